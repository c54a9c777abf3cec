"""The pictures of a mission: contact sheets, frames over time, plots, tracks and top views of lidars."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kleinkram.library.canvas import (
    BORDER,
    GRID,
    INK,
    MUTED,
    Box,
    Canvas,
    clock_text,
    colour_bar,
    coloured,
    tick_texts,
    ticks,
    time_axis,
)
from kleinkram.library.curves import BINS, Curve, Panel, TimeSpan
from kleinkram.library.frames import Frame, ScanPoints, as_bytes, value_range

OVERVIEW = (640, 360)
MAX_OVERVIEW_BYTES = 100_000
_PRESENT, _ABSENT = "#2563eb", "#fecaca"
_AXES = {"x": "#d62728", "y": "#2ca02c", "z": "#1f77b4", "w": "#7f7f7f"}  # as tf frames are drawn
_CYCLE = (
    *("#1f77b4", "#ff7f0e", "#2ca02c", "#d62728", "#9467bd", "#8c564b"),
    *("#e377c2", "#17becf", "#bcbd22", "#7f7f7f", "#393b79", "#637939"),
)
# Viridis (CC0) for depth; darker colours for heights, since these are points on white.
_DEPTH_COLOURS = ((68, 1, 84), (59, 82, 139), (33, 145, 140), (94, 201, 98), (253, 231, 37))
_HEIGHT_COLOURS = ((49, 46, 129), (29, 99, 220), (13, 148, 136), (101, 163, 13), (217, 119, 6), (185, 28, 28))
_UNKNOWN_DEPTH = (55, 55, 60)


# -- cameras ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class CameraFrames:
    """What is shown of a camera: frames in the order of time, and the times with messages, in seconds.

    `details`: type, size, rate and number of messages, as one line.
    """

    topic: str
    details: str
    frames: tuple[Frame, ...]
    present_s: tuple[tuple[float, float], ...]

    def pictures(self) -> list[NDArray[np.uint8]]:
        """Return the frames in colours; values that are none are scaled alike in all frames."""
        bounds = self.bounds()
        return [_in_colours(frame, bounds) for frame in self.frames]

    def bounds(self) -> tuple[float, float]:
        """Return the range of values that are no colours."""
        return value_range([frame.pixels for frame in self.frames if frame.pixels.ndim == 2])


def _in_colours(frame: Frame, bounds: tuple[float, float]) -> NDArray[np.uint8]:
    if frame.pixels.ndim == 3:
        return frame.pixels
    if not frame.is_depth:
        return np.repeat(as_bytes(frame.pixels, bounds)[..., np.newaxis], 3, axis=2)
    colours = coloured(frame.pixels, bounds, _DEPTH_COLOURS)
    shown: NDArray[np.uint8] = np.where(np.isfinite(frame.pixels)[..., np.newaxis], colours, _UNKNOWN_DEPTH).astype(
        np.uint8
    )
    return shown


def contact_sheet(view: CameraFrames, span: TimeSpan) -> Canvas:
    """Return the frames of a camera in rows, each with its time."""
    columns = min(4, len(view.frames)) if len(view.frames) > 2 else 2
    tile_width = 316
    aspect = float(np.median([frame.pixels.shape[0] / frame.pixels.shape[1] for frame in view.frames]))
    tile_height = min(tile_width * 1.5, max(40, tile_width * aspect))
    rows = -(-len(view.frames) // columns)
    canvas = Canvas(columns * (tile_width + 8) + 16, 58 + rows * (tile_height + 26), scale=1)
    canvas.text(12, 10, view.topic, size=16, room=canvas.width - 24)
    has_depth = any(frame.is_depth for frame in view.frames)
    canvas.text(12, 33, view.details, size=12, colour=MUTED, room=canvas.width - (280 if has_depth else 24))
    if has_depth:
        colour_bar(canvas, canvas.width - 12, 33, view.bounds(), _DEPTH_COLOURS, "depth")
    for number, (frame, picture) in enumerate(zip(view.frames, view.pictures(), strict=True)):
        left = 12 + number % columns * (tile_width + 8)
        top = 56 + number // columns * (tile_height + 26)
        canvas.box((left, top, left + tile_width, top + tile_height), fill="#f3f4f6")
        canvas.picture(picture, (left, top, left + tile_width, top + tile_height))
        offset_s = (frame.time_ns - span.start_ns) / 1e9
        canvas.text(left + 2, top + tile_height + 4, clock_text(offset_s), size=12, colour=MUTED)
    return canvas


def camera_strip(views: Sequence[CameraFrames], span: TimeSpan) -> Canvas:
    """Return one row a camera along one time axis: frames at their times, and a bar with the times with messages."""
    left, right, row_height, frame_height = 12, 1268, 104, 66
    canvas = Canvas(1280, 40 + len(views) * row_height, scale=1)
    box = (left, 8, right, canvas.height - 28)
    time_axis(canvas, box, span.seconds, with_labels=True)
    for number, view in enumerate(views):
        top = 8 + number * row_height
        canvas.text(left, top + 2, view.topic, size=12, room=right - left)
        free = float(left)
        for frame, picture in zip(view.frames, view.pictures(), strict=True):
            width = min(180.0, frame_height * picture.shape[1] / picture.shape[0])
            x = left + (right - left) * (frame.time_ns - span.start_ns) / 1e9 / span.seconds
            ideal = min(max(left, x - width / 2), right - width)
            begin = max(free, ideal)
            if begin - ideal <= width / 3 and begin + width <= right and left <= x <= right + 1:
                canvas.picture(picture, (begin, top + 20, begin + width, top + 20 + frame_height))
                free = begin + width + 2
        _presence_bar(canvas, (left, top + 89, right, top + 97), view.present_s, span)
    return canvas


def _presence_bar(
    canvas: Canvas, box: Box, present_s: Iterable[tuple[float, float]], span: TimeSpan, absent: str = _ABSENT
) -> None:
    canvas.box(box, fill=absent)
    scale = (box[2] - box[0]) / span.seconds
    for begin_s, end_s in present_s:
        edges = [min(max(box[0] + second * scale, box[0]), box[2]) for second in (begin_s, end_s)]
        canvas.box((edges[0], box[1], max(edges[1], edges[0] + 0.5), box[3]), fill=_PRESENT)


def camera_overview(views: Sequence[CameraFrames]) -> Canvas:
    """Return up to six cameras in a grid, of each the frame with the most contrast near the middle of the drive."""
    canvas = Canvas(*OVERVIEW, scale=1)
    count = next(number for number in (6, 4, 3, 2, 1) if len(views) >= number)
    rows = 2 if count >= 4 else 1
    columns = count // rows
    width, height = (OVERVIEW[0] + 4) / columns - 4, (OVERVIEW[1] + 4) / rows - 4
    for number, view in enumerate(views[:count]):
        left, top = number % columns * (width + 4), number // columns * (height + 4)
        canvas.picture(_representative(view), (left, top, left + width, top + height), is_cropped=True)
    return canvas


def _representative(view: CameraFrames) -> NDArray[np.uint8]:
    pictures = view.pictures()
    middle = (len(pictures) - 1) / 2

    def worth(number: int) -> float:
        return float(pictures[number].std()) * (1 - 0.3 * abs(number - middle) / max(1.0, middle))

    return pictures[max(range(len(pictures)), key=worth)]


# -- plots ------------------------------------------------------------------------------------------------------------


def plots(panels: Sequence[Panel], span: TimeSpan, title: str) -> Canvas:
    """Return small plots over one time, in two columns."""
    width, height, columns = 600, 156, min(2, len(panels))
    rows = -(-len(panels) // columns)
    canvas = Canvas(columns * (width + 8) + 16, 36 + rows * height + 22)
    canvas.text(12, 9, title, size=14, room=canvas.width - 24)
    for number, panel in enumerate(panels):
        column, row = number % columns, number // columns
        left, top = 8 + column * (width + 8), 36 + row * height
        is_last = number + columns >= len(panels)
        _plot(canvas, (left, top, left + width, top + height), panel, span, with_times=is_last)
    return canvas


def plot_overview(panels: Sequence[Panel], span: TimeSpan) -> Canvas:
    """Return the first two plots, in the size of the overview."""
    canvas = Canvas(*OVERVIEW)
    count = min(2, len(panels))
    height = (OVERVIEW[1] - 30) / count
    for number, panel in enumerate(panels[:count]):
        box = (4, 6 + number * height, OVERVIEW[0] - 8, 6 + (number + 1) * height)
        _plot(canvas, box, panel, span, with_times=number == count - 1)
    return canvas


def plot_range(panel: Panel) -> tuple[float, float]:
    """Return the range of the vertical axis: that of the values, and a margin of 5 %."""
    bounds = [curve.bounds for _, curve in panel.curves]
    low, high = min(bound[0] for bound in bounds), max(bound[1] for bound in bounds)
    margin = 0.05 * (high - low) or 0.05 * abs(high) or 1.0
    return low - margin, high + margin


def _plot(canvas: Canvas, box: Box, panel: Panel, span: TimeSpan, *, with_times: bool) -> None:
    inner = (box[0] + 62, box[1] + 22, box[2] - 6, box[3] - 8)
    bounds = plot_range(panel)
    time_axis(canvas, inner, span.seconds, with_labels=with_times)
    values = ticks(*bounds, 5)
    for value, label in zip(values, tick_texts(values), strict=True):
        y = inner[3] - (inner[3] - inner[1]) * (value - bounds[0]) / (bounds[1] - bounds[0])
        canvas.line([(inner[0], y), (inner[2], y)], GRID)
        canvas.text(inner[0] - 5, y, label, size=11, colour=MUTED, anchor="rm", room=56)
    for number, (name, curve) in enumerate(panel.curves):
        _draw_curve(canvas, inner, curve, bounds, _colour_of(name, number))
    canvas.box(inner, outline=BORDER)
    names = [name for name, _ in panel.curves if name]
    room = inner[2] - inner[0]
    legend = _legend(canvas, (inner[2], box[1] + 4), names, room * 0.55)
    unit = f" [{panel.unit}]" if panel.unit else ""
    invalid = sum(curve.not_finite for _, curve in panel.curves)
    note = f", {invalid} NaN" if invalid else ""
    canvas.text(inner[0], box[1] + 4, f"{panel.topic}  {panel.field}{unit}{note}", room=room - legend - 10)


def _colour_of(name: str, number: int) -> str:
    return _AXES.get(name, _CYCLE[number % len(_CYCLE)])


def _legend(canvas: Canvas, corner: tuple[float, float], names: Sequence[str], room: float) -> float:
    """Write the names of curves, in their colours, to the left of a corner; return how wide they are."""
    width = 0.0
    shown = list(enumerate(names))
    while len(shown) > 1 and sum(7.0 * len(name) + 12 for _, name in shown) > room:
        shown.pop()
    if len(shown) < len(names):
        width += canvas.text(*corner, f"… {len(names)} curves", size=11, colour=MUTED, anchor="ra") + 8
    for number, name in reversed(shown):
        x = corner[0] - width
        width += canvas.text(x, corner[1], name, size=11, colour=_colour_of(name, number), anchor="ra", room=room) + 10
    return width


def _draw_curve(canvas: Canvas, box: Box, curve: Curve, bounds: tuple[float, float], colour: str) -> None:
    """Draw the range between the least and the greatest values, and a line through their middles."""
    used = np.flatnonzero(~np.isnan(curve.low))
    steps = np.diff(used)
    allowed = max(3.0, 3 * float(np.median(steps))) if len(steps) else 3.0
    x = box[0] + (box[2] - box[0]) * (used + 0.5) / BINS
    heights = [(np.vstack([curve.low, curve.high])[row, used] - bounds[0]) / (bounds[1] - bounds[0]) for row in (0, 1)]
    low, high = (box[3] - (box[3] - box[1]) * height for height in heights)
    for run in np.split(np.arange(len(used)), np.flatnonzero(steps > allowed) + 1):
        lower, upper = list(zip(x[run], low[run], strict=True)), list(zip(x[run], high[run], strict=True))
        if len(run) == 1:
            canvas.line([(lower[0][0], lower[0][1] + 0.5), (upper[0][0], upper[0][1] - 0.5)], colour, 1.6)
            continue
        canvas.area([*upper, *lower[::-1]], f"{colour}60")
        canvas.line(list(zip(x[run], (low[run] + high[run]) / 2, strict=True)), colour, 1)
        for place in run[low[run] - high[run] > 1]:
            canvas.line([(x[place], low[place]), (x[place], high[place])], f"{colour}70", 1)


# -- tracks and lidars ------------------------------------------------------------------------------------------------


class MapScale(NamedTuple):
    """Where metres are on a picture: y is up, and both axes have the same scale."""

    box: Box
    centre: tuple[float, float]
    pixels_per_m: float

    def place(self, xy: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return pixels [N, 2] of metres [N, 2]."""
        middle = (self.box[0] + self.box[2]) / 2, (self.box[1] + self.box[3]) / 2
        offset = (xy - np.array(self.centre)) * self.pixels_per_m
        return np.column_stack([middle[0] + offset[:, 0], middle[1] - offset[:, 1]])

    def range_m(self, axis: int) -> tuple[float, float]:
        """Return the metres that are shown along x (0) or y (1)."""
        half = (self.box[2 + axis] - self.box[axis]) / 2 / self.pixels_per_m
        return self.centre[axis] - half, self.centre[axis] + half


