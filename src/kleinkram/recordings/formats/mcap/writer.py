"""Writing an MCAP: chunked, indexed, every CRC; streaming, with one chunk in memory and 16 bytes a message of index.

Source: MCAP format specification, version 0 (mcap.dev/spec).
"""

from __future__ import annotations

import struct
import zlib
from array import array
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from typing import BinaryIO

import lz4.frame
import zstandard

from kleinkram.recordings.formats.mcap import records
from kleinkram.recordings.formats.mcap.records import Opcode

CHUNK_BYTES = 2**20
LIBRARY = "kleinkram"
_MESSAGE = struct.Struct("<BQHIQQ")
_MESSAGE_FIXED_BYTES = _MESSAGE.size - records.RECORD_HEAD.size
_CHUNK_FIXED = struct.Struct("<QQQI")
_PLACE = struct.Struct("<QQQQ")
_STATISTICS = struct.Struct("<QHIIIIQQ")


class Compression(str, Enum):
    """Compression of chunks, as MCAP spells it."""

    none = ""
    lz4 = "lz4"
    zstd = "zstd"


@dataclass
class _McapChunk:
    """The chunk being filled."""

    pieces: list[bytes] = field(default_factory=list)
    size: int = 0
    first_ns: int = 2**64 - 1
    last_ns: int = 0
    index: dict[int, array[int]] = field(default_factory=dict)


