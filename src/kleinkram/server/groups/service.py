"""Groups and their members. Every change that can take a right away begins with `lock_rights`."""

import datetime
import uuid
from typing import Any

from sqlalchemy import ColumnElement, Row, Select, and_, case, delete, func, insert, literal, null, select, update
from sqlalchemy.dialects.postgresql import insert as upsert
from sqlalchemy.exc import IntegrityError

from kleinkram.contract import errors
from kleinkram.contract.access import GroupCreate, GroupKind, GroupRead, GroupUpdate, MemberRead, MemberSet, Right
from kleinkram.contract.base import Page
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.names import name_key
from kleinkram.contract.people import PersonRef
from kleinkram.server.access.actor import Actor, unexpired
from kleinkram.server.access.rights import (
    ensure_admin_remains,
    ensure_owner_remains,
    lock_rights,
    owned_by_groups,
    require_creator,
    require_match,
)
from kleinkram.server.access.visible import may_see_addresses, visible_groups, visible_people
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.db import Connection, matches_key, violated_constraint
from kleinkram.server.pagination import Order, PageRequest, read_page
from kleinkram.server.settings import Creators
from kleinkram.server.tables import (
    access_grant,
    access_group,
    affiliation,
    affiliation_domain,
    membership,
    mission,
    person,
    person_email,
)

_creator, _adder, _mine = person.alias("maker"), person.alias("adder"), membership.alias("mine")
_GROUP_ORDER = Order([access_group.c.name, access_group.c.id])
_MEMBER_ORDER = Order([person.c.name.collate("C"), person.c.id])


async def list_groups(db: Connection, actor: Actor, *, name: str | None, page: PageRequest) -> Page[GroupRead]:
    """Return a page of the actor's groups (admins: all) whose name matches a glob, by name. Raises InvalidCursor."""
    stmt = _visible_groups(actor)
    stmt = stmt if name is None else stmt.where(matches_key(access_group.c.name_key, name))
    return await read_page(db, stmt, _GROUP_ORDER, page, _to_group)


async def get_group(db: Connection, actor: Actor, group_id: uuid.UUID) -> GroupRead:
    """Return one group. Raises NotFound."""
    row = (await db.execute(_visible_groups(actor).where(access_group.c.id == group_id))).one_or_none()
    if row is None:
        raise errors.NotFound(resource_type="group", ref=str(group_id))
    return _to_group(row)


async def create_group(db: Connection, actor: Actor, *, request: GroupCreate, creators: Creators) -> GroupRead:
    """Create a group, with its creator as first member and editor, and return it. Raises Forbidden or NameTaken."""
    needs_admin = await require_creator(db, actor, creators, resource_type="group")
    group_id = uuid.uuid4()
    values = {"name": request.name, "name_key": name_key(request.name), "created_by_id": actor.person_id}
    try:
        await db.execute(insert(access_group).values(id=group_id, kind=GroupKind.custom.value, **values))
    except IntegrityError as error:
        raise _name_taken(error, request.name) from error
    await db.execute(insert(membership).values(group_id=group_id, person_id=actor.person_id, is_editor=True))
    after: Metadata = {"name": request.name, "editor": actor.name}
    await audit(db, actor, Event("group.create", "group", group_id, request.name, after=after, needs_admin=needs_admin))
    return await get_group(db, actor, group_id)


async def rename_group(
    db: Connection, actor: Actor, *, group_id: uuid.UUID, changes: GroupUpdate, if_match: str | None = None
) -> GroupRead:
    """Rename a group and return it; the ETag is not checked if it has the name already.

    Raises NotFound, Forbidden, GroupFixed, NameTaken or EditConflict.
    """
    await db.execute(select(access_group.c.id).where(access_group.c.id == group_id).with_for_update())
    group = await _get_edited_group(db, actor, group_id, "rename")
    if group.kind is not GroupKind.custom:
        raise errors.GroupFixed(name=group.name, reason="its name is fixed")
    if group.name == changes.name:
        return group
    require_match(if_match, group.etag, resource_type="group", name=group.name)
    renamed = update(access_group).where(access_group.c.id == group_id)
    try:
        await db.execute(renamed.values(name=changes.name, name_key=name_key(changes.name)))
    except IntegrityError as error:
        raise _name_taken(error, changes.name) from error
    await audit(db, actor, _event(group, "group.rename", {"name": group.name}, {"name": changes.name}))
    return await get_group(db, actor, group_id)


