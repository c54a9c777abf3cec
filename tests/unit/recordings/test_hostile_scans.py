"""Scans of files that are made to be read again and again: what is read in vain stays a small share of the file."""

from __future__ import annotations

import struct
import tracemalloc
import zlib

import pytest

from kleinkram.recordings import Content
from kleinkram.recordings import losses as losses_module
from kleinkram.recordings.bag import records as bag_records
from kleinkram.recordings.decompress import decompress
from kleinkram.recordings.forward import from_source
from kleinkram.recordings.mcap import records
from kleinkram.recordings.summary import scan

from .memory_source import MemorySource
from .test_hostile import small_mcap

REACH = 128 * 1024
HEADS = 2_000


def bag_head(opcode: int, **fields: bytes) -> bytes:
    """A record's header that claims `REACH` bytes of data, none of which are there."""
    parts = [f"{name}=".encode() + value for name, value in {"op": bytes([opcode]), **fields}.items()]
    header = b"".join(struct.pack("<I", len(part)) + part for part in parts)
    return struct.pack("<I", len(header)) + header + struct.pack("<I", REACH)


def mcap_chunk_head() -> bytes:
    body = struct.pack("<QQQII", 0, 0, REACH, zlib.crc32(b"x"), 0) + struct.pack("<Q", REACH)
    return records.RECORD_HEAD.pack(records.CHUNK, len(body) + REACH) + body


def bag_of(head: bytes) -> bytes:
    return bag_records.MAGIC + head * HEADS + bytes(REACH)


FILES = {
    "mcap": records.MAGIC + mcap_chunk_head() * HEADS + bytes(REACH),
    "bag": bag_of(bag_head(5, compression=b"none", size=struct.pack("<I", REACH))),
    "bag, bz2": bag_of(bag_head(5, compression=b"bz2", size=struct.pack("<I", REACH))),
}


@pytest.mark.parametrize("name", FILES)
def test_heads_of_chunks_are_not_read_as_often_as_they_stand_there(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    read = 0

    def counted(kind: str, stored: memoryview, uncompressed_bytes: int) -> bytes:
        nonlocal read
        read += len(stored)
        return decompress(kind, stored, uncompressed_bytes)

    monkeypatch.setattr(losses_module, "_FREE_VAIN_BYTES", 2**20)
    monkeypatch.setattr("kleinkram.recordings.mcap.chunks.decompress", counted)
    monkeypatch.setattr("kleinkram.recordings.bag.scan.decompress", counted)
    data = FILES[name]
    summary = scan(from_source(MemorySource(data, name)))
    assert summary.content is Content.broken
    assert 0 < read <= 2**20 + 6 * len(data)


def test_faults_that_are_remembered_keep_no_bytes() -> None:
    connection = bag_head(7, conn=bytes(4), topic=b"/a")
    data = bag_of(connection)[: len(bag_records.MAGIC) + 800 * len(connection)] + bytes(REACH)
    tracemalloc.start()
    try:
        scan(from_source(MemorySource(data, "a.bag")))
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 48 * 2**20  # one window, and little more: kept, the bytes would come to 100 MB


def test_the_footer_of_a_file_inside_of_a_damaged_attachment_ends_nothing() -> None:
    """The search behind the damage comes upon the inner file's records; the outer file goes on behind its footer."""
    outer, inner = small_mcap(), small_mcap()
    first = len(records.MAGIC) + records.RECORD_HEAD.size
    (header_bytes,) = struct.unpack_from("<Q", outer, len(records.MAGIC) + 1)
    front = outer[: first + header_bytes]
    damaged = struct.pack("<BQ", records.ATTACHMENT, 2**60) + inner
    summary = scan(from_source(MemorySource(front + damaged + outer[len(front) :], "a.mcap")))
    assert summary.content is Content.recovered
    assert summary.message_count == 40 + 40
    assert f"{len(outer) - len(front)} bytes follow its end" in summary.problems[-1].message


def test_a_topic_may_have_any_name() -> None:
    """Names under which messages wait for the definition of their channel are no topic's."""
    topic = b"\0channel 5"
    definition = struct.pack("<HHI", 5, 0, len(topic)) + topic + struct.pack("<I3sI", 3, b"cdr", 0)
    message = struct.pack("<HIQQ", 5, 0, 7, 7)
    pieces = [records.RECORD_HEAD.pack(records.CHANNEL, len(definition)) + definition]
    pieces += 3 * [records.RECORD_HEAD.pack(records.MESSAGE, len(message)) + message]
    summary = scan(from_source(MemorySource(records.MAGIC + b"".join(pieces), "a.mcap")))
    assert [(found.name, found.count) for found in summary.topics] == [(topic.decode(), 3)]
