"""Messages are ordered by log time, and by file order at equal times."""

from __future__ import annotations

import random
import struct
from collections.abc import Callable, Iterable
from io import BytesIO
from pathlib import Path

import pytest

from kleinkram.recordings import Recording, TooDisordered
from kleinkram.recordings.sample.writers import Db3Writer
from tests.recording_files.builders import T0, Stamped, Watched, bag_of, mcap_of
from tests.recording_files.memory_source import MemorySource
from tests.recording_files.writers import Compression, McapWriter

Make = Callable[[Iterable[Iterable[Stamped]]], MemorySource]
MAKERS = [pytest.param(mcap_of, id="mcap"), pytest.param(bag_of, id="bag")]


def plain(recording: Recording) -> list[Stamped]:
    return [(message.topic, message.log_time_ns, message.data) for message in recording.raw_messages()]


def in_order(chunks: Iterable[Iterable[Stamped]]) -> list[Stamped]:
    return sorted((message for chunk in chunks for message in chunk), key=lambda message: message[1])


def shuffled(seed: int, *, chunks: int, messages: int, spread_ns: int) -> list[list[Stamped]]:
    """Return chunks whose messages jump about, and among which many have equal times."""
    rng = random.Random(seed)
    return [
        [
            (f"/t{rng.randrange(3)}", T0 + number * 10 + rng.randrange(spread_ns), f"{number}/{place}".encode())
            for place in range(messages)
        ]
        for number in range(chunks)
    ]


@pytest.mark.parametrize("make", MAKERS)
@pytest.mark.parametrize("spread_ns", [8, 30, 1000])
def test_chunks_that_overlap(make: Make, spread_ns: int) -> None:
    chunks = shuffled(spread_ns, chunks=20, messages=15, spread_ns=spread_ns)
    assert plain(Recording.open(make(chunks))) == in_order(chunks)


@pytest.mark.parametrize("make", MAKERS)
def test_chunks_that_overlap_more_than_memory_allows(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    chunks = shuffled(7, chunks=12, messages=20, spread_ns=400)
    monkeypatch.setattr("kleinkram.recordings.merge_messages.MAX_BUFFERED_BYTES", 12 * 20 * (250 + 6) // 3)
    source = Watched(make(chunks))
    assert plain(Recording.open(source)) == in_order(chunks)
    assert len(source.ranges) > 2 * len(chunks)  # chunks were read again instead of being held


def test_too_many_chunks_at_once_are_refused_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    chunks = [[("/t", T0, b"x" * 1000), ("/t", T0 + 1_000_000, b"x" * 1000)] for _ in range(50)]
    monkeypatch.setattr("kleinkram.recordings.merge_messages.MAX_BUFFERED_BYTES", 10_000)
    with pytest.raises(TooDisordered, match="overlap in time"):
        list(Recording.open(mcap_of(chunks)).raw_messages())


@pytest.mark.parametrize("make", MAKERS)
def test_equal_times_keep_the_order_of_the_file(make: Make) -> None:
    chunks = [[("/t", T0 + 5, b"a"), ("/t", T0 + 9, b"b")], [("/t", T0 + 9, b"c"), ("/t", T0 + 9, b"d")]]
    assert [data for _, _, data in plain(Recording.open(make(chunks)))] == [b"a", b"b", b"c", b"d"]


def test_a_stamp_from_1970_comes_first_and_delays_nothing() -> None:
    chunks = [[("/t", T0 + n, b"x"), ("/t", 5 if n == 3 else T0 + n, b"y")] for n in range(6)]
    assert plain(Recording.open(mcap_of(chunks))) == in_order(chunks)


def test_files_that_overlap_are_merged() -> None:
    chunks = shuffled(3, chunks=12, messages=10, spread_ns=60)
    members = [mcap_of(chunks[:5], name="run_0.mcap"), bag_of(chunks[5:9]), mcap_of(chunks[9:], name="run_2.mcap")]
    assert plain(Recording.open(members)) == in_order(chunks)


def test_database_and_mcap_are_merged(tmp_path: Path) -> None:
    chunks = shuffled(4, chunks=10, messages=10, spread_ns=60)
    writer = Db3Writer(tmp_path / "drive")
    topics = {name: writer.add_topic(name, "a/msg/B") for name in ("/t0", "/t1", "/t2")}
    for topic, log_ns, data in in_order(chunks[:6]):
        writer.add_message(topics[topic], log_ns, data)
    writer.finish()
    database = MemorySource(writer.path.read_bytes(), "drive_0.db3")
    with Recording.open([database, mcap_of(chunks[6:])]) as recording:
        actual = plain(recording)
    assert [stamp for _, stamp, _ in actual] == [stamp for _, stamp, _ in in_order(chunks)]
    assert sorted(actual) == sorted(in_order(chunks))


def test_messages_without_chunks_and_without_index() -> None:
    """An MCAP of loose records, in no order, over several rows of the table that is made of them."""
    (messages,) = shuffled(5, chunks=1, messages=300, spread_ns=5000)
    messages = [(topic, stamp, data * 3000) for topic, stamp, data in messages]
    chunked_bytes = mcap_of([messages], compression=Compression.none)
    whole = chunked_bytes.read(0, chunked_bytes.size_bytes)
    start = whole.index(b"\x06", 8)  # the chunk's record
    content_at = start + 9 + 8 + 8 + 8 + 4 + 4 + 8
    loose = (
        whole[:start] + whole[content_at : content_at + int.from_bytes(whole[content_at - 8 : content_at], "little")]
    )
    recording = Recording.open(MemorySource(loose))
    assert plain(recording) == in_order([messages])
    assert recording.message_count == 300


def test_channels_written_in_every_chunk() -> None:
    out = BytesIO()
    writer = McapWriter(out, chunk_bytes=1)
    channel = writer.add_channel("/t", writer.add_schema("a/B", "ros2msg", b"uint8 x"), "cdr")
    for number in range(5):
        writer.add_message(channel, T0 + number, b"x", publish_time_ns=T0)
    writer.finish()
    messages = list(Recording.open(MemorySource(out.getvalue())).raw_messages())
    assert [message.sequence for message in messages] == [0, 1, 2, 3, 4]
    assert {message.publish_time_ns for message in messages} == {T0}
    assert messages[0].schema.data == b"uint8 x"


def test_a_chunk_earlier_than_its_index_does_not_change_the_order() -> None:
    late = [("/t", T0 + 50, b"b"), ("/t", T0 + 95, b"c")]
    whole = bag_of([[("/t", T0 + n, b"a") for n in range(0, 101, 10)], late])
    data = whole.read(0, whole.size_bytes)
    time = struct.Struct("<II")
    at = data.rindex(b"start_time=" + time.pack(*divmod(T0 + 50, 10**9)))
    changed = b"start_time=" + time.pack(*divmod(T0 + 90, 10**9))
    recording = Recording.open(MemorySource(data[:at] + changed + data[at + len(changed) :], "test.bag"))
    actual = plain(recording)
    assert [stamp - T0 for _, stamp, _ in actual] == [0, 10, 20, 30, 40, 50, 60, 70, 80, 90, 95, 100]
    assert [problem.code for problem in recording.problems] == ["index-damaged", "too-late"]
