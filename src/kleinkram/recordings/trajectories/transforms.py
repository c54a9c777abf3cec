"""The trajectory of one frame in another, from the transforms (tf) of a recording.

The way between the two frames may have several transforms, in either direction. Its times are those of the transform
with the most samples that is not static; the others are interpolated at them. All topics of transforms are read twice
where the way has several.

Source: tf2 and REP 105 (frames form a tree; a transform is the pose of `child_frame_id` in `header.frame_id`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Iterator
from dataclasses import replace
from functools import reduce
from typing import NamedTuple

from kleinkram.recordings.decoding import DecodeError
from kleinkram.recordings.decoding.values import part, stamp_ns
from kleinkram.recordings.errors import TrajectoryRefused
from kleinkram.recordings.recording import Recording
from kleinkram.recordings.trajectories.model import PoseList, Trajectory, seconds_text
from kleinkram.recordings.trajectories.topics import frame_of, transform_of

_TYPES = ("tf2_msgs/msg/TFMessage", "tf2_msgs/TFMessage", "tf/tfMessage")
_STATIC = "tf_static"
_MAX_FRAMES = 10_000
_SHOWN_FRAMES = 20

Edge = tuple[str, str]
"""Parent and child frame of a transform."""


class _Sample(NamedTuple):
    edge: Edge
    is_static: bool
    log_time_ns: int
    stamp_ns: int
    pose: tuple[float, ...]


def read_transforms(recording: Recording, parent: str, child: str) -> Trajectory:
    """Read the poses of frame `child` in frame `parent`.

    If all transforms between them are static, it has one pose and no stamps. A transform that is repeated with the same
    stamp and values counts once.

    Raises:
        TrajectoryRefused: the recording has no transforms between them, or they cannot be used.
        SourceError: the bytes cannot be read.
    """
    parent, child = parent.lstrip("/"), child.lstrip("/")
    name = f"tf:{parent}->{child}"
    if parent == child:
        raise TrajectoryRefused(name, "both frames are the same")
    topics = [topic.name for topic in recording.topics if topic.message_type in _TYPES]
    if not topics:
        raise TrajectoryRefused(name, "the recording has no transforms (tf2_msgs/TFMessage)")
    direct = _Series(name, {(parent, child)})
    edges: dict[Edge, None] = {}
    for sample in _samples(recording, topics, name):
        edges.setdefault(sample.edge)
        if len(edges) > _MAX_FRAMES:
            raise TrajectoryRefused(name, f"the recording has more than {_MAX_FRAMES} transforms")
        direct.add(sample)
    if (parent, child) in edges:
        return replace(direct.trajectory((parent, child)), name=name)
    way = _way(name, edges, parent, child)
    series = _Series(name, way)
    for sample in _samples(recording, topics, name):
        series.add(sample)
    starts = [*_starts(way, parent)]
    poses = _at_common_times(name, [series.trajectory(edge) for edge in way])
    steps = [step if edge[0] == start else step.inverse() for step, edge, start in zip(poses, way, starts, strict=True)]
    return replace(reduce(Trajectory.followed_by, steps), name=name)


def _samples(recording: Recording, topics: list[str], name: str) -> Iterator[_Sample]:
    for message in recording.messages(topics):
        is_static = message.topic.rpartition("/")[2] == _STATIC
        if isinstance(message.value, bytes):
            place = f"{message.topic} at {seconds_text(message.log_time_ns)} s"
            raise TrajectoryRefused(name, f"{place} cannot be decoded")
        for transform in part(message.value, "transforms") or ():
            edge = frame_of(transform), str(part(transform, "child_frame_id") or "").lstrip("/")
            try:
                stamp = stamp_ns(transform) or 0
                pose = transform_of(part(transform, "transform"))
            except (DecodeError, TypeError, ValueError):
                place = f"{message.topic} at {seconds_text(message.log_time_ns)} s"
                raise TrajectoryRefused(name, f"{place} has a transform that cannot be read") from None
            yield _Sample(edge, is_static, message.log_time_ns, stamp, pose)


class _Series:
    """The samples of some transforms; of a static one, the last."""

    def __init__(self, name: str, edges: Collection[Edge]) -> None:
        self._name = name
        self._poses = {edge: PoseList(f"{name}: {edge[0]}->{edge[1]}", _place) for edge in edges}
        self._static: dict[Edge, _Sample] = {}

    def add(self, sample: _Sample) -> None:
        poses = self._poses.get(sample.edge)
        if poses is None:
            return
        if sample.is_static:
            self._static[sample.edge] = sample
        elif not poses.repeats_last(sample.stamp_ns, sample.pose):
            poses.add(sample.log_time_ns, sample.stamp_ns, sample.pose)

    def trajectory(self, edge: Edge) -> Trajectory:
        """Return the samples of a transform; one pose without stamps if it is static. Raises TrajectoryRefused."""
        poses = self._poses[edge]
        if edge in self._static and not len(poses):
            poses.add(self._static[edge].log_time_ns, None, self._static[edge].pose)
        return poses.trajectory(*edge)


def _place(log_time_ns: int) -> str:
    return f"the transform logged at {seconds_text(log_time_ns)} s"


def _way(name: str, edges: Collection[Edge], parent: str, child: str) -> list[Edge]:
    """Return the transforms between two frames, from the parent on, by the fewest steps. Raises TrajectoryRefused."""
    neighbours: dict[str, list[tuple[str, Edge]]] = {}
    for edge in edges:
        for start, end in (edge, edge[::-1]):
            neighbours.setdefault(start, []).append((end, edge))
    for frame in (parent, child):
        if frame not in neighbours:
            raise TrajectoryRefused(name, f"there is no frame {frame}; the recording has {_shown(neighbours)}")
    came_by: dict[str, tuple[str, Edge]] = {}
    waiting = deque([parent])
    while waiting and child not in came_by:
        frame = waiting.popleft()
        for neighbour, edge in neighbours[frame]:
            if neighbour not in came_by and neighbour != parent:
                came_by[neighbour] = frame, edge
                waiting.append(neighbour)
    if child not in came_by:
        raise TrajectoryRefused(name, "no transforms connect the two frames")
    way: list[Edge] = []
    frame = child
    while frame != parent:
        frame, edge = came_by[frame]
        way.append(edge)
    return way[::-1]


def _shown(frames: Collection[str]) -> str:
    names = sorted(frames)
    return ", ".join(names[:_SHOWN_FRAMES]) + (", …" if len(names) > _SHOWN_FRAMES else "")


def _starts(way: list[Edge], parent: str) -> Iterator[str]:
    """Yield the frame at which each step of a way begins."""
    frame = parent
    for edge in way:
        yield frame
        frame = edge[1] if edge[0] == frame else edge[0]


def _at_common_times(name: str, steps: list[Trajectory]) -> list[Trajectory]:
    """Return transforms as published, since the inverse of a turning one does not move in a straight line."""
    stamps = [step.stamps_ns for step in steps if step.stamps_ns is not None]
    if not stamps:
        return steps
    longest = max(stamps, key=len)
    common = longest[(longest >= max(own[0] for own in stamps)) & (longest <= min(own[-1] for own in stamps))]
    if not len(common):
        raise TrajectoryRefused(name, "its transforms have no time in common")
    return [step if step.stamps_ns is None else step.at(common) for step in steps]
