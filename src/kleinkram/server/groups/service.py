"""What may be done with groups. Whatever can take somebody's rights away begins with `lock_rights`."""

import uuid
from typing import Any

from sqlalchemy import Row, delete, func, insert, literal, select, update
from sqlalchemy.dialects.postgresql import insert as upsert
from sqlalchemy.exc import IntegrityError

from kleinkram.contract.errors import (
    FieldProblem,
    Forbidden,
    GroupFixed,
    InvalidRequest,
    NameTaken,
    NotFound,
    RightExceeded,
)
from kleinkram.contract.groups import GroupCreate, GroupRead, GroupUpdate, MemberRead, MemberSet
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.names import name_key
from kleinkram.contract.paging import Page
from kleinkram.contract.rights import GroupKind, Right
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.creation import require_creator
from kleinkram.server.access.ownership import ensure_admin_remains, ensure_owner_remains, owned_by_groups
from kleinkram.server.access.rights import lock_rights
from kleinkram.server.access.visible import visible_people
from kleinkram.server.audit.service import Event, record, record_all
from kleinkram.server.db import Connection, violated_constraint
from kleinkram.server.groups import queries
from kleinkram.server.http.etags import require_match
from kleinkram.server.paging import PageRequest, fetch_page
from kleinkram.server.settings import Creators
from kleinkram.server.tables import access_group, membership, person


async def list_groups(db: Connection, actor: Actor, *, name: str | None, page: PageRequest) -> Page[GroupRead]:
    """Return a page of the groups that one is in, by name; admins see all.

    Raises:
        InvalidCursor: the cursor is not of this list.
    """
    rows = await fetch_page(db, queries.matching_groups(actor, name=name), queries.GROUP_ORDER, page)
    return Page(items=[queries.to_group(row) for row in rows.items], next=rows.next, total=rows.total)


async def get_group(db: Connection, actor: Actor, group_id: uuid.UUID) -> GroupRead:
    """Return one group.

    Raises:
        NotFound: it is not there, or not for this actor.
    """
    row = (await db.execute(queries.groups_seen(actor).where(access_group.c.id == group_id))).one_or_none()
    if row is None:
        raise NotFound(noun="group", ref=str(group_id))
    return queries.to_group(row)


async def create_group(db: Connection, actor: Actor, *, wanted: GroupCreate, creators: Creators) -> GroupRead:
    """Make a group, with its maker as first member and editor, and return it.

    Raises:
        Forbidden: the settings let others make groups.
        NameTaken: there is a group of that name, seen or not.
    """
    by_power = await require_creator(db, actor, creators, noun="group")
    group_id = uuid.uuid4()
    values = {"name": wanted.name, "name_key": name_key(wanted.name), "created_by_id": actor.person_id}
    try:
        await db.execute(insert(access_group).values(id=group_id, kind=GroupKind.custom.value, **values))
    except IntegrityError as error:
        raise _name_taken(error, wanted.name) from error
    await db.execute(insert(membership).values(group_id=group_id, person_id=actor.person_id, is_editor=True))
    after: Metadata = {"name": wanted.name, "editor": actor.name}
    event = Event("group.create", "group", group_id, wanted.name, None, after=after, by_power=by_power)
    await record(db, actor, event)
    return await get_group(db, actor, group_id)


async def rename_group(
    db: Connection, actor: Actor, *, group_id: uuid.UUID, changes: GroupUpdate, if_match: str | None = None
) -> GroupRead:
    """Rename a group and return it; where that is its name already, nothing is asked of its ETag.

    Raises:
        NotFound: it is not there, or not for this actor.
        Forbidden: they are no editor of it.
        GroupFixed: its name is in the settings, or ours.
        NameTaken: there is a group of that name, seen or not.
        EditConflict: it is not of the ETag in `if_match` any more.
    """
    await db.execute(select(access_group.c.id).where(access_group.c.id == group_id).with_for_update())
    seen = await _managed(db, actor, group_id, "rename")
    if seen.kind is not GroupKind.custom:
        raise GroupFixed(name=seen.name, reason="its name is fixed")
    if seen.name == changes.name:
        return seen
    require_match(if_match, seen.etag, noun="group", name=seen.name)
    renamed = update(access_group).where(access_group.c.id == group_id)
    try:
        await db.execute(renamed.values(name=changes.name, name_key=name_key(changes.name)))
    except IntegrityError as error:
        raise _name_taken(error, changes.name) from error
    await record(db, actor, _event(seen, "group.rename", {"name": seen.name}, {"name": changes.name}))
    return await get_group(db, actor, group_id)


