"""The second factor of local accounts: time-based codes (TOTP, RFC 6238) and recovery codes.

It applies to signing in with a password; providers have second factors of their own. The secret is stored in plain,
since every check needs it, and leaves the server only when it is enrolled.
"""

import base64
import datetime
import enum
import secrets
import time
import uuid
from typing import Any, NamedTuple

import pyotp
import segno
from sqlalchemy import ColumnElement, Select, case, delete, exists, func, insert, select, update
from sqlalchemy.dialects.postgresql import insert as upsert

from kleinkram.contract.access import GroupKind, Scope
from kleinkram.contract.accounts import (
    AccountRead,
    AddressRead,
    CredentialKind,
    CredentialRead,
    IdentityRead,
    MeRead,
    RecoveryCodes,
    TotpEnrolment,
    TotpRead,
)
from kleinkram.contract.errors import (
    Forbidden,
    LastSignInMethod,
    NameTaken,
    NotAuthenticated,
    NotFound,
    SecondFactorNeeded,
    SecondFactorWrong,
)
from kleinkram.contract.metadata import Metadata
from kleinkram.server.access.actor import Actor, ActorKind, find_person, secret_hash, unexpired
from kleinkram.server.access.groups import OWNER_ID
from kleinkram.server.access.rights import lock_person
from kleinkram.server.audit.service import Event, record
from kleinkram.server.auth.sessions import end_sessions
from kleinkram.server.db import Connection, Database
from kleinkram.server.settings import Settings
from kleinkram.server.tables import (
    access_group,
    identity,
    membership,
    password,
    person,
    person_email,
    recovery_code,
    session,
    token,
    totp,
)

_PERIOD_S = 30
# A device's clock may be this many periods ahead or behind.
_MAX_DRIFT = 1
_MAX_FAILURES = 10
_LOCKOUT = datetime.timedelta(minutes=15)
_RECOVERY_CODES = 10
_RECOVERY_BYTES = 10


class _Result(enum.Enum):
    not_required = "not_required"
    missing = "missing"
    wrong = "wrong"
    correct = "correct"


class _Totp(NamedTuple):
    person_id: uuid.UUID
    secret: str
    last_step: int
    is_locked_out: bool


async def read_totp(db: Connection, person_id: uuid.UUID | None) -> TotpRead | None:
    """Return a person's second factor and the number of their recovery codes; None without one."""
    codes_left = select(func.count()).where(recovery_code.c.person_id == totp.c.person_id).scalar_subquery()
    stmt = select(totp.c.confirmed_at, codes_left.label("codes_left")).where(
        totp.c.person_id == person_id, _is_confirmed()
    )
    row = (await db.execute(stmt)).one_or_none()
    return None if row is None else TotpRead(enabled_at=row.confirmed_at, recovery_codes_left=row.codes_left)


async def begin_totp(db: Connection, actor: Actor, *, settings: Settings) -> TotpEnrolment:
    """Create a secret for an authenticator app; it takes effect once one of its codes is confirmed.

    Raises Forbidden or NameTaken.
    """
    has_password = select(password.c.person_id).where(password.c.person_id == actor.person_id)
    if actor.person_id is None or (await db.execute(has_password)).first() is None:
        needs = "an account with a password; providers have second factors of their own"
        raise Forbidden(noun="account", operation="add a second factor", needs=needs)
    secret = pyotp.random_base32()
    row = upsert(totp).values(person_id=actor.person_id, secret=secret)
    new_values = {"secret": secret, "created_at": func.now()}
    stmt = row.on_conflict_do_update(index_elements=["person_id"], set_=new_values, where=~_is_confirmed())
    if (await db.execute(stmt.returning(totp.c.person_id))).first() is None:
        raise NameTaken(noun="second factor", name=actor.name)
    email = select(person_email.c.email).where(person_email.c.person_id == actor.person_id).limit(1)
    account = (await db.execute(email)).scalar_one_or_none() or actor.name
    url = pyotp.TOTP(secret).provisioning_uri(name=account, issuer_name=settings.lab_name)
    qr_code: str = segno.make(url, error="m").svg_data_uri(scale=5, border=4, light="white")
    return TotpEnrolment(secret=secret, url=url, qr=qr_code)


async def confirm_totp(database: Database, actor: Actor, *, code: str) -> RecoveryCodes:
    """Confirm a second factor with one of its codes, and sign the actor's other browsers out.

    Raises NotFound or SecondFactorWrong.
    """
    async with database.begin() as db:
        enrolled = await _lock_totp(db, actor.person_id, ~_is_confirmed())
        if enrolled is None or actor.person_id is None:
            raise NotFound(noun="second factor to confirm", ref=actor.name)
        result = await _check(db, enrolled, code)
        if result is _Result.correct:
            stmt = update(totp).where(totp.c.person_id == actor.person_id).values(confirmed_at=func.now())
            await db.execute(stmt)
            await end_sessions(db, actor, except_session_id=actor.session_id)
            await record(db, actor, Event("totp.enable", "person", actor.person_id, actor.name, None))
            return await _create_recovery_codes(db, actor.person_id)
    raise _wrong()


