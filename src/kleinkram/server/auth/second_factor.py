"""The second factor of local accounts: time-based codes (TOTP, RFC 6238) and recovery codes.

It applies to signing in with a password; providers have second factors of their own. The secret is stored in plain,
since every check needs it, and leaves the server only when it is enrolled.
"""

import base64
import datetime
import secrets
import time
import uuid
from typing import NamedTuple

import pyotp
import segno
from sqlalchemy import ColumnElement, case, delete, func, insert, select, update
from sqlalchemy.dialects.postgresql import insert as upsert

from kleinkram.contract import accounts, errors
from kleinkram.server.access.actor import Actor, find_person, secret_hash
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.auth.sessions import end_sessions
from kleinkram.server.db import Connection, Database
from kleinkram.server.settings import Settings
from kleinkram.server.tables import password, person_email, recovery_code, totp

_PERIOD_S = 30
# A device's clock may be this many periods ahead or behind.
_MAX_DRIFT = 1
_MAX_FAILURES = 10
_LOCKOUT = datetime.timedelta(minutes=15)
_RECOVERY_CODES = 10
_RECOVERY_BYTES = 10


class _Totp(NamedTuple):
    person_id: uuid.UUID
    secret: str
    last_step: int
    is_locked_out: bool


async def read_totp(db: Connection, person_id: uuid.UUID | None) -> accounts.TotpRead | None:
    """Return a person's second factor and the number of their recovery codes; None without one."""
    codes_left = select(func.count()).where(recovery_code.c.person_id == totp.c.person_id).scalar_subquery()
    stmt = select(totp.c.confirmed_at, codes_left.label("codes_left")).where(
        totp.c.person_id == person_id, _is_confirmed()
    )
    row = (await db.execute(stmt)).one_or_none()
    return None if row is None else accounts.TotpRead(enabled_at=row.confirmed_at, recovery_codes_left=row.codes_left)


async def begin_totp(db: Connection, actor: Actor, *, settings: Settings) -> accounts.TotpEnrolment:
    """Create a secret for an authenticator app; it takes effect once one of its codes is confirmed.

    Raises Forbidden or NameTaken.
    """
    has_password = select(password.c.person_id).where(password.c.person_id == actor.person_id)
    if actor.person_id is None or (await db.execute(has_password)).first() is None:
        needs = "an account with a password; providers have second factors of their own"
        raise errors.Forbidden(resource_type="account", operation="add a second factor", needs=needs)
    secret = pyotp.random_base32()
    row = upsert(totp).values(person_id=actor.person_id, secret=secret)
    new_values = {"secret": secret, "created_at": func.now()}
    stmt = row.on_conflict_do_update(index_elements=["person_id"], set_=new_values, where=~_is_confirmed())
    if (await db.execute(stmt.returning(totp.c.person_id))).first() is None:
        raise errors.NameTaken(resource_type="second factor", name=actor.name)
    email = select(person_email.c.email).where(person_email.c.person_id == actor.person_id).limit(1)
    account = (await db.execute(email)).scalar_one_or_none() or actor.name
    url = pyotp.TOTP(secret).provisioning_uri(name=account, issuer_name=settings.lab_name)
    qr_code: str = segno.make(url, error="m").svg_data_uri(scale=5, border=4, light="white")
    return accounts.TotpEnrolment(secret=secret, url=url, qr=qr_code)


async def confirm_totp(database: Database, actor: Actor, *, code: str) -> accounts.RecoveryCodes:
    """Confirm a second factor with one of its codes, and sign the actor's other browsers out.

    Raises NotFound or SecondFactorWrong.
    """
    async with database.begin() as db:
        enrolled = await _lock_totp(db, actor.person_id, ~_is_confirmed())
        if enrolled is None or actor.person_id is None:
            raise errors.NotFound(resource_type="second factor to confirm", ref=actor.name)
        if await _is_correct(db, enrolled, code):
            stmt = update(totp).where(totp.c.person_id == actor.person_id).values(confirmed_at=func.now())
            await db.execute(stmt)
            await end_sessions(db, actor, except_session_id=actor.session_id)
            await audit(db, actor, Event("totp.enable", "person", actor.person_id, actor.name))
            return await _create_recovery_codes(db, actor.person_id)
    raise _wrong()


async def renew_recovery_codes(db: Connection, actor: Actor) -> accounts.RecoveryCodes:
    """Replace the recovery codes. Raises NotFound."""
    if actor.person_id is None or await read_totp(db, actor.person_id) is None:
        raise errors.NotFound(resource_type="second factor", ref=actor.name)
    await audit(db, actor, Event("totp.renew_codes", "person", actor.person_id, actor.name))
    return await _create_recovery_codes(db, actor.person_id)


