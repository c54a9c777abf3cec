"""Downloads a plan: the caller's thread gets URLs in batches and queues ranges; others fetch, verify and finish.

The same command, run again after any interruption, fetches only what is missing. Memory: one slice per thread.
"""

import contextlib
import itertools
import os
import shutil
import time
import uuid
from collections import Counter
from collections.abc import Callable, Sequence

import urllib3

from kleinkram import traces
from kleinkram.client._client import Client
from kleinkram.client._http import Backoff
from kleinkram.client.errors import DestinationDiffers, DestinationRefused, DiskFull, ServerUnreachable, VerifyFailed
from kleinkram.client.transfer import store
from kleinkram.client.transfer.download_target import (
    PART_SUFFIX,
    DownloadPlan,
    DownloadTarget,
    PartialFile,
    make_folders,
    partial_path,
    regular_size,
)
from kleinkram.client.transfer.plan import SLICE_BYTES
from kleinkram.client.transfer.pool import Part, TransferPool
from kleinkram.client.transfer.report import CONNECTIONS, Outcome, TransferReport, TransferResult, Watcher
from kleinkram.client.transfer.store import GetResult, StoreResult
from kleinkram.client.transfer.verify import is_same
from kleinkram.contract.errors import FileUnavailable, KleinkramError, NotFound
from kleinkram.contract.files import DownloadLink

_LINKS_PER_REQUEST = 50
_MAX_FILES = 64
_MAX_QUEUED_RANGES = 16

# Returns where to read files, by their ids, in the order asked.
Links = Callable[[Sequence[uuid.UUID]], Sequence[DownloadLink]]
# Has the server read the bytes of a file and compare them with its checksums.
Check = Callable[[uuid.UUID], object]
# The server takes up to half a minute to notice that a store cannot return an object.
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

    Every file is verified against the server's checksum before it gets its name; until then it is `NAME.klein-part`.
    An existing file stays: it is the same, or the download of that file is refused unless `overwrite`.

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
    """Download the planned files, as `download` does, from the URLs that `links` returns.

    `server` is the URL of the server. `check` has it read a file that the store does not return.
    """
    watcher = watcher or Watcher()
    downloader = Downloader(
        links,
        server,
        connections=connections,
        bytes_per_s=bytes_per_s,
        watcher=watcher,
        overwrite=overwrite,
        check=check,
    )
    if plan.targets:
        _check_room(plan)
    watcher.began(len(plan.targets), plan.size_bytes)
    attributes: traces.Attributes = {"kleinkram.files": len(plan.targets), "kleinkram.bytes": plan.size_bytes}
    with traces.span("download", attributes):
        link = downloader.run(lambda: downloader.queue(plan.targets))
    by_id = {result.file_id: result for result in downloader.results}
    return TransferReport([by_id[target.file.id] for target in plan.targets], plan.left_out, link)


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
            present = 0  # bytes of an earlier run take up room already
            with contextlib.suppress(OSError):
                present = partial_path(target.local, PART_SUFFIX).stat().st_blocks * 512
            needed += max(0, target.file.size_bytes - present)
    if needed > free:
        raise DiskFull(path=os.fspath(dest), reason=f"{needed} bytes are needed and {free} are free")


class _FileRange(Part):
    """A range of a file to fetch."""

    file: PartialFile


