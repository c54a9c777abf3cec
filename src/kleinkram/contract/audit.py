"""The record of what happened."""

import datetime
import uuid

from kleinkram.contract.metadata import Metadata
from kleinkram.contract.names import Ids, Term
from kleinkram.contract.people import PersonRef
from kleinkram.contract.wire import Request, Response


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
