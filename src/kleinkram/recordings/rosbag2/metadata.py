"""The metadata.yaml of a rosbag2 folder: what the recorder claims. Tolerant: whatever is missing or odd is None.

It is only a claim. Missing and surplus members are named by comparing `files` with what is there.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import PurePosixPath

from kleinkram.recordings.model import Problem

MAX_TEXT = 4 * 2**20


@dataclass(frozen=True)
class Rosbag2Metadata:
    """What a metadata.yaml says.

    Attributes:
        files: data files, relative to the folder, in the order of recording.
        message_count: messages of all files.
        duration_ns: from the first to the last message.
        start_ns: log time of the first message.
        storage: "sqlite3" or "mcap".
        compression: format such as "zstd", or "".
        compression_mode: "file", "message" or "".
    """

    files: tuple[str, ...]
    message_count: int | None = None
    duration_ns: int | None = None
    start_ns: int | None = None
    storage: str | None = None
    compression: str = ""
    compression_mode: str = ""


def parse_rosbag2_metadata(text: str) -> Rosbag2Metadata | None:
    """Read a metadata.yaml; None if it is not one, or not YAML.

    Source: rosbag2_storage, `YAML::convert<BagMetadata>`, metadata versions 1 to 9.
    """
    if len(text) > MAX_TEXT:
        return None
    from ruamel.yaml import YAML  # slow to import, and rarely needed
    from ruamel.yaml.error import YAMLError

    try:
        document = YAML(typ="safe", pure=True).load(text)
    except (YAMLError, ValueError, TypeError, RecursionError, AttributeError):
        return None
    top = _mapping(_mapping(document).get("rosbag2_bagfile_information"))
    if not top:
        return None
    return Rosbag2Metadata(
        files=_files(top),
        message_count=_number(top.get("message_count")),
        duration_ns=_number(_mapping(top.get("duration")).get("nanoseconds")),
        start_ns=_number(_mapping(top.get("starting_time")).get("nanoseconds_since_epoch")),
        storage=_text(top.get("storage_identifier")) or None,
        compression=_text(top.get("compression_format")),
        compression_mode=_text(top.get("compression_mode")).lower().replace("none", ""),
    )


def compare_members(metadata: Rosbag2Metadata, names: Iterable[str]) -> list[Problem]:
    """Return a problem for each file that the metadata names and that is missing, and for each that it does not name.

    `names`: file names of the data files in the folder, without directory.
    """
    claimed = {PurePosixPath(path).name for path in metadata.files}
    there = set(names)
    missing = [
        Problem("member-missing", name, "metadata.yaml names it, but it is not there") for name in claimed - there
    ]
    surplus = [
        Problem("member-surplus", name, "it is there, but metadata.yaml does not name it") for name in there - claimed
    ]
    return sorted([*missing, *surplus], key=lambda problem: (problem.code, problem.where))


def _files(top: Mapping[object, object]) -> tuple[str, ...]:
    paths = top.get("relative_file_paths")
    if isinstance(paths, list):
        return tuple(path for path in paths if isinstance(path, str))
    files = top.get("files")
    if isinstance(files, list):
        return tuple(path for entry in files if isinstance(path := _mapping(entry).get("path"), str))
    return ()


def _mapping(value: object) -> Mapping[object, object]:
    return value if isinstance(value, dict) else {}


def _number(value: object) -> int | None:
    return value if isinstance(value, int) and not isinstance(value, bool) and value >= 0 else None


def _text(value: object) -> str:
    return value if isinstance(value, str) else ""
