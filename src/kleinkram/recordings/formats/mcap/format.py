"""The MCAP format, and SVO2, which is an MCAP."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from kleinkram.recordings import file_summary
from kleinkram.recordings.chunk_reader import ChunkedMember, ChunkFormat, FileGap, SalvagedMessages
from kleinkram.recordings.chunk_scanner import open_by_scan, salvage_by_scan
from kleinkram.recordings.chunk_table import ChunkTableBuilder
from kleinkram.recordings.damage_report import DamageReport
from kleinkram.recordings.errors import NotIndexed
from kleinkram.recordings.file_summary import TopicType
from kleinkram.recordings.formats.base import Format, MemberContents, OpenContext, RecordingFile
from kleinkram.recordings.formats.mcap import chunks
from kleinkram.recordings.formats.mcap.index import read_index
from kleinkram.recordings.formats.mcap.records import MAGIC, ChannelRecord, McapFacts
from kleinkram.recordings.formats.mcap.scan import McapScan, scan_records
from kleinkram.recordings.index_check import wrong_times
from kleinkram.recordings.messages import Channel
from kleinkram.recordings.model import Depth, Fact, Problem, RecordingFormat, RecordingSummary, counted
from kleinkram.recordings.sources import SequentialReader, Source, SourceReader
from kleinkram.recordings.timeline import Timeline


def summarise_mcap(source: Source, *, max_bytes: int) -> RecordingSummary:
    """Summarise by the index, or else by a scan of at most `max_bytes`."""
    timeline, losses = Timeline(), DamageReport()
    try:
        facts = read_index(source, (timeline, losses))
    except NotIndexed as refusal:
        why, code = str(refusal), refusal.code
        problems = [Problem(code, source.name, why)] if refusal.is_problem else []
        if source.size_bytes > max_bytes:
            return file_summary.pending(RecordingFormat.mcap, source.size_bytes, why, problems)
        return scan_mcap(SourceReader(source), problems)
    damage = facts.header_damage
    problems = [Problem("header-damaged", damage.where, damage.message)] if damage is not None else []
    problems += [*losses.problems(), *facts.index_faults.problems()]
    if not losses.damage:
        problems += _wrong_statistics(facts, timeline)
    return _summary(facts, timeline, losses, problems, closed=True)


def scan_mcap(reader: SequentialReader, problems: Sequence[Problem] = ()) -> RecordingSummary:
    """Scan a whole file. `problems`: why its index was not enough."""
    return summarise_scan(scan_records(reader), reader.name, problems)


def summarise_scan(scan: McapScan, name: str, problems: Sequence[Problem] = ()) -> RecordingSummary:
    """Return the summary of a scan. `problems`: why the index was not enough."""
    timeline = scan.counter.timeline
    all_problems = scan.losses.problems()
    claimed, messages = scan.facts.statistics, scan.counter.messages
    if claimed is not None and claimed.messages != messages and not all_problems:
        message = f"the statistics say {counted(claimed.messages, 'message')}, the file holds {messages}"
        all_problems.append(Problem("counts-disagree", name, message))
    if not scan.losses.damage:
        all_problems += _wrong_statistics(scan.facts, timeline)
    all_problems += scan.facts.index_faults.problems()
    all_problems = all_problems or [*problems]  # a scan describes a wrong index more exactly
    all_problems += file_summary.publish_time_problems(scan.counter.lateness)
    summary = _summary(scan.facts, timeline, scan.losses, all_problems, closed=scan.closed)
    return replace(summary, depth=Depth.scan)


def _wrong_statistics(facts: McapFacts, timeline: Timeline) -> list[Problem]:
    """Report where the statistics differ from the messages of an undamaged file."""
    claimed = facts.statistics
    runs = [run for times in timeline.topics.values() for run in times.runs]
    if claimed is None or not runs:
        return []
    problems = []
    span = min(run.first_ns for run in runs), max(run.last_ns for run in runs)
    if wrong := wrong_times((claimed.start_ns, claimed.end_ns), span):
        problems.append(Problem("index-damaged", "statistics", f"they say that the messages {wrong}"))
    counts: dict[str, int] = defaultdict(int)
    for number, count in claimed.counts:
        if number in facts.channels:
            counts[facts.channels[number].topic] += count
    for topic, count in sorted(counts.items()) if sum(counts.values()) == claimed.messages else ():
        actual = timeline.topics[topic].count if topic in timeline.topics else 0
        if actual != count:
            message = f"the statistics say {counted(count, 'message')}, there are {actual}"
            problems.append(Problem("counts-disagree", topic, message))
    return file_summary.merge_similar(problems)


def _summary(
    facts: McapFacts, timeline: Timeline, losses: DamageReport, problems: Sequence[Problem], *, closed: bool
) -> RecordingSummary:
    kinds: list[tuple[str, TopicType]] = []
    publishers: list[tuple[str, str, str]] = []
    for channel in facts.channels.values():
        timeline.topic(channel.topic)
        schema = facts.schema_of(channel)
        kinds.append((channel.topic, TopicType(schema.name, schema.encoding, channel.message_encoding)))
        publishers.append((channel.topic, schema.name, channel.publisher))
    all_problems = [*problems, *file_summary.duplicate_channel_problems(publishers)]
    types = file_summary.types_by_topic(kinds)
    summary = replace(
        file_summary.build_summary(RecordingFormat.mcap, timeline, types, all_problems),
        compression=tuple(sorted(facts.compression)),
        library=facts.library,
        profile=facts.profile,
        attachments=facts.attachments,
        metadata_records=facts.metadata_records,
        facts=tuple(facts.listed),
    )
    if closed and not losses.damage:
        return summary
    claimed = facts.statistics.messages if facts.statistics is not None and not losses.index_faults else None
    reasons = [] if closed else ["it has no footer, so it was cut or never closed"]
    return losses.describe(summary, claimed=claimed, reasons=reasons, checksum_note=", without its checksum")


def open_mcap(file: RecordingFile, context: OpenContext) -> ChunkedMember:
    """Open by the index, or else by a scan; `TooCostly` if the file has more bytes than may be read."""
    source, problem_log, message_compression = file.source, context.problem_log, context.message_compression
    try:
        facts = read_index(source)
    except NotIndexed as refusal:
        context.check_cost(source, str(refusal))
        if refusal.code == "no-footer" or refusal.is_problem:
            problem_log.add(refusal.code, source.name, str(refusal))
        builder = ChunkTableBuilder(problem_log)
        scan = scan_records(SourceReader(source), builder)
        channels, summary = scan.facts.resolve_channels(message_compression), summarise_scan(scan, source.name)
        return open_by_scan(source, builder, MCAP_CHUNKS, channels, summary)
    channels = facts.resolve_channels(message_compression)
    statistics = facts.statistics
    if statistics is None or facts.unknown_compression:
        # The statistics also count messages that cannot be read.
        contents = MemberContents(channels, None, None, *facts.table.span(without=facts.unknown_compression.keys()))
        return ChunkedMember(source, MCAP_CHUNKS, facts.table, contents, problem_log, with_index_check=True)
    by_channel = dict(statistics.counts)
    counts = by_channel if sum(by_channel.values()) == statistics.messages else None
    span = (statistics.start_ns, statistics.end_ns) if statistics.messages else (None, None)
    contents = MemberContents(channels, counts, statistics.messages, *span)
    return ChunkedMember(
        source, MCAP_CHUNKS, facts.table, contents, problem_log, with_index_check=True, claimed_span=span
    )


def _salvage(source: Source, gaps: Iterable[FileGap], channels: Mapping[int, Channel]) -> SalvagedMessages:
    known = {number: ChannelRecord(0, channel.topic, channel.message_encoding) for number, channel in channels.items()}
    return salvage_by_scan(source, gaps, MAGIC, lambda reader, observer: scan_records(reader, observer, known))


MCAP_CHUNKS = ChunkFormat(chunks.open_chunk, chunks.parse_messages, _salvage, chunks.read_message_index)
MCAP = Format(
    RecordingFormat.mcap,
    lambda head: head.data.startswith(MAGIC),
    "a recording (MCAP)",
    extensions=(".mcap", ".svo2"),
    scan=scan_mcap,
    summarise=summarise_mcap,
    open=open_mcap,
)


_LIBRARY_WORD = b"stereolabs"
_MCAP_HEADER_BYTES = 64
_CAMERA = re.compile(r"Camera_SN(?P<serial>\d{1,20})/(?P<what>\w+)")


def as_svo2(summary: RecordingSummary) -> RecordingSummary:
    """Return an MCAP summary as that of an SVO2, with cameras and frames as facts."""
    facts: list[Fact] = []
    for topic in summary.topics:
        match = _CAMERA.fullmatch(topic.name)
        if match is not None and match["what"] == "side_by_side":
            facts.append(Fact("camera_serial", match["serial"]))
            if topic.count is not None:
                facts.append(Fact("frames", topic.count))
    return replace(summary, format=RecordingFormat.svo2, facts=(*facts, *summary.facts))


SVO2 = Format(
    RecordingFormat.svo2,
    lambda head: head.data.startswith(MAGIC) and _LIBRARY_WORD in head.data[len(MAGIC) :][:_MCAP_HEADER_BYTES],
    "a recording of a ZED camera (SVO2)",
    extensions=(".svo2", ".mcap"),
    scan=lambda reader: as_svo2(scan_mcap(reader)),
    summarise=lambda source, *, max_bytes: as_svo2(summarise_mcap(source, max_bytes=max_bytes)),
    refusal="it is a SVO2 of a ZED camera, and reading that format is not supported",
)
