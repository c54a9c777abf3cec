"""The MCAP format, and SVO2, which is an MCAP."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from kleinkram.recordings.chunk_reader import ChunkFormat, ChunkTableBuilder, FileGap, JoinedGaps, SalvagedMessages
from kleinkram.recordings.chunk_table import ChunkTable
from kleinkram.recordings.damage_report import DamageReport, ProblemLog
from kleinkram.recordings.errors import NotIndexed
from kleinkram.recordings.formats.base import (
    ChunkedMember,
    Format,
    MemberContents,
    OpenContext,
    RecordingFile,
    check_cost,
)
from kleinkram.recordings.formats.mcap import chunks, records
from kleinkram.recordings.formats.mcap.index import read_index
from kleinkram.recordings.formats.mcap.records import MAGIC, ChannelRecord, McapFacts
from kleinkram.recordings.formats.mcap.scan import McapScan, scan_records
from kleinkram.recordings.index_check import wrong_times
from kleinkram.recordings.messages import Channel
from kleinkram.recordings.model import Content, Depth, Fact, Problem, RecordingFormat, RecordingSummary, counted
from kleinkram.recordings.sources import SequentialReader, Source, SourceReader, source_reader
from kleinkram.recordings.timeline import Timeline
from kleinkram.recordings.topic_statistics import (
    Measured,
    TopicType,
    bounded,
    describe_damage,
    describe_readable,
    duplicate_channel_problems,
    measure,
    merge_similar,
    pending,
    publish_time_problems,
)


def summarise_mcap(source: Source, *, most_bytes: int) -> RecordingSummary:
    """Summarise by the index, or else by a scan of at most `most_bytes`.

    Raises:
        SourceError: as `Source.read`.
    """
    timeline, losses = Timeline(), DamageReport()
    problems: list[Problem] = []
    try:
        facts = read_index(source, (timeline, losses))
    except NotIndexed as refusal:
        why = str(refusal)
        if refusal.is_problem:
            problems.append(Problem(refusal.code, source.name, why))
    else:
        return _by_index(facts, timeline, losses)
    if source.size_bytes > most_bytes:
        return pending(RecordingFormat.mcap, source.size_bytes, why, problems)
    return scan_mcap(source_reader(source), problems)


def scan_mcap(reader: SequentialReader, problems: Sequence[Problem] = ()) -> RecordingSummary:
    """Scan a whole file. `problems`: why its index was not enough.

    Raises:
        SourceError: as `SequentialReader.read`.
    """
    return summarise_scan(scan_records(reader), reader.name, problems)


def summarise_scan(scan: McapScan, name: str, problems: Sequence[Problem] = ()) -> RecordingSummary:
    """Return the summary of a scan. `problems`: why the index was not enough."""
    all_problems = scan.losses.problems()
    claimed, messages = scan.facts.statistics, scan.counter.messages
    if claimed is not None and claimed.messages != messages and not all_problems:
        message = f"the statistics say {counted(claimed.messages, 'message')}, the file holds {messages}"
        all_problems.append(Problem("counts-disagree", name, message))
    if not scan.losses.damage:
        all_problems += _wrong_statistics(scan.facts, scan.counter.timeline)
    all_problems += scan.facts.index_faults.problems()
    all_problems = all_problems or [*problems]  # a scan says more exactly what is wrong with an index
    all_problems += publish_time_problems(scan.counter.lateness)
    summary = _judged(
        _summary(scan.facts, scan.counter.timeline, all_problems), scan.facts, scan.losses, closed=scan.closed
    )
    return replace(summary, depth=Depth.scan)


def _by_index(facts: McapFacts, timeline: Timeline, losses: DamageReport) -> RecordingSummary:
    damage = facts.header_damage
    problems = [Problem("header-damaged", damage.where, damage.message)] if damage is not None else []
    problems += [*losses.problems(), *facts.index_faults.problems()]
    if not losses.damage:
        problems += _wrong_statistics(facts, timeline)
    return _judged(_summary(facts, timeline, problems), facts, losses, closed=True)


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
            problems.append(
                Problem("counts-disagree", topic, f"the statistics say {counted(count, 'message')}, there are {actual}")
            )
    return merge_similar(problems)


def _judged(summary: RecordingSummary, facts: McapFacts, losses: DamageReport, *, closed: bool) -> RecordingSummary:
    """Add content, reason and loss."""
    messages = summary.message_count or 0
    content = _content(
        losses, closed=closed, holds_anything=bool(messages or facts.attachments or facts.metadata_records)
    )
    if content is Content.indexed:
        return replace(summary, content=content)
    stated = facts.statistics.messages if facts.statistics is not None and not losses.index_faults else None
    lost = losses.total(claimed=stated, readable=messages)
    reason = f"{_what_is_wrong(losses, closed=closed)}; {describe_readable(messages, lost)}"
    return replace(summary, content=content, reason=reason, lost=lost)


def _content(losses: DamageReport, *, closed: bool, holds_anything: bool) -> Content:
    if closed and not losses.damage:
        return Content.indexed
    if holds_anything:
        return Content.recovered
    return Content.broken if any(fault.certain for fault in losses.damage) or not losses.damage else Content.opaque


def _what_is_wrong(losses: DamageReport, *, closed: bool) -> str:
    never_closed = "" if closed else "it has no footer, so it was cut or never closed"
    if not losses.damage:
        return never_closed
    damage = f"damaged {describe_damage(losses.damage)}"
    if losses.unverified:
        saved = counted(losses.unverified, "message was", "messages were")
        damage += f"; {saved} saved from the beginning of a cut chunk, without its checksum"
    return f"{never_closed}; {damage}" if never_closed else f"it is {damage}"


def _summary(facts: McapFacts, timeline: Timeline, problems: list[Problem]) -> RecordingSummary:
    for channel in facts.channels.values():
        timeline.topic(channel.topic)
    measured: Measured = measure(timeline, _topic_types(facts))
    named = [(one.topic, facts.schema_of(one).name, one.publisher) for one in facts.channels.values()]
    return RecordingSummary(
        format=RecordingFormat.mcap,
        content=Content.indexed,
        message_count=measured.message_count,
        start_ns=measured.start_ns,
        end_ns=measured.end_ns,
        compression=tuple(sorted(facts.compression)),
        topics=measured.topics,
        problems=bounded([*problems, *duplicate_channel_problems(named), *measured.problems]),
        library=facts.library,
        profile=facts.profile,
        attachments=facts.attachments,
        metadata_records=facts.metadata_records,
        facts=tuple(facts.listed),
    )


def _topic_types(facts: McapFacts) -> Mapping[str, list[TopicType]]:
    types: dict[str, list[TopicType]] = {}
    for channel in facts.channels.values():
        schema = facts.schema_of(channel)
        kind = TopicType(schema.name, schema.encoding, channel.message_encoding)
        known = types.setdefault(channel.topic, [])
        if kind not in known:
            known.append(kind)
    return types


def open_mcap(file: RecordingFile, context: OpenContext) -> ChunkedMember:
    """Open by the index, or else by a scan.

    Raises:
        TooCostly: it would have to be read whole, and has more bytes than may be read.
        SourceError: as `Source.read`.
    """
    source, problem_log, message_compression = file.source, context.problem_log, context.message_compression
    try:
        facts = read_index(source)
    except NotIndexed as refusal:
        check_cost(source, context.limit_of(source), str(refusal))
        if refusal.code == "no-footer":
            problem_log.add("no-footer", source.name, str(refusal))
        elif refusal.is_problem:
            problem_log.add(refusal.code, source.name, str(refusal))
        return _open_scanned(source, problem_log, message_compression)
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


def _open_scanned(source: Source, problem_log: ProblemLog, message_compression: str) -> ChunkedMember:
    builder = ChunkTableBuilder(ChunkTable(), problem_log)
    scan = scan_records(SourceReader(source), builder)
    builder.close()
    channels = scan.facts.resolve_channels(message_compression)
    counts = {number: count for number, count in builder.counts.items() if number in channels}
    span = builder.table.span() if counts else (None, None)
    contents = MemberContents(channels, counts, sum(counts.values()), *span)
    return ChunkedMember(
        source, MCAP_CHUNKS, builder.table, contents, problem_log, summary=summarise_scan(scan, source.name)
    )


def _salvage(source: Source, gaps: Iterable[FileGap], channels: Mapping[int, Channel]) -> SalvagedMessages:
    part = JoinedGaps(source, records.MAGIC, gaps)
    builder = ChunkTableBuilder(ChunkTable(), ProblemLog())
    known = {number: ChannelRecord(0, channel.topic, channel.message_encoding) for number, channel in channels.items()}
    scan_records(SourceReader(part), builder, known)
    builder.close()
    return SalvagedMessages(part, builder.table)


MCAP_CHUNKS = ChunkFormat(chunks.open_chunk, chunks.parse_messages, _salvage, chunks.read_message_index)
MCAP = Format(
    RecordingFormat.mcap,
    lambda head: head.data.startswith(records.MAGIC),
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


def _summarise(source: Source, *, most_bytes: int) -> RecordingSummary:
    return as_svo2(summarise_mcap(source, most_bytes=most_bytes))


SVO2 = Format(
    RecordingFormat.svo2,
    lambda head: head.data.startswith(MAGIC) and _LIBRARY_WORD in head.data[len(MAGIC) :][:_MCAP_HEADER_BYTES],
    "a recording of a ZED camera (SVO2)",
    extensions=(".svo2", ".mcap"),
    scan=lambda reader: as_svo2(scan_mcap(reader)),
    summarise=_summarise,
    refusal="it is a SVO2 of a ZED camera, and reading that format is not supported",
)
