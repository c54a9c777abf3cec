"""The index of a ROS 1 bag 2.0: connections, chunk infos and, on request, index data.

Reads no chunk and decompresses nothing: the index section, and with index data their bytes and 64 bytes a chunk.
"""

from __future__ import annotations

from array import array
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import chain

from kleinkram.recordings.chunk_table import UNKNOWN, ChunkTable, Row, smallest_to_come
from kleinkram.recordings.compression import unreadable_chunk
from kleinkram.recordings.damage_report import DamageReport
from kleinkram.recordings.errors import Cut, Malformed
from kleinkram.recordings.formats.rosbag1 import records
from kleinkram.recordings.formats.rosbag1.chunks import BagFacts
from kleinkram.recordings.formats.rosbag1.records import Op
from kleinkram.recordings.index_check import ChunkClaim, ChunkMessages, IndexFaults
from kleinkram.recordings.limits import MAX_CHUNK_INDEX, MAX_TAKE, WINDOW
from kleinkram.recordings.message_counts import PlaceKind
from kleinkram.recordings.model import counted
from kleinkram.recordings.sources import Source, read_short_ranges
from kleinkram.recordings.streams import ByteStream, open_bytes, open_range
from kleinkram.recordings.timeline import ChunkEntries, Timeline

_HEAD_WINDOW = 4096
_GUESSED_RATIO = 4


@dataclass
class BagIndex:
    """What the index section of a bag says.

    Attributes:
        table: chunks; a chunk and its index data end where the next chunk begins. Uncompressed sizes are guesses.
        counts: messages by connection.
        index_faults: what the index says of chunks that is not so; filled by `read_index_data`.
        compression: filled by `read_index_data`.
    """

    index_start: int
    facts: BagFacts = field(default_factory=BagFacts)
    table: ChunkTable = field(default_factory=ChunkTable)
    counts: dict[int, int] = field(default_factory=lambda: defaultdict(int))
    compression: set[str] = field(default_factory=set)
    index_faults: IndexFaults = field(default_factory=IndexFaults)


def read_index(source: Source) -> BagIndex:
    """Read the index section.

    Raises:
        Malformed: there is none, or it cannot be true.
        SourceError: as `Source.read`.
    """
    index_start, connections, chunks = _read_bag_header(source)
    index = BagIndex(index_start)
    _read_index_section(open_range(source, index_start, source.size_bytes), index, connections + chunks)
    _place_chunks(index)
    return index


def _read_bag_header(source: Source) -> tuple[int, int, int]:
    """Return where the index begins, and how many connections and chunks it lists."""
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
    return index_start, fields.u32("conn_count"), fields.u32("chunk_count")


def _read_index_section(stream: ByteStream, index: BagIndex, left: int) -> None:
    """Read connections and chunk infos, `left` in number."""
    while left and not stream.at_end():
        where = f"byte {stream.position}"
        fields, data_bytes = records.read_fields(stream)
        if data_bytes > MAX_TAKE:
            raise Malformed(where, f"an index record of {data_bytes} bytes; at most {MAX_TAKE} are read", certain=False)
        data, opcode = stream.take(data_bytes), fields.opcode()
        if opcode == Op.CONNECTION:
            index.facts.define(*records.read_connection(fields, data, where), where)
        elif opcode == Op.CHUNK_INFO:
            _read_chunk_info(index, fields, data, where)
        else:
            raise Malformed(where, f"a record of type {opcode} in the index")
        left -= 1
    if left:
        missing = counted(left, "record is", "records are")
        raise Malformed(f"byte {stream.position}", f"the file is cut within its index: {missing} missing")
    if not stream.at_end():
        raise Malformed(f"byte {stream.position}", "the index continues after the records that the bag header counts")


def _read_chunk_info(index: BagIndex, fields: records.Fields, data: bytes, where: str) -> None:
    info = records.read_chunk_info(fields, data, where)
    for number, count in info.counts.items():
        index.counts[number] += count
    members, start = index.table.sets.number(info.counts), info.position
    index.table.rows.append(
        Row(
            start,
            0,
            start,
            info.first_ns,
            info.last_ns,
            PlaceKind.chunk,
            members,
            0,
            messages=sum(info.counts.values()),
        )
    )


