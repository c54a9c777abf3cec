"""The begin of uploads: decides about each announced file, reserves names, links duplicates, opens uploads.

Never calls the store inside a transaction. A row with a lease reserves each name.
"""

import datetime
import enum
import uuid
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

from sqlalchemy import func, select, update

from kleinkram.contract import uploads as protocol
from kleinkram.contract.access import Scope
from kleinkram.contract.audit import ChangeKind
from kleinkram.contract.base import Page
from kleinkram.contract.errors import KleinkramError, NameLeased, NotFound, PathConflict, StoreUnavailable
from kleinkram.contract.files import FileRead
from kleinkram.contract.names import name_key
from kleinkram.contract.problems import to_problem
from kleinkram.contract.uploads import UploadRead, UploadState
from kleinkram.server import metrics
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.rights import require_mission
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.change_events import ChangeEvent, publish
from kleinkram.server.context import AppContext
from kleinkram.server.db import Connection, among, upsert_rows
from kleinkram.server.files import service as files
from kleinkram.server.files.paths import HIDDEN_FILE, conflicts_among, path_conflicts, visible_conflicts
from kleinkram.server.missions import service as missions
from kleinkram.server.pagination import Order, PageRequest, fetch_page
from kleinkram.server.quotas import Amount, project_of, require_room
from kleinkram.server.recordings.derive import derive_again
from kleinkram.server.tables import blob, file, upload
from kleinkram.server.tables.blobs import UNDER_WAY
from kleinkram.server.uploads import queries
from kleinkram.server.uploads.completion import finish_interrupted
from kleinkram.server.uploads.parts import (
    free_names,
    lease_columns,
    open_multiparts,
    sign_only_part,
    stored_small_files,
    to_upload_read,
    upload_columns,
)
from kleinkram.server.uploads.queries import ExistingFile, FileContent, UploadRow


async def begin_uploads(
    context: AppContext, actor: Actor, *, mission_id: uuid.UUID, requested: Sequence[protocol.UploadFile]
) -> list[protocol.UploadDecision]:
    """Decide about each file, reserve the names of those to be sent, and open them at the store.

    Idempotent: with the id of an upload, the upload continues where it was. One that was being completed when its
    client died is finished first.

    Raises:
        NotFound: the actor may not see such a mission.
        Forbidden: the actor may see it, but not upload into it.
        QuotaExceeded: the project has no room for the new files; none of them was begun.
        StoreUnavailable: the store does not answer.
    """
    await finish_interrupted(context, actor, mission_id=mission_id, requested=requested)
    async with context.database.begin() as db:
        await missions.lock_mission_to_fill(db, actor, mission_id)
        facts = await _collect_facts(db, actor, mission_id, requested)
        decisions = _decide_all(requested, facts)
        await _steal_leases(db, decisions)
        project_id = await project_of(db, mission_id)
        await require_room(db, actor, project_id=project_id, requested=_new_amount(decisions, facts))
        await _renew_resumed(db, context, decisions)
        decisions = await _reserve_names(db, context, actor, mission_id, decisions)
        decisions = await _link_duplicates(db, actor, mission_id, decisions)
        uploads = await queries.lock_own_uploads(db, actor, [d.upload_id for d in decisions if d.upload_id])
    linked = [decision.requested.size_bytes for decision in decisions if decision.action is FileAction.link]
    metrics.count_uploads("linked", files=len(linked), size_bytes=sum(linked))
    parts = await _open_at_store(context, decisions, uploads)
    file_ids = [decision.file_id for decision in decisions if decision.file_id]
    visible_files: dict[uuid.UUID, FileRead] = {}
    if file_ids:
        async with context.database.begin() as db:
            visible_files = {read.id: read for read in await files.read_visible_files(db, actor, file_ids)}
    begun = _BegunUploads(uploads, parts, visible_files)
    return [_to_wire(context, actor, decision, begun) for decision in decisions]


# -- deciding: functions of the facts, without database and store -----------------------------------------------------


class FileAction(enum.Enum):
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

    requested: protocol.UploadFile
    action: FileAction
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


def decide(requested: protocol.UploadFile, facts: RequestFacts) -> Decision:
    """Decide about one announced file."""
    key = name_key(requested.path)
    if other := facts.conflicts.get(requested.path):
        return _refuse(requested, PathConflict(path=requested.path, other=other))
    if (existing := facts.files.get(key)) and (decision := _decide_with_existing(requested, existing, facts)):
        return decision
    if other_upload := facts.uploads.get(key):
        return _decide_with_upload(requested, other_upload, facts.person_id)
    return _decide_new(requested, facts)