async def renew_recovery_codes(db: Connection, actor: Actor) -> RecoveryCodes:
    """Replace the recovery codes. Raises NotFound."""
    if actor.person_id is None or await read_totp(db, actor.person_id) is None:
        raise NotFound(noun="second factor", ref=actor.name)
    await record(db, actor, Event("totp.renew_codes", "person", actor.person_id, actor.name, None))
    return await _create_recovery_codes(db, actor.person_id)


async def disable_totp(db: Connection, actor: Actor) -> None:
    """Remove the actor's second factor. Raises NotFound."""
    stmt = delete(totp).where(totp.c.person_id == actor.person_id, _is_confirmed()).returning(totp.c.person_id)
    if (await db.execute(stmt)).first() is None:
        raise NotFound(noun="second factor", ref=actor.name)
    await record(db, actor, Event("totp.disable", "person", actor.person_id, actor.name, None))


async def reset_totp(db: Connection, admin: Actor, *, person_id: uuid.UUID) -> None:
    """Remove the second factor of a person who lost their device and recovery codes. Raises NotFound."""
    owner = await find_person(db, person_id)
    stmt = delete(totp).where(totp.c.person_id == person_id).returning(totp.c.person_id)
    if owner is None or (await db.execute(stmt)).first() is None:
        raise NotFound(noun="second factor", ref=str(person_id))
    await record(db, admin, Event("totp.reset", "person", person_id, owner.name, None, by_power=True))


async def require_second_factor(database: Database, person_id: uuid.UUID, code: str | None, actor: Actor) -> None:
    """Check the second factor of a person who entered their password, if the account has one.

    In a transaction of its own: the code is used up, and a wrong one counts, whatever happens afterwards.

    Raises SecondFactorNeeded or SecondFactorWrong.
    """
    async with database.begin() as db:
        enrolled = await _lock_totp(db, person_id, _is_confirmed())
        result = _Result.not_required
        if enrolled is not None:
            result = _Result.missing if not code else await _check(db, enrolled, code, actor)
    if result is _Result.missing:
        raise SecondFactorNeeded
    if result is _Result.wrong:
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


async def _check(db: Connection, enrolled: _Totp, code: str, guest: Actor | None = None) -> _Result:
    """Check a code and use it up; the person's row is locked, so that a concurrent second use is a replay."""
    if enrolled.is_locked_out:
        return _Result.wrong
    text = code.replace(" ", "").replace("-", "").upper()
    stmt = update(totp).where(totp.c.person_id == enrolled.person_id)
    device, now = pyotp.TOTP(enrolled.secret, interval=_PERIOD_S), int(time.time()) // _PERIOD_S
    steps = range(now - _MAX_DRIFT, now + _MAX_DRIFT + 1)
    matching = [step for step in steps if secrets.compare_digest(device.generate_otp(step).encode(), text.encode())]
    # Codes up to the last accepted one are replays.
    step = next((step for step in matching if step > enrolled.last_step), None)
    if step is not None:
        await db.execute(stmt.values(last_step=step, failed_count=0, failed_at=None))
        return _Result.correct
    use_recovery_code = delete(recovery_code).where(
        recovery_code.c.person_id == enrolled.person_id, recovery_code.c.secret_sha256 == secret_hash(text)
    )
    if guest is not None and (await db.execute(use_recovery_code.returning(recovery_code.c.person_id))).first():
        await db.execute(stmt.values(failed_count=0, failed_at=None))
        owner = await find_person(db, enrolled.person_id)
        name = "" if owner is None else owner.name
        await record(db, owner or guest, Event("totp.use_recovery_code", "person", enrolled.person_id, name, None))
        return _Result.correct
    # After the lockout, counting starts at zero.
    count = case((totp.c.failed_at > func.now() - _LOCKOUT, totp.c.failed_count), else_=0) + 1
    await db.execute(stmt.values(failed_count=count, failed_at=func.now()))
    return _Result.wrong


def _wrong() -> SecondFactorWrong:
    return SecondFactorWrong(max_attempts=_MAX_FAILURES, minutes=_LOCKOUT.total_seconds() / 60)


async def _create_recovery_codes(db: Connection, person_id: uuid.UUID) -> RecoveryCodes:
    await db.execute(delete(recovery_code).where(recovery_code.c.person_id == person_id))
    codes = [base64.b32encode(secrets.token_bytes(_RECOVERY_BYTES)).decode() for _ in range(_RECOVERY_CODES)]
    rows = [{"person_id": person_id, "secret_sha256": secret_hash(code)} for code in codes]
    await db.execute(insert(recovery_code), rows)
    return RecoveryCodes(codes=["-".join(code[at : at + 4] for at in range(0, 16, 4)) for code in codes])


