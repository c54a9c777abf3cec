"""The second factor of local accounts: time-based codes (RFC 6238), and recovery codes for whoever lost their device.

It belongs to signing in with a password: a provider asks for a second factor by itself. The secret is kept as it is,
since every check needs it, and leaves the server once, when it is enrolled.
"""

import base64
import datetime
import enum
import secrets
import time
import uuid
from typing import Any

import pyotp
import segno
from sqlalchemy import Row, case, delete, func, insert, select, update
from sqlalchemy.dialects.postgresql import insert as upsert

from kleinkram.contract.accounts import RecoveryCodes, TotpEnrolment, TotpRead
from kleinkram.contract.errors import Forbidden, NameTaken, NotFound, SecondFactorNeeded, SecondFactorWrong
from kleinkram.server.access.actor import Actor, find_person, secret_hash
from kleinkram.server.audit.service import Event, record
from kleinkram.server.auth.sessions import end_sessions
from kleinkram.server.db import Connection, Database
from kleinkram.server.settings import Settings
from kleinkram.server.tables import password, person_email, recovery_code, totp

_PERIOD_S = 30
# A device's clock may be so many periods ahead or behind.
_DRIFT = 1
_MOST_WRONG = 10
_PAUSE = datetime.timedelta(minutes=15)
_RECOVERY_CODES = 10
_RECOVERY_BYTES = 10


class _Outcome(enum.Enum):
    unneeded = "unneeded"
    missing = "missing"
    wrong = "wrong"
    right = "right"


async def read_totp(db: Connection, person_id: uuid.UUID | None) -> TotpRead | None:
    """Return since when somebody has a second factor and how many recovery codes are left; None without one."""
    left = select(func.count()).where(recovery_code.c.person_id == totp.c.person_id).scalar_subquery()
    stmt = select(totp.c.confirmed_at, left.label("left")).where(totp.c.person_id == person_id, _is_in_use())
    row = (await db.execute(stmt)).one_or_none()
    return None if row is None else TotpRead(enabled_at=row.confirmed_at, recovery_codes_left=row.left)


async def begin_totp(db: Connection, actor: Actor, *, settings: Settings) -> TotpEnrolment:
    """Make a secret for an authenticator app. It is in use once a code of it was confirmed; until then, another may be.

    Raises:
        Forbidden: the account has no password, so that nothing would ask for a code.
        NameTaken: it has a second factor already.
    """
    if actor.person_id is None or not await _has_password(db, actor.person_id):
        needs = "an account with a password; a provider asks for a second factor by itself"
        raise Forbidden(noun="account", operation="add a second factor", needs=needs)
    secret = pyotp.random_base32()
    row = upsert(totp).values(person_id=actor.person_id, secret=secret)
    fresh = {"secret": secret, "created_at": func.now()}
    kept = row.on_conflict_do_update(index_elements=["person_id"], set_=fresh, where=~_is_in_use())
    if (await db.execute(kept.returning(totp.c.person_id))).first() is None:
        raise NameTaken(noun="second factor", name=actor.name)
    email = select(person_email.c.email).where(person_email.c.person_id == actor.person_id).limit(1)
    account = (await db.execute(email)).scalar_one_or_none() or actor.name
    url = pyotp.TOTP(secret).provisioning_uri(name=account, issuer_name=settings.lab_name)
    picture: str = segno.make(url, error="m").svg_data_uri(scale=5, border=4, light="white")
    return TotpEnrolment(secret=secret, url=url, qr=picture)


async def confirm_totp(database: Database, actor: Actor, *, code: str) -> RecoveryCodes:
    """Take a second factor into use, by a code of it. One's other browsers are signed out.

    Raises:
        NotFound: none was begun, or it is in use already.
        SecondFactorWrong: the code is another.
    """
    async with database.begin() as db:
        row = (await db.execute(_locked(actor.person_id).where(~_is_in_use()))).one_or_none()
        if row is None or actor.person_id is None:
            raise NotFound(noun="second factor to confirm", ref=actor.name)
        outcome = await _check(db, row, code)
        if outcome is _Outcome.right:
            in_use = update(totp).where(totp.c.person_id == actor.person_id).values(confirmed_at=func.now())
            await db.execute(in_use)
            await end_sessions(db, actor, besides=actor.session_id)
            await record(db, actor, Event("totp.enable", "person", actor.person_id, actor.name, None))
            return await _new_recovery_codes(db, actor.person_id)
    raise _wrong()


async def renew_recovery_codes(db: Connection, actor: Actor) -> RecoveryCodes:
    """Return new recovery codes; those from before are good no more.

    Raises:
        NotFound: there is no second factor.
    """
    if actor.person_id is None or await read_totp(db, actor.person_id) is None:
        raise NotFound(noun="second factor", ref=actor.name)
    await record(db, actor, Event("totp.renew_codes", "person", actor.person_id, actor.name, None))
    return await _new_recovery_codes(db, actor.person_id)