async def delete_group(db: Connection, actor: Actor, group_id: uuid.UUID) -> None:
    """Delete a group and the grants to it. Raises NotFound, Forbidden, GroupFixed or LastOwner."""
    await lock_rights(db)
    group = await _get_edited_group(db, actor, group_id, "delete")
    if group.kind is GroupKind.admins or group.domains:
        raise errors.GroupFixed(name=group.name, reason="it is the group of the admins, or the settings require it")
    owned = list((await db.execute(owned_by_groups([group_id]))).scalars())
    project_id = func.coalesce(access_grant.c.project_id, mission.c.project_id).label("on_project_id")
    grants = select(access_grant, project_id).outerjoin(mission, mission.c.id == access_grant.c.mission_id)
    events = [_event(group, "group.delete", {"name": group.name})]
    for row in await db.execute(grants.where(access_grant.c.group_id == group_id)):
        before: Metadata = {"right": Right.of_level(row.level).value}
        location = {"project_id": row.on_project_id, "mission_id": row.mission_id}
        events.append(Event("grant.revoke", "grant", row.id, group.name, before=before, **location))
    await audit(db, actor, *events)
    await db.execute(delete(access_group).where(access_group.c.id == group_id))
    await ensure_owner_remains(db, owned)


async def list_members(db: Connection, actor: Actor, *, group_id: uuid.UUID, page: PageRequest) -> Page[MemberRead]:
    """Return a page of the members of a group, by name; addresses and past members only for its editors.

    Raises NotFound or InvalidCursor.
    """
    group = await get_group(db, actor, group_id)
    stmt = _members_of(actor, group_id, for_editor=actor.is_admin or group.is_editor)
    return await read_page(db, stmt, _MEMBER_ORDER, page, _to_member)


async def set_member(
    db: Connection,
    actor: Actor,
    *,
    group_id: uuid.UUID,
    person_id: uuid.UUID,
    request: MemberSet,
    if_match: str | None = None,
) -> MemberRead:
    """Add a person to a group or change their membership, and return it; the ETag is not checked if nothing changes.

    Raises NotFound (also with `if_match` if they are no member any more), Forbidden, RightExceeded, GroupFixed,
    InvalidRequest, LastOwner, LastAdmin or EditConflict.
    """
    await lock_rights(db)
    group = await _get_edited_group(db, actor, group_id, "add members")
    old = await _find_member(db, actor, group_id, person_id)
    name = old.person.name if old is not None else await _get_name(db, actor, person_id)
    if old is None and if_match is not None:
        raise errors.NotFound(resource_type="member", ref=str(person_id))
    if group.kind is GroupKind.affiliation and (old is None or request.expires_at is not None):
        raise errors.GroupFixed(name=group.name, reason="its members follow from their verified addresses")
    if request.expires_at is not None:
        has_passed = select(literal(request.expires_at) <= func.now())
        if (await db.execute(has_passed)).scalar_one():
            raise errors.InvalidRequest(
                problems=[errors.FieldProblem(field="body.expires_at", message="has passed already")]
            )
    if old is not None and (old.is_editor, old.expires_at) == (request.is_editor, request.expires_at):
        return old
    if old is not None:
        require_match(if_match, old.etag, resource_type="member", name=name)
    _require_not_longer(actor, group, request.expires_at)
    after: Metadata = {"person": name, **_audit_values(request.is_editor, request.expires_at)}
    await audit(db, actor, _event(group, "group.member", _before(old), after))
    values = {"is_editor": request.is_editor, "expires_at": request.expires_at}
    row = upsert(membership).values(group_id=group_id, person_id=person_id, added_by_id=actor.person_id, **values)
    await db.execute(row.on_conflict_do_update(index_elements=["group_id", "person_id"], set_=values))
    if request.expires_at is not None:
        await _ensure_owners_remain(db, group)
    new = await _find_member(db, actor, group_id, person_id)
    if new is None:
        raise errors.NotFound(resource_type="member", ref=str(person_id))
    return new