class McapWriter:
    """Writes to a file opened for binary writing; call `finish` at the end, or the file has no index.

    Attributes:
        bytes_written: size of the file so far, with an estimate for the chunk being filled.
    """

    def __init__(
        self,
        file: BinaryIO,
        *,
        profile: str = "",
        library: str = LIBRARY,
        compression: Compression = Compression.zstd,
        chunk_bytes: int = CHUNK_BYTES,
    ) -> None:
        self._file = file
        self._compression = compression
        self._compress = _compressor(compression)
        self._chunk_bytes = chunk_bytes
        self._chunk = _McapChunk()
        self._position = 0
        self._raw_bytes = self._stored_bytes = 0
        self._crc = 0
        self._definitions: list[bytes] = []
        self._chunk_indexes: list[bytes] = []
        self._counts: dict[int, int] = {}
        self._schemas = 0
        self._span = (2**64 - 1, 0)
        self._put(records.MAGIC)
        self._put(_record(Opcode.HEADER, _text(profile) + _text(library)))

    @property
    def bytes_written(self) -> int:
        """Size of the file so far; of the chunk being filled, what it will be if it compresses like those before."""
        if not self._raw_bytes:
            return self._position + self._chunk.size
        return self._position + self._chunk.size * self._stored_bytes // self._raw_bytes

    def add_schema(self, name: str, encoding: str, text: bytes) -> int:
        """Define a message type; returns its id, to be used for channels."""
        self._schemas += 1
        body = struct.pack("<H", self._schemas) + _text(name) + _text(encoding) + _counted(text)
        self._define(_record(Opcode.SCHEMA, body))
        return self._schemas

    def add_channel(self, topic: str, schema_id: int, message_encoding: str) -> int:
        """Define a topic; returns its id, to be used for messages."""
        channel_id = len(self._counts)
        body = struct.pack("<HH", channel_id, schema_id) + _text(topic) + _text(message_encoding) + _counted(b"")
        self._define(_record(Opcode.CHANNEL, body))
        self._counts[channel_id] = 0
        return channel_id

    def add_message(self, channel_id: int, log_time_ns: int, payload: bytes, *, publish_time_ns: int) -> None:
        """Add a message; messages are in the file in the order in which they are added."""
        chunk = self._chunk
        index = chunk.index.get(channel_id)
        if index is None:
            index = chunk.index[channel_id] = array("Q")
        index.append(log_time_ns)
        index.append(chunk.size)
        sequence = self._counts[channel_id]
        self._counts[channel_id] = sequence + 1
        length = _MESSAGE_FIXED_BYTES + len(payload)
        chunk.pieces.append(
            _MESSAGE.pack(Opcode.MESSAGE, length, channel_id, sequence & 0xFFFFFFFF, log_time_ns, publish_time_ns)
        )
        chunk.pieces.append(payload)
        chunk.size += records.RECORD_HEAD.size + length
        chunk.first_ns = min(chunk.first_ns, log_time_ns)
        chunk.last_ns = max(chunk.last_ns, log_time_ns)
        if chunk.size >= self._chunk_bytes:
            self._flush()

    def finish(self) -> None:
        """Write what is left, the summary and the footer. The file is not closed."""
        self._flush()
        data_end = _record(Opcode.DATA_END, struct.pack("<I", self._crc))
        self._put(data_end)
        summary_start = self._position
        self._crc = 0
        self._write_summary()
        body = struct.pack("<QQ", summary_start, 0)
        head = records.RECORD_HEAD.pack(Opcode.FOOTER, records.FOOTER_BODY.size)
        crc = zlib.crc32(head + body, self._crc)
        self._put(head + body + struct.pack("<I", crc) + records.MAGIC)

    def _write_summary(self) -> None:
        for definition in self._definitions:
            self._put(definition)
        counts = b"".join(struct.pack("<HQ", *item) for item in self._counts.items())
        total = sum(self._counts.values())
        first_ns, last_ns = self._span if total else (0, 0)
        fixed = _STATISTICS.pack(
            total, self._schemas, len(self._counts), 0, 0, len(self._chunk_indexes), first_ns, last_ns
        )
        self._put(_record(Opcode.STATISTICS, fixed + _counted(counts)))
        for chunk_index in self._chunk_indexes:
            self._put(chunk_index)

    def _define(self, record: bytes) -> None:
        self._definitions.append(record)
        self._chunk.pieces.append(record)
        self._chunk.size += len(record)

    def _flush(self) -> None:
        chunk = self._chunk
        if not chunk.size:
            return
        if not chunk.index:
            chunk.first_ns = 0
        else:
            self._span = (min(self._span[0], chunk.first_ns), max(self._span[1], chunk.last_ns))
        raw = b"".join(chunk.pieces)
        stored = self._compress(raw)
        self._raw_bytes += chunk.size
        self._stored_bytes += len(stored)
        start = self._position
        fixed = _CHUNK_FIXED.pack(chunk.first_ns, chunk.last_ns, len(raw), zlib.crc32(raw))
        head = fixed + _text(self._compression.value) + struct.pack("<Q", len(stored))
        self._put(records.RECORD_HEAD.pack(Opcode.CHUNK, len(head) + len(stored)) + head)
        self._put(stored)
        index_start = self._position
        offsets: list[bytes] = []
        for channel_id, index in chunk.index.items():
            offsets.append(struct.pack("<HQ", channel_id, self._position))
            entries = struct.pack(f"<{len(index)}Q", *index)
            self._put(_record(Opcode.MESSAGE_INDEX, struct.pack("<H", channel_id) + _counted(entries)))
        place = _PLACE.pack(chunk.first_ns, chunk.last_ns, start, index_start - start)
        sizes = struct.pack("<QQ", len(stored), len(raw))
        body = place + _counted(b"".join(offsets)) + struct.pack("<Q", self._position - index_start)
        body += _text(self._compression.value) + sizes
        self._chunk_indexes.append(_record(Opcode.CHUNK_INDEX, body))
        self._chunk = _McapChunk()

    def _put(self, data: bytes) -> None:
        self._file.write(data)
        self._crc = zlib.crc32(data, self._crc)
        self._position += len(data)


def _compressor(compression: Compression) -> Callable[[bytes], bytes]:
    if compression is Compression.zstd:
        return zstandard.ZstdCompressor(level=1).compress
    if compression is Compression.lz4:
        return lz4.frame.compress  # type: ignore[no-any-return]  # lz4 has no types
    return bytes


def _record(opcode: int, body: bytes) -> bytes:
    return records.RECORD_HEAD.pack(opcode, len(body)) + body


def _counted(data: bytes) -> bytes:
    return struct.pack("<I", len(data)) + data


def _text(text: str) -> bytes:
    return _counted(text.encode())
