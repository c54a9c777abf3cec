"""`klein mission …`, and how missions, recordings and topics are shown"""

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import typer

from kleinkram import connect
from kleinkram.cli.commands import Noun
from kleinkram.cli.filters import Many, projects_of
from kleinkram.cli.options import (
    AsJson,
    DryRun,
    IfMatch,
    Limit,
    MissionOption,
    MissionsOption,
    ProjectOption,
    ProjectsOption,
    Yes,
    complete_mission,
    complete_project,
    confirm,
    read_text,
    the_ref,
)
from kleinkram.cli.render import details, escape, line, note, show_json, show_json_list, table
from kleinkram.cli.units import count, duration, instant, rate, size, span
from kleinkram.client import Client
from kleinkram.client._nouns import checked
from kleinkram.client.errors import InvalidInput
from kleinkram.contract.files import BlobState, FileFilter, FileRead, RecordingRead, TopicRead
from kleinkram.contract.missions import MissionFilter, MissionRead, MissionSort
from kleinkram.contract.names import is_id
from kleinkram.contract.overviews import MissionTopic

_DAMAGED = {BlobState.lost, BlobState.corrupt}


def show_mission(mission: MissionRead) -> None:
    """Print a mission's own properties and metadata."""
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
            ("not read yet", count(mission.pending_file_count, "file") if mission.pending_file_count else None),
            ("etag", mission.etag),
            ("notes", mission.notes),
            *((f"  {name}", _value(value)) for name, value in mission.metadata.items()),
            *((f"problem with {problem.field}", problem.message) for problem in mission.metadata_problems),
        ]
    )


def show_changes(before: MissionRead, after: MissionRead) -> None:
    """Print what a change made different, a line for each field: the old value and the new one."""
    own = [(name, getattr(before, name), getattr(after, name)) for name in ("name", "notes")]
    fields = sorted({*before.metadata, *after.metadata})  # the database does not keep their order
    pairs = [*own, *((name, before.metadata.get(name), after.metadata.get(name)) for name in fields)]
    changes = [(name, old, new) for name, old, new in pairs if old != new]
    if not changes:
        note(f"{after.project.name}/{after.name} is as it was: nothing changed.")
        return
    line(f"Changed {after.project.name}/{after.name}")
    for name, old, new in changes:
        line(f"  {name}: {_shown(old)} -> {_shown(new)}")


def _shown(value: object) -> str:
    return "(none)" if value in (None, "") else str(_value(value))


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
        line("")
        line("Recordings")
        show_recordings(recordings)
    if files:
        line("")
        line("Files")
        show_files(files)
        _show_damage(files)
    topics = client.missions.topics(mission.id, bins=0).items
    if topics:
        line("")
        line("Topics")
        show_mission_topics(topics)


def _show_damage(files: Iterable[FileRead]) -> None:
    damaged = [file for file in files if file.state in _DAMAGED]
    if damaged:
        line("")
        line("Not what was uploaded: upload these again to mend them")
        table(
            ["path", "bytes", "since", "what differs"],
            [(file.path, file.state.value, file.damaged_at, file.state_reason) for file in damaged],
        )


def show_missions(missions: Iterable[MissionRead]) -> None:
    """Print missions of any projects as a table."""
    table(
        ["project", "mission", "files", "size", "start", "span", "id"],
        [
            (
                row.project.name,
                row.name,
                row.file_count,
                size(row.size_bytes),
                instant(row.start_ns),
                span(row.start_ns, row.end_ns),
                row.id,
            )
            for row in missions
        ],
    )


def show_recordings(recordings: Iterable[RecordingRead]) -> None:
    """Print recordings as a table, and what is odd about them below."""
    rows = [*recordings]
    table(
        ["recording", "kind", "files", "content", "messages", "start", "span", "size"],
        [
            (
                row.name,
                row.kind,
                len(row.file_ids),
                row.content.value,
                row.message_count,
                instant(row.start_ns),
                span(row.start_ns, row.end_ns),
                size(row.size_bytes),
            )
            for row in rows
        ],
    )
    suspect = [
        *((row.name, row.content.value, row.content_reason) for row in rows if row.content_reason),
        *((row.name, problem.where, problem.message) for row in rows for problem in row.problems),
    ]
    if suspect:
        line("")
        table(["recording", "what", "to know"], suspect)


