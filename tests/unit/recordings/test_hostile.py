"""Files with false claims are summarised quickly and in little memory."""

from __future__ import annotations

import struct
import zlib
from io import BytesIO

import pytest
import zstandard

from kleinkram.recordings import Content, Fact, Lost, RecordingFormat, RecordingSummary, summarise
from kleinkram.recordings.formats.mcap import records
from kleinkram.recordings.formats.mcap.records import Opcode
from kleinkram.recordings.formats.rosbag1.records import MAGIC as BAG_MAGIC
from kleinkram.recordings.sources import SourceReader
from kleinkram.recordings.summary import scan
from tests.recording_files.memory_source import MemorySource
from tests.recording_files.writers import BagWriter, Compression, McapWriter

T0 = 1_700_000_000_000_000_000
HUGE = 2**63


def small_mcap(compression: Compression = Compression.zstd) -> bytes:
    """Return a whole MCAP with two chunks of 20 messages each."""
    out = BytesIO()
    writer = McapWriter(out, compression=compression, chunk_bytes=1_000)
    channel = writer.add_channel("/t", writer.add_schema("T", "ros2msg", b"int8 x"), "cdr")
    for number in range(40):
        writer.add_message(channel, T0 + number, b"p" * 20, publish_time_ns=0)
    writer.finish()
    return out.getvalue()


def small_bag() -> bytes:
    """Return a whole bag with several chunks."""
    out = BytesIO()
    writer = BagWriter(out, chunk_bytes=1_000)
    connection = writer.add_connection("/t", "a/B", md5sum="*", definition="int8 x")
    for number in range(40):
        writer.add_message(connection, T0 + number, b"p" * 20)
    writer.finish()
    return out.getvalue()


def record(opcode: int, body: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(body)) + body


def mcap_of(data: bytes, summary: bytes = b"") -> bytes:
    """Return an MCAP of a header, some data, and a summary section without CRC."""
    front = records.MAGIC + record(Opcode.HEADER, bytes(8)) + data + record(Opcode.DATA_END, bytes(4))
    footer = struct.pack("<QQI", len(front) if summary else 0, 0, 0)
    return front + summary + record(Opcode.FOOTER, footer) + records.MAGIC


def summarise_bytes(data: bytes, name: str = "test.mcap") -> RecordingSummary:
    return summarise(MemorySource(data, name))


def chunk_index(start: int, length: int, index_length: int, offsets_claim: int = 0) -> bytes:
    head = struct.pack("<QQQQI", 0, 0, start, length, offsets_claim)
    return record(Opcode.CHUNK_INDEX, head + struct.pack("<QI", index_length, 0) + struct.pack("<QQ", 10, 10))


def chunk(compression: bytes, stored: bytes, uncompressed: int, crc: int = 0) -> bytes:
    head = struct.pack("<QQQII", 0, 0, uncompressed, crc, len(compression)) + compression
    return record(Opcode.CHUNK, head + struct.pack("<Q", len(stored)) + stored)


def test_the_small_files_are_undamaged() -> None:
    for compression in Compression:
        assert summarise_bytes(small_mcap(compression)).content is Content.indexed
    assert summarise_bytes(small_bag(), "test.bag").content is Content.indexed


@pytest.mark.parametrize(
    "summary",
    [
        chunk_index(HUGE, 10, 10),
        chunk_index(2**64 - 1, 2**64 - 1, 2**64 - 1),
        chunk_index(8, 10, HUGE),
        chunk_index(8, 10, 10, offsets_claim=2**32 - 1),
        chunk_index(8, 20, 0) + chunk_index(8, 20, 0),
        record(Opcode.STATISTICS, struct.pack("<QHIIIIQQ", HUGE, 0, 0, 0, 0, 0, 0, 0) + struct.pack("<I", 2**32 - 1)),
        struct.pack("<BQ", Opcode.CHUNK_INDEX, HUGE),
        struct.pack("<BQ", Opcode.SCHEMA, HUGE) + bytes(30),
        record(Opcode.CHANNEL, struct.pack("<HHI", 0, 0, 2**31)),
        b"\x08",
    ],
    ids=[
        "chunk beyond file",
        "numbers that overflow",
        "index beyond file",
        "map beyond record",
        "overlapping chunks",
        "too many messages",
        "record beyond file",
        "schema beyond file",
        "name beyond record",
        "cut record",
    ],
)
def test_a_wrong_index_is_refused(summary: bytes) -> None:
    actual = summarise_bytes(mcap_of(b"", summary))
    assert actual.message_count == 0
    assert actual.problems


