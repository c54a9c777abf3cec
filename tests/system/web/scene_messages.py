"""A recording with one message, or a few, of each type that 3D panels show, as JSON in an MCAP."""

import base64
import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kleinkram.recordings.writing.mcap_writer import McapWriter

START_NS = 1_800_000_000_000_000_000
SECOND_NS = 10**9
LARGE_CLOUD_POINTS = 1_000_000
UTM = (465_000.0, 5_247_000.0, 430.0)
_FLOAT32, _FLOAT64, _UINT32 = 7, 8, 6
# By the numbers of visualization_msgs/Marker.type.
_TRANSPARENT, _WITH_POINTS, _SMALL, _COLOURED = 3, 4, (6, 7, 8), (6, 8, 11)
_CORNERS = ((0, 0, 0), (0.8, 0, 0.4), (0.8, 0.8, 0), (0, 0.8, 0.4), (0, 0, 0.8), (0.4, 0.4, 1))

Message = tuple[str, str, int, Mapping[str, Any]]
"""Topic, type, log time in ns, and value."""


def write_shapes(path: Path) -> None:
    """Write the recording: 10 s, in which frame `base` moves 1 m along x of `map` each second."""
    with path.open("xb") as file:
        writer = McapWriter(file)
        channels: dict[str, int] = {}
        for topic, message_type, log_time_ns, value in sorted(_messages(), key=lambda message: message[2]):
            if topic not in channels:
                schema = writer.add_schema(message_type, "jsonschema", b'{"type":"object"}')
                channels[topic] = writer.add_channel(topic, schema, "json")
            writer.add_message(channels[topic], log_time_ns, json.dumps(value).encode())
        writer.finish()