async def remove_member(db: Connection, actor: Actor, *, group_id: uuid.UUID, person_id: uuid.UUID) -> None:
    """Remove a person from a group; anybody may leave a group that people are added to.

    Raises NotFound, Forbidden, GroupFixed, LastOwner or LastAdmin.
    """
    await lock_rights(db)
    if person_id == actor.person_id:
        group = await get_group(db, actor, group_id)
    else:
        group = await _get_edited_group(db, actor, group_id, "remove members")
    if group.kind is GroupKind.affiliation:
        raise errors.GroupFixed(name=group.name, reason="its members follow from their verified addresses")
    old = await _find_member(db, actor, group_id, person_id)
    if old is None:
        raise errors.NotFound(resource_type="member", ref=str(person_id))
    after: Metadata = {"person": old.person.name, "removed": True}
    await audit(db, actor, _event(group, "group.member", _before(old), after))
    await db.execute(delete(membership).where(membership.c.group_id == group_id, membership.c.person_id == person_id))
    await _ensure_owners_remain(db, group)


async def _get_edited_group(db: Connection, actor: Actor, group_id: uuid.UUID, operation: str) -> GroupRead:
    group = await get_group(db, actor, group_id)
    if not (actor.is_admin or (group.is_editor and group.kind is not GroupKind.admins)):
        raise errors.Forbidden(resource_type="group", operation=operation, needs="an editor of the group")
    return group


def _require_not_longer(actor: Actor, group: GroupRead, expires_at: datetime.datetime | None) -> None:
    own_expiry = group.expires_at
    if not actor.is_admin and own_expiry is not None and (expires_at is None or expires_at > own_expiry):
        requested_end = "without an end" if expires_at is None else f"until {expires_at:%Y-%m-%d %H:%M} UTC"
        raise errors.RightExceeded(
            resource_type="group",
            requested=f"a membership {requested_end}",
            own=f"one until {own_expiry:%Y-%m-%d %H:%M} UTC",
        )


async def _find_member(db: Connection, actor: Actor, group_id: uuid.UUID, person_id: uuid.UUID) -> MemberRead | None:
    stmt = _members_of(actor, group_id, for_editor=True).where(person.c.id == person_id)
    row = (await db.execute(stmt)).one_or_none()
    return None if row is None else _to_member(row)


async def _get_name(db: Connection, actor: Actor, person_id: uuid.UUID) -> str:
    stmt = visible_people(actor).where(person.c.id == person_id, person.c.deactivated_at.is_(None))
    if (row := (await db.execute(stmt)).one_or_none()) is None:
        raise errors.NotFound(resource_type="person", ref=str(person_id))
    return str(row.name)


async def _ensure_owners_remain(db: Connection, group: GroupRead) -> None:
    if group.kind is GroupKind.admins:
        await ensure_admin_remains(db)
    await ensure_owner_remains(db, list((await db.execute(owned_by_groups([group.id]))).scalars()))


def _before(old: MemberRead | None) -> Metadata:
    return {} if old is None else {"person": old.person.name, **_audit_values(old.is_editor, old.expires_at)}


def _audit_values(is_editor: bool, expires_at: datetime.datetime | None) -> Metadata:
    return {"is_editor": is_editor, "expires_at": None if expires_at is None else expires_at.isoformat()}


