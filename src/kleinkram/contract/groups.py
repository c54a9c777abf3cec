"""Groups of people, and who is in them until when."""

import datetime
import uuid
from typing import Any

from pydantic import Field

from kleinkram.contract.etags import ETag, etag_of
from kleinkram.contract.expiry import Expiry
from kleinkram.contract.names import Name
from kleinkram.contract.people import PersonRef
from kleinkram.contract.rights import GroupKind, Right
from kleinkram.contract.wire import Request, Response


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
