"""Checks before a change: the credential's scope, its holder's right, the ETag; and that every project keeps an owner.

A permanent owner is an active person in a group without an end, which has DELETE on the project without an end. Grants
to an address do not count: whether anybody has it is not revealed to the granter.
"""

import uuid
from collections.abc import Collection, Sequence
from typing import NamedTuple

from sqlalchemy import Select, exists, func, insert, select

from kleinkram.contract import errors
from kleinkram.contract.access import GroupKind, Right, Scope
from kleinkram.server.access.actor import Actor, ActorKind, find_person, unexpired
from kleinkram.server.access.builtin_groups import ADMINS_ID, own_group, own_project
from kleinkram.server.access.operations import OPERATIONS, ResourceKind
from kleinkram.server.access.visible import (
    joined_files,
    level_on_mission,
    level_on_project,
    visible_missions,
    visible_projects,
)
from kleinkram.server.db import Connection
from kleinkram.server.settings import Creators
from kleinkram.server.tables import (
    access_grant,
    access_group,
    affiliation,
    affiliation_domain,
    file,
    membership,
    mission,
    person,
    project,
    share,
)

_RIGHTS_LOCK = 0x6B6C5247
_COUNTABLE = frozenset(
    {
        *("action", "event", "file", "grant", "group", "layout", "mission", "project", "recording", "run", "share"),
        "token",
    }
)


class OwnedProject(NamedTuple):
    """A project whose ownership changed."""

    id: uuid.UUID
    name: str


def check_credential(actor: Actor, operation: str) -> None:
    """Check that a credential may be used for an operation, regardless of the rights of its holder.

    Raises NotAuthenticated, ScopeMissing or Forbidden.
    """
    permission = OPERATIONS[operation]
    missing = None
    if actor.kind is ActorKind.stranger and not permission.guests:
        raise errors.NotAuthenticated(reason="this requires an account")
    if actor.kind is ActorKind.share and not permission.guests:
        missing = "an account"
    elif actor.kind is ActorKind.runner and not permission.runners:
        missing = "a personal token"
    elif permission.only_runners and actor.kind is not ActorKind.runner:
        missing = "a runner's token"
    elif not permission.scopes & actor.scopes and actor.kind is not ActorKind.runner:
        missing = f"a token with the scope {_any_of(permission.scopes)}"
    elif permission.also is not None and permission.also not in actor.scopes:
        missing = f"a token with the scopes `{permission.also.value}` and {_any_of(permission.scopes)}"
    elif permission.browsers and actor.session_id is None:
        missing = "a browser session"
    if missing is not None:
        raise errors.ScopeMissing(operation=_phrase(operation), needs=missing)
    if permission.on is ResourceKind.server and not actor.is_admin:
        raise errors.Forbidden(resource_type="server", operation=_phrase(operation), needs="admin rights")
    if (permission.unrestricted or permission.on is ResourceKind.server) and actor.limits is not None:
        raise errors.ScopeMissing(operation=_phrase(operation), needs="a token without limits")


def require_fresh_sign_in(actor: Actor, operation: str, *, within_s: float) -> None:
    """Check that the actor signed in recently. Raises SignInTooOld."""
    if actor.sign_in_age_s is None or actor.sign_in_age_s > within_s:
        raise errors.SignInTooOld(operation=_phrase(operation), minutes=round(within_s / 60, 1))


def is_public_endpoint(operation: str) -> bool:
    """Whether an operation, such as signing in, is open to everybody and about no stored object."""
    permission = OPERATIONS[operation]
    return permission.guests and permission.on is ResourceKind.none


async def require_project(db: Connection, actor: Actor, operation: str, project_id: uuid.UUID) -> None:
    """Check that the actor may perform an operation on a project. Raises NotFound or Forbidden."""
    levels = visible_projects(actor).with_only_columns(level_on_project(actor)).where(project.c.id == project_id)
    level: int | None = (await db.execute(levels)).scalar_one_or_none()
    _require_level(level, operation, resource_type="project", resource_id=project_id)


async def require_mission(db: Connection, actor: Actor, operation: str, mission_id: uuid.UUID) -> None:
    """Check that the actor may perform an operation on a mission. Raises NotFound or Forbidden."""
    level: int | None = (await db.execute(_mission_level(actor, mission_id))).scalar_one_or_none()
    _require_level(level, operation, resource_type="mission", resource_id=mission_id)


