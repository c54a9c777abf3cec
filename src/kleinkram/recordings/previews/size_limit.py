"""Makes a preview fit into its size: coarser bins, fewer pictures, shorter clouds and tracks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

from kleinkram.recordings.previews.bins import halved
from kleinkram.recordings.previews.clouds import thinned
from kleinkram.recordings.previews.container import encode
from kleinkram.recordings.previews.model import LeftOutTopic, RecordingPreview

_STEPS = 7  # each about halves a part
_TOO_LARGE = "the preview would be too large"


def encode_within(preview: RecordingPreview, max_bytes: int) -> bytes:
    """Return the file of a preview, made so small that it has at most `max_bytes`."""
    empty = replace(preview, series=(), cameras=(), clouds=(), tracks=(), log_lines=())
    fitting = empty
    for part in _PARTS:
        alone = _shrunk(part.copy(preview, empty), part.shrink, int(part.share * max_bytes), empty)
        fitting = part.copy(alone, fitting)
    with_series = replace(fitting, series=preview.series)
    fitting = _shrunk(with_series, _fewer_bins, max_bytes, fitting)
    if preview.series and not fitting.series:
        fitting = _first_series(with_series, fitting, max_bytes)
    data = encode(fitting)
    if len(data) > max_bytes:  # names of topics and fields alone
        data = encode(replace(empty, left_out=(LeftOutTopic("", _TOO_LARGE),), read_spans=empty.read_spans[:0]))
    return data


def _shrunk(
    preview: RecordingPreview,
    shrink: Callable[[RecordingPreview], RecordingPreview],
    max_bytes: int,
    without: RecordingPreview,
) -> RecordingPreview:
    """Return a preview that was shrunk until it fits; `without` if that does not suffice."""
    for _ in range(_STEPS):
        size_bytes = len(encode(preview))
        if size_bytes <= max_bytes:
            return preview
        preview = shrink(preview)
    return preview if len(encode(preview)) <= max_bytes else without


def _fewer_thumbnails(preview: RecordingPreview) -> RecordingPreview:
    cameras = tuple(
        replace(strip, thumbnails=strip.thumbnails[::2] if len(strip.thumbnails) > 1 else strip.thumbnails)
        for strip in preview.cameras
    )
    if cameras == preview.cameras:  # one picture of each is too much
        cameras = cameras[: len(cameras) // 2]
    return replace(preview, cameras=cameras)


def _fewer_points(preview: RecordingPreview) -> RecordingPreview:
    clouds = (replace(cloud, xyz=thinned(cloud.xyz, (len(cloud.xyz) + 1) // 2)) for cloud in preview.clouds)
    return replace(preview, clouds=tuple(clouds))


def _fewer_positions(preview: RecordingPreview) -> RecordingPreview:
    tracks = (replace(track, times_ns=track.times_ns[::2], positions=track.positions[::2]) for track in preview.tracks)
    return replace(preview, tracks=tuple(tracks))


def _fewer_lines(preview: RecordingPreview) -> RecordingPreview:
    return replace(preview, log_lines=preview.log_lines[: len(preview.log_lines) // 2])


def _fewer_bins(preview: RecordingPreview) -> RecordingPreview:
    return replace(preview, series=tuple(map(halved, preview.series)))


def _first_series(preview: RecordingPreview, without: RecordingPreview, max_bytes: int) -> RecordingPreview:
    """Return the preview with as many of its topics, with coarse bins, as fit; the first half, quarter, and so on."""
    for _ in range(_STEPS):
        preview = _fewer_bins(preview)
    count = len(preview.series) // 2
    while count:
        left_out = tuple(LeftOutTopic(series.topic, _TOO_LARGE) for series in preview.series[count:][:100])
        shorter = replace(preview, series=preview.series[:count], left_out=preview.left_out + left_out)
        if len(encode(shorter)) <= max_bytes:
            return shorter
        count //= 2
    return without


class _Part(NamedTuple):
    """A part that may take a share of the size. `copy`: from one preview to another."""

    share: float
    shrink: Callable[[RecordingPreview], RecordingPreview]
    copy: Callable[[RecordingPreview, RecordingPreview], RecordingPreview]


# The series get what these leave over.
_PARTS = (
    _Part(0.5, _fewer_thumbnails, lambda source, to: replace(to, cameras=source.cameras)),
    _Part(0.15, _fewer_points, lambda source, to: replace(to, clouds=source.clouds)),
    _Part(0.1, _fewer_positions, lambda source, to: replace(to, tracks=source.tracks)),
    _Part(0.1, _fewer_lines, lambda source, to: replace(to, log_lines=source.log_lines)),
)
