"""The summary of a ROS 1 bag 2.0 from its own index: connections, chunk infos, and the index data behind each chunk.

Reads no chunk and decompresses nothing: the index bytes of the file, 64 bytes a chunk, and at most 1 MB more. A bag
without index (its recorder was killed) is broken here; reading it from end to end is another matter.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, islice

from kleinkram.recordings.chunk_table import UNKNOWN, ChannelSets, PackedTable, smallest_to_come
from kleinkram.recordings.compression import unreadable_chunk
from kleinkram.recordings.damage_report import Losses
from kleinkram.recordings.errors import Malformed
from kleinkram.recordings.formats.rosbag1 import records
from kleinkram.recordings.formats.rosbag1.chunks import BagListener
from kleinkram.recordings.formats.rosbag1.records import ChunkInfo, Connection
from kleinkram.recordings.formats.rosbag1.scan import BagScan, scan_bag_records
from kleinkram.recordings.index_check import ChunkClaim, FoundMessages, IndexFaults
from kleinkram.recordings.limits import MAX_CHUNK_INDEX, MAX_NAMES, MAX_TAKE, MAX_TOPICS, WINDOW
from kleinkram.recordings.model import Content, Depth, Problem, RecordingFormat, RecordingSummary, counted
from kleinkram.recordings.sources import Forward, Source, from_source, read_short_ranges
from kleinkram.recordings.streams import Cut, ForwardStream, open_bytes, open_range
from kleinkram.recordings.timeline import ChunkEntries, Timeline
from kleinkram.recordings.topic_statistics import (
    TopicType,
    bounded,
    measure,
    pending,
    tell_damage,
    tell_doubled,
    tell_readable,
)

_HEAD_WINDOW = 4096


@dataclass
class _Bag:
    """What the index said so far."""

    index_start: int
    connections: dict[int, Connection] = field(default_factory=dict)
    chunks: PackedTable[ChunkInfo] = field(default_factory=lambda: PackedTable(ChunkInfo, len(ChunkInfo._fields)))
    names_bytes: int = 0
    compression: set[str] = field(default_factory=set)
    timeline: Timeline = field(default_factory=Timeline)
    losses: Losses = field(default_factory=Losses)
    sets: ChannelSets = field(default_factory=ChannelSets)
    index_faults: IndexFaults = field(default_factory=IndexFaults)


def summarise_bag(source: Source, *, most_bytes: int) -> RecordingSummary:
    """Summarise a file that begins with the magic of a ROS 1 bag 2.0; scan it where that is impossible, if it has at
    most `most_bytes`.

    Raises:
        SourceError: as `Source.read`.
    """
    try:
        index_start, connections, chunks = _read_bag_header(source)
        bag = _Bag(index_start)
        _read_index_section(source, bag, connections, chunks)
        _read_chunk_indexes(source, bag)
    except Malformed as error:
        if source.size_bytes > most_bytes:
            return pending(RecordingFormat.rosbag1, source.size_bytes, f"{error.message}, at {error.where}")
        return scan_bag(from_source(source), [Problem("index-damaged", error.where, error.message)])
    summary = _summary(
        bag.timeline, bag.connections, bag.compression, [*bag.losses.problems(), *bag.index_faults.problems()]
    )
    if not bag.losses.damage:
        return summary
    messages = summary.message_count or 0
    lost = bag.losses.total(claimed=sum(chunk.messages for chunk in bag.chunks), found=messages)
    reason = f"it is damaged {tell_damage(bag.losses.damage)}; {tell_readable(messages, lost)}"
    return replace(summary, content=_content(bag.losses, messages), reason=reason, lost=lost)


def scan_bag(
    forward: Forward, problems: Sequence[Problem] = (), listener: BagListener | None = None
) -> RecordingSummary:
    """Read all of a file that begins with the magic of a ROS 1 bag 2.0. `problems`: why its index is not enough.
    `listener`: as `scan_bag_records`.

    Raises:
        SourceError: as `Forward.read`.
    """
    scan = scan_bag_records(forward, listener)
    losses, messages = scan.losses, scan.tally.messages
    found = [*losses.problems(), *scan.index_faults.problems()]
    if scan.listed is not None and scan.listed != messages and not found:
        message = f"the index says {counted(scan.listed, 'message')}, the file holds {messages}"
        found.append(Problem("counts-disagree", forward.name, message))
    whole = bool(scan.index_start) and not losses.damage and scan.refused is None
    lost = None if whole or scan.refused is not None else losses.total(claimed=scan.listed, found=messages)
    if whole:
        found = found or [*problems]
    reason = None if whole else f"{_what_is_wrong(scan)}; {tell_readable(messages, lost)}"
    summary = _summary(scan.tally.timeline, scan.facts.connections, scan.compression, found)
    content = Content.opaque if scan.refused is not None else _content(losses, messages)
    return replace(summary, content=Content.indexed if whole else content, reason=reason, depth=Depth.scan, lost=lost)


def _content(losses: Losses, messages: int) -> Content:
    """Return what a bag is that is not whole."""
    if messages:
        return Content.recovered
    damage = losses.damage
    return Content.broken if any(fault.certain for fault in damage) or not damage else Content.opaque


def _what_is_wrong(scan: BagScan) -> str:
    parts = []
    if scan.refused is not None:
        return f"{scan.refused.message}, at {scan.refused.where}"
    if scan.index_start == 0:
        parts.append("it was not closed by its recorder, so it has no index (index_pos is 0)")
    if scan.losses.damage:
        parts.append(f"it is damaged {tell_damage(scan.losses.damage)}")
    if scan.index_start is None:
        parts.append("it has no bag header")
    if scan.losses.unproven:
        parts.append(
            f"{counted(scan.losses.unproven, 'message was', 'messages were')} saved from the beginning of a cut chunk"
        )
    return "; ".join(parts)


def _read_bag_header(source: Source) -> tuple[int, int, int]:
    """Return where the index begins, and how many connections and chunks it lists."""
    start = len(records.MAGIC)
    stream = open_range(source, start, source.size_bytes, window=_HEAD_WINDOW)
    fields, _data_bytes = records.read_fields(stream)
    if fields.opcode() != records.BAG_HEADER:
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


def _read_index_section(source: Source, bag: _Bag, connections: int, chunks: int) -> None:
    stream = open_range(source, bag.index_start, source.size_bytes)
    left = connections + chunks
    while left and not stream.at_end():
        where = f"byte {stream.position}"
        fields, data_bytes = records.read_fields(stream)
        opcode = fields.opcode()
        if data_bytes > MAX_TAKE:
            raise Malformed(where, f"an index record of {data_bytes} bytes; at most {MAX_TAKE} are read", certain=False)
        data = stream.take(data_bytes)
        if opcode == records.CONNECTION:
            number, connection = records.read_connection(fields, data, where)
            bag.connections[number] = connection
            bag.names_bytes += len(connection.topic) + len(connection.message_type) + len(connection.publisher)
        elif opcode == records.CHUNK_INFO:
            bag.chunks.append(records.read_chunk_info(fields, data, where, bag.sets))
        else:
            raise Malformed(where, f"a record of type {opcode} in the index")
        if len(bag.connections) > MAX_TOPICS or bag.names_bytes > MAX_NAMES:
            raise Malformed(where, "more connections than are read", certain=False)
        left -= 1
    if left:
        raise Malformed(
            f"byte {source.size_bytes}",
            f"the file is cut within its index: {counted(left, 'record is', 'records are')} missing",
        )
    _check_places(bag)


def _check_places(bag: _Bag) -> None:
    bag.chunks.sort()
    end = len(records.MAGIC)
    for chunk in bag.chunks:
        if chunk.position < end or chunk.position + records.CHUNK_HEAD_BYTES // 2 > bag.index_start:
            raise Malformed(f"byte {chunk.position}", "the index lists chunks that overlap, or lie outside the file")
        end = chunk.position + 1


def _read_chunk_indexes(source: Source, bag: _Bag) -> None:
    for connection in bag.connections.values():
        bag.timeline.topic(connection.topic)
    watermarks = smallest_to_come(bag.chunks.column(ChunkInfo._fields.index("first_ns")))
    for (chunk, head, stream), before_ns in zip(_chunk_streams(source, bag), watermarks, strict=True):
        bag.compression.add(head.compression)
        entries = _read_chunk_entries(stream, bag, chunk)
        stored, uncompressed = head.data_start + head.data_bytes, head.uncompressed_bytes
        if why := unreadable_chunk(head.compression, stored=stored, uncompressed=uncompressed):
            bag.losses.leave_chunk(chunk.position, stored, sum(len(entry.stamps) for entry in entries), why)
        else:
            bag.timeline.add_chunk(entries, uncompressed_bytes=uncompressed, stored_bytes=head.data_bytes)
        bag.timeline.settle(before_ns)


def _chunk_streams(source: Source, bag: _Bag) -> Iterator[tuple[ChunkInfo, records.ChunkHead, ForwardStream]]:
    """Yield each chunk with its header and its index data.

    The index data of a chunk end where the next chunk begins, and their size follows from the chunk info. So one read
    fetches them together with the next chunk's header; where a writer does otherwise, the header says where they are.
    """
    if not len(bag.chunks):
        return
    first = bag.chunks[0].position
    first_head = (first, min(records.CHUNK_HEAD_BYTES, bag.index_start - first))
    reads = ((start, stop - start) for _, start, stop in _plan_reads(bag))
    answers = read_short_ranges(source, chain([first_head], reads))
    head_bytes = next(answers)
    for chunk, (end, start, _stop), answer in zip(bag.chunks, _plan_reads(bag), answers, strict=True):
        head = _parse_head(source, chunk.position, head_bytes)
        index_start = chunk.position + head.data_start + head.data_bytes
        if index_start > end:
            raise Malformed(f"byte {chunk.position}", "a chunk reaches into the next one, or into the index")
        if end - index_start > MAX_CHUNK_INDEX:
            raise Malformed(f"byte {index_start}", "the index of a chunk is too large to be read", certain=False)
        if index_start == start:
            yield chunk, head, open_bytes(answer[: end - start], start)
        else:
            yield chunk, head, open_range(source, index_start, end)
        head_bytes = answer[end - start :]


def _plan_reads(bag: _Bag) -> Iterator[tuple[int, int, int]]:
    """Yield for each chunk where its index data end, and what to read: they, and the header of the next chunk."""
    ends = chain(islice((chunk.position for chunk in bag.chunks), 1, None), [bag.index_start])
    for chunk, end in zip(bag.chunks, ends, strict=True):
        size = min(chunk.index_bytes, end - chunk.position)
        yield end, end - size if size <= WINDOW else end, min(end + records.CHUNK_HEAD_BYTES, bag.index_start)


def _parse_head(source: Source, position: int, head_bytes: bytes) -> records.ChunkHead:
    try:
        return records.read_chunk_head(open_bytes(head_bytes, position))
    except Cut:
        return records.read_chunk_head(open_range(source, position, source.size_bytes, window=_HEAD_WINDOW))


def _read_chunk_entries(stream: ForwardStream, bag: _Bag, chunk: ChunkInfo) -> list[ChunkEntries]:
    by_topic: dict[str, ChunkEntries] = {}
    found = FoundMessages()
    while not stream.at_end():
        where = f"byte {stream.position}"
        number, stamps, offsets = records.read_index_data(stream)
        connection = bag.connections.get(number)
        if connection is None:
            raise Malformed(where, f"index data of connection {number}, which the bag does not define")
        found.add_index(number, stamps)
        known = by_topic.get(connection.topic)
        if known is not None:
            stamps, offsets = [*known.stamps, *stamps], array("I", known.offsets) + offsets
        by_topic[connection.topic] = ChunkEntries(connection.topic, stamps, offsets)
    claim = ChunkClaim(chunk.position, UNKNOWN, chunk.first_ns, chunk.last_ns, chunk.channels, chunk.messages)
    bag.index_faults.compare(claim, bag.sets.listed(chunk.channels), found)
    return list(by_topic.values())


def _summary(
    timeline: Timeline, connections: Mapping[int, Connection], compression: set[str], problems: Sequence[Problem]
) -> RecordingSummary:
    types: dict[str, list[TopicType]] = {}
    for connection in connections.values():
        timeline.topic(connection.topic)
        kind = TopicType(connection.message_type, "ros1msg", "ros1")
        known = types.setdefault(connection.topic, [])
        if kind not in known:
            known.append(kind)
    measured = measure(timeline, types)
    named = [(one.topic, one.message_type, one.publisher) for one in connections.values()]
    return RecordingSummary(
        format=RecordingFormat.rosbag1,
        content=Content.indexed,
        message_count=measured.message_count,
        start_ns=measured.start_ns,
        end_ns=measured.end_ns,
        compression=tuple(sorted(compression)),
        topics=measured.topics,
        problems=bounded([*problems, *tell_doubled(named), *measured.problems]),
        profile="ros1",
    )
