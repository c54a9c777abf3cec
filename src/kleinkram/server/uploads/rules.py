"""What is decided about each file that somebody wants to upload, from what is known. Pure: no database, no store."""

import enum
import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Row

from kleinkram.contract.errors import FileExists, KleinkramError, NameLeased, PathConflict
from kleinkram.contract.files import BlobState
from kleinkram.contract.names import name_key
from kleinkram.contract.uploads import ChecksumKind, UploadFile, UploadState
from kleinkram.server.files.paths import folder_keys
from kleinkram.server.uploads.queries import Content

# What a conflict names to who may not read what is there.
UNSHOWN = "a file that you may not see"
UNREADABLE = {BlobState.lost.value, BlobState.corrupt.value}


class Way(enum.Enum):
    """What happens with a file next."""

    present = enum.auto()
    link = enum.auto()
    hash_first = enum.auto()
    begin = enum.auto()
    resume = enum.auto()
    refuse = enum.auto()


@dataclass(frozen=True)
class Decision:
    """One file's way; `ref` is the file that is present, the blob to link or the upload to resume."""

    wanted: UploadFile
    way: Way
    ref: uuid.UUID | None = None
    error: KleinkramError | None = None
    takes_over: uuid.UUID | None = None


@dataclass(frozen=True)
class Known:
    """What is known of the names and contents that a request touches, and of who asks."""

    person_id: uuid.UUID | None
    # Whether they may read what is there; else they hear no more of it than that it is there.
    may_read: bool
    files: Mapping[str, Row[Any]]
    uploads: Mapping[str, Row[Any]]
    twin_sizes: frozenset[int]
    twins: Mapping[Content, uuid.UUID]
    conflicts: Mapping[str, str]


def content_of(wanted: UploadFile) -> Content | None:
    """Return what a file holds, where its hash is known."""
    return (wanted.size_bytes, bytes.fromhex(wanted.sha256)) if wanted.sha256 else None


def decide(wanted: UploadFile, known: Known) -> Decision:
    """Return what happens with one file."""
    key = name_key(wanted.path)
    if other := known.conflicts.get(wanted.path):
        return Decision(wanted, Way.refuse, error=PathConflict(path=wanted.path, other=other))
    if existing := known.files.get(key):
        decision = _beside(wanted, existing, known)
        if decision:
            return decision
    if active := known.uploads.get(key):
        return _during(wanted, active, known.person_id)
    return _afresh(wanted, known)


def _beside(wanted: UploadFile, existing: Row[Any], known: Known) -> Decision | None:
    if existing.path != wanted.path:
        other = existing.path if known.may_read else UNSHOWN
        return Decision(wanted, Way.refuse, error=PathConflict(path=wanted.path, other=other))
    if wanted.sha256 is None:
        return Decision(wanted, Way.hash_first)
    if content_of(wanted) != (existing.size_bytes, existing.sha256):
        error = FileExists(
            path=wanted.path,
            existing_sha256=existing.sha256.hex() if known.may_read else None,
            sent_sha256=wanted.sha256,
            existing_file_id=str(existing.id) if known.may_read else None,
        )
        return Decision(wanted, Way.refuse, error=error)
    if existing.state in UNREADABLE:
        return None  # the same content again: this is how a lost or corrupt file is mended
    return Decision(wanted, Way.present, ref=existing.id)


def _during(wanted: UploadFile, active: Row[Any], person_id: uuid.UUID | None) -> Decision:
    same = active.person_id == person_id and active.path == wanted.path and active.size_bytes == wanted.size_bytes
    if same and active.id == wanted.upload_id and active.state == UploadState.open.value:
        return Decision(wanted, Way.resume, ref=active.id)
    if active.leased or active.state == UploadState.completing.value:
        error = NameLeased(path=wanted.path, lease_ends_at=active.lease_ends_at.isoformat(timespec="seconds"))
        return Decision(wanted, Way.refuse, error=error)
    return Decision(wanted, Way.begin, takes_over=active.id)


def _afresh(wanted: UploadFile, known: Known) -> Decision:
    content = content_of(wanted)
    if content is None:
        return Decision(wanted, Way.hash_first if wanted.size_bytes in known.twin_sizes else Way.begin)
    if twin := known.twins.get(content):
        return Decision(wanted, Way.link, ref=twin)
    return Decision(wanted, Way.begin)


def as_shown(conflicts: dict[str, str], *, may_read: bool) -> dict[str, str]:
    """Return conflicts of paths with files that are there, as one may hear of them who may read those, or not."""
    return conflicts if may_read else dict.fromkeys(conflicts, UNSHOWN)


def first_come(paths: Sequence[str]) -> dict[int, str]:
    """Return, of paths that are to stand side by side, the places of those that an earlier one keeps out, with it.

    The same name twice (in any case or Unicode form), or a file where another needs a folder.
    """
    files: dict[str, str] = {}
    folders: dict[str, str] = {}
    refused: dict[int, str] = {}
    for place, path in enumerate(paths):
        key = name_key(path)
        above = folder_keys(path)
        other = files.get(key) or folders.get(key) or next((files[each] for each in above if each in files), None)
        if other is not None:
            refused[place] = other
            continue
        files[key] = path
        folders |= dict.fromkeys(above, path)
    return refused


def blob_values(row: Row[Any], blob_id: uuid.UUID) -> dict[str, object]:
    """Return the row of the blob that an upload becomes."""
    # Only a checksum that the store compared itself is kept as its word.
    verified = row.checksum == ChecksumKind.crc64nvme.value
    return {
        "id": blob_id,
        "store_id": row.store_id,
        "key": row.key,
        "size_bytes": row.size_bytes,
        "crc64nvme": row.crc64nvme if verified else None,
        "sha256": row.sha256,
        "uploaded_by_id": row.person_id,
    }
