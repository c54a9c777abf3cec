"""The threads of an upload: the caller's hashes, one signs, some send, one finishes.

Each byte is read once for its checksums; senders send their part again, from the page cache, as the body of its PUT.
Memory is one slice per thread. The store refuses a part whose bytes changed in between: it checks each part against the
checksum that the server signed. At most `AHEAD_BYTES` are hashed and not yet sent.
"""

import contextlib
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

from kleinkram.client._http import Backoff
from kleinkram.client.errors import FileChanged, FileUnreadable, TransferFailed
from kleinkram.client.files import Uploads
from kleinkram.client.transfer.journal import Journal, JournalPart
from kleinkram.client.transfer.link import CongestionWindow, Lane, LinkMonitor
from kleinkram.client.transfer.local_file import FileHashes, FileSlice, OpenFile, new_checksum
from kleinkram.client.transfer.plan import LocalFile
from kleinkram.client.transfer.report import Outcome, TransferResult, Watcher
from kleinkram.client.transfer.store import PATIENCE_S, PutResult, StoreAnswer, StoreClient
from kleinkram.client.transfer.threads import Budget, RateLimit, Stop, WorkQueue
from kleinkram.contract.errors import KleinkramError, NotFound, UploadGone, UploadIncomplete
from kleinkram.contract.problems import from_problem
from kleinkram.contract.uploads import ChecksumKind, NotCompleted, PartToSign, SignedPart, UploadFinish, UploadRequired

AHEAD_BYTES = 128 * 1024 * 1024
_PART_COST = 512 * 1024  # what the smallest part counts, so that open files are bounded too
_FILES_UNDER_WAY = 256
_BATCH_SIZE = 100
_RENEW_S = 20.0
_SIGN_BATCH_DELAY_S = 0.02
_COMPLETE_BATCH_DELAY_S = 0.5
_REFUSALS = 4
_JOIN_S = 2.0

_OF_ONE_FILE = (FileChanged, FileUnreadable, TransferFailed, UploadGone, NotFound)


@dataclass(frozen=True)
class FilePart:
    """A part to send."""

    sending: "FileUpload"
    number: int
    offset: int
    size_bytes: int
    checksum: str
    cost: int

    def to_sign(self) -> PartToSign:
        """Return the request to sign it."""
        return PartToSign(upload_id=self.sending.upload.id, number=self.number, checksum=self.checksum)


class FileUpload:
    """One file's upload under way. Shared between threads; every change of the counts is under its lock.

    `whole` are the checksums of the file where it has been read already.
    """

    def __init__(self, source: OpenFile, journal: Journal, send: UploadRequired, whole: FileHashes | None) -> None:
        self.source = source
        self.journal = journal
        self.upload = send.upload
        self.signed = send.part
        self._is_hashed = whole is not None
        self.whole = whole or FileHashes()
        self.latest: PartToSign | None = None  # the part hashed last; signing it again renews the lease
        self.renewed_at = time.monotonic()
        self.sent_bytes = 0
        self.ended = False
        self._stored_parts = {part.number: part for part in send.upload.parts}
        self._left = 1  # the hashing itself; parts are added while it runs
        self._lock = threading.Lock()

    @property
    def file(self) -> LocalFile:
        """The file as it was planned."""
        return self.source.file

    def ranges(self) -> Iterator[tuple[int, int, int]]:
        """Yield (number, offset, size) of every part; an empty file has one empty part."""
        size, step = self.file.size_bytes, self.upload.part_size_bytes
        for number, offset in enumerate(range(0, max(size, 1), step), start=1):
            yield number, offset, min(step, size - offset)

    def hash_part(self, number: int, offset: int, size_bytes: int) -> str:
        """Read a part, adding it to the whole file's checksums, and return its own checksum."""
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
        digest = checksum.hexdigest()
        self.latest = PartToSign(upload_id=self.upload.id, number=number, checksum=digest)
        return digest

    def is_stored(self, number: int, size_bytes: int, checksum: str) -> bool:
        """Say whether the store holds these bytes: the journal's checksum and the store's ETag must both agree."""
        stored = self._stored_parts.get(number)
        remembered = self.journal.remembered
        written = remembered.parts.get(number) if remembered else None
        if stored is None or written is None:
            return False
        is_same_etag = stored.etag.strip('"') == written.etag.strip('"')
        return is_same_etag and stored.size_bytes == size_bytes and written.checksum == checksum

    def add_part(self) -> None:
        """Count one more part to send."""
        with self._lock:
            self._left += 1

    def part_done(self) -> bool:
        """Count one part (or the hashing) as done; return True for the last of all."""
        with self._lock:
            self._left -= 1
            return self._left == 0

    def record(self, part: FilePart, etag: str) -> None:
        """Record a part that the store has taken."""
        with self._lock:
            if not self.ended:
                self.journal.record(JournalPart(number=part.number, checksum=part.checksum, etag=etag))
            self.sent_bytes += part.size_bytes

    def end(self) -> bool:
        """End this upload; return False when it had ended already."""
        with self._lock:
            first, self.ended = not self.ended, True
        return first

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


