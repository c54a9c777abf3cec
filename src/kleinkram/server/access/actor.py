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

from sqlalchemy import ColumnElement, Row, Select, bindparam, case, exists, func, or_, select, update

from kleinkram.contract.access import Right, Scope, TokenKind
from kleinkram.contract.people import PersonRef
from kleinkram.contract.tokens import SecretKind, is_whole, with_checksum
from kleinkram.server.access.groups import ADMINS_ID, OWNER_ID, OWNER_TOKEN_NAME
from kleinkram.server.db import Connection
from kleinkram.server.tables import membership, mission, person, project, session, share, share_file, token, token_limit

ALL_SCOPES = frozenset(Scope)
_CONTAINED = {
    Scope.write: frozenset({Scope.write, Scope.read, Scope.upload}),
    Scope.admin: ALL_SCOPES,
}
# How exactly the last use of a token or a session is known.
_USE_NOTED_EVERY_S = 60


class ActorKind(str, enum.Enum):
    """How somebody comes: as a person, as a runner of actions, by a link, or without any credential."""

    person = "person"
    runner = "runner"
    share = "share"
    stranger = "stranger"


@dataclass(frozen=True)
class Limits:
    """The projects and missions that a credential reaches; with `file_ids`, only these files of the missions."""

    project_ids: frozenset[uuid.UUID] = frozenset()
    mission_ids: frozenset[uuid.UUID] = frozenset()
    file_ids: frozenset[uuid.UUID] | None = None


@dataclass(frozen=True)
class Actor:
    """Somebody at work in one request. `is_admin` is the power of an admin, which not every token of one carries."""

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
    # A run, by its own token: with no more than this right, whatever whoever started it holds.
    run_id: uuid.UUID | None = None
    most: Right | None = None
    # The runner that this runner's token is bound to; None until one has used it.
    runner_id: uuid.UUID | None = None
    # Seconds since they last proved who they are: by signing in, or by `klein login` for the token that came of it.
    # None where that is not known, as of a token that was made with another.
    sign_in_age_s: float | None = None
    # The row of the table of operations under which this request came in.
    operation: str | None = None

    @property
    def ref(self) -> PersonRef | None:
        """The person as named beside what they do."""
        return None if self.person_id is None else PersonRef(id=self.person_id, name=self.name)

    def asking(self, operation: str, *, request_id: str | None, address: str | None) -> "Actor":
        """Return the same somebody, in this request, from this address."""
        return replace(self, operation=operation, request_id=request_id, address=address)

    def without_power(self) -> "Actor":
        """Return the same somebody with no more than their own rights."""
        return replace(self, is_admin=False)


STRANGER = Actor(None, "anybody", None, None, ActorKind.stranger, scopes=frozenset({Scope.read}))


def secret_hash(secret: str) -> bytes:
    """Return what is kept of a secret: the SHA-256 of its UTF-8."""
    return hashlib.sha256(secret.encode()).digest()


def contained(scopes: Collection[Scope]) -> frozenset[Scope]:
    """Return scopes with those that they contain."""
    return frozenset(part for scope in scopes for part in _CONTAINED.get(scope, {scope}))


def unexpired(expires_at: ColumnElement[Any]) -> ColumnElement[bool]:
    """Say of a time of expiry that it has not come: effective the second it passes, by the database's clock."""
    return or_(expires_at.is_(None), expires_at > func.now())


async def find_actor(db: Connection, secret: str) -> Actor | None:
    """Return who carries a token or a link's secret, or None where it is unknown, expired or revoked, or they left."""
    carried = {"hashed": secret_hash(secret)}
    row = (await db.execute(_by_token(), carried)).one_or_none()
    if row is not None:
        if row.use_is_unnoted:
            await db.execute(update(token).where(token.c.id == row.token_id).values(last_used_at=func.now()))
        return _carrier(row)
    row = (await db.execute(_by_share(), carried)).one_or_none()
    if row is None:
        return None
    if row.use_is_unnoted:
        await db.execute(update(share).where(share.c.id == row.id).values(last_used_at=func.now()))
    return _guest(row)


async def find_signed_in(db: Connection, secret: str, *, idle_s: float) -> Actor | None:
    """Return whose browser's session it is, or None where it is unknown, over, revoked or idle, or they left."""
    known = (session.c.secret_sha256 == secret_hash(secret)) & session.c.revoked_at.is_(None)
    age = _age_s(session.c.authenticated_at).label("sign_in_age_s")
    stmt = _people(session.c.id.label("session_id"), age, _is_unnoted(session.c.last_used_at)).join_from(
        session, person
    )
    in_use = session.c.last_used_at > func.now() - datetime.timedelta(seconds=idle_s)
    row = (await db.execute(stmt.where(known, in_use, session.c.expires_at > func.now()))).one_or_none()
    if row is None:
        return None
    if row.use_is_unnoted:
        await db.execute(update(session).where(session.c.id == row.session_id).values(last_used_at=func.now()))
    age_s = float(row.sign_in_age_s)
    return Actor(row.id, row.name, None, None, session_id=row.session_id, is_admin=row.is_admin, sign_in_age_s=age_s)


async def find_person(db: Connection, person_id: uuid.UUID) -> Actor | None:
    """Return somebody as they would act now by themselves, for what a job does in their name; None where they left."""
    row = (await db.execute(_people().where(person.c.id == person_id))).one_or_none()
    return None if row is None else Actor(row.id, row.name, None, None, is_admin=row.is_admin)