def _refuse(requested: protocol.UploadFile, error: KleinkramError) -> Decision:
    return Decision(requested, FileAction.refuse, error=error)


def _decide_with_existing(
    requested: protocol.UploadFile, existing: ExistingFile, facts: RequestFacts
) -> Decision | None:
    """Decide about a file whose name is taken; None to repair the damaged file there."""
    if existing.path != requested.path:
        other = existing.path if facts.may_read else HIDDEN_FILE
        return _refuse(requested, PathConflict(path=requested.path, other=other))
    content = content_of(requested)
    if content is None:
        return Decision(requested, FileAction.hash_required)
    if content != existing.content:
        return _refuse(requested, existing.exists_error(requested.path, content, may_read=facts.may_read))
    if existing.is_damaged:
        return None
    return Decision(requested, FileAction.present, file_id=existing.id)


def _decide_with_upload(requested: protocol.UploadFile, other: UploadRow, person_id: uuid.UUID | None) -> Decision:
    """Decide about a file whose name another upload reserves: resume it, wait for it, or steal its lease."""
    is_same_file = (other.person_id, other.path, other.size_bytes) == (person_id, requested.path, requested.size_bytes)
    is_completing = other.state == UploadState.completing.value
    if is_same_file and other.id == requested.upload_id and not is_completing:
        return Decision(requested, FileAction.resume, upload_id=other.id)
    if other.has_lease or is_completing:
        lease_ends_at = other.lease_ends_at.isoformat(timespec="seconds")
        return _refuse(requested, NameLeased(path=requested.path, lease_ends_at=lease_ends_at))
    return Decision(requested, FileAction.begin, stolen_upload_id=other.id)


def _decide_new(requested: protocol.UploadFile, facts: RequestFacts) -> Decision:
    content = content_of(requested)
    if content is None:
        is_worth_hashing = requested.size_bytes in facts.duplicate_sizes
        return Decision(requested, FileAction.hash_required if is_worth_hashing else FileAction.begin)
    if blob_id := facts.duplicates.get(content):
        return Decision(requested, FileAction.link, blob_id=blob_id)
    return Decision(requested, FileAction.begin)


def content_of(requested: protocol.UploadFile) -> FileContent | None:
    """Return the content of an announced file, if its hash is known."""
    return FileContent(requested.size_bytes, bytes.fromhex(requested.sha256)) if requested.sha256 else None


# -- the facts, and the amount of new data ----------------------------------------------------------------------------


async def _collect_facts(
    db: Connection, actor: Actor, mission_id: uuid.UUID, requested: Sequence[protocol.UploadFile]
) -> RequestFacts:
    keys = [name_key(file.path) for file in requested]
    sizes_without_hash = [file.size_bytes for file in requested if not file.sha256]
    contents = [content for file in requested if (content := content_of(file))]
    may_read = Scope.read in actor.scopes
    conflicts = await path_conflicts(db, mission_id, [file.path for file in requested])
    return RequestFacts(
        person_id=actor.person_id,
        may_read=may_read,
        files=await queries.existing_files(db, mission_id, keys),
        uploads=await queries.lock_uploads_at(db, mission_id, keys),
        duplicate_sizes=await queries.duplicate_sizes(db, actor, sizes_without_hash),
        duplicates=await queries.lock_duplicates(db, actor, contents),
        conflicts=visible_conflicts(conflicts, may_read=may_read),
    )


def _decide_all(requested: Sequence[protocol.UploadFile], facts: RequestFacts) -> list[Decision]:
    conflicts = conflicts_among([file.path for file in requested])
    return [
        Decision(file, FileAction.refuse, error=PathConflict(path=file.path, other=conflicts[position]))
        if position in conflicts
        else decide(file, facts)
        for position, file in enumerate(requested)
    ]


def _new_amount(decisions: Sequence[Decision], facts: RequestFacts) -> Amount:
    """Return how much quota the request needs. A repaired file needs no more than it has."""
    new = [d.requested for d in decisions if d.action in {FileAction.begin, FileAction.link}]
    new = [file for file in new if name_key(file.path) not in facts.files]
    return Amount(len(new), sum(file.size_bytes for file in new))


# -- reserving names --------------------------------------------------------------------------------------------------


async def _steal_leases(db: Connection, decisions: Sequence[Decision]) -> None:
    """End the uploads whose leases ran out and whose names are needed now."""
    stolen = [decision.stolen_upload_id for decision in decisions if decision.stolen_upload_id]
    if stolen:
        await db.execute(update(upload).where(among(upload.c.id, stolen)).values(state=UploadState.aborted.value))


