"""Decisions about each file at the begin and at the completion of its upload. Pure: no database, no store."""

import enum
import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from kleinkram.contract.errors import FileExists, KleinkramError, NameLeased, PathConflict
from kleinkram.contract.names import name_key
from kleinkram.contract.uploads import ChecksumKind, UploadFile, UploadState
from kleinkram.server.files.paths import folder_keys
from kleinkram.server.uploads.queries import ExistingFile, FileContent, UploadRow

HIDDEN_FILE = "a file that you may not see"
"""The text of a conflict for an actor who may not read the mission."""


class Action(enum.Enum):
    """Decision about an announced file."""

    present = enum.auto()
    """Send nothing: the mission has this file."""
    link = enum.auto()
    """Make the file from a stored blob."""
    hash_required = enum.auto()
    """Ask the client for the hash, then decide."""
    begin = enum.auto()
    resume = enum.auto()
    refuse = enum.auto()


@dataclass(frozen=True)
class Decision:
    """One announced file and what happens with it. Of the ids, those that the action needs are set.

    `stolen_upload_id`: another upload of this name whose lease ran out, and which ends now.
    """

    requested: UploadFile
    action: Action
    file_id: uuid.UUID | None = None
    blob_id: uuid.UUID | None = None
    upload_id: uuid.UUID | None = None
    stolen_upload_id: uuid.UUID | None = None
    error: KleinkramError | None = None


@dataclass(frozen=True)
class RequestFacts:
    """Rows about the names and contents of one request. Keys are path keys; those of conflicts are paths.

    `may_read`: whether the actor may read the mission; otherwise they learn only that a name is taken.
    """

    person_id: uuid.UUID | None
    may_read: bool
    files: Mapping[str, ExistingFile]
    uploads: Mapping[str, UploadRow]
    duplicate_sizes: frozenset[int]
    duplicates: Mapping[FileContent, uuid.UUID]
    conflicts: Mapping[str, str]


def decide(requested: UploadFile, facts: RequestFacts) -> Decision:
    """Decide about one announced file."""
    key = name_key(requested.path)
    if other := facts.conflicts.get(requested.path):
        return _refuse(requested, PathConflict(path=requested.path, other=other))
    if (existing := facts.files.get(key)) and (decision := _decide_with_existing(requested, existing, facts)):
        return decision
    if other_upload := facts.uploads.get(key):
        return _decide_with_upload(requested, other_upload, facts.person_id)
    return _decide_new(requested, facts)


def _refuse(requested: UploadFile, error: KleinkramError) -> Decision:
    return Decision(requested, Action.refuse, error=error)


def _decide_with_existing(requested: UploadFile, existing: ExistingFile, facts: RequestFacts) -> Decision | None:
    """Decide about a file whose name is taken; None to repair the damaged file there."""
    if existing.path != requested.path:
        other = existing.path if facts.may_read else HIDDEN_FILE
        return _refuse(requested, PathConflict(path=requested.path, other=other))
    content = content_of(requested)
    if content is None:
        return Decision(requested, Action.hash_required)
    if content != existing.content:
        return _refuse(requested, _file_exists(requested.path, existing, content, may_read=facts.may_read))
    if existing.is_damaged:
        return None
    return Decision(requested, Action.present, file_id=existing.id)


def _decide_with_upload(requested: UploadFile, other: UploadRow, person_id: uuid.UUID | None) -> Decision:
    """Decide about a file whose name another upload reserves: resume it, wait for it, or steal its lease."""
    is_same_file = (other.person_id, other.path, other.size_bytes) == (person_id, requested.path, requested.size_bytes)
    is_completing = other.state == UploadState.completing.value
    if is_same_file and other.id == requested.upload_id and not is_completing:
        return Decision(requested, Action.resume, upload_id=other.id)
    if other.has_lease or is_completing:
        lease_ends_at = other.lease_ends_at.isoformat(timespec="seconds")
        return _refuse(requested, NameLeased(path=requested.path, lease_ends_at=lease_ends_at))
    return Decision(requested, Action.begin, stolen_upload_id=other.id)


def _decide_new(requested: UploadFile, facts: RequestFacts) -> Decision:
    content = content_of(requested)
    if content is None:
        is_worth_hashing = requested.size_bytes in facts.duplicate_sizes
        return Decision(requested, Action.hash_required if is_worth_hashing else Action.begin)
    if blob_id := facts.duplicates.get(content):
        return Decision(requested, Action.link, blob_id=blob_id)
    return Decision(requested, Action.begin)


def content_of(requested: UploadFile) -> FileContent | None:
    """Return the content of an announced file, if its hash is known."""
    return FileContent(requested.size_bytes, bytes.fromhex(requested.sha256)) if requested.sha256 else None


@dataclass(frozen=True)
class Placement:
    """Where a completed upload goes: into a new file, or into the existing file `file_id`; or why nowhere.

    `needs_blob`: the uploaded bytes are used. Otherwise, the file has the same bytes already.
    """

    upload: UploadRow
    file_id: uuid.UUID | None = None
    needs_blob: bool = True
    error: KleinkramError | None = None


def placement_of(
    upload: UploadRow, existing: ExistingFile | None, conflict: str | None, *, may_read: bool
) -> Placement:
    """Decide what becomes of an upload whose bytes the store has: a new file, a repaired one, or a refusal."""
    if conflict is not None:
        return Placement(upload, error=PathConflict(path=upload.path, other=conflict))
    if existing is None:
        return Placement(upload)
    if existing.content != upload.content:
        return Placement(upload, error=_file_exists(upload.path, existing, upload.content, may_read=may_read))
    # The same bytes repair a damaged file; an undamaged one was linked or moved here since.
    return Placement(upload, file_id=existing.id, needs_blob=existing.is_damaged)


def blob_columns(row: UploadRow, blob_id: uuid.UUID) -> dict[str, object]:
    """Return the columns of the blob that an upload becomes, for an insert."""
    # The client's value, so it is stored only if the store compared it.
    has_store_compared = row.checksum == ChecksumKind.crc64nvme.value
    return {
        "id": blob_id,
        "store_id": row.store_id,
        "key": row.key,
        "size_bytes": row.size_bytes,
        "crc64nvme": row.crc64nvme if has_store_compared else None,
        "sha256": row.sha256,
        "uploaded_by_id": row.person_id,
    }


def _file_exists(path: str, existing: ExistingFile, content: FileContent, *, may_read: bool) -> FileExists:
    return FileExists(
        path=path,
        existing_sha256=existing.sha256.hex() if may_read else None,
        sent_sha256=content.sha256.hex(),
        existing_file_id=str(existing.id) if may_read else None,
    )


def visible_conflicts(conflicts: dict[str, str], *, may_read: bool) -> dict[str, str]:
    """Return conflicts with existing files as the actor may see them."""
    return conflicts if may_read else dict.fromkeys(conflicts, HIDDEN_FILE)


def conflicts_among(paths: Sequence[str]) -> dict[int, str]:
    """Return the positions of paths that conflict with an earlier path of the list, with that path.

    Two paths conflict if they are the same name (in any case or Unicode form), or one is a folder of the other.
    """
    files: dict[str, str] = {}
    folders: dict[str, str] = {}
    conflicts: dict[int, str] = {}
    for position, path in enumerate(paths):
        key, parents = name_key(path), folder_keys(path)
        parent_file = next((files[parent] for parent in parents if parent in files), None)
        other = files.get(key) or folders.get(key) or parent_file
        if other is not None:
            conflicts[position] = other
            continue
        files[key] = path
        folders |= dict.fromkeys(parents, path)
    return conflicts
