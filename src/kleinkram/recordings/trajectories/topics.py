"""Trajectories in topics: odometry, poses, transforms and paths.

Stamps are those of the headers, when the pose was measured; of a path, those of its poses. Source: nav_msgs and
geometry_msgs of ROS 1 and ROS 2, foxglove.PoseInFrame.
"""

from __future__ import annotations

from kleinkram.recordings.decoding import DecodeError
from kleinkram.recordings.decoding.values import part, stamp_ns
from kleinkram.recordings.errors import TrajectoryRefused
from kleinkram.recordings.messages import RawMessage, Topic
from kleinkram.recordings.recording import Recording, decode
from kleinkram.recordings.trajectories.model import PoseList, Trajectory, seconds_text

POSE_TYPES = ("Odometry", "PoseStamped", "PoseWithCovarianceStamped", "TransformStamped", "PoseInFrame", "Path")
"""Message types, without their packages, whose topics are trajectories."""


def read_topic(recording: Recording, topic: str) -> Trajectory:
    """Read the poses of a topic; of a topic of paths, those of its last message, in the order of the path.

    Raises:
        NoSuchTopic: there is none of that name.
        TrajectoryRefused: its type has no poses, or they cannot be used; the sentence names the time.
        SourceError: the bytes cannot be read.
    """
    properties = recording.topic(topic)
    _check_type(recording, properties)
    if _short_type(properties) == "Path":
        return _read_path(recording, topic)
    poses = PoseList(topic, _place)
    frames = ("", "")
    for message in recording.messages(topic):
        value = message.value
        if isinstance(value, bytes):
            raise TrajectoryRefused(topic, f"{_place(message.log_time_ns)} cannot be decoded")
        stamp = message.stamp_ns
        if stamp is None:
            raise TrajectoryRefused(topic, f"{_place(message.log_time_ns)} has no stamp")
        if not len(poses):
            frames = frame_of(value), str(part(value, "child_frame_id") or "")
        poses.add(message.log_time_ns, stamp, _pose(topic, message.log_time_ns, value))
    return poses.trajectory(*frames)


def _check_type(recording: Recording, topic: Topic) -> None:
    if topic.undecodable is not None:
        raise TrajectoryRefused(topic.name, f"cannot be decoded: {topic.undecodable}")
    if _short_type(topic) not in POSE_TYPES:
        others = [other.name for other in recording.topics if _short_type(other) in POSE_TYPES]
        choice = f"topics with poses: {', '.join(others[:20])}" if others else "the recording has no topic with poses"
        raise TrajectoryRefused(topic.name, f"is of type {topic.message_type}, which has no poses; {choice}")


def _short_type(topic: Topic) -> str:
    return topic.message_type.replace(".", "/").rpartition("/")[2]


def _read_path(recording: Recording, topic: str) -> Trajectory:
    """Read the last path, since a path that grows is published again and again."""
    last: RawMessage | None = None
    for message in recording.raw_messages(topic):
        last = message
    if last is None:
        raise TrajectoryRefused(topic, "has no messages")
    try:
        path = decode(last)
    except DecodeError as error:
        raise TrajectoryRefused(topic, f"{_place(last.log_time_ns)} cannot be decoded: {error}") from None
    poses = PoseList(topic, lambda number: f"pose {number} of its last path")
    for number, pose in enumerate(part(path, "poses") or ()):
        poses.add(number, stamp_ns(pose), _pose(topic, last.log_time_ns, pose))
    return poses.trajectory(frame_of(path))


def _place(log_time_ns: int) -> str:
    return f"the message logged at {seconds_text(log_time_ns)} s"


def frame_of(value: object) -> str:
    """Return the frame of a message, without the slash that ROS 1 may put first."""
    name = part(part(value, "header"), "frame_id") or part(value, "frame_id") or ""
    return str(name).lstrip("/")


def _pose(topic: str, log_time_ns: int, value: object) -> tuple[float, ...]:
    pose = part(value, "pose")
    inner = part(pose, "pose")
    pose = pose if inner is None else inner
    try:
        if pose is None:
            return transform_of(part(value, "transform"))
        return _seven(part(pose, "position"), part(pose, "orientation"))
    except (TypeError, ValueError):
        raise TrajectoryRefused(topic, f"{_place(log_time_ns)} has no pose") from None


def transform_of(value: object) -> tuple[float, ...]:
    """Return translation and rotation of a transform: 7 numbers. Raises TypeError or ValueError."""
    return _seven(part(value, "translation"), part(value, "rotation"))


def _seven(position: object, orientation: object) -> tuple[float, ...]:
    return (
        *(float(part(position, axis)) for axis in "xyz"),
        *(float(part(orientation, axis)) for axis in "xyzw"),
    )
