"""Images and point clouds in messages as numpy arrays.

`image` reads `sensor_msgs/Image`, `sensor_msgs/CompressedImage` (ROS 1 and 2), `foxglove.RawImage` and
`foxglove.CompressedImage` (protobuf, JSON, ROS), by their fields. The array is [H, W, C], row 0 at the top:

- colour is uint8 [H, W, 3] in RGB order (with alpha [H, W, 4]), whatever order the encoding names; YUV becomes RGB
  (ITU-R BT.601, limited range); `rgb16` and similar encodings are uint16;
- `mono8` is uint8 [H, W, 1], `mono16` uint16 [H, W, 1] with the values of the message;
- `8UC3`, `16UC1`, `32FC1` and similar encodings keep their type and channel order; depth images are in millimetres as
  `16UC1` and metres as `32FC1` (REP 118);
- a Bayer mosaic stays a mosaic: uint8 or uint16 [H, W, 1];
- JPEG, PNG and WebP have their own channels; `compressedDepth` gives its uint16 or float32 depth.

The frame is the message's `header.frame_id` (`frame_id` for foxglove), its optical frame: z forward, x right, y down.

`points` reads `sensor_msgs/PointCloud2` (ROS 1 and 2) and `foxglove.PointCloud` (protobuf, JSON, ROS), by their fields.
The array has the message's own field names, types and offsets: `cloud["x"]`, `cloud["intensity"]`. It is [N], or
[H, W] for an organised cloud (height above 1). Coordinates are metres in the frame `header.frame_id` (`frame_id` for
foxglove, whose `pose` is not applied).

Arrays may be read-only views of the message. Compressed images are decoded only once their size is known and bounded.

Source: sensor_msgs/image_encodings.h; sensor_msgs/PointCloud2, sensor_msgs/PointField; REP 118;
compressed_depth_image_transport; foxglove/schemas.
"""

from __future__ import annotations

import io
import re
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import TYPE_CHECKING, Any

from kleinkram.recordings.decoding.types import MAX_IMAGE_PIXELS, MAX_POINT_FIELDS, DecodeError, ReadingExtraMissing
from kleinkram.recordings.decoding.values import part, payload, type_name, whole_number

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from PIL import Image


CAMERA_TYPES = frozenset(("Image", "CompressedImage", "RawImage"))
"""Types of single pictures, without their package."""

VIDEO_TYPES = frozenset(("CompressedVideo", "FFMPEGPacket", "Packet"))
"""Types of parts of a video, which are no pictures by themselves."""

_FORMATS = ("JPEG", "PNG", "WEBP")
_SIGNATURES = {b"\xff\xd8\xff": "jpg", b"\x89PNG\r\n\x1a\n": "png"}
_DEPTH_HEADER = struct.Struct("<iff")
# Exceptions that pillow raises for broken images.
_BROKEN = (OSError, SyntaxError, ValueError, TypeError, IndexError, EOFError, OverflowError, struct.error)


def decode_image(data: Any, name: str, max_pixels: int) -> NDArray[Any]:
    """Return a compressed image as [H, W, C]: uint8, or uint16 [H, W, 1] for 16 bits of grey."""
    import numpy as np

    with opened_image(data, name, max_pixels) as opened:
        picture = opened
        if picture.mode == "1":
            picture = picture.convert("L")
        elif picture.mode not in ("L", "RGB", "RGBA") and not picture.mode.startswith("I"):
            has_alpha = "transparency" in picture.info or picture.mode.endswith("A")
            picture = picture.convert("RGBA" if has_alpha else "RGB")
        array = np.asarray(picture)
    if array.dtype.kind in "ui" and array.dtype.itemsize > 1:
        array = array.astype(np.uint16)
    return array[..., np.newaxis] if array.ndim == 2 else array


