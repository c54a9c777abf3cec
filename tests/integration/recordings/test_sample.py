"""Sample missions: our summaries and independent readers find the values that were written."""

from __future__ import annotations

import hashlib
import struct
from collections import Counter
from pathlib import Path

import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Reader as BagReader
from rosbags.typesys import Stores, get_typestore

from kleinkram.recordings import Content, FileSource, RecordingSummary, summarise
from kleinkram.recordings.sample import (
    Faults,
    FileTruth,
    MissionTruth,
    TopicGap,
    generate_bag,
    generate_mcap,
    generate_mission,
)

SECOND = 1_000_000_000


def summarise_file(path: Path) -> RecordingSummary:
    with FileSource(path) as source:
        return summarise(source)


def assert_true(summary: RecordingSummary, truth: FileTruth) -> None:
    assert summary.content is Content.indexed
    assert (summary.message_count, summary.start_ns, summary.end_ns) == (
        truth.message_count,
        truth.start_ns,
        truth.end_ns,
    )
    actual = [
        (t.name, t.message_type, t.count, t.first_ns, t.last_ns, t.longest_gap_ns or 0, t.out_of_order_count)
        for t in summary.topics
    ]
    assert actual == [
        (t.name, t.message_type, t.count, t.first_ns, t.last_ns, t.longest_gap_ns, t.out_of_order_count)
        for t in truth.topics
    ]


def counts(truth: FileTruth) -> dict[str, int]:
    return {topic.name: topic.count for topic in truth.topics}


