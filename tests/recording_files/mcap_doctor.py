"""What `mcap doctor` examines of chunks and their indexes; records and statistics are in `whole_mcap`.

Source: the MCAP specification (Chunk, Message Index, Chunk Index, Data End, Footer), and `doctor.go` of the MCAP
command line tool, whose errors and warnings are all failures here.
"""

from __future__ import annotations

import struct
import zlib
from collections import defaultdict
from collections.abc import Iterator
from io import BytesIO
from itertools import takewhile
from pathlib import Path
from typing import NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Chunk, ChunkIndex, DataEnd, Footer, MessageIndex
from mcap.stream_reader import get_chunk_data_stream

_MAGIC = b"\x89MCAP0\r\n"
_START = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQ")
_IN_CHUNKS = {Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE}


class _Record(NamedTuple):
    """A record, and where it begins."""

    start: int
    opcode: int
    body: bytes

    @property
    def end(self) -> int:
        return self.start + _START.size + len(self.body)

    @property
    def stream(self) -> ReadDataStream:
        return ReadDataStream(BytesIO(self.body))


def examine(path: Path) -> None:
    """Assert that chunks, message indexes, chunk indexes, and the checksums of both sections are true."""
    data = path.read_bytes()
    assert data[:8] == data[-8:] == _MAGIC
    written = [*_records(data, 8, len(data) - 8)]
    data_end = next(one for one in written if one.opcode == Opcode.DATA_END)
    assert DataEnd.read(data_end.stream).data_section_crc == zlib.crc32(data[: data_end.start])
    footer = Footer.read(written[-1].stream)
    assert footer.summary_crc == zlib.crc32(data[footer.summary_start : written[-1].end - 4])
    assert not [one for one in written if one.opcode == Opcode.MESSAGE], "a message outside of chunks"
    indexes = {
        index.chunk_start_offset: index
        for index in (ChunkIndex.read(one.stream) for one in written if one.opcode == Opcode.CHUNK_INDEX)
    }
    chunks = [at for at, one in enumerate(written) if one.opcode == Opcode.CHUNK]
    assert [*indexes] == [written[at].start for at in chunks]
    for at in chunks:
        message_indexes = [*takewhile(lambda one: one.opcode == Opcode.MESSAGE_INDEX, written[at + 1 :])]
        _examine_chunk(written[at], message_indexes, indexes[written[at].start])


def _records(data: bytes, start: int, end: int) -> Iterator[_Record]:
    while start < end:
        opcode, length = _START.unpack_from(data, start)
        yield _Record(start, opcode, data[start + _START.size : start + _START.size + length])
        start += _START.size + length
    assert start == end


def _examine_chunk(record: _Record, message_indexes: list[_Record], index: ChunkIndex) -> None:
    chunk = Chunk.read(record.stream)
    stream, size_bytes = get_chunk_data_stream(chunk, validate_crc=True)
    assert chunk.uncompressed_size == size_bytes
    assert chunk.uncompressed_crc
    entries = defaultdict[int, list[tuple[int, int]]](list)
    for one in _records(stream.read(size_bytes), 0, size_bytes):
        assert one.opcode in _IN_CHUNKS
        if one.opcode == Opcode.MESSAGE:
            channel_id, _sequence, log_ns = _MESSAGE.unpack_from(one.body)
            entries[channel_id].append((log_ns, one.start))
    stored = [(one.start, MessageIndex.read(one.stream)) for one in message_indexes]
    assert {part.channel_id: part.records for _, part in stored} == entries
    assert len(stored) == len(entries)
    stamps = [log_ns for records in entries.values() for log_ns, _ in records]
    span = (min(stamps), max(stamps)) if stamps else (0, 0)
    assert (chunk.message_start_time, chunk.message_end_time) == span
    assert (index.message_start_time, index.message_end_time) == span
    assert (index.compression, index.compressed_size) == (chunk.compression, len(chunk.data))
    assert (index.chunk_length, index.uncompressed_size) == (record.end - record.start, size_bytes)
    assert index.message_index_offsets == {part.channel_id: start for start, part in stored}
    assert index.message_index_length == sum(one.end - one.start for one in message_indexes)
