"""Slices of small recordings: latched topics, merged recordings, and which bytes are read."""

from __future__ import annotations

import json
import random
import threading
from io import BytesIO
from pathlib import Path

import pytest

from kleinkram.recordings import (
    CannotWrite,
    EmptyRange,
    McapOptions,
    NoSuchTopic,
    OutsideRecording,
    Recording,
    SourceError,
    merge_to_mcap,
)
from kleinkram.recordings.chunk_reader import ChunkedMember
from kleinkram.recordings.messages import Channel, Schema
from kleinkram.recordings.writing.latched import publisher_count
from kleinkram.recordings.writing.mcap import MADE_FROM
from tests.recording_files.builders import T0, Stamped, Watched, bag_of, mcap_of
from tests.recording_files.databases import make_database
from tests.recording_files.memory_source import MemorySource
from tests.recording_files.whole_mcap import WholeMcap, read_whole_mcap
from tests.recording_files.writers import BagWriter, McapWriter

PROFILE = "- history: 1\n  depth: 1\n  durability: {}\n"
NOISE = random.Random(1).randbytes(50_000)
TRANSFORMS = """geometry_msgs/TransformStamped[] transforms
================================================================================
MSG: geometry_msgs/TransformStamped
string child_frame_id"""


def cut(source: Recording, target: Path, *topics: str, **settings: object) -> WholeMcap:
    source.to_mcap(target, topics or None, **settings)  # type: ignore[arg-type]  # as the test gives them
    return read_whole_mcap(target)


def stamped(whole: WholeMcap) -> list[Stamped]:
    return [(topic, log_ns - T0, data) for topic, log_ns, _, _, data in whole.messages]


def transforms(*frames: str) -> bytes:
    """Return a message of static transforms in CDR."""
    out = b"\0\1\0\0" + len(frames).to_bytes(4, "little")
    for frame in frames:
        text = frame.encode() + b"\0"
        out += b"\0" * (-(len(out) - 4) % 4) + len(text).to_bytes(4, "little") + text
    return out


def latched_mcap(*, repeated: int = 0) -> MemorySource:
    """A map (transient-local), static transforms of two publishers, and an IMU; a chunk every 10 ns."""
    out = BytesIO()
    writer = McapWriter(out, chunk_bytes=2**40)
    schema = writer.add_schema("tf2_msgs/msg/TFMessage", "ros2msg", TRANSFORMS.encode())
    offered = [("offered_qos_profiles", PROFILE.format(1))]
    map_id = writer.add_channel("/map", 0, "cdr", tuple(offered))
    tf_id = writer.add_channel("/tf_static", schema, "cdr", tuple(offered))
    imu_id = writer.add_channel("/imu", 0, "cdr", (("offered_qos_profiles", PROFILE.format(2)),))
    early = {0: [(map_id, b"old map"), (tf_id, transforms("lidar", "camera"))], 1: [(tf_id, transforms("imu"))]}
    early[2] = [(map_id, b"new map")]
    for chunk in range(10 + repeated):
        for channel_id, data in early.get(chunk, []):
            writer.add_message(channel_id, T0 + 10 * chunk, data, publish_time_ns=T0 + 10 * chunk - 1)
        if chunk > 2 and repeated:
            writer.add_message(tf_id, T0 + 10 * chunk, transforms("imu"))
        writer.add_message(imu_id, T0 + 10 * chunk + 1, b"imu")
        writer._flush()
    writer.finish()
    return MemorySource(out.getvalue(), "latched.mcap")


@pytest.mark.parametrize(
    ("topic", "properties", "count"),
    [
        ("/map", (("offered_qos_profiles", PROFILE.format(1)),), 1),
        ("/map", (("offered_qos_profiles", PROFILE.format("transient_local") * 2),), 2),
        ("/map", (("offered_qos_profiles", PROFILE.format(2)),), 0),
        ("/map", (("offered_qos_profiles", PROFILE.format("volatile")),), 0),
        ("/map", (("offered_qos_profiles", PROFILE.format(1) + PROFILE.format(2)),), 1),
        ("/map", (("latching", "1"),), 1),
        ("/map", (("latching", "0"),), 0),
        ("/map", (), 0),
        ("/tf_static", (), 1),
        ("/robot/tf_static", (), 1),
        ("/robot_description", (), 1),
        ("/my_tf_static", (), 0),
    ],
)
def test_latched_topics_are_known_by_qos_latching_or_name(
    topic: str, properties: tuple[tuple[str, str], ...], count: int
) -> None:
    assert publisher_count(Channel(topic, "cdr", Schema("", "", b""), "", properties)) == count


