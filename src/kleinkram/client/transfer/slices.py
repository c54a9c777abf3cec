"""Downloads slices of recordings: topics, or a time range, of each recording as one MCAP at its path.

Fetches the indexes and the chunks that are needed, in ranges, straight from the store. One recording is read at a time.
"""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING
from uuid import UUID

from kleinkram.client._client import Client
from kleinkram.client.errors import (
    ClientError,
    DestinationRefused,
    FileUnreadable,
    InvalidInput,
    NothingToDo,
    ServerUnreachable,
    TransferFailed,
)
from kleinkram.client.transfer.download_target import make_folders, partial_path, regular_size
from kleinkram.client.transfer.report import Outcome, TransferReport, TransferResult, Watcher
from kleinkram.contract.errors import KleinkramError
from kleinkram.contract.files import FileRead, RecordingRead
from kleinkram.contract.names import check_file_path

if TYPE_CHECKING:
    from kleinkram.recordings.errors import RecordingError
    from kleinkram.recordings.messages import Selection, Time
    from kleinkram.recordings.recording import Topics
    from kleinkram.recordings.writing.mcap import McapOptions


@dataclass(frozen=True)
class SliceRange:
    """What of each recording is downloaded; None: all topics, from the start, to the end.

    Times such as `10:00` and `+20s` refer to the earliest start of the recordings.
    """

    topics: "Topics | None" = None
    start: "Time | None" = None
    end: "Time | None" = None


@dataclass(frozen=True)
class SliceTarget:
    """A recording, or a single file of one, and where its slice goes: `relative` below `dest`."""

    recording: RecordingRead | FileRead
    dest: Path
    relative: str

    @property
    def name(self) -> str:
        """The name of the recording, or the path of the file."""
        return self.recording.name if isinstance(self.recording, RecordingRead) else self.recording.path


@dataclass(frozen=True)
class SlicePlan:
    """The recordings to download slices of, and what is left out because its name cannot be written here."""

    targets: Sequence[SliceTarget]
    left_out: Sequence[ClientError]


def plan_slices(client: Client, files: Iterable[FileRead], dest: Path, *, nested: bool = False) -> SlicePlan:
    """Return the recordings of these files, and where their slices go: `nuc/drive.bag` becomes `nuc/drive.mcap`.

    If only some files of a recording are among them, each of these is a slice of its own. Other files are left out.
    """
    from kleinkram.recordings.writing.conversion import without_extensions

    by_mission: dict[UUID, list[FileRead]] = defaultdict(list)
    for file in files:
        by_mission[file.mission.id].append(file)
    targets: dict[str, SliceTarget] = {}
    left_out: list[ClientError] = []
    for mission_id, mission_files in by_mission.items():
        mission = mission_files[0].mission
        above = f"{mission.project.name}/{mission.name}/" if nested else ""
        for recording in recordings_of(client, mission_id, mission_files):
            name = recording.name if isinstance(recording, RecordingRead) else recording.path
            relative = f"{above}{without_extensions(name if name != '.' else mission.name)}.mcap"
            if relative in targets:
                relative = f"{relative.removesuffix('.mcap')}-{PurePosixPath(name).suffix.strip('.') or 'slice'}.mcap"
            try:
                target = SliceTarget(recording, dest, check_file_path(relative))
            except ValueError as error:
                reason = f"the server's name for it {error}"
                left_out.append(DestinationRefused(path=relative, reason=reason))
                continue
            if relative in targets:
                reason = f"the slice of {targets[relative].name} has the same path; use --nested"
                left_out.append(DestinationRefused(path=relative, reason=reason))
                continue
            targets[relative] = target
    return SlicePlan([*targets.values()], left_out)


def recordings_of(client: Client, mission_id: UUID, files: Sequence[FileRead]) -> Iterator[RecordingRead | FileRead]:
    """Yield the recordings of which all files are selected, and single files of others."""
    selected = {file.id: file for file in files}
    for recording in client.recordings.list(mission_id):
        own = [selected[file_id] for file_id in recording.file_ids if file_id in selected]
        if own and len(own) == len(recording.file_ids):
            yield recording
        else:
            yield from own


def download_slices(
    client: Client,
    plan: SlicePlan,
    what: SliceRange,
    *,
    options: "McapOptions | None" = None,
    overwrite: bool = False,
    watcher: Watcher | None = None,
) -> TransferReport:
    """Write the slice of each planned recording, and return the result for each.

    A recording that has none of the topics, or nothing in the time range, is left out. An existing file stays, and is
    refused unless `overwrite`. `left_out` of the report has a topic that no recording has.

    Raises:
        NothingToDo: no recording has any of it.
        InvalidInput: the time range is empty, or a text is no time.
        ServerUnreachable: the server stayed unavailable.
    """
    slicer = _Slicer(client, plan, what, options, overwrite=overwrite, watcher=watcher or Watcher())
    slicer.run()
    missing = [NothingToDo(reason=f"No recording has a topic {topic}") for topic in slicer.unmatched_topics()]
    if not slicer.results:
        raise missing[0] if missing else NothingToDo(reason="No recording has messages in this time range")
    return TransferReport(slicer.results, [*plan.left_out, *missing])


