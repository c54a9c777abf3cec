"""Compares local files with those of a mission, and has the server verify the bytes that it stores."""

import enum
import os
import time
import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from kleinkram.client.errors import FileUnreadable, TimedOut
from kleinkram.client.files import Files
from kleinkram.client.transfer.plan import SLICE_BYTES, FileHashes, UploadPlan, read_slice
from kleinkram.contract.files import BlobState, FileFilter, FileRead
from kleinkram.contract.names import name_key
from kleinkram.contract.runs import ArtifactRead

_POLL_S = 0.5
_DAMAGED = {BlobState.lost, BlobState.corrupt}


class Comparison(str, enum.Enum):
    """The result of a comparison. `damaged`: the stored copy is not what was uploaded."""

    same = "same"
    differs = "differs"
    missing = "missing"
    damaged = "damaged"
    unreadable = "unreadable"


@dataclass(frozen=True)
class FileComparison:
    """The result for one file. `error`: why it is unreadable."""

    path: str
    comparison: Comparison
    size_bytes: int
    sha256: str | None
    file: FileRead | None
    error: FileUnreadable | None = None


def verify_local(files: Files, mission_id: uuid.UUID, plan: UploadPlan) -> list[FileComparison]:
    """Compare the planned local files with the mission's, reading every local byte; in the plan's order."""
    remote = {name_key(file.path): file for file in files.list(FileFilter(mission_id=mission_id))}
    comparisons = []
    for local in plan.files:
        file = remote.get(name_key(local.path))
        try:
            sums = _hash_file(local.source, lambda: None)
        except FileUnreadable as error:
            comparisons.append(FileComparison(local.path, Comparison.unreadable, local.size_bytes, None, file, error))
            continue
        comparison, sha256 = _compare(file, local.size_bytes, sums), sums.sha256.hexdigest()
        comparisons.append(FileComparison(local.path, comparison, local.size_bytes, sha256, file))
    return comparisons


def verify_remote(files: Files, selected: Sequence[FileRead], *, timeout_s: float) -> list[FileComparison]:
    """Have the server verify the bytes of these files, wait for the results, and return the comparisons.

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
    comparisons = []
    for file in (answers[file.id] for file in selected):
        comparison = Comparison.same if file.state is BlobState.verified else Comparison.damaged
        comparisons.append(FileComparison(file.path, comparison, file.size_bytes, file.sha256, file))
    return comparisons


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
    return _compare(file, file.size_bytes, sums) is Comparison.same


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


def _compare(file: FileRead | None, size_bytes: int, sums: FileHashes) -> Comparison:
    if file is None:
        return Comparison.missing
    if file.sha256 is not None:
        is_same_sum = sums.sha256.hexdigest() == file.sha256
    else:
        is_same_sum = sums.crc64nvme.hexdigest() == file.crc64nvme
    if not is_same_sum or size_bytes != file.size_bytes:
        return Comparison.differs
    return Comparison.damaged if file.state in _DAMAGED else Comparison.same
