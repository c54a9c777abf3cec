"""What may be done with tokens. Their secrets leave the server once, in the answer that makes them."""

import datetime
import enum
import uuid
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Row, Select, func, insert, select, update

from kleinkram.contract.errors import (
    FieldProblem,
    Forbidden,
    InvalidRequest,
    NotAuthenticated,
    NotFound,
    ScopeMissing,
    TokenTooWide,
)
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.paging import Page
from kleinkram.contract.rights import Scope, TokenKind
from kleinkram.contract.secrets import SecretKind
from kleinkram.contract.tokens import TokenCreate, TokenMade, TokenRead
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.rights import ensure_active_person, lock_person, require_fresh_sign_in
from kleinkram.server.access.secrets import NewSecret, new_secret
from kleinkram.server.audit.service import Event, record, record_all
from kleinkram.server.db import Connection
from kleinkram.server.paging import PageRequest, Rows, fetch_page
from kleinkram.server.settings import Settings
from kleinkram.server.tables import token, token_limit
from kleinkram.server.tokens import queries

_SECRETS = {
    TokenKind.personal: SecretKind.personal,
    TokenKind.robot: SecretKind.robot,
    TokenKind.runner: SecretKind.runner,
    TokenKind.run: SecretKind.run,
}


@dataclass(frozen=True)
class Whose:
    """Whose tokens a list shows: one person's, or with None everybody's."""

    person_id: uuid.UUID | None


class Made(str, enum.Enum):
    """What becomes of the tokens that one made, when it ends."""

    ended = "ended"
    kept = "kept"


async def create_token(db: Connection, actor: Actor, *, wanted: TokenCreate, settings: Settings) -> TokenMade:
    """Make a token for `actor` and return it with its secret.

    Raises:
        NotFound: a project or mission to limit it to is not there, or not for this actor.
        Forbidden: only admins make tokens for runners.
        TokenTooWide: it could do more than the token that it is made with.
        InvalidRequest: it would have expired already, or be good for longer than the settings allow.
        SignInTooOld: it has the scope admin, and `actor` signed in too long ago.
    """
    if Scope.admin in wanted.chosen_scopes:
        require_fresh_sign_in(actor, "create_token_with_the_scope_admin", within_s=settings.fresh_sign_in_s)
    if wanted.kind is TokenKind.runner and not actor.is_admin:
        raise Forbidden(noun="server", operation="create a token for a runner", needs="admin rights")
    await _see_that_places_are_there(db, actor, wanted)
    expires_at = await _expiry(db, actor, wanted, settings)
    _see_that_it_is_no_wider(actor, wanted)
    token_id, secret = await issue_token(
        db, actor.person_id, wanted=wanted, expires_at=expires_at, made_by=actor.token_id
    )
    made = await get_token(db, actor, token_id)
    after = made.model_dump(
        mode="json", include={"kind", "scopes", "limits", "expires_at", "prefix", "runner", "runner_labels"}
    )
    event = Event(
        "token.create", "token", token_id, made.name, None, after=after, by_power=wanted.kind is TokenKind.runner
    )
    await record(db, actor, event)
    return TokenMade(token=made, secret=secret.text)


