"""Operations on files. Renaming and moving change rows; no object in the store is ever touched."""

import datetime
import uuid
from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Any

from sqlalchemy import Row, func

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
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.rights import require_mission
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.blobs.service import verify_again
from kleinkram.server.context import AppContext
from kleinkram.server.db import Connection
from kleinkram.server.files import queries
from kleinkram.server.files.paths import check_path_free
from kleinkram.server.files.queries import TOPIC_ORDER, to_topics
from kleinkram.server.filters.plan import NO_PLAN, SearchPlan
from kleinkram.server.filters.prepared import prepare
from kleinkram.server.http.headers import require_match
from kleinkram.server.missions import service as missions
from kleinkram.server.pagination import PageRequest, Rows, execute_after, fetch_listing, fetch_page, values_after
from kleinkram.server.quotas import Amount, project_of, require_room
from kleinkram.server.recordings.service import regroup
from kleinkram.server.shares.service import count_downloads

_UNREADABLE = {BlobState.lost.value, BlobState.corrupt.value}
_BY_PATH = {FileSort.path, FileSort.path_desc}
# The first page of a list by path is looked for among the files of so many missions.
_FIRST_MISSIONS = 64
_FETCHED = {FetchPurpose.download: "file.download", FetchPurpose.preview: "file.preview"}


async def read_files(db: Connection, actor: Actor, file_ids: Sequence[uuid.UUID]) -> list[FileRead]:
    """Return files in the order asked, by one query.

    Raises:
        NotFound: one of them is not there, or not for this actor.
    """
    return queries.to_files(await _rows(db, actor, file_ids))


async def read_visible_files(db: Connection, actor: Actor, file_ids: Collection[uuid.UUID]) -> list[FileRead]:
    """Return those of the files that are there for this actor, in no order, by one query."""
    return queries.to_files(await rows_by_id(db, actor, file_ids))


async def rows_by_id(db: Connection, actor: Actor, file_ids: Collection[uuid.UUID]) -> Sequence[Row[Any]]:
    """Return the rows of those of the files that are there for this actor, in no order."""
    return (await db.execute(queries.files_by_id(actor, file_ids))).all()


async def get_file(db: Connection, actor: Actor, file_id: uuid.UUID) -> FileRead:
    """Return one file.

    Raises:
        NotFound: it is not there, or not for this actor.
    """
    return (await read_files(db, actor, [file_id]))[0]


async def list_files(
    db: Connection,
    actor: Actor,
    *,
    matching: FileFilter,
    sort: FileSort,
    page: PageRequest,
    plan: SearchPlan = NO_PLAN,
) -> Page[FileRead]:
    """Return a page of the files that match.

    Raises:
        InvalidQuery: a `where` cannot be used.
        InvalidCursor: the cursor is not of this list.
    """
    if page.count and matching == FileFilter():
        total = int((await db.execute(*prepare(queries.count_all, actor))).scalar_one())
        listed = await list_files(db, actor, matching=matching, sort=sort, page=replace(page, count=False))
        return listed.model_copy(update={"total": total})
    if plan is NO_PLAN and matching.mission_id is None:
        plan = replace(NO_PLAN, mission_ids=await missions.find_visible_mission_ids(db, actor))
    rows = None
    if sort in _BY_PATH and not page.count and matching.mission_id is None and not plan.is_selective:
        rows = await _page_of_first_missions(db, actor, matching, sort, page)
    if rows is None:
        listing, values = prepare(queries.file_listing, actor, matching, plan=plan, sort=sort)
        rows = await fetch_listing(db, listing, page, values)
    return Page(items=queries.to_files(rows.items), next=rows.next, total=rows.total)


async def _page_of_first_missions(
    db: Connection, actor: Actor, matching: FileFilter, sort: FileSort, page: PageRequest
) -> Rows | None:
    """Return a page of a list by path where the first missions fill it, so that the others' files are not sorted.

    None where they do not fill it, or where there are no more missions.
    """
    order = queries.file_order(sort)
    after = values_after(page, order)
    first, values = prepare(
        queries.first_missions,
        actor,
        MissionFilter(project_id=matching.project_id),
        is_first=after is None,
        descending=order.descending,
        limit=_FIRST_MISSIONS,
    )
    mission_ids = [row.id for row in await execute_after(db, first, after, values)]
    plan = replace(NO_PLAN, mission_ids=mission_ids)
    listing, values = prepare(queries.file_listing, actor, matching, plan=plan, sort=sort)
    rows = await fetch_listing(db, listing, page, values)
    return rows if rows.next is not None or len(mission_ids) < _FIRST_MISSIONS else None


async def list_topics(db: Connection, actor: Actor, *, file_id: uuid.UUID, page: PageRequest) -> Page[TopicRead]:
    """Return a page of one file's topics, by name.

    Raises:
        NotFound: the file is not there, or not for this actor.
    """
    rows = await fetch_page(db, queries.topics_of_file(actor, file_id), TOPIC_ORDER, page)
    if not rows.items:
        await _row(db, actor, file_id)
    return Page(items=to_topics(rows.items), next=rows.next, total=rows.total)


