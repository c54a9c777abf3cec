"""Uploading a plan. The same command, run again after any interruption, sends only what is missing.

Files are announced to the server a batch at a time, just before they are sent, so that no lease runs out while others
are sent. The pipeline sends the bytes.
"""

import contextlib
import threading
import time
import uuid
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from kleinkram.client._client import Client
from kleinkram.client._network import NetworkMonitor
from kleinkram.client.errors import FileChanged, FileUnreadable, TransferFailed, UploadElsewhere
from kleinkram.client.transfer.file_upload import FileUpload
from kleinkram.client.transfer.journal import Journal, JournalHead, Journals
from kleinkram.client.transfer.link import LinkMonitor, LinkReport
from kleinkram.client.transfer.local_file import FileHashes, OpenFile
from kleinkram.client.transfer.plan import LocalFile, UploadPlan
from kleinkram.client.transfer.report import Outcome, SilentObserver, TransferReport, TransferResult, Watcher
from kleinkram.client.transfer.store import PATIENCE_S
from kleinkram.client.transfer.threads import RateLimit, Stop, Stopped, check_limits
from kleinkram.client.transfer.upload_pipeline import UploadPipeline
from kleinkram.client.uploads import Uploads
from kleinkram.contract.errors import KleinkramError, NameLeased, QuotaExceeded, UploadGone
from kleinkram.contract.problems import from_problem
from kleinkram.contract.uploads import (
    MIN_PART_BYTES,
    HashFirst,
    Linked,
    Present,
    Send,
    UploadDecision,
    UploadFile,
    UploadRead,
    UploadRefused,
)

_FIRST_BATCH_FILES = 16
_BATCH_FILES = 100
_BATCH_BYTES = 128 * 1024 * 1024
_LEASE_PATIENCE_S = 90.0
_LEASE_POLL_S = 2.0


@dataclass
class PendingFile:
    """A file about to be announced: open, its journal locked, its checksums where they are known."""

    source: OpenFile
    journal: Journal
    whole: FileHashes | None = None
    new_id: uuid.UUID = field(default_factory=uuid.uuid4)

    def announcement(self) -> UploadFile:
        """Return what the server is told."""
        notify: dict[str, object] = {"path": self.source.file.path, "size_bytes": self.source.file.size_bytes}
        if self.whole is not None:
            notify |= {"sha256": self.whole.sha256.hexdigest(), "crc64nvme": self.whole.crc64nvme.hexdigest()}
        # By an id of our own: an answer may be lost, and its upload would hold the name against us.
        remembered = self.journal.remembered
        notify["upload_id"] = self.new_id if remembered is None else remembered.upload_id
        return UploadFile.model_validate(notify)

    def hash_whole(self, check: Callable[[], None]) -> None:
        """Read all of the file for its checksums; `check` may end it between two slices."""
        whole = FileHashes()
        for view in self.source.slices(0, self.source.file.size_bytes):
            check()
            whole.update(view)
        self.whole = whole

    def close(self) -> None:
        """Close the file and its journal."""
        self.source.close()
        self.journal.close()


