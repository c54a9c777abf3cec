"""The summary of an MCAP from its own index: footer, summary section, and the message indexes behind each chunk.

Reads no chunk and decompresses nothing; costs the index bytes of the file and at most 1 MB more. Where the index
cannot be used, or does not add up, it raises `NotIndexed`, and the file is scanned (`mcap_scan`).
"""

from __future__ import annotations

import zlib
from array import array
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain

from kleinkram.recordings.chunk_table import UNKNOWN, smallest_to_come
from kleinkram.recordings.compression import is_known_compression, unreadable_chunk
from kleinkram.recordings.damage_report import Losses
from kleinkram.recordings.errors import Malformed, NotIndexed
from kleinkram.recordings.formats.mcap import records
from kleinkram.recordings.formats.mcap.records import ChunkPlace, McapFacts
from kleinkram.recordings.formats.mcap.resync import CHUNK_FIXED
from kleinkram.recordings.index_check import ChunkClaim, FoundMessages, wrong_compression
from kleinkram.recordings.limits import MAX_CHUNK_INDEX, MAX_NAME, TAIL, WINDOW
from kleinkram.recordings.model import counted
from kleinkram.recordings.sources import Source, read_short_ranges
from kleinkram.recordings.streams import ForwardStream, open_bytes, open_range
from kleinkram.recordings.timeline import ChunkEntries, Timeline

_CHUNK_HEAD_BYTES = 4096
_HEAD_OF_DEFINITION = 3 * 4096 + 16
_MOST_RECORDS_WALKED = 10_000
_READERS = {
    records.CHUNK_INDEX: records.read_chunk_index,
    records.STATISTICS: records.read_statistics,
    records.ATTACHMENT_INDEX: records.read_attachment_index,
    records.METADATA_INDEX: records.read_metadata_index,
}
_DEFINITIONS = {
    records.SCHEMA: records.read_schema,
    records.CHANNEL: records.read_channel,
}


@dataclass(frozen=True)
class Footer:
    """The end of an MCAP: where the summary section begins (0: there is none), and its CRC-32 (0: not kept)."""

    start: int
    summary_start: int
    summary_crc: int


def read_footer(source: Source) -> Footer | None:
    """Return the footer; None if the file does not end in one."""
    size = source.size_bytes
    if size < 2 * len(records.MAGIC) + records.FOOTER_BYTES:
        return None
    tail = source.read(size - records.FOOTER_BYTES, records.FOOTER_BYTES)
    opcode, length = records.RECORD_HEAD.unpack_from(tail)
    if opcode != records.FOOTER or length != records.FOOTER_BODY.size or not tail.endswith(records.MAGIC):
        return None
    summary_start, _offsets_start, crc = records.FOOTER_BODY.unpack_from(tail, records.RECORD_HEAD.size)
    return Footer(size - records.FOOTER_BYTES, summary_start, crc)


def read_index(source: Source, footer: Footer, timeline: Timeline, losses: Losses) -> McapFacts:
    """Fill the timeline from the file's own index, and return what else it says.

    `losses` counts the chunks whose compression, as the index says, is not one that is read.

    Raises:
        NotIndexed: there is no index, or it cannot be true.
        SourceError: as `Source.read`.
    """
    facts = McapFacts()
    try:
        _read_summary_section(source, footer, facts)
        _check_definitions(facts)
        _check_places(facts, footer)
        _read_message_indexes(source, facts, timeline, losses)
        if facts.statistics is None:
            _refuse_messages_outside_chunks(source, facts, footer)
    except Malformed as error:
        raise NotIndexed("index-damaged", f"the index cannot be used: {error}", is_problem=True) from error
    _compare_with_statistics(facts, timeline, losses)
    return facts


