"""The records of a ROS 1 bag 2.0: headers, connections, chunk infos, index data.

Source: wiki.ros.org/Bags/Format/2.0. A record is a header (fields `name=value`, each with its length) and data.
"""

from __future__ import annotations

import struct
import sys
from array import array
from enum import IntEnum
from typing import NamedTuple

from kleinkram.recordings.chunk_table import ChunkHead
from kleinkram.recordings.errors import Malformed
from kleinkram.recordings.limits import MAX_HEADER, MAX_NAME
from kleinkram.recordings.messages import Properties
from kleinkram.recordings.streams import ByteStream

MAGIC = b"#ROSBAG V2.0\n"
CHUNK_HEAD_BYTES = 64
"""Enough for the header of a chunk record as every known writer writes it, with the length of its data."""

_U32 = struct.Struct("<I")
_U64 = struct.Struct("<Q")
INDEX_ENTRY_BYTES = 12
_INDEX_HEAD_BYTES = 4 + (4 + 4) + (4 + 8) + (4 + 9) + (4 + 10) + 4


class Op(IntEnum):
    """The type of a record."""

    MESSAGE_DATA = 2
    BAG_HEADER = 3
    INDEX_DATA = 4
    CHUNK = 5
    CHUNK_INFO = 6
    CONNECTION = 7


class Fields:
    """The fields of a record's header; a missing or short one is `Malformed`."""

    def __init__(self, raw: bytes, where: str) -> None:
        self._where = where
        self._values: dict[bytes, bytes] = {}
        at = 0
        while at < len(raw):
            if at + _U32.size > len(raw):
                raise Malformed(where, "a header that ends within a field")
            (length,) = _U32.unpack_from(raw, at)
            at += _U32.size
            name, equals, value = raw[at : at + length].partition(b"=")
            if at + length > len(raw) or not equals:
                raise Malformed(where, "a header with a damaged field")
            self._values[name] = value
            at += length

    def u32(self, name: str) -> int:
        """Return a 4-byte field."""
        return self._number(name, _U32)

    def u64(self, name: str) -> int:
        """Return an 8-byte field."""
        return self._number(name, _U64)

    def time_ns(self, name: str) -> int:
        """Return a time (seconds, nanoseconds) in nanoseconds."""
        both = self.u64(name)
        return (both & 0xFFFFFFFF) * 1_000_000_000 + (both >> 32)

    def opcode(self) -> int:
        """Return the type of the record."""
        raw = self._raw("op")
        if len(raw) != 1:
            raise Malformed(self._where, "a record without a type")
        return raw[0]

    def text(self, name: str, default: str | None = None) -> str:
        """Return a text; bytes that are not UTF-8 are replaced."""
        if default is not None and name.encode() not in self._values:
            return default
        raw = self._raw(name)
        if len(raw) > MAX_NAME:
            raise Malformed(self._where, f"a {name} of {len(raw)} bytes; at most {MAX_NAME} are read", certain=False)
        return raw.decode("utf-8", "replace")

    def blob(self, name: str) -> bytes:
        """Return a field as bytes; empty if it is missing."""
        return self._values.get(name.encode(), b"")

    def _raw(self, name: str) -> bytes:
        try:
            return self._values[name.encode()]
        except KeyError:
            raise Malformed(self._where, f"a record without the field '{name}'") from None

    def _number(self, name: str, layout: struct.Struct) -> int:
        raw = self._raw(name)
        if len(raw) != layout.size:
            raise Malformed(self._where, f"the field '{name}' has {len(raw)} bytes instead of {layout.size}")
        number: int = layout.unpack(raw)[0]
        return number


_PROPERTIES = ("callerid", "latching", "md5sum")
_MD5_OF_NOTHING = "d41d8cd98f00b204e9800998ecf8427e"
"""The md5sum of a type without fields: its empty definition is no missing one."""


