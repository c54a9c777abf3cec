"""Units of the fields of ROS's standard types.

Source: the comments of common_interfaces (sensor_msgs, geometry_msgs, nav_msgs), and REP 103 for lengths and angles.
"""

from __future__ import annotations

from kleinkram.recordings.decoding.tables import columns_of, is_time
from kleinkram.recordings.decoding.types import Array, Struct, Type

_UNITS: dict[str, dict[str, str]] = {
    "geometry_msgs/Accel": {"linear": "m/s^2", "angular": "rad/s^2"},
    "geometry_msgs/Inertia": {
        "m": "kg",
        "com": "m",
        **dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), "kg*m^2"),
    },
    "geometry_msgs/PointStamped": {"point": "m"},
    "geometry_msgs/Polygon": {"points": "m"},
    "geometry_msgs/Pose": {"position": "m"},
    "geometry_msgs/Pose2D": {"x": "m", "y": "m", "theta": "rad"},
    "geometry_msgs/Transform": {"translation": "m"},
    "geometry_msgs/Twist": {"linear": "m/s", "angular": "rad/s"},
    "geometry_msgs/Wrench": {"force": "N", "torque": "N*m"},
    "nav_msgs/GridCells": {"cell_width": "m", "cell_height": "m", "cells": "m"},
    "nav_msgs/MapMetaData": {"resolution": "m"},
    "sensor_msgs/BatteryState": {
        "voltage": "V",
        "temperature": "degC",
        "current": "A",
        "charge": "A*h",
        "capacity": "A*h",
        "design_capacity": "A*h",
        "percentage": "1",
        "cell_voltage": "V",
        "cell_temperature": "degC",
    },
    "sensor_msgs/FluidPressure": {"fluid_pressure": "Pa", "variance": "Pa^2"},
    "sensor_msgs/Illuminance": {"illuminance": "lx", "variance": "lx^2"},
    "sensor_msgs/Imu": {
        "orientation_covariance": "rad^2",
        "angular_velocity": "rad/s",
        "angular_velocity_covariance": "rad^2/s^2",
        "linear_acceleration": "m/s^2",
        "linear_acceleration_covariance": "m^2/s^4",
    },
    "sensor_msgs/JointState": {"position": "rad or m", "velocity": "rad/s or m/s", "effort": "N*m or N"},
    "sensor_msgs/LaserScan": {
        "angle_min": "rad",
        "angle_max": "rad",
        "angle_increment": "rad",
        "time_increment": "s",
        "scan_time": "s",
        "range_min": "m",
        "range_max": "m",
        "ranges": "m",
    },
    "sensor_msgs/MagneticField": {"magnetic_field": "T", "magnetic_field_covariance": "T^2"},
    "sensor_msgs/NavSatFix": {"latitude": "deg", "longitude": "deg", "altitude": "m", "position_covariance": "m^2"},
    "sensor_msgs/PointCloud": {"points": "m"},
    "sensor_msgs/Range": {"field_of_view": "rad", "min_range": "m", "max_range": "m", "range": "m", "variance": "m^2"},
    "sensor_msgs/RelativeHumidity": {"relative_humidity": "1", "variance": "1"},
    "sensor_msgs/Temperature": {"temperature": "degC", "variance": "degC^2"},
}


def units_of(root: Struct) -> dict[str, str]:
    """Return the unit of each column of a type, by the column's name in `to_arrow`; none for those without one.

    A type's own unit applies to all fields below the field, unless a nested type has one for them.
    """
    columns = columns_of(root, None)
    units = {column.name: "ns" if is_time(column.kind) else _unit_at(root, column.path) for column in columns}
    return {name: unit for name, unit in units.items() if unit}


def _unit_at(root: Struct, path: tuple[int, ...]) -> str:
    unit, kind = "", root
    for position in path:
        field = kind.fields[position]
        unit = _UNITS.get(_plain_name(kind), {}).get(field.name, unit)
        inner: Type = field.type
        while isinstance(inner, Array):
            inner = inner.element
        if not isinstance(inner, Struct):
            break
        kind = inner
    return unit


def _plain_name(kind: Struct) -> str:
    return kind.name.replace("::", "/").replace("/msg/", "/")