async def issue_token(
    db: Connection,
    person_id: uuid.UUID | None,
    *,
    wanted: TokenCreate,
    expires_at: datetime.datetime | None,
    made_by: uuid.UUID | None = None,
) -> tuple[uuid.UUID, NewSecret]:
    """Put a token there for somebody; whether they may have it, and the record, are the caller's.

    `made_by` is the token that it is made with, if any.

    Raises:
        NotAuthenticated: they left, or that token was revoked just now.
    """
    await ensure_active_person(db, person_id)
    ended = select(token.c.id).where(token.c.id == made_by, token.c.revoked_at.is_not(None))
    if (await db.execute(ended)).first() is not None:
        raise NotAuthenticated(reason="the token is not valid here")
    token_id = uuid.uuid4()
    secret = new_secret(_SECRETS[wanted.kind])
    await db.execute(
        insert(token).values(
            id=token_id,
            person_id=person_id,
            kind=wanted.kind.value,
            name=wanted.name,
            prefix=secret.prefix,
            secret_sha256=secret.sha256,
            scopes=[scope.value for scope in wanted.chosen_scopes],
            is_limited=wanted.is_limited,
            expires_at=expires_at,
            made_by_token_id=made_by,
            runner_id=wanted.runner_id,
            runner_labels=wanted.runner_labels,
        )
    )
    limits = [{"project_id": each, "mission_id": None} for each in dict.fromkeys(wanted.project_ids)]
    limits += [{"project_id": None, "mission_id": each} for each in dict.fromkeys(wanted.mission_ids)]
    if limits:
        rows = [{"id": uuid.uuid4(), "token_id": token_id, **limit} for limit in limits]
        await db.execute(insert(token_limit), rows)
    return token_id, secret


async def get_token(db: Connection, actor: Actor, token_id: uuid.UUID) -> TokenRead:
    """Return one of `actor`'s tokens; admins may see anybody's.

    Raises:
        NotFound: it is not there, or not for this actor.
    """
    row = await _row(db, actor, token_id)
    return (await _reads(db, actor, Rows([row], None, None)))[0]


async def list_tokens(
    db: Connection, actor: Actor, *, whose: Whose, with_ended: bool, page: PageRequest
) -> Page[TokenRead]:
    """Return a page of tokens, latest first; those that were revoked or have expired only `with_ended`.

    Raises:
        Forbidden: tokens of others are for admins.
        InvalidCursor: the cursor is not of this list.
    """
    if whose.person_id != actor.person_id and not _sees_others(actor):
        raise Forbidden(noun="server", operation="list tokens of others", needs="admin rights")
    found = queries.tokens_of(whose.person_id)
    rows = await fetch_page(db, found if with_ended else queries.still_usable(found), queries.TOKEN_ORDER, page)
    return Page(items=await _reads(db, actor, rows), next=rows.next, total=rows.total)


async def revoke_token(db: Connection, actor: Actor, *, token_id: uuid.UUID, made: Made = Made.ended) -> None:
    """End a token, and those that it made and they made, from the next request on; what has ended stays so.

    Any token may end itself; to end another takes the scope admin, and no limits.

    Raises:
        NotFound: it is not there, or not for this actor.
        ScopeMissing: it is another than the one that asks, and that is not for this.
    """
    if token_id != actor.token_id and Scope.admin not in actor.scopes:
        raise ScopeMissing(operation="revoke another token", needs="a token with the scope `admin`")
    if token_id != actor.token_id and actor.limits is not None:
        raise ScopeMissing(operation="revoke another token", needs="a token without limits")
    row = await _row(db, actor, token_id)
    await lock_person(db, row.person_id)
    which = queries.made_from(token_id) if made is Made.ended else select(token.c.id).where(token.c.id == token_id)
    stmt = update(token).where(token.c.id.in_(which), token.c.revoked_at.is_(None)).values(revoked_at=func.now())
    ended = (await db.execute(stmt.returning(token.c.id, token.c.name, token.c.prefix))).all()
    by_power = row.person_id != actor.person_id
    events = []
    for each in ended:
        after: Metadata = {"prefix": each.prefix, "person": row.person_name}
        if each.id != token_id:
            after["made_with"] = row.name
        events.append(Event("token.revoke", "token", each.id, each.name, None, after=after, by_power=by_power))
    await record_all(db, actor, events)


async def end_personal_tokens(db: Connection, actor: Actor) -> int:
    """End all that stands for a person as themselves, such as by `klein login`, and return how many that were.

    Those of robots and runners stay, so that these do not stop.
    """
    mine = token.c.id.in_(queries.carried_by(actor.person_id)) & token.c.revoked_at.is_(None)
    stmt = update(token).where(mine).values(revoked_at=func.now())
    ended = (await db.execute(stmt.returning(token.c.id, token.c.name, token.c.prefix))).all()
    events = [
        Event("token.revoke", "token", each.id, each.name, None, after={"prefix": each.prefix, "person": actor.name})
        for each in ended
    ]
    await record_all(db, actor, events)
    return len(ended)


