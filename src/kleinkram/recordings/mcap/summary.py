"""The summary of an MCAP: by its index where that holds, else by a scan."""

from __future__ import annotations

from collections.abc import Mapping

from kleinkram.recordings.assemble import Measured, TopicType, bounded, measure
from kleinkram.recordings.errors import Malformed, NotIndexed
from kleinkram.recordings.limits import MAX_SCAN_BYTES
from kleinkram.recordings.mcap import records
from kleinkram.recordings.mcap.index import read_footer, read_index
from kleinkram.recordings.mcap.records import McapFacts
from kleinkram.recordings.mcap.scan import Scan, scan_mcap
from kleinkram.recordings.model import Content, Problem, RecordingFormat, RecordingSummary
from kleinkram.recordings.sources import Source
from kleinkram.recordings.stream import open_range
from kleinkram.recordings.timeline import Timeline

_HEAD_WINDOW = 4096


def summarise_mcap(source: Source) -> RecordingSummary:
    """Summarise a file that begins with the magic of MCAP.

    Raises:
        SourceError: as `Source.read`.
    """
    footer = read_footer(source)
    problems: list[Problem] = []
    if footer is not None:
        timeline = Timeline()
        try:
            facts = read_index(source, footer, timeline)
        except NotIndexed as refusal:
            if refusal.is_problem:
                problems.append(Problem(refusal.code, source.name, str(refusal)))
        else:
            _read_header(source, facts, problems)
            return _summary(Content.indexed, None, facts, timeline, problems)
    if source.size_bytes > MAX_SCAN_BYTES:
        reason = f"it has no usable index and is larger than {MAX_SCAN_BYTES // 2**30} GiB: it must be scanned first"
        return RecordingSummary(RecordingFormat.mcap, Content.pending, reason, problems=tuple(problems))
    timeline = Timeline()
    scan = scan_mcap(source, timeline)
    messages = sum(times.count for times in timeline.topics.values())
    why = _why_not_whole(scan, whole=footer is not None, messages=messages)
    problems += [Problem("damaged", fault.where, fault.message) for fault in scan.damage]
    claimed = scan.facts.statistics
    if claimed is not None and claimed.messages != messages and not problems:
        message = f"the statistics say {claimed.messages} messages, the file holds {messages}"
        problems.append(Problem("counts-disagree", source.name, message))
    content = _content(scan, why)
    return _summary(content, why, scan.facts, timeline, problems)


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


def _content(scan: Scan, why: str | None) -> Content:
    if why is None:
        return Content.indexed
    faults = [*scan.damage, *([scan.ended] if scan.ended else [])]
    return Content.pending if faults and not any(fault.certain for fault in faults) else Content.broken


def _why_not_whole(scan: Scan, *, whole: bool, messages: int) -> str | None:
    if scan.ended is not None:
        cut = "" if whole else "it has no footer, so it was cut or never closed: "
        cause = f"{cut}{scan.ended.message}, at {scan.ended.where}"
    elif scan.damage:
        first = scan.damage[0]
        more = f" (and {len(scan.damage) - 1} more damaged places)" if len(scan.damage) > 1 else ""
        cause = f"the {first.where} is damaged: {first.message}{more}"
    elif not whole:
        cause = "something else follows its footer"
    else:
        return None
    return f"{cause}; {messages} messages can be read"


def _summary(
    content: Content, reason: str | None, facts: McapFacts, timeline: Timeline, problems: list[Problem]
) -> RecordingSummary:
    for channel in facts.channels.values():
        timeline.topic(channel.topic)
    measured: Measured = measure(timeline, _topic_types(facts))
    return RecordingSummary(
        format=RecordingFormat.mcap,
        content=content,
        reason=reason,
        message_count=measured.message_count,
        start_ns=measured.start_ns,
        end_ns=measured.end_ns,
        compression=tuple(sorted(facts.compression)),
        topics=measured.topics,
        problems=bounded([*problems, *measured.problems]),
        library=facts.library,
        profile=facts.profile,
        attachments=facts.attachments,
        metadata_records=facts.metadata_records,
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
