"""Parses the metadata.yaml of a rosbag2 folder, and compares its claims with the data files."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath

from kleinkram.recordings.model import Problem, RecordingFormat, RecordingSummary, TopicSummary, counted

MAX_TEXT = 4 * 2**20
_MAX_ENTRIES = 100_000
_TOP = "rosbag2_bagfile_information"
_MAX_DIGITS = 20
# The deepest that a recorder writes is 6.
_MAX_DEPTH = 50
_NULL = frozenset(("~", "null", "Null", "NULL"))


@dataclass(frozen=True)
class MetadataTopic:
    """A topic in metadata.yaml; empty or None where it says nothing."""

    name: str
    message_type: str
    serialization_format: str
    message_count: int | None


@dataclass(frozen=True)
class MetadataFile:
    """A data file in metadata.yaml, from version 5 on."""

    path: str
    message_count: int | None
    start_ns: int | None
    duration_ns: int | None


@dataclass(frozen=True)
class Rosbag2Metadata:
    """The contents of a metadata.yaml; missing or invalid values are None.

    Attributes:
        files: data files, relative to the folder, in the order of recording.
        storage: "sqlite3" or "mcap".
        compression_mode: "file", "message" or "". With "message", the data of each message is compressed separately, in
            a db3 as well as in an MCAP, without a trace in these files.
        version: of the metadata's own format, 1 to 9.
        file_entries: single files; empty before version 5.
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
    topics: tuple[MetadataTopic, ...] = ()
    file_entries: tuple[MetadataFile, ...] = ()
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
    topics = []
    for entry in _entries(top, "topics_with_message_count"):
        # The latter in version 1.
        topic = _mapping(entry.get("topic_metadata")) or _mapping(entry.get("topic_and_type"))
        name, message_type, encoding = (_text(topic.get(key)) for key in ("name", "type", "serialization_format"))
        topics.append(MetadataTopic(name, message_type, encoding, _number(entry.get("message_count"))))
    entries = tuple(
        MetadataFile(_path(entry.get("path")), _number(entry.get("message_count")), *_times(entry))
        for entry in _entries(top, "files")
    )
    paths = top.get("relative_file_paths")
    files = [_path(path) for path in paths[:_MAX_ENTRIES]] if isinstance(paths, list) else [e.path for e in entries]
    start_ns, duration_ns = _times(top)
    return Rosbag2Metadata(
        files=tuple(filter(None, files)),
        message_count=_number(top.get("message_count")),
        duration_ns=duration_ns,
        start_ns=start_ns,
        storage=_text(top.get("storage_identifier")) or None,
        compression=_text(top.get("compression_format")).lower(),
        compression_mode=_text(top.get("compression_mode")).lower().replace("none", ""),
        version=_number(top.get("version")),
        topics=tuple(topics),
        file_entries=entries,
        ros_distro=_text(top.get("ros_distro")),
    )


def _path(value: object) -> str:
    """Return a POSIX path: recorders on Windows write backslashes."""
    return _text(value).replace("\\", "/")


def _entries(top: Mapping[object, object], key: str) -> list[Mapping[object, object]]:
    entries = top.get(key)
    return [_mapping(entry) for entry in entries[:_MAX_ENTRIES]] if isinstance(entries, list) else []


def _times(entry: Mapping[object, object]) -> tuple[int | None, int | None]:
    start = _mapping(entry.get("starting_time")).get("nanoseconds_since_epoch")
    return _number(start), _number(_mapping(entry.get("duration")).get("nanoseconds"))


def _mapping(value: object) -> Mapping[object, object]:
    return value if isinstance(value, dict) else {}


def _number(value: object) -> int | None:
    text = _text(value)
    return int(text) if text.isascii() and text.isdecimal() and len(text) <= _MAX_DIGITS else None


def _text(value: object) -> str:
    return value if isinstance(value, str) and value not in _NULL else ""


METADATA_NAME = "metadata.yaml"
KNOWN_ENCODINGS = frozenset(("cdr", "cdr2", "ros1", "json", "protobuf", "flatbuffer", "cbor", "msgpack"))
_TOLERANCE_NS = 1_000_000
_CREDIBLE_NS = 366 * 24 * 3600 * 1_000_000_000
STORAGE_FORMATS = {"sqlite3": RecordingFormat.rosbag2_db3, "mcap": RecordingFormat.mcap}
_FIRST_VERSION_WITH_FILES = 5


Member = tuple[str, RecordingSummary]  # the name of a data file, without folder, and its summary


def compare_metadata(
    metadata: Rosbag2Metadata, members: Sequence[Member], topics: Iterable[TopicSummary] = ()
) -> list[Problem]:
    """Report where metadata.yaml and the data files disagree.

    `members` in the order of recording. Total count and span are compared only where all files are there
    and their counts are known; times agree within 1 ms. Only these topics are compared.
    """
    problems = compare_names(metadata, [name for name, _ in members])
    is_complete = not problems and bool(members)
    problems += _compare_files(metadata, members)
    by_name = {topic.name: topic for topic in topics}
    problems += _compare_types(metadata.topics, by_name)
    counts = [summary.message_count for _, summary in members]
    known = [count for count in counts if count is not None]
    if is_complete and len(known) == len(counts):
        problems += _compare_counts(metadata, sum(known), by_name)
        problems += _compare_span(metadata, members)
    return problems


