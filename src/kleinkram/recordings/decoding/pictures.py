"""JPEG, PNG and WebP -> arrays, with pillow; nothing is unpacked before its size is known to be bounded."""

from __future__ import annotations

import io
import struct
from typing import TYPE_CHECKING, Any

from kleinkram.recordings.decoding.errors import DecodeError
from kleinkram.recordings.decoding.limits import MAX_IMAGE_PIXELS

if TYPE_CHECKING:
    from numpy.typing import NDArray

_FORMATS = ("JPEG", "PNG", "WEBP")
_DEPTH_HEADER = struct.Struct("<iff")
# What pillow is known to raise on broken pictures.
_BROKEN = (OSError, SyntaxError, ValueError, TypeError, IndexError, EOFError, OverflowError, struct.error)


def open_picture(data: Any, name: str) -> NDArray[Any]:
    """Return a compressed picture as [H, W, C]: uint8, or uint16 [H, W, 1] for 16 bits of grey.

    Raises:
        DecodeError: it is no such picture, broken, or larger than `MAX_IMAGE_PIXELS`.
    """
    import numpy as np
    from PIL import Image

    try:
        with Image.open(io.BytesIO(data), formats=_FORMATS) as picture:
            if picture.width * picture.height > MAX_IMAGE_PIXELS:
                raise DecodeError(name, f"{picture.width} x {picture.height} pixels are more than {MAX_IMAGE_PIXELS}")
            array = np.asarray(_usual(picture))
    except (Image.DecompressionBombError, Image.DecompressionBombWarning):
        raise DecodeError(name, f"a picture of more than {MAX_IMAGE_PIXELS} pixels") from None
    except _BROKEN as error:
        raise DecodeError(name, f"its picture cannot be read: {str(error)[:100]}") from None
    if array.dtype.kind in "ui" and array.dtype.itemsize > 1:
        array = array.astype(np.uint16)
    return array[..., np.newaxis] if array.ndim == 2 else array


def _usual(picture: Any) -> Any:
    """Return a picture in one of the modes that have an array of their own."""
    if picture.mode in ("L", "RGB", "RGBA") or picture.mode.startswith("I"):
        return picture
    if picture.mode == "1":
        return picture.convert("L")
    return picture.convert("RGBA" if "transparency" in picture.info or picture.mode.endswith("A") else "RGB")


def uncompressed_depth(data: Any, form: str, name: str) -> NDArray[Any]:
    """Return a `compressedDepth` picture: uint16 [H, W, 1] as stored, or float32 [H, W, 1], metres, NaN for unknown.

    Raises:
        DecodeError: it is compressed otherwise than by PNG, broken or too large.
    """
    import numpy as np

    if "rvl" in form:
        raise DecodeError(name, "depth compressed by RVL is not read")
    if len(data) < _DEPTH_HEADER.size:
        raise DecodeError(name, "its compressed depth has no header")
    _, quantum, offset = _DEPTH_HEADER.unpack_from(data)
    depth = open_picture(data[_DEPTH_HEADER.size :], name)
    if not form.startswith("32fc1"):
        return depth
    with np.errstate(divide="ignore", invalid="ignore"):
        metres = np.float32(quantum) / (depth.astype(np.float32) - np.float32(offset))
    known: NDArray[Any] = np.where(depth == 0, np.float32(np.nan), metres).astype(np.float32)
    return known
