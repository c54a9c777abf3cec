"""Local accounts: passwords, invitations by an admin, and reset links.

Nothing reveals to guests whether an account exists: a wrong password takes equally long without one. Passwords are
hashed with argon2id, in threads, never inside a transaction.
"""

import asyncio
import re
import secrets
import uuid
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import TypeVar

import argon2
from argon2.exceptions import InvalidHashError, VerificationError
from sqlalchemy import func, select, update
from sqlalchemy.dialects.postgresql import insert as upsert

from kleinkram.contract import accounts, errors
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.people import email_key
from kleinkram.server.access.actor import Actor, find_person
from kleinkram.server.access.builtin_groups import add_person, add_verified_address
from kleinkram.server.access.rights import ensure_active_person, lock_person
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.auth.one_time_codes import CodeRequest, create_code, require_person, use_code
from kleinkram.server.auth.sessions import end_sessions
from kleinkram.server.db import Connection, Database
from kleinkram.server.runs.eligibility import known_runners
from kleinkram.server.settings import Settings
from kleinkram.server.tables import password, person, person_email
from kleinkram.server.tables.sign_in import CodePurpose
from kleinkram.server.tokens.service import end_personal_tokens

T = TypeVar("T")

# About 65 ms on a slow core; above OWASP's minimum (19 MiB, two passes).
_argon2 = argon2.PasswordHasher(time_cost=2, memory_cost=32_768, parallelism=1, hash_len=32, salt_len=16)
# Each hash takes 32 MiB and a core.
_MAX_CONCURRENT = 2
_MAX_WAITING = 30
_RETRY_AFTER_S = 5.0
# zxcvbn's scores are 0 to 4; below 3, a hundred million guesses suffice.
_MIN_SCORE = 3
# zxcvbn refuses longer passwords.
_MAX_SCORED_CHARACTERS = 72
_PRODUCT_NAMES = ("kleinkram", "klein")
_MIN_WORD_CHARACTERS = 3
_MIN_OTHER_CHARACTERS = 6


class PasswordHasher:
    """Hashes and verifies passwords in threads, a few at a time."""

    def __init__(self) -> None:
        self._slots = asyncio.Semaphore(_MAX_CONCURRENT)
        self._waiting = 0

    async def hash(self, password: str) -> str:
        """Return the hash of a password. Raises SlowDown."""
        return await self._run(lambda: _argon2.hash(password))

    async def hash_new(self, password: str, *, field: str, about: tuple[str | None, ...]) -> str:
        """Return the hash of a newly chosen password; `about` are the person's names and addresses.

        Raises InvalidRequest or SlowDown.
        """
        refuse_obvious_password(password, field=field, about=about)
        await self._run(lambda: _refuse_weak(password, field=field, about=about))
        return await self.hash(password)

    async def verify(self, hashed: str | None, password: str) -> bool:
        """Whether a password matches a hash; with None, take equally long and return False. Raises SlowDown."""

        def matches() -> bool:
            try:
                return _argon2.verify(hashed or _unknown_hash(), password)
            except (VerificationError, InvalidHashError):
                return False

        return await self._run(matches) and hashed is not None

    @staticmethod
    def is_outdated(hashed: str) -> bool:
        """Whether a hash was made with other parameters than the current ones."""
        return _argon2.check_needs_rehash(hashed)

    async def _run(self, work: Callable[[], T]) -> T:
        if self._waiting >= _MAX_WAITING:
            raise errors.SlowDown(interval_s=_RETRY_AFTER_S)
        self._waiting += 1
        try:
            async with self._slots:
                return await asyncio.to_thread(work)
        finally:
            self._waiting -= 1