def lost_messages(metadata: Rosbag2Metadata, members: Sequence[Member]) -> int | None:
    """Return how many messages the metadata claims beyond those in the files; None if unknown."""
    counts = [summary.message_count for _, summary in members]
    known = [count for count in counts if count is not None]
    if metadata.message_count is None or len(known) < len(counts):
        return None
    return max(0, metadata.message_count - sum(known))


def compare_names(metadata: Rosbag2Metadata, names: Iterable[str]) -> list[Problem]:
    """Report data files that are missing, or that metadata.yaml does not name."""
    claimed = {PurePosixPath(path).name for path in metadata.files}
    there = set(names)
    missing, unlisted = "metadata.yaml names it, but it is not there", "it is there, but metadata.yaml does not name it"
    return [
        *(Problem("member-missing", name, missing) for name in sorted(claimed - there)),
        *(Problem("member-unlisted", name, unlisted) for name in sorted(there - claimed)),
    ]


def _compare_files(metadata: Rosbag2Metadata, members: Sequence[Member]) -> list[Problem]:
    problems: list[Problem] = []
    entries: dict[str, MetadataFile] = {PurePosixPath(entry.path).name: entry for entry in metadata.file_entries}
    expected = STORAGE_FORMATS.get(metadata.storage or "")
    for name, summary in members:
        actual_format = summary.format if summary.format in STORAGE_FORMATS.values() else None
        if expected is not None and actual_format is not None and actual_format is not expected:
            message = f"metadata.yaml says its storage is {metadata.storage}, but it is {actual_format.value}"
            problems.append(Problem("metadata-storage", name, message))
        claimed = entries[name].message_count if name in entries else None
        if len(members) > 1 and claimed is not None and summary.message_count not in (None, claimed):
            message = f"metadata.yaml says it holds {counted(claimed, 'message')}, it holds {summary.message_count}"
            problems.append(Problem("metadata-count", name, message))
    return problems


def _compare_counts(metadata: Rosbag2Metadata, count: int, topics: Mapping[str, TopicSummary]) -> list[Problem]:
    problems: list[Problem] = []
    if metadata.message_count is not None and metadata.message_count != count:
        message = f"it says {counted(metadata.message_count, 'message')}, the files hold {count}"
        problems.append(Problem("metadata-count", METADATA_NAME, message))
    if not topics or not metadata.topics:
        return problems
    counts = {topic.name: topic.message_count for topic in metadata.topics}
    for name in sorted(counts.keys() | topics.keys()):
        claimed = counts.get(name, 0)
        actual = topics[name].count if name in topics else 0
        if claimed is not None and actual is not None and claimed != actual:
            message = f"metadata.yaml says {counted(claimed, 'message')}, the files hold {actual}"
            problems.append(Problem("metadata-topic-count", name, message))
    return problems


def _compare_types(metadata_topics: Iterable[MetadataTopic], topics: Mapping[str, TopicSummary]) -> list[Problem]:
    problems: list[Problem] = []
    for topic in metadata_topics:
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
        # ROS 1 and the first rosbag2 write types without `/msg/`.
        metadata_type, actual_type = (one.message_type.replace("/msg/", "/") for one in (topic, actual))
        if metadata_type and actual_type and metadata_type != actual_type:
            message = f"metadata.yaml says its type is {topic.message_type}, the files say {actual.message_type}"
            problems.append(Problem("metadata-type", topic.name, message))
    return problems


def _compare_span(metadata: Rosbag2Metadata, members: Sequence[Member]) -> list[Problem]:
    spans = [(s.start_ns, s.end_ns) for _, s in members if s.start_ns is not None and s.end_ns is not None]
    if not spans or metadata.start_ns is None or metadata.duration_ns is None or not metadata.message_count:
        return []
    start, end = min(first for first, _ in spans), max(last for _, last in spans)
    accepted = [(start, end - start)]
    if (metadata.version or 0) < _FIRST_VERSION_WITH_FILES:
        # Early recorders of split sets wrote the start of the last file, and the duration of the longest.
        accepted.append((spans[-1][0], max(last - first for first, last in spans)))
    differences = (max(abs(metadata.start_ns - a), abs(metadata.duration_ns - b)) for a, b in accepted)
    if min(differences) <= _TOLERANCE_NS:
        return []
    if abs(metadata.start_ns - start) > _CREDIBLE_NS:
        return []  # a clock that was not set, which the stamps themselves show
    message = (
        f"it says {metadata.duration_ns} ns from {metadata.start_ns}, the files hold {end - start} ns from {start}"
    )
    return [Problem("metadata-span", METADATA_NAME, message)]
