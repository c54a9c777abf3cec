"""The MCAP format (and SVO2, which is an MCAP): its index, its summary, and opening it for messages.

`read_index` reads footer, summary section and, on request, message indexes; it reads no chunk and decompresses nothing.
Where the index cannot be used, or contradicts itself, it raises `NotIndexed`, and the file must be scanned.
"""

from __future__ import annotations

import heapq
import re
import zlib
from array import array
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain

from kleinkram.recordings import file_summary
from kleinkram.recordings.chunk_index_check import wrong_compression, wrong_times
from kleinkram.recordings.chunk_reader import ChunkedMember, ChunkFormat, FileGap, SalvagedMessages
from kleinkram.recordings.chunk_scanner import ChunkIndex, count_by_index, open_by_scan, salvage_by_scan
from kleinkram.recordings.chunk_table import ANY_CHANNEL, ChunkHead, ChunkTableBuilder
from kleinkram.recordings.compression import is_known_compression
from kleinkram.recordings.damage_report import DamageReport
from kleinkram.recordings.errors import Malformed, NotIndexed
from kleinkram.recordings.file_summary import TopicType
from kleinkram.recordings.formats.base import Format, MemberContents, OpenContext, RecordingFile
from kleinkram.recordings.formats.mcap import chunks, records
from kleinkram.recordings.formats.mcap.chunks import open_chunk
from kleinkram.recordings.formats.mcap.other_records import find_other_records
from kleinkram.recordings.formats.mcap.records import MAGIC, ChannelRecord, McapFacts, Opcode
from kleinkram.recordings.formats.mcap.scan import McapScan, scan_records
from kleinkram.recordings.limits import MAX_CHUNK_INDEX, MAX_TAKE, TAIL, WINDOW
from kleinkram.recordings.messages import Channel
from kleinkram.recordings.model import Depth, Fact, Problem, RecordingFormat, RecordingSummary, counted
from kleinkram.recordings.sources import SequentialReader, Source, SourceReader, read_short_ranges
from kleinkram.recordings.streams import ByteStream, open_bytes, open_range
from kleinkram.recordings.timeline import Timeline

_HEAD_BYTES = 4096
_MAX_RECORDS_WALKED = 1_000
_READERS = {
    Opcode.CHUNK_INDEX: records.read_chunk_index,
    Opcode.STATISTICS: records.read_statistics,
    Opcode.ATTACHMENT_INDEX: records.read_attachment_index,
    Opcode.METADATA_INDEX: records.read_metadata_index,
    Opcode.SCHEMA: records.read_schema,
    Opcode.CHANNEL: records.read_channel,
}


def read_index(source: Source, times: tuple[Timeline, DamageReport] | None = None) -> McapFacts:
    """Read the index; `NotIndexed` if it is missing or contradicts itself.

    `times`: receive the messages of all message indexes, and the chunks that cannot be read; None: no message index is
    read.
    """
    known = _KnownEnds(source)
    facts = McapFacts()
    try:
        summary_start = _read_summary_section(known, facts)
        _read_header(known, facts)
        _check_definitions(facts)
        _check_offsets(facts, summary_start)
        _check_compressions(source, facts)
        if times is not None:
            for start, size in _index_ranges(facts):
                if size > MAX_CHUNK_INDEX:
                    raise Malformed(f"byte {start}", "the index of a chunk is too large to be read", certain=False)
            count_by_index(facts, _message_indexes(source, facts), *times)
        if times is None or facts.statistics is None:
            _check_space_between_chunks(known, facts, summary_start)
    except Malformed as error:
        raise NotIndexed("index-damaged", f"the index cannot be used: {error}", is_problem=True) from error
    if times is None:
        _check_table(facts)
    else:
        _compare_with_statistics(facts, *times)
    return facts


