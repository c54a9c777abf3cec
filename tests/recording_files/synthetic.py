"""An MCAP file of any size that is never stored: each read generates its bytes."""

from __future__ import annotations

import struct

from kleinkram.recordings.formats.mcap import records
from kleinkram.recordings.formats.mcap.records import Opcode
from kleinkram.recordings.sources import check_range

T0 = 1_700_000_000_000_000_000
PERIOD_NS = 10_000_000
MESSAGES_PER_CHUNK = 20


def _record(opcode: int, body: bytes) -> bytes:
    return records.RECORD_HEAD.pack(opcode, len(body)) + body


def _text(text: str) -> bytes:
    return struct.pack("<I", len(text)) + text.encode()


class SyntheticMcap:
    """One topic of 100 Hz in chunks of `chunk_bytes`, indexed; the chunks themselves hold only zeros.

    Attributes:
        index_bytes: of the summary section and of all message indexes.
    """

    name = "synthetic.mcap"

    def __init__(self, size_bytes: int, *, chunk_bytes: int) -> None:
        self._chunk_bytes = chunk_bytes
        self._front = records.MAGIC + _record(Opcode.HEADER, bytes(8))
        self._message_index_bytes = len(self._message_index(0))
        self._stride = chunk_bytes + self._message_index_bytes
        self.chunks = size_bytes // self._stride
        data_end = _record(Opcode.DATA_END, bytes(4))
        self._summary_start = len(self._front) + self.chunks * self._stride + len(data_end)
        place = len(self._chunk_index(0))
        schema = _record(Opcode.SCHEMA, struct.pack("<H", 1) + _text("a/B") + _text("ros2msg") + _text("int8 x"))
        channel = _record(Opcode.CHANNEL, struct.pack("<HH", 0, 1) + _text("/t") + _text("cdr") + bytes(4))
        statistics = _record(
            Opcode.STATISTICS,
            records.STATISTICS_BODY.pack(self.chunks * MESSAGES_PER_CHUNK, 1, 1, 0, 0, self.chunks, T0, T0) + bytes(4),
        )
        footer = _record(Opcode.FOOTER, struct.pack("<QQI", self._summary_start, 0, 0)) + records.MAGIC
        self._data_end, self._definitions, self._back = data_end, schema + channel + statistics, footer
        self._places_start = self._summary_start + len(self._definitions)
        self._place_bytes = place
        self.size_bytes = self._places_start + self.chunks * place + len(footer)
        self.index_bytes = self.size_bytes - self._summary_start + self.chunks * self._message_index_bytes

    def read(self, offset: int, length: int) -> bytes:
        check_range(self, offset, length)
        pieces: list[bytes] = []
        end = offset + length
        while offset < end:
            start, piece = self._piece(offset)
            part = piece[offset - start : end - start]
            pieces.append(part)
            offset += len(part)
        return b"".join(pieces)

    def _piece(self, offset: int) -> tuple[int, bytes]:
        """Return the part of the file that holds a place, and where it begins."""
        if offset < len(self._front):
            return 0, self._front
        data_end_start = self._summary_start - len(self._data_end)
        if offset < data_end_start:
            number = (offset - len(self._front)) // self._stride
            start = len(self._front) + number * self._stride
            if offset < start + self._chunk_bytes:
                return offset, bytes(min(65536, start + self._chunk_bytes - offset))
            return start + self._chunk_bytes, self._message_index(number)
        if offset < self._summary_start:
            return data_end_start, self._data_end
        if offset < self._places_start:
            return self._summary_start, self._definitions
        number = (offset - self._places_start) // self._place_bytes
        if number < self.chunks:
            return self._places_start + number * self._place_bytes, self._chunk_index(number)
        return self._places_start + self.chunks * self._place_bytes, self._back

    def _message_index(self, number: int) -> bytes:
        first = T0 + number * MESSAGES_PER_CHUNK * PERIOD_NS
        entries = b"".join(struct.pack("<QQ", first + i * PERIOD_NS, i * 100) for i in range(MESSAGES_PER_CHUNK))
        return _record(Opcode.MESSAGE_INDEX, struct.pack("<HI", 0, len(entries)) + entries)

    def _chunk_index(self, number: int) -> bytes:
        first = T0 + number * MESSAGES_PER_CHUNK * PERIOD_NS
        start = len(self._front) + number * (self._chunk_bytes + self._message_index_bytes)
        last = first + (MESSAGES_PER_CHUNK - 1) * PERIOD_NS
        places = struct.pack("<QQQQ", first, last, start, self._chunk_bytes) + struct.pack("<IHQ", 10, 0, start)
        sizes = struct.pack("<Q", self._message_index_bytes) + _text("zstd") + struct.pack("<QQ", 1000, 2000)
        return _record(Opcode.CHUNK_INDEX, places + sizes)
