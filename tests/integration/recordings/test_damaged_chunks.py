"""Damaged, truncated, hostile and oversized chunks: readable messages are read, and the loss is measured."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from random import Random

import lz4.frame
import pytest
import zstandard

from kleinkram.recordings import Content, Lost, Recording, RecordingSummary
from kleinkram.recordings import damage_report as damage_report_module
from kleinkram.recordings.formats.mcap import records
from kleinkram.recordings.formats.mcap.records import Opcode
from kleinkram.recordings.sources import SourceReader
from kleinkram.recordings.summary import scan
from tests.recording_files import builders
from tests.recording_files.agreement import accounts_of, disagreements
from tests.recording_files.memory_source import MemorySource
from tests.recording_files.writers import BagCompression, BagWriter, Compression, McapWriter
from tests.unit.recordings.test_hostile import chunk, mcap_of, record

T0 = 1_700_000_000_000_000_000
PACK = {b"": bytes, b"zstd": zstandard.compress, b"lz4": lz4.frame.compress}
INDEX_OF_1000 = records.RECORD_HEAD.pack(Opcode.MESSAGE_INDEX, 2 + 4 + 16 * 1_000)


def channel_record(number: int, topic: bytes) -> bytes:
    return record(
        Opcode.CHANNEL, struct.pack("<HHI", number, 0, len(topic)) + topic + struct.pack("<I3sI", 3, b"cdr", 0)
    )


def messages(count: int, first: int = 0, channel: int = 0) -> bytes:
    return b"".join(
        record(Opcode.MESSAGE, struct.pack("<HIQQ", channel, 0, T0 + first + n, T0 + first + n) + bytes(range(200)))
        for n in range(count)
    )


def packed(compression: bytes, content: bytes, *, crc: int | None = None) -> bytes:
    crc = zlib.crc32(content) if crc is None else crc
    return chunk(compression, PACK[compression](content), len(content), crc)


def scan_bytes(data: bytes, name: str = "a.mcap") -> RecordingSummary:
    return scan(SourceReader(MemorySource(data, name)))


@pytest.mark.parametrize("compression", PACK)
def test_a_chunk_with_a_wrong_checksum_is_left_out(compression: bytes) -> None:
    before, after = messages(10), messages(10, 30)
    data = mcap_of(
        packed(compression, channel_record(0, b"/a") + before)
        + packed(compression, channel_record(1, b"/lie") + messages(20, 10), crc=1)
        + packed(compression, after)
    )
    summary = scan_bytes(data)
    assert (summary.content, summary.message_count) == (Content.recovered, 20)
    assert [(topic.name, topic.out_of_order_count) for topic in summary.topics] == [("/a", 0)]
    assert "its checksum is wrong" in (summary.reason or "")


@pytest.mark.parametrize("compression", PACK)
def test_records_that_break_off_keep_what_stands_before(compression: bytes) -> None:
    content = channel_record(0, b"/a") + messages(20) + bytes(300)
    summary = scan_bytes(mcap_of(packed(compression, content)))
    assert (summary.content, summary.message_count) == (Content.recovered, 20)


@pytest.mark.parametrize("compression", [b"zstd", b"lz4"])
@pytest.mark.parametrize("how", ["cut short", "with more", "claims less"])
def test_data_that_do_not_end_with_the_chunk(how: str, compression: bytes) -> None:
    content = channel_record(0, b"/a") + messages(20)
    stored = PACK[compression](content)
    stored = {"cut short": stored[:-3], "with more": stored + b"more", "claims less": stored}[how]
    claimed = len(content) - (209 + 22 if how == "claims less" else 0)
    data = mcap_of(chunk(compression, stored, claimed) + packed(compression, channel_record(0, b"/a") + messages(5)))
    assert scan_bytes(data).message_count == 5


def test_order_and_gaps_go_on_over_damaged_chunks() -> None:
    data = mcap_of(
        packed(b"zstd", channel_record(0, b"/a") + messages(20, 500))
        + packed(b"zstd", messages(20, 100), crc=1)
        + packed(b"zstd", messages(20))
    )
    (topic,) = scan_bytes(data).topics
    assert (topic.count, topic.out_of_order_count, topic.longest_gap_ns) == (40, 20, 481)


@pytest.mark.parametrize("compression", [Compression.zstd, Compression.none])
def test_a_cut_chunk_is_saved_and_measured(compression: Compression) -> None:
    whole = mcap_of_writer(compression, payload_bytes=1_000, count=1_000)
    data = whole[: whole.index(INDEX_OF_1000) * 7 // 10]
    summary = scan_bytes(data)
    assert summary.message_count is not None
    assert summary.lost is not None
    assert 500 < summary.message_count < 800
    assert 0 < summary.lost.bytes < len(data) // 4
    assert (summary.lost.chunks, summary.lost.messages) == (1, None)


def test_a_large_message_that_is_cut_is_not_counted() -> None:
    body = struct.pack("<HIQQ", 0, 0, T0, T0) + bytes(20 * 2**20)
    content = channel_record(0, b"/a") + messages(1) + record(Opcode.MESSAGE, body)
    data = mcap_of(chunk(b"", content, len(content)))[: 5 * 2**20]
    summary = scan(SourceReader(MemorySource(data)))
    assert summary.message_count == 1
    assert summary.lost is not None
    assert summary.lost.bytes > 4 * 2**20


def mcap_of_writer(compression: Compression, *, payload_bytes: int, count: int) -> bytes:
    """Return an MCAP of one chunk, whose payloads do not compress away."""
    out = BytesIO()
    writer = McapWriter(out, compression=compression, chunk_bytes=2**40)
    channel = writer.add_channel("/t", 0, "cdr")
    for number in range(count):
        writer.add_message(channel, T0 + number, Random(number).randbytes(payload_bytes), publish_time_ns=T0 + number)
    writer.finish()
    return out.getvalue()


@pytest.mark.parametrize("to_the_end", [True, False])
@pytest.mark.parametrize("compression", [Compression.zstd, Compression.lz4])
def test_the_beginning_of_a_chunk_with_a_tail_of_zeros(compression: Compression, to_the_end: bool) -> None:
    """After a power cut, the last sectors of a file are there and empty."""
    whole = mcap_of_writer(compression, payload_bytes=1_000, count=1_000)
    end = whole.index(INDEX_OF_1000)
    at = end * 6 // 10
    data = whole[:at] + bytes(len(whole) - at if to_the_end else end - at) + (b"" if to_the_end else whole[end:])
    summary = scan(SourceReader(MemorySource(data, "a.mcap")))
    assert summary.message_count is not None
    assert summary.lost is not None
    assert 400 < summary.message_count < 600
    assert summary.content is Content.recovered
    assert 0.3 * len(whole) < summary.lost.bytes < 0.7 * len(whole)
    assert summary.lost == Lost(summary.lost.bytes, 1, None if to_the_end else 1_000 - summary.message_count)
    assert f"{summary.message_count} messages were saved" in (summary.reason or "")


@pytest.mark.parametrize("to_the_end", [True, False])
@pytest.mark.parametrize("compression", [BagCompression.lz4, BagCompression.bz2])
def test_the_beginning_of_a_chunk_of_a_bag_with_a_tail_of_zeros(
    compression: BagCompression, to_the_end: bool, tmp_path: Path
) -> None:
    """bz2 comes in blocks of 900 kB: those before the zeros are saved."""
    whole, start, end = bag_of_one_chunk(compression, payload_bytes=4_000, count=1_000)
    at = start + (end - start) * 6 // 10
    data = whole[:at] + bytes(len(whole) - at if to_the_end else end - at) + (b"" if to_the_end else whole[end:])
    path = tmp_path / "a.bag"
    path.write_bytes(data)
    summary = scan(SourceReader(MemorySource(data, "a.bag")))
    assert summary.content is Content.recovered
    assert summary.message_count is not None
    assert summary.lost is not None
    assert 400 < summary.message_count < 650
    assert 0.3 * len(whole) < summary.lost.bytes < 0.7 * len(whole)
    assert summary.lost == Lost(summary.lost.bytes, 1, None if to_the_end else 1_000 - summary.message_count)
    assert f"{summary.message_count} messages were saved" in (summary.reason or "")
    with Recording.open(path) as recording:
        assert len(list(recording.raw_messages())) == summary.message_count


def bag_of_one_chunk(compression: BagCompression, *, payload_bytes: int, count: int) -> tuple[bytes, int, int]:
    """Return a bag, and where its chunk begins and ends."""
    out = BytesIO()
    writer = BagWriter(out, compression=compression, chunk_bytes=2 * payload_bytes * count)
    connection = writer.add_connection("/t", "a/B", md5sum="*", definition="")
    start = out.tell()
    for number in range(count):
        writer.add_message(connection, T0 + number, Random(number).randbytes(payload_bytes))
    writer.finish()
    data = out.getvalue()
    (head_bytes,) = struct.unpack_from("<I", data, start)
    (data_bytes,) = struct.unpack_from("<I", data, start + 4 + head_bytes)
    return data, start, start + 8 + head_bytes + data_bytes


def test_as_many_messages_are_read_as_counted(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    content = packed(b"zstd", channel_record(0, b"/a") + messages(10))
    lie = packed(b"zstd", channel_record(1, b"/lie") + messages(20, 10, 1), crc=1)
    path.write_bytes(mcap_of(content + lie + packed(b"zstd", messages(10, 30)) + lie))
    with Recording.open(path) as recording:
        assert [topic.name for topic in recording.topics] == ["/a"]
        assert [topic.count for topic in recording.topics] == [20]
        assert [message.log_time_ns - T0 for message in recording.raw_messages()] == [*range(10), *range(30, 40)]


def bomb_mcap() -> bytes:
    out = BytesIO()
    writer = McapWriter(out, chunk_bytes=2**20)
    channel = writer.add_channel("/t", 0, "cdr")
    for number in range(40):
        writer.add_message(channel, T0 + number, bytes(2**20), publish_time_ns=0)
    writer.finish()
    return out.getvalue()


def bomb_bag() -> bytes:
    out = BytesIO()
    writer = BagWriter(out, compression=BagCompression.bz2, chunk_bytes=2**20)
    connection = writer.add_connection("/t", "a/B", md5sum="*", definition="")
    for number in range(40):
        writer.add_message(connection, T0 + number, bytes(2**20))
    writer.finish()
    return out.getvalue()


@pytest.mark.parametrize(("make", "name"), [(bomb_mcap, "a.mcap"), (bomb_bag, "a.bag")])
def test_a_file_of_bombs_is_unpacked_up_to_a_bound(
    make: Callable[[], bytes], name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = make()
    monkeypatch.setattr(damage_report_module, "FREE_UNPACKED", 10 * 2**20)
    monkeypatch.setattr(damage_report_module, "MAX_EXPANSION", 2)
    summary = scan_bytes(data, name)
    assert summary.content is Content.recovered
    assert summary.message_count == 10
    assert summary.lost is not None
    assert (summary.lost.chunks, summary.lost.messages) == (30, 30)
    assert "would expand to more than" in (summary.reason or "")
    monkeypatch.undo()
    assert scan(SourceReader(MemorySource(data, name))).content is Content.indexed


@pytest.mark.parametrize("kind", ["mcap", "bag"])
def test_a_chunk_above_the_limit_is_left_out_by_all_readers(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("kleinkram.recordings.compression.MAX_CHUNK_BYTES", 50_000)
    small, large = [("/t", T0 + n, b"x" * 10) for n in range(5)], [("/t", T0 + 10 + n, b"x" * 1000) for n in range(100)]
    source = (builders.mcap_of if kind == "mcap" else builders.bag_of)([small, large, [("/t", T0 + 1000, b"x")]])
    path = tmp_path / f"a.{kind}"
    path.write_bytes(source.read(0, source.size_bytes))
    (accounts,) = accounts_of(tmp_path)
    assert disagreements(accounts) == []
    assert (accounts.summary.content, accounts.summary.count) == (Content.recovered, 6)
    summary = scan_bytes(path.read_bytes(), path.name)
    assert "chunks above 50000 are not read" in (summary.reason or "")
    assert summary.lost is not None
    assert (summary.lost.chunks, summary.lost.messages) == (1, 100)
