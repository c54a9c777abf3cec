"""What a stream of events tells: what changed, and never what it says now."""

import enum
import uuid

from kleinkram.contract.wire import Response


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
