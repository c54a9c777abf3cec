"""`klein mission …`, and the display of missions, recordings, files and topics."""

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

from kleinkram.cli import options
from kleinkram.cli.commands import AsJson, Many, Subcommands, Text, argument, flag, option
from kleinkram.cli.filters import WhereOption, filter_of, projects_of
from kleinkram.cli.render import Output, as_list, as_table, as_total, details, line, note, show_json, table
from kleinkram.cli.run_view import action_name
from kleinkram.cli.transfer import run_transfer, transfer_output
from kleinkram.cli.units import count as count_of
from kleinkram.cli.units import duration, instant, rate, size, span
from kleinkram.cli.verdicts import accept, add_note, verdict_text
from kleinkram.client import Client
from kleinkram.client.errors import InvalidInput, NothingToDo
from kleinkram.contract.errors import NotAuthenticated, ScopeMissing
from kleinkram.contract.files import BlobState, FileFilter, FileRead, RecordingRead
from kleinkram.contract.mission_positions import MissionPosition
from kleinkram.contract.missions import MissionFilter, MissionRead, MissionSort
from kleinkram.contract.names import is_id
from kleinkram.contract.previews import MissionPreview

app = Subcommands("Manage missions: each is one outing of a robot, with the metadata that its project requires.")
NameArgument = Annotated[
    Text, argument("MISSION", "Name or id of the mission.", autocompletion=options.complete_mission)
]
MetadataOption = Annotated[
    Path | None, option("--metadata", "mission.yaml", "Set the metadata; `klein mission template` writes a form.")
]
NotesOption = Annotated[Text, option("--notes", None, "Set the notes.")]


@app.command("create")
def create(
    client: Client,
    name: NameArgument = None,
    project: options.ProjectOption = None,
    mission: options.MissionOption = None,
    metadata: MetadataOption = None,
    notes: NotesOption = None,
) -> Output:
    """Create a mission. Its metadata must satisfy the fields of the project."""
    text = options.read_text(metadata)
    project_id = client.projects.get(options.the_ref("project", None, project)).id
    name = options.the_ref("mission", name, mission)
    return _output(client.missions.create(name, project=project_id, metadata_yaml=text, notes=notes or ""))


@app.command("list")
def list_(
    client: Client,
    names: Annotated[Many, argument("GLOB", "Globs that names match.")] = None,
    project: options.ProjectsOption = None,
    mission: options.MissionsOption = None,
    text: Annotated[Text, option("--text", None, "Search names, notes and metadata for TEXT.")] = None,
    where: WhereOption = None,
    topic: Annotated[Many, option("--topic -t", "GLOB", "Select missions with a matching topic.")] = None,
    event: Annotated[Many, option("--event", "GLOB", "Select missions with an event of this name.")] = None,
    unsatisfied: Annotated[
        bool, flag("--unsatisfied", "Select missions whose metadata does not satisfy the project.")
    ] = False,
    sort: Annotated[
        MissionSort | None,
        option("--sort", None, "Set the order; a leading - reverses it. By verdict: bad ones first."),
    ] = None,
    limit: options.Limit = None,
    count: options.Count = False,
) -> Output:
    """List missions."""
    refs = [str(client.missions.id_of(ref)) if "/" in ref else ref for ref in [*(names or []), *(mission or [])]]
    fields: dict[str, object] = {
        "text": text,
        "where": where,
        "topic": topic,
        "event": event,
        **projects_of(client, project),
    }
    fields |= {"name": refs[0]} if len(refs) == 1 and not is_id(refs[0]) else {"missions": refs}
    matching = filter_of(MissionFilter, fields)
    if unsatisfied:
        matching = matching.model_copy(update={"satisfied": False})
    if count:
        return as_total(client.missions.count(matching))
    return as_list(client.missions.list(matching, sort=sort, limit=limit), show_missions)


