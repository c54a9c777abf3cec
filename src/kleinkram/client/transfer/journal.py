"""What an upload has sent, kept on this machine so that the same command resumes after a kill -9.

One append-only file an upload: a head line, then a line a part. A torn last line is ignored, so nothing needs undoing
after a crash. The parts written here are a hint only: a part is skipped when its bytes, hashed again, still have the
checksum written here and the store still has the etag. The file is locked: two processes never share one. Small
uploads of one run use each other's files, once these are empty again (`SpareFiles`).
"""

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
    """Which upload a journal is of."""

    model_config = ConfigDict(frozen=True)

    version: int = 1
    server: str
    mission_id: uuid.UUID
    path: str
    source: str
    size_bytes: int
    upload_id: uuid.UUID


class JournalPart(BaseModel):
    """A part that the store has taken: its number, our checksum of it, the store's etag for it."""

    model_config = ConfigDict(frozen=True)

    number: int
    checksum: str
    etag: str


@dataclass(frozen=True)
class SavedUpload:
    """What a journal says of an upload begun earlier."""

    upload_id: uuid.UUID
    size_bytes: int
    parts: dict[int, JournalPart]


def journals_dir() -> Path:
    """Return where the journals are."""
    return state_dir() / "uploads"


class SpareFiles:
    """Files of journals that ended, for those of small files to come: each empty, locked, and under a name of its own.

    To make and remove a file costs more than to send a small one, the more so the faster they follow each other: file
    systems are slow to give an inode out again. So of thousands of uploads those under way at once share some hundred
    files: what ends a journal takes its name from the file, and what begins one gives the file that name as well.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._free: list[tuple[int, Path]] = []

    def take(self, path: Path) -> tuple[int, Path] | None:
        """Give a file to `path`, and return its handle and its own name; None where there is none, or one is there."""
        try:
            handle, own = self._free.pop()
        except IndexError:
            return None
        try:
            os.link(own, path)
        except OSError:  # or where the file system knows no second names
            self._free.append((handle, own))
            return None
        return handle, own

    def keep(self, handle: int, path: Path, own: Path | None) -> None:
        """Take a file from `path`; what `take` did not give gets a name of its own."""
        try:
            if own is None:
                own = path.rename(self._folder / f"{_SPARE}{uuid.uuid4().hex}")
            else:
                path.unlink()
        except FileNotFoundError:  # somebody has cleared the folder
            os.close(handle)
            return
        os.ftruncate(handle, 0)
        self._free.append((handle, own))

    def close(self) -> None:
        """Remove them, and those that a process left that was killed."""
        while self._free:
            handle, own = self._free.pop()
            own.unlink(missing_ok=True)
            os.close(handle)
        for left in self._folder.glob(f"{_SPARE}*"):
            _remove_left(left)


def _remove_left(spare: Path) -> None:
    try:
        handle = os.open(spare, os.O_RDWR | os.O_CLOEXEC)
    except FileNotFoundError:
        return
    try:
        # One that a journal has, too, is left to whoever resumes that upload: not even for a moment locked here.
        if os.fstat(handle).st_nlink == 1 and _lock(handle):
            spare.unlink(missing_ok=True)
    finally:
        os.close(handle)


class Journal:
    """The journal of one file's upload, locked for as long as it is open. Appending is safe from several threads.

    Its file is `own` of the spare ones, where it came from them; once it says nothing, it goes to them.
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
        """Start the journal of an upload anew, unless it is that upload's already.

        `durable` journals survive a power cut too: every line is forced to disk.
        """
        self._durable = durable
        if self.remembered is None or self.remembered.upload_id != head.upload_id:
            os.ftruncate(self._handle, 0)
            self._append(head)

    def record(self, part: JournalPart) -> None:
        """Write down that the store has taken a part."""
        self._append(part)

    def forget(self) -> None:
        """End the journal: the upload is done, or will never be. Nothing may be recorded from here on."""
        handle, self._handle = self._handle, -1
        if handle >= 0:
            self._spares.keep(handle, self._file, self._own)
        else:
            self._file.unlink(missing_ok=True)

    def close(self) -> None:
        """Close and unlock, keeping the journal when it says anything."""
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
    """The journals of one run of uploads: in `folder`, if not where this user's are."""

    def __init__(self, folder: Path | None = None) -> None:
        self._folder = folder or journals_dir()
        self._spares = SpareFiles(self._folder)

    def open(self, server: str, mission_id: uuid.UUID, file: LocalFile) -> Journal:
        """Open the journal of uploading one file to one place, making it where there is none.

        Raises:
            UploadElsewhere: another process of this machine holds it.
        """
        key = hashlib.sha256(json.dumps([server, str(mission_id), file.path]).encode()).hexdigest()[:32]
        path = self._folder / f"{key}.jsonl"
        # That of a large file is made anew: to be durable, its name must be forced to disk with its lines.
        if file.size_bytes <= MIN_PART_BYTES and (spare := self._spares.take(path)) is not None:
            return Journal(spare[0], path, None, self._spares, spare[1])
        while True:
            handle = _open(path)
            is_free = _lock(handle)
            if _is_at(handle, path):
                if is_free:
                    return Journal(handle, path, _read(handle), self._spares)
                os.close(handle)
                raise UploadElsewhere(path=file.path)
            os.close(handle)  # its last owner removed it between our open and our lock

    def close(self) -> None:
        """Remove what is only kept for further journals; those still open are closed by whoever has them, before."""
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


def _is_at(handle: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(handle), path.stat())
    except FileNotFoundError:
        return False


def _read(handle: int) -> SavedUpload | None:
    size = os.fstat(handle).st_size
    if size == 0:
        return None
    content = os.pread(handle, size, 0)
    whole, _, torn = content.rpartition(b"\n")
    if torn:  # whatever follows must not be glued to it
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
