"""Exports recordings on the server as tables or images, each mission to a folder of its own.

Fetches indexes and the chunks that are needed, in ranges, straight from the store. One mission is read at a time.
"""

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING
from uuid import UUID

from kleinkram.client.errors import DestinationRefused, InvalidInput, NothingToDo
from kleinkram.client.transfer.slices import recordings_of, time_range_errors
from kleinkram.contract.errors import FileUnavailable
from kleinkram.contract.files import ContentState, FileRead, RecordingRead
from kleinkram.contract.names import check_name

if TYPE_CHECKING:
    from kleinkram.client._client import Client
    from kleinkram.recordings.writing.export import ExportFormat, ExportOptions, ExportPlan, ExportResult
    from kleinkram.recordings.writing.topic_rows import NamedRecording

_NOT_READ = ": the server has not read the files yet, which takes a moment after an upload"
OnShare = Callable[[float], None]


@dataclass(frozen=True)
class MissionRecordings:
    """The recordings of a mission that are exported, single files of others, and the folder of the export."""

    project: str
    mission: str
    recordings: Sequence[RecordingRead | FileRead]
    folder: Path


@dataclass(frozen=True)
class OpenedRecordings:
    """The recordings of a mission that could be opened, and why others could not, by name."""

    recordings: Sequence["NamedRecording"]
    unread: Mapping[str, str]


@dataclass(frozen=True)
class MissionExport:
    """What was exported of a mission.

    Attributes:
        result: files, topics that were left out, and problems; None where nothing could be exported.
        unread: why recordings could not be opened, by name.
        error: why nothing was exported; None where something was.
    """

    project: str
    mission: str
    folder: Path
    result: "ExportResult | None"
    unread: Mapping[str, str]
    error: str | None


def plan_exports(
    client: "Client", files: Iterable[FileRead], dest: Path, *, nested: bool = True
) -> list[MissionRecordings]:
    """Return the recordings of these files by mission; other files are left out, as are recordings that runs made.

    Of a mission in which only recordings that runs made are selected, these are taken. With `nested`, the folder is
    DEST/PROJECT/MISSION.

    Raises:
        NothingToDo: there is no recording among the files.
        InvalidInput: the files are of several missions, and not `nested`.
        DestinationRefused: the name of a project or mission cannot be that of a folder.
    """
    files = [*files]
    by_mission: dict[UUID, list[FileRead]] = defaultdict(list)
    for file in files:
        by_mission[file.mission.id].append(file)
    if len(by_mission) > 1 and not nested:
        raise InvalidInput(what="The selection", reason="its files are of several missions: use nested=True")
    missions: list[MissionRecordings] = []
    for mission_id, mission_files in by_mission.items():
        selected = [*recordings_of(client, mission_id, mission_files)]
        recorded = [one for one in selected if not one.is_derived] or selected
        project, mission = mission_files[0].mission.project.name, mission_files[0].mission.name
        if recorded:
            folder = _folder_of(dest, project, mission) if nested else dest
            missions.append(MissionRecordings(project, mission, recorded, folder))
    if not missions:
        is_pending = any(file.content is ContentState.pending for file in files)
        raise NothingToDo(reason=f"No recording matches{_NOT_READ if is_pending else ''}")
    return missions


def _folder_of(dest: Path, project: str, mission: str) -> Path:
    try:
        return dest / check_name(project) / check_name(mission)
    except ValueError as error:
        raise DestinationRefused(path=f"{project}/{mission}", reason=f"the server's name for it {error}") from None


def in_range(mission: MissionRecordings, options: "ExportOptions") -> tuple[MissionRecordings, "ExportOptions"]:
    """Return what of a mission may have messages in the time range, and options with its log times. Opens nothing.

    All of it where the server does not know all times yet: then those in the recordings decide.

    Raises:
        InvalidInput: the time range is empty, or a text is no time.
        OutsideRecording: nothing was recorded in it.
    """
    from kleinkram.recordings.messages import Selection
    from kleinkram.recordings.writing.mcap import may_overlap, select_range

    is_known = all(one.start_ns is not None for one in mission.recordings)
    if (options.start, options.end) == (None, None) or not is_known:
        return mission, options
    with time_range_errors():
        start_ns, end_ns = select_range(mission.recordings, options.start, options.end, name=mission.mission)
    selection = Selection(None, start_ns, end_ns)
    recordings = [one for one in mission.recordings if may_overlap(one, selection)]
    return replace(mission, recordings=recordings), replace(options, start=start_ns, end=end_ns)


