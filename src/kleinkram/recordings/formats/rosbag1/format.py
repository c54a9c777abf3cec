"""The ROS 1 bag format, version 2.0."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from kleinkram.recordings.chunk_reader import ChunkFormat, ChunkTableBuilder, FileGap, JoinedGaps, SalvagedMessages
from kleinkram.recordings.chunk_table import ChunkTable
from kleinkram.recordings.damage_report import DamageReport, ProblemLog
from kleinkram.recordings.errors import Malformed
from kleinkram.recordings.formats.base import (
    ChunkedMember,
    Format,
    MemberContents,
    OpenContext,
    RecordingFile,
    check_cost,
)
from kleinkram.recordings.formats.rosbag1 import chunks, records
from kleinkram.recordings.formats.rosbag1.index import read_index, read_index_data
from kleinkram.recordings.formats.rosbag1.records import Connection
from kleinkram.recordings.formats.rosbag1.scan import BagScan, scan_bag_records
from kleinkram.recordings.messages import Channel
from kleinkram.recordings.model import Content, Depth, Problem, RecordingFormat, RecordingSummary, counted
from kleinkram.recordings.sources import SequentialReader, Source, SourceReader, source_reader
from kleinkram.recordings.timeline import Timeline
from kleinkram.recordings.topic_statistics import (
    TopicType,
    bounded,
    describe_damage,
    describe_readable,
    duplicate_channel_problems,
    measure,
    pending,
)


def summarise_bag(source: Source, *, most_bytes: int) -> RecordingSummary:
    """Summarise a bag by its index; scan it where that is impossible, if it has at most `most_bytes`.

    Raises:
        SourceError: as `Source.read`.
    """
    timeline, losses = Timeline(), DamageReport()
    try:
        index = read_index(source)
        read_index_data(source, index, timeline, losses)
    except Malformed as error:
        if source.size_bytes > most_bytes:
            return pending(RecordingFormat.rosbag1, source.size_bytes, f"{error.message}, at {error.where}")
        return scan_bag(source_reader(source), [Problem("index-damaged", error.where, error.message)])
    problems = [*losses.problems(), *index.index_faults.problems()]
    summary = _summary(timeline, index.facts.connections, index.compression, problems)
    if not losses.damage:
        return summary
    messages = summary.message_count or 0
    lost = losses.total(claimed=sum(index.counts.values()), readable=messages)
    reason = f"it is damaged {describe_damage(losses.damage)}; {describe_readable(messages, lost)}"
    return replace(summary, content=_content(losses, messages), reason=reason, lost=lost)


def scan_bag(reader: SequentialReader, problems: Sequence[Problem] = ()) -> RecordingSummary:
    """Scan a whole bag. `problems`: why its index was not enough.

    Raises:
        SourceError: as `SequentialReader.read`.
    """
    return summarise_scan(scan_bag_records(reader), reader.name, problems)


def summarise_scan(scan: BagScan, name: str, problems: Sequence[Problem] = ()) -> RecordingSummary:
    """Return the summary of a scan. `problems`: why the index was not enough."""
    losses, messages = scan.losses, scan.counter.messages
    all_problems = [*losses.problems(), *scan.index_faults.problems()]
    if scan.listed is not None and scan.listed != messages and not all_problems:
        message = f"the index says {counted(scan.listed, 'message')}, the file holds {messages}"
        all_problems.append(Problem("counts-disagree", name, message))
    whole = bool(scan.index_start) and not losses.damage and scan.refused is None
    lost = None if whole or scan.refused is not None else losses.total(claimed=scan.listed, readable=messages)
    if whole:
        all_problems = all_problems or [*problems]
    reason = None if whole else f"{_what_is_wrong(scan)}; {describe_readable(messages, lost)}"
    summary = _summary(scan.counter.timeline, scan.facts.connections, scan.compression, all_problems)
    content = Content.opaque if scan.refused is not None else _content(losses, messages)
    return replace(summary, content=Content.indexed if whole else content, reason=reason, depth=Depth.scan, lost=lost)


def _content(losses: DamageReport, messages: int) -> Content:
    """Return the content of a damaged bag."""
    if messages:
        return Content.recovered
    damage = losses.damage
    return Content.broken if any(fault.certain for fault in damage) or not damage else Content.opaque


def _what_is_wrong(scan: BagScan) -> str:
    parts = []
    if scan.refused is not None:
        return f"{scan.refused.message}, at {scan.refused.where}"
    if scan.index_start == 0:
        parts.append("it was not closed by its recorder, so it has no index (index_pos is 0)")
    if scan.losses.damage:
        parts.append(f"it is damaged {describe_damage(scan.losses.damage)}")
    if scan.index_start is None:
        parts.append("it has no bag header")
    if scan.losses.unverified:
        parts.append(
            f"{counted(scan.losses.unverified, 'message was', 'messages were')} saved from the beginning of a cut chunk"
        )
    return "; ".join(parts)


def _summary(
    timeline: Timeline, connections: Mapping[int, Connection], compression: set[str], problems: Sequence[Problem]
) -> RecordingSummary:
    types: dict[str, list[TopicType]] = {}
    for connection in connections.values():
        timeline.topic(connection.topic)
        kind = TopicType(connection.message_type, "ros1msg", "ros1")
        known = types.setdefault(connection.topic, [])
        if kind not in known:
            known.append(kind)
    measured = measure(timeline, types)
    named = [(one.topic, one.message_type, one.publisher) for one in connections.values()]
    return RecordingSummary(
        format=RecordingFormat.rosbag1,
        content=Content.indexed,
        message_count=measured.message_count,
        start_ns=measured.start_ns,
        end_ns=measured.end_ns,
        compression=tuple(sorted(compression)),
        topics=measured.topics,
        problems=bounded([*problems, *duplicate_channel_problems(named), *measured.problems]),
        profile="ros1",
    )


def open_bag(file: RecordingFile, context: OpenContext) -> ChunkedMember:
    """Open by the index, or else by a scan.

    Raises:
        TooCostly: it would have to be read whole, and has more bytes than may be read.
        SourceError: as `Source.read`.
    """
    source, problem_log = file.source, context.problem_log
    try:
        index = read_index(source)
    except Malformed as error:
        why = f"the index cannot be used: {error}"
        check_cost(source, context.limit_of(source), why)
        problem_log.add("no-index", source.name, why)
        return _open_scanned(source, problem_log)
    contents = MemberContents(index.facts.channels(), index.counts, sum(index.counts.values()), *index.table.span())
    return ChunkedMember(source, BAG_CHUNKS, index.table, contents, problem_log, with_index_check=True)


def _open_scanned(source: Source, problem_log: ProblemLog) -> ChunkedMember:
    builder = ChunkTableBuilder(ChunkTable(), problem_log)
    scan = scan_bag_records(SourceReader(source), builder)
    builder.close()
    channels = scan.facts.channels()
    counts = {number: count for number, count in builder.counts.items() if number in channels}
    contents = MemberContents(channels, counts, sum(counts.values()), *builder.table.span())
    return ChunkedMember(
        source, BAG_CHUNKS, builder.table, contents, problem_log, summary=summarise_scan(scan, source.name)
    )


def _salvage(source: Source, gaps: Iterable[FileGap], channels: Mapping[int, Channel]) -> SalvagedMessages:
    part = JoinedGaps(source, records.MAGIC, gaps)
    builder = ChunkTableBuilder(ChunkTable(), ProblemLog())
    scan_bag_records(SourceReader(part), builder)
    builder.close()
    return SalvagedMessages(part, builder.table)


BAG_CHUNKS = ChunkFormat(chunks.open_chunk, chunks.parse_messages, _salvage, chunks.read_message_index)
ROSBAG1 = Format(
    RecordingFormat.rosbag1,
    lambda head: head.data.startswith(records.MAGIC),
    "a recording (ROS 1 bag)",
    extensions=(".bag",),
    scan=scan_bag,
    summarise=summarise_bag,
    open=open_bag,
)
ROSBAG1_OLD = Format(
    RecordingFormat.rosbag1_old,
    lambda head: head.data.startswith((b"#ROSBAG V1", b"#ROSRECORD V1")),
    "a ROS bag 1.x: convert it with 'rosbag migrate'",
    extensions=(".bag",),
    refusal="it is a ROS bag 1.x: convert it with 'rosbag migrate'",
)
