"""Previews of small recordings: what is in them, and what bad input does."""

from __future__ import annotations

import base64
import io
import json
import math
import struct
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from kleinkram.recordings import Recording
from kleinkram.recordings.formats.rosbag2 import db3
from kleinkram.recordings.previews import (
    LogSeverity,
    PreviewLimits,
    RecordingPreview,
    make_preview,
    read_preview,
    topic_readers,
)
from kleinkram.recordings.previews import builder as builder_module
from kleinkram.recordings.previews.thumbnails import thumbnail
from tests.recording_files.builders import mcap_of
from tests.recording_files.memory_source import MemorySource
from tests.recording_files.ros_messages import SECOND, T0, TimedMessage, ros1_bag, ros2_db3, ros2_mcap
from tests.recording_files.tables import json_mcap
from tests.recording_files.writers import McapWriter

_TEN_YEARS_NS = 10 * 365 * 86_400 * SECOND


def preview_of(source: MemorySource, limits: PreviewLimits | None = None) -> RecordingPreview:
    with Recording.open(source) as recording:
        return read_preview(make_preview(recording, limits))


def imu(number: int, x: float, *, log_ns: int | None = None) -> TimedMessage:
    log_ns = T0 + number * SECOND if log_ns is None else log_ns
    return TimedMessage("/imu", "sensor_msgs/Imu", log_ns, {"linear_acceleration": {"x": x, "y": 2.5}}, log_ns)


def image_of(encoding: str, data: bytes, height: int, width: int, step: int) -> TimedMessage:
    values = {"height": height, "width": width, "encoding": encoding, "step": step, "data": data}
    return TimedMessage("/camera", "sensor_msgs/Image", T0, values, T0)


def jpeg(width: int, height: int, colour: tuple[int, int, int]) -> bytes:
    out = io.BytesIO()
    Image.new("RGB", (width, height), colour).save(out, "JPEG")
    return out.getvalue()


def values_by_field(preview: RecordingPreview, topic: str) -> dict[str, list[float]]:
    (series,) = [one for one in preview.series if one.topic == topic]
    return {field.name: field.low.tolist() for field in series.fields}


@pytest.mark.parametrize("record", [ros2_mcap, ros1_bag])
def test_series_have_the_numbers_of_the_messages(record: Any) -> None:
    preview = preview_of(record([imu(number, number / 8) for number in range(100)]))
    fields = values_by_field(preview, "/imu")
    assert fields["linear_acceleration.x"] == [number / 8 for number in range(100)]
    assert fields["linear_acceleration.y"] == [2.5] * 100
    assert "orientation_covariance[8]" in fields
    assert not any("stamp" in name for name in fields), "times are no numbers to plot"
    assert (preview.start_ns, preview.end_ns, preview.read_share) == (T0, T0 + 99 * SECOND, 1)


def test_numbers_that_are_not_finite_leave_the_others() -> None:
    preview = preview_of(ros2_mcap([imu(0, math.nan), imu(1, 4.0), imu(2, math.inf)]))
    low = values_by_field(preview, "/imu")["linear_acceleration.x"]
    assert math.isnan(low[0])
    assert low[1:] == [4, math.inf]


def test_a_time_jump_of_ten_years_costs_no_bins() -> None:
    before = [imu(number, 1.0) for number in range(50)]
    after = [imu(0, 2.0, log_ns=T0 + _TEN_YEARS_NS + number) for number in range(50)]
    preview = preview_of(ros2_mcap([*before, *after]))
    (series,) = preview.series
    assert len(series.first_ns) == 100
    assert int(np.diff(series.first_ns).max()) > _TEN_YEARS_NS / 2
    assert [values_by_field(preview, "/imu")["linear_acceleration.x"][at] for at in (49, 50)] == [1, 2]


def test_json_fields_and_their_types_may_change() -> None:
    states: list[object] = [{"x": 1, "on": True, "deep": {"y": [1, 2]}}, {"x": 2.5}, {"x": "text"}, [1], 7, "no"]
    fields = values_by_field(preview_of(json_mcap(states)), "/state")
    assert fields["x"][:2] == [1, 2.5]
    assert math.isnan(fields["x"][2])
    assert (fields["on"][0], fields["deep.y[1]"][0]) == (1, 2)
    assert fields["value"][4] == 7


