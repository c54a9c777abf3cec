"""`klein login` and other programs: a person approves the program in their browser, and it gets a token.

Loopback (RFC 8252 with PKCE): the browser delivers the code to 127.0.0.1. Device (RFC 8628): the person types a short
code that the program shows. Codes expire within minutes and are valid once. The token is created when the program
exchanges its code, and only while the session that approved it is active.
"""

import datetime
import secrets
import uuid
from typing import Any, NamedTuple
from urllib.parse import urlencode

from sqlalchemy import ColumnElement, delete, func, insert, or_, select, update
from sqlalchemy.dialects.postgresql import insert as upsert

from kleinkram.contract import accounts
from kleinkram.contract.access import Scope
from kleinkram.contract.errors import CodeGone, SignInDenied, SignInExpired, SignInPending, SlowDown
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.names import MAX_LABEL_CHARACTERS, check_label
from kleinkram.contract.tokens import TokenCreate
from kleinkram.server.access.actor import Actor, find_person, secret_hash
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.db import Connection, Database
from kleinkram.server.settings import Settings
from kleinkram.server.tables import login_request, session
from kleinkram.server.tables.sign_in import LoginKind
from kleinkram.server.tokens.service import issue_token

_SECRET_BYTES = 32
_LOOPBACK_CODE_S = 120
DEVICE_CODE_S = 600.0
DEVICE_INTERVAL_S = 5.0
# How long finished requests are kept, so that late programs get an explanation.
_RETENTION_S = 3600
# No vowels, which could form words, and no letters that look alike. Eight of twenty: 34 bits for ten minutes.
_LETTERS = "BCDFGHJKLMNPQRSTVWXZ"
_LETTER_COUNT = 8
_UNDECIDED = login_request.c.approved_at.is_(None) & login_request.c.denied_at.is_(None)


class _Approval(NamedTuple):
    label: str
    kind: str
    approved_by_id: uuid.UUID
    approved_session_id: uuid.UUID


class _Poll(NamedTuple):
    is_denied: bool
    is_approved: bool
    is_too_early: bool


async def approve_loopback(
    db: Connection, actor: Actor, *, approval: accounts.LoopbackApproval
) -> accounts.LoopbackApproved:
    """Approve the program that listens on a loopback port; returns the URL that delivers its code."""
    await _delete_old_requests(db)
    code = secrets.token_urlsafe(_SECRET_BYTES)
    request_id = uuid.uuid4()
    await db.execute(
        insert(login_request).values(
            id=request_id,
            kind=LoginKind.loopback.value,
            secret_sha256=secret_hash(code),
            label=approval.client,
            address=actor.address,
            code_challenge=approval.code_challenge,
            port=approval.port,
            expires_at=_in(_LOOPBACK_CODE_S),
            approved_at=func.now(),
            approved_by_id=actor.person_id,
            approved_session_id=actor.session_id,
        )
    )
    await audit(db, actor, Event("login.approve", "login", request_id, approval.client, after={"by": "browser"}))
    query = urlencode({"code": code, "state": approval.state})
    return accounts.LoopbackApproved(url=f"http://127.0.0.1:{approval.port}/?{query}")


async def exchange_loopback(
    db: Connection, guest: Actor, *, exchange: accounts.CliExchange, settings: Settings
) -> accounts.SignedIn:
    """Exchange a code that a browser delivered to the loopback for a token. Raises SignInExpired."""
    from authlib.oauth2.rfc7636 import create_s256_code_challenge

    challenge: str = create_s256_code_challenge(exchange.code_verifier)
    condition = (
        (login_request.c.secret_sha256 == secret_hash(exchange.code))
        & (login_request.c.code_challenge == challenge)
        & (login_request.c.kind == LoginKind.loopback.value)
    )
    approval = await _redeem(db, condition)
    if approval is None:
        raise SignInExpired
    return await _create_token(db, guest, approval, settings)