def map_scale(low: Sequence[float], high: Sequence[float], box: Box) -> MapScale:
    """Return the scale by which a range of x and y, at least 2 m wide, fits into a box with a margin of 5 %."""
    extent = [max(2.0, 1.1 * (high[axis] - low[axis])) for axis in (0, 1)]
    scale = min((box[2 + axis] - box[axis]) / extent[axis] for axis in (0, 1))
    return MapScale(box, ((low[0] + high[0]) / 2, (low[1] + high[1]) / 2), scale)


def _metric_grid(canvas: Canvas, scale: MapScale) -> None:
    box = scale.box
    longest = max(box[2] - box[0], box[3] - box[1])
    step_ticks = ticks(0, longest / scale.pixels_per_m, max(4, round(longest / 75)))
    step = step_ticks[1] - step_ticks[0]
    for axis in (0, 1):
        low, high = scale.range_m(axis)
        values = [number * step for number in range(math.ceil(low / step), math.floor(high / step) + 1)]
        for value, label in zip(values, tick_texts(values) if values else (), strict=True):
            if axis == 0:
                x = box[0] + (value - low) * scale.pixels_per_m
                canvas.line([(x, box[1]), (x, box[3])], GRID)
                canvas.text(x, box[3] + 4, label, size=11, colour=MUTED, anchor="ma")
            else:
                y = box[3] - (value - low) * scale.pixels_per_m
                canvas.line([(box[0], y), (box[2], y)], GRID)
                canvas.text(box[0] - 5, y, label, size=11, colour=MUTED, anchor="rm")
    canvas.box(box, outline=BORDER)


