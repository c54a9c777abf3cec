"""Pictures in messages -> numpy arrays.

Reads `sensor_msgs/Image`, `sensor_msgs/CompressedImage` (ROS 1 and 2), `foxglove.RawImage` and
`foxglove.CompressedImage` (protobuf, JSON, ROS), by their fields. The array is [H, W, C], row 0 at the top:

- colour is uint8 [H, W, 3] in RGB order (with alpha [H, W, 4]), whatever order the encoding names; YUV becomes RGB
  (ITU-R BT.601, limited range); `rgb16` and the like are uint16;
- `mono8` is uint8 [H, W, 1], `mono16` uint16 [H, W, 1] with the values of the message;
- `8UC3`, `16UC1`, `32FC1` and the like keep their type and the order of their channels; depth pictures are in
  millimetres as `16UC1` and metres as `32FC1` (REP 118);
- a Bayer mosaic stays a mosaic: uint8 or uint16 [H, W, 1];
- JPEG, PNG and WebP give what they hold; `compressedDepth` gives its uint16 or float32 depth.

The frame is the message's `header.frame_id` (`frame_id` at foxglove), its optical frame: z forward, x right, y down.
The array may be a read-only view of the message.

Source: sensor_msgs/image_encodings.h; REP 118; compressed_depth_image_transport; foxglove/schemas.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from kleinkram.recordings.decoding.errors import DecodeError, ReadingExtraMissing
from kleinkram.recordings.decoding.limits import MAX_IMAGE_PIXELS
from kleinkram.recordings.decoding.payloads import payload, type_name, whole_number
from kleinkram.recordings.decoding.pictures import open_picture, uncompressed_depth
from kleinkram.recordings.decoding.values import part

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

_OPENCV = re.compile(r"(8|16|32|64)(U|S|F)C([1-9]\d?)?\Z")
_BAYER = re.compile(r"bayer_[rgb]{4}(8|16)\Z")
_KINDS = {"U": "u", "S": "i", "F": "f"}
_COLOURS = {"rgb": (0, 1, 2), "bgr": (2, 1, 0), "rgba": (0, 1, 2, 3), "bgra": (2, 1, 0, 3), "mono": (0,)}
_COLOUR = re.compile(r"(rgba?|bgra?|mono)(8|16)\Z")
_PACKED_YUV = {"yuv422": "uyvy", "uyvy": "uyvy", "yuv422_yuy2": "yuyv", "yuyv": "yuyv"}
_PLANAR_YUV = {"nv12": 0, "nv21": 1}


def image(value: object) -> NDArray[Any]:
    """Return the picture that a decoded message holds, as the module says.

    Raises:
        DecodeError: it holds none, its sizes contradict each other, or its encoding is not known.
        ReadingExtraMissing: numpy or pillow is not installed.
    """
    _need_numpy()
    if part(value, "encoding") is not None and part(value, "height") is not None:
        return _raw(value)
    if part(value, "format") is not None and part(value, "data") is not None:
        return _compressed(value)
    raise DecodeError(type_name(value), "it holds no picture")


def _need_numpy() -> None:
    try:
        import numpy  # noqa: F401  # only to name it where it is missing
    except ImportError:
        raise ReadingExtraMissing("numpy") from None


def _raw(value: object) -> NDArray[Any]:
    height, width, step = (whole_number(value, name) for name in ("height", "width", "step"))
    if height * width > MAX_IMAGE_PIXELS:
        raise DecodeError(type_name(value), f"{width} x {height} pixels are more than {MAX_IMAGE_PIXELS}")
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
            raise DecodeError(type_name(value), f"the encoding '{encoding[:40]}' is not read")
        return _pixels(value, f"{_KINDS[opencv[2]]}{int(opencv[1]) // 8}", height, width, int(opencv[3] or 1), step)
    raise DecodeError(type_name(value), f"the encoding '{encoding[:40]}' is not read")


def _pixels(value: object, code: str, height: int, width: int, channels: int, step: int) -> NDArray[Any]:
    """Return rows of pixels, `step` bytes apart, in the machine's byte order."""
    import numpy as np

    data = payload(value)
    dtype = np.dtype(f"{'>' if part(value, 'is_bigendian') else '<'}{code}")
    row = width * channels * dtype.itemsize
    step = step or row
    if height and (step < row or len(data) < step * (height - 1) + row):
        told = f"{height} rows of {row} bytes, {step} apart, do not fit into {len(data)} bytes"
        raise DecodeError(type_name(value), told)
    strides = (step, channels * dtype.itemsize, dtype.itemsize)
    pixels: NDArray[Any] = np.ndarray((height, width, channels), dtype, data, strides=strides)
    return pixels if dtype.isnative else pixels.astype(dtype.newbyteorder("="))


def _packed_yuv(pairs: NDArray[Any], order: str) -> NDArray[np.uint8]:
    """Two pixels share their colour: bytes [H, W, 2] in the order of "uyvy" or "yuyv"."""
    import numpy as np

    width = pairs.shape[1]
    if width % 2:
        raise DecodeError("", f"a picture in YUV 4:2:2 of {width} columns: they come in pairs")
    luma = order.index("y")
    colour = pairs[..., 1 - luma].astype(np.float32)
    u, v = (np.repeat(colour[:, start::2], 2, axis=1) for start in (0, 1))
    return _rgb(pairs[..., luma], u, v)


def _planar_yuv(planes: NDArray[Any], height: int, v_first: int) -> NDArray[np.uint8]:
    """A plane of luma, then one of colour for each four pixels."""
    import numpy as np

    width = planes.shape[1]
    if height % 2 or width % 2:
        raise DecodeError("", f"a picture in YUV 4:2:0 of {width} x {height}: pixels come in squares of four")
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


def _compressed(value: object) -> NDArray[Any]:
    form, data = str(part(value, "format")).lower(), payload(value)
    try:
        import PIL  # noqa: F401  # only to name it where it is missing
    except ImportError:
        raise ReadingExtraMissing("pillow") from None
    if "compresseddepth" in form:
        return uncompressed_depth(data, form, type_name(value))
    return open_picture(data, type_name(value))