@app.command("info")
def info(
    client: Client,
    name: NameArgument = None,
    project: options.ProjectOption = None,
    mission: options.MissionOption = None,
    as_json: AsJson = False,
) -> None:
    """Show a mission: its metadata, recordings, files, and topics with counts, rates and gaps."""
    target = client.missions.get(options.the_ref("mission", name, mission), project=project)
    matching = FileFilter(mission_id=target.id)
    recordings = [*client.recordings.list(target.id)]
    files = [*client.files.list(matching)]
    try:
        shown_by_runs = client.missions.previews(target.id)
    except (NotAuthenticated, ScopeMissing):  # links show no runs
        shown_by_runs = []
    if as_json:
        topics_by_file = [*client.files.find_topics(matching)]
        results = {"files": files, "topics": topics_by_file, "previews": shown_by_runs}
        show_json({"mission": target, "recordings": recordings, **results})
        return
    _show_mission(target, preview_count=len(shown_by_runs))
    if recordings:
        _heading("Recordings")
        _show_recordings(recordings)
    if files:
        _heading("Files")
        _show_mission_files(files)
    damaged = [row for row in files if row.state in {BlobState.lost, BlobState.corrupt}]
    if damaged:
        _heading("Lost or corrupt files: upload them again to repair them")
        cells = [(row.path, row.state.value, row.damaged_at, row.state_reason) for row in damaged]
        table(["path", "bytes", "since", "what differs"], cells)
    if topics := client.missions.topics(target.id, bins=0).items:
        _heading("Topics")
        table(
            ["topic", "type", "count", "rate", "longest gap", "files"],
            [
                (row.name, row.message_type, row.count, rate(row.rate_hz), duration(row.longest_gap_ns), row.file_count)
                for row in topics
            ],
        )


@app.command("positions")
def positions(
    client: Client,
    project: options.ProjectsOption = None,
    query: Annotated[Text, option("--query", "QUERY", "Select missions by the query of a search.")] = None,
    where: WhereOption = None,
) -> Output:
    """List where the latest missions were recorded, in degrees: first fixes, else locations in the metadata."""
    matching = filter_of(MissionFilter, {"where": where, **projects_of(client, project)})
    answer = client.missions.positions(matching, query=query)

    def show() -> None:
        headers = ["project", "mission", "latitude", "longitude", "from"]
        table(headers, map(_position_cells, answer.items))
        if answer.unplaced_count:
            note(f"{count_of(answer.unplaced_count, 'mission')} without a known position.")
        if answer.left_out_count:
            note(f"{count_of(answer.left_out_count, 'earlier mission')} not listed.")

    return Output(answer, show)


def _position_cells(row: MissionPosition) -> tuple[object, ...]:
    return row.mission.project.name, row.mission.name, row.latitude, row.longitude, row.source.value


@app.command("previews")
def previews(
    client: Client,
    name: NameArgument = None,
    project: options.ProjectOption = None,
    mission: options.MissionOption = None,
    dest: Annotated[Path | None, option("--dest", "DIR", "Download them to DIR, verified.")] = None,
    overwrite: options.Overwrite = False,
) -> Output:
    """List or download the pictures, tables and tracks that the latest runs of actions made of a mission."""
    target = client.missions.get(options.the_ref("mission", name, mission), project=project)
    rows = client.missions.previews(target.id)
    if dest is None:
        headers = ["action", "path", "title", "size", "made", "outdated", "run"]
        return as_table(rows, headers, _preview_cells)
    if not rows:
        raise NothingToDo(reason=f"{target.project.name}/{target.name} has no previews")
    report, elapsed_s = run_transfer(
        lambda watcher: client.runs.download_previews(rows, dest, overwrite=overwrite, watcher=watcher)
    )
    for error in report.left_out:
        note(str(error))
    return transfer_output(report, elapsed_s)


def _preview_cells(row: MissionPreview) -> tuple[object, ...]:
    made, outdated = f"{row.made_at:%Y-%m-%d %H:%M}Z", "yes" if row.outdated else None
    return action_name(row.action), row.path, row.title, size(row.size_bytes), made, outdated, row.run_id


