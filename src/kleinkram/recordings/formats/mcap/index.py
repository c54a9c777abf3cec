"""The index of an MCAP: footer, summary section and, on request, message indexes.

Reads no chunk and decompresses nothing. Where the index cannot be used, or does not add up, `read_index` raises
`NotIndexed`, and the file must be scanned.
"""

from __future__ import annotations

import heapq
import zlib
from array import array
from collections.abc import Iterator
from itertools import chain

from kleinkram.recordings.chunk_table import ANY_CHANNEL, UNKNOWN, Row, smallest_to_come
from kleinkram.recordings.compression import is_known_compression, unknown_compression, unreadable_chunk
from kleinkram.recordings.damage_report import DamageReport
from kleinkram.recordings.errors import Malformed, NotIndexed
from kleinkram.recordings.formats.mcap import records
from kleinkram.recordings.formats.mcap.records import McapFacts, Opcode
from kleinkram.recordings.formats.mcap.resync import CHUNK_FIXED
from kleinkram.recordings.index_check import ChunkClaim, ChunkMessages, wrong_compression
from kleinkram.recordings.limits import MAX_CHUNK_INDEX, MAX_NAME, MAX_TAKE, TAIL, WINDOW
from kleinkram.recordings.model import counted
from kleinkram.recordings.sources import Source, read_short_ranges
from kleinkram.recordings.streams import ByteStream, open_bytes, open_range
from kleinkram.recordings.timeline import ChunkEntries, Timeline

_HEAD_BYTES = 4096
_CHUNK_HEAD_BYTES = 4096
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
    """Read the index.

    Args:
        source: the file.
        times: where the messages of all message indexes are counted, and the chunks that cannot be read. None: no
            message index is read.

    Raises:
        NotIndexed: there is no index, or it cannot be true.
        SourceError: as `Source.read`.
    """
    known = _KnownEnds(source)
    facts = McapFacts()
    try:
        summary_start = _read_summary_section(known, facts)
        _read_header(known, facts)
        _check_definitions(facts)
        _check_places(facts, summary_start)
        _check_compressions(source, facts)
        if times is not None:
            _read_message_indexes(source, facts, *times)
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
        """Return up to `length` bytes; fewer at the end of the file."""
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
    if footer_at < len(records.MAGIC) or not tail.endswith(records.MAGIC):
        raise NotIndexed("no-footer", "it was never closed, so it has no index", is_problem=False)
    opcode, length = records.RECORD_HEAD.unpack_from(tail, footer_at)
    if opcode != Opcode.FOOTER or length != records.FOOTER_BODY.size:
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
        _read_summary_record(stream, facts)
    footer_without_crc = tail[footer_at : footer_at + records.RECORD_HEAD.size + records.FOOTER_BODY.size - 4]
    if crc and zlib.crc32(footer_without_crc, stream.crc) != crc:
        raise Malformed(f"byte {summary_start}", "the checksum of the summary section is wrong")
    return summary_start


def _read_summary_record(stream: ByteStream, facts: McapFacts) -> None:
    where = f"byte {stream.position}"
    opcode, length = records.RECORD_HEAD.unpack(stream.take(records.RECORD_HEAD.size))
    if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
        body = stream.take(min(length, MAX_TAKE))
        _READERS[opcode](facts, body, where)
        stream.skip(length - len(body))
    elif opcode in _READERS:
        _READERS[opcode](facts, stream.take(length), where)
    else:
        stream.skip(length)


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


def _check_places(facts: McapFacts, summary_start: int) -> None:
    facts.table.rows.sort()
    end = len(records.MAGIC)
    for row in facts.table.rows:
        if row.start < end or row.length < records.RECORD_HEAD.size:
            raise Malformed(f"byte {row.start}", "the chunk index lists chunks that overlap")
        if row.end > summary_start:
            raise Malformed(f"byte {row.start}", "the chunk index points behind the data")
        end = row.end


def _check_compressions(source: Source, facts: McapFacts) -> None:
    """Keep those unknown compressions that the chunks themselves confirm."""
    for row in facts.table.rows if facts.unknown_compression else ():
        named = facts.unknown_compression.get(row.start)
        if named is None:
            continue
        compression = _read_compression(source, row) or named
        if is_known_compression(compression):
            facts.index_faults.note(row.start, wrong_compression(named))
            del facts.unknown_compression[row.start]
        else:
            facts.unknown_compression[row.start] = compression


