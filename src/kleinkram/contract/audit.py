"""The record of what happened."""

import datetime
import uuid

from pydantic import BaseModel, ConfigDict

from kleinkram.contract.metadata import Metadata
from kleinkram.contract.names import Ids, Term
from kleinkram.contract.people import PersonRef


class CredentialRef(BaseModel):
    """A token or a link, by the name that it was given."""

    model_config = ConfigDict(frozen=True)

    id: uuid.UUID
    name: str


class AuditRead(BaseModel):
    """One event: who did what to what, with what changed.

    `address` and `session_id` of a person are theirs and the admins' to see; of a link or a stranger, the owners' too.
    `as_admin`: it took the power of an admin; by their own rights they would have been refused.
    """

    model_config = ConfigDict(frozen=True)

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


class AuditFilter(BaseModel):
    """Which events are wanted: those that satisfy all that is given.

    `person`, `token` and `operation` may be globs: `anna*`, `file.*`. `since` is inclusive, `until` is not; a time
    without zone is UTC. `project_id` and `mission_id`: whatever happened in them, at the time it happened; with
    `project_ids` and `mission_ids`, in any of several.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

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
