"""Mission events: moments and spans of a mission's log time that people, programs and runs mark by name.

They are no audit events (who did what) and no change events (what an open page must read again).
"""

import datetime
import enum
import uuid
from typing import Annotated, Any

from pydantic import AfterValidator, Field, model_validator
from typing_extensions import Self

from kleinkram.contract.base import ETag, Request, Response, etag_of
from kleinkram.contract.missions import LocationFilter, MissionRef
from kleinkram.contract.names import Label, Name, Terms, check_text
from kleinkram.contract.people import PersonRef

MAX_MISSION_EVENTS = 10_000
MAX_NOTE_CHARACTERS = 10_000
MAX_EVENT_LABELS = 20
MAX_TOPIC_CHARACTERS = 1024

EventTimeNs = Annotated[int, Field(ge=0, le=2**63 - 1)]
Colour = Annotated[str, Field(pattern=r"^#[0-9a-f]{6}$")]
EventNote = Annotated[str, AfterValidator(check_text), Field(max_length=MAX_NOTE_CHARACTERS)]
EventLabels = Annotated[list[Label], Field(max_length=MAX_EVENT_LABELS)]
EventTopic = Annotated[str, AfterValidator(check_text), Field(min_length=1, max_length=MAX_TOPIC_CHARACTERS)]
FindingId = Annotated[int, Field(ge=1, le=2**63 - 1)]


class EventReference(str, enum.Enum):
    """What an event is of: all of its mission, or one file or recording."""

    mission = "mission"
    file = "file"
    recording = "recording"


class MissionEventCreate(Request):
    """An event to add to a mission: a moment, or a span where `end_ns` is later than `start_ns`.

    Times are log times, in ns since 1970. It may refer to a file or a recording of the mission, and to a topic.
    `finding_id` is the finding of a run from which it is made. If the mission has an event with the `id` or of the
    finding, nothing is added, and that event is returned: a request that is sent again does not double an event.
    """

    id: uuid.UUID | None = None
    name: Name
    start_ns: EventTimeNs
    end_ns: EventTimeNs | None = None
    labels: EventLabels = []
    colour: Colour | None = None
    note: EventNote = ""
    file_id: uuid.UUID | None = None
    recording_id: uuid.UUID | None = None
    topic: EventTopic | None = None
    finding_id: FindingId | None = None

    @model_validator(mode="after")
    def _refers_to_one(self) -> Self:
        if self.file_id is not None and self.recording_id is not None:
            raise ValueError("an event refers to a file or a recording, not to both")
        return self


class MissionEventUpdate(Request):
    """Changes of an event; omitted fields stay. Null removes an end, which makes it a moment, a colour or a reference.

    A `file_id` replaces the recording that the event refers to, a `recording_id` the file. Null also removes the
    reference to a file or a recording that is gone: the event is of the whole mission then.
    """

    name: Name | None = None
    start_ns: EventTimeNs | None = None
    end_ns: EventTimeNs | None = None
    labels: EventLabels | None = None
    colour: Colour | None = None
    note: EventNote | None = None
    file_id: uuid.UUID | None = None
    recording_id: uuid.UUID | None = None
    topic: EventTopic | None = None

    @model_validator(mode="after")
    def _refers_to_one(self) -> Self:
        if self.file_id is not None and self.recording_id is not None:
            raise ValueError("an event refers to a file or a recording, not to both")
        return self


class EventFileRef(Response):
    """The file that an event refers to."""

    id: uuid.UUID
    path: str


class EventRecordingRef(Response):
    """The recording that an event refers to."""

    id: uuid.UUID
    name: str


_EDITABLE = ("name", "start_ns", "end_ns", "labels", "colour", "note", "refers_to", "topic")


def _etag(values: dict[str, Any]) -> str:
    refs = [None if values[name] is None else values[name].id for name in ("file", "recording")]
    return etag_of(*(values[name] for name in _EDITABLE), *refs)


class MissionEventRead(Response):
    """A moment or a span of a mission. Times are log times, in ns since 1970, and both ends belong to a span.

    `end_ns` is null for a moment, or equal to the start. `refers_to` is what the event is of. `file` is null also where
    that file is in the trash, was moved or is deleted, and `recording` where that recording no longer exists, as when
    it got another name: the event is then of nothing in the mission. `run_id` is the run that added it or reported its
    finding. `created_by` is null for callers without an account. `etag` covers the edited fields: a change with an
    outdated one is refused.
    """

    id: uuid.UUID
    mission: MissionRef
    name: str
    start_ns: int
    end_ns: int | None
    labels: list[str]
    colour: str | None
    note: str
    refers_to: EventReference
    file: EventFileRef | None
    recording: EventRecordingRef | None
    topic: str | None
    run_id: uuid.UUID | None
    finding_id: int | None
    created_at: datetime.datetime
    created_by: PersonRef | None
    etag: ETag = Field(default_factory=_etag)


class MissionEventSort(str, enum.Enum):
    """Orders of a list of events."""

    start = "start"
    start_desc = "-start"
    created = "created"
    created_desc = "-created"


class MissionEventFilter(LocationFilter):
    """A filter of events: all criteria must match, and of the values in one list, any.

    `name` are names or globs, in any case. `after` and `before` select events that end then or later, and begin then or
    earlier.
    """

    name: Terms = []
    label: Terms = []
    run_id: uuid.UUID | None = None
    after: datetime.datetime | None = None
    before: datetime.datetime | None = None
