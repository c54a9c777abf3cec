"""Operations on files. Renaming and moving change rows, and never an object in the store."""

import datetime
import uuid
from collections.abc import Collection, Sequence
from dataclasses import replace

from sqlalchemy import func

from kleinkram.contract.access import Right
from kleinkram.contract.base import Page
from kleinkram.contract.errors import FieldProblem, FileUnavailable, Forbidden, InvalidRequest, KleinkramError, NotFound
from kleinkram.contract.files import (
    BlobState,
    DownloadLink,
    FetchPurpose,
    FileFilter,
    FileRead,
    FileSort,
    FileUpdate,
    TopicRead,
)
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.missions import MissionFilter
from kleinkram.contract.names import name_key
from kleinkram.contract.problems import to_problem
from kleinkram.contract.projects import Deleted
from kleinkram.contract.search import FileLabelled, LabelChange
from kleinkram.server import metrics
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.rights import require_match, require_mission
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.blobs.service import verify_again
from kleinkram.server.context import AppContext
from kleinkram.server.db import Connection
from kleinkram.server.files import queries
from kleinkram.server.files.paths import check_path_free
from kleinkram.server.files.queries import FileWithBlob
from kleinkram.server.filters.plan import NO_PLAN, SearchPlan, find_visible_mission_ids, prepare_statement
from kleinkram.server.missions import service as missions
from kleinkram.server.pagination import PageRequest, execute_after, read_listing, values_after
from kleinkram.server.quotas import Amount, project_of, require_room
from kleinkram.server.recordings.derive import derive_again
from kleinkram.server.shares.service import count_downloads

_UNREADABLE = {BlobState.lost, BlobState.corrupt}
_BY_PATH = {FileSort.path, FileSort.path_desc}
# A page of a list by path is first looked for among the files of so many missions.
_FIRST_MISSIONS = 64
# The most visible missions whose files are all sorted for a list. Of more, pages are read in the order of an index,
# since other conditions than a label may hold for most files.
_MAX_SORTED_MISSIONS = 32
_FETCHED = {FetchPurpose.download: "file.download", FetchPurpose.preview: "file.preview"}


async def read_files(db: Connection, actor: Actor, file_ids: Sequence[uuid.UUID]) -> list[FileRead]:
    """Return files in the given order, by one query. Raises NotFound."""
    return [stored.read for stored in await _stored_files(db, actor, file_ids)]


async def read_visible_files(db: Connection, actor: Actor, file_ids: Collection[uuid.UUID]) -> list[FileRead]:
    """Return those of the files that are visible to this actor, in no order, by one query."""
    return queries.to_files((await db.execute(queries.files_by_id(actor, file_ids))).all())


async def get_file(db: Connection, actor: Actor, file_id: uuid.UUID) -> FileRead:
    """Return one file. Raises NotFound."""
    return (await read_files(db, actor, [file_id]))[0]


async def stored_file(db: Connection, actor: Actor, file_id: uuid.UUID) -> FileWithBlob:
    """Return one file with its blob. Raises NotFound."""
    return (await _stored_files(db, actor, [file_id]))[0]


async def _stored_files(db: Connection, actor: Actor, file_ids: Sequence[uuid.UUID]) -> list[FileWithBlob]:
    rows = (await db.execute(queries.files_by_id(actor, file_ids))).all()
    stored = queries.to_stored_files(rows)
    for file_id in file_ids:
        if file_id not in stored:
            raise NotFound(resource_type="file", ref=str(file_id))
    return [stored[file_id] for file_id in file_ids]