def compressed_image(value: object) -> tuple[memoryview, str, tuple[int, int]] | None:
    """Return the JPEG or PNG that a decoded message holds, its format ("jpg", "png"), and its width and height.

    Also that of a 16-bit `compressedDepth`. Decodes no pixel. None for other messages.

    Raises:
        DecodeError: its header cannot be read, or says that it is too large.
        ReadingExtraMissing: pillow is not installed.
    """
    if part(value, "encoding") is not None or part(value, "format") is None or part(value, "data") is None:
        return None
    form, data = str(part(value, "format")).lower(), memoryview(payload(value))
    if "compresseddepth" in form and not form.startswith("32fc1"):
        data = data[_DEPTH_HEADER.size :]
    for signature, suffix in _SIGNATURES.items():
        if data[: len(signature)] == signature:
            _require("PIL", "pillow")
            with opened_image(data, type_name(value), MAX_IMAGE_PIXELS) as opened:
                return data, suffix, opened.size
    return None


@contextmanager
def opened_image(data: Any, name: str, max_pixels: int) -> Iterator[Image.Image]:
    """Yield a compressed image whose size is bounded; what fails in the block becomes a `DecodeError`, too."""
    from PIL import Image

    try:
        with Image.open(io.BytesIO(data), formats=_FORMATS) as opened:
            if opened.width * opened.height > max_pixels:
                raise DecodeError(name, f"{opened.width} x {opened.height} pixels are more than {max_pixels}")
            yield opened
    except (Image.DecompressionBombError, Image.DecompressionBombWarning):
        raise DecodeError(name, f"an image of more than {max_pixels} pixels") from None
    except _BROKEN as error:
        raise DecodeError(name, f"its image cannot be read: {str(error)[:100]}") from None


def uncompressed_depth(data: Any, form: str, name: str, max_pixels: int) -> NDArray[Any]:
    """Return a `compressedDepth` image: uint16 [H, W, 1] as stored, or float32 [H, W, 1], metres, NaN for unknown."""
    import numpy as np

    if "rvl" in form:
        raise DecodeError(name, "RVL-compressed depth is not supported")
    if len(data) < _DEPTH_HEADER.size:
        raise DecodeError(name, "its compressed depth has no header")
    _, quantum, offset = _DEPTH_HEADER.unpack_from(data)
    depth = decode_image(data[_DEPTH_HEADER.size :], name, max_pixels)
    if not form.startswith("32fc1"):
        return depth
    with np.errstate(divide="ignore", invalid="ignore"):
        metres = np.float32(quantum) / (depth.astype(np.float32) - np.float32(offset))
    known: NDArray[Any] = np.where(depth == 0, np.float32(np.nan), metres).astype(np.float32)
    return known


_OPENCV = re.compile(r"(8|16|32|64)(U|S|F)C([1-9]\d?)?\Z")
_BAYER = re.compile(r"bayer_[rgb]{4}(8|16)\Z")
_KINDS = {"U": "u", "S": "i", "F": "f"}
_COLOURS = {"rgb": (0, 1, 2), "bgr": (2, 1, 0), "rgba": (0, 1, 2, 3), "bgra": (2, 1, 0, 3), "mono": (0,)}
_COLOUR = re.compile(r"(rgba?|bgra?|mono)(8|16)\Z")
_PACKED_YUV = {"yuv422": "uyvy", "uyvy": "uyvy", "yuv422_yuy2": "yuyv", "yuyv": "yuyv"}
_PLANAR_YUV = {"nv12": 0, "nv21": 1}


def image(value: object, *, max_pixels: int = MAX_IMAGE_PIXELS) -> NDArray[Any]:
    """Return the image of a decoded message (see the module).

    Raises:
        DecodeError: it has none, its sizes are inconsistent, it has too many pixels, or its encoding is unknown.
        ReadingExtraMissing: numpy or pillow is not installed.
    """
    _require("numpy")
    if part(value, "encoding") is not None and part(value, "height") is not None:
        return _raw(value, max_pixels)
    if part(value, "format") is None or part(value, "data") is None:
        raise DecodeError(type_name(value), "it has no image")
    _require("PIL", "pillow")
    form, data = str(part(value, "format")).lower(), payload(value)
    if "compresseddepth" in form:
        return uncompressed_depth(data, form, type_name(value), max_pixels)
    return decode_image(data, type_name(value), max_pixels)