async def delete_group(db: Connection, actor: Actor, group_id: uuid.UUID) -> None:
    """Delete a group, and with it what was granted to it.

    Raises:
        NotFound: it is not there, or not for this actor.
        Forbidden: they are no editor of it.
        GroupFixed: the settings name it, or it is the admins'.
        LastOwner: it is what owns a project.
    """
    await lock_rights(db)
    seen = await _managed(db, actor, group_id, "delete")
    if seen.kind is GroupKind.admins or seen.domains:
        raise GroupFixed(name=seen.name, reason="it is the group of the admins, or the settings require it")
    owned = await _owned(db, group_id)
    grants = (await db.execute(queries.granted_to(group_id))).all()
    await record_all(
        db, actor, [_event(seen, "group.delete", {"name": seen.name}), *(_revoked(seen, row) for row in grants)]
    )
    await db.execute(delete(access_group).where(access_group.c.id == group_id))
    await ensure_owner_remains(db, owned)


async def list_members(db: Connection, actor: Actor, *, group_id: uuid.UUID, page: PageRequest) -> Page[MemberRead]:
    """Return a page of the people in a group, by name; addresses and those whose time is over are for its editors.

    Raises:
        NotFound: it is not there, or not for this actor.
        InvalidCursor: the cursor is not of this list.
    """
    seen = await get_group(db, actor, group_id)
    stmt = queries.members_of(actor, group_id, for_editor=actor.is_admin or seen.is_editor)
    rows = await fetch_page(db, stmt, queries.MEMBER_ORDER, page)
    return Page(items=[queries.to_member(row) for row in rows.items], next=rows.next, total=rows.total)


async def set_member(
    db: Connection,
    actor: Actor,
    *,
    group_id: uuid.UUID,
    person_id: uuid.UUID,
    wanted: MemberSet,
    if_match: str | None = None,
) -> MemberRead:
    """Put somebody into a group, or change how and until when they are in it, and return that.

    Where it is so already, nothing is asked of the ETag.

    Raises:
        NotFound: the group or the person is not there, or not for this actor; or `if_match` names an ETag, and they
            are in the group no longer.
        Forbidden: they are no editor of it.
        RightExceeded: it is for longer than they are in it themselves.
        GroupFixed: who is in it follows from addresses; only who edits it can be changed.
        InvalidRequest: the end has passed already.
        LastOwner, LastAdmin: somebody would be in it no longer for good, and was the last.
        EditConflict: the membership is not of the ETag in `if_match` any more.
    """
    await lock_rights(db)
    seen = await _managed(db, actor, group_id, "add members")
    old = await _member(db, actor, group_id, person_id)
    name = old.name if old is not None else await _name_of(db, actor, person_id)
    if old is None and if_match is not None:
        raise NotFound(noun="member", ref=str(person_id))
    if seen.kind is GroupKind.affiliation and (old is None or wanted.expires_at is not None):
        raise GroupFixed(name=seen.name, reason="its members follow from their verified addresses")
    if wanted.expires_at is not None:
        passed = select(literal(wanted.expires_at) <= func.now())
        if (await db.execute(passed)).scalar_one():
            raise InvalidRequest(problems=[FieldProblem(field="body.expires_at", message="has passed already")])
    values = {"is_editor": wanted.is_editor, "expires_at": wanted.expires_at}
    if old is None or (old.is_editor, old.expires_at) != (wanted.is_editor, wanted.expires_at):
        if old is not None:
            require_match(if_match, queries.to_member(old).etag, noun="member", name=old.name)
        _see_that_it_is_theirs_to_give(actor, seen, wanted)
        after = {"person": name, **_said(wanted.is_editor, wanted.expires_at)}
        await record(db, actor, _event(seen, "group.member", _before(old), after))
        put = upsert(membership).values(group_id=group_id, person_id=person_id, added_by_id=actor.person_id, **values)
        await db.execute(put.on_conflict_do_update(index_elements=["group_id", "person_id"], set_=values))
        if wanted.expires_at is not None:
            await _see_that_all_stay(db, seen)
    found = queries.members_of(actor, group_id, for_editor=True).where(person.c.id == person_id)
    return queries.to_member((await db.execute(found)).one())


