"""The topics of a mission, all its recordings together, and how densely messages lie in time."""

import uuid
from typing import Annotated

from pydantic import Field

from kleinkram.contract.wire import Response

MAX_BINS = 512
MAX_MISSION_TOPICS = 2_000

# How many bins somebody wants to draw, at most: an answer has at least a quarter as many, where so much is known.
Bins = Annotated[int, Field(ge=0, le=MAX_BINS)]
MissionTopicsSize = Annotated[int, Field(ge=1, le=MAX_MISSION_TOPICS)]


class Density(Response):
    """How many messages lie where in time.

    `counts[k]` are the messages from `start_ns + k * bin_ns` on, that time included, up to the next bin. `bin_ns` is a
    power of two, and `start_ns` a multiple of it. Stamps that cannot be true are in no bin.
    """

    start_ns: int
    bin_ns: int
    counts: list[int]


class TimeAxis(Response):
    """The bins that several densities share: `bins` of `bin_ns` each, the first from `start_ns` on."""

    start_ns: int
    bin_ns: int
    bins: int


class RecordingRef(Response):
    """A recording, as named beside what it holds."""

    id: uuid.UUID
    name: str


class MissionTopic(Response):
    """One topic with one type, in all recordings of a mission.

    `other_types` are those under which the mission has the same topic too: a conflict. `count` is null where a file
    does not say its own. `rate_hz` is that while recordings lasted, and `longest_gap_ns` the longest silence inside of
    one: between two recordings nobody listened. `counts` are by the bins of `axis`; null where no file that has the
    topic was read since densities are kept, and adding up to less than `count` where only some were. `recordings` are
    those that have messages of it, as ranges `[first, last]` (both inclusive) of places in the answer's `recordings`.
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

    `axis` spans the mission without recordings from before 1990; null where no times are known. `recordings` are in
    the order of time. `is_current` says whether this follows from today's files; if not, it soon will.
    """

    axis: TimeAxis | None
    recordings: list[RecordingRef]
    items: list[MissionTopic]
    next: str | None = None
    is_current: bool
