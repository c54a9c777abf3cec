"""A recording of any size that is never stored: an MCAP whose chunks are made when they are read.

Each chunk is 0.1 s: a camera message of nearly 1 MB, and ten IMU messages. Nothing is compressed; every CRC is right.
"""

import struct
from functools import lru_cache
from io import BytesIO

from kleinkram.recordings.formats.mcap import records
from kleinkram.recordings.formats.mcap.records import Opcode
from kleinkram.recordings.sources import check_range
from kleinkram.recordings.writing.chunked_writer import counted_bytes
from kleinkram.recordings.writing.mcap_writer import McapWriter

PERIOD_NS = 10**8
IMU_PER_CHUNK = 10
_STEP_NS = PERIOD_NS // IMU_PER_CHUNK
_PICTURE = bytes(range(256)) * 3900
_CHUNK_INDEX = struct.Struct("<QQQQ")
_OFFSETS = 2


class SyntheticDrive:
    """A source with the topics /camera and /imu.

    Attributes:
        bytes_read: of chunks and index.
        chunk_bytes: of each chunk, without message indexes.
        index_bytes: of the summary.
    """

    parallel_reads = 8

    def __init__(self, name: str, *, start_ns: int, size_bytes: int) -> None:
        self.name, self._start_ns = name, start_ns
        self.bytes_read = 0
        self._front, chunk, self._definitions, index = _write_chunk(start_ns, start_ns)
        self._stride = len(chunk)
        self.chunks = size_bytes // self._stride
        head = records.RECORD_HEAD.size
        *_, index_start, self.chunk_bytes = _CHUNK_INDEX.unpack_from(index, head)
        offsets = struct.unpack_from("<" + "HQ" * _OFFSETS, index, head + _CHUNK_INDEX.size + 4)
        self._offsets = [offset - index_start for offset in offsets[1::2]]
        self._index_tail = index[head + _CHUNK_INDEX.size + 4 + 10 * _OFFSETS :]
        self._back = self._summary()
        self.index_bytes = len(self._back)
        self.size_bytes = len(self._front) + self.chunks * self._stride + len(self._back)

    @property
    def end_ns(self) -> int:
        """The time behind the last chunk."""
        return self._start_ns + self.chunks * PERIOD_NS

    def chunks_between(self, start_ns: int, end_ns: int) -> int:
        """Return how many chunks hold messages in [start, end)."""
        first = max(0, (start_ns - self._start_ns) // PERIOD_NS)
        return max(0, min(self.chunks, -((self._start_ns - end_ns) // PERIOD_NS)) - first)

    def read(self, offset: int, length: int) -> bytes:
        """Return exactly `length` bytes from `offset`."""
        check_range(self, offset, length)
        self.bytes_read += length
        pieces, end = [], offset + length
        while offset < end:
            start, piece = self._piece(offset)
            part = piece[offset - start : end - start]
            pieces.append(part)
            offset += len(part)
        return b"".join(pieces)

    def _piece(self, offset: int) -> tuple[int, bytes]:
        number = (offset - len(self._front)) // self._stride
        if number < 0:
            return 0, self._front
        start = len(self._front) + min(number, self.chunks) * self._stride
        return start, self._back if number >= self.chunks else _chunk(self._start_ns, number)

    def _summary(self) -> bytes:
        """Return everything behind the last chunk."""
        data_end = records.RECORD_HEAD.pack(Opcode.DATA_END, 4) + bytes(4)
        body = records.STATISTICS_BODY.pack(
            self.chunks * (IMU_PER_CHUNK + 1), 0, 2, 0, 0, self.chunks, self._start_ns, self.end_ns - _STEP_NS
        )
        counts = struct.pack("<HQHQ", 0, self.chunks, 1, self.chunks * IMU_PER_CHUNK)
        statistics = _record(Opcode.STATISTICS, body + counted_bytes(counts))
        indexes = b"".join(self._chunk_index(number) for number in range(self.chunks))
        summary_start = len(self._front) + self.chunks * self._stride + len(data_end)
        footer = _record(Opcode.FOOTER, struct.pack("<QQI", summary_start, 0, 0)) + records.MAGIC
        return data_end + self._definitions + statistics + indexes + footer

    def _chunk_index(self, number: int) -> bytes:
        start, first_ns = len(self._front) + number * self._stride, self._start_ns + number * PERIOD_NS
        offsets = struct.pack("<" + "HQ" * _OFFSETS, 0, start + self._offsets[0], 1, start + self._offsets[1])
        times = first_ns, first_ns + PERIOD_NS - _STEP_NS
        body = _CHUNK_INDEX.pack(*times, start, self.chunk_bytes) + counted_bytes(offsets) + self._index_tail
        return _record(Opcode.CHUNK_INDEX, body)


def _record(opcode: int, body: bytes) -> bytes:
    return records.RECORD_HEAD.pack(opcode, len(body)) + body


@lru_cache(maxsize=16)
def _chunk(start_ns: int, number: int) -> bytes:
    return _write_chunk(start_ns, start_ns + number * PERIOD_NS)[1]


def _write_chunk(start_ns: int, first_ns: int) -> tuple[bytes, bytes, bytes, bytes]:
    """Return the front of a file, a chunk with its message indexes, the definitions, and the index of the chunk."""
    out = BytesIO()
    writer = McapWriter(out, profile="ros2", compression="", compress=bytes, chunk_bytes=2**40)
    front = out.getvalue()
    camera, imu = (writer.add_channel(topic, 0, "cdr") for topic in ("/camera", "/imu"))
    writer.add_message(camera, first_ns, _PICTURE, sequence=0)
    for number in range(IMU_PER_CHUNK):
        writer.add_message(
            imu, first_ns + number * _STEP_NS, struct.pack("<Q", first_ns - start_ns + number), sequence=number
        )
    writer._flush()
    return front, out.getvalue()[len(front) :], b"".join(writer._definitions), writer._chunk_indexes[0]
