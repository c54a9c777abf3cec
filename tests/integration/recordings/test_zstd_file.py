"""Recordings compressed as a whole: intact, truncated, damaged, and larger than they claim."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
import zstandard

from kleinkram.recordings import Content, Depth, FileSource, RecordingFormat, RecordingSummary, summarise
from kleinkram.recordings.formats.zstd_file import scan_zstd_file
from kleinkram.recordings.sources import PipeReader, SourceReader
from kleinkram.recordings.summary import scan
from tests.recording_files.corpus import Entry, params
from tests.recording_files.databases import make_database, steady


def scan_bytes(data: bytes, name: str) -> RecordingSummary:
    return scan(PipeReader(io.BytesIO(data), len(data), name))


@pytest.fixture(autouse=True)
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder for copies, empty at the end of every test."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(folder))
    return folder


@pytest.fixture
def database(tmp_path: Path) -> bytes:
    return make_database(tmp_path / "a.db3", messages=steady(3000, size=1000)).read_bytes()


@pytest.mark.parametrize("entry", params("file-zstd of ROS2 sqlite3 db3", "file-zstd of MCAP"))
def test_real_files(entry: Entry, recordings_dir: Path, temporary: Path) -> None:
    path = recordings_dir / entry.name
    with FileSource(path) as source:
        scanned, summarised = scan(SourceReader(source)), summarise(source)
    assert scanned == summarised
    expected = entry.expected
    assert (scanned.content, scanned.reason, scanned.depth) == (Content.indexed, None, Depth.scan)
    assert scanned.format is (RecordingFormat.mcap if "MCAP" in entry.format else RecordingFormat.rosbag2_db3)
    assert scanned.message_count == expected["messages"]
    assert {*expected["compression"]} <= {*scanned.compression} <= {"file-zstd", "zstd"}
    assert (scanned.start_ns, scanned.end_ns) == (expected["start_ns"], expected["end_ns"])
    actual = [(t.name, t.message_type, t.count, t.message_encoding) for t in scanned.topics]
    assert actual == sorted((t["topic"], t["type"], t["count"], t["encoding"]) for t in expected["topics"])
    assert scanned.problems == ()
    assert [*temporary.iterdir()] == []


def test_several_frames_and_one_to_skip(database: bytes) -> None:
    half = len(database) // 2
    skippable = b"\x50\x2a\x4d\x18" + (5).to_bytes(4, "little") + b"hello"
    packed = zstandard.compress(database[:half]) + skippable + zstandard.compress(database[half:])
    summary = scan_bytes(packed, "a.db3.zstd")
    assert (summary.content, summary.reason, summary.message_count) == (Content.indexed, None, 3000)


@pytest.mark.parametrize("checksum", [False, True])
def test_cut_anywhere(checksum: bool, database: bytes, temporary: Path) -> None:
    """Whatever came out until the cut is read."""
    packed = zstandard.ZstdCompressor(level=1, write_checksum=checksum).compress(database)
    actual = []
    for tenth in range(1, 10):
        cut = len(packed) * tenth // 10
        summary = scan_bytes(packed[:cut], "a.db3.zstd")
        assert summary.content in (Content.broken, Content.recovered)
        assert summary.reason is not None
        assert summary.reason.startswith(f"its zstd data breaks off at byte {cut}")
        assert summary.compression in ((), ("file-zstd",))
        actual.append(summary.message_count or 0)
    assert actual == sorted(actual)
    assert 1000 < actual[-1] < 3000
    assert scan_bytes(packed[:-1], "a.db3.zstd").content is Content.recovered
    assert [*temporary.iterdir()] == []


@pytest.mark.parametrize("with_size", [False, True])
def test_bytes_after_the_last_frame_are_reported(with_size: bool, database: bytes) -> None:
    packed = zstandard.ZstdCompressor(write_content_size=with_size).compress(database)
    empty = zstandard.compress(b"")
    assert scan_bytes(packed + empty, "a.db3.zstd").content is Content.indexed
    for left_over in (empty[:4], empty[:-1]):
        summary = scan_bytes(packed + left_over, "a.db3.zstd")
        assert (summary.content, summary.message_count) == (Content.recovered, 3000)
        assert "breaks off" in (summary.reason or "")


def test_damaged_data_say_where(database: bytes) -> None:
    packed = bytearray(zstandard.ZstdCompressor(write_checksum=True).compress(database))
    packed[len(packed) // 2] ^= 0xFF
    summary = scan_bytes(bytes(packed), "a.db3.zstd")
    assert summary.content in (Content.recovered, Content.broken)
    assert "its zstd data is damaged" in (summary.reason or "")


@pytest.mark.parametrize(
    ("inside", "named"),
    [(b"just words", "inside is unknown"), (b"a,b\n1,2\n3,4\n", "inside is csv"), (b"", "inside is empty")],
)
def test_files_that_are_no_recordings_are_not_decompressed(inside: bytes, named: str) -> None:
    summary = scan_bytes(zstandard.compress(inside), "notes.zst")
    assert (summary.format, summary.content) == (RecordingFormat.zstd, Content.opaque)
    assert named in (summary.reason or "")


def test_the_name_inside_must_match_the_content(database: bytes) -> None:
    summary = scan_bytes(zstandard.compress(database), "a.mcap.zstd")
    assert [(p.code, p.where) for p in summary.problems] == [("extension-lies", "a.mcap")]


def test_a_bomb_ends_at_the_bound(database: bytes, temporary: Path) -> None:
    bomb = zstandard.compress(database + bytes(200_000_000))
    assert len(bomb) < len(database)
    reader = PipeReader(io.BytesIO(bomb), len(bomb), "a.db3.zstd")
    summary = scan_zstd_file(reader, max_bytes=5_000_000)
    assert summary.content is Content.pending
    assert "more than 5000000 bytes" in (summary.reason or "")
    assert [*temporary.iterdir()] == []


def test_a_database_from_a_pipe_is_copied_and_the_copy_is_gone(database: bytes, temporary: Path) -> None:
    summary = scan_bytes(database, "a.db3")
    assert (summary.content, summary.message_count) == (Content.indexed, 3000)
    assert [*temporary.iterdir()] == []


def test_no_copy_without_space(database: bytes, monkeypatch: pytest.MonkeyPatch, temporary: Path) -> None:
    monkeypatch.setattr("kleinkram.recordings.temporary_files.MIN_FREE_DISK_BYTES", 2**62)
    summary = scan_bytes(database, "a.db3")
    assert summary.content is Content.pending
    assert str(temporary) in (summary.reason or "")
    assert [*temporary.iterdir()] == []


def test_temporary_files_of_a_killed_reader_are_removed_by_the_next(database: bytes, temporary: Path) -> None:
    import fcntl
    import os

    left, used, new = (temporary / f"kleinkram-spool-{name}" for name in ("left", "used", "new"))
    for path in (left, used, new):
        path.write_bytes(b"x")
    for path in (left, used):
        os.utime(path, (0, 0))
    with used.open() as reader:
        fcntl.flock(reader, fcntl.LOCK_EX)
        scan_bytes(database, "a.db3")
        assert sorted(temporary.iterdir()) == [new, used]
