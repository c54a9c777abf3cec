"""Who is asking: found from the bearer token, once a request."""

import hashlib
import uuid
from dataclasses import dataclass

from sqlalchemy import select

from kleinkram.contract.people import PersonRef
from kleinkram.server.db import Connection
from kleinkram.server.tables import person, token


@dataclass(frozen=True)
class Actor:
    """A person at work, by one of their tokens, in one request."""

    person_id: uuid.UUID
    name: str
    token_id: uuid.UUID | None
    request_id: str | None

    @property
    def ref(self) -> PersonRef:
        """The person as named beside what they do."""
        return PersonRef(id=self.person_id, name=self.name)


def token_hash(secret: str) -> bytes:
    """Return what is kept of a token: the SHA-256 of its UTF-8."""
    return hashlib.sha256(secret.encode()).digest()


async def find_actor(db: Connection, secret: str, *, request_id: str | None) -> Actor | None:
    """Return who carries a token, or None when it is unknown or revoked."""
    statement = (
        select(person.c.id, person.c.name, token.c.id.label("token_id"))
        .join_from(token, person)
        .where(token.c.secret_sha256 == token_hash(secret), token.c.revoked_at.is_(None))
    )
    row = (await db.execute(statement)).one_or_none()
    return Actor(row.id, row.name, row.token_id, request_id) if row else None
