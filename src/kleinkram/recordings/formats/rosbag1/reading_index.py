"""What reading a ROS 1 bag needs to know: connections, and where its chunks are; by its index, or by reading it all.

The index section is read once; no index data of any chunk is.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field

from kleinkram.recordings.chunk_reader import Gathering
from kleinkram.recordings.chunk_table import ChunkTable, Row
from kleinkram.recordings.damage_report import Noticed
from kleinkram.recordings.errors import Malformed, NotIndexed
from kleinkram.recordings.formats.mcap.reading_index import MAX_DEFINITIONS
from kleinkram.recordings.formats.rosbag1 import records
from kleinkram.recordings.formats.rosbag1.chunks import read_connection, read_records
from kleinkram.recordings.formats.rosbag1.format import scan_bag
from kleinkram.recordings.formats.rosbag1.records import Fields, read_chunk_counts
from kleinkram.recordings.limits import MAX_CHUNKS, MAX_TOPICS
from kleinkram.recordings.message_counts import CHUNK
from kleinkram.recordings.messages import Channel
from kleinkram.recordings.model import RecordingSummary, counted
from kleinkram.recordings.sources import Source, SourceForward
from kleinkram.recordings.streams import ForwardStream, open_range

_GUESSED_RATIO = 4
_HEAD_WINDOW = 4096


@dataclass
class BagIndex:
    """What is known of a bag before any chunk is read."""

    channels: dict[int, Channel] = field(default_factory=dict)
    table: ChunkTable = field(default_factory=ChunkTable)
    counts: dict[int, int] = field(default_factory=lambda: defaultdict(int))
    definition_bytes: int = 0

    def define(self, fields: Fields, data: bytes, where: str) -> None:
        """Note a connection; the first of a number counts."""
        number, channel = read_connection(fields, data, where)
        if number in self.channels:
            return
        self.definition_bytes += len(data)
        if len(self.channels) >= MAX_TOPICS or self.definition_bytes > MAX_DEFINITIONS:
            raise Malformed(where, "more connections than are read", certain=False)
        self.channels[number] = channel


def read_index(source: Source) -> BagIndex:
    """Return the index of a bag.

    Raises:
        NotIndexed: there is none, or it cannot be true.
        SourceError: as `Source.read`.
    """
    index = BagIndex()
    try:
        index_start, connections, chunks = _read_bag_header(source)
        stream = open_range(source, index_start, source.size_bytes)
        starts = _read_index_section(stream, index, connections + chunks)
        _place(index, starts, index_start)
    except Malformed as error:
        raise NotIndexed("no-index", f"the index cannot be used: {error}", is_problem=True) from error
    return index


def _read_bag_header(source: Source) -> tuple[int, int, int]:
    start = len(records.MAGIC)
    stream = open_range(source, start, source.size_bytes, window=_HEAD_WINDOW)
    fields, _ = records.read_fields(stream)
    if fields.opcode() != records.BAG_HEADER:
        raise Malformed(f"byte {start}", "the first record is not a bag header")
    index_start = fields.u64("index_pos")
    if not start < index_start <= source.size_bytes:
        raise Malformed(f"byte {start}", "the bag has no index: it was cut, or not closed by its recorder")
    return index_start, fields.u32("conn_count"), fields.u32("chunk_count")


def _read_index_section(stream: ForwardStream, index: BagIndex, left: int) -> list[tuple[int, int, int, int]]:
    """Read connections and chunk infos; return start, first and last time, and set of channels of each chunk."""
    found: list[tuple[int, int, int, int]] = []
    for record in read_records(stream):
        left -= 1
        where = f"byte {record.start}"
        if left < 0:
            raise Malformed(where, "the index goes on behind what the bag's header says")
        if record.opcode == records.CONNECTION:
            index.define(record.fields, stream.take(record.data_bytes), where)
        elif record.opcode == records.CHUNK_INFO:
            fields = record.fields
            flat = read_chunk_counts(fields, stream.take(record.data_bytes), where)
            for number, count in zip(flat[0::2], flat[1::2], strict=True):
                index.counts[number] += count
            members = index.table.sets.number(flat[0::2])
            found.append((fields.u64("chunk_pos"), fields.time_ns("start_time"), fields.time_ns("end_time"), members))
            if len(found) > MAX_CHUNKS:
                raise Malformed(where, f"more than {MAX_CHUNKS} chunks", certain=False)
        else:
            raise Malformed(where, f"a record of type {record.opcode} in the index")
    if left:
        raise Malformed(
            f"byte {stream.position}",
            f"the file is cut within its index: {counted(left, 'record is', 'records are')} missing",
        )
    return found


def _place(index: BagIndex, found: list[tuple[int, int, int, int]], index_start: int) -> None:
    """Make rows: a chunk and its index data end where the next chunk begins."""
    found.sort()
    ends = [*(place[0] for place in found[1:]), index_start] if found else []
    for (start, first_ns, last_ns, members), end in zip(found, ends, strict=True):
        if not len(records.MAGIC) <= start < end <= index_start:
            raise Malformed(f"byte {start}", "the index lists chunks that overlap, or lie outside the file")
        guess = _GUESSED_RATIO * (end - start)
        index.table.rows.append(Row(start, end - start, end, first_ns, last_ns, CHUNK, members, guess))
    if not index.counts.keys() <= index.channels.keys():
        raise Malformed("index", "it lists chunks of connections that it does not define")


class _Gathering(Gathering):
    def __init__(self, index: BagIndex, noticed: Noticed) -> None:
        super().__init__(index.table, noticed)
        self._index = index

    def define(self, fields: Fields, data: bytes, where: str) -> None:
        """Take note of a connection."""
        try:
            self._index.define(fields, data, where)
        except Malformed as error:
            self.noticed.add("damaged", error.where, error.message)


def rebuild_index(source: Source, noticed: Noticed) -> tuple[BagIndex, RecordingSummary]:
    """Return the index of what can be read of a bag, which is scanned once from end to end, and its summary; what
    cannot be read is noted.

    Raises:
        SourceError: as `Source.read`.
    """
    index = BagIndex()
    gathering = _Gathering(index, noticed)
    summary = scan_bag(SourceForward(source), listener=gathering)
    gathering.close()
    index.counts.update((number, count) for number, count in gathering.counts.items() if number in index.channels)
    return index, summary