def coloured_points() -> NDArray[Any]:
    """Return the points of `/colours`: 12 by 8, of which one has no position."""
    points = np.zeros(96, dtype=[("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("rgb", "<u4")])
    rows, columns = np.divmod(np.arange(96), 12)
    points["x"], points["y"], points["z"] = columns * 0.25, rows * 0.25, 0.5
    points["rgb"] = (columns * 20) << 16 | (rows * 30) << 8 | 0x40
    points["x"][5] = np.nan
    return points


def utm_points() -> NDArray[Any]:
    """Return the points of `/utm`, in metres of a projection, as float64."""
    points = np.zeros(400, dtype=[("x", "<f8"), ("y", "<f8"), ("z", "<f8")])
    for axis, offset in zip("xyz", UTM, strict=True):
        points[axis] = offset + np.linspace(0, {"x": 4.0, "y": 3.0, "z": 1.0}[axis], 400)
    return points


def large_points() -> NDArray[Any]:
    """Return the points of `/large`: a million on a wave."""
    points = np.zeros(LARGE_CLOUD_POINTS, dtype=[("x", "<f4"), ("y", "<f4"), ("z", "<f4")])
    rows, columns = np.divmod(np.arange(LARGE_CLOUD_POINTS), 1000)
    points["x"], points["y"] = columns * 0.02 - 10, rows * 0.02 - 10
    points["z"] = np.sin(points["x"]) + np.cos(points["y"])
    return points


def _messages() -> Iterator[Message]:
    for number in range(101):
        log_time_ns = START_NS + number * SECOND_NS // 10
        yield "/tf", "tf2_msgs/TFMessage", log_time_ns, _transform("map", "base", log_time_ns, (number / 10, 0, 0))
    yield "/tf_static", "tf2_msgs/TFMessage", START_NS, _transform("base", "lidar", START_NS, (0, 0, 1.5))
    loop = [_transform(parent, child, START_NS, (0, 0, 0)) for parent, child in ("ab", "ba")]
    for value in loop:
        yield "/tf_static", "tf2_msgs/TFMessage", START_NS, value
    for second in range(10):
        now = START_NS + second * SECOND_NS
        yield "/colours", "sensor_msgs/PointCloud2", now, _cloud("lidar", now, coloured_points())
        yield "/pose", "geometry_msgs/PoseStamped", now, {"header": _header("base", now), "pose": _pose(1, 1, 0)}
        yield "/looping", "geometry_msgs/PoseStamped", now, {"header": _header("b", now), "pose": _pose(0, 0, 0)}
        yield "/cut", "sensor_msgs/PointCloud2", now, _cut(_cloud("base", now, coloured_points()))
    yield "/utm", "sensor_msgs/PointCloud2", START_NS, _cloud("utm", START_NS, utm_points())
    yield "/large", "sensor_msgs/PointCloud2", START_NS, _cloud("map", START_NS, large_points())
    yield "/path", "nav_msgs/Path", START_NS, _path()
    yield "/grid", "nav_msgs/OccupancyGrid", START_NS, _grid()
    yield "/shapes", "visualization_msgs/MarkerArray", START_NS, {"markers": _markers()}
    later = START_NS + 5 * SECOND_NS
    yield "/shapes", "visualization_msgs/MarkerArray", later, {"markers": [{"ns": "shapes", "id": 1, "action": 2}]}


def _header(frame: str, stamp_ns: int) -> dict[str, Any]:
    return {"frame_id": frame, "stamp": {"sec": stamp_ns // SECOND_NS, "nanosec": stamp_ns % SECOND_NS}}


def _point(x: float, y: float, z: float) -> dict[str, float]:
    return {"x": x, "y": y, "z": z}


def _pose(x: float, y: float, z: float, yaw: float = 0) -> dict[str, Any]:
    rotation = {"x": 0, "y": 0, "z": math.sin(yaw / 2), "w": math.cos(yaw / 2)}
    return {"position": _point(x, y, z), "orientation": rotation}


def _transform(parent: str, child: str, stamp_ns: int, position: tuple[float, float, float]) -> dict[str, Any]:
    transform = {"translation": _point(*position), "rotation": {"x": 0, "y": 0, "z": 0, "w": 1}}
    return {"transforms": [{"header": _header(parent, stamp_ns), "child_frame_id": child, "transform": transform}]}


def _cloud(frame: str, stamp_ns: int, points: NDArray[Any]) -> dict[str, Any]:
    layout: Mapping[str, Any] = points.dtype.fields or {}
    fields = [
        {"name": name, "offset": field[1], "datatype": _datatype(field[0]), "count": 1}
        for name, field in layout.items()
    ]
    step = points.dtype.itemsize
    return {
        "header": _header(frame, stamp_ns), "height": 1, "width": len(points), "fields": fields, "is_bigendian": False,
        "point_step": step, "row_step": step * len(points), "is_dense": False,
        "data": base64.b64encode(points.tobytes()).decode(),
    }  # fmt: skip


def _datatype(dtype: np.dtype[Any]) -> int:
    return {"f4": _FLOAT32, "f8": _FLOAT64, "u4": _UINT32}[dtype.str[1:]]


def _cut(cloud: dict[str, Any]) -> dict[str, Any]:
    """Return a cloud without its last 16 points."""
    data = base64.b64decode(cloud["data"])[: -16 * cloud["point_step"]]
    return {**cloud, "data": base64.b64encode(data).decode()}


def _path() -> dict[str, Any]:
    turns = [step / 20 for step in range(120)]
    poses = [
        {"header": _header("map", START_NS), "pose": _pose(6 + 4 * math.cos(t), 4 * math.sin(t), 0.1)} for t in turns
    ]
    return {"header": _header("map", START_NS), "poses": poses}


def _grid() -> dict[str, Any]:
    cells = [-1 if row < 4 else (100 if (row + column) % 7 == 0 else 0) for row in range(40) for column in range(60)]
    info = {"resolution": 0.25, "width": 60, "height": 40, "origin": _pose(-2, -5, -0.05)}
    return {"header": _header("map", START_NS), "info": info, "data": cells}


def _markers() -> list[dict[str, Any]]:
    """Return a marker of each type, in two rows."""
    return [_marker(shape) for shape in range(12)]


def _marker(shape: int) -> dict[str, Any]:
    size = 0.2 if shape in _SMALL else 0.9
    thin = size / 3 if shape == 0 else size
    return {
        "header": _header("map", START_NS),
        "ns": "shapes",
        "id": shape,
        "type": shape,
        "action": 0,
        "pose": _pose(1.5 * (shape % 6), 1.5 * (shape // 6), 0.5, yaw=0.4),
        "scale": _point(size, thin, thin),
        "color": {"r": 0.9, "g": 0.5, "b": 0.1, "a": 0.6 if shape == _TRANSPARENT else 1},
        "lifetime": {"sec": 0, "nanosec": 0},
        "frame_locked": False,
        "points": [_point(*corner) for corner in _CORNERS] if shape >= _WITH_POINTS else [],
        "colors": [{"r": step / 5, "g": 0.4, "b": 1 - step / 5, "a": 1} for step in range(6)]
        if shape in _COLOURED
        else [],
        "text": "Kleinkram",
        "mesh_resource": "package://robot/base.stl",
    }
