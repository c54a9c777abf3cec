"""Codes that are good once: links to sign in, to an account, to a new password; the code that makes the first admin.

What an admin hands out ends with their power: whoever leaves must not come back by a link that they kept.
"""

import datetime
import secrets
import uuid
from dataclasses import dataclass, field
from typing import Any

from sqlalchemy import ColumnElement, Row, exists, func, insert, select, update

from kleinkram.contract.accounts import CodeRead, OneTimeLink
from kleinkram.contract.errors import CodeGone
from kleinkram.server.access.actor import secret_hash, unexpired
from kleinkram.server.access.groups import ADMINS_ID
from kleinkram.server.db import Connection
from kleinkram.server.settings import Settings
from kleinkram.server.tables import membership, one_time_code, person
from kleinkram.server.tables.signing_in import CodePurpose

_SECRET_BYTES = 32
_PAGES = {CodePurpose.owner: "link", CodePurpose.invitation: "invitation", CodePurpose.reset: "reset"}


@dataclass(frozen=True)
class CodeWanted:
    """A code to make: for somebody who has an account, or for an address that is invited to one."""

    purpose: CodePurpose
    lasts_s: float
    person_id: uuid.UUID | None = None
    email: str | None = None
    name: str | None = None
    created_by_id: uuid.UUID | None = None


@dataclass(frozen=True)
class NewCode:
    """A code that nobody has seen yet."""

    id: uuid.UUID
    secret: str = field(repr=False)
    expires_at: datetime.datetime

    def link(self, settings: Settings, purpose: CodePurpose) -> OneTimeLink:
        """Return the link that carries it, behind the `#`."""
        url = f"{settings.public_url.rstrip('/')}/sign-in/{_PAGES[purpose]}#{self.secret}"
        return OneTimeLink(url=url, expires_at=self.expires_at)


async def make_code(db: Connection, wanted: CodeWanted) -> NewCode:
    """Make a code; those made before for the same purpose and person or address are good no more."""
    same = (one_time_code.c.purpose == wanted.purpose.value) & one_time_code.c.used_at.is_(None)
    for column, whose in ((one_time_code.c.person_id, wanted.person_id), (one_time_code.c.email, wanted.email)):
        if whose is not None:
            await db.execute(update(one_time_code).where(same, column == whose).values(used_at=func.now()))
    code_id, secret = uuid.uuid4(), secrets.token_urlsafe(_SECRET_BYTES)
    row = insert(one_time_code).values(
        id=code_id,
        purpose=wanted.purpose.value,
        secret_sha256=secret_hash(secret),
        person_id=wanted.person_id,
        email=wanted.email,
        name=wanted.name,
        created_by_id=wanted.created_by_id,
        expires_at=func.now() + datetime.timedelta(seconds=wanted.lasts_s),
    )
    expires_at = (await db.execute(row.returning(one_time_code.c.expires_at))).scalar_one()
    return NewCode(code_id, secret, expires_at)


async def use_code(db: Connection, secret: str, purpose: CodePurpose) -> Row[Any]:
    """Use a code up, if this transaction is kept, and return its row.

    Raises:
        CodeGone: there is none like that, it was used, its time is over, or who made it may make none any more.
    """
    stmt = update(one_time_code).where(*_is_good(secret), one_time_code.c.purpose == purpose.value)
    row = (await db.execute(stmt.values(used_at=func.now()).returning(*one_time_code.c))).one_or_none()
    if row is None:
        raise CodeGone
    return row


async def find_code(db: Connection, secret: str, purpose: CodePurpose) -> Row[Any]:
    """Return the row of a code, which stays good.

    Raises:
        CodeGone: as `use_code`.
    """
    stmt = select(one_time_code).where(*_is_good(secret), one_time_code.c.purpose == purpose.value)
    row = (await db.execute(stmt)).one_or_none()
    if row is None:
        raise CodeGone
    return row


async def end_codes(db: Connection, person_id: uuid.UUID) -> None:
    """End the codes that are for somebody and those that they handed out, for good."""
    theirs = (one_time_code.c.person_id == person_id) | (one_time_code.c.created_by_id == person_id)
    await db.execute(update(one_time_code).where(theirs, one_time_code.c.used_at.is_(None)).values(used_at=func.now()))


async def look_at_code(db: Connection, secret: str) -> CodeRead:
    """Return for whom a code is, without using it up.

    Raises:
        CodeGone: there is none like that, it was used, its time is over, or who made it may make none any more.
    """
    columns = one_time_code.c.purpose, one_time_code.c.email, one_time_code.c.name, person.c.name.label("person_name")
    stmt = select(*columns).outerjoin(person, person.c.id == one_time_code.c.person_id).where(*_is_good(secret))
    row = (await db.execute(stmt)).one_or_none()
    if row is None:
        raise CodeGone
    return CodeRead(purpose=row.purpose, name=row.name or row.person_name, email=row.email)


def good_still() -> tuple[ColumnElement[bool], ...]:
    """Say of codes that they were not used, their time is not over, and who made them may still do that."""
    maker = person.alias("maker")
    is_admin = exists().where(
        maker.c.id == one_time_code.c.created_by_id,
        maker.c.deactivated_at.is_(None),
        membership.c.person_id == maker.c.id,
        membership.c.group_id == ADMINS_ID,
        unexpired(membership.c.expires_at),
    )
    may_still = one_time_code.c.created_by_id.is_(None) | is_admin.correlate(one_time_code)
    return one_time_code.c.used_at.is_(None), one_time_code.c.expires_at > func.now(), may_still


def _is_good(secret: str) -> tuple[ColumnElement[bool], ...]:
    return (one_time_code.c.secret_sha256 == secret_hash(secret), *good_still())
