"""Pictures of cameras and scans of lidars, small enough that many of them fit into memory.

Messages are untrusted: a picture of more than `MAX_PIXELS` is refused before it is decoded.
"""

import re
from collections.abc import Callable
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from kleinkram.checks.content.probe import SampledMessage
from kleinkram.recordings.decoding import DecodeError, image, points
from kleinkram.recordings.decoding.values import part, type_name

MAX_PIXELS = 32_000_000
MAX_POINTS = 60_000  # of a scan; of more, every second, third, … is taken
LIDAR_TYPES = frozenset(("PointCloud2", "PointCloud", "LaserScan", "CustomMsg"))
_VIDEO = re.compile(r"h\.?26[45]|hevc|avc|av1|vp[89]|theora", re.IGNORECASE)
_DEPTH = re.compile(r"16uc1|32fc1|64fc1|compresseddepth")
_BAYER = re.compile(r"bayer_([rgb]{4})")
_BGR = re.compile(r"8uc[34]")  # OpenCV's order of channels
_BROKEN = (DecodeError, OverflowError, ValueError, TypeError)  # the last three: JSON has fields of any type

Item = TypeVar("Item")


class Frame(NamedTuple):
    """A picture. `pixels`: uint8 [H, W, 3] in RGB, or float32 [H, W] whose range is that of its camera; NaN: unknown.

    `is_depth`: the values are metres. `size`: width and height of the original. `encoding`: as the message names it.
    """

    time_ns: int
    pixels: NDArray[Any]
    is_depth: bool
    size: tuple[int, int]
    encoding: str


class ScanPoints(NamedTuple):
    """The points of one scan: float32 [N, 3], metres in the frame of the sensor. `total`: how many it had."""

    time_ns: int
    xyz: NDArray[np.float32]
    total: int
    is_flat: bool


class Samples(Generic[Item]):
    """Collects what `read` makes of the samples of one topic; at most `limit`."""

    def __init__(self, read: Callable[[int, object], Item], limit: int) -> None:
        self._read, self._limit = read, limit
        self.items: list[Item] = []
        self.failed = 0
        self.error = ""

    def add(self, sample: SampledMessage) -> None:
        """Take a message; what cannot be shown is counted."""
        if not sample.is_picked or len(self.items) >= self._limit:
            return
        try:
            self.items.append(self._read(sample.log_time_ns, sample.value))
        except _BROKEN as error:
            self.failed += 1
            self.error = self.error or str(error)

    def note_unread(self, reason: str) -> None:
        """Note why messages could not be read."""
        self.error = self.error or reason

    def note_damage(self, reason: str) -> None:
        """Ignore damage, which is reported for the whole recording."""


def read_frame(size: tuple[int, int], time_ns: int, value: object) -> Frame:
    """Return the picture of a decoded message, made as small as `size` (width, height). Raises DecodeError."""
    encoding = str(part(value, "encoding") or part(value, "format") or "")
    if _VIDEO.search(encoding):
        raise DecodeError(type_name(value), f"{encoding[:40]} video is not shown: only single pictures are")
    picture = image(value, max_pixels=MAX_PIXELS)
    if picture.size == 0:
        raise DecodeError(type_name(value), "the picture has no pixels")
    original = picture.shape[1], picture.shape[0]
    name = encoding.lower()
    is_depth = bool(_DEPTH.search(name)) or picture.dtype.kind == "f"
    if bayer := _BAYER.match(name):
        picture = _demosaiced(picture[..., 0], bayer[1])
    elif _BGR.match(name):
        picture = picture[..., [2, 1, 0]]
    if picture.dtype == np.uint8:
        pixels: NDArray[Any] = _reduced(picture, size)
    else:
        pixels = _scaled_values(_thinned(picture, size), name, is_depth=is_depth)
    return Frame(time_ns, pixels, is_depth, original, encoding)


def _demosaiced(mosaic: NDArray[Any], pattern: str) -> NDArray[Any]:
    """Return colours of half the size: the two greens of four pixels are averaged."""
    height, width = mosaic.shape[0] // 2 * 2, mosaic.shape[1] // 2 * 2
    if not height or not width:
        return mosaic[..., np.newaxis]
    four = [mosaic[row:height:2, column:width:2] for row in (0, 1) for column in (0, 1)]
    planes = {}
    for colour in "rgb":
        own = [plane.astype(np.float32) for plane, name in zip(four, pattern, strict=True) if name == colour]
        planes[colour] = sum(own) / len(own) if own else np.zeros_like(four[0], np.float32)
    return np.stack([planes[colour] for colour in "rgb"], axis=-1).astype(mosaic.dtype)


