"""Downloading a plan. The same command, run again after any interruption, fetches only what is missing.

The caller's thread asks for URLs in batches and hands out ranges; other threads fetch, verify and finish. Memory: one
slice for each thread.
"""

import contextlib
import os
import shutil
import threading
import time
import uuid
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import urllib3

from kleinkram.client._client import Client
from kleinkram.client._http import store_unreachable
from kleinkram.client._network import NetworkMonitor
from kleinkram.client._retry import Backoff
from kleinkram.client.errors import (
    DestinationDiffers,
    DestinationRefused,
    DiskFull,
    ServerUnreachable,
    StoreTroubled,
    TransferFailed,
    VerifyFailed,
)
from kleinkram.client.transfer.destination import (
    PART_SUFFIX,
    DownloadPlan,
    DownloadTarget,
    make_folders,
    partial_path,
    regular_size,
)
from kleinkram.client.transfer.link import RECONNECT_S, Lane, LinkMonitor, LinkReport, Window
from kleinkram.client.transfer.local_file import SLICE_BYTES
from kleinkram.client.transfer.partial_file import PartialFile
from kleinkram.client.transfer.report import Outcome, SilentObserver, TransferReport, TransferResult, Watcher
from kleinkram.client.transfer.store import MOST_TROUBLED, PATIENCE_S, GetResult, StoreAnswer, StoreClient
from kleinkram.client.transfer.threads import Budget, RateLimit, Stop, Stopped, WorkQueue, check_limits
from kleinkram.client.transfer.verify import is_same
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


@dataclass(frozen=True)
class _Piece:
    fetching: PartialFile
    number: int
    first: int
    last: int


