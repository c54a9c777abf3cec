"""`klein file …`, `klein move` and `klein rename`"""

from typing import Annotated

import typer
from pydantic import BaseModel

from kleinkram import connect
from kleinkram.cli.commands import Noun
from kleinkram.cli.errors import exit_code_of
from kleinkram.cli.filters import Choice, Many, file_filter, select_files, with_choice
from kleinkram.cli.mission import show_topics
from kleinkram.cli.options import (
    AsJson,
    DryRun,
    Limit,
    MissionOption,
    MissionsOption,
    ProjectOption,
    ProjectsOption,
    Yes,
    confirm,
    the_only,
    the_ref,
)
from kleinkram.cli.render import details, escape, line, note, show_json, show_json_list, table
from kleinkram.cli.units import count, instant, size, span
from kleinkram.cli.upload import upload
from kleinkram.client import Client
from kleinkram.client.errors import InvalidInput, NothingToDo
from kleinkram.client.files import file_label
from kleinkram.contract.files import FileLoss, FileRead, FileSort, ReadDepth
from kleinkram.contract.problems import from_problem
from kleinkram.contract.search import FileLabelled

_DEPTHS = {ReadDepth.summary: "its index", ReadDepth.scan: "every byte"}
app = Noun("Files: what a mission holds.")
app.command("create", help="Upload files: the same as `klein upload`.")(upload)

FileArgument = Annotated[str, typer.Argument(metavar="FILE", help="Path or id.", show_default=False)]


@app.command("list")
@with_choice
def list_(
    choice: Choice,
    paths: Annotated[Many, typer.Argument(metavar="GLOB", show_default=False)] = None,
    sort: Annotated[FileSort | None, typer.Option("--sort", help="Order; a - turns it round.")] = None,
    limit: Limit = None,
    count: Annotated[bool, typer.Option("--count", help="Only say how many.")] = False,
    as_json: AsJson = False,
) -> None:
    """List files."""
    with connect() as client:
        matching = file_filter(client, choice, paths or [])
        if count:
            number = client.files.count(matching)
            show_json({"total": number}) if as_json else line(str(number))
            return
        rows = [*client.files.list(matching, sort=sort, limit=limit)]
    show_json_list(rows) if as_json else show_found(rows)


@app.command("info")
def info(
    file: FileArgument, project: ProjectOption = None, mission: MissionOption = None, as_json: AsJson = False
) -> None:
    """Show a file, its checksums and its topics."""
    with connect() as client:
        chosen = client.files.get(file, mission=mission, project=project)
        topics = [*client.files.topics(chosen.id)]
    if as_json:
        show_json({"file": chosen, "topics": topics})
        return
    _show(chosen)
    if topics:
        line("")
        show_topics(topics)


@app.command("update")
def update(
    file: FileArgument,
    project: ProjectOption = None,
    mission: MissionOption = None,
    label: Annotated[Many, typer.Option("--label", help="Its labels from now on; may be given several times.")] = None,
    no_labels: Annotated[bool, typer.Option("--no-labels", help="Take all labels off.")] = False,
    path: Annotated[str | None, typer.Option("--path", help="Its new path in the mission.")] = None,
    as_json: AsJson = False,
) -> None:
    """Change a file's labels or path."""
    if label is None and path is None and not no_labels:
        raise InvalidInput(what="The command", reason="say what to change: --label, --no-labels or --path")
    with connect() as client:
        chosen = client.files.get(file, mission=mission, project=project)
        if label is not None or no_labels:
            chosen = client.files.update(chosen.id, if_match=chosen.etag, labels=label or [])
        if path is not None:
            chosen = client.files.update(chosen.id, if_match=chosen.etag, path=path)
    show_json(chosen) if as_json else _show(chosen)


