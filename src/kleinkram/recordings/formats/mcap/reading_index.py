"""What reading an MCAP needs of its summary section: definitions, and where its chunks are. Reads no message index.

The summary is read once, with a checksum. Where it cannot be used, or does not account for everything, it raises
`NotIndexed`, and the index is built anew (`mcap_rebuild`).
"""

from __future__ import annotations

import heapq
import struct
import zlib
from dataclasses import dataclass, field
from itertools import chain

from kleinkram.recordings.chunk_reader import Gathering
from kleinkram.recordings.chunk_table import ANY_CHANNEL, ChunkTable, Row
from kleinkram.recordings.compression import is_known_compression
from kleinkram.recordings.damage_report import Noticed
from kleinkram.recordings.errors import Malformed, NotIndexed
from kleinkram.recordings.formats.mcap import records
from kleinkram.recordings.formats.mcap.format import scan_mcap
from kleinkram.recordings.formats.mcap.index import read_compression
from kleinkram.recordings.formats.mcap.records import BodyReader
from kleinkram.recordings.limits import MAX_TOPICS, TAIL
from kleinkram.recordings.message_counts import CHUNK
from kleinkram.recordings.messages import Channel, Schema
from kleinkram.recordings.model import RecordingSummary, counted
from kleinkram.recordings.sources import Source, SourceForward
from kleinkram.recordings.streams import ForwardStream, open_bytes, open_range

_PLACE = struct.Struct("<QQQQ")
_OFFSET = struct.Struct("<HQ")
_SIZES = struct.Struct("<QQ")
_U64 = struct.Struct("<Q")
_STATISTICS = struct.Struct("<QHIIIIQQ")
_HEAD = 4096
_MOST_RECORDS_WALKED = 1_000
_MOST_OTHERS = 200_000