def _read_compression(source: Source, row: Row) -> str | None:
    """Return the compression in the head of a chunk; None if there is no chunk."""
    stream = open_range(source, row.start, row.end, window=_CHUNK_HEAD_BYTES)
    try:
        opcode, _length = records.RECORD_HEAD.unpack(stream.take(records.RECORD_HEAD.size))
        name_length = CHUNK_FIXED.unpack(stream.take(CHUNK_FIXED.size))[-1]
        if opcode == Opcode.CHUNK and name_length <= MAX_NAME:
            return stream.take(name_length).decode("utf-8", "replace")
    except Malformed:
        pass  # it is cut: the same as none
    return None


def _read_message_indexes(source: Source, facts: McapFacts, timeline: Timeline, losses: DamageReport) -> None:
    rows = facts.table.rows
    for start, size in _index_ranges(facts):
        if size > MAX_CHUNK_INDEX:
            raise Malformed(f"byte {start}", "the index of a chunk is too large to be read", certain=False)
    for channel in facts.channels.values():
        timeline.topic(channel.topic)
    watermarks = smallest_to_come(rows.column(Row._fields.index("first_ns")))
    for row, stream, before_ns in zip(rows, _index_streams(source, facts), watermarks, strict=True):
        entries, messages = _read_chunk_entries(stream, facts)
        claim = ChunkClaim(row.start, row.start + row.length, row.first_ns, row.last_ns, row.channels, UNKNOWN)
        facts.index_faults.compare(claim, facts.table.sets.listed(row.channels), messages)
        why = unreadable_chunk("", stored=row.length, uncompressed=row.uncompressed_bytes)
        if named := facts.unknown_compression.get(row.start):
            why = unknown_compression(named)
        if why is not None:
            losses.skip_chunk(row.start, row.length, sum(len(entry.stamps) for entry in entries), why)
        else:
            timeline.add_chunk(entries, uncompressed_bytes=row.uncompressed_bytes, stored_bytes=row.stored_bytes)
        timeline.settle(before_ns)


def _index_ranges(facts: McapFacts) -> Iterator[tuple[int, int]]:
    """Yield where the message indexes of each chunk begin, and their size."""
    starts, lengths, ends = (facts.table.rows.column(Row._fields.index(name)) for name in ("start", "length", "end"))
    return ((start + length, end - start - length) for start, length, end in zip(starts, lengths, ends, strict=True))


def _index_streams(source: Source, facts: McapFacts) -> Iterator[ByteStream]:
    """Yield the message indexes of each chunk; over a network, the next ones are fetched meanwhile."""
    if any(size > WINDOW for _, size in _index_ranges(facts)):
        for start, size in _index_ranges(facts):
            yield open_range(source, start, start + size)
        return
    answers = read_short_ranges(source, _index_ranges(facts))
    for (start, _), data in zip(_index_ranges(facts), answers, strict=True):
        yield open_bytes(data, start)


def _read_chunk_entries(stream: ByteStream, facts: McapFacts) -> tuple[list[ChunkEntries], ChunkMessages]:
    by_topic: dict[str, ChunkEntries] = {}
    messages = ChunkMessages()
    while not stream.at_end():
        where = f"byte {stream.position}"
        opcode, length = records.RECORD_HEAD.unpack(stream.take(records.RECORD_HEAD.size))
        if opcode != Opcode.MESSAGE_INDEX:
            raise Malformed(where, f"a record of type {opcode} where a message index should be")
        channel_id, stamps, offsets = records.read_message_index(stream.take(length), where)
        messages.add_index(channel_id, stamps)
        channel = facts.channels.get(channel_id)
        if channel is None:
            raise NotIndexed("no-channels", f"the summary does not list channel {channel_id}", is_problem=False)
        known = by_topic.get(channel.topic)
        if known is not None:
            stamps, offsets = array("Q", known.stamps) + stamps, array("Q", known.offsets) + offsets
        by_topic[channel.topic] = ChunkEntries(channel.topic, stamps, offsets)
    return list(by_topic.values()), messages


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
    if statistics is None and ANY_CHANNEL in rows.column(Row._fields.index("channels")):
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
