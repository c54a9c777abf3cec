"""Cuts what was recorded around events: one MCAP for each event, of the recordings of its mission at that time.

Fetches the indexes and the chunks that are needed, in ranges, straight from the store. Events are cut in order of time;
of each mission, only the recordings that later events may need are open.
"""

import os
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING
from uuid import UUID

from kleinkram.client._client import Client
from kleinkram.client.errors import ClientError, DestinationRefused, FileUnreadable, NothingToDo, ServerUnreachable
from kleinkram.client.transfer.download_target import make_folders
from kleinkram.client.transfer.report import Outcome, TransferReport, TransferResult, Watcher
from kleinkram.client.transfer.slices import failure_of, make_dest
from kleinkram.contract.errors import FileUnavailable, KleinkramError
from kleinkram.contract.files import RecordingRead
from kleinkram.contract.mission_events import EventReference, MissionEventRead
from kleinkram.contract.names import check_file_path, name_key

if TYPE_CHECKING:
    from kleinkram.recordings.recording import Recording, Topics
    from kleinkram.recordings.writing.mcap import McapOptions

# With a time, a part of the id and the name of a partial file, below the limit of file systems of 255.
_MAX_NAME_BYTES = 160


@dataclass(frozen=True)
class EventSlice:
    """An event, and where its slice goes: log times from `start_ns`, inclusive, to `end_ns`, exclusive."""

    event: MissionEventRead
    dest: Path
    relative: str
    start_ns: int
    end_ns: int

    @property
    def local(self) -> Path:
        """The path of the MCAP."""
        return self.dest / self.relative


@dataclass(frozen=True)
class EventSlicePlan:
    """The slices to cut, in order of missions and times, and what is left out because its name cannot be written."""

    slices: Sequence[EventSlice]
    left_out: Sequence[ClientError]


def plan_event_slices(events: Iterable[MissionEventRead], dest: Path, *, around_ns: int) -> EventSlicePlan:
    """Return a slice for each event, from `around_ns` before its start to as long after its end.

    A slice is named after its event and the start of that, as in `stumble-2026-05-01T10-00-00.000Z.mcap`; where events
    of several missions are cut, in PROJECT/MISSION/. Of events with the same name and time, the later ones have the
    first digits of their id in the name.
    """
    ordered = sorted(events, key=lambda event: (str(event.mission.id), event.start_ns, str(event.id)))
    is_nested = len({event.mission.id for event in ordered}) > 1
    slices: list[EventSlice] = []
    left_out: list[ClientError] = []
    taken: set[str] = set()
    for event in ordered:
        folder = f"{_plain(event.mission.project.name)}/{_plain(event.mission.name)}/" if is_nested else ""
        relative = f"{folder}{_stem(event)}.mcap"
        if name_key(relative) in taken:
            relative = f"{folder}{_stem(event)}-{event.id.hex[:8]}.mcap"
        try:
            check_file_path(relative)
        except ValueError as error:
            left_out.append(DestinationRefused(path=relative, reason=f"the server's name for it {error}"))
            continue
        taken.add(name_key(relative))
        last_ns = event.start_ns if event.end_ns is None else event.end_ns
        slices.append(EventSlice(event, dest, relative, max(0, event.start_ns - around_ns), last_ns + around_ns + 1))
    return EventSlicePlan(slices, left_out)


def _stem(event: MissionEventRead) -> str:
    from kleinkram.recordings.time_range import utc_text

    name = _plain(event.name).encode()[:_MAX_NAME_BYTES].decode(errors="ignore")
    return f"{name}-{utc_text(event.start_ns).replace(':', '-').replace(' ', '')}"


def _plain(name: str) -> str:
    """Return a name as a single part of a path that no shell or program hides."""
    plain = name.replace("/", "_").replace("\\", "_")
    return f"_{plain[1:]}" if plain.startswith((".", "-")) else plain


def cut_event_slices(
    client: Client,
    plan: EventSlicePlan,
    *,
    topics: "Topics | None" = None,
    options: "McapOptions | None" = None,
    watcher: Watcher | None = None,
) -> TransferReport:
    """Write the slice of each planned event as one MCAP, and return the result for each.

    The recordings of the mission at that time are merged, except those that runs made; of an event that refers to a
    file or a recording, it is that recording. An existing file stays, and is refused. `left_out` of the report has the
    events at whose time nothing of the topics was recorded, those that refer to something that is no longer in the
    mission, and recordings that cannot be read.

    Raises:
        NothingToDo: nothing was recorded at the time of any event.
        ServerUnreachable: the server stayed unavailable.
    """
    watcher = watcher or Watcher()
    watcher.began(len(plan.slices), 0)
    results: list[TransferResult] = []
    left_out: list[ClientError] = [*plan.left_out]
    for mission_id, slices in groupby(plan.slices, key=lambda one: one.event.mission.id):
        with ExitStack() as stack:
            recordings = _OpenRecordings(client, mission_id, stack)
            for one in slices:
                result = _cut(recordings, one, topics, options)
                if isinstance(result, TransferResult):
                    results.append(result)
                    error = result.error
                    watcher.ended(one.relative, result.outcome.value, str(error) if error else None)
                else:
                    left_out.append(result)
            left_out += recordings.unreadable
    if not results and left_out:
        raise left_out[0]
    return TransferReport(results, left_out)


