"""One file's upload under way: which parts are left, what has been hashed, and how it ended.

Shared by the hashing thread, the senders and the finisher; every change of the counts is under its lock.
"""

import threading
import time
import uuid
from collections.abc import Iterator
from dataclasses import dataclass

from kleinkram.client.transfer.journal import Journal, JournalPart
from kleinkram.client.transfer.local_file import FileHashes, OpenFile, new_checksum
from kleinkram.client.transfer.plan import LocalFile
from kleinkram.client.transfer.report import Outcome, TransferResult
from kleinkram.contract.errors import KleinkramError
from kleinkram.contract.uploads import ChecksumKind, PartToSign, Send, StoredPart, UploadFinish


@dataclass(frozen=True)
class FilePart:
    """A part that is to be sent."""

    sending: "FileUpload"
    number: int
    offset: int
    size_bytes: int
    checksum: str
    cost: int

    def to_sign(self) -> PartToSign:
        """Return what the server signs."""
        return PartToSign(upload_id=self.sending.upload.id, number=self.number, checksum=self.checksum)


class FileUpload:
    """An upload of one file; `whole` are its checksums where it has been read already."""

    def __init__(self, source: OpenFile, journal: Journal, send: Send, whole: FileHashes | None) -> None:
        self.source = source
        self.journal = journal
        self.upload = send.upload
        self.signed = send.part
        self._is_hashed = whole is not None
        self.whole = whole or FileHashes()
        self._latest: tuple[int, str] | None = None
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
        """Yield (number, offset, size) of every part; a file of no bytes has one part of none."""
        size, step = self.file.size_bytes, self.upload.part_size_bytes
        for number, offset in enumerate(range(0, max(size, 1), step), start=1):
            yield number, offset, min(step, size - offset)

    def hash_part(self, number: int, offset: int, size_bytes: int) -> str:
        """Read a part, adding it to the whole file's checksums, and return its own checksum."""
        checksum = self._known_checksum(size_bytes) or self._read_checksum(offset, size_bytes)
        self._latest = number, checksum
        return checksum

    def latest(self) -> PartToSign | None:
        """Return what the server signs of the part hashed last; asking for it renews the lease."""
        if self._latest is None:
            return None
        number, checksum = self._latest
        return PartToSign(upload_id=self.upload.id, number=number, checksum=checksum)

    def _known_checksum(self, size_bytes: int) -> str | None:
        if not self._is_hashed or size_bytes != self.file.size_bytes:
            return None
        whole = {ChecksumKind.crc64nvme: self.whole.crc64nvme, ChecksumKind.sha256: self.whole.sha256}
        checksum = whole.get(self.upload.checksum)
        return checksum.hexdigest() if checksum else None

    def _read_checksum(self, offset: int, size_bytes: int) -> str:
        part = new_checksum(self.upload.checksum)
        for view in self.source.slices(offset, size_bytes):
            if not self._is_hashed:
                self.whole.update(view)
            part.update(view)
        return part.hexdigest()

    def is_stored(self, number: int, size_bytes: int, checksum: str) -> bool:
        """Say whether the store holds these very bytes: our journal's checksum and the store's etag both agree."""
        held = self._stored_parts.get(number)
        remembered = self.journal.remembered
        written = remembered.parts.get(number) if remembered else None
        return held is not None and written is not None and _agree(held, written, size_bytes, checksum)

    def add_part(self) -> None:
        """Count one more part to be sent."""
        with self._lock:
            self._left += 1

    def part_done(self) -> bool:
        """Count one part (or the hashing) as done; return True for the last of all."""
        with self._lock:
            self._left -= 1
            return self._left == 0

    def record(self, part: FilePart, etag: str) -> None:
        """Write down that the store has taken a part."""
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
        """Return this file's end."""
        file = self.file
        return TransferResult(file.path, file.source, file.size_bytes, outcome, self.sent_bytes, file_id, sha256, error)

    def to_finish(self) -> UploadFinish:
        """Return what completes the upload."""
        return UploadFinish(upload_id=self.upload.id, sha256=self.sha256(), crc64nvme=self.whole.crc64nvme.hexdigest())

    def sha256(self) -> str:
        """Return the whole file's checksum, once all of it is hashed."""
        return self.whole.sha256.hexdigest()


def _agree(held: StoredPart, written: JournalPart, size_bytes: int, checksum: str) -> bool:
    same_etag = held.etag.strip('"') == written.etag.strip('"')
    return same_etag and held.size_bytes == size_bytes and written.checksum == checksum
