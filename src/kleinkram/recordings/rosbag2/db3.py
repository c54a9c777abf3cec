"""A rosbag2 database (db3) -> its summary, by SQLite where that can read it, else row by row from what is left.

A database has no index of its messages' times: the pages with their heads are read all, so a summary costs about the
file. A scan also checks the structure of every page; what stands inside of messages has no checksum and is not judged.
"""

from __future__ import annotations

import sqlite3
from array import array
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path

from kleinkram.recordings.assemble import TopicType, bounded, measure
from kleinkram.recordings.errors import Malformed
from kleinkram.recordings.forward import Forward
from kleinkram.recordings.model import Content, Depth, Fact, Lost, Problem, RecordingFormat, RecordingSummary, counted
from kleinkram.recordings.rosbag2 import database as db
from kleinkram.recordings.rosbag2.database import MessageRow, Origin, TopicRow
from kleinkram.recordings.rosbag2.leftovers import find_leftovers, not_read, replay, replayed_copy
from kleinkram.recordings.rosbag2.recovery import Recovered, Recovery
from kleinkram.recordings.rosbag2.spool import TooLarge, database_file
from kleinkram.recordings.timeline import Timeline

_BATCH = 20_000
_NO_ORIGIN = Origin()
_SCHEMA_ENCODING = ""


def scan_db3(forward: Forward, *, depth: Depth = Depth.scan) -> RecordingSummary:
    """Read a whole database: in place where it is a local file, else through a temporary copy.

    Where a local file has a log or a journal beside it that holds something it does not, a copy is read to which
    SQLite applied them. `Depth.summary` leaves out the check of every page, and does not read the pages of large
    messages.

    Raises:
        SourceError: as `Forward.read`, or the temporary copy cannot be written.
    """
    left = find_leftovers(forward.path, forward.name) if forward.path is not None else []
    try:
        if forward.path is not None and left:
            with replayed_copy(forward.path) as copy:
                summary = _read(copy or forward.path, forward.name, depth)
            return _killed(summary, left, is_applied=copy is not None)
        with database_file(forward) as path:
            return _read(path, forward.name, depth)
    except TooLarge as error:
        return RecordingSummary(RecordingFormat.rosbag2_db3, Content.pending, str(error))


def scan_copy(copy: Path, name: str, scan_without_logs: Callable[[], RecordingSummary]) -> RecordingSummary:
    """Read a database, a temporary copy with its log or journal beside it, of which SQLite makes one file.

    `scan_without_logs`: where SQLite does not apply them, half of them may be in the copy.

    Raises:
        SourceError: one of them cannot be read.
    """
    left = find_leftovers(copy, name)
    if not left:
        return _read(copy, name, Depth.scan)
    is_applied = replay(copy)
    summary = _read(copy, name, Depth.scan) if is_applied else scan_without_logs()
    return _killed(summary, left, is_applied=is_applied)


def _killed(summary: RecordingSummary, left: Sequence[Problem], *, is_applied: bool) -> RecordingSummary:
    """Say of a summary that the recorder was killed, and whether what it left beside the database was read too."""
    content = Content.recovered if summary.content is Content.indexed else summary.content
    reason = summary.reason or left[0].message
    lost = summary.lost or Lost(0, 0, None)
    unread = [] if is_applied else not_read(left)
    return replace(
        summary, content=content, reason=reason, problems=bounded([*left, *unread, *summary.problems]), lost=lost
    )


