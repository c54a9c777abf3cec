"""Text files that hold no messages: YAML, JSON, trajectories (TUM, KITTI, EuRoC) and tables (CSV), in one pass.

TUM's stamps are seconds; many tools write milliseconds, microseconds or nanoseconds instead. The first stamp that
is not 0 decides: the largest unit in which it lies before 2262, the last year that int64 nanoseconds hold.

Source: TUM RGB-D file formats (`timestamp tx ty tz qx qy qz qw`, seconds and metres); KITTI odometry (the upper
3 x 4 of a pose a line, row by row, metres); EuRoC MAV's state_groundtruth_estimate0/data.csv (nanoseconds, place,
quaternion with w first, then 9 more columns) and vicon0/data.csv (the first 8 of them).
"""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from decimal import Decimal
from functools import lru_cache
from math import hypot, isfinite

from kleinkram.recordings.formats.base import HEAD_BYTES, Format
from kleinkram.recordings.limits import WINDOW
from kleinkram.recordings.model import Content, Fact, Problem, RecordingFormat, RecordingSummary, counted
from kleinkram.recordings.sources import SequentialReader

MAX_LINE_BYTES = 64 * 2**10


def read_lines(reader: SequentialReader) -> Iterator[bytes]:
    """Yield lines without their end, empty ones too; at most `MAX_LINE_BYTES` of each."""
    rest = b""
    is_cut = False
    while block := reader.read(WINDOW):
        *lines, last = block.split(b"\n")
        for line in lines:
            if not is_cut:
                yield (rest + line)[:MAX_LINE_BYTES].rstrip(b"\r")
            rest, is_cut = b"", False
        rest += last
        if len(rest) > MAX_LINE_BYTES and not is_cut:
            yield rest[:MAX_LINE_BYTES]
            is_cut = True
        rest = b"" if is_cut else rest
    if rest and not is_cut:
        yield rest.rstrip(b"\r")


MAX_JSON_BYTES = 8 * 2**20
_YAML_KEY = re.compile(rb"""(?P<quote>["']?)(?P<key>[^\s#\-"'\[{][^:#"']*)(?P=quote)\s*:(\s|$)""")
_MOST_KEYS = 10_000
_LISTED_KEYS = 64
_MAX_NAME = 128
_CALIBRATION_KEYS = {"camera_matrix", "distortion_coefficients"}
_KALIBR_KEYS = (b"camera_model:", b"intrinsics:", b"distortion_coeffs:")


def describe_yaml(reader: SequentialReader) -> RecordingSummary:
    """Count the top-level keys of a YAML file."""
    keys: dict[str, None] = {}
    kalibr: set[bytes] = set()
    for line in read_lines(reader):
        match = _YAML_KEY.match(line)
        if match is not None and len(keys) < _MOST_KEYS:
            keys[match["key"].decode("utf-8", "replace").strip()[:_MAX_NAME]] = None
        kalibr.update(key for key in _KALIBR_KEYS if line.strip().startswith(key))
    facts = [Fact("keys", len(keys)), *(Fact("key", key) for key in list(keys)[:_LISTED_KEYS])]
    is_kalibr = "cam0" in keys and len(kalibr) == len(_KALIBR_KEYS)
    if is_kalibr or keys.keys() >= _CALIBRATION_KEYS:
        facts.insert(0, Fact("kind", "camera calibration"))
    return RecordingSummary(RecordingFormat.yaml, Content.opaque, YAML.description, facts=tuple(facts))


def describe_json(reader: SequentialReader) -> RecordingSummary:
    """Count the top-level items of a JSON file of at most `MAX_JSON_BYTES`."""
    facts: list[Fact] = []
    problems: list[Problem] = []
    if reader.size_bytes <= MAX_JSON_BYTES:
        pieces: list[bytes] = []
        while piece := reader.read(MAX_JSON_BYTES):
            pieces.append(piece)
        try:
            document = json.loads(b"".join(pieces))
        except (ValueError, RecursionError):
            problems.append(Problem("json-damaged", reader.name, "it is not whole, or no JSON"))
        else:
            facts = _top(document)
    return RecordingSummary(
        RecordingFormat.json, Content.opaque, JSON.description, problems=tuple(problems), facts=tuple(facts)
    )


