"""Files with a wrong chunk index: it is reported, and all messages are found."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from kleinkram.recordings import FileSource, Recording, RecordingSummary, summarise
from kleinkram.recordings.formats.mcap import records
from kleinkram.recordings.formats.mcap.records import Opcode
from kleinkram.recordings.sources import SourceReader
from kleinkram.recordings.summary import scan
from tests.recording_files.agreement import ParallelSource, accounts_of, disagreements
from tests.recording_files.builders import T0, bag_of, mcap_of
from tests.recording_files.memory_source import MemorySource

CHUNKS = 6
PER_CHUNK = 4
S = 10**9

NEAR_AND_FAR = pytest.mark.parametrize("source", [FileSource, ParallelSource], ids=["near", "far"])
Change = Callable[[int, bytearray], None]


def messages() -> list[list[tuple[str, int, bytes]]]:
    """Return chunks of four seconds each; /b is in every second one."""
    chunks = []
    for number in range(CHUNKS):
        stamps = [T0 + (PER_CHUNK * number + at) * S for at in range(PER_CHUNK)]
        chunks.append([("/b" if number % 2 and at == 1 else "/a", stamp, b"x") for at, stamp in enumerate(stamps)])
    return chunks


def mcap_records(data: bytes | bytearray, start: int, end: int) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, place and length of the body of each record."""
    while start < end:
        opcode, length = records.RECORD_HEAD.unpack_from(data, start)
        yield opcode, start + records.RECORD_HEAD.size, length
        start += records.RECORD_HEAD.size + length


def change_mcap(opcode: int, change: Change) -> bytes:
    """Return an MCAP of which the bodies of the summary's records of a kind were changed, under no checksum."""
    source = mcap_of(messages())
    data = bytearray(source.read(0, source.size_bytes))
    footer_at = len(data) - records.FOOTER_BYTES + records.RECORD_HEAD.size
    summary_start, _, _ = records.FOOTER_BODY.unpack_from(data, footer_at)
    struct.pack_into("<I", data, footer_at + 16, 0)
    actual = [place for place in mcap_records(data, summary_start, footer_at - 9) if place[0] == opcode]
    assert actual
    for number, (_, at, length) in enumerate(actual):
        body = data[at : at + length]
        change(number, body)
        assert len(body) == length
        data[at : at + length] = body
    return bytes(data)


def change_bag(field: bytes, change: Change) -> bytes:
    """Return a bag of which a field of each chunk info was changed."""
    source = bag_of(messages())
    data = bytearray(source.read(0, source.size_bytes))
    at, number = data.index(b"op=\x07", data.rindex(b"op=\x04")), 0
    while (at := data.find(field + b"=", at)) >= 0:
        value = data[at + len(field) + 1 : at + len(field) + 9]
        change(number, value)
        data[at + len(field) + 1 : at + len(field) + 9] = value
        at, number = at + 1, number + 1
    assert number == CHUNKS
    return bytes(data)


