"""`klein mission …`, and how missions, recordings and topics look."""

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

from kleinkram import connect
from kleinkram.cli.commands import Noun
from kleinkram.cli.filters import WhereOption, projects_of
from kleinkram.cli.options import (
    AsJson,
    Count,
    DryRun,
    IfMatch,
    Limit,
    Many,
    MissionOption,
    MissionsOption,
    ProjectOption,
    ProjectsOption,
    Text,
    Yes,
    argument,
    complete_mission,
    complete_project,
    confirm,
    flag,
    option,
    read_text,
    the_ref,
)
from kleinkram.cli.render import details, line, note, show_count, show_json, show_json_list, table
from kleinkram.cli.units import count as count_of
from kleinkram.cli.units import duration, instant, rate, size, span
from kleinkram.client import Client
from kleinkram.client._nouns import checked
from kleinkram.client.errors import InvalidInput
from kleinkram.contract.files import BlobState, FileFilter, FileRead, RecordingRead, TopicRead
from kleinkram.contract.missions import MissionFilter, MissionRead, MissionSort
from kleinkram.contract.names import is_id

app = Noun("Manage missions: each is one outing of a robot, with the metadata that its project requires.")
NameArgument = Annotated[Text, argument("MISSION", "Name or id of the mission.", autocompletion=complete_mission)]
MetadataOption = Annotated[
    Path | None, option("--metadata", "mission.yaml", "Set the metadata; `klein mission template` writes a form.")
]
NotesOption = Annotated[Text, option("--notes", None, "Set the notes.")]


@app.command("create")
def create(
    name: NameArgument = None,
    project: ProjectOption = None,
    mission: MissionOption = None,
    metadata: MetadataOption = None,
    notes: NotesOption = None,
    as_json: AsJson = False,
) -> None:
    """Create a mission. Its metadata must satisfy the fields of the project."""
    text = read_text(metadata)
    with connect() as client:
        project_id = client.projects.get(the_ref("project", None, project)).id
        made = client.missions.create(
            the_ref("mission", name, mission), project=project_id, metadata_yaml=text, notes=notes or ""
        )
    show_json(made) if as_json else show_mission(made)


@app.command("list")
def list_(
    names: Annotated[Many, argument("GLOB", "Globs that names match.")] = None,
    project: ProjectsOption = None,
    mission: MissionsOption = None,
    text: Annotated[Text, option("--text", None, "Search names, notes and metadata for TEXT.")] = None,
    where: WhereOption = None,
    topic: Annotated[Many, option("--topic -t", "GLOB", "Select missions with a matching topic.")] = None,
    unsatisfied: Annotated[
        bool, flag("--unsatisfied", "Select missions whose metadata does not satisfy the project.")
    ] = False,
    sort: Annotated[MissionSort | None, option("--sort", None, "Set the order; a leading - reverses it.")] = None,
    limit: Limit = None,
    count: Count = False,
    as_json: AsJson = False,
) -> None:
    """List missions."""
    fields: dict[str, object] = {"text": text, "where": where, "topic": topic}
    with connect() as client:
        refs = [str(client.missions.id_of(ref)) if "/" in ref else ref for ref in [*(names or []), *(mission or [])]]
        fields |= {"name": refs[0]} if len(refs) == 1 and not is_id(refs[0]) else {"missions": refs}
        fields |= projects_of(client, project)
        set_fields = {key: value for key, value in fields.items() if value}
        matching = checked(MissionFilter, "The filter", **set_fields, **({"satisfied": False} if unsatisfied else {}))
        if count:
            show_count(client.missions.count(matching), as_json)
            return
        rows = [*client.missions.list(matching, sort=sort, limit=limit)]
    show_json_list(rows) if as_json else show_missions(rows)


@app.command("info")
def info(
    name: NameArgument = None, project: ProjectOption = None, mission: MissionOption = None, as_json: AsJson = False
) -> None:
    """Show a mission: its metadata, recordings, files, and topics with counts, rates and gaps."""
    with connect() as client:
        show_contents(client, client.missions.get(the_ref("mission", name, mission), project=project), as_json)


