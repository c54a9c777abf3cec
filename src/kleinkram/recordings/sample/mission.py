"""Making sample missions: one drive, recorded as MCAP, ROS 1 bag and rosbag2 db3, of any size, with known truth.

Streaming: memory is that of one chunk and of the truth (a few bytes a message), whatever the size.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Collection
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import NamedTuple

from kleinkram.recordings.formats.mcap.writer import McapWriter
from kleinkram.recordings.formats.rosbag1.writer import BagWriter
from kleinkram.recordings.formats.rosbag2.writer import Db3Writer
from kleinkram.recordings.sample import definitions
from kleinkram.recordings.sample.layout import Encoding
from kleinkram.recordings.sample.truth import FileTruth, MissionTruth, TruthKeeper
from kleinkram.recordings.sample.vehicle import Faults, Vehicle

DEFAULT_DURATION_S = 10.0
_CAMERA_BYTES, _LIDAR_POINTS = 80_000, 30_000
_LEAST_CAMERA_BYTES, _LEAST_LIDAR_POINTS = 4_000, 64
_POINT_BYTES, _BULK_HZ = 16, 10
_SMALL_BYTES_PER_S = 125_000
_NO_FAULTS = Faults()


class SampleFormat(str, Enum):
    """What a drive is recorded as."""

    mcap = "mcap"
    bag = "bag"
    db3 = "db3"


@dataclass(frozen=True)
class _Plan:
    """How much bulk, and when to stop: after a time, or at a size."""

    camera_bytes: int
    lidar_points: int
    duration_s: float | None
    size_bytes: int | None


class _Topic(NamedTuple):
    """A topic of an open recording: what its type is called there, and the number to write to it by."""

    message_type: str
    number: int


@dataclass(frozen=True)
class _Recorder:
    """One open recording, whatever its format."""

    add_topic: Callable[[str, str], _Topic]
    write: Callable[[int, int, bytes], None]
    bytes_written: Callable[[], int]
    finish: Callable[[], None]


def generate_mission(
    directory: str | os.PathLike[str],
    *,
    size_bytes: int | None = None,
    duration_s: float | None = None,
    seed: int = 1,
    formats: Collection[SampleFormat] = tuple(SampleFormat),
    faults: Faults = _NO_FAULTS,
) -> MissionTruth:
    """Make `drive.mcap` (zstd), `drive.bag` (lz4) and `drive_rosbag2/` (db3) in a directory, and say what is in them.

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
    vehicle = _vehicle(plan, seed, Encoding.cdr, faults)
    with Path(path).open("xb") as file:
        truth = _record(vehicle, plan, _mcap_recorder(McapWriter(file, profile="ros2")))
    return _finish(Path(path), truth, faults)


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
    vehicle = _vehicle(plan, seed, Encoding.ros1, faults)
    with Path(path).open("xb") as file:
        truth = _record(vehicle, plan, _bag_recorder(BagWriter(file)))
    return _finish(Path(path), truth, faults)


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
    vehicle = _vehicle(plan, seed, Encoding.cdr, faults)
    writer = Db3Writer(Path(folder))
    truth = _record(vehicle, plan, _db3_recorder(writer))
    return _finish(writer.path, truth, faults)


def _mcap_recorder(writer: McapWriter) -> _Recorder:
    schemas: dict[str, int] = {}

    def add_topic(topic: str, message_type: str) -> _Topic:
        name = definitions.ros2_name(message_type)
        if name not in schemas:
            schemas[name] = writer.add_schema(name, "ros2msg", definitions.ros2_definition(message_type).encode())
        return _Topic(name, writer.add_channel(topic, schemas[name], "cdr"))

    def write(channel: int, log_time_ns: int, payload: bytes) -> None:
        writer.add_message(channel, log_time_ns, payload, publish_time_ns=log_time_ns)

    return _Recorder(add_topic, write, lambda: writer.bytes_written, writer.finish)


def _bag_recorder(writer: BagWriter) -> _Recorder:
    def add_topic(topic: str, message_type: str) -> _Topic:
        md5sum, definition = definitions.ros1_md5(message_type), definitions.ros1_definition(message_type)
        return _Topic(message_type, writer.add_connection(topic, message_type, md5sum=md5sum, definition=definition))

    return _Recorder(add_topic, writer.add_message, lambda: writer.bytes_written, writer.finish)


def _db3_recorder(writer: Db3Writer) -> _Recorder:
    def add_topic(topic: str, message_type: str) -> _Topic:
        name = definitions.ros2_name(message_type)
        return _Topic(name, writer.add_topic(topic, name))

    return _Recorder(add_topic, writer.add_message, lambda: writer.bytes_written, writer.finish)


def _plan(size_bytes: int | None, duration_s: float | None) -> _Plan:
    """Choose the bulk: full size where the size allows for 10 seconds or more, else less of it."""
    if (size_bytes is not None and size_bytes <= 0) or (duration_s is not None and duration_s <= 0):
        raise ValueError("size and duration of a sample must be positive")
    if size_bytes is None:
        return _Plan(_CAMERA_BYTES, _LIDAR_POINTS, duration_s or DEFAULT_DURATION_S, None)
    full = _CAMERA_BYTES + _LIDAR_POINTS * _POINT_BYTES
    seconds = duration_s or DEFAULT_DURATION_S
    bulk = (size_bytes / seconds - _SMALL_BYTES_PER_S) / _BULK_HZ
    scale = max(0.0, bulk / full) if duration_s else min(1.0, max(0.0, bulk / full))
    return _Plan(
        camera_bytes=max(_LEAST_CAMERA_BYTES, round(_CAMERA_BYTES * scale)),
        lidar_points=max(_LEAST_LIDAR_POINTS, round(_LIDAR_POINTS * scale)),
        duration_s=duration_s,
        size_bytes=None if duration_s else size_bytes,
    )


def _vehicle(plan: _Plan, seed: int, encoding: Encoding, faults: Faults) -> Vehicle:
    return Vehicle(
        seed=seed,
        encoding=encoding,
        camera_bytes=plan.camera_bytes,
        lidar_points=plan.lidar_points,
        faults=faults,
    )


def _record(vehicle: Vehicle, plan: _Plan, recorder: _Recorder) -> TruthKeeper:
    truth = TruthKeeper()
    numbers: dict[str, int] = {}
    for stream in vehicle.streams:
        message_type, numbers[stream.topic] = recorder.add_topic(stream.topic, stream.message_type)
        truth.add_topic(stream.topic, message_type)
    for sample in vehicle.drive(plan.duration_s):
        recorder.write(numbers[sample.topic], sample.log_time_ns, sample.payload)
        truth.add(sample.topic, sample.log_time_ns)
        if plan.size_bytes is not None and recorder.bytes_written() >= plan.size_bytes:
            break
    recorder.finish()
    return truth


def _finish(path: Path, truth: TruthKeeper, faults: Faults) -> FileTruth:
    if faults.truncate_to is not None:
        os.truncate(path, int(path.stat().st_size * faults.truncate_to))
    return truth.file(path, truncated=faults.truncate_to is not None)
