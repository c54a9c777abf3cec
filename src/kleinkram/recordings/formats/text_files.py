"""Recognises and describes text files without messages: YAML, JSON, trajectories (TUM, KITTI, EuRoC), tables (CSV).

TUM's stamps are seconds; many tools write milliseconds, microseconds or nanoseconds instead. The first stamp that
is not 0 decides: the largest unit in which it lies before 2262, the last year that int64 nanoseconds hold.

Source: TUM RGB-D file formats (`timestamp tx ty tz qx qy qz qw`, seconds and metres); KITTI odometry (the upper
3 x 4 of a pose a line, row by row, metres); EuRoC MAV's state_groundtruth_estimate0/data.csv (nanoseconds, position,
quaternion with w first, then 9 more columns) and vicon0/data.csv (the first 8 of them).
"""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from decimal import Decimal
from functools import lru_cache, partial
from math import hypot, isfinite

from kleinkram.recordings.formats.base import HEAD_BYTES, Format
from kleinkram.recordings.limits import WINDOW
from kleinkram.recordings.model import Content, Fact, Problem, RecordingFormat, RecordingSummary, counted
from kleinkram.recordings.sources import SequentialReader

MAX_LINE_BYTES = 64 * 2**10
MAX_JSON_BYTES = 8 * 2**20
_MAX_KEYS = 10_000
_LISTED_KEYS = 64
_MAX_NAME = 128
_YAML_KEY = re.compile(rb"""(?P<quote>["']?)(?P<key>[^\s#\-"'\[{][^:#"']*)(?P=quote)\s*:(\s|$)""")
_CALIBRATION_KEYS = {"camera_matrix", "distortion_coefficients"}
_KALIBR_KEYS = (b"camera_model:", b"intrinsics:", b"distortion_coeffs:")
_YAML_START = re.compile(r"""(- |)["']?[\w./ -]+["']?\s*:(\s|$)|---(\s|$)|%YAML""")
_JSON_START = re.compile(r"""\s*(\{\s*("|\})|\[\s*(["\[{\]\d-]|true|false|null))""")


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


def describe_yaml(reader: SequentialReader) -> RecordingSummary:
    """Count the top-level keys of a YAML file."""
    keys: dict[str, None] = {}
    kalibr: set[bytes] = set()
    for line in read_lines(reader):
        match = _YAML_KEY.match(line)
        if match is not None and len(keys) < _MAX_KEYS:
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
        try:
            document = json.loads(b"".join(iter(partial(reader.read, MAX_JSON_BYTES), b"")))
        except (ValueError, RecursionError):
            problems.append(Problem("json-damaged", reader.name, "it is incomplete, or not JSON"))
        else:
            if isinstance(document, dict | list):
                facts.append(Fact("keys" if isinstance(document, dict) else "items", len(document)))
            if isinstance(document, dict):
                facts += [Fact("key", str(key)[:_MAX_NAME]) for key in list(document)[:_LISTED_KEYS]]
    return RecordingSummary(
        RecordingFormat.json, Content.opaque, JSON.description, problems=tuple(problems), facts=tuple(facts)
    )


@lru_cache(maxsize=1)
def sniff_text(head: bytes) -> RecordingFormat:
    """Return the format of a text by its first bytes; `unknown` if it is not a text."""
    head = head[:HEAD_BYTES]
    text = head.decode("utf-8", "ignore")
    if b"\0" in head or len(text.encode()) < len(head) - 3:
        return RecordingFormat.unknown
    if _JSON_START.match(text):
        return RecordingFormat.json
    complete_lines = text.splitlines()[: -1 if len(head) == HEAD_BYTES else None]
    lines = [line.strip() for line in complete_lines if line.strip() and not line.lstrip().startswith("#")]
    if not lines:
        return RecordingFormat.unknown
    if any(line.startswith("rosbag2_bagfile_information:") for line in lines):
        return RecordingFormat.rosbag2_metadata
    if _are_numbers(lines, 8):
        return RecordingFormat.tum
    if _are_numbers(lines, 12):
        return RecordingFormat.kitti
    if len(lines) > 1 and "," in lines[0] and len({line.count(",") for line in lines}) == 1:
        return RecordingFormat.csv
    return RecordingFormat.yaml if _YAML_START.match(lines[0]) else RecordingFormat.unknown


def _are_numbers(lines: list[str], columns: int) -> bool:
    rows = [line.split() for line in lines]
    return all(len(row) == columns and all(map(_is_number, row)) for row in rows)


def _is_number(cell: str) -> bool:
    try:
        float(cell)
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