@app.command("update")
def update(
    client: Client,
    name: NameArgument = None,
    project: options.ProjectOption = None,
    mission: options.MissionOption = None,
    new_name: Annotated[Text, option("--name", None, "Set the name.")] = None,
    metadata: MetadataOption = None,
    replace: Annotated[
        bool, flag("--replace", "Replace all metadata with --metadata: fields that it does not contain are removed.")
    ] = False,
    notes: NotesOption = None,
    etag: options.IfMatch = None,
) -> Output:
    """Change a mission's name, notes, or metadata.

    --metadata changes only the fields that its file names. A field without a value (null) is removed.
    """
    text = options.read_text(metadata)
    if replace and text is None:
        raise InvalidInput(what="--replace", reason="it requires --metadata")
    if new_name is None and text is None and notes is None:
        raise InvalidInput(what="The command", reason="specify what to change: --name, --metadata or --notes")
    changes: dict[str, str | bool] = {} if new_name is None else {"name": new_name}
    changes |= {} if notes is None else {"notes": notes}
    changes |= {} if text is None else {"metadata_yaml": text, "merge_yaml": not replace}
    target = client.missions.get(options.the_ref("mission", name, mission), project=project)
    changed = client.missions.update(target.id, if_match=etag or target.etag, **changes)
    return Output(changed, lambda: _show_changes(target, changed))


@app.command("complete")
def complete(
    client: Client,
    name: NameArgument = None,
    project: options.ProjectOption = None,
    mission: options.MissionOption = None,
) -> Output:
    """Mark a mission as completely uploaded."""
    target = client.missions.get(options.the_ref("mission", name, mission), project=project)
    return _output(client.missions.complete(target.id))


@app.command("template")
def template(
    client: Client,
    name: Annotated[
        Text, argument("PROJECT", "Name or id of the project.", autocompletion=options.complete_project)
    ] = None,
    project: options.ProjectOption = None,
) -> Output:
    """Print the metadata form (YAML) for the next mission of a project, with the last values in comments."""
    form = client.projects.template(client.projects.get(options.the_ref("project", name, project)).id)

    def show() -> None:
        if form.prefilled_from is not None and form.carried:
            note(f"The comments contain values of {form.prefilled_from.name}: uncomment those that still apply.")
        for yaml_line in form.yaml.rstrip("\n").split("\n"):
            line(yaml_line)

    return Output(form, show)


@app.command("delete")
def delete(
    client: Client,
    name: NameArgument = None,
    project: options.ProjectOption = None,
    mission: options.MissionOption = None,
    dry_run: options.DryRun = False,
    yes: options.Yes = False,
) -> Output:
    """Move a mission, and its files, to the trash."""
    target = client.missions.get(options.the_ref("mission", name, mission), project=project)
    would = client.missions.delete(target.id, dry_run=True)
    what = f"{target.project.name}/{target.name}: {count_of(would.files, 'file')}, {size(would.size_bytes)}"
    if not dry_run:
        options.confirm(f"Move to the trash {what}?", yes)
        would = client.missions.delete(target.id)
    return Output(would, f"{'Would move' if dry_run else 'Moved'} to the trash: {what}")


app.command("accept")(accept)
app.command("note")(add_note)


def _output(mission: MissionRead) -> Output:
    return Output(mission, lambda: _show_mission(mission))