def _people(*columns: ColumnElement[Any]) -> Select[Any]:
    is_admin = exists().where(
        membership.c.group_id == ADMINS_ID, membership.c.person_id == person.c.id, unexpired(membership.c.expires_at)
    )
    named = select(person.c.id, person.c.name, is_admin.label("is_admin"), *columns)
    return named.where(person.c.deactivated_at.is_(None))


def _is_unnoted(last_used_at: ColumnElement[Any]) -> ColumnElement[bool]:
    late = last_used_at < func.now() - datetime.timedelta(seconds=_USE_NOTED_EVERY_S)
    return func.coalesce(late, True).label("use_is_unnoted")


# Made once: to put such a statement together takes longer than to run it, and every request does.
@cache
def _by_token() -> Select[Any]:
    def limits(column: ColumnElement[Any]) -> ColumnElement[Any]:
        of_token = select(column).where(token_limit.c.token_id == token.c.id, column.is_not(None))
        return func.array(of_token.correlate(token).scalar_subquery())

    stmt = _people(
        token.c.id.label("token_id"),
        _is_unnoted(token.c.last_used_at),
        token.c.kind,
        token.c.scopes,
        token.c.is_limited,
        token.c.run_id,
        token.c.most,
        token.c.runner_id,
        _token_sign_in_age_s().label("sign_in_age_s"),
        limits(token_limit.c.project_id).label("project_ids"),
        limits(token_limit.c.mission_id).label("mission_ids"),
    )
    of_run = or_(token.c.kind != TokenKind.run.value, token.c.run_id.is_not(None))
    usable = token.c.revoked_at.is_(None) & unexpired(token.c.expires_at) & of_run
    return stmt.join_from(token, person).where(token.c.secret_sha256 == bindparam("hashed"), usable)


def _carrier(row: Row[Any]) -> Actor:
    scopes = contained([Scope(scope) for scope in row.scopes])
    limits = Limits(frozenset(row.project_ids), frozenset(row.mission_ids)) if row.is_limited else None
    return Actor(
        row.id,
        row.name,
        row.token_id,
        None,
        ActorKind.runner if row.kind == TokenKind.runner.value else ActorKind.person,
        # A run of an admin's has an admin's rights on its mission; what is for admins takes a scope that no run has.
        is_admin=row.is_admin and (Scope.admin in scopes or row.run_id is not None),
        scopes=scopes,
        limits=limits,
        run_id=row.run_id,
        most=None if row.most is None else Right(row.most),
        runner_id=row.runner_id,
        sign_in_age_s=None if row.sign_in_age_s is None else float(row.sign_in_age_s),
    )


def _age_s(at: ColumnElement[Any]) -> ColumnElement[Any]:
    return func.extract("epoch", func.now() - at)


def _token_sign_in_age_s() -> ColumnElement[Any]:
    # Whoever has the file of the owner of `klein up` can have a link to sign in at any time.
    is_owners_file = (token.c.person_id == OWNER_ID) & (token.c.name == OWNER_TOKEN_NAME)
    from_sign_in = token.c.made_by_token_id.is_(None) & (token.c.kind == TokenKind.personal.value)
    return case((from_sign_in & is_owners_file, 0), (from_sign_in, _age_s(token.c.created_at)))


@cache
def _by_share() -> Select[Any]:
    files = select(share_file.c.file_id).where(share_file.c.share_id == share.c.id).correlate(share)
    chosen = func.array(files.scalar_subquery()).label("file_ids")
    usable = share.c.revoked_at.is_(None) & (share.c.expires_at > func.now())
    # It ends with whoever made it, and rests while what it shows is in the trash.
    stands = mission.c.deleted_at.is_(None) & project.c.deleted_at.is_(None) & person.c.deactivated_at.is_(None)
    return (
        select(share, chosen, _is_unnoted(share.c.last_used_at))
        .join_from(share, mission, mission.c.id == share.c.mission_id)
        .join(project, project.c.id == mission.c.project_id)
        .join(person, person.c.id == share.c.created_by_id)
        .where(share.c.secret_sha256 == bindparam("hashed"), usable, stands)
    )


def _guest(row: Row[Any]) -> Actor:
    limits = Limits(mission_ids=frozenset({row.mission_id}), file_ids=None if row.is_whole else frozenset(row.file_ids))
    return Actor(
        None,
        f"link {row.name}",
        None,
        None,
        ActorKind.share,
        share_id=row.id,
        scopes=frozenset({Scope.read}),
        limits=limits,
    )


_RANDOM_BYTES = 32
# Enough to recognise one's own token in a list, and no help in guessing the rest.
_SHOWN_CHARACTERS = 4


@dataclass(frozen=True)
class NewSecret:
    """A secret that nobody has seen yet: shown once, to whoever asked for it."""

    text: str = field(repr=False)
    prefix: str

    @property
    def sha256(self) -> bytes:
        """What is kept of it."""
        return secret_hash(self.text)


def new_secret(kind: SecretKind) -> NewSecret:
    """Return a secret of 256 random bits."""
    text = with_checksum(f"klein_{kind.value}_{secrets.token_urlsafe(_RANDOM_BYTES)}")
    return NewSecret(text, beginning(text))


def beginning(secret: str) -> str:
    """Return how a secret of ours begins, as lists show it; nothing of one that is not in this form."""
    return secret[: secret.index("_", len("klein_")) + 1 + _SHOWN_CHARACTERS] if is_whole(secret) else ""