def _top(document: object) -> list[Fact]:
    if isinstance(document, dict):
        listed = [Fact("key", str(key)[:_MAX_NAME]) for key in list(document)[:_LISTED_KEYS]]
        return [Fact("keys", len(document)), *listed]
    return [Fact("items", len(document))] if isinstance(document, list) else []


_YAML_START = re.compile(r"""(- |)["']?[\w./ -]+["']?\s*:(\s|$)|---(\s|$)|%YAML""")
_JSON_START = re.compile(r"""\s*(\{\s*("|\})|\[\s*(["\[{\]\d-]|true|false|null))""")
_TUM_COLUMNS, _KITTI_COLUMNS = 8, 12


@lru_cache(maxsize=1)
def sniff_text(head: bytes) -> RecordingFormat:
    """Return the format of a text by its first bytes; unknown if it is none."""
    head = head[:HEAD_BYTES]
    text = head.decode("utf-8", "ignore")
    if b"\0" in head or len(text.encode()) < len(head) - 3:
        return RecordingFormat.unknown
    if _JSON_START.match(text):
        return RecordingFormat.json
    whole_lines = text.splitlines()[: -1 if len(head) == HEAD_BYTES else None]
    lines = [line.strip() for line in whole_lines if line.strip() and not line.lstrip().startswith("#")]
    if not lines:
        return RecordingFormat.unknown
    if any(line.startswith("rosbag2_bagfile_information:") for line in lines):
        return RecordingFormat.rosbag2_metadata
    if _are_numbers(lines, _TUM_COLUMNS):
        return RecordingFormat.tum
    if _are_numbers(lines, _KITTI_COLUMNS):
        return RecordingFormat.kitti
    if len(lines) > 1 and "," in lines[0] and len({line.count(",") for line in lines}) == 1:
        return RecordingFormat.csv
    return RecordingFormat.yaml if _YAML_START.match(lines[0]) else RecordingFormat.unknown


def _are_numbers(lines: list[str], columns: int) -> bool:
    for line in lines:
        cells = line.split()
        if len(cells) != columns:
            return False
        try:
            [float(cell) for cell in cells]
        except ValueError:
            return False
    return True


def text_format(
    kind: RecordingFormat,
    description: str,
    scan: Callable[[SequentialReader], RecordingSummary] | None = None,
    refusal: str = "",
) -> Format:
    """Return a format that is recognised by `sniff_text`, and holds no messages."""
    return Format(
        kind,
        lambda head: sniff_text(head.data) is kind,
        description,
        is_text=True,
        scan=scan,
        refusal=refusal or f"its content is that of {kind.value}, which holds no messages",
    )


YAML = text_format(RecordingFormat.yaml, "YAML, not a recording", describe_yaml)
JSON = text_format(RecordingFormat.json, "JSON, not a recording", describe_json)
ROSBAG2_METADATA = text_format(
    RecordingFormat.rosbag2_metadata, "the metadata of a rosbag2 recording, not a recording by itself"
)
UNKNOWN = text_format(RecordingFormat.unknown, "not a known recording format")


_UNITS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}
_UNIT_NAMES = {"s": "seconds", "ms": "milliseconds", "us": "microseconds", "ns": "nanoseconds"}
_MAX_STAMP_DIGITS = 40
_LATEST_NS = 2**63 - 1
_UNIT_TOLERANCE = 0.01
_REASONS = {
    RecordingFormat.tum: "a trajectory (TUM), not a recording",
    RecordingFormat.kitti: "a trajectory (KITTI), not a recording",
}
_COLUMNS = {RecordingFormat.tum: 8, RecordingFormat.kitti: 12}
_PLACES_OF_KITTI = (3, 7, 11)


@dataclass
class Trajectory:
    """State of parsing a trajectory. `unit`: of its stamps; empty before the first one that is not 0."""

    unit: str = ""
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


