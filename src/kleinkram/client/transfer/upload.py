"""Uploads a plan: announces files to the server in batches and sends what it lacks.

The same command, run again after any interruption, sends only what is missing. A batch is announced just before it is
sent, so that no lease expires while other files are sent. `UploadPipeline` sends the bytes.
"""

import contextlib
import time
import uuid
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from kleinkram import traces
from kleinkram.client._client import Client
from kleinkram.client.errors import FileChanged, FileUnreadable, TransferFailed, UploadElsewhere
from kleinkram.client.files import Uploads
from kleinkram.client.transfer.journal import Journal, JournalHead, Journals
from kleinkram.client.transfer.plan import FileHashes, LocalFile, OpenFile, UploadPlan
from kleinkram.client.transfer.report import CONNECTIONS, LinkReport, Outcome, TransferReport, TransferResult, Watcher
from kleinkram.client.transfer.upload_pipeline import FileUpload, UploadPipeline
from kleinkram.contract.errors import KleinkramError, NameLeased, QuotaExceeded, UploadGone
from kleinkram.contract.problems import from_problem
from kleinkram.contract.uploads import (
    MIN_PART_BYTES,
    HashRequired,
    UploadDecision,
    UploadFile,
    UploadRead,
    UploadRefused,
    UploadRequired,
)

_FIRST_BATCH_FILES = 16
_BATCH_FILES = 100
_BATCH_BYTES = 128 * 1024 * 1024
_LEASE_TIMEOUT_S = 90.0
_LEASE_POLL_S = 2.0


def upload(
    client: Client,
    mission_id: uuid.UUID,
    plan: UploadPlan,
    *,
    connections: int = CONNECTIONS,
    bytes_per_s: float | None = None,
    watcher: Watcher | None = None,
) -> TransferReport:
    """Upload the planned files into a mission and return the result for each.

    One refused file does not stop the others. Memory does not grow with the size of files. Requests are retried for
    some minutes while the server or the store is unavailable.

    Raises:
        ServerUnreachable, StoreUnreachable: one of them stayed unavailable.
        KleinkramError: something else that concerns all files, such as a mission that was deleted.
    """
    watcher = watcher or Watcher()
    uploader = Uploader(
        client.uploads,
        client.endpoint.url,
        mission_id,
        connections=connections,
        bytes_per_s=bytes_per_s,
        watcher=watcher,
    )
    watcher.began(len(plan.files), plan.size_bytes)
    attributes: traces.Attributes = {
        "kleinkram.mission_id": str(mission_id),
        "kleinkram.files": len(plan.files),
        "kleinkram.bytes": plan.size_bytes,
    }
    with traces.span("upload", attributes):
        link = uploader.run(plan.files)
    by_path = {result.path: result for result in uploader.results}
    return TransferReport([by_path[file.path] for file in plan.files], plan.left_out, link)


@dataclass
class PendingFile:
    """A file about to be announced: open, its journal locked, its checksums where they are known."""

    source: OpenFile
    journal: Journal
    whole: FileHashes | None = None
    new_id: uuid.UUID = field(default_factory=uuid.uuid4)

    def announcement(self) -> UploadFile:
        """Return the request to upload it."""
        fields: dict[str, object] = {"path": self.source.file.path, "size_bytes": self.source.file.size_bytes}
        if self.whole is not None:
            fields |= {"sha256": self.whole.sha256.hexdigest(), "crc64nvme": self.whole.crc64nvme.hexdigest()}
        # The client chooses the id: if an answer is lost, its upload must not block the name.
        remembered = self.journal.remembered
        fields["upload_id"] = self.new_id if remembered is None else remembered.upload_id
        return UploadFile.model_validate(fields)

    def hash_whole(self, check: Callable[[], None]) -> None:
        """Read all of the file for its checksums; `check` may raise an error between two slices."""
        whole = FileHashes()
        for view in self.source.slices(0, self.source.file.size_bytes):
            check()
            whole.update(view)
        self.source.check_unchanged()
        self.whole = whole

    def close(self) -> None:
        """Close the file and its journal."""
        self.source.close()
        self.journal.close()


