"""A trajectory and its geometry.

Source: B. Siciliano et al., "Robotics: Modelling, Planning and Control", section 2.6 (unit quaternions); K. Shoemake,
"Animating Rotation with Quaternion Curves", 1985 (slerp).
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from kleinkram.recordings.decoding.types import ReadingExtraMissing
from kleinkram.recordings.errors import TrajectoryRefused

try:
    import numpy as np
except ImportError:
    raise ReadingExtraMissing("numpy") from None

if TYPE_CHECKING:
    from numpy.typing import NDArray

_UNIT_TOLERANCE = 0.01
_STRAIGHT_RAD = 1e-7
_NS = 10**9


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses of frame `child_frame` in frame `frame` (empty: unknown), by time.

    Attributes:
        name: of its file, topic or transforms, for people.
        stamps_ns: int64 [N], ascending; None for KITTI files, which have none.
        positions: float64 [N, 3], metres.
        orientations: float64 [N, 4], unit quaternions x, y, z, w.
    """

    name: str
    stamps_ns: NDArray[np.int64] | None
    positions: NDArray[np.float64]
    orientations: NDArray[np.float64]
    frame: str = ""
    child_frame: str = ""

    def __len__(self) -> int:
        return len(self.positions)

    @property
    def length_m(self) -> float:
        """The length of the path, in metres."""
        return float(np.linalg.norm(np.diff(self.positions, axis=0), axis=1).sum())

    def at(self, stamps_ns: NDArray[np.int64]) -> Trajectory:
        """Return the poses at other times, between the first and the last one: positions linear, orientations by slerp.

        Raises:
            TrajectoryRefused: it has no stamps.
            ValueError: a time is before the first or after the last pose.
        """
        own = self.stamps_ns
        if own is None:
            raise TrajectoryRefused(self.name, "has no stamps")
        if len(stamps_ns) and (stamps_ns[0] < own[0] or stamps_ns[-1] > own[-1]):
            raise ValueError("times outside of a trajectory have no pose")
        after = np.clip(np.searchsorted(own, stamps_ns, side="left"), min(1, len(own) - 1), len(own) - 1)
        before = np.maximum(after - 1, 0)
        shares = ((stamps_ns - own[before]) / np.maximum(own[after] - own[before], 1))[:, np.newaxis]
        positions = self.positions[before] + shares * (self.positions[after] - self.positions[before])
        orientations = _slerp(self.orientations[before], self.orientations[after], shares)
        return replace(self, stamps_ns=stamps_ns, positions=positions, orientations=orientations)

    def followed_by(self, other: Trajectory) -> Trajectory:
        """Return the poses of `other`'s child frame, which is in the child frame of this one, at the same indices.

        A trajectory of one pose is the same at all times.
        """
        turned = rotated(self.orientations, other.positions)
        return Trajectory(
            name=self.name,
            stamps_ns=other.stamps_ns if self.stamps_ns is None else self.stamps_ns,
            positions=self.positions + turned,
            orientations=_product(self.orientations, other.orientations),
            frame=self.frame,
            child_frame=other.child_frame,
        )

    def inverse(self) -> Trajectory:
        """Return the poses of `frame` in `child_frame`."""
        conjugates = self.orientations * np.array([-1.0, -1.0, -1.0, 1.0])
        return replace(
            self,
            positions=-rotated(conjugates, self.positions),
            orientations=conjugates,
            frame=self.child_frame,
            child_frame=self.frame,
        )


