"""Point clouds with fields of any order, type, padding and byte order."""

from __future__ import annotations

import base64
import struct
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from kleinkram.recordings.decoding import DecodeError, points


def field(name: str, offset: int, datatype: int = 7, count: int = 1) -> Any:
    return SimpleNamespace(name=name, offset=offset, datatype=datatype, count=count)


def cloud(data: bytes, fields: list[Any], **sizes: int) -> Any:
    usual = {"height": 1, "width": 2, "point_step": 16, "row_step": 32, "is_bigendian": 0, "is_dense": 1}
    return SimpleNamespace(data=data, fields=fields, header=None, **{**usual, **sizes})


XYZI = [field("x", 0), field("y", 4), field("intensity", 12, 4), field("ring", 14, 2)]


def test_a_cloud_is_a_structured_array() -> None:
    data = struct.pack("<2f4xHBx", 1, 2, 300, 7) + struct.pack("<2f4xHBx", 3, 4, 5, 255)
    cloud_array = points(cloud(data, XYZI))
    assert cloud_array.dtype.names == ("x", "y", "intensity", "ring")
    assert cloud_array.shape == (2,)
    assert cloud_array["x"].tolist() == [1, 3]
    assert cloud_array["intensity"].tolist() == [300, 5]
    assert cloud_array["ring"].tolist() == [7, 255]
    assert cloud_array["x"].dtype == np.float32


def test_an_organised_cloud_keeps_its_rows() -> None:
    rows = [struct.pack("<4f", row, 0, 0, 0) + struct.pack("<4f", row, 1, 0, 0) + bytes(8) for row in range(3)]
    data = b"".join(rows)[:-8]
    cloud_array = points(cloud(data, [field("x", 0), field("y", 4)], height=3, row_step=40))
    assert cloud_array.shape == (3, 2)
    assert cloud_array["x"].tolist() == [[0, 0], [1, 1], [2, 2]]
    assert cloud_array["y"].tolist() == [[0, 1]] * 3


def test_big_endian_and_fields_of_several_numbers() -> None:
    data = struct.pack(">3d", 1, 2, 3) + struct.pack(">3d", 4, 5, 6)
    cloud_array = points(cloud(data, [field("p", 0, 8, 3)], point_step=24, row_step=48, is_bigendian=1))
    assert cloud_array["p"].tolist() == [[1, 2, 3], [4, 5, 6]]


def test_foxglove() -> None:
    fields = [SimpleNamespace(name="x", offset=0, type=7), SimpleNamespace(name="i", offset=4, type=1)]
    data = struct.pack("<fBfBB", 1.5, 2, 2.5, 3, 99)
    message = SimpleNamespace(fields=fields, point_stride=5, data=data, frame_id="lidar")
    assert points(message).tolist() == [(1.5, 2), (2.5, 3)]
    as_json = {"fields": [vars(f) for f in fields], "point_stride": 5, "data": base64.b64encode(data).decode()}
    assert points(as_json).tolist() == [(1.5, 2), (2.5, 3)]


def test_an_empty_cloud() -> None:
    assert points(cloud(b"", XYZI, width=0, row_step=0)).shape == (0,)
    assert points(cloud(b"", XYZI, width=0, height=0, row_step=0)).shape == (0,)


@pytest.mark.parametrize(
    ("message", "why"),
    [
        (cloud(bytes(31), XYZI), "do not fit"),
        (cloud(bytes(64), XYZI, height=2, row_step=16), "do not fit"),
        (cloud(bytes(32), XYZI, width=2**31, height=2**31), "do not fit"),
        (cloud(bytes(32), [field("x", 14)]), "does not fit into points"),
        (cloud(bytes(32), [field("x", 0, 8, 2**31)]), "does not fit into points"),
        (cloud(bytes(32), [field("x", 0), field("x", 4)]), "duplicated"),
        (cloud(bytes(32), [field("x", 0, 99)]), "unknown type"),
        (cloud(bytes(32), []), "0 fields"),
        (cloud(bytes(32), XYZI, point_step=0), "does not fit"),
        (SimpleNamespace(x=1), "no point cloud"),
    ],
)
def test_values_that_are_not_point_clouds_are_refused(message: object, why: str) -> None:
    with pytest.raises(DecodeError, match=why):
        points(message)
