"""What metadata.yaml claims against what the data files hold: one rule, for folders here and for rows of a server."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath

from kleinkram.recordings.model import Problem, RecordingFormat, counted
from kleinkram.recordings.rosbag2.metadata import Rosbag2Metadata, StatedFile, StatedTopic

METADATA_NAME = "metadata.yaml"
KNOWN_ENCODINGS = frozenset(("cdr", "cdr2", "ros1", "json", "protobuf", "flatbuffer", "cbor", "msgpack"))
_TOLERANCE_NS = 1_000_000
_CREDIBLE_NS = 366 * 24 * 3600 * 1_000_000_000
_FORMATS = {"sqlite3": RecordingFormat.rosbag2_db3, "mcap": RecordingFormat.mcap}
_FIRST_VERSION_WITH_FILES = 5


@dataclass(frozen=True)
class MemberFacts:
    """What is known of one data file that is there; None: not known.

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
    """What is known of one topic over all data files; None or empty: not known."""

    name: str
    message_type: str = ""
    message_encoding: str = ""
    message_count: int | None = None


def compare_metadata(
    metadata: Rosbag2Metadata, members: Sequence[MemberFacts], topics: Iterable[TopicFacts] = ()
) -> list[Problem]:
    """Say where metadata.yaml and the data files disagree.

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
    """Return how many messages the metadata claims beyond those that the files hold; None where that is not known."""
    counts = [member.message_count for member in members]
    known = [count for count in counts if count is not None]
    if metadata.message_count is None or len(known) < len(counts):
        return None
    return max(0, metadata.message_count - sum(known))


def compare_names(metadata: Rosbag2Metadata, names: Iterable[str]) -> list[Problem]:
    """Say which data files metadata.yaml names and are not there, and which are there unnamed."""
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
        found = member.format if member.format in _FORMATS.values() else None
        if expected is not None and found is not None and found is not expected:
            message = f"metadata.yaml says its storage is {metadata.storage}, but it is {found.value}"
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
        found = topics[name].message_count if name in topics else 0
        if claimed is not None and found is not None and claimed != found:
            message = f"metadata.yaml says {counted(claimed, 'message')}, the files hold {found}"
            problems.append(Problem("metadata-topic-count", name, message))
    return problems


def _compare_types(stated: Iterable[StatedTopic], topics: Mapping[str, TopicFacts]) -> list[Problem]:
    problems: list[Problem] = []
    for topic in stated:
        encoding = topic.serialization_format
        if encoding and encoding not in KNOWN_ENCODINGS:
            message = f"metadata.yaml says its messages are encoded as '{encoding}', which is no encoding that we know"
            problems.append(Problem("metadata-encoding", topic.name, message))
        found = topics.get(topic.name)
        if found is None:
            continue
        if found.message_encoding and encoding and encoding in KNOWN_ENCODINGS and encoding != found.message_encoding:
            message = (
                f"metadata.yaml says its messages are encoded as {encoding}, the files say {found.message_encoding}"
            )
            problems.append(Problem("metadata-encoding", topic.name, message))
        if found.message_type and topic.message_type and _short(topic.message_type) != _short(found.message_type):
            message = f"metadata.yaml says its type is {topic.message_type}, the files say {found.message_type}"
            problems.append(Problem("metadata-type", topic.name, message))
    return problems


def _short(message_type: str) -> str:
    """Return a type as ROS 1 and the first rosbag2 spelled it, `std_msgs/String`."""
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
    if any(_agree(claimed, found) for found in accepted):
        return []
    if abs(metadata.start_ns - start) > _CREDIBLE_NS:
        return []  # a clock that was not set: told of the stamps themselves
    message = (
        f"it says {metadata.duration_ns} ns from {metadata.start_ns}, the files hold {end - start} ns from {start}"
    )
    return [Problem("metadata-span", METADATA_NAME, message)]


def _agree(claimed: tuple[int, int], found: tuple[int, int]) -> bool:
    return all(abs(a - b) <= _TOLERANCE_NS for a, b in zip(claimed, found, strict=True))
