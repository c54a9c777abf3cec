"""Missions for the benchmarks of checks: 1 GB with messages of real sizes, and the indexes of 50 GB."""

from __future__ import annotations

import io
import random
import struct
from array import array
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from PIL import Image
from tests.recording_files.ros_messages import SECOND, T0, TimedMessage, data_of

from kleinkram.recordings.formats.mcap import records
from kleinkram.recordings.formats.mcap.records import Opcode
from kleinkram.recordings.sample import messages as definitions
from kleinkram.recordings.sample.messages import Encoding
from kleinkram.recordings.writing.mcap_writer import McapWriter

RULES = """
version: 1
profiles:
- name: payload
  recordings: {"*": {covers: 95%, max_start_skew: 1s, max_end_skew: 1s}}
  topics:
    /camera/*: {rate: 10, max_gap: 500ms}
    /lidar/*: {rate: 10, max_gap: 500ms}
    /imu/*: {rate: 200, max_gap: 100ms}
  clocks: {"/*": {no_jump: true, max_stamp_offset: 100ms, max_stamp_drift: 200, max_stamp_jump: 100ms}}
  images: {"/camera/*": {min_sharpness: 20}}
  imu: {"/imu/*": {up: z, max_acceleration: 80}}
  point_clouds: {"/lidar/*": {min_points: 1000, max_range: 200}}
  transforms: {"/tf*": {}}
  odometry: {/odom: {}}
  batteries: {/battery: {min_percentage: 20%}}
  values: {/odom: {}, "/imu/*": {}}
"""
_COMPUTERS = 4
_WIDTH, _HEIGHT, _POINTS, _PICTURES = 1280, 720, 30_000, 48


def payload_mission(folder: Path, size_bytes: int) -> None:
    """Write one MCAP for each of four computers: twelve cameras, two lidars, five IMUs."""
    folder.mkdir(parents=True)
    pictures, clouds = _pictures(), _clouds()
    with ExitStack() as stack:
        files = [stack.enter_context((folder / f"computer{n}.mcap").open("wb")) for n in range(_COMPUTERS)]
        writers = [_MessageWriter(file) for file in files]
        tick = 0
        while sum(writer.bytes_written for writer in writers) < size_bytes:
            for computer, writer in enumerate(writers):
                for message in _payload(computer, tick, pictures, clouds):
                    writer.add(message)
            tick += 1
        for writer in writers:
            writer.finish()


class _MessageWriter:
    """Writes ROS 2 messages to an MCAP."""

    def __init__(self, file: BinaryIO) -> None:
        self._writer = McapWriter(file, profile="ros2")
        self._channels: dict[str, int] = {}

    @property
    def bytes_written(self) -> int:
        return self._writer.bytes_written

    def add(self, message: TimedMessage) -> None:
        if message.topic not in self._channels:
            text = definitions.ros2_definition(message.message_type).encode()
            schema = self._writer.add_schema(definitions.ros2_name(message.message_type), "ros2msg", text)
            self._channels[message.topic] = self._writer.add_channel(message.topic, schema, "cdr")
        self._writer.add_message(self._channels[message.topic], message.log_ns, data_of(message, Encoding.cdr))

    def finish(self) -> None:
        self._writer.finish()


_FIELDS = [{"name": axis, "offset": 4 * place, "datatype": 7, "count": 1} for place, axis in enumerate("xyz")]