class _KnownEnds:
    """A source whose first and last bytes are read at most once."""

    def __init__(self, source: Source) -> None:
        self.source = source
        self.tail_start = max(0, source.size_bytes - TAIL)
        self.tail = source.read(self.tail_start, source.size_bytes - self.tail_start)
        self._head = b""

    def read(self, offset: int, length: int) -> bytes:
        if offset >= self.tail_start:
            return self.tail[offset - self.tail_start :][:length]
        if offset + length > _HEAD_BYTES:
            return self.source.read(offset, min(length, self.source.size_bytes - offset))
        if not self._head:
            self._head = self.source.read(0, min(_HEAD_BYTES, self.source.size_bytes))
        return self._head[offset : offset + length]


def _read_summary_section(known: _KnownEnds, facts: McapFacts) -> int:
    """Read the records between data section and footer; return where they begin."""
    tail, tail_start = known.tail, known.tail_start
    footer_at = len(tail) - records.FOOTER_BYTES
    footer_head = records.RECORD_HEAD.pack(Opcode.FOOTER, records.FOOTER_BODY.size)
    if (
        footer_at < len(records.MAGIC)
        or not tail.endswith(records.MAGIC)
        or not tail.startswith(footer_head, footer_at)
    ):
        raise NotIndexed("no-footer", "it was never closed, so it has no index", is_problem=False)
    summary_start: int
    summary_start, _offsets_start, crc = records.FOOTER_BODY.unpack_from(tail, footer_at + records.RECORD_HEAD.size)
    footer_start = tail_start + footer_at
    if summary_start == 0:
        raise NotIndexed("no-summary", "the file has no summary section", is_problem=False)
    if not len(records.MAGIC) < summary_start <= footer_start:
        raise Malformed(f"byte {footer_start}", f"the footer places the summary at byte {summary_start}")
    if summary_start >= tail_start:
        stream = open_bytes(tail[summary_start - tail_start : footer_at], summary_start)
    else:
        stream = open_range(known.source, summary_start, footer_start)
    if crc:
        stream.start_crc()
    while not stream.at_end():
        where = f"byte {stream.position}"
        opcode, length = records.RECORD_HEAD.unpack(stream.take(records.RECORD_HEAD.size))
        if opcode in _READERS:
            is_definition = opcode in (Opcode.SCHEMA, Opcode.CHANNEL)
            body = stream.take(min(length, MAX_TAKE) if is_definition else length)
            _READERS[opcode](facts, body, where)
            length -= len(body)
        stream.skip(length)
    footer_without_crc = tail[footer_at : footer_at + records.RECORD_HEAD.size + records.FOOTER_BODY.size - 4]
    if crc and zlib.crc32(footer_without_crc, stream.crc) != crc:
        raise Malformed(f"byte {summary_start}", "the checksum of the summary section is wrong")
    return summary_start


def _read_header(known: _KnownEnds, facts: McapFacts) -> None:
    """Read profile and library; a damaged header does not invalidate the index."""
    start = len(records.MAGIC)
    stream = open_bytes(known.read(start, _HEAD_BYTES - start), start)
    try:
        opcode, length = records.RECORD_HEAD.unpack(stream.take(records.RECORD_HEAD.size))
        if opcode != Opcode.HEADER:
            facts.header_damage = Malformed(f"byte {start}", "the first record is not a header")
            return
        if length > _HEAD_BYTES - start - records.RECORD_HEAD.size:
            stream = open_range(known.source, stream.position, known.source.size_bytes, window=2 * _HEAD_BYTES)
        records.read_header(facts, stream.take(length), f"byte {start}")
    except Malformed as error:
        facts.header_damage = error


def _check_definitions(facts: McapFacts) -> None:
    statistics = facts.statistics
    if statistics is not None:
        facts.attachments, facts.metadata_records = statistics.attachments, statistics.metadata_records
        if len(facts.channels) < statistics.channels:
            raise NotIndexed("no-channels", "the summary does not list all channels", is_problem=False)
    if any(c.schema_id and c.schema_id not in facts.schemas for c in facts.channels.values()):
        raise NotIndexed("no-schemas", "the summary does not list all schemas", is_problem=False)
    if len(facts.table.rows) == 0 and (statistics is None or statistics.messages):
        raise NotIndexed("no-chunk-index", "the file has no chunk index", is_problem=False)