def _read_summary_section(source: Source, footer: Footer, facts: McapFacts) -> None:
    if footer.summary_start == 0:
        raise NotIndexed("no-summary", "the file has no summary section", is_problem=False)
    if not len(records.MAGIC) < footer.summary_start <= footer.start:
        raise Malformed(f"byte {footer.start}", f"the summary is said to begin at byte {footer.summary_start}")
    length = footer.start - footer.summary_start
    if length <= TAIL:
        stream = open_bytes(source.read(footer.summary_start, length), footer.summary_start)
    else:
        stream = open_range(source, footer.summary_start, footer.start)
    if footer.summary_crc:
        stream.start_crc()
    while not stream.at_end():
        _read_summary_record(stream, facts)
    if footer.summary_crc:
        rest = source.read(footer.start, records.RECORD_HEAD.size + records.FOOTER_BODY.size - 4)
        if zlib.crc32(rest, stream.crc) != footer.summary_crc:
            raise Malformed(f"byte {footer.summary_start}", "the checksum of the summary section is wrong")


def _read_summary_record(stream: ForwardStream, facts: McapFacts) -> None:
    where = f"byte {stream.position}"
    opcode, length = records.RECORD_HEAD.unpack(stream.take(records.RECORD_HEAD.size))
    if opcode in _READERS:
        _READERS[opcode](facts, stream.take(length), where)
        return
    if opcode in _DEFINITIONS:
        head = stream.take(min(length, _HEAD_OF_DEFINITION))
        _DEFINITIONS[opcode](facts, head, where)
        length -= len(head)
    stream.skip(length)


def _check_definitions(facts: McapFacts) -> None:
    statistics = facts.statistics
    if statistics is not None:
        facts.attachments, facts.metadata_records = statistics.attachments, statistics.metadata_records
        if len(facts.channels) < statistics.channels:
            raise NotIndexed("no-channels", "the summary does not list all channels", is_problem=False)
    if any(c.schema_id and c.schema_id not in facts.schemas for c in facts.channels.values()):
        raise NotIndexed("no-schemas", "the summary does not list all schemas", is_problem=False)
    if len(facts.chunks) == 0 and (statistics is None or statistics.messages):
        raise NotIndexed("no-chunk-index", "the file has no chunk index", is_problem=False)


def _check_places(facts: McapFacts, footer: Footer) -> None:
    facts.chunks.sort()
    end = len(records.MAGIC)
    for place in facts.chunks:
        if place.start < end:
            raise Malformed(f"byte {place.start}", "the chunk index lists chunks that overlap")
        if place.end > footer.summary_start:
            raise Malformed(f"byte {place.start}", "the chunk index points behind the data")
        if place.end - place.index_start > MAX_CHUNK_INDEX:
            raise Malformed(f"byte {place.start}", "the index of a chunk is too large to be read", certain=False)
        end = place.end


def _read_message_indexes(source: Source, facts: McapFacts, timeline: Timeline, losses: Losses) -> None:
    for channel in facts.channels.values():
        timeline.topic(channel.topic)
    watermarks = smallest_to_come(facts.chunks.column(ChunkPlace._fields.index("first_ns")))
    for place, stream, before_ns in zip(facts.chunks, _index_streams(source, facts), watermarks, strict=True):
        entries, found = _read_chunk_entries(stream, facts)
        claim = ChunkClaim(place.start, place.index_start, place.first_ns, place.last_ns, place.channels, UNKNOWN)
        facts.index_faults.compare(claim, facts.sets.listed(place.channels), found)
        compression = named = facts.unknown_compression.get(place.start, "")
        if named:
            compression = read_compression(source, place.start, place.end) or named
            if is_known_compression(compression):
                facts.index_faults.note(place.start, wrong_compression(named))
        stored, uncompressed = place.index_start - place.start, place.uncompressed_bytes
        if why := unreadable_chunk(compression, stored=stored, uncompressed=uncompressed):
            losses.leave_chunk(place.start, stored, sum(len(entry.stamps) for entry in entries), why)
        else:
            timeline.add_chunk(entries, uncompressed_bytes=uncompressed, stored_bytes=place.compressed_bytes)
        timeline.settle(before_ns)


