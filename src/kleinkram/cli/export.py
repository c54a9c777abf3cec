"""`klein export`: topics of local recordings, of a mission or of a search as Parquet, CSV or images."""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from kleinkram.cli import options
from kleinkram.cli.commands import Many, argument, flag, option, with_option_groups
from kleinkram.cli.cut import open_readable, watch_shares
from kleinkram.cli.errors import ExitCode
from kleinkram.cli.filters import Choice, select_files
from kleinkram.cli.render import Output, note, table
from kleinkram.cli.units import count, size
from kleinkram.client import Client, connect
from kleinkram.client._resources import is_glob
from kleinkram.client.errors import InvalidInput, NothingToDo
from kleinkram.client.exports import (
    MissionExport,
    MissionRecordings,
    OpenedRecordings,
    export_missions,
    in_range,
    open_recordings,
    plan_export,
    plan_exports,
    refuse_existing_folder,
)
from kleinkram.recordings import Recording, RecordingError
from kleinkram.recordings.open_paths import find_recordings
from kleinkram.recordings.writing.export import ExportFormat, ExportOptions, ExportPlan, export_recordings
from kleinkram.recordings.writing.image_files import ImageOptions
from kleinkram.recordings.writing.topic_rows import NamedRecording

_REMEDY = "Run the same command with --continue to continue."


@dataclass(frozen=True)
class _ExportRequest:
    to: ExportFormat
    options: ExportOptions
    output: Path
    resume: bool
    dry_run: bool


@with_option_groups
def export(
    choice: Choice,
    to: Annotated[ExportFormat, option("--to", None, "Write a table for each topic, or its images.")],
    sources: Annotated[
        Many, argument("SOURCE", "Files and folders; with a selection, paths, globs or ids of files.")
    ] = None,
    topics: options.TopicsOption = None,
    start: options.StartOption = None,
    end: options.EndOption = None,
    every: Annotated[int, option("--every", "N", "Of images, write the first of every N.", min=1)] = 1,
    rate: Annotated[float | None, option("--rate", "HZ", "Write at most HZ images a second of log time.")] = None,
    jpeg: Annotated[
        bool, flag("--jpeg", "Write uncompressed images of 8 bits as JPEG (lossy) instead of PNG.")
    ] = False,
    output: Annotated[Path | None, option("--output -o", "DIR", "The folder to make; it must not exist.")] = None,
    resume: Annotated[bool, flag("--continue", "Continue an export to this folder that was interrupted.")] = False,
    dry_run: options.DryRun = False,
) -> Output:
    """Write topics of recordings as Parquet or CSV, one file a topic, or their images, one folder a topic.

    The recordings of SOURCE are written to DIR as those of one mission: rows of all of them are in one file, by log
    time. Those of a mission on the server (-m) are, too; with --query or other selections, each mission is written to
    DIR/PROJECT/MISSION. Only the chunks that are needed are fetched. `index.json` lists the files.

    Topics that cannot be decoded are named and left out. The exit code is 10 if a mission could not be exported.
    """
    if output is None and not dry_run:
        raise InvalidInput(what="The command", reason="specify the folder to write to: -o DIR")
    if to is not ExportFormat.images and (every != 1 or rate is not None or jpeg):
        raise InvalidInput(what="--every, --rate and --jpeg", reason="they select images: use --to images")
    try:
        images = ImageOptions(every, rate, jpeg)
    except ValueError as error:
        raise InvalidInput(what="The selection of images", reason=str(error)) from None
    what = ExportOptions(options.topic_names(topics), start, end, images)
    request = _ExportRequest(to, what, output or Path(), resume, dry_run)
    if choice.is_empty():
        if not sources:
            raise InvalidInput(what="The command", reason="specify files or folders, or a mission with -m")
        return _export_local(sources, request)
    with connect() as client:
        return _export_remote(client, choice, sources or [], request)


def _export_local(sources: Sequence[str], request: _ExportRequest) -> Output:
    with _open_local(sources) as opened:
        plan = plan_export(opened.recordings, request.to, request.options)
        if request.dry_run:
            return _show_plans([(None, opened, plan)])
        if not request.resume:
            refuse_existing_folder(request.output)
        if not plan.files and not plan.left_out:
            topics = ", ".join(request.options.topics or [])
            raise NothingToDo(
                reason=f"No topic matches {topics}" if topics else f"There is no topic to export as {request.to.value}"
            )
        with watch_shares(_REMEDY) as watch:
            result = export_recordings(
                opened.recordings,
                request.output,
                request.to,
                request.options,
                resume=request.resume,
                on_progress=watch(request.output.name),
            )
    error = None if result.files else "none of the topics can be exported"
    return _show_exports([MissionExport("", "", request.output, result, opened.unread, error)], request.output)


@contextmanager
def _open_local(sources: Sequence[str]) -> Iterator[OpenedRecordings]:
    """Open local recordings; one that cannot be read is named, if there are others."""
    with ExitStack() as stack:
        results = [(item.name, open_readable(item.open)) for item in find_recordings(sources)]
        recordings = [
            NamedRecording(name, stack.enter_context(one)) for name, one in results if isinstance(one, Recording)
        ]
        failures = {name: one for name, one in results if not isinstance(one, Recording)}
        if not recordings:
            raise next(iter(failures.values()))
        yield OpenedRecordings(recordings, {name: str(error) for name, error in failures.items()})


