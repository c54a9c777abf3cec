"""Makes sample missions: one drive of a small vehicle, as MCAP, ROS 1 bag and rosbag2 db3, with known contents.

For `klein sample`, tests and benchmarks; never imported by the server. Memory is that of one chunk and 8 bytes a
message, whatever the size.
"""

from __future__ import annotations

import os
from collections.abc import Collection
from contextlib import ExitStack
from dataclasses import dataclass
from enum import Enum
from functools import partial
from itertools import accumulate, pairwise
from pathlib import Path

from kleinkram.recordings.sample import messages
from kleinkram.recordings.sample.vehicle import Faults, TopicGap, Vehicle
from kleinkram.recordings.sample.writers import BagWriter, Db3Writer, McapWriter

__all__ = [
    "Faults",
    "FileTruth",
    "MissionTruth",
    "SampleFormat",
    "TopicGap",
    "TopicTruth",
    "generate_bag",
    "generate_db3",
    "generate_mcap",
    "generate_mission",
]
DEFAULT_DURATION_S = 10.0
_CAMERA_BYTES, _LIDAR_POINTS = 80_000, 30_000
_MIN_CAMERA_BYTES, _MIN_LIDAR_POINTS = 4_000, 64
_POINT_BYTES, _SENSOR_HZ = 16, 10
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
    """The contents of one recording file, counted while it was written.

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


def generate_file(
    path: str | os.PathLike[str],
    *,
    kind: SampleFormat,
    size_bytes: int | None = None,
    duration_s: float | None = None,
    seed: int = 1,
    faults: Faults = _NO_FAULTS,
) -> FileTruth:
    """Make one recording as `generate_mission` does; `path`: of a file, for db3 of a folder."""
    vehicle = _vehicle(size_bytes, duration_s, seed, kind, faults)
    limit_s = duration_s if duration_s is not None or size_bytes is not None else DEFAULT_DURATION_S
    limit_bytes = size_bytes if duration_s is None else None
    path = Path(path)
    stamps: dict[str, list[int]] = {stream.topic: [] for stream in vehicle.streams}
    with ExitStack() as stack:
        writer: McapWriter | BagWriter | Db3Writer
        if kind is SampleFormat.db3:
            writer = Db3Writer(path)
            path = writer.path
        else:
            file = stack.enter_context(path.open("xb"))
            writer = McapWriter(file, profile="ros2") if kind is SampleFormat.mcap else BagWriter(file)
        numbers = {stream.topic: _add_topic(writer, stream.topic, stream.message_type) for stream in vehicle.streams}
        for message in vehicle.drive(limit_s):
            writer.add_message(numbers[message.topic], message.log_time_ns, message.payload)
            stamps[message.topic].append(message.log_time_ns)
            if limit_bytes is not None and writer.bytes_written >= limit_bytes:
                break
        writer.finish()
    if faults.truncate_to is not None:
        os.truncate(path, int(path.stat().st_size * faults.truncate_to))
    types = {stream.topic: stream.message_type for stream in vehicle.streams}
    if kind is not SampleFormat.bag:
        types = {topic: messages.ros2_name(message_type) for topic, message_type in types.items()}
    topics = tuple(_topic_truth(name, types[name], stamps[name]) for name in sorted(stamps))
    return FileTruth(
        path=path,
        size_bytes=path.stat().st_size,
        truncated=faults.truncate_to is not None,
        message_count=sum(topic.count for topic in topics),
        start_ns=min(topic.first_ns for topic in topics),
        end_ns=max(topic.last_ns for topic in topics),
        topics=topics,
    )


generate_mcap = partial(generate_file, kind=SampleFormat.mcap)  # profile ros2, CDR, zstd
generate_bag = partial(generate_file, kind=SampleFormat.bag)  # lz4
generate_db3 = partial(generate_file, kind=SampleFormat.db3)  # a rosbag2 folder; the contents are those of its database


def generate_mission(
    directory: str | os.PathLike[str],
    *,
    size_bytes: int | None = None,
    duration_s: float | None = None,
    seed: int = 1,
    formats: Collection[SampleFormat] = tuple(SampleFormat),
    faults: Faults = _NO_FAULTS,
) -> MissionTruth:
    """Make `drive.mcap` (zstd), `drive.bag` (lz4) and `drive_rosbag2/` (db3) in a directory; return their contents.

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
    names = {SampleFormat.mcap: "drive.mcap", SampleFormat.bag: "drive.bag", SampleFormat.db3: "drive_rosbag2"}
    files = tuple(
        generate_file(folder / name, kind=kind, size_bytes=share, duration_s=duration_s, seed=seed, faults=faults)
        for kind, name in names.items()
        if kind in formats
    )
    return MissionTruth(folder, files)


def _vehicle(
    size_bytes: int | None, duration_s: float | None, seed: int, kind: SampleFormat, faults: Faults
) -> Vehicle:
    """Return a vehicle with pictures and scans of full size where the size allows for 10 seconds, else smaller ones."""
    if (size_bytes is not None and size_bytes <= 0) or (duration_s is not None and duration_s <= 0):
        raise ValueError("size and duration of a sample must be positive")
    scale = 1.0
    if size_bytes is not None:
        full = _CAMERA_BYTES + _LIDAR_POINTS * _POINT_BYTES
        bytes_per_tick = (size_bytes / (duration_s or DEFAULT_DURATION_S) - _SMALL_BYTES_PER_S) / _SENSOR_HZ
        scale = max(0.0, bytes_per_tick / full) if duration_s else min(1.0, max(0.0, bytes_per_tick / full))
    return Vehicle(
        seed=seed,
        encoding=messages.Encoding.ros1 if kind is SampleFormat.bag else messages.Encoding.cdr,
        camera_bytes=max(_MIN_CAMERA_BYTES, round(_CAMERA_BYTES * scale)),
        lidar_points=max(_MIN_LIDAR_POINTS, round(_LIDAR_POINTS * scale)),
        faults=faults,
    )


def _add_topic(writer: McapWriter | BagWriter | Db3Writer, topic: str, message_type: str) -> int:
    """Define a topic; return its number in the file."""
    if isinstance(writer, BagWriter):
        md5sum, definition = messages.ros1_md5(message_type), messages.ros1_definition(message_type)
        return writer.add_connection(topic, message_type, md5sum=md5sum, definition=definition)
    name = messages.ros2_name(message_type)
    if isinstance(writer, Db3Writer):
        return writer.add_topic(topic, name)
    schema_id = writer.add_schema(name, "ros2msg", messages.ros2_definition(message_type).encode())
    return writer.add_channel(topic, schema_id, "cdr")


def _topic_truth(name: str, message_type: str, in_file: list[int]) -> TopicTruth:
    in_time = sorted(in_file)
    gap = max((after - before for before, after in pairwise(in_time)), default=0)
    out_of_order = sum(stamp < highest for stamp, highest in zip(in_file, accumulate(in_file, max), strict=True))
    return TopicTruth(name, message_type, len(in_file), in_time[0], in_time[-1], gap, out_of_order)
