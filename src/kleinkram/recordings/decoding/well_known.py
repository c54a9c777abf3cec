"""The ROS 2 types that everybody uses, for recordings that hold no definitions: rosbag2 databases up to Humble.

As of Humble, the last release whose databases lack them; only types that had not changed for years. A recording's own
definition always goes first.

Source: common_interfaces, geometry2, rcl_interfaces of ROS 2 Humble.
"""

from __future__ import annotations

from kleinkram.recordings.decoding.msg_text import short_name

_HEADER = "std_msgs/Header header"
_XYZ = "float64 x, float64 y, float64 z"
_NUMBERS = "Bool Byte Char Float32 Float64 Int8 Int16 Int32 Int64 UInt8 UInt16 UInt32 UInt64 String".split()  # noqa: SIM905  # a table

_FIELDS = {
    **{f"std_msgs/{name}": f"{name.lower()} data" for name in _NUMBERS},
    **{
        f"std_msgs/{name}MultiArray": f"MultiArrayLayout layout, {name.lower()}[] data"
        for name in _NUMBERS
        if name not in ("Bool", "Char", "String")
    },
    "std_msgs/Empty": "",
    "std_msgs/ColorRGBA": "float32 r, float32 g, float32 b, float32 a",
    "std_msgs/Header": "builtin_interfaces/Time stamp, string frame_id",
    "std_msgs/MultiArrayDimension": "string label, uint32 size, uint32 stride",
    "std_msgs/MultiArrayLayout": "MultiArrayDimension[] dim, uint32 data_offset",
    "rosgraph_msgs/Clock": "builtin_interfaces/Time clock",
    "rcl_interfaces/Log": (
        "builtin_interfaces/Time stamp, uint8 level, string name, string msg, string file, string function, uint32 line"
    ),
    "rcl_interfaces/ParameterEvent": (
        "builtin_interfaces/Time stamp, string node, Parameter[] new_parameters, Parameter[] changed_parameters, "
        "Parameter[] deleted_parameters"
    ),
    "rcl_interfaces/Parameter": "string name, ParameterValue value",
    "rcl_interfaces/ParameterValue": (
        "uint8 type, bool bool_value, int64 integer_value, float64 double_value, string string_value, "
        "byte[] byte_array_value, bool[] bool_array_value, int64[] integer_array_value, float64[] double_array_value, "
        "string[] string_array_value"
    ),
    "diagnostic_msgs/KeyValue": "string key, string value",
    "diagnostic_msgs/DiagnosticStatus": (
        "byte level, string name, string message, string hardware_id, KeyValue[] values"
    ),
    "diagnostic_msgs/DiagnosticArray": f"{_HEADER}, DiagnosticStatus[] status",
    "geometry_msgs/Vector3": _XYZ,
    "geometry_msgs/Point": _XYZ,
    "geometry_msgs/Point32": "float32 x, float32 y, float32 z",
    "geometry_msgs/Quaternion": f"{_XYZ}, float64 w",
    "geometry_msgs/Pose": "Point position, Quaternion orientation",
    "geometry_msgs/PoseWithCovariance": "Pose pose, float64[36] covariance",
    "geometry_msgs/PoseArray": f"{_HEADER}, Pose[] poses",
    "geometry_msgs/Polygon": "Point32[] points",
    "geometry_msgs/Transform": "Vector3 translation, Quaternion rotation",
    "geometry_msgs/TransformStamped": f"{_HEADER}, string child_frame_id, Transform transform",
    "geometry_msgs/Twist": "Vector3 linear, Vector3 angular",
    "geometry_msgs/TwistWithCovariance": "Twist twist, float64[36] covariance",
    "geometry_msgs/Accel": "Vector3 linear, Vector3 angular",
    "geometry_msgs/AccelWithCovariance": "Accel accel, float64[36] covariance",
    "geometry_msgs/Wrench": "Vector3 force, Vector3 torque",
    **{
        f"geometry_msgs/{name}Stamped": f"{_HEADER}, {name} {field}"
        for name, field in (
            ("Vector3", "vector"),
            ("Point", "point"),
            ("Quaternion", "quaternion"),
            ("Pose", "pose"),
            ("PoseWithCovariance", "pose"),
            ("Polygon", "polygon"),
            ("Twist", "twist"),
            ("TwistWithCovariance", "twist"),
            ("Accel", "accel"),
            ("AccelWithCovariance", "accel"),
            ("Wrench", "wrench"),
        )
    },
    "nav_msgs/MapMetaData": (
        "builtin_interfaces/Time map_load_time, float32 resolution, uint32 width, uint32 height, "
        "geometry_msgs/Pose origin"
    ),
    "nav_msgs/OccupancyGrid": f"{_HEADER}, MapMetaData info, int8[] data",
    "nav_msgs/Odometry": (
        f"{_HEADER}, string child_frame_id, geometry_msgs/PoseWithCovariance pose, "
        "geometry_msgs/TwistWithCovariance twist"
    ),
    "nav_msgs/Path": f"{_HEADER}, geometry_msgs/PoseStamped[] poses",
    "sensor_msgs/RegionOfInterest": "uint32 x_offset, uint32 y_offset, uint32 height, uint32 width, bool do_rectify",
    "sensor_msgs/CameraInfo": (
        f"{_HEADER}, uint32 height, uint32 width, string distortion_model, float64[] d, float64[9] k, float64[9] r, "
        "float64[12] p, uint32 binning_x, uint32 binning_y, RegionOfInterest roi"
    ),
    "sensor_msgs/CompressedImage": f"{_HEADER}, string format, uint8[] data",
    "sensor_msgs/FluidPressure": f"{_HEADER}, float64 fluid_pressure, float64 variance",
    "sensor_msgs/Image": (
        f"{_HEADER}, uint32 height, uint32 width, string encoding, uint8 is_bigendian, uint32 step, uint8[] data"
    ),
    "sensor_msgs/Imu": (
        f"{_HEADER}, geometry_msgs/Quaternion orientation, float64[9] orientation_covariance, "
        "geometry_msgs/Vector3 angular_velocity, float64[9] angular_velocity_covariance, "
        "geometry_msgs/Vector3 linear_acceleration, float64[9] linear_acceleration_covariance"
    ),
    "sensor_msgs/JointState": f"{_HEADER}, string[] name, float64[] position, float64[] velocity, float64[] effort",
    "sensor_msgs/Joy": f"{_HEADER}, float32[] axes, int32[] buttons",
    "sensor_msgs/LaserScan": (
        f"{_HEADER}, float32 angle_min, float32 angle_max, float32 angle_increment, float32 time_increment, "
        "float32 scan_time, float32 range_min, float32 range_max, float32[] ranges, float32[] intensities"
    ),
    "sensor_msgs/MagneticField": (
        f"{_HEADER}, geometry_msgs/Vector3 magnetic_field, float64[9] magnetic_field_covariance"
    ),
    "sensor_msgs/NavSatStatus": "int8 status, uint16 service",
    "sensor_msgs/NavSatFix": (
        f"{_HEADER}, NavSatStatus status, float64 latitude, float64 longitude, float64 altitude, "
        "float64[9] position_covariance, uint8 position_covariance_type"
    ),
    "sensor_msgs/PointField": "string name, uint32 offset, uint8 datatype, uint32 count",
    "sensor_msgs/PointCloud2": (
        f"{_HEADER}, uint32 height, uint32 width, PointField[] fields, bool is_bigendian, uint32 point_step, "
        "uint32 row_step, uint8[] data, bool is_dense"
    ),
    "sensor_msgs/Temperature": f"{_HEADER}, float64 temperature, float64 variance",
    "sensor_msgs/TimeReference": f"{_HEADER}, builtin_interfaces/Time time_ref, string source",
    "tf2_msgs/TFMessage": "geometry_msgs/TransformStamped[] transforms",
}
NAMES = frozenset(_FIELDS)


def well_known_definition(name: str) -> str | None:
    """Return the definition of a ROS 2 type ("sensor_msgs/msg/Imu") with all others behind it; None for other types."""
    wanted = short_name(name)
    if wanted not in _FIELDS:
        return None
    others = (f"===\nMSG: {other}\n{_lines(other)}" for other in _FIELDS if other != wanted)
    return "\n".join([_lines(wanted), *others])


def _lines(name: str) -> str:
    return _FIELDS[name].replace(", ", "\n")
