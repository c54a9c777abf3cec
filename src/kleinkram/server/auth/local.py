"""Local accounts: invited by an admin, kept with a password, helped by an admin's link to a new one.

Nothing here tells a guest whether there is an account. Passwords are hashed and compared between transactions, never
inside one.
"""

import uuid
from dataclasses import dataclass

from sqlalchemy import func, select, update
from sqlalchemy.dialects.postgresql import insert as upsert

from kleinkram.contract.accounts import InvitationAccept, InvitationCreate, OneTimeLink, PasswordReset, PasswordSignIn
from kleinkram.contract.emails import email_key
from kleinkram.contract.errors import Forbidden, NameTaken, NotFound, SignInFailed, SignInRefused
from kleinkram.contract.metadata import Metadata
from kleinkram.server.access.actor import Actor, find_person
from kleinkram.server.access.groups import add_person, prove_address
from kleinkram.server.access.rights import lock_person
from kleinkram.server.audit.service import Event, record
from kleinkram.server.auth.codes import CodeWanted, find_code, make_code, use_code
from kleinkram.server.auth.passwords import Passwords, refuse_obvious
from kleinkram.server.auth.sessions import end_sessions
from kleinkram.server.db import Connection, Database
from kleinkram.server.runners.scheduling import has_single_person, invitation_warning, known_runners
from kleinkram.server.settings import Settings
from kleinkram.server.tables import password, person, person_email
from kleinkram.server.tables.signing_in import CodePurpose
from kleinkram.server.tokens.service import end_personal_tokens


@dataclass(frozen=True)
class Proven:
    """Whose password was given, and the hash that it was compared with: it must still be theirs when they sign in."""

    person_id: uuid.UUID
    hashed: str


async def prove_password(database: Database, passwords: Passwords, given: PasswordSignIn) -> Proven:
    """Return whose address and password these are; a hash made with older parameters is renewed.

    Raises:
        SignInFailed: nobody's who may sign in.
        SlowDown: too many sign in at the moment.
    """
    active = person.c.deactivated_at.is_(None) & person_email.c.verified_at.is_not(None)
    stmt = select(person.c.id, password.c.hash).join_from(person_email, person).join(password)
    async with database.begin() as db:
        found = await db.execute(stmt.where(person_email.c.email_key == email_key(given.email), active))
        row = found.one_or_none()
    if not await passwords.verify(None if row is None else row.hash, given.password) or row is None:
        raise SignInFailed
    if not passwords.is_outdated(row.hash):
        return Proven(row.id, row.hash)
    renewed = await passwords.hash(given.password)
    async with database.begin() as db:
        same = (password.c.person_id == row.id) & (password.c.hash == row.hash)
        await db.execute(update(password).where(same).values(hash=renewed))
    return Proven(row.id, renewed)


async def see_that_it_still_is(db: Connection, proven: Proven) -> None:
    """See that a password was not changed since it was compared.

    Raises:
        SignInFailed: it was.
    """
    stmt = select(password.c.hash).where(password.c.person_id == proven.person_id).with_for_update(read=True)
    if (await db.execute(stmt)).scalar_one_or_none() != proven.hashed:
        raise SignInFailed


async def prove_own_password(database: Database, passwords: Passwords, actor: Actor, given: str) -> Proven:
    """See that somebody who is signed in knows their password.

    Raises:
        SignInFailed: it is another, or they have none.
    """
    async with database.begin() as db:
        stmt = select(password.c.hash).where(password.c.person_id == actor.person_id)
        hashed: str | None = (await db.execute(stmt)).scalar_one_or_none()
    if not await passwords.verify(hashed, given) or hashed is None or actor.person_id is None:
        raise SignInFailed
    return Proven(actor.person_id, hashed)


async def change_password(db: Connection, actor: Actor, *, proven: Proven, new: str, hashed: str) -> None:
    """Take a new password for one's own; one's other browsers are signed out.

    Raises:
        InvalidRequest: it is one's name or address.
        SignInFailed: somebody changed it meanwhile.
    """
    await see_that_it_still_is(db, proven)
    await _keep_password(db, proven.person_id, name=actor.name, new=new, hashed=hashed, field="new_password")
    await end_sessions(db, actor, besides=actor.session_id)
    await record(db, actor, Event("password.change", "person", actor.person_id, actor.name, None))


async def make_invitation(db: Connection, actor: Actor, *, wanted: InvitationCreate, settings: Settings) -> OneTimeLink:
    """Return a link by which somebody gets an account; earlier ones to the address end.

    Raises:
        Forbidden: this server has no local accounts, and no provider that takes invitations.
        NameTaken: there is an account with this address.
    """
    if not settings.local_accounts and not settings.oidc_providers:
        raise Forbidden(noun="server", operation="invite people", needs="local accounts, which are switched off")
    if await has_account(db, wanted.email):
        raise NameTaken(noun="person", name=wanted.email)
    asked = CodeWanted(
        CodePurpose.invitation,
        settings.invitation_s,
        email=wanted.email,
        name=wanted.name,
        created_by_id=actor.person_id,
    )
    code = await make_code(db, asked)
    after: Metadata = {"email": wanted.email, "expires_at": code.expires_at.isoformat()}
    await record(db, actor, Event("invitation.create", "invitation", code.id, wanted.email, None, after=after))
    warning = invitation_warning(await known_runners(db), single_person=await has_single_person(db))
    return code.link(settings, CodePurpose.invitation).model_copy(update={"warning": warning})


