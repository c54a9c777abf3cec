"""The audit log, and the stream of change events."""

import datetime
import enum
import uuid

from kleinkram.contract.base import NamedRef, Response
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.missions import LocationFilter
from kleinkram.contract.names import Term
from kleinkram.contract.people import PersonRef


class CredentialRef(NamedRef):
    """The id and name of a token or link."""


class AuditRead(Response):
    """One event: who did what to which object, and what changed.

    Only the person and admins see their `address` and `session_id`; owners see those of links and guests.
    `as_admin`: it required admin rights; the actor's own rights would not have sufficed.
    """

    id: int
    at: datetime.datetime
    actor: PersonRef | None
    token: CredentialRef | None
    share: CredentialRef | None
    session_id: uuid.UUID | None
    address: str | None
    as_admin: bool
    operation: str
    resource_type: str
    resource_id: uuid.UUID | None
    resource_name: str
    project_id: uuid.UUID | None
    mission_id: uuid.UUID | None
    before: Metadata
    after: Metadata
    request_id: str | None


class AuditFilter(LocationFilter):
    """A filter of events; all given conditions apply.

    `person`, `token` and `operation` may be globs: `anna*`, `file.*`. `since` is inclusive, `until` exclusive; times
    without a zone are UTC. `project_id` and `mission_id`: where it happened, at that time; `project_ids` and
    `mission_ids`: in any of these.
    """

    person: Term | None = None
    person_id: uuid.UUID | None = None
    token: Term | None = None
    token_id: uuid.UUID | None = None
    share_id: uuid.UUID | None = None
    resource_type: Term | None = None
    resource_id: uuid.UUID | None = None
    operation: Term | None = None
    since: datetime.datetime | None = None
    until: datetime.datetime | None = None
    as_admin: bool | None = None


class ChangeKind(str, enum.Enum):
    """What happened to an object."""

    created = "created"
    changed = "changed"
    removed = "removed"


class Change(Response):
    """The event `change`. `id` is null if several objects changed at once, in that mission or project."""

    resource_type: str
    change: ChangeKind
    id: uuid.UUID | None
    project_id: uuid.UUID | None
    mission_id: uuid.UUID | None


class RefetchReason(str, enum.Enum):
    """Why everything must be fetched again: events were missed, came too fast, or the reader's rights changed."""

    missed = "missed"
    behind = "behind"
    rights = "rights"


class Refetch(Response):
    """The event `refetch`: everything that was fetched may be outdated."""

    reason: RefetchReason
