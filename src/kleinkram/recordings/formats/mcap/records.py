"""MCAP records: parsing of record bodies.

Source: MCAP format specification, version 0 (mcap.dev/spec).
"""

from __future__ import annotations

import struct
import sys
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import IntEnum
from typing import NamedTuple

from kleinkram.recordings.chunk_scanner import ChunkedFacts
from kleinkram.recordings.chunk_table import ANY_CHANNEL, Row
from kleinkram.recordings.compression import is_known_compression
from kleinkram.recordings.errors import Malformed
from kleinkram.recordings.limits import MAX_DAMAGE, MAX_DEFINITIONS, MAX_FACTS, MAX_NAME, MAX_NAMES, MAX_TOPICS
from kleinkram.recordings.messages import Channel, Properties, Schema
from kleinkram.recordings.model import Fact
from kleinkram.recordings.scanned_messages import LocationKind
from kleinkram.recordings.streams import ByteStream

MAGIC = b"\x89MCAP0\r\n"
RECORD_HEAD = struct.Struct("<BQ")
FOOTER_BODY = struct.Struct("<QQI")
FOOTER_BYTES = RECORD_HEAD.size + FOOTER_BODY.size + len(MAGIC)
MAX_OUTSIDE_CHUNKS = 200_000  # attachments and metadata records that an index may list

PLACEHOLDER = 2**64 - 1
"""The length of a record or of data while it is being written (mcap-rs); it remains if the recorder is killed."""
STATISTICS_BODY = struct.Struct("<QHIIIIQQ")
_CHUNK_PLACE = struct.Struct("<QQQQ")
_CHANNEL_AND_U64 = struct.Struct("<HQ")
_ATTACHMENT_PLACE = struct.Struct("<QQQQQ")


class Opcode(IntEnum):
    """The type of a record."""

    HEADER = 1
    FOOTER = 2
    SCHEMA = 3
    CHANNEL = 4
    MESSAGE = 5
    CHUNK = 6
    MESSAGE_INDEX = 7
    CHUNK_INDEX = 8
    ATTACHMENT = 9
    ATTACHMENT_INDEX = 10
    STATISTICS = 11
    METADATA = 12
    METADATA_INDEX = 13
    SUMMARY_OFFSET = 14
    DATA_END = 15


class ChannelRecord(NamedTuple):
    """A channel. `properties`: its metadata."""

    schema_id: int
    topic: str
    message_encoding: str
    properties: Properties = ()

    @property
    def publisher(self) -> str:
        """Its ROS 1 node, from the metadata that a conversion leaves; may be empty."""
        return dict(self.properties).get("callerid", "")


class Statistics(NamedTuple):
    """Statistics record. `counts`: messages by channel id."""

    messages: int
    channels: int
    attachments: int
    metadata_records: int
    chunks: int
    start_ns: int
    end_ns: int
    counts: tuple[tuple[int, int], ...]


NO_SCHEMA = Schema("", "", b"")


@dataclass
class McapFacts(ChunkedFacts[ChannelRecord]):
    """Definitions and counts of the records of a file.

    `unknown_compression`: by the start of a chunk. `outside_chunks`: indexed offsets of attachments and metadata.
    """

    library: str = ""
    profile: str = ""
    schemas: dict[int, Schema] = field(default_factory=dict)
    statistics: Statistics | None = None
    unknown_compression: dict[int, str] = field(default_factory=dict)
    attachments: int = 0
    metadata_records: int = 0
    listed: list[Fact] = field(default_factory=list)
    outside_chunks: list[tuple[int, int]] = field(default_factory=list)
    header_damage: Malformed | None = None
    properties_bytes: int = 0

    def schema_of(self, channel: ChannelRecord) -> Schema:
        """Return the schema of a channel; an empty one where the file lacks it."""
        return self.schemas.get(channel.schema_id, NO_SCHEMA)

    def resolve_channels(self, message_compression: str = "") -> dict[int, Channel]:
        """Return the channels with their schemas."""
        return {
            number: Channel(one.topic, one.message_encoding, self.schema_of(one), message_compression, one.properties)
            for number, one in self.channels.items()
        }


