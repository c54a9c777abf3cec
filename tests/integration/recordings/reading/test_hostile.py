"""Hostile and damaged files: reading ends in bounded memory, with messages and problems."""

from __future__ import annotations

import random
import struct
from collections.abc import Callable, Iterable
from io import BytesIO
from pathlib import Path

import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st

from kleinkram.recordings import NotARecording, Recording, TooCostly
from kleinkram.recordings.errors import SourceError
from kleinkram.recordings.formats.mcap import records
from kleinkram.recordings.formats.mcap.records import Opcode
from kleinkram.recordings.formats.rosbag2.pages import LEAF_INDEX
from kleinkram.recordings.sample import generate_db3
from kleinkram.recordings.sources import FileSource
from tests.memory import call_within
from tests.recording_files.builders import T0, Stamped, Watched, bag_of, mcap_of
from tests.recording_files.databases import T0 as DATABASE_T0
from tests.recording_files.databases import make_database, steady
from tests.recording_files.memory_source import MemorySource

Make = Callable[[Iterable[Iterable[Stamped]]], MemorySource]


def small(make: Make) -> bytes:
    rng = random.Random(1)
    chunks = [
        [(f"/t{n % 2}", T0 + chunk * 100 + n, rng.randbytes(rng.randrange(40))) for n in range(8)] for chunk in range(4)
    ]
    source = make(chunks)
    return source.read(0, source.size_bytes)


FILES = {"mcap": small(mcap_of), "bag": small(bag_of)}


def read_all(data: bytes, name: str) -> tuple[int, int]:
    """Read a file whatever is in it; return how many messages and problems there are."""
    try:
        recording = Recording.open(MemorySource(data, name))
    except NotARecording:
        return 0, 1
    actual = list(recording.raw_messages())
    assert [m.log_time_ns for m in actual] == sorted(m.log_time_ns for m in actual)
    list(recording.messages("/t0*"))
    return len(actual), len(recording.problems)


@pytest.mark.parametrize("kind", ["mcap", "bag"])
@settings(max_examples=150, deadline=None)
@given(place=st.floats(0, 1, exclude_max=True), value=st.integers(0, 255), length=st.sampled_from([1, 2, 8]))
def test_flipped_bytes(kind: str, place: float, value: int, length: int) -> None:
    data = bytearray(FILES[kind])
    at = int(place * len(data))
    data[at : at + length] = bytes([value]) * min(length, len(data) - at)
    read_all(bytes(data), kind)


@pytest.mark.parametrize("kind", ["mcap", "bag"])
def test_cut_anywhere(kind: str) -> None:
    whole = FILES[kind]
    counts = [read_all(whole[:length], kind)[0] for length in range(0, len(whole), 7)]
    assert counts[0] == 0
    assert max(counts) == 32
    assert counts == sorted(counts)


def test_flipped_database(tmp_path: Path) -> None:
    generate_db3(tmp_path / "drive", duration_s=0.3, size_bytes=200_000)
    path = tmp_path / "drive" / "drive_0.db3"
    whole = path.read_bytes()
    rng = random.Random(2)
    for number in range(40):
        data = bytearray(whole)
        for _ in range(20):
            data[rng.randrange(100, len(data))] = rng.randrange(256)
        damaged = tmp_path / f"{number}.db3"
        damaged.write_bytes(data)
        try:
            with Recording.open(damaged) as recording:
                assert len(list(recording.raw_messages())) <= 1000
        except NotARecording:
            continue


def test_a_chunk_that_fails_its_checksum_is_left_out_and_named() -> None:
    source = mcap_of([[("/t", T0 + n, b"same" * 50)] for n in range(3)])
    data = bytearray(source.read(0, source.size_bytes))
    places = [at for at in range(len(data)) if data.startswith(b"\x28\xb5\x2f\xfd", at)]
    crc_at = places[1] - 8 - 4 - 4 - 4
    data[crc_at] ^= 1
    recording = Recording.open(MemorySource(bytes(data)))
    assert [m.log_time_ns - T0 for m in recording.raw_messages()] == [0, 2]
    (problem,) = recording.problems
    assert problem.code == "damaged"
    assert "checksum" in problem.message
    assert list(recording.raw_messages()) != []
    assert len(recording.problems) == 1


def chunk_record(content: bytes, *, claimed: int, stored: bytes | None = None) -> bytes:
    stored = zstandard.compress(content) if stored is None else stored
    head = struct.pack("<QQQII", T0, T0, claimed, 0, 4) + b"zstd" + struct.pack("<Q", len(stored))
    return records.RECORD_HEAD.pack(Opcode.CHUNK, len(head) + len(stored)) + head + stored


@pytest.mark.parametrize("claimed", [2**62, 2**40, 100])
def test_a_chunk_may_claim_anything(claimed: int) -> None:
    """A chunk that unpacks to 300 MB of zeros, or says that it holds a million million bytes."""
    bomb = chunk_record(bytes(300 * 2**20), claimed=claimed)
    source = MemorySource(records.MAGIC + bomb)

    def read() -> Recording:
        recording = Recording.open(source)
        assert list(recording.raw_messages()) == []
        return recording

    assert call_within(60_000_000, read).problems