async def disable_totp(db: Connection, actor: Actor) -> None:
    """Remove the actor's second factor. Raises NotFound."""
    stmt = delete(totp).where(totp.c.person_id == actor.person_id, _is_confirmed()).returning(totp.c.person_id)
    if (await db.execute(stmt)).first() is None:
        raise errors.NotFound(resource_type="second factor", ref=actor.name)
    await audit(db, actor, Event("totp.disable", "person", actor.person_id, actor.name))


async def reset_totp(db: Connection, admin: Actor, *, person_id: uuid.UUID) -> None:
    """Remove the second factor of a person who lost their device and recovery codes. Raises NotFound."""
    owner = await find_person(db, person_id)
    stmt = delete(totp).where(totp.c.person_id == person_id).returning(totp.c.person_id)
    if owner is None or (await db.execute(stmt)).first() is None:
        raise errors.NotFound(resource_type="second factor", ref=str(person_id))
    await audit(db, admin, Event("totp.reset", "person", person_id, owner.name, needs_admin=True))


async def require_second_factor(database: Database, person_id: uuid.UUID, code: str | None, actor: Actor) -> None:
    """Check the second factor of a person who entered their password, if the account has one.

    In a transaction of its own, so that the code is used up, or a wrong one counted, even if the request fails.

    Raises SecondFactorNeeded or SecondFactorWrong.
    """
    async with database.begin() as db:
        enrolled = await _lock_totp(db, person_id, _is_confirmed())
        if enrolled is None:
            return
        is_correct = bool(code) and await _is_correct(db, enrolled, code or "", actor)
    if not code:
        raise errors.SecondFactorNeeded
    if not is_correct:
        raise _wrong()


def _is_confirmed() -> ColumnElement[bool]:
    return totp.c.confirmed_at.is_not(None)


async def _lock_totp(db: Connection, person_id: uuid.UUID | None, condition: ColumnElement[bool]) -> _Totp | None:
    has_failed_lately = totp.c.failed_at.is_not(None) & (totp.c.failed_at > func.now() - _LOCKOUT)
    is_locked_out = (has_failed_lately & (totp.c.failed_count >= _MAX_FAILURES)).label("is_locked_out")
    columns = totp.c.person_id, totp.c.secret, totp.c.last_step, is_locked_out
    stmt = select(*columns).where(totp.c.person_id == person_id, condition).with_for_update()
    row = (await db.execute(stmt)).one_or_none()
    return None if row is None else _Totp(*row)


async def _is_correct(db: Connection, enrolled: _Totp, code: str, guest: Actor | None = None) -> bool:
    """Check a code and use it up; the person's row is locked, so that a concurrent second use is a replay."""
    if enrolled.is_locked_out:
        return False
    text = code.replace(" ", "").replace("-", "").upper()
    stmt = update(totp).where(totp.c.person_id == enrolled.person_id)
    device, now = pyotp.TOTP(enrolled.secret, interval=_PERIOD_S), int(time.time()) // _PERIOD_S
    steps = range(now - _MAX_DRIFT, now + _MAX_DRIFT + 1)
    matching = [step for step in steps if secrets.compare_digest(device.generate_otp(step).encode(), text.encode())]
    # Codes up to the last accepted one are replays.
    step = next((step for step in matching if step > enrolled.last_step), None)
    if step is not None:
        await db.execute(stmt.values(last_step=step, failed_count=0, failed_at=None))
        return True
    use_recovery_code = delete(recovery_code).where(
        recovery_code.c.person_id == enrolled.person_id, recovery_code.c.secret_sha256 == secret_hash(text)
    )
    if guest is not None and (await db.execute(use_recovery_code.returning(recovery_code.c.person_id))).first():
        await db.execute(stmt.values(failed_count=0, failed_at=None))
        owner = await find_person(db, enrolled.person_id)
        name = "" if owner is None else owner.name
        await audit(db, owner or guest, Event("totp.use_recovery_code", "person", enrolled.person_id, name))
        return True
    # After the lockout, counting starts at zero.
    count = case((totp.c.failed_at > func.now() - _LOCKOUT, totp.c.failed_count), else_=0) + 1
    await db.execute(stmt.values(failed_count=count, failed_at=func.now()))
    return False


def _wrong() -> errors.SecondFactorWrong:
    return errors.SecondFactorWrong(max_attempts=_MAX_FAILURES, minutes=_LOCKOUT.total_seconds() / 60)


async def _create_recovery_codes(db: Connection, person_id: uuid.UUID) -> accounts.RecoveryCodes:
    await db.execute(delete(recovery_code).where(recovery_code.c.person_id == person_id))
    codes = [base64.b32encode(secrets.token_bytes(_RECOVERY_BYTES)).decode() for _ in range(_RECOVERY_CODES)]
    rows = [{"person_id": person_id, "secret_sha256": secret_hash(code)} for code in codes]
    await db.execute(insert(recovery_code), rows)
    return accounts.RecoveryCodes(codes=["-".join(code[at : at + 4] for at in range(0, 16, 4)) for code in codes])