@app.command("update")
def update(
    name: NameArgument = None,
    project: ProjectOption = None,
    mission: MissionOption = None,
    new_name: Annotated[Text, option("--name", None, "Set the name.")] = None,
    metadata: MetadataOption = None,
    replace: Annotated[
        bool, flag("--replace", "Replace all metadata by --metadata: fields that it lacks are removed.")
    ] = False,
    notes: NotesOption = None,
    etag: IfMatch = None,
    as_json: AsJson = False,
) -> None:
    """Change a mission's name, notes, or metadata.

    --metadata changes only the fields that its file names. A field without a value (null) is removed.
    """
    text = read_text(metadata)
    if replace and text is None:
        raise InvalidInput(what="--replace", reason="it goes with --metadata")
    if new_name is None and text is None and notes is None:
        raise InvalidInput(what="The command", reason="say what to change: --name, --metadata or --notes")
    changes: dict[str, str | bool] = {} if new_name is None else {"name": new_name}
    changes |= {} if notes is None else {"notes": notes}
    changes |= {} if text is None else {"metadata_yaml": text, "merge_yaml": not replace}
    with connect() as client:
        target = client.missions.get(the_ref("mission", name, mission), project=project)
        changed = client.missions.update(target.id, if_match=etag or target.etag, **changes)
    show_json(changed) if as_json else show_changes(target, changed)


@app.command("complete")
def complete(
    name: NameArgument = None, project: ProjectOption = None, mission: MissionOption = None, as_json: AsJson = False
) -> None:
    """Mark a mission as completely uploaded."""
    with connect() as client:
        target = client.missions.get(the_ref("mission", name, mission), project=project)
        changed = client.missions.complete(target.id)
    show_json(changed) if as_json else show_mission(changed)


@app.command("template")
def template(
    name: Annotated[Text, argument("PROJECT", "Name or id of the project.", autocompletion=complete_project)] = None,
    project: ProjectOption = None,
    as_json: AsJson = False,
) -> None:
    """Print the metadata form (YAML) for the next mission of a project, with the last values in comments."""
    with connect() as client:
        form = client.projects.template(client.projects.get(the_ref("project", name, project)).id)
    if as_json:
        show_json(form)
        return
    if form.prefilled_from is not None and form.carried:
        note(f"Values of {form.prefilled_from.name} stand in comments: write those that hold again.")
    for yaml_line in form.yaml.rstrip("\n").split("\n"):
        line(yaml_line)


@app.command("delete")
def delete(
    name: NameArgument = None,
    project: ProjectOption = None,
    mission: MissionOption = None,
    dry_run: DryRun = False,
    yes: Yes = False,
    as_json: AsJson = False,
) -> None:
    """Move a mission, and its files, to the trash."""
    with connect() as client:
        target = client.missions.get(the_ref("mission", name, mission), project=project)
        would = client.missions.delete(target.id, dry_run=True)
        what = f"{target.project.name}/{target.name}: {count_of(would.files, 'file')}, {size(would.size_bytes)}"
        if not dry_run:
            confirm(f"Move to the trash {what}?", yes)
            would = client.missions.delete(target.id)
    show_json(would) if as_json else note(f"{'Would move' if dry_run else 'Moved'} to the trash: {what}")


def show_mission(mission: MissionRead) -> None:
    """Print the properties and metadata of a mission."""
    pending = mission.pending_file_count
    details(
        [
            ("mission", mission.name),
            ("project", mission.project.name),
            ("id", mission.id),
            ("created", f"{mission.created_at:%Y-%m-%d %H:%M}Z by {mission.created_by.name}"),
            ("completed", mission.completed_at),
            ("start", instant(mission.start_ns)),
            ("span", span(mission.start_ns, mission.end_ns)),
            ("files", f"{mission.file_count}, {size(mission.size_bytes)}"),
            ("messages", mission.message_count),
            ("not read yet", count_of(pending, "file") if pending else None),
            ("etag", mission.etag),
            ("notes", mission.notes),
            *((f"  {name}", _value(value)) for name, value in mission.metadata.items()),
            *((f"problem with {problem.field}", problem.message) for problem in mission.metadata_problems),
        ]
    )


def show_changes(before: MissionRead, after: MissionRead) -> None:
    """Print each changed field with its old and new value."""
    own = [(name, getattr(before, name), getattr(after, name)) for name in ("name", "notes")]
    fields = sorted({*before.metadata, *after.metadata})  # the database does not keep their order
    pairs = [*own, *((name, before.metadata.get(name), after.metadata.get(name)) for name in fields)]
    changes = [(name, old, new) for name, old, new in pairs if old != new]
    if not changes:
        note(f"{after.project.name}/{after.name} is as it was: nothing changed.")
        return
    line(f"Changed {after.project.name}/{after.name}")
    for name, *values in changes:
        old, new = ("(none)" if value in (None, "") else str(_value(value)) for value in values)
        line(f"  {name}: {old} -> {new}")


