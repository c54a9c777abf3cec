"""The summary of an MCAP: by its index where that holds, else by a scan."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace

from kleinkram.recordings.damage_report import Losses
from kleinkram.recordings.errors import Malformed, NotIndexed
from kleinkram.recordings.formats.mcap import records
from kleinkram.recordings.formats.mcap.index import read_footer, read_index
from kleinkram.recordings.formats.mcap.records import McapFacts, McapListener, Schema
from kleinkram.recordings.formats.mcap.scan import scan_records
from kleinkram.recordings.index_check import wrong_times
from kleinkram.recordings.model import Content, Depth, Problem, RecordingFormat, RecordingSummary, counted
from kleinkram.recordings.sources import Forward, Source, from_source
from kleinkram.recordings.streams import open_range
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

_HEAD_WINDOW = 4096
_NO_SCHEMA = Schema("", "")


def summarise_mcap(source: Source, *, most_bytes: int) -> RecordingSummary:
    """Summarise a file that begins with the magic of MCAP; scan it where that is impossible, if it has at most
    `most_bytes`.

    Raises:
        SourceError: as `Source.read`.
    """
    footer = read_footer(source)
    problems: list[Problem] = []
    why = "it was never closed, so it has no index"
    if footer is not None:
        timeline, losses = Timeline(), Losses()
        try:
            facts = read_index(source, footer, timeline, losses)
        except NotIndexed as refusal:
            why = str(refusal)
            if refusal.is_problem:
                problems.append(Problem(refusal.code, source.name, why))
        else:
            _read_header(source, facts, problems)
            return _by_index(facts, timeline, losses, problems)
    if source.size_bytes > most_bytes:
        return pending(RecordingFormat.mcap, source.size_bytes, why, problems)
    return scan_mcap(from_source(source), problems)


def scan_mcap(
    forward: Forward, problems: Sequence[Problem] = (), listener: McapListener | None = None
) -> RecordingSummary:
    """Read all of a file that begins with the magic of MCAP. `problems`: found before. `listener`: as `scan_records`.

    Raises:
        SourceError: as `Forward.read`.
    """
    scan = scan_records(forward, listener)
    found = scan.losses.problems()
    claimed, messages = scan.facts.statistics, scan.tally.messages
    if claimed is not None and claimed.messages != messages and not found:
        message = f"the statistics say {counted(claimed.messages, 'message')}, the file holds {messages}"
        found.append(Problem("counts-disagree", forward.name, message))
    if not scan.losses.damage:
        found += _wrong_statistics(scan.facts, scan.tally.timeline)
    found += scan.facts.index_faults.problems()
    found = found or [*problems]  # a scan says more exactly what is wrong with an index
    found += tell_lateness(scan.tally.lateness)
    summary = _judged(_summary(scan.facts, scan.tally.timeline, found), scan.facts, scan.losses, closed=scan.closed)
    return replace(summary, depth=Depth.scan)


def _by_index(facts: McapFacts, timeline: Timeline, losses: Losses, problems: list[Problem]) -> RecordingSummary:
    found = [*problems, *losses.problems(), *facts.index_faults.problems()]
    if not losses.damage:
        found += _wrong_statistics(facts, timeline)
    summary = _summary(facts, timeline, found)
    return _judged(summary, facts, losses, closed=True)


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


def _read_header(source: Source, facts: McapFacts, problems: list[Problem]) -> None:
    start = len(records.MAGIC)
    stream = open_range(source, start, source.size_bytes, window=_HEAD_WINDOW)
    try:
        opcode, length = records.RECORD_HEAD.unpack(stream.take(records.RECORD_HEAD.size))
        if opcode == records.HEADER:
            records.read_header(facts, stream.take(length), f"byte {start}")
        else:
            problems.append(Problem("header-damaged", f"byte {start}", "the first record is not a header"))
    except Malformed as error:
        problems.append(Problem("header-damaged", error.where, error.message))


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
    named = [
        (one.topic, facts.schemas.get(one.schema_id, _NO_SCHEMA).name, one.publisher) for one in facts.channels.values()
    ]
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
        schema = facts.schemas.get(channel.schema_id)
        kind = TopicType(schema.name if schema else "", schema.encoding if schema else "", channel.message_encoding)
        known = types.setdefault(channel.topic, [])
        if kind not in known:
            known.append(kind)
    return types
