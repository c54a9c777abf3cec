"""Tables (CSV): columns, their names, rows; poses too if it is a trajectory as EuRoC has it. One pass, nothing kept."""

from __future__ import annotations

import csv
import re
from math import hypot

from kleinkram.recordings.forward import Forward
from kleinkram.recordings.model import Content, Fact, RecordingFormat, RecordingSummary
from kleinkram.recordings.other.lines import read_lines
from kleinkram.recordings.other.trajectories import (
    Trajectory,
    add_stamped_pose,
    trajectory_facts,
    trajectory_problems,
)

_MOST_NAMES = 64
_MAX_NAME = 128
_POSE_COLUMNS = 8
_EUROC_COLUMNS = (8, 17)
_UNIT_TOLERANCE = 0.01
_STAMP = re.compile(r"time|stamp|\bt\b", re.I)


def describe_table(forward: Forward) -> RecordingSummary:
    """Read a whole table. Its first line is a header if no cell of it is a number.

    Raises:
        SourceError: as `Forward.read`.
    """
    names: list[str] = []
    columns = rows = 0
    trajectory: Trajectory | None = None
    for number, line in enumerate(read_lines(forward), 1):
        if not line.strip():
            continue
        if columns == 0:
            # The names of EuRoC's tables stand behind a comment sign.
            cells = _cells(line.lstrip(b"#"))
            columns = len(cells)
            if line.startswith(b"#") or not any(map(_is_number, cells)):
                names = cells
                continue
        if line.startswith(b"#"):
            continue
        rows += 1
        pose = line.split(b",")[:_POSE_COLUMNS]
        if rows == 1 and _are_poses(names, columns, pose):
            trajectory = Trajectory(unit=_unit_in(names))
        if trajectory is not None and not add_stamped_pose(trajectory, pose):
            trajectory.bad_lines += 1
            trajectory.first_bad_line = trajectory.first_bad_line or number
    facts = [Fact("columns", columns), Fact("rows", rows)]
    facts += [Fact("column", name[:_MAX_NAME]) for name in names[:_MOST_NAMES] if name]
    if trajectory is None or not trajectory.poses:
        reason = "a table (CSV), not a recording"
        return RecordingSummary(RecordingFormat.csv, Content.opaque, reason, facts=tuple(facts))
    return RecordingSummary(
        RecordingFormat.csv,
        Content.opaque,
        "a trajectory (CSV), not a recording",
        start_ns=trajectory.start_ns,
        end_ns=trajectory.end_ns,
        problems=tuple(trajectory_problems(trajectory)),
        facts=(*trajectory_facts(trajectory), *facts),
    )


def _are_poses(names: list[str], columns: int, pose: list[bytes]) -> bool:
    """Say whether a table is one of poses: by the names of its columns, or without them by a quaternion of length 1."""
    if columns < _POSE_COLUMNS:
        return False
    if names:
        return bool(_STAMP.search(names[0])) and all(map(_has, names[1:4], "xyz")) and all(map(_is_turn, names[4:8]))
    try:
        numbers = [float(cell) for cell in pose]
    except ValueError:
        return False
    return columns in _EUROC_COLUMNS and abs(hypot(*numbers[4:]) - 1) < _UNIT_TOLERANCE


def _has(name: str, axis: str) -> bool:
    """Say whether a column is a place along an axis: "p_RS_R_x [m]", "tx", "position.x"."""
    return bool(re.match(rf"(p|t|pos|position|translation|)([_.]\w+)?[_.]?{axis}\b", name, re.I))


def _is_turn(name: str) -> bool:
    """Say whether a column is a part of a quaternion: "q_RS_w []", "qx", "orientation.x"."""
    return bool(re.match(r"(q|quat|quaternion|rot|rotation|orientation)([_.]\w+)?[_.]?[wxyz]\b", name, re.I))


def _unit_in(names: list[str]) -> str:
    """Return the unit that the first column's name gives; empty: the first stamp tells."""
    match = re.search(r"\[\s*(s|ms|us|ns)\s*\]", names[0]) if names else None
    return match[1] if match else ""


def _cells(line: bytes) -> list[str]:
    try:
        found = next(csv.reader([line.decode("utf-8", "replace")]), [])
    except csv.Error:
        found = line.decode("utf-8", "replace").split(",")
    return [cell.strip() for cell in found]


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
