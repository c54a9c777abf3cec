"""Local files: reading in slices, and checksums. Memory: one slice per thread."""

import hashlib
import os
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, Protocol

from kleinkram.client.errors import FileChanged, FileUnreadable
from kleinkram.client.transfer.plan import FileIdentity, LocalFile, identity_of
from kleinkram.contract.uploads import ChecksumKind, crc64nvme

SLICE_BYTES = 1024 * 1024
_slices = threading.local()


class Checksum(Protocol):
    """A checksum that bytes are added to."""

    def update(self, data: memoryview, /) -> None:
        """Add bytes."""

    def hexdigest(self) -> str:
        """Return the checksum, lower-case hex."""
        ...


@dataclass
class Crc64Hash:
    """A CRC-64/NVME, the full-object checksum of the S3 API."""

    value: int = 0

    def update(self, data: memoryview) -> None:
        """Add bytes."""
        self.value = crc64nvme(data, self.value)

    def hexdigest(self) -> str:
        """Return 16 hex digits."""
        return f"{self.value:016x}"


@dataclass
class FileHashes:
    """Both checksums of a file, computed in one pass."""

    sha256: Checksum = field(default_factory=hashlib.sha256)
    crc64nvme: Checksum = field(default_factory=Crc64Hash)

    def update(self, data: memoryview) -> None:
        """Add bytes."""
        self.sha256.update(data)
        self.crc64nvme.update(data)


def new_checksum(kind: ChecksumKind) -> Checksum:
    """Return an empty checksum of the kind that the store verifies parts by."""
    if kind is ChecksumKind.crc64nvme:
        return Crc64Hash()
    if kind is ChecksumKind.sha256:
        return hashlib.sha256()
    return hashlib.md5(usedforsecurity=False)


def read_slice(handle: int, offset: int, length: int) -> memoryview:
    """Return up to `length` bytes at an offset; valid until this thread reads its next slice."""
    buffer: bytearray | None = getattr(_slices, "buffer", None)
    if buffer is None:
        buffer = _slices.buffer = bytearray(SLICE_BYTES)
    view = memoryview(buffer)[: min(length, SLICE_BYTES)]
    return view[: os.preadv(handle, [view], offset)]


class FileSlice(NamedTuple):
    """Bytes of an open file: `length` of them from `offset`."""

    path: Path
    handle: int
    offset: int
    length: int

    def from_byte(self, number: int) -> "FileSlice":
        """Return the rest of the slice from its byte `number`."""
        return self._replace(offset=self.offset + number, length=self.length - number)

    def read(self) -> Iterator[memoryview]:
        """Yield the bytes, in views that are valid until the next one; raise FileChanged if the file is shorter now."""
        offset, end = self.offset, self.offset + self.length
        while offset < end:
            try:
                view = read_slice(self.handle, offset, end - offset)
            except OSError as error:
                raise FileUnreadable(path=str(self.path), reason=error.strerror or str(error)) from None
            if not view:
                raise FileChanged(path=str(self.path), reason="it became shorter")
            yield view
            offset += len(view)


class OpenFile:
    """A planned file, open for reading from several threads."""

    def __init__(self, file: LocalFile) -> None:
        """Open the file; raise FileChanged if it is not the file that was planned."""
        self.file = file
        try:
            self._handle = os.open(file.source, os.O_RDONLY | os.O_CLOEXEC)
        except FileNotFoundError:
            raise FileChanged(path=str(file.source), reason="it is gone") from None
        except OSError as error:
            raise FileUnreadable(path=str(file.source), reason=error.strerror or str(error)) from None
        try:
            self._compare(identity_of(os.fstat(self._handle)))
        except FileChanged:
            self.close()
            raise

    def slices(self, offset: int, length: int) -> Iterator[memoryview]:
        """Yield `length` bytes from `offset`, as `FileSlice.read` does."""
        return FileSlice(self.file.source, self._handle, offset, length).read()

    def file_slices(self, offset: int, length: int) -> Iterator[FileSlice]:
        """Yield the same slices without reading them."""
        end = offset + length
        for start in range(offset, end, SLICE_BYTES):
            yield FileSlice(self.file.source, self._handle, start, min(SLICE_BYTES, end - start))

    def check_unchanged(self) -> None:
        """Raise FileChanged unless this is still the file that was planned, and still at its path."""
        self._compare(identity_of(os.fstat(self._handle)))
        try:
            self._compare(identity_of(self.file.source.stat()))
        except OSError:
            raise FileChanged(path=str(self.file.source), reason="it is gone") from None

    def close(self) -> None:
        """Close the file; a second time does nothing."""
        handle, self._handle = self._handle, -1
        if handle >= 0:
            os.close(handle)

    def _compare(self, now: FileIdentity) -> None:
        planned = self.file.identity
        if now == planned:
            return
        if now.size_bytes != planned.size_bytes:
            reason = f"it had {planned.size_bytes} bytes and has {now.size_bytes}"
        elif (now.inode, now.device) != (planned.inode, planned.device):
            reason = "another file has taken its place"
        else:
            reason = "it was written to"
        raise FileChanged(path=str(self.file.source), reason=reason)