@dataclass
class Definitions:
    """What a file defines; the first of an id counts."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, tuple[int, str, str]] = field(default_factory=dict)
    _bytes: int = 0

    def read_schema(self, body: bytes, where: str) -> None:
        """Note a schema record."""
        reader = BodyReader(body, where)
        (schema_id,) = reader.fields(_ID)
        if schema_id not in self.schemas:
            self._count(len(body), where)
            self.schemas[schema_id] = Schema(reader.text(), reader.text(), reader.counted())

    def read_channel(self, body: bytes, where: str) -> None:
        """Note a channel record."""
        reader = BodyReader(body, where)
        channel_id, schema_id = reader.fields(_IDS)
        if channel_id not in self.channels:
            if len(self.channels) >= MAX_TOPICS:
                raise Malformed(where, f"more than {MAX_TOPICS} channels", certain=False)
            self._count(len(body), where)
            self.channels[channel_id] = (schema_id, reader.text(), reader.text())

    def resolve(self, message_compression: str) -> dict[int, Channel]:
        """Return the channels with their schemas; one whose schema the file lacks has an empty one."""
        return {
            channel_id: Channel(topic, encoding, self.schemas.get(schema_id, NO_SCHEMA), message_compression)
            for channel_id, (schema_id, topic, encoding) in self.channels.items()
        }

    def _count(self, size: int, where: str) -> None:
        self._bytes += size
        if self._bytes > MAX_DEFINITIONS:
            raise Malformed(where, f"more than {MAX_DEFINITIONS} bytes of definitions", certain=False)


@dataclass
class McapIndex:
    """What is known of an MCAP before any chunk is read.

    Attributes:
        counts: messages by channel; None where the file does not say.
        others: where attachments and metadata stand, each [start, end).
        unreadable: starts of chunks whose compression is not one that is read.
    """

    definitions: Definitions = field(default_factory=Definitions)
    table: ChunkTable = field(default_factory=ChunkTable)
    counts: dict[int, int] | None = None
    message_count: int | None = None
    start_ns: int | None = None
    end_ns: int | None = None
    channel_count: int | None = None
    chunk_count: int | None = None
    others: list[tuple[int, int]] = field(default_factory=list)
    unreadable: set[int] = field(default_factory=set)


def read_index(source: Source) -> McapIndex:
    """Return the index of an MCAP.

    Raises:
        NotIndexed: there is none, or it cannot be true.
        SourceError: as `Source.read`.
    """
    size = source.size_bytes
    tail_start = max(0, size - TAIL)
    tail = source.read(tail_start, size - tail_start)
    index = McapIndex()
    try:
        summary_start = _read_summary(source, tail, tail_start, index)
        _check(index)
        _check_places(index, summary_start)
        _check_compressions(source, index)
        _refuse_messages_outside_chunks(_Known(source, tail, tail_start), index, summary_start)
    except Malformed as error:
        raise NotIndexed("index-damaged", f"the index cannot be used: {error}", is_problem=True) from error
    return index


def _read_summary(source: Source, tail: bytes, tail_start: int, index: McapIndex) -> int:
    footer_start = tail_start + len(tail) - records.FOOTER_BYTES
    if len(tail) < records.FOOTER_BYTES + len(records.MAGIC) or not tail.endswith(records.MAGIC):
        raise NotIndexed("no-footer", "the file does not end in a footer: it was cut or never closed", is_problem=True)
    opcode, length = records.RECORD_HEAD.unpack_from(tail, footer_start - tail_start)
    if opcode != records.FOOTER or length != records.FOOTER_BODY.size:
        raise NotIndexed("no-footer", "the file does not end in a footer: it was cut or never closed", is_problem=True)
    body_start = footer_start - tail_start + records.RECORD_HEAD.size
    summary_start: int
    summary_start, _offsets_start, crc = records.FOOTER_BODY.unpack_from(tail, body_start)
    if summary_start == 0:
        raise NotIndexed("no-summary", "the file has no summary section", is_problem=False)
    if not len(records.MAGIC) < summary_start <= footer_start:
        raise Malformed(f"byte {footer_start}", f"the summary is said to begin at byte {summary_start}")
    if summary_start >= tail_start:
        stream = open_bytes(tail[summary_start - tail_start : footer_start - tail_start], summary_start)
    else:
        stream = open_range(source, summary_start, footer_start)
    if crc:
        stream.start_crc()
    while not stream.at_end():
        _read_record(stream, index)
    rest = tail[footer_start - tail_start : body_start + records.FOOTER_BODY.size - 4]
    if crc and zlib.crc32(rest, stream.crc) != crc:
        raise Malformed(f"byte {summary_start}", "the checksum of the summary section is wrong")
    return summary_start


def _read_record(stream: ForwardStream, index: McapIndex) -> None:
    where = f"byte {stream.position}"
    opcode, length = records.RECORD_HEAD.unpack(stream.take(records.RECORD_HEAD.size))
    if opcode == records.CHUNK_INDEX:
        _read_chunk_index(index, stream.take(length), where)
    elif opcode == records.SCHEMA:
        index.definitions.read_schema(stream.take(length), where)
    elif opcode == records.CHANNEL:
        index.definitions.read_channel(stream.take(length), where)
    elif opcode == records.STATISTICS:
        _read_statistics(index, stream.take(length), where)
    elif opcode in (records.ATTACHMENT_INDEX, records.METADATA_INDEX):
        start, other_length = BodyReader(stream.take(length), where).fields(_SIZES)
        if len(index.others) >= _MOST_OTHERS:
            raise Malformed(where, f"more than {_MOST_OTHERS} attachments and metadata", certain=False)
        index.others.append((start, start + other_length))
    else:
        stream.skip(length)


def _read_chunk_index(index: McapIndex, body: bytes, where: str) -> None:
    reader = BodyReader(body, where)
    first_ns, last_ns, start, length = reader.fields(_PLACE)
    offsets = reader.counted()
    if len(offsets) % _OFFSET.size:
        raise Malformed(where, "a chunk index that ends within an entry")
    channel_ids = [channel_id for channel_id, _ in _OFFSET.iter_unpack(offsets)]
    (index_length,) = reader.fields(_U64)
    if not is_known_compression(reader.text()):
        index.unreadable.add(start)
    _stored, uncompressed = reader.fields(_SIZES)
    known = index.table.sets.number(channel_ids) if channel_ids else ANY_CHANNEL
    end = start + length + index_length
    index.table.rows.append(Row(start, length, end, first_ns, last_ns, CHUNK, known, uncompressed))


def _read_statistics(index: McapIndex, body: bytes, where: str) -> None:
    reader = BodyReader(body, where)
    messages, _schemas, channels, _attachments, _metadata, chunks, start_ns, end_ns = reader.fields(_STATISTICS)
    counts = reader.counted()
    if len(counts) % _OFFSET.size:
        raise Malformed(where, "statistics that end within an entry")
    index.message_count, index.channel_count, index.chunk_count = messages, channels, chunks
    index.start_ns, index.end_ns = (start_ns, end_ns) if messages else (None, None)
    by_channel = dict(_OFFSET.iter_unpack(counts))
    index.counts = by_channel if sum(by_channel.values()) == messages else None


def _check(index: McapIndex) -> None:
    """Refuse an index that leaves out channels, schemas or chunks."""
    definitions, table = index.definitions, index.table
    if index.channel_count is not None and len(definitions.channels) < index.channel_count:
        raise NotIndexed("no-channels", "the summary does not list all channels", is_problem=False)
    if any(ids[0] and ids[0] not in definitions.schemas for ids in definitions.channels.values()):
        raise NotIndexed("no-schemas", "the summary does not list all schemas", is_problem=False)
    if len(table.rows) == 0 and index.message_count != 0:
        raise NotIndexed("no-chunk-index", "the file has no chunk index", is_problem=False)
    if index.chunk_count is not None and len(table.rows) != index.chunk_count:
        message = f"the statistics say {counted(index.chunk_count, 'chunk')}, the index lists {len(table.rows)}"
        raise NotIndexed("counts-disagree", message, is_problem=True)
    if index.message_count is None and ANY_CHANNEL in table.rows.column(Row._fields.index("channels")):
        raise NotIndexed("no-message-index", "the file has chunks without message index", is_problem=False)
    if not table.known_channels() <= definitions.channels.keys():
        raise NotIndexed("no-channels", "the summary does not list all channels", is_problem=False)


def _check_places(index: McapIndex, summary_start: int) -> None:
    rows = index.table.rows
    rows.sort()
    end = len(records.MAGIC)
    for row in rows:
        if row.start < end or row.length < records.RECORD_HEAD.size:
            raise Malformed(f"byte {row.start}", "the chunk index lists chunks that overlap")
        if row.end > summary_start:
            raise Malformed(f"byte {row.start}", "the chunk index points behind the data")
        end = row.end


def _check_compressions(source: Source, index: McapIndex) -> None:
    """Ask the chunks whose compression, as the index says, is not one that is read. Of those that say so themselves,
    the statistics count messages that nobody can read.
    """
    if not index.unreadable:
        return
    for row in index.table.rows:
        if row.start in index.unreadable:
            compression = read_compression(source, row.start, row.end)
            if compression is not None and is_known_compression(compression):
                index.unreadable.discard(row.start)
    if index.unreadable:
        index.counts = index.message_count = None


def _refuse_messages_outside_chunks(known: _Known, index: McapIndex, summary_start: int) -> None:
    """Walk over what no index covers: messages may stand there."""
    position, left = len(records.MAGIC), _MOST_RECORDS_WALKED
    covered = ((row.start, row.end) for row in index.table.rows)
    for start, end in chain(heapq.merge(covered, sorted(index.others)), [(summary_start, summary_start)]):
        while position < start:
            head = open_bytes(known.read(position, records.RECORD_HEAD.size), position)
            opcode, length = records.RECORD_HEAD.unpack(head.take(records.RECORD_HEAD.size))
            left -= 1
            if opcode in (records.MESSAGE, records.CHUNK) or left == 0:
                raise NotIndexed("no-chunk-index", "the index does not list all messages", is_problem=False)
            position += records.RECORD_HEAD.size + length
        position = max(position, end)


class _Known:
    """A source of which the tail is at hand; the head is fetched once."""

    def __init__(self, source: Source, tail: bytes, tail_start: int) -> None:
        self._source = source
        self._tail = tail
        self._tail_start = tail_start
        self._head = b""

    def read(self, offset: int, length: int) -> bytes:
        if offset >= self._tail_start:
            return self._tail[offset - self._tail_start :][:length]
        if offset + length > _HEAD:
            return self._source.read(offset, min(length, self._source.size_bytes - offset))
        if not self._head:
            self._head = self._source.read(0, min(_HEAD, self._source.size_bytes))
        return self._head[offset : offset + length]


MAX_DEFINITIONS = 32 * 2**20
"""Bytes of all definitions of one file together."""

NO_SCHEMA = Schema("", "", b"")
_ID = struct.Struct("<H")
_IDS = struct.Struct("<HH")


class _Gathering(Gathering):
    def __init__(self, index: McapIndex, noticed: Noticed) -> None:
        super().__init__(index.table, noticed)
        self._definitions = index.definitions

    def define(self, opcode: int, body: bytes, where: str) -> None:
        """Take note of a schema or a channel."""
        read = self._definitions.read_schema if opcode == records.SCHEMA else self._definitions.read_channel
        try:
            read(body, where)
        except Malformed as error:
            self.noticed.add("damaged", error.where, error.message)


def rebuild_index(source: Source, noticed: Noticed) -> tuple[McapIndex, RecordingSummary]:
    """Return the index of what can be read of an MCAP, and its summary; what cannot be read is noted.

    Raises:
        SourceError: as `Source.read`.
    """
    index = McapIndex()
    gathering = _Gathering(index, noticed)
    summary = scan_mcap(SourceForward(source), listener=gathering)
    gathering.close()
    known, rows = index.definitions.channels, index.table.rows
    index.counts = {number: count for number, count in gathering.counts.items() if number in known}
    index.message_count = sum(index.counts.values())
    if index.message_count:
        index.start_ns = min(rows.column(Row._fields.index("first_ns")))
        index.end_ns = max(rows.column(Row._fields.index("last_ns")))
    return index, summary