class _Tally:
    """Messages on their way into a timeline."""

    def __init__(self, topics: Iterable[TopicRow], origin: Origin = _NO_ORIGIN) -> None:
        self.timeline = Timeline()
        self._origin = origin
        self.types: dict[str, list[TopicType]] = {}
        self.undefined: dict[int, int] = {}
        self.unusable = 0
        self._names: dict[int, str] = {}
        for topic in topics:
            self._define(topic)

    def add(self, rows: Sequence[MessageRow]) -> None:
        """Add messages in the order of the file. Rows are what a stranger's database holds: of any type."""
        stamps: dict[int, list[int]] = defaultdict(list)
        sizes: dict[int, int] = defaultdict(int)
        for topic_id, timestamp, size in rows:
            if type(timestamp) is int and type(topic_id) is int and timestamp >= 0:
                stamps[topic_id].append(timestamp)
                sizes[topic_id] += size or 0
            else:
                self.unusable += 1
        for topic_id, found in stamps.items():
            if topic_id not in self._names:
                self._define(TopicRow(topic_id, f"(topic id {topic_id})", "", ""))
                self.undefined[topic_id] = 0
            if topic_id in self.undefined:
                self.undefined[topic_id] += len(found)
            self.timeline.add(self._names[topic_id], array("Q", found), sizes[topic_id])
        self.timeline.settle(0)

    def _define(self, topic: TopicRow) -> None:
        self._names[topic.topic_id] = topic.name
        self.timeline.topic(topic.name)
        kinds = self.types.setdefault(topic.name, [])
        kind = TopicType(topic.message_type, _SCHEMA_ENCODING, topic.serialization_format)
        if kind not in kinds:
            kinds.append(kind)

    def summary(
        self, content: Content, reason: str | None, depth: Depth, problems: Sequence[Problem], lost: Lost | None
    ) -> RecordingSummary:
        """Close the timeline, and say what is in it."""
        self.timeline.settle(None)
        measured = measure(self.timeline, self.types)
        return RecordingSummary(
            format=RecordingFormat.rosbag2_db3,
            content=content,
            reason=reason,
            message_count=measured.message_count,
            start_ns=measured.start_ns,
            end_ns=measured.end_ns,
            compression=(
                f"message-{self._origin.message_compression}" if self._origin.message_compression else "none",
            ),
            topics=measured.topics,
            problems=bounded([*problems, *self._problems(), *measured.problems]),
            depth=depth,
            lost=lost,
            facts=tuple(_facts(self._origin)),
        )

    def _problems(self) -> Iterator[Problem]:
        for topic_id, count in sorted(self.undefined.items()):
            belonging = counted(count, "message belongs", "messages belong")
            message = f"{belonging} to topic id {topic_id}, which the database does not define"
            yield Problem("topic-undefined", self._names[topic_id], message)
        if self.unusable:
            rows = counted(self.unusable, "row has", "rows have")
            message = f"{rows} no whole number as time or topic id, or a time before 1970; left out"
            yield Problem("rows-unusable", "table messages", message)


def _facts(origin: Origin) -> Iterator[Fact]:
    if origin.ros_distro:
        yield Fact("ros_distro", origin.ros_distro)
    if origin.schema_version is not None:
        yield Fact("schema_version", origin.schema_version)
    if origin.definitions:
        yield Fact("message_definitions", origin.definitions)


def _read(path: Path, name: str, depth: Depth) -> RecordingSummary:
    try:
        with db.open_database(path) as database:
            db.check_tables(database)
            faults = db.find_faults(database) if depth is Depth.scan else []
            tally = _Tally(db.read_topics(database), db.read_origin(database))
            cursor = db.message_cursor(database)
            while rows := cursor.fetchmany(_BATCH):
                tally.add(rows)
    except sqlite3.Error as error:
        return _recover(path, name, depth, str(error))
    except Malformed as error:
        reason = f"{error.message}, in {error.where}"
        return RecordingSummary(RecordingFormat.rosbag2_db3, Content.broken, reason, depth=depth)
    if not faults:
        return tally.summary(Content.indexed, None, depth, (), None)
    problems = [Problem("damaged", name, fault) for fault in faults]
    reason = f"the database is damaged ({faults[0]}); what SQLite finds of it is counted"
    return tally.summary(Content.recovered, reason, depth, problems, Lost(0, 0, None))


def _recover(path: Path, name: str, depth: Depth, error: str) -> RecordingSummary:
    """Read what is left of a database that SQLite does not read."""
    try:
        with Recovery(path, name) as recovery:
            found = recovery.found
            tally = _Tally(found.topics)
            rows = recovery.messages()
            while batch := list(islice(rows, _BATCH)):
                tally.add(batch)
    except Malformed as fault:
        reason = f"{fault.message}, at {fault.where}"
        return RecordingSummary(RecordingFormat.rosbag2_db3, Content.broken, reason, depth=Depth.scan)
    count = sum(times.count for times in tally.timeline.topics.values())
    content = Content.recovered if count or found.topics else Content.broken
    lost = Lost(found.damaged_bytes, found.damaged_pages, found.lost_messages if found.is_exact else None)
    return tally.summary(content, _reason(found, count, error), Depth.scan, (), lost)


def _reason(found: Recovered, count: int, error: str) -> str:
    if found.size_bytes < found.claimed_bytes:
        cause = f"the file is cut: {found.size_bytes} of {found.claimed_bytes} bytes are there"
    elif found.first_damage:
        more = f" (and {counted(found.damaged_pages - 1, 'more page')})" if found.damaged_pages > 1 else ""
        cause = found.first_damage + more
    else:
        cause = f"SQLite cannot read it ({error})"
    least = "" if found.is_exact else "at least "
    missing = (
        f", {least}{found.lost_messages} {'is' if found.lost_messages == 1 else 'are'} lost"
        if found.lost_messages
        else ""
    )
    return f"{cause}; {counted(count, 'message')} can be read{missing}"