def test_a_slice_begins_with_what_a_late_subscriber_receives(tmp_path: Path) -> None:
    with Recording.open(latched_mcap()) as recording:
        result = recording.to_mcap(tmp_path / "cut.mcap", start=T0 + 55, end=T0 + 70)
    whole = read_whole_mcap(tmp_path / "cut.mcap")
    assert stamped(whole) == [
        ("/tf_static", 55, transforms("lidar", "camera")),
        ("/tf_static", 55, transforms("imu")),
        ("/map", 55, b"new map"),
        ("/imu", 61, b"imu"),
    ]
    assert [publish_ns - T0 for _, _, publish_ns, _, _ in whole.messages[:3]] == [-1, 9, 19], "as published"
    assert (result.message_count, result.latched_count) == (4, 3)
    made_from = whole.metadata_of(MADE_FROM)
    assert (made_from["start_ns"], made_from["end_ns"]) == (str(T0 + 55), str(T0 + 70))
    assert json.loads(made_from["latched"]) == {"/tf_static": [T0, T0 + 10], "/map": [T0 + 20]}
    assert "topics" not in made_from


def test_latched_messages_are_those_of_the_selected_topics_if_wanted(tmp_path: Path) -> None:
    with Recording.open(latched_mcap()) as recording:
        only_imu = cut(recording, tmp_path / "a.mcap", "/imu", start=T0 + 55, end=T0 + 70)
        without = cut(recording, tmp_path / "b.mcap", start=T0 + 55, end=T0 + 70, options=McapOptions(latched=False))
        from_start = cut(recording, tmp_path / "c.mcap", "/map", start=T0)
    assert stamped(only_imu) == stamped(without) == [("/imu", 61, b"imu")]
    assert {channel.topic for channel in without.channels} == {"/map", "/tf_static", "/imu"}
    assert stamped(from_start) == [("/map", 0, b"old map"), ("/map", 20, b"new map")]


def test_cutting_a_slice_again_gives_the_same_messages(tmp_path: Path) -> None:
    with Recording.open(latched_mcap()) as recording:
        first = cut(recording, tmp_path / "a.mcap", start=T0 + 55, end=T0 + 70)
    with Recording.open(tmp_path / "a.mcap") as recording:
        assert cut(recording, tmp_path / "b.mcap", start=T0 + 55, end=T0 + 70).messages == first.messages


def test_repeated_static_transforms_are_searched_in_bounded_time(tmp_path: Path) -> None:
    """Of 300 chunks that hold the topic, the first and the last 32 are read."""
    source = Watched(latched_mcap(repeated=300), parallel_reads=8)
    with Recording.open(source) as recording:
        (member,) = recording.members
        assert isinstance(member, ChunkedMember)
        source.ranges.clear()
        whole = cut(recording, tmp_path / "a.mcap", "/tf_static", start=T0 + 3005)
    frames = [data for _, _, data in stamped(whole)]
    assert frames[:2] == [transforms("lidar", "camera"), transforms("imu")]
    earlier = [row for row in member.table.rows if row.last_ns < T0 + 3005]
    assert sum(source.touched(row.start, row.start + row.length) for row in earlier) == 64


def test_latched_messages_of_a_bag(tmp_path: Path) -> None:
    source = bag_of(
        [[("/robot_description", T0, b"\x04\0\0\0urdf"), ("/imu", T0 + 1, b"a")], [("/imu", T0 + 50, b"b")]]
    )
    with Recording.open(source) as recording:
        whole = cut(recording, tmp_path / "a.mcap", start=T0 + 40)
    assert stamped(whole) == [("/robot_description", 40, b"\x04\0\0\0urdf"), ("/imu", 50, b"b")]
    assert [publish_ns - T0 for _, _, publish_ns, _, _ in whole.messages] == [0, 50]


