"""What an upload has sent, kept on this machine so that the same command resumes after a kill -9.

One append-only file an upload: a head line, then a line a part. A torn last line is ignored, so nothing needs undoing
after a crash. The parts written here are a hint only: a part is skipped when its bytes, hashed again, still have the
checksum written here and the store still has the etag. The file is locked: two processes never share one.
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
class Remembered:
    """What a journal says of an upload begun earlier."""

    upload_id: uuid.UUID
    size_bytes: int
    parts: dict[int, JournalPart]


def journals_dir() -> Path:
    """Return where the journals are."""
    return state_dir() / "uploads"


class Journal:
    """The journal of one file's upload, locked for as long as it is open. Appending is safe from several threads."""

    def __init__(self, handle: int, file: Path, remembered: Remembered | None) -> None:
        self._handle = handle
        self._file = file
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
        """End the journal: the upload is done, or will never be."""
        self._file.unlink(missing_ok=True)
        self._close()

    def close(self) -> None:
        """Close and unlock, keeping the journal when it says anything."""
        if self._handle >= 0:
            if os.fstat(self._handle).st_size == 0:
                self._file.unlink(missing_ok=True)
            self._close()

    def _close(self) -> None:
        handle, self._handle = self._handle, -1
        if handle >= 0:
            os.close(handle)

    def _append(self, line: BaseModel) -> None:
        os.write(self._handle, line.model_dump_json().encode() + b"\n")
        if self._durable:
            os.fdatasync(self._handle)


def open_journal(server: str, mission_id: uuid.UUID, file: LocalFile, *, folder: Path | None = None) -> Journal:
    """Open the journal of uploading one file to one place, making it where there is none.

    It is in `folder`, if not where this user's are.

    Raises:
        UploadElsewhere: another process of this machine holds it.
    """
    key = hashlib.sha256(json.dumps([server, str(mission_id), file.path]).encode()).hexdigest()[:32]
    path = (folder or journals_dir()) / f"{key}.jsonl"
    while True:
        handle = _open(path)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(handle)
            raise UploadElsewhere(path=file.path) from None
        if _is_at(handle, path):
            return Journal(handle, path, _read(handle))
        os.close(handle)  # its last owner removed it between our open and our lock


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


def _read(handle: int) -> Remembered | None:
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
    return Remembered(head.upload_id, head.size_bytes, {part.number: part for part in parts})