@app.command("label")
@with_choice
def label(
    choice: Choice,
    files: Annotated[Many, typer.Argument(metavar="FILE", help="Paths, globs or ids.", show_default=False)] = None,
    add: Annotated[Many, typer.Option("--add", metavar="LABEL", help="To put on; may be given several times.")] = None,
    remove: Annotated[Many, typer.Option("--remove", metavar="LABEL", help="To take off; likewise.")] = None,
    dry_run: DryRun = False,
    as_json: AsJson = False,
) -> None:
    """Put labels on many files, or take labels off: of those that are named, or that the options choose."""
    if not add and not remove:
        raise InvalidInput(what="The command", reason="say what to change: --add or --remove")
    if choice.is_empty() and not files:
        raise InvalidInput(what="The command", reason="say which files: -p, -m, --query, a path, a glob or an id")
    with connect() as client:
        chosen = select_files(client, choice, files or [])
        if not chosen:
            raise NothingToDo(reason="No file matches")
        if dry_run:
            show_json_list(chosen) if as_json else show_found(chosen)
            note(f"Would label {count(len(chosen), 'file')}")
            return
        done = [*client.files.label([file.id for file in chosen], add=add or [], remove=remove or [])]
    if as_json:
        show_json_list(done)
    _say_labelled(chosen, done)


def _say_labelled(chosen: list[FileRead], done: list[FileLabelled]) -> None:
    failures = [from_problem(outcome.problem) for outcome in done if outcome.problem is not None]
    for file, outcome in zip(chosen, done, strict=True):
        if outcome.problem is not None:
            note(f"{file_label(file)}: {outcome.problem.detail}")
    note(f"Labelled {count(len(done) - len(failures), 'file')}")
    if code := exit_code_of(failures):
        raise typer.Exit(code)


@app.command("delete")
def delete(
    files: Annotated[list[str], typer.Argument(metavar="FILE", help="Paths, globs or ids.", show_default=False)],
    project: ProjectsOption = None,
    mission: MissionsOption = None,
    dry_run: DryRun = False,
    yes: Yes = False,
    as_json: AsJson = False,
) -> None:
    """Move files to the trash."""
    with connect() as client:
        chosen = select_files(client, Choice(project=project, mission=mission), files)
        if not chosen:
            raise NothingToDo(reason="No file matches")
        total = sum(file.size_bytes for file in chosen)
        for file in chosen:
            preview = client.files.delete(file.id, dry_run=True)
            if preview.made_from_it:
                made = ", ".join(map(escape, preview.made_from_it))
                note(f"{file_label(file)} was read by {count(preview.read_by_runs, 'run')}; {made} made from it stay")
        if not dry_run:
            show_found(chosen, to_stderr=True)
            confirm(f"Move {count(len(chosen), 'file')}, {size(total)}, to the trash?", yes)
            for file in chosen:
                client.files.delete(file.id)
    if as_json:
        show_json({"files": len(chosen), "size_bytes": total, "dry_run": dry_run, "items": chosen})
    elif dry_run:
        show_found(chosen)
    note(f"{'Would move' if dry_run else 'Moved'} to the trash: {count(len(chosen), 'file')}, {size(total)}")


def show_found(files: list[FileRead], *, to_stderr: bool = False) -> None:
    """Print files of any missions as a table."""
    table(
        ["project", "mission", "path", "size", "bytes", "content", "messages", "start", "span", "id"],
        [
            (
                row.mission.project.name,
                row.mission.name,
                row.path,
                size(row.size_bytes),
                row.state.value,
                row.content.value,
                row.message_count,
                instant(row.start_ns),
                span(row.start_ns, row.end_ns),
                row.id,
            )
            for row in files
        ],
        to_stderr=to_stderr,
    )


def _show(file: FileRead) -> None:
    details(
        [
            ("file", file.path),
            ("mission", f"{file.mission.project.name}/{file.mission.name}"),
            ("id", file.id),
            ("size", f"{size(file.size_bytes)} ({file.size_bytes} bytes)"),
            ("bytes", file.state.value + (f": {file.state_reason}" if file.state_reason else "")),
            ("damaged", file.damaged_at),
            ("content", file.content.value + (f": {file.content_reason}" if file.content_reason else "")),
            ("read by", file.depth and _DEPTHS[file.depth]),
            ("lost", file.lost and _loss(file.lost)),
            ("format", file.format),
            ("compression", file.compression),
            ("messages", file.message_count),
            ("start", instant(file.start_ns)),
            ("span", span(file.start_ns, file.end_ns)),
            ("sha256", file.sha256),
            ("md5", file.md5),
            ("crc64nvme", file.crc64nvme),
            ("verified", file.verified_at),
            ("labels", file.labels),
            ("uploaded", f"{file.created_at:%Y-%m-%d %H:%M}Z by {file.uploaded_by.name} ({file.origin})"),
            *((f"{fact.name} ({fact.unit})" if fact.unit else fact.name, fact.value) for fact in file.facts),
            *((f"problem at {problem.where}", problem.message) for problem in file.problems),
        ]
    )