class UploadPipeline:
    """Takes uploads that the server has agreed to, sends their parts and finishes them.

    `ended` is called once per file, from any thread. A failure of one file ends that file; any other stops everything.
    """

    def __init__(
        self,
        uploads: Uploads,
        stop: Stop,
        *,
        pace: RateLimit,
        link: LinkMonitor,
        watcher: Watcher,
        ended: Callable[[TransferResult], None],
    ) -> None:
        self._uploads = uploads
        self._stop = stop
        self._pace = pace
        self._watcher = watcher
        self._link = link
        self._ended = ended
        self._ahead = Budget(stop, AHEAD_BYTES)
        self._under_way = Budget(stop, _FILES_UNDER_WAY)
        self._to_sign: WorkQueue[FilePart] = WorkQueue(stop)
        self._to_send: WorkQueue[tuple[FilePart, SignedPart]] = WorkQueue(stop)
        self._to_finish: WorkQueue[FileUpload] = WorkQueue(stop)
        self._open: dict[uuid.UUID, FileUpload] = {}
        self._leases: dict[uuid.UUID, FileUpload] = {}
        self._threads: list[threading.Thread] = []

    def start(self, connections: int) -> None:
        """Start the threads, `connections` of which send."""
        self._store = StoreClient(connections)
        self._lane = Lane(self._stop, CongestionWindow(connections))
        loops = [self._sign_loop, self._finish_loop, *[self._send_loop] * connections]
        self._threads = [self._stop.start(loop) for loop in loops]

    def submit(self, sending: FileUpload) -> None:
        """Hash an upload's parts and queue those that the store lacks; waits while enough is under way."""
        self._under_way.acquire(1)
        self._open[sending.upload.id] = sending
        self._leases[sending.upload.id] = sending
        try:
            for number, offset, size_bytes in sending.ranges():
                if sending.ended:
                    break
                self._stop.check()
                checksum = sending.hash_part(number, offset, size_bytes)
                if sending.is_stored(number, size_bytes, checksum):
                    self._watcher.skipped(sending.file.path, size_bytes, sending.file.size_bytes)
                    continue
                cost = max(size_bytes, _PART_COST)
                self._ahead.acquire(cost)
                sending.add_part()
                part = FilePart(sending, number, offset, size_bytes, checksum, cost)
                if sending.signed is None:
                    self._to_sign.put(part)
                else:  # the server has signed it for what was announced, which is what was hashed
                    self._to_send.put((part, sending.signed))
        except (FileChanged, FileUnreadable) as error:
            self._fail(sending, error)
        self._count_done(sending)

    def drain(self) -> None:
        """Wait until every submitted upload has ended."""
        self._under_way.wait_until_free()

    def close(self) -> None:
        """Stop the threads and close what is open; journals stay for the next run."""
        self._stop.now()
        gives_up_at = time.monotonic() + _JOIN_S  # for all together: on a dead link each would take it whole
        for thread in self._threads:
            thread.join(max(0.0, gives_up_at - time.monotonic()))
        for sending in self._open.values():
            sending.close()
        self._store.close()

    # -- signing ------------------------------------------------------------------------------------------------------

    def _sign_loop(self) -> None:
        while True:
            parts = self._to_sign.take(_BATCH_SIZE, _RENEW_S)
            if 0 < len(parts) < _BATCH_SIZE:  # more come within moments: one request for all of them
                self._stop.wait(_SIGN_BATCH_DELAY_S)
                parts += self._to_sign.take(_BATCH_SIZE - len(parts), timeout_s=0)
            for part in parts:
                if part.sending.ended:
                    self._part_over(part)
            self._sign([part for part in parts if not part.sending.ended])
            due = time.monotonic() - _RENEW_S
            for sending in [*self._leases.values()]:
                if sending.renewed_at < due and sending.latest is not None and not sending.ended:
                    sending.renewed_at = time.monotonic()
                    try:
                        self._uploads.sign([sending.latest])
                    except (UploadGone, NotFound) as error:
                        self._fail(sending, error)

    def _sign(self, parts: Sequence[FilePart]) -> None:
        if not parts:
            return
        try:
            signed = self._uploads.sign([part.to_sign() for part in parts])
        except (UploadGone, NotFound) as error:
            uploads = {part.sending.upload.id: part.sending for part in parts}
            if len(uploads) > 1:  # one of them has ended; the others go on
                for sending in uploads.values():
                    self._sign([part for part in parts if part.sending is sending])
                return
            for part in parts:
                self._fail(part.sending, error)
                self._part_over(part)
            return
        for part, one in zip(parts, signed.items, strict=True):
            part.sending.renewed_at = time.monotonic()
            self._to_send.put((part, one))

    # -- sending ------------------------------------------------------------------------------------------------------

    def _send_loop(self) -> None:
        while True:
            for part, signed in self._to_send.take(1):
                try:
                    if not part.sending.ended:
                        with self._lane.place() as place:
                            self._send(part, signed, place)
                except _OF_ONE_FILE as error:
                    self._fail(part.sending, error)
                self._part_over(part)

    def _send(self, part: FilePart, signed: SignedPart, place: int) -> None:
        backoff: Backoff | None = None  # begins at the first failure: a part may be on its way for long
        began_at = time.monotonic()
        shown = [0]
        refusals = 0
        while True:
            with self._lane.turn(place, part.size_bytes) as waited_s:
                if backoff is not None:
                    backoff.excuse(waited_s)
                if signed.expires_at <= self._uploads.now():  # spares sending it in vain
                    signed = self._uploads.sign([part.to_sign()]).items[0]
                result = self._put(part, signed, shown)
            if result.answer is StoreAnswer.taken:
                part.sending.record(part, result.etag)
                return
            if result.answer is StoreAnswer.gone:
                raise UploadGone(upload_id=str(part.sending.upload.id))
            if result.answer is StoreAnswer.try_again:
                if backoff is None or self._lane.arrived_at > began_at:  # other parts arrive: the link works
                    backoff, began_at = Backoff(PATIENCE_S, self._stop.wait), time.monotonic()
                self._link.lost(signed.url, backoff, result.error, result.why, result.sent_bytes)
                if result.error is None:
                    self._lane.step_out(place)
                if not self._link.pause(backoff, self._stop):
                    raise self._link.give_up(signed.url, part.sending.file.path, result)
                if result.error is not None:
                    continue  # the signature is still good
            else:
                part.sending.source.check_unchanged()
                refusals += 1
                if refusals >= _REFUSALS:
                    raise TransferFailed(path=part.sending.file.path, reason=result.reason)
            signed = self._uploads.sign([part.to_sign()]).items[0]

    def _put(self, part: FilePart, signed: SignedPart, shown: list[int]) -> PutResult:
        """PUT a part. Bytes that were `shown` at an earlier try are not shown again: no bar goes back."""
        sent = [0]

        def body() -> Iterator[FileSlice]:
            for piece in part.sending.source.stretches(part.offset, part.size_bytes):
                self._stop.check()
                self._pace.spend(piece.length, self._stop.wait)
                yield piece
                sent[0] += piece.length
                if sent[0] > shown[0]:
                    self._watcher.moved(part.sending.file.path, sent[0] - shown[0], part.sending.file.size_bytes)
                    shown[0] = sent[0]

        began_at = time.monotonic()
        result = self._store.put(signed.url, signed.headers, part.size_bytes, body())
        took_s = time.monotonic() - began_at
        if result.answer is StoreAnswer.taken:
            self._lane.arrived(part.size_bytes, took_s)
            self._link.arrived(took_s)
        elif result.answer is StoreAnswer.try_again:
            self._lane.lost()
        return replace(result, sent_bytes=sent[0])

    # -- finishing ----------------------------------------------------------------------------------------------------

    def _finish_loop(self) -> None:
        while True:
            sent = self._to_finish.take(_BATCH_SIZE)
            gathers_until = time.monotonic() + _COMPLETE_BATCH_DELAY_S
            # While others are on their way, wait a little for a good number of them.
            while (lacking := min(_BATCH_SIZE, self._under_way.used()) - len(sent)) > 0:
                left_s = gathers_until - time.monotonic()
                if left_s <= 0:
                    break
                sent += self._to_finish.take(_BATCH_SIZE - len(sent), left_s, at_least=lacking)
            if ready := [sending for sending in sent if self._is_unchanged(sending)]:
                self._finish(ready)

    def _is_unchanged(self, sending: FileUpload) -> bool:
        try:
            sending.source.check_unchanged()
        except FileChanged as error:
            self._fail(sending, error)
            self._release(sending)
            return False
        return True

    def _finish(self, ready: Sequence[FileUpload]) -> None:
        requests = []
        for sending in ready:
            sha256, crc64nvme = sending.whole.sha256.hexdigest(), sending.whole.crc64nvme.hexdigest()
            requests.append(UploadFinish(upload_id=sending.upload.id, sha256=sha256, crc64nvme=crc64nvme))
        outcomes = self._uploads.complete(requests).items
        for sending, request, outcome in zip(ready, requests, outcomes, strict=True):
            if isinstance(outcome, NotCompleted):
                self._fail(sending, from_problem(outcome.problem))
            elif sending.end():
                sending.journal.forget()
                file_id = outcome.file.id if outcome.file else None
                self._ended(sending.result(Outcome.uploaded, file_id=file_id, sha256=request.sha256))
            self._release(sending)

    # -- ends ---------------------------------------------------------------------------------------------------------

    def _fail(self, sending: FileUpload, error: KleinkramError) -> None:
        """End one file's upload; the others go on. What can be resumed keeps its journal."""
        self._stop.check()
        if not sending.end():
            return
        if isinstance(error, FileChanged | UploadGone):
            # Frees its name at once; without this the upload expires.
            with contextlib.suppress(KleinkramError):
                self._uploads.abort(sending.upload.id)
        if not isinstance(error, TransferFailed | UploadIncomplete | FileUnreadable):
            sending.journal.forget()
        self._ended(sending.result(Outcome.refused, error=error))

    def _part_over(self, part: FilePart) -> None:
        self._ahead.release(part.cost)
        self._count_done(part.sending)

    def _count_done(self, sending: FileUpload) -> None:
        if not sending.part_done():
            return
        if sending.ended:
            self._release(sending)
        else:
            self._leases.pop(sending.upload.id, None)
            self._to_finish.put(sending)

    def _release(self, sending: FileUpload) -> None:
        """Close what a file's upload held open. Only once no thread reads it any more."""
        self._leases.pop(sending.upload.id, None)
        self._open.pop(sending.upload.id, None)
        sending.close()
        self._under_way.release(1)