class PoseList:
    """Collects the poses of a trajectory, with where each of them is, for the sentences of a refusal."""

    def __init__(self, name: str, describe: Callable[[int], str]) -> None:
        """`describe`: says where a pose is, by the number that `add` got for it."""
        self._name, self._describe = name, describe
        self._places, self._stamps, self._values = array("q"), array("q"), array("d")

    def __len__(self) -> int:
        return len(self._places)

    def add(self, place: int, stamp_ns: int | None, pose: Sequence[float]) -> None:
        """Add a pose: position and quaternion (x, y, z, w)."""
        if stamp_ns is not None:
            if not 0 <= stamp_ns < 2**63:
                raise TrajectoryRefused(self._name, f"{self._describe(place)}: its stamp, {stamp_ns} ns, is not a time")
            self._stamps.append(stamp_ns)
        self._places.append(place)
        self._values.extend(pose)

    def repeats_last(self, stamp_ns: int, pose: Sequence[float]) -> bool:
        """Return whether a pose is the last one again: the same stamp and values."""
        return bool(self._stamps) and self._stamps[-1] == stamp_ns and list(self._values[-7:]) == list(pose)

    def trajectory(self, frame: str = "", child_frame: str = "") -> Trajectory:
        """Return the trajectory. Raises TrajectoryRefused."""
        values = np.array(self._values, dtype=np.float64).reshape(-1, 7)
        stamps_ns = np.array(self._stamps, dtype=np.int64) if self._stamps else None
        if not len(values):
            raise TrajectoryRefused(self._name, "has no poses")
        if stamps_ns is not None and len(stamps_ns) < len(values):
            raise TrajectoryRefused(self._name, f"{len(values) - len(stamps_ns)} of its poses have no stamps")
        self._check_values(values)
        if stamps_ns is not None:
            self._check_stamps(stamps_ns)
        norms = np.linalg.norm(values[:, 3:], axis=1, keepdims=True)
        return Trajectory(self._name, stamps_ns, values[:, :3].copy(), values[:, 3:] / norms, frame, child_frame)

    def _check_values(self, values: NDArray[np.float64]) -> None:
        finite = np.isfinite(values).all(axis=1)
        if not finite.all():
            raise TrajectoryRefused(self._name, f"{self._place(np.argmin(finite))}: its pose is NaN or infinite")
        norms = np.linalg.norm(values[:, 3:], axis=1)
        is_unit = np.abs(norms - 1) <= _UNIT_TOLERANCE
        if not is_unit.all():
            worst = int(np.argmin(is_unit))
            reason = f"its quaternion has the length {norms[worst]:.3g}, not 1"
            raise TrajectoryRefused(self._name, f"{self._place(worst)}: {reason}")

    def _check_stamps(self, stamps_ns: NDArray[np.int64]) -> None:
        if len(stamps_ns) > 1 and not stamps_ns.any():
            raise TrajectoryRefused(self._name, "its poses have no stamps: all are 0")
        steps = np.diff(stamps_ns)
        if (steps > 0).all():
            return
        later = int(np.argmax(steps <= 0)) + 1
        stamp, before = seconds_text(int(stamps_ns[later])), seconds_text(int(stamps_ns[later - 1]))
        reason = (
            f"its stamp {stamp} s is that of the pose before it, too"
            if stamp == before
            else f"its stamp {stamp} s is earlier than {before} s of the pose before it"
        )
        raise TrajectoryRefused(self._name, f"{self._place(later)}: {reason}; stamps must ascend")

    def _place(self, index: int | np.intp) -> str:
        return self._describe(self._places[int(index)])


def seconds_text(stamp_ns: int) -> str:
    """Return a stamp in seconds, with nine digits."""
    return f"{stamp_ns // _NS}.{stamp_ns % _NS:09}"


def quaternions_of(rotations: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return rotation matrices [N, 3, 3] as unit quaternions [N, 4]: x, y, z, w.

    Source: S. W. Shepperd, "Quaternion from rotation matrix", 1978: the largest component first.
    """
    rows = rotations.transpose(1, 2, 0)
    ((xx, xy, xz), (yx, yy, yz), (zx, zy, zz)) = rows
    products = np.array(
        [
            [1 + xx - yy - zz, xy + yx, xz + zx, zy - yz],
            [xy + yx, 1 - xx + yy - zz, yz + zy, xz - zx],
            [xz + zx, yz + zy, 1 - xx - yy + zz, yx - xy],
            [zy - yz, xz - zx, yx - xy, 1 + xx + yy + zz],
        ]
    )  # four times the products of each pair of components
    largest = np.argmax(np.einsum("iin->in", products), axis=0)
    chosen: NDArray[np.float64] = products[largest, :, np.arange(len(rotations))]
    unit: NDArray[np.float64] = chosen / np.linalg.norm(chosen, axis=1, keepdims=True)
    return unit


def rotations_of(orientations: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return unit quaternions [N, 4] (x, y, z, w) as rotation matrices [N, 3, 3]."""
    columns = [rotated(orientations, np.tile(axis, (len(orientations), 1))) for axis in np.eye(3)]
    return np.stack(columns, axis=2)


def rotated(orientations: NDArray[np.float64], vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return vectors [N, 3], each turned by its quaternion; of one of the two, a single one fits all of the other."""
    axes, w = orientations[:, :3], orientations[:, 3:]
    twice = 2 * np.cross(axes, vectors)
    turned: NDArray[np.float64] = vectors + w * twice + np.cross(axes, twice)
    return turned


def _product(one: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float64]:
    axes, w, other_axes, other_w = one[:, :3], one[:, 3:], other[:, :3], other[:, 3:]
    vector = w * other_axes + other_w * axes + np.cross(axes, other_axes)
    scalar = w * other_w - (axes * other_axes).sum(axis=1, keepdims=True)
    return np.concatenate([vector, scalar], axis=1)


def _slerp(one: NDArray[np.float64], other: NDArray[np.float64], shares: NDArray[np.float64]) -> NDArray[np.float64]:
    cosines = (one * other).sum(axis=1, keepdims=True)
    other = np.where(cosines < 0, -other, other)  # the shorter way
    angles = np.arccos(np.clip(np.abs(cosines), 0, 1))
    is_straight = angles < _STRAIGHT_RAD
    sines = np.where(is_straight, 1, np.sin(angles))
    first = np.where(is_straight, 1 - shares, np.sin((1 - shares) * angles) / sines)
    second = np.where(is_straight, shares, np.sin(shares * angles) / sines)
    between = first * one + second * other
    unit: NDArray[np.float64] = between / np.linalg.norm(between, axis=1, keepdims=True)
    return unit
