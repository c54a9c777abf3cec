"""What is known of a mission from the indexes of its files: the input of checks that read no message."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from pydantic import JsonValue

from kleinkram.recordings.model import Content, Problem


@dataclass(frozen=True)
class FileFacts:
    """One file. `path` is relative to the mission; `content` is None while it was not read."""

    path: str
    size_bytes: int
    content: Content | None
    reason: str | None = None


@dataclass(frozen=True)
class RecordingFacts:
    """One recording of one or more files. Times are integer nanoseconds of the log clock; None without messages."""

    name: str
    paths: tuple[str, ...]
    content: Content
    reason: str | None = None
    start_ns: int | None = None
    end_ns: int | None = None
    problems: tuple[Problem, ...] = ()


@dataclass(frozen=True)
class TopicFacts:
    """One topic with one type, merged over all recordings of the mission.

    Attributes:
        count: messages; None if unknown.
        rate_hz: over all recordings: intervals between messages divided by the time that they take.
        longest_gap_ns: within one recording.
        recordings: names of the recordings that have messages of it.
    """

    name: str
    message_type: str | None
    count: int | None
    first_ns: int | None = None
    last_ns: int | None = None
    rate_hz: float | None = None
    longest_gap_ns: int | None = None
    recordings: tuple[str, ...] = ()


@dataclass(frozen=True)
class MissionFacts:
    """A mission, or a folder on a robot. `start_ns` and `end_ns`: its span, over all recordings."""

    files: tuple[FileFacts, ...]
    recordings: tuple[RecordingFacts, ...]
    topics: tuple[TopicFacts, ...]
    start_ns: int | None = None
    end_ns: int | None = None
    metadata: Mapping[str, JsonValue] = field(default_factory=dict)
