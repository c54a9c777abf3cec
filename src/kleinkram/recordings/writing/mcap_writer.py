"""Writer of MCAP: chunked and indexed, with every CRC.

Memory: that of `ChunkedWriter`; of the summary, about 100 bytes and 10 for each channel of a chunk.

Source: MCAP format specification, version 0 (mcap.dev/spec).
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterable
from itertools import chain
from typing import BinaryIO

import zstandard

from kleinkram.recordings.errors import CannotWrite
from kleinkram.recordings.formats.base import OtherRecord
from kleinkram.recordings.formats.mcap import records as mcap
from kleinkram.recordings.formats.mcap.records import Opcode
from kleinkram.recordings.messages import Properties
from kleinkram.recordings.writing.chunked_writer import Chunk, ChunkedWriter, PackedChunk, counted_bytes

_MESSAGE = struct.Struct("<BQHIQQ")
_MAX_CHANNELS = 2**16
_MAX_SCHEMAS = 2**16 - 1  # 0 is that of channels without schema
_INDEX_OF: dict[int, Opcode] = {Opcode.ATTACHMENT: Opcode.ATTACHMENT_INDEX, Opcode.METADATA: Opcode.METADATA_INDEX}


class McapWriter(ChunkedWriter):
    """Writes an MCAP with every CRC; call `finish` at the end, or the file has no index.

    `compression`: the name of what `compress` does, which is zstd by default. `workers`: see `ChunkedWriter`.
    """

    def __init__(
        self,
        file: BinaryIO,
        *,
        profile: str = "",
        library: str = "kleinkram",
        compression: str = "zstd",
        compress: Callable[[bytes], bytes] | None = None,
        chunk_bytes: int = 2**20,
        workers: int = 0,
    ) -> None:
        super().__init__(file, compress or zstandard.ZstdCompressor(level=1).compress, chunk_bytes, "Q", workers)
        self._compression = _text(compression)
        self._crc = 0
        self._counts: dict[int, int] = {}
        self._schemas: dict[tuple[str, str, bytes], int] = {}
        self._span = (2**64 - 1, 0)
        self._others: dict[int, list[bytes]] = {Opcode.ATTACHMENT: [], Opcode.METADATA: []}
        self._put(mcap.MAGIC)
        self._put(_mcap_record(Opcode.HEADER, _text(profile) + _text(library)))

    def add_schema(self, name: str, encoding: str, text: bytes) -> int:
        """Define a message type; returns its id, to be used for channels."""
        schema = name, encoding, text
        if schema not in self._schemas:
            if len(self._schemas) >= _MAX_SCHEMAS:
                raise CannotWrite(name, f"an MCAP has at most {_MAX_SCHEMAS} schemas")
            self._schemas[schema] = len(self._schemas) + 1
            body = struct.pack("<H", self._schemas[schema]) + _text(name) + _text(encoding) + counted_bytes(text)
            self._define(_mcap_record(Opcode.SCHEMA, body))
        return self._schemas[schema]

    def add_channel(self, topic: str, schema_id: int, message_encoding: str, properties: Properties = ()) -> int:
        """Define a topic; returns its id, to be used for messages."""
        channel_id = len(self._counts)
        if channel_id >= _MAX_CHANNELS:
            raise CannotWrite(topic, f"an MCAP has at most {_MAX_CHANNELS} channels")
        body = struct.pack("<HH", channel_id, schema_id) + _text(topic) + _text(message_encoding)
        body += counted_bytes(_entries(properties))
        self._define(_mcap_record(Opcode.CHANNEL, body))
        self._counts[channel_id] = 0
        return channel_id

    def add_message(
        self,
        channel_id: int,
        log_time_ns: int,
        payload: bytes,
        *,
        publish_time_ns: int | None = None,
        sequence: int | None = None,
    ) -> None:
        """Add a message; messages are in the file in the order in which they are added.

        By default, it was published at the log time, and its sequence is the number of messages before it.
        """
        count = self._counts[channel_id]
        self._counts[channel_id] = count + 1
        sequence = count if sequence is None else sequence
        length = _MESSAGE.size - mcap.RECORD_HEAD.size + len(payload)
        times = log_time_ns, log_time_ns if publish_time_ns is None else publish_time_ns
        head = _MESSAGE.pack(Opcode.MESSAGE, length, channel_id, sequence & 0xFFFFFFFF, *times)
        self._add(channel_id, (log_time_ns, self._size), log_time_ns, head, payload)

    def add_metadata(self, name: str, entries: Iterable[tuple[str, str]]) -> None:
        """Add a metadata record."""
        record = _mcap_record(Opcode.METADATA, _text(name) + counted_bytes(_entries(entries)))
        self.copy_record(OtherRecord(Opcode.METADATA, 0, len(record), _text(name)), [record])

    def copy_record(self, record: OtherRecord, pieces: Iterable[bytes]) -> None:
        """Add an attachment or metadata record as another file has it: `pieces` are its bytes."""
        self._flush()
        start = self._position
        for piece in pieces:
            self._put(piece)
        place = struct.pack("<QQ", start, record.length)
        self._others[record.opcode].append(_mcap_record(_INDEX_OF[record.opcode], place + record.index_fields))

    def finish(self) -> None:
        """Write what is left, the summary and the footer. The file is not closed."""
        self._flush()
        self._put(_mcap_record(Opcode.DATA_END, struct.pack("<I", self._crc)))
        summary_start, self._crc = self._position, 0
        counts = b"".join(struct.pack("<HQ", *item) for item in self._counts.items())
        total = sum(self._counts.values())
        statistics = mcap.STATISTICS_BODY.pack(
            total,
            len(self._schemas),
            len(self._counts),
            len(self._others[Opcode.ATTACHMENT]),
            len(self._others[Opcode.METADATA]),
            len(self._chunk_indexes),
            *(self._span if total else (0, 0)),
        )
        records = *self._definitions, _mcap_record(Opcode.STATISTICS, statistics + counted_bytes(counts))
        for record in (*records, *self._chunk_indexes, *chain(*self._others.values())):
            self._put(record)
        footer = mcap.RECORD_HEAD.pack(Opcode.FOOTER, mcap.FOOTER_BODY.size) + struct.pack("<QQ", summary_start, 0)
        self._put(footer + struct.pack("<I", zlib.crc32(footer, self._crc)) + mcap.MAGIC)

    def _checksum(self, raw: bytes) -> int:
        return zlib.crc32(raw)

    def _write_chunk(self, chunk: Chunk, packed: PackedChunk) -> None:
        first_ns = chunk.first_ns if chunk.indexes else 0
        if chunk.indexes:
            self._span = min(self._span[0], first_ns), max(self._span[1], chunk.last_ns)
        stored, start = packed.stored, self._position
        head = struct.pack("<QQQI", first_ns, chunk.last_ns, chunk.size, packed.checksum)
        head += self._compression + struct.pack("<Q", len(stored))
        self._put(mcap.RECORD_HEAD.pack(Opcode.CHUNK, len(head) + len(stored)) + head)
        self._put(stored)
        index_start = self._position
        offsets = b""
        for channel_id, index in chunk.indexes.items():
            offsets += struct.pack("<HQ", channel_id, self._position)
            entries = struct.pack(f"<{len(index)}Q", *index)
            self._put(_mcap_record(Opcode.MESSAGE_INDEX, struct.pack("<H", channel_id) + counted_bytes(entries)))
        body = struct.pack("<QQQQ", first_ns, chunk.last_ns, start, index_start - start) + counted_bytes(offsets)
        body += struct.pack("<Q", self._position - index_start) + self._compression
        self._chunk_indexes.append(_mcap_record(Opcode.CHUNK_INDEX, body + struct.pack("<QQ", len(stored), chunk.size)))

    def _put(self, data: bytes) -> None:
        super()._put(data)
        self._crc = zlib.crc32(data, self._crc)


def _mcap_record(opcode: int, body: bytes) -> bytes:
    return mcap.RECORD_HEAD.pack(opcode, len(body)) + body


def _text(text: str) -> bytes:
    return counted_bytes(text.encode())


def _entries(entries: Iterable[tuple[str, str]]) -> bytes:
    return b"".join(_text(name) + _text(value) for name, value in entries)
