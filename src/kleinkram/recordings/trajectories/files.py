"""Trajectories in files: TUM, KITTI and EuRoC.

The first line with values decides: commas are a table of poses, with EuRoC's columns or with names; else 8 values are
TUM, 12 are KITTI. The unit of stamps is that of `klein inspect`: see `formats/text_files.py`.

Source: as in `kleinkram.recordings.formats.text_files`.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from kleinkram.recordings.errors import TrajectoryRefused
from kleinkram.recordings.formats.text_files import (
    are_poses,
    parse_stamp,
    read_lines,
    split_cells,
    stamp_unit_in,
    unit_of_stamp,
)
from kleinkram.recordings.sources import FileSource, SourceReader
from kleinkram.recordings.trajectories.model import PoseList, Trajectory, quaternions_of, seconds_text

if TYPE_CHECKING:
    from numpy.typing import NDArray

_TUM_VALUES, _KITTI_VALUES = 8, 12
_FORMATS = "a pose of TUM has 8 values, one of KITTI 12, and one of EuRoC at least 8 with commas between them"
_NO_NAMES = (
    "no names of columns above it, and its stamp is not EuRoC's, in nanoseconds: whether the quaternion begins with w "
    "is not known; begin the file with a line such as time,x,y,z,qx,qy,qz,qw"
)
# In ns; greater than any number of seconds, milliseconds or microseconds that is a time.
_EARLIEST_EUROC = 1e17
_ROTATION_TOLERANCE = 0.01
_SHOWN = 40


def read_file(path: str | os.PathLike[str], *, name: str | None = None) -> Trajectory:
    """Read a trajectory in the format of TUM, KITTI or EuRoC. `name`: in sentences, instead of that of the file.

    Raises:
        TrajectoryRefused: it is none, or cannot be used; the sentence names the line.
        SourceError: it cannot be read.
    """
    shown = name or Path(path).name
    with FileSource(path) as source:
        lines = _Lines(shown, SourceReader(source))
        first = lines.first_values()
        if "," in first:
            return _read_table(lines, first)
        values = len(first.split())
        if values == _TUM_VALUES:
            return _read_tum(lines)
        if values == _KITTI_VALUES:
            return _read_kitti(lines)
        raise lines.refusal(f"has {values} {'value' if values == 1 else 'values'}; {_FORMATS}")


def write_tum(trajectory: Trajectory, path: str | os.PathLike[str]) -> None:
    """Write a trajectory in the format of TUM: stamps in seconds with nine digits; other numbers are exact.

    Raises:
        TrajectoryRefused: it has no stamps.
    """
    if trajectory.stamps_ns is None:
        raise TrajectoryRefused(trajectory.name, "has no stamps, which the format of TUM requires")
    with Path(path).open("w", encoding="ascii") as file:
        file.write("# timestamp[s] x[m] y[m] z[m] qx qy qz qw\n")
        rows = zip(
            trajectory.stamps_ns.tolist(), trajectory.positions.tolist(), trajectory.orientations.tolist(), strict=True
        )
        for stamp_ns, position, orientation in rows:
            file.write(f"{seconds_text(stamp_ns)} {' '.join(map(repr, (*position, *orientation)))}\n")


class _Lines:
    """The lines of a file with values, and the number of the current one."""

    def __init__(self, name: str, reader: SourceReader) -> None:
        self.name = name
        self.number = 0
        self.comment = ""
        self._lines = enumerate(read_lines(reader), 1)
        self._first: str | None = None

    def first_values(self) -> str:
        """Return the first line with values, which `__iter__` yields again; before it, `comment` is the last one."""
        for text in self._texts():
            if text.startswith("#"):
                self.comment = text.lstrip("# ")
            else:
                self._first = text
                return text
        raise TrajectoryRefused(self.name, "has no poses")

    def skip(self) -> None:
        """Do not yield the first line again."""
        self._first = None

    def __iter__(self) -> Iterator[str]:
        if self._first is not None:
            yield self._first
        yield from (text for text in self._texts() if not text.startswith("#"))

    def _texts(self) -> Iterator[str]:
        for number, line in self._lines:
            self.number = number
            # Some programs put a byte order mark before the first line.
            if text := line.decode("utf-8-sig" if number == 1 else "utf-8", "replace").strip():
                yield text

    def refusal(self, reason: str) -> TrajectoryRefused:
        return TrajectoryRefused(self.name, f"line {self.number} {reason}")

    def numbers(self, cells: Sequence[str], count: int) -> list[float]:
        """Return the values of the current line. Raises TrajectoryRefused."""
        if len(cells) != count:
            raise self.refusal(f"is no pose: it has {len(cells)} values, not {count}")
        try:
            return [float(cell) for cell in cells]
        except ValueError:
            wrong = next(cell for cell in cells if not _is_number(cell))
            raise self.refusal(f"is no pose: {wrong[:_SHOWN]!r} is not a number") from None


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


class _Stamps:
    """Reads stamps; the first one that is not 0 decides on their unit, unless it is known."""

    def __init__(self, lines: _Lines, unit: str = "") -> None:
        self._lines, self._unit = lines, unit

    def read(self, text: str, number: float) -> int:
        try:
            if not self._unit and number:
                self._unit = unit_of_stamp(text)
            return parse_stamp(text, self._unit or "s")
        except ValueError:
            raise self._lines.refusal(f"has the stamp {text[:_SHOWN]!r}, which is not a time") from None


def _place(line: int) -> str:
    return f"line {line}"


def _read_tum(lines: _Lines) -> Trajectory:
    poses, stamps = PoseList(lines.name, _place), _Stamps(lines)
    for text in lines:
        cells = text.split()
        numbers = lines.numbers(cells, _TUM_VALUES)
        poses.add(lines.number, stamps.read(cells[0], numbers[0]), numbers[1:])
    return poses.trajectory()


def _read_kitti(lines: _Lines) -> Trajectory:
    rows: list[list[float]] = []
    places: list[int] = []
    for text in lines:
        rows.append(lines.numbers(text.split(), _KITTI_VALUES))
        places.append(lines.number)
    matrices = np.array(rows).reshape(-1, 3, 4)
    quaternions = quaternions_of(_rotations(lines.name, places, matrices))
    poses = PoseList(lines.name, _place)
    for place, position, quaternion in zip(places, matrices[:, :, 3].tolist(), quaternions.tolist(), strict=True):
        poses.add(place, None, (*position, *quaternion))
    return poses.trajectory()


def _rotations(name: str, places: Sequence[int], matrices: NDArray[np.float64]) -> NDArray[np.float64]:
    rotations: NDArray[np.float64] = matrices[:, :, :3]
    with np.errstate(invalid="ignore", over="ignore"):
        errors = np.abs(rotations.transpose(0, 2, 1) @ rotations - np.eye(3)).max(axis=(1, 2))
        is_rotation = (errors <= _ROTATION_TOLERANCE) & (np.linalg.det(rotations) > 0)
    if not is_rotation.all():
        raise TrajectoryRefused(name, f"line {places[int(np.argmin(is_rotation))]}: its matrix is no rotation")
    return rotations


def _read_table(lines: _Lines, first: str) -> Trajectory:
    names, cells = split_cells(lines.comment), split_cells(first)
    if len(names) != len(cells):
        names = []
    if not any(map(_is_number, cells)):
        names, cells = cells, []
        lines.skip()
    columns = len(names) or len(cells)
    poses, stamps = PoseList(lines.name, _place), _Stamps(lines, stamp_unit_in(names))
    order = _quaternion_order(names)
    for text in lines:
        cells = text.split(",")
        if not len(poses) and not are_poses(names, columns, [cell.encode() for cell in cells[:_TUM_VALUES]]):
            raise lines.refusal("is a row of a table whose columns are no poses; EuRoC's are time, p_x … q_z")
        cells = [cell.strip() for cell in cells[:_TUM_VALUES]]
        numbers = lines.numbers(cells, _TUM_VALUES)
        if not names and columns == _TUM_VALUES and numbers[0] < _EARLIEST_EUROC:
            raise lines.refusal(f"has {_NO_NAMES}")
        poses.add(lines.number, stamps.read(cells[0], numbers[0]), (*numbers[1:4], *(numbers[at] for at in order)))
    return poses.trajectory()


def _quaternion_order(names: Sequence[str]) -> list[int]:
    """Return the columns of x, y, z and w of the quaternion: by their names, else in the order of EuRoC."""
    axes = {match[1].lower(): at for at in range(4, min(len(names), 8)) if (match := _QUATERNION_AXIS.match(names[at]))}
    return [axes[axis] for axis in "xyzw"] if axes.keys() == set("xyzw") else [5, 6, 7, 4]


_QUATERNION_AXIS = re.compile(r"[\w.]*?([wxyz])\b", re.IGNORECASE)
