"""Whether somebody may do something: what a credential is for at all, and what right its carrier has on a place."""

import uuid
from collections.abc import Iterable
from typing import Any

from sqlalchemy import Row, Select, func, select

from kleinkram.contract.errors import Forbidden, NotAuthenticated, NotFound, ScopeMissing, SignInTooOld
from kleinkram.contract.rights import Right, Scope
from kleinkram.server.access.actor import Actor, ActorKind, find_person
from kleinkram.server.access.operations import OPERATIONS, ResourceKind
from kleinkram.server.access.visible import level_on_mission, level_on_project, visible_missions, visible_projects
from kleinkram.server.db import Connection
from kleinkram.server.tables import mission, person, project, share

# Held for the length of a transaction by whatever takes rights away, so that two cannot each leave the other's.
_TAKING = 0x6B6C5247
_COUNTABLE = frozenset({"action", "file", "grant", "group", "mission", "project", "recording", "run", "share", "token"})


def admit(actor: Actor, operation: str) -> None:
    """See that a credential may be used for an operation at all, whatever its carrier's rights are.

    Raises:
        NotAuthenticated: it takes an account, and there is none.
        ScopeMissing: the token, or the link, is not for this.
        Forbidden: it is for admins.
    """
    need = OPERATIONS[operation]
    if actor.kind is ActorKind.stranger and not need.guests:
        raise NotAuthenticated(reason="this requires an account")
    if actor.kind is ActorKind.share and not need.guests:
        raise ScopeMissing(operation=_words(operation), needs="an account")
    if actor.kind is ActorKind.runner and not need.runners:
        raise ScopeMissing(operation=_words(operation), needs="a personal token")
    if need.only_runners and actor.kind is not ActorKind.runner:
        raise ScopeMissing(operation=_words(operation), needs="a runner's token")
    if not need.scopes & actor.scopes and actor.kind is not ActorKind.runner:
        raise ScopeMissing(operation=_words(operation), needs=f"a token with the scope {_any_of(need.scopes)}")
    if need.reads and Scope.read not in actor.scopes:
        needs = f"a token with the scopes `read` and {_any_of(need.scopes)}"
        raise ScopeMissing(operation=_words(operation), needs=needs)
    if need.browsers and actor.session_id is None:
        raise ScopeMissing(operation=_words(operation), needs="a browser session")
    if need.on is ResourceKind.server and not actor.is_admin:
        raise Forbidden(noun="server", operation=_words(operation), needs="admin rights")
    if (need.boundless or need.on is ResourceKind.server) and actor.limits is not None:
        raise ScopeMissing(operation=_words(operation), needs="a token without limits")


def require_fresh_sign_in(actor: Actor, operation: str, *, within_s: float) -> None:
    """See that `actor` proved who they are a short while ago.

    Raises:
        SignInTooOld: it is longer ago, or not known.
    """
    if actor.sign_in_age_s is None or actor.sign_in_age_s > within_s:
        raise SignInTooOld(operation=_words(operation), minutes=round(within_s / 60, 1))


def is_public_endpoint(operation: str) -> bool:
    """Say whether an operation is for whoever comes, about nothing that is there: signing in."""
    need = OPERATIONS[operation]
    return need.guests and need.on is ResourceKind.nothing


async def require_project(db: Connection, actor: Actor, operation: str, project_id: uuid.UUID) -> None:
    """See that `actor` may do `operation` on a project.

    Raises:
        NotFound: it is not there, or not for this actor.
        Forbidden: they may see it, but the operation takes more.
    """
    row = (await db.execute(_project_level(actor, project_id))).one_or_none()
    _require(row, operation, noun="project", ref=project_id)


async def require_mission(db: Connection, actor: Actor, operation: str, mission_id: uuid.UUID) -> None:
    """See that `actor` may do `operation` on a mission.

    Raises:
        NotFound: it is not there, or not for this actor.
        Forbidden: they may see it, but the operation takes more.
    """
    row = (await db.execute(_mission_level(actor, mission_id))).one_or_none()
    _require(row, operation, noun="mission", ref=mission_id)


async def still_shares(db: Connection, guest: Actor) -> bool:
    """Say whether whoever made the link by which `guest` came may make such a link still: they know its secret."""
    made = select(share.c.created_by_id, share.c.mission_id).where(share.c.id == guest.share_id)
    row = (await db.execute(made)).one()
    maker = await find_person(db, row.created_by_id)
    if maker is None:
        return False
    level: int | None = (await db.execute(_mission_level(maker, row.mission_id))).scalar_one_or_none()
    return (level or 0) >= (OPERATIONS["create_share"].right or Right.read).level


async def ensure_active_person(db: Connection, person_id: uuid.UUID | None) -> None:
    """Before a credential is made for somebody, see that they have not left, and keep them until this transaction ends.

    Who leaves while it is made would find it good when they are back.

    Raises:
        NotAuthenticated: they left.
    """
    here = select(person.c.id).where(person.c.id == person_id, person.c.deactivated_at.is_(None))
    if (await db.execute(here.with_for_update(read=True, key_share=True))).first() is None:
        raise NotAuthenticated(reason="the account was deactivated")


async def lock_person(db: Connection, person_id: uuid.UUID) -> None:
    """Keep credentials from being made for somebody until this transaction ends: those that end are all there are."""
    await db.execute(select(person.c.id).where(person.c.id == person_id).with_for_update())


async def lock_rights(db: Connection) -> None:
    """Keep everybody else from taking rights away until this transaction ends."""
    await db.execute(select(func.pg_advisory_xact_lock(_TAKING)))


def _project_level(actor: Actor, project_id: uuid.UUID) -> Select[Any]:
    levels = visible_projects(actor).with_only_columns(level_on_project(actor))
    return levels.where(project.c.id == project_id)


def _mission_level(actor: Actor, mission_id: uuid.UUID) -> Select[Any]:
    levels = visible_missions(actor).with_only_columns(level_on_mission(actor), maintain_column_froms=True)
    return levels.where(mission.c.id == mission_id)


def _require(row: Row[Any] | None, operation: str, *, noun: str, ref: uuid.UUID) -> None:
    if row is None:
        raise NotFound(noun=noun, ref=str(ref))
    needed = OPERATIONS[operation].right or Right.read
    if row[0] < needed.level:
        raise Forbidden(noun=noun, operation=_words(operation), needs=needed.value)


def _words(operation: str) -> str:
    """Return an operation's id as an English phrase: `delete_mission` is "delete a mission"."""
    verb, *rest = operation.split("_")
    if rest and rest[-1] in _COUNTABLE:
        rest.insert(0, "an" if rest[0][0] in "aeiou" else "a")
    return " ".join([verb, *rest])


def _any_of(scopes: Iterable[Scope]) -> str:
    return " or ".join(f"`{scope}`" for scope in sorted(scope.value for scope in scopes))
