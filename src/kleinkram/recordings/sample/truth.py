"""What a sample mission really holds, counted while it is made, by other code than that which reads recordings."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class TopicTruth:
    """One topic as it was written. Times are integer nanoseconds of the log clock."""

    name: str
    message_type: str
    count: int
    first_ns: int
    last_ns: int
    longest_gap_ns: int
    out_of_order_count: int


@dataclass(frozen=True)
class FileTruth:
    """One recording file.

    Attributes:
        path: where it is.
        truncated: its end was cut off, so that it holds less than `topics` say.
        topics: by name; types in the spelling of the format.
    """

    path: Path
    size_bytes: int
    truncated: bool
    message_count: int
    start_ns: int
    end_ns: int
    topics: tuple[TopicTruth, ...]


@dataclass(frozen=True)
class MissionTruth:
    """A sample mission; `files` are its recording files, without metadata.yaml."""

    directory: Path
    files: tuple[FileTruth, ...]


class TruthKeeper:
    """Collects the stamps of one file: 8 bytes or more a message, so for sample missions only."""

    def __init__(self) -> None:
        self._stamps: dict[str, list[int]] = {}
        self._types: dict[str, str] = {}

    def add_topic(self, name: str, message_type: str) -> None:
        """Note a topic."""
        self._types[name] = message_type
        self._stamps[name] = []

    def add(self, name: str, log_time_ns: int) -> None:
        """Note a message."""
        self._stamps[name].append(log_time_ns)

    def file(self, path: Path, *, truncated: bool) -> FileTruth:
        """Return the truth of the file, which must be complete (or cut) on disk."""
        topics = tuple(_topic(name, self._types[name], self._stamps[name]) for name in sorted(self._stamps))
        return FileTruth(
            path=path,
            size_bytes=path.stat().st_size,
            truncated=truncated,
            message_count=sum(topic.count for topic in topics),
            start_ns=min(topic.first_ns for topic in topics),
            end_ns=max(topic.last_ns for topic in topics),
            topics=topics,
        )


def _topic(name: str, message_type: str, stamps: list[int]) -> TopicTruth:
    longest_gap = out_of_order = 0
    in_time = sorted(stamps)
    for number in range(1, len(in_time)):
        longest_gap = max(longest_gap, in_time[number] - in_time[number - 1])
    highest = stamps[0]
    for stamp in stamps:
        if stamp < highest:
            out_of_order += 1
        highest = max(highest, stamp)
    return TopicTruth(name, message_type, len(stamps), in_time[0], in_time[-1], longest_gap, out_of_order)
