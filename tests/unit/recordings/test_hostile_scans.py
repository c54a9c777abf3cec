"""Files that provoke repeated reads: the repeated bytes stay a small share of the file."""

from __future__ import annotations

import struct
import zlib
from io import BytesIO

import pytest

from kleinkram.recordings import Content
from kleinkram.recordings import damage_report as damage_report_module
from kleinkram.recordings.compression import decompress
from kleinkram.recordings.formats.mcap import records
from kleinkram.recordings.formats.mcap import scan as scan_module
from kleinkram.recordings.formats.mcap.records import Opcode
from kleinkram.recordings.formats.mcap.scan import scan_records
from kleinkram.recordings.formats.rosbag1 import records as bag_records
from kleinkram.recordings.sources import SourceReader
from kleinkram.recordings.summary import scan
from tests.memory import call_within
from tests.recording_files.memory_source import MemorySource
from tests.recording_files.writers import Compression, McapWriter
from tests.unit.recordings.test_hostile import record, small_mcap

REACH = 128 * 1024
HEADS = 2_000


def bag_head(opcode: int, **fields: bytes) -> bytes:
    """A record's header that claims `REACH` bytes of data, none of which are there."""
    parts = [f"{name}=".encode() + value for name, value in {"op": bytes([opcode]), **fields}.items()]
    header = b"".join(struct.pack("<I", len(part)) + part for part in parts)
    return struct.pack("<I", len(header)) + header + struct.pack("<I", REACH)


def mcap_chunk_head() -> bytes:
    body = struct.pack("<QQQII", 0, 0, REACH, zlib.crc32(b"x"), 0) + struct.pack("<Q", REACH)
    return records.RECORD_HEAD.pack(Opcode.CHUNK, len(body) + REACH) + body


def bag_of(head: bytes) -> bytes:
    return bag_records.MAGIC + head * HEADS + bytes(REACH)


FILES = {
    "mcap": records.MAGIC + mcap_chunk_head() * HEADS + bytes(REACH),
    "bag": bag_of(bag_head(5, compression=b"none", size=struct.pack("<I", REACH))),
    "bag, bz2": bag_of(bag_head(5, compression=b"bz2", size=struct.pack("<I", REACH))),
}


