"""One-time codes: links for signing in, invitations, password resets, and the code of the first admin.

A code that an admin created ends with their admin rights, so that former admins cannot return with a link.
"""

import datetime
import secrets
import uuid
from dataclasses import dataclass, field
from typing import NamedTuple

from sqlalchemy import ColumnElement, delete, exists, func, insert, select, update

from kleinkram.contract.accounts import CodeRead, OneTimeLink
from kleinkram.contract.errors import CodeGone
from kleinkram.server.access.actor import secret_hash, unexpired
from kleinkram.server.access.builtin_groups import ADMINS_ID
from kleinkram.server.db import Connection
from kleinkram.server.settings import Settings
from kleinkram.server.tables import login_request, membership, oidc_login, one_time_code, person, used_logout_token
from kleinkram.server.tables.sign_in import CodePurpose

_SECRET_BYTES = 32
_PAGES = {CodePurpose.owner: "link", CodePurpose.invitation: "invitation", CodePurpose.reset: "reset"}


@dataclass(frozen=True)
class CodeRequest:
    """A code to create: for a person with an account, or for an invited address."""

    purpose: CodePurpose
    lifetime_s: float
    person_id: uuid.UUID | None = None
    email: str | None = None
    name: str | None = None
    created_by_id: uuid.UUID | None = None


@dataclass(frozen=True)
class NewCode:
    """A new code with its secret."""

    id: uuid.UUID
    secret: str = field(repr=False)
    expires_at: datetime.datetime

    def link(self, settings: Settings, purpose: CodePurpose) -> OneTimeLink:
        """Return the link with the code after the `#`."""
        url = f"{settings.public_url.rstrip('/')}/sign-in/{_PAGES[purpose]}#{self.secret}"
        return OneTimeLink(url=url, expires_at=self.expires_at)


class StoredCode(NamedTuple):
    """A valid code."""

    person_id: uuid.UUID | None
    email: str | None
    name: str | None
    created_by_id: uuid.UUID | None


_STORED = [one_time_code.c[name] for name in StoredCode._fields]


async def create_code(db: Connection, request: CodeRequest) -> NewCode:
    """Create a code; earlier ones for the same purpose and person or address become invalid."""
    is_unused = (one_time_code.c.purpose == request.purpose.value) & one_time_code.c.used_at.is_(None)
    for column, value in ((one_time_code.c.person_id, request.person_id), (one_time_code.c.email, request.email)):
        if value is not None:
            await db.execute(update(one_time_code).where(is_unused, column == value).values(used_at=func.now()))
    code_id, secret = uuid.uuid4(), secrets.token_urlsafe(_SECRET_BYTES)
    row = insert(one_time_code).values(
        id=code_id,
        purpose=request.purpose.value,
        secret_sha256=secret_hash(secret),
        person_id=request.person_id,
        email=request.email,
        name=request.name,
        created_by_id=request.created_by_id,
        expires_at=func.now() + datetime.timedelta(seconds=request.lifetime_s),
    )
    expires_at = (await db.execute(row.returning(one_time_code.c.expires_at))).scalar_one()
    return NewCode(code_id, secret, expires_at)


async def use_code(db: Connection, secret: str, purpose: CodePurpose) -> StoredCode:
    """Return a code and mark it as used. Raises CodeGone."""
    stmt = update(one_time_code).where(*_is_valid_code(secret), one_time_code.c.purpose == purpose.value)
    row = (await db.execute(stmt.values(used_at=func.now()).returning(*_STORED))).one_or_none()
    if row is None:
        raise CodeGone
    return StoredCode(*row)


async def get_code_person(db: Connection, secret: str, purpose: CodePurpose) -> uuid.UUID:
    """Return the person of a code without using it. Raises CodeGone."""
    stmt = select(one_time_code.c.person_id).where(*_is_valid_code(secret), one_time_code.c.purpose == purpose.value)
    person_id: uuid.UUID | None = (await db.execute(stmt)).scalar_one_or_none()
    if person_id is None:
        raise CodeGone
    return person_id


def require_person(code: StoredCode) -> uuid.UUID:
    """Return the person of a code whose purpose requires one."""
    if code.person_id is None:  # a constraint of the table forbids it
        raise CodeGone
    return code.person_id


async def revoke_codes(db: Connection, person_id: uuid.UUID) -> None:
    """Revoke the codes for a person and those that they created."""
    is_theirs = (one_time_code.c.person_id == person_id) | (one_time_code.c.created_by_id == person_id)
    stmt = update(one_time_code).where(is_theirs, one_time_code.c.used_at.is_(None))
    await db.execute(stmt.values(used_at=func.now()))


async def describe_code(db: Connection, secret: str) -> CodeRead:
    """Return the purpose and recipient of a code without using it. Raises CodeGone."""
    columns = one_time_code.c.purpose, one_time_code.c.email, one_time_code.c.name, person.c.name.label("person_name")
    stmt = select(*columns).outerjoin(person, person.c.id == one_time_code.c.person_id).where(*_is_valid_code(secret))
    row = (await db.execute(stmt)).one_or_none()
    if row is None:
        raise CodeGone
    return CodeRead(purpose=row.purpose, name=row.name or row.person_name, email=row.email)


def is_valid() -> tuple[ColumnElement[bool], ...]:
    """SQL conditions: a code is unused, has not expired, and its creator is still an admin."""
    creator = person.alias("creator")
    is_admin = exists().where(
        creator.c.id == one_time_code.c.created_by_id,
        creator.c.deactivated_at.is_(None),
        membership.c.person_id == creator.c.id,
        membership.c.group_id == ADMINS_ID,
        unexpired(membership.c.expires_at),
    )
    creator_may = one_time_code.c.created_by_id.is_(None) | is_admin.correlate(one_time_code)
    return one_time_code.c.used_at.is_(None), one_time_code.c.expires_at > func.now(), creator_may


def _is_valid_code(secret: str) -> tuple[ColumnElement[bool], ...]:
    return (one_time_code.c.secret_sha256 == secret_hash(secret), *is_valid())


async def delete_expired_codes(db: Connection) -> None:
    """Delete codes a month after their end, device logins after a day, and what expired of sign-ins by providers."""
    for table, days in ((one_time_code, 30), (login_request, 1), (oidc_login, 0), (used_logout_token, 0)):
        await db.execute(delete(table).where(table.c.expires_at < func.now() - datetime.timedelta(days=days)))
