"""Thumbnails: small JPEGs of the pictures in messages."""

from __future__ import annotations

import io
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kleinkram.recordings.decoding import DecodeError, image
from kleinkram.recordings.decoding.sensor_data import compressed_image, opened_image
from kleinkram.recordings.decoding.types import MAX_IMAGE_PIXELS
from kleinkram.recordings.decoding.values import part, type_name
from kleinkram.recordings.previews.model import Thumbnail

WIDTH, MAX_HEIGHT = 160, 160
_QUALITY = 60
_OVERSIZE = 2  # pictures are subsampled to this multiple of a thumbnail before they are filtered
_BGR_ENCODINGS = ("8uc3", "8uc4")  # OpenCV's order
_BAYER = re.compile(r"bayer_([rgb]{4})(?:8|16)\Z")
_CHANNELS = {"r": 0, "g": 1, "b": 2}


def thumbnail(value: object, time_ns: int) -> Thumbnail:
    """Return the picture of a decoded message, scaled down; depth and 16-bit grey from their 1st to 99th percentile.

    Raises:
        DecodeError: it has none, it has no pixels, or it cannot be decoded.
        ReadingExtraMissing: pillow is not installed.
    """
    compressed = compressed_image(value)
    if compressed is not None and compressed[1] == "jpg":
        return _of_jpeg(compressed[0], type_name(value), time_ns)
    pixels = image(value)
    if not pixels.size:
        raise DecodeError(type_name(value), "the picture has no pixels")
    # Compressed pictures may name an encoding, too, but are decoded by their own format.
    is_raw = part(value, "height") is not None
    encoding = str(part(value, "encoding") or "").lower() if is_raw else ""
    if (bayer := _BAYER.match(encoding)) is not None:
        pixels = _demosaiced(pixels, bayer[1])
    step = max(1, pixels.shape[1] // (_OVERSIZE * WIDTH), pixels.shape[0] // (_OVERSIZE * MAX_HEIGHT))
    pixels = _eight_bit(pixels[::step, ::step])
    if encoding in _BGR_ENCODINGS:
        pixels = pixels[..., [2, 1, 0]]
    channels = 3 if pixels.shape[2] >= 3 else 1
    from PIL import Image

    plane = np.ascontiguousarray(pixels[..., :3] if channels == 3 else pixels[..., 0])
    return _encoded(Image.fromarray(plane), time_ns)


def _of_jpeg(data: Any, name: str, time_ns: int) -> Thumbnail:
    """Decode a JPEG at the smallest scale of its format that suffices."""
    with opened_image(data, name, MAX_IMAGE_PIXELS) as picture:
        if not picture.width or not picture.height:
            raise DecodeError(name, "the picture has no pixels")
        picture.draft("RGB", (_OVERSIZE * WIDTH, _OVERSIZE * MAX_HEIGHT))
        return _encoded(picture.convert("L" if picture.mode in ("L", "1") else "RGB"), time_ns)


def _encoded(picture: Any, time_ns: int) -> Thumbnail:
    out = io.BytesIO()
    picture.thumbnail((WIDTH, MAX_HEIGHT))
    picture.save(out, "JPEG", quality=_QUALITY)
    return Thumbnail(time_ns, picture.width, picture.height, out.getvalue())


def _demosaiced(mosaic: NDArray[Any], pattern: str) -> NDArray[Any]:
    """Return RGB of half the size: the red, the mean green and the blue of each square of four pixels."""
    height, width = mosaic.shape[0] // 2 * 2, mosaic.shape[1] // 2 * 2
    if not height or not width:
        return mosaic
    sums = np.zeros((height // 2, width // 2, 3), np.float32)
    counts = np.zeros(3, np.float32)
    for number, colour in enumerate(pattern):
        channel = _CHANNELS[colour]
        sums[..., channel] += mosaic[number // 2 : height : 2, number % 2 : width : 2, 0]
        counts[channel] += 1
    return (sums / np.maximum(counts, 1)).astype(mosaic.dtype)


def _eight_bit(pixels: NDArray[Any]) -> NDArray[np.uint8]:
    if pixels.dtype == np.uint8:
        return pixels
    numbers = pixels.astype(np.float32)
    known = np.isfinite(numbers) & (numbers != 0)  # 0 is "unknown" in depth images
    if not known.any():
        return np.zeros(pixels.shape, np.uint8)
    low, high = np.percentile(numbers[known], (1, 99))
    with np.errstate(invalid="ignore", over="ignore"):
        scaled = (numbers - low) / max(float(high - low), 1e-9) * 254 + 1
        shown: NDArray[np.uint8] = np.where(known, np.clip(scaled, 1, 255), 0).astype(np.uint8)
    return shown
