"""The records of MCAP: what stands in a record's body. No reading of files, no judgement of whole files.

Source: MCAP format specification, version 0 (mcap.dev/spec).
"""

from __future__ import annotations

import struct
import sys
from array import array
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

from kleinkram.recordings.chunk_table import ANY_CHANNEL, ChannelSets, PackedTable
from kleinkram.recordings.compression import is_known_compression
from kleinkram.recordings.errors import Malformed
from kleinkram.recordings.index_check import IndexFaults
from kleinkram.recordings.limits import MAX_DAMAGE, MAX_FACTS, MAX_NAME, MAX_NAMES, MAX_TOPICS
from kleinkram.recordings.message_counts import Listener
from kleinkram.recordings.model import Fact

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = range(1, 9)
ATTACHMENT, ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = range(9, 16)
RECORD_HEAD = struct.Struct("<BQ")
FOOTER_BODY = struct.Struct("<QQI")
FOOTER_BYTES = RECORD_HEAD.size + FOOTER_BODY.size + len(MAGIC)
PLACEHOLDER = 2**64 - 1
"""What stands for the length of a record or of data while it is being written (mcap-rs): a recorder that was killed
leaves it."""
STATISTICS_BODY = struct.Struct("<QHIIIIQQ")
_CHUNK_PLACE = struct.Struct("<QQQQ")
_CHANNEL_AND_U64 = struct.Struct("<HQ")
_ATTACHMENT_PLACE = struct.Struct("<QQQQQ")


class Schema(NamedTuple):
    """A message type, without its text."""

    name: str
    encoding: str


class Channel(NamedTuple):
    """A topic as one publisher writes it."""

    schema_id: int
    topic: str
    message_encoding: str
    publisher: str = ""


class Statistics(NamedTuple):
    """What the writer counted."""

    messages: int
    channels: int
    attachments: int
    metadata_records: int
    start_ns: int
    end_ns: int
    counts: tuple[tuple[int, int], ...]


class ChunkPlace(NamedTuple):
    """A chunk and its message indexes in the file: [start, index_start) and [index_start, end).

    `channels`: number of the set of those that the index lists.
    """

    start: int
    index_start: int
    end: int
    first_ns: int
    last_ns: int
    channels: int
    compressed_bytes: int
    uncompressed_bytes: int


class McapListener(Listener, Protocol):
    """Is told of definitions, too."""

    def define(self, opcode: int, body: bytes, where: str, /) -> None:
        """Take note of a schema or a channel."""


@dataclass
class McapFacts:
    """What the records of one file said so far.

    Attributes:
        listener: is told of what the facts leave out: the text of definitions, and where the messages stand.
        index_faults: what the index says of chunks that is not so.
        unknown_compression: by the start of a chunk, a compression that its index names and that is not read.
    """

    library: str = ""
    profile: str = ""
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    statistics: Statistics | None = None
    sets: ChannelSets = field(default_factory=ChannelSets)
    chunks: PackedTable[ChunkPlace] = field(default_factory=lambda: PackedTable(ChunkPlace, len(ChunkPlace._fields)))
    names_bytes: int = 0
    compression: set[str] = field(default_factory=set)
    index_faults: IndexFaults = field(default_factory=IndexFaults)
    unknown_compression: dict[int, str] = field(default_factory=dict)
    attachments: int = 0
    metadata_records: int = 0
    listed: list[Fact] = field(default_factory=list)
    listener: McapListener | None = None


class BodyReader:
    """Fields of one record's body, in order.

    Raises:
        Malformed: from every method, where a field reaches beyond the body.
    """

    def __init__(self, body: bytes, where: str) -> None:
        self._body = body
        self._at = 0
        self._where = where

    def fields(self, layout: struct.Struct) -> tuple[int, ...]:
        """Read fixed fields."""
        self._need(layout.size)
        values: tuple[int, ...] = layout.unpack_from(self._body, self._at)
        self._at += layout.size
        return values

    def text(self) -> str:
        """Read a string; bytes that are not UTF-8 are replaced, so that a name can always be shown."""
        (length,) = self.fields(_U32)
        if length > MAX_NAME:
            raise Malformed(self._where, f"a name of {length} bytes; at most {MAX_NAME} are read", certain=False)
        return self.blob(length).decode("utf-8", "replace")

    def blob(self, length: int) -> bytes:
        """Read `length` bytes."""
        self._need(length)
        data = self._body[self._at : self._at + length]
        self._at += length
        return data

    def counted(self) -> bytes:
        """Read bytes that follow their length."""
        (length,) = self.fields(_U32)
        return self.blob(length)

    @property
    def left(self) -> int:
        """Bytes behind the fields that were read."""
        return len(self._body) - self._at

    def _need(self, length: int) -> None:
        if self._at + length > len(self._body):
            raise Malformed(self._where, "a field reaches beyond its record")


_U16 = struct.Struct("<H")
_U32 = struct.Struct("<I")
_U64 = struct.Struct("<Q")
_PAIR_U16 = struct.Struct("<HH")
_PAIR_U64 = struct.Struct("<QQ")


def read_header(facts: McapFacts, body: bytes, where: str) -> None:
    """Note profile and library."""
    reader = BodyReader(body, where)
    facts.profile = reader.text()
    facts.library = reader.text()


def read_schema(facts: McapFacts, body: bytes, where: str) -> None:
    """Note a schema; the first of an id counts. The body may be cut behind the encoding."""
    reader = BodyReader(body, where)
    (schema_id,) = reader.fields(_U16)
    schema = Schema(reader.text(), reader.text())
    if schema_id not in facts.schemas:
        _count_names(facts, where, *schema)
        facts.schemas[schema_id] = schema


