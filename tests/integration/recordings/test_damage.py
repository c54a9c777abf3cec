"""Damage at any place: a scan never raises, finds every undamaged message, and measures the loss."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from io import BytesIO

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from kleinkram.recordings import Content, RecordingSummary
from kleinkram.recordings.formats.mcap import records
from kleinkram.recordings.formats.mcap.records import Opcode
from kleinkram.recordings.sources import SourceReader
from kleinkram.recordings.summary import scan
from tests.recording_files.memory_source import MemorySource
from tests.recording_files.writers import BagCompression, BagWriter, Compression, McapWriter

T0 = 1_700_000_000_000_000_000
MESSAGES = 120
TOPICS = ("/imu", "/image", "/tf")


@dataclass(frozen=True)
class Whole:
    """A whole recording, and where its chunks stand: start, end, and messages of each."""

    name: str
    data: bytes
    chunks: tuple[tuple[int, int, int], ...]


def payload(number: int) -> bytes:
    """Bytes that do not compress away, and that look like no record."""
    return bytes((number * 37 + i * i) % 251 for i in range(60))


def make_mcap(compression: Compression) -> Whole:
    out = BytesIO()
    writer = McapWriter(out, compression=compression, chunk_bytes=1_500)
    channels = [writer.add_channel(topic, writer.add_schema("T", "ros2msg", b"int8 x"), "cdr") for topic in TOPICS]
    for number in range(MESSAGES):
        stamp = T0 + number * 1_000_000
        writer.add_message(channels[number % 3], stamp, payload(number), publish_time_ns=stamp)
    writer.finish()
    data = out.getvalue()
    return Whole(f"{compression.name}.mcap", data, tuple(mcap_chunks(data)))


def mcap_chunks(data: bytes) -> list[tuple[int, int, int]]:
    """Return the chunks by a plain walk; the message indexes behind each tell its messages."""
    actual: list[tuple[int, int, int]] = []
    at = len(records.MAGIC)
    while data[at] != Opcode.DATA_END:
        opcode, length = records.RECORD_HEAD.unpack_from(data, at)
        end = at + records.RECORD_HEAD.size + length
        if opcode == Opcode.CHUNK:
            actual.append((at, end, 0))
        elif opcode == Opcode.MESSAGE_INDEX:
            start, chunk_end, messages = actual.pop()
            actual.append((start, chunk_end, messages + (length - 6) // 16))
        at = end
    return actual


def make_unchunked() -> Whole:
    """An MCAP whose messages stand outside of chunks: each is a chunk of its own, as far as damage goes."""
    definitions = record(Opcode.SCHEMA, struct.pack("<HI", 1, 1) + b"T" + struct.pack("<I", 7) + b"ros2msg" + bytes(4))
    for number, topic in enumerate(TOPICS):
        name = topic.encode()
        body = struct.pack("<HHI", number, 1, len(name)) + name + struct.pack("<I", 3) + b"cdr" + bytes(4)
        definitions += record(Opcode.CHANNEL, body)
    out = records.MAGIC + record(Opcode.HEADER, bytes(8)) + definitions
    places = []
    for number in range(MESSAGES):
        stamp = T0 + number * 1_000_000
        message = record(Opcode.MESSAGE, struct.pack("<HIQQ", number % 3, number, stamp, stamp) + payload(number))
        places.append((len(out), len(out) + len(message), 1))
        out += message
    out += record(Opcode.DATA_END, bytes(4))
    footer = struct.pack("<QQI", len(out), 0, 0)
    out += definitions + record(Opcode.FOOTER, footer) + records.MAGIC
    return Whole("unchunked.mcap", out, tuple(places))


def record(opcode: int, body: bytes) -> bytes:
    return records.RECORD_HEAD.pack(opcode, len(body)) + body


def make_bag(compression: BagCompression) -> Whole:
    out = BytesIO()
    writer = BagWriter(out, compression=compression, chunk_bytes=1_500)
    connections = [writer.add_connection(topic, "a/B", md5sum="*", definition="int8 x") for topic in TOPICS]
    counts: list[int] = []
    starts: list[int] = []
    before = 0
    for number in range(MESSAGES):
        position = out.tell()
        writer.add_message(connections[number % 3], T0 + number * 1_000_000, payload(number))
        if out.tell() != position:
            starts.append(position)
            counts.append(number + 1 - before)
            before = number + 1
    starts.append(out.tell())
    counts.append(MESSAGES - before)
    writer.finish()
    data = out.getvalue()
    ends = [start + chunk_bytes(data, start) for start in starts]
    return Whole(f"{compression.value}.bag", data, tuple(zip(starts, ends, counts, strict=True)))


def chunk_bytes(data: bytes, start: int) -> int:
    (head,) = struct.unpack_from("<I", data, start)
    (body,) = struct.unpack_from("<I", data, start + 4 + head)
    return 8 + int(head) + int(body)


MADE = [*map(make_mcap, Compression), *map(make_bag, BagCompression), make_unchunked()]
WHOLE = {whole.name: whole for whole in MADE}
NAMES = st.sampled_from(sorted(WHOLE))
PLACES = st.floats(0, 1)


def place_of(name: str, at: int) -> float:
    """Return what leads to a byte of a file, as the tests choose one."""
    return (at - 13 + 0.5) / (len(WHOLE[name].data) - 14)


def scanned(data: bytes, name: str) -> RecordingSummary:
    return scan(SourceReader(MemorySource(data, name)))


def untouched(whole: Whole, start: int, end: int) -> int:
    """Messages of the chunks that [start, end) does not touch."""
    return sum(messages for first, last, messages in whole.chunks if last <= start or end <= first)


def assert_measured(summary: RecordingSummary, whole: Whole, readable: int) -> None:
    assert summary.message_count is not None
    assert readable <= summary.message_count <= MESSAGES
    assert summary.content in (Content.indexed, Content.recovered, Content.broken)
    assert (summary.content is Content.indexed) == (summary.reason is None)
    if summary.content is Content.broken:
        assert summary.message_count == 0
    if summary.lost is not None:
        assert 0 <= summary.lost.bytes <= len(whole.data)
        assert 0 <= summary.lost.chunks <= len(whole.chunks)
        if summary.lost.messages is not None:
            assert summary.lost.messages + summary.message_count == MESSAGES


@pytest.mark.parametrize("name", sorted(WHOLE))
def test_undamaged(name: str) -> None:
    whole = WHOLE[name]
    summary = scanned(whole.data, whole.name)
    assert (summary.content, summary.message_count, summary.lost) == (Content.indexed, MESSAGES, None)
    assert summary.problems == ()
    assert sum(messages for _, _, messages in whole.chunks) == MESSAGES


@given(NAMES, PLACES, st.integers(1, 4096))
@settings(max_examples=500, deadline=None)
def test_a_range_of_zeros_loses_only_the_chunks_that_it_overlaps(name: str, place: float, length: int) -> None:
    whole = WHOLE[name]
    start = 13 + int(place * (len(whole.data) - 14))
    end = min(len(whole.data), start + length)
    damaged = whole.data[:start] + bytes(end - start) + whole.data[end:]
    assert_measured(scanned(damaged, whole.name), whole, untouched(whole, start, end))


@given(NAMES, PLACES, st.integers(1, 4096))
@example("lz4.bag", 0.5, 406)  # a damaged chunk ends where the next one's compressed data look like a message
@example("zstd.mcap", 0.3515625, 250)  # what is left of a chunk's head looks like a record of unknown kind
@example("none.mcap", 0.8125, 701)  # a damaged chunk reaches over the next one, to a record of that one's index
@example("bz2.bag", place_of("bz2.bag", 19001), 1)  # what is left of a chunk info claims messages without number
@example("lz4.mcap", 0.9296875, 411)  # what is left of the statistics claims more messages than there are stars
@example("none.mcap", place_of("none.mcap", 3735), 1600)  # a chunk is gone with its index; what is left fits together
@example("bz2.bag", place_of("bz2.bag", 12746), 1680)  # what is left of a chunk's head claims more than is held at once
@example("none.bag", place_of("none.bag", 4530), 3181)  # a message's length reaches into the next chunk but one
@example("lz4.mcap", place_of("lz4.mcap", 3286), 7)  # what is left of a message index looks like a message
@example("none.mcap", place_of("none.mcap", 1730), 22)  # ... like a record of unknown kind that reaches into a chunk
@settings(max_examples=500, deadline=None)
def test_a_missing_range_loses_only_the_chunks_that_it_overlaps(name: str, place: float, length: int) -> None:
    whole = WHOLE[name]
    start = 13 + int(place * (len(whole.data) - 14))
    end = min(len(whole.data), start + length)
    damaged = whole.data[:start] + whole.data[end:]
    assert_measured(scanned(damaged, whole.name), whole, untouched(whole, start, end))


@given(NAMES, PLACES)
@settings(max_examples=250, deadline=None)
def test_a_cut_anywhere(name: str, place: float) -> None:
    whole = WHOLE[name]
    start = 13 + int(place * (len(whole.data) - 14))
    summary = scanned(whole.data[:start], whole.name)
    assert summary.content is not Content.indexed
    assert_measured(summary, whole, untouched(whole, start, len(whole.data)))


@given(NAMES, PLACES, st.integers(0, 7))
@example("none.mcap", 0.7531278399983186, 1)  # a message index becomes a message
@example("none.mcap", place_of("none.mcap", 1658), 1)  # a message index is said to hold some of the next chunk
@example("none.mcap", place_of("none.mcap", 1846), 1)  # the last message index of a chunk becomes a message
@example("none.mcap", place_of("none.mcap", 13884), 0)  # a channel in the summary becomes a message
@example("lz4.bag", 0.30179838998996594, 3)  # a chunk is said to be so long that it holds the next one, too
@settings(max_examples=500, deadline=None)
def test_a_flipped_bit(name: str, place: float, bit: int) -> None:
    whole = WHOLE[name]
    at = 13 + int(place * (len(whole.data) - 14))
    damaged = bytearray(whole.data)
    damaged[at] ^= 1 << bit
    assert_measured(scanned(bytes(damaged), whole.name), whole, untouched(whole, at, at + 1))