async def disable_totp(db: Connection, actor: Actor) -> None:
    """Sign in with the password alone from now on.

    Raises:
        NotFound: there is no second factor.
    """
    gone = delete(totp).where(totp.c.person_id == actor.person_id, _is_in_use()).returning(totp.c.person_id)
    if (await db.execute(gone)).first() is None:
        raise NotFound(noun="second factor", ref=actor.name)
    await record(db, actor, Event("totp.disable", "person", actor.person_id, actor.name, None))


async def reset_totp(db: Connection, admin: Actor, *, person_id: uuid.UUID) -> None:
    """Take somebody's second factor away, who lost their device and their recovery codes.

    Raises:
        NotFound: nobody has that id, they left, or they have none.
    """
    whose = await find_person(db, person_id)
    gone = delete(totp).where(totp.c.person_id == person_id).returning(totp.c.person_id)
    if whose is None or (await db.execute(gone)).first() is None:
        raise NotFound(noun="second factor", ref=str(person_id))
    await record(db, admin, Event("totp.reset", "person", person_id, whose.name, None, by_power=True))


async def see_second_factor(database: Database, person_id: uuid.UUID, code: str | None, asker: Actor) -> None:
    """See that somebody who knew a password also has the second factor, where the account has one.

    In a transaction of its own: a code is used up, and a wrong one counts, whatever comes after.

    Raises:
        SecondFactorNeeded: no code was given.
        SecondFactorWrong: it is another, was used before, or too many were wrong.
    """
    async with database.begin() as db:
        row = (await db.execute(_locked(person_id).where(_is_in_use()))).one_or_none()
        outcome = _Outcome.unneeded
        if row is not None:
            outcome = _Outcome.missing if not code else await _check(db, row, code, asker)
    if outcome is _Outcome.missing:
        raise SecondFactorNeeded
    if outcome is _Outcome.wrong:
        raise _wrong()


def _is_in_use() -> Any:
    return totp.c.confirmed_at.is_not(None)


def _locked(person_id: uuid.UUID | None) -> Any:
    paused = totp.c.failed_at.is_not(None) & (totp.c.failed_at > func.now() - _PAUSE)
    columns = totp, (paused & (totp.c.failed_count >= _MOST_WRONG)).label("is_paused")
    return select(*columns).where(totp.c.person_id == person_id).with_for_update()


async def _check(db: Connection, row: Row[Any], code: str, asker: Actor | None = None) -> _Outcome:
    """Take a code, once; of a person whose row is locked, so that of two at once the second is a replay."""
    if row.is_paused:
        return _Outcome.wrong
    text = code.replace(" ", "").replace("-", "").upper()
    mine = update(totp).where(totp.c.person_id == row.person_id)
    step = _step_of(row, text)
    if step is not None:
        await db.execute(mine.values(last_step=step, failed_count=0, failed_at=None))
        return _Outcome.right
    used = delete(recovery_code).where(
        recovery_code.c.person_id == row.person_id, recovery_code.c.secret_sha256 == secret_hash(text)
    )
    if asker is not None and (await db.execute(used.returning(recovery_code.c.person_id))).first() is not None:
        await db.execute(mine.values(failed_count=0, failed_at=None))
        whose = await find_person(db, row.person_id)
        name = "" if whose is None else whose.name
        await record(db, whose or asker, Event("totp.use_recovery_code", "person", row.person_id, name, None))
        return _Outcome.right
    # After a pause, counting begins anew.
    count = case((totp.c.failed_at > func.now() - _PAUSE, totp.c.failed_count), else_=0) + 1
    await db.execute(mine.values(failed_count=count, failed_at=func.now()))
    return _Outcome.wrong


def _step_of(row: Row[Any], code: str) -> int | None:
    """Return the time step that a code is of, if it is later than that of the last one that was taken."""
    device, now = pyotp.TOTP(row.secret, interval=_PERIOD_S), int(time.time()) // _PERIOD_S
    steps = range(now - _DRIFT, now + _DRIFT + 1)
    right = [step for step in steps if secrets.compare_digest(device.generate_otp(step).encode(), code.encode())]
    return next((step for step in right if step > row.last_step), None)


def _wrong() -> SecondFactorWrong:
    return SecondFactorWrong(max_attempts=_MOST_WRONG, minutes=_PAUSE.total_seconds() / 60)


async def _has_password(db: Connection, person_id: uuid.UUID) -> bool:
    return (await db.execute(select(password.c.person_id).where(password.c.person_id == person_id))).first() is not None


async def _new_recovery_codes(db: Connection, person_id: uuid.UUID) -> RecoveryCodes:
    await db.execute(delete(recovery_code).where(recovery_code.c.person_id == person_id))
    made = [base64.b32encode(secrets.token_bytes(_RECOVERY_BYTES)).decode() for _ in range(_RECOVERY_CODES)]
    rows = [{"person_id": person_id, "secret_sha256": secret_hash(each)} for each in made]
    await db.execute(insert(recovery_code), rows)
    return RecoveryCodes(codes=["-".join(each[at : at + 4] for at in range(0, 16, 4)) for each in made])
