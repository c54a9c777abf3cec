"""Local files: reading in slices, checksums, and verification against a mission. Memory: one slice per thread."""

import enum
import hashlib
import os
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, Protocol

from kleinkram.client.errors import FileChanged, FileUnreadable, TimedOut
from kleinkram.client.files import Files
from kleinkram.client.transfer.plan import FileIdentity, LocalFile, UploadPlan, identity_of
from kleinkram.contract.files import BlobState, FileFilter, FileRead
from kleinkram.contract.names import name_key
from kleinkram.contract.runs import ArtifactRead
from kleinkram.contract.uploads import ChecksumKind, crc64nvme

SLICE_BYTES = 1024 * 1024
_POLL_S = 0.5
_DAMAGED = {BlobState.lost, BlobState.corrupt}
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


class Verdict(str, enum.Enum):
    """The result of a comparison. `damaged`: the stored copy is not what was uploaded."""

    same = "same"
    differs = "differs"
    missing = "missing"
    damaged = "damaged"
    unreadable = "unreadable"


@dataclass(frozen=True)
class FileVerdict:
    """The result for one file. `error`: why it is unreadable."""

    path: str
    verdict: Verdict
    size_bytes: int
    sha256: str | None
    file: FileRead | None
    error: FileUnreadable | None = None


def verify_local(files: Files, mission_id: uuid.UUID, plan: UploadPlan) -> list[FileVerdict]:
    """Compare the planned local files with the mission's, reading every local byte; in the plan's order."""
    remote = {name_key(file.path): file for file in files.list(FileFilter(mission_id=mission_id))}
    verdicts = []
    for local in plan.files:
        file = remote.get(name_key(local.path))
        try:
            sums = _hash_file(local.source, lambda: None)
        except FileUnreadable as error:
            verdicts.append(FileVerdict(local.path, Verdict.unreadable, local.size_bytes, None, file, error))
            continue
        verdict, sha256 = _compare(file, local.size_bytes, sums), sums.sha256.hexdigest()
        verdicts.append(FileVerdict(local.path, verdict, local.size_bytes, sha256, file))
    return verdicts


def verify_remote(files: Files, selected: Sequence[FileRead], *, timeout_s: float) -> list[FileVerdict]:
    """Have the server verify the bytes of these files, wait for the results, and return the verdicts.

    Raises:
        TimedOut: it took longer; the server continues.
    """
    deadline = time.monotonic() + timeout_s
    for file in selected:
        files.verify(file.id)
    waiting = {file.id: file.verified_at for file in selected}
    answers: dict[uuid.UUID, FileRead] = {}
    while waiting:
        for file_id, before in [*waiting.items()]:
            now = files.get(file_id)
            is_verified = now.state is BlobState.verified and now.verified_at is not None and now.verified_at != before
            if now.state in _DAMAGED or is_verified:
                answers[file_id] = now
                del waiting[file_id]
        if waiting and time.monotonic() > deadline:
            raise TimedOut(what=f"Verifying {len(waiting)} of {len(selected)} files", seconds=timeout_s)
        if waiting:
            time.sleep(_POLL_S)
    verdicts = []
    for file in (answers[file.id] for file in selected):
        verdict = Verdict.same if file.state is BlobState.verified else Verdict.damaged
        verdicts.append(FileVerdict(file.path, verdict, file.size_bytes, file.sha256, file))
    return verdicts


def is_same(file: FileRead | ArtifactRead, local: Path, check: Callable[[], None]) -> bool:
    """Return whether a local file has the bytes of a stored one; `check` may raise an error between two slices."""
    try:
        if local.is_symlink() or not local.is_file() or local.stat().st_size != file.size_bytes:
            return False
        sums = _hash_file(local, check)
    except FileUnreadable:
        return False
    if isinstance(file, ArtifactRead):
        return sums.sha256.hexdigest() == file.sha256
    return _compare(file, file.size_bytes, sums) is Verdict.same


def _hash_file(local: Path, check: Callable[[], None]) -> FileHashes:
    whole, offset = FileHashes(), 0
    try:
        handle = os.open(local, os.O_RDONLY | os.O_CLOEXEC)
        try:
            while view := read_slice(handle, offset, SLICE_BYTES):
                check()
                whole.update(view)
                offset += len(view)
        finally:
            os.close(handle)
    except OSError as error:
        raise FileUnreadable(path=str(local), reason=error.strerror or str(error)) from None
    return whole


def _compare(file: FileRead | None, size_bytes: int, sums: FileHashes) -> Verdict:
    if file is None:
        return Verdict.missing
    if file.sha256 is not None:
        is_same_sum = sums.sha256.hexdigest() == file.sha256
    else:
        is_same_sum = sums.crc64nvme.hexdigest() == file.crc64nvme
    if not is_same_sum or size_bytes != file.size_bytes:
        return Verdict.differs
    return Verdict.damaged if file.state in _DAMAGED else Verdict.same
