"""Logins of programs: a person who is signed in agrees, on a page that names who asks, and the program gets a token.

By loopback (RFC 8252 with PKCE): the code goes to 127.0.0.1 of the machine that the browser runs on. By device (RFC
8628): the person types a short code that the program shows. Codes live for minutes and are good once; a token is made
only when the program comes for it, and only while the session that agreed has not been ended.
"""

import datetime
import secrets
import uuid
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlencode

from sqlalchemy import ColumnElement, Row, delete, func, insert, or_, select, update
from sqlalchemy.dialects.postgresql import insert as upsert

from kleinkram.contract.accounts import DeviceRead, LoopbackApproval, LoopbackApproved
from kleinkram.contract.errors import CodeGone, SignInDenied, SignInExpired, SignInPending, SlowDown
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.names import MAX_LABEL_CHARACTERS, check_label
from kleinkram.contract.rights import Scope
from kleinkram.contract.signing_in import CliExchange, DeviceCode, SignedIn
from kleinkram.contract.tokens import TokenCreate
from kleinkram.server.access.actor import Actor, find_person, secret_hash
from kleinkram.server.audit.service import Event, record
from kleinkram.server.db import Connection, Database
from kleinkram.server.settings import Settings
from kleinkram.server.tables import login_request, session
from kleinkram.server.tables.signing_in import LoginKind
from kleinkram.server.tokens.service import issue_token

_SECRET_BYTES = 32
_LOOPBACK_CODE_S = 120
DEVICE_CODE_S = 600.0
DEVICE_INTERVAL_S = 5.0
# How long ended ones are kept, so that who comes late hears what happened.
_KEPT_S = 3600
# No vowels, so that no word is spelt, and no letters that look like others. Eight of twenty: 34 bits for ten minutes.
_LETTERS = "BCDFGHJKLMNPQRSTVWXZ"
_LETTER_COUNT = 8


@dataclass(frozen=True)
class _Poll:
    """What a device finds when it asks."""

    row: Row[Any] | None
    came_too_soon: bool


async def approve_loopback(db: Connection, actor: Actor, *, wanted: LoopbackApproval) -> LoopbackApproved:
    """Agree that the program behind a port of this machine's loopback gets a token; returns where its code goes."""
    await _forget(db)
    code = secrets.token_urlsafe(_SECRET_BYTES)
    request_id = uuid.uuid4()
    await db.execute(
        insert(login_request).values(
            id=request_id,
            kind=LoginKind.loopback.value,
            secret_sha256=secret_hash(code),
            label=wanted.client,
            address=actor.address,
            code_challenge=wanted.code_challenge,
            port=wanted.port,
            expires_at=_in(_LOOPBACK_CODE_S),
            approved_at=func.now(),
            approved_by_id=actor.person_id,
            approved_session_id=actor.session_id,
        )
    )
    await record(db, actor, Event("login.approve", "login", request_id, wanted.client, None, after={"by": "browser"}))
    query = urlencode({"code": code, "state": wanted.state})
    return LoopbackApproved(url=f"http://127.0.0.1:{wanted.port}/?{query}")


async def exchange_loopback(db: Connection, asker: Actor, *, brought: CliExchange, settings: Settings) -> SignedIn:
    """Make the token for a code that a browser brought to the loopback.

    Raises:
        SignInExpired: the code is unknown, used, too old, or not for who has this verifier.
    """
    from authlib.oauth2.rfc7636 import create_s256_code_challenge

    challenge: str = create_s256_code_challenge(brought.code_verifier)
    mine = (
        (login_request.c.secret_sha256 == secret_hash(brought.code))
        & (login_request.c.code_challenge == challenge)
        & (login_request.c.kind == LoginKind.loopback.value)
    )
    row = await _redeem(db, mine)
    if row is None:
        raise SignInExpired
    return await _make_token(db, asker, row, settings)


