"""A picture to draw on, and the axes, units and colours of plots. Uses Pillow alone.

Lines are drawn at twice their size and made smaller, which smooths them. Lengths are pixels of the result.
"""

from __future__ import annotations

import io
import math
from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

INK, MUTED, GRID, BORDER = "#1f2937", "#6b7280", "#e5e7eb", "#9ca3af"
_WITHOUT_GLYPH = str.maketrans({"²": "^2", "×": "x", "–": "-", "µ": "u"})  # in the font that is part of Pillow

Box = tuple[float, float, float, float]
"""Left, top, right and bottom."""


@cache
def _font(size: float) -> Any:
    return ImageFont.load_default(size)


def printable(text: str) -> str:
    """Return a text without characters that cannot be shown on a line."""
    return "".join(character if character.isprintable() else "\ufffd" for character in text)


class Canvas:
    """A white picture of a size.

    `scale`: how much larger it is while it is drawn. `has_palette`: its colours are so similar that 255 are enough.
    """

    def __init__(self, width: float, height: float, *, scale: int = 2, has_palette: bool = True) -> None:
        self.width, self.height, self._scale, self._has_palette = width, height, scale, has_palette
        self.image = Image.new("RGB", (round(width * scale), round(height * scale)), "white")
        self._draw = ImageDraw.Draw(self.image, "RGBA")

    def text(
        self,
        x: float,
        y: float,
        text: str,
        *,
        size: float = 12,
        colour: str = INK,
        anchor: str = "la",
        room: float = 0,
    ) -> float:
        """Write a text, shortened in the middle to fit into `room` pixels if there is a limit; return its width."""
        font = _font(size * self._scale)
        text = shown = printable(text[:500]).translate(_WITHOUT_GLYPH)
        while room and len(shown) > 3 and font.getlength(shown) > room * self._scale:
            half = (len(shown) - 2) // 2
            shown = f"{text[:half]}…{text[-half:]}"
        self._draw.text((x * self._scale, y * self._scale), shown, fill=colour, font=font, anchor=anchor)
        return float(font.getlength(shown)) / self._scale

    def rising_text(self, x: float, y: float, text: str, *, size: float = 12, colour: str = MUTED) -> None:
        """Write a text that is read from below, centred on a place."""
        font = _font(size * self._scale)
        left, top, right, bottom = font.getbbox(text)
        label = Image.new("RGB", (round(right - left) + 4, round(bottom - top) + 4), "white")
        ImageDraw.Draw(label).text((2 - left, 2 - top), text, fill=colour, font=font)
        turned = label.transpose(Image.Transpose.ROTATE_90)
        self.image.paste(
            turned, (round(x * self._scale) - turned.width // 2, round(y * self._scale) - turned.height // 2)
        )

    def line(self, points: Iterable[tuple[float, float]], colour: Any, width: float = 1) -> None:
        """Draw a line through points."""
        scaled = [(x * self._scale, y * self._scale) for x, y in points]
        self._draw.line(scaled, fill=colour, width=max(1, round(width * self._scale)), joint="curve")

    def box(self, box: Box, *, fill: Any = None, outline: Any = None) -> None:
        """Draw a rectangle."""
        self._draw.rectangle([edge * self._scale for edge in box], fill=fill, outline=outline)

    def area(self, points: Sequence[tuple[float, float]], colour: Any) -> None:
        """Fill a polygon."""
        self._draw.polygon([(x * self._scale, y * self._scale) for x, y in points], fill=colour)

    def dot(self, x: float, y: float, radius: float, colour: Any) -> None:
        """Draw a filled circle."""
        edges = [
            (x - radius) * self._scale,
            (y - radius) * self._scale,
            (x + radius) * self._scale,
            (y + radius) * self._scale,
        ]
        self._draw.ellipse(edges, fill=colour, outline="white")

    def picture(self, pixels: NDArray[np.uint8], box: Box, *, is_cropped: bool = False) -> Box:
        """Draw a picture as large as fits into a box, or so that it fills it; return where it is."""
        image = Image.fromarray(np.ascontiguousarray(pixels))
        width, height = (box[2] - box[0]) * self._scale, (box[3] - box[1]) * self._scale
        factors = width / image.width, height / image.height
        factor = max(factors) if is_cropped else min(factors)
        size = max(1, round(image.width * factor)), max(1, round(image.height * factor))
        image = image.resize(size, Image.Resampling.BILINEAR)
        if is_cropped:
            left, top = (size[0] - round(width)) // 2, (size[1] - round(height)) // 2
            image = image.crop((left, top, left + round(width), top + round(height)))
        place = box[0] + (width - image.width) / 2 / self._scale, box[1] + (height - image.height) / 2 / self._scale
        self.image.paste(image, (round(place[0] * self._scale), round(place[1] * self._scale)))
        return (*place, place[0] + image.width / self._scale, place[1] + image.height / self._scale)

    def points(self, xy: NDArray[np.float64], colours: NDArray[np.uint8], box: Box, size: int) -> None:
        """Draw points [N, 2] as squares, those inside a box; later ones cover earlier ones."""
        left, top, right, bottom = (round(edge * self._scale) for edge in box)
        part = np.array(self.image.crop((left, top, right, bottom)))
        places = np.floor(xy * self._scale).astype(np.int64) - (left, top)
        for across in range(size):
            for down in range(size):
                column, row = places[:, 0] + across, places[:, 1] + down
                inside = (column >= 0) & (column < right - left) & (row >= 0) & (row < bottom - top)
                part[row[inside], column[inside]] = colours[inside]
        self.image.paste(Image.fromarray(part), (left, top))

    def small(self) -> Image.Image:
        """Return the picture in its size."""
        if self._scale == 1:
            return self.image
        return self.image.resize((round(self.width), round(self.height)), Image.Resampling.LANCZOS)

    def save(self, path: Path, max_bytes: int | None = None) -> None:
        """Write a PNG, or by the name a JPEG, whose quality is reduced until it has at most `max_bytes`."""
        image = self.small()
        if path.suffix != ".jpg":
            (image.quantize(255, dither=Image.Dither.NONE) if self._has_palette else image).save(path, optimize=True)
            return
        for quality in (85, 75, 60, 45, 30, 15):
            data = io.BytesIO()
            image.save(data, "jpeg", quality=quality, optimize=True)
            if max_bytes is None or data.tell() <= max_bytes:
                break
        path.write_bytes(data.getvalue())


def ticks(low: float, high: float, count: int) -> list[float]:
    """Return about `count` round numbers (1, 2 or 5 times a power of ten apart) of a range, its ends inclusive."""
    span = high - low
    if not math.isfinite(span) or span <= 0:
        return [low]
    magnitude = 10.0 ** math.floor(math.log10(span / count))
    step = next((factor * magnitude for factor in (1, 2, 5, 10) if factor * magnitude * count >= span), span)
    first, last = math.ceil(low / step - 1e-6), math.floor(high / step + 1e-6)
    return [number * step for number in range(first, min(last, first + 4 * count) + 1)]


def tick_texts(values: Sequence[float]) -> list[str]:
    """Return the labels of ticks, with as many decimals as distinguish them."""
    step = values[1] - values[0] if len(values) > 1 else abs(values[0])
    largest = max(map(abs, values))
    if largest >= 1e6 or 0 < step < 1e-5:
        return [f"{value:.6g}" for value in values]
    decimals = max(0, -math.floor(math.log10(step) + 1e-9)) if step > 0 else 0
    return [f"{value + 0.0:.{min(decimals, 6)}f}" for value in values]


def time_unit(seconds: float) -> tuple[float, str]:
    """Return in which unit, of how many seconds, a span is shown."""
    for limit, length, name in (
        (5e-4, 1e-6, "us"),
        (0.5, 1e-3, "ms"),
        (300, 1, "s"),
        (3 * 3600, 60, "min"),
        (72 * 3600, 3600, "h"),
    ):
        if seconds <= limit:
            return length, name
    return 86400, "days"


def clock_text(seconds: float) -> str:
    """Return a time since the start, as 12.3 s, 4:05 min or 2:04:05 h."""
    if seconds < 60:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(int(seconds), 60)
    return f"{minutes}:{rest:02} min" if minutes < 60 else f"{minutes // 60}:{minutes % 60:02}:{rest:02} h"


def time_axis(canvas: Canvas, box: Box, seconds: float, *, with_labels: bool) -> None:
    """Draw vertical grid lines, and below the box the times since the start."""
    length, name = time_unit(seconds)
    values = ticks(0, seconds / length, max(3, round((box[2] - box[0]) / 110)))
    for value, label in zip(values, tick_texts(values), strict=True):
        x = box[0] + (box[2] - box[0]) * value * length / seconds
        canvas.line([(x, box[1]), (x, box[3])], GRID)
        if with_labels:
            text = f"{label} {name}" if value == values[-1] else label
            canvas.text(max(min(x, box[2] - 12), 16), box[3] + 4, text, size=11, colour=MUTED, anchor="ma")


def coloured(values: NDArray[Any], bounds: tuple[float, float], colours: Sequence[tuple[int, int, int]]) -> Any:
    """Return values [...] as colours uint8 [..., 3]."""
    share = np.clip((np.nan_to_num(values) - bounds[0]) / (bounds[1] - bounds[0]), 0, 1)
    stops = np.linspace(0, 1, len(colours))
    return np.stack([np.interp(share, stops, [colour[part] for colour in colours]) for part in range(3)], -1).astype(
        np.uint8
    )


def colour_bar(canvas: Canvas, right: float, y: float, bounds: tuple[float, float], colours: Any, name: str) -> None:
    """Draw a bar of colours with the values at its ends, which ends at `right`."""
    width = canvas.text(right, y, f"{bounds[1]:.3g} m", size=11, colour=MUTED, anchor="ra")
    bar = coloured(np.linspace(0, 1, 80)[np.newaxis].repeat(8, 0), (0, 1), colours)
    canvas.picture(bar, (right - width - 86, y + 3, right - width - 6, y + 11))
    canvas.text(right - width - 92, y, f"{name} {bounds[0]:.3g}", size=11, colour=MUTED, anchor="ra")