class Uploader:
    """One run of an upload into one mission. `ended` is called once a file, with its end; from any thread.

    `journals` is where its journals are; by default, where this user's are.
    """

    def __init__(
        self,
        uploads: Uploads,
        server: str,
        mission_id: uuid.UUID,
        *,
        pace: RateLimit,
        watcher: Watcher,
        ended: Callable[[TransferResult], None],
        journals: Path | None = None,
    ) -> None:
        self._stop = Stop()
        self._link = LinkMonitor(watcher.notify)
        self._uploads = uploads.with_patience(PATIENCE_S, self._wait_for_server)
        self._server = server
        self._mission_id = mission_id
        self._journals = Journals(journals)
        self._watcher = watcher
        self._ended = ended
        self._pipeline = UploadPipeline(
            self._uploads, self._stop, pace=pace, link=self._link, watcher=watcher, ended=ended
        )
        self._leased: dict[LocalFile, NameLeased] = {}

    def end(self) -> None:
        """End it, from another thread: `run` returns soon, and files that had not ended stay as they are."""
        self._stop.now()

    def run(self, files: Sequence[LocalFile], connections: int) -> LinkReport:
        """Upload the files; returns when each has ended, with how the link was.

        Raises:
            KleinkramError: something that concerns all files; those that had not ended have not been uploaded.
        """
        self._pipeline.start(connections)
        failure: BaseException | None = None
        try:
            with NetworkMonitor(self._link.moved), contextlib.suppress(Stopped):
                for batch in batches(files):
                    self._announce(batch)
                self._settle_leased()
                self._pipeline.drain()
        except KleinkramError as error:
            failure = error
        finally:
            self._pipeline.close()
            self._journals.close()
        failure = failure or self._stop.failure
        if failure is not None:
            self._link.explain(failure, self._server)
            raise failure
        return self._link.report()

    def _wait_for_server(self, seconds: float) -> None:
        self._link.waits_for_server(self._server)
        self._stop.wait(seconds)

    def _announce(self, batch: Sequence[LocalFile]) -> None:
        asking = [candidate for file in batch if (candidate := self._opened(file)) is not None]
        try:
            while asking:
                self._stop.check()
                try:
                    decisions = self._begin(asking)
                except QuotaExceeded as error:
                    asking = [candidate for candidate in asking if self._refused(candidate, error)]
                    continue
                answered = [*zip(asking, decisions, strict=True)]
                # All written down before the first is sent: a kill from here on leaves none that cannot be resumed.
                for candidate, decision in answered:
                    if isinstance(decision, Send):
                        self._write_down(candidate, decision.upload)
                asking = [candidate for candidate, decision in answered if self._asks_again(candidate, decision)]
        except BaseException:
            self._stop.now()
            for candidate in asking:
                candidate.close()
            raise

    def _begin(self, asking: Sequence[PendingFile]) -> Sequence[UploadDecision]:
        return self._uploads.begin(self._mission_id, [candidate.announcement() for candidate in asking]).items

    def _opened(self, file: LocalFile) -> PendingFile | None:
        """Open a file and its journal, and hash it when it is small."""
        journal: Journal | None = None
        source: OpenFile | None = None
        try:
            journal = self._journals.open(self._server, self._mission_id, file)
            source = OpenFile(file)
            candidate = PendingFile(source, journal)
            self._drop_other_size(candidate)
            if file.size_bytes <= MIN_PART_BYTES:
                candidate.hash_whole(self._stop.check)
                source.check_unchanged()
        except (FileChanged, FileUnreadable, UploadElsewhere) as error:
            for opened in (journal, source):
                if opened is not None:
                    opened.close()
            self._end_refused(file, error)
            return None
        return candidate

    def _drop_other_size(self, candidate: PendingFile) -> None:
        remembered = candidate.journal.remembered
        if remembered is not None and remembered.size_bytes != candidate.source.file.size_bytes:
            with contextlib.suppress(KleinkramError):  # it expires by itself where this cannot be notify
                self._uploads.abort(remembered.upload_id)
            candidate.journal.remembered = None

    def _asks_again(self, candidate: PendingFile, decision: UploadDecision) -> bool:
        """Act on the server's decision; return True when it wants to be asked again, with what it lacked."""
        file = candidate.source.file
        if isinstance(decision, HashFirst):
            return self._hash_first(candidate)
        if isinstance(decision, UploadRefused):
            return self._refused(candidate, from_problem(decision.problem))
        if isinstance(decision, Present | Linked):
            candidate.journal.forget()
            candidate.close()
            self._watcher.skipped(file.path, file.size_bytes, file.size_bytes)
            outcome = Outcome(decision.decision)
            existing = decision.file
            file_id, sha256 = (existing.id, existing.sha256) if existing else (None, _known_hash(candidate))
            result = TransferResult(file.path, file.source, file.size_bytes, outcome, 0, file_id, sha256)
            self._ended(result)
        else:
            self._pipeline.submit(FileUpload(candidate.source, candidate.journal, decision, candidate.whole))
        return False

    def _hash_first(self, candidate: PendingFile) -> bool:
        file = candidate.source.file
        if candidate.whole is not None:
            error = TransferFailed(path=file.path, reason="the server asks for a checksum that it was given")
            return self._refused(candidate, error)
        try:
            candidate.hash_whole(self._stop.check)
            candidate.source.check_unchanged()
        except (FileChanged, FileUnreadable) as unusable:
            return self._refused(candidate, unusable)
        return True

    def _refused(self, candidate: PendingFile, error: KleinkramError) -> bool:
        if isinstance(error, UploadGone) and candidate.journal.remembered is not None:
            candidate.journal.remembered = None
            return True
        file = candidate.source.file
        candidate.close()
        if isinstance(error, NameLeased):
            self._leased[file] = error
        else:
            self._end_refused(file, error)
        return False

    def _write_down(self, candidate: PendingFile, upload: UploadRead) -> None:
        file = candidate.source.file
        head = JournalHead(
            server=self._server,
            mission_id=self._mission_id,
            path=file.path,
            source=str(file.source.absolute()),
            size_bytes=file.size_bytes,
            upload_id=upload.id,
        )
        candidate.journal.begin(head, durable=file.size_bytes > upload.part_size_bytes)

    def _settle_leased(self) -> None:
        """Wait for names that another client holds; one that died holds them for a minute at most.

        A lease that is renewed meanwhile belongs to a client that lives: that file is refused at once.
        """
        gives_up_at = time.monotonic() + _LEASE_PATIENCE_S
        waiting, self._leased = self._leased, {}
        if waiting:
            self._watcher.notify(f"waiting for {_named(waiting)}: held by an upload that may have died")
        while waiting:
            if time.monotonic() > gives_up_at:
                self._end_all(waiting)
                return
            self._stop.wait(_LEASE_POLL_S)
            self._announce([*waiting])
            again, self._leased = self._leased, {}
            waiting, renewed = (
                {file: error for file, error in again.items() if _same_lease(error, waiting[file]) is same}
                for same in (True, False)
            )
            self._end_all(renewed)

    def _end_all(self, refused: Mapping[LocalFile, KleinkramError]) -> None:
        for file, error in refused.items():
            self._end_refused(file, error)

    def _end_refused(self, file: LocalFile, error: KleinkramError) -> None:
        self._ended(TransferResult(file.path, file.source, file.size_bytes, Outcome.refused, error=error))