async def list_files(
    db: Connection,
    actor: Actor,
    *,
    matching: FileFilter,
    sort: FileSort,
    page: PageRequest,
    plan: SearchPlan = NO_PLAN,
) -> Page[FileRead]:
    """Return a page of the files that match. Raises InvalidQuery for an invalid `where`, or InvalidCursor."""
    if page.count and matching == FileFilter():
        total = int((await db.execute(*prepare_statement(queries.count_all, actor))).scalar_one())
        listed = await list_files(db, actor, matching=matching, sort=sort, page=replace(page, count=False))
        return listed.model_copy(update={"total": total})
    if plan is NO_PLAN and matching.mission_id is None:
        # Few files have a label: those of all visible missions are sorted.
        at_most = None if matching.label else _MAX_SORTED_MISSIONS
        plan = replace(NO_PLAN, mission_ids=await find_visible_mission_ids(db, actor, at_most=at_most))
    if sort in _BY_PATH and not page.count and matching.mission_id is None and not plan.is_selective:
        from_first = await _list_first_missions(db, actor, matching, sort, page)
        if from_first is not None:
            return from_first
    listing, values = prepare_statement(queries.file_listing, actor, matching, plan=plan, sort=sort)
    return await read_listing(db, listing, page, values)


async def _list_first_missions(
    db: Connection, actor: Actor, matching: FileFilter, sort: FileSort, page: PageRequest
) -> Page[FileRead] | None:
    """Return a page of a list by path from the first missions alone, so that the files of the others are not sorted.

    None where they do not fill the page, and there are more missions.
    """
    order = queries.file_order(sort)
    after = values_after(page, order)
    first, values = prepare_statement(
        queries.first_missions,
        actor,
        MissionFilter(project_id=matching.project_id),
        is_first=after is None,
        descending=order.descending,
        limit=_FIRST_MISSIONS,
    )
    mission_ids = [str(row.id) for row in await execute_after(db, first, after, values)]
    plan = replace(NO_PLAN, mission_ids=f"{{{','.join(mission_ids)}}}")
    listing, values = prepare_statement(queries.file_listing, actor, matching, plan=plan, sort=sort)
    listed = await read_listing(db, listing, page, values)
    return listed if listed.next is not None or len(mission_ids) < _FIRST_MISSIONS else None


async def list_topics(db: Connection, actor: Actor, *, file_id: uuid.UUID, page: PageRequest) -> Page[TopicRead]:
    """Return a page of one file's topics, by name. Raises NotFound or InvalidCursor."""
    topics = await read_listing(db, queries.topic_listing(queries.topics_of_file(actor, file_id)), page)
    if not topics.items:
        await get_file(db, actor, file_id)
    return topics


async def update_file(
    db: Connection, actor: Actor, *, file_id: uuid.UUID, changes: FileUpdate, if_match: str | None = None
) -> FileRead:
    """Rename, move or label a file and return it; the recordings of both missions are derived again.

    Raises:
        NotFound: the file, or the mission to move it to, does not exist.
        Forbidden: the change requires a right that the actor lacks on this or the other mission.
        NameTaken: there is a file of that path.
        QuotaExceeded: the other project has no room for it.
        PathConflict: the path is a folder there, or needs a folder where a file is.
        EditConflict: its ETag is not the one in `if_match`, and the change is not made already.
    """
    old = (await _lock_file(db, actor, file_id, *filter(None, [changes.mission_id]))).read
    mission_id = changes.mission_id or old.mission.id
    moves = mission_id != old.mission.id
    await require_mission(db, actor, "move_file" if moves else "update_file", old.mission.id)
    if moves:
        await require_mission(db, actor, "begin_uploads", mission_id)
    path = changes.path or old.path
    labels = old.labels if changes.labels is None else list(dict.fromkeys(changes.labels))
    values: dict[str, object] = {} if labels == old.labels else {"labels": labels}
    if moves or path != old.path:
        values |= {"mission_id": mission_id, "path": path, "path_key": name_key(path)}
    if not values:
        return old
    require_match(if_match, old.etag, resource_type="file", name=old.path)
    if "path" in values:
        if moves and (project_id := await project_of(db, mission_id)) != old.mission.project.id:
            await require_room(db, actor, project_id=project_id, requested=Amount(1, old.size_bytes))
        await check_path_free(db, mission_id, path, except_id=old.id)
        for affected_id in sorted({old.mission.id, mission_id}):
            await derive_again(db, affected_id)
    await db.execute(queries.change_file(file_id, **values))
    new = await get_file(db, actor, file_id)
    await audit(db, actor, *_change_events(old, new))
    return new