def _payload(computer: int, tick: int, pictures: list[bytes], clouds: list[bytes]) -> Iterator[TimedMessage]:
    """Yield what one computer records in 5 ms."""
    chance = random.Random(tick * _COMPUTERS + computer)
    now = T0 + tick * SECOND // 200
    log_ns = now + chance.randrange(1_000_000, 4_000_000)
    for imu in ("a", "b") if computer == 0 else ("a",):
        x, y, z, u, v, w = (chance.gauss(0, 0.03) for _ in range(6))
        values: dict[str, Any] = {
            "linear_acceleration": {"x": x, "y": y, "z": 9.81 + z},
            "angular_velocity": {"x": u, "y": v, "z": w},
        }
        yield TimedMessage(f"/imu/{computer}{imu}", "sensor_msgs/Imu", log_ns, values, now)
    if computer == 3 and tick % 2 == 0:
        pose = {"pose": {"position": {"x": tick / 200}, "orientation": {"w": 1}}}
        yield TimedMessage("/odom", "nav_msgs/Odometry", log_ns, {"pose": pose}, now)
        transform = {"header": {"frame_id": "odom"}, "child_frame_id": "base"}
        yield TimedMessage("/tf", "tf2_msgs/TFMessage", log_ns, {"transforms": [transform]})
    if computer == 3 and tick % 200 == 0:
        yield TimedMessage("/battery", "sensor_msgs/BatteryState", log_ns, {"percentage": 0.8}, now)
    if tick % 20 == 0:
        for camera in range(3):
            data = pictures[(tick // 20 * 5 + camera + computer) % len(pictures)]
            picture = {"format": "jpeg", "data": data}
            yield TimedMessage(f"/camera/{computer}{camera}", "sensor_msgs/CompressedImage", log_ns, picture, now)
    if tick % 20 == 10 and computer < 2:
        sizes = {"height": 1, "width": _POINTS, "point_step": 12, "row_step": 12 * _POINTS}
        cloud = {**sizes, "fields": _FIELDS, "data": clouds[tick // 20 % len(clouds)]}
        yield TimedMessage(f"/lidar/{computer}", "sensor_msgs/PointCloud2", log_ns, cloud, now)


def _pictures() -> list[bytes]:
    generator = np.random.default_rng(1)
    rows = np.linspace(60, 200, _HEIGHT)[:, None, None]
    pictures = []
    for number in range(_PICTURES):
        scene = np.broadcast_to(rows, (_HEIGHT, _WIDTH, 3)) + generator.normal(0, 8, (_HEIGHT, _WIDTH, 1))
        scene[200:500, 20 * number : 20 * number + 200] = (200, 60, 30)
        out = io.BytesIO()
        Image.fromarray(np.clip(scene, 0, 255).astype(np.uint8)).save(out, "jpeg", quality=80)
        pictures.append(out.getvalue())
    return pictures


def _clouds() -> list[bytes]:
    generator = np.random.default_rng(2)
    return [generator.uniform(-40, 40, (_POINTS, 3)).astype(np.float32).tobytes() for _ in range(24)]


_CHUNK_BYTES, _CHUNK_NS = 2**20, 80_000_000
_RATES_HZ = {"imu": 200, "camera": 10, "lidar": 10, "tf": 100}
_TYPES = {
    "imu": "sensor_msgs/Imu",
    "camera": "sensor_msgs/CompressedImage",
    "lidar": "sensor_msgs/PointCloud2",
    "tf": "tf2_msgs/TFMessage",
}


def index_only_mission(folder: Path, size_bytes: int) -> None:
    """Write four MCAPs with true indexes, whose chunks are holes of sparse files."""
    folder.mkdir(parents=True)
    for number in range(_COMPUTERS):
        with (folder / f"computer{number}.mcap").open("wb") as file:
            _write_index(file, number, size_bytes // _COMPUTERS)


def _write_index(file: BinaryIO, computer: int, size_bytes: int) -> None:
    sensors = [("imu", 2), ("camera", 3), ("lidar", 1), ("tf", 1)]
    topics = [(f"/{kind}/{computer}{number}", kind) for kind, count in sensors for number in range(count)]
    definitions_text = b""
    for number, (topic, kind) in enumerate(topics):
        name = definitions.ros2_name(_TYPES[kind])
        text = definitions.ros2_definition(_TYPES[kind]).encode()
        schema = struct.pack("<H", number + 1) + _text(name) + _text("ros2msg") + struct.pack("<I", len(text)) + text
        definitions_text += _record(Opcode.SCHEMA, schema)
        channel = struct.pack("<HH", number, number + 1) + _text(topic) + _text("cdr") + bytes(4)
        definitions_text += _record(Opcode.CHANNEL, channel)
    file.write(records.MAGIC + _record(Opcode.HEADER, _text("ros2") + _text("benchmark")))
    chunk_indexes: list[bytes] = []
    counts = [0] * len(topics)
    start_ns = last_ns = T0
    while file.tell() < size_bytes:
        first_ns, end_ns = start_ns, start_ns + _CHUNK_NS
        start = file.tell()
        stored = _CHUNK_BYTES - 49
        head = struct.pack("<QQQI", first_ns, end_ns - 1, 2 * _CHUNK_BYTES, 0) + _text("zstd")
        file.write(records.RECORD_HEAD.pack(Opcode.CHUNK, len(head) + 8 + stored) + head + struct.pack("<Q", stored))
        file.seek(stored, 1)
        index_start, offsets, times = file.tell(), b"", []
        for number, (_, kind) in enumerate(topics):
            period_ns = SECOND // _RATES_HZ[kind]
            stamps = range(T0 + -(-(first_ns - T0) // period_ns) * period_ns, end_ns, period_ns)
            if stamps:
                offsets += struct.pack("<HQ", number, file.tell())
                entries = array("Q", (item for place, ns in enumerate(stamps) for item in (ns, place * 100))).tobytes()
                file.write(
                    _record(Opcode.MESSAGE_INDEX, struct.pack("<H", number) + struct.pack("<I", len(entries)) + entries)
                )
                counts[number] += len(stamps)
                times += [stamps[0], stamps[-1]]
        last_ns = max(times)
        place = struct.pack("<QQQQ", min(times), last_ns, start, index_start - start)
        place += struct.pack("<I", len(offsets)) + offsets + struct.pack("<Q", file.tell() - index_start)
        chunk_indexes.append(
            _record(Opcode.CHUNK_INDEX, place + _text("zstd") + struct.pack("<QQ", stored, 2 * _CHUNK_BYTES))
        )
        start_ns = end_ns
    file.write(_record(Opcode.DATA_END, bytes(4)))
    summary_start = file.tell()
    by_channel = b"".join(struct.pack("<HQ", number, count) for number, count in enumerate(counts))
    totals = (sum(counts), len(topics), len(topics), 0, 0, len(chunk_indexes), T0, last_ns)
    statistics = records.STATISTICS_BODY.pack(*totals) + struct.pack("<I", len(by_channel)) + by_channel
    file.write(definitions_text + _record(Opcode.STATISTICS, statistics) + b"".join(chunk_indexes))
    file.write(_record(Opcode.FOOTER, struct.pack("<QQI", summary_start, 0, 0)) + records.MAGIC)


def _record(opcode: int, body: bytes) -> bytes:
    return records.RECORD_HEAD.pack(opcode, len(body)) + body


def _text(text: str) -> bytes:
    return struct.pack("<I", len(text)) + text.encode()
