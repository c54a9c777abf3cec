"""The upload protocol up to its last part, each step as mark -> store -> finish.

The store is never asked inside a transaction, and a name is never held without a row that says until when.
"""

import asyncio
import datetime
import uuid
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

from sqlalchemy import Row, func, select, update

from kleinkram.contract.errors import NameLeased, NotFound, PathConflict, StoreUnavailable
from kleinkram.contract.events import ChangeKind
from kleinkram.contract.files import FileRead
from kleinkram.contract.names import name_key
from kleinkram.contract.paging import Page
from kleinkram.contract.problems import to_problem
from kleinkram.contract.rights import Scope
from kleinkram.contract.uploads import (
    ChecksumKind,
    HashFirst,
    HeldPart,
    Linked,
    Present,
    Refused,
    Send,
    UploadDecision,
    UploadFile,
    UploadRead,
    UploadState,
    part_size_bytes,
)
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.rights import require_mission
from kleinkram.server.audit.service import Event, record
from kleinkram.server.change_events import ChangeEvent, publish
from kleinkram.server.context import AppContext
from kleinkram.server.db import Connection, among, upsert_rows
from kleinkram.server.files import service as files
from kleinkram.server.files.paths import path_conflicts
from kleinkram.server.missions import service as missions
from kleinkram.server.paging import Order, PageRequest, fetch_page
from kleinkram.server.quotas.service import Amount, project_of, require_room
from kleinkram.server.tables import mission, upload
from kleinkram.server.tables.upload import UNDER_WAY
from kleinkram.server.uploads import queries
from kleinkram.server.uploads.joining import held_whole
from kleinkram.server.uploads.linking import link_twins
from kleinkram.server.uploads.rules import Decision, Known, Way, as_shown, content_of, decide, first_come
from kleinkram.server.uploads.signing_parts import first_checksum, is_multipart, renewed, sign_first

_AT_ONCE = 16


async def begin_uploads(
    context: AppContext, actor: Actor, *, mission_id: uuid.UUID, wanted: Sequence[UploadFile]
) -> list[UploadDecision]:
    """Decide about each file, hold the names of those to be sent, and open them at the store.

    Idempotent: asked again with the upload's id, an upload goes on where it was.

    Raises:
        NotFound: no such mission for `actor`.
        Forbidden: they may see it, but put nothing into it.
        QuotaExceeded: its project has no room for those that are not there yet; none of them was begun.
    """
    async with context.database.begin() as db:
        await missions.lock_mission_to_fill(db, actor, mission_id)
        decisions, asked = await _decide_all(db, actor, mission_id=mission_id, wanted=wanted)
        await _take_over(db, decisions)
        await require_room(db, actor, project_id=await project_of(db, mission_id), asked=asked)
        decisions = await _hold_names(db, context, actor, mission_id=mission_id, decisions=decisions)
        decisions = await link_twins(db, actor, mission_id=mission_id, decisions=decisions)
        held = [decision.ref for decision in decisions if decision.way in {Way.begin, Way.resume} and decision.ref]
        rows = await queries.locked_uploads(db, actor, held)
    try:
        multipart = [row for row in rows.values() if is_multipart(row)]
        resumed = {decision.ref for decision in decisions if decision.way is Way.resume and decision.ref}
        parts = await open_at_store(context, multipart, resumed=resumed) if multipart else {}
        # So much may be sent and not yet completed that to send it again would take long.
        parts |= await held_whole(context.storage, [rows[each] for each in resumed])
    except StoreUnavailable:
        await let_go(context, [decision.ref for decision in decisions if decision.way is Way.begin])
        raise
    reads: dict[uuid.UUID, FileRead] = {}
    if refs := [d.ref for d in decisions if d.way in {Way.present, Way.link} and d.ref]:
        async with context.database.begin() as db:
            reads = {read.id: read for read in await files.read_visible_files(db, actor, refs)}
    return [_answer(context, actor, decision, rows, parts, reads) for decision in decisions]


async def let_go(context: AppContext, upload_ids: Sequence[uuid.UUID | None]) -> None:
    """Free names whose holder never heard of it."""
    async with context.database.begin() as db:
        unheard = upload.c.id.in_([each for each in upload_ids if each]) & (upload.c.state == UploadState.open.value)
        await db.execute(update(upload).where(unheard).values(state=UploadState.aborted.value))