async def delete_file(db: Connection, actor: Actor, *, file_id: uuid.UUID, dry_run: bool) -> Deleted:
    """Move a file to the trash; its path is free at once. With `dry_run`, only report what would be deleted.

    The right to add files suffices for a file that the actor uploaded in the last hour.

    Raises:
        NotFound: the file does not exist, or is not visible.
        Forbidden: the actor may not delete it.
    """
    old = await get_file(db, actor, file_id) if dry_run else (await _lock_file(db, actor, file_id)).read
    is_own = (await db.execute(queries.own_fresh_file(actor, file_id))).first() is not None
    takes = "begin_uploads" if is_own else "delete_file"
    await require_mission(db, actor, takes, old.mission.id)
    if not dry_run:
        await derive_again(db, old.mission.id)
        await db.execute(queries.change_file(file_id, deleted_at=func.now(), deleted_by_id=actor.person_id))
        before: Metadata = {"path": old.path, "mission": old.mission.name}
        await audit(db, actor, file_event("file.delete", old, before, takes=takes))
    runs = (await db.execute(queries.runs_that_read(actor, file_id))).scalar_one()
    made = list((await db.execute(queries.derived_from(actor, file_id))).scalars()) if runs else []
    usage = {"read_by_runs": runs, "made_from_it": made}
    return Deleted(missions=0, files=1, size_bytes=old.size_bytes, dry_run=dry_run, **usage)


async def link_files(
    context: AppContext, actor: Actor, *, file_ids: Sequence[uuid.UUID], purpose: FetchPurpose
) -> list[DownloadLink]:
    """Return URLs of files in the given order, and record who downloads or previews them.

    Raises:
        NotFound: one of them does not exist, or is not visible.
        FileUnavailable: the stored copy of one is lost or corrupt.
    """
    async with context.database.begin() as db:
        stored = await _readable_files(db, actor, file_ids)
        await audit(db, actor, *[file_event(_FETCHED[purpose], one.read) for one in stored])
        amount = {"files": len(stored), "size_bytes": sum(one.read.size_bytes for one in stored)}
        await count_downloads(db, actor, **amount)
    metrics.count_downloads(**amount)
    expires_s = context.settings.download_url_s
    expires_at = datetime.datetime.now(datetime.timezone.utc) + datetime.timedelta(seconds=expires_s)
    return [
        DownloadLink(
            file_id=read.id,
            path=read.path,
            size_bytes=read.size_bytes,
            sha256=read.sha256,
            crc64nvme=read.crc64nvme,
            state=read.state,
            url=context.storage.sign_get(key, path=read.path, expires_s=expires_s),
            expires_at=expires_at,
        )
        for read, _, key in stored
    ]


async def record_slice(db: Connection, actor: Actor, *, file_id: uuid.UUID, selection: Metadata) -> FileWithBlob:
    """Return a file with its key, and record that somebody downloads a slice of it; `selection` is for the audit log.

    Raises:
        NotFound: it does not exist, or is not visible.
        FileUnavailable: the stored copy is lost or corrupt.
    """
    (stored,) = await _readable_files(db, actor, [file_id])
    await audit(db, actor, file_event("file.download", stored.read, after=selection))
    await count_downloads(db, actor, files=1, size_bytes=0)
    return stored


async def _readable_files(db: Connection, actor: Actor, file_ids: Sequence[uuid.UUID]) -> list[FileWithBlob]:
    stored = await _stored_files(db, actor, file_ids)
    for one in stored:
        if one.read.state in _UNREADABLE:
            raise FileUnavailable(path=one.read.path, state=one.read.state.value)
    return stored


async def verify_file(db: Connection, actor: Actor, *, file_id: uuid.UUID) -> FileRead:
    """Have the bytes of a file verified again soon, and return the file as it is now. Raises NotFound."""
    (stored,) = await _stored_files(db, actor, [file_id])
    await verify_again(db, stored.blob_id)
    await audit(db, actor, file_event("file.verify", stored.read))
    return stored.read