async def remove_member(db: Connection, actor: Actor, *, group_id: uuid.UUID, person_id: uuid.UUID) -> None:
    """Take somebody out of a group; anybody may leave one that people are put into.

    Raises:
        NotFound: the group is not there, or not for this actor, or that person is not in it.
        Forbidden: they are no editor of it.
        GroupFixed: who is in it follows from addresses.
        LastOwner, LastAdmin: they were the last.
    """
    await lock_rights(db)
    leaves = person_id == actor.person_id
    seen = await (get_group(db, actor, group_id) if leaves else _managed(db, actor, group_id, "remove members"))
    if seen.kind is GroupKind.affiliation:
        raise GroupFixed(name=seen.name, reason="its members follow from their verified addresses")
    old = await _member(db, actor, group_id, person_id)
    if old is None:
        raise NotFound(noun="member", ref=str(person_id))
    await record(db, actor, _event(seen, "group.member", _before(old), {"person": old.name, "removed": True}))
    await db.execute(delete(membership).where(membership.c.group_id == group_id, membership.c.person_id == person_id))
    await _see_that_all_stay(db, seen)


async def _managed(db: Connection, actor: Actor, group_id: uuid.UUID, doing: str) -> GroupRead:
    seen = await get_group(db, actor, group_id)
    if not (actor.is_admin or (seen.is_editor and seen.kind is not GroupKind.admins)):
        raise Forbidden(noun="group", operation=doing, needs="an editor of the group")
    return seen


def _see_that_it_is_theirs_to_give(actor: Actor, seen: GroupRead, wanted: MemberSet) -> None:
    own, given = seen.expires_at, wanted.expires_at
    if not actor.is_admin and own is not None and (given is None or given > own):
        until = "a membership without an end" if given is None else f"a membership until {given:%Y-%m-%d %H:%M} UTC"
        raise RightExceeded(noun="group", requested=until, own=f"one until {own:%Y-%m-%d %H:%M} UTC")


async def _member(db: Connection, actor: Actor, group_id: uuid.UUID, person_id: uuid.UUID) -> Row[Any] | None:
    found = queries.members_of(actor, group_id, for_editor=True).where(person.c.id == person_id)
    return (await db.execute(found)).one_or_none()


async def _name_of(db: Connection, actor: Actor, person_id: uuid.UUID) -> str:
    found = visible_people(actor).where(person.c.id == person_id, person.c.deactivated_at.is_(None))
    if (row := (await db.execute(found)).one_or_none()) is None:
        raise NotFound(noun="person", ref=str(person_id))
    return str(row.name)


async def _owned(db: Connection, group_id: uuid.UUID) -> list[uuid.UUID]:
    return list((await db.execute(owned_by_groups([group_id]))).scalars())


async def _see_that_all_stay(db: Connection, seen: GroupRead) -> None:
    if seen.kind is GroupKind.admins:
        await ensure_admin_remains(db)
    await ensure_owner_remains(db, await _owned(db, seen.id))


def _before(old: Row[Any] | None) -> Metadata:
    return {} if old is None else {"person": old.name, **_said(old.is_editor, old.expires_at)}


def _said(is_editor: bool, expires_at: Any) -> Metadata:  # Any: a time, or None
    return {"is_editor": is_editor, "expires_at": None if expires_at is None else expires_at.isoformat()}


def _event(seen: GroupRead, operation: str, before: Metadata | None = None, after: Metadata | None = None) -> Event:
    return Event(operation, "group", seen.id, seen.name, None, before or {}, after or {}, by_power=not seen.is_editor)


def _revoked(seen: GroupRead, row: Row[Any]) -> Event:
    before: Metadata = {"right": Right.of_level(row.level).value}
    return Event("grant.revoke", "grant", row.id, seen.name, row.on_project_id, before, {}, mission_id=row.mission_id)


def _name_taken(error: IntegrityError, name: str) -> Exception:
    return NameTaken(noun="group", name=name) if violated_constraint(error) == "uq_access_group_name" else error