async def begin_device(db: Connection, asker: Actor, *, client: str, settings: Settings) -> DeviceCode:
    """Give a program a code to show, and a secret to ask with whether it was typed."""
    await _forget(db)
    secret = secrets.token_urlsafe(_SECRET_BYTES)
    user_code = await _new_user_code(db, asker, client=client, secret=secret)
    shown = f"{user_code[:4]}-{user_code[4:]}"
    page = f"{settings.public_url.rstrip('/')}/sign-in/device"
    return DeviceCode(
        device_code=secret,
        user_code=shown,
        verification_url=page,
        verification_url_complete=f"{page}?{urlencode({'user_code': shown})}",
        interval_s=DEVICE_INTERVAL_S,
        expires_s=DEVICE_CODE_S,
    )


async def exchange_device(database: Database, asker: Actor, *, device_code: str, settings: Settings) -> SignedIn:
    """Make the token for a program whose code was typed.

    Raises:
        SignInPending: nobody has typed it yet.
        SlowDown: it asks more often than it was told to.
        SignInDenied: somebody typed it and disagreed.
        SignInExpired: it is unknown, used or too old, or who agreed has signed out since.
    """
    mine = (login_request.c.secret_sha256 == secret_hash(device_code)) & (
        login_request.c.kind == LoginKind.device.value
    )
    async with database.begin() as db:  # of its own: that it asked counts, whatever it is told
        poll = await _note_poll(db, mine)
    if poll.row is None:
        raise SignInExpired
    if poll.row.denied_at is not None:
        raise SignInDenied
    if poll.came_too_soon:
        raise SlowDown(interval_s=2 * DEVICE_INTERVAL_S)
    async with database.begin() as db:
        row = await _redeem(db, mine)
        if row is not None:
            return await _make_token(db, asker, row, settings)
    if poll.row.approved_at is None:
        raise SignInPending(interval_s=DEVICE_INTERVAL_S)
    raise SignInExpired


async def look_at_device(db: Connection, user_code: str) -> DeviceRead:
    """Return who shows a code.

    Raises:
        CodeGone: nobody, or no longer.
    """
    columns = (login_request.c[name] for name in ("label", "address", "created_at", "expires_at"))
    row = (await db.execute(select(*columns).where(_shows(user_code)))).one_or_none()
    if row is None:
        raise CodeGone
    return DeviceRead(client=row.label, address=row.address, created_at=row.created_at, expires_at=row.expires_at)


async def approve_device(db: Connection, actor: Actor, user_code: str) -> DeviceRead:
    """Agree that the program that shows a code gets a token.

    Raises:
        CodeGone: none shows it, or no longer.
    """
    agreed = {
        "approved_at": func.now(),
        "approved_by_id": actor.person_id,
        "approved_session_id": actor.session_id,
    }
    return await _decide(db, actor, user_code, agreed, "login.approve")


async def deny_device(db: Connection, actor: Actor, user_code: str) -> DeviceRead:
    """Disagree.

    Raises:
        CodeGone: none shows the code, or no longer.
    """
    return await _decide(db, actor, user_code, {"denied_at": func.now()}, "login.deny")


async def _decide(db: Connection, actor: Actor, user_code: str, values: dict[str, Any], operation: str) -> DeviceRead:
    stmt = update(login_request).where(_shows(user_code)).values(values).returning(*login_request.c)
    row = (await db.execute(stmt)).one_or_none()
    if row is None:
        raise CodeGone
    after = {"by": "code", "from": row.address}
    await record(db, actor, Event(operation, "login", row.id, row.label, None, after=after))
    return DeviceRead(client=row.label, address=row.address, created_at=row.created_at, expires_at=row.expires_at)