def show_files(files: Iterable[FileRead]) -> None:
    """Print files of one mission as a table."""
    table(
        ["path", "size", "bytes", "content", "format", "messages", "start", "span", "id"],
        [
            (
                row.path,
                size(row.size_bytes),
                row.state.value,
                row.content.value,
                row.format,
                row.message_count,
                instant(row.start_ns),
                span(row.start_ns, row.end_ns),
                row.id,
            )
            for row in files
        ],
    )


def show_mission_topics(topics: Iterable[MissionTopic]) -> None:
    """Print the topics of a mission as a table, a line each, over all its files."""
    table(
        ["topic", "type", "count", "rate", "longest gap", "files"],
        [
            (row.name, row.message_type, row.count, rate(row.rate_hz), duration(row.longest_gap_ns), row.file_count)
            for row in topics
        ],
    )


def show_topics(topics: Iterable[TopicRead]) -> None:
    """Print the topics of one file as a table."""
    table(
        ["topic", "type", "count", "rate", "longest gap", "head gap", "tail gap"],
        [
            (
                row.name,
                row.message_type,
                row.count,
                rate(row.rate_hz),
                duration(row.longest_gap_ns),
                duration(row.head_gap_ns),
                duration(row.tail_gap_ns),
            )
            for row in topics
        ],
    )


def _value(value: object) -> object:
    if isinstance(value, dict):
        return ", ".join(f"{key} {one}" for key, one in value.items() if one is not None)
    return value


app = Noun("Missions: one outing of a robot, with the metadata that its project requires.")

NameArgument = Annotated[
    str | None, typer.Argument(metavar="MISSION", show_default=False, autocompletion=complete_mission)
]
MetadataOption = Annotated[
    Path | None,
    typer.Option("--metadata", metavar="mission.yaml", help="Its metadata; `klein mission template` writes a form."),
]
NotesOption = Annotated[str | None, typer.Option("--notes", help="Anything worth knowing.")]


@app.command("create")
def create(
    name: NameArgument = None,
    project: ProjectOption = None,
    mission: MissionOption = None,
    metadata: MetadataOption = None,
    notes: NotesOption = None,
    as_json: AsJson = False,
) -> None:
    """Make a mission; its metadata must satisfy the project's fields."""
    text = read_text(metadata)
    with connect() as client:
        project_id = client.projects.get(the_ref("project", None, project)).id
        made = client.missions.create(
            the_ref("mission", name, mission), project_id=project_id, metadata_yaml=text, notes=notes or ""
        )
    show_json(made) if as_json else show_mission(made)


@app.command("list")
def list_(
    names: Annotated[Many, typer.Argument(metavar="GLOB", show_default=False)] = None,
    project: ProjectsOption = None,
    mission: MissionsOption = None,
    text: Annotated[str | None, typer.Option("--text", help="Found in names, notes and metadata.")] = None,
    where: Annotated[Many, typer.Option("--where", "-w", metavar="FIELD=VALUE", help="robot=anymal, t>20.")] = None,
    topic: Annotated[Many, typer.Option("--topic", "-t", metavar="GLOB", help="Has such a topic.")] = None,
    unsatisfied: Annotated[
        bool, typer.Option("--unsatisfied", help="Only those whose metadata does not satisfy the project.")
    ] = False,
    sort: Annotated[MissionSort | None, typer.Option("--sort", help="Order; a - turns it round.")] = None,
    limit: Limit = None,
    count: Annotated[bool, typer.Option("--count", help="Only say how many.")] = False,
    as_json: AsJson = False,
) -> None:
    """List missions."""
    filter_fields: dict[str, object] = {"text": text, "where": where, "topic": topic}
    filter_fields["satisfied"] = False if unsatisfied else None
    with connect() as client:
        refs = [str(client.missions.id_of(ref)) if "/" in ref else ref for ref in [*(names or []), *(mission or [])]]
        filter_fields |= {"name": refs[0]} if len(refs) == 1 and not is_id(refs[0]) else {"missions": refs}
        filter_fields |= projects_of(client, project)
        matching = checked(MissionFilter, "The filter", **{key: value for key, value in filter_fields.items() if value})
        matching = matching.model_copy(update={"satisfied": False}) if unsatisfied else matching
        if count:
            number = client.missions.count(matching)
            show_json({"total": number}) if as_json else line(str(number))
            return
        rows = [*client.missions.list(matching, sort=sort, limit=limit)]
    if as_json:
        show_json_list(rows)
        return
    show_missions(rows)


