"""`Recording.to_csv`: what other readers read is what the messages hold."""

from __future__ import annotations

import base64
import csv
import json
import math
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.rosbag1 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from kleinkram.recordings import Recording
from kleinkram.recordings.writing.csv_file import MAX_NUMBERED
from tests.recording_files.builders import T0
from tests.recording_files.corpus import Entry, params_to_write
from tests.recording_files.ros_messages import TimedMessage, ros2_mcap
from tests.recording_files.tables import json_mcap


def read(path: Path) -> tuple[list[str], list[list[str]]]:
    csv.field_size_limit(2**27)  # a point cloud in base64
    with path.open(encoding="utf-8", newline="") as file:
        headers, *rows = csv.reader(file, strict=True)
    return headers, rows


def messages_by_rosbags(path: Path) -> dict[str, list[tuple[int, Any]]]:
    """Return log time and value of each message by topic."""
    messages: dict[str, list[tuple[int, Any]]] = defaultdict(list)
    with Reader(path) as reader:
        stores = {}
        for connection in reader.connections:
            store = stores[connection.id] = get_typestore(Stores.EMPTY)
            store.register(get_types_from_msg(connection.msgdef.data, connection.msgtype))
        for connection, log_ns, data in reader.messages():
            value = stores[connection.id].deserialize_ros1(data, connection.msgtype)
            messages[connection.topic].append((log_ns, value))
    return messages


def assert_same(cell: str, value: Any) -> None:
    """Compare a cell with what rosbags decodes."""
    if hasattr(value, "nanosec"):
        assert int(cell) == value.sec * 10**9 + value.nanosec
    elif isinstance(value, bool | np.bool_):
        assert cell == str(bool(value)).lower()
    elif isinstance(value, int | np.integer):
        assert int(cell) == value
    elif isinstance(value, float | np.floating):
        assert float(cell) == value or np.float32(cell) == np.float32(value) or math.isnan(float(cell) + float(value))
    elif isinstance(value, str):
        assert cell == value
    elif isinstance(value, np.ndarray) and value.dtype == np.uint8 and not cell.startswith("["):
        assert base64.b64decode(cell) == value.tobytes()
    else:
        items = json.loads(cell)
        assert len(items) == len(value)
        for item, inner in zip(items, value, strict=True):
            if isinstance(item, dict):
                assert_same_fields(item, inner)
            else:
                assert_same(item if isinstance(item, str) else json.dumps(item), inner)


def assert_same_fields(item: dict[str, Any], value: Any) -> None:
    for name, part in item.items():
        inner = getattr(value, name.removesuffix("_ns") if not hasattr(value, name) else name)
        if isinstance(part, dict):
            assert_same_fields(part, inner)
        else:
            assert_same(part if isinstance(part, str) else json.dumps(part), inner)


def field_of(value: Any, header: str) -> Any:
    name, _, index = header.partition("[")
    for part in name.split("."):
        value = getattr(value, part, None) if hasattr(value, part) else getattr(value, part.removesuffix("_ns"))
    if not index:
        return value
    number = int(index.rstrip("]"))
    return value[number] if number < len(value) else None


@pytest.mark.parametrize("entry", params_to_write("ROS1 bag 2.0"))
def test_every_topic_of_every_bag(entry: Entry, recordings_dir: Path, tmp_path: Path) -> None:
    expected = messages_by_rosbags(recordings_dir / entry.name)
    with Recording.open(recordings_dir / entry.name) as recording:
        result = recording.to_csv(tmp_path / "out")
        undecodable = {topic.name for topic in recording.topics if topic.undecodable}
    assert {item.topic for item in result.left_out} == undecodable
    assert {file.topic for file in result.files} >= expected.keys() - undecodable
    for file in result.files:
        headers, rows = read(file.path)
        messages = sorted(expected.get(file.topic, []), key=lambda message: message[0])
        assert len(rows) == len(messages) == file.row_count
        assert [int(row[0]) for row in rows] == [log_ns for log_ns, _ in messages]
        if len({log_ns for log_ns, _ in messages}) < len(messages):
            continue  # readers may order messages of one time differently
        for row, (_, value) in zip(rows[:200], messages, strict=False):
            for header, cell in zip(headers[2:], row[2:], strict=True):
                part = field_of(value, header)
                if part is None:
                    assert cell == ""
                else:
                    assert_same(cell, part)


