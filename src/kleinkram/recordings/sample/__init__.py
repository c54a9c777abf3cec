"""Makes sample missions with known contents and known defects, as MCAP, ROS 1 bag and rosbag2 db3.

One drive of a small vehicle, or of a legged robot with several computers. No numpy.
For `klein sample`, tests and benchmarks; never imported by the server. Memory is that of one chunk and 8 bytes a
message, whatever the size.
"""

from __future__ import annotations

import os
from collections.abc import Collection
from contextlib import ExitStack
from dataclasses import dataclass, replace
from enum import Enum
from functools import partial
from itertools import accumulate, pairwise
from pathlib import Path

from kleinkram.recordings.sample import messages
from kleinkram.recordings.sample.defects import Defect, Faults, TopicGap
from kleinkram.recordings.sample.drive import Drive
from kleinkram.recordings.sample.robots import COMPUTER, Robot, legged, vehicle
from kleinkram.recordings.sample.writers import Db3Writer
from kleinkram.recordings.writing.bag_writer import BagWriter
from kleinkram.recordings.writing.mcap_writer import McapWriter

__all__ = [
    "Defect",
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
    "generate_rig",
]
DEFAULT_DURATION_S = 10.0
_CAMERA_BYTES, _LIDAR_POINTS = 80_000, 30_000
_MIN_CAMERA_BYTES, _MIN_LIDAR_POINTS = 4_000, 64
_POINT_BYTES, _SENSOR_HZ = 16, 10
_SMALL_BYTES_PER_S = 125_000
_TRUNCATED_SHARE = 0.6
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
    robot, expected_s = _sized_vehicle(size_bytes, duration_s)
    drive = Drive(robot, seed=seed, encoding=_encoding(kind), faults=faults, expected_s=expected_s)
    limit_s = duration_s if duration_s is not None or size_bytes is not None else DEFAULT_DURATION_S
    limit_bytes = size_bytes if duration_s is None else None
    truth = _record(Path(path), kind, drive, COMPUTER, limit_s, limit_bytes)
    share = faults.truncate_to or (_TRUNCATED_SHARE if Defect.truncated in faults.defects else None)
    return truth if share is None else _truncate(truth, share)


def _record(
    path: Path, kind: SampleFormat, drive: Drive, computer: str, limit_s: float | None, limit_bytes: int | None
) -> FileTruth:
    """Make the recording of one computer."""
    sensors = drive.sensors(computer)
    stamps: dict[str, list[int]] = {sensor.topic: [] for sensor in sensors}
    with ExitStack() as stack:
        writer: McapWriter | BagWriter | Db3Writer
        if kind is SampleFormat.db3:
            writer = Db3Writer(path)
            path = writer.path
        else:
            file = stack.enter_context(path.open("xb"))
            writer = McapWriter(file, profile="ros2") if kind is SampleFormat.mcap else BagWriter(file)
        numbers = {sensor.topic: _add_topic(writer, sensor.topic, sensor.message_type) for sensor in sensors}
        for message in drive.messages(computer, limit_s):
            writer.add_message(numbers[message.topic], message.log_time_ns, message.payload)
            stamps[message.topic].append(message.log_time_ns)
            if limit_bytes is not None and writer.bytes_written >= limit_bytes:
                break
        writer.finish()
    types = {sensor.topic: sensor.message_type for sensor in sensors}
    if kind is not SampleFormat.bag:
        types = {topic: messages.ros2_name(message_type) for topic, message_type in types.items()}
    topics = tuple(_topic_truth(name, types[name], stamps[name]) for name in sorted(stamps) if stamps[name])
    return FileTruth(
        path=path,
        size_bytes=path.stat().st_size,
        truncated=False,
        message_count=sum(topic.count for topic in topics),
        start_ns=min((topic.first_ns for topic in topics), default=0),
        end_ns=max((topic.last_ns for topic in topics), default=0),
        topics=topics,
    )