async def start_device_login(db: Connection, guest: Actor, *, client: str, settings: Settings) -> accounts.DeviceCode:
    """Return a code that the program shows, and a secret with which it polls."""
    await _delete_old_requests(db)
    secret = secrets.token_urlsafe(_SECRET_BYTES)
    user_code = await _create_user_code(db, guest, client=client, secret=secret)
    formatted_code = f"{user_code[:4]}-{user_code[4:]}"
    page = f"{settings.public_url.rstrip('/')}/sign-in/device"
    return accounts.DeviceCode(
        device_code=secret,
        user_code=formatted_code,
        verification_url=page,
        verification_url_complete=f"{page}?{urlencode({'user_code': formatted_code})}",
        interval_s=DEVICE_INTERVAL_S,
        expires_s=DEVICE_CODE_S,
    )


async def exchange_device_code(
    database: Database, guest: Actor, *, device_code: str, settings: Settings
) -> accounts.SignedIn:
    """Exchange a device code for a token. Raises SignInPending, SlowDown, SignInDenied or SignInExpired."""
    condition = (login_request.c.secret_sha256 == secret_hash(device_code)) & (
        login_request.c.kind == LoginKind.device.value
    )
    async with database.begin() as db:  # of its own, so that every poll counts
        poll = await _record_poll(db, condition)
    if poll is None:
        raise SignInExpired
    if poll.is_denied:
        raise SignInDenied
    if poll.is_too_early:
        raise SlowDown(interval_s=2 * DEVICE_INTERVAL_S)
    async with database.begin() as db:
        approval = await _redeem(db, condition)
        if approval is not None:
            return await _create_token(db, guest, approval, settings)
    if not poll.is_approved:
        raise SignInPending(interval_s=DEVICE_INTERVAL_S)
    raise SignInExpired


async def get_device_login(db: Connection, user_code: str) -> accounts.DeviceRead:
    """Return the program that shows a code. Raises CodeGone."""
    columns = (login_request.c[name] for name in ("label", "address", "created_at", "expires_at"))
    row = (await db.execute(select(*columns).where(_is_undecided(user_code)))).one_or_none()
    if row is None:
        raise CodeGone
    return accounts.DeviceRead(
        client=row.label, address=row.address, created_at=row.created_at, expires_at=row.expires_at
    )


async def approve_device(db: Connection, actor: Actor, user_code: str) -> accounts.DeviceRead:
    """Approve the program that shows a code. Raises CodeGone."""
    approval = {
        "approved_at": func.now(),
        "approved_by_id": actor.person_id,
        "approved_session_id": actor.session_id,
    }
    return await _decide(db, actor, user_code, approval, "login.approve")


async def deny_device(db: Connection, actor: Actor, user_code: str) -> accounts.DeviceRead:
    """Deny the program that shows a code. Raises CodeGone."""
    return await _decide(db, actor, user_code, {"denied_at": func.now()}, "login.deny")


async def _decide(
    db: Connection, actor: Actor, user_code: str, values: dict[str, Any], operation: str
) -> accounts.DeviceRead:
    stmt = update(login_request).where(_is_undecided(user_code)).values(values).returning(*login_request.c)
    row = (await db.execute(stmt)).one_or_none()
    if row is None:
        raise CodeGone
    after = {"by": "code", "from": row.address}
    await audit(db, actor, Event(operation, "login", row.id, row.label, after=after))
    return accounts.DeviceRead(
        client=row.label, address=row.address, created_at=row.created_at, expires_at=row.expires_at
    )


async def _create_user_code(db: Connection, guest: Actor, *, client: str, secret: str) -> str:
    while True:
        user_code = "".join(secrets.choice(_LETTERS) for _ in range(_LETTER_COUNT))
        row = upsert(login_request).values(
            id=uuid.uuid4(),
            kind=LoginKind.device.value,
            secret_sha256=secret_hash(secret),
            label=client,
            address=guest.address,
            user_code=user_code,
            expires_at=_in(DEVICE_CODE_S),
        )
        # On a conflict with a pending code, try another.
        if (await db.execute(row.on_conflict_do_nothing().returning(login_request.c.id))).first() is not None:
            return user_code