async def _new_user_code(db: Connection, asker: Actor, *, client: str, secret: str) -> str:
    while True:
        user_code = "".join(secrets.choice(_LETTERS) for _ in range(_LETTER_COUNT))
        row = upsert(login_request).values(
            id=uuid.uuid4(),
            kind=LoginKind.device.value,
            secret_sha256=secret_hash(secret),
            label=client,
            address=asker.address,
            user_code=user_code,
            expires_at=_in(DEVICE_CODE_S),
        )
        # Where somebody shows the same code just now, another is made.
        if (await db.execute(row.on_conflict_do_nothing().returning(login_request.c.id))).first() is not None:
            return user_code


async def _note_poll(db: Connection, mine: ColumnElement[bool]) -> _Poll:
    stmt = select(login_request, func.now().label("now")).where(mine, login_request.c.expires_at > func.now())
    row = (await db.execute(stmt.with_for_update())).one_or_none()
    if row is None:
        return _Poll(None, came_too_soon=False)
    await db.execute(update(login_request).where(mine).values(polled_at=func.now()))
    # One second of grace: what the network takes differs from time to time.
    too_soon = datetime.timedelta(seconds=DEVICE_INTERVAL_S - 1)
    return _Poll(row, came_too_soon=row.polled_at is not None and row.now - row.polled_at < too_soon)


async def _redeem(db: Connection, mine: ColumnElement[bool]) -> Row[Any] | None:
    still_signed_in = select(session.c.id).where(session.c.revoked_at.is_(None), session.c.expires_at > func.now())
    stmt = update(login_request).where(
        mine,
        login_request.c.approved_at.is_not(None),
        login_request.c.redeemed_at.is_(None),
        login_request.c.expires_at > func.now(),
        login_request.c.approved_session_id.in_(still_signed_in),
    )
    return (await db.execute(stmt.values(redeemed_at=func.now()).returning(*login_request.c))).one_or_none()


async def _make_token(db: Connection, asker: Actor, row: Row[Any], settings: Settings) -> SignedIn:
    found = await find_person(db, row.approved_by_id)
    if found is None or found.ref is None:
        raise SignInExpired
    days = min(settings.login_token_days, settings.token_days_max or settings.login_token_days)
    ends = func.now() + datetime.timedelta(days=days)
    expires_at: datetime.datetime = (await db.execute(select(ends))).scalar_one()
    wanted = TokenCreate(name=_as_label(row.label), scopes=[Scope.admin], expires_at=expires_at)
    token_id, secret = await issue_token(db, found.person_id, wanted=wanted, expires_at=expires_at)
    actor = found.asking(asker.operation or "", request_id=asker.request_id, address=asker.address)
    after: Metadata = {"way": f"login by {row.kind}", "prefix": secret.prefix, "expires_at": expires_at.isoformat()}
    await record(db, actor, Event("token.create", "token", token_id, wanted.name, None, after=after))
    return SignedIn(token=secret.text, person=found.ref, expires_at=expires_at)


async def _forget(db: Connection) -> None:
    gone = login_request.c.expires_at < func.now() - datetime.timedelta(seconds=_KEPT_S)
    # Their user codes are free again at once; rows go an hour later.
    await db.execute(delete(login_request).where(or_(gone, _is_abandoned())))


def _is_abandoned() -> ColumnElement[bool]:
    undecided = login_request.c.approved_at.is_(None) & login_request.c.denied_at.is_(None)
    return undecided & (login_request.c.expires_at < func.now())


def _shows(user_code: str) -> ColumnElement[bool]:
    letters = "".join(letter for letter in user_code.upper() if letter.isalpha())
    undecided = login_request.c.approved_at.is_(None) & login_request.c.denied_at.is_(None)
    return (login_request.c.user_code == letters) & undecided & (login_request.c.expires_at > func.now())


def _in(seconds: float) -> ColumnElement[datetime.datetime]:
    return func.now() + datetime.timedelta(seconds=seconds)


def _as_label(client: str) -> str:
    """Return what a program calls itself as the name of a token."""
    return check_label(client.replace(",", " ")[:MAX_LABEL_CHARACTERS].strip() or "klein")
