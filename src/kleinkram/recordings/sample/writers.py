"""Writers of sample recordings: ROS 1 bag, and rosbag2 with SQLite storage.

They hold one chunk and the index in memory. Only samples, tests and benchmarks use them.

Source: wiki.ros.org/Bags/Format/2.0; rosbag2_storage_sqlite3, schema version 3, with metadata version 5 (ROS 2 Humble).
"""

from __future__ import annotations

import json
import sqlite3
import struct
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

import lz4.frame

from kleinkram.recordings.formats.rosbag1 import records as rosbag1
from kleinkram.recordings.formats.rosbag1.records import Op
from kleinkram.recordings.writing.mcap_writer import ChunkedWriter, counted_bytes

_BAG_HEADER_BYTES = 4096
_LZ4_BLOCK_1MB = 6


class BagWriter(ChunkedWriter):
    """Writes a ROS 1 bag to a seekable file, compressed by lz4 by default; `finish` writes its index."""

    def __init__(
        self,
        file: BinaryIO,
        *,
        compression: str = "lz4",
        compress: Callable[[bytes], bytes] | None = None,
        chunk_bytes: int = 768 * 1024,
    ) -> None:
        super().__init__(file, compress or ros_lz4, chunk_bytes, "I")
        self._compression = compression.encode()
        self._put(rosbag1.MAGIC)
        self._put(_bag_header(0, 0, 0))

    def add_connection(self, topic: str, message_type: str, *, md5sum: str, definition: str) -> int:
        """Define a topic; returns its number, to be used for messages."""
        number = len(self._definitions)
        data = _fields(topic=topic.encode(), type=message_type.encode(), md5sum=md5sum.encode())
        data += _fields(message_definition=definition.encode())
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

    def _flush(self) -> None:
        if not self._index:
            return
        raw, stored = self._compressed()
        start = self._position
        head = _fields(op=bytes([Op.CHUNK]), compression=self._compression, size=_u32(len(raw)))
        self._put(counted_bytes(head) + _u32(len(stored)))
        self._put(stored)
        counts = b""
        for connection, index in self._index.items():
            entries, count = struct.pack(f"<{len(index)}I", *index), _u32(len(index) // 3)
            counts += _u32(connection) + count
            self._put(_bag_record(Op.INDEX_DATA, entries, ver=_u32(1), conn=_u32(connection), count=count))
        times = (struct.pack("<II", *divmod(time_ns, 1_000_000_000)) for time_ns in (self._first_ns, self._last_ns))
        info = dict(zip(("start_time", "end_time"), times, strict=True))
        fields = {"ver": _u32(1), "chunk_pos": struct.pack("<Q", start), **info, "count": _u32(len(self._index))}
        self._chunk_indexes.append(_bag_record(Op.CHUNK_INFO, counts, **fields))
        self._begin_chunk()


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


_ROSBAG2_SCHEMA = """
CREATE TABLE schema(schema_version INTEGER PRIMARY KEY,ros_distro TEXT NOT NULL);
CREATE TABLE metadata(id INTEGER PRIMARY KEY,metadata_version INTEGER NOT NULL,metadata TEXT NOT NULL);
CREATE TABLE topics(id INTEGER PRIMARY KEY,name TEXT NOT NULL,type TEXT NOT NULL,
    serialization_format TEXT NOT NULL,offered_qos_profiles TEXT NOT NULL);
CREATE TABLE messages(id INTEGER PRIMARY KEY,topic_id INTEGER NOT NULL,timestamp INTEGER NOT NULL, data BLOB NOT NULL);
CREATE INDEX timestamp_idx ON messages (timestamp ASC);
INSERT INTO schema(schema_version, ros_distro) VALUES (3, 'humble');
"""
_METADATA = """\
rosbag2_bagfile_information:
  version: 5
  storage_identifier: sqlite3
  duration:
    nanoseconds: {duration}
  starting_time:
    nanoseconds_since_epoch: {start}
  message_count: {count}
  topics_with_message_count:
{topics}  compression_format: ""
  compression_mode: ""
  relative_file_paths:
    - {name}
  files:
    - path: {name}
      starting_time:
        nanoseconds_since_epoch: {start}
      duration:
        nanoseconds: {duration}
      message_count: {count}
"""
_TOPIC_METADATA = """\
    - topic_metadata:
        name: {name}
        type: {message_type}
        serialization_format: cdr
        offered_qos_profiles: ""
      message_count: {count}
"""


class Db3Writer:
    """Makes a new rosbag2 folder with one database, `path`; call `finish` at the end, or there is no metadata.yaml."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True)
        self.path = folder / f"{folder.name}_0.db3"
        self.bytes_written = 0
        self._topics: list[tuple[str, str]] = []
        self._counts: list[int] = []
        self._batch: list[tuple[int, int, bytes]] = []
        self._first_ns, self._last_ns = 2**63, 0
        self._database = sqlite3.connect(self.path, isolation_level=None)
        self._database.execute("PRAGMA journal_mode=OFF")
        self._database.execute("PRAGMA synchronous=OFF")
        self._database.executescript(_ROSBAG2_SCHEMA)
        self._database.execute("BEGIN")

    def add_topic(self, name: str, message_type: str) -> int:
        """Define a topic; returns its id, to be used for messages."""
        self._topics.append((name, message_type))
        self._counts.append(0)
        topic_id = len(self._topics)
        self._database.execute("INSERT INTO topics VALUES (?, ?, ?, 'cdr', '')", (topic_id, name, message_type))
        return topic_id

    def add_message(self, topic_id: int, log_time_ns: int, payload: bytes) -> None:
        """Add a message."""
        self._counts[topic_id - 1] += 1
        self._first_ns, self._last_ns = min(self._first_ns, log_time_ns), max(self._last_ns, log_time_ns)
        self._batch.append((topic_id, log_time_ns, payload))
        self.bytes_written += len(payload)
        if len(self._batch) >= 500:
            self._flush()

    def finish(self) -> None:
        """Write what is left and metadata.yaml, and close the database."""
        self._flush()
        self._database.execute("COMMIT")
        self._database.close()
        start = self._first_ns if any(self._counts) else 0
        topics = "".join(
            _TOPIC_METADATA.format(name=json.dumps(name), message_type=message_type, count=count)
            for (name, message_type), count in zip(self._topics, self._counts, strict=True)
        )
        metadata = _METADATA.format(
            name=self.path.name, start=start, duration=self._last_ns - start, count=sum(self._counts), topics=topics
        )
        self.path.with_name("metadata.yaml").write_text(metadata, encoding="utf-8")

    def _flush(self) -> None:
        self._database.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", self._batch)
        self._batch.clear()
