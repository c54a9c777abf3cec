"""Quality warnings about unusual topics, and none about healthy ones."""

from __future__ import annotations

import struct
from collections.abc import Callable
from io import BytesIO

import pytest

from kleinkram.recordings import Problem, combine, summarise
from kleinkram.recordings.formats.mcap import records
from kleinkram.recordings.formats.mcap.records import Opcode
from kleinkram.recordings.formats.rosbag1 import records as bag_records
from kleinkram.recordings.model import span_text
from kleinkram.recordings.sources import SourceReader
from kleinkram.recordings.summary import scan
from tests.recording_files.memory_source import MemorySource
from tests.recording_files.writers import McapWriter

T0 = 1_700_000_000_000_000_000
SECOND = 1_000_000_000


def problems(topics: dict[str, list[int]], *, published: int = 0) -> list[tuple[str, str]]:
    """Return code and place of the problems of a recording with these stamps (seconds); scan and summary agree."""
    data = recording(topics, published=published)
    actual = scan(SourceReader(MemorySource(data))).problems
    if not published:
        assert summarise(MemorySource(data)).problems == actual
    return [(problem.code, problem.where) for problem in actual]


def recording(topics: dict[str, list[int]], *, published: int) -> bytes:
    out = BytesIO()
    writer = McapWriter(out)
    channels = {topic: writer.add_channel(topic, 0, "cdr") for topic in topics}
    for stamp, topic in sorted((stamp, topic) for topic, stamps in topics.items() for stamp in stamps):
        log_time = T0 + stamp * SECOND
        writer.add_message(channels[topic], log_time, b"x", publish_time_ns=log_time - published)
    writer.finish()
    return out.getvalue()


def test_a_healthy_recording_has_no_problems() -> None:
    topics = {
        "/imu": list(range(100)),
        "/tf_static": [0],
        "/map": [50, 51],
        "/rosout": [3, 4, 5, 5, 6, 7, 7, 7, 7, 8, 9, 9],
        "/parameter_events": [],
        "/slow": list(range(0, 100, 10)),
    }
    assert problems(topics) == []


def stamped(stamps: list[int]) -> MemorySource:
    """Return a recording of two topics with these stamps (seconds), in this order, in small chunks."""
    out = BytesIO()
    writer = McapWriter(out, chunk_bytes=500)
    channels = [writer.add_channel(topic, 0, "cdr") for topic in ("/imu", "/lidar")]
    for stamp in stamps:
        for channel in channels:
            writer.add_message(channel, T0 + stamp * SECOND, b"x", publish_time_ns=T0 + stamp * SECOND)
    writer.finish()
    return MemorySource(out.getvalue())


@pytest.mark.parametrize(
    ("stamps", "named"),
    [
        pytest.param(
            [*range(100), *range(-3500, -3400), *range(200, 300)],
            "forward again at 2023-11-14T22:16:40Z",
            id="and back",
        ),
        pytest.param(
            [*range(4000, 4100), *range(100)], "log times jump back by 1.14 h at 2023-11-14T23:21:39Z:", id="stays"
        ),
        pytest.param([*range(100), *range(85, 185)], "log times jump back by 14.0 s", id="little"),
    ],
)
def test_a_clock_that_was_set_back(stamps: list[int], named: str) -> None:
    source = stamped(stamps)
    actual = summarise(source).problems
    assert scan(SourceReader(source)).problems == actual
    (problem,) = actual
    assert (problem.code, problem.where) == ("clock-jump", "2 topics")
    assert named in problem.message
    both = combine([summarise(source), summarise(stamped(list(range(5000, 5100))))])
    assert [problem.code for problem in both.problems] == ["clock-jump"]


def test_late_writes_are_no_clock_jump() -> None:
    late = [stamp for start in range(0, 100, 9) for stamp in (*range(start + 1, start + 9), start)]
    assert summarise(stamped(late)).problems == ()


def test_a_sensor_that_dies() -> None:
    assert problems({"/imu": list(range(100)), "/lidar": list(range(60))}) == [("stops-early", "/lidar")]


def test_a_sensor_that_starts_late() -> None:
    assert problems({"/imu": list(range(100)), "/lidar": list(range(30, 100))}) == [("starts-late", "/lidar")]


