"""Some points of a point cloud."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from kleinkram.recordings.decoding import DecodeError, points
from kleinkram.recordings.decoding.values import part, type_name
from kleinkram.recordings.previews.model import ThinnedCloud

CLOUD_TYPES = frozenset(("PointCloud2", "PointCloud"))
MAX_POINTS = 5_000
_CANDIDATES = 500_000  # points that are read of a cloud, since some are not finite
_MAX_FRAME_ID = 200


def thinned_cloud(value: object, topic: str, time_ns: int) -> ThinnedCloud:
    """Return at most `MAX_POINTS` points of the cloud in a decoded message, evenly spread over their order in it.

    Raises:
        DecodeError: it has no cloud, or one without x, y and z.
    """
    cloud = points(value).reshape(-1)
    names = cloud.dtype.names or ()
    if any(axis not in names or cloud.dtype[axis].shape for axis in "xyz"):
        raise DecodeError(type_name(value), "its points have no x, y and z")
    candidates = thinned(cloud, _CANDIDATES)
    with np.errstate(over="ignore", invalid="ignore"):
        local = np.stack([candidates[axis].astype(np.float64) for axis in "xyz"], axis=1)
        xyz = _in_frame(local, part(value, "pose")).astype(np.float32)
    xyz = xyz[np.isfinite(xyz).all(axis=1)]
    xyz = np.ascontiguousarray(thinned(xyz, MAX_POINTS))
    frame_id = str(part(part(value, "header"), "frame_id") or part(value, "frame_id") or "")
    return ThinnedCloud(topic, time_ns, _text(frame_id), len(cloud), xyz)


def thinned(rows: NDArray[Any], count: int) -> NDArray[Any]:
    """Return at most so many rows, evenly spread over their order, the same ones each time.

    Of equal parts, one row each, at random: every n-th point of a lidar may come from the same ring.
    """
    if len(rows) <= count:
        return rows
    edges = np.arange(count + 1) * len(rows) // count
    return rows[np.random.default_rng(0).integers(edges[:-1], edges[1:])]


def _in_frame(xyz: NDArray[np.float64], pose: object) -> NDArray[np.float64]:
    """Return points in the frame of their message, in which clouds of Foxglove have a pose.

    Source: B. Siciliano et al., "Robotics: Modelling, Planning and Control", section 2.6 (unit quaternions).
    """
    try:
        position, axis, (scalar,) = (
            np.array([float(part(part(pose, name), component)) for component in components])
            for name, components in (("position", "xyz"), ("orientation", "xyz"), ("orientation", "w"))
        )
    except (TypeError, ValueError, OverflowError):
        return xyz  # without a pose, or with one that is not usable
    length = float(np.sqrt(axis @ axis + scalar * scalar))
    if not np.isfinite(length) or not np.isfinite(position).all():
        return xyz
    placed: NDArray[np.float64] = xyz + position
    if length > 0:  # else it was left unset
        turn = 2 * np.cross(axis / length, xyz)
        placed += scalar / length * turn + np.cross(axis / length, turn)
    return placed


def _text(text: str) -> str:
    return text[:_MAX_FRAME_ID].encode("utf-8", "replace").decode()
