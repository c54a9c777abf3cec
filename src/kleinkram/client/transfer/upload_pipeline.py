"""The threads of an upload: the caller's thread hashes, one signs parts, some send them, one finishes files.

Each byte is read once for its checksums, and sent from the page cache as the body of a PUT. Memory: one slice per
thread. The store refuses a part whose bytes changed after they were hashed, because the server signed its checksum.
"""

import contextlib
import itertools
import time
import uuid
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from urllib.parse import urlsplit

from kleinkram import traces
from kleinkram.client.errors import FileChanged, FileUnreadable, TransferFailed
from kleinkram.client.files import Uploads
from kleinkram.client.transfer import store
from kleinkram.client.transfer.journal import Journal, JournalPart
from kleinkram.client.transfer.plan import FileHashes, FileSlice, LocalFile, OpenFile, new_checksum
from kleinkram.client.transfer.pool import FileTransfer, Part, TransferPool, WorkQueue
from kleinkram.client.transfer.report import Outcome, TransferResult, Watcher
from kleinkram.client.transfer.store import PutResult, StoreAnswer
from kleinkram.contract.errors import KleinkramError, NotFound, UploadGone, UploadIncomplete
from kleinkram.contract.problems import from_problem
from kleinkram.contract.uploads import ChecksumKind, NotCompleted, PartToSign, SignedPart, UploadFinish, UploadRequired

# At most so many bytes are hashed and not yet sent.
AHEAD_BYTES = 128 * 1024 * 1024
_MIN_COST_BYTES = 512 * 1024  # of a small part, so that open files are bounded too
_MAX_FILES = 256
_BATCH_SIZE = 100
_RENEW_S = 20.0
_SIGN_BATCH_DELAY_S = 0.02
_COMPLETE_BATCH_DELAY_S = 0.5
# Spans of an upload for the first parts that are sent: a trace with many thousands is of no use to anybody.
_MAX_PUT_SPANS = 100


class FileUpload(FileTransfer):
    """One file's upload. `whole`: the checksums of the file if it has been read already."""

    def __init__(self, source: OpenFile, journal: Journal, send: UploadRequired, whole: FileHashes | None) -> None:
        super().__init__(source.file.path)
        self.source = source
        self.journal = journal
        self.upload = send.upload
        self.signed = send.part
        self._is_hashed = whole is not None
        self.whole = whole or FileHashes()
        self.latest: PartToSign | None = None  # the part hashed last; signing it again renews the lease
        self.renewed_at = time.monotonic()
        self.sent_bytes = 0
        self._stored_parts = {part.number: part for part in send.upload.parts}

    @property
    def file(self) -> LocalFile:
        """The file as it was planned."""
        return self.source.file

    def ranges(self) -> Iterator[tuple[int, int, int]]:
        """Yield (number, offset, size) of every part; an empty file has one empty part."""
        size, step = self.file.size_bytes, self.upload.part_size_bytes
        for number, offset in enumerate(range(0, max(size, 1), step), start=1):
            yield number, offset, min(step, size - offset)

    def hash_part(self, number: int, offset: int, size_bytes: int) -> PartToSign:
        """Read a part, add it to the file's checksums, and return it with its own checksum."""
        checksum = None
        if self._is_hashed and size_bytes == self.file.size_bytes:
            known = {ChecksumKind.crc64nvme: self.whole.crc64nvme, ChecksumKind.sha256: self.whole.sha256}
            checksum = known.get(self.upload.checksum)
        if checksum is None:
            checksum = new_checksum(self.upload.checksum)
            for view in self.source.slices(offset, size_bytes):
                if not self._is_hashed:
                    self.whole.update(view)
                checksum.update(view)
        self.latest = PartToSign(upload_id=self.upload.id, number=number, checksum=checksum.hexdigest())
        return self.latest

    def is_stored(self, part: PartToSign, size_bytes: int) -> bool:
        """Return whether the store has a part: the journal's checksum and the store's ETag must both agree."""
        stored = self._stored_parts.get(part.number)
        remembered = self.journal.remembered
        written = remembered.parts.get(part.number) if remembered else None
        if stored is None or written is None:
            return False
        is_same_etag = stored.etag.strip('"') == written.etag.strip('"')
        return is_same_etag and stored.size_bytes == size_bytes and written.checksum == part.checksum

    def record(self, part: JournalPart, size_bytes: int) -> None:
        """Record a part that the store has taken."""
        with self._lock:
            if not self.ended:
                self.journal.record(part)
            self.sent_bytes += size_bytes

    def result(
        self,
        outcome: Outcome,
        *,
        file_id: uuid.UUID | None = None,
        sha256: str | None = None,
        error: KleinkramError | None = None,
    ) -> TransferResult:
        """Return the result for this file."""
        file = self.file
        return TransferResult(file.path, file.source, file.size_bytes, outcome, self.sent_bytes, file_id, sha256, error)

    def close(self) -> None:
        """Close the file and its journal."""
        self.source.close()
        self.journal.close()