_UNITS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}
_UNIT_NAMES = {"s": "seconds", "ms": "milliseconds", "us": "microseconds", "ns": "nanoseconds"}
_MAX_STAMP_DIGITS = 40
_LATEST_NS = 2**63 - 1
_UNIT_TOLERANCE = 0.01


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


def unit_of_stamp(text: str) -> str:
    """Return the unit of a first stamp: the largest in which int64 nanoseconds can hold it.

    Raises:
        ValueError: it is not a time.
    """
    for unit in _UNITS:
        with suppress(ValueError):
            parse_stamp(text, unit)
            return unit
    raise ValueError(text)


@dataclass
class TrajectoryStatistics:
    """What is known of the poses so far. `unit`: of their stamps; empty before the first one that is not 0."""

    unit: str = ""
    poses: int = 0
    length_m: float = 0.0
    bad_lines: int = 0
    first_bad_line: int = 0
    backward: int = 0
    not_unit: int = 0
    start_ns: int | None = None
    end_ns: int | None = None
    last_position: tuple[float, ...] = ()
    last_ns: int = -1

    def add(self, cells: list[bytes], line_number: int) -> None:
        """Add a pose: 8 cells are stamp, position and quaternion; 12 are a 3 x 4 matrix; a bad line is counted."""
        try:
            numbers = [float(cell) for cell in cells]
            if len(cells) not in (8, 12) or not all(map(isfinite, numbers)):
                raise ValueError(cells)
            if len(cells) == 8:
                self._add_stamp(cells[0].decode(), numbers[0])
                self.not_unit += abs(hypot(*numbers[4:]) - 1) > _UNIT_TOLERANCE
        except ValueError:
            self.bad_lines += 1
            self.first_bad_line = self.first_bad_line or line_number
            return
        position = tuple(numbers[1:4]) if len(cells) == 8 else (numbers[3], numbers[7], numbers[11])
        if self.last_position:
            self.length_m += hypot(*(a - b for a, b in zip(position, self.last_position, strict=True)))
        self.last_position = position
        self.poses += 1

    def _add_stamp(self, text: str, number: float) -> None:
        if not self.unit and number:
            self.unit = unit_of_stamp(text)
        stamp = parse_stamp(text, self.unit or "s")
        self.backward += stamp < self.last_ns
        self.last_ns = stamp
        self.start_ns = stamp if self.start_ns is None else min(self.start_ns, stamp)
        self.end_ns = stamp if self.end_ns is None else max(self.end_ns, stamp)

    def summary(
        self, kind: RecordingFormat, facts: Iterable[Fact] = (), problems: Iterable[Problem] = ()
    ) -> RecordingSummary:
        """Return the summary: number of poses, path length and time span, then other `facts`; `problems` first."""
        own = [Fact("poses", self.poses), Fact("path_length", round(self.length_m, 3), "m")]
        if self.start_ns is not None and self.end_ns is not None:
            own.append(Fact("duration", round((self.end_ns - self.start_ns) / 1e9, 6), "s"))
        if self.unit not in ("", "s"):
            own.append(Fact("stamp_unit", self.unit))
        return RecordingSummary(
            kind,
            Content.opaque,
            f"a trajectory ({kind.value.upper()}), not a recording",
            start_ns=self.start_ns,
            end_ns=self.end_ns,
            problems=(*problems, *self._problems()),
            facts=(*own, *facts),
        )

    def _problems(self) -> Iterator[Problem]:
        if self.bad_lines:
            message = counted(self.bad_lines, "line is no pose", "lines are no poses")
            yield Problem("lines-damaged", f"line {self.first_bad_line}", message)
        if self.backward:
            message = f"{counted(self.backward, 'pose is', 'poses are')} stamped earlier than the one before"
            yield Problem("out-of-order", "file", message)
        if self.not_unit:
            yield Problem("rotation-not-unit", "file", f"{self.not_unit} rotations are no unit quaternions")


def describe_trajectory(kind: RecordingFormat, reader: SequentialReader) -> RecordingSummary:
    """Read a complete trajectory. Its times are those of its poses, as integer nanoseconds; KITTI has none."""
    trajectory = TrajectoryStatistics()
    columns = 8 if kind is RecordingFormat.tum else 12
    for number, line in enumerate(read_lines(reader), 1):
        cells = line.split()
        if cells and not cells[0].startswith(b"#"):
            trajectory.add(cells if len(cells) == columns else [], number)
    problems = []
    if trajectory.unit not in ("", "s"):
        message = f"the stamps are in {_UNIT_NAMES[trajectory.unit]}, where TUM has seconds; they are read as such"
        problems.append(Problem("stamp-unit", "file", message))
    return trajectory.summary(kind, problems=problems)


