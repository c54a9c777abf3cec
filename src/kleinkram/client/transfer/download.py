"""Downloading a plan. The same command, run again after any interruption, fetches only what is missing.

The caller's thread asks for URLs in batches and hands out ranges; other threads fetch, verify and finish. Memory: one
slice per thread.
"""

import contextlib
import itertools
import os
import shutil
import threading
import time
import uuid
from collections import Counter
from collections.abc import Callable, Sequence
from typing import NamedTuple

import urllib3

from kleinkram.client._client import Client
from kleinkram.client._http import Backoff
from kleinkram.client.errors import (
    DestinationDiffers,
    DestinationRefused,
    DiskFull,
    ServerUnreachable,
    TransferFailed,
    VerifyFailed,
)
from kleinkram.client.transfer.destination import (
    PART_SUFFIX,
    DownloadPlan,
    DownloadTarget,
    PartialFile,
    make_folders,
    partial_path,
    regular_size,
)
from kleinkram.client.transfer.link import CongestionWindow, Lane, LinkMonitor
from kleinkram.client.transfer.local_file import SLICE_BYTES, is_same
from kleinkram.client.transfer.report import (
    CONNECTIONS,
    LinkReport,
    Outcome,
    ResultCollector,
    TransferReport,
    TransferResult,
    Watcher,
)
from kleinkram.client.transfer.store import PATIENCE_S, GetResult, StoreAnswer, StoreClient
from kleinkram.client.transfer.threads import Budget, RateLimit, Stop, WorkQueue, check_limits
from kleinkram.contract.errors import FileUnavailable, KleinkramError, NotFound
from kleinkram.contract.files import DownloadLink

_LINKS_AT_ONCE = 50
_FILES_UNDER_WAY = 64
_RANGES_AHEAD = 16
_REFUSALS = 4
_OF_ONE_FILE = (DestinationDiffers, DestinationRefused, TransferFailed, VerifyFailed, FileUnavailable, NotFound)

# Returns where to read some files, by their ids, in the order asked.
Links = Callable[[Sequence[uuid.UUID]], Sequence[DownloadLink]]
# Asks the server to read the bytes of a file and compare them with its checksums.
Check = Callable[[uuid.UUID], object]
# The server needs half a minute to find that a store cannot return an object.
_CHECK_S, _CHECK_POLL_S = 45.0, 2.0


def download(
    client: Client,
    plan: DownloadPlan,
    *,
    overwrite: bool = False,
    connections: int = CONNECTIONS,
    bytes_per_s: float | None = None,
    watcher: Watcher | None = None,
) -> TransferReport:
    """Download the planned files and return the result for each.

    Every file is verified against the server's checksum, then appears under its name at once and whole; until then it
    is `NAME.klein-part`. An existing file stays: the same, or refused unless `overwrite`.

    Raises:
        DiskFull: there is no room for all of it.
        ServerUnreachable, StoreUnreachable: one of them stayed unavailable.
    """
    return fetch(
        lambda file_ids: client.files.links(file_ids).items,
        client.endpoint.url,
        plan,
        overwrite=overwrite,
        connections=connections,
        bytes_per_s=bytes_per_s,
        watcher=watcher,
        check=client.files.verify,
    )


def fetch(
    links: Links,
    server: str,
    plan: DownloadPlan,
    *,
    overwrite: bool = False,
    connections: int = CONNECTIONS,
    bytes_per_s: float | None = None,
    watcher: Watcher | None = None,
    check: Check | None = None,
) -> TransferReport:
    """Download what is planned, as `download` does, from where `links` of a `server` point.

    `check` has the server read a file that the store does not return.
    """
    check_limits(connections, bytes_per_s)
    watcher = watcher or Watcher()
    results = ResultCollector(watcher)
    if plan.targets:
        _check_room(plan)
    watcher.began(len(plan.targets), plan.size_bytes)
    downloader = Downloader(
        links,
        server,
        pace=RateLimit(bytes_per_s),
        watcher=watcher,
        overwrite=overwrite,
        ended=lambda result: results.add(result.file_id, result),
        check=check,
    )
    link = downloader.run(plan.targets, connections)
    return TransferReport(results.in_order([target.file.id for target in plan.targets]), plan.left_out, link)


def _check_room(plan: DownloadPlan) -> None:
    dest = plan.targets[0].dest
    try:
        dest.mkdir(parents=True, exist_ok=True)
        free = shutil.disk_usage(dest).free
    except OSError as error:
        raise DestinationRefused(path=os.fspath(dest), reason=error.strerror or str(error)) from None
    needed = 0
    for target in plan.targets:
        if not target.local.exists():
            present = 0  # what an earlier run left takes its room already
            with contextlib.suppress(OSError):
                present = partial_path(target.local, PART_SUFFIX).stat().st_blocks * 512
            needed += max(0, target.file.size_bytes - present)
    if needed > free:
        raise DiskFull(path=os.fspath(dest), reason=f"{needed} bytes are needed and {free} are free")


