"""The messages of a sample mission: definitions in ROS 1 and ROS 2, and layouts compiled to one `struct` each.

Strings and array lengths are fixed when a layout is made, so that a message is one `pack`.

Source: common_msgs, geometry2 and their ROS 2 descendants; the md5 rule is that of genmsg; ROS 1 serialisation
(wiki.ros.org/msg); OMG CDR, little endian, as in DDS-XTYPES 1.2 section 7.4.1 (XCDR1).
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Sequence
from enum import Enum
from functools import cache

_VECTOR = "float64 x\nfloat64 y\nfloat64 z\n"
_FIELDS = {
    "std_msgs/Header": "uint32 seq\ntime stamp\nstring frame_id\n",
    "geometry_msgs/Vector3": _VECTOR,
    "geometry_msgs/Point": _VECTOR,
    "geometry_msgs/Quaternion": _VECTOR + "float64 w\n",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n",
    "geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose\nfloat64[36] covariance\n",
    "geometry_msgs/Twist": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n",
    "geometry_msgs/TwistWithCovariance": "geometry_msgs/Twist twist\nfloat64[36] covariance\n",
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n",
    "geometry_msgs/TransformStamped": (
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n"
    ),
    "tf2_msgs/TFMessage": "geometry_msgs/TransformStamped[] transforms\n",
    "nav_msgs/Odometry": (
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/PoseWithCovariance pose\n"
        "geometry_msgs/TwistWithCovariance twist\n"
    ),
    "sensor_msgs/Imu": (
        "std_msgs/Header header\ngeometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n"
        "geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n"
        "geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance\n"
    ),
    "sensor_msgs/CompressedImage": "std_msgs/Header header\nstring format\nuint8[] data\n",
    "sensor_msgs/PointField": (
        "uint8 INT8=1\nuint8 UINT8=2\nuint8 INT16=3\nuint8 UINT16=4\n"
        "uint8 INT32=5\nuint8 UINT32=6\nuint8 FLOAT32=7\nuint8 FLOAT64=8\n"
        "string name\nuint32 offset\nuint8 datatype\nuint32 count\n"
    ),
    "sensor_msgs/PointCloud2": (
        "std_msgs/Header header\nuint32 height\nuint32 width\nsensor_msgs/PointField[] fields\n"
        "bool is_bigendian\nuint32 point_step\nuint32 row_step\nuint8[] data\nbool is_dense\n"
    ),
    "sensor_msgs/NavSatStatus": (
        "int8 STATUS_NO_FIX=-1\nint8 STATUS_FIX=0\nint8 STATUS_SBAS_FIX=1\nint8 STATUS_GBAS_FIX=2\nint8 status\n"
        "uint16 SERVICE_GPS=1\nuint16 SERVICE_GLONASS=2\nuint16 SERVICE_COMPASS=4\nuint16 SERVICE_GALILEO=8\n"
        "uint16 service\n"
    ),
    "sensor_msgs/NavSatFix": (
        "std_msgs/Header header\nsensor_msgs/NavSatStatus status\nfloat64 latitude\nfloat64 longitude\n"
        "float64 altitude\nfloat64[9] position_covariance\nuint8 COVARIANCE_TYPE_UNKNOWN=0\n"
        "uint8 COVARIANCE_TYPE_APPROXIMATED=1\nuint8 COVARIANCE_TYPE_DIAGONAL_KNOWN=2\n"
        "uint8 COVARIANCE_TYPE_KNOWN=3\nuint8 position_covariance_type\n"
    ),
}
_ROS2_FIELDS = {
    **_FIELDS,
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec\n",
}
_RULE = "=" * 80


def ros1_definition(message_type: str) -> str:
    """Return the definition of a type with all that it needs, as a bag keeps it."""
    return _with_dependencies(message_type, _FIELDS)


def ros2_definition(message_type: str) -> str:
    """Return the definition of a type with all that it needs, as an MCAP with schema encoding "ros2msg" keeps it."""
    return _with_dependencies(message_type, _ROS2_FIELDS)


def ros2_name(message_type: str) -> str:
    """Return the ROS 2 name of a type: "sensor_msgs/Imu" -> "sensor_msgs/msg/Imu"."""
    return message_type.replace("/", "/msg/")


@cache
def ros1_md5(message_type: str) -> str:
    """Return the md5 sum by which ROS 1 identifies a type: constants first, nested types by their own sums."""
    lines = _FIELDS[message_type].splitlines()
    constants = [line for line in lines if "=" in line]
    fields: list[str] = []
    for line in lines:
        if "=" not in line:
            kind, name = line.split()
            nested = kind.removesuffix("[]")
            fields.append(f"{ros1_md5(nested)} {name}" if nested in _FIELDS else line)
    return hashlib.md5("\n".join([*constants, *fields]).encode(), usedforsecurity=False).hexdigest()


def _with_dependencies(message_type: str, texts: dict[str, str]) -> str:
    parts = [texts[message_type]]
    seen = {message_type}
    waiting = [message_type]
    while waiting:
        for line in texts[waiting.pop(0)].splitlines():
            nested = line.split()[0].removesuffix("[]")
            if nested in texts and nested not in seen:
                seen.add(nested)
                waiting.append(nested)
                parts.append(f"{_RULE}\nMSG: {nested}\n{texts[nested]}")
    return "".join(parts)


CDR_LITTLE_ENDIAN = b"\x00\x01\x00\x00"

Item = tuple[str, "float | str | None"]
"""A field: struct code (or "s" for a string) and its fixed value; None for an argument of `pack`."""


class Encoding(str, Enum):
    """Serialisation of messages."""

    ros1 = "ros1"
    cdr = "cdr"


class Layout:
    """A compiled layout: `pack` takes the values of the fields that are not fixed, in order."""

    def __init__(self, items: Sequence[Item], encoding: Encoding) -> None:
        cdr = encoding is Encoding.cdr
        self._codes = "<"
        self._size = 0
        self._values: list[float | bytes | None] = []
        for code, value in items:
            if isinstance(value, str):
                raw = value.encode() + (b"\0" if cdr else b"")
                self._add("I", len(raw), align=cdr)
                self._add(f"{len(raw)}s", raw, align=False)
            else:
                self._add(code, value, align=cdr)
        self._slots = [number for number, value in enumerate(self._values) if value is None]
        self._front = CDR_LITTLE_ENDIAN if cdr else b""
        self._struct = struct.Struct(self._codes)

    def pack(self, *arguments: float) -> bytes:
        """Return the serialised message, or its beginning where items are missing at the end."""
        values = self._values.copy()
        for slot, value in zip(self._slots, arguments, strict=True):
            values[slot] = value
        return self._front + self._struct.pack(*values)

    def _add(self, code: str, value: float | bytes | None, *, align: bool) -> None:
        size = struct.calcsize("<" + code)
        padding = -self._size % size if align else 0
        self._codes += "x" * padding + code
        self._size += padding + size
        self._values.append(value)


def header(frame_id: str, encoding: Encoding) -> list[Item]:
    """Return a std_msgs/Header whose stamp (seconds, nanoseconds) is packed; the sequence number of ROS 1 stays 0."""
    sequence: list[Item] = [("I", 0)] if encoding is Encoding.ros1 else []
    return [*sequence, ("I", None), ("I", None), ("s", frame_id)]


def variable(count: int) -> list[Item]:
    """Return float64 fields whose values are arguments of `pack`."""
    return [("d", None)] * count


def diagonal(size: int, variance: float) -> list[Item]:
    """Return a fixed covariance matrix with equal variances."""
    return [("d", variance if row == column else 0.0) for row in range(size) for column in range(size)]