def describe_trajectory(kind: RecordingFormat, reader: SequentialReader) -> RecordingSummary:
    """Read a whole trajectory. Its times are those of its poses, as integer nanoseconds; KITTI has none."""
    trajectory = Trajectory()
    for number, line in enumerate(read_lines(reader), 1):
        text = line.strip()
        if text and not text.startswith(b"#") and not _add(trajectory, kind, text):
            trajectory.bad_lines += 1
            trajectory.first_bad_line = trajectory.first_bad_line or number
    unit_problems = []
    if trajectory.unit not in ("", "s"):
        message = f"the stamps are in {_UNIT_NAMES[trajectory.unit]}, where TUM has seconds; they are read as such"
        unit_problems.append(Problem("stamp-unit", "file", message))
    return RecordingSummary(
        kind,
        Content.opaque,
        _REASONS[kind],
        start_ns=trajectory.start_ns,
        end_ns=trajectory.end_ns,
        problems=(*unit_problems, *trajectory_problems(trajectory)),
        facts=tuple(trajectory_facts(trajectory)),
    )


def trajectory_facts(trajectory: Trajectory) -> list[Fact]:
    """Return number of poses, path length and duration."""
    facts = [Fact("poses", trajectory.poses), Fact("path_length", round(trajectory.length_m, 3), "m")]
    if trajectory.start_ns is not None and trajectory.end_ns is not None:
        facts.append(Fact("duration", round((trajectory.end_ns - trajectory.start_ns) / 1e9, 6), "s"))
    if trajectory.unit not in ("", "s"):
        facts.append(Fact("stamp_unit", trajectory.unit))
    return facts


def _add(trajectory: Trajectory, kind: RecordingFormat, text: bytes) -> bool:
    """Add a pose; return whether the line is one."""
    cells = text.split()
    if len(cells) != _COLUMNS[kind]:
        return False
    if kind is RecordingFormat.tum:
        return add_stamped_pose(trajectory, cells)
    try:
        numbers = [float(cell) for cell in cells]
    except ValueError:
        return False
    if not all(map(isfinite, numbers)):
        return False
    _add_place(trajectory, tuple(numbers[column] for column in _PLACES_OF_KITTI))
    return True


def add_stamped_pose(trajectory: Trajectory, cells: list[bytes]) -> bool:
    """Add a pose of 8 cells (stamp, position, quaternion); return whether they are one."""
    try:
        numbers = [float(cell) for cell in cells]
        if not trajectory.unit and numbers[0]:
            trajectory.unit = unit_of(cells[0].decode())
        stamp = parse_stamp(cells[0].decode(), trajectory.unit or "s")
    except (ValueError, UnicodeDecodeError):
        return False
    if not all(map(isfinite, numbers)):
        return False
    trajectory.backward += stamp < trajectory.last_ns
    trajectory.last_ns = stamp
    trajectory.start_ns = stamp if trajectory.start_ns is None else min(trajectory.start_ns, stamp)
    trajectory.end_ns = stamp if trajectory.end_ns is None else max(trajectory.end_ns, stamp)
    trajectory.not_unit += abs(hypot(*numbers[4:]) - 1) > _UNIT_TOLERANCE
    _add_place(trajectory, tuple(numbers[1:4]))
    return True


def _add_place(trajectory: Trajectory, place: tuple[float, ...]) -> None:
    if trajectory.last_place:
        trajectory.length_m += hypot(*(a - b for a, b in zip(place, trajectory.last_place, strict=True)))
    trajectory.last_place = place
    trajectory.poses += 1


def unit_of(text: str) -> str:
    """Return the unit of a first stamp: the largest in which int64 nanoseconds can hold it."""
    for unit in _UNITS:
        try:
            parse_stamp(text, unit)
        except ValueError:
            continue
        return unit
    raise ValueError(text)


def parse_stamp(text: str, unit: str = "s") -> int:
    """Return a stamp, such as `1403638128.545096874` or `1.4e9`, as nanoseconds, without rounding by floats."""
    try:
        number = Decimal(text[:_MAX_STAMP_DIGITS] if "e" not in text.lower() else text)
        is_usual = number.is_finite() and number.adjusted() < _MAX_STAMP_DIGITS
        stamp = int(number * _UNITS[unit]) if is_usual else -1
    except ArithmeticError:
        stamp = -1
    if not 0 <= stamp <= _LATEST_NS:
        raise ValueError(text)
    return stamp


