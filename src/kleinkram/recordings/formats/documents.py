"""Text files: lines of any text, YAML and JSON, and how text formats are recognised."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from functools import lru_cache

from kleinkram.recordings.formats.base import HEAD_BYTES, Format
from kleinkram.recordings.limits import WINDOW
from kleinkram.recordings.model import Content, Fact, Problem, RecordingFormat, RecordingSummary
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
