"""The record of what happened."""

import datetime
import uuid

from pydantic import BaseModel, ConfigDict

from kleinkram.contract.metadata import Metadata
from kleinkram.contract.people import PersonRef


class AuditRead(BaseModel):
    """One event: who did what to what, with what changed."""

    model_config = ConfigDict(frozen=True)

    id: int
    at: datetime.datetime
    actor: PersonRef | None
    operation: str
    noun: str
    noun_id: uuid.UUID | None
    noun_name: str
    project_id: uuid.UUID | None
    before: Metadata
    after: Metadata
    request_id: str | None
