"""The plots of the reading guide as SVG, from `Recording.to_arrow` of the sample mission. Deterministic."""

import tempfile
from collections.abc import Sequence
from pathlib import Path

from kleinkram.recordings import Recording
from kleinkram.recordings.sample import generate_mcap

_WIDTH, _HEIGHT, _MARGIN = 720, 260, 46
_COLOURS = ("#1f77b4", "#d62728", "#2ca02c")
_POINTS = 400

Line = tuple[str, list[float], list[float]]


def plots() -> dict[str, str]:
    """Return the plots by file name."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "drive.mcap"
        generate_mcap(path, duration_s=10, size_bytes=3_000_000)
        with Recording.open(path) as recording:
            return {"imu.svg": _imu(recording), "path.svg": _path(recording)}


def _imu(recording: Recording) -> str:
    table = recording.to_arrow("/imu/data", fields=["linear_acceleration"])
    start = recording.start_ns or 0
    seconds = [(stamp - start) / 1e9 for stamp in table.column("log_time_ns").to_pylist()]
    lines = [(axis, seconds, table.column(f"linear_acceleration.{axis}").to_pylist()) for axis in ("x", "y", "z")]
    return _draw("/imu/data: linear acceleration, m/s² over s", lines)


def _path(recording: Recording) -> str:
    table = recording.to_arrow("/odom", fields=["pose.pose.position"])
    x, y = (table.column(f"pose.pose.position.{axis}").to_pylist() for axis in ("x", "y"))
    return _draw("/odom: y over x, m, frame odom", [("path", x, y)])


def _draw(title: str, lines: Sequence[Line]) -> str:
    xs = [x for _, line_xs, _ in lines for x in line_xs]
    ys = [y for _, _, line_ys in lines for y in line_ys]
    left, right, low, high = min(xs), max(xs), min(ys), max(ys)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {_HEIGHT}" font-family="sans-serif">',
        f'<rect width="{_WIDTH}" height="{_HEIGHT}" fill="white"/>',
        f'<text x="{_MARGIN}" y="20" font-size="14">{title}</text>',
        _text(4, _MARGIN, f"{high:.2f}"),
        _text(4, _HEIGHT - _MARGIN, f"{low:.2f}"),
        _text(_MARGIN, _HEIGHT - 24, f"{left:.1f}"),
        _text(_WIDTH - _MARGIN, _HEIGHT - 24, f"{right:.1f}"),
    ]
    for number, (name, line_xs, line_ys) in enumerate(lines):
        step = max(1, len(line_xs) // _POINTS)
        points = " ".join(
            f"{_scale(x, left, right, _MARGIN, _WIDTH - _MARGIN):.1f},"
            f"{_scale(y, low, high, _HEIGHT - _MARGIN, _MARGIN):.1f}"
            for x, y in zip(line_xs[::step], line_ys[::step], strict=True)
        )
        colour = _COLOURS[number]
        parts.append(f'<polyline fill="none" stroke="{colour}" points="{points}"/>')
        parts.append(f'<text x="{_WIDTH - 90 + 30 * number}" y="20" font-size="13" fill="{colour}">{name}</text>')
    return "\n".join([*parts, "</svg>", ""])


def _text(x: int, y: int, text: str) -> str:
    return f'<text x="{x}" y="{y}" font-size="11" fill="#555">{text}</text>'


def _scale(value: float, low: float, high: float, start: int, end: int) -> float:
    return start + (value - low) / ((high - low) or 1.0) * (end - start)