async def _decide_all(
    db: Connection, actor: Actor, *, mission_id: uuid.UUID, wanted: Sequence[UploadFile]
) -> tuple[list[Decision], Amount]:
    keys = [name_key(each.path) for each in wanted]
    paths = [each.path for each in wanted]
    contents = [content for each in wanted if (content := content_of(each))]
    may_read = Scope.read in actor.scopes
    known = Known(
        person_id=actor.person_id,
        may_read=may_read,
        files=await queries.live_files(db, mission_id, keys),
        uploads=await queries.active_uploads(db, mission_id, keys),
        twin_sizes=frozenset(await queries.twin_sizes(db, actor, [e.size_bytes for e in wanted if not e.sha256])),
        twins=await queries.twins(db, actor, contents) if contents else {},
        conflicts=as_shown(await path_conflicts(db, mission_id, paths), may_read=may_read),
    )
    crowded = first_come(paths)
    decisions = [
        Decision(each, Way.refuse, error=PathConflict(path=each.path, other=crowded[place]))
        if place in crowded
        else decide(each, known)
        for place, each in enumerate(wanted)
    ]
    # What mends a file takes the room that the file has already.
    coming = [each.wanted for each in decisions if each.way in {Way.begin, Way.link}]
    coming = [each for each in coming if name_key(each.path) not in known.files]
    return decisions, Amount(len(coming), sum(each.size_bytes for each in coming))


async def _take_over(db: Connection, decisions: Sequence[Decision]) -> None:
    """End the uploads that had names which are wanted now, and whose leases have run out."""
    lapsed = [decision.takes_over for decision in decisions if decision.takes_over]
    if lapsed:
        await db.execute(update(upload).where(among(upload.c.id, lapsed)).values(state=UploadState.aborted.value))


async def _hold_names(
    db: Connection, context: AppContext, actor: Actor, *, mission_id: uuid.UUID, decisions: list[Decision]
) -> list[Decision]:
    resumed = [decision.ref for decision in decisions if decision.way is Way.resume]
    if resumed:
        await db.execute(
            update(upload).where(among(upload.c.id, resumed)).values(**renewed(context.settings, func.now()))
        )
    begun = [decision for decision in decisions if decision.way is Way.begin]
    if not begun:
        return decisions
    batch = uuid.uuid4()
    # The database's clock, asked once: leases are compared with it, and machines' clocks differ.
    now = (await db.execute(select(func.now()))).scalar_one()
    asked_for = [decision.wanted.upload_id for decision in begun if decision.wanted.upload_id]
    used = await queries.used_ids(db, asked_for) if asked_for else frozenset()
    rows = [new_upload(context, actor.person_id, mission_id, batch, each.wanted, now, used=used) for each in begun]
    statement = upsert_rows(upload, rows).on_conflict_do_nothing().returning(upload.c.id, upload.c.path)
    ids = {row.path: row.id for row in await db.execute(statement)}
    await publish(db, [ChangeEvent("upload", ChangeKind.created, each, mission_id=mission_id) for each in ids.values()])
    return [_held(decision, ids) if decision.way is Way.begin else decision for decision in decisions]


def new_upload(
    context: AppContext,
    person_id: uuid.UUID | None,
    mission_id: uuid.UUID,
    batch: uuid.UUID,
    wanted: UploadFile,
    now: datetime.datetime,
    *,
    used: Collection[uuid.UUID] | None = None,
) -> dict[str, Any]:
    """Return the row of an upload that begins: by the id wished for, where those `used` are told and it is not one."""
    wished = wanted.upload_id
    upload_id = uuid.uuid4() if wished is None or used is None or wished in used else wished
    return {
        "id": upload_id,
        "mission_id": mission_id,
        "person_id": person_id,
        "path": wanted.path,
        "path_key": name_key(wanted.path),
        "size_bytes": wanted.size_bytes,
        "part_size_bytes": part_size_bytes(wanted.size_bytes),
        "checksum": context.storage.checksum.value,
        "signed_checksum": first_checksum(context.storage, wanted),
        "store_id": context.settings.store_id,
        # One prefix a request: its small files are then found with one listing.
        "key": f"{batch}/{upload_id}{_viewable_suffix(wanted.path)}",
        **renewed(context.settings, now),
    }


def _viewable_suffix(path: str) -> str:
    """Return what a key ends with: viewers go by that of an address, and open nothing without."""
    return next((suffix for suffix in (".mcap", ".bag") if path.lower().endswith(suffix)), "")


def _held(decision: Decision, ids: Mapping[str, uuid.UUID]) -> Decision:
    if upload_id := ids.get(decision.wanted.path):
        return replace(decision, ref=upload_id)
    now = datetime.datetime.now(datetime.timezone.utc).isoformat(timespec="seconds")
    return replace(decision, way=Way.refuse, error=NameLeased(path=decision.wanted.path, lease_ends_at=now))