def test_memory_does_not_follow_the_size_of_the_file(tmp_path: Path) -> None:
    """200 MB in chunks of 25 MB, which overlap in time: less than that is held."""
    noise = bytes(range(256)) * 2000
    chunks = [[("/t", T0 + chunk * 10 + n, noise) for n in range(49)] for chunk in range(8)]
    path = tmp_path / "large.mcap"
    out = mcap_of(chunks)
    path.write_bytes(out.read(0, min(out.size_bytes, 16 * 2**20)))
    with FileSource(path) as source:
        count = call_within(150_000_000, lambda: sum(1 for _ in Recording.open(source).raw_messages()))
    assert count == 8 * 49


def test_a_source_that_fails_is_a_source_error() -> None:
    class Failing(Watched):
        def read(self, offset: int, length: int) -> bytes:
            if len(self.ranges) > 2:
                raise SourceError("the store is away")
            return super().read(offset, length)

    noise = random.Random(3).randbytes(40_000)
    recording = Recording.open(Failing(mcap_of([[("/t", T0 + n, noise)] for n in range(20)]), parallel_reads=4))
    with pytest.raises(SourceError, match="away"):
        list(recording.raw_messages())


def test_no_bytes_are_read_beyond_a_bound() -> None:
    out = BytesIO()
    out.write(records.MAGIC)
    out.write(records.RECORD_HEAD.pack(Opcode.MESSAGE, 2**63))
    out.write(bytes(100))
    assert read_all(out.getvalue(), "huge.mcap") == (0, 2)


def test_a_database_with_a_page_of_rubbish_gives_the_others(tmp_path: Path) -> None:
    """SQLite stumbles in the middle; what comes behind is recovered, nothing twice, and all in order."""
    generate_db3(tmp_path / "drive", duration_s=1, size_bytes=300_000)
    path = tmp_path / "drive" / "drive_0.db3"
    with Recording.open(path) as recording:
        whole = [(m.topic, m.log_time_ns, m.data) for m in recording.raw_messages()]
    data = bytearray(path.read_bytes())
    middle = len(data) // 2 // 4096 * 4096
    data[middle : middle + 4096] = b"\xee" * 4096
    path.write_bytes(data)
    with Recording.open(path) as recording:
        left = [(m.topic, m.log_time_ns, m.data) for m in recording.raw_messages()]
        assert recording.problems
    assert len(whole) > len(left) > len(whole) // 2
    assert len(set(left)) == len(left)
    assert left == sorted(left, key=lambda message: message[1])
    assert left[-1] == whole[-1]


def test_a_database_whose_index_is_not_in_order_is_read_without_it(tmp_path: Path) -> None:
    """The times of a flipped index hand messages out of order, and SQLite does not notice."""
    path = make_database(tmp_path / "drive_0.db3", messages=steady(4000))
    data = bytearray(path.read_bytes())
    stamp = (DATABASE_T0 + 1000 * 10_000_000).to_bytes(8, "big")
    in_index = next(
        at
        for page in range(0, len(data), 4096)
        if data[page] == LEAF_INDEX and (at := data.find(stamp, page, page + 4096)) >= 0
    )
    data[in_index : in_index + 8] = (DATABASE_T0 + 3000 * 10_000_000).to_bytes(8, "big")
    path.write_bytes(data)
    with Recording.open(path) as recording:
        actual = [message.log_time_ns for message in recording.raw_messages()]
        assert [problem.code for problem in recording.problems] == ["damaged", "damaged"]
    assert actual == sorted(actual)
    assert len(actual) == 4000


def test_a_bag_with_too_long_chunk_info_is_read_without_index() -> None:
    whole = FILES["bag"]
    info_at = whole.rfind(b"op=\x06")
    length_at = whole.find(struct.pack("<I", 16), info_at)
    damaged = whole[:length_at] + struct.pack("<I", 17) + whole[length_at + 4 :] + b"\0"
    assert read_all(damaged, "test.bag")[0] == read_all(whole, "test.bag")[0]


@pytest.mark.parametrize("kind", ["mcap", "bag"])
def test_a_remote_file_without_index_is_scanned_only_if_allowed(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    cut = Watched(MemorySource(FILES[kind][:-60], f"far.{kind}"))
    monkeypatch.setattr("kleinkram.recordings.formats.base.MAX_REMOTE_SCAN_BYTES", cut.size_bytes - 1)
    with pytest.raises(TooCostly, match=f"far.{kind}: .* max_bytes={cut.size_bytes}") as refused:
        Recording.open(cut)
    assert refused.value.size_bytes == cut.size_bytes
    with Recording.open(cut, max_bytes=cut.size_bytes) as recording:
        assert len(list(recording.raw_messages())) == 32
    with Recording.open(MemorySource(FILES[kind], f"far.{kind}")) as recording:
        assert len(list(recording.raw_messages())) == 32


def test_a_local_file_is_read_whatever_its_size_unless_that_is_bounded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("kleinkram.recordings.formats.base.MAX_REMOTE_SCAN_BYTES", 10)
    path = tmp_path / "cut.mcap"
    path.write_bytes(FILES["mcap"][:-60])
    with Recording.open(path) as recording:
        assert len(list(recording.raw_messages())) == 32
    with pytest.raises(TooCostly):
        Recording.open(path, max_bytes=10)
    generate_db3(tmp_path / "drive", duration_s=1, size_bytes=100_000)
    database = tmp_path / "drive" / "drive_0.db3"
    with Recording.open(database, max_bytes=10) as recording:
        assert recording.message_count
    with pytest.raises(TooCostly, match="local copy"):
        Recording.open(MemorySource(database.read_bytes(), "far.db3"))