class Connection(NamedTuple):
    """A topic as one publisher writes it. `definition`: the text of its message type. `properties`: other fields."""

    topic: str
    message_type: str
    definition: bytes = b""
    properties: Properties = ()

    @property
    def publisher(self) -> str:
        """Its node; may be empty."""
        return dict(self.properties).get("callerid", "")


class ChunkInfo(NamedTuple):
    """A chunk in the index. `counts`: messages by connection."""

    position: int
    first_ns: int
    last_ns: int
    counts: dict[int, int]


def read_fields(stream: ByteStream) -> tuple[Fields, int]:
    """Read a record up to its data; return its header and the length of the data."""
    where = f"byte {stream.position}"
    (length,) = _U32.unpack(stream.take(_U32.size))
    if length > MAX_HEADER:
        raise Malformed(where, f"a header of {length} bytes; at most {MAX_HEADER} are read")
    fields = Fields(stream.take(length), where)
    (data_bytes,) = _U32.unpack(stream.take(_U32.size))
    return fields, data_bytes


def read_connection(fields: Fields, data: bytes, where: str) -> tuple[int, Connection]:
    """Return number and content of a connection record."""
    inner = Fields(data, where)
    topic = fields.text("topic") or inner.text("topic", "")
    definition = inner.blob("message_definition")
    if not definition.strip() and inner.text("md5sum", "") == _MD5_OF_NOTHING:
        definition = b"# no fields\n"
    properties = tuple((name, inner.text(name)) for name in _PROPERTIES if inner.blob(name))
    return fields.u32("conn"), Connection(topic, inner.text("type"), definition, properties)


def read_chunk_info(fields: Fields, data: bytes, where: str) -> ChunkInfo:
    """Return a chunk info record."""
    if len(data) != 8 * fields.u32("count"):
        raise Malformed(where, "a chunk info whose length does not fit its count")
    flat = array_u32(data)
    counts: dict[int, int] = {}
    for number, count in zip(flat[0::2], flat[1::2], strict=True):
        counts[number] = counts.get(number, 0) + count
    return ChunkInfo(fields.u64("chunk_pos"), fields.time_ns("start_time"), fields.time_ns("end_time"), counts)


def index_data_bytes(connections: int, messages: int) -> int:
    """Return the size of the index data records behind a chunk, as every known writer writes them."""
    return connections * _INDEX_HEAD_BYTES + messages * INDEX_ENTRY_BYTES


def chunk_head(fields: Fields, data_start: int, data_bytes: int) -> ChunkHead:
    """Return the head of a chunk by the fields of its header."""
    compression = fields.text("compression")
    return ChunkHead("" if compression == "none" else compression, fields.u32("size"), 0, data_start, data_bytes)


def open_chunk(stream: ByteStream) -> ChunkHead:
    """Read a chunk record up to its stored bytes."""
    start = stream.position
    fields, data_bytes = read_fields(stream)
    if fields.opcode() != Op.CHUNK:
        raise Malformed(f"byte {start}", f"a record of type {fields.opcode()} where a chunk should be")
    return chunk_head(fields, stream.position - start, data_bytes)


def read_index_data(stream: ByteStream) -> tuple[int, list[int], array[int]]:
    """Read an index data record; return connection, log times, and offsets in the uncompressed chunk."""
    where = f"byte {stream.position}"
    fields, data_bytes = read_fields(stream)
    if fields.opcode() != Op.INDEX_DATA or fields.u32("ver") != 1:
        raise Malformed(where, "another record instead of index data")
    if data_bytes != INDEX_ENTRY_BYTES * fields.u32("count"):
        raise Malformed(where, "index data whose length does not fit its count")
    flat = array_u32(stream.take(data_bytes))
    stamps = [s * 1_000_000_000 + n for s, n in zip(flat[0::3], flat[1::3], strict=True)]
    return fields.u32("conn"), stamps, flat[2::3]


def array_u32(data: bytes) -> array[int]:
    """Return little-endian 32-bit numbers."""
    numbers = array("I", data)
    if sys.byteorder == "big":
        numbers.byteswap()
    return numbers