class Downloader(TransferPool[_FileRange]):
    """One run of a download."""

    def __init__(
        self,
        links: Links,
        server: str,
        *,
        connections: int,
        bytes_per_s: float | None,
        watcher: Watcher,
        overwrite: bool,
        check: Check | None = None,
    ) -> None:
        super().__init__(
            server,
            connections=connections,
            spare_threads=1,  # while one thread hashes, no connection is idle
            max_files=_MAX_FILES,
            max_queued=_MAX_QUEUED_RANGES,
            bytes_per_s=bytes_per_s,
            watcher=watcher,
        )
        self._links = links
        self._check = check
        self._refused = Counter[uuid.UUID]()
        self._overwrite = overwrite
        self._targets: dict[uuid.UUID, DownloadTarget] = {}

    # -- queueing: the caller's thread --------------------------------------------------------------------------------

    def queue(self, targets: Sequence[DownloadTarget]) -> None:
        """Queue what is missing of these files; waits while enough is queued."""
        self._targets = {target.file.id: target for target in targets}
        missing = (target for target in targets if self._is_missing(target))
        while batch := [*itertools.islice(missing, _LINKS_PER_REQUEST)]:
            self._queue_batch(batch)

    def _is_missing(self, target: DownloadTarget) -> bool:
        """Return whether a file must be fetched; end one that is there already, or cannot be written."""
        try:
            make_folders(target.dest, target.relative)
            if regular_size(target.local) is None:
                return True
            if is_same(target.file, target.local, self.stop.check):
                self._watcher.skipped(target.file.path, target.file.size_bytes, target.file.size_bytes)
                self._end(target, Outcome.already_present)
                return False
        except DestinationRefused as error:
            self._end(target, Outcome.refused, error=error)
            return False
        if not self._overwrite:
            self._end(target, Outcome.refused, error=DestinationDiffers(path=str(target.local)))
        return self._overwrite

    def _queue_batch(self, batch: Sequence[DownloadTarget]) -> None:
        try:
            links = self._request_links([target.file.id for target in batch])
        except (FileUnavailable, NotFound) as error:
            if len(batch) == 1:
                self._end(batch[0], Outcome.refused, error=error)
                return
            for target in batch:
                self._queue_batch([target])
            return
        for target, link in zip(batch, links, strict=True):
            try:
                file = PartialFile(link, target.local, overwrite=self._overwrite)
            except DestinationRefused as error:
                self._end(target, Outcome.refused, error=error)
                continue
            self._open_file(file)
            self._watcher.skipped(file.path, file.stored_bytes(), file.size_bytes)
            for number, first, last in [*file.missing()]:
                if file.ended:
                    break
                part = _FileRange(file, number, first, last + 1 - first)
                self._add_part(part)
                self._parts.put(part)
            self._count_done(file)

    def _request_links(self, file_ids: Sequence[uuid.UUID]) -> Sequence[DownloadLink]:
        """Return links to files; retried while the server is unavailable."""
        backoff: Backoff | None = None
        while True:
            try:
                return self._links(file_ids)
            except ServerUnreachable:  # noqa: PERF203  (each round is a request)
                backoff = backoff or Backoff(store.TRANSFER_RETRY_S, self.wait_for_server)
                if not backoff.pause():
                    raise

    # -- fetching: the other threads ----------------------------------------------------------------------------------

    def _request(self, part: _FileRange) -> GetResult | None:
        file = part.file
        first = part.offset + part.moved_bytes
        result = self._store.get(file.url, first, part.offset + part.size_bytes - 1, SLICE_BYTES)
        try:
            for data in result.slices():
                self.stop.check()
                data = data[: part.left_bytes]
                self._rate_limit.spend(len(data), self.stop.wait)
                file.write(part.offset + part.moved_bytes, data)
                part.moved_bytes += len(data)
                self.outages.arrived()
                self._watcher.moved(file.path, len(data), file.size_bytes)
        except urllib3.exceptions.HTTPError as error:
            result.error = error
        finally:
            result.close()
        return result if part.left_bytes else None

    def _sign_again(self, part: _FileRange) -> None:
        file = part.file
        [file.link] = self._request_links([file.link.file_id])
        file.url = file.link.url

    def _report_failure(self, part: _FileRange, result: StoreResult, backoff: Backoff) -> None:
        if result.is_store_wide or self._check is None:
            super()._report_failure(part, result, backoff)
        else:
            self._raise_if_damaged(part, result.why, self._check)

    def _raise_if_damaged(self, part: _FileRange, why: str, check: Check) -> None:
        """Have the server check a file whose bytes the store does not return; the second time, wait for the result.

        Raises:
            FileUnavailable: the server found that it is damaged or missing.
        """
        file_id, path = part.file.link.file_id, part.file.path
        self._refused[file_id] += 1
        if self._refused[file_id] == 1:
            with contextlib.suppress(KleinkramError):  # without the right to verify, wait for the store as before
                check(file_id)
                self._watcher.notify(f"the store does not return {path} ({why}); the server is checking the file")
        elif self._refused[file_id] == 2:
            deadline = time.monotonic() + _CHECK_S
            while time.monotonic() < deadline:
                self._sign_again(part)
                self.stop.wait(_CHECK_POLL_S)

    def _moved(self, part: _FileRange) -> None:
        part.file.arrived(part.number, part.size_bytes)
        part.file.hash_ready(self.stop.check)

    # -- ends ---------------------------------------------------------------------------------------------------------

    def _part_done(self, part: _FileRange) -> None:
        self._queued.release(part.cost)
        self._count_done(part.file)

    def _count_done(self, file: PartialFile) -> None:
        """Count a range as done; the thread that moved the last one finishes the file."""
        if not file.part_done():
            return
        try:
            if not file.ended:
                file.finish(self.stop.check)
                file.end()
                self._end(self._targets[file.link.file_id], Outcome.downloaded, moved_bytes=file.fetched_bytes)
        except (DestinationDiffers, DestinationRefused, VerifyFailed) as error:
            self._fail(file, error)
        self._close_file(file)

    def _part_failed(self, part: _FileRange, error: KleinkramError) -> None:
        self._fail(part.file, error)

    def _fail(self, file: PartialFile, error: KleinkramError) -> None:
        self.stop.check()
        if file.end():
            self._end(self._targets[file.link.file_id], Outcome.refused, error=error)

    def _end(
        self, target: DownloadTarget, outcome: Outcome, *, moved_bytes: int = 0, error: KleinkramError | None = None
    ) -> None:
        file = target.file
        self.add_result(
            TransferResult(file.path, target.local, file.size_bytes, outcome, moved_bytes, file.id, file.sha256, error)
        )