def test_each_publisher_of_a_latched_topic_has_its_last_message(tmp_path: Path) -> None:
    """Also where a later chunk already has one of another publisher."""
    out = BytesIO()
    writer = BagWriter(out, chunk_bytes=2**40)
    publishers = [
        writer.add_connection(
            "/map", "a/B", md5sum="*", definition="", properties=(("callerid", name), ("latching", "1"))
        )
        for name in ("/lower", "/upper")
    ]
    for number, data in enumerate((b"lower", b"upper", b"upper again")):
        writer.add_message(publishers[min(number, 1)], T0 + 10 * number, data)
        writer._flush()
    writer.finish()
    with Recording.open(MemorySource(out.getvalue(), "two.bag")) as recording:
        whole = cut(recording, tmp_path / "a.mcap", start=T0 + 20)
    assert stamped(whole) == [("/map", 20, b"lower"), ("/map", 20, b"upper"), ("/map", 20, b"upper again")]


@pytest.mark.parametrize("chunk_bytes", [1, 2**20], ids=["several chunks", "one chunk"])
def test_latched_messages_of_one_time_keep_their_order(tmp_path: Path, chunk_bytes: int) -> None:
    """As in a slice, where all of them have its start as log time: the last one of a frame must stay the last."""
    out = BytesIO()
    writer = McapWriter(out, chunk_bytes=chunk_bytes)
    schema = writer.add_schema("tf2_msgs/msg/TFMessage", "ros2msg", TRANSFORMS.encode())
    channel = writer.add_channel("/tf_static", schema, "cdr")
    both, again = transforms("lidar", "camera"), transforms("lidar") + b"\0"
    for time_ns, data in ((T0, both), (T0, again), (T0 + 9, both)):
        writer.add_message(channel, time_ns, data)
    writer.finish()
    with Recording.open(MemorySource(out.getvalue(), "one_time.mcap")) as recording:
        whole = cut(recording, tmp_path / "a.mcap", start=T0 + 5)
    assert [data for _, _, data in stamped(whole)] == [both, again, both]


def test_a_topic_that_only_has_the_name_of_static_transforms(tmp_path: Path) -> None:
    out = BytesIO()
    writer = McapWriter(out)
    channel = writer.add_channel("/tf_static", writer.add_schema("a/msg/B", "ros2msg", b"uint32 transforms"), "cdr")
    for number in range(3):
        writer.add_message(channel, T0 + number, b"\0\1\0\0" + bytes([number, 0, 0, 0]))
    writer.finish()
    with Recording.open(MemorySource(out.getvalue(), "other.mcap")) as recording:
        whole = cut(recording, tmp_path / "a.mcap", start=T0 + 2)
    assert [data[4] for _, _, data in stamped(whole)] == [1, 2]


# Bytes


CHUNKS: list[list[Stamped]] = [
    [("/imu" if chunk % 4 else "/camera", T0 + 100 * chunk + step, NOISE[chunk:]) for step in range(3)]
    for chunk in range(80)
]


def test_only_the_chunks_needed_are_read_over_a_network(tmp_path: Path) -> None:
    source = Watched(mcap_of(CHUNKS), parallel_reads=8)
    with Recording.open(source) as recording:
        needed = [one for one in recording.segments("/camera") if one.last_ns >= T0 + 2000 and one.first_ns < T0 + 4000]
        source.ranges.clear()
        whole = cut(recording, tmp_path / "a.mcap", "/camera", start=T0 + 2000, end=T0 + 4000)
    expected = [one for chunk in CHUNKS for one in chunk if one[0] == "/camera" and T0 + 2000 <= one[1] < T0 + 4000]
    assert [(topic, log_ns, data) for topic, log_ns, _, _, data in whole.messages] == expected
    outside = 64 * 2**10  # the window that looks for attachments behind the last chunk
    assert source.bytes_read <= 1.2 * sum(segment.size_bytes for segment in needed) + outside


class FetchedTogether(Watched):
    """A source that answers requests for some offsets once all of them have come."""

    def __init__(self, source: MemorySource) -> None:
        super().__init__(source, parallel_reads=8)
        self.offsets: list[int] = []
        self.together = threading.Barrier(1)

    def read(self, offset: int, length: int) -> bytes:
        if offset in self.offsets:
            self.together.wait(20)
        return super().read(offset, length)