async def update_file(
    db: Connection, actor: Actor, *, file_id: uuid.UUID, changes: FileUpdate, if_match: str | None = None
) -> FileRead:
    """Rename, move or label a file and return it; recordings on both sides are derived anew.

    Raises:
        NotFound: the file, or the mission to move it to, is not there.
        Forbidden: the change takes more than they hold here, or, for a move, there.
        NameTaken: there is a file of that path.
        QuotaExceeded: the project to move it to has no room for it.
        PathConflict: the path is a folder there, or needs a folder where a file is.
        EditConflict: it is not of the ETag in `if_match` any more, and what is asked for is not so already.
    """
    old = await _locked_row(db, actor, file_id, *filter(None, [changes.mission_id]))
    mission_id = changes.mission_id or old.mission_id
    await require_mission(db, actor, "update_file" if mission_id == old.mission_id else "move_file", old.mission_id)
    if mission_id != old.mission_id:
        await require_mission(db, actor, "begin_uploads", mission_id)
    path = changes.path or old.path
    labels = old.labels if changes.labels is None else list(dict.fromkeys(changes.labels))
    if (mission_id, path, labels) != (old.mission_id, old.path, old.labels):
        require_match(if_match, queries.to_file(old).etag, noun="file", name=old.path)
    values: dict[str, Any] = {}
    if labels != old.labels:
        values["labels"] = labels
    if (mission_id, path) != (old.mission_id, old.path):
        if mission_id != old.mission_id and (project_id := await project_of(db, mission_id)) != old.project_id:
            await require_room(db, actor, project_id=project_id, requested=Amount(1, old.size_bytes))
        await _check_move(db, actor, old, mission_id=mission_id, path=path)
        values |= {"mission_id": mission_id, "path": path, "path_key": name_key(path)}
    if not values:
        return queries.to_file(old)
    await db.execute(queries.change_file(file_id, **values))
    new = await _row(db, actor, file_id)
    await audit(db, actor, *_changes(old, new))
    return queries.to_file(new)


async def delete_file(db: Connection, actor: Actor, *, file_id: uuid.UUID, dry_run: bool) -> Deleted:
    """Move a file to the trash; its path is free at once. As a dry run, only say what would go.

    What one brought oneself, one may delete within the hour.

    Raises:
        NotFound: it is not there, or not for this actor.
        Forbidden: they may see it, but not delete it.
    """
    row = await (_row if dry_run else _locked_row)(db, actor, file_id)
    takes = "begin_uploads" if (await db.execute(queries.own_fresh_file(actor, file_id))).first() else "delete_file"
    await require_mission(db, actor, takes, row.mission_id)
    if not dry_run:
        await regroup(db, row.mission_id)
        await db.execute(queries.change_file(file_id, deleted_at=func.now(), deleted_by_id=actor.person_id))
        before: Metadata = {"path": row.path, "mission": row.mission_name}
        await audit(db, actor, _event("file.delete", row, before, takes=takes))
    runs, made = await _come_of_it(db, actor, file_id)
    summary = {"size_bytes": row.size_bytes, "dry_run": dry_run, "read_by_runs": runs, "made_from_it": made}
    return Deleted(missions=0, files=1, **summary)


async def _come_of_it(db: Connection, actor: Actor, file_id: uuid.UUID) -> tuple[int, list[str]]:
    """Return how many runs read a file, and the paths of the files that they made of it, as far as these are shown."""
    runs = (await db.execute(queries.runs_that_read(actor, file_id))).scalar_one()
    if not runs:
        return 0, []
    return runs, list((await db.execute(queries.made_from(actor, file_id))).scalars())


async def link_files(
    context: AppContext, actor: Actor, *, file_ids: Sequence[uuid.UUID], purpose: FetchPurpose
) -> list[DownloadLink]:
    """Return where to read files, in the order asked, and note who fetched them, or looked into them.

    Raises:
        NotFound: one of them is not there, or not for this actor.
        FileUnavailable: the store's copy of one is lost or corrupt.
    """
    async with context.database.begin() as db:
        rows = await _rows(db, actor, file_ids)
        for row in rows:
            if row.state in _UNREADABLE:
                raise FileUnavailable(path=row.path, state=row.state)
        await audit(db, actor, *[_event(_FETCHED[purpose], row) for row in rows])
        await count_downloads(db, actor, files=len(rows), size_bytes=sum(row.size_bytes for row in rows))
    return [_link(context, row) for row in rows]


async def verify_file(db: Connection, actor: Actor, *, file_id: uuid.UUID) -> FileRead:
    """Have a file's bytes read again soon, and return the file as it is known now.

    Raises:
        NotFound: it is not there, or not for this actor.
    """
    row = await _row(db, actor, file_id)
    await verify_again(db, row.blob_id)
    await audit(db, actor, _event("file.verify", row))
    return queries.to_file(row)


async def _rows(db: Connection, actor: Actor, file_ids: Sequence[uuid.UUID]) -> list[Row[Any]]:
    rows = {row.id: row for row in await rows_by_id(db, actor, file_ids)}
    for file_id in file_ids:
        if file_id not in rows:
            raise NotFound(noun="file", ref=str(file_id))
    return [rows[file_id] for file_id in file_ids]