async def _renew_resumed(db: Connection, context: AppContext, decisions: Sequence[Decision]) -> None:
    resumed = [decision.upload_id for decision in decisions if decision.action is FileAction.resume]
    if resumed:
        renewed = lease_columns(context.settings, func.now())
        await db.execute(update(upload).where(among(upload.c.id, resumed)).values(**renewed))


async def _reserve_names(
    db: Connection, context: AppContext, actor: Actor, mission_id: uuid.UUID, decisions: list[Decision]
) -> list[Decision]:
    """Insert an upload for each new file. The unique index decides between requests that come at the same time."""
    new = [decision.requested for decision in decisions if decision.action is FileAction.begin]
    if not new:
        return decisions
    # The database's clock, because leases are compared with it and the clocks of machines differ.
    now = (await db.execute(select(func.now()))).scalar_one()
    proposed = [file.upload_id for file in new if file.upload_id]
    used = await queries.used_ids(db, proposed) if proposed else frozenset()
    batch_id = uuid.uuid4()
    rows = [
        upload_columns(context, actor.person_id, mission_id, batch_id, file, now, id_=_free_id(file, used))
        for file in new
    ]
    statement = upsert_rows(upload, rows).on_conflict_do_nothing().returning(upload.c.id, upload.c.path)
    ids = {row.path: row.id for row in await db.execute(statement)}
    created = [ChangeEvent("upload", ChangeKind.created, id_, mission_id=mission_id) for id_ in ids.values()]
    await publish(db, created)
    return [_with_upload(decision, ids) if decision.action is FileAction.begin else decision for decision in decisions]


def _free_id(requested: protocol.UploadFile, used: Collection[uuid.UUID]) -> uuid.UUID:
    """Return the id that the client proposes, or a new one if an upload has it."""
    if requested.upload_id is None or requested.upload_id in used:
        return uuid.uuid4()
    return requested.upload_id


def _with_upload(decision: Decision, ids: Mapping[str, uuid.UUID]) -> Decision:
    path = decision.requested.path
    if upload_id := ids.get(path):
        return replace(decision, upload_id=upload_id)
    now = datetime.datetime.now(datetime.timezone.utc).isoformat(timespec="seconds")
    return replace(decision, action=FileAction.refuse, error=NameLeased(path=path, lease_ends_at=now))


# -- linking duplicates -----------------------------------------------------------------------------------------------


async def _link_duplicates(
    db: Connection, actor: Actor, mission_id: uuid.UUID, decisions: list[Decision]
) -> list[Decision]:
    """Make files from stored blobs; a file whose blob is damaged gets the undamaged one."""
    linked = [decision for decision in decisions if decision.action is FileAction.link]
    if not linked:
        return decisions
    rows = [
        {
            "id": uuid.uuid4(),
            "mission_id": mission_id,
            "blob_id": decision.blob_id,
            "path": decision.requested.path,
            "path_key": name_key(decision.requested.path),
            "origin": "link",
            "uploaded_by_id": actor.person_id,
        }
        for decision in linked
    ]
    statement = upsert_rows(file, rows)
    statement = statement.on_conflict_do_update(
        index_elements=["mission_id", "path_key"],
        index_where=file.c.deleted_at.is_(None),
        set_={"blob_id": statement.excluded.blob_id},
        # Only a damaged file may be replaced; the lock on the mission keeps other uploads out.
        where=file.c.blob_id.in_(select(blob.c.id).where(blob.c.state.in_(queries.DAMAGED_STATES))),
    )
    file_ids = {row.path: row.id for row in await db.execute(statement.returning(file.c.path, file.c.id))}
    project_id = await project_of(db, mission_id)
    events = [
        Event(
            "file.link",
            "file",
            file_ids[decision.requested.path],
            decision.requested.path,
            project_id,
            after={"sha256": decision.requested.sha256},
            mission_id=mission_id,
        )
        for decision in linked
        if decision.requested.path in file_ids
    ]
    await audit(db, actor, *events)
    await derive_again(db, mission_id)
    # A file that was damaged may have been verified since; then it has the same bytes as its duplicate.
    healed = [name_key(d.requested.path) for d in linked if d.requested.path not in file_ids]
    existing = await queries.existing_files(db, mission_id, healed) if healed else {}
    return [_with_file(d, file_ids, existing) if d.action is FileAction.link else d for d in decisions]


def _with_file(decision: Decision, file_ids: Mapping[str, uuid.UUID], existing: Mapping[str, ExistingFile]) -> Decision:
    path = decision.requested.path
    if file_id := file_ids.get(path):
        return replace(decision, file_id=file_id)
    return replace(decision, action=FileAction.present, file_id=existing[name_key(path)].id)