async def open_at_store(
    context: AppContext, rows: Sequence[Row[Any]], *, resumed: Collection[uuid.UUID] = ()
) -> dict[uuid.UUID, list[HeldPart]]:
    """Open the multipart uploads that are not open yet, and return the parts that the store holds of each.

    Of those `resumed`, one may be open whose id was never written down: the process died between.
    """
    gate = asyncio.Semaphore(_AT_ONCE)

    async def open_one(row: Row[Any]) -> tuple[uuid.UUID, str, list[HeldPart]]:
        async with gate:
            if row.multipart_id is not None:
                held = await context.storage.held_parts(row.key, row.multipart_id)
                if held is not None:
                    return row.id, row.multipart_id, held
            elif row.id in resumed:
                for _, multipart_id in await context.storage.open_multiparts(row.key):
                    return row.id, multipart_id, await context.storage.held_parts(row.key, multipart_id) or []
            return row.id, await context.storage.begin_multipart(row.key), []

    answers = await asyncio.gather(*(open_one(row) for row in rows), return_exceptions=True)
    opened = [answer for answer in answers if not isinstance(answer, BaseException)]
    fresh = {row.id: row.multipart_id for row in rows}
    async with context.database.begin() as db:
        for upload_id, multipart_id, _ in opened:
            if fresh[upload_id] != multipart_id:
                await db.execute(update(upload).where(upload.c.id == upload_id).values(multipart_id=multipart_id))
    for answer in answers:
        if isinstance(answer, BaseException):
            raise answer
    return {upload_id: held for upload_id, _, held in opened}


def read_upload(row: Row[Any], held: Sequence[HeldPart]) -> UploadRead:
    """Return an upload as its client sees it."""
    return UploadRead(
        id=row.id,
        mission_id=row.mission_id,
        path=row.path,
        size_bytes=row.size_bytes,
        part_size_bytes=row.part_size_bytes,
        checksum=ChecksumKind(row.checksum),
        state=UploadState(row.state),
        lease_ends_at=row.lease_ends_at,
        expires_at=row.expires_at,
        parts=list(held),
    )


def _answer(
    context: AppContext,
    actor: Actor,
    decision: Decision,
    rows: Mapping[uuid.UUID, Row[Any]],
    parts: Mapping[uuid.UUID, list[HeldPart]],
    reads: Mapping[uuid.UUID, FileRead],
) -> UploadDecision:
    if decision.error is not None:
        return Refused(path=decision.wanted.path, problem=to_problem(decision.error, actor.request_id))
    if decision.way in {Way.begin, Way.resume} and decision.ref is not None:
        row = rows[decision.ref]
        return Send(upload=read_upload(row, parts.get(row.id, [])), part=sign_first(context, row, decision.wanted))
    read = reads.get(decision.ref) if decision.ref else None
    if decision.way is Way.present and Scope.read not in actor.scopes:
        return Present(file=read)
    if read is None:  # also where the file was deleted since: then the answer to asking again is another one
        return HashFirst(path=decision.wanted.path)
    return Present(file=read) if decision.way is Way.present else Linked(file=read)


async def abort_upload(context: AppContext, actor: Actor, *, upload_id: uuid.UUID) -> None:
    """End an upload that is still open; its parts go soon. Nothing happens to one that has ended.

    Raises:
        NotFound: `actor` began no such upload.
    """
    async with context.database.begin() as db:
        rows = await queries.locked_uploads(db, actor, [upload_id])
        if upload_id not in rows:
            raise NotFound(noun="upload", ref=str(upload_id))
        still_open = (upload.c.id == upload_id) & (upload.c.state == UploadState.open.value)
        ended = update(upload).where(still_open).values(state=UploadState.aborted.value)
        if (await db.execute(ended.returning(upload.c.id))).first() is not None:
            await record(db, actor, await _aborted(db, rows[upload_id]))


async def _aborted(db: Connection, row: Row[Any]) -> Event:
    of_mission = select(mission.c.project_id).where(mission.c.id == row.mission_id)
    project_id: uuid.UUID = (await db.execute(of_mission)).scalar_one()
    return Event("upload.abort", "upload", row.id, row.path, project_id, mission_id=row.mission_id)


async def get_upload(context: AppContext, actor: Actor, *, upload_id: uuid.UUID) -> UploadRead:
    """Return an upload with the parts that the store holds.

    Raises:
        NotFound: `actor` began no such upload.
    """
    async with context.database.begin() as db:
        row = (await db.execute(queries.own_uploads(actor).where(upload.c.id == upload_id))).one_or_none()
    if row is None:
        raise NotFound(noun="upload", ref=str(upload_id))
    held: list[HeldPart] | None = None
    if row.state == UploadState.open.value:
        if row.multipart_id is not None:
            held = await context.storage.held_parts(row.key, row.multipart_id)
        else:
            held = (await held_whole(context.storage, [row])).get(row.id)
    return read_upload(row, held or [])


async def list_uploads(db: Connection, actor: Actor, *, mission_id: uuid.UUID, page: PageRequest) -> Page[UploadRead]:
    """Return the uploads under way into a mission, oldest first, without asking the store for their parts.

    Raises:
        NotFound: no such mission for `actor`.
        Forbidden: they may see it, but put nothing into it.
    """
    await require_mission(db, actor, "list_uploads", mission_id)
    statement = queries.own_uploads(actor).where(upload.c.mission_id == mission_id, upload.c.state.in_(UNDER_WAY))
    rows = await fetch_page(db, statement, Order([upload.c.created_at, upload.c.id]), page)
    return Page(items=[read_upload(row, []) for row in rows.items], next=rows.next, total=rows.total)
