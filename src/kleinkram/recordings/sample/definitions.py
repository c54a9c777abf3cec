"""The message types of a sample mission: their definitions in ROS 1 and ROS 2, and ROS 1's md5 sums.

Source: common_msgs, geometry2 and their ROS 2 descendants; the md5 rule is that of genmsg.
"""

from __future__ import annotations

import hashlib
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
    """Return the md5 sum by which ROS 1 knows a type: constants first, nested types by their own sums."""
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