async def require_missions_of_blob(db: Connection, actor: Actor, operation: str, blob_id: uuid.UUID) -> None:
    """Check that the actor may perform an operation on all missions with files of a blob, except those in the trash.

    Raises Forbidden, which names none of the missions: the actor may not see them.
    """
    needed = OPERATIONS[operation].right or Right.read
    permitted = visible_missions(actor, needed).with_only_columns(mission.c.id, maintain_column_froms=True)
    live = (file.c.deleted_at.is_(None), mission.c.deleted_at.is_(None), project.c.deleted_at.is_(None))
    others = joined_files().with_only_columns(file.c.id, maintain_column_froms=True)
    others = others.where(file.c.blob_id == blob_id, *live, mission.c.id.not_in(permitted))
    if (await db.execute(others.limit(1))).first() is not None:
        needs = f"{needed.value} on all missions with the same file"
        raise errors.Forbidden(resource_type="file", operation=_phrase(operation), needs=needs)


async def still_shares(db: Connection, guest: Actor) -> bool:
    """Whether the creator of a guest's link might still create it: they know its secret."""
    stmt = select(share.c.created_by_id, share.c.mission_id).where(share.c.id == guest.share_id)
    row = (await db.execute(stmt)).one()
    creator = await find_person(db, row.created_by_id)
    if creator is None:
        return False
    level: int | None = (await db.execute(_mission_level(creator, row.mission_id))).scalar_one_or_none()
    return (level or 0) >= (OPERATIONS["create_share"].right or Right.read).level


async def ensure_active_person(db: Connection, person_id: uuid.UUID | None) -> None:
    """Check, before a credential is created, that a person is active, and keep them so until the transaction ends.

    Otherwise the credential of a person who is deactivated concurrently would be valid again after reactivation.
    Raises NotAuthenticated.
    """
    active = select(person.c.id).where(person.c.id == person_id, person.c.deactivated_at.is_(None))
    if (await db.execute(active.with_for_update(read=True, key_share=True))).first() is None:
        raise errors.NotAuthenticated(reason="the account was deactivated")


async def lock_person(db: Connection, person_id: uuid.UUID) -> None:
    """Prevent credentials from being created for a person until this transaction ends."""
    await db.execute(select(person.c.id).where(person.c.id == person_id).with_for_update())


async def lock_rights(db: Connection) -> None:
    """Serialize the transactions that take rights away, so that two cannot each remove one of the last two owners."""
    await db.execute(select(func.pg_advisory_xact_lock(_RIGHTS_LOCK)))


def _mission_level(actor: Actor, mission_id: uuid.UUID) -> Select[tuple[int]]:
    levels = visible_missions(actor).with_only_columns(level_on_mission(actor), maintain_column_froms=True)
    return levels.where(mission.c.id == mission_id)


def _require_level(level: int | None, operation: str, *, resource_type: str, resource_id: uuid.UUID) -> None:
    if level is None:
        raise errors.NotFound(resource_type=resource_type, ref=str(resource_id))
    needed = OPERATIONS[operation].right or Right.read
    if level < needed.level:
        raise errors.Forbidden(resource_type=resource_type, operation=_phrase(operation), needs=needed.value)


def _phrase(operation: str) -> str:
    """Return an operation's id as an English phrase: `delete_mission` is "delete a mission"."""
    verb, *rest = operation.split("_")
    if rest and rest[-1] in _COUNTABLE:
        rest.insert(0, "an" if rest[0][0] in "aeiou" else "a")
    return " ".join([verb, *rest])


def _any_of(scopes: Collection[Scope]) -> str:
    return " or ".join(f"`{scope}`" for scope in sorted(scope.value for scope in scopes))


def owned_by_groups(group_ids: Collection[uuid.UUID]) -> Select[tuple[uuid.UUID]]:
    """Return the ids of the projects that groups own without an end."""
    is_permanent_ownership = (access_grant.c.level == Right.delete.level) & access_grant.c.expires_at.is_(None)
    return select(access_grant.c.project_id).where(
        is_permanent_ownership, access_grant.c.project_id.is_not(None), access_grant.c.group_id.in_(group_ids)
    )


async def ensure_owner_remains(db: Connection, project_ids: Sequence[uuid.UUID]) -> None:
    """Check that projects, also in the trash, still have a permanent owner. Raises LastOwner."""
    if unowned := await _unowned(db, project_ids):
        raise errors.LastOwner(projects=[owned.name for owned in unowned])


