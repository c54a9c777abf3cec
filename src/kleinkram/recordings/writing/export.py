"""Writes topics of the recordings of a mission as Parquet, CSV or images: one file or folder a topic.

A new folder gets a file for each topic of the mission (a folder, for images), and `index.json`, which lists them. A
folder a mission, rather than one file: topics differ in their columns, and a reader of one topic reads one file.

Each file appears when it is complete. `.export.jsonl` lists the complete files until all are, so that an export can
continue after it was interrupted. Memory: that of one topic (`topic_rows`, `csv_file`, `image_files`).
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any, BinaryIO

from kleinkram import __version__
from kleinkram.recordings.decoding.tables import load_pyarrow
from kleinkram.recordings.errors import CannotWrite
from kleinkram.recordings.messages import END_OF_TIME_NS, Selection, Time
from kleinkram.recordings.recording import OnProgress, Recording, Topics
from kleinkram.recordings.writing.csv_file import write_csv
from kleinkram.recordings.writing.image_files import ImageOptions, why_no_images, write_images
from kleinkram.recordings.writing.mcap import select_slice, share_read_ahead
from kleinkram.recordings.writing.new_file import lock, new_file, refuse_existing
from kleinkram.recordings.writing.parquet import column_units, write_parquet
from kleinkram.recordings.writing.topic_rows import (
    NamedRecording,
    OnRows,
    TopicGroup,
    Written,
    group_topics,
    sources_of,
)

INDEX_NAME = "index.json"
JOURNAL_NAME = ".export.jsonl"

_OTHER_EXPORT = "the export in it has other recordings or options: choose another name"


class ExportFormat(str, Enum):
    """What topics become."""

    parquet = "parquet"
    csv = "csv"
    images = "images"


@dataclass(frozen=True)
class ExportOptions:
    """What of the recordings is exported.

    Attributes:
        topics: names or globs; None: all, and all with images where images are written.
        start: earliest log time, inclusive; as in `Recording.raw_messages`, with `+20s` after the earliest recording.
        end: latest log time, exclusive.
        images: which images, and how; of no effect on tables.
    """

    topics: Topics | None = None
    start: Time | None = None
    end: Time | None = None
    images: ImageOptions = field(default_factory=ImageOptions)


@dataclass(frozen=True)
class ExportedFile:
    """The file of a topic; the folder of its images.

    Attributes:
        recordings: names of the recordings that have the topic.
        row_count: rows or images.
        size_bytes: of the file, or of all files of the folder.
        frame_id: of all messages; None where it differs, or where they have none.
        units: of columns, by their names.
        failed_count: messages whose image cannot be written; `failure`: why the first cannot.
    """

    topic: str
    message_type: str
    message_encoding: str
    recordings: tuple[str, ...]
    path: Path
    row_count: int
    size_bytes: int
    frame_id: str | None
    units: Mapping[str, str]
    failed_count: int = 0
    failure: str = ""


@dataclass(frozen=True)
class TopicLeftOut:
    """A topic of some recordings that is not exported, and why."""

    topic: str
    recordings: tuple[str, ...]
    reason: str


@dataclass(frozen=True)
class RecordingProblem:
    """A problem that was met while a recording was read: some of its messages are missing, or null."""

    recording: str
    code: str
    where: str
    message: str


@dataclass(frozen=True)
class ExportResult:
    """The written files by topic, the topics that were left out, and the problems that were met."""

    files: tuple[ExportedFile, ...]
    left_out: tuple[TopicLeftOut, ...]
    problems: tuple[RecordingProblem, ...]

    def to_plain(self, folder: Path) -> dict[str, object]:
        """Return what `json.dumps` takes, with paths relative to a folder."""
        return {
            "files": [_plain_file(file, folder) for file in self.files],
            "left_out": [asdict(item) for item in self.left_out],
            "problems": [asdict(problem) for problem in self.problems],
        }


@dataclass(frozen=True)
class PlannedFile:
    """A topic that is written, and the path of its file or folder below that of the export."""

    group: TopicGroup
    path: str


@dataclass(frozen=True)
class ExportPlan:
    """The files that an export writes, and the topics that it leaves out."""

    to: ExportFormat
    selection: Selection
    files: tuple[PlannedFile, ...]
    left_out: tuple[TopicLeftOut, ...]


def plan_export(
    recordings: Sequence[NamedRecording], to: ExportFormat, options: ExportOptions, *, with_recording: bool = True
) -> ExportPlan:
    """Return what would be written; reads no messages.

    Raises:
        NoSuchTopic: a name that is no glob is not among the topics of any recording.
        EmptyRange: the end is not after the start.
        OutsideRecording: nothing was recorded between start and end.
        ValueError: a text is no time.
    """
    selection = select_slice([one.recording for one in recordings], options.topics, options.start, options.end)
    files: list[PlannedFile] = []
    left_out: list[TopicLeftOut] = []
    for group in group_topics(recordings, selection, with_recording=with_recording):
        why_no_image = why_no_images(group.topic.message_type) if to is ExportFormat.images else None
        if why_no_image is not None and options.topics is None:
            continue
        reason = group.topic.undecodable or why_no_image
        if reason is None:
            suffix = "" if to is ExportFormat.images else f".{to.value}"
            files.append(PlannedFile(group, f"{group.name}{suffix}"))
        else:
            left_out.append(_left_out(group, reason))
    return ExportPlan(to, selection, tuple(files), tuple(left_out))


def _left_out(group: TopicGroup, reason: str) -> TopicLeftOut:
    return TopicLeftOut(group.topic.name, tuple(one.name for one in group.recordings), reason)


def export_recordings(
    recordings: Sequence[NamedRecording],
    folder: str | os.PathLike[str],
    to: ExportFormat,
    options: ExportOptions | None = None,
    *,
    resume: bool = False,
    on_progress: OnProgress | None = None,
) -> ExportResult:
    """Write the topics of the recordings of a mission to a new folder, with an `index.json`.

    Rows of all recordings are in one file a topic, in the order of log time, with the name of their recording. A topic
    with several types or encodings has several files. Without anything to write, there is no folder.

    Args:
        recordings: opened, with names that differ.
        folder: is made, with those above it.
        to: what topics become.
        options: topics, log times and images.
        resume: continue an export to this folder that was interrupted; its complete files stay. If it is complete,
            nothing is done.
        on_progress: called with the share that is done, from 0 to 1.

    Raises:
        CannotWrite: the folder exists (with `resume`: it holds no such export), or cannot be written to or is full.
        NoSuchTopic, EmptyRange, OutsideRecording, ValueError: as `plan_export`.
        ReadingExtraMissing: the extra `reading` is not installed.
        TooDisordered: too many parts of a recording overlap in time to be put in order in bounded memory.
        SourceError: the bytes cannot be read, or a local file was written to while it was read.
    """
    folder, options = Path(folder), options or ExportOptions()
    plan = plan_export(recordings, to, options)
    if not plan.files:
        return ExportResult((), plan.left_out, _problems_of(recordings))
    load_pyarrow()  # where it is missing, no folder is made
    request = _request_of(recordings, plan, options)
    if resume and (folder / INDEX_NAME).exists() and not (folder / JOURNAL_NAME).exists():
        return _read_index(folder, request)
    with _open_journal(folder, request, resume=resume) as journal:
        result = write_plan(plan, folder, options.images, journal=journal, on_progress=on_progress)
        (folder / INDEX_NAME).unlink(missing_ok=True)  # written just before it was interrupted
        with new_file(folder / INDEX_NAME) as stream:
            index = {"kleinkram": __version__, **request, **result.to_plain(folder)}
            stream.write(json.dumps(index, indent=2, ensure_ascii=False).encode())
        (folder / JOURNAL_NAME).unlink()
    return result


def export_topics(
    recording: Recording, folder: Path, to: ExportFormat, options: ExportOptions, on_progress: OnProgress | None
) -> ExportResult:
    """Write topics of one recording to a folder, as `Recording.to_parquet` describes."""
    name = Path(recording.name).name
    plan = plan_export([NamedRecording(name, recording)], to, options, with_recording=False)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CannotWrite(str(folder), f"the folder cannot be made: {error.strerror}") from error
    return write_plan(plan, folder, options.images, on_progress=on_progress)


def _request_of(recordings: Sequence[NamedRecording], plan: ExportPlan, options: ExportOptions) -> dict[str, object]:
    topics = [options.topics] if isinstance(options.topics, str) else options.topics
    start_ns, end_ns = plan.selection.start_ns, plan.selection.end_ns
    return {
        "to": plan.to.value,
        "recordings": [one.name for one in recordings],
        "sources": sources_of(recordings),
        "source_bytes": {one.name: one.recording.size_bytes for one in recordings},
        "topics": None if topics is None else [*topics],
        "start_ns": start_ns or None,
        "end_ns": None if end_ns == END_OF_TIME_NS else end_ns,
        **(asdict(options.images) if plan.to is ExportFormat.images else {}),
    }


def _read_index(folder: Path, request: Mapping[str, object]) -> ExportResult:
    """Return the result of an export that is complete; CannotWrite if the request was another."""
    with _reading(folder / INDEX_NAME):
        index = json.loads((folder / INDEX_NAME).read_bytes())
        if {name: index.get(name) for name in request} != request:
            raise CannotWrite(str(folder), _OTHER_EXPORT)
        return ExportResult(
            tuple(_read_file(file, folder) for file in index["files"]),
            tuple(TopicLeftOut(**{**item, "recordings": tuple(item["recordings"])}) for item in index["left_out"]),
            tuple(RecordingProblem(**problem) for problem in index["problems"]),
        )


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    """Raise CannotWrite where a file does not say what an export wrote."""
    try:
        yield
    except (ValueError, KeyError, TypeError, AttributeError, OSError) as error:
        raise CannotWrite(str(path), f"it cannot be read: {error}; choose another folder") from None


class ExportJournal:
    """The complete files of an export, in a file of one JSON document a line; the first is the request."""

    def __init__(self, folder: Path, stream: BinaryIO) -> None:
        self._folder, self._stream = folder, stream
        self.files: dict[str, ExportedFile] = {}
        self.problems: list[RecordingProblem] = []

    def begin(self, request: Mapping[str, object]) -> None:
        """Write the request."""
        self._append({"request": request})

    def read(self, request: Mapping[str, object]) -> None:
        """Read the files that are complete; CannotWrite if the request was another."""
        self._stream.seek(0)
        text = self._stream.read()
        whole = text[: text.rfind(b"\n") + 1]  # the last line may be cut
        self._stream.truncate(len(whole))
        if not whole:  # it was interrupted before anything was written
            self.begin(request)
            return
        with _reading(self._folder / JOURNAL_NAME):
            first, *lines = [json.loads(line) for line in whole.splitlines()] or [{}]
            if first.get("request") != request:
                raise CannotWrite(str(self._folder), _OTHER_EXPORT)
            for line in lines:
                self.files[line["file"]["path"]] = _read_file(line["file"], self._folder)
                self.problems += [RecordingProblem(**problem) for problem in line["problems"]]

    def add(self, file: ExportedFile, problems: Sequence[RecordingProblem]) -> None:
        """Note that a file is complete, and the problems that were met so far."""
        self._append({"file": _plain_file(file, self._folder), "problems": [asdict(problem) for problem in problems]})

    def _append(self, document: Mapping[str, object]) -> None:
        self._stream.write(json.dumps(document).encode() + b"\n")
        self._stream.flush()
        os.fsync(self._stream.fileno())


def _plain_file(file: ExportedFile, folder: Path) -> dict[str, Any]:
    return {**asdict(file), "path": file.path.relative_to(folder).as_posix(), "recordings": [*file.recordings]}


def _read_file(plain: Mapping[str, Any], folder: Path) -> ExportedFile:
    return ExportedFile(**{**plain, "path": folder / plain["path"], "recordings": tuple(plain["recordings"])})


@contextmanager
def _open_journal(folder: Path, request: Mapping[str, object], *, resume: bool) -> Iterator[ExportJournal]:
    """Make the folder of an export and its journal, or open those of an interrupted one; only one process at a time."""
    path = folder / JOURNAL_NAME
    is_continued = resume and folder.exists()
    if is_continued and not path.exists():
        raise CannotWrite(str(folder), "there is no export in it that can continue: choose another name")
    if not is_continued:
        refuse_existing(folder)
    try:
        if not is_continued:
            folder.mkdir(parents=True)
        with path.open("a+b") as stream:
            lock(stream.fileno(), path)
            journal = ExportJournal(folder, stream)
            if is_continued:
                journal.read(request)
            else:
                journal.begin(request)
            yield journal
    except BlockingIOError:
        raise CannotWrite(str(folder), "another process is writing it") from None
    except OSError as error:
        raise CannotWrite(str(folder), f"cannot be written: {error.strerror or error}") from error


def write_plan(
    plan: ExportPlan,
    folder: Path,
    images: ImageOptions,
    *,
    journal: ExportJournal | None = None,
    on_progress: OnProgress | None = None,
) -> ExportResult:
    """Write the files of a plan to a folder that exists; with a journal, those that it does not have yet."""
    recordings = [*{id(one): one for planned in plan.files for one in planned.group.recordings}.values()]
    share_read_ahead([one.recording for one in recordings], with_gaps=images.rate_hz is not None)
    outcomes: list[ExportedFile | TopicLeftOut] = [*plan.left_out]
    for number, planned in enumerate(plan.files):
        path = folder / planned.path
        outcome: ExportedFile | TopicLeftOut | None = None
        if journal is not None:
            outcome = journal.files.get(planned.path) if path.exists() else None
        if outcome is None:
            if journal is not None:
                _remove(path)  # written, but not noted, when the export was interrupted
            on_rows = _counter(on_progress, number, len(plan.files), planned.group.message_count)
            outcome = _write_topic(plan, planned.group, path, images, on_rows)
            if journal is not None and isinstance(outcome, ExportedFile):
                journal.add(outcome, _problems_of(recordings))
        outcomes.append(outcome)
    if on_progress is not None:
        on_progress(1.0)
    files = tuple(outcome for outcome in outcomes if isinstance(outcome, ExportedFile))
    left_out = tuple(outcome for outcome in outcomes if isinstance(outcome, TopicLeftOut))
    problems = dict.fromkeys([*(journal.problems if journal else ()), *_problems_of(recordings)])
    return ExportResult(files, left_out, tuple(problems))


def _write_topic(
    plan: ExportPlan, group: TopicGroup, path: Path, images: ImageOptions, on_rows: OnRows
) -> ExportedFile | TopicLeftOut:
    arrow_error = load_pyarrow().ArrowException
    try:
        written = _write(plan, group, path, images, on_rows)
    except arrow_error as error:
        return _left_out(group, f"its columns cannot be written: {error}")
    for one in group.recordings:
        one.recording.check_unchanged()
    if plan.to is ExportFormat.images and not written.row_count:
        return _left_out(group, written.failure or "it has no images in this time")
    return _exported(plan.to, group, path, written)


def _problems_of(recordings: Sequence[NamedRecording]) -> tuple[RecordingProblem, ...]:
    return tuple(RecordingProblem(one.name, **vars(p)) for one in recordings for p in one.recording.problem_log.all())


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def _write(plan: ExportPlan, group: TopicGroup, path: Path, images: ImageOptions, on_rows: OnRows) -> Written:
    if plan.to is ExportFormat.images:
        return write_images(group, path, plan.selection, images, on_rows)
    write = write_parquet if plan.to is ExportFormat.parquet else write_csv
    return write(group, path, plan.selection, on_rows)


def _exported(to: ExportFormat, group: TopicGroup, path: Path, written: Written) -> ExportedFile:
    topic = group.topic
    units = {} if to is ExportFormat.images else column_units(group) if to is ExportFormat.parquet else group.units()
    return ExportedFile(
        topic.name,
        topic.message_type,
        topic.message_encoding,
        tuple(one.name for one in group.recordings),
        path,
        written.row_count,
        written.size_bytes,
        written.frame_id,
        units,
        written.failed_count,
        written.failure,
    )


def _counter(on_progress: OnProgress | None, number: int, count: int, messages: int | None) -> OnRows:
    """Return what reports the share of all topics that is done, at most a thousand times."""
    done, shown = 0, -1

    def on_rows(more: int) -> None:
        nonlocal done, shown
        done += more
        share = (number + (min(1.0, done / messages) if messages else 0)) / count
        if on_progress is not None and int(share * 1000) > shown:
            shown = int(share * 1000)
            on_progress(share)

    return on_rows
