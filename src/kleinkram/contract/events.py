"""What a stream of events tells: what changed, and never what it says now."""

import enum
import uuid

from pydantic import BaseModel, ConfigDict


class ChangeKind(str, enum.Enum):
    """What became of something: it is there now, it is another, or it is not there any more."""

    created = "created"
    changed = "changed"
    removed = "removed"


class Change(BaseModel):
    """The event `change`. `id` is null where several of the noun changed at once, in that mission or project."""

    model_config = ConfigDict(frozen=True)

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


class Refetch(BaseModel):
    """The event `refetch`: all that was fetched may be old."""

    model_config = ConfigDict(frozen=True)

    reason: RefetchReason