async def ensure_admin_remains(db: Connection) -> None:
    """Check, after admin rights were taken away, that an active person is a permanent admin. Raises LastAdmin."""
    is_permanent_admin = (membership.c.group_id == ADMINS_ID) & membership.c.expires_at.is_(None)
    admins = select(person.c.id).join_from(membership, person, person.c.id == membership.c.person_id)
    if (await db.execute(admins.where(is_permanent_admin, person.c.deactivated_at.is_(None)).limit(1))).first() is None:
        raise errors.LastAdmin


async def give_to_admins(db: Connection, project_ids: Sequence[uuid.UUID]) -> list[OwnedProject]:
    """Make the admins owners of those projects that nobody owns any more, and return these."""
    unowned = await _unowned(db, project_ids)
    for owned in unowned:
        await own_project(db, project_id=owned.id, group_id=ADMINS_ID)
    return unowned


async def _unowned(db: Connection, project_ids: Sequence[uuid.UUID]) -> list[OwnedProject]:
    await lock_rights(db)
    is_owned = (
        exists()
        .where(
            access_grant.c.project_id == project.c.id,
            access_grant.c.level == Right.delete.level,
            access_grant.c.expires_at.is_(None),
            access_group.c.id == access_grant.c.group_id,
            access_group.c.kind != GroupKind.email.value,
            membership.c.group_id == access_grant.c.group_id,
            membership.c.expires_at.is_(None),
            person.c.id == membership.c.person_id,
            person.c.deactivated_at.is_(None),
        )
        .correlate(project)
    )
    stmt = select(project.c.id, project.c.name).where(project.c.id.in_(project_ids), ~is_owned)
    return [OwnedProject(*row) for row in await db.execute(stmt.order_by(project.c.name, project.c.id))]


async def require_creator(db: Connection, actor: Actor, creators: Creators, *, resource_type: str) -> bool:
    """Check that the actor may create a project or group; returns whether that required admin rights.

    Without affiliations in the settings, everybody counts as affiliated. Raises Forbidden.
    """
    operation = f"create a {resource_type}"
    if actor.limits is not None:
        raise errors.Forbidden(resource_type="server", operation=operation, needs="a token without limits")
    if creators == "everybody":
        return False
    if creators == "affiliated":
        is_own = (membership.c.person_id == actor.person_id) & unexpired(membership.c.expires_at)
        is_member = exists().where(
            is_own, access_group.c.id == membership.c.group_id, access_group.c.kind == GroupKind.affiliation.value
        )
        is_affiliated = select(is_member | ~exists(select(affiliation_domain.c.domain)))
        if (await db.execute(is_affiliated)).scalar_one():
            return False
    if actor.is_admin:
        return True
    needs = "admin rights" if creators == "admins" else "an affiliation with the lab"
    raise errors.Forbidden(resource_type="server", operation=operation, needs=needs)


async def grant_first_rights(db: Connection, actor: Actor, project_id: uuid.UUID) -> dict[str, Right]:
    """Make the creator of a project its owner, and give affiliation groups their default rights; returns the latter.

    Raises LastOwner if the creator was deactivated concurrently.
    """
    await lock_rights(db)
    await own_project(db, project_id=project_id, group_id=await own_group(db, actor.person_id))
    stmt = select(access_group.c.id, access_group.c.name, affiliation.c.default_level).join(affiliation)
    rows = (await db.execute(stmt.where(affiliation.c.default_level.is_not(None)))).all()
    if rows:
        shared_values = {"project_id": project_id, "granted_by_id": actor.person_id}
        grants = [{"group_id": row.id, "level": row.default_level, "id": uuid.uuid4(), **shared_values} for row in rows]
        await db.execute(insert(access_grant), grants)
    await ensure_owner_remains(db, [project_id])
    return {row.name: Right.of_level(row.default_level) for row in rows}


def require_match(if_match: str | None, etag: str, *, resource_type: str, name: str) -> None:
    """Check that an object still has one of the ETags in an If-Match header; without a header, there is no check.

    Raises EditConflict.
    """
    if if_match is None:
        return
    expected = {part.strip().removeprefix("W/").strip('"') for part in if_match.split(",")}
    if not expected & {etag, "*"}:
        raise errors.EditConflict(resource_type=resource_type, name=name, etag=etag)
