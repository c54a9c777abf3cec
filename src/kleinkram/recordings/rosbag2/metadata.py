"""The metadata.yaml of a rosbag2 folder: what the recorder claims. Tolerant: whatever is missing or odd is None.

It is only a claim: `comparing` says where the data disagree.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

MAX_TEXT = 4 * 2**20
_MOST_ENTRIES = 100_000
_TOP = "rosbag2_bagfile_information"
_MOST_DIGITS = 20
# The deepest that a recorder writes is 6.
_MAX_DEPTH = 50
_NULL = frozenset(("~", "null", "Null", "NULL"))


@dataclass(frozen=True)
class StatedTopic:
    """What metadata.yaml says of a topic; empty or None where it says nothing."""

    name: str
    message_type: str
    serialization_format: str
    message_count: int | None


@dataclass(frozen=True)
class StatedFile:
    """What metadata.yaml says of one data file, from version 5 on."""

    path: str
    message_count: int | None
    start_ns: int | None
    duration_ns: int | None


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
        compression_mode: "file", "message" or "". With "message", the data of each message is compressed by itself,
            in a db3 as well as in an MCAP, and nothing in these files says so.
        version: of the metadata's own format, 1 to 9.
        topics: in the order of the file.
        file_entries: what is said of single files; empty before version 5.
        ros_distro: such as "jazzy"; empty before version 8.
        is_other: it is YAML of something else, such as a mission's own notes; nothing else is set then.
    """

    files: tuple[str, ...]
    message_count: int | None = None
    duration_ns: int | None = None
    start_ns: int | None = None
    storage: str | None = None
    compression: str = ""
    compression_mode: str = ""
    version: int | None = None
    topics: tuple[StatedTopic, ...] = ()
    file_entries: tuple[StatedFile, ...] = ()
    ros_distro: str = ""
    is_other: bool = False


def parse_rosbag2_metadata(text: str) -> Rosbag2Metadata | None:
    """Read a metadata.yaml; None if it is a damaged one, or not YAML.

    Source: rosbag2_storage, `YAML::convert<BagMetadata>`, metadata versions 1 to 9.
    """
    if len(text) > MAX_TEXT:
        return None
    from ruamel.yaml.error import YAMLError  # slow to import, and rarely needed

    from kleinkram.recordings.yaml_depth import shallow_yaml

    try:
        # "base" leaves each scalar a text and "<<" a key: merge keys, which can unfold without end, do nothing.
        document = shallow_yaml("base", max_depth=_MAX_DEPTH).load(text)
    except (YAMLError, ValueError, TypeError, RecursionError, AttributeError, ArithmeticError, LookupError):
        return None
    if _mapping(document) and _TOP not in _mapping(document):
        return Rosbag2Metadata((), is_other=True)
    top = _mapping(_mapping(document).get(_TOP))
    if not top:
        return None
    return Rosbag2Metadata(
        files=_files(top),
        message_count=_number(top.get("message_count")),
        duration_ns=_nanoseconds(top, "duration", "nanoseconds"),
        start_ns=_nanoseconds(top, "starting_time", "nanoseconds_since_epoch"),
        storage=_text(top.get("storage_identifier")) or None,
        compression=_text(top.get("compression_format")).lower(),
        compression_mode=_text(top.get("compression_mode")).lower().replace("none", ""),
        version=_number(top.get("version")),
        topics=tuple(_topic(entry) for entry in _entries(top, "topics_with_message_count")),
        file_entries=tuple(_file(entry) for entry in _entries(top, "files")),
        ros_distro=_text(top.get("ros_distro")),
    )


def _topic(entry: Mapping[object, object]) -> StatedTopic:
    topic = _mapping(entry.get("topic_metadata")) or _mapping(entry.get("topic_and_type"))  # the latter in version 1
    return StatedTopic(
        name=_text(topic.get("name")),
        message_type=_text(topic.get("type")),
        serialization_format=_text(topic.get("serialization_format")),
        message_count=_number(entry.get("message_count")),
    )


def _file(entry: Mapping[object, object]) -> StatedFile:
    return StatedFile(
        path=_path(entry.get("path")),
        message_count=_number(entry.get("message_count")),
        start_ns=_nanoseconds(entry, "starting_time", "nanoseconds_since_epoch"),
        duration_ns=_nanoseconds(entry, "duration", "nanoseconds"),
    )


def _files(top: Mapping[object, object]) -> tuple[str, ...]:
    paths = top.get("relative_file_paths")
    if isinstance(paths, list):
        return tuple(path for entry in paths[:_MOST_ENTRIES] if (path := _path(entry)))
    return tuple(path for entry in _entries(top, "files") if (path := _path(entry.get("path"))))


def _path(value: object) -> str:
    """Return a path as POSIX writes it: recorders on Windows write backslashes."""
    return _text(value).replace("\\", "/")


def _entries(top: Mapping[object, object], key: str) -> list[Mapping[object, object]]:
    entries = top.get(key)
    return [_mapping(entry) for entry in entries[:_MOST_ENTRIES]] if isinstance(entries, list) else []


def _nanoseconds(top: Mapping[object, object], key: str, inner: str) -> int | None:
    return _number(_mapping(top.get(key)).get(inner))


def _mapping(value: object) -> Mapping[object, object]:
    return value if isinstance(value, dict) else {}


def _number(value: object) -> int | None:
    text = _text(value)
    return int(text) if text.isascii() and text.isdecimal() and len(text) <= _MOST_DIGITS else None


def _text(value: object) -> str:
    return value if isinstance(value, str) and value not in _NULL else ""
