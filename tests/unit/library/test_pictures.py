"""What is drawn where: scales, ticks, colours and shares of time."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from kleinkram.library.canvas import Canvas, clock_text, printable, tick_texts, ticks, time_unit
from kleinkram.library.curves import TimeSpan
from kleinkram.library.frames import Frame, ScanPoints, read_frame, read_scan, value_range
from kleinkram.library.pictures import CameraFrames, PlanarTrack, map_scale, track_bounds, view_distance
from kleinkram.library.preview import file_name_part, present_times, spread, view_rank
from kleinkram.recordings.decoding import DecodeError
from kleinkram.recordings.model import MessageDensity, TopicSummary

SECOND = 10**9
SPAN = TimeSpan(0, 100 * SECOND)


@pytest.mark.parametrize(
    ("low", "high", "labels"),
    [
        (0, 10, ["0", "2", "4", "6", "8", "10"]),
        (-0.31, 0.12, ["-0.3", "-0.2", "-0.1", "0.0", "0.1"]),
        (9.78, 9.84, ["9.78", "9.80", "9.82", "9.84"]),
        (101_200, 101_900, ["101200", "101400", "101600", "101800"]),
        (0, 3e-6, ["0", "1e-06", "2e-06", "3e-06"]),
        (5, 5, ["5"]),
    ],
)
def test_ticks_are_round_numbers_with_the_decimals_that_they_need(low: float, high: float, labels: list[str]) -> None:
    assert tick_texts(ticks(low, high, 5)) == labels


@pytest.mark.parametrize(("low", "high"), [(0, float("inf")), (1e300, 1.0001e300), (1, 1 + 2e-16), (-1e308, 1e308)])
def test_ticks_of_any_range_are_bounded(low: float, high: float) -> None:
    assert 1 <= len(tick_texts(ticks(low, high, 5))) <= 21


def test_times_have_the_unit_that_is_read_best() -> None:
    assert [time_unit(seconds)[1] for seconds in (0.2, 60, 1800, 20_000, 1e6)] == ["ms", "s", "min", "h", "days"]
    assert [clock_text(seconds) for seconds in (3.21, 245, 7445)] == ["3.2 s", "4:05 min", "2:04:05 h"]


def test_both_axes_of_a_map_have_one_scale() -> None:
    low, high = track_bounds([PlanarTrack("a", np.array([[0.0, 0.0], [100.0, 10.0]]))])
    scale = map_scale(low.tolist(), high.tolist(), (50, 0, 450, 400))
    corners = scale.place(np.array([[0.0, 0.0], [100.0, 0.0], [0.0, 10.0]]))
    assert corners[1, 0] - corners[0, 0] == pytest.approx(100 * scale.pixels_per_m)
    assert corners[0, 1] - corners[2, 1] == pytest.approx(10 * scale.pixels_per_m)  # y is up
    assert scale.range_m(0) == pytest.approx((-5, 105))


def test_a_track_of_one_position_has_a_scale() -> None:
    scale = map_scale((3.0, 4.0), (3.0, 4.0), (0, 0, 100, 100))
    assert scale.place(np.array([[3.0, 4.0]])).tolist() == [[50, 50]]
    assert scale.range_m(1) == pytest.approx((3, 5))


def test_stray_points_do_not_shrink_the_view_of_a_lidar() -> None:
    near = np.random.default_rng(1).uniform(-10, 10, (990, 3)).astype(np.float32)
    stray = np.full((10, 3), 5000, np.float32)
    assert 9 < view_distance([ScanPoints(0, np.concatenate([near, stray]), 1000, is_flat=False)]) <= 10
    assert view_distance([ScanPoints(0, np.empty((0, 3), np.float32), 0, is_flat=False)]) == 1


def summary(counts: tuple[int, ...], rate_hz: float) -> TopicSummary:
    density = MessageDensity(0, SECOND, counts)
    first_ns, last_ns = 0, len(counts) * SECOND
    return TopicSummary("/t", "T", "T", "", "", sum(counts), first_ns, last_ns, rate_hz, density=density)


def test_gaps_are_silence_that_is_longer_than_usual() -> None:
    assert present_times(summary((10, 10, 10, 0, 0, 0, 10, 10), 10), SPAN) == [(0, 3), (6, 8)]
    assert present_times(summary((1, 0, 1, 0, 1, 0, 0, 0, 0, 1), 0.5), SPAN) == [(0, 10)]
    assert present_times(TopicSummary("/t", "T", "T", "", "", 0), SPAN) == []


def test_the_first_and_the_last_are_among_those_that_are_spread() -> None:
    assert spread(100, 5) == [0, 25, 50, 74, 99]
    assert spread(3, 5) == [0, 1, 2]
    assert spread(9, 1) == [4]
    assert spread(0, 3) == []


def test_names_of_files_have_letters_of_the_topic_only() -> None:
    assert file_name_part("/camera/front left/image") == "-camera-front-left-image"
    assert file_name_part("///") == ""
    assert len(file_name_part("/x" * 500)) <= 61


def test_control_characters_are_not_drawn() -> None:
    assert printable("/a\n\x00\u202e\ud800b") == "/a" + "\ufffd" * 4 + "b"
    Canvas(50, 20).text(0, 0, "/a\nb", anchor="ma")


def view(topic: str, pixels: np.ndarray[tuple[int, ...], np.dtype[np.uint8]]) -> CameraFrames:
    return CameraFrames(topic, "", (Frame(0, pixels, is_depth=False, size=(8, 8), encoding="rgb8"),), ())


def test_colour_cameras_come_before_grey_ones_and_black_ones_come_last() -> None:
    noise = np.random.default_rng(1).integers(0, 255, (8, 8, 3), np.uint8)
    grey = np.repeat(noise[..., :1], 3, axis=2)
    views = [view("/black", 0 * noise), view("/grey", grey), view("/colour", noise)]
    assert [one.topic for one in sorted(views, key=view_rank)] == ["/colour", "/grey", "/black"]


def test_an_overview_is_compressed_until_it_is_small(tmp_path: Path) -> None:
    canvas = Canvas(640, 360)
    noise = np.random.default_rng(1).integers(0, 255, (360, 640, 3), np.uint8)
    canvas.picture(noise, (0, 0, 640, 360))
    canvas.save(tmp_path / "a.jpg", 60_000)
    assert (tmp_path / "a.jpg").stat().st_size <= 60_000


def test_the_range_of_values_leaves_out_what_is_unknown_and_outliers() -> None:
    values = np.array([np.nan, *[2.0] * 50, *[4.0] * 50, 1e9], np.float32)
    assert value_range([values]) == (2, 4)
    assert value_range([]) == (0, 1)
    assert value_range([np.full(3, 7, np.float32)]) == (7, 8)


def test_a_picture_of_too_many_pixels_is_not_decoded() -> None:
    out = io.BytesIO()
    Image.new("1", (7000, 7000)).save(out, "png")
    assert len(out.getvalue()) < 20_000
    with pytest.raises(DecodeError, match="7000 x 7000 pixels are more than 32000000"):
        read_frame((400, 300), 0, {"format": "png", "data": out.getvalue()})


def test_a_laser_scan_is_points_in_the_plane_of_its_sensor() -> None:
    value = {"angle_min": 0.0, "angle_max": 3.0, "angle_increment": np.pi / 2, "range_min": 0.5, "range_max": 10.0}
    scan = read_scan(0, {**value, "ranges": np.array([1.0, 2.0, 0.1, np.inf], np.float32)})
    assert scan.is_flat
    assert scan.xyz == pytest.approx(np.array([[1, 0, 0], [0, 2, 0]]), abs=1e-6)


@pytest.mark.parametrize("value", [{}, {"points": 3}, {"fields": 3, "data": b""}, {"ranges": "text"}, {"points": [{}]}])
def test_scans_of_any_content_are_refused(value: dict[str, object]) -> None:
    with pytest.raises((DecodeError, ValueError, TypeError)):
        read_scan(0, value)