class Downloader:
    """One run of a download. `ended` is called once a file, from any thread."""

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
        self._pieces: WorkQueue[_Piece] = WorkQueue(self._stop)
        self._targets: dict[uuid.UUID, DownloadTarget] = {}
        self._open: dict[uuid.UUID, PartialFile] = {}
        self._troubled = 0

    def run(self, targets: Sequence[DownloadTarget], connections: int) -> LinkReport:
        """Download the files; returns when each has ended, with how the link was.

        Raises:
            KleinkramError: something that concerns all files; what has arrived stays for the next run.
        """
        self._targets = {target.file.id: target for target in targets}
        self._store = StoreClient(connections)
        self._lane = Lane(self._stop, Window(connections))
        self._lines = threading.BoundedSemaphore(connections)
        # One more than there are connections: while one takes the checksum of what arrived, none of them idles.
        threads = [threading.Thread(target=self._guard, daemon=True) for _ in range(connections + 1)]
        for thread in threads:
            thread.start()
        failure: BaseException | None = None
        try:
            with NetworkMonitor(self._link.moved), contextlib.suppress(Stopped):
                self._hand_out(targets)
                self._under_way.wait_until_free()
        except KleinkramError as error:
            failure = error
        finally:
            self._stop.now()
            for thread in threads:
                thread.join(timeout=2.0)
            for fetching in self._open.values():
                fetching.close()
            self._store.close()
        failure = failure or self._stop.failure
        if failure is not None:
            self._link.explain(failure, self._server)
            raise failure
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

    def _guard(self) -> None:
        try:
            while True:
                for piece in self._pieces.take(1):
                    self._fetch_piece(piece)
        except Stopped:
            return
        except BaseException as error:  # carried to the caller's thread, which raises it
            self._stop.now(error)

    # -- handing out: the caller's thread -----------------------------------------------------------------------------

    def _hand_out(self, targets: Sequence[DownloadTarget]) -> None:
        batch: list[DownloadTarget] = []
        for target in targets:
            if self._is_needed(target):
                batch.append(target)
            if len(batch) == _LINKS_AT_ONCE:
                self._hand_out_batch(batch)
                batch = []
        self._hand_out_batch(batch)

    def _is_needed(self, target: DownloadTarget) -> bool:
        """Look at what is at the target already; say whether the file must be fetched."""
        try:
            make_folders(target.dest, target.relative)
            if regular_size(target.local) is None:
                return True
            if is_same(target.file, target.local, self._stop.check):
                self._watcher.skipped(target.file.path, target.file.size_bytes, target.file.size_bytes)
                self._end(target, Outcome.present)
                return False
        except DestinationRefused as error:
            self._end(target, Outcome.refused, error=error)
            return False
        if not self._overwrite:
            self._end(target, Outcome.refused, error=DestinationDiffers(path=str(target.local)))
        return self._overwrite

    def _hand_out_batch(self, batch: Sequence[DownloadTarget]) -> None:
        if not batch:
            return
        try:
            links = self._ask_links([target.file.id for target in batch])
        except (FileUnavailable, NotFound) as error:
            if len(batch) == 1:
                self._end(batch[0], Outcome.refused, error=error)
                return
            for target in batch:
                self._hand_out_batch([target])
            return
        for target, link in zip(batch, links, strict=True):
            self._hand_out_file(target, link)

    def _hand_out_file(self, target: DownloadTarget, link: DownloadLink) -> None:
        self._under_way.acquire(1)
        try:
            fetching = PartialFile(link, target.local, overwrite=self._overwrite)
        except DestinationRefused as error:
            self._under_way.release(1)
            self._end(target, Outcome.refused, error=error)
            return
        self._open[link.file_id] = fetching
        self._watcher.skipped(target.file.path, fetching.stored_bytes(), link.size_bytes)
        for number, first, last in [*fetching.missing()]:
            if fetching.ended:
                break
            self._ahead.acquire(1)
            fetching.add_range()
            self._pieces.put(_Piece(fetching, number, first, last))
        self._count_done(fetching)

    # -- fetching: the other threads ----------------------------------------------------------------------------------

    def _fetch_piece(self, piece: _Piece) -> None:
        fetching = piece.fetching
        try:
            if not fetching.ended:
                with self._lines, self._lane.place() as place:
                    self._fetch(piece, place)
                fetching.arrived(piece.number, piece.last - piece.first + 1)
                fetching.hash_ready(self._stop.check)
        except _OF_ONE_FILE as error:
            self._fail(fetching, error)
        self._ahead.release(1)
        self._count_done(fetching)

    def _fetch(self, piece: _Piece, place: int) -> None:
        fetching, offset, refusals = piece.fetching, piece.first, 0
        backoff = Backoff(PATIENCE_S, self._stop.wait)
        while offset <= piece.last:
            with self._lane.turn(place, piece.last + 1 - offset) as waited_s:
                backoff.excuse(waited_s)
                answer, reached = self._get(piece, offset)
            if reached > offset:
                offset, backoff = reached, Backoff(PATIENCE_S, self._stop.wait)
                self._troubled = 0
                if answer.error is not None:
                    self._link.lost(fetching.link.url, backoff, answer.error, answer.why)
            elif answer.answer in {StoreAnswer.taken, StoreAnswer.try_again}:
                self._wait_for_bytes(fetching, answer, backoff, place)
            elif answer.answer is StoreAnswer.sign_again and refusals < _REFUSALS:
                refusals += 1
                fetching.link = self._ask_links([fetching.link.file_id])[0]
            else:
                raise TransferFailed(path=fetching.link.path, reason=answer.reason)

    def _get(self, piece: _Piece, offset: int) -> tuple[GetResult, int]:
        """Fetch from an offset to the piece's end; return the store's answer and the offset reached."""
        began_at = time.monotonic()
        answer = self._store.get(piece.fetching.link.url, offset, piece.last, SLICE_BYTES)
        reached = self._receive(piece, offset, answer)
        if answer.is_of_all:
            self._lane.lost()
        elif reached > piece.last:
            self._lane.arrived(reached - offset, time.monotonic() - began_at)
        return answer, reached

    def _wait_for_bytes(self, fetching: PartialFile, answer: GetResult, backoff: Backoff, place: int) -> None:
        """Wait before a piece of which nothing came is asked for again.

        Raises:
            FileUnavailable: the server found that the file is damaged or lost.
            StoreUnreachable, StoreTroubled: it has been waited for long enough.
        """
        if answer.error is None:
            self._lane.step_out(place)
        if answer.error is None and not answer.is_of_all and self._check is not None:
            self._raise_if_damaged(fetching, answer.why, self._check)
        else:
            self._link.lost(fetching.link.url, backoff, answer.error, answer.why)
        if self._link.has_moved():
            self._stop.wait(RECONNECT_S)
        elif not backoff.pause():
            raise self._gave_up(fetching, answer)

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
            with contextlib.suppress(KleinkramError):  # who may not ask for it waits for the store as before
                check(file_id)
                path = fetching.link.path
                self._watcher.notify(f"the store does not return {path} ({why}); the server is checking the file")
            return
        until = time.monotonic() + _CHECK_S
        while time.monotonic() < until:
            fetching.link = self._ask_links([file_id])[0]
            self._stop.wait(_CHECK_POLL_S)

    def _receive(self, piece: _Piece, offset: int, answer: GetResult) -> int:
        """Write what the store gives, and return the offset reached; less than asked when the connection ended."""
        path, total = piece.fetching.link.path, piece.fetching.size_bytes
        try:
            for data in answer.slices():
                self._stop.check()
                data = data[: piece.last + 1 - offset]
                self._pace.spend(len(data), self._stop.wait)
                piece.fetching.write(offset, data)
                offset += len(data)
                self._link.arrived()
                self._watcher.moved(path, len(data), total)
        except urllib3.exceptions.HTTPError as error:
            answer.error = error
        finally:
            answer.close()
        return offset

    def _gave_up(self, fetching: PartialFile, answer: GetResult) -> KleinkramError:
        self._troubled += 1
        if answer.is_of_all or self._troubled > MOST_TROUBLED:
            return store_unreachable(fetching.link.url, answer.why)
        return StoreTroubled(path=fetching.link.path, reason=answer.why)

    # -- ends ---------------------------------------------------------------------------------------------------------

    def _count_done(self, fetching: PartialFile) -> None:
        """Count a range as over; the thread that brings the last one finishes the file."""
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


