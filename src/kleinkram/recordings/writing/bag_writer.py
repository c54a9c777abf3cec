"""Writer of ROS 1 bags: chunked and indexed.

Memory: that of `ChunkedWriter`; of the index, about 120 bytes and 8 for each connection of a chunk.

Source: wiki.ros.org/Bags/Format/2.0.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import BinaryIO

import lz4.frame

from kleinkram.recordings.formats.rosbag1 import records as rosbag1
from kleinkram.recordings.formats.rosbag1.records import Op
from kleinkram.recordings.messages import Properties
from kleinkram.recordings.writing.chunked_writer import Chunk, ChunkedWriter, PackedChunk, counted_bytes

_BAG_HEADER_BYTES = 4096
_LZ4_BLOCK_1MB = 6


class BagWriter(ChunkedWriter):
    """Writes a ROS 1 bag to a seekable file; call `finish` at the end, or the file has no index.

    `compression`: the name of what `compress` does, which is lz4 by default. `workers`: see `ChunkedWriter`.
    """

    def __init__(
        self,
        file: BinaryIO,
        *,
        compression: str = "lz4",
        compress: Callable[[bytes], bytes] | None = None,
        chunk_bytes: int = 768 * 1024,
        workers: int = 0,
    ) -> None:
        super().__init__(file, compress or ros_lz4, chunk_bytes, "I", workers)
        self._compression = compression.encode()
        self._put(rosbag1.MAGIC)
        self._put(_bag_header(0, 0, 0))

    def add_connection(
        self, topic: str, message_type: str, *, md5sum: str, definition: str, properties: Properties = ()
    ) -> int:
        """Define a topic; returns its number, to be used for messages. `properties`: "callerid" and "latching"."""
        number = len(self._definitions)
        data = _fields(topic=topic.encode(), type=message_type.encode(), md5sum=md5sum.encode())
        others = {name: text.encode() for name, text in properties if name in ("callerid", "latching")}
        data += _fields(message_definition=definition.encode(), **others)
        self._define(_bag_record(Op.CONNECTION, data, conn=_u32(number), topic=topic.encode()))
        return number

    def add_message(self, connection: int, log_time_ns: int, payload: bytes) -> None:
        """Add a message; messages are in the file in the order in which they are added."""
        seconds, nanoseconds = divmod(log_time_ns, 1_000_000_000)
        time = struct.pack("<II", seconds, nanoseconds)
        head = _fields(op=bytes([Op.MESSAGE_DATA]), conn=_u32(connection), time=time)
        front = counted_bytes(head) + _u32(len(payload))
        self._add(connection, (seconds, nanoseconds, self._size), log_time_ns, front, payload)

    def finish(self) -> None:
        """Write what is left and the index. The file is not closed."""
        self._flush()
        index_start = self._position
        for record in (*self._definitions, *self._chunk_indexes):
            self._put(record)
        self._file.seek(len(rosbag1.MAGIC))
        self._file.write(_bag_header(index_start, len(self._definitions), len(self._chunk_indexes)))
        self._file.seek(0, 2)

    def _write_chunk(self, chunk: Chunk, packed: PackedChunk) -> None:
        if not chunk.indexes:
            return  # connections are in the index section, too
        start, stored = self._position, packed.stored
        head = _fields(op=bytes([Op.CHUNK]), compression=self._compression, size=_u32(chunk.size))
        self._put(counted_bytes(head) + _u32(len(stored)))
        self._put(stored)
        counts = b""
        for connection, index in chunk.indexes.items():
            entries, count = struct.pack(f"<{len(index)}I", *index), _u32(len(index) // 3)
            counts += _u32(connection) + count
            self._put(_bag_record(Op.INDEX_DATA, entries, ver=_u32(1), conn=_u32(connection), count=count))
        times = (struct.pack("<II", *divmod(time_ns, 1_000_000_000)) for time_ns in (chunk.first_ns, chunk.last_ns))
        info = dict(zip(("start_time", "end_time"), times, strict=True))
        fields = {"ver": _u32(1), "chunk_pos": struct.pack("<Q", start), **info, "count": _u32(len(chunk.indexes))}
        self._chunk_indexes.append(_bag_record(Op.CHUNK_INFO, counts, **fields))


def _bag_header(index_start: int, connections: int, chunks: int) -> bytes:
    """Return the bag header record, padded so that it can be overwritten in place."""
    values = {"index_pos": struct.pack("<Q", index_start), "conn_count": _u32(connections), "chunk_count": _u32(chunks)}
    size = len(_bag_record(Op.BAG_HEADER, b"", **values))
    return _bag_record(Op.BAG_HEADER, b" " * (_BAG_HEADER_BYTES - size), **values)


def ros_lz4(raw: bytes) -> bytes:
    """Compress in independent blocks of 1 MB with a checksum: what ROS itself writes, and the only kind it reads."""
    return bytes(
        lz4.frame.compress(raw, block_size=_LZ4_BLOCK_1MB, block_linked=False, content_checksum=True, store_size=False)
    )


def _bag_record(opcode: int, data: bytes, **fields: bytes) -> bytes:
    return counted_bytes(_fields(op=bytes([opcode]), **fields)) + counted_bytes(data)


def _fields(**values: bytes) -> bytes:
    return b"".join(counted_bytes(name.encode() + b"=" + value) for name, value in values.items())


def _u32(number: int) -> bytes:
    return struct.pack("<I", number)