def _reduced(picture: NDArray[Any], size: tuple[int, int]) -> NDArray[np.uint8]:
    colours = picture[..., :3] if picture.shape[2] >= 3 else picture[..., 0]
    small = Image.fromarray(np.ascontiguousarray(colours))
    small.thumbnail(size, Image.Resampling.BOX)
    return np.asarray(small.convert("RGB"))


def _thinned(picture: NDArray[Any], size: tuple[int, int]) -> NDArray[np.float32]:
    """Return every n-th pixel of values that are no colours, which averages would falsify at edges."""
    step = max(1, -(-picture.shape[1] // size[0]), -(-picture.shape[0] // size[1]))
    with np.errstate(all="ignore"):
        thin: NDArray[np.float32] = picture[::step, ::step].astype(np.float32)
    return thin


def _scaled_values(values: NDArray[np.float32], encoding: str, *, is_depth: bool) -> NDArray[Any]:
    if values.shape[2] >= 3:
        return np.stack([as_bytes(values[..., channel], value_range([values[..., :3]])) for channel in range(3)], -1)
    plane = values[..., 0]
    plane = np.where(np.isfinite(plane), plane, np.nan)
    if not is_depth:
        return plane
    return np.where(plane > 0, plane * (0.001 if "16uc1" in encoding else 1), np.nan).astype(np.float32)


def value_range(values: list[NDArray[np.float32]]) -> tuple[float, float]:
    """Return the range of the finite values without the outermost 2 percent; (0, 1) without any."""
    finite = np.concatenate([array[np.isfinite(array)].ravel() for array in values]) if values else np.empty(0)
    if not len(finite):
        return 0.0, 1.0
    low, high = (float(bound) for bound in np.percentile(finite, (2, 98)))
    return low, high if high > low else low + 1.0


def as_bytes(values: NDArray[np.float32], bounds: tuple[float, float]) -> NDArray[np.uint8]:
    """Return values scaled from a range to 0 to 255; NaN becomes 0."""
    scaled = (np.nan_to_num(values, nan=bounds[0], posinf=bounds[1], neginf=bounds[0]) - bounds[0]) * (
        255 / (bounds[1] - bounds[0])
    )
    clipped: NDArray[np.uint8] = np.clip(scaled, 0, 255).astype(np.uint8)
    return clipped


def read_scan(time_ns: int, value: object) -> ScanPoints:
    """Return the points of a decoded message: PointCloud2, LaserScan, and lists of points. Raises DecodeError.

    Points that are not finite, or all 0, are missing returns and are left out.
    """
    is_flat = part(value, "ranges") is not None
    with np.errstate(all="ignore"):
        if is_flat:
            xyz = _points_of_ranges(value)
        elif isinstance(listed := part(value, "points"), list):
            xyz = np.array([[float(part(point, axis)) for axis in "xyz"] for point in listed], np.float32)
            xyz = xyz.reshape(-1, 3)
        else:
            xyz = _points_of_cloud(value)
        xyz = xyz[np.isfinite(xyz).all(axis=1) & xyz.any(axis=1)]
    return ScanPoints(time_ns, xyz[:: max(1, -(-len(xyz) // MAX_POINTS))], len(xyz), is_flat)


def _points_of_cloud(value: object) -> NDArray[np.float32]:
    cloud = points(value).reshape(-1)
    names = [axis for axis in "xyz" if axis in (cloud.dtype.names or ()) and cloud.dtype[axis].shape == ()]
    if not {"x", "y"} <= set(names):
        raise DecodeError(type_name(value), "its points have no x and y")
    axes = [cloud[axis].astype(np.float32) for axis in names]
    return np.stack([*axes, *[np.zeros(len(cloud), np.float32)] * (3 - len(axes))], axis=-1)


def _points_of_ranges(value: object) -> NDArray[np.float32]:
    ranges = np.asarray(part(value, "ranges"), np.float64).ravel()
    begin, end = (_number(value, *names) for names in (("angle_min", "start_angle"), ("angle_max", "end_angle")))
    step = _number(value, "angle_increment") or (end - begin) / max(1, len(ranges) - 1)
    nearest, farthest = _number(value, "range_min"), _number(value, "range_max") or np.inf
    ranges = np.where((ranges > 0) & (ranges >= nearest) & (ranges <= farthest), ranges, np.nan)
    angles = begin + step * np.arange(len(ranges))
    return np.stack([ranges * np.cos(angles), ranges * np.sin(angles), 0 * ranges], axis=-1).astype(np.float32)


def _number(value: object, *names: str) -> float:
    values = (part(value, name) for name in names)
    return float(next((number for number in values if number is not None), 0.0))