@app.command("info")
def info(
    name: NameArgument = None, project: ProjectOption = None, mission: MissionOption = None, as_json: AsJson = False
) -> None:
    """Show a mission: its metadata, recordings, files, and topics with counts, rates and gaps."""
    with connect() as client:
        target = client.missions.get(the_ref("mission", name, mission), project=project)
        show_contents(client, target, as_json)


@app.command("update")
def update(
    name: NameArgument = None,
    project: ProjectOption = None,
    mission: MissionOption = None,
    new_name: Annotated[str | None, typer.Option("--name", help="Its new name.")] = None,
    metadata: MetadataOption = None,
    replace: Annotated[
        bool, typer.Option("--replace", help="Replace all metadata by --metadata: fields that it lacks are removed.")
    ] = False,
    notes: NotesOption = None,
    etag: IfMatch = None,
    as_json: AsJson = False,
) -> None:
    """Change a mission's name, notes, or metadata.

    --metadata changes the fields that its file names, and leaves the others as they are; a field without a value (null)
    is removed.
    """
    text = read_text(metadata)
    if replace and text is None:
        raise InvalidInput(what="--replace", reason="it goes with --metadata")
    if new_name is None and text is None and notes is None:
        raise InvalidInput(what="The command", reason="say what to change: --name, --metadata or --notes")
    filter_fields: dict[str, str | bool] = {"name": new_name} if new_name is not None else {}
    filter_fields |= {"notes": notes} if notes is not None else {}
    if text is not None:
        filter_fields |= {"metadata_yaml": text, "merge_yaml": not replace}
    with connect() as client:
        target = client.missions.get(the_ref("mission", name, mission), project=project)
        changed = client.missions.update(target.id, if_match=etag or target.etag, **filter_fields)
    if as_json:
        show_json(changed)
        return
    show_changes(target, changed)


@app.command("complete")
def complete(
    name: NameArgument = None, project: ProjectOption = None, mission: MissionOption = None, as_json: AsJson = False
) -> None:
    """Say that all of a mission has been uploaded."""
    with connect() as client:
        target = client.missions.get(the_ref("mission", name, mission), project=project)
        changed = client.missions.complete(target.id)
    show_json(changed) if as_json else show_mission(changed)


@app.command("template")
def template(
    name: Annotated[
        str | None, typer.Argument(metavar="PROJECT", show_default=False, autocompletion=complete_project)
    ] = None,
    project: ProjectOption = None,
    as_json: AsJson = False,
) -> None:
    """Print the metadata YAML to fill in for a project's next mission; values of the last one stand in comments."""
    with connect() as client:
        target = client.projects.get(the_ref("project", name, project))
        form = client.projects.template(target.id)
    if as_json:
        show_json(form)
        return
    if form.prefilled_from is not None and form.carried:
        note(f"Values of {escape(form.prefilled_from.name)} stand in comments: write those that hold again.")
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
        what = f"{target.project.name}/{target.name}: {count(would.files, 'file')}, {size(would.size_bytes)}"
        if not dry_run:
            confirm(f"Move to the trash {what}?", yes)
            would = client.missions.delete(target.id)
    show_json(would) if as_json else note(f"{'Would move' if dry_run else 'Moved'} to the trash: {what}")