def batches(files: Iterable[LocalFile]) -> Iterator[list[LocalFile]]:
    """Yield files to announce together, in order: a few large ones are not hashed ahead, many small ones are.

    The first batch is small, so that sending begins at once.
    """
    batch: list[LocalFile] = []
    size, at_most = 0, _FIRST_BATCH_FILES
    for file in files:
        if batch and (len(batch) == at_most or size + file.size_bytes > _BATCH_BYTES):
            yield batch
            batch, size, at_most = [], 0, _BATCH_FILES
        batch.append(file)
        size += file.size_bytes
    if batch:
        yield batch


def _known_hash(candidate: PendingFile) -> str | None:
    return candidate.whole.sha256.hexdigest() if candidate.whole else None


def _same_lease(now: NameLeased, then: NameLeased) -> bool:
    return now.lease_ends_at == then.lease_ends_at


def _named(files: Iterable[LocalFile]) -> str:
    paths = [file.path for file in files]
    return paths[0] if len(paths) == 1 else f"{paths[0]} and {len(paths) - 1} more"


CONNECTIONS = 4


def upload(
    client: Client,
    mission_id: uuid.UUID,
    plan: UploadPlan,
    *,
    connections: int = CONNECTIONS,
    bytes_per_s: float | None = None,
    watcher: Watcher | None = None,
) -> TransferReport:
    """Upload the planned files into a mission and return how each ended.

    One refused file does not stop the others. Memory does not grow with the size of files. A server or store that is
    away for up to some minutes is waited for.

    Raises:
        ServerUnreachable, StoreUnreachable: one of them stayed away.
        KleinkramError: something else that concerns all files, such as a mission that was deleted.
    """
    check_limits(connections, bytes_per_s)
    watcher = watcher or SilentObserver()
    results: dict[str, TransferResult] = {}
    lock = threading.Lock()

    def ended(result: TransferResult) -> None:
        with lock:
            results[result.path] = result
        watcher.ended(result.path, result.outcome.value, str(result.error) if result.error else None)

    watcher.began(len(plan.files), plan.size_bytes)
    uploader = Uploader(
        client.uploads, client.endpoint.url, mission_id, pace=RateLimit(bytes_per_s), watcher=watcher, ended=ended
    )
    link = uploader.run(plan.files, connections)
    return TransferReport([results[file.path] for file in plan.files], plan.left_out, link)