class _FileRange(NamedTuple):
    """A range of a file to fetch, both ends inclusive."""

    fetching: PartialFile
    number: int
    first: int
    last: int


class Downloader:
    """One run of a download. `ended` is called once per file, from any thread."""

    def __init__(
        self,
        links: Links,
        server: str,
        *,
        pace: RateLimit,
        watcher: Watcher,
        overwrite: bool,
        ended: Callable[[TransferResult], None],
        check: Check | None = None,
    ) -> None:
        self._links = links
        self._check = check
        self._refused = Counter[uuid.UUID]()
        self._server = server
        self._stop = Stop()
        self._pace = pace
        self._watcher = watcher
        self._link = LinkMonitor(watcher.notify)
        self._overwrite = overwrite
        self._ended = ended
        self._under_way = Budget(self._stop, _FILES_UNDER_WAY)
        self._ahead = Budget(self._stop, _RANGES_AHEAD)
        self._ranges: WorkQueue[_FileRange] = WorkQueue(self._stop)
        self._targets: dict[uuid.UUID, DownloadTarget] = {}
        self._open: dict[uuid.UUID, PartialFile] = {}

    def run(self, targets: Sequence[DownloadTarget], connections: int) -> LinkReport:
        """Download the files; return when each has ended, with how the network was.

        Raises:
            KleinkramError: something that concerns all files; what has arrived stays for the next run.
        """
        self._targets = {target.file.id: target for target in targets}
        self._store = StoreClient(connections)
        self._lane = Lane(self._stop, CongestionWindow(connections))
        self._lines = threading.BoundedSemaphore(connections)
        # One more than there are connections: while one hashes what arrived, none of them idles.
        threads = [self._stop.start(self._fetch_loop) for _ in range(connections + 1)]

        def fetch_all() -> None:
            needed = (target for target in targets if self._is_needed(target))
            while batch := [*itertools.islice(needed, _LINKS_AT_ONCE)]:
                self._hand_out(batch)
            self._under_way.wait_until_free()

        try:
            self._link.watch(self._stop, self._server, fetch_all)
        finally:
            self._stop.now()
            for thread in threads:
                thread.join(timeout=2.0)
            for fetching in self._open.values():
                fetching.close()
            self._store.close()
        return self._link.report()

    def _ask_links(self, file_ids: Sequence[uuid.UUID]) -> Sequence[DownloadLink]:
        """Ask where files are, for as long as a store would be waited for."""
        backoff: Backoff | None = None
        while True:
            try:
                return self._links(file_ids)
            except ServerUnreachable as error:
                failure = error
            backoff = backoff or Backoff(PATIENCE_S, self._stop.wait)
            self._link.waits_for_server(self._server)
            if not backoff.pause():
                raise failure

    # -- handing out: the caller's thread -----------------------------------------------------------------------------

    def _is_needed(self, target: DownloadTarget) -> bool:
        """Say whether a file must be fetched; end one that is there already, or cannot be written."""
        try:
            make_folders(target.dest, target.relative)
            if regular_size(target.local) is None:
                return True
            if is_same(target.file, target.local, self._stop.check):
                self._watcher.skipped(target.file.path, target.file.size_bytes, target.file.size_bytes)
                self._end(target, Outcome.already_present)
                return False
        except DestinationRefused as error:
            self._end(target, Outcome.refused, error=error)
            return False
        if not self._overwrite:
            self._end(target, Outcome.refused, error=DestinationDiffers(path=str(target.local)))
        return self._overwrite

    def _hand_out(self, batch: Sequence[DownloadTarget]) -> None:
        try:
            links = self._ask_links([target.file.id for target in batch])
        except (FileUnavailable, NotFound) as error:
            if len(batch) == 1:
                self._end(batch[0], Outcome.refused, error=error)
                return
            for target in batch:
                self._hand_out([target])
            return
        for target, link in zip(batch, links, strict=True):
            self._under_way.acquire(1)
            try:
                fetching = PartialFile(link, target.local, overwrite=self._overwrite)
            except DestinationRefused as error:
                self._under_way.release(1)
                self._end(target, Outcome.refused, error=error)
                continue
            self._open[link.file_id] = fetching
            self._watcher.skipped(target.file.path, fetching.stored_bytes(), link.size_bytes)
            for number, first, last in [*fetching.missing()]:
                if fetching.ended:
                    break
                self._ahead.acquire(1)
                fetching.add_range()
                self._ranges.put(_FileRange(fetching, number, first, last))
            self._count_done(fetching)

    # -- fetching: the other threads ----------------------------------------------------------------------------------

    def _fetch_loop(self) -> None:
        while True:
            for part in self._ranges.take(1):
                fetching = part.fetching
                try:
                    if not fetching.ended:
                        with self._lines, self._lane.place() as place:
                            self._fetch(part, place)
                        fetching.arrived(part.number, part.last - part.first + 1)
                        fetching.hash_ready(self._stop.check)
                except _OF_ONE_FILE as error:
                    self._fail(fetching, error)
                self._ahead.release(1)
                self._count_done(fetching)

    def _fetch(self, part: _FileRange, place: int) -> None:
        fetching, offset, refusals = part.fetching, part.first, 0
        backoff = Backoff(PATIENCE_S, self._stop.wait)
        while offset <= part.last:
            with self._lane.turn(place, part.last + 1 - offset) as waited_s:
                backoff.excuse(waited_s)
                result, reached = self._get(part, offset)
            if reached > offset:
                offset, backoff = reached, Backoff(PATIENCE_S, self._stop.wait)
                if result.error is not None:
                    self._link.lost(fetching.link.url, backoff, result.error, result.why)
            elif result.answer in {StoreAnswer.taken, StoreAnswer.try_again}:
                if result.error is None:
                    self._lane.step_out(place)
                if result.error is None and not result.is_store_wide and self._check is not None:
                    self._raise_if_damaged(fetching, result.why, self._check)
                else:
                    self._link.lost(fetching.link.url, backoff, result.error, result.why)
                if not self._link.pause(backoff, self._stop):
                    raise self._link.give_up(fetching.link.url, fetching.link.path, result)
            elif result.answer is StoreAnswer.sign_again and refusals < _REFUSALS:
                refusals += 1
                fetching.link = self._ask_links([fetching.link.file_id])[0]
            else:
                raise TransferFailed(path=fetching.link.path, reason=result.reason)

    def _get(self, part: _FileRange, offset: int) -> tuple[GetResult, int]:
        """Write the bytes from an offset to the range's end; return the store's answer and the offset reached."""
        began_at, began_offset = time.monotonic(), offset
        result = self._store.get(part.fetching.link.url, offset, part.last, SLICE_BYTES)
        path, total = part.fetching.link.path, part.fetching.size_bytes
        try:
            for data in result.slices():
                self._stop.check()
                data = data[: part.last + 1 - offset]
                self._pace.spend(len(data), self._stop.wait)
                part.fetching.write(offset, data)
                offset += len(data)
                self._link.arrived()
                self._watcher.moved(path, len(data), total)
        except urllib3.exceptions.HTTPError as error:
            result.error = error
        finally:
            result.close()
        if result.is_store_wide:
            self._lane.lost()
        elif offset > part.last:
            self._lane.arrived(offset - began_offset, time.monotonic() - began_at)
        return result, offset

    def _raise_if_damaged(self, fetching: PartialFile, why: str, check: Check) -> None:
        """Have the server check a file whose bytes the store does not return; the second time, wait for the answer.

        Raises:
            FileUnavailable: the server found that it is damaged or lost.
        """
        file_id = fetching.link.file_id
        self._refused[file_id] += 1
        if self._refused[file_id] > 2:
            return
        if self._refused[file_id] == 1:
            with contextlib.suppress(KleinkramError):  # without the right to ask, wait for the store as before
                check(file_id)
                path = fetching.link.path
                self._watcher.notify(f"the store does not return {path} ({why}); the server is checking the file")
            return
        until = time.monotonic() + _CHECK_S
        while time.monotonic() < until:
            fetching.link = self._ask_links([file_id])[0]
            self._stop.wait(_CHECK_POLL_S)

    # -- ends ---------------------------------------------------------------------------------------------------------

    def _count_done(self, fetching: PartialFile) -> None:
        """Count a range as done; the thread that brings the last one finishes the file."""
        if not fetching.part_done():
            return
        try:
            if not fetching.ended:
                fetching.finish(self._stop.check)
                fetching.end()
                self._end(self._targets[fetching.link.file_id], Outcome.downloaded, moved_bytes=fetching.fetched_bytes)
        except _OF_ONE_FILE as error:
            self._fail(fetching, error)
        self._open.pop(fetching.link.file_id, None)
        fetching.close()
        self._under_way.release(1)

    def _fail(self, fetching: PartialFile, error: KleinkramError) -> None:
        self._stop.check()
        if fetching.end():
            self._end(self._targets[fetching.link.file_id], Outcome.refused, error=error)

    def _end(
        self, target: DownloadTarget, outcome: Outcome, *, moved_bytes: int = 0, error: KleinkramError | None = None
    ) -> None:
        file = target.file
        self._ended(
            TransferResult(file.path, target.local, file.size_bytes, outcome, moved_bytes, file.id, file.sha256, error)
        )
