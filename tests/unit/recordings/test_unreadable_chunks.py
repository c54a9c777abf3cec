"""Chunks of an unknown compression, or begun and never finished."""

from __future__ import annotations

import random
import struct
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import pytest
import zstandard

from kleinkram.recordings import Content, FileSource, Recording, RecordingSummary, summarise
from kleinkram.recordings.formats.mcap import records
from kleinkram.recordings.formats.mcap.records import Opcode
from kleinkram.recordings.sources import SourceReader
from kleinkram.recordings.summary import scan
from tests.recording_files.agreement import ParallelSource, accounts_of, disagreements
from tests.recording_files.builders import T0, bag_of, mcap_of

_ONES = 2**64 - 1
_MESSAGES = 1000


def by_scan(path: Path) -> RecordingSummary:
    with FileSource(path) as source:
        return scan(SourceReader(source))


def by_index(path: Path) -> RecordingSummary:
    with FileSource(path) as source:
        return summarise(source)


def chunks(count: int = 3) -> list[list[tuple[str, int, bytes]]]:
    return [[("/a", T0 + 10 * number + at, b"data" * 50) for at in range(5)] for number in range(count)]


def replaced(data: bytes, name: bytes, other: bytes, *places: int) -> bytes:
    """Return the bytes with some of the occurrences of a name, by their number, replaced."""
    pieces = data.split(name)
    names = [other if number in places else name for number in range(len(pieces) - 1)]
    return pieces[0] + b"".join(new + piece for new, piece in zip(names, pieces[1:], strict=True))


def without_checksums(data: bytes) -> bytes:
    """Return an MCAP whose data and summary section are under no checksum."""
    at = data.rindex(bytes([Opcode.DATA_END]) + struct.pack("<Q", 4)) + records.RECORD_HEAD.size
    data = data[:at] + bytes(4) + data[at + 4 :]
    return data[: -len(records.MAGIC) - 4] + bytes(4) + records.MAGIC


@pytest.mark.parametrize("all_of_them", [False, True])
@pytest.mark.parametrize("kind", ["mcap", "bag"])
def test_an_unknown_compression_is_named_by_the_summary_as_by_the_scan(
    kind: str, all_of_them: bool, tmp_path: Path
) -> None:
    made = mcap_of(chunks()) if kind == "mcap" else bag_of(chunks())
    data, name = made.read(0, made.size_bytes), b"\x04\0\0\0zstd" if kind == "mcap" else b"compression=lz4"
    count = data.count(name)
    assert count == (6 if kind == "mcap" else 3)
    places = range(count) if all_of_them else (1, 4)
    data = replaced(data, name, name[:-1] + b"x", *places)
    path = tmp_path / f"unknown.{kind}"
    path.write_bytes(without_checksums(data) if kind == "mcap" else data)
    summary, deep = by_index(path), by_scan(path)
    assert summary.content is (Content.opaque if all_of_them else Content.recovered)
    assert (summary.message_count, summary.lost) == (deep.message_count, deep.lost)
    assert summary.message_count == (0 if all_of_them else 10)
    assert summary.lost is not None
    assert summary.lost.messages == (15 if all_of_them else 5)
    assert "unknown compression" in str(summary.reason)
    assert {p.where for p in summary.problems if p.code == "damaged"} == {
        p.where for p in deep.problems if p.code == "damaged"
    }
    (accounts,) = accounts_of(tmp_path)
    assert disagreements(accounts) == []


def test_a_wrong_unknown_compression_in_the_index_loses_no_message(tmp_path: Path) -> None:
    made = mcap_of(chunks())
    data = replaced(made.read(0, made.size_bytes), b"\x04\0\0\0zstd", b"\x04\0\0\0zstx", 4)
    path = tmp_path / "index_only.mcap"
    path.write_bytes(without_checksums(data))
    for summary in (by_index(path), by_scan(path)):
        assert (summary.content, summary.message_count) == (Content.indexed, 15)
        assert [problem.code for problem in summary.problems] == ["index-damaged"]
    (accounts,) = accounts_of(tmp_path)
    assert disagreements(accounts) == []


def text(value: bytes) -> bytes:
    return struct.pack("<I", len(value)) + value


def record(opcode: int, body: bytes) -> bytes:
    return records.RECORD_HEAD.pack(opcode, len(body)) + body


