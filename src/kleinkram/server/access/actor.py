"""The actor of a request, found from its credential, and the secrets of credentials."""

import datetime
import enum
import hashlib
import secrets
import uuid
from collections.abc import Collection
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

from sqlalchemy import ColumnElement, Integer, Select, bindparam, case, exists, func, or_, select, update

from kleinkram.contract.access import Right, Scope, TokenKind
from kleinkram.contract.people import PersonRef
from kleinkram.contract.token_format import SecretKind, has_valid_checksum, with_checksum
from kleinkram.server.access.builtin_groups import ADMINS_ID, OWNER_ID, OWNER_TOKEN_NAME
from kleinkram.server.db import Connection
from kleinkram.server.tables import (
    identity,
    membership,
    mission,
    person,
    project,
    session,
    share,
    share_file,
    token,
    token_limit,
)

ALL_SCOPES = frozenset(Scope)
_CONTAINED = {
    Scope.write: frozenset({Scope.write, Scope.read, Scope.upload}),
    Scope.admin: ALL_SCOPES,
}
# The precision of `last_used_at`.
_USE_PRECISION_S = 60


class ActorKind(str, enum.Enum):
    """Kinds of actors: a person, a runner, the holder of a share link, or a guest without credential."""

    person = "person"
    runner = "runner"
    share = "share"
    stranger = "stranger"


@dataclass(frozen=True)
class Limits:
    """The projects and missions to which a credential is limited; with `file_ids`, to these files of the missions."""

    project_ids: frozenset[uuid.UUID] = frozenset()
    mission_ids: frozenset[uuid.UUID] = frozenset()
    file_ids: frozenset[uuid.UUID] | None = None


@dataclass(frozen=True)
class Actor:
    """Who sends a request. `is_admin`: with admin rights, which not every token of an admin has."""

    person_id: uuid.UUID | None
    name: str
    token_id: uuid.UUID | None
    request_id: str | None
    kind: ActorKind = ActorKind.person
    session_id: uuid.UUID | None = None
    share_id: uuid.UUID | None = None
    address: str | None = None
    is_admin: bool = False
    scopes: frozenset[Scope] = ALL_SCOPES
    limits: Limits | None = None
    # For the token of a run: its highest right, even if the person who started the run has higher ones.
    run_id: uuid.UUID | None = None
    max_right: Right | None = None
    # For the token of a runner: the runner it is bound to; None before its first use.
    runner_id: uuid.UUID | None = None
    # Seconds since the person signed in, also with `klein login` for its token; None for tokens made with a token.
    sign_in_age_s: float | None = None
    # The operation of the request, in `operations.OPERATIONS`.
    operation: str | None = None

    @property
    def ref(self) -> PersonRef | None:
        """The person, for responses."""
        return None if self.person_id is None else PersonRef(id=self.person_id, name=self.name)

    def for_request(self, operation: str, *, request_id: str | None, address: str | None) -> "Actor":
        """Return the actor for this request."""
        return replace(self, operation=operation, request_id=request_id, address=address)

    def without_admin(self) -> "Actor":
        """Return the actor without admin rights."""
        return replace(self, is_admin=False)


STRANGER = Actor(None, "anybody", None, None, ActorKind.stranger, scopes=frozenset({Scope.read}))


def secret_hash(secret: str) -> bytes:
    """Return what is stored of a secret: the SHA-256 of its UTF-8."""
    return hashlib.sha256(secret.encode()).digest()


def expand_scopes(scopes: Collection[Scope]) -> frozenset[Scope]:
    """Return scopes and the scopes that they contain."""
    return frozenset(part for scope in scopes for part in _CONTAINED.get(scope, {scope}))


def unexpired(expires_at: ColumnElement[Any]) -> ColumnElement[bool]:
    """Whether a time of expiry has not passed, by the database's clock."""
    return or_(expires_at.is_(None), expires_at > func.now())