def show_contents(client: Client, mission: MissionRead, as_json: bool) -> None:
    """Print a mission with its recordings, files and topics."""
    matching = FileFilter(mission_id=mission.id)
    recordings = [*client.recordings.list(mission.id)]
    files = [*client.files.list(matching)]
    if as_json:
        by_file = [*client.files.find_topics(matching)]
        show_json({"mission": mission, "recordings": recordings, "files": files, "topics": by_file})
        return
    show_mission(mission)
    if recordings:
        _heading("Recordings")
        show_recordings(recordings)
    if files:
        _heading("Files")
        show_files(files)
        damaged = [
            (file.path, file.state.value, file.damaged_at, file.state_reason)
            for file in files
            if file.state in {BlobState.lost, BlobState.corrupt}
        ]
        if damaged:
            _heading("Lost or corrupt files: upload them again to repair them")
            table(["path", "bytes", "since", "what differs"], damaged)
    topics = client.missions.topics(mission.id, bins=0).items
    if topics:
        _heading("Topics")
        table(
            ["topic", "type", "count", "rate", "longest gap", "files"],
            [
                (row.name, row.message_type, row.count, rate(row.rate_hz), duration(row.longest_gap_ns), row.file_count)
                for row in topics
            ],
        )


def _heading(text: str) -> None:
    line("")
    line(text)


def show_missions(missions: Iterable[MissionRead]) -> None:
    """Print missions of any projects as a table."""
    table(
        ["project", "mission", "files", "size", "start", "span", "id"],
        [(row.project.name, row.name, row.file_count, size(row.size_bytes), *_times(row), row.id) for row in missions],
    )


def _times(row: MissionRead | RecordingRead | FileRead) -> tuple[str | None, str | None]:
    """Return the start and the span of what was recorded."""
    return instant(row.start_ns), span(row.start_ns, row.end_ns)


def show_recordings(recordings: Iterable[RecordingRead]) -> None:
    """Print recordings as a table, and their quality warnings below."""
    rows = [*recordings]
    cells = []
    for row in rows:
        content = (row.content.value, row.message_count)
        cells.append((row.name, row.kind, len(row.file_ids), *content, *_times(row), size(row.size_bytes)))
    table(["recording", "kind", "files", "content", "messages", "start", "span", "size"], cells)
    warnings = [
        *((row.name, row.content.value, row.content_reason) for row in rows if row.content_reason),
        *((row.name, problem.where, problem.message) for row in rows for problem in row.problems),
    ]
    if warnings:
        line("")
        table(["recording", "what", "to know"], warnings)


def show_files(files: Iterable[FileRead]) -> None:
    """Print files of one mission as a table."""
    cells = []
    for row in files:
        content = (row.content.value, row.format, row.message_count)
        cells.append((row.path, size(row.size_bytes), row.state.value, *content, *_times(row), row.id))
    table(["path", "size", "bytes", "content", "format", "messages", "start", "span", "id"], cells)


def show_found(files: Iterable[FileRead], *, to_stderr: bool = False) -> None:
    """Print files of any missions as a table."""
    cells = []
    for row in files:
        place = (row.mission.project.name, row.mission.name, row.path)
        content = (row.content.value, row.message_count)
        cells.append((*place, size(row.size_bytes), row.state.value, *content, *_times(row), row.id))
    headers = ["project", "mission", "path", "size", "bytes", "content", "messages", "start", "span", "id"]
    table(headers, cells, to_stderr=to_stderr)


def show_topics(topics: Iterable[TopicRead]) -> None:
    """Print the topics of one file as a table."""
    cells = []
    for row in topics:
        gaps = (duration(gap_ns) for gap_ns in (row.longest_gap_ns, row.head_gap_ns, row.tail_gap_ns))
        cells.append((row.name, row.message_type, row.count, rate(row.rate_hz), *gaps))
    table(["topic", "type", "count", "rate", "longest gap", "head gap", "tail gap"], cells)


def _value(value: object) -> object:
    if isinstance(value, dict):
        return ", ".join(f"{key} {item}" for key, item in value.items() if item is not None)
    return value