def test_a_sensor_that_is_gone_for_a_while() -> None:
    lidar = [*range(100), *range(200, 300)]
    assert problems({"/imu": list(range(300)), "/lidar": lidar}) == [("long-gap", "/lidar")]


def test_a_topic_without_messages() -> None:
    assert problems({"/imu": list(range(100)), "/gps": []}) == [("silent-topic", "/gps")]


def test_many_topics_are_one_problem() -> None:
    silent: dict[str, list[int]] = {f"/silent_{number}": [] for number in range(30)}
    assert problems({"/imu": list(range(100)), **silent}) == [("silent-topic", "30 topics")]


def test_log_times_far_from_publish_times() -> None:
    topics = {"/imu": list(range(20))}
    assert problems(topics, published=SECOND // 2) == []
    assert problems(topics, published=3 * SECOND) == [("publish-time-differs", "/imu")]
    (problem,) = scan(SourceReader(MemorySource(recording(topics, published=-3 * SECOND)))).problems
    assert problem == Problem(
        "publish-time-differs",
        "/imu",
        "20 messages were logged more than 1 s away from their publish time: typically -3.0 s, at most -3.0 s",
    )


def test_long_spans_are_shown_in_days_and_years() -> None:
    assert [span_text(seconds * SECOND) for seconds in (0, 3660, -200 * 3600, 12 * 365 * 86_400)] == [
        "0.0 s",
        "3660.0 s",
        "-8.3 days",
        "12.0 years",
    ]
    assert span_text(400 * 86_400 * SECOND, "+") == "+1.1 years"


def fields(values: dict[str, bytes]) -> bytes:
    parts = [name.encode() + b"=" + value for name, value in values.items()]
    return b"".join(struct.pack("<I", len(part)) + part for part in parts)


def bag_of(*publishers: tuple[bytes, bytes]) -> bytes:
    """Return a bag without index, with a connection of /t and a message for each type and publisher."""
    pieces = [bag_records.MAGIC]
    for number, (kind, publisher) in enumerate(publishers):
        conn = struct.pack("<I", number)
        data = fields({"topic": b"/t", "type": kind, **({"callerid": publisher} if publisher else {})})
        time = struct.pack("<II", 1_700_000_000, number)
        for head, body in (
            (fields({"op": b"\x07", "conn": conn, "topic": b"/t"}), data),
            (fields({"op": b"\x02", "conn": conn, "time": time}), b"x"),
        ):
            pieces += [struct.pack("<I", len(head)), head, struct.pack("<I", len(body)), body]
    return b"".join(pieces)


def mcap_of(*publishers: tuple[bytes, bytes]) -> bytes:
    """Return the same as an MCAP, as a conversion from ROS 1 writes it."""
    pieces = [records.MAGIC]
    for number, (kind, publisher) in enumerate(publishers):
        name, key, value = (struct.pack("<I", len(text)) + text for text in (kind, b"callerid", publisher))
        metadata = key + value if publisher else b""
        head = struct.pack("<HHI", number, number + 1, 2) + b"/t" + struct.pack("<II", 0, len(metadata))
        bodies = (
            (Opcode.SCHEMA, struct.pack("<H", number + 1) + name + bytes(8)),
            (Opcode.CHANNEL, head + metadata),
            (Opcode.MESSAGE, struct.pack("<HIQQ", number, 0, T0, T0)),
        )
        pieces += [records.RECORD_HEAD.pack(opcode, len(body)) + body for opcode, body in bodies]
    return b"".join(pieces)


@pytest.mark.parametrize(("make", "name"), [(bag_of, "a.bag"), (mcap_of, "a.mcap")])
def test_doubled_channels(make: Callable[..., bytes], name: str) -> None:
    def doubled(*publishers: tuple[bytes, bytes]) -> list[str]:
        summary = scan(SourceReader(MemorySource(make(*publishers), name)))
        assert summary.message_count == len(publishers)
        return [one.where + ": " + one.message for one in summary.problems if one.code == "doubled-channel"]

    (named,) = doubled((b"a/B", b"/node"), (b"a/B", b"/node"), (b"a/B", b"/other"))
    assert named.startswith("/t: /node has 2 channels")
    assert doubled((b"a/B", b"/node"), (b"a/B", b"/other")) == []
    assert doubled((b"a/B", b"/node"), (b"a/C", b"/node")) == []
    assert doubled((b"a/B", b""), (b"a/B", b"")) == []