def _event(group: GroupRead, operation: str, before: Metadata | None = None, after: Metadata | None = None) -> Event:
    return Event(
        operation, "group", group.id, group.name, None, before or {}, after or {}, needs_admin=not group.is_editor
    )


def _name_taken(error: IntegrityError, name: str) -> Exception:
    return (
        errors.NameTaken(resource_type="group", name=name)
        if violated_constraint(error) == "uq_access_group_name"
        else error
    )


def _visible_groups(actor: Actor) -> Select[Any]:
    """Return the visible groups for `_to_group`."""
    members = select(func.count()).join_from(membership, person, person.c.id == membership.c.person_id)
    count = members.where(membership.c.group_id == access_group.c.id, _is_active())
    domains = select(affiliation_domain.c.domain).where(affiliation_domain.c.group_id == access_group.c.id)
    is_own = and_(
        _mine.c.group_id == access_group.c.id, _mine.c.person_id == actor.person_id, unexpired(_mine.c.expires_at)
    )
    return (
        visible_groups(actor)
        .add_columns(
            count.correlate(access_group).scalar_subquery().label("member_count"),
            func.array(domains.order_by(affiliation_domain.c.domain).scalar_subquery()).label("domains"),
            affiliation.c.default_level,
            _creator.c.name.label("creator_name"),
            _mine.c.person_id.label("my_id"),
            _mine.c.is_editor,
            _mine.c.expires_at,
        )
        .outerjoin(affiliation, affiliation.c.group_id == access_group.c.id)
        .outerjoin(_creator, _creator.c.id == access_group.c.created_by_id)
        .outerjoin(_mine, is_own)
    )


def _is_active() -> ColumnElement[bool]:
    return unexpired(membership.c.expires_at) & person.c.deactivated_at.is_(None)


def _to_group(row: Row[Any]) -> GroupRead:
    """Return the group in a row of `_visible_groups`."""
    return GroupRead(
        id=row.id,
        name=row.name,
        kind=GroupKind(row.kind),
        member_count=row.member_count,
        is_member=row.my_id is not None,
        is_editor=bool(row.is_editor),
        expires_at=row.expires_at,
        domains=row.domains,
        default_right=Right.of_level(row.default_level) if row.default_level else None,
        created_at=row.created_at,
        created_by=PersonRef(id=row.created_by_id, name=row.creator_name) if row.created_by_id else None,
    )


def _members_of(actor: Actor, group_id: uuid.UUID, *, for_editor: bool) -> Select[Any]:
    """Return the members of a group for `_to_member`; only editors see past members, and addresses they may know."""
    emails = select(person_email.c.email).where(
        person_email.c.person_id == person.c.id, person_email.c.verified_at.is_not(None)
    )
    addresses = func.array(emails.order_by(person_email.c.email_key).correlate(person).scalar_subquery())
    stmt = (
        select(
            person.c.id,
            person.c.name,
            (case((may_see_addresses(actor), addresses), else_=null()) if for_editor else null()).label("emails"),
            _is_active().label("is_active"),
            membership.c.is_editor,
            membership.c.expires_at,
            membership.c.created_at,
            membership.c.added_by_id,
            _adder.c.name.label("adder_name"),
        )
        .join_from(membership, person, person.c.id == membership.c.person_id)
        .outerjoin(_adder, _adder.c.id == membership.c.added_by_id)
        .where(membership.c.group_id == group_id)
    )
    return stmt if for_editor else stmt.where(_is_active())


def _to_member(row: Row[Any]) -> MemberRead:
    """Return the member in a row of `_members_of`."""
    return MemberRead(
        person=PersonRef(id=row.id, name=row.name),
        emails=row.emails or [],
        is_editor=row.is_editor,
        is_active=row.is_active,
        expires_at=row.expires_at,
        added_at=row.created_at,
        added_by=PersonRef(id=row.added_by_id, name=row.adder_name) if row.added_by_id else None,
    )