class _OpenRecordings:
    """The recordings of one mission that slices need, opened once; only those that later slices may need stay open."""

    def __init__(self, client: Client, mission_id: UUID, stack: ExitStack) -> None:
        self._client = client
        self._rows = [row for row in client.recordings.list(mission_id) if not row.is_derived]
        self._open: dict[UUID, Recording | None] = {}
        self.unreadable: list[ClientError] = []
        stack.callback(self._close, lambda _row: True)

    def around(self, one: EventSlice) -> "list[Recording]":
        """Return the recordings that may have messages in a slice; slices are asked for in order of time."""
        from kleinkram.recordings.messages import Selection
        from kleinkram.recordings.writing.mcap import may_overlap

        selection = Selection(None, one.start_ns, one.end_ns)
        self._close(lambda row: row.end_ns is not None and row.end_ns < one.start_ns)
        rows = [row for row in self._rows if _is_of(one.event, row) and may_overlap(row, selection)]
        return [recording for recording in map(self._opened, rows) if recording is not None]

    def _opened(self, row: RecordingRead) -> "Recording | None":
        from kleinkram.recordings.errors import RecordingError

        if row.id not in self._open:
            try:
                self._open[row.id] = self._client.recordings.open(row)
            except RecordingError as error:
                self._open[row.id] = None
                self.unreadable.append(failure_of(error, row.name, Path(row.name)))
            except FileUnavailable as error:
                self._open[row.id] = None
                self.unreadable.append(FileUnreadable(path=row.name, reason=str(error)))
        return self._open[row.id]

    def _close(self, is_over: Callable[[RecordingRead], bool]) -> None:
        for row in self._rows:
            if is_over(row) and (recording := self._open.pop(row.id, None)) is not None:
                recording.close()


def _is_of(event: MissionEventRead, row: RecordingRead) -> bool:
    """Return whether an event is of a recording: none where what it refers to is gone."""
    if event.refers_to is EventReference.recording:
        return event.recording is not None and row.id == event.recording.id
    if event.refers_to is EventReference.file:
        return event.file is not None and event.file.id in row.file_ids
    return True


def _why_none(event: MissionEventRead) -> str:
    """Return why no recording has anything at the time of an event."""
    if event.refers_to is EventReference.mission or event.file is not None or event.recording is not None:
        return "nothing was recorded then"
    return f"the {event.refers_to.value} that the event refers to is no longer in the mission"


def _cut(
    recordings: _OpenRecordings, one: EventSlice, topics: "Topics | None", options: "McapOptions | None"
) -> "TransferResult | NothingToDo":
    """Write one slice; return its result, or why there is nothing to write."""
    from kleinkram.recordings.errors import NoSuchTopic, OutsideRecording, RecordingError
    from kleinkram.recordings.writing.mcap import merge_to_mcap

    try:
        if os.path.lexists(one.local):
            raise DestinationRefused(path=str(one.local), reason="it exists, and is not replaced; use another folder")
        sources = recordings.around(one)
        if not sources:
            return NothingToDo(reason=f"{one.relative}: {_why_none(one.event)}")
        make_dest(one.dest)
        make_folders(one.dest, one.relative)
        written = merge_to_mcap(sources, one.local, topics, start=one.start_ns, end=one.end_ns, options=options)
    except (OutsideRecording, NoSuchTopic) as error:
        return NothingToDo(reason=f"{one.relative}: {error}")
    except RecordingError as error:
        failure: KleinkramError = failure_of(error, one.relative, one.local)
    except ServerUnreachable:
        raise
    except KleinkramError as error:
        failure = error
    else:
        losses = tuple(f"{loss.file}: {loss.reason}" for loss in written.losses)
        size_bytes, outcome = written.size_bytes, Outcome.downloaded
        return TransferResult(one.relative, one.local, size_bytes, outcome, moved_bytes=size_bytes, losses=losses)
    return TransferResult(one.relative, one.local, 0, Outcome.refused, error=failure)