def _sees_others(actor: Actor) -> bool:
    return actor.is_admin and actor.limits is None


async def _row(db: Connection, actor: Actor, token_id: uuid.UUID) -> Row[Any]:
    found: Select[Any] = queries.tokens_of(None if _sees_others(actor) else actor.person_id)
    row = (await db.execute(found.where(token.c.id == token_id))).one_or_none()
    if row is None:
        raise NotFound(noun="token", ref=str(token_id))
    return row


async def _reads(db: Connection, actor: Actor, rows: Rows) -> list[TokenRead]:
    limited = [row.id for row in rows.items if row.is_limited]
    places: dict[uuid.UUID, list[Row[Any]]] = {}
    if limited:
        for place in await db.execute(queries.places_of(actor, limited)):
            places.setdefault(place.token_id, []).append(place)
    return [queries.to_token(row, places.get(row.id, [])) for row in rows.items]


async def _see_that_places_are_there(db: Connection, actor: Actor, wanted: TokenCreate) -> None:
    if not wanted.is_limited:
        return
    found = await db.execute(queries.reachable(actor, project_ids=wanted.project_ids, mission_ids=wanted.mission_ids))
    there = {(row.noun, row.id) for row in found}
    for noun, ids in (("project", wanted.project_ids), ("mission", wanted.mission_ids)):
        for each in ids:
            if (noun, each) not in there:
                raise NotFound(noun=noun, ref=str(each))


async def _expiry(db: Connection, actor: Actor, wanted: TokenCreate, settings: Settings) -> datetime.datetime | None:
    """Return when the token will end: as wanted, else as the settings say; never after the one that it is made with."""
    own = select(token.c.expires_at).where(token.c.id == actor.token_id).scalar_subquery()
    now, latest = (await db.execute(select(func.now(), own))).one()
    most = settings.token_days_max
    # A minute of grace: whoever counts the days does so a little earlier.
    longest = now + datetime.timedelta(days=most, minutes=1)
    if most and (wanted.no_end or (wanted.expires_at is not None and wanted.expires_at > longest)):
        message = f"a token of this server is good for {most} days at most (KLEINKRAM_TOKEN_DAYS_MAX)"
        field = "no_end" if wanted.no_end else "expires_at"
        raise InvalidRequest(problems=[FieldProblem(field=field, message=message)])
    if wanted.expires_at is not None and wanted.expires_at <= now:
        problem = FieldProblem(field="expires_at", message="is in the past; a token must expire later than now")
        raise InvalidRequest(problems=[problem])
    if wanted.expires_at is not None and latest is not None and wanted.expires_at > latest:
        raise TokenTooWide(reason=f"the new token would outlive it; it ends at {latest.isoformat(timespec='seconds')}")
    if wanted.expires_at is not None or wanted.no_end:
        return wanted.expires_at or latest
    days = default_days(wanted.kind, settings)
    usual = None if days is None else now + datetime.timedelta(days=days)
    return min((each for each in (usual, latest) if each is not None), default=None)


def default_days(kind: TokenKind, settings: Settings) -> int | None:
    """Return how long a token is good for of which nobody said how long; None for ever."""
    most = settings.token_days_max or None
    # A runner works by itself for long, and for no more than its own runs.
    if kind is TokenKind.runner:
        return most
    return settings.token_days_default if most is None else min(settings.token_days_default, most)


def _see_that_it_is_no_wider(actor: Actor, wanted: TokenCreate) -> None:
    # Of scopes none can be beyond its own: to make tokens takes the one that contains all.
    if actor.limits is not None and not wanted.is_limited:
        raise TokenTooWide(reason="it is limited itself; limit the new token to what it can reach")
