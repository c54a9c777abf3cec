"""The rosbag2 database format (db3): read by SQLite, or page by page where SQLite fails.

A database has no suitable index of times: a summary reads all pages with heads of messages, about the whole file. A
scan also checks the structure of every page; the contents of messages have no checksum and are not checked.
"""

from __future__ import annotations

import re
import sqlite3
import sys
from array import array
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import islice, pairwise
from operator import le
from pathlib import Path

from kleinkram.recordings.chunk_reader import MAX_MESSAGE
from kleinkram.recordings.damage_report import ProblemLog
from kleinkram.recordings.errors import Malformed
from kleinkram.recordings.file_summary import TopicType, bounded, build_summary, pending
from kleinkram.recordings.formats import base
from kleinkram.recordings.formats.base import Format, MemberContents, OpenedFile, Segment
from kleinkram.recordings.formats.rosbag2 import database as db
from kleinkram.recordings.formats.rosbag2.database import LOG_SUFFIXES, MessageRow, Origin, TopicRow
from kleinkram.recordings.formats.rosbag2.recovery import Recovery, open_recovered
from kleinkram.recordings.limits import MAX_DEFINITIONS
from kleinkram.recordings.merge_messages import MessagePiece, MessageRun, merge
from kleinkram.recordings.messages import Block, Channel, RawMessage, Schema, Selection
from kleinkram.recordings.model import Content, Depth, Fact, Lost, Problem, RecordingFormat, RecordingSummary, counted
from kleinkram.recordings.sources import SequentialReader, Source, SourceReader
from kleinkram.recordings.temporary_files import MAX_SPOOL_BYTES, TooLarge, temporary_copy, too_large
from kleinkram.recordings.timeline import Timeline

_BATCH = 20_000
_ROSBAG2_TABLES = (re.compile(rb"TABLE\s+[\"'`\[]?messages\b", re.I), re.compile(rb"TABLE\s+[\"'`\[]?topics\b", re.I))
_NO_ORIGIN = Origin()
_SCHEMA_ENCODING = ""


def scan_db3(reader: SequentialReader, *, depth: Depth = Depth.scan) -> RecordingSummary:
    """Scan a database: a local file in place, else a temporary copy; with unmerged logs, a copy to which they are
    applied.

    `Depth.summary` leaves out the check of every page, and does not read the pages of large messages.
    """
    log_problems = db.find_unmerged_logs(reader.path, reader.name) if reader.path is not None else []
    try:
        if reader.path is not None and log_problems:
            with db.replayed_copy(reader.path) as copy:
                summary = _read(copy or reader.path, reader.name, depth)
            return _with_log_problems(summary, log_problems, is_applied=copy is not None)
        if reader.path is not None:
            return _read(reader.path, reader.name, depth)
        if reader.size_bytes > MAX_SPOOL_BYTES:
            raise too_large(MAX_SPOOL_BYTES, MAX_SPOOL_BYTES)
        with temporary_copy(reader.read) as path:
            return _read(path, reader.name, depth)
    except TooLarge as error:
        return RecordingSummary(RecordingFormat.rosbag2_db3, Content.pending, str(error))


def scan_copy(copy: Path, name: str, scan_without_logs: Callable[[], RecordingSummary]) -> RecordingSummary:
    """Scan a temporary copy of a database and its log or journal.

    `scan_without_logs`: where SQLite does not apply them, half of them may be in the copy.
    """
    log_problems = db.find_unmerged_logs(copy, name)
    if not log_problems:
        return _read(copy, name, Depth.scan)
    is_applied = db.replay(copy)
    summary = _read(copy, name, Depth.scan) if is_applied else scan_without_logs()
    return _with_log_problems(summary, log_problems, is_applied=is_applied)


