"""Makes sample missions: one drive, recorded as MCAP, ROS 1 bag and rosbag2 db3, of any size, with a known truth.

Memory is that of one chunk and of the truth (8 bytes a message), whatever the size.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Collection
from dataclasses import dataclass
from enum import Enum
from itertools import accumulate, pairwise
from pathlib import Path
from typing import NamedTuple

from kleinkram.recordings.sample.messages import Encoding, ros1_definition, ros1_md5, ros2_definition, ros2_name
from kleinkram.recordings.sample.vehicle import Faults, Vehicle
from kleinkram.recordings.sample.writers import BagWriter, Db3Writer, McapWriter

DEFAULT_DURATION_S = 10.0
_CAMERA_BYTES, _LIDAR_POINTS = 80_000, 30_000
_LEAST_CAMERA_BYTES, _LEAST_LIDAR_POINTS = 4_000, 64
_POINT_BYTES, _BULK_HZ = 16, 10
_SMALL_BYTES_PER_S = 125_000
_NO_FAULTS = Faults()


class SampleFormat(str, Enum):
    """Format of a recorded drive."""

    mcap = "mcap"
    bag = "bag"
    db3 = "db3"


@dataclass(frozen=True)
class TopicTruth:
    """One topic as it was written. Times are integer nanoseconds of the log clock."""

    name: str
    message_type: str
    count: int
    first_ns: int
    last_ns: int
    longest_gap_ns: int
    out_of_order_count: int


@dataclass(frozen=True)
class FileTruth:
    """One recording file, counted while it was made, by other code than that which reads recordings.

    Attributes:
        truncated: its end was cut off, so that it holds less than `topics` say.
        topics: by name; types in the spelling of the format.
    """

    path: Path
    size_bytes: int
    truncated: bool
    message_count: int
    start_ns: int
    end_ns: int
    topics: tuple[TopicTruth, ...]


@dataclass(frozen=True)
class MissionTruth:
    """A sample mission; `files` are its recording files, without metadata.yaml."""

    directory: Path
    files: tuple[FileTruth, ...]


class _Plan(NamedTuple):
    """Amount of bulk data, and the limit by time or size."""

    camera_bytes: int
    lidar_points: int
    duration_s: float | None
    size_bytes: int | None


@dataclass(frozen=True)
class _Recorder:
    """An open recording; `add_topic` returns the name of a type in the format, and the topic's number for `write`."""

    add_topic: Callable[[str, str], tuple[str, int]]
    write: Callable[[int, int, bytes], None]
    writer: McapWriter | BagWriter | Db3Writer


def generate_mission(
    directory: str | os.PathLike[str],
    *,
    size_bytes: int | None = None,
    duration_s: float | None = None,
    seed: int = 1,
    formats: Collection[SampleFormat] = tuple(SampleFormat),
    faults: Faults = _NO_FAULTS,
) -> MissionTruth:
    """Make `drive.mcap` (zstd), `drive.bag` (lz4) and `drive_rosbag2/` (db3) in a directory; return what is in them.

    With `size_bytes`, all data files together have about that size (to a few percent; below 1 MB a file, less); with
    `duration_s`, the drive lasts that long; with both, pictures and scans are scaled. The same arguments give the
    same bytes. 10 seconds without either.

    Raises:
        FileExistsError: one of them is there already.
        ValueError: a size or duration that is not positive, or no format.
    """
    folder = Path(directory)
    folder.mkdir(parents=True, exist_ok=True)
    if not formats:
        raise ValueError("a sample mission needs at least one format")
    share = None if size_bytes is None else size_bytes // len(formats)
    paths = {
        SampleFormat.mcap: folder / "drive.mcap",
        SampleFormat.bag: folder / "drive.bag",
        SampleFormat.db3: folder / "drive_rosbag2",
    }
    makers = {SampleFormat.mcap: generate_mcap, SampleFormat.bag: generate_bag, SampleFormat.db3: generate_db3}
    files = tuple(
        makers[kind](paths[kind], size_bytes=share, duration_s=duration_s, seed=seed, faults=faults)
        for kind in SampleFormat
        if kind in formats
    )
    return MissionTruth(folder, files)


def generate_mcap(
    path: str | os.PathLike[str],
    *,
    size_bytes: int | None = None,
    duration_s: float | None = None,
    seed: int = 1,
    faults: Faults = _NO_FAULTS,
) -> FileTruth:
    """Make one MCAP (profile ros2, CDR, zstd) as `generate_mission` does."""
    plan = _plan(size_bytes, duration_s)
    schemas: dict[str, int] = {}
    with Path(path).open("xb") as file:
        writer = McapWriter(file, profile="ros2")

        def add_topic(topic: str, message_type: str) -> tuple[str, int]:
            name = ros2_name(message_type)
            if name not in schemas:
                schemas[name] = writer.add_schema(name, "ros2msg", ros2_definition(message_type).encode())
            return name, writer.add_channel(topic, schemas[name], "cdr")

        def write(channel: int, log_time_ns: int, payload: bytes) -> None:
            writer.add_message(channel, log_time_ns, payload, publish_time_ns=log_time_ns)

        topics = _record(plan, seed, Encoding.cdr, faults, _Recorder(add_topic, write, writer))
    return _truth(Path(path), topics, faults)


