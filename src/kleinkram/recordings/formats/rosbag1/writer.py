"""Writing a ROS 1 bag 2.0: chunked and indexed; streaming, with one chunk in memory and 12 bytes a message of index.

Source: wiki.ros.org/Bags/Format/2.0.
"""

from __future__ import annotations

import bz2
import struct
from array import array
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from typing import BinaryIO

import lz4.frame

from kleinkram.recordings.formats.rosbag1 import records
from kleinkram.recordings.formats.rosbag1.records import Op

CHUNK_BYTES = 768 * 1024
_BAG_HEADER_BYTES = 4096
_LZ4_BLOCK_1MB = 6


class BagCompression(str, Enum):
    """Compression of chunks, as bags spell it."""

    none = "none"
    bz2 = "bz2"
    lz4 = "lz4"


@dataclass
class _BagChunk:
    """The chunk being filled."""

    pieces: list[bytes] = field(default_factory=list)
    size: int = 0
    times: list[int] = field(default_factory=list)
    index: dict[int, array[int]] = field(default_factory=dict)


class BagWriter:
    """Writes to a seekable file opened for binary writing; call `finish` at the end, or the bag is not indexed.

    Attributes:
        bytes_written: size of the file so far, with an estimate for the chunk being filled.
    """

    def __init__(
        self, file: BinaryIO, *, compression: BagCompression = BagCompression.lz4, chunk_bytes: int = CHUNK_BYTES
    ) -> None:
        self._file = file
        self._compression = compression
        self._compress = _compressor(compression)
        self._chunk_bytes = chunk_bytes
        self._chunk = _BagChunk()
        self._position = 0
        self._raw_bytes = self._stored_bytes = 0
        self._connections: list[bytes] = []
        self._chunk_infos: list[bytes] = []
        self._put(records.MAGIC)
        self._put(_bag_header(0, 0, 0))

    @property
    def bytes_written(self) -> int:
        """Size of the file so far; of the chunk being filled, what it will be if it compresses like those before."""
        if not self._raw_bytes:
            return self._position + self._chunk.size
        return self._position + self._chunk.size * self._stored_bytes // self._raw_bytes

    def add_connection(self, topic: str, message_type: str, *, md5sum: str, definition: str) -> int:
        """Define a topic; returns its number, to be used for messages."""
        number = len(self._connections)
        data = _fields(topic=topic.encode(), type=message_type.encode(), md5sum=md5sum.encode())
        data += _fields(message_definition=definition.encode())
        head = _fields(op=bytes([Op.CONNECTION]), conn=_u32(number), topic=topic.encode())
        record = _record(head, data)
        self._connections.append(record)
        self._chunk.pieces.append(record)
        self._chunk.size += len(record)
        return number

    def add_message(self, connection: int, log_time_ns: int, payload: bytes) -> None:
        """Add a message; messages are in the file in the order in which they are added."""
        chunk = self._chunk
        seconds, nanoseconds = divmod(log_time_ns, 1_000_000_000)
        index = chunk.index.get(connection)
        if index is None:
            index = chunk.index[connection] = array("I")
        index.extend((seconds, nanoseconds, chunk.size))
        chunk.times.append(log_time_ns)
        time = struct.pack("<II", seconds, nanoseconds)
        head = _fields(op=bytes([Op.MESSAGE_DATA]), conn=_u32(connection), time=time)
        front = _u32(len(head)) + head + _u32(len(payload))
        chunk.pieces.append(front)
        chunk.pieces.append(payload)
        chunk.size += len(front) + len(payload)
        if chunk.size >= self._chunk_bytes:
            self._flush()

    def finish(self) -> None:
        """Write what is left and the index. The file is not closed."""
        self._flush()
        index_start = self._position
        for record in (*self._connections, *self._chunk_infos):
            self._put(record)
        self._file.seek(len(records.MAGIC))
        self._file.write(_bag_header(index_start, len(self._connections), len(self._chunk_infos)))
        self._file.seek(0, 2)

    def _flush(self) -> None:
        chunk = self._chunk
        if not chunk.index:
            return
        stored = self._compress(b"".join(chunk.pieces))
        self._raw_bytes += chunk.size
        self._stored_bytes += len(stored)
        start = self._position
        compression = self._compression.value.encode()
        head = _fields(op=bytes([Op.CHUNK]), compression=compression, size=_u32(chunk.size))
        self._put(_u32(len(head)) + head + _u32(len(stored)))
        self._put(stored)
        counts: list[bytes] = []
        for connection, index in chunk.index.items():
            count = len(index) // 3
            counts.append(_u32(connection) + _u32(count))
            head = _fields(op=bytes([Op.INDEX_DATA]), ver=_u32(1), conn=_u32(connection), count=_u32(count))
            self._put(_record(head, struct.pack(f"<{len(index)}I", *index)))
        self._chunk_infos.append(_record(_chunk_info_head(start, chunk, len(counts)), b"".join(counts)))
        self._chunk = _BagChunk()

    def _put(self, data: bytes) -> None:
        self._file.write(data)
        self._position += len(data)


def _chunk_info_head(start: int, chunk: _BagChunk, connections: int) -> bytes:
    return _fields(
        op=bytes([Op.CHUNK_INFO]),
        ver=_u32(1),
        chunk_pos=struct.pack("<Q", start),
        start_time=_time(min(chunk.times)),
        end_time=_time(max(chunk.times)),
        count=_u32(connections),
    )


def _bag_header(index_start: int, connections: int, chunks: int) -> bytes:
    """Return the bag header record, padded so that it can be overwritten in place."""
    head = _fields(
        op=bytes([Op.BAG_HEADER]),
        index_pos=struct.pack("<Q", index_start),
        conn_count=_u32(connections),
        chunk_count=_u32(chunks),
    )
    return _record(head, b" " * (_BAG_HEADER_BYTES - 8 - len(head)))


def _compressor(compression: BagCompression) -> Callable[[bytes], bytes]:
    if compression is BagCompression.bz2:
        return bz2.compress
    if compression is BagCompression.lz4:
        # Independent blocks of 1 MB with a checksum: what ROS itself writes, and the only kind that it reads.
        return lambda raw: bytes(
            lz4.frame.compress(
                raw, block_size=_LZ4_BLOCK_1MB, block_linked=False, content_checksum=True, store_size=False
            )
        )
    return bytes


def _fields(**values: bytes) -> bytes:
    return b"".join(_u32(len(name) + 1 + len(value)) + name.encode() + b"=" + value for name, value in values.items())


def _record(head: bytes, data: bytes) -> bytes:
    return _u32(len(head)) + head + _u32(len(data)) + data


def _time(time_ns: int) -> bytes:
    return struct.pack("<II", *divmod(time_ns, 1_000_000_000))


def _u32(number: int) -> bytes:
    return struct.pack("<I", number)