class _Slicer:
    """One run of a download of slices."""

    def __init__(
        self,
        client: Client,
        plan: SlicePlan,
        what: SliceRange,
        options: "McapOptions | None",
        *,
        overwrite: bool,
        watcher: Watcher,
    ) -> None:
        topics = what.topics
        self._patterns = None if topics is None else [topics] if isinstance(topics, str) else [*topics]
        self._client, self._options = client, options
        self._overwrite, self._watcher = overwrite, watcher
        self._range, self._targets = select_targets(plan, what)
        self._matched: set[str] = set()
        self._read_count = 0
        self.results: list[TransferResult] = []

    def run(self) -> None:
        self._watcher.began(len(self._targets), sum(target.recording.size_bytes for target in self._targets))
        for target in self._targets:
            result = self._result(target)
            if result is not None:
                self.results.append(result)
                error = result.error
                self._watcher.ended(target.name, result.outcome.value, str(error) if error else None)

    def unmatched_topics(self) -> list[str]:
        """Return the names and globs that matched no topic of the recordings that were read."""
        if not self._read_count:
            return []
        return [pattern for pattern in self._patterns or () if pattern not in self._matched]

    def _result(self, target: SliceTarget) -> TransferResult | None:
        from kleinkram.recordings.errors import OutsideRecording, RecordingError

        local = target.dest / target.relative
        try:
            return self._write(target)
        except OutsideRecording:
            return None
        except RecordingError as error:
            failure: KleinkramError = failure_of(error, target.name, local)
        except ServerUnreachable:
            raise
        except KleinkramError as error:
            failure = error
        return TransferResult(target.name, local, 0, Outcome.refused, error=failure)

    def _write(self, target: SliceTarget) -> TransferResult | None:
        local = target.dest / target.relative
        is_there = regular_size(local) is not None
        if is_there and not self._overwrite:
            reason = "it exists, and is not compared; use --overwrite to replace it, or another --dest"
            raise DestinationRefused(path=str(local), reason=reason)
        part = partial_path(local, ".klein-slice") if is_there else local
        with self._client.recordings.open(target.recording) as recording:
            topics = self._matching([topic.name for topic in recording.topics])
            if topics is not None and not topics:
                return None
            make_dest(target.dest)
            make_folders(target.dest, target.relative)
            if is_there:
                part.unlink(missing_ok=True)  # of a killed process
            moved = 0

            def show(share: float) -> None:
                nonlocal moved
                size_bytes = target.recording.size_bytes
                self._watcher.moved(target.name, int(share * size_bytes) - moved, size_bytes)
                moved = int(share * size_bytes)

            written = recording.to_mcap(
                part,
                topics,
                start=self._range.start_ns,
                end=self._range.end_ns,
                options=self._options,
                on_progress=show,
            )
        part.replace(local)
        losses = tuple(f"{loss.file}: {loss.reason}" for loss in written.losses)
        for loss in losses:
            self._watcher.notify(f"{target.name}: lost: {loss}")
        size_bytes = written.size_bytes
        return TransferResult(target.name, local, size_bytes, Outcome.downloaded, moved_bytes=size_bytes, losses=losses)

    def _matching(self, names: Sequence[str]) -> list[str] | None:
        """Return the names that the topics select in one recording; None for all."""
        if self._patterns is None:
            return None
        from kleinkram.recordings.errors import NoSuchTopic
        from kleinkram.recordings.recording import select_names

        self._read_count += 1
        selected: set[str] = set()
        for pattern in self._patterns:
            try:
                own = select_names([pattern], names) or frozenset()
            except NoSuchTopic:
                continue
            if own:
                self._matched.add(pattern)
                selected |= own
        return sorted(selected)


def failure_of(error: "RecordingError", name: str, local: Path) -> ClientError:
    """Return why a slice of this name was not written to its path."""
    from kleinkram.recordings.errors import CannotWrite, NotConvertible, SourceError

    if isinstance(error, NotConvertible):
        return FileUnreadable(path=name, reason=error.reason)
    if isinstance(error, CannotWrite):
        return DestinationRefused(path=str(local), reason=error.reason)
    if isinstance(error, SourceError):
        return TransferFailed(path=name, reason=str(error))
    return FileUnreadable(path=name, reason=str(error))


def make_dest(dest: Path) -> None:
    """Make the folder of a download. Raises DestinationRefused."""
    try:
        dest.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DestinationRefused(path=str(dest), reason=error.strerror or str(error)) from None


def select_targets(plan: SlicePlan, what: SliceRange) -> "tuple[Selection, list[SliceTarget]]":
    """Return the log times of a range, and what of a plan may have messages in it. Opens nothing.

    Raises:
        InvalidInput: the time range is empty, or a text is no time.
        NothingToDo: nothing was recorded in it.
    """
    from kleinkram.recordings.errors import OutsideRecording
    from kleinkram.recordings.messages import Selection
    from kleinkram.recordings.writing.mcap import may_overlap, select_range

    recordings = [target.recording for target in plan.targets]
    try:
        with time_range_errors():
            times = select_range(recordings, what.start, what.end, name="The selected recordings")
    except OutsideRecording as error:
        raise NothingToDo(reason=str(error)) from None
    selection = Selection(None, *times)
    return selection, [target for target in plan.targets if may_overlap(target.recording, selection)]


@contextmanager
def time_range_errors() -> Iterator[None]:
    """Raise InvalidInput where a time range is empty, or a text in it is no time."""
    from kleinkram.recordings.errors import EmptyRange

    try:
        yield
    except (EmptyRange, TypeError, ValueError) as error:
        raise InvalidInput(what="The time range", reason=str(error)) from None
