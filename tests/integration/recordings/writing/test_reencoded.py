"""Every real recording has the same values in the other version of ROS, as `rosbags` reads them."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import pytest
from rosbags.interfaces import Connection, ConnectionExtRosbag1
from rosbags.rosbag1 import Reader as BagReader
from rosbags.rosbag2 import Reader as Rosbag2Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from kleinkram.recordings import (
    BagCompression,
    BagOptions,
    CannotWrite,
    Content,
    McapOptions,
    NotConvertible,
    Recording,
    Ros1Messages,
    is_whole_mcap,
)
from kleinkram.recordings.decoding import to_plain
from kleinkram.recordings.sample import generate_bag, generate_db3, generate_mcap
from kleinkram.recordings.writing.mcap import MADE_FROM, ChunkCompression
from tests.recording_files.builders import T0
from tests.recording_files.corpus import Entry, params, params_to_write
from tests.recording_files.independent import (
    Values,
    independent_recording,
    independent_values,
    read_recording,
    values_of,
)
from tests.recording_files.memory_source import MemorySource
from tests.recording_files.plain_values import plain, rosbags_decoder
from tests.recording_files.ros_messages import TimedMessage, ros1_bag, ros2_mcap
from tests.recording_files.whole_mcap import WholeMcap, read_whole_mcap
from tests.recording_files.writers import BagWriter, McapWriter

REENCODE = McapOptions(ros1=Ros1Messages.reencode)


def bag_values(path: Path) -> Values:
    """Return topic, log time and values of all messages of a bag, by rosbags."""
    return values_of(read_recording(path))


def mcap_values(whole: WholeMcap) -> Values:
    """Return topic, log time and values of all messages of an MCAP, by rosbags."""
    decoders: dict[str, Any] = {}
    for channel in whole.channels:
        schema = whole.schemas[channel.schema_id]
        decoders[channel.topic] = rosbags_decoder(channel.message_encoding, schema.name, schema.data.decode())
    return [(topic, log_ns, repr(decoders[topic](data))) for topic, log_ns, _, _, data in whole.messages]


def our_values(recording: Recording) -> Values:
    """Return topic, log time and values of a recording by our decoders."""
    return [
        (message.topic, message.log_time_ns, repr(plain(to_plain(message.value)))) for message in recording.messages()
    ]


ROS_1 = [*params_to_write("ROS1 bag 2.0"), *(one for one in params_to_write("MCAP") if "ros1profile" in str(one.id))]


@pytest.mark.parametrize("entry", ROS_1)
def test_every_ros_1_recording_has_the_same_values_in_ros_2(entry: Entry, recordings_dir: Path, tmp_path: Path) -> None:
    source = recordings_dir / entry.name
    with Recording.open(source) as recording:
        result = recording.to_mcap(tmp_path / "made.mcap", options=REENCODE)
    assert (result.left_out, result.losses) == ((), ())
    whole = read_whole_mcap(tmp_path / "made.mcap")
    assert {channel.message_encoding for channel in whole.channels} <= {"cdr"}
    assert {schema.encoding for schema in whole.schemas.values()} <= {"ros2msg"}
    assert mcap_values(whole) == independent_values(source)
    if not whole.channels:
        return
    assert whole.header.profile == "ros2"
    with Rosbag2Reader(tmp_path / "made.mcap") as reader:
        read = {(connection.topic, stamp, bytes(data)) for connection, stamp, data in reader.messages()}
    assert read == {(topic, log_ns, data) for topic, log_ns, _, _, data in whole.messages}


@pytest.mark.parametrize("entry", ROS_1)
def test_every_ros_1_recording_has_the_same_bytes_in_a_bag(entry: Entry, recordings_dir: Path, tmp_path: Path) -> None:
    """Recompressed, or from an MCAP."""
    source = recordings_dir / entry.name
    with Recording.open(source) as recording:
        result = recording.to_bag(tmp_path / "made.bag", options=BagOptions(BagCompression.bz2))
    assert (result.left_out, result.losses) == ((), ())
    made = read_recording(tmp_path / "made.bag")
    original = independent_recording(source)
    assert made.messages == original.messages
    assert {topic: kind.name.replace("/msg/", "/") for topic, kind in made.types.items()} == {
        topic: kind.name.replace("/msg/", "/") for topic, kind in original.types.items()
    }


@pytest.mark.parametrize("entry", params_to_write("ROS1 bag 2.0"))
def test_ros_1_to_ros_2_and_back_is_the_same(entry: Entry, recordings_dir: Path, tmp_path: Path) -> None:
    """Except sequence numbers, which a second conversion no longer sees."""
    with Recording.open(recordings_dir / entry.name) as recording:
        recording.to_mcap(tmp_path / "there.mcap", options=REENCODE)
    with Recording.open(tmp_path / "there.mcap") as recording:
        assert recording.to_bag(tmp_path / "back.bag").left_out == ()
    assert bag_values(tmp_path / "back.bag") == independent_values(recordings_dir / entry.name)
    with Recording.open(tmp_path / "back.bag") as recording:
        recording.to_mcap(tmp_path / "again.mcap", options=REENCODE)
    with Recording.open(tmp_path / "again.mcap") as again, Recording.open(tmp_path / "there.mcap") as there:
        assert [one[:5] for one in again.raw_messages()] == [one[:5] for one in there.raw_messages()]


ROS_2 = [
    param
    for param in params_to_write("MCAP", "ROS2 sqlite3 db3", "file-zstd of MCAP", "file-zstd of ROS2 sqlite3 db3")
    if not str(param.id).startswith(("conformance/", "derived/magic_only", "broken/", "ros2-db3/old_schema"))
    and param not in ROS_1
]


REFUSED = frozenset(
    (
        "mcap/image_message_zstd_inside_mcap.mcap",  # its messages are compressed, and nothing says so
        "ros2-db3/vicon_standard2/rosbag2_2025_12_12-16_34_20_0.db3",  # no definition of the type
        "ros2-db3/vicon_test6/rosbag2_2025_12_05-14_46_48_0.db3",
    )
)
"""Recordings of which no message can be in a bag. Of all others, each message is."""


@pytest.mark.parametrize("entry", ROS_2)
def test_every_ros_2_recording_has_the_same_values_in_a_bag(entry: Entry, recordings_dir: Path, tmp_path: Path) -> None:
    source, target = recordings_dir / entry.name, tmp_path / "made.bag"
    original = independent_recording(source)
    is_ros = {kind.encoding for kind in original.types.values()} <= {"cdr", "ros1"}
    with Recording.open(source) as recording:
        if not is_ros or entry.name in REFUSED:
            with pytest.raises(NotConvertible, match="can be in a bag: "):
                recording.to_bag(target)
            assert not [*tmp_path.iterdir()]
            return
        assert recording.to_bag(target).left_out == ()
    made = read_recording(target)
    assert sorted(values_of(made)) == sorted(values_of(original))  # rosbags has its own order of equal times
    with Recording.open(target) as bag:
        stamps = [(one.topic, one.log_time_ns) for one in bag.raw_messages()]
    assert stamps == [message[:2] for message in original.messages]
    assert_true_md5_sums(target)


@pytest.mark.parametrize("entry", [one for one in params("ROS1 bag 2.0", broken=True) if one.values[0].made_from])
def test_what_is_left_of_a_damaged_bag_has_the_values_of_the_original(
    entry: Entry, recordings_dir: Path, tmp_path: Path
) -> None:
    with Recording.open(recordings_dir / entry.name) as recording:
        result = recording.to_mcap(tmp_path / "made.mcap", options=REENCODE)
    assert result.losses
    saved = mcap_values(read_whole_mcap(tmp_path / "made.mcap"))
    intact = independent_values(recordings_dir / str(entry.made_from))
    assert saved == intact[: len(saved)] != []


def assert_true_md5_sums(path: Path) -> None:
    """Assert that connections have the md5 sums of their definitions, as rosbags computes them."""
    with BagReader(path) as reader:
        for connection in reader.connections:
            store = get_typestore(Stores.EMPTY)
            store.register(get_types_from_msg(connection.msgdef.data, connection.msgtype))
            assert store.generate_msgdef(connection.msgtype, ros_version=1)[1] == connection.digest


@pytest.mark.parametrize("compression", [*BagCompression])
@pytest.mark.parametrize("kind", ["mcap", "bag", "db3"])
def test_bags_are_indexed_and_the_same_each_time(compression: BagCompression, kind: str, tmp_path: Path) -> None:
    make = {"mcap": generate_mcap, "bag": generate_bag, "db3": generate_db3}[kind]
    source = tmp_path / ("drive" if kind == "db3" else f"drive.{kind}")
    make(source, size_bytes=600_000, duration_s=2)
    with Recording.open(source) as recording:
        for name in ("one.bag", "other.bag"):
            result = recording.to_bag(tmp_path / name, options=BagOptions(compression))
        expected = our_values(recording)
    assert result.size_bytes == (tmp_path / "one.bag").stat().st_size
    assert (tmp_path / "one.bag").read_bytes() == (tmp_path / "other.bag").read_bytes()
    assert bag_values(tmp_path / "one.bag") == expected
    with Recording.open(tmp_path / "one.bag") as made:
        (summary,) = made.scan_files()
    assert (summary.content, summary.compression) == (Content.indexed, (compression.value,))
    assert [path.name for path in tmp_path.glob(".*")] == []


def extension(connection: Connection) -> ConnectionExtRosbag1:
    """Return what only connections of bags have."""
    assert isinstance(connection.ext, ConnectionExtRosbag1)
    return connection.ext


def test_a_bag_keeps_its_connections(tmp_path: Path) -> None:
    source = tmp_path / "a.bag"
    with source.open("wb") as stream:
        writer = BagWriter(stream)
        for callerid, latching in (("/one", "1"), ("/other", "")):
            properties = (("callerid", callerid), *((("latching", latching),) if latching else ()))
            number = writer.add_connection(
                "/t",
                "std_msgs/String",
                md5sum="992ce8a1687cec8c8bd883ec73ca41d1",
                definition="string data\n",
                properties=properties,
            )
            writer.add_message(number, T0 + number, struct.pack("<I", 1) + b"a")
        writer.finish()
    with Recording.open(source) as recording:
        recording.to_bag(tmp_path / "made.bag")
        recording.to_mcap(tmp_path / "made.mcap", options=REENCODE)
    with BagReader(tmp_path / "made.bag") as reader:
        connections = [(extension(one).callerid, extension(one).latching, one.digest) for one in reader.connections]
    assert connections == [
        ("/one", 1, "992ce8a1687cec8c8bd883ec73ca41d1"),
        ("/other", None, "992ce8a1687cec8c8bd883ec73ca41d1"),
    ]
    latched, other = read_whole_mcap(tmp_path / "made.mcap").channels
    assert latched.metadata["callerid"] == "/one"
    assert "durability: 1" in latched.metadata["offered_qos_profiles"]
    assert other.metadata == {"callerid": "/other"}
    with Recording.open(tmp_path / "made.mcap") as recording:
        recording.to_bag(tmp_path / "back.bag")
    with BagReader(tmp_path / "back.bag") as reader:
        assert [extension(one).latching for one in reader.connections] == [1, None]


@pytest.mark.parametrize("name", ["sensor_msgs/Imu", "visualization_msgs/Marker", "std_msgs/Empty", "std_msgs/Header"])
def test_a_bag_gets_md5_sums_where_an_mcap_has_none(name: str, tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS1_NOETIC)
    definition, md5sum = store.generate_msgdef(name.replace("/", "/msg/"), ros_version=1)
    with (tmp_path / "a.mcap").open("wb") as stream:
        writer = McapWriter(stream, profile="ros1")
        schema = writer.add_schema(name, "ros1msg", definition.encode() or b"\n")
        writer.add_message(writer.add_channel("/t", schema, "ros1"), T0, b"not decoded")
        writer.finish()
    with Recording.open(tmp_path / "a.mcap") as recording:
        recording.to_bag(tmp_path / "made.bag")
    with BagReader(tmp_path / "made.bag") as reader:
        assert [connection.digest for connection in reader.connections] == [md5sum]


def unmappable_bag(path: Path) -> None:
    """Write a bag with a type that has a well-known name and other fields, and one message with a time beyond 2038."""
    with path.open("wb") as stream:
        writer = BagWriter(stream)
        other = writer.add_connection("/imu", "sensor_msgs/Imu", md5sum="0" * 32, definition="int8 a\n")
        time = writer.add_connection("/time", "my_msgs/Time", md5sum="1" * 32, definition="time stamp\n")
        writer.add_message(other, T0, b"\1")
        for seconds in (5, 2**31 + 5, 7):
            writer.add_message(time, T0 + seconds % 2**31, struct.pack("<II", seconds, 0))
        writer.finish()


def test_what_cannot_be_re_encoded_is_left_out_and_named(tmp_path: Path) -> None:
    unmappable_bag(tmp_path / "a.bag")
    with Recording.open(tmp_path / "a.bag") as recording:
        result = recording.to_mcap(tmp_path / "made.mcap", options=REENCODE)
        unchanged = recording.to_mcap(tmp_path / "unchanged.mcap")
    assert (result.message_count, unchanged.message_count, unchanged.left_out) == (2, 4, ())
    imu, time = result.left_out
    assert (imu.topic, imu.message_count) == ("/imu", 1)
    assert "it is not the sensor_msgs/Imu of ROS 2" in imu.reason
    assert (time.topic, time.message_count) == ("/time", 1)
    assert "a time that the other version of ROS cannot express" in time.reason
    whole = read_whole_mcap(tmp_path / "made.mcap")
    assert [data for *_, data in whole.messages] == [b"\0\1\0\0" + struct.pack("<II", one, 0) for one in (5, 7)]
    stored = json.loads(whole.metadata_of(MADE_FROM)["left_out"])
    assert [(part["topic"], part["message_count"]) for part in stored] == [("/imu", 1), ("/time", 1)]


def test_a_recording_of_which_nothing_can_be_re_encoded_is_refused(tmp_path: Path) -> None:
    with (tmp_path / "a.bag").open("wb") as stream:
        writer = BagWriter(stream)
        writer.add_message(
            writer.add_connection("/imu", "sensor_msgs/Imu", md5sum="0" * 32, definition="int8 a\n"), T0, b"\1"
        )
        writer.finish()
    with (
        Recording.open(tmp_path / "a.bag") as recording,
        pytest.raises(CannotWrite, match="no message can be re-encoded: it is not the sensor_msgs/Imu of ROS 2"),
    ):
        recording.to_mcap(tmp_path / "made.mcap", options=REENCODE)
    assert [path.name for path in tmp_path.iterdir()] == ["a.bag"]


def test_a_log_time_beyond_those_of_bags_is_left_out(tmp_path: Path) -> None:
    times = (T0, 2**32 * 10**9, 2**63)
    source = ros2_mcap([TimedMessage("/t", "std_msgs/Int8", time, {"data": 1}) for time in times])
    with Recording.open(source) as recording:
        (part,) = recording.to_bag(tmp_path / "made.bag").left_out
    assert (part.topic, part.message_count) == ("/t", 2)
    assert "is beyond those of a bag" in part.reason
    assert [stamp for _, stamp, _ in bag_values(tmp_path / "made.bag")] == [T0]


def test_big_endian_cdr_is_left_out(tmp_path: Path) -> None:
    """Nothing but the plain little-endian form, which every writer of ROS 2 makes, is re-encoded."""
    with (tmp_path / "a.mcap").open("wb") as stream:
        writer = McapWriter(stream, profile="ros2")
        channel = writer.add_channel("/t", writer.add_schema("std_msgs/msg/Int8", "ros2msg", b"int8 data\n"), "cdr")
        writer.add_message(channel, T0, b"\0\1\0\0\1")
        writer.add_message(channel, T0 + 1, b"\0\0\0\0\1")
        writer.finish()
    with Recording.open(tmp_path / "a.mcap") as recording:
        (part,) = recording.to_bag(tmp_path / "made.bag").left_out
    assert (part.message_count, "not in plain little-endian CDR" in part.reason) == (1, True)


def test_a_damaged_bag_is_re_encoded_as_far_as_possible(tmp_path: Path) -> None:
    source = ros1_bag(TimedMessage("/imu", "sensor_msgs/Imu", T0 + number, {}, T0) for number in range(2000))
    data = source.read(0, source.size_bytes)
    with Recording.open(MemorySource(data[: len(data) * 6 // 10], "cut.bag")) as recording:
        made = recording.to_mcap(tmp_path / "made.mcap", options=REENCODE)
        bag = recording.to_bag(tmp_path / "made.bag")
    assert 0 < made.message_count == bag.message_count < 2000
    assert made.losses == bag.losses != ()
    whole = read_whole_mcap(tmp_path / "made.mcap")
    assert mcap_values(whole) == bag_values(tmp_path / "made.bag")
    with Recording.open(tmp_path / "made.mcap") as again:
        assert is_whole_mcap(again, ChunkCompression.zstd)