async def accept_invitation(db: Connection, asker: Actor, *, accepted: InvitationAccept, hashed: str) -> uuid.UUID:
    """Make the account that a link invites to, and return whose it is.

    Raises:
        CodeGone: the link is not good any more.
        SignInRefused: there is an account with this address by now.
        InvalidRequest: the password is the name or the address.
    """
    row = await use_code(db, accepted.code, CodePurpose.invitation)
    name = accepted.name or row.name or row.email.partition("@")[0]
    refuse_obvious(accepted.password, field="password", about=(name, row.email))
    person_id = await add_person(db, name=name)
    if not await prove_address(db, person_id, row.email, by="invitation"):
        raise SignInRefused(reason=f"there is an account with {row.email} already. Sign in with it.")
    await _keep_password(db, person_id, name=name, new=accepted.password, hashed=hashed, field="password")
    invited_by = None if row.created_by_id is None else str(row.created_by_id)
    after: Metadata = {"way": "invitation", "email": row.email, "invited_by": invited_by}
    await record(db, asker, Event("person.create", "person", person_id, name, None, after=after))
    return person_id


async def make_reset(db: Connection, actor: Actor, *, person_id: uuid.UUID, settings: Settings) -> OneTimeLink:
    """Return a link by which somebody chooses a new password; an earlier one ends.

    Raises:
        NotFound: nobody has that id, or they left.
        Forbidden: this server has no local accounts.
    """
    if not settings.local_accounts:
        raise Forbidden(noun="server", operation="reset a password", needs="local accounts, which are switched off")
    whose = await find_person(db, person_id)
    if whose is None:
        raise NotFound(noun="person", ref=str(person_id))
    asked = CodeWanted(CodePurpose.reset, settings.reset_link_s, person_id=person_id, created_by_id=actor.person_id)
    code = await make_code(db, asked)
    after: Metadata = {"expires_at": code.expires_at.isoformat()}
    await record(db, actor, Event("password.reset_link", "person", person_id, whose.name, None, after=after))
    return code.link(settings, CodePurpose.reset)


async def whose_reset(db: Connection, code: str) -> uuid.UUID:
    """Return whose password an admin's link resets; the link stays good.

    Raises:
        CodeGone: the link is not good any more.
    """
    row = await find_code(db, code, CodePurpose.reset)
    person_id: uuid.UUID = row.person_id
    return person_id


async def reset_password(db: Connection, asker: Actor, *, reset: PasswordReset, hashed: str) -> uuid.UUID:
    """Take a new password by an admin's link; returns whose it is.

    Whoever had the account until now is out of it: all browsers are signed out, and all personal tokens end.

    Raises:
        CodeGone: the link is not good any more.
        SignInRefused: its person left.
        InvalidRequest: the password is the name or an address.
    """
    person_id: uuid.UUID = (await use_code(db, reset.code, CodePurpose.reset)).person_id
    whose = await find_person(db, person_id)
    if whose is None:
        raise SignInRefused(reason="this account was deactivated. An admin of this server can say why.")
    actor = whose.asking(asker.operation or "", request_id=asker.request_id, address=asker.address)
    await lock_person(db, person_id)
    await _keep_password(db, person_id, name=whose.name, new=reset.password, hashed=hashed, field="password")
    ended: Metadata = {"sessions": await end_sessions(db, actor), "tokens": await end_personal_tokens(db, actor)}
    await record(db, actor, Event("password.reset", "person", person_id, whose.name, None, after=ended))
    return person_id


async def has_account(db: Connection, email: str) -> bool:
    """Say whether an address is somebody's. For admins and the server itself, never for guests."""
    stmt = select(person_email.c.person_id).where(person_email.c.email_key == email_key(email))
    return (await db.execute(stmt)).first() is not None


async def keep_first_password(db: Connection, person_id: uuid.UUID, hashed: str) -> None:
    """Keep a password's hash, in place of any other."""
    row = upsert(password).values(person_id=person_id, hash=hashed)
    renewed = {"hash": hashed, "changed_at": func.now()}
    await db.execute(row.on_conflict_do_update(index_elements=["person_id"], set_=renewed))


async def _keep_password(db: Connection, person_id: uuid.UUID, *, name: str, new: str, hashed: str, field: str) -> None:
    addresses = select(person_email.c.email).where(person_email.c.person_id == person_id)
    refuse_obvious(new, field=field, about=(name, *(await db.execute(addresses)).scalars()))
    await keep_first_password(db, person_id, hashed)