# -- answering --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _BegunUploads:
    """Rows for the response to one request, by id."""

    uploads: Mapping[uuid.UUID, UploadRow]
    parts: Mapping[uuid.UUID, list[protocol.StoredPart]]
    files: Mapping[uuid.UUID, FileRead]


async def _open_at_store(
    context: AppContext, decisions: Sequence[Decision], uploads: Mapping[uuid.UUID, UploadRow]
) -> dict[uuid.UUID, list[protocol.StoredPart]]:
    """Open the uploads at the store and return the parts that it has; free the names if the store is unavailable."""
    resumed = {d.upload_id for d in decisions if d.action is FileAction.resume and d.upload_id}
    multipart = [row for row in uploads.values() if row.is_multipart]
    try:
        parts = await open_multiparts(context, multipart, resumed=resumed) if multipart else {}
        # A resumed upload may have many small files at the store; sending them again would take long.
        return parts | await stored_small_files(context.storage, [uploads[id_] for id_ in resumed])
    except StoreUnavailable:
        await free_names(context, [d.upload_id for d in decisions if d.action is FileAction.begin and d.upload_id])
        raise


def _to_wire(context: AppContext, actor: Actor, decision: Decision, begun: _BegunUploads) -> protocol.UploadDecision:
    requested = decision.requested
    if decision.error is not None:
        return protocol.UploadRefused(path=requested.path, problem=to_problem(decision.error, actor.request_id))
    if decision.upload_id is not None:
        row = begun.uploads[decision.upload_id]
        parts = begun.parts.get(row.id, [])
        return protocol.UploadRequired(upload=to_upload_read(row, parts), part=sign_only_part(context, row, requested))
    read = begun.files.get(decision.file_id) if decision.file_id else None
    if decision.action is FileAction.present and Scope.read not in actor.scopes:
        return protocol.AlreadyPresent(file=read)
    if read is None:  # also if the file was deleted since: the next request gets another decision
        return protocol.HashRequired(path=requested.path)
    return (
        protocol.AlreadyPresent(file=read)
        if decision.action is FileAction.present
        else protocol.Deduplicated(file=read)
    )


# -- one upload, and all of a mission ---------------------------------------------------------------------------------


async def abort_upload(context: AppContext, actor: Actor, *, upload_id: uuid.UUID) -> None:
    """End an open upload; its parts are deleted soon. Does nothing to one that has ended.

    Raises:
        NotFound: the actor began no such upload.
    """
    async with context.database.begin() as db:
        row = (await queries.lock_own_uploads(db, actor, [upload_id])).get(upload_id)
        if row is None:
            raise NotFound(resource_type="upload", ref=str(upload_id))
        if row.state != UploadState.open.value:
            return
        await db.execute(update(upload).where(upload.c.id == upload_id).values(state=UploadState.aborted.value))
        project_id = await project_of(db, row.mission_id)
        event = Event("upload.abort", "upload", row.id, row.path, project_id, mission_id=row.mission_id)
        await audit(db, actor, event)


async def get_upload(context: AppContext, actor: Actor, *, upload_id: uuid.UUID) -> UploadRead:
    """Return an upload with the parts that the store has.

    Raises:
        NotFound: the actor began no such upload.
    """
    async with context.database.begin() as db:
        rows = await queries.read_rows(db, queries.own_uploads(actor).where(upload.c.id == upload_id))
    if not rows:
        raise NotFound(resource_type="upload", ref=str(upload_id))
    [row] = rows
    parts: list[protocol.StoredPart] | None = None
    if row.state == UploadState.open.value and row.multipart_id is not None:
        parts = await context.storage.list_parts(row.key, row.multipart_id)
    elif row.state == UploadState.open.value:
        parts = (await stored_small_files(context.storage, rows)).get(row.id)
    return to_upload_read(row, parts or [])


async def list_uploads(db: Connection, actor: Actor, *, mission_id: uuid.UUID, page: PageRequest) -> Page[UploadRead]:
    """Return the open uploads into a mission, oldest first, without asking the store for their parts.

    Raises:
        NotFound: the actor may not see such a mission.
        Forbidden: the actor may see it, but not upload into it.
    """
    await require_mission(db, actor, "list_uploads", mission_id)
    statement = queries.own_uploads(actor).where(upload.c.mission_id == mission_id, upload.c.state.in_(UNDER_WAY))
    rows = await fetch_page(db, statement, Order([upload.c.created_at, upload.c.id]), page)
    return Page(
        items=[to_upload_read(queries.to_upload(row), []) for row in rows.items], next=rows.next, total=rows.total
    )
