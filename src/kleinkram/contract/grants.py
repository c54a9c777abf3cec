"""Grants: who may do what with a project or a mission, until when. And access: what follows from them for people."""

import datetime
import enum
import uuid

from pydantic import model_validator
from typing_extensions import Self

from kleinkram.contract.emails import EmailAddress
from kleinkram.contract.expiry import Expiry
from kleinkram.contract.people import PersonRef
from kleinkram.contract.rights import Right
from kleinkram.contract.wire import Request, Response


class GranteeKind(str, enum.Enum):
    """Whom a right is given to: a person, a group, or whoever has an e-mail address."""

    person = "person"
    group = "group"
    email = "email"


class Grantee(Response):
    """Whom a right is given to. An address has no id, whether or not somebody has it; its name is the address."""

    kind: GranteeKind
    id: uuid.UUID | None
    name: str


class GrantCreate(Request):
    """A right to give, to exactly one of a person, a group and an address; without `expires_at` it has no end.

    Where they were granted a right there before, this takes its place.
    """

    person_id: uuid.UUID | None = None
    group_id: uuid.UUID | None = None
    email: EmailAddress | None = None
    right: Right
    expires_at: Expiry | None = None

    @model_validator(mode="after")
    def _names_one(self) -> Self:
        if [self.person_id, self.group_id, self.email].count(None) != 2:
            raise ValueError("say one of person_id, group_id and email")
        return self


class GrantUpdate(Request):
    """What to change of a grant; what is left out stays. `expires_at` null takes its end away."""

    right: Right | None = None
    expires_at: Expiry | None = None


class GrantOn(str, enum.Enum):
    """Where a grant stands. One on a project holds for all its missions."""

    project = "project"
    mission = "mission"


class GrantRead(Response):
    """A right that was given. One that has expired has no effect any more."""

    id: uuid.UUID
    on: GrantOn
    to: Grantee
    right: Right
    expires_at: datetime.datetime | None
    has_expired: bool
    granted_at: datetime.datetime
    granted_by: PersonRef | None


class AccessThrough(str, enum.Enum):
    """What a right comes from: a grant on the project or the mission, the project's being public, or being an admin."""

    project_grant = "project grant"
    mission_grant = "mission grant"
    public = "public"
    admin = "admin"


class AccessRead(Response):
    """One way in which somebody has a right now; of several, the highest counts.

    `to` is who was granted it; null: all admins, or, where the project is public, everybody. `person` is who has it by
    that; null where that is not known, or not for the one who asks: the members of a group, whoever has an address.
    `expires_at` is when the grant or the membership ends, whichever is first.
    """

    person: PersonRef | None
    to: Grantee | None
    right: Right
    through: AccessThrough
    grant_id: uuid.UUID | None
    expires_at: datetime.datetime | None
