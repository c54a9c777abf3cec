"""The plan of an upload: which files on this machine become which files of a mission, and how their bytes are read.

A file goes to the top of the mission under its own name. A folder keeps its tree, as with rsync: `day1`
puts `day1/cam.mcap`, while `day1/` (or `.`) puts its contents, `cam.mcap`. Links to files are followed; links to
folders only if they are among the paths. The plan lists what is left out, and why. Planning reads no byte; an
`OpenFile` is read in slices. Memory: one slice per thread.
"""

import hashlib
import os
import stat
import threading
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import NamedTuple, Protocol

from kleinkram.client.errors import (
    ClientError,
    FileChanged,
    FileUnreadable,
    InvalidInput,
    NameUnusable,
    NotAFile,
    PathsCollide,
    StillRecording,
)
from kleinkram.contract.names import check_file_path, name_key
from kleinkram.contract.uploads import MAX_FILE_BYTES, ChecksumKind, crc64nvme

ACTIVE_SUFFIX = ".active"
SLICE_BYTES = 1024 * 1024
_RECENT_NS = 10 * 1_000_000_000
_WATCH_S = 1.0
_slices = threading.local()

# -- planning ---------------------------------------------------------------------------------------------------------


class FileIdentity(NamedTuple):
    """Tells whether a file is still the one that was planned."""

    size_bytes: int
    mtime_ns: int
    inode: int
    device: int


@dataclass(frozen=True)
class LocalFile:
    """A file on this machine and its path in the mission."""

    source: Path
    path: str
    identity: FileIdentity

    @property
    def size_bytes(self) -> int:
        """The size when it was planned."""
        return self.identity.size_bytes


@dataclass(frozen=True)
class UploadPlan:
    """What would be uploaded, by path, and what is left out and why."""

    files: list[LocalFile] = field(default_factory=list)
    left_out: list[ClientError] = field(default_factory=list)

    @property
    def size_bytes(self) -> int:
        """The bytes of all files planned."""
        return sum(file.size_bytes for file in self.files)


def plan_upload(
    paths: Iterable[str | os.PathLike[str]], *, include_active: bool = False, exclude: Sequence[str] = ()
) -> UploadPlan:
    """Return the plan of uploading these paths.

    Files that are still being recorded are left out unless `include_active`: those whose name ends in `.active`, and
    those that grow while they are watched for a second (only files modified in the last seconds are). Files that would
    have the same path in the mission are left out. Those that match a glob in `exclude` are ignored (`is_excluded`).

    Raises:
        InvalidInput: a path does not exist.
    """
    plan = UploadPlan()
    by_key: dict[str, list[LocalFile]] = defaultdict(list)
    for source, path in _walk(paths, plan.left_out):
        if is_excluded(path, exclude):
            continue
        file = _checked_file(source, path)
        if isinstance(file, ClientError):
            plan.left_out.append(file)
        elif all(other.source != file.source for other in by_key[name_key(file.path)]):
            by_key[name_key(file.path)].append(file)
    files = []
    for group in by_key.values():
        if len(group) == 1:
            files += group
            continue
        *others, last = [distinct_text(str(file.source)) for file in group]
        path, first = distinct_text(group[0].path), ", ".join(others)
        plan.left_out.append(PathsCollide(path=path, first=first, second=last, remedy="rename all but one"))
    files.sort(key=lambda file: file.path)
    plan.files.extend(files if include_active else _without_active(files, plan.left_out))
    return plan


def distinct_text(text: str) -> str:
    """Return a text in quotes, with the code points of what is not ASCII: `'café.txt' (cafe\u0301.txt)`."""
    if text.isascii():
        return repr(text)
    return f"{text!r} ({text.encode('ascii', 'backslashreplace').decode()})"


def mission_folders(paths: Iterable[str | os.PathLike[str]], exclude: Sequence[str] = ()) -> dict[str, Path]:
    """Return the subfolders of some folders, except hidden ones, by name; each becomes a mission.

    Raises:
        InvalidInput: a path is no folder, or has no subfolder, or holds files beside them; or two have one name.
    """
    missions: dict[str, Path] = {}
    for parent in map(Path, paths):
        what = f"The folder {shown(str(parent))}"
        try:
            entries = sorted(entry for entry in parent.iterdir() if not is_excluded(entry.name, [*exclude, ".*"]))
        except OSError as error:
            raise InvalidInput(what=what, reason=error.strerror or str(error)) from None
        if loose := [entry.name for entry in entries if not entry.is_dir()]:
            reason = f"{loose[0]!r} in it belongs to no mission; move it into one, or leave it out with --exclude"
            raise InvalidInput(what=what, reason=reason)
        if not entries:
            raise InvalidInput(what=what, reason="it has no subfolder that could be a mission")
        for folder in entries:
            if folder.name in missions:
                raise InvalidInput(what=what, reason=f"there is a second folder named {folder.name!r}")
            missions[folder.name] = folder
    return missions