def stamp(offset_s: int) -> bytes:
    """Return a time as a bag writes it."""
    return struct.pack("<II", T0 // S + offset_s, 0)


def every_start_late(_: int, body: bytearray) -> None:
    struct.pack_into("<Q", body, 0, struct.unpack_from("<Q", body, 0)[0] + 3 * S)


def one_chunk_far_away(number: int, body: bytearray) -> None:
    if number == 2:
        struct.pack_into("<QQ", body, 0, T0 + 1000 * S, T0 + 1001 * S)


def no_channel_b(_: int, body: bytearray) -> None:
    """Let the list of message indexes name the first channel only, twice."""
    (size,) = struct.unpack_from("<I", body, 32)
    if size == 20:
        body[46:48] = body[36:38]


def bag_start_late(number: int, value: bytearray) -> None:
    value[:] = stamp(PER_CHUNK * number + 3)


def bag_chunk_far_away(number: int, value: bytearray) -> None:
    if number == 2:
        value[:] = stamp(1000)


WRONG = {
    "every-start-late.mcap": lambda: change_mcap(Opcode.CHUNK_INDEX, every_start_late),
    "one-chunk-far-away.mcap": lambda: change_mcap(Opcode.CHUNK_INDEX, one_chunk_far_away),
    "no-channel-b.mcap": lambda: change_mcap(Opcode.CHUNK_INDEX, no_channel_b),
    "every-start-late.bag": lambda: change_bag(b"start_time", bag_start_late),
    "one-chunk-far-away.bag": lambda: change_bag(b"start_time", bag_chunk_far_away),
}
NOT_SEEN_FROM_AFAR = {"no-channel-b.mcap"}
"""To know it, a message index a chunk would have to be read: `problems` does so, and names it."""


def written(name: str, folder: Path) -> Path:
    path = folder / name
    path.write_bytes(WRONG[name]())
    return path


def by_scan(path: Path) -> RecordingSummary:
    with FileSource(path) as source:
        return scan(SourceReader(source))


def by_index(path: Path) -> RecordingSummary:
    with FileSource(path) as source:
        return summarise(source)


@pytest.mark.parametrize("name", WRONG)
def test_summary_and_scan_name_an_index_that_is_wrong_about_chunks(name: str, tmp_path: Path) -> None:
    path = written(name, tmp_path)
    for summary in (by_index(path), by_scan(path)):
        assert summary.content.value == "indexed"
        assert summary.message_count == CHUNKS * PER_CHUNK
        assert (summary.start_ns, summary.end_ns) == (T0, T0 + (CHUNKS * PER_CHUNK - 1) * S)
        assert "index-damaged" in {problem.code for problem in summary.problems}
    (accounts,) = accounts_of(tmp_path)
    assert disagreements(accounts) == []


@pytest.mark.parametrize(
    ("name", "source"), [(name, source) for source in (FileSource, ParallelSource) for name in WRONG]
)
def test_every_span_and_topic_is_complete_though_the_index_is_wrong(
    name: str, source: type[FileSource], tmp_path: Path
) -> None:
    path = written(name, tmp_path)
    every = [(topic, log_ns) for chunk in messages() for topic, log_ns, _ in chunk]
    for first in range(0, CHUNKS * PER_CHUNK, 3):
        with source(path) as opened, Recording.open(opened) as recording:
            start, end = T0 + first * S, T0 + (first + 5) * S
            actual = [(m.topic, m.log_time_ns) for m in recording.raw_messages(start=start, end=end)]
            assert actual == [message for message in every if start <= message[1] < end]
    with source(path) as opened, Recording.open(opened) as recording:
        if source is ParallelSource and name in NOT_SEEN_FROM_AFAR:
            assert recording.problems
        actual = [(m.topic, m.log_time_ns) for m in recording.raw_messages("/b")]
        assert actual == [message for message in every if message[0] == "/b"]
        assert "index-damaged" in {problem.code for problem in recording.problems}
        assert (recording.start_ns, recording.end_ns) == (every[0][1], every[-1][1])


def chunk_two_at_the_end(number: int, body: bytearray) -> None:
    """Let the index say of chunk 2 that it is as late as the second half of chunk 3: no contradiction by itself."""
    if number == 2:
        struct.pack_into("<QQ", body, 0, T0 + (3 * PER_CHUNK + 1) * S, T0 + (4 * PER_CHUNK - 1) * S)


def test_a_local_file_is_read_in_order_despite_late_times_in_the_index(tmp_path: Path) -> None:
    path = tmp_path / "late.mcap"
    path.write_bytes(change_mcap(Opcode.CHUNK_INDEX, chunk_two_at_the_end))
    with Recording.open(path) as recording:
        assert [m.log_time_ns for m in recording.raw_messages()] == [T0 + n * S for n in range(CHUNKS * PER_CHUNK)]
        assert {problem.code for problem in recording.problems} == {"index-damaged"}


def test_all_iterations_are_complete_once_one_found_the_index_wrong(tmp_path: Path) -> None:
    path = tmp_path / "late.mcap"
    path.write_bytes(change_mcap(Opcode.CHUNK_INDEX, chunk_two_at_the_end))
    with ParallelSource(path) as source, Recording.open(source) as recording:
        first = recording.raw_messages(end=T0 + 3 * PER_CHUNK * S)
        actual = [next(first).log_time_ns]
        assert "index-damaged" in {problem.code for problem in recording.problems}
        assert sum(1 for _ in recording.raw_messages()) == CHUNKS * PER_CHUNK
        actual += [m.log_time_ns for m in first]
    assert actual == [T0 + n * S for n in range(3 * PER_CHUNK)]


def test_an_empty_selection_over_a_network_compares_the_index_first(tmp_path: Path) -> None:
    """The times of chunks 1 and 2 are so wrong that nothing seems to lie there, and the statistics do not show it."""

    def moved(number: int, body: bytearray) -> None:
        if number in (1, 2):
            struct.pack_into("<QQ", body, 0, T0, T0 + S)

    path = tmp_path / "moved.mcap"
    path.write_bytes(change_mcap(Opcode.CHUNK_INDEX, moved))
    with ParallelSource(path) as source, Recording.open(source) as recording:
        start = T0 + PER_CHUNK * S
        actual = [m.log_time_ns for m in recording.raw_messages(start=start, end=start + 2 * PER_CHUNK * S)]
        assert actual == [start + number * S for number in range(2 * PER_CHUNK)]


@NEAR_AND_FAR
def test_wrong_times_in_the_statistics_are_named_and_not_repeated(source: type[FileSource], tmp_path: Path) -> None:
    def shift(_: int, body: bytearray) -> None:
        struct.pack_into("<QQ", body, 26, T0 + 2 * S, T0 + 900 * S)

    path = tmp_path / "statistics.mcap"
    path.write_bytes(change_mcap(Opcode.STATISTICS, shift))
    for summary in (by_index(path), by_scan(path)):
        (problem,) = (problem for problem in summary.problems if problem.code == "index-damaged")
        assert (problem.where, "begin 2 s later" in problem.message) == ("statistics", True)
    with source(path) as opened, Recording.open(opened) as recording:
        assert (recording.start_ns, recording.end_ns) == (T0, T0 + (CHUNKS * PER_CHUNK - 1) * S)


def test_a_wrong_count_of_a_topic_in_the_statistics_is_named(tmp_path: Path) -> None:
    def swap(_: int, body: bytearray) -> None:
        body[46:48], body[56:58] = body[56:58], body[46:48]

    path = tmp_path / "counts.mcap"
    path.write_bytes(change_mcap(Opcode.STATISTICS, swap))
    for summary in (by_index(path), by_scan(path)):
        assert {(p.code, p.where) for p in summary.problems} == {("counts-disagree", "/a"), ("counts-disagree", "/b")}


@pytest.mark.parametrize("what", ["mcap", "bag"])
def test_a_scan_names_a_message_index_that_points_elsewhere(what: str, tmp_path: Path) -> None:
    source = mcap_of(messages()) if what == "mcap" else bag_of(messages())
    data = bytearray(source.read(0, source.size_bytes))
    if what == "mcap":
        at = next(at for opcode, at, _ in mcap_records(data, len(records.MAGIC), len(data)) if opcode == 7)
        place, layout = at + 6 + 8, "<Q"
        end = next(at for opcode, at, _ in mcap_records(data, len(records.MAGIC), len(data)) if opcode == 15)
        data[end : end + 4] = bytes(4)  # under no checksum
    else:
        place, layout = data.index(b"op=\x04"), "<I"
        place = data.index(struct.pack("<II", T0 // S, 0), place) + 8
    struct.pack_into(layout, data, place, struct.unpack_from(layout, data, place)[0] + 1)
    path = tmp_path / f"elsewhere.{what}"
    path.write_bytes(data)
    assert [p.code for p in by_scan(path).problems] == ["index-damaged"]
    assert by_scan(path).message_count == CHUNKS * PER_CHUNK


def test_a_healthy_file_is_read_over_a_network_without_its_message_indexes() -> None:
    source = mcap_of(messages())

    class Counted(MemorySource):
        parallel_reads = 4
        reads = 0

        def read(self, offset: int, length: int) -> bytes:
            self.reads += 1
            return super().read(offset, length)

    far = Counted(source.read(0, source.size_bytes))
    with Recording.open(far) as recording:
        opened = far.reads
        assert sum(1 for _ in recording.raw_messages(start=T0 + 5 * S, end=T0 + 6 * S)) == 1
    assert far.reads == opened + 1


def test_a_chunk_that_claims_more_than_it_holds_is_left_out_and_named() -> None:
    source = mcap_of(messages())
    data = bytearray(source.read(0, source.size_bytes))
    at = next(at for opcode, at, _ in mcap_records(data, len(records.MAGIC), len(data)) if opcode == Opcode.CHUNK)
    struct.pack_into("<QI", data, at + 16, 2**40, 0)
    with Recording.open(MemorySource(bytes(data))) as recording:
        assert sum(1 for _ in recording.raw_messages()) == (CHUNKS - 1) * PER_CHUNK
        (problem,) = (problem for problem in recording.problems if problem.code == "damaged")
    assert f"{2**40} bytes" in problem.message