CONNECTIONS = 4


def download(
    client: Client,
    plan: DownloadPlan,
    *,
    overwrite: bool = False,
    connections: int = CONNECTIONS,
    bytes_per_s: float | None = None,
    watcher: Watcher | None = None,
) -> TransferReport:
    """Download the planned files and return how each ended.

    Every file is verified against the server's checksum, then appears under its name at once and whole; until then it
    is `NAME.klein-part`. A file that is here already is left as it is: the same, or refused unless `overwrite`.

    Raises:
        DiskFull: there is no room for all of it.
        ServerUnreachable, StoreUnreachable: one of them stayed away.
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
    """Download what is planned from where `links`, asked of a `server`, says it is; all else is as in `download`.

    `check` has the server read a file that the store does not return.
    """
    check_limits(connections, bytes_per_s)
    watcher = watcher or SilentObserver()
    results: dict[uuid.UUID | None, TransferResult] = {}
    lock = threading.Lock()

    def ended(result: TransferResult) -> None:
        with lock:
            results[result.file_id] = result
        watcher.ended(result.path, result.outcome.value, str(result.error) if result.error else None)

    if plan.targets:
        _check_room(plan)
    watcher.began(len(plan.targets), plan.size_bytes)
    downloader = Downloader(
        links, server, pace=RateLimit(bytes_per_s), watcher=watcher, overwrite=overwrite, ended=ended, check=check
    )
    link = downloader.run(plan.targets, connections)
    return TransferReport([results[target.file.id] for target in plan.targets], plan.left_out, link)


def _check_room(plan: DownloadPlan) -> None:
    dest = plan.targets[0].dest
    try:
        dest.mkdir(parents=True, exist_ok=True)
        free = shutil.disk_usage(dest).free
    except OSError as error:
        raise DestinationRefused(path=os.fspath(dest), reason=error.strerror or str(error)) from None
    needed = sum(_needed(target) for target in plan.targets)
    if needed > free:
        raise DiskFull(path=os.fspath(dest), reason=f"{needed} bytes are needed and {free} are free")


def _needed(target: DownloadTarget) -> int:
    """Return how much more room a file takes; what an earlier run left takes its own already."""
    if target.local.exists():
        return 0
    try:
        return max(0, target.file.size_bytes - partial_path(target.local, PART_SUFFIX).stat().st_blocks * 512)
    except OSError:
        return target.file.size_bytes