@contextmanager
def open_recordings(client: "Client", mission: MissionRecordings) -> Iterator[OpenedRecordings]:
    """Open the recordings of a mission for reading, for the duration of a `with`.

    Raises:
        ServerUnreachable: the server stayed unavailable.
    """
    from kleinkram.recordings.errors import RecordingError
    from kleinkram.recordings.writing.topic_rows import NamedRecording

    opened: list[NamedRecording] = []
    unread: dict[str, str] = {}
    with ExitStack() as stack:
        for one in mission.recordings:
            name = one.name if isinstance(one, RecordingRead) else one.path
            name = mission.mission if name == "." else name
            try:
                opened.append(NamedRecording(name, stack.enter_context(client.recordings.open(one))))
            except (RecordingError, FileUnavailable) as error:
                unread[name] = str(error)
        yield OpenedRecordings(opened, unread)


def export_missions(
    client: "Client",
    missions: Iterable[MissionRecordings],
    to: "ExportFormat",
    options: "ExportOptions",
    *,
    resume: bool = False,
    on_progress: Callable[[MissionRecordings, float], None] | None = None,
) -> list[MissionExport]:
    """Export each mission to its folder, as `recordings.export_recordings` does; one that fails stops no other.

    Raises:
        DestinationRefused: a folder exists, and not `resume`; nothing was exported.
        InvalidInput: the time range is empty, or a text is no time.
        CannotWrite: a folder cannot be written to or is full, or holds another export.
        ServerUnreachable: the server stayed unavailable.
    """
    missions = [*missions]
    if not resume:
        for mission in missions:
            refuse_existing_folder(mission.folder)

    def show(mission: MissionRecordings) -> OnShare | None:
        return None if on_progress is None else lambda share: on_progress(mission, share)

    return [_export(client, mission, to, options, resume=resume, on_progress=show(mission)) for mission in missions]


def plan_export(recordings: Sequence["NamedRecording"], to: "ExportFormat", options: "ExportOptions") -> "ExportPlan":
    """Return what would be written, as `recordings.writing.export.plan_export` does.

    Raises:
        InvalidInput: the time range is empty, or a text is no time.
        RecordingError: NoSuchTopic, OutsideRecording.
    """
    from kleinkram.recordings.writing import export

    with time_range_errors():
        return export.plan_export(recordings, to, options)


def refuse_existing_folder(folder: Path) -> None:
    """Raise DestinationRefused if there is such a file or folder."""
    if folder.exists() or folder.is_symlink():
        remedy = "choose another name, or continue an export that was interrupted (--continue, resume=True)"
        reason = f"there is such a file or folder; {remedy}"
        raise DestinationRefused(path=str(folder), reason=reason)


def _export(
    client: "Client",
    mission: MissionRecordings,
    to: "ExportFormat",
    options: "ExportOptions",
    *,
    resume: bool,
    on_progress: OnShare | None,
) -> MissionExport:
    from kleinkram.recordings.errors import CannotWrite, RecordingError
    from kleinkram.recordings.writing.export import export_recordings

    result, error, unread = None, None, dict[str, str]()
    try:
        mission, options = in_range(mission, options)
        with open_recordings(client, mission) as opened:
            unread.update(opened.unread)
            if opened.recordings:
                plan_export(opened.recordings, to, options)
                result = export_recordings(
                    opened.recordings, mission.folder, to, options, resume=resume, on_progress=on_progress
                )
            else:
                error = "none of its recordings can be read"
    except CannotWrite:
        raise
    except RecordingError as failure:
        error = str(failure)
    if result is not None and not result.files:
        error = "none of its topics can be exported" if result.left_out else "it has no such topics"
    return MissionExport(mission.project, mission.mission, mission.folder, result, unread, error)