def read_channel(facts: McapFacts, body: bytes, where: str) -> None:
    """Note a channel; the first of an id counts. The body may be cut behind the encoding."""
    reader = BodyReader(body, where)
    channel_id, schema_id = reader.fields(_PAIR_U16)
    channel = Channel(schema_id, reader.text(), reader.text(), _publisher(reader))
    if channel_id not in facts.channels:
        if len(facts.channels) >= MAX_TOPICS:
            raise Malformed(where, f"more than {MAX_TOPICS} channels", certain=False)
        _count_names(facts, where, channel.topic, channel.message_encoding, channel.publisher)
        facts.channels[channel_id] = channel


def _publisher(reader: BodyReader) -> str:
    """Return who publishes a channel, by the metadata that a conversion from ROS 1 leaves; empty where unknown."""
    try:
        metadata = BodyReader(reader.counted(), "")
        while metadata.left:
            key, value = metadata.text(), metadata.text()
            if key == "callerid":
                return value
    except Malformed:
        pass  # cut, or damaged: nothing else depends on it
    return ""


def _count_names(facts: McapFacts, where: str, *names: str) -> None:
    facts.names_bytes += sum(map(len, names))
    if facts.names_bytes > MAX_NAMES:
        raise Malformed(where, f"more than {MAX_NAMES} bytes of names", certain=False)


def read_statistics(facts: McapFacts, body: bytes, where: str) -> None:
    """Note the statistics."""
    reader = BodyReader(body, where)
    messages, _schemas, channels, attachments, metadata, _chunks, *span = reader.fields(STATISTICS_BODY)
    counts = reader.counted()
    if len(counts) % _CHANNEL_AND_U64.size:
        raise Malformed(where, "statistics that end within an entry")
    by_channel = tuple((number, count) for number, count in _CHANNEL_AND_U64.iter_unpack(counts))
    facts.statistics = Statistics(messages, channels, attachments, metadata, span[0], span[1], by_channel)


def read_attachment(facts: McapFacts, body: bytes, where: str) -> None:
    """Note an attachment. The body may be cut behind the size of its data."""
    reader = BodyReader(body, where)
    reader.fields(_PAIR_U64)
    name, media_type = reader.text(), reader.text()
    _note_attachment(facts, name, media_type, reader.fields(_U64)[0])


def read_attachment_index(facts: McapFacts, body: bytes, where: str) -> None:
    """Note an attachment, by its index."""
    reader = BodyReader(body, where)
    size_bytes = reader.fields(_ATTACHMENT_PLACE)[4]
    _note_attachment(facts, reader.text(), reader.text(), size_bytes)


def _note_attachment(facts: McapFacts, name: str, media_type: str, size_bytes: int) -> None:
    facts.attachments += 1
    if len(facts.listed) < MAX_FACTS:
        facts.listed.append(Fact("attachment", f"{name} ({media_type or 'of no type'}, {size_bytes} bytes)"))


def read_metadata(facts: McapFacts, body: bytes, where: str) -> None:
    """Note a metadata record. The body may be cut behind the name."""
    _note_metadata(facts, BodyReader(body, where).text())


def read_metadata_index(facts: McapFacts, body: bytes, where: str) -> None:
    """Note a metadata record, by its index."""
    reader = BodyReader(body, where)
    reader.fields(_PAIR_U64)
    _note_metadata(facts, reader.text())


def _note_metadata(facts: McapFacts, name: str) -> None:
    facts.metadata_records += 1
    if len(facts.listed) < MAX_FACTS:
        facts.listed.append(Fact("metadata", name))


def read_chunk_index(facts: McapFacts, body: bytes, where: str) -> None:
    """Note where a chunk and its message indexes stand."""
    reader = BodyReader(body, where)
    first_ns, last_ns, start, length = reader.fields(_CHUNK_PLACE)
    offsets = reader.counted()
    if len(offsets) % _CHANNEL_AND_U64.size:
        raise Malformed(where, "a chunk index that ends within an entry")
    channel_ids = [number for number, _ in _CHANNEL_AND_U64.iter_unpack(offsets)]
    channels = facts.sets.number(channel_ids) if channel_ids else ANY_CHANNEL
    (index_length,) = reader.fields(_U64)
    compression = reader.text()
    facts.compression.add(compression or "none")
    if not is_known_compression(compression):
        if len(facts.unknown_compression) >= MAX_DAMAGE:
            raise Malformed(where, f"more than {MAX_DAMAGE} chunks that are not read", certain=False)
        facts.unknown_compression[start] = compression
    compressed, uncompressed = reader.fields(_PAIR_U64)
    index_start = start + length
    end = index_start + index_length
    facts.chunks.append(ChunkPlace(start, index_start, end, first_ns, last_ns, channels, compressed, uncompressed))


def read_message_index(body: bytes, where: str) -> tuple[int, array[int], array[int]]:
    """Return channel id, log times and offsets (in the uncompressed chunk) of a message index."""
    reader = BodyReader(body, where)
    (channel_id,) = reader.fields(_U16)
    entries = reader.counted()
    if len(entries) % 16:
        raise Malformed(where, "a message index that ends within an entry")
    flat = array("Q", entries)
    if sys.byteorder == "big":
        flat.byteswap()
    return channel_id, flat[0::2], flat[1::2]