async def get_me(db: Connection, actor: Actor) -> MeRead:
    """Return the actor and their credential.

    Addresses and groups are left out for tokens of robots and runners, which may be lost with their machine.

    Raises NotAuthenticated.
    """
    if actor.ref is None:
        raise NotAuthenticated(reason="this requires an account")
    is_person = actor.limits is None and actor.kind is ActorKind.person
    emails = select(person_email.c.email).where(
        person_email.c.person_id == actor.person_id, person_email.c.verified_at.is_not(None)
    )
    groups = (
        select(access_group.c.name)
        .join_from(membership, access_group)
        .where(
            membership.c.person_id == actor.person_id,
            unexpired(membership.c.expires_at),
            access_group.c.kind.not_in([GroupKind.person.value, GroupKind.email.value]),
        )
    )
    return MeRead(
        person=actor.ref,
        emails=sorted((await db.execute(emails)).scalars()) if is_person else [],
        groups=sorted((await db.execute(groups)).scalars()) if is_person else [],
        is_admin=actor.is_admin and Scope.admin in actor.scopes,
        credential=await _get_credential(db, actor),
    )


async def _get_credential(db: Connection, actor: Actor) -> CredentialRead:
    if actor.token_id is not None:
        row = (await db.execute(select(token).where(token.c.id == actor.token_id))).one()
        kind, name, scopes, is_limited = (
            CredentialKind(row.kind),
            row.name,
            [Scope(scope) for scope in row.scopes],
            row.is_limited,
        )
    else:
        row = (await db.execute(select(session).where(session.c.id == actor.session_id))).one()
        kind, name, scopes, is_limited = CredentialKind.session, row.method, sorted(actor.scopes), False
    return CredentialRead(
        id=row.id, kind=kind, name=name, scopes=scopes, is_limited=is_limited, expires_at=row.expires_at
    )


async def get_account(db: Connection, actor: Actor, *, settings: Settings) -> AccountRead:
    """Return the actor's account. Raises NotAuthenticated."""
    if actor.ref is None:
        raise NotAuthenticated(reason="this requires an account")
    created_at = (await db.execute(select(person.c.created_at).where(person.c.id == actor.person_id))).scalar_one()
    groups = select(access_group.c.name).join_from(membership, access_group)
    own = (membership.c.person_id == actor.person_id) & unexpired(membership.c.expires_at)
    affiliations = groups.where(own, access_group.c.kind == GroupKind.affiliation.value)
    return AccountRead(
        person=actor.ref,
        addresses=[
            AddressRead(email=row.email, verified_at=row.verified_at, verified_by=row.verified_by)
            for row in await db.execute(_addresses(actor))
        ],
        affiliations=sorted((await db.execute(affiliations)).scalars()),
        has_password=await _may_use_password(db, actor, settings),
        totp=await read_totp(db, actor.person_id),
        created_at=created_at,
    )


async def list_identities(db: Connection, actor: Actor, *, settings: Settings) -> list[IdentityRead]:
    """Return the actor's linked identities in the order in which they were linked."""
    linked = (identity.c.person_id == actor.person_id) & identity.c.unlinked_at.is_(None)
    stmt = select(identity).where(linked).order_by(identity.c.created_at, identity.c.id)
    rows = (await db.execute(stmt)).all()
    # Without a provider, people sign in with a password, and the owner with a link.
    has_other_method = actor.person_id == OWNER_ID and settings.owner_token_file is not None
    if not has_other_method and (await db.execute(_addresses(actor))).first() is not None:
        has_other_method = await _may_use_password(db, actor, settings)
    titles = {provider.issuer: provider.title for provider in settings.oidc_providers}
    # Identities of providers that left the settings no longer work.
    usable_ids = {row.id for row in rows if row.issuer in titles}
    return [
        IdentityRead(
            id=row.id,
            issuer=row.issuer,
            provider=titles.get(row.issuer),
            is_last=not has_other_method and not usable_ids - {row.id},
            email=row.email,
            created_at=row.created_at,
            last_used_at=row.last_used_at,
        )
        for row in rows
    ]


async def unlink_identity(db: Connection, actor: Actor, *, identity_id: uuid.UUID, settings: Settings) -> None:
    """Unlink an identity, so that it no longer opens the account. Raises NotFound or LastSignInMethod."""
    if actor.person_id is not None:
        # Serializes concurrent requests, which could otherwise unlink all identities.
        await lock_person(db, actor.person_id)
    identities = await list_identities(db, actor, settings=settings)
    unlinked = next((candidate for candidate in identities if candidate.id == identity_id), None)
    if unlinked is None:
        raise NotFound(noun="identity", ref=str(identity_id))
    name = unlinked.provider or unlinked.issuer
    if unlinked.is_last:
        raise LastSignInMethod(provider=name)
    await db.execute(update(identity).where(identity.c.id == identity_id).values(unlinked_at=func.now()))
    before: Metadata = {"issuer": unlinked.issuer, "email": unlinked.email, "person_id": str(actor.person_id)}
    await record(db, actor, Event("identity.unlink", "identity", identity_id, name, None, before=before))


def _addresses(actor: Actor) -> Select[Any]:
    verified = (person_email.c.person_id == actor.person_id) & person_email.c.verified_at.is_not(None)
    return select(person_email).where(verified).order_by(person_email.c.email_key)


async def _may_use_password(db: Connection, actor: Actor, settings: Settings) -> bool:
    has_password = exists().where(password.c.person_id == actor.person_id)
    return settings.local_accounts and bool((await db.execute(select(has_password))).scalar_one())
