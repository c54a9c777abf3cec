"""Point clouds in messages -> structured numpy arrays.

Reads `sensor_msgs/PointCloud2` (ROS 1 and 2) and `foxglove.PointCloud` (protobuf, JSON, ROS), by their fields.
The array has the message's own field names, types and offsets: `cloud["x"]`, `cloud["intensity"]`. It is [N], or
[H, W] for an organised cloud (height above 1), and a read-only view of the message. Coordinates are metres in the
frame `header.frame_id` (`frame_id` at foxglove, whose `pose` is not applied).

Source: sensor_msgs/PointCloud2, sensor_msgs/PointField; foxglove/schemas.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from kleinkram.recordings.decoding.errors import DecodeError, ReadingExtraMissing
from kleinkram.recordings.decoding.limits import MAX_POINT_FIELDS
from kleinkram.recordings.decoding.payloads import payload, type_name, whole_number
from kleinkram.recordings.decoding.values import part

if TYPE_CHECKING:
    from numpy.typing import NDArray

_ROS_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
_FOXGLOVE_TYPES = {1: "u1", 2: "i1", 3: "u2", 4: "i2", 5: "u4", 6: "i4", 7: "f4", 8: "f8"}


def points(value: object) -> NDArray[Any]:
    """Return the point cloud that a decoded message holds, as the module says.

    Raises:
        DecodeError: it holds none, or its sizes contradict each other.
        ReadingExtraMissing: numpy is not installed.
    """
    try:
        import numpy  # noqa: F401  # only to name it where it is missing
    except ImportError:
        raise ReadingExtraMissing("numpy") from None
    if part(value, "fields") is None or part(value, "data") is None:
        raise DecodeError(type_name(value), "it holds no point cloud")
    data = payload(value)
    if part(value, "point_step") is None:
        stride = whole_number(value, "point_stride")
        dtype = _point_type(value, stride, _FOXGLOVE_TYPES, "type", "<")
        return _view((len(data) // stride,), dtype, data, (stride,))
    height, width, step, row = (whole_number(value, n) for n in ("height", "width", "point_step", "row_step"))
    dtype = _point_type(value, step, _ROS_TYPES, "datatype", ">" if part(value, "is_bigendian") else "<")
    row = max(row, width * step) if height < 2 else row
    if row < width * step or (height and width and len(data) < row * (height - 1) + width * step):
        told = f"{height} rows of {width} points of {step} bytes do not fit into {len(data)} bytes"
        raise DecodeError(type_name(value), told)
    if height < 2:
        return _view((width * height,), dtype, data, (step,))
    return _view((height, width), dtype, data, (row, step))


def _view(shape: tuple[int, ...], dtype: Any, data: Any, strides: tuple[int, ...]) -> NDArray[Any]:
    import numpy as np

    cloud: NDArray[Any] = np.ndarray(shape, dtype, data, strides=strides)
    return cloud


def _point_type(value: object, step: int, types: dict[int, str], key: str, order: str) -> Any:
    """Return the dtype of a point."""
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
            raise DecodeError(name, f"the field '{called[:40]}' of its points is there twice or has no known type")
        if offset + max(1, count) * int(kind[1]) > step:
            raise DecodeError(name, f"the field '{called[:40]}' does not fit into points of {step} bytes")
        names.append(called)
        formats.append(f"{order}{kind}" if count < 2 else (f"{order}{kind}", (count,)))
        offsets.append(offset)
    try:
        return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": step})
    except (ValueError, TypeError) as error:
        raise DecodeError(name, f"its fields are no layout of points: {error}") from None