def _loss(lost: FileLoss) -> str:
    messages = "an unknown number of messages" if lost.messages is None else count(lost.messages, "message")
    return f"{messages}, {size(lost.bytes)} in {count(lost.chunks, 'chunk')}"


def move(
    files: Annotated[
        Many, typer.Argument(metavar="FILES", help="Paths, globs or ids; none: the mission.", show_default=False)
    ] = None,
    project: ProjectsOption = None,
    mission: MissionsOption = None,
    to_project: Annotated[str | None, typer.Option("--to-project", metavar="PROJECT", help="Where to.")] = None,
    to_mission: Annotated[str | None, typer.Option("--to-mission", metavar="MISSION", help="Where to.")] = None,
    dry_run: DryRun = False,
    as_json: AsJson = False,
) -> None:
    """Move files to another mission, or a whole mission to another project. No byte is copied."""
    with connect() as client:
        if to_mission is not None:
            if not files:
                raise InvalidInput(what="The command", reason="say which files move to the other mission ('*' for all)")
            _move_files(
                client, Choice(project=project, mission=mission), files, to_mission, to_project, dry_run, as_json
            )
        elif files:
            raise InvalidInput(what="The command", reason="files move to a mission: say --to-mission")
        else:
            one_mission = the_ref("mission", None, the_only("mission", mission))
            _move_mission(client, the_only("project", project), one_mission, to_project, dry_run, as_json)


def rename(
    new_name: Annotated[str, typer.Argument(metavar="NEW_NAME", show_default=False)],
    project: ProjectOption = None,
    mission: MissionOption = None,
    file: Annotated[str | None, typer.Option("--file", "-f", metavar="FILE", help="Path or id of the file.")] = None,
    as_json: AsJson = False,
) -> None:
    """Rename the innermost thing named: a file (-f), else a mission (-m), else a project (-p)."""
    renamed: BaseModel
    with connect() as client:
        if file is not None:
            chosen = client.files.get(file, mission=mission, project=project)
            old, renamed = chosen.path, client.files.update(chosen.id, if_match=chosen.etag, path=new_name)
        elif mission is not None:
            held = client.missions.get(mission, project=project)
            old, renamed = held.name, client.missions.update(held.id, if_match=held.etag, name=new_name)
        else:
            top = client.projects.get(the_ref("project", None, project))
            old, renamed = top.name, client.projects.update(top.id, if_match=top.etag, name=new_name)
    show_json(renamed) if as_json else note(f"Renamed {escape(old)} to {escape(new_name)}.")


def _move_mission(
    client: Client, project: str | None, mission: str, to_project: str | None, dry_run: bool, as_json: bool
) -> None:
    chosen = client.missions.get(mission, project=project)
    target = client.projects.get(the_ref("project to move to", None, to_project))
    moved = chosen if dry_run else client.missions.update(chosen.id, project_id=target.id)
    if as_json:
        show_json({"dry_run": dry_run, "mission": moved})
    note(f"{'Would move' if dry_run else 'Moved'} {escape(chosen.name)} to the project {escape(target.name)}.")


def _move_files(
    client: Client,
    choice: Choice,
    refs: list[str],
    to_mission: str,
    to_project: str | None,
    dry_run: bool,
    as_json: bool,
) -> None:
    target = client.missions.get(to_mission, project=to_project or the_only("project", choice.project))
    chosen = select_files(client, choice, refs)
    if not chosen:
        raise NothingToDo(reason="No file matches")
    if not dry_run:
        chosen = [client.files.update(file.id, mission_id=target.id) for file in chosen]
    if as_json:
        show_json({"dry_run": dry_run, "items": chosen})
    elif dry_run:
        show_found(chosen)
    place = escape(f"{target.project.name}/{target.name}")
    note(f"{'Would move' if dry_run else 'Moved'} {count(len(chosen), 'file')} to {place}.")
