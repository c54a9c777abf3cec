"""The ROS 1 bag format, version 2.0."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from kleinkram.recordings import file_summary
from kleinkram.recordings.chunk_reader import ChunkedMember, ChunkFormat, FileGap, SalvagedMessages
from kleinkram.recordings.chunk_scanner import open_by_scan, salvage_by_scan
from kleinkram.recordings.chunk_table import ChunkTableBuilder
from kleinkram.recordings.damage_report import DamageReport, describe_readable
from kleinkram.recordings.errors import Malformed
from kleinkram.recordings.file_summary import TopicType
from kleinkram.recordings.formats.base import Format, MemberContents, OpenContext, RecordingFile
from kleinkram.recordings.formats.rosbag1 import chunks, records
from kleinkram.recordings.formats.rosbag1.chunks import BagFacts
from kleinkram.recordings.formats.rosbag1.index import read_index
from kleinkram.recordings.formats.rosbag1.scan import BagScan, scan_bag_records
from kleinkram.recordings.messages import Channel
from kleinkram.recordings.model import Content, Depth, Problem, RecordingFormat, RecordingSummary, counted
from kleinkram.recordings.sources import SequentialReader, Source, SourceReader
from kleinkram.recordings.timeline import Timeline


def summarise_bag(source: Source, *, max_bytes: int) -> RecordingSummary:
    """Summarise by the index; scan where that is impossible, if the bag has at most `max_bytes`."""
    timeline, losses = Timeline(), DamageReport()
    try:
        facts = read_index(source, (timeline, losses))
    except Malformed as error:
        if source.size_bytes > max_bytes:
            return file_summary.pending(
                RecordingFormat.rosbag1, source.size_bytes, f"{error.message}, at {error.where}"
            )
        return scan_bag(SourceReader(source), [Problem("index-damaged", error.where, error.message)])
    summary = _summary(facts, timeline, [*losses.problems(), *facts.index_faults.problems()])
    return losses.describe(summary, claimed=sum(facts.counts.values())) if losses.damage else summary


def scan_bag(reader: SequentialReader, problems: Sequence[Problem] = ()) -> RecordingSummary:
    """Scan a whole bag. `problems`: why its index was not enough."""
    return summarise_scan(scan_bag_records(reader), reader.name, problems)


def summarise_scan(scan: BagScan, name: str, problems: Sequence[Problem] = ()) -> RecordingSummary:
    """Return the summary of a scan. `problems`: why the index was not enough."""
    losses, messages = scan.losses, scan.counter.messages
    all_problems = [*losses.problems(), *scan.facts.index_faults.problems()]
    if scan.listed is not None and scan.listed != messages and not all_problems:
        message = f"the index says {counted(scan.listed, 'message')}, the file holds {messages}"
        all_problems.append(Problem("counts-disagree", name, message))
    is_complete = bool(scan.index_start) and not losses.damage and scan.refused is None
    if is_complete:
        all_problems = all_problems or [*problems]
    summary = replace(_summary(scan.facts, scan.counter.timeline, all_problems), depth=Depth.scan)
    if is_complete:
        return summary
    if scan.refused is not None:
        reason = f"{scan.refused.message}, at {scan.refused.where}; {describe_readable(messages, None)}"
        return replace(summary, content=Content.opaque, reason=reason)
    reasons = []
    if scan.index_start == 0:
        reasons.append("it was not closed by its recorder, so it has no index (index_pos is 0)")
    elif scan.index_start is None:
        reasons.append("it has no bag header")
    return losses.describe(summary, claimed=scan.listed, reasons=reasons)


def _summary(facts: BagFacts, timeline: Timeline, problems: Sequence[Problem]) -> RecordingSummary:
    connections = facts.channels.values()
    for connection in connections:
        timeline.topic(connection.topic)
    publishers = [(one.topic, one.message_type, one.publisher) for one in connections]
    all_problems = [*problems, *file_summary.duplicate_channel_problems(publishers)]
    kinds = ((one.topic, TopicType(one.message_type, "ros1msg", "ros1")) for one in connections)
    types = file_summary.types_by_topic(kinds)
    summary = file_summary.build_summary(RecordingFormat.rosbag1, timeline, types, all_problems)
    return replace(summary, compression=tuple(sorted(facts.compression)), profile="ros1")


def open_bag(file: RecordingFile, context: OpenContext) -> ChunkedMember:
    """Open by the index, or else by a scan; `TooCostly` if the file has more bytes than may be read."""
    source, problem_log = file.source, context.problem_log
    try:
        facts = read_index(source)
    except Malformed as error:
        why = f"the index cannot be used: {error}"
        context.check_cost(source, why)
        problem_log.add("no-index", source.name, why)
        builder = ChunkTableBuilder(problem_log)
        scan = scan_bag_records(SourceReader(source), builder)
        channels, summary = scan.facts.resolve_channels(), summarise_scan(scan, source.name)
        return open_by_scan(source, builder, BAG_CHUNKS, channels, summary)
    contents = MemberContents(facts.resolve_channels(), facts.counts, sum(facts.counts.values()), *facts.table.span())
    return ChunkedMember(source, BAG_CHUNKS, facts.table, contents, problem_log, with_index_check=True)


def _salvage(source: Source, gaps: Iterable[FileGap], channels: Mapping[int, Channel]) -> SalvagedMessages:
    return salvage_by_scan(source, gaps, records.MAGIC, scan_bag_records)


BAG_CHUNKS = ChunkFormat(records.open_chunk, chunks.parse_messages, _salvage, chunks.read_message_index)
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