def test_the_first_chunks_of_a_slice_are_fetched_together(tmp_path: Path) -> None:
    source = FetchedTogether(mcap_of(CHUNKS))
    with Recording.open(source) as recording:
        (member,) = recording.members
        assert isinstance(member, ChunkedMember)
        source.offsets = [row.start for row in member.table.rows][20:40:4]
        source.together = threading.Barrier(len(source.offsets))
        cut(recording, tmp_path / "a.mcap", "/camera", start=T0 + 2000, end=T0 + 4000)


def test_the_start_is_inclusive_and_the_end_exclusive(tmp_path: Path) -> None:
    with Recording.open(mcap_of(CHUNKS)) as recording:
        whole = cut(recording, tmp_path / "a.mcap", start=T0 + 101, end=T0 + 202)
        assert [log_ns for _, log_ns, _ in stamped(whole)] == [101, 102, 200, 201]
        relative = cut(recording, tmp_path / "b.mcap", start="+101ns", end="+202ns")
    assert relative.messages == whole.messages


# Bad input


def test_a_start_behind_all_times_of_a_database(tmp_path: Path) -> None:
    database = make_database(tmp_path / "a.db3", schema="crystal", messages=[(1, T0, b"\0\1\0\0")])
    with Recording.open(database) as recording:
        assert not list(recording.raw_messages(start=2**63))


def test_ranges_and_topics_that_are_wrong_are_named(tmp_path: Path) -> None:
    target = tmp_path / "a.mcap"
    with Recording.open(mcap_of(CHUNKS)) as recording:
        with pytest.raises(EmptyRange, match=r"the end, 2023-11-14T22:13:20.000Z, is not after the start"):
            recording.to_mcap(target, start=T0 + 5, end=T0 + 5)
        with pytest.raises(OutsideRecording, match=r"nothing was recorded from .*: the messages are from .* to "):
            recording.to_mcap(target, start=T0 + 10**6)
        with pytest.raises(OutsideRecording, match=r"nothing was recorded before "):
            recording.to_mcap(target, end=T0)
        with pytest.raises(NoSuchTopic, match="no topic /gps; the recording has /camera, /imu"):
            recording.to_mcap(target, ["/imu", "/gps"], start=T0)
        with pytest.raises(ValueError, match="is no time; write it like"):
            recording.to_mcap(target, start="noon")
        assert not target.exists()
        target.write_bytes(b"mine")
        with pytest.raises(CannotWrite, match="is not replaced"):
            recording.to_mcap(target, start=T0)
    assert target.read_bytes() == b"mine"
    with Recording.open(mcap_of([])) as empty, pytest.raises(OutsideRecording, match="there are no messages"):
        empty.to_mcap(tmp_path / "b.mcap", start=T0)


def test_a_quiet_range_of_a_topic_is_an_empty_file(tmp_path: Path) -> None:
    with Recording.open(mcap_of(CHUNKS)) as recording:
        whole = cut(recording, tmp_path / "a.mcap", "/camera", start=T0 + 110, end=T0 + 150)
    assert whole.messages == []
    assert [channel.topic for channel in whole.channels] == ["/camera"]


def test_damage_in_the_range_is_in_the_result(tmp_path: Path) -> None:
    source = mcap_of(CHUNKS)
    with Recording.open(source) as recording:
        segment, (member,) = recording.segments()[20], recording.members
        assert isinstance(member, ChunkedMember)
        chunk_start = member.table.rows[20].start
        data = bytearray(source.read(0, source.size_bytes))
        position = data.index(b"\x28\xb5\x2f\xfd", chunk_start)
        data[position + 8 : position + 40] = bytes(32)
    with Recording.open(MemorySource(bytes(data))) as recording:
        result = recording.to_mcap(tmp_path / "a.mcap", start=segment.first_ns, end=segment.last_ns + 1)
        elsewhere = recording.to_mcap(tmp_path / "b.mcap", start=T0 + 3000)
    (loss,) = result.losses
    assert [place.where for place in loss.places] == [f"chunk at byte {chunk_start}"]
    assert json.loads(read_whole_mcap(tmp_path / "a.mcap").metadata_of(MADE_FROM)["losses"])
    assert elsewhere.message_count == 150