class PlanarTrack(NamedTuple):
    """A track in the plane: x and y in metres [N, 2], in the order of time."""

    name: str
    xy: NDArray[np.float64]


def track_bounds(tracks: Sequence[PlanarTrack]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the least and the greatest x and y of all tracks."""
    points = np.concatenate([track.xy for track in tracks])
    return points.min(axis=0), points.max(axis=0)


def track_map(
    tracks: Sequence[PlanarTrack], title: str, axes: tuple[str, str], size: tuple[float, float] = (760, 680)
) -> Canvas:
    """Return tracks over a metric grid, with a legend; a circle is the start, a square the end."""
    canvas = Canvas(*size)
    legend_rows = len(tracks)
    canvas.text(12, 9, title, size=14, room=size[0] - 24)
    box = (70, 34 + 16 * legend_rows, size[0] - 14, size[1] - 44)
    low, high = track_bounds(tracks)
    scale = map_scale(low.tolist(), high.tolist(), box)
    _metric_grid(canvas, scale)
    for number, track in enumerate(tracks):
        colour = _CYCLE[number % len(_CYCLE)]
        places = [(float(x), float(y)) for x, y in scale.place(track.xy)]
        canvas.line([(14, 40 + 16 * number), (34, 40 + 16 * number)], colour, 2)
        canvas.text(40, 40 + 16 * number, track.name, colour=INK, anchor="lm", room=size[0] - 60)
        if len(places) > 1:
            canvas.line(places, colour, 1.6)
        canvas.dot(*places[0], 5, colour)
        end_x, end_y = places[-1]
        canvas.box((end_x - 4, end_y - 4, end_x + 4, end_y + 4), fill=colour, outline="white")
    canvas.text((box[0] + box[2]) / 2, size[1] - 20, f"{axes[0]} [m]", colour=MUTED, anchor="ma")
    canvas.rising_text(16, (box[1] + box[3]) / 2, f"{axes[1]} [m]")
    return canvas


def top_views(
    topic: str, details: str, scans: Sequence[ScanPoints], span: TimeSpan, size: tuple[float, float] = (420, 420)
) -> Canvas:
    """Return scans from above beside each other, all in one scale; colours are heights, a cross is the sensor."""
    canvas = Canvas(max(660, len(scans) * size[0] + 16), size[1] + 60, has_palette=False)
    canvas.text(12, 9, topic, size=16, room=canvas.width - 24)
    is_flat = all(scan.is_flat for scan in scans)
    canvas.text(12, 31, details, colour=MUTED, room=canvas.width - (24 if is_flat else 240))
    bounds = value_range([scan.xyz[:, 2] for scan in scans])
    if not is_flat:
        colour_bar(canvas, canvas.width - 12, 31, bounds, _HEIGHT_COLOURS, "height")
    reach = view_distance(scans)
    for number, scan in enumerate(scans):
        left = 8 + number * size[0]
        box = (left + 44, 68, left + size[0] - 6, 52 + size[1] - 26)
        _top_view(canvas, box, scan, reach, None if is_flat else bounds)
        text = f"{clock_text((scan.time_ns - span.start_ns) / 1e9)}, {scan.total} points"
        canvas.text(box[0], 52, text, size=11, colour=MUTED, room=box[2] - box[0])
    return canvas


def view_distance(scans: Sequence[ScanPoints]) -> float:
    """Return how many metres around the sensor are shown: with 98 % of the points, at least 1 m."""
    distances = [np.abs(scan.xyz[:, :2]).max(axis=1) for scan in scans if len(scan.xyz)]
    return max(1.0, float(np.percentile(np.concatenate(distances), 98))) if distances else 1.0


def lidar_overview(scan: ScanPoints) -> Canvas:
    """Return a scan from above, in the size of the overview."""
    canvas = Canvas(*OVERVIEW)
    bounds = None if scan.is_flat else value_range([scan.xyz[:, 2]])
    _top_view(canvas, (44, 10, OVERVIEW[0] - 10, OVERVIEW[1] - 24), scan, view_distance([scan]), bounds)
    return canvas


def _top_view(canvas: Canvas, box: Box, scan: ScanPoints, reach: float, heights: tuple[float, float] | None) -> None:
    scale = map_scale((-reach, -reach), (reach, reach), box)
    _metric_grid(canvas, scale)
    xyz = scan.xyz[np.argsort(scan.xyz[:, 2], kind="stable")]
    if heights is None:
        colours = np.tile(np.array([[29, 99, 220]], np.uint8), (len(xyz), 1))
    else:
        colours = coloured(xyz[:, 2], heights, _HEIGHT_COLOURS)
    canvas.points(scale.place(xyz[:, :2].astype(np.float64)), colours, box, 3 if len(xyz) > 3000 else 4)
    ((x, y),) = scale.place(np.zeros((1, 2)))
    for across, up in ((5, 0), (0, 5)):
        canvas.line([(x - across, y - up), (x + across, y + up)], INK, 1.5)


# -- messages over time -----------------------------------------------------------------------------------------------


def message_bars(rows: Sequence[tuple[str, Sequence[tuple[float, float]]]], span: TimeSpan) -> Canvas:
    """Return when topics have messages, in the size of the overview: the first ones, one row each."""
    canvas = Canvas(*OVERVIEW)
    box = (10, 10, OVERVIEW[0] - 14, OVERVIEW[1] - 28)
    shown = rows[:10]
    height = min(60.0, (box[3] - box[1]) / len(shown))
    time_axis(canvas, box, span.seconds, with_labels=True)
    for number, (topic, present_s) in enumerate(shown):
        top = box[1] + number * height
        canvas.text(box[0], top, topic, size=11, room=box[2] - box[0])
        _presence_bar(canvas, (box[0], top + 16, box[2], top + min(height - 4, 28)), present_s, span, GRID)
    return canvas