def trajectory_problems(trajectory: Trajectory) -> list[Problem]:
    """Return what is wrong with a trajectory."""
    problems: list[Problem] = []
    if trajectory.bad_lines:
        message = f"{counted(trajectory.bad_lines, 'line is no pose', 'lines are no poses')}"
        problems.append(Problem("lines-damaged", f"line {trajectory.first_bad_line}", message))
    if trajectory.backward:
        message = f"{counted(trajectory.backward, 'pose is', 'poses are')} stamped earlier than the one before"
        problems.append(Problem("out-of-order", "file", message))
    if trajectory.not_unit:
        message = f"{trajectory.not_unit} rotations are no unit quaternions"
        problems.append(Problem("rotation-not-unit", "file", message))
    return problems


_POSE_COLUMNS = 8
_EUROC_COLUMNS = (8, 17)
_STAMP = re.compile(r"time|stamp|\bt\b", re.I)


def describe_table(reader: SequentialReader) -> RecordingSummary:
    """Read a whole table. Its first line is a header if no cell of it is a number."""
    names: list[str] = []
    columns = rows = 0
    trajectory: Trajectory | None = None
    for number, line in enumerate(read_lines(reader), 1):
        if not line.strip():
            continue
        if columns == 0:
            # The names of EuRoC's tables are behind a comment sign.
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
            unit = re.search(r"\[\s*(s|ms|us|ns)\s*\]", names[0]) if names else None
            trajectory = Trajectory(unit=unit[1] if unit else "")
        if trajectory is not None and not add_stamped_pose(trajectory, pose):
            trajectory.bad_lines += 1
            trajectory.first_bad_line = trajectory.first_bad_line or number
    facts = [Fact("columns", columns), Fact("rows", rows)]
    facts += [Fact("column", name[:_MAX_NAME]) for name in names[:_LISTED_KEYS] if name]
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
    """Return whether a table holds poses, by its column names, or by a unit quaternion."""
    if columns < _POSE_COLUMNS:
        return False
    if names:
        # Such as "p_RS_R_x [m]", "tx", "position.x"; "q_RS_w []", "qx", "orientation.x".
        position, rotation = r"(p|t|pos|position|translation|)", r"(q|quat|quaternion|rot|rotation|orientation)"
        patterns = [_STAMP.pattern, *(rf"^{position}([_.]\w+)?[_.]?{axis}\b" for axis in "xyz")]
        patterns += [rf"^{rotation}([_.]\w+)?[_.]?[wxyz]\b"] * 4
        return all(re.search(pattern, name, re.I) for pattern, name in zip(patterns, names, strict=False))
    try:
        numbers = [float(cell) for cell in pose]
    except ValueError:
        return False
    return columns in _EUROC_COLUMNS and abs(hypot(*numbers[4:]) - 1) < _UNIT_TOLERANCE


def _cells(line: bytes) -> list[str]:
    try:
        cells = next(csv.reader([line.decode("utf-8", "replace")]), [])
    except csv.Error:
        cells = line.decode("utf-8", "replace").split(",")
    return [cell.strip() for cell in cells]


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


_NO_MESSAGES = "which holds no messages: use `klein inspect` or `kleinkram.recordings.inspect` for its"
_TRAJECTORY_FACTS = "number of poses, path length and time span, and `numpy.loadtxt` or evo for the poses"
TUM = text_format(
    RecordingFormat.tum,
    _REASONS[RecordingFormat.tum],
    lambda reader: describe_trajectory(RecordingFormat.tum, reader),
    f"it is a trajectory (TUM), {_NO_MESSAGES} {_TRAJECTORY_FACTS}",
)
KITTI = text_format(
    RecordingFormat.kitti,
    _REASONS[RecordingFormat.kitti],
    lambda reader: describe_trajectory(RecordingFormat.kitti, reader),
    f"it is a trajectory (KITTI), {_NO_MESSAGES} {_TRAJECTORY_FACTS}",
)
CSV = text_format(
    RecordingFormat.csv,
    "a table (CSV), not a recording",
    describe_table,
    f"it is a table (CSV), {_NO_MESSAGES} columns, rows and poses, and `pandas.read_csv` for the rows",
)