def test_a_file_that_changes_is_an_error(tmp_path: Path) -> None:
    source, target = tmp_path / "drive.mcap", tmp_path / "a.mcap"
    memory = mcap_of(CHUNKS[:5])
    source.write_bytes(memory.read(0, memory.size_bytes))

    with Recording.open(source) as recording:
        with source.open("ab") as stream:
            stream.write(b"more")
        with pytest.raises(SourceError, match=r"drive\.mcap: changed while it was read"):
            recording.to_mcap(target, start=T0 + 100)
    assert [path.name for path in tmp_path.iterdir()] == ["drive.mcap"]


# Several recordings


def test_overlapping_recordings_are_merged_by_log_time(tmp_path: Path) -> None:
    left = mcap_of([[("/a", T0 + 2 * step, b"left")] for step in range(50)], name="left.mcap")
    right = mcap_of([[("/a", T0 + 3 * step, b"right"), ("/b", T0 + 3 * step + 1, b"")] for step in range(50)])
    with Recording.open(left) as one, Recording.open(right) as other:
        result = merge_to_mcap([one, other], tmp_path / "a.mcap", start="+10ns", end=T0 + 100)
    whole = read_whole_mcap(tmp_path / "a.mcap")
    expected = [
        *(("/a", 2 * step, b"left") for step in range(50)),
        *(message for step in range(50) for message in (("/a", 3 * step, b"right"), ("/b", 3 * step + 1, b""))),
    ]
    expected = sorted((one for one in expected if 10 <= one[1] < 100), key=lambda one: one[1])
    assert stamped(whole) == expected
    assert result.message_count == len(expected)
    assert [channel.topic for channel in whole.channels] == ["/a", "/b"], "equal channels are one"
    files = json.loads(whole.metadata_of(MADE_FROM)["files"])
    assert files == [{"name": "left.mcap", "recording": "0"}, {"name": "test.mcap", "recording": "1"}]


def test_channels_that_differ_stay_apart(tmp_path: Path) -> None:
    with (
        Recording.open(mcap_of([[("/a", T0, b"x")]])) as one,
        Recording.open(bag_of([[("/a", T0 + 1, b"y")]])) as other,
    ):
        merge_to_mcap([one, other], tmp_path / "a.mcap")
    whole = read_whole_mcap(tmp_path / "a.mcap")
    assert [(channel.topic, channel.message_encoding) for channel in whole.channels] == [("/a", "cdr"), ("/a", "ros1")]
    assert stamped(whole) == [("/a", 0, b"x"), ("/a", 1, b"y")]
    assert whole.header.profile == ""


def test_recordings_outside_the_range_are_left_out(tmp_path: Path) -> None:
    early, late = Watched(mcap_of([[("/a", T0, b"early")]])), mcap_of([[("/b", T0 + 100, b"late")]])
    with Recording.open(early) as one, Recording.open(late) as other:
        early.ranges.clear()
        merge_to_mcap([one, other], tmp_path / "a.mcap", start=T0 + 50)
        assert early.ranges == []
        with pytest.raises(OutsideRecording, match="the 2 recordings: nothing was recorded"):
            merge_to_mcap([one, other], tmp_path / "b.mcap", start=T0 + 10, end=T0 + 90)
        with pytest.raises(NoSuchTopic):
            merge_to_mcap([one, other], tmp_path / "b.mcap", "/c")
        merge_to_mcap([one, other], tmp_path / "c.mcap", "/b")
    whole = read_whole_mcap(tmp_path / "a.mcap")
    assert stamped(whole) == [("/b", 100, b"late")]
    assert json.loads(whole.metadata_of(MADE_FROM)["files"]) == [{"name": "test.mcap"}]
    assert stamped(read_whole_mcap(tmp_path / "c.mcap")) == [("/b", 100, b"late")]


def test_clocks_that_jump_give_messages_in_order(tmp_path: Path) -> None:
    """One clock goes back by half a minute in the middle, the other forward."""
    back = mcap_of([[("/a", T0 + 100 + step - 60 * (step > 50), bytes([step])) for step in range(100)]])
    forward = mcap_of([[("/b", T0 + step + 70 * (step > 30), bytes([step]))] for step in range(100)])
    with Recording.open(back) as one, Recording.open(forward) as other:
        result = merge_to_mcap([one, other], tmp_path / "a.mcap")
    whole = read_whole_mcap(tmp_path / "a.mcap")  # asserts the order of log times
    assert result.message_count == 200
    assert sorted(data for topic, _, data in stamped(whole) if topic == "/a") == [bytes([step]) for step in range(100)]
