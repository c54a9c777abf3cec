"""What is said of topics that are odd, and what is left unsaid of healthy ones."""

from __future__ import annotations

from io import BytesIO

from kleinkram.recordings import Problem, summarise
from kleinkram.recordings.forward import from_source
from kleinkram.recordings.mcap.writer import McapWriter
from kleinkram.recordings.summary import scan

from .memory_source import MemorySource

T0 = 1_700_000_000_000_000_000
SECOND = 1_000_000_000


def problems(topics: dict[str, list[int]], *, published: int = 0) -> list[tuple[str, str]]:
    """Return code and place of the problems of a recording with these stamps (seconds); scan and summary agree."""
    data = recording(topics, published=published)
    found = scan(from_source(MemorySource(data))).problems
    if not published:
        assert summarise(MemorySource(data)).problems == found
    return [(problem.code, problem.where) for problem in found]


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
    (problem,) = scan(from_source(MemorySource(recording(topics, published=-3 * SECOND)))).problems
    assert problem == Problem(
        "publish-time-differs",
        "/imu",
        "20 messages were logged more than 1 s away from their publish time: typically -3.0 s, at most -3.0 s",
    )
