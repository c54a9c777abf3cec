"""Trajectories of TUM and KITTI: how many poses, from when to when, how long a way. One pass, nothing kept.

Source: TUM RGB-D file formats (`timestamp tx ty tz qx qy qz qw`, seconds and metres); KITTI odometry (the upper
3 x 4 of a pose a line, row by row, metres).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import hypot, isfinite

from kleinkram.recordings.forward import Forward
from kleinkram.recordings.model import Content, Fact, Problem, RecordingFormat, RecordingSummary
from kleinkram.recordings.other.lines import read_lines

_NS_DIGITS = 9
_NS = 1_000_000_000
_LATEST_NS = 2**63 - 1
_UNIT_TOLERANCE = 0.01
_REASONS = {
    RecordingFormat.tum: "a trajectory (TUM), not a recording",
    RecordingFormat.kitti: "a trajectory (KITTI), not a recording",
}
_COLUMNS = {RecordingFormat.tum: 8, RecordingFormat.kitti: 12}
_PLACES = {RecordingFormat.tum: (1, 2, 3), RecordingFormat.kitti: (3, 7, 11)}


@dataclass
class _Trajectory:
    poses: int = 0
    length_m: float = 0.0
    bad_lines: int = 0
    first_bad_line: int = 0
    backward: int = 0
    not_unit: int = 0
    start_ns: int | None = None
    end_ns: int | None = None
    last_place: tuple[float, ...] = field(default=())
    last_ns: int = -1


def describe_trajectory(kind: RecordingFormat, forward: Forward) -> RecordingSummary:
    """Read a whole trajectory. Its times are those of its poses, as integer nanoseconds; KITTI has none.

    Raises:
        SourceError: as `Forward.read`.
    """
    found = _Trajectory()
    for number, line in enumerate(read_lines(forward), 1):
        text = line.strip()
        if text and not text.startswith(b"#") and not _add(found, kind, text):
            found.bad_lines += 1
            found.first_bad_line = found.first_bad_line or number
    facts = [Fact("poses", found.poses), Fact("path_length", round(found.length_m, 3), "m")]
    if found.start_ns is not None and found.end_ns is not None:
        facts.append(Fact("duration", round((found.end_ns - found.start_ns) / 1e9, 6), "s"))
    return RecordingSummary(
        kind,
        Content.opaque,
        _REASONS[kind],
        start_ns=found.start_ns,
        end_ns=found.end_ns,
        problems=tuple(_problems(found)),
        facts=tuple(facts),
    )


def _add(found: _Trajectory, kind: RecordingFormat, text: bytes) -> bool:
    """Add a pose; False if the line is none."""
    cells = text.split()
    if len(cells) != _COLUMNS[kind]:
        return False
    try:
        numbers = [float(cell) for cell in cells]
        stamp = parse_seconds(cells[0].decode()) if kind is RecordingFormat.tum else None
    except (ValueError, UnicodeDecodeError):
        return False
    if not all(map(isfinite, numbers)):
        return False
    if stamp is not None:
        if stamp < found.last_ns:
            found.backward += 1
        found.last_ns = stamp
        found.start_ns = stamp if found.start_ns is None else min(found.start_ns, stamp)
        found.end_ns = stamp if found.end_ns is None else max(found.end_ns, stamp)
        found.not_unit += abs(hypot(*numbers[4:]) - 1) > _UNIT_TOLERANCE
    place = tuple(numbers[column] for column in _PLACES[kind])
    if found.last_place:
        found.length_m += hypot(*(a - b for a, b in zip(place, found.last_place, strict=True)))
    found.last_place = place
    found.poses += 1
    return True


def parse_seconds(text: str) -> int:
    """Return seconds, such as `1403638128.545096874` or `1.4e9`, as nanoseconds, without rounding by floats.

    Raises:
        ValueError: it is no number, or none that a clock can show.
    """
    whole, _, part = text.partition(".")
    if whole.isdecimal() and (part.isdecimal() or not part):
        stamp = int(whole[:20]) * _NS + int(part[:_NS_DIGITS].ljust(_NS_DIGITS, "0") or 0)
    else:
        nanoseconds = float(text) * _NS
        if not isfinite(nanoseconds):
            raise ValueError(text)
        stamp = round(nanoseconds)
    if not 0 <= stamp <= _LATEST_NS:
        raise ValueError(text)
    return stamp


def _problems(found: _Trajectory) -> list[Problem]:
    problems: list[Problem] = []
    if found.bad_lines:
        message = f"{found.bad_lines} lines are no poses"
        problems.append(Problem("lines-damaged", f"line {found.first_bad_line}", message))
    if found.backward:
        message = f"{found.backward} poses are stamped earlier than the one before"
        problems.append(Problem("out-of-order", "file", message))
    if found.not_unit:
        message = f"{found.not_unit} rotations are no unit quaternions"
        problems.append(Problem("rotation-not-unit", "file", message))
    return problems