def read_compression(source: Source, start: int, end: int) -> str | None:
    """Return what a chunk itself says of its compression; None where no chunk stands in [start, end).

    Raises:
        SourceError: as `Source.read`.
    """
    stream = open_range(source, start, end, window=_CHUNK_HEAD_BYTES)
    try:
        opcode, _length = records.RECORD_HEAD.unpack(stream.take(records.RECORD_HEAD.size))
        name_length = CHUNK_FIXED.unpack(stream.take(CHUNK_FIXED.size))[-1]
        if opcode == records.CHUNK and name_length <= MAX_NAME:
            return stream.take(name_length).decode("utf-8", "replace")
    except Malformed:
        pass  # it is cut: the same as none
    return None


def _index_streams(source: Source, facts: McapFacts) -> Iterator[ForwardStream]:
    """Yield the message indexes of each chunk; over a network, those of the next few are fetched meanwhile."""
    if any(place.end - place.index_start > WINDOW for place in facts.chunks):
        for place in facts.chunks:
            yield open_range(source, place.index_start, place.end)
        return
    ranges = ((place.index_start, place.end - place.index_start) for place in facts.chunks)
    for place, data in zip(facts.chunks, read_short_ranges(source, ranges), strict=True):
        yield open_bytes(data, place.index_start)


def _read_chunk_entries(stream: ForwardStream, facts: McapFacts) -> tuple[list[ChunkEntries], FoundMessages]:
    by_topic: dict[str, ChunkEntries] = {}
    found = FoundMessages()
    while not stream.at_end():
        where = f"byte {stream.position}"
        opcode, length = records.RECORD_HEAD.unpack(stream.take(records.RECORD_HEAD.size))
        if opcode != records.MESSAGE_INDEX:
            raise Malformed(where, f"a record of type {opcode} where a message index should be")
        channel_id, stamps, offsets = records.read_message_index(stream.take(length), where)
        found.add_index(channel_id, stamps)
        channel = facts.channels.get(channel_id)
        if channel is None:
            raise NotIndexed("no-channels", f"the summary does not list channel {channel_id}", is_problem=False)
        known = by_topic.get(channel.topic)
        if known is not None:
            stamps, offsets = array("Q", known.stamps) + stamps, array("Q", known.offsets) + offsets
        by_topic[channel.topic] = ChunkEntries(channel.topic, stamps, offsets)
    return list(by_topic.values()), found


def _compare_with_statistics(facts: McapFacts, timeline: Timeline, losses: Losses) -> None:
    """Refuse an index that does not account for all messages, or that a chunk is missing from."""
    found = sum(times.count for times in timeline.topics.values()) + losses.messages
    if facts.statistics is None:
        if any(place.uncompressed_bytes and place.index_start == place.end for place in facts.chunks):
            raise NotIndexed("no-message-index", "the file has chunks without message index", is_problem=False)
    elif found == 0 and facts.statistics.messages:
        raise NotIndexed("no-message-index", "the file has no message index", is_problem=False)
    elif found != facts.statistics.messages:
        claimed = facts.statistics.messages
        message = f"the statistics say {counted(claimed, 'message')}, the index lists {found}"
        raise NotIndexed("counts-disagree", message, is_problem=True)


def _refuse_messages_outside_chunks(source: Source, facts: McapFacts, footer: Footer) -> None:
    """Without statistics, walk over what no chunk covers: messages may stand there, which no index lists."""
    position = len(records.MAGIC)
    left = _MOST_RECORDS_WALKED
    for start, end in chain(((p.start, p.end) for p in facts.chunks), [(footer.summary_start, footer.start)]):
        while position < start:
            opcode, length = records.RECORD_HEAD.unpack(source.read(position, records.RECORD_HEAD.size))
            left -= 1
            if opcode in (records.MESSAGE, records.CHUNK) or left == 0:
                raise NotIndexed("no-statistics", "the index does not list all messages", is_problem=False)
            position += records.RECORD_HEAD.size + length
        position = end