async def find_actor(db: Connection, secret: str, *, provider_days: int = 0) -> Actor | None:
    """Return the actor of a token or link; None if it is unknown, expired or revoked, or its owner is deactivated.

    Nor is a token of `klein login` usable whose provider account was not confirmed within `provider_days` (0: any).
    """
    parameters = {"hashed": secret_hash(secret)}
    row = (await db.execute(_by_token(), {**parameters, "provider_days": provider_days})).one_or_none()
    if row is not None:
        if row.is_use_outdated:
            await db.execute(update(token).where(token.c.id == row.token_id).values(last_used_at=func.now()))
        scopes = expand_scopes([Scope(scope) for scope in row.scopes])
        return Actor(
            row.id,
            row.name,
            row.token_id,
            None,
            ActorKind.runner if row.kind == TokenKind.runner.value else ActorKind.person,
            # Runs of admins have admin rights on their mission; operations for admins require a scope that no run has.
            is_admin=row.is_admin and (Scope.admin in scopes or row.run_id is not None),
            scopes=scopes,
            limits=Limits(frozenset(row.project_ids), frozenset(row.mission_ids)) if row.is_limited else None,
            run_id=row.run_id,
            max_right=None if row.max_right is None else Right(row.max_right),
            runner_id=row.runner_id,
            sign_in_age_s=None if row.sign_in_age_s is None else float(row.sign_in_age_s),
        )
    row = (await db.execute(_by_share(), parameters)).one_or_none()
    if row is None:
        return None
    if row.is_use_outdated:
        await db.execute(update(share).where(share.c.id == row.id).values(last_used_at=func.now()))
    file_ids = None if row.is_whole_mission else frozenset(row.file_ids)
    return Actor(
        None,
        f"link {row.name}",
        None,
        None,
        ActorKind.share,
        share_id=row.id,
        scopes=frozenset({Scope.read}),
        limits=Limits(mission_ids=frozenset({row.mission_id}), file_ids=file_ids),
    )


async def find_signed_in(db: Connection, secret: str, *, idle_s: float, provider_days: int = 0) -> Actor | None:
    """Return the actor of a session; None if it is unknown, expired, revoked or idle, or its person is deactivated.

    Nor is a session usable whose provider account was not confirmed within `provider_days` (0: any).
    """
    is_known = (session.c.secret_sha256 == secret_hash(secret)) & session.c.revoked_at.is_(None)
    age_s_column = _age_s(session.c.authenticated_at).label("sign_in_age_s")
    stmt = _people(session.c.id.label("session_id"), age_s_column, _is_use_outdated(session.c.last_used_at)).join_from(
        session, person
    )
    in_use = session.c.last_used_at > func.now() - datetime.timedelta(seconds=idle_s)
    stmt = stmt.where(is_known, in_use, session.c.expires_at > func.now(), _is_confirmed(session.c.identity_id))
    row = (await db.execute(stmt, {"provider_days": provider_days})).one_or_none()
    if row is None:
        return None
    if row.is_use_outdated:
        await db.execute(update(session).where(session.c.id == row.session_id).values(last_used_at=func.now()))
    age_s = float(row.sign_in_age_s)
    return Actor(row.id, row.name, None, None, session_id=row.session_id, is_admin=row.is_admin, sign_in_age_s=age_s)


async def find_person(db: Connection, person_id: uuid.UUID) -> Actor | None:
    """Return an active person with all their rights, for jobs that act in their name; None if they are deactivated."""
    row = (await db.execute(_people().where(person.c.id == person_id))).one_or_none()
    return None if row is None else Actor(row.id, row.name, None, None, is_admin=row.is_admin)


def _people(*columns: ColumnElement[Any]) -> Select[Any]:
    is_admin = exists().where(
        membership.c.group_id == ADMINS_ID, membership.c.person_id == person.c.id, unexpired(membership.c.expires_at)
    )
    named = select(person.c.id, person.c.name, is_admin.label("is_admin"), *columns)
    return named.where(person.c.deactivated_at.is_(None))