def _with_log_problems(
    summary: RecordingSummary, log_problems: Sequence[Problem], *, is_applied: bool
) -> RecordingSummary:
    """Add to a summary that the recorder was killed, and whether its log was read."""
    content = Content.recovered if summary.content is Content.indexed else summary.content
    reason = summary.reason or log_problems[0].message
    lost = summary.lost or Lost(0, 0, None)
    unread = [] if is_applied else db.log_not_read(log_problems)
    return replace(
        summary,
        content=content,
        reason=reason,
        problems=bounded([*log_problems, *unread, *summary.problems]),
        lost=lost,
    )


class _TopicCounts:
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
        """Add messages in file order. Values may have any type."""
        stamps: dict[int, list[int]] = defaultdict(list)
        sizes: dict[int, int] = defaultdict(int)
        for topic_id, timestamp, size in rows:
            if type(timestamp) is int and type(topic_id) is int and timestamp >= 0:
                stamps[topic_id].append(timestamp)
                sizes[topic_id] += size or 0
            else:
                self.unusable += 1
        for topic_id, topic_stamps in stamps.items():
            if topic_id not in self._names:
                self._define(TopicRow(topic_id, f"(topic id {topic_id})", "", ""))
                self.undefined[topic_id] = 0
            if topic_id in self.undefined:
                self.undefined[topic_id] += len(topic_stamps)
            self.timeline.add(self._names[topic_id], array("Q", topic_stamps), sizes[topic_id])
        self.timeline.finish(0)

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
        self.timeline.finish(None)
        compression, facts = self._origin.message_compression, []
        if self._origin.ros_distro:
            facts.append(Fact("ros_distro", self._origin.ros_distro))
        if self._origin.schema_version is not None:
            facts.append(Fact("schema_version", self._origin.schema_version))
        if self._origin.definitions:
            facts.append(Fact("message_definitions", self._origin.definitions))
        return replace(
            build_summary(RecordingFormat.rosbag2_db3, self.timeline, self.types, [*problems, *self._problems()]),
            content=content,
            reason=reason,
            compression=(f"message-{compression}" if compression else "none",),
            depth=depth,
            lost=lost,
            facts=tuple(facts),
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


def _read(path: Path, name: str, depth: Depth) -> RecordingSummary:
    try:
        with db.open_database(path) as database:
            db.check_tables(database)
            faults = db.find_faults(database) if depth is Depth.scan else []
            counter = _TopicCounts(db.read_topics(database), db.read_origin(database))
            cursor = db.message_cursor(database)
            while rows := cursor.fetchmany(_BATCH):
                counter.add(rows)
    except sqlite3.Error as error:
        return _recover(path, name, depth, str(error))
    except Malformed as error:
        reason = f"{error.message}, in {error.where}"
        return RecordingSummary(RecordingFormat.rosbag2_db3, Content.broken, reason, depth=depth)
    if not faults:
        return counter.summary(Content.indexed, None, depth, (), None)
    problems = [Problem("damaged", name, fault) for fault in faults]
    reason = f"the database is damaged ({faults[0]}); what SQLite finds of it is counted"
    return counter.summary(Content.recovered, reason, depth, problems, Lost(0, 0, None))


def _recover(path: Path, name: str, depth: Depth, error: str) -> RecordingSummary:
    """Read a database that SQLite cannot read."""
    try:
        with Recovery(path, name) as recovery:
            result = recovery.result
            counter = _TopicCounts(result.topics)
            rows = recovery.messages()
            while batch := list(islice(rows, _BATCH)):
                counter.add(batch)
    except Malformed as fault:
        reason = f"{fault.message}, at {fault.where}"
        return RecordingSummary(RecordingFormat.rosbag2_db3, Content.broken, reason, depth=Depth.scan)
    count = sum(times.count for times in counter.timeline.topics.values())
    content = Content.recovered if count or result.topics else Content.broken
    lost = Lost(result.damaged_bytes, result.damaged_pages, result.lost_messages if result.is_exact else None)
    cause = f"SQLite cannot read it ({error})"
    if result.size_bytes < result.claimed_bytes:
        cause = f"the file is cut: {result.size_bytes} of {result.claimed_bytes} bytes are there"
    elif result.first_damage:
        more = f" (and {counted(result.damaged_pages - 1, 'more page')})" if result.damaged_pages > 1 else ""
        cause = result.first_damage + more
    missing = ""
    if result.lost_messages:
        is_or_are = "is" if result.lost_messages == 1 else "are"
        missing = f", {'' if result.is_exact else 'at least '}{result.lost_messages} {is_or_are} lost"
    reason = f"{cause}; {counted(count, 'message')} can be read{missing}"
    return counter.summary(content, reason, Depth.scan, (), lost)


_LATEST_NS = 2**63 - 1
_BLOCK_BYTES = 4 * 2**20
_BLOCK_ROWS = 2000
_SLICE_BYTES, _MAX_SLICES = 2**20, 1_000_000
_DATA = f"CASE WHEN length(data) <= {MAX_MESSAGE} THEN data END"
_WHERE = "FROM messages WHERE timestamp >= ? AND timestamp < ?"
_BY_INDEX = f"SELECT topic_id, timestamp, {_DATA} {_WHERE} ORDER BY timestamp, rowid"  # our words
_BY_NUMBERS = f"SELECT rowid {_WHERE} ORDER BY timestamp, rowid"
_ONE = f"SELECT topic_id, timestamp, {_DATA} FROM messages WHERE rowid = ?"  # noqa: S608  # our words
_TEXT = f"substr(encoded_message_definition, 1, {MAX_DEFINITIONS})"
_DEFINITIONS = f"SELECT topic_type, encoding, {_TEXT} FROM message_definitions"  # noqa: S608  # our words
_Row = tuple[object, object, object]


class DatabaseMember:
    """A database; its channels are the rows of `topics`."""

    summary = None
    """Opening it reads little of it."""

    def __init__(
        self,
        path: Path,
        name: str,
        problem_log: ProblemLog,
        recover: Callable[[], OpenedFile],
        *,
        message_compression: str = "",
    ) -> None:
        """Read topics and span; `recover` opens a damaged database."""
        self._recover = recover
        self._recovered: OpenedFile | None = None
        self._path = path
        self._name = name
        self._problem_log = problem_log
        self._has_index = False
        self.contents = MemberContents({}, {}, 0, None, None)
        try:
            with db.open_database(path) as database:
                db.check_tables(database)
                self._has_index = _has_index(database)
                compression = message_compression or db.read_origin(database).message_compression
                channels = _read_channels(database, compression)
                self.contents = _contents(database, channels, has_index=self._has_index)
        except (sqlite3.Error, Malformed) as error:
            self.contents = self._rescue(error).contents

    def pieces(self, selection: Selection, order: tuple[int, ...]) -> Iterator[MessagePiece]:
        """Yield the database as one piece."""
        if self._recovered is not None:
            yield from self._recovered.pieces(selection, order)
            return
        if channels := self.contents.select(selection):
            first_ns = max(selection.start_ns, self.contents.start_ns or 0)
            yield MessagePiece(first_ns, order, lambda: MessageRun([], 0, self._blocks(channels, selection)))

    def segments(self, selection: Selection, file_number: int) -> Iterator[Segment]:
        """Yield slices of equal time, of about 1 MB each; without an index of times, the whole database."""
        if self._recovered is not None:
            yield from self._recovered.segments(selection, file_number)
            return
        if not self.contents.select(selection):
            return
        start_ns, end_ns, size_bytes = self.contents.start_ns, self.contents.end_ns, self._path.stat().st_size
        if start_ns is None or end_ns is None:
            if self.contents.message_count != 0:
                yield Segment(0, _LATEST_NS, size_bytes, None, (file_number, 0))
            return
        count = min(_MAX_SLICES, max(1, size_bytes // _SLICE_BYTES), end_ns - start_ns + 1)
        edges = [start_ns + (end_ns + 1 - start_ns) * number // count for number in range(count + 1)]
        for number, (first_ns, after_ns) in enumerate(pairwise(edges)):
            if first_ns < selection.end_ns and after_ns > selection.start_ns:
                yield Segment(first_ns, after_ns - 1, size_bytes // count, None, (file_number, number))

    def segment_pieces(self, segment: Segment, selection: Selection) -> Iterator[MessagePiece]:
        """Yield one slice."""
        if self._recovered is not None:
            return self._recovered.segment_pieces(segment, selection)
        start_ns, end_ns = max(selection.start_ns, segment.first_ns), min(selection.end_ns, segment.last_ns + 1)
        return self.pieces(Selection(selection.topics, start_ns, end_ns), segment.order)

    def _blocks(self, channels: dict[int, Channel], selection: Selection) -> Iterator[Block]:
        """Yield messages from SQLite; if it fails, the later ones from the recovery."""
        latest_ns, of_latest = max(selection.start_ns, self.contents.start_ns or 0), 0
        try:
            for block in self._by_sqlite(channels, selection):
                stamps = [message.log_time_ns for message in block]
                if not all(map(le, [latest_ns, *stamps], stamps)):
                    raise sqlite3.DatabaseError("its index of times is not in their order")
                of_latest = of_latest if stamps[-1] == latest_ns else 0
                latest_ns = stamps[-1]
                of_latest += stamps.count(latest_ns)
                yield block
        except sqlite3.Error as error:
            rest = self._rescue(error).pieces(selection._replace(start_ns=latest_ns), ())
            for block in merge(rest):
                seen = sum(message.log_time_ns == latest_ns for message in block[:of_latest])
                of_latest -= seen
                if block[seen:]:
                    yield block[seen:]

    def _by_sqlite(self, channels: dict[int, Channel], selection: Selection) -> Iterator[Block]:
        block: Block = []
        size = 0
        with db.open_database(self._path) as database:
            if sys.version_info >= (3, 11):
                database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, 2 * MAX_MESSAGE)
            for topic_id, timestamp, data in self._rows(database, channels, selection):
                channel = channels.get(topic_id) if isinstance(topic_id, int) else None
                if channel is None or not isinstance(timestamp, int):
                    continue
                if not isinstance(data, bytes):
                    self._problem_log.add("damaged-message", channel.topic, "left out: its data are too large, or none")
                    continue
                block.append(RawMessage(channel.topic, timestamp, timestamp, 0, data, channel))
                size += len(data)
                if size > _BLOCK_BYTES or len(block) >= _BLOCK_ROWS:
                    yield block
                    block, size = [], 0
        if block:
            yield block

    def _rows(self, database: sqlite3.Connection, channels: dict[int, Channel], selection: Selection) -> Iterator[_Row]:
        span = (min(max(0, selection.start_ns), _LATEST_NS), min(selection.end_ns, _LATEST_NS))
        if self._has_index:
            some = len(channels) < len(self.contents.channels)
            numbers = ", ".join(str(number) for number in channels)
            statement = _BY_INDEX.replace("ORDER", f"AND topic_id IN ({numbers}) ORDER") if some else _BY_INDEX
            yield from database.execute(statement, span)
            return
        for (number,) in database.execute(_BY_NUMBERS, span):
            yield from database.execute(_ONE, (number,))

    def _rescue(self, error: Exception) -> OpenedFile:
        self._problem_log.add("damaged", self._name, f"SQLite cannot read it ({error}); what is left of it is read")
        if self._recovered is None:
            self._recovered = self._recover()
        return self._recovered


def _has_index(database: sqlite3.Connection) -> bool:
    statements = database.execute("SELECT sql FROM sqlite_master WHERE type = 'index' AND tbl_name = 'messages'")
    return any(isinstance(sql, str) and "(timestamp" in sql.replace(" ", "").lower() for (sql,) in statements)


def _read_channels(database: sqlite3.Connection, message_compression: str) -> dict[int, Channel]:
    definitions: dict[str, tuple[str, bytes]] = {}
    if {"topic_type", "encoding", "encoded_message_definition"} <= db.columns(database, "message_definitions"):
        size = 0
        for name, encoding, text in database.execute(_DEFINITIONS):
            if isinstance(name, str) and isinstance(encoding, str) and isinstance(text, str):
                size += len(text)
                if size > MAX_DEFINITIONS:
                    break
                definitions.setdefault(name, (encoding, text.encode()))
    return {
        topic.topic_id: Channel(
            topic.name,
            topic.serialization_format or "cdr",
            Schema(topic.message_type, *definitions.get(topic.message_type, ("", b""))),
            message_compression,
            topic.properties,
        )
        for topic in db.read_topics(database)
    }


def _contents(database: sqlite3.Connection, channels: dict[int, Channel], *, has_index: bool) -> MemberContents:
    """Return channels and, if timestamps are indexed, span and count."""
    if not has_index:
        return MemberContents(channels, None, None, None, None)
    (count,) = database.execute("SELECT count(*) FROM messages").fetchone()
    ends = [
        database.execute(f"SELECT timestamp FROM messages ORDER BY timestamp {order} LIMIT 1").fetchone()  # noqa: S608  # our words
        for order in ("ASC", "DESC")
    ]
    start_ns, end_ns = (end[0] if end and isinstance(end[0], int) else None for end in ends)
    return MemberContents(channels, None, count, start_ns, end_ns)


def _summarise(source: Source, max_bytes: int) -> RecordingSummary:
    if source.size_bytes > max_bytes:
        why = "a rosbag2 database (db3) has no index of its messages"
        return pending(RecordingFormat.rosbag2_db3, source.size_bytes, why)
    return scan_db3(SourceReader(source), depth=Depth.summary)


def _open(file: base.RecordingFile, context: base.OpenContext) -> OpenedFile:
    source, problem_log, compression = file.source, context.problem_log, context.message_compression
    if file.path is None:
        context.check_cost(source, "a rosbag2 database (db3) is read from a local copy")
    path = file.database = _whole_database(file, context)

    def recover() -> OpenedFile:
        return open_recovered(path, source.name, problem_log, context.stack, message_compression=compression)

    return DatabaseMember(path, source.name, problem_log, recover, message_compression=compression)


def _whole_database(file: base.RecordingFile, context: base.OpenContext) -> Path:
    """Return the path of a database with its log and journal applied."""
    if file.path is not None:
        log_problems = db.find_unmerged_logs(file.path, file.base_name)
        copy = context.stack.enter_context(db.replayed_copy(file.path)) if log_problems else None
        is_applied = copy is not None
        path = copy or file.path
    else:
        name = file.source.name
        logs = {suffix: log for suffix in LOG_SUFFIXES if (log := context.logs.get(f"{name}{suffix}")) is not None}
        path = context.copy(SourceReader(file.source).read, name, logs)
        log_problems = db.find_unmerged_logs(path, file.base_name)
        is_applied = bool(log_problems) and db.replay(path)
        if log_problems and not is_applied:  # half of it may be in this copy
            path = context.copy(SourceReader(file.source).read, name)
    for problem in [*log_problems, *([] if is_applied else db.log_not_read(log_problems))]:
        context.problem_log.add(problem.code, problem.where, problem.message)
    return path


def _matches(head: base.Head) -> bool:
    """Recognise the tables in the schema, or a database whose tables may be in the log beside it."""
    return db.is_database(head.data) and (
        all(table.search(head.data) for table in _ROSBAG2_TABLES) or db.is_database_in_log(head.data, head.path)
    )


ROSBAG2_DB3 = Format(
    RecordingFormat.rosbag2_db3,
    _matches,
    "a recording (rosbag2 database)",
    extensions=(".db3",),
    scan=scan_db3,
    summarise=_summarise,
    open=_open,
)