def content_of_chunk() -> bytes:
    """Return a schema, a channel, and many messages of random bytes, so that several blocks are compressed."""
    rng = random.Random(7)
    body = record(Opcode.SCHEMA, struct.pack("<H", 1) + text(b"a/B") + text(b"ros2msg") + text(b"uint8[] x"))
    body += record(Opcode.CHANNEL, struct.pack("<HH", 1, 1) + text(b"/a") + text(b"cdr") + text(b""))
    for number in range(_MESSAGES):
        head = struct.pack("<HIQQ", 1, number, T0 + number, T0 + number)
        body += record(Opcode.MESSAGE, head + rng.randbytes(500))
    return body


_PACK: dict[str, Callable[[bytes], bytes]] = {
    "": bytes,
    "zstd": zstandard.ZstdCompressor().compress,
    "lz4": lz4.frame.compress,
}


def unfinished(compression: str, *, packed: bytes, length: int, uncompressed: int, stored: int) -> bytes:
    head = struct.pack("<QQQI", 0, 0, uncompressed, 2**32 - 1) + text(compression.encode())
    chunk = records.RECORD_HEAD.pack(Opcode.CHUNK, length) + head + struct.pack("<Q", stored) + packed
    return records.MAGIC + record(Opcode.HEADER, text(b"ros2") + text(b"a recorder")) + chunk


@pytest.mark.parametrize("share", [1.0, 0.6], ids=["all", "cut"])
@pytest.mark.parametrize("compression", ["", "zstd", "lz4"])
def test_a_chunk_that_was_never_finished_is_saved_as_far_as_it_goes(
    compression: str, share: float, tmp_path: Path
) -> None:
    packed = _PACK[compression](content_of_chunk())
    packed = packed[: int(len(packed) * share)]
    path = tmp_path / "unfinished.mcap"
    path.write_bytes(unfinished(compression, packed=packed, length=_ONES, uncompressed=_ONES, stored=_ONES))
    summary = by_scan(path)
    assert summary.content is Content.recovered
    assert "was begun here and never finished" in str(summary.reason)
    assert summary.message_count is not None
    minimum = _MESSAGES if share == 1 else _MESSAGES * share * 0.6
    assert minimum <= summary.message_count <= _MESSAGES
    assert (summary.topics[0].stored_bytes or 0) <= path.stat().st_size
    (accounts,) = accounts_of(tmp_path)
    assert disagreements(accounts) == []
    for source in (FileSource, ParallelSource):
        with source(path) as opened, Recording.open(opened) as recording:
            actual = [message.log_time_ns - T0 for message in recording.raw_messages()]
        assert actual == [*range(summary.message_count)]


@pytest.mark.parametrize("known", ["length", "uncompressed", "stored"])
def test_one_placeholder_among_the_lengths_of_a_chunk_is_enough(known: str, tmp_path: Path) -> None:
    content = content_of_chunk()
    packed = _PACK["zstd"](content)
    fixed = 8 + 8 + 8 + 4 + 4 + 4 + 8
    lengths = {"length": fixed + len(packed), "uncompressed": len(content), "stored": len(packed)}
    placeholders = dict.fromkeys(lengths, _ONES) | {known: lengths[known]}
    path = tmp_path / "unfinished.mcap"
    path.write_bytes(unfinished("zstd", packed=packed, **placeholders))
    assert by_scan(path).message_count == _MESSAGES
    (accounts,) = accounts_of(tmp_path)
    assert disagreements(accounts) == []


def test_records_before_an_unfinished_chunk_are_read(tmp_path: Path) -> None:
    made = mcap_of(chunks())
    data = made.read(0, made.size_bytes)
    whole = data[: data.rindex(bytes([Opcode.DATA_END]) + struct.pack("<Q", 4))]
    begun = unfinished("zstd", packed=b"", length=_ONES, uncompressed=_ONES, stored=_ONES)
    chunk_at = begun.index(bytes([Opcode.CHUNK]) + bytes([255]) * 8)
    path = tmp_path / "unfinished.mcap"
    path.write_bytes(whole + begun[chunk_at:] + _PACK["zstd"](b""))
    assert by_scan(path).message_count == 15
    assert "never finished" in str(by_scan(path).reason)
    (accounts,) = accounts_of(tmp_path)
    assert disagreements(accounts) == []