def test_lines_and_texts_are_those_of_rfc_4180(tmp_path: Path) -> None:
    texts = ["plain", 'with "quotes"', "a, comma", "two\r\nlines", "=1+1", "", " space ", "ünïcode 🤖", "\n", '"']
    with Recording.open(json_mcap([{"text": text} for text in texts])) as recording:
        (file,) = recording.to_csv(tmp_path).files
    headers, rows = read(file.path)
    assert headers == ["log_time_ns", "publish_time_ns", "text"]
    assert [row[2] for row in rows] == texts
    data = file.path.read_bytes()
    assert data.startswith(b"log_time_ns,publish_time_ns,text\r\n")
    assert b'"with ""quotes"""' in data
    assert data.endswith(b"\r\n")


def test_numbers_lose_nothing(tmp_path: Path) -> None:
    values = {"angular_velocity": {"x": 0.1, "y": 1e300, "z": 5e-324}, "linear_acceleration": {"x": float("inf")}}
    stamp = T0 + 123_456_789
    with Recording.open(ros2_mcap([TimedMessage("/imu", "sensor_msgs/Imu", 2**62 + 1, values, stamp)])) as recording:
        (file,) = recording.to_csv(tmp_path).files
    headers, (row,) = read(file.path)
    cells = dict(zip(headers, row, strict=True))
    assert cells["log_time_ns"] == str(2**62 + 1)
    assert cells["header.stamp_ns"] == str(stamp)
    assert float(cells["angular_velocity.x"]) == 0.1
    assert float(cells["angular_velocity.y"]) == 1e300
    assert float(cells["angular_velocity.z"]) == 5e-324
    assert float(cells["linear_acceleration.x"]) == math.inf
    assert {f"orientation_covariance[{number}]" for number in range(9)} <= set(headers)


def test_arrays_have_columns_up_to_a_bound(tmp_path: Path) -> None:
    joints = [
        TimedMessage("/joints", "sensor_msgs/JointState", T0 + number, {"name": names, "position": positions}, T0)
        for number, (names, positions) in enumerate([(["a", "b"], [1.0, 2.0]), (["a"], [3.0]), ([], [])])
    ]
    ranges = [float(number) for number in range(MAX_NUMBERED + 1)]
    scan = TimedMessage("/scan", "sensor_msgs/LaserScan", T0, {"ranges": [*ranges, float("nan"), float("inf")]}, T0)
    with Recording.open(ros2_mcap([*joints, scan])) as recording:
        files = {file.topic: file.path for file in recording.to_csv(tmp_path).files}
    headers, rows = read(files["/joints"])
    position = headers.index("position[0]")
    assert headers[position - 2 : position + 2] == ["name[0]", "name[1]", "position[0]", "position[1]"]
    assert [row[position - 2 : position + 2] for row in rows] == [
        ["a", "b", "1", "2"],
        ["a", "", "3", ""],
        ["", "", "", ""],
    ]
    headers, (row,) = read(files["/scan"])
    assert json.loads(row[headers.index("ranges")]) == [*ranges, "NaN", "Infinity"]


def test_files_without_messages_have_headers(tmp_path: Path) -> None:
    imu = [TimedMessage("/imu", "sensor_msgs/Imu", T0 + n, {}, T0) for n in range(2)]
    other = [TimedMessage("/odom", "nav_msgs/Odometry", T0 + 10**9, {}, T0)]
    with Recording.open(ros2_mcap([*imu, *other])) as recording:
        files = {file.topic: file for file in recording.to_csv(tmp_path, end=T0 + 10).files}
    assert files["/odom"].row_count == 0
    headers, rows = read(files["/odom"].path)
    assert "pose.pose.position.x" in headers
    assert rows == []


json_values = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**63 - 1) | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text("abc", min_size=1), inner, max_size=3),
    max_leaves=8,
)


@settings(max_examples=60)
@given(st.lists(st.dictionaries(st.text("xyz", min_size=1, max_size=2), json_values, max_size=3), max_size=5))
def test_any_json_gives_a_file_of_equal_rows(tmp_path_factory: pytest.TempPathFactory, values: list[object]) -> None:
    with Recording.open(json_mcap(values)) as recording:
        result = recording.to_csv(tmp_path_factory.mktemp("csv"))
    for file in result.files:
        headers, rows = read(file.path)
        assert len(rows) == len(values)
        assert {len(row) for row in rows} <= {len(headers)}