async def _lock_file(db: Connection, actor: Actor, file_id: uuid.UUID, *also: uuid.UUID) -> FileWithBlob:
    """Return a file that nobody else can change in this transaction; locks its mission, and the missions `also`."""
    (stored,) = await _stored_files(db, actor, [file_id])
    while True:
        locked = {stored.read.mission.id, *also}
        await missions.lock_missions(db, locked)
        (stored,) = await _stored_files(db, actor, [file_id])
        if stored.read.mission.id in locked:
            return stored
        # It was moved before the lock was acquired. The locks held now are out of order: if that leads to a deadlock,
        # the database aborts one of the two transactions, and its client retries.


def file_event(
    operation: str,
    changed: FileRead,
    before: Metadata | None = None,
    after: Metadata | None = None,
    *,
    takes: str | None = None,
) -> Event:
    """Return the audit event of an operation on a file."""
    mission, before, after = changed.mission, before or {}, after or {}
    return Event(operation, "file", changed.id, changed.path, mission.project.id, before, after, mission.id, takes)


def _change_events(old: FileRead, new: FileRead) -> list[Event]:
    """Return the audit events of a change. After a move between projects, neither names the other to its owners."""
    versions: list[Metadata] = [
        {"path": one.path, "labels": [*one.labels], "mission": one.mission.name, "project": one.mission.project.name}
        for one in (old, new)
    ]
    differing = [name for name in versions[0] if versions[0][name] != versions[1][name]]
    before, after = ({name: version[name] for name in differing} for version in versions)
    if old.mission.id == new.mission.id:
        return [file_event("file.update", new, before, after)]
    left: Metadata = {"path": old.path, "mission": old.mission.name}
    if old.mission.project.id != new.mission.project.id:
        before = {name: value for name, value in before.items() if name not in {"mission", "project"}}
    arrival = file_event("file.move_in", new, before, after, takes="begin_uploads")
    return [file_event("file.move_out", old, left, takes="move_file"), arrival]


# The most labels of one file.
MAX_LABELS = 50


async def label_files(db: Connection, actor: Actor, *, change: LabelChange) -> list[FileLabelled]:
    """Add labels to files and remove labels from them; return the outcome for each, in the order of the request.

    A file that is not visible, or that this actor may not change, does not keep the others from being labelled.
    """
    locked: set[uuid.UUID] = set()
    while True:
        files = {one.id: one for one in await read_visible_files(db, actor, change.file_ids)}
        unlocked = {one.mission.id for one in files.values()} - locked
        if not unlocked:
            break
        await missions.lock_missions(db, unlocked)
        locked |= unlocked
    writable = set((await db.execute(queries.ids_among(actor, files, Right.write))).scalars())
    outcomes = {file_id: _new_labels(files.get(file_id), file_id, writable, change) for file_id in change.file_ids}
    new = {file_id: labels for file_id, labels in outcomes.items() if isinstance(labels, list)}
    changed = {file_id: labels for file_id, labels in new.items() if labels != files[file_id].labels}
    if changed:
        values = [{"ref": file_id, "new_labels": labels} for file_id, labels in changed.items()]
        await db.execute(queries.set_labels(), values)
    events = [
        file_event("file.update", files[file_id], {"labels": [*files[file_id].labels]}, {"labels": [*labels]})
        for file_id, labels in changed.items()
    ]
    await audit(db, actor, *events)
    return [
        FileLabelled(file_id=file_id, labels=outcome, problem=None)
        if isinstance(outcome := outcomes[file_id], list)
        else FileLabelled(file_id=file_id, labels=None, problem=to_problem(outcome, actor.request_id))
        for file_id in change.file_ids
    ]


def _new_labels(
    read: FileRead | None, file_id: uuid.UUID, writable: Collection[uuid.UUID], change: LabelChange
) -> list[str] | KleinkramError:
    if read is None:
        return NotFound(resource_type="file", ref=str(file_id))
    if file_id not in writable:
        return Forbidden(resource_type="mission", operation="label files", needs=Right.write.value)
    removed = set(change.remove) - set(change.add)
    labels = [label for label in dict.fromkeys([*read.labels, *change.add]) if label not in removed]
    if len(labels) > MAX_LABELS:
        message = f"{read.path} would have {len(labels)} labels; {MAX_LABELS} are allowed"
        return InvalidRequest(problems=[FieldProblem(field="add", message=message)])
    return labels