async def _row(db: Connection, actor: Actor, file_id: uuid.UUID) -> Row[Any]:
    return (await _rows(db, actor, [file_id]))[0]


async def _locked_row(db: Connection, actor: Actor, file_id: uuid.UUID, *also: uuid.UUID) -> Row[Any]:
    """Return a file as it stays until the transaction ends: its mission is locked, and the missions `also` with it."""
    row = await _row(db, actor, file_id)
    while True:
        locked = {row.mission_id, *also}
        await missions.lock_missions(db, locked)
        row = await _row(db, actor, file_id)
        if row.mission_id in locked:
            return row
        # Moved while it was waited for. What is held already is held out of order now; should that meet another who
        # does the same the other way round, the database ends one of the two, who is told to try again.


async def _check_move(db: Connection, actor: Actor, old: Row[Any], *, mission_id: uuid.UUID, path: str) -> None:
    await check_path_free(db, mission_id, path, except_id=old.id)
    for affected_id in sorted({old.mission_id, mission_id}):
        await regroup(db, affected_id)


def _event(
    operation: str,
    row: Row[Any],
    before: Metadata | None = None,
    after: Metadata | None = None,
    *,
    takes: str | None = None,
) -> Event:
    return Event(operation, "file", row.id, row.path, row.project_id, before or {}, after or {}, row.mission_id, takes)


def _changes(old: Row[Any], new: Row[Any]) -> list[Event]:
    """Return what the record says of a change. Of a move between projects, neither names the other to its owners."""
    before, after = _changed(old, new)
    if old.mission_id == new.mission_id:
        return [_event("file.update", new, before, after)]
    left: Metadata = {"path": old.path, "mission": old.mission_name}
    if old.project_id != new.project_id:
        before = {name: value for name, value in before.items() if name not in {"mission", "project"}}
    came = _event("file.arrive", new, before, after, takes="begin_uploads")
    return [_event("file.leave", old, left, takes="move_file"), came]


def _changed(old: Row[Any], new: Row[Any]) -> tuple[Metadata, Metadata]:
    names = {"path": "path", "labels": "labels", "mission_name": "mission", "project_name": "project"}
    differing = [(column, word) for column, word in names.items() if old._mapping[column] != new._mapping[column]]
    return (
        {word: old._mapping[column] for column, word in differing},
        {word: new._mapping[column] for column, word in differing},
    )


def _link(context: AppContext, row: Row[Any]) -> DownloadLink:
    expires_s = context.settings.download_url_s
    expires_at = datetime.datetime.now(datetime.timezone.utc) + datetime.timedelta(seconds=expires_s)
    url = context.storage.sign_get(row.key, path=row.path, expires_s=expires_s)
    seen = queries.to_file(row)
    return DownloadLink(
        file_id=seen.id,
        path=seen.path,
        size_bytes=seen.size_bytes,
        sha256=seen.sha256,
        crc64nvme=seen.crc64nvme,
        state=seen.state,
        url=url,
        expires_at=expires_at,
    )


# As many as one file may carry.
MAX_LABELS = 50


async def label_files(db: Connection, actor: Actor, *, change: LabelChange) -> list[FileLabelled]:
    """Put labels on files and take labels off them; return the outcome for each, in the order of the request.

    A file that is not there, or may not be changed by this actor, keeps no other from being labelled.
    """
    locked: set[uuid.UUID] = set()
    while True:
        rows = {row.id: row for row in await rows_by_id(db, actor, change.file_ids)}
        unlocked = {row.mission_id for row in rows.values()} - locked
        if not unlocked:
            break
        await missions.lock_missions(db, unlocked)
        locked |= unlocked
    writable = {row.id for row in await db.execute(queries.ids_among(actor, rows, Right.write))}
    outcomes = {file_id: _new_labels(rows.get(file_id), file_id, writable, change) for file_id in change.file_ids}
    new = {file_id: labels for file_id, labels in outcomes.items() if isinstance(labels, list)}
    changed = {file_id: labels for file_id, labels in new.items() if labels != rows[file_id].labels}
    if changed:
        values = [{"ref": file_id, "new_labels": labels} for file_id, labels in changed.items()]
        await db.execute(queries.set_labels(), values)
    events = [
        _event("file.update", rows[file_id], {"labels": rows[file_id].labels}, {"labels": [*labels]})
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
    row: Row[Any] | None, file_id: uuid.UUID, writable: Collection[uuid.UUID], change: LabelChange
) -> list[str] | KleinkramError:
    if row is None:
        return NotFound(noun="file", ref=str(file_id))
    if file_id not in writable:
        return Forbidden(noun="mission", operation="label files", needs=Right.write.value)
    removed = set(change.remove) - set(change.add)
    labels = [label for label in dict.fromkeys([*row.labels, *change.add]) if label not in removed]
    if len(labels) > MAX_LABELS:
        message = f"{row.path} would have {len(labels)} labels; {MAX_LABELS} are allowed"
        return InvalidRequest(problems=[FieldProblem(field="add", message=message)])
    return labels