def test_a_summary_that_begins_beyond_the_file() -> None:
    data = bytearray(small_mcap())
    at = len(data) - len(records.MAGIC) - records.FOOTER_BODY.size
    data[at : at + 8] = struct.pack("<Q", HUGE)
    summary = summarise_bytes(bytes(data))
    assert (summary.content, summary.message_count) == (Content.indexed, 40)
    assert [problem.code for problem in summary.problems] == ["index-damaged"]


def test_a_flipped_byte_in_the_summary_is_found_by_its_checksum() -> None:
    data = small_mcap()
    at = data.rindex(b"ros2msg")
    flipped = data[:at] + b"r0s2msg" + data[at + 7 :]
    summary = summarise_bytes(flipped)
    assert (summary.content, summary.message_count) == (Content.indexed, 40)
    assert summary.topics[0].schema_encoding == "ros2msg"
    assert "checksum" in summary.problems[0].message


def test_an_index_that_omits_a_chunk_is_refused() -> None:
    """The statistics say more messages than the chunks in the index hold."""
    whole = small_mcap()
    start = whole.index(bytes([Opcode.CHUNK_INDEX]) + struct.pack("<Q", 78), len(whole) // 2)
    at = len(whole) - len(records.MAGIC) - 4
    without = whole[:start] + whole[start + 9 + 78 :]
    at = len(without) - len(records.MAGIC) - 4
    without = without[:at] + bytes(4) + without[at + 4 :]
    summary = summarise_bytes(without)
    assert (summary.content, summary.message_count) == (Content.indexed, 40)
    assert [problem.code for problem in summary.problems] == ["index-damaged"]


def test_a_chunk_that_holds_more_than_it_claims() -> None:
    """A bomb: 64 MB out of a few kilobytes, though 100 bytes were claimed."""
    bomb = zstandard.compress(bytes(64 * 2**20))
    summary = summarise_bytes(mcap_of(chunk(b"zstd", bomb, 100)))
    assert summary.content is Content.broken
    assert summary.reason is not None
    assert "100 bytes" in summary.reason


@pytest.mark.parametrize(
    ("compression", "stored"),
    [(b"zstd", b"rubbish rubbish rubbish"), (b"lz4", b"rubbish rubbish"), (b"lz4", b""), (b"zstd", b"")],
)
def test_rubbish_in_a_chunk(compression: bytes, stored: bytes) -> None:
    summary = summarise_bytes(mcap_of(chunk(compression, stored, 1_000)))
    assert (summary.content, summary.message_count) == (Content.broken, 0)
    assert summary.reason is not None
    assert summary.reason.startswith("it is damaged in the chunk at byte 25: ")
    assert summary.lost is not None
    assert summary.lost.chunks == 1


def test_a_file_with_an_unsupported_compression_is_opaque() -> None:
    summary = summarise_bytes(mcap_of(chunk(b"brotli", b"x" * 50, 1_000)))
    assert summary.content is Content.opaque
    assert summary.reason is not None
    assert "'brotli'" in summary.reason


def test_a_zstd_frame_that_needs_too_much_memory_is_no_damage() -> None:
    parameters = zstandard.ZstdCompressionParameters(window_log=27)
    compressor = zstandard.ZstdCompressor(compression_params=parameters).compressobj()
    stored = compressor.compress(b"x" * 1_000) + compressor.flush()
    summary = summarise_bytes(mcap_of(chunk(b"zstd", stored, 100_000_000)))
    assert summary.content is Content.opaque
    assert summary.reason is not None
    assert "bytes of memory" in summary.reason


def test_a_wrong_chunk_checksum_keeps_the_other_chunks() -> None:
    data = small_mcap(Compression.none)
    at = data.index(b"p" * 20)
    unindexed = data[:at] + b"q" + data[at + 1 :]
    footer_at = len(data) - records.FOOTER_BYTES + records.RECORD_HEAD.size
    unindexed = unindexed[:footer_at] + bytes(20) + records.MAGIC
    summary = summarise_bytes(unindexed)
    assert (summary.content, summary.message_count) == (Content.recovered, 21)
    assert summary.lost is not None
    assert (summary.lost.chunks, summary.lost.messages) == (1, 19)
    assert summary.reason is not None
    assert "checksum" in summary.reason


def test_a_chunk_whose_name_reaches_beyond_it() -> None:
    head = struct.pack("<QQQII", 0, 0, 100, 0, 50)
    summary = summarise_bytes(mcap_of(record(Opcode.CHUNK, head + b"zstd")))
    assert summary.content is Content.broken
    assert summary.reason is not None
    assert "contradict" in summary.reason


def test_more_channels_than_any_robot_has() -> None:
    channels = b"".join(
        record(Opcode.CHANNEL, struct.pack("<HHI", number, 0, 5) + b"/" + b"%04x" % number + bytes(8))
        for number in range(30_000)
    )
    summary = summarise_bytes(mcap_of(channels))
    assert summary.content is Content.opaque
    assert len(summary.topics) <= 20_000


def test_names_that_are_not_utf8_can_be_shown() -> None:
    channel = record(Opcode.CHANNEL, struct.pack("<HHI", 0, 0, 3) + b"/\xff\xfe" + bytes(8))
    (topic,) = summarise_bytes(mcap_of(channel)).topics
    assert topic.name == "/\ufffd\ufffd"


@pytest.mark.parametrize(
    ("field", "value", "content"),
    [
        ("index_pos", HUGE, Content.indexed),
        ("index_pos", 20, Content.indexed),
        ("index_pos", 0, Content.recovered),
        ("conn_count", 2**31, Content.recovered),
        ("chunk_count", 2**31, Content.recovered),
    ],
)
def test_a_wrong_bag_header(field: str, value: int, content: Content) -> None:
    """Everything is there: only its header is wrong, or announces what never was."""
    data = small_bag()
    at = data.index(field.encode() + b"=") + len(field) + 1
    raw = struct.pack("<Q" if field == "index_pos" else "<I", value)
    summary = summarise_bytes(data[:at] + raw + data[at + len(raw) :], "test.bag")
    assert (summary.format, summary.content, summary.message_count) == (RecordingFormat.rosbag1, content, 40)
    assert summary.reason if content is Content.recovered else summary.problems


@pytest.mark.parametrize("position", [0, HUGE, 2**64 - 1])
def test_a_bag_index_that_points_elsewhere(position: int) -> None:
    data = small_bag()
    at = data.rindex(b"chunk_pos=") + len("chunk_pos=")
    summary = summarise_bytes(data[:at] + struct.pack("<Q", position) + data[at + 8 :], "test.bag")
    assert (summary.content, summary.message_count) == (Content.indexed, 40)
    # It lists a chunk where there is none, and one that is there is not listed.
    assert [problem.code for problem in summary.problems] == ["index-damaged", "index-damaged"]


def test_a_bag_whose_index_data_contradict_its_chunk_info() -> None:
    data = small_bag()
    at = data.rindex(b"chunk_pos=")
    count_at = len(data) - 4
    assert count_at > at
    summary = summarise_bytes(data[:count_at] + struct.pack("<I", 1) + data[count_at + 4 :], "test.bag")
    assert (summary.content, summary.message_count) == (Content.indexed, 40)
    assert [problem.code for problem in summary.problems] == ["counts-disagree"]


@pytest.mark.parametrize(
    ("data", "name", "kind", "lies"),
    [
        (small_mcap(), "drive.bag", RecordingFormat.mcap, True),
        (small_bag(), "drive.mcap", RecordingFormat.rosbag1, True),
        (small_bag(), "drive.BAG", RecordingFormat.rosbag1, False),
        (small_mcap(), "drive.svo2", RecordingFormat.mcap, False),
        (small_mcap(), "drive.yaml", RecordingFormat.mcap, True),
        (small_mcap(), "drive", RecordingFormat.mcap, False),
        (b"\x89PNG\r\n\x1a\n\0\0", "drive.mcap", RecordingFormat.unknown, True),
        (b"SQLite format 3\0" + bytes(200), "drive.db3", RecordingFormat.unknown, True),
        (b"#ROSBAG V1.2\n", "old.bag", RecordingFormat.rosbag1_old, False),
        (b"a,b\n1,2\n3,4\n", "t.csv", RecordingFormat.csv, False),
        (b"robot: anymal\nyear: 2024\n", "m.yaml", RecordingFormat.yaml, False),
        (b"1 0 0 0 0 1 0 0 0 0 1 0\n", "poses.txt", RecordingFormat.kitti, False),
        (b"# t x y z qx qy qz qw\n1 0 0 0 0 0 0 1\n", "poses.txt", RecordingFormat.tum, False),
        (b"just words", "notes.txt", RecordingFormat.unknown, False),
        (b"", "drive.mcap", RecordingFormat.empty, False),
    ],
)
def test_files_are_recognised_by_their_content(data: bytes, name: str, kind: RecordingFormat, lies: bool) -> None:
    summary = summarise_bytes(data, name)
    assert summary.format is kind
    assert ("extension-lies" in [problem.code for problem in summary.problems]) == lies


def test_an_empty_file_is_reported_as_empty() -> None:
    summary = summarise_bytes(b"")
    assert (summary.content, summary.reason) == (Content.broken, "the file has 0 bytes")


def test_only_the_magic_of_a_bag() -> None:
    assert summarise_bytes(BAG_MAGIC, "a.bag").content is Content.broken


def test_private_records_are_passed_over() -> None:
    private = record(0x80, b"x" * 40) + record(0xFF, b"")
    data = mcap_of(private + chunk(b"", private, len(private)) + private)
    assert (summarise_bytes(data).content, summarise_bytes(data).message_count) == (Content.indexed, 0)


def test_attachments_and_metadata_are_listed() -> None:
    name = struct.pack("<I", 3) + b"cal"
    attachment = record(Opcode.ATTACHMENT, bytes(16) + name + bytes(4) + struct.pack("<Q", 5) + b"12345" + bytes(4))
    metadata = record(Opcode.METADATA, name + bytes(4))
    summary = summarise_bytes(mcap_of(attachment * 300 + metadata))
    assert (summary.content, summary.attachments, summary.metadata_records) == (Content.indexed, 300, 1)
    assert summary.facts[0] == Fact("attachment", "cal (of no type, 5 bytes)")
    assert len(summary.facts) == 100


def test_the_data_section_checksum_finds_bytes_flipped_outside_chunks() -> None:
    message = record(Opcode.MESSAGE, struct.pack("<HIQQ", 0, 0, T0, T0) + b"payload")
    definition = record(Opcode.CHANNEL, struct.pack("<HHI", 0, 0, 2) + b"/t" + bytes(8))
    front = records.MAGIC + record(Opcode.HEADER, bytes(8)) + definition + message
    crc, footer = zlib.crc32(front), record(Opcode.FOOTER, bytes(20)) + records.MAGIC
    flipped = front.replace(b"payload", b"pazload")
    for data, claimed, content in (
        (front, crc, Content.indexed),
        (front, 0, Content.indexed),
        (flipped, crc, Content.recovered),
    ):
        end = record(Opcode.DATA_END, struct.pack("<I", claimed)) + footer
        summary = scan(SourceReader(MemorySource(data + end)))
        assert (summary.content, summary.message_count) == (content, 1)
        assert summary.lost == (None if content is Content.indexed else Lost(0, 0, None))
    assert "data section" in (summary.reason or "")
    assert "nothing is lost" not in (summary.reason or "")


def test_an_attachment_with_a_wrong_checksum_is_reported() -> None:
    attachment = record(Opcode.ATTACHMENT, bytes(24) + struct.pack("<Q", 5) + b"12345" + b"\1\2\3\4")
    summary = summarise_bytes(mcap_of(attachment))
    assert (summary.content, summary.attachments) == (Content.recovered, 1)
    assert summary.reason is not None
    assert "attachment" in summary.reason


@pytest.mark.parametrize("name", [b"size", b"compression"])
def test_a_cut_bag_whose_chunk_lacks_a_field(name: bytes) -> None:
    """The last chunk reaches beyond the end of the file, and its header does not say how it is to be read."""
    data = small_bag()
    at = data.rindex(name + b"=")
    hurt = data[:at] + name.upper() + data[at + len(name) : at + 60]
    summary = summarise(MemorySource(hurt, "test.bag"))
    assert summary.content is Content.recovered
    assert 0 < (summary.message_count or 0) < 40