def test_messages_that_take_long_to_decode_are_sampled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("kleinkram.recordings.previews.columns._DECODED_BEFORE_SAMPLING", 10)
    preview = preview_of(json_mcap({"x": number} for number in range(200)))
    (series,) = preview.series
    assert series.is_sampled
    assert series.message_count == 200
    assert 15 < np.isfinite(series.fields[0].low).sum() < 100


def test_truncated_messages_are_left_out() -> None:
    out = io.BytesIO()
    writer = McapWriter(out)
    schema = writer.add_schema("a/msg/B", "ros2msg", b"float64 x\nint32[] values")
    channel = writer.add_channel("/topic", schema, "cdr")
    whole = b"\0\1\0\0" + struct.pack("<dI2i", 5, 2, 1, 2)
    for number, data in enumerate([whole, whole[:-1], b"", whole[:8], b"\0\1\0\0" + struct.pack("<dI", 1, 2**31)]):
        writer.add_message(channel, T0 + number, data)
    writer.finish()
    fields = values_by_field(preview_of(MemorySource(out.getvalue())), "/topic")
    assert [fields["x"][0], fields["values[1]"][0]] == [5, 2]
    assert all(math.isnan(number) for number in fields["x"][1:])


def test_arrays_that_are_large_are_no_series() -> None:
    scan = {"ranges": [1.0] * 1000, "range_max": 30.0}
    preview = preview_of(ros2_mcap([TimedMessage("/scan", "sensor_msgs/LaserScan", T0, scan, T0)]))
    fields = values_by_field(preview, "/scan")
    assert fields["range_max"] == [30]
    assert not any(name.startswith("ranges") for name in fields)


def test_large_messages_are_named() -> None:
    grid = {"ranges": [1.0] * 20_000}
    preview = preview_of(ros2_mcap([TimedMessage("/scan", "sensor_msgs/LaserScan", T0, grid, T0)]))
    assert preview.series == ()
    assert [(left_out.topic, "larger" in left_out.reason) for left_out in preview.left_out] == [("/scan", True)]


def test_pictures_become_thumbnails_of_their_colour() -> None:
    red = jpeg(640, 480, (250, 0, 0))
    stills = [
        TimedMessage("/jpeg", "sensor_msgs/CompressedImage", T0 + n * SECOND, {"format": "jpeg", "data": red}, T0)
        for n in range(200)
    ]
    raw = image_of("bgr8", bytes([250, 0, 0]) * 400 * 300, 300, 400, 1200)
    preview = preview_of(ros2_mcap([*stills, raw]))
    blue, strip = preview.cameras
    assert (strip.topic, strip.message_count) == ("/jpeg", 200)
    assert 30 <= len(strip.thumbnails) <= 60
    for picture, expected in ((strip.thumbnails[-1], (250, 0, 0)), (blue.thumbnails[0], (0, 0, 250))):
        with Image.open(io.BytesIO(picture.jpeg)) as opened:
            assert (opened.width, opened.height) == (picture.width, picture.height) == (160, 120)
            pixel = opened.getpixel((80, 60))
        np.testing.assert_allclose(np.array(pixel), expected, atol=12)