def _truncate(truth: FileTruth, share: float) -> FileTruth:
    os.truncate(truth.path, int(truth.size_bytes * share))
    return replace(truth, size_bytes=truth.path.stat().st_size, truncated=True)


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
        ValueError: a size or duration that is not positive, no format, or a defect that the vehicle cannot have.
    """
    folder = Path(directory)
    if not formats:
        raise ValueError("a sample mission needs at least one format")
    share = None if size_bytes is None else size_bytes // len(formats)
    robot, _expected_s = _sized_vehicle(share, duration_s)
    robot.check_defects(faults.defects)
    folder.mkdir(parents=True, exist_ok=True)
    names = {SampleFormat.mcap: "drive.mcap", SampleFormat.bag: "drive.bag", SampleFormat.db3: "drive_rosbag2"}
    files = tuple(
        generate_file(folder / name, kind=kind, size_bytes=share, duration_s=duration_s, seed=seed, faults=faults)
        for kind, name in names.items()
        if kind in formats
    )
    return MissionTruth(folder, files)


def generate_rig(
    directory: str | os.PathLike[str],
    *,
    duration_s: float = DEFAULT_DURATION_S,
    seed: int = 1,
    kind: SampleFormat = SampleFormat.mcap,
    faults: Faults = _NO_FAULTS,
) -> MissionTruth:
    """Make a mission of a legged robot whose four computers record one file each, such as `nuc/nuc.mcap`.

    The same arguments give the same bytes, about 5 MB for each second.

    Raises:
        FileExistsError: one of them is there already.
        ValueError: a duration that is not positive.
    """
    if duration_s <= 0:
        raise ValueError("the duration of a sample must be positive")
    folder = Path(directory)
    robot = legged()
    drive = Drive(robot, seed=seed, encoding=_encoding(kind), faults=faults, expected_s=duration_s)
    files = []
    for computer in robot.computers:
        if robot.has_defect(faults.defects, Defect.missing_computer, computer):
            continue
        (folder / computer).mkdir(parents=True, exist_ok=True)
        name = f"{computer}_rosbag2" if kind is SampleFormat.db3 else f"{computer}.{kind.value}"
        truth = _record(folder / computer / name, kind, drive, computer, duration_s, None)
        if faults.truncate_to is not None:
            truth = _truncate(truth, faults.truncate_to)
        elif robot.has_defect(faults.defects, Defect.truncated, computer):
            truth = _truncate(truth, _TRUNCATED_SHARE)
        files.append(truth)
    for name, text in robot.texts.items():
        if not robot.has_defect(faults.defects, Defect.missing_file, name):
            with (folder / name).open("x", encoding="utf-8") as file:
                file.write(text)
    return MissionTruth(folder, tuple(files))


def _encoding(kind: SampleFormat) -> messages.Encoding:
    return messages.Encoding.ros1 if kind is SampleFormat.bag else messages.Encoding.cdr


def _sized_vehicle(size_bytes: int | None, duration_s: float | None) -> tuple[Robot, float]:
    """Return a vehicle, and about how long it drives.

    Its pictures and scans have their full size where the size allows for 10 seconds; else they are smaller.
    """
    if (size_bytes is not None and size_bytes <= 0) or (duration_s is not None and duration_s <= 0):
        raise ValueError("size and duration of a sample must be positive")
    scale, expected_s = 1.0, duration_s or DEFAULT_DURATION_S
    if size_bytes is not None:
        full = _CAMERA_BYTES + _LIDAR_POINTS * _POINT_BYTES
        bytes_per_tick = (size_bytes / expected_s - _SMALL_BYTES_PER_S) / _SENSOR_HZ
        scale = max(0.0, bytes_per_tick / full)
        if duration_s is None and scale > 1:
            scale, expected_s = 1.0, size_bytes / (full * _SENSOR_HZ + _SMALL_BYTES_PER_S)
    robot = vehicle(
        camera_bytes=max(_MIN_CAMERA_BYTES, round(_CAMERA_BYTES * scale)),
        lidar_points=max(_MIN_LIDAR_POINTS, round(_LIDAR_POINTS * scale)),
    )
    return robot, expected_s


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
