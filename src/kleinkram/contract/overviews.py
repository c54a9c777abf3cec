"""Overviews of a mission: its topics, its timeline; and statistics over many."""

import uuid
from typing import Annotated

from pydantic import Field

from kleinkram.contract.base import Response
from kleinkram.contract.files import BlobState, ContentState

MAX_BINS = 512
MAX_MISSION_TOPICS = 2_000

# The maximum number of bins; a response has at least a quarter as many, if the data allow it.
Bins = Annotated[int, Field(ge=0, le=MAX_BINS)]
MissionTopicsSize = Annotated[int, Field(ge=1, le=MAX_MISSION_TOPICS)]


class TimeAxis(Response):
    """The bins that several densities share: `bins` of `bin_ns` each, the first from `start_ns` on."""

    start_ns: int
    bin_ns: int
    bins: int


class RecordingRef(Response):
    """The id and name of a recording."""

    id: uuid.UUID
    name: str


class MissionTopic(Response):
    """One topic with one type, in all recordings of a mission.

    `other_types`: other types of the same topic in the mission, a conflict. `count` is null if a file has no count.
    `rate_hz` and `longest_gap_ns` cover only the time within recordings. `counts` are by the bins of `axis`; null if no
    file with the topic has a density, and less than `count` in sum if only some have. `recordings` are ranges
    `[first, last]` (inclusive) of indexes in the response's `recordings`.
    """

    name: str
    message_type: str | None
    other_types: list[str | None]
    count: int | None
    file_count: int
    recording_count: int
    recordings: list[tuple[int, int]]
    first_ns: int | None
    last_ns: int | None
    rate_hz: float | None
    longest_gap_ns: int | None
    stored_bytes: int | None
    counts: list[int] | None


class MissionTopics(Response):
    """A page of the topics of a mission, by name and type.

    `axis` spans the mission without recordings from before 1990; null if no times are known. `recordings` are in
    chronological order. `is_current`: it reflects the current files; otherwise it will soon.
    """

    axis: TimeAxis | None
    recordings: list[RecordingRef]
    items: list[MissionTopic]
    next: str | None = None
    is_current: bool


MAX_TIMELINE_FILES = 10_000

TimelineSize = Annotated[int, Field(ge=1, le=MAX_TIMELINE_FILES)]


class TimelineFile(Response):
    """When a file was recorded; `start_ns` and `end_ns` are null if it has no times, or was not read yet."""

    id: uuid.UUID
    path: str
    recording_id: uuid.UUID | None
    start_ns: int | None
    end_ns: int | None
    size_bytes: int
    content: ContentState
    state: BlobState


class MissionTimeline(Response):
    """Files of a mission, by path; `next` is the cursor of those that follow, or null.

    `start_ns` and `end_ns` span the mission (log clock, since 1970, UTC), without recordings from before 1990.
    """

    start_ns: int | None
    end_ns: int | None
    items: list[TimelineFile]
    next: str | None = None


class StatsRow(Response):
    """One group. `duration_ns` sums the recordings' spans; files in the trash do not count.

    Grouped by topic or message type, a recording counts in each of its groups, and `messages` are that group's own.
    """

    group: str | None
    missions: int
    files: int
    recordings: int
    size_bytes: int
    duration_ns: int
    messages: int


class StatsRead(Response):
    """Statistics by `by` (`project`, `mission`, `topic`, `type`, `month`, `format` or `metadata.FIELD`), and in all."""

    by: str
    rows: list[StatsRow]
    total: StatsRow


MAX_BUCKETS = 200

# Buckets that are told each by itself; what is left of other values than times and numbers is one more.
Buckets = Annotated[int, Field(ge=1, le=MAX_BUCKETS)]


class Bucket(Response):
    """Files of one month, of one value of a field, or of the numbers from `low` on up to below `high`.

    All three are null for what has no such time or value.
    """

    value: str | None
    low: float | None = None
    high: float | None = None
    stats: StatsRow


class Overview(Response):
    """Totals of a project, or of everything visible, by `month` of recording or by a metadata field.

    Months and numbers come in their order. Other values come with the longest recorded first, as many as were asked
    for, and `other` is all that are left. `unit` is that of a field of numbers. `topics` are the distinct names of
    topics; null for who is shown less than whole missions.
    """

    by: str
    unit: str | None
    buckets: list[Bucket]
    other: StatsRow | None
    total: StatsRow
    topics: int | None