class BodyReader:
    """Reads the fields of a record body in order; one that reaches beyond the body is `Malformed`."""

    def __init__(self, body: bytes, where: str) -> None:
        self._body = body
        self._at = 0
        self._where = where

    def fields(self, layout: struct.Struct) -> tuple[int, ...]:
        """Read fixed fields."""
        values: tuple[int, ...] = layout.unpack(self.blob(layout.size))
        return values

    def text(self) -> str:
        """Read a string; invalid UTF-8 is replaced."""
        (length,) = self.fields(_U32)
        if length > MAX_NAME:
            raise Malformed(self._where, f"a name of {length} bytes; at most {MAX_NAME} are read", certain=False)
        return self.blob(length).decode("utf-8", "replace")

    def raw_text(self) -> bytes:
        """Read a string; return its bytes behind their length."""
        text = self.counted()
        return _U32.pack(len(text)) + text

    def blob(self, length: int) -> bytes:
        """Read `length` bytes."""
        if length > self.left:
            raise Malformed(self._where, "a field reaches beyond its record")
        self._at += length
        return self._body[self._at - length : self._at]

    def counted(self) -> bytes:
        """Read length-prefixed bytes."""
        (length,) = self.fields(_U32)
        return self.blob(length)

    @property
    def left(self) -> int:
        """Unread bytes."""
        return len(self._body) - self._at


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
    """Note a schema; the first of an id counts. The body may be cut after the encoding; then it has no text."""
    reader = BodyReader(body, where)
    (schema_id,) = reader.fields(_U16)
    name, encoding = reader.text(), reader.text()
    if schema_id in facts.schemas:
        return
    _count_names(facts, where, name, encoding)
    try:
        text = reader.counted()
    except Malformed:
        text = b""
    facts.definition_bytes += len(text)
    facts.schemas[schema_id] = Schema(name, encoding, text if facts.definition_bytes <= MAX_DEFINITIONS else b"")


def read_channel(facts: McapFacts, body: bytes, where: str) -> None:
    """Note a channel; the first of an id counts. The body may be cut after the encoding."""
    reader = BodyReader(body, where)
    channel_id, schema_id = reader.fields(_PAIR_U16)
    topic, message_encoding = reader.text(), reader.text()
    if channel_id in facts.channels:
        return
    if len(facts.channels) >= MAX_TOPICS:
        raise Malformed(where, f"more than {MAX_TOPICS} channels", certain=False)
    _count_names(facts, where, topic, message_encoding)
    properties = _read_properties(facts, reader)
    facts.channels[channel_id] = ChannelRecord(schema_id, topic, message_encoding, properties)


def _read_properties(facts: McapFacts, reader: BodyReader) -> Properties:
    """Return the metadata of a channel, as far as it can be read; none beyond `MAX_NAMES` bytes of them in a file."""
    properties: list[tuple[str, str]] = []
    try:
        body = reader.counted()
        facts.properties_bytes += len(body)
        entries = BodyReader(body, "")
        while entries.left and facts.properties_bytes <= MAX_NAMES:
            name, value = entries.text(), entries.counted().decode("utf-8", "replace")
            properties.append((name, value))
    except Malformed:
        pass  # cut, or damaged: nothing else depends on it
    return tuple(properties)


def _count_names(facts: McapFacts, where: str, *names: str) -> None:
    facts.names_bytes += sum(map(len, names))
    if facts.names_bytes > MAX_NAMES:
        raise Malformed(where, f"more than {MAX_NAMES} bytes of names", certain=False)


def read_statistics(facts: McapFacts, body: bytes, where: str) -> None:
    """Note the statistics."""
    reader = BodyReader(body, where)
    messages, _schemas, channels, attachments, metadata, chunks, *span = reader.fields(STATISTICS_BODY)
    counts = reader.counted()
    if len(counts) % _CHANNEL_AND_U64.size:
        raise Malformed(where, "statistics that end within an entry")
    by_channel = tuple((number, count) for number, count in _CHANNEL_AND_U64.iter_unpack(counts))
    facts.statistics = Statistics(messages, channels, attachments, metadata, chunks, span[0], span[1], by_channel)