_POSE_COLUMNS = 8
_EUROC_COLUMNS = (8, 17)
# Such as "p_RS_R_x [m]", "tx", "position.x"; "q_RS_w []", "qx", "orientation.x".
_POSITION, _ROTATION = r"(p|t|pos|position|translation|)", r"(q|quat|quaternion|rot|rotation|orientation)"
_POSE_NAMES = [
    r"time|stamp|\bt\b",
    *(rf"^{_POSITION}([_.]\w+)?[_.]?{axis}\b" for axis in "xyz"),
    *[rf"^{_ROTATION}([_.]\w+)?[_.]?[wxyz]\b"] * 4,
]


def describe_table(reader: SequentialReader) -> RecordingSummary:
    """Read a complete table. Its first line is a header if no cell of it is a number."""
    names: list[str] = []
    columns = rows = 0
    trajectory: TrajectoryStatistics | None = None
    for number, line in enumerate(read_lines(reader), 1):
        if not line.strip():
            continue
        if columns == 0:
            # The names of EuRoC's tables are behind a comment sign.
            cells = split_cells(line.lstrip(b"#").decode("utf-8", "replace"))
            columns = len(cells)
            if line.startswith(b"#") or not any(map(_is_number, cells)):
                names = cells
                continue
        if line.startswith(b"#"):
            continue
        rows += 1
        pose = line.split(b",")[:_POSE_COLUMNS]
        if rows == 1 and are_poses(names, columns, pose):
            trajectory = TrajectoryStatistics(unit=stamp_unit_in(names))
        if trajectory is not None:
            trajectory.add(pose, number)
    facts = [Fact("columns", columns), Fact("rows", rows)]
    facts += [Fact("column", name[:_MAX_NAME]) for name in names[:_LISTED_KEYS] if name]
    if trajectory is None or not trajectory.poses:
        return RecordingSummary(RecordingFormat.csv, Content.opaque, CSV.description, facts=tuple(facts))
    return trajectory.summary(RecordingFormat.csv, facts)


def stamp_unit_in(names: Sequence[str]) -> str:
    """Return the unit that the name of the first column states, such as "timestamp [ns]"; empty if it states none."""
    unit = re.search(r"\[\s*(s|ms|us|ns)\s*\]", names[0]) if names else None
    return unit[1] if unit else ""


def are_poses(names: Sequence[str], columns: int, pose: Sequence[bytes]) -> bool:
    """Return whether a table holds poses, by its column names, or by a unit quaternion."""
    if columns < _POSE_COLUMNS:
        return False
    if names:
        return all(re.search(pattern, name, re.I) for pattern, name in zip(_POSE_NAMES, names, strict=False))
    try:
        numbers = [float(cell) for cell in pose]
    except ValueError:
        return False
    return columns in _EUROC_COLUMNS and abs(hypot(*numbers[4:]) - 1) < _UNIT_TOLERANCE


def split_cells(text: str) -> list[str]:
    """Return the cells of a row of a table."""
    try:
        cells = next(csv.reader([text]), [])
    except csv.Error:
        cells = text.split(",")
    return [cell.strip() for cell in cells]


YAML = text_format(RecordingFormat.yaml, "YAML, not a recording", describe_yaml)
JSON = text_format(RecordingFormat.json, "JSON, not a recording", describe_json)
ROSBAG2_METADATA = text_format(
    RecordingFormat.rosbag2_metadata, "the metadata of a rosbag2 recording, not a recording by itself"
)
UNKNOWN = text_format(
    RecordingFormat.unknown, "not a known recording format", refusal="it is not a recording of a known format"
)
_NO_MESSAGES = "which holds no messages: use `klein inspect` or `kleinkram.recordings.inspect` for its"
TUM, KITTI = (
    text_format(
        kind,
        f"a trajectory ({kind.value.upper()}), not a recording",
        partial(describe_trajectory, kind),
        f"it is a trajectory ({kind.value.upper()}), {_NO_MESSAGES} number of poses, path length and time span, and "
        "`kleinkram.recordings.trajectories` for the poses",
    )
    for kind in (RecordingFormat.tum, RecordingFormat.kitti)
)
CSV = text_format(
    RecordingFormat.csv,
    "a table (CSV), not a recording",
    describe_table,
    f"it is a table (CSV), {_NO_MESSAGES} columns, rows and poses, `pandas.read_csv` for the rows, and "
    "`kleinkram.recordings.trajectories` for the poses",
)