async def _record_poll(db: Connection, condition: ColumnElement[bool]) -> _Poll | None:
    columns = login_request.c.polled_at, login_request.c.denied_at, login_request.c.approved_at
    stmt = select(*columns, func.now().label("now")).where(condition, login_request.c.expires_at > func.now())
    row = (await db.execute(stmt.with_for_update())).one_or_none()
    if row is None:
        return None
    await db.execute(update(login_request).where(condition).values(polled_at=func.now()))
    # One second of tolerance for network delays.
    min_interval = datetime.timedelta(seconds=DEVICE_INTERVAL_S - 1)
    is_too_early = row.polled_at is not None and row.now - row.polled_at < min_interval
    return _Poll(row.denied_at is not None, row.approved_at is not None, is_too_early)


async def _redeem(db: Connection, condition: ColumnElement[bool]) -> _Approval | None:
    active_sessions = select(session.c.id).where(session.c.revoked_at.is_(None), session.c.expires_at > func.now())
    stmt = update(login_request).where(
        condition,
        login_request.c.approved_at.is_not(None),
        login_request.c.redeemed_at.is_(None),
        login_request.c.expires_at > func.now(),
        login_request.c.approved_session_id.in_(active_sessions),
    )
    columns = [login_request.c[name] for name in _Approval._fields]
    row = (await db.execute(stmt.values(redeemed_at=func.now()).returning(*columns))).one_or_none()
    return None if row is None else _Approval(*row)


async def _create_token(db: Connection, guest: Actor, approval: _Approval, settings: Settings) -> accounts.SignedIn:
    approver = await find_person(db, approval.approved_by_id)
    if approver is None or approver.ref is None:
        raise SignInExpired
    days = min(settings.login_token_days, settings.token_days_max or settings.login_token_days)
    ends = func.now() + datetime.timedelta(days=days)
    expires_at: datetime.datetime = (await db.execute(select(ends))).scalar_one()
    request = TokenCreate(name=_as_label(approval.label), scopes=[Scope.admin], expires_at=expires_at)
    session_id = approval.approved_session_id
    token_id, secret = await issue_token(
        db, approver.person_id, request=request, expires_at=expires_at, approved_in=session_id
    )
    actor = approver.for_request(guest.operation or "", request_id=guest.request_id, address=guest.address)
    after: Metadata = {
        "method": f"login by {approval.kind}",
        "prefix": secret.prefix,
        "expires_at": expires_at.isoformat(),
    }
    await audit(db, actor, Event("token.create", "token", token_id, request.name, after=after))
    return accounts.SignedIn(token=secret.text, person=approver.ref, expires_at=expires_at)


async def _delete_old_requests(db: Connection) -> None:
    is_old = login_request.c.expires_at < func.now() - datetime.timedelta(seconds=_RETENTION_S)
    # Undecided requests are deleted when they expire, which frees their user codes.
    await db.execute(delete(login_request).where(or_(is_old, _UNDECIDED & (login_request.c.expires_at < func.now()))))


def _is_undecided(user_code: str) -> ColumnElement[bool]:
    letters = "".join(letter for letter in user_code.upper() if letter.isalpha())
    return (login_request.c.user_code == letters) & _UNDECIDED & (login_request.c.expires_at > func.now())


def _in(seconds: float) -> ColumnElement[datetime.datetime]:
    return func.now() + datetime.timedelta(seconds=seconds)


def _as_label(client: str) -> str:
    """Return the client name of a program as a token name."""
    return check_label(client.replace(",", " ")[:MAX_LABEL_CHARACTERS].strip() or "klein")