def read_attachment(facts: McapFacts, body: bytes, where: str) -> None:
    """Note an attachment. The body may be cut after the size of its data."""
    reader = BodyReader(body, where)
    reader.fields(_PAIR_U64)
    name, media_type = reader.text(), reader.text()
    _note_attachment(facts, name, media_type, reader.fields(_U64)[0])


def read_attachment_index(facts: McapFacts, body: bytes, where: str) -> None:
    """Note an attachment, by its index."""
    reader = BodyReader(body, where)
    start, length, _log_time, _create_time, size_bytes = reader.fields(_ATTACHMENT_PLACE)
    _note_outside_chunks(facts, start, start + length, where)
    _note_attachment(facts, reader.text(), reader.text(), size_bytes)


def _note_attachment(facts: McapFacts, name: str, media_type: str, size_bytes: int) -> None:
    facts.attachments += 1
    if len(facts.listed) < MAX_FACTS:
        facts.listed.append(Fact("attachment", f"{name} ({media_type or 'of no type'}, {size_bytes} bytes)"))


def read_metadata(facts: McapFacts, body: bytes, where: str) -> None:
    """Note a metadata record. The body may be cut after the name."""
    name = BodyReader(body, where).text()
    facts.metadata_records += 1
    if len(facts.listed) < MAX_FACTS:
        facts.listed.append(Fact("metadata", name))


def read_metadata_index(facts: McapFacts, body: bytes, where: str) -> None:
    """Note a metadata record, by its index."""
    start, length = BodyReader(body, where).fields(_PAIR_U64)
    _note_outside_chunks(facts, start, start + length, where)
    read_metadata(facts, body[_PAIR_U64.size :], where)


def _note_outside_chunks(facts: McapFacts, start: int, end: int, where: str) -> None:
    if len(facts.outside_chunks) >= MAX_OUTSIDE_CHUNKS:
        raise Malformed(where, f"more than {MAX_OUTSIDE_CHUNKS} attachments and metadata", certain=False)
    facts.outside_chunks.append((start, end))


def read_chunk_index(facts: McapFacts, body: bytes, where: str) -> None:
    """Note a chunk."""
    reader = BodyReader(body, where)
    first_ns, last_ns, start, length = reader.fields(_CHUNK_PLACE)
    offsets = reader.counted()
    if len(offsets) % _CHANNEL_AND_U64.size:
        raise Malformed(where, "a chunk index that ends within an entry")
    channel_ids = [number for number, _ in _CHANNEL_AND_U64.iter_unpack(offsets)]
    channels = facts.table.sets.number(channel_ids) if channel_ids else ANY_CHANNEL
    (index_length,) = reader.fields(_U64)
    compression = reader.text()
    facts.compression.add(compression or "none")
    if not is_known_compression(compression):
        if len(facts.unknown_compression) >= MAX_DAMAGE:
            raise Malformed(where, f"more than {MAX_DAMAGE} chunks that are not read", certain=False)
        facts.unknown_compression[start] = compression
    stored, uncompressed = reader.fields(_PAIR_U64)
    end = start + length + index_length
    facts.table.rows.append(
        Row(start, length, end, first_ns, last_ns, LocationKind.chunk, channels, uncompressed, stored)
    )


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


def read_message_indexes(stream: ByteStream) -> Iterator[tuple[int, array[int], array[int]]]:
    """Yield what `read_message_index` returns for each record of a stream, which has no others."""
    while not stream.at_end():
        where = f"byte {stream.position}"
        opcode, length = RECORD_HEAD.unpack(stream.take(RECORD_HEAD.size))
        if opcode != Opcode.MESSAGE_INDEX:
            raise Malformed(where, f"a record of type {opcode} where a message index should be")
        yield read_message_index(stream.take(length), where)