class Uploader:
    """One run of an upload into one destination: a mission, or a run whose artifacts these are.

    `results` has one result per file that has ended.

    `journals` is the folder of its journals; by default, in this user's state directory.
    """

    def __init__(
        self,
        uploads: Uploads,
        server: str,
        destination_id: uuid.UUID,
        *,
        connections: int,
        bytes_per_s: float | None,
        watcher: Watcher,
        journals: Path | None = None,
    ) -> None:
        self._server = server
        self._destination_id = destination_id
        self._journals = Journals(journals)
        self._watcher = watcher
        self._pipeline = UploadPipeline(
            uploads, server, connections=connections, bytes_per_s=bytes_per_s, watcher=watcher
        )
        self.results = self._pipeline.results
        self._uploads = self._pipeline.uploads
        self._stop = self._pipeline.stop
        self._leased: dict[LocalFile, NameLeased] = {}

    def end(self) -> None:
        """End it, from another thread: `run` returns soon, and unfinished files can be resumed."""
        self._stop.now()

    def run(self, files: Sequence[LocalFile]) -> LinkReport:
        """Upload the files; return when each has ended, with how the network was.

        Raises:
            KleinkramError: something that concerns all files; those that had not ended have not been uploaded.
        """

        def send_all() -> None:
            for batch in batches(files):
                self._announce(batch)
            self._retry_leased()

        try:
            return self._pipeline.run(send_all)
        finally:
            self._journals.close()

    def _announce(self, batch: Sequence[LocalFile]) -> None:
        pending = [candidate for file in batch if (candidate := self._open(file)) is not None]
        try:
            while pending:
                self._stop.check()
                try:
                    requests = [candidate.announcement() for candidate in pending]
                    decisions = self._uploads.begin(self._destination_id, requests).items
                except QuotaExceeded as error:
                    pending = [candidate for candidate in pending if self._refuse(candidate, error)]
                    continue
                answered = [*zip(pending, decisions, strict=True)]
                # All are recorded before the first is sent: a kill from here on leaves none that cannot be resumed.
                for candidate, decision in answered:
                    if isinstance(decision, UploadRequired):
                        self._record(candidate, decision.upload)
                pending = [candidate for candidate, decision in answered if self._must_ask_again(candidate, decision)]
        except BaseException:
            self._stop.now()
            for candidate in pending:
                candidate.close()
            raise

    def _open(self, file: LocalFile) -> PendingFile | None:
        """Open a file and its journal, and hash it when it is small."""
        with contextlib.ExitStack() as opened:
            try:
                journal = self._journals.open(self._server, self._destination_id, file)
                opened.callback(journal.close)
                source = OpenFile(file)
                opened.callback(source.close)
                candidate = PendingFile(source, journal)
                remembered = journal.remembered
                if remembered is not None and remembered.size_bytes != file.size_bytes:
                    with contextlib.suppress(KleinkramError):  # without this the upload expires
                        self._uploads.abort(remembered.upload_id)
                    journal.remembered = None
                if file.size_bytes <= MIN_PART_BYTES:
                    candidate.hash_whole(self._stop.check)
            except (FileChanged, FileUnreadable, UploadElsewhere) as error:
                opened.close()
                self._end_refused(file, error)
                return None
            opened.pop_all()
        return candidate

    def _must_ask_again(self, candidate: PendingFile, decision: UploadDecision) -> bool:
        """Act on the server's decision; return True for a file to announce again, with what the server lacked."""
        file = candidate.source.file
        if isinstance(decision, UploadRequired):
            self._pipeline.submit(FileUpload(candidate.source, candidate.journal, decision, candidate.whole))
            return False
        if isinstance(decision, UploadRefused):
            return self._refuse(candidate, from_problem(decision.problem))
        if isinstance(decision, HashRequired):
            if candidate.whole is not None:
                reason = "the server asks for a checksum that it has received"
                return self._refuse(candidate, TransferFailed(path=file.path, reason=reason))
            try:
                candidate.hash_whole(self._stop.check)
            except (FileChanged, FileUnreadable) as unusable:
                return self._refuse(candidate, unusable)
            return True
        candidate.journal.forget()
        candidate.close()
        self._watcher.skipped(file.path, file.size_bytes, file.size_bytes)
        existing = decision.file
        sha256 = candidate.whole.sha256.hexdigest() if candidate.whole else None
        file_id, sha256 = (existing.id, existing.sha256) if existing else (None, sha256)
        outcome = Outcome(decision.decision)
        self._pipeline.add_result(TransferResult(file.path, file.source, file.size_bytes, outcome, 0, file_id, sha256))
        return False

    def _refuse(self, candidate: PendingFile, error: KleinkramError) -> bool:
        """End a file; return True to announce it again, because its earlier upload is gone."""
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

    def _record(self, candidate: PendingFile, upload: UploadRead) -> None:
        file = candidate.source.file
        head = JournalHead(
            server=self._server,
            mission_id=self._destination_id,
            path=file.path,
            source=str(file.source.absolute()),
            size_bytes=file.size_bytes,
            upload_id=upload.id,
        )
        candidate.journal.begin(head, durable=file.size_bytes > upload.part_size_bytes)

    def _retry_leased(self) -> None:
        """Announce files again whose names other clients have leased: the lease of a dead client ends within a minute.

        A lease that is renewed belongs to a client that is alive: its file is refused at once.
        """
        gives_up_at = time.monotonic() + _LEASE_TIMEOUT_S
        waiting, self._leased = self._leased, {}
        if waiting:
            first, more = next(iter(waiting)).path, len(waiting) - 1
            named = f"{first} and {more} more" if more else first
            self._watcher.notify(f"waiting for {named}: held by an upload that may have died")
        while waiting and time.monotonic() <= gives_up_at:
            self._stop.wait(_LEASE_POLL_S)
            self._announce([*waiting])
            leased, self._leased = self._leased, {}
            for file, error in [*leased.items()]:
                if error.lease_ends_at != waiting[file].lease_ends_at:
                    self._end_refused(file, leased.pop(file))
            waiting = leased
        for file, error in waiting.items():
            self._end_refused(file, error)

    def _end_refused(self, file: LocalFile, error: KleinkramError) -> None:
        self._pipeline.add_result(TransferResult(file.path, file.source, file.size_bytes, Outcome.refused, error=error))


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
