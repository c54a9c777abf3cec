"""Units: of fields that ROS's standard types have, for columns of any nesting."""

from __future__ import annotations

import re

import pytest

from kleinkram.recordings.decoding import Decoder, decoder_for
from kleinkram.recordings.decoding.msg_definitions import known_definitions
from kleinkram.recordings.decoding.types import Struct
from kleinkram.recordings.writing.units import _UNITS, units_of


def struct_of(name: str) -> Struct:
    decoder = decoder_for("cdr", name, "", b"")
    assert isinstance(decoder, Decoder)
    assert decoder.struct is not None
    return decoder.struct


@pytest.mark.parametrize("name", sorted(_UNITS))
def test_units_are_of_fields_that_exist(name: str) -> None:
    """In one release of ROS 2 at least: a range has a variance since Iron."""
    texts = "\n".join(known_definitions()[name])
    fields = set(re.findall(r"^\S+ (\w+)$", texts, re.MULTILINE))
    assert set(_UNITS[name]) <= fields


def test_units_of_nested_types() -> None:
    units = units_of(struct_of("nav_msgs/msg/Odometry"))
    assert units["pose.pose.position.x"] == "m"
    assert units["twist.twist.linear.z"] == "m/s"
    assert units["twist.twist.angular.z"] == "rad/s"
    assert units["header.stamp_ns"] == "ns"
    assert "pose.pose.orientation.w" not in units
    assert "pose.covariance" not in units


def test_units_of_arrays() -> None:
    assert units_of(struct_of("sensor_msgs/msg/LaserScan"))["ranges"] == "m"
    assert units_of(struct_of("geometry_msgs/msg/Polygon")) == {"points": "m"}
