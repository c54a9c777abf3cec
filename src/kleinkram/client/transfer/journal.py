"""Journals of uploads on this machine, so that the same command resumes after a kill -9.

One append-only file per upload: a head line, then a line per part. A torn last line is ignored. A part is skipped only
when its bytes, hashed again, have the checksum written here, and the store still has the ETag. The file is locked: two
processes never share one.
"""

import contextlib
import fcntl
import hashlib
import json
import os
import uuid
from dataclasses import dataclass
from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError

from kleinkram.client.config import state_dir
from kleinkram.client.errors import UploadElsewhere
from kleinkram.client.transfer.plan import LocalFile
from kleinkram.contract.uploads import MIN_PART_BYTES

_SPARE = "spare-"


class JournalHead(BaseModel):
    """The upload of a journal."""

    model_config = ConfigDict(frozen=True)

    version: int = 1
    server: str
    mission_id: uuid.UUID
    path: str
    source: str
    size_bytes: int
    upload_id: uuid.UUID


class JournalPart(BaseModel):
    """A part that the store has taken: its number, our checksum, the store's ETag."""

    model_config = ConfigDict(frozen=True)

    number: int
    checksum: str
    etag: str


@dataclass(frozen=True)
class SavedUpload:
    """An upload that an earlier run began, as its journal describes it."""

    upload_id: uuid.UUID
    size_bytes: int
    parts: dict[int, JournalPart]


def journals_dir() -> Path:
    """Return where the journals are."""
    return state_dir() / "uploads"


class SpareFiles:
    """Reuses the files of ended journals for small uploads: each is empty, locked, and has a name of its own.

    Creating and removing a file costs more than sending a small one. So thousands of uploads share some hundred files:
    a journal that begins gives its name to a spare file, and takes it away at its end.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._free: list[tuple[int, Path]] = []

    def take(self, path: Path) -> tuple[int, Path] | None:
        """Link a spare file at `path`; return its handle and its own name, or None where that is not possible."""
        try:
            handle, own = self._free.pop()
        except IndexError:
            return None
        try:
            os.link(own, path)
        except OSError:  # it exists, or the file system has no hard links
            self._free.append((handle, own))
            return None
        return handle, own

    def keep(self, handle: int, path: Path, own: Path | None) -> None:
        """Keep the file at `path` as a spare one; `own` is its second name, if `take` gave one."""
        try:
            if own is None:
                own = path.rename(self._folder / f"{_SPARE}{uuid.uuid4().hex}")
            else:
                path.unlink()
        except FileNotFoundError:  # the folder was cleared
            os.close(handle)
            return
        os.ftruncate(handle, 0)
        self._free.append((handle, own))

    def close(self) -> None:
        """Remove the spare files, and those of processes that were killed."""
        while self._free:
            handle, own = self._free.pop()
            own.unlink(missing_ok=True)
            os.close(handle)
        for spare in self._folder.glob(f"{_SPARE}*"):
            try:
                handle = os.open(spare, os.O_RDWR | os.O_CLOEXEC)
            except FileNotFoundError:
                continue
            try:
                # One with a second name is a journal: it is left to the process that resumes that upload.
                if os.fstat(handle).st_nlink == 1 and _lock(handle):
                    spare.unlink(missing_ok=True)
            finally:
                os.close(handle)


class Journal:
    """The journal of one file's upload, locked while it is open. Appending is safe from several threads.

    `own` is the second name of its file, if it came from the spare ones.
    """

    def __init__(
        self, handle: int, file: Path, remembered: SavedUpload | None, spares: SpareFiles, own: Path | None = None
    ) -> None:
        self._handle = handle
        self._file = file
        self._spares = spares
        self._own = own
        self._durable = False
        self.remembered = remembered

    def begin(self, head: JournalHead, *, durable: bool) -> None:
        """Start the journal of an upload, unless it is that upload's already. `durable` forces every line to disk."""
        self._durable = durable
        if self.remembered is None or self.remembered.upload_id != head.upload_id:
            os.ftruncate(self._handle, 0)
            self._append(head)

    def record(self, part: JournalPart) -> None:
        """Record a part that the store has taken."""
        self._append(part)

    def forget(self) -> None:
        """Remove the journal: the upload has ended. Nothing may be recorded afterwards."""
        handle, self._handle = self._handle, -1
        if handle >= 0:
            self._spares.keep(handle, self._file, self._own)
        else:
            self._file.unlink(missing_ok=True)

    def close(self) -> None:
        """Close and unlock; an empty journal is removed."""
        if self._handle < 0:
            return
        if os.fstat(self._handle).st_size == 0:
            self.forget()
            return
        if self._own is not None:
            self._own.unlink(missing_ok=True)
        os.close(self._handle)
        self._handle = -1

    def _append(self, line: BaseModel) -> None:
        os.write(self._handle, line.model_dump_json().encode() + b"\n")
        if self._durable:
            os.fdatasync(self._handle)


class Journals:
    """The journals of one run of uploads, in `folder` or in the state directory of this user."""

    def __init__(self, folder: Path | None = None) -> None:
        self._folder = folder or journals_dir()
        self._spares = SpareFiles(self._folder)

    def open(self, server: str, mission_id: uuid.UUID, file: LocalFile) -> Journal:
        """Open or create the journal of one upload; raise UploadElsewhere where another process holds it."""
        key = hashlib.sha256(json.dumps([server, str(mission_id), file.path]).encode()).hexdigest()[:32]
        path = self._folder / f"{key}.jsonl"
        # Not for large files: a durable journal needs a file of its own.
        if file.size_bytes <= MIN_PART_BYTES and (spare := self._spares.take(path)) is not None:
            return Journal(spare[0], path, None, self._spares, spare[1])
        while True:
            handle = _open(path)
            is_free = _lock(handle)
            with contextlib.suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(handle), path.stat()):
                    if is_free:
                        return Journal(handle, path, _read(handle), self._spares)
                    os.close(handle)
                    raise UploadElsewhere(path=file.path)
            os.close(handle)  # its last owner removed it between our open and our lock

    def close(self) -> None:
        """Remove the spare files. Journals must be closed before."""
        self._spares.close()


def _lock(handle: int) -> bool:
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _open(path: Path) -> int:
    flags = os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC
    try:
        return os.open(path, flags, 0o600)
    except FileNotFoundError:  # the first of this user's
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        return os.open(path, flags, 0o600)


def _read(handle: int) -> SavedUpload | None:
    size = os.fstat(handle).st_size
    if size == 0:
        return None
    content = os.pread(handle, size, 0)
    whole, _, torn = content.rpartition(b"\n")
    if torn:  # the next line must not continue it
        os.ftruncate(handle, len(content) - len(torn))
    lines = whole.splitlines()
    if not lines:
        return None
    try:
        head = JournalHead.model_validate_json(lines[0])
        parts = [JournalPart.model_validate_json(line) for line in lines[1:]]
    except ValidationError:
        return None
    return SavedUpload(head.upload_id, head.size_bytes, {part.number: part for part in parts})
