"""Rights, scopes, groups and grants: who may do what with a project or a mission, until when."""

import datetime
import enum
import uuid
from typing import Any

from pydantic import Field, model_validator
from typing_extensions import Self

from kleinkram.contract.base import ETag, Expiry, Request, Response, etag_of
from kleinkram.contract.names import Name
from kleinkram.contract.people import EmailAddress, PersonRef


class Right(str, enum.Enum):
    """What somebody may do with a project or a mission. Each contains those before it; compare by `level`."""

    read = "READ"
    create = "CREATE"
    write = "WRITE"
    delete = "DELETE"

    @property
    def level(self) -> int:
        """Its place, from 1 (READ) to 4 (DELETE)."""
        return _RIGHTS.index(self) + 1

    @classmethod
    def of_level(cls, level: int) -> "Right":
        """Return the right at a place from 1 to 4."""
        return _RIGHTS[level - 1]


_RIGHTS = tuple(Right)


class Scope(str, enum.Enum):
    """What a token may be used for, within what its person may do.

    `read`: see and download. `upload`: make missions and send files, seeing no more than names. `write`: change and
    delete, with `read` and `upload`. `run`: start and cancel runs. `admin`: all of these, grant rights, and use the
    power of an admin.
    """

    read = "read"
    upload = "upload"
    write = "write"
    run = "run"
    admin = "admin"


class TokenKind(str, enum.Enum):
    """Who carries a token: a person's script, a robot, a runner of actions, or one run while it lasts."""

    personal = "personal"
    robot = "robot"
    runner = "runner"
    run = "run"


class GroupKind(str, enum.Enum):
    """How a group gets its members.

    `person`: one person's own, always just that person. `email`: whoever proves that address. `custom`: by its editors.
    `affiliation`: by the domain of a verified address. `admins`: by admins.
    """

    person = "person"
    email = "email"
    custom = "custom"
    affiliation = "affiliation"
    admins = "admins"


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


class GroupCreate(Request):
    """A group to make; whoever makes it is its first member and editor."""

    name: Name


class GroupUpdate(Request):
    """A group's new name."""

    name: Name


def _group_etag(said: dict[str, Any]) -> str:
    return etag_of("group", said["id"], said["name"])


class GroupRead(Response):
    """A group. Members whose time is over, or who left, do not count.

    `is_member`, `is_editor` and `expires_at` are the asker's own membership. `domains` and `default_right` are what the
    settings say of an affiliation group. `etag` names the group as its editors last named it: given back with a
    change, that is refused where somebody else came first.
    """

    id: uuid.UUID
    name: str
    kind: GroupKind
    member_count: int
    is_member: bool
    is_editor: bool
    expires_at: datetime.datetime | None
    domains: list[str]
    default_right: Right | None
    created_at: datetime.datetime
    created_by: PersonRef | None
    etag: ETag = Field(default_factory=_group_etag)


class MemberSet(Request):
    """How somebody is in a group: with a say in who else is, and until when; without `expires_at` there is no end."""

    is_editor: bool = False
    expires_at: Expiry | None = None


def _member_etag(said: dict[str, Any]) -> str:
    end: datetime.datetime | None = said["expires_at"]
    return etag_of("member", said["person"].id, said["is_editor"], end and end.timestamp())


class MemberRead(Response):
    """Somebody in a group. `emails` are for its editors and admins, as are members who are not active any more.

    `is_active`: neither has their time ended, nor did they leave. `etag` names how and until when they are in it:
    given back with a change, that is refused where somebody else came first.
    """

    person: PersonRef
    emails: list[str]
    is_editor: bool
    is_active: bool
    expires_at: datetime.datetime | None
    added_at: datetime.datetime
    added_by: PersonRef | None
    etag: ETag = Field(default_factory=_member_etag)
