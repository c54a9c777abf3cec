"""The intact recordings to mutate: small, generated, one of each format and compression."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import zstandard

from kleinkram.recordings.sample.writers import Db3Writer
from tests.conftest import RECORDINGS
from tests.recording_files.writers import BagCompression, BagWriter, Compression, McapWriter

_T0 = 1_700_000_000_000_000_000
_STEP = 100_000_000
_LARGEST_REAL = 128 * 1024
_IMU_LIKE = "std_msgs/Header header\nfloat64[3] a\nfloat32[] b\nstring[] names\nInner[<=4] inner\n"
_HEADER = "builtin_interfaces/Time stamp\nstring frame_id\n"
_TIME = "int32 sec\nuint32 nanosec\n"
_SEPARATOR = "=" * 80 + "\n"
_ROS2 = (
    f"{_IMU_LIKE}{_SEPARATOR}MSG: std_msgs/Header\n{_HEADER}{_SEPARATOR}MSG: builtin_interfaces/Time\n{_TIME}"
    f"{_SEPARATOR}MSG: pkg/Inner\nint8 x\nwstring y\n"
)
_ROS1 = "Header header\nfloat64[3] a\nfloat32[] b\nstring[] names\ntime t\n"


@dataclass(frozen=True)
class Seed:
    """A whole file, by the name that it claims."""

    name: str
    data: bytes


def generated() -> list[Seed]:
    """Return the generated seeds; the same bytes each time."""
    seeds = [Seed(f"{kind.value}.mcap", _mcap(kind)) for kind in Compression]
    seeds += [Seed(f"{kind.value}.bag", _bag(kind)) for kind in BagCompression]
    seeds.append(Seed("database.db3", _db3()))
    seeds.append(Seed("whole.mcap.zstd", zstandard.compress(_mcap(Compression.none))))
    seeds.append(
        Seed("path.tum", b"".join(b"%d.5 1 2 3 0 0 0 1\n" % stamp for stamp in range(1_700_000_000, 1_700_000_040)))
    )
    return seeds


def real() -> list[Seed]:
    """Return the small ones of the real recordings, where there are any."""
    files = [path for path in sorted(RECORDINGS.rglob("*")) if path.is_file()]
    return [Seed(path.name, path.read_bytes()) for path in files if 0 < path.stat().st_size <= _LARGEST_REAL]


def _mcap(compression: Compression) -> bytes:
    out = BytesIO()
    writer = McapWriter(out, compression=compression, chunk_bytes=1_500)
    ros2 = writer.add_channel("/imu", writer.add_schema("pkg/msg/ImuLike", "ros2msg", _ROS2.encode()), "cdr")
    plain = writer.add_channel("/json", writer.add_schema("Any", "jsonschema", b'{"type": "object"}'), "json")
    for number in range(30):
        stamp = _T0 + number * _STEP
        writer.add_message(ros2, stamp, _cdr_message(number), publish_time_ns=stamp)
        writer.add_message(plain, stamp + 1, b'{"x": [1, 2.5, null], "y": "z"}', publish_time_ns=stamp)
    writer.finish()
    return out.getvalue()


def _cdr_message(number: int) -> bytes:
    head = b"\x00\x01\x00\x00" + number.to_bytes(4, "little") + bytes(4)
    text = (4).to_bytes(4, "little") + b"map\x00"
    numbers = bytes(4) + bytes(24) + (2).to_bytes(4, "little") + bytes(8)
    names = (1).to_bytes(4, "little") + (2).to_bytes(4, "little") + b"a\x00" + bytes(2)
    return head + text + numbers + names + (1).to_bytes(4, "little") + b"\x07" + bytes(3) + bytes(4)


def _bag(compression: BagCompression) -> bytes:
    out = BytesIO()
    writer = BagWriter(out, compression=compression, chunk_bytes=1_500)
    connection = writer.add_connection("/imu", "pkg/ImuLike", md5sum="*", definition=_ROS1)
    for number in range(30):
        body = bytes(12) + (3).to_bytes(4, "little") + b"map" + bytes(24)
        body += (1).to_bytes(4, "little") + bytes(4) + (1).to_bytes(4, "little") + (1).to_bytes(4, "little") + b"n"
        writer.add_message(connection, _T0 + number * _STEP, body + bytes(8))
    writer.finish()
    return out.getvalue()


def _db3() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        writer = Db3Writer(Path(folder) / "rec")
        topic = writer.add_topic("/imu", "pkg/msg/ImuLike")
        for number in range(40):
            writer.add_message(topic, _T0 + number * _STEP, _cdr_message(number) * (number % 5 + 1))
        writer.finish()
        return writer.path.read_bytes()
