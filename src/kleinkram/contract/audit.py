"""The audit log, and the stream of change events."""

import datetime
import enum
import uuid

from kleinkram.contract.base import Request, Response
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.names import Ids, Term
from kleinkram.contract.people import PersonRef


class CredentialRef(Response):
    """A token or a link, by the name that it was given."""

    id: uuid.UUID
    name: str


class AuditRead(Response):
    """One event: who did what to what, with what changed.

    `address` and `session_id` of a person are theirs and the admins' to see; of a link or a stranger, the owners' too.
    `as_admin`: it took the power of an admin; by their own rights they would have been refused.
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
    noun: str
    noun_id: uuid.UUID | None
    noun_name: str
    project_id: uuid.UUID | None
    mission_id: uuid.UUID | None
    before: Metadata
    after: Metadata
    request_id: str | None


class AuditFilter(Request):
    """Which events are wanted: those that satisfy all that is given.

    `person`, `token` and `operation` may be globs: `anna*`, `file.*`. `since` is inclusive, `until` is not; a time
    without zone is UTC. `project_id` and `mission_id`: whatever happened in them, at the time it happened; with
    `project_ids` and `mission_ids`, in any of several.
    """

    person: Term | None = None
    person_id: uuid.UUID | None = None
    token: Term | None = None
    token_id: uuid.UUID | None = None
    share_id: uuid.UUID | None = None
    noun: Term | None = None
    noun_id: uuid.UUID | None = None
    project_id: uuid.UUID | None = None
    project_ids: Ids = []
    mission_id: uuid.UUID | None = None
    mission_ids: Ids = []
    operation: Term | None = None
    since: datetime.datetime | None = None
    until: datetime.datetime | None = None
    as_admin: bool | None = None


class ChangeKind(str, enum.Enum):
    """What became of something: it is there now, it is another, or it is not there any more."""

    created = "created"
    changed = "changed"
    removed = "removed"


class Change(Response):
    """The event `change`. `id` is null where several of the noun changed at once, in that mission or project."""

    noun: str
    change: ChangeKind
    id: uuid.UUID | None
    project_id: uuid.UUID | None
    mission_id: uuid.UUID | None


class RefetchReason(str, enum.Enum):
    """Why all that was fetched may be old: events were missed, came too fast, or one's rights are others now."""

    missed = "missed"
    behind = "behind"
    rights = "rights"


class Refetch(Response):
    """The event `refetch`: all that was fetched may be old."""

    reason: RefetchReason
