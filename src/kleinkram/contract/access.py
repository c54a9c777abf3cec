"""Rights on projects and missions, scopes of tokens, groups, and grants."""

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
    """Rights on a project or a mission. Each right includes those before it; compare by `level`."""

    read = "READ"
    create = "CREATE"
    write = "WRITE"
    delete = "DELETE"

    @property
    def level(self) -> int:
        """The level, from 1 (READ) to 4 (DELETE)."""
        return _RIGHTS.index(self) + 1

    @classmethod
    def of_level(cls, level: int) -> "Right":
        """Return the right of a level from 1 to 4."""
        return _RIGHTS[level - 1]


_RIGHTS = tuple(Right)


class Scope(str, enum.Enum):
    """Scopes of a token, within the rights of its person.

    `read`: view and download. `upload`: create missions and upload files, seeing only names. `write`: change and
    delete, and also `read` and `upload`. `run`: start and cancel runs. `admin`: everything, including granting rights
    and admin rights.
    """

    read = "read"
    upload = "upload"
    write = "write"
    run = "run"
    admin = "admin"


class TokenKind(str, enum.Enum):
    """Who uses a token: a person's script, a robot, a runner of actions, or a single run."""

    personal = "personal"
    robot = "robot"
    runner = "runner"
    run = "run"


class GroupKind(str, enum.Enum):
    """Source of a group's members.

    `person`: always one person. `email`: the person with that verified address. `custom`: added by its editors.
    `affiliation`: by the domain of a verified address. `admins`: added by admins.
    """

    person = "person"
    email = "email"
    custom = "custom"
    affiliation = "affiliation"
    admins = "admins"


class GranteeKind(str, enum.Enum):
    """The kind of a grantee: a person, a group, or the owner of an e-mail address."""

    person = "person"
    group = "group"
    email = "email"


class Grantee(Response):
    """Who has a grant. An address has no id, whether or not somebody has it; its name is the address."""

    kind: GranteeKind
    id: uuid.UUID | None
    name: str


class GrantCreate(Request):
    """A right to grant to exactly one of a person, a group and an address; it replaces their earlier grant there.

    Without `expires_at` it has no end.
    """

    person_id: uuid.UUID | None = None
    group_id: uuid.UUID | None = None
    email: EmailAddress | None = None
    right: Right
    expires_at: Expiry | None = None

    @model_validator(mode="after")
    def _names_one(self) -> Self:
        if [self.person_id, self.group_id, self.email].count(None) != 2:
            raise ValueError("specify exactly one of person_id, group_id and email")
        return self


class GrantUpdate(Request):
    """Changes of a grant; omitted fields stay. `expires_at` null removes the end."""

    right: Right | None = None
    expires_at: Expiry | None = None


class GrantOn(str, enum.Enum):
    """Object of a grant. A grant on a project applies to all its missions."""

    project = "project"
    mission = "mission"


class GrantRead(Response):
    """A granted right. Expired grants have no effect."""

    id: uuid.UUID
    on: GrantOn
    to: Grantee
    right: Right
    expires_at: datetime.datetime | None
    has_expired: bool
    granted_at: datetime.datetime
    granted_by: PersonRef | None


class AccessThrough(str, enum.Enum):
    """The source of a right: a grant on the project or mission, a public project, or admin rights."""

    project_grant = "project grant"
    mission_grant = "mission grant"
    public = "public"
    admin = "admin"


class AccessRead(Response):
    """A right that somebody has now, and its source; of several, the highest counts.

    `to` is the grantee; null for all admins or, in a public project, everybody. `person` has the right through it;
    null if unknown or hidden, such as members of a group or the owner of an address. `expires_at` is when the grant or
    the membership ends, whichever is first.
    """

    person: PersonRef | None
    to: Grantee | None
    right: Right
    through: AccessThrough
    grant_id: uuid.UUID | None
    expires_at: datetime.datetime | None


class GroupCreate(Request):
    """A group to create; its creator is the first member and editor."""

    name: Name


class GroupUpdate(Request):
    """A group's new name."""

    name: Name


def _group_etag(values: dict[str, Any]) -> str:
    return etag_of("group", values["id"], values["name"])


class GroupRead(Response):
    """A group. Expired memberships and deactivated people do not count.

    `is_member`, `is_editor` and `expires_at` are the caller's own membership. `domains` and `default_right` are the
    settings of an affiliation group. A change with an outdated `etag` is refused.
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
    """A membership. Editors may change the members. Without `expires_at` there is no end."""

    is_editor: bool = False
    expires_at: Expiry | None = None


def _member_etag(values: dict[str, Any]) -> str:
    end: datetime.datetime | None = values["expires_at"]
    return etag_of("member", values["person"].id, values["is_editor"], end and end.timestamp())


class MemberRead(Response):
    """A member of a group. Only its editors and admins see `emails`, and members who are not active.

    `is_active`: the membership has not expired, and the person is not deactivated. A change with an outdated `etag` is
    refused.
    """

    person: PersonRef
    emails: list[str]
    is_editor: bool
    is_active: bool
    expires_at: datetime.datetime | None
    added_at: datetime.datetime
    added_by: PersonRef | None
    etag: ETag = Field(default_factory=_member_etag)
