"""Verification: local files against the checksums of a mission's files, and stored bytes by the server itself."""

import enum
import os
import time
import uuid
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from kleinkram.client.errors import FileUnreadable, TimedOut
from kleinkram.client.files import Files
from kleinkram.client.transfer.local_file import FileHashes, read_slice
from kleinkram.client.transfer.plan import UploadPlan
from kleinkram.contract.files import BlobState, FileFilter, FileRead
from kleinkram.contract.names import name_key
from kleinkram.contract.runs import ArtifactRead

_POLL_S = 0.5


class Verdict(str, enum.Enum):
    """What comparing found.

    `damaged`: the copy in the store is not what was uploaded. `unreadable`: the local file cannot be read.
    """

    same = "same"
    differs = "differs"
    missing = "missing"
    damaged = "damaged"
    unreadable = "unreadable"


@dataclass(frozen=True)
class FileVerdict:
    """What was found of one file. `error`: why it is unreadable."""

    path: str
    verdict: Verdict
    size_bytes: int
    sha256: str | None
    file: FileRead | None
    error: FileUnreadable | None = None


def verify_local(files: Files, mission_id: uuid.UUID, plan: UploadPlan) -> list[FileVerdict]:
    """Compare the planned local files with the mission's, reading every local byte; in the plan's order."""
    there = {name_key(file.path): file for file in files.list(FileFilter(mission_id=mission_id))}
    found = []
    for local in plan.files:
        file = there.get(name_key(local.path))
        try:
            sums = _sums(local.source, lambda: None)
        except FileUnreadable as error:
            found.append(FileVerdict(local.path, Verdict.unreadable, local.size_bytes, None, file, error))
            continue
        found.append(
            FileVerdict(
                local.path, _judge(file, local.size_bytes, sums), local.size_bytes, sums.sha256.hexdigest(), file
            )
        )
    return found


def verify_remote(files: Files, asked: Sequence[FileRead], *, timeout_s: float) -> list[FileVerdict]:
    """Have the server read the bytes of these files again, wait until it has, and return what it found.

    Raises:
        TimedOut: it took longer; the server goes on.
    """
    deadline = time.monotonic() + timeout_s
    before = {file.id: file.verified_at for file in asked}
    for file in asked:
        files.verify(file.id)
    waiting = [file.id for file in asked]
    answers: dict[uuid.UUID, FileRead] = {}
    while waiting:
        for file_id in waiting:
            now = files.get(file_id)
            if now.state in {BlobState.lost, BlobState.corrupt} or _is_later(now, before[file_id]):
                answers[file_id] = now
        waiting = [file_id for file_id in waiting if file_id not in answers]
        if waiting and time.monotonic() > deadline:
            raise TimedOut(what=f"Verifying {len(waiting)} of {len(asked)} files", seconds=timeout_s)
        if waiting:
            time.sleep(_POLL_S)
    return [_verified(answers[file.id]) for file in asked]


def is_same(file: FileRead | ArtifactRead, local: Path, check: Callable[[], None]) -> bool:
    """Say whether a local file is, byte for byte, what the server keeps; `check` may end the reading."""
    try:
        if local.is_symlink() or not local.is_file() or local.stat().st_size != file.size_bytes:
            return False
        sums = _sums(local, check)
        if isinstance(file, ArtifactRead):
            return sums.sha256.hexdigest() == file.sha256
        return _judge(file, file.size_bytes, sums) is Verdict.same
    except FileUnreadable:
        return False


def all_same(found: Iterable[FileVerdict]) -> bool:
    """Say whether nothing differs."""
    return all(one.verdict is Verdict.same for one in found)


def _sums(local: Path, check: Callable[[], None]) -> FileHashes:
    whole, offset = FileHashes(), 0
    try:
        handle = os.open(local, os.O_RDONLY | os.O_CLOEXEC)
    except OSError as error:
        raise FileUnreadable(path=str(local), reason=error.strerror or str(error)) from None
    try:
        while view := read_slice(handle, offset, 1 << 20):
            check()
            whole.update(view)
            offset += len(view)
    except OSError as error:
        raise FileUnreadable(path=str(local), reason=error.strerror or str(error)) from None
    finally:
        os.close(handle)
    return whole


def _judge(file: FileRead | None, size_bytes: int, sums: FileHashes) -> Verdict:
    if file is None:
        return Verdict.missing
    if file.sha256 is not None:
        same = sums.sha256.hexdigest() == file.sha256
    else:
        same = sums.crc64nvme.hexdigest() == file.crc64nvme
    if not same or size_bytes != file.size_bytes:
        return Verdict.differs
    return Verdict.damaged if file.state in {BlobState.lost, BlobState.corrupt} else Verdict.same


def _is_later(file: FileRead, before: object) -> bool:
    return file.state is BlobState.verified and file.verified_at is not None and file.verified_at != before


def _verified(file: FileRead) -> FileVerdict:
    verdict = Verdict.same if file.state is BlobState.verified else Verdict.damaged
    return FileVerdict(file.path, verdict, file.size_bytes, file.sha256, file)
