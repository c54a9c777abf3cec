"""Local files as a mission: its facts, by the same rules as on the server, and its recordings to open.

Reads indexes, and a file that has none from end to end. Local files and the same files on a server give the same facts,
so that checks have the same outcome on both.
"""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from pydantic import JsonValue

from kleinkram.checks.facts import FileFacts, MissionFacts, RecordingFacts, TopicFacts
from kleinkram.checks.outcomes import ShowProgress, show_nothing
from kleinkram.recordings.combine_summaries import combine, combine_folder
from kleinkram.recordings.errors import SourceError
from kleinkram.recordings.formats.rosbag2.metadata import (
    MAX_TEXT,
    METADATA_NAME,
    Rosbag2Metadata,
    parse_rosbag2_metadata,
)
from kleinkram.recordings.model import Content, RecordingFormat, RecordingSummary
from kleinkram.recordings.recording import Recording
from kleinkram.recordings.recording_groups import RecordingGroup, RecordingGroupKind, group
from kleinkram.recordings.sources import FileSource
from kleinkram.recordings.summary import summarise
from kleinkram.recordings.timeline import StampSpan, join_spans

CREDIBLE_NS = 631_152_000 * 10**9
"""1990: recordings that begin earlier are of clocks that were never set, and do not belong to the span of a mission."""


@dataclass(frozen=True)
class LocalRecording:
    """A recording of local files. `metadata_path`: the metadata.yaml of a rosbag2 folder."""

    name: str
    members: tuple[Path, ...]
    metadata_path: Path | None
    content: Content
    reason: str | None

    def open(self) -> Recording:
        """Open it for reading. Raises RecordingError."""
        if self.metadata_path is not None and all(path.parent == self.metadata_path.parent for path in self.members):
            return Recording.open(self.metadata_path)
        if len(self.members) == 1 and self.metadata_path is None:
            return Recording.open(self.members[0])
        paths = [*([self.metadata_path] if self.metadata_path else []), *self.members]
        return Recording.open(_LocalSources(paths))


class _LocalSources:
    """The files of a recording that are in several folders."""

    def __init__(self, paths: Sequence[Path]) -> None:
        self._paths = paths
        self._sources: list[FileSource] = []

    def sources(self) -> Sequence[FileSource]:
        for path in self._paths:
            self._sources.append(FileSource(path))
        return self._sources

    def close(self) -> None:
        for source in self._sources:
            source.close()


@dataclass(frozen=True)
class LocalMission:
    """Local files as a mission. `summaries`: of each file, by its path in the mission."""

    facts: MissionFacts
    recordings: tuple[LocalRecording, ...]
    summaries: Mapping[str, RecordingSummary]


def read_mission(
    files: Mapping[str, Path],
    metadata: Mapping[str, JsonValue] | None = None,
    *,
    show: ShowProgress = show_nothing,
) -> LocalMission:
    """Read the indexes of local files, by their paths in the mission.

    A file that cannot be read has the content `error`, with the reason; it hides no other.
    """
    summaries: dict[str, RecordingSummary] = {}
    for number, path in enumerate(sorted(files)):
        show(number / len(files), path)
        summaries[path] = _summary(files[path])
    metadata_files = _metadata_files(files)
    parsed = {path: content for path, content in metadata_files.items() if content is not None}
    groups = group((path for path in files if path in metadata_files or not _is_metadata(path)), parsed)
    combined = [_combined(one, summaries, metadata_files) for one in groups]
    start_ns, end_ns = _span(combined)
    facts = MissionFacts(
        files=tuple(_file_facts(path, files[path], summary) for path, summary in summaries.items()),
        recordings=tuple(_recording_facts(one, summary) for one, summary in zip(groups, combined, strict=True)),
        topics=tuple(_merged_topics(_topics_of_files(groups, summaries), start_ns, end_ns)),
        start_ns=start_ns,
        end_ns=end_ns,
        metadata=metadata or {},
    )
    recordings = tuple(
        LocalRecording(
            name=one.name,
            members=tuple(files[path] for path in one.members),
            metadata_path=files[one.metadata_path] if one.metadata_path else None,
            content=summary.content,
            reason=summary.reason,
        )
        for one, summary in zip(groups, combined, strict=True)
    )
    return LocalMission(facts, recordings, summaries)


def _summary(path: Path) -> RecordingSummary:
    try:
        with FileSource(path) as source:
            return summarise(source, max_bytes=None)
    except SourceError as error:
        return RecordingSummary(RecordingFormat.unknown, Content.error, str(error))


def _is_metadata(path: str) -> bool:
    return PurePosixPath(path).name == METADATA_NAME