def _place_chunks(index: BagIndex) -> None:
    """Sort the chunks and set their ends."""
    rows = index.table.rows
    rows.sort()
    starts = rows.column(0)
    ends = [*starts[1:], index.index_start] if starts else []
    for number, (start, end) in enumerate(zip(starts, ends, strict=True)):
        if not len(records.MAGIC) <= start < end <= index.index_start:
            raise Malformed(f"byte {start}", "the index lists chunks that overlap, or lie outside the file")
        size = end - start
        rows.replace(number, rows[number]._replace(length=size, end=end, uncompressed_bytes=_GUESSED_RATIO * size))
    if not index.counts.keys() <= index.facts.connections.keys():
        raise Malformed("index", "it lists chunks of connections that it does not define")


def read_index_data(source: Source, index: BagIndex, timeline: Timeline, losses: DamageReport) -> None:
    """Count the messages of all index data, and the chunks that cannot be read.

    Raises:
        Malformed: index data are damaged.
        SourceError: as `Source.read`.
    """
    for connection in index.facts.connections.values():
        timeline.topic(connection.topic)
    watermarks = smallest_to_come(index.table.rows.column(Row._fields.index("first_ns")))
    for (row, head, stream), before_ns in zip(_chunk_streams(source, index), watermarks, strict=True):
        index.compression.add(head.compression)
        entries = _read_chunk_entries(stream, index, row)
        stored, uncompressed = head.data_start + head.data_bytes, head.uncompressed_bytes
        if why := unreadable_chunk(head.compression, stored=stored, uncompressed=uncompressed):
            losses.skip_chunk(row.start, stored, sum(len(entry.stamps) for entry in entries), why)
        else:
            timeline.add_chunk(entries, uncompressed_bytes=uncompressed, stored_bytes=head.data_bytes)
        timeline.settle(before_ns)


def _chunk_streams(source: Source, index: BagIndex) -> Iterator[tuple[Row, records.BagChunkHead, ByteStream]]:
    """Yield each chunk with its header and its index data.

    The size of the index data of a chunk follows from its chunk info. So one read fetches them together with the next
    chunk's header; where a writer does otherwise, the header says where they are.
    """
    rows = index.table.rows
    if not len(rows):
        return
    first_head = (rows[0].start, min(records.CHUNK_HEAD_BYTES, index.index_start - rows[0].start))
    reads = ((start, stop - start) for start, stop in _plan_reads(index))
    answers = read_short_ranges(source, chain([first_head], reads))
    head_bytes = next(answers)
    for row, (start, _stop), answer in zip(rows, _plan_reads(index), answers, strict=True):
        head = _parse_head(source, row.start, head_bytes)
        index_start = row.start + head.data_start + head.data_bytes
        if index_start > row.end:
            raise Malformed(f"byte {row.start}", "a chunk reaches into the next one, or into the index")
        if row.end - index_start > MAX_CHUNK_INDEX:
            raise Malformed(f"byte {index_start}", "the index of a chunk is too large to be read", certain=False)
        if index_start == start:
            yield row, head, open_bytes(answer[: row.end - start], start)
        else:
            yield row, head, open_range(source, index_start, row.end)
        head_bytes = answer[row.end - start :]


def _plan_reads(index: BagIndex) -> Iterator[tuple[int, int]]:
    """Yield for each chunk what to read: its index data and the header of the next chunk."""
    for row in index.table.rows:
        connections = index.table.sets.listed(row.channels) or ()
        size = min(records.index_data_bytes(len(connections), row.messages), row.length)
        stop = min(row.end + records.CHUNK_HEAD_BYTES, index.index_start)
        yield row.end - size if size <= WINDOW else row.end, stop


def _parse_head(source: Source, position: int, head_bytes: bytes) -> records.BagChunkHead:
    try:
        return records.read_chunk_head(open_bytes(head_bytes, position))
    except Cut:
        return records.read_chunk_head(open_range(source, position, source.size_bytes, window=_HEAD_WINDOW))


def _read_chunk_entries(stream: ByteStream, index: BagIndex, row: Row) -> list[ChunkEntries]:
    by_topic: dict[str, ChunkEntries] = {}
    messages = ChunkMessages()
    while not stream.at_end():
        where = f"byte {stream.position}"
        number, stamps, offsets = records.read_index_data(stream)
        connection = index.facts.connections.get(number)
        if connection is None:
            raise Malformed(where, f"index data of connection {number}, which the bag does not define")
        messages.add_index(number, stamps)
        known = by_topic.get(connection.topic)
        if known is not None:
            stamps, offsets = [*known.stamps, *stamps], array("I", known.offsets) + offsets
        by_topic[connection.topic] = ChunkEntries(connection.topic, stamps, offsets)
    claim = ChunkClaim(row.start, UNKNOWN, row.first_ns, row.last_ns, row.channels, row.messages)
    index.index_faults.compare(claim, index.table.sets.listed(row.channels), messages)
    return list(by_topic.values())