def _export_remote(client: Client, choice: Choice, sources: Sequence[str], request: _ExportRequest) -> Output:
    missions = plan_exports(
        client, select_files(client, choice, sources), request.output, nested=not _is_one_mission(choice)
    )
    if request.dry_run:
        return _show_plans(_plans(client, missions, request))
    with watch_shares(_REMEDY) as watch:
        on_share = watch(request.output.name)
        shares = {(mission.project, mission.mission): 0.0 for mission in missions}

        def show(mission: MissionRecordings, share: float) -> None:
            shares[mission.project, mission.mission] = share
            if on_share is not None:
                on_share(sum(shares.values()) / len(shares))

        exports = export_missions(
            client, missions, request.to, request.options, resume=request.resume, on_progress=show
        )
    return _show_exports(exports, request.output)


def _is_one_mission(choice: Choice) -> bool:
    """Return whether the options name one mission, whatever they match: its files are then in DIR itself."""
    missions, projects = choice.mission or [], choice.project or []
    return len(missions) == 1 and len(projects) < 2 and not any(map(is_glob, [*missions, *projects]))


_Planned = tuple[MissionRecordings | None, OpenedRecordings, ExportPlan]


def _plans(client: Client, missions: Sequence[MissionRecordings], request: _ExportRequest) -> list[_Planned]:
    """Plan each mission; note those of which nothing would be exported, if there are others."""
    results = [(mission, _plan(client, mission, request)) for mission in missions]
    plans = [plan for _, plan in results if not isinstance(plan, RecordingError)]
    failures = [(mission, plan) for mission, plan in results if isinstance(plan, RecordingError)]
    if not plans:
        raise failures[0][1]
    for mission, error in failures:
        note(f"Would leave out {mission.project}/{mission.mission}: {error}")
    return plans


def _plan(client: Client, mission: MissionRecordings, request: _ExportRequest) -> _Planned | RecordingError:
    try:
        near, what = in_range(mission, request.options)
        with open_recordings(client, near) as opened:
            return near, opened, plan_export(opened.recordings, request.to, what)
    except RecordingError as error:
        return error


def _show_plans(plans: Sequence[_Planned]) -> Output:
    """Print what would be written."""
    items: list[dict[str, object]] = []
    for mission, opened, plan in plans:
        above = "" if mission is None else f"{mission.project}/{mission.mission}/"
        items += [
            {
                "topic": file.group.topic.name,
                "message_type": file.group.topic.message_type,
                "message_count": file.group.message_count,
                "recordings": [one.name for one in file.group.recordings],
                "path": f"{above}{file.path}",
            }
            for file in plan.files
        ]
        for topic in plan.left_out:
            note(f"Would leave out {above}{topic.topic}: {topic.reason}")
        for name, reason in opened.unread.items():
            note(f"Would leave out {above}{name}: {reason}")
    note(f"Would write {count(len(items), 'topic')}.")
    cells = [(item["topic"], item["message_type"], item["message_count"], item["path"]) for item in items]
    return Output({"dry_run": True, "items": items}, lambda: table(["topic", "type", "messages", "to"], cells))


def _show_exports(exports: Sequence[MissionExport], output: Path) -> Output:
    """Print the files, and what is missing in them."""
    items: list[dict[str, object]] = []
    rows: list[tuple[object, ...]] = []
    for one in exports:
        plain = {} if one.result is None else one.result.to_plain(one.folder)
        names = {"project": one.project or None, "mission": one.mission or None, "folder": str(one.folder)}
        items.append({**names, "error": one.error, "unread": dict(one.unread), **plain})
        _note_missing(one)
        files = one.result.files if one.result is not None else ()
        rows += [
            (file.topic, file.message_type, file.row_count, size(file.size_bytes), str(file.path)) for file in files
        ]
    failed = [one for one in exports if one.error is not None]
    if len(failed) == len(exports):
        raise NothingToDo(reason=f"Nothing was exported: {failed[0].error}")
    code = ExitCode.several if failed else 0
    return Output({"items": items}, lambda: table(["topic", "type", "rows", "size", "file"], rows), code)


def _note_missing(one: MissionExport) -> None:
    above = f"{one.project}/{one.mission}: " if one.project else ""
    for name, reason in one.unread.items():
        note(f"{above}Left out: {name}: {reason}")
    if one.error is not None and one.project:
        note(f"{above}{one.error}")
    if one.result is None:
        return
    for topic in one.result.left_out:
        note(f"{above}Left out: {topic.topic}: {topic.reason}")
    for file in one.result.files:
        if file.failed_count:
            note(f"{above}{file.topic}: {count(file.failed_count, 'message')} left out: {file.failure}")
    for problem in one.result.problems:
        note(f"{above}{problem.recording}: {problem.where}: {problem.message}")
