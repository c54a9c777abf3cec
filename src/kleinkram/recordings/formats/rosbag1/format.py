"""The ROS 1 bag format, version 2.0: its index, its summary, and opening it for messages.

`read_index` reads connections, chunk infos and, on request, index data; it reads no chunk and decompresses nothing.
With index data, it reads their bytes and 64 bytes a chunk.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain

from kleinkram.recordings import file_summary
from kleinkram.recordings.chunk_reader import ChunkedMember, ChunkFormat, FileGap, SalvagedMessages
from kleinkram.recordings.chunk_scanner import ChunkIndex, count_by_index, open_by_scan, salvage_by_scan
from kleinkram.recordings.chunk_table import ChunkTableBuilder, Row
from kleinkram.recordings.damage_report import DamageReport, describe_readable
from kleinkram.recordings.errors import Cut, Malformed
from kleinkram.recordings.file_summary import TopicType
from kleinkram.recordings.formats.base import Format, MemberContents, OpenContext, RecordingFile
from kleinkram.recordings.formats.rosbag1 import chunks, records
from kleinkram.recordings.formats.rosbag1.chunks import BagFacts
from kleinkram.recordings.formats.rosbag1.records import Op
from kleinkram.recordings.formats.rosbag1.scan import BagScan, scan_bag_records
from kleinkram.recordings.limits import MAX_CHUNK_INDEX, MAX_TAKE, WINDOW
from kleinkram.recordings.messages import Channel
from kleinkram.recordings.model import Content, Depth, Problem, RecordingFormat, RecordingSummary, counted
from kleinkram.recordings.scanned_messages import LocationKind
from kleinkram.recordings.sources import SequentialReader, Source, SourceReader, read_short_ranges
from kleinkram.recordings.streams import ByteStream, open_bytes, open_range
from kleinkram.recordings.timeline import Timeline

_HEAD_WINDOW = 4096
_GUESSED_RATIO = 4


def read_index(source: Source, times: tuple[Timeline, DamageReport] | None = None) -> BagFacts:
    """Read the index section; `Malformed` if it is missing or contradicts itself.

    A chunk and its index data end where the next chunk begins; without index data, uncompressed sizes are guesses.
    `times`: receive the messages of all index data, and the chunks that cannot be read; None: no index data are read.
    """
    start = len(records.MAGIC)
    fields, _data_bytes = records.read_fields(open_range(source, start, source.size_bytes, window=_HEAD_WINDOW))
    if fields.opcode() != Op.BAG_HEADER:
        raise Malformed(f"byte {start}", "the first record is not a bag header")
    if fields.text("encryptor", ""):
        raise Malformed(f"byte {start}", "the bag is encrypted", certain=False)
    index_start = fields.u64("index_pos")
    if index_start == 0:
        raise Malformed(f"byte {start}", "the bag has no index: it was not closed by its recorder (index_pos is 0)")
    if not start < index_start <= source.size_bytes:
        where = f"byte {source.size_bytes}"
        raise Malformed(where, f"the file is cut: its index should begin at byte {index_start}, where it has ended")
    facts = BagFacts()
    stream = open_range(source, index_start, source.size_bytes)
    _read_index_section(stream, facts, fields.u32("conn_count") + fields.u32("chunk_count"))
    _locate_chunks(facts, index_start)
    if times is not None:
        count_by_index(facts, _chunk_indexes(source, facts, index_start), *times)
    return facts


def _read_index_section(stream: ByteStream, facts: BagFacts, left: int) -> None:
    """Read connections and chunk infos, `left` in number."""
    while left and not stream.at_end():
        where = f"byte {stream.position}"
        fields, data_bytes = records.read_fields(stream)
        if data_bytes > MAX_TAKE:
            raise Malformed(where, f"an index record of {data_bytes} bytes; at most {MAX_TAKE} are read", certain=False)
        data, opcode = stream.take(data_bytes), fields.opcode()
        if opcode == Op.CONNECTION:
            facts.define(*records.read_connection(fields, data, where), where)
        elif opcode == Op.CHUNK_INFO:
            info = records.read_chunk_info(fields, data, where)
            for number, count in info.counts.items():
                facts.counts[number] += count
            location = info.position, 0, info.position, info.first_ns, info.last_ns
            members, messages = facts.table.sets.number(info.counts), sum(info.counts.values())
            facts.table.rows.append(Row(*location, LocationKind.chunk, members, 0, messages=messages))
        else:
            raise Malformed(where, f"a record of type {opcode} in the index")
        left -= 1
    if left:
        missing = counted(left, "record is", "records are")
        raise Malformed(f"byte {stream.position}", f"the file is cut within its index: {missing} missing")
    if not stream.at_end():
        raise Malformed(f"byte {stream.position}", "the index continues after the records that the bag header counts")


def _locate_chunks(facts: BagFacts, index_start: int) -> None:
    """Sort the chunks and set their ends."""
    rows = facts.table.rows
    rows.sort()
    starts = rows.column("start")
    ends = [*starts[1:], index_start] if starts else []
    for number, (start, end) in enumerate(zip(starts, ends, strict=True)):
        if not len(records.MAGIC) <= start < end <= index_start:
            raise Malformed(f"byte {start}", "the index lists chunks that overlap, or lie outside the file")
        size = end - start
        rows.replace(number, rows[number]._replace(length=size, end=end, uncompressed_bytes=_GUESSED_RATIO * size))
    if not facts.counts.keys() <= facts.channels.keys():
        raise Malformed("index", "it lists chunks of connections that it does not define")


def _chunk_indexes(source: Source, facts: BagFacts, index_start: int) -> Iterator[ChunkIndex]:
    """Yield the index data of each chunk.

    The size of the index data of a chunk follows from its chunk info. So one read fetches them together with the next
    chunk's header; where a writer does otherwise, the offset of the index data follows from the header.
    """
    rows = facts.table.rows
    if not len(rows):
        return
    first_head = (rows[0].start, min(records.CHUNK_HEAD_BYTES, index_start - rows[0].start))
    reads = ((start, stop - start) for start, stop in _plan_reads(facts, index_start))
    answers = read_short_ranges(source, chain([first_head], reads))
    head_bytes = next(answers)
    for row, (start, _stop), answer in zip(rows, _plan_reads(facts, index_start), answers, strict=True):
        try:
            head = records.open_chunk(open_bytes(head_bytes, row.start))
        except Cut:
            head = records.open_chunk(open_range(source, row.start, source.size_bytes, window=_HEAD_WINDOW))
        facts.compression.add(head.compression or "none")
        data_at = row.start + head.record_bytes
        if data_at > row.end:
            raise Malformed(f"byte {row.start}", "a chunk reaches into the next one, or into the index")
        if row.end - data_at > MAX_CHUNK_INDEX:
            raise Malformed(f"byte {data_at}", "the index of a chunk is too large to be read", certain=False)
        is_at_hand = data_at == start
        stream = open_bytes(answer[: row.end - start], start) if is_at_hand else open_range(source, data_at, row.end)
        yield ChunkIndex(row, head, _defined_entries(stream, facts))
        head_bytes = answer[row.end - start :]


def _plan_reads(facts: BagFacts, index_start: int) -> Iterator[tuple[int, int]]:
    """Yield for each chunk what to read: its index data and the header of the next chunk."""
    for row in facts.table.rows:
        connections = facts.table.sets.listed(row.channels) or ()
        size = min(records.index_data_bytes(len(connections), row.messages), row.length)
        stop = min(row.end + records.CHUNK_HEAD_BYTES, index_start)
        yield row.end - size if size <= WINDOW else row.end, stop


def _defined_entries(stream: ByteStream, facts: BagFacts) -> Iterator[tuple[int, list[int], array[int]]]:
    while not stream.at_end():
        where = f"byte {stream.position}"
        entry = records.read_index_data(stream)
        if entry[0] not in facts.channels:
            raise Malformed(where, f"index data of connection {entry[0]}, which the bag does not define")
        yield entry


def summarise_bag(source: Source, max_bytes: int) -> RecordingSummary:
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


BAG_CHUNKS = ChunkFormat(chunks.parse_messages, records.open_chunk, _salvage, chunks.read_message_index)
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
