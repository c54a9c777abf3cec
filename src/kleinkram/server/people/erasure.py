"""Erasing a person: their data is deleted, and a pseudonym replaces their name wherever it is shown.

What they did stays on record: rows refer to the person by an id, and the audit log, whose entries repeat some names, is
redacted by a job. Texts that people wrote, such as notes and metadata, stay as they are; erasing reports them.
"""

import uuid
from dataclasses import dataclass

from sqlalchemy import delete, func, insert, or_, select, text, update

from kleinkram.contract.errors import FieldProblem, InvalidRequest, NotFound
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.people import Erasure, PersonRef, email_key
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.builtin_groups import OWNER_ID
from kleinkram.server.access.rights import lock_rights
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.auth.provider_accounts import lock_identities
from kleinkram.server.context import AppContext
from kleinkram.server.db import Connection
from kleinkram.server.jobs.queue import Job, Priority, enqueue
from kleinkram.server.people.mentions import find_mentions
from kleinkram.server.people.service import end_access
from kleinkram.server.tables import (
    access_group,
    erasure,
    identity,
    login_request,
    membership,
    oidc_login,
    one_time_code,
    password,
    person,
    person_email,
    runner,
    session,
    token,
    totp,
    viewer_layout,
)

_REDACT = text("SELECT redact_audit_log(:person_id)")


@dataclass(frozen=True)
class _Terms:
    """What identifies a person in texts."""

    names: list[str]
    addresses: list[str]


async def erase_person(db: Connection, actor: Actor, *, person_id: uuid.UUID, confirmation: str) -> Erasure:
    """Erase a person irrevocably; for a person who was erased before, return how far that is.

    Raises NotFound, InvalidRequest (`confirmation` is not their name) or LastAdmin.
    """
    await lock_identities(db)
    await lock_rights(db)
    row = (await db.execute(select(person).where(person.c.id == person_id).with_for_update())).one_or_none()
    if row is None:
        raise NotFound(resource_type="person", ref=str(person_id))
    if row.erased_at is not None:
        return await get_erasure(db, person_id)
    _require_confirmed(person_id, row.name, confirmation)
    terms = await _get_terms(db, person_id, row.name)
    mentions = await find_mentions(db, [*terms.names, *terms.addresses])
    departure, events = await end_access(db, person_id, row.name)
    pseudonym = f"erased person {str(person_id)[:8]}"
    after: Metadata = {**departure.model_dump(mode="json", exclude={"person"}), "mentions": len(mentions)}
    erased = Event("person.erase", "person", person_id, pseudonym, after=after, needs_admin=True)
    await audit(db, actor, erased, *events)
    await _delete_rights(db, person_id, terms)
    await _delete_sign_in_data(db, person_id, terms)
    # Nobody else sees the personal ones.
    await db.execute(
        delete(viewer_layout).where(viewer_layout.c.created_by_id == person_id, ~viewer_layout.c.is_shared)
    )
    await _replace_names(db, person_id, pseudonym)
    await db.execute(insert(erasure).values(person_id=person_id, names=terms.names, addresses=terms.addresses))
    await enqueue(db, Job.redact_audit_log, ids=[str(person_id)], priority=Priority.normal)
    ended = departure.model_dump(exclude={"person"})
    return (await get_erasure(db, person_id)).model_copy(update={**ended, "mentions": mentions})


async def get_erasure(db: Connection, person_id: uuid.UUID) -> Erasure:
    """Return the erasure of a person, without what it ended. Raises NotFound."""
    columns = person.c.id, person.c.name, person.c.erased_at, erasure.c.event_count
    stmt = select(*columns).join_from(person, erasure).where(person.c.id == person_id)
    row = (await db.execute(stmt)).one_or_none()
    if row is None:
        raise NotFound(resource_type="erased person", ref=str(person_id))
    return Erasure(person=PersonRef(id=row.id, name=row.name), erased_at=row.erased_at, audit_events=row.event_count)


async def redact_audit_log(context: AppContext, person_id: uuid.UUID) -> None:
    """Replace the names of an erased person in the audit log; does nothing the second time."""
    async with context.database.begin() as db:
        await db.execute(_REDACT, {"person_id": person_id})


def _require_confirmed(person_id: uuid.UUID, name: str, confirmation: str) -> None:
    if person_id == OWNER_ID:
        problem = FieldProblem(
            field="person_id", message="is the local owner of `klein up`, an account without personal data"
        )
        raise InvalidRequest(problems=[problem])
    if confirmation != name:
        message = f"is not the name of this person; type {name!r} to erase them"
        raise InvalidRequest(problems=[FieldProblem(field="body.confirmation", message=message)])


async def _get_terms(db: Connection, person_id: uuid.UUID, name: str) -> _Terms:
    addresses = select(person_email.c.email).where(person_email.c.person_id == person_id)
    provided = select(identity.c.email).where(identity.c.person_id == person_id, identity.c.email.is_not(None))
    rows = [*(await db.execute(addresses)).scalars(), *(await db.execute(provided)).scalars()]
    return _Terms([name], sorted(dict.fromkeys(rows)))


async def _delete_rights(db: Connection, person_id: uuid.UUID, terms: _Terms) -> None:
    """Delete memberships, grants to the person, and grants to their addresses."""
    keys = [email_key(address) for address in terms.addresses]
    own_addresses = select(person_email.c.email_key).where(person_email.c.person_id == person_id)
    is_address = (access_group.c.kind == "email") & access_group.c.name_key.in_(own_addresses)
    is_provided = (access_group.c.kind == "email") & access_group.c.name_key.in_(keys)
    # Of an address that the provider sent and somebody else has verified, the group is theirs.
    verified_by_others = select(person_email.c.email_key).where(person_email.c.person_id != person_id)
    is_provided &= access_group.c.name_key.not_in(verified_by_others)
    await db.execute(delete(membership).where(membership.c.person_id == person_id))
    await db.execute(delete(access_group).where(or_(access_group.c.person_id == person_id, is_address, is_provided)))


async def _delete_sign_in_data(db: Connection, person_id: uuid.UUID, terms: _Terms) -> None:
    """Delete what the person signed in with, so that their next sign-in makes a new account."""
    keys = [email_key(address) for address in terms.addresses]
    own_sessions = select(session.c.id).where(session.c.person_id == person_id)
    is_code = or_(one_time_code.c.person_id == person_id, func.lower(one_time_code.c.email).in_(keys))
    await db.execute(delete(one_time_code).where(is_code))
    await db.execute(delete(oidc_login).where(oidc_login.c.session_id.in_(own_sessions)))
    await db.execute(delete(login_request).where(login_request.c.approved_by_id == person_id))
    for table in (identity, password, totp, person_email):
        await db.execute(delete(table).where(table.c.person_id == person_id))


async def _replace_names(db: Connection, person_id: uuid.UUID, pseudonym: str) -> None:
    """Rename the person, and what they named and the audit log refers to: tokens and runners."""
    of_session = {"address": None, "user_agent": None, "provider_session_id": None}
    await db.execute(update(session).where(session.c.person_id == person_id).values(of_session))
    await db.execute(update(token).where(token.c.person_id == person_id).values(name=pseudonym))
    await db.execute(update(runner).where(runner.c.person_id == person_id).values(name=pseudonym))
    await db.execute(update(person).where(person.c.id == person_id).values(name=pseudonym, erased_at=func.now()))