def digests(mission: MissionTruth) -> dict[str, str]:
    return {
        str(path.relative_to(mission.directory)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(mission.directory.rglob("*"))
        if path.is_file()
    }


@pytest.fixture(scope="module")
def mission(tmp_path_factory: pytest.TempPathFactory) -> MissionTruth:
    return generate_mission(tmp_path_factory.mktemp("mission"), size_bytes=12_000_000, seed=7)


def test_a_mission_has_all_formats(mission: MissionTruth) -> None:
    names = [str(file.path.relative_to(mission.directory)) for file in mission.files]
    assert names == ["drive.mcap", "drive.bag", "drive_rosbag2/drive_rosbag2_0.db3"]
    assert (mission.directory / "drive_rosbag2/metadata.yaml").is_file()


def test_summaries_find_the_truth(mission: MissionTruth) -> None:
    mcap, bag, _db3 = mission.files
    assert_true(summarise_file(mcap.path), mcap)
    assert_true(summarise_file(bag.path), bag)


def test_mcap_is_read_by_mcap(mission: MissionTruth) -> None:
    truth = mission.files[0]
    with truth.path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        actual = Counter(channel.topic for _, channel, _ in reader.iter_messages())
        statistics = reader.get_summary()
    assert actual == counts(truth)
    assert statistics is not None
    assert statistics.statistics is not None
    assert statistics.statistics.message_count == truth.message_count


@pytest.mark.parametrize("kind", ["drive.bag", "drive_rosbag2"])
def test_every_message_is_decoded_by_rosbags(mission: MissionTruth, kind: str) -> None:
    truth = next(file for file in mission.files if kind in str(file.path.relative_to(mission.directory)))
    actual: Counter[str] = Counter()
    with AnyReader([mission.directory / kind], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        for connection, _time, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            assert type(message).__name__ == connection.msgtype.replace("/", "__")
            actual[connection.topic] += 1
        assert (reader.start_time, reader.end_time - 1) == (truth.start_ns, truth.end_ns)
    assert actual == counts(truth)


def test_cdr_in_mcap_is_decoded_by_rosbags(mission: MissionTruth) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    with mission.files[0].path.open("rb") as file:
        for schema, _channel, message in make_reader(file).iter_messages():
            assert schema is not None
            decoded = store.deserialize_cdr(message.data, schema.name)
            # Serialised again it is as long: no byte was left over, and none is missing.
            assert len(store.serialize_cdr(decoded, schema.name)) == len(message.data)


def test_md5_sums_are_those_of_ros(mission: MissionTruth) -> None:
    with BagReader(mission.files[1].path) as reader:
        sums = {connection.msgtype.replace("/msg/", "/"): connection.digest for connection in reader.connections}
    assert sums == {
        "sensor_msgs/Imu": "6a62c6daae103f4ff57a132d6f95cec2",
        "sensor_msgs/PointCloud2": "1158d486dd51d683ce2f1be655c3c181",
        "sensor_msgs/CompressedImage": "8f7a12909da2c9d3332d540a0977563f",
        "sensor_msgs/NavSatFix": "2d3a8cd499b9b4a0249fb98fd05cfa48",
        "nav_msgs/Odometry": "cd5e73d190d741a2f92e81eda573aca7",
        "tf2_msgs/TFMessage": "94810edda583a504dfda3829e70d7eec",
    }


def test_rates_are_those_of_the_sensors(mission: MissionTruth) -> None:
    rates = {t.name: t.rate_hz for t in summarise_file(mission.files[1].path).topics}
    assert rates.pop("/tf_static") is None
    expected = {"/camera/image/compressed": 10, "/lidar/points": 10, "/imu/data": 200, "/gps/fix": 5, "/odom": 50}
    assert rates == {topic: pytest.approx(hz, rel=0.01) for topic, hz in {**expected, "/tf": 50}.items()}


def test_same_seed_same_bytes(tmp_path: Path) -> None:
    first = generate_mission(tmp_path / "a", duration_s=1, seed=3)
    again = generate_mission(tmp_path / "b", duration_s=1, seed=3)
    other = generate_mission(tmp_path / "c", duration_s=1, seed=4)
    assert digests(first) == digests(again)
    assert not set(digests(first).values()) & set(digests(other).values())


@pytest.mark.parametrize("size_bytes", [2_000_000, 60_000_000])
def test_size_is_about_the_requested_one(tmp_path: Path, size_bytes: int) -> None:
    truth = generate_bag(tmp_path / "sized.bag", size_bytes=size_bytes)
    assert truth.size_bytes == truth.path.stat().st_size
    assert truth.size_bytes == pytest.approx(size_bytes, rel=0.15)


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    generate_mcap(tmp_path / "a.mcap", duration_s=0.5)
    with pytest.raises(FileExistsError):
        generate_mcap(tmp_path / "a.mcap", duration_s=0.5)


def test_dropped_topic(tmp_path: Path) -> None:
    truth = generate_mcap(tmp_path / "a.mcap", duration_s=1, faults=Faults(dropped_topic="/gps/fix"))
    summary = summarise_file(truth.path)
    assert_true(summary, truth)
    assert "/gps/fix" not in {topic.name for topic in summary.topics}
    assert len(summary.topics) == 6


def test_gap(tmp_path: Path) -> None:
    faults = Faults(gap=TopicGap("/imu/data", start_s=1, duration_s=1.5))
    truth = generate_bag(tmp_path / "a.bag", duration_s=4, faults=faults)
    summary = summarise_file(truth.path)
    assert_true(summary, truth)
    gaps = {topic.name: topic.longest_gap_ns or 0 for topic in summary.topics}
    assert 1.5 * SECOND <= gaps.pop("/imu/data") < 1.52 * SECOND
    assert max(gaps.values()) < 0.3 * SECOND


def test_truncated_end(tmp_path: Path) -> None:
    mission = generate_mission(tmp_path, duration_s=2, faults=Faults(truncate_to=0.6))
    contents = [summarise_file(file.path).content for file in mission.files]
    assert contents == [Content.recovered] * 3
    assert all(file.truncated for file in mission.files)


def test_pictures_can_be_decoded(tmp_path: Path) -> None:
    truth = generate_mcap(tmp_path / "a.mcap", duration_s=1)
    store = get_typestore(Stores.ROS2_HUMBLE)
    with truth.path.open("rb") as file:
        pictures = [
            bytes(store.deserialize_cdr(message.data, "sensor_msgs/msg/CompressedImage").data)  # type: ignore[attr-defined]  # made at run time
            for _, _, message in make_reader(file).iter_messages(topics=["/camera/image/compressed"])
        ]
    bright = [tiles_of(picture) for picture in pictures]
    assert len(bright) == 10
    assert all(len(tiles) == 80 * 60 and max(tiles) > 190 and min(tiles) < 60 for tiles in bright)
    assert len(pictures[0]) == pytest.approx(80_000, rel=0.01)


def tiles_of(jpeg: bytes) -> list[int]:
    """Decode a grey baseline JPEG whose only AC code is "end of block", by the tables that it brings."""
    assert jpeg[:2] == b"\xff\xd8"
    assert jpeg[-2:] == b"\xff\xd9"
    codes: dict[str, int] = {}
    at = 2
    while True:
        marker, length = struct.unpack_from(">HH", jpeg, at)
        body = jpeg[at + 4 : at + 2 + length]
        at += 2 + length
        if marker == 0xFFC4 and body[0] == 0:
            codes = huffman_codes(body[1:17], body[17:])
        if marker == 0xFFDA:
            break
    data = jpeg[at:-2].replace(b"\xff\x00", b"\xff")
    bits = "".join(format(byte, "08b") for byte in data)
    tiles: list[int] = []
    level, at = 128, 0
    while len(tiles) < 80 * 60:
        end = at + 1
        while bits[at:end] not in codes:
            end += 1
        category = codes[bits[at:end]]
        value = int(bits[end : end + category] or "0", 2)
        level += value if category == 0 or value >> (category - 1) else value - (1 << category) + 1
        tiles.append(level)
        assert bits[end + category] == "0"
        at = end + category + 1
    return tiles


def huffman_codes(lengths: bytes, symbols: bytes) -> dict[str, int]:
    codes: dict[str, int] = {}
    code = number = 0
    for length, count in enumerate(lengths, start=1):
        for _ in range(count):
            codes[format(code, f"0{length}b")] = symbols[number]
            code, number = code + 1, number + 1
        code <<= 1
    return codes