@pytest.mark.parametrize("name", FILES)
def test_the_work_for_repeated_chunk_headers_is_bounded(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    read = 0

    def counted(kind: str, stored: memoryview, uncompressed_bytes: int) -> bytes:
        nonlocal read
        read += len(stored)
        return decompress(kind, stored, uncompressed_bytes)

    monkeypatch.setattr(damage_report_module, "_FREE_WASTED_BYTES", 2**20)
    monkeypatch.setattr("kleinkram.recordings.chunk_scanner.decompress", counted)
    data = FILES[name]
    summary = scan(SourceReader(MemorySource(data, name)))
    assert summary.content is Content.broken
    assert 0 < read <= 2**20 + 6 * len(data)


def test_faults_that_are_remembered_keep_no_bytes() -> None:
    connection = bag_head(7, conn=bytes(4), topic=b"/a")
    data = bag_of(connection)[: len(bag_records.MAGIC) + 800 * len(connection)] + bytes(REACH)
    # One window, and little more: if the bytes stayed in memory, they would come to 100 MB.
    call_within(48 * 2**20, lambda: scan(SourceReader(MemorySource(data, "a.bag"))))


def front_and_rest(whole: bytes) -> tuple[bytes, bytes]:
    """Return magic and header of an MCAP, and what follows."""
    at = len(records.MAGIC) + records.RECORD_HEAD.size
    (header_bytes,) = struct.unpack_from("<Q", whole, len(records.MAGIC) + 1)
    return whole[: at + header_bytes], whole[at + header_bytes :]


def attachment_of(inner: bytes) -> bytes:
    return struct.pack("<QQII", 0, 0, 0, 0) + struct.pack("<Q", len(inner)) + inner + bytes(4)


HEADER_OF_INNER = len(records.MAGIC)
INNER = {
    "whole": small_mcap(),
    "a file in a file": front_and_rest(small_mcap())[0]
    + record(Opcode.ATTACHMENT, attachment_of(small_mcap()))
    + front_and_rest(small_mcap())[1],
    "its magic is overwritten": bytes(HEADER_OF_INNER) + small_mcap()[HEADER_OF_INNER:],
}


@pytest.mark.parametrize("opcode", [Opcode.ATTACHMENT, Opcode.MESSAGE, Opcode.METADATA])
@pytest.mark.parametrize("length", [2**60, 2**39, 1_200, 700])
@pytest.mark.parametrize("inner", INNER)
def test_messages_of_an_embedded_file_are_not_counted(inner: str, length: int, opcode: int) -> None:
    """The length around the inner file is damaged, so that the search comes upon its records."""
    front, rest = front_and_rest(small_mcap())
    damaged = struct.pack("<BQ", opcode, length) + attachment_of(INNER[inner])
    summary = scan(SourceReader(MemorySource(front + damaged + rest, "a.mcap")))
    assert summary.content is Content.recovered
    assert summary.message_count == 40 + (opcode == Opcode.MESSAGE and length < len(damaged))
    assert summary.lost is not None
    assert summary.lost.bytes >= len(INNER[inner]) - 1_200
    assert any("another MCAP begins inside" in problem.message for problem in summary.problems)


def test_messages_after_an_embedded_file_of_unknown_length_are_not_counted() -> None:
    """Where it ends cannot be known: too little is counted rather than what is not this file's."""
    front, rest = front_and_rest(small_mcap())
    cut = small_mcap()[:-60]
    damaged = struct.pack("<BQ", Opcode.ATTACHMENT, 2**60) + attachment_of(cut)
    summary = scan(SourceReader(MemorySource(front + damaged + rest, "a.mcap")))
    assert (summary.content, summary.message_count) == (Content.broken, 0)


def test_a_second_file_after_the_end_of_a_recording_is_not_counted() -> None:
    first, second = small_mcap(), small_mcap()
    summary = scan(SourceReader(MemorySource(first + second, "a.mcap")))
    assert (summary.content, summary.message_count) == (Content.recovered, 40)
    assert summary.lost is not None
    assert summary.lost.bytes == len(second)
    assert f"{len(second)} bytes follow its end" in summary.problems[0].message


def test_a_damaged_chunk_that_contains_a_file_is_left_out() -> None:
    """A chunk of the inner file is no proof that the outer one's length reaches too far."""
    out = BytesIO()
    writer = McapWriter(out, compression=Compression.none, chunk_bytes=100)
    channel = writer.add_channel("/files", 0, "raw")
    for number in range(3):
        writer.add_message(channel, 10 + number, small_mcap(), publish_time_ns=0)
    writer.finish()
    data = bytearray(out.getvalue())
    data[data.index(records.MAGIC, 8) + 12] ^= 1
    summary = scan(SourceReader(MemorySource(bytes(data), "a.mcap")))
    assert (summary.message_count, [topic.name for topic in summary.topics]) == (2, ["/files"])
    assert summary.lost is not None
    assert (summary.lost.chunks, summary.lost.messages) == (1, 1)


def test_a_topic_may_have_any_name() -> None:
    """Names under which messages wait for the definition of their channel are no topic's."""
    topic = b"\0channel 5"
    definition = struct.pack("<HHI", 5, 0, len(topic)) + topic + struct.pack("<I3sI", 3, b"cdr", 0)
    message = struct.pack("<HIQQ", 5, 0, 7, 7)
    pieces = [records.RECORD_HEAD.pack(Opcode.CHANNEL, len(definition)) + definition]
    pieces += 3 * [records.RECORD_HEAD.pack(Opcode.MESSAGE, len(message)) + message]
    summary = scan(SourceReader(MemorySource(records.MAGIC + b"".join(pieces), "a.mcap")))
    assert [(actual.name, actual.count) for actual in summary.topics] == [(topic.decode(), 3)]


def test_the_work_for_repeated_definition_headers_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each claims a megabyte, behind which nothing stands; a reader without index is told of none but a few."""
    bytes_parsed = 0

    def read_schema(facts: records.McapFacts, body: bytes, where: str) -> None:
        nonlocal bytes_parsed
        bytes_parsed += len(body)
        records.read_schema(facts, body, where)

    monkeypatch.setitem(scan_module._READERS, Opcode.SCHEMA, read_schema)
    monkeypatch.setattr(damage_report_module, "_FREE_WASTED_BYTES", 2**20)
    length = 2**20
    head = records.RECORD_HEAD.pack(Opcode.SCHEMA, length) + struct.pack("<HIII", 1, 0, 0, length - 14)
    data = records.MAGIC + head * HEADS + bytes(length)
    scan_records(SourceReader(MemorySource(data, "a.mcap")))
    assert 0 < bytes_parsed <= 2**20 + 6 * len(data)