def is_excluded(path: str, globs: Iterable[str]) -> bool:
    """Return whether a glob matches a file's path in the mission, its name, or one of its folders."""
    parts = path.split("/")
    names = {*parts, *("/".join(parts[: end + 1]) for end in range(len(parts)))}
    return any(fnmatchcase(name, glob.rstrip("/")) for glob in globs for name in names)


def identity_of(status: os.stat_result) -> FileIdentity:
    """Return a file's identity from its status."""
    return FileIdentity(status.st_size, status.st_mtime_ns, status.st_ino, status.st_dev)


def _walk(paths: Iterable[str | os.PathLike[str]], left_out: list[ClientError]) -> Iterator[tuple[Path, str]]:
    """Yield each file with its path in the mission."""

    def unreadable(error: OSError) -> None:
        left_out.append(FileUnreadable(path=shown(str(error.filename)), reason=error.strerror or str(error)))

    for entry in paths:
        text = os.fspath(entry)
        root = Path(text)
        try:
            is_folder = stat.S_ISDIR(root.stat().st_mode)
        except OSError as error:
            raise InvalidInput(what=f"The path {shown(text)}", reason=error.strerror or str(error)) from None
        if not is_folder:
            yield root, root.name
            continue
        prefix = "" if text.endswith(("/", "/.", "..")) or text == "." else f"{root.name}/"
        for folder, folders, names in os.walk(root, onerror=unreadable):
            here = Path(folder)
            links = [here / name for name in folders if (here / name).is_symlink()]
            left_out.extend(NotAFile(path=shown(str(link)), kind="a link to a folder") for link in links)
            inside = here.relative_to(root).as_posix()
            for name in names:
                yield here / name, prefix + (name if inside == "." else f"{inside}/{name}")


def _checked_file(source: Path, path: str) -> LocalFile | ClientError:
    """Return a file, or why it cannot be uploaded."""
    try:
        path.encode()
        path = check_file_path(path)
    except UnicodeEncodeError:
        return NameUnusable(path=shown(str(source)), reason="is not UTF-8")
    except ValueError as error:
        return NameUnusable(path=path, reason=str(error))
    try:
        status = source.stat()
    except OSError as error:
        return FileUnreadable(path=str(source), reason=error.strerror or str(error))
    if not stat.S_ISREG(status.st_mode):
        kinds = {stat.S_IFIFO: "a named pipe", stat.S_IFSOCK: "a socket", stat.S_IFDIR: "a folder"}
        return NotAFile(path=str(source), kind=kinds.get(stat.S_IFMT(status.st_mode), "a device"))
    if status.st_size > MAX_FILE_BYTES:
        return NameUnusable(path=str(source), reason="is larger than the 5 TiB that a store takes")
    return LocalFile(source, path, identity_of(status))


def _without_active(files: list[LocalFile], left_out: list[ClientError]) -> list[LocalFile]:
    recent = {file for file in files if time.time_ns() - file.identity.mtime_ns < _RECENT_NS}
    if any(not file.path.endswith(ACTIVE_SUFFIX) for file in recent):
        time.sleep(_WATCH_S)
    closed = []
    for file in files:
        reason = "its name ends in .active" if file.path.endswith(ACTIVE_SUFFIX) else None
        if reason is None and file in recent and _has_changed(file):
            reason = "something is writing to it"
        if reason is None:
            closed.append(file)
        else:
            left_out.append(StillRecording(path=str(file.source), reason=reason))
    return closed


def _has_changed(file: LocalFile) -> bool:
    try:
        return identity_of(file.source.stat()) != file.identity
    except FileNotFoundError:
        return True


def shown(path: str) -> str:
    """Return a path as printable text, with bytes that are not UTF-8 escaped."""
    return os.fsencode(path).decode("utf-8", "backslashreplace")


# -- reading ----------------------------------------------------------------------------------------------------------


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