def _check_offsets(facts: McapFacts, summary_start: int) -> None:
    facts.table.rows.sort()
    end = len(records.MAGIC)
    for row in facts.table.rows:
        if row.start < end or row.length < records.RECORD_HEAD.size:
            raise Malformed(f"byte {row.start}", "the chunk index lists chunks that overlap")
        if row.end > summary_start:
            raise Malformed(f"byte {row.start}", "the chunk index points past the data")
        end = row.end


def _check_compressions(source: Source, facts: McapFacts) -> None:
    """Keep those unknown compressions that the chunks themselves confirm."""
    for row in facts.table.rows if facts.unknown_compression else ():
        named = facts.unknown_compression.get(row.start)
        if named is None:
            continue
        try:
            compression = open_chunk(open_range(source, row.start, row.end, window=_HEAD_BYTES)).compression
        except Malformed:
            continue  # there is no chunk with another compression
        if is_known_compression(compression):
            facts.index_faults.note(row.start, wrong_compression(named))
            del facts.unknown_compression[row.start]
        else:
            facts.unknown_compression[row.start] = compression


def _index_ranges(facts: McapFacts) -> Iterator[tuple[int, int]]:
    """Yield where the message indexes of each chunk begin, and their size."""
    starts, lengths, ends = map(facts.table.rows.column, ("start", "length", "end"))
    return ((start + length, end - start - length) for start, length, end in zip(starts, lengths, ends, strict=True))


def _message_indexes(source: Source, facts: McapFacts) -> Iterator[ChunkIndex]:
    """Yield the message indexes of each chunk; over a network, the next ones are requested in advance."""
    ranges = _index_ranges(facts)
    if any(size > WINDOW for _, size in _index_ranges(facts)):
        streams = (open_range(source, start, start + size) for start, size in ranges)
    else:
        answers = read_short_ranges(source, _index_ranges(facts))
        streams = (open_bytes(data, start) for (start, _), data in zip(ranges, answers, strict=True))
    for row, stream in zip(facts.table.rows, streams, strict=True):
        compression, stored = facts.unknown_compression.get(row.start, ""), row.stored_bytes
        head = ChunkHead(compression, row.uncompressed_bytes, 0, row.length - stored, stored)
        yield ChunkIndex(row, head, _defined_entries(stream, facts))


def _defined_entries(stream: ByteStream, facts: McapFacts) -> Iterator[tuple[int, array[int], array[int]]]:
    for entry in records.read_message_indexes(stream):
        if entry[0] not in facts.channels:
            raise NotIndexed("no-channels", f"the summary does not list channel {entry[0]}", is_problem=False)
        yield entry


def _compare_with_statistics(facts: McapFacts, timeline: Timeline, losses: DamageReport) -> None:
    """Refuse an index that does not list all messages."""
    listed = sum(times.count for times in timeline.topics.values()) + losses.messages
    if facts.statistics is None:
        if any(row.uncompressed_bytes and row.start + row.length == row.end for row in facts.table.rows):
            raise NotIndexed("no-message-index", "the file has chunks without message index", is_problem=False)
    elif listed == 0 and facts.statistics.messages:
        raise NotIndexed("no-message-index", "the file has no message index", is_problem=False)
    elif listed != facts.statistics.messages:
        claimed = facts.statistics.messages
        message = f"the statistics say {counted(claimed, 'message')}, the index lists {listed}"
        raise NotIndexed("counts-disagree", message, is_problem=True)