def generate_bag(
    path: str | os.PathLike[str],
    *,
    size_bytes: int | None = None,
    duration_s: float | None = None,
    seed: int = 1,
    faults: Faults = _NO_FAULTS,
) -> FileTruth:
    """Make one ROS 1 bag (lz4) as `generate_mission` does."""
    plan = _plan(size_bytes, duration_s)
    with Path(path).open("xb") as file:
        writer = BagWriter(file)

        def add_topic(topic: str, message_type: str) -> tuple[str, int]:
            md5sum, definition = ros1_md5(message_type), ros1_definition(message_type)
            return message_type, writer.add_connection(topic, message_type, md5sum=md5sum, definition=definition)

        topics = _record(plan, seed, Encoding.ros1, faults, _Recorder(add_topic, writer.add_message, writer))
    return _truth(Path(path), topics, faults)


def generate_db3(
    folder: str | os.PathLike[str],
    *,
    size_bytes: int | None = None,
    duration_s: float | None = None,
    seed: int = 1,
    faults: Faults = _NO_FAULTS,
) -> FileTruth:
    """Make one rosbag2 folder (SQLite storage) as `generate_mission` does; the truth is that of its database."""
    plan = _plan(size_bytes, duration_s)
    writer = Db3Writer(Path(folder))

    def add_topic(topic: str, message_type: str) -> tuple[str, int]:
        return ros2_name(message_type), writer.add_topic(topic, ros2_name(message_type))

    topics = _record(plan, seed, Encoding.cdr, faults, _Recorder(add_topic, writer.add_message, writer))
    return _truth(writer.path, topics, faults)


def _plan(size_bytes: int | None, duration_s: float | None) -> _Plan:
    """Choose the bulk: full size where the size allows for 10 seconds or more, else less of it."""
    if (size_bytes is not None and size_bytes <= 0) or (duration_s is not None and duration_s <= 0):
        raise ValueError("size and duration of a sample must be positive")
    seconds = duration_s or DEFAULT_DURATION_S
    if size_bytes is None:
        return _Plan(_CAMERA_BYTES, _LIDAR_POINTS, seconds, None)
    full = _CAMERA_BYTES + _LIDAR_POINTS * _POINT_BYTES
    bulk = (size_bytes / seconds - _SMALL_BYTES_PER_S) / _BULK_HZ
    scale = max(0.0, bulk / full) if duration_s else min(1.0, max(0.0, bulk / full))
    return _Plan(
        camera_bytes=max(_LEAST_CAMERA_BYTES, round(_CAMERA_BYTES * scale)),
        lidar_points=max(_LEAST_LIDAR_POINTS, round(_LIDAR_POINTS * scale)),
        duration_s=duration_s,
        size_bytes=None if duration_s else size_bytes,
    )


def _record(plan: _Plan, seed: int, encoding: Encoding, faults: Faults, recorder: _Recorder) -> tuple[TopicTruth, ...]:
    vehicle = Vehicle(
        seed=seed, encoding=encoding, camera_bytes=plan.camera_bytes, lidar_points=plan.lidar_points, faults=faults
    )
    types: dict[str, tuple[str, int]] = {}
    stamps: dict[str, list[int]] = {stream.topic: [] for stream in vehicle.streams}
    for stream in vehicle.streams:
        types[stream.topic] = recorder.add_topic(stream.topic, stream.message_type)
    for message in vehicle.drive(plan.duration_s):
        recorder.write(types[message.topic][1], message.log_time_ns, message.payload)
        stamps[message.topic].append(message.log_time_ns)
        if plan.size_bytes is not None and recorder.writer.bytes_written >= plan.size_bytes:
            break
    recorder.writer.finish()
    topics = []
    for name in sorted(stamps):
        in_file, in_time = stamps[name], sorted(stamps[name])
        gap = max((after - before for before, after in pairwise(in_time)), default=0)
        out_of_order = sum(stamp < highest for stamp, highest in zip(in_file, accumulate(in_file, max), strict=True))
        topics.append(TopicTruth(name, types[name][0], len(in_file), in_time[0], in_time[-1], gap, out_of_order))
    return tuple(topics)


def _truth(path: Path, topics: tuple[TopicTruth, ...], faults: Faults) -> FileTruth:
    """Cut the finished file if `faults` ask for it; return what is in it."""
    if faults.truncate_to is not None:
        os.truncate(path, int(path.stat().st_size * faults.truncate_to))
    return FileTruth(
        path=path,
        size_bytes=path.stat().st_size,
        truncated=faults.truncate_to is not None,
        message_count=sum(topic.count for topic in topics),
        start_ns=min(topic.first_ns for topic in topics),
        end_ns=max(topic.last_ns for topic in topics),
        topics=topics,
    )