def _metadata_files(files: Mapping[str, Path]) -> dict[str, Rosbag2Metadata | None]:
    """Return the content of each metadata.yaml; None for an invalid one, no entry for one that cannot be read."""
    contents: dict[str, Rosbag2Metadata | None] = {}
    for path, local in files.items():
        if _is_metadata(path):
            try:
                with local.open(encoding="utf-8", errors="replace") as file:
                    contents[path] = parse_rosbag2_metadata(file.read(MAX_TEXT + 1))
            except OSError:  # its own facts have the reason
                continue
    return contents


def _combined(
    one: RecordingGroup, summaries: Mapping[str, RecordingSummary], metadata_files: Mapping[str, Rosbag2Metadata | None]
) -> RecordingSummary:
    names = [PurePosixPath(path).name for path in one.members]
    members = [summaries[path] for path in one.members]
    if one.kind is RecordingGroupKind.rosbag2:
        return combine_folder(metadata_files[one.metadata_path or ""], names, members)
    return combine(members, names)


def _span(recordings: Iterable[RecordingSummary]) -> tuple[int | None, int | None]:
    """Return start and end of a mission, without recordings of a clock that was never set if there are others."""
    spans = [
        (summary.start_ns, summary.end_ns)
        for summary in recordings
        if summary.start_ns is not None and summary.end_ns is not None
    ]
    credible = [span for span in spans if span[0] >= CREDIBLE_NS] or spans
    return min((start for start, _ in credible), default=None), max((end for _, end in credible), default=None)


def _file_facts(path: str, local: Path, summary: RecordingSummary) -> FileFacts:
    try:
        size_bytes = local.stat().st_size
    except OSError:
        size_bytes = 0
    return FileFacts(path, size_bytes, summary.content, summary.reason)


def _recording_facts(one: RecordingGroup, summary: RecordingSummary) -> RecordingFacts:
    return RecordingFacts(
        name=one.name,
        paths=(*one.members, *([one.metadata_path] if one.metadata_path else [])),
        content=summary.content,
        reason=summary.reason,
        start_ns=summary.start_ns,
        end_ns=summary.end_ns,
        problems=summary.problems,
    )


# -- topics -----------------------------------------------------------------------------------------------------------


class _TopicOfFile(NamedTuple):
    """One topic of one file. `recording`: the name of its recording; None for a file that belongs to none."""

    recording: str | None
    message_count: int | None
    first_ns: int | None
    last_ns: int | None
    longest_gap_ns: int | None


_TopicKey = tuple[str, str]  # name and type


def _topics_of_files(
    groups: Sequence[RecordingGroup], summaries: Mapping[str, RecordingSummary]
) -> dict[_TopicKey, list[_TopicOfFile]]:
    recording_of = {path: one.name for one in groups for path in one.members}
    topics: dict[_TopicKey, list[_TopicOfFile]] = defaultdict(list)
    for path, summary in summaries.items():
        for topic in summary.topics:
            times = (topic.first_ns, topic.last_ns, topic.longest_gap_ns)
            row = _TopicOfFile(recording_of.get(path), topic.count, *times)
            topics[topic.name, topic.message_type].append(row)
    return topics


def _merged_topics(
    topics: Mapping[_TopicKey, Sequence[_TopicOfFile]], start_ns: int | None, end_ns: int | None
) -> Iterator[TopicFacts]:
    """Merge the topics of files as the server does (`server/overviews/topics.py`).

    Counts are added. Times outside the mission's span are of a clock that was never set, and are left out. Silence
    between the files of one recording counts as a gap, that between recordings does not.
    """
    for (name, message_type), rows in sorted(topics.items()):
        counts = [row.message_count for row in rows]
        spans = list(_joined_spans(rows, start_ns, end_ns))
        steps = sum(max(0, span.count - 1) for span in spans)
        time_ns = sum(span.last_ns - span.first_ns for span in spans)
        yield TopicFacts(
            name=name,
            message_type=message_type or None,
            count=None if None in counts else sum(count or 0 for count in counts),
            first_ns=min((span.first_ns for span in spans), default=None),
            last_ns=max((span.last_ns for span in spans), default=None),
            rate_hz=steps * 1e9 / time_ns if time_ns > 0 and steps > 0 else None,
            longest_gap_ns=max((span.longest_gap_ns for span in spans), default=0) if steps > 0 else None,
            recordings=tuple(
                sorted({row.recording for row in rows if row.recording is not None and row.message_count != 0})
            ),
        )


def _joined_spans(rows: Sequence[_TopicOfFile], start_ns: int | None, end_ns: int | None) -> Iterator[StampSpan]:
    spans: dict[str | None, list[StampSpan]] = defaultdict(list)
    for row in rows:
        if row.first_ns is None or row.last_ns is None or start_ns is None or end_ns is None:
            continue
        if row.first_ns >= start_ns and row.last_ns <= end_ns:
            span = StampSpan(row.first_ns, row.last_ns, row.message_count or 0, row.longest_gap_ns or 0)
            spans[row.recording].append(span)
    for recording, own in spans.items():
        yield from own if recording is None else join_spans(own)