def _check_table(facts: McapFacts) -> None:
    """Refuse a chunk index that omits chunks or channels, which no message count would show."""
    rows, statistics = facts.table.rows, facts.statistics
    if statistics is not None and len(rows) != statistics.chunks:
        message = f"the statistics say {counted(statistics.chunks, 'chunk')}, the index lists {len(rows)}"
        raise NotIndexed("counts-disagree", message, is_problem=True)
    if statistics is None and ANY_CHANNEL in rows.column("channels"):
        raise NotIndexed("no-message-index", "the file has chunks without message index", is_problem=False)
    if not facts.table.known_channels() <= facts.channels.keys():
        raise NotIndexed("no-channels", "the summary does not list all channels", is_problem=False)


def _check_space_between_chunks(known: _KnownEnds, facts: McapFacts, summary_start: int) -> None:
    """Refuse an index that omits messages or chunks, by the records that it does not cover."""
    position, left = len(records.MAGIC), _MAX_RECORDS_WALKED
    covered = ((row.start, row.end) for row in facts.table.rows)
    for start, end in chain(heapq.merge(covered, sorted(facts.outside_chunks)), [(summary_start, summary_start)]):
        while position < start:
            head = open_bytes(known.read(position, records.RECORD_HEAD.size), position)
            opcode, length = records.RECORD_HEAD.unpack(head.take(records.RECORD_HEAD.size))
            left -= 1
            if opcode in (Opcode.MESSAGE, Opcode.CHUNK) or left == 0:
                raise NotIndexed("no-chunk-index", "the index does not list all messages", is_problem=False)
            position += records.RECORD_HEAD.size + length
        position = max(position, end)


def summarise_mcap(source: Source, max_bytes: int) -> RecordingSummary:
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
    spans = [span for times in timeline.topics.values() for span in times.spans]
    if claimed is None or not spans:
        return []
    problems = []
    first_and_last = min(span.first_ns for span in spans), max(span.last_ns for span in spans)
    if wrong := wrong_times((claimed.start_ns, claimed.end_ns), first_and_last):
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
        if refusal.code == "no-footer":
            problem_log.add("no-footer", source.name, str(refusal))
        elif refusal.is_problem:
            problem_log.add(refusal.code, source.name, str(refusal))
        builder = ChunkTableBuilder(problem_log)
        scan = scan_records(SourceReader(source), builder)
        channels, summary = scan.facts.resolve_channels(message_compression), summarise_scan(scan, source.name)
        return open_by_scan(source, builder, MCAP_CHUNKS, channels, summary)
    channels = facts.resolve_channels(message_compression)
    statistics = facts.statistics
    if statistics is None or facts.unknown_compression:
        # The statistics also count messages that cannot be read.
        start_ns, end_ns = facts.table.span(without=facts.unknown_compression.keys())
        contents = MemberContents(channels, None, None, start_ns, end_ns, facts.profile)
        return ChunkedMember(source, MCAP_CHUNKS, facts.table, contents, problem_log, with_index_check=True)
    by_channel = dict(statistics.counts)
    counts = by_channel if sum(by_channel.values()) == statistics.messages else None
    span = (statistics.start_ns, statistics.end_ns) if statistics.messages else (None, None)
    contents = MemberContents(channels, counts, statistics.messages, span[0], span[1], facts.profile)
    return ChunkedMember(
        source, MCAP_CHUNKS, facts.table, contents, problem_log, with_index_check=True, claimed_span=span
    )


def _salvage(source: Source, gaps: Iterable[FileGap], channels: Mapping[int, Channel]) -> SalvagedMessages:
    known = {number: ChannelRecord(0, channel.topic, channel.message_encoding) for number, channel in channels.items()}
    return salvage_by_scan(source, gaps, MAGIC, lambda reader, builder: scan_records(reader, builder, known))


MCAP_CHUNKS = ChunkFormat(
    chunks.parse_messages, chunks.open_chunk, _salvage, chunks.read_message_index, find_other_records
)
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
    summarise=lambda source, max_bytes: as_svo2(summarise_mcap(source, max_bytes)),
    refusal="it is an SVO2 of a ZED camera, and reading that format is not supported",
)
