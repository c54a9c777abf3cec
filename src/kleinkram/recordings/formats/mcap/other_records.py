"""Finds the attachments and metadata records of an MCAP, so that they can be copied."""

from __future__ import annotations

from collections.abc import Container, Iterator
from itertools import chain

from kleinkram.recordings.chunk_table import ChunkTable
from kleinkram.recordings.errors import Malformed
from kleinkram.recordings.formats.base import OtherRecord
from kleinkram.recordings.formats.mcap.records import MAGIC, MAX_OUTSIDE_CHUNKS, RECORD_HEAD, BodyReader, Opcode
from kleinkram.recordings.limits import MAX_TAKE
from kleinkram.recordings.sources import Source
from kleinkram.recordings.streams import ByteStream, open_range

_WINDOW = 64 * 2**10
_TIMES_BYTES, _SIZE_BYTES, _CRC_BYTES = 16, 8, 4
_LAST = (0, Opcode.DATA_END, Opcode.FOOTER)


def find_other_records(source: Source, table: ChunkTable, opcodes: Container[int]) -> Iterator[OtherRecord | Malformed]:
    """Yield the attachments and metadata records between the chunks of a file, or what is wrong with one of them.

    `opcodes`: of those to be read, `Opcode.ATTACHMENT` or `Opcode.METADATA`; the bytes of others are not read. Where
    something between two chunks is no record, the search goes on behind the next chunk.
    """
    position, count = len(MAGIC), 0
    gaps = chain(((row.start, row.end) for row in table.rows), [(source.size_bytes, source.size_bytes)])
    for start, end in gaps:
        for opcode, at, length in _records(source, position, start):
            if opcode in opcodes and count < MAX_OUTSIDE_CHUNKS:
                count += 1
                yield _read(source, opcode, at, length)
        position = max(position, end)


def _records(source: Source, start: int, end: int) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, start and length of the records in a range, up to the end of the data section."""
    stream = open_range(source, start, end, window=_WINDOW)
    while end - stream.position >= RECORD_HEAD.size:
        at = stream.position
        opcode, body_bytes = RECORD_HEAD.unpack(stream.take(RECORD_HEAD.size))
        if opcode in _LAST or body_bytes > end - stream.position:
            return
        yield opcode, at, RECORD_HEAD.size + body_bytes
        stream.skip(body_bytes)


def _read(source: Source, opcode: int, start: int, length: int) -> OtherRecord | Malformed:
    is_attachment = opcode == Opcode.ATTACHMENT
    where = f"{'attachment' if is_attachment else 'metadata record'} at byte {start}"
    body_at, body_bytes = start + RECORD_HEAD.size, length - RECORD_HEAD.size
    try:
        if not is_attachment and body_bytes > MAX_TAKE:
            raise Malformed(where, f"it has {body_bytes} bytes; at most {MAX_TAKE} are read", certain=False)
        body = BodyReader(source.read(body_at, min(MAX_TAKE, body_bytes)), where)
        if not is_attachment:
            return OtherRecord(opcode, start, length, _name_of_metadata(body, where))
        times = body.blob(_TIMES_BYTES)
        names = body.raw_text() + body.raw_text()
        size = body.blob(_SIZE_BYTES)
        _check_crc(open_range(source, body_at, start + length), body_bytes - _CRC_BYTES)
        return OtherRecord(opcode, start, length, times + size + names)
    except Malformed as error:
        return Malformed(where, error.message)


def _name_of_metadata(body: BodyReader, where: str) -> bytes:
    name = body.raw_text()
    entries = BodyReader(body.counted(), where)
    while entries.left:
        entries.raw_text()
    return name


def _check_crc(stream: ByteStream, size_bytes: int) -> None:
    stream.start_crc()
    stream.skip(size_bytes)
    computed = stream.crc
    claimed = int.from_bytes(stream.take(_CRC_BYTES), "little")
    if claimed and claimed != computed:
        raise Malformed("attachment", "its checksum is wrong")