@pytest.mark.parametrize(
    ("encoding", "pixels", "brightness"),
    [
        ("bayer_rggb8", bytes([200, 100] * 50 + [100, 0] * 50) * 50, (200, 100, 0)),
        ("mono16", struct.pack("<10000H", *range(10000)), None),
        ("16UC1", struct.pack("<10000H", *range(10000)), None),
        ("32FC1", struct.pack("<10000f", *([math.nan] * 5000 + [*range(5000)])), None),
    ],
)
def test_mosaics_and_depth_become_thumbnails(encoding: str, pixels: bytes, brightness: Any) -> None:
    preview = preview_of(ros2_mcap([image_of(encoding, pixels, 100, 100, len(pixels) // 100)]))
    (picture,) = preview.cameras[0].thumbnails
    with Image.open(io.BytesIO(picture.jpeg)) as opened:
        shown = np.asarray(opened)
    if brightness is None:
        assert int(shown.min()) < 20
        assert int(shown.max()) > 235
    else:
        np.testing.assert_allclose(shown[20, 20], brightness, atol=12)


@pytest.mark.parametrize(
    "message",
    [
        image_of("rgb8", b"", 0, 0, 0),
        image_of("rgb8", b"\0" * 10, 100, 100, 300),
        image_of("rgb8", b"\0" * 300, 10, 10, 1),
        image_of("nonsense", b"\0" * 300, 10, 10, 30),
        image_of("bayer_rggb8", b"\0", 1, 1, 1),
        image_of("32FC1", struct.pack("<f", math.nan), 1, 1, 4),
        TimedMessage("/camera", "sensor_msgs/CompressedImage", T0, {"format": "jpeg", "data": b"\xff\xd8\xff"}, T0),
        TimedMessage("/camera", "sensor_msgs/CompressedImage", T0, {"format": "png", "data": b""}, T0),
    ],
)
def test_pictures_that_cannot_be_decoded_leave_the_rest(message: TimedMessage) -> None:
    preview = preview_of(ros2_mcap([message, imu(1, 3.0)]))
    assert values_by_field(preview, "/imu")["linear_acceleration.x"] == [3]
    assert all(picture.width for strip in preview.cameras for picture in strip.thumbnails)


@pytest.mark.parametrize("encoding", ["bayer_rggb8", "bayer_none8", "8UC3"])
def test_the_encoding_that_a_compressed_picture_names_changes_nothing(encoding: str) -> None:
    out = io.BytesIO()
    Image.new("RGB", (100, 100), (200, 100, 0)).save(out, "PNG")
    value = {"encoding": encoding, "format": "png", "data": out.getvalue()}
    with Image.open(io.BytesIO(thumbnail(value, T0).jpeg)) as opened:
        np.testing.assert_allclose(np.asarray(opened)[20, 20], (200, 100, 0), atol=12)


@pytest.mark.parametrize("method", ["add", "finish"])
def test_a_topic_that_fails_leaves_the_others(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise KeyError("unexpected")

    monkeypatch.setattr(topic_readers.CameraReader, method, fail)
    preview = preview_of(ros2_mcap([image_of("mono8", bytes(100), 10, 10, 10), imu(1, 3.0)]))
    assert values_by_field(preview, "/imu")["linear_acceleration.x"] == [3]
    assert not preview.cameras
    assert [(one.topic, "KeyError" in one.reason) for one in preview.left_out] == [("/camera", True)]


def cloud(points: np.ndarray[Any, Any], *, point_step: int = 12, width: int | None = None) -> TimedMessage:
    fields = [{"name": axis, "offset": 4 * n, "datatype": 7, "count": 1} for n, axis in enumerate("xyz")]
    values = {
        "height": 1,
        "width": len(points) if width is None else width,
        "fields": fields,
        "point_step": point_step,
        "row_step": point_step * len(points),
        "data": points.astype("<f4").tobytes(),
    }
    return TimedMessage("/lidar", "sensor_msgs/PointCloud2", T0, values, T0)


def test_clouds_are_thinned_evenly_without_what_is_not_finite() -> None:
    points = np.arange(30_000 * 3, dtype=np.float32).reshape(-1, 3)
    points[::2] = np.nan
    (thin,) = preview_of(ros2_mcap([cloud(points)])).clouds
    assert (thin.point_count, thin.frame_id) == (30_000, "sensor")
    assert 0 < len(thin.xyz) <= 5_000
    assert np.isfinite(thin.xyz).all()
    assert (thin.xyz[:, 1] - thin.xyz[:, 0] == 1).all()


@pytest.mark.parametrize("count", [4_800, 32_000])
def test_thinned_clouds_have_points_of_all_rings_of_a_lidar(count: int) -> None:
    rings = np.arange(count) % 16
    points = np.stack([np.arange(count), np.zeros(count), rings], axis=1)
    limits = PreviewLimits(max_bytes=20_000)  # too small for all points of the cloud
    (thin,) = preview_of(ros2_mcap([cloud(points)]), limits).clouds
    assert 100 < len(thin.xyz) < 2_500
    shares = np.bincount(thin.xyz[:, 2].astype(int), minlength=16) / len(thin.xyz)
    assert (shares > 0.5 / 16).all()
    assert (np.diff(thin.xyz[:, 0]) > 0).all()
    assert len(set((thin.xyz[:, 0] * 10 // count).tolist())) == 10, "they are spread over the cloud"


_QUARTER = math.sqrt(0.5)


@pytest.mark.parametrize(
    ("orientation", "expected"),
    [
        ({"x": 0, "y": 0, "z": _QUARTER, "w": _QUARTER}, [[8.0, 21.0, 33.0]]),  # a quarter turn to the left
        ({"x": 0, "y": 0, "z": 0, "w": 0}, [[11.0, 22.0, 33.0]]),
        ({"x": "east"}, [[1.0, 2.0, 3.0]]),
    ],
)
def test_clouds_with_a_pose_are_in_the_frame_of_their_message(orientation: object, expected: list[list[float]]) -> None:
    message = {
        "frame_id": "base",
        "pose": {"position": {"x": 10, "y": 20, "z": 30}, "orientation": orientation},
        "point_stride": 12,
        "fields": [{"name": axis, "offset": 4 * place, "type": 7} for place, axis in enumerate("xyz")],
        "data": base64.b64encode(np.array([1, 2, 3], "<f4").tobytes()).decode(),
    }
    out = io.BytesIO()
    writer = McapWriter(out)
    channel = writer.add_channel("/cloud", writer.add_schema("foxglove.PointCloud", "jsonschema", b"{}"), "json")
    writer.add_message(channel, T0, json.dumps(message).encode())
    writer.finish()
    (thin,) = preview_of(MemorySource(out.getvalue())).clouds
    assert thin.frame_id == "base"
    np.testing.assert_allclose(thin.xyz, expected, atol=1e-5)


@pytest.mark.parametrize(
    "message",
    [
        cloud(np.zeros((2, 3)), width=1000),
        cloud(np.zeros((2, 3)), point_step=0),
        cloud(np.full((10, 3), np.nan)),
        cloud(np.zeros((0, 3))),
    ],
)
def test_broken_and_empty_clouds_have_no_points(message: TimedMessage) -> None:
    assert sum(len(one.xyz) for one in preview_of(ros2_mcap([message])).clouds) == 0


def test_logs_have_the_first_and_the_most_severe_lines() -> None:
    out = io.BytesIO()
    writer = McapWriter(out)
    channel = writer.add_channel("/log", writer.add_schema("foxglove.Log", "jsonschema", b"{}"), "json")
    for number in range(2000):
        value = {"level": 5 if number == 1500 else 3 if number > 1000 else 2, "name": "node", "message": f"m{number}"}
        writer.add_message(channel, T0 + number, json.dumps(value).encode())
    writer.finish()
    preview = preview_of(MemorySource(out.getvalue()))
    assert preview.log_line_count == 2000
    assert [line.text for line in preview.log_lines[:3]] == ["m0", "m1", "m2"]
    assert [line.text for line in preview.log_lines if line.severity is LogSeverity.fatal] == ["m1500"]
    assert len(preview.log_lines) == 600
    assert [line.time_ns for line in preview.log_lines] == sorted(line.time_ns for line in preview.log_lines)


def test_diagnostics_have_the_statuses_that_changed() -> None:
    def statuses(number: int, level: int, message: str) -> TimedMessage:
        array = {"status": [{"level": level, "name": "motor", "message": message, "values": []}]}
        return TimedMessage("/diagnostics", "diagnostic_msgs/DiagnosticArray", T0 + number, array, T0)

    changes = [(0, 0, "OK"), (1, 1, "hot"), (2, 1, "hot"), (3, 2, "broken"), (4, 0, "OK"), (5, 1, "hot")]
    preview = preview_of(ros2_mcap(statuses(*change) for change in changes))
    lines = [(line.severity.value, line.source, line.text) for line in preview.log_lines]
    assert lines == [("warning", "motor", "hot"), ("error", "motor", "broken"), ("warning", "motor", "hot")]


def test_ten_thousand_topics_are_bounded() -> None:
    out = io.BytesIO()
    writer = McapWriter(out)
    schema = writer.add_schema("a/msg/B", "ros2msg", b"float64 x")
    for number in range(10_000):
        channel = writer.add_channel(f"/topic{number:05}", schema, "cdr")
        writer.add_message(channel, T0 + number, b"\0\1\0\0" + struct.pack("<d", number))
    writer.finish()
    preview = preview_of(MemorySource(out.getvalue()))
    assert len(preview.series) == builder_module.MAX_TOPICS
    assert preview.series[7].fields[0].low.tolist() == [7]
    assert len(preview.left_out) == builder_module.MAX_LEFT_OUT


def messages_of_chunks(count: int) -> Iterable[list[tuple[str, int, bytes]]]:
    return ([("/a", T0 + number, b"data")] for number in range(count))


@pytest.mark.parametrize("source", [mcap_of([]), mcap_of(messages_of_chunks(3))])
def test_a_recording_without_anything_to_show_has_an_empty_preview(source: MemorySource) -> None:
    preview = preview_of(source)
    assert (preview.series, preview.cameras, preview.tracks, preview.log_lines, preview.clouds) == ((), (), (), (), ())


def test_a_damaged_chunk_leaves_the_others() -> None:
    source = ros2_mcap([imu(number, number) for number in range(400)], chunk_bytes=20_000)
    data = bytearray(source.read(0, source.size_bytes))
    second_chunk = data.index(b"zstd", data.index(b"zstd") + 4)
    data[second_chunk + 20 : second_chunk + 40] = b"\xff" * 20
    preview = preview_of(MemorySource(bytes(data)))
    low = values_by_field(preview, "/imu")["linear_acceleration.x"]
    assert 100 < len(low) < 400
    assert low[-1] == 399


def test_a_large_recording_is_read_in_parts_that_are_spread_over_it() -> None:
    source = ros2_mcap([imu(number, number) for number in range(2000)], chunk_bytes=5_000)
    preview = preview_of(source, PreviewLimits(whole_bytes=source.size_bytes // 4))
    low = values_by_field(preview, "/imu")["linear_acceleration.x"]
    assert 0.2 < preview.read_share < 0.6, "its index is a part of the file, and is not counted"
    assert len(low) == pytest.approx(2000 * preview.read_share, rel=0.1)
    assert max(low) > 1700
    assert min(low) < 100
    series = preview.series[0]
    messages_of_part = [
        ((first <= series.first_ns) & (series.first_ns <= last)).sum() for first, last in preview.read_spans
    ]
    assert sum(messages_of_part) == len(low), "every message is of one of the parts"
    steps = np.diff(series.first_ns)
    assert (steps > SECOND).sum() == len(preview.read_spans) - 1, "times that were not read lie between parts only"


def test_a_part_whose_reading_ended_early_ends_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(db3, "_SLICE_BYTES", 2**16)
    monkeypatch.setattr(db3, "_BLOCK_ROWS", 20)
    path = ros2_db3([imu(number, number) for number in range(1_500)], tmp_path / "bag")
    with Recording.open(path) as recording:
        limits = PreviewLimits(whole_bytes=recording.size_bytes // 2, cpu_s=0)
        preview = read_preview(make_preview(recording, limits))
    assert values_by_field(preview, "/imu")["linear_acceleration.x"] == [*range(20)]
    assert preview.read_spans.tolist() == [[T0, T0 + 19 * SECOND]]
    assert preview.read_share == pytest.approx(20 / 1_500, rel=0.2)


def test_a_recording_that_is_read_as_a_whole_names_no_parts() -> None:
    assert len(preview_of(ros2_mcap([imu(number, number) for number in range(50)])).read_spans) == 0


def test_parts_that_touch_are_one_and_of_too_many_neighbours_are_joined() -> None:
    assert builder_module.joined_spans([(20, 29), (0, 9), (10, 12), (5, 7)]).tolist() == [[0, 12], [20, 29]]
    assert builder_module.joined_spans([(number * 10, number * 10 + 5) for number in range(5)], most=3).tolist() == [
        [0, 15],
        [20, 35],
        [40, 45],
    ]
    assert builder_module.joined_spans([(1, 2**64 - 1)]).tolist() == [[1, 2**63 - 1]], "times that no index can hold"
    assert builder_module.joined_spans([]).shape == (0, 2)


@pytest.mark.parametrize("limits", [PreviewLimits(cpu_s=0), PreviewLimits(wall_s=0)])
def test_reading_ends_after_the_time_that_is_allowed(limits: PreviewLimits) -> None:
    source = ros2_mcap([imu(number, number) for number in range(5000)], chunk_bytes=5_000)
    preview = preview_of(source, limits)
    assert 0 < preview.read_share < 0.1
    assert 0 < preview.series[0].message_count < 5000
