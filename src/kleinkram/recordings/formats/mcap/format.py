"""MCAP: summary by index, scan, and messages."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from kleinkram.recordings.chunk_reader import ChunkFormat, ChunkTableBuilder, Gap, Part, Saved
from kleinkram.recordings.chunk_table import ChunkTable
from kleinkram.recordings.damage_report import Losses, Noticed
from kleinkram.recordings.errors import NotIndexed
from kleinkram.recordings.formats.base import Format, OpenContext, RecordingFile
from kleinkram.recordings.formats.mcap import chunks, records
from kleinkram.recordings.formats.mcap.index import read_index
from kleinkram.recordings.formats.mcap.records import ChannelRecord, McapFacts
from kleinkram.recordings.formats.mcap.scan import Scan, scan_records
from kleinkram.recordings.index_check import wrong_times
from kleinkram.recordings.member import ChunkedMember, Contents, check_cost
from kleinkram.recordings.messages import Channel
from kleinkram.recordings.model import Content, Depth, Problem, RecordingFormat, RecordingSummary, counted
from kleinkram.recordings.sources import Forward, Source, SourceForward, from_source
from kleinkram.recordings.timeline import Timeline
from kleinkram.recordings.topic_statistics import (
    Measured,
    TopicType,
    bounded,
    gathered,
    measure,
    pending,
    tell_damage,
    tell_doubled,
    tell_lateness,
    tell_readable,
)


def summarise_mcap(source: Source, *, most_bytes: int) -> RecordingSummary:
    """Summarise a file that begins with the magic of MCAP; scan it where that is impossible, if it has at most
    `most_bytes`.

    Raises:
        SourceError: as `Source.read`.
    """
    timeline, losses = Timeline(), Losses()
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
    return scan_mcap(from_source(source), problems)


def scan_mcap(forward: Forward, problems: Sequence[Problem] = ()) -> RecordingSummary:
    """Read all of a file that begins with the magic of MCAP. `problems`: found before.

    Raises:
        SourceError: as `Forward.read`.
    """
    return summarise_scan(scan_records(forward), forward.name, problems)


def summarise_scan(scan: Scan, name: str, problems: Sequence[Problem] = ()) -> RecordingSummary:
    """Return the summary of a file that was scanned. `problems`: found before."""
    found = scan.losses.problems()
    claimed, messages = scan.facts.statistics, scan.tally.messages
    if claimed is not None and claimed.messages != messages and not found:
        message = f"the statistics say {counted(claimed.messages, 'message')}, the file holds {messages}"
        found.append(Problem("counts-disagree", name, message))
    if not scan.losses.damage:
        found += _wrong_statistics(scan.facts, scan.tally.timeline)
    found += scan.facts.index_faults.problems()
    found = found or [*problems]  # a scan says more exactly what is wrong with an index
    found += tell_lateness(scan.tally.lateness)
    summary = _judged(_summary(scan.facts, scan.tally.timeline, found), scan.facts, scan.losses, closed=scan.closed)
    return replace(summary, depth=Depth.scan)


def _by_index(facts: McapFacts, timeline: Timeline, losses: Losses) -> RecordingSummary:
    damage = facts.header_damage
    found = [Problem("header-damaged", damage.where, damage.message)] if damage is not None else []
    found += [*losses.problems(), *facts.index_faults.problems()]
    if not losses.damage:
        found += _wrong_statistics(facts, timeline)
    return _judged(_summary(facts, timeline, found), facts, losses, closed=True)


def _wrong_statistics(facts: McapFacts, timeline: Timeline) -> list[Problem]:
    """Say where the statistics differ from the messages of a file that is whole."""
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
        found = timeline.topics[topic].count if topic in timeline.topics else 0
        if found != count:
            problems.append(
                Problem("counts-disagree", topic, f"the statistics say {counted(count, 'message')}, there are {found}")
            )
    return gathered(problems)


def _judged(summary: RecordingSummary, facts: McapFacts, losses: Losses, *, closed: bool) -> RecordingSummary:
    """Add how far a file can be read, and what is lost of it."""
    messages = summary.message_count or 0
    content = _content(
        losses, closed=closed, holds_anything=bool(messages or facts.attachments or facts.metadata_records)
    )
    if content is Content.indexed:
        return replace(summary, content=content)
    stated = facts.statistics.messages if facts.statistics is not None and not losses.index_faults else None
    lost = losses.total(claimed=stated, found=messages)
    reason = f"{_what_is_wrong(losses, closed=closed)}; {tell_readable(messages, lost)}"
    return replace(summary, content=content, reason=reason, lost=lost)


def _content(losses: Losses, *, closed: bool, holds_anything: bool) -> Content:
    if closed and not losses.damage:
        return Content.indexed
    if holds_anything:
        return Content.recovered
    return Content.broken if any(fault.certain for fault in losses.damage) or not losses.damage else Content.opaque


def _what_is_wrong(losses: Losses, *, closed: bool) -> str:
    never_closed = "" if closed else "it has no footer, so it was cut or never closed"
    if not losses.damage:
        return never_closed
    damage = f"damaged {tell_damage(losses.damage)}"
    if losses.unproven:
        saved = counted(losses.unproven, "message was", "messages were")
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
        problems=bounded([*problems, *tell_doubled(named), *measured.problems]),
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
    """Open an MCAP by its index; one without is scanned once, and what is broken in it is noted.

    Raises:
        TooCostly: it would have to be read whole, and has more bytes than may be read.
        SourceError: as `Source.read`.
    """
    source, noticed, message_compression = file.source, context.noticed, context.message_compression
    try:
        facts = read_index(source)
    except NotIndexed as refusal:
        check_cost(source, context.limit_of(source), str(refusal))
        if refusal.is_problem or refusal.code == "no-footer":
            noticed.add(refusal.code, source.name, str(refusal))
        return _open_scanned(source, noticed, message_compression)
    channels = facts.resolve_channels(message_compression)
    statistics = facts.statistics
    if statistics is None or facts.unknown_compression:
        # The statistics also count messages that cannot be read.
        contents = Contents(channels, None, None, *facts.table.span(without=facts.unknown_compression.keys()))
        return ChunkedMember(source, MCAP_CHUNKS, facts.table, contents, noticed, with_index_check=True)
    by_channel = dict(statistics.counts)
    counts = by_channel if sum(by_channel.values()) == statistics.messages else None
    span = (statistics.start_ns, statistics.end_ns) if statistics.messages else (None, None)
    contents = Contents(channels, counts, statistics.messages, *span)
    return ChunkedMember(source, MCAP_CHUNKS, facts.table, contents, noticed, with_index_check=True, claimed_span=span)


def _open_scanned(source: Source, noticed: Noticed, message_compression: str) -> ChunkedMember:
    builder = ChunkTableBuilder(ChunkTable(), noticed)
    scan = scan_records(SourceForward(source), builder)
    builder.close()
    channels = scan.facts.resolve_channels(message_compression)
    counts = {number: count for number, count in builder.counts.items() if number in channels}
    span = builder.table.span() if counts else (None, None)
    contents = Contents(channels, counts, sum(counts.values()), *span)
    return ChunkedMember(
        source, MCAP_CHUNKS, builder.table, contents, noticed, summary=summarise_scan(scan, source.name)
    )


def _salvage(source: Source, gaps: Iterable[Gap], channels: Mapping[int, Channel]) -> Saved:
    part = Part(source, records.MAGIC, gaps)
    builder = ChunkTableBuilder(ChunkTable(), Noticed())
    known = {number: ChannelRecord(0, channel.topic, channel.message_encoding) for number, channel in channels.items()}
    scan_records(SourceForward(part), builder, known)
    builder.close()
    return Saved(part, builder.table)


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
