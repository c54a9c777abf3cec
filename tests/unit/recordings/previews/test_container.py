"""The file of a preview: it keeps every value, has at most its size, and no bytes of it are believed."""

from __future__ import annotations

import random
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from kleinkram.recordings.geo_position import GeoPosition, usable_position
from kleinkram.recordings.previews import (
    CameraStrip,
    FieldSeries,
    LeftOutTopic,
    LogLine,
    LogSeverity,
    PositionTrack,
    PreviewUnreadable,
    RecordingPreview,
    ThinnedCloud,
    Thumbnail,
    TopicSeries,
    TrackKind,
    container,
    first_position,
    preview_max_bytes,
    read_preview,
    representative_thumbnail,
)
from kleinkram.recordings.previews.container import encode
from kleinkram.recordings.previews.size_limit import encode_within

T0 = 1_700_000_000_000_000_000
_RNG = np.random.default_rng(3)


def _topic(number: int, bins: int, field_count: int) -> TopicSeries:
    first_ns = T0 + np.arange(bins) * 10
    lows = [_RNG.normal(size=bins) for _ in range(field_count)]
    series = tuple(FieldSeries(f"field{n}", low, low + 1) for n, low in enumerate(lows))
    return TopicSeries(f"/topic{number}", "a/B", 4 * bins - 1, 4, first_ns, first_ns + 5, series, is_sampled=False)


def _preview(topics: int = 3, bins: int = 50, field_count: int = 4) -> RecordingPreview:
    pictures = tuple(Thumbnail(T0 + n, 160, 120, random.Random(n).randbytes(3000)) for n in range(40))
    exact = np.array([1.5, np.nan, np.inf])
    special = TopicSeries(
        "/special",
        "a/B",
        3,
        1,
        T0 + np.arange(3),
        T0 + np.arange(3),
        (FieldSeries("constant", np.full(3, 7.25), np.full(3, 7.25)), FieldSeries("odd/name ü", exact, exact)),
        is_sampled=True,
    )
    return RecordingPreview(
        T0,
        T0 + 2**61,
        0.5,
        (special, *(_topic(number, bins, field_count) for number in range(topics))),
        (CameraStrip("/camera", 900, pictures),),
        (PositionTrack("/gnss", TrackKind.gnss, 9, T0 + np.arange(3), np.array([[47.1, 8.123456789, np.nan]] * 3)),),
        tuple(LogLine(T0 + n, "/rosout", LogSeverity.error, "node", "text " * 20) for n in range(100)),
        1234,
        (ThinnedCloud("/lidar", T0, "base", 10**6, _RNG.normal(size=(5000, 3)).astype(np.float32)),),
        (LeftOutTopic("/video", "parts of a video"),),
        T0 + np.array([[0, 5], [9, 2**61]]),
    )


def _assert_same(one: Any, other: Any) -> None:
    assert type(one) is type(other)
    if isinstance(one, tuple):
        assert len(one) == len(other)
        for part, other_part in zip(one, other, strict=True):
            _assert_same(part, other_part)
    elif isinstance(one, np.ndarray):
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)
    elif hasattr(one, "__dataclass_fields__"):
        for field in fields(one):
            _assert_same(getattr(one, field.name), getattr(other, field.name))
    else:
        assert one == other


def test_everything_is_read_back_exactly() -> None:
    preview = _preview()
    _assert_same(read_preview(encode(preview)), preview)


def test_the_picture_that_stands_for_a_recording_is_in_the_middle_of_its_busiest_camera() -> None:
    preview = _preview()
    (strip,) = preview.cameras
    rare = CameraStrip("/rare", 2, (Thumbnail(T0, 4, 3, b"rare"),))
    empty = CameraStrip("/empty", 5000, ())
    assert representative_thumbnail(encode(replace(preview, cameras=(rare, empty, strip)))) == strip.thumbnails[20]
    assert representative_thumbnail(encode(replace(preview, cameras=(empty,)))) is None
    with pytest.raises(PreviewUnreadable):
        representative_thumbnail(encode(preview)[:200])


@pytest.mark.parametrize(
    ("latitude", "longitude", "is_usable"),
    [
        (47.1, 8.1, True),
        (-90.0, 180.0, True),
        (0.0, 8.1, True),
        (0.0, 0.0, False),
        (90.1, 0.0, False),
        (47.1, -180.1, False),
        (np.nan, 8.1, False),
        (47.1, np.inf, False),
    ],
)
def test_numbers_are_a_position_only_on_earth(latitude: float, longitude: float, *, is_usable: bool) -> None:
    expected = GeoPosition(latitude, longitude) if is_usable else None
    assert usable_position(latitude, longitude) == expected