@dataclass(kw_only=True)
class FilePart(Part):
    """A part to send. `shown_bytes` have been reported to the watcher."""

    file: FileUpload
    to_sign: PartToSign
    signed: SignedPart | None
    shown_bytes: int = 0
    etag: str = ""


class UploadPipeline(TransferPool[FilePart]):
    """Sends the files that the server has agreed to, and finishes them."""

    def __init__(
        self, uploads: Uploads, server_url: str, *, connections: int, bytes_per_s: float | None, watcher: Watcher
    ) -> None:
        super().__init__(
            server_url,
            connections=connections,
            spare_threads=0,
            max_files=_MAX_FILES,
            max_queued=AHEAD_BYTES,
            bytes_per_s=bytes_per_s,
            watcher=watcher,
        )
        self.uploads = uploads.with_retry(store.TRANSFER_RETRY_S, self.wait_for_server)
        self._to_sign: WorkQueue[FilePart] = WorkQueue(self.stop)
        self._to_finish: WorkQueue[FileUpload] = WorkQueue(self.stop)
        self._leases: dict[uuid.UUID, FileUpload] = {}
        self._put_count = itertools.count()
        self._loops += [self._sign_parts, self._finish_files]

    def submit(self, file: FileUpload) -> None:
        """Hash a file's parts and queue those that the store lacks; waits while enough is queued."""
        self._open_file(file)
        self._leases[file.upload.id] = file
        try:
            for number, offset, size_bytes in file.ranges():
                if file.ended:
                    break
                self.stop.check()
                to_sign = file.hash_part(number, offset, size_bytes)
                if file.is_stored(to_sign, size_bytes):
                    self._watcher.skipped(file.path, size_bytes, file.file.size_bytes)
                    continue
                cost = max(size_bytes, _MIN_COST_BYTES)
                part = FilePart(
                    file=file,
                    number=number,
                    offset=offset,
                    size_bytes=size_bytes,
                    cost=cost,
                    to_sign=to_sign,
                    signed=file.signed,
                )
                self._add_part(part)
                # The server signs the only part of a file for the checksum that was announced.
                (self._parts if part.signed else self._to_sign).put(part)
        except (FileChanged, FileUnreadable) as error:
            self._fail(file, error)
        self._count_done(file)

    # -- signing ------------------------------------------------------------------------------------------------------

    def _sign_parts(self) -> None:
        while True:
            parts = self._to_sign.take(_BATCH_SIZE, _RENEW_S)
            if 0 < len(parts) < _BATCH_SIZE:  # more come within moments: one request for all of them
                self.stop.wait(_SIGN_BATCH_DELAY_S)
                parts += self._to_sign.take(_BATCH_SIZE - len(parts), timeout_s=0)
            for part in parts:
                if part.file.ended:
                    self._part_done(part)
            self._sign([part for part in parts if not part.file.ended])
            due = time.monotonic() - _RENEW_S
            for file in [*self._leases.values()]:
                if file.renewed_at < due and file.latest is not None and not file.ended:
                    file.renewed_at = time.monotonic()
                    try:
                        self.uploads.sign([file.latest])
                    except (UploadGone, NotFound) as error:
                        self._fail(file, error)

    def _sign(self, parts: Sequence[FilePart]) -> None:
        if not parts:
            return
        try:
            signed = self.uploads.sign([part.to_sign for part in parts]).items
        except (UploadGone, NotFound) as error:
            files = {part.file.upload.id: part.file for part in parts}
            if len(files) > 1:  # one of them has ended; the others go on
                for file in files.values():
                    self._sign([part for part in parts if part.file is file])
                return
            for part in parts:
                self._fail(part.file, error)
                self._part_done(part)
            return
        for part, one in zip(parts, signed, strict=True):
            part.signed = one
            part.file.renewed_at = time.monotonic()
            self._parts.put(part)

    def _sign_again(self, part: FilePart) -> None:
        [part.signed] = self.uploads.sign([part.to_sign]).items

    # -- sending ------------------------------------------------------------------------------------------------------

    def _request(self, part: FilePart) -> PutResult | None:
        signed = part.signed
        if signed is None or signed.expires_at <= self.uploads.now():  # the store would refuse the bytes
            [signed] = self.uploads.sign([part.to_sign]).items
            part.signed = signed
        part.file.url = signed.url
        path, sent_bytes = part.file.path, 0

        def body() -> Iterator[FileSlice]:
            nonlocal sent_bytes
            for piece in part.file.source.file_slices(part.offset, part.size_bytes):
                self.stop.check()
                self._rate_limit.spend(piece.length, self.stop.wait)
                yield piece
                sent_bytes += piece.length
                if sent_bytes > part.shown_bytes:  # a progress bar never goes back
                    self._watcher.moved(path, sent_bytes - part.shown_bytes, part.file.file.size_bytes)
                    part.shown_bytes = sent_bytes

        result = self._put(part, signed, body())
        if result.answer is StoreAnswer.taken:
            part.etag = result.etag
            return None
        if result.answer is StoreAnswer.gone:
            raise UploadGone(upload_id=str(part.file.upload.id))
        result.sent_bytes = sent_bytes
        return result

    def _put(self, part: FilePart, signed: SignedPart, body: Iterator[FileSlice]) -> PutResult:
        if next(self._put_count) >= _MAX_PUT_SPANS or not traces.is_active():
            return self._store.put(signed.url, signed.headers, part.size_bytes, body)
        attributes: traces.Attributes = {
            "http.request.method": "PUT",
            "http.request.body.size": part.size_bytes,
            "server.address": urlsplit(signed.url).hostname or "",
            "kleinkram.upload_id": str(part.file.upload.id),
            "kleinkram.part": part.number,
        }
        with traces.leaf_span("PUT", attributes) as span:
            result = self._store.put(signed.url, signed.headers, part.size_bytes, body)
            if result.answer is not StoreAnswer.taken:
                span.fail(result.answer.name)
            return result

    def _check_source(self, part: FilePart) -> None:
        part.file.source.check_unchanged()

    def _moved(self, part: FilePart) -> None:
        entry = JournalPart(number=part.number, checksum=part.to_sign.checksum, etag=part.etag)
        part.file.record(entry, part.size_bytes)

    def _part_failed(self, part: FilePart, error: KleinkramError) -> None:
        self._fail(part.file, error)

    def _part_done(self, part: FilePart) -> None:
        self._queued.release(part.cost)
        self._count_done(part.file)

    # -- finishing ----------------------------------------------------------------------------------------------------

    def _count_done(self, file: FileUpload) -> None:
        if not file.part_done():
            return
        self._leases.pop(file.upload.id, None)
        if file.ended:
            self._close_file(file)
        else:
            self._to_finish.put(file)

    def _finish_files(self) -> None:
        while True:
            sent = self._to_finish.take(_BATCH_SIZE)
            deadline = time.monotonic() + _COMPLETE_BATCH_DELAY_S
            # While other files are under way, wait a little to finish several with one request.
            while (lacking := min(_BATCH_SIZE, self._files.used()) - len(sent)) > 0:
                left_s = deadline - time.monotonic()
                if left_s <= 0:
                    break
                sent += self._to_finish.take(_BATCH_SIZE - len(sent), left_s, at_least=lacking)
            if ready := [file for file in sent if self._is_unchanged(file)]:
                self._finish(ready)

    def _is_unchanged(self, file: FileUpload) -> bool:
        try:
            file.source.check_unchanged()
        except FileChanged as error:
            self._fail(file, error)
            self._close_file(file)
            return False
        return True

    def _finish(self, ready: Sequence[FileUpload]) -> None:
        requests = []
        for file in ready:
            sha256, crc64nvme = file.whole.sha256.hexdigest(), file.whole.crc64nvme.hexdigest()
            requests.append(UploadFinish(upload_id=file.upload.id, sha256=sha256, crc64nvme=crc64nvme))
        outcomes = self.uploads.complete(requests).items
        for file, request, outcome in zip(ready, requests, outcomes, strict=True):
            if isinstance(outcome, NotCompleted):
                self._fail(file, from_problem(outcome.problem))
            elif file.end():
                file.journal.forget()
                file_id = outcome.file.id if outcome.file else None
                self.add_result(file.result(Outcome.uploaded, file_id=file_id, sha256=request.sha256))
            self._close_file(file)

    def _fail(self, file: FileUpload, error: KleinkramError) -> None:
        """End one file's upload; the others go on. What can be resumed keeps its journal."""
        self.stop.check()
        if not file.end():
            return
        if isinstance(error, FileChanged | UploadGone):
            with contextlib.suppress(KleinkramError):  # frees the name at once; otherwise the upload expires
                self.uploads.abort(file.upload.id)
        if not isinstance(error, TransferFailed | UploadIncomplete | FileUnreadable):
            file.journal.forget()
        self.add_result(file.result(Outcome.refused, error=error))