@cache
def _unknown_hash() -> str:
    return _argon2.hash(secrets.token_urlsafe(accounts.MAX_PASSWORD_CHARACTERS // 8))


def refuse_obvious_password(password: str, *, field: str, about: tuple[str | None, ...]) -> None:
    """Refuse a password that is little more than a name or address of the person, or of this software.

    Raises InvalidRequest.
    """
    folded = "".join(letter for letter in password.casefold() if letter.isalnum())
    rest = folded
    for word in sorted(_words_of((*about, *_PRODUCT_NAMES)), key=len, reverse=True):
        rest = rest.replace(word, "")
    if rest != folded and len(rest) < _MIN_OTHER_CHARACTERS:
        message = "is little more than your name or address, or the name of this server; choose another"
        raise errors.InvalidRequest(problems=[errors.FieldProblem(field=field, message=message)])


def _words_of(texts: tuple[str | None, ...]) -> set[str]:
    """Return the words of names and addresses that are long enough to matter."""
    words = {word for text in texts if text for word in re.findall(r"[^\W_]+", text.casefold())}
    whole = {"".join(re.findall(r"[^\W_]+", text.casefold())) for text in texts if text}
    return {word for word in words | whole if len(word) >= _MIN_WORD_CHARACTERS}


def _refuse_weak(password: str, *, field: str, about: tuple[str | None, ...]) -> None:
    from zxcvbn import zxcvbn  # loads large word lists

    result = zxcvbn(password[:_MAX_SCORED_CHARACTERS], user_inputs=sorted(_words_of((*about, *_PRODUCT_NAMES))))
    if result["score"] >= _MIN_SCORE:
        return
    reason = str(result["feedback"]["warning"]).rstrip(".") or "It is easy to guess"
    message = (
        f"is not safe: {reason[0].lower()}{reason[1:]}. Choose another, such as four words that do not belong together"
    )
    raise errors.InvalidRequest(problems=[errors.FieldProblem(field=field, message=message)])


@dataclass(frozen=True)
class VerifiedPassword:
    """A person who entered their password, and the hash it matched, which is checked again at sign-in."""

    person_id: uuid.UUID
    password_hash: str


async def verify_password(
    database: Database, hasher: PasswordHasher, sign_in: accounts.PasswordSignIn
) -> VerifiedPassword:
    """Return the person with this address and password; a hash with old parameters is renewed.

    Raises SignInFailed or SlowDown.
    """
    is_active = person.c.deactivated_at.is_(None) & person_email.c.verified_at.is_not(None)
    stmt = select(person.c.id, password.c.hash).join_from(person_email, person).join(password)
    async with database.begin() as db:
        rows = await db.execute(stmt.where(person_email.c.email_key == email_key(sign_in.email), is_active))
        row = rows.one_or_none()
    if not await hasher.verify(None if row is None else row.hash, sign_in.password) or row is None:
        raise errors.SignInFailed
    if not hasher.is_outdated(row.hash):
        return VerifiedPassword(row.id, row.hash)
    renewed = await hasher.hash(sign_in.password)
    async with database.begin() as db:
        is_unchanged = (password.c.person_id == row.id) & (password.c.hash == row.hash)
        await db.execute(update(password).where(is_unchanged).values(hash=renewed))
    return VerifiedPassword(row.id, renewed)


async def require_unchanged_password(db: Connection, verified: VerifiedPassword) -> None:
    """Check that a password has not changed since it was verified. Raises SignInFailed."""
    stmt = select(password.c.hash).where(password.c.person_id == verified.person_id).with_for_update(read=True)
    if (await db.execute(stmt)).scalar_one_or_none() != verified.password_hash:
        raise errors.SignInFailed


async def verify_own_password(
    database: Database, hasher: PasswordHasher, actor: Actor, entered: str
) -> VerifiedPassword:
    """Verify the password of the signed-in person. Raises SignInFailed."""
    async with database.begin() as db:
        stmt = select(password.c.hash).where(password.c.person_id == actor.person_id)
        password_hash: str | None = (await db.execute(stmt)).scalar_one_or_none()
    if not await hasher.verify(password_hash, entered) or password_hash is None or actor.person_id is None:
        raise errors.SignInFailed
    return VerifiedPassword(actor.person_id, password_hash)


async def change_password(
    db: Connection, actor: Actor, *, verified: VerifiedPassword, new: str, password_hash: str
) -> None:
    """Change the actor's password and sign their other browsers out. Raises InvalidRequest or SignInFailed."""
    await require_unchanged_password(db, verified)
    await _set_checked_password(
        db, verified.person_id, name=actor.name, new=new, password_hash=password_hash, field="new_password"
    )
    await end_sessions(db, actor, except_session_id=actor.session_id)
    await audit(db, actor, Event("password.change", "person", actor.person_id, actor.name))


async def create_invitation(
    db: Connection, actor: Actor, *, invitation: accounts.InvitationCreate, settings: Settings
) -> accounts.OneTimeLink:
    """Return a link that invites a person to an account; earlier ones for the address become invalid.

    Raises Forbidden or NameTaken.
    """
    if not settings.local_accounts and not settings.oidc_providers:
        raise errors.Forbidden(
            resource_type="server",
            operation="invite people",
            needs="local accounts, which this server has switched off",
        )
    if await has_account(db, invitation.email):
        raise errors.NameTaken(resource_type="person", name=invitation.email)
    request = CodeRequest(
        CodePurpose.invitation,
        settings.invitation_s,
        email=invitation.email,
        name=invitation.name,
        created_by_id=actor.person_id,
    )
    code = await create_code(db, request)
    after: Metadata = {"email": invitation.email, "expires_at": code.expires_at.isoformat()}
    await audit(db, actor, Event("invitation.create", "invitation", code.id, invitation.email, after=after))
    warning = (await known_runners(db, settings.weakest_isolation)).invitation_warning()
    return code.link(settings, CodePurpose.invitation).model_copy(update={"warning": warning})


async def accept_invitation(
    db: Connection, actor: Actor, *, accepted: accounts.InvitationAccept, password_hash: str
) -> uuid.UUID:
    """Create the account that a link invites to; returns the person.

    Raises CodeGone, SignInRefused or InvalidRequest.
    """
    code = await use_code(db, accepted.code, CodePurpose.invitation)
    email = code.email or ""  # of invitations, never null
    name = accepted.name or code.name or email.partition("@")[0]
    refuse_obvious_password(accepted.password, field="password", about=(name, email))
    person_id = await add_person(db, name=name)
    if not await add_verified_address(db, person_id, email, by="invitation"):
        raise errors.SignInRefused(reason=f"{email} has an account already. Sign in with it.")
    await _set_checked_password(
        db, person_id, name=name, new=accepted.password, password_hash=password_hash, field="password"
    )
    invited_by = None if code.created_by_id is None else str(code.created_by_id)
    after: Metadata = {"method": "invitation", "email": email, "invited_by": invited_by}
    await audit(db, actor, Event("person.create", "person", person_id, name, after=after))
    return person_id


async def create_reset_link(
    db: Connection, actor: Actor, *, person_id: uuid.UUID, settings: Settings
) -> accounts.OneTimeLink:
    """Return a link with which a person chooses a new password; an earlier one becomes invalid.

    Raises NotFound or Forbidden.
    """
    if not settings.local_accounts:
        raise errors.Forbidden(
            resource_type="server",
            operation="reset a password",
            needs="local accounts, which this server has switched off",
        )
    owner = await find_person(db, person_id)
    if owner is None:
        raise errors.NotFound(resource_type="person", ref=str(person_id))
    request = CodeRequest(CodePurpose.reset, settings.reset_link_s, person_id=person_id, created_by_id=actor.person_id)
    code = await create_code(db, request)
    after: Metadata = {"expires_at": code.expires_at.isoformat()}
    await audit(db, actor, Event("password.reset_link", "person", person_id, owner.name, after=after))
    return code.link(settings, CodePurpose.reset)


async def reset_password(
    db: Connection, guest: Actor, *, reset: accounts.PasswordReset, password_hash: str
) -> uuid.UUID:
    """Set a new password with an admin's link; returns the person.

    Signs all browsers of the person out and revokes their personal tokens.

    Raises CodeGone, SignInRefused or InvalidRequest.
    """
    person_id = require_person(await use_code(db, reset.code, CodePurpose.reset))
    owner = await find_person(db, person_id)
    if owner is None:
        raise errors.SignInRefused(reason="this account is deactivated. Ask an admin of this server.")
    actor = owner.for_request(guest.operation or "", request_id=guest.request_id, address=guest.address)
    await lock_person(db, person_id)
    await _set_checked_password(
        db, person_id, name=owner.name, new=reset.password, password_hash=password_hash, field="password"
    )
    ended: Metadata = {"sessions": await end_sessions(db, actor), "tokens": await end_personal_tokens(db, actor)}
    await audit(db, actor, Event("password.reset", "person", person_id, owner.name, after=ended))
    return person_id


async def has_account(db: Connection, email: str) -> bool:
    """Whether an account has an address. Must not be revealed to guests."""
    stmt = select(person_email.c.person_id).where(person_email.c.email_key == email_key(email))
    return (await db.execute(stmt)).first() is not None


async def set_password(db: Connection, person_id: uuid.UUID, password_hash: str) -> None:
    """Set or replace a person's password. Raises NotAuthenticated if they were deactivated or erased just now."""
    await ensure_active_person(db, person_id)
    row = upsert(password).values(person_id=person_id, hash=password_hash)
    renewed = {"hash": password_hash, "changed_at": func.now()}
    await db.execute(row.on_conflict_do_update(index_elements=["person_id"], set_=renewed))


async def _set_checked_password(
    db: Connection, person_id: uuid.UUID, *, name: str, new: str, password_hash: str, field: str
) -> None:
    addresses = select(person_email.c.email).where(person_email.c.person_id == person_id)
    refuse_obvious_password(new, field=field, about=(name, *(await db.execute(addresses)).scalars()))
    await set_password(db, person_id, password_hash)