def _show_mission(mission: MissionRead, preview_count: int = 0) -> None:
    pending = mission.pending_file_count
    details(
        [
            ("mission", mission.name),
            ("project", mission.project.name),
            ("id", mission.id),
            ("created", f"{mission.created_at:%Y-%m-%d %H:%M}Z by {mission.created_by.name}"),
            ("completed", mission.completed_at),
            ("checks", verdict_text(mission)),
            ("start", instant(mission.start_ns)),
            ("span", span(mission.start_ns, mission.end_ns)),
            ("files", f"{mission.file_count}, {size(mission.size_bytes)}"),
            ("messages", mission.message_count),
            ("previews", f"{preview_count} (`klein mission previews`)" if preview_count else None),
            ("not read yet", count_of(pending, "file") if pending else None),
            ("etag", mission.etag),
            ("notes", mission.notes),
            *((f"  {name}", _value(value)) for name, value in mission.metadata.items()),
            *((f"problem with {problem.field}", problem.message) for problem in mission.metadata_problems),
        ]
    )


def _show_changes(before: MissionRead, after: MissionRead) -> None:
    """Print each changed field with its old and new value."""
    own = [(name, getattr(before, name), getattr(after, name)) for name in ("name", "notes")]
    fields = sorted({*before.metadata, *after.metadata})  # the database does not keep their order
    pairs = [*own, *((name, before.metadata.get(name), after.metadata.get(name)) for name in fields)]
    changes = [(name, old, new) for name, old, new in pairs if old != new]
    if not changes:
        note(f"{after.project.name}/{after.name} is unchanged.")
        return
    line(f"Changed {after.project.name}/{after.name}")
    for name, *values in changes:
        old, new = ("(none)" if value in (None, "") else str(_value(value)) for value in values)
        line(f"  {name}: {old} -> {new}")


def _heading(text: str) -> None:
    line("")
    line(text)


def show_missions(missions: Iterable[MissionRead]) -> None:
    """Print missions of any projects as a table."""
    table(
        ["project", "mission", "checks", "files", "size", "start", "span", "id"],
        [
            (
                *(row.project.name, row.name, row.verdict.value, row.file_count),
                size(row.size_bytes),
                *_times(row),
                row.id,
            )
            for row in missions
        ],
    )


def show_files(files: Iterable[FileRead], *, to_stderr: bool = False) -> None:
    """Print files of any missions as a table."""
    cells = []
    for row in files:
        location = (row.mission.project.name, row.mission.name, f"{row.path} (derived)" if row.is_derived else row.path)
        content = (row.content.value, row.message_count)
        cells.append((*location, size(row.size_bytes), row.state.value, *content, *_times(row), row.id))
    headers = ["project", "mission", "path", "size", "bytes", "content", "messages", "start", "span", "id"]
    table(headers, cells, to_stderr=to_stderr)


def _times(row: MissionRead | RecordingRead | FileRead) -> tuple[str | None, str | None]:
    """Return the start and the span of what was recorded."""
    return instant(row.start_ns), span(row.start_ns, row.end_ns)


def _show_recordings(recordings: Iterable[RecordingRead]) -> None:
    """Print recordings as a table, and their quality warnings below."""
    rows = [*recordings]
    cells = []
    for row in rows:
        content = (row.content.value, row.message_count)
        name = f"{row.name} (derived)" if row.is_derived else row.name
        cells.append((name, row.kind, len(row.file_ids), *content, *_times(row), size(row.size_bytes)))
    table(["recording", "kind", "files", "content", "messages", "start", "span", "size"], cells)
    warnings = [
        *((row.name, row.content.value, row.content_reason) for row in rows if row.content_reason),
        *((row.name, problem.where, problem.message) for row in rows for problem in row.problems),
    ]
    if warnings:
        line("")
        table(["recording", "what", "to know"], warnings)


def _show_mission_files(files: Iterable[FileRead]) -> None:
    """Print files of one mission as a table."""
    cells = []
    for row in files:
        content = (row.content.value, row.format, row.message_count)
        cells.append((row.path, size(row.size_bytes), row.state.value, *content, *_times(row), row.id))
    table(["path", "size", "bytes", "content", "format", "messages", "start", "span", "id"], cells)


def _value(value: object) -> object:
    if isinstance(value, dict):
        return ", ".join(f"{key} {item}" for key, item in value.items() if item is not None)
    return value