def test_the_first_position_is_the_earliest_usable_one_of_the_fixes() -> None:
    def track(topic: str, kind: TrackKind, start: int, *rows: tuple[float, float]) -> PositionTrack:
        positions = np.array([[*row, np.nan] for row in rows])
        return PositionTrack(topic, kind, len(rows), T0 + start + np.arange(len(rows)), positions)

    pose = track("/odometry", TrackKind.pose, 0, (1.0, 2.0))
    late = track("/late", TrackKind.gnss, 100, (47.2, 8.2))
    noisy = track("/noisy", TrackKind.gnss, 50, (0.0, 0.0), (np.nan, 8.0), (91.0, 8.0), (47.1, 8.1), (47.3, 8.3))
    radians = track("/radians", TrackKind.gnss, 0, (0.83, 0.15))
    made = _preview()
    types = {"/late": "gps_msgs/msg/GPSFix", "/noisy": "sensor_msgs/NavSatFix", "/radians": "driver_msgs/PVTGeodetic"}
    series = [replace(made.series[0], topic=topic, message_type=name) for topic, name in types.items()]
    preview = replace(made, series=(*made.series, *series))
    tracks = (pose, radians, late, noisy)
    assert first_position(encode(replace(preview, tracks=tracks))) == GeoPosition(47.1, 8.1)
    assert first_position(encode(replace(preview, tracks=(pose, radians)))) is None
    assert first_position(encode(replace(preview, tracks=()))) is None
    with pytest.raises(PreviewUnreadable):
        first_position(encode(preview)[:200])


@pytest.mark.parametrize("max_bytes", [5_000_000, 400_000, 100_000, 20_000, 3_000, 300])
def test_a_preview_has_at_most_its_size(max_bytes: int) -> None:
    preview = _preview(topics=40, bins=3000, field_count=3)
    data = encode_within(preview, max_bytes)
    assert len(data) <= max_bytes
    fitting = read_preview(data)
    assert (fitting.start_ns, fitting.end_ns) == (preview.start_ns, preview.end_ns)
    if max_bytes >= 20_000:
        assert fitting.cameras
        assert fitting.cameras[0].thumbnails
        assert fitting.series
    for series in fitting.series:
        (original,) = [one for one in preview.series if one.topic == series.topic]
        for field, whole in zip(series.fields, original.fields, strict=True):
            assert np.nanmin(field.low) == np.nanmin(whole.low)
            assert np.nanmax(field.high) == np.nanmax(whole.high)


@pytest.mark.parametrize(
    ("recording_bytes", "expected"), [(1000, 256_000), (10**8, 10**6), (10**9, 10**7), (5 * 10**10, 2 * 10**7)]
)
def test_the_size_is_a_share_of_the_recording(recording_bytes: int, expected: int) -> None:
    assert preview_max_bytes(recording_bytes) == expected


def test_damaged_files_have_a_named_error() -> None:
    data, rng, unreadable = encode(_preview()), random.Random(7), 0
    assert len(data) > 100_000
    for _ in range(300):
        damaged = bytearray(data)
        for _ in range(rng.randint(1, 4)):
            place = rng.randrange(600 if rng.random() < 0.7 else len(damaged))
            damaged[place] = rng.randrange(256)
        cut = len(damaged) if rng.random() < 0.7 else rng.randrange(len(damaged))
        try:
            read_preview(bytes(damaged[:cut]))
        except PreviewUnreadable:
            unreadable += 1
    assert unreadable > 100


def test_pictures_that_share_bytes_have_a_bound_together(monkeypatch: pytest.MonkeyPatch) -> None:
    data = encode(_preview())
    monkeypatch.setattr(container, "_MAX_UNPACKED_BYTES", 10**9)
    strip = read_preview(data).cameras[0]
    # Cameras may all name the same section: a small file would become large.
    many = replace(_preview(), series=(), clouds=(), tracks=(), log_lines=(), cameras=(strip,) * 3)
    monkeypatch.setattr(container, "_MAX_UNPACKED_BYTES", 2 * sum(len(one.jpeg) for one in strip.thumbnails))
    with pytest.raises(PreviewUnreadable, match="too large"):
        read_preview(encode(many))


@pytest.mark.parametrize("data", [b"", b"KLPREV1\n", b"KLPREV1\n" + b"\xff" * 8, b"\x89MCAP0\r\n" + bytes(20)])
def test_other_files_are_no_previews(data: bytes) -> None:
    with pytest.raises(PreviewUnreadable):
        read_preview(data)