def _is_confirmed(identity_id: ColumnElement[Any]) -> ColumnElement[bool]:
    """Whether a credential depends on no provider account, or on one that was confirmed within `provider_days`."""
    days = bindparam("provider_days", type_=Integer)
    was_confirmed = exists().where(
        identity.c.id == identity_id, identity.c.confirmed_at > func.now() - func.make_interval(0, 0, 0, days)
    )
    return or_(days == 0, identity_id.is_(None), was_confirmed)


def _is_use_outdated(last_used_at: ColumnElement[Any]) -> ColumnElement[bool]:
    late = last_used_at < func.now() - datetime.timedelta(seconds=_USE_PRECISION_S)
    return func.coalesce(late, True).label("is_use_outdated")


# Built once: building this statement takes longer than executing it.
@cache
def _by_token() -> Select[Any]:
    def limits(column: ColumnElement[Any]) -> ColumnElement[Any]:
        of_token = select(column).where(token_limit.c.token_id == token.c.id, column.is_not(None))
        return func.array(of_token.correlate(token).scalar_subquery())

    # The owner of `klein up` can create a sign-in link with the token in their file at any time.
    is_owner_file = (token.c.person_id == OWNER_ID) & (token.c.name == OWNER_TOKEN_NAME)
    from_sign_in = token.c.created_by_token_id.is_(None) & (token.c.kind == TokenKind.personal.value)
    stmt = _people(
        token.c.id.label("token_id"),
        _is_use_outdated(token.c.last_used_at),
        token.c.kind,
        token.c.scopes,
        token.c.is_limited,
        token.c.run_id,
        token.c.max_right,
        token.c.runner_id,
        case((from_sign_in & is_owner_file, 0), (from_sign_in, _age_s(token.c.created_at))).label("sign_in_age_s"),
        limits(token_limit.c.project_id).label("project_ids"),
        limits(token_limit.c.mission_id).label("mission_ids"),
    )
    of_run = or_(token.c.kind != TokenKind.run.value, token.c.run_id.is_not(None))
    usable = token.c.revoked_at.is_(None) & unexpired(token.c.expires_at) & of_run
    usable &= _is_confirmed(token.c.identity_id)
    return stmt.join_from(token, person).where(token.c.secret_sha256 == bindparam("hashed"), usable)


def _age_s(at: ColumnElement[Any]) -> ColumnElement[Any]:
    return func.extract("epoch", func.now() - at)


@cache
def _by_share() -> Select[Any]:
    files = select(share_file.c.file_id).where(share_file.c.share_id == share.c.id).correlate(share)
    file_ids = func.array(files.scalar_subquery()).label("file_ids")
    usable = share.c.revoked_at.is_(None) & (share.c.expires_at > func.now())
    # It ends when its creator is deactivated, and is suspended while its mission is in the trash.
    is_active = mission.c.deleted_at.is_(None) & project.c.deleted_at.is_(None) & person.c.deactivated_at.is_(None)
    return (
        select(share, file_ids, _is_use_outdated(share.c.last_used_at))
        .join_from(share, mission, mission.c.id == share.c.mission_id)
        .join(project, project.c.id == mission.c.project_id)
        .join(person, person.c.id == share.c.created_by_id)
        .where(share.c.secret_sha256 == bindparam("hashed"), usable, is_active)
    )


_RANDOM_BYTES = 32
# Enough to recognize a token in a list, and of no help to guess the rest.
_SHOWN_CHARACTERS = 4


@dataclass(frozen=True)
class NewSecret:
    """A new secret, which is shown once."""

    text: str = field(repr=False)
    prefix: str

    @property
    def sha256(self) -> bytes:
        """Identity of the credential, as stored."""
        return secret_hash(self.text)


def new_secret(kind: SecretKind) -> NewSecret:
    """Return a secret of 256 random bits."""
    text = with_checksum(f"klein_{kind.value}_{secrets.token_urlsafe(_RANDOM_BYTES)}")
    return NewSecret(text, secret_prefix(text))


def secret_prefix(secret: str) -> str:
    """Return the beginning of a secret, for lists; empty if it is not one of ours."""
    return secret[: secret.index("_", len("klein_")) + 1 + _SHOWN_CHARACTERS] if has_valid_checksum(secret) else ""
