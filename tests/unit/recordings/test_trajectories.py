"""Trajectories are read from files, topics and transforms; what cannot be compared is refused with its line or time."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kleinkram.recordings import NoSuchTopic, Recording
from kleinkram.recordings.trajectories import (
    Trajectory,
    TrajectoryRefused,
    quaternions_of,
    read_file,
    read_topic,
    read_transforms,
    rotations_of,
    write_tum,
)
from tests.recording_files.memory_source import MemorySource
from tests.recording_files.ros_messages import SECOND, T0, TimedMessage, ros1_bag, ros2_mcap

BOTH = pytest.mark.parametrize("make", [ros2_mcap, ros1_bag], ids=["ros2", "ros1"])
IDENTITY = (0.0, 0.0, 0.0, 1.0)
QUARTER_TURN = (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5))
TUM = "# timestamp x y z qx qy qz qw\n1.5 1 2 3 0 0 0 1\n2.000000001 4 5 6 0 0 1 0\n"


def from_text(folder: Path, text: str, name: str = "poses.txt") -> Trajectory:
    path = folder / name
    path.write_text(text)
    return read_file(path)


def refusal_of(folder: Path, text: str) -> str:
    with pytest.raises(TrajectoryRefused) as caught:
        from_text(folder, text)
    return str(caught.value)


def stamps_of(trajectory: Trajectory) -> list[int]:
    assert trajectory.stamps_ns is not None
    return [int(stamp) for stamp in trajectory.stamps_ns]


def test_tum_has_stamps_to_the_nanosecond(tmp_path: Path) -> None:
    trajectory = from_text(tmp_path, TUM)
    assert stamps_of(trajectory) == [1_500_000_000, 2_000_000_001]
    assert trajectory.positions.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert trajectory.orientations.tolist() == [[0, 0, 0, 1], [0, 0, 1, 0]]
    assert len(trajectory) == 2
    assert trajectory.length_m == pytest.approx(math.sqrt(27))


def test_tum_with_stamps_in_nanoseconds(tmp_path: Path) -> None:
    text = f"{T0 + 7} 0 0 0 0 0 0 1\n{T0 + 8} 0 0 0 0 0 0 1\n"
    assert stamps_of(from_text(tmp_path, text)) == [T0 + 7, T0 + 8]


def test_kitti_has_matrices_and_no_stamps(tmp_path: Path) -> None:
    trajectory = from_text(tmp_path, "1 0 0 7 0 1 0 8 0 0 1 9\n0 -1 0 1 1 0 0 2 0 0 1 3\n")
    assert trajectory.stamps_ns is None
    assert trajectory.positions.tolist() == [[7, 8, 9], [1, 2, 3]]
    assert trajectory.orientations == pytest.approx(np.array([IDENTITY, QUARTER_TURN]))


@pytest.mark.parametrize(
    "header",
    [
        "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []\n",
        "#timestamp, p_x, p_y, p_z, q_w, q_x, q_y, q_z\n",
        "",
    ],
)
def test_euroc_has_the_real_part_first(tmp_path: Path, header: str) -> None:
    rows = f"{T0},1,2,3,1,0,0,0\n{T0 + 5_000_000},4,5,6,{math.sqrt(0.5)},0,0,{math.sqrt(0.5)}\n"
    trajectory = from_text(tmp_path, header + rows)
    assert stamps_of(trajectory) == [T0, T0 + 5_000_000]
    assert trajectory.positions[1].tolist() == [4, 5, 6]
    assert trajectory.orientations == pytest.approx(np.array([IDENTITY, QUARTER_TURN]))


def test_names_of_columns_decide_on_the_order_of_the_quaternion(tmp_path: Path) -> None:
    trajectory = from_text(tmp_path, "time,x,y,z,qx,qy,qz,qw\n1.5,1,2,3,0,0,0.6,0.8\n")
    assert trajectory.orientations.tolist() == [[0, 0, 0.6, 0.8]]


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "has no poses"),
        ("# nothing\n\n", "has no poses"),
        ("1.5 0 0 0 0 0 0 1\n1.2 0 0 0 0 0 0 1\n", "line 2: its stamp 1.200000000 s is earlier than 1.500000000 s"),
        ("1.5 0 0 0 0 0 0 1\n\n1.5 1 0 0 0 0 0 1\n", "line 3: its stamp 1.500000000 s is that of the pose before it"),
        ("0 0 0 0 0 0 0 1\n0 1 0 0 0 0 0 1\n", "its poses have no stamps: all are 0"),
        ("1.5 0 nan 0 0 0 0 1\n", "line 1: its pose is NaN or infinite"),
        ("1.5 0 0 0 0 0 0 0\n", "line 1: its quaternion has the length 0, not 1"),
        ("nan 0 0 0 0 0 0 1\n", "line 1 has the stamp 'nan', which is not a time"),
        ("1.5 0 0 0 0 0 0 1\n2.5 0 0 0 0 0 0\n", "line 2 is no pose: it has 7 values, not 8"),
        ("1.5 0 0 0 0 0 0 1\n2.5 0 0 0 0 0 0 x\n", "line 2 is no pose: 'x' is not a number"),
        ("1 2 3\n", "line 1 has 3 values; a pose of TUM has 8 values, one of KITTI 12"),
        ("1 0 0 7 0 1 0 8 0 0 2 9\n", "line 1: its matrix is no rotation"),
        ("1 0 0 7 0 1 0 8 0 0 nan 9\n", "line 1: its matrix is no rotation"),
        ("1.5,0,0,0,0,0,0,1\n", "line 1 has no names of columns above it, and its stamp is not EuRoC's"),
        ("stamp,b,c\n1,2,3\n", "line 2 is a row of a table whose columns are no poses"),
        (f"{T0},0,0,0,1,0,0,0\n{T0},0,0,0,1,0,0,0\n", f"line 2: its stamp {T0 // SECOND}.000000000 s is that of"),
    ],
)
def test_what_cannot_be_compared_is_refused_with_its_line(tmp_path: Path, text: str, sentence: str) -> None:
    refusal = refusal_of(tmp_path, text)
    assert refusal.startswith("poses.txt: ")
    assert sentence in refusal


@given(st.binary(max_size=300))
def test_any_bytes_are_a_trajectory_or_refused(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> None:
    path = tmp_path_factory.getbasetemp() / "any-bytes"
    path.write_bytes(data)
    try:
        trajectory = read_file(path)
    except TrajectoryRefused:
        return
    assert len(trajectory) > 0


NEARLY_UPRIGHT = (0, 0, 0, 2)
NUMBER = st.floats(-1e6, 1e6).map(lambda value: value + 0.0)
POSE = st.tuples(st.tuples(NUMBER, NUMBER, NUMBER), st.tuples(*[st.floats(-1, 1)] * 4))


@given(st.lists(POSE, min_size=1, max_size=5), st.integers(0, 2**62), st.integers(1, 2**40))
def test_what_is_written_is_read_again(
    tmp_path_factory: pytest.TempPathFactory, poses: list[Any], first_ns: int, step_ns: int
) -> None:
    orientations = np.array([quaternion for _, quaternion in poses]) + np.array(NEARLY_UPRIGHT)
    orientations /= np.linalg.norm(orientations, axis=1, keepdims=True)
    # Seconds up to 2262, so that the unit of the stamps is known.
    stamps_ns = np.array([SECOND + first_ns + number * step_ns for number in range(len(poses))], dtype=np.int64)
    written = Trajectory("written", stamps_ns, np.array([position for position, _ in poses]), orientations)
    path = tmp_path_factory.getbasetemp() / "written.tum"
    write_tum(written, path)
    again = read_file(path)
    assert stamps_of(again) == stamps_of(written)
    assert again.positions.tolist() == written.positions.tolist()
    assert again.orientations == pytest.approx(written.orientations, abs=1e-15)


def test_a_trajectory_without_stamps_is_not_written(tmp_path: Path) -> None:
    trajectory = from_text(tmp_path, "1 0 0 7 0 1 0 8 0 0 1 9\n")
    with pytest.raises(TrajectoryRefused, match="has no stamps, which the format of TUM requires"):
        write_tum(trajectory, tmp_path / "out.tum")


@given(st.lists(st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: math.hypot(*q) > 0.1), min_size=1, max_size=5))
def test_matrices_and_quaternions_are_the_same_rotations(quaternions: list[tuple[float, ...]]) -> None:
    orientations = np.array(quaternions)
    orientations /= np.linalg.norm(orientations, axis=1, keepdims=True)
    rotations = rotations_of(orientations)
    assert rotations @ rotations.transpose(0, 2, 1) == pytest.approx(np.tile(np.eye(3), (len(quaternions), 1, 1)))
    assert np.linalg.det(rotations) == pytest.approx(np.ones(len(quaternions)))
    back = quaternions_of(rotations)
    assert np.abs((back * orientations).sum(axis=1)) == pytest.approx(np.ones(len(quaternions)))


def pose_of(x: float, orientation: Sequence[float] = IDENTITY) -> dict[str, Any]:
    return {"position": {"x": x, "y": 2.0, "z": 3.0}, "orientation": dict(zip("xyzw", orientation, strict=True))}


def transform_of(x: float, orientation: Sequence[float] = IDENTITY) -> dict[str, Any]:
    return {"translation": {"x": x, "y": 0.0, "z": 0.0}, "rotation": dict(zip("xyzw", orientation, strict=True))}


VALUES: dict[str, Callable[[float], dict[str, Any]]] = {
    "nav_msgs/Odometry": lambda x: {"pose": {"pose": pose_of(x)}, "child_frame_id": "base_link"},
    "geometry_msgs/PoseStamped": lambda x: {"pose": pose_of(x)},
    "geometry_msgs/PoseWithCovarianceStamped": lambda x: {"pose": {"pose": pose_of(x)}},
}


@BOTH
@pytest.mark.parametrize("message_type", VALUES)
def test_poses_of_a_topic_have_the_stamps_of_their_headers(make: Any, message_type: str) -> None:
    """They arrive a second later."""
    timed = [
        TimedMessage("/pose", message_type, T0 + SECOND + number, VALUES[message_type](float(number)), T0 + number)
        for number in range(3)
    ]
    with Recording.open(make(timed)) as recording:
        trajectory = read_topic(recording, "/pose")
    assert stamps_of(trajectory) == [T0, T0 + 1, T0 + 2]
    assert trajectory.positions.tolist() == [[0, 2, 3], [1, 2, 3], [2, 2, 3]]
    assert trajectory.frame == "sensor"
    assert trajectory.child_frame == ("base_link" if message_type == "nav_msgs/Odometry" else "")


def test_a_topic_of_transforms() -> None:
    values = {"transform": transform_of(4.0, QUARTER_TURN), "child_frame_id": "base"}
    timed = [TimedMessage("/vicon", "geometry_msgs/TransformStamped", T0, values, T0)]
    with Recording.open(ros2_mcap(timed)) as recording:
        trajectory = read_topic(recording, "/vicon")
    assert (trajectory.positions.tolist(), trajectory.child_frame) == ([[4, 0, 0]], "base")
    assert trajectory.orientations == pytest.approx(np.array([QUARTER_TURN]))


def path_message(log_ns: int, stamps_ns: Iterable[int]) -> TimedMessage:
    poses = [
        {"header": {"stamp": {"sec": stamp // SECOND, "nanosec": stamp % SECOND}}, "pose": pose_of(float(number))}
        for number, stamp in enumerate(stamps_ns)
    ]
    return TimedMessage("/path", "nav_msgs/Path", log_ns, {"poses": poses}, log_ns)


def test_the_last_path_of_a_topic_counts() -> None:
    timed = [path_message(T0, [T0]), path_message(T0 + 10, [T0, T0 + 5, T0 + 9])]
    with Recording.open(ros2_mcap(timed)) as recording:
        trajectory = read_topic(recording, "/path")
    assert stamps_of(trajectory) == [T0, T0 + 5, T0 + 9]
    assert trajectory.frame == "sensor"


def test_a_path_with_a_doubled_stamp_is_refused() -> None:
    with (
        Recording.open(ros2_mcap([path_message(T0, [T0, T0 + 5, T0 + 5])])) as recording,
        pytest.raises(
            TrajectoryRefused, match=r"^/path: pose 2 of its last path: its stamp .* is that of the pose before"
        ),
    ):
        read_topic(recording, "/path")


@pytest.mark.parametrize(
    ("stamps_ns", "sentence"),
    [
        (
            [T0, T0 + 5, T0 + 5],
            "the message logged at 1700000000.000000002 s: its stamp 1700000000.000000005 s is that of",
        ),
        (
            [T0 + 5, T0],
            "the message logged at 1700000000.000000001 s: its stamp 1700000000.000000000 s is earlier than",
        ),
        ([0, 0], "its poses have no stamps: all are 0"),
    ],
)
def test_stamps_of_a_topic_that_do_not_ascend_are_refused(stamps_ns: list[int], sentence: str) -> None:
    timed = [
        TimedMessage("/odom", "nav_msgs/Odometry", T0 + number, {"pose": {"pose": pose_of(0.0)}}, stamp_ns)
        for number, stamp_ns in enumerate(stamps_ns)
    ]
    with Recording.open(ros2_mcap(timed)) as recording, pytest.raises(TrajectoryRefused) as caught:
        read_topic(recording, "/odom")
    assert str(caught.value).startswith(f"/odom: {sentence}")


def test_a_topic_of_another_type_is_refused() -> None:
    timed = [
        TimedMessage("/imu", "sensor_msgs/Imu", T0, {}, T0),
        TimedMessage("/odom", "nav_msgs/Odometry", T0, {"pose": {"pose": pose_of(0.0)}}, T0),
    ]
    with Recording.open(ros2_mcap(timed)) as recording:
        with pytest.raises(TrajectoryRefused) as caught:
            read_topic(recording, "/imu")
        with pytest.raises(NoSuchTopic):
            read_topic(recording, "/nothing")
    assert str(caught.value) == ("/imu: is of type sensor_msgs/msg/Imu, which has no poses; topics with poses: /odom")


def test_json_messages_without_stamps_are_refused() -> None:
    with Recording.open(json_mcap([{"pose": pose_of(0.0)}])) as recording, pytest.raises(TrajectoryRefused) as caught:
        read_topic(recording, "/pose")
    assert str(caught.value) == "/pose: the message logged at 1700000000.000000000 s has no stamp"


def test_json_messages_without_poses_are_refused() -> None:
    stamp = {"timestamp": {"sec": 5, "nsec": 0}}
    for message in ({**stamp, "pose": 3}, stamp, {**stamp, "pose": {"position": {"x": "a"}}}):
        with Recording.open(json_mcap([message])) as recording, pytest.raises(TrajectoryRefused, match="has no pose"):
            read_topic(recording, "/pose")


def json_mcap(messages: Sequence[dict[str, Any]]) -> MemorySource:
    """A topic of foxglove.PoseInFrame, in JSON."""
    import json
    from io import BytesIO

    from tests.recording_files.writers import McapWriter

    out = BytesIO()
    writer = McapWriter(out, profile="")
    channel = writer.add_channel("/pose", writer.add_schema("foxglove.PoseInFrame", "jsonschema", b"{}"), "json")
    for number, message in enumerate(messages):
        writer.add_message(channel, T0 + number, json.dumps(message).encode())
    writer.finish()
    return MemorySource(out.getvalue(), "pose.mcap")


def test_poses_in_json() -> None:
    message = {"timestamp": {"sec": 5, "nsec": 7}, "frame_id": "map", "pose": pose_of(1.0)}
    with Recording.open(json_mcap([message])) as recording:
        trajectory = read_topic(recording, "/pose")
    assert (stamps_of(trajectory), trajectory.frame) == ([5 * SECOND + 7], "map")


def tf(
    stamp_ns: int, parent: str, child: str, transform: dict[str, Any], *, topic: str = "/tf", seconds: str = "sec"
) -> TimedMessage:
    parts = ("sec", "nanosec") if seconds == "sec" else ("secs", "nsecs")
    stamp = dict(zip(parts, divmod(stamp_ns, SECOND), strict=True))
    header = {"stamp": stamp, "frame_id": parent}
    values = {"transforms": [{"header": header, "child_frame_id": child, "transform": transform}]}
    return TimedMessage(topic, "tf2_msgs/TFMessage", stamp_ns, values)


@BOTH
def test_a_pair_of_frames(make: Any) -> None:
    seconds = "sec" if make is ros2_mcap else "secs"
    timed = [tf(T0 + number, "/odom", "base", transform_of(float(number)), seconds=seconds) for number in range(3)]
    timed.insert(2, timed[1])  # a repeated transform counts once
    with Recording.open(make(timed)) as recording:
        trajectory = read_transforms(recording, "odom", "/base")
    assert stamps_of(trajectory) == [T0, T0 + 1, T0 + 2]
    assert trajectory.positions[:, 0].tolist() == [0, 1, 2]
    assert (trajectory.name, trajectory.frame, trajectory.child_frame) == ("tf:odom->base", "odom", "base")


def test_a_chain_of_frames_is_interpolated_and_goes_both_ways() -> None:
    """map->odom corrects once a second, odom->base moves, and the map is fixed in the world the other way round."""
    timed = [tf(T0 + number * SECOND // 2, "odom", "base", transform_of(number / 2)) for number in range(9)]
    timed += [tf(T0 + number * SECOND, "map", "odom", transform_of(10.0 * number)) for number in range(1, 4)]
    timed += [tf(T0, "map", "world", transform_of(1.0, QUARTER_TURN), topic="/tf_static")]
    with Recording.open(ros2_mcap(sorted(timed, key=lambda message: message.log_ns))) as recording:
        on_map = read_transforms(recording, "map", "base")
        in_world = read_transforms(recording, "world", "base")
    assert stamps_of(on_map) == [T0 + number * SECOND // 2 for number in range(2, 7)]
    assert on_map.positions[:, 0] == pytest.approx([10 + 1, 15 + 1.5, 20 + 2, 25 + 2.5, 30 + 3])
    # A quarter turn to the left and one metre: x of the map is -y of the world.
    assert in_world.positions[:, 1] == pytest.approx(1 - on_map.positions[:, 0])
    assert in_world.positions[:, 0] == pytest.approx(np.zeros(5))
    turned_back = np.tile([*QUARTER_TURN[:2], -QUARTER_TURN[2], QUARTER_TURN[3]], (5, 1))
    assert in_world.orientations == pytest.approx(turned_back)


def test_a_static_transform_is_one_pose_without_stamps() -> None:
    timed = [
        tf(T0, "base", "mast", transform_of(1.0), topic="/tf_static"),
        tf(T0, "mast", "lidar", transform_of(0.5), topic="/tf_static"),
    ]
    with Recording.open(ros2_mcap(timed)) as recording:
        mount = read_transforms(recording, "base", "lidar")
    assert (mount.stamps_ns, mount.positions.tolist()) == (None, [[1.5, 0, 0]])


@pytest.mark.parametrize(
    ("parent", "child", "sentence"),
    [
        ("map", "base", "there is no frame map; the recording has base, left, odom, right"),
        ("odom", "right", "no transforms connect the two frames"),
        ("odom", "odom", "both frames are the same"),
    ],
)
def test_frames_that_are_not_connected_are_refused(parent: str, child: str, sentence: str) -> None:
    timed = [tf(T0, "odom", "base", transform_of(0.0)), tf(T0, "left", "right", transform_of(0.0))]
    with Recording.open(ros2_mcap(timed)) as recording, pytest.raises(TrajectoryRefused) as caught:
        read_transforms(recording, parent, child)
    assert str(caught.value) == f"tf:{parent}->{child}: {sentence}"


def test_two_transforms_with_one_stamp_are_refused() -> None:
    timed = [tf(T0, "odom", "base", transform_of(0.0)), tf(T0, "odom", "base", transform_of(1.0))]
    with Recording.open(ros2_mcap(timed)) as recording, pytest.raises(TrajectoryRefused) as caught:
        read_transforms(recording, "odom", "base")
    assert "odom->base: the transform logged at 1700000000.000000000 s: its stamp" in str(caught.value)


def test_a_recording_without_transforms_is_refused() -> None:
    timed = [TimedMessage("/odom", "nav_msgs/Odometry", T0, {}, T0)]
    with (
        Recording.open(ros2_mcap(timed)) as recording,
        pytest.raises(TrajectoryRefused, match="the recording has no transforms"),
    ):
        read_transforms(recording, "odom", "base")


def test_poses_between_stamps_turn_the_shorter_way() -> None:
    stamps_ns = np.array([0, 100], dtype=np.int64)
    orientations = np.array([IDENTITY, [-value for value in QUARTER_TURN]])
    trajectory = Trajectory("turn", stamps_ns, np.array([[0.0, 0, 0], [1.0, 0, 0]]), orientations)
    between = trajectory.at(np.array([0, 50, 100], dtype=np.int64))
    assert between.positions[:, 0].tolist() == [0, 0.5, 1]
    eighth = [0, 0, math.sin(math.pi / 8), math.cos(math.pi / 8)]
    assert between.orientations[1] == pytest.approx(np.array(eighth))
    with pytest.raises(ValueError, match="outside"):
        trajectory.at(np.array([101], dtype=np.int64))


def test_a_byte_order_mark_does_not_matter(tmp_path: Path) -> None:
    for text in (TUM, TUM.partition("\n")[2], "time,x,y,z,qx,qy,qz,qw\r\n1.5,1,2,3,0,0,0,1\r\n"):
        assert from_text(tmp_path, f"\ufeff{text}").positions[0].tolist() == [1, 2, 3]


def test_a_transform_is_interpolated_as_it_was_published() -> None:
    """The inverse of a turning frame moves on an arc: 100 m away, a straight line between two samples is wrong."""
    far = transform_of(100.0)
    timed = [tf(T0, "map", "odom", far), tf(T0 + 2 * SECOND, "map", "odom", transform_of(100.0, QUARTER_TURN))]
    timed += [tf(T0 + number * SECOND, "odom", "base", transform_of(0.0)) for number in range(3)]
    with Recording.open(ros2_mcap(sorted(timed, key=lambda message: message.log_ns))) as recording:
        there, back = read_transforms(recording, "map", "base"), read_transforms(recording, "base", "map")
    assert np.linalg.norm(back.positions, axis=1) == pytest.approx([100.0] * 3)
    assert there.inverse().positions == pytest.approx(back.positions)


def test_transforms_that_cannot_be_decoded_are_refused() -> None:
    import json
    from io import BytesIO

    from tests.recording_files.writers import McapWriter

    out = BytesIO()
    writer = McapWriter(out, profile="")
    channel = writer.add_channel("/tf", writer.add_schema("tf2_msgs/msg/TFMessage", "jsonschema", b"{}"), "json")
    header = {"stamp": {"sec": 5, "nanosec": 0}, "frame_id": "odom"}
    transform = {"header": header, "child_frame_id": "base", "transform": transform_of(1.0)}
    writer.add_message(channel, T0, json.dumps({"transforms": [transform]}).encode())
    writer.add_message(channel, T0 + SECOND, b"{broken")
    writer.finish()
    with (
        Recording.open(MemorySource(out.getvalue(), "tf.mcap")) as recording,
        pytest.raises(TrajectoryRefused, match=r"/tf at 1700000001\.000000000 s cannot be decoded"),
    ):
        read_transforms(recording, "odom", "base")
