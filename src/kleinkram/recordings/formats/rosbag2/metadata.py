"""The metadata.yaml of a rosbag2 folder, and its comparison with the data files. Missing or invalid values are None.

It is only a claim: `comparing` says where the data disagree.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath

from kleinkram.recordings.model import Problem, RecordingFormat, counted

MAX_TEXT = 4 * 2**20
_MOST_ENTRIES = 100_000
_TOP = "rosbag2_bagfile_information"
_MOST_DIGITS = 20
# The deepest that a recorder writes is 6.
_MAX_DEPTH = 50
_NULL = frozenset(("~", "null", "Null", "NULL"))


@dataclass(frozen=True)
class StatedTopic:
    """A topic in metadata.yaml; empty or None where it says nothing."""

    name: str
    message_type: str
    serialization_format: str
    message_count: int | None


@dataclass(frozen=True)
class StatedFile:
    """A data file in metadata.yaml, from version 5 on."""

    path: str
    message_count: int | None
    start_ns: int | None
    duration_ns: int | None


@dataclass(frozen=True)
class Rosbag2Metadata:
    """The contents of a metadata.yaml.

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
    """Parse a metadata.yaml; None if it is damaged, or not YAML.

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
    """Return a POSIX path: recorders on Windows write backslashes."""
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


METADATA_NAME = "metadata.yaml"
KNOWN_ENCODINGS = frozenset(("cdr", "cdr2", "ros1", "json", "protobuf", "flatbuffer", "cbor", "msgpack"))
_TOLERANCE_NS = 1_000_000
_CREDIBLE_NS = 366 * 24 * 3600 * 1_000_000_000
_FORMATS = {"sqlite3": RecordingFormat.rosbag2_db3, "mcap": RecordingFormat.mcap}
_FIRST_VERSION_WITH_FILES = 5


@dataclass(frozen=True)
class MemberFacts:
    """What is known of a data file; None: unknown.

    Attributes:
        name: without folder.
        format: of what is inside; None where it is not known.
    """

    name: str
    message_count: int | None = None
    start_ns: int | None = None
    end_ns: int | None = None
    format: RecordingFormat | None = None


@dataclass(frozen=True)
class TopicFacts:
    """What is known of a topic over all data files; None or empty: unknown."""

    name: str
    message_type: str = ""
    message_encoding: str = ""
    message_count: int | None = None


def compare_metadata(
    metadata: Rosbag2Metadata, members: Sequence[MemberFacts], topics: Iterable[TopicFacts] = ()
) -> list[Problem]:
    """Report where metadata.yaml and the data files disagree.

    `members` in the order of recording. Counts and times of the whole are compared only where all files are there
    and their counts are known; times agree within 1 ms. Topics that are not given are not compared.
    """
    problems = compare_names(metadata, [member.name for member in members])
    is_complete = not problems and bool(members)
    problems += _compare_files(metadata, members)
    by_name = {topic.name: topic for topic in topics}
    problems += _compare_types(metadata.topics, by_name)
    counts = [member.message_count for member in members]
    known = [count for count in counts if count is not None]
    if is_complete and len(known) == len(counts):
        problems += _compare_counts(metadata, sum(known), by_name)
        problems += _compare_span(metadata, members)
    return problems


def lost_messages(metadata: Rosbag2Metadata, members: Sequence[MemberFacts]) -> int | None:
    """Return how many messages the metadata claims beyond those in the files; None if unknown."""
    counts = [member.message_count for member in members]
    known = [count for count in counts if count is not None]
    if metadata.message_count is None or len(known) < len(counts):
        return None
    return max(0, metadata.message_count - sum(known))


def compare_names(metadata: Rosbag2Metadata, names: Iterable[str]) -> list[Problem]:
    """Report data files that are missing, or that metadata.yaml does not name."""
    claimed = {PurePosixPath(path).name for path in metadata.files}
    there = set(names)
    missing = [
        Problem("member-missing", name, "metadata.yaml names it, but it is not there") for name in claimed - there
    ]
    surplus = [
        Problem("member-surplus", name, "it is there, but metadata.yaml does not name it") for name in there - claimed
    ]
    return sorted([*missing, *surplus], key=lambda problem: (problem.code, problem.where))


def _compare_files(metadata: Rosbag2Metadata, members: Sequence[MemberFacts]) -> list[Problem]:
    problems: list[Problem] = []
    stated: dict[str, StatedFile] = {PurePosixPath(entry.path).name: entry for entry in metadata.file_entries}
    expected = _FORMATS.get(metadata.storage or "")
    for member in members:
        actual_format = member.format if member.format in _FORMATS.values() else None
        if expected is not None and actual_format is not None and actual_format is not expected:
            message = f"metadata.yaml says its storage is {metadata.storage}, but it is {actual_format.value}"
            problems.append(Problem("metadata-storage", member.name, message))
        claimed = stated[member.name].message_count if member.name in stated else None
        if len(members) > 1 and claimed is not None and member.message_count not in (None, claimed):
            message = f"metadata.yaml says it holds {counted(claimed, 'message')}, it holds {member.message_count}"
            problems.append(Problem("metadata-count", member.name, message))
    return problems


def _compare_counts(metadata: Rosbag2Metadata, count: int, topics: Mapping[str, TopicFacts]) -> list[Problem]:
    problems: list[Problem] = []
    if metadata.message_count is not None and metadata.message_count != count:
        message = f"it says {counted(metadata.message_count, 'message')}, the files hold {count}"
        problems.append(Problem("metadata-count", METADATA_NAME, message))
    if not topics or not metadata.topics:
        return problems
    stated = {topic.name: topic.message_count for topic in metadata.topics}
    for name in sorted(stated.keys() | topics.keys()):
        claimed = stated.get(name, 0)
        actual = topics[name].message_count if name in topics else 0
        if claimed is not None and actual is not None and claimed != actual:
            message = f"metadata.yaml says {counted(claimed, 'message')}, the files hold {actual}"
            problems.append(Problem("metadata-topic-count", name, message))
    return problems


def _compare_types(stated: Iterable[StatedTopic], topics: Mapping[str, TopicFacts]) -> list[Problem]:
    problems: list[Problem] = []
    for topic in stated:
        encoding = topic.serialization_format
        if encoding and encoding not in KNOWN_ENCODINGS:
            message = f"metadata.yaml says its messages are encoded as '{encoding}', which is no encoding that we know"
            problems.append(Problem("metadata-encoding", topic.name, message))
        actual = topics.get(topic.name)
        if actual is None:
            continue
        if actual.message_encoding and encoding and encoding in KNOWN_ENCODINGS and encoding != actual.message_encoding:
            message = (
                f"metadata.yaml says its messages are encoded as {encoding}, the files say {actual.message_encoding}"
            )
            problems.append(Problem("metadata-encoding", topic.name, message))
        if actual.message_type and topic.message_type and _short(topic.message_type) != _short(actual.message_type):
            message = f"metadata.yaml says its type is {topic.message_type}, the files say {actual.message_type}"
            problems.append(Problem("metadata-type", topic.name, message))
    return problems


def _short(message_type: str) -> str:
    """Return a type name without `/msg/`, as ROS 1 and the first rosbag2 wrote it."""
    return message_type.replace("/msg/", "/")


def _compare_span(metadata: Rosbag2Metadata, members: Sequence[MemberFacts]) -> list[Problem]:
    spans = [(m.start_ns, m.end_ns) for m in members if m.start_ns is not None and m.end_ns is not None]
    if not spans or metadata.start_ns is None or metadata.duration_ns is None or not metadata.message_count:
        return []
    start, end = min(first for first, _ in spans), max(last for _, last in spans)
    accepted = [(start, end - start)]
    if (metadata.version or 0) < _FIRST_VERSION_WITH_FILES:
        # Early recorders of split sets wrote the start of the last file, and the duration of the longest.
        accepted.append((spans[-1][0], max(last - first for first, last in spans)))
    claimed = (metadata.start_ns, metadata.duration_ns)
    if any(_agree(claimed, actual) for actual in accepted):
        return []
    if abs(metadata.start_ns - start) > _CREDIBLE_NS:
        return []  # a clock that was not set: told of the stamps themselves
    message = (
        f"it says {metadata.duration_ns} ns from {metadata.start_ns}, the files hold {end - start} ns from {start}"
    )
    return [Problem("metadata-span", METADATA_NAME, message)]


def _agree(claimed: tuple[int, int], actual: tuple[int, int]) -> bool:
    return all(abs(a - b) <= _TOLERANCE_NS for a, b in zip(claimed, actual, strict=True))