def _require(module: str, library: str = "") -> None:
    try:
        import_module(module)
    except ImportError:
        raise ReadingExtraMissing(library or module) from None


def _raw(value: object, max_pixels: int) -> NDArray[Any]:
    height, width, step = (whole_number(value, name) for name in ("height", "width", "step"))
    if height * width > max_pixels:
        raise DecodeError(type_name(value), f"{width} x {height} pixels are more than {max_pixels}")
    encoding = str(part(value, "encoding"))
    name = encoding.lower()
    if name in _PACKED_YUV:
        return _packed_yuv(_pixels(value, "u1", height, width, 2, step), _PACKED_YUV[name])
    if name in _PLANAR_YUV:
        return _planar_yuv(_pixels(value, "u1", height + height // 2, width, 1, step), height, _PLANAR_YUV[name])
    if colour := _COLOUR.match(name):
        order = _COLOURS[colour[1]]
        pixels = _pixels(value, f"u{int(colour[2]) // 8}", height, width, len(order), step)
        return pixels[..., [2, 1, 0, *order[3:]]] if order[0] == 2 else pixels
    if bayer := _BAYER.match(name):
        return _pixels(value, f"u{int(bayer[1]) // 8}", height, width, 1, step)
    if opencv := _OPENCV.match(encoding.upper()):
        if opencv[2] == "F" and int(opencv[1]) < 32:
            raise DecodeError(type_name(value), f"the encoding '{encoding[:40]}' is not supported")
        return _pixels(value, f"{_KINDS[opencv[2]]}{int(opencv[1]) // 8}", height, width, int(opencv[3] or 1), step)
    raise DecodeError(type_name(value), f"the encoding '{encoding[:40]}' is not supported")


def _pixels(value: object, code: str, height: int, width: int, channels: int, step: int) -> NDArray[Any]:
    """Return rows of pixels, `step` bytes apart, in the machine's byte order."""
    import numpy as np

    data = payload(value)
    dtype = np.dtype(f"{'>' if part(value, 'is_bigendian') else '<'}{code}")
    row = width * channels * dtype.itemsize
    step = step or row
    if height and (step < row or len(data) < step * (height - 1) + row):
        problem = f"{height} rows of {row} bytes, {step} apart, do not fit into {len(data)} bytes"
        raise DecodeError(type_name(value), problem)
    strides = (step, channels * dtype.itemsize, dtype.itemsize)
    pixels: NDArray[Any] = np.ndarray((height, width, channels), dtype, data, strides=strides)
    return pixels if dtype.isnative else pixels.astype(dtype.newbyteorder("="))


def _packed_yuv(pairs: NDArray[Any], order: str) -> NDArray[np.uint8]:
    """Decode bytes [H, W, 2], where two pixels share their colour, in the order "uyvy" or "yuyv"."""
    import numpy as np

    width = pairs.shape[1]
    if width % 2:
        raise DecodeError("", f"a YUV 4:2:2 image of {width} columns: the number must be even")
    luma = order.index("y")
    colour = pairs[..., 1 - luma].astype(np.float32)
    u, v = (np.repeat(colour[:, start::2], 2, axis=1) for start in (0, 1))
    return _rgb(pairs[..., luma], u, v)


def _planar_yuv(planes: NDArray[Any], height: int, v_first: int) -> NDArray[np.uint8]:
    """Decode a plane of luma followed by one of colour for each square of four pixels."""
    import numpy as np

    width = planes.shape[1]
    if height % 2 or width % 2:
        raise DecodeError("", f"a YUV 4:2:0 image of {width} x {height}: both must be even")
    colour = planes[height:, :, 0].reshape(height // 2, width // 2, 2).astype(np.float32)
    u, v = (np.repeat(np.repeat(colour[..., which], 2, axis=0), 2, axis=1) for which in (v_first, 1 - v_first))
    return _rgb(planes[:height, :, 0], u, v)


def _rgb(luma: NDArray[Any], u: NDArray[Any], v: NDArray[Any]) -> NDArray[np.uint8]:
    import numpy as np

    y = (luma.astype(np.float32) - 16) * np.float32(255 / 219)
    u, v = u - 128, v - 128
    rgb = np.stack([y + 1.596 * v, y - 0.392 * u - 0.813 * v, y + 2.017 * u], axis=-1)
    bounded: NDArray[np.uint8] = np.clip(np.rint(rgb), 0, 255).astype(np.uint8)
    return bounded


_ROS_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
_FOXGLOVE_TYPES = {1: "u1", 2: "i1", 3: "u2", 4: "i2", 5: "u4", 6: "i4", 7: "f4", 8: "f8"}


def points(value: object) -> NDArray[Any]:
    """Return the point cloud of a decoded message (see the module).

    Raises:
        DecodeError: it has none, or its sizes are inconsistent.
        ReadingExtraMissing: numpy is not installed.
    """
    _require("numpy")
    if part(value, "fields") is None or part(value, "data") is None:
        raise DecodeError(type_name(value), "it has no point cloud")
    data = payload(value)
    if part(value, "point_step") is None:
        stride = whole_number(value, "point_stride")
        dtype = _point_type(value, stride, _FOXGLOVE_TYPES, "type", "<")
        return _view((len(data) // stride,), dtype, data, (stride,))
    height, width, step, row = (whole_number(value, n) for n in ("height", "width", "point_step", "row_step"))
    dtype = _point_type(value, step, _ROS_TYPES, "datatype", ">" if part(value, "is_bigendian") else "<")
    row = max(row, width * step) if height < 2 else row
    if row < width * step or (height and width and len(data) < row * (height - 1) + width * step):
        problem = f"{height} rows of {width} points of {step} bytes do not fit into {len(data)} bytes"
        raise DecodeError(type_name(value), problem)
    if height < 2:
        return _view((width * height,), dtype, data, (step,))
    return _view((height, width), dtype, data, (row, step))


def _view(shape: tuple[int, ...], dtype: Any, data: Any, strides: tuple[int, ...]) -> NDArray[Any]:
    import numpy as np

    cloud: NDArray[Any] = np.ndarray(shape, dtype, data, strides=strides)
    return cloud


def _point_type(value: object, step: int, types: dict[int, str], key: str, order: str) -> Any:
    import numpy as np

    name = type_name(value)
    names: list[str] = []
    formats: list[Any] = []
    offsets: list[int] = []
    fields = part(value, "fields")
    if not 0 < len(fields) <= MAX_POINT_FIELDS:
        raise DecodeError(name, f"its points have {len(fields)} fields")
    for field in fields:
        called, offset = str(part(field, "name")), whole_number(field, "offset")
        count = whole_number(field, "count") if part(field, "count") is not None else 1
        kind = types.get(whole_number(field, key))
        if kind is None or called in names:
            raise DecodeError(name, f"the field '{called[:40]}' of its points is duplicated or has an unknown type")
        if offset + max(1, count) * int(kind[1]) > step:
            raise DecodeError(name, f"the field '{called[:40]}' does not fit into points of {step} bytes")
        names.append(called)
        formats.append(f"{order}{kind}" if count < 2 else (f"{order}{kind}", (count,)))
        offsets.append(offset)
    try:
        return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": step})
    except (ValueError, TypeError) as error:
        raise DecodeError(name, f"its fields are not a valid point layout: {error}") from None
