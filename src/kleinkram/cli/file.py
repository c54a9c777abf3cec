"""`klein file …`, `klein move` and `klein rename`"""

from collections.abc import Iterable
from typing import Annotated

from pydantic import BaseModel

from kleinkram.cli import options
from kleinkram.cli.commands import Many, Subcommands, Text, argument, flag, option, with_option_groups
from kleinkram.cli.errors import exit_code_of
from kleinkram.cli.filters import Choice, file_filter, select_files
from kleinkram.cli.mission import show_files
from kleinkram.cli.preview import preview
from kleinkram.cli.render import Output, as_list, as_total, details, line, note, table
from kleinkram.cli.transfer import upload
from kleinkram.cli.units import count as count_of
from kleinkram.cli.units import duration, instant, rate, size, span
from kleinkram.client import Client
from kleinkram.client.errors import InvalidInput, NothingToDo
from kleinkram.client.files import file_label
from kleinkram.contract.files import FileRead, FileSort, ReadDepth, TopicRead
from kleinkram.contract.problems import from_problem

_DEPTHS = {ReadDepth.summary: "its index", ReadDepth.scan: "every byte"}
app = Subcommands("Manage the files of missions.")
app.command("preview")(preview)
app.command("create", help="Upload files. The same as `klein upload`.")(upload)


@app.command("list")
@with_option_groups
def list_(
    client: Client,
    choice: Choice,
    paths: Annotated[Many, argument("GLOB", "Globs that paths match.")] = None,
    sort: Annotated[FileSort | None, option("--sort", None, "Set the order; a leading - reverses it.")] = None,
    limit: options.Limit = None,
    count: options.Count = False,
) -> Output:
    """List files."""
    matching = file_filter(client, choice, paths or [])
    if count:
        return as_total(client.files.count(matching))
    return as_list(client.files.list(matching, sort=sort, limit=limit), show_files)


@app.command("info")
def info(
    client: Client,
    file: options.FileArgument,
    project: options.ProjectOption = None,
    mission: options.MissionOption = None,
) -> Output:
    """Show a file, its checksums and its topics."""
    chosen = client.files.get(file, mission=mission, project=project)
    topics = [*client.files.topics(chosen.id)]

    def show() -> None:
        _show(chosen)
        if topics:
            line("")
            _show_topics(topics)

    return Output({"file": chosen, "topics": topics}, show)


@app.command("update")
def update(
    client: Client,
    file: options.FileArgument,
    project: options.ProjectOption = None,
    mission: options.MissionOption = None,
    label: Annotated[Many, option("--label", None, "Replace its labels; repeatable.")] = None,
    no_labels: Annotated[bool, flag("--no-labels", "Remove all labels.")] = False,
    path: Annotated[Text, option("--path", None, "Set its path in the mission.")] = None,
) -> Output:
    """Change a file's labels or path."""
    if label is None and path is None and not no_labels:
        raise InvalidInput(what="The command", reason="specify what to change: --label, --no-labels or --path")
    chosen = client.files.get(file, mission=mission, project=project)
    if label is not None or no_labels:
        chosen = client.files.update(chosen.id, if_match=chosen.etag, labels=label or [])
    if path is not None:
        chosen = client.files.update(chosen.id, if_match=chosen.etag, path=path)
    return Output(chosen, lambda: _show(chosen))


@app.command("label")
@with_option_groups
def label(
    client: Client,
    choice: Choice,
    files: Annotated[Many, argument("FILE", "Paths, globs or ids of files.")] = None,
    add: Annotated[Many, option("--add", "LABEL", "Add a label; repeatable.")] = None,
    remove: Annotated[Many, option("--remove", "LABEL", "Remove a label; repeatable.")] = None,
    dry_run: options.DryRun = False,
) -> Output:
    """Add labels to many files, or remove them. Select the files by name or by options."""
    if not add and not remove:
        raise InvalidInput(what="The command", reason="specify what to change: --add or --remove")
    if choice.is_empty() and not files:
        raise InvalidInput(what="The command", reason="specify files: -p, -m, --query, a path, a glob or an id")
    chosen = _chosen(client, choice, files or [])
    if dry_run:
        note(f"Would label {count_of(len(chosen), 'file')}.")
        return as_list(chosen, show_files)
    outcomes = [*client.files.label([file.id for file in chosen], add=add or [], remove=remove or [])]
    failures = []
    for file, outcome in zip(chosen, outcomes, strict=True):
        if outcome.problem is not None:
            failures.append(from_problem(outcome.problem))
            note(f"{file_label(file)}: {outcome.problem.detail}")
    note(f"Labelled {count_of(len(outcomes) - len(failures), 'file')}.")
    return Output({"items": outcomes}, exit_code=exit_code_of(failures))


def _chosen(client: Client, choice: Choice, refs: list[str]) -> list[FileRead]:
    chosen = select_files(client, choice, refs)
    if not chosen:
        raise NothingToDo(reason="No file matches")
    return chosen


@app.command("delete")
def delete(
    client: Client,
    files: Annotated[list[str], argument("FILE", "Paths, globs or ids of files.")],
    project: options.ProjectsOption = None,
    mission: options.MissionsOption = None,
    dry_run: options.DryRun = False,
    yes: options.Yes = False,
) -> Output:
    """Move files to the trash."""
    chosen = _chosen(client, Choice(project=project, mission=mission), files)
    size_bytes = sum(file.size_bytes for file in chosen)
    for file in chosen:
        preview = client.files.delete(file.id, dry_run=True)
        if preview.made_from_it:
            runs, made = count_of(preview.read_by_runs, "run"), ", ".join(preview.made_from_it)
            note(f"{file_label(file)} was read by {runs}; {made}, made from it, stay.")
    if not dry_run:
        show_files(chosen, to_stderr=True)
        options.confirm(f"Move {count_of(len(chosen), 'file')}, {size(size_bytes)}, to the trash?", yes)
        for file in chosen:
            client.files.delete(file.id)
    verb = "Would move" if dry_run else "Moved"
    note(f"{verb} to the trash: {count_of(len(chosen), 'file')}, {size(size_bytes)}")
    document = {"files": len(chosen), "size_bytes": size_bytes, "dry_run": dry_run, "items": chosen}
    return Output(document, (lambda: show_files(chosen)) if dry_run else ())


def _show_topics(topics: Iterable[TopicRead]) -> None:
    """Print the topics of one file as a table."""
    cells = []
    for row in topics:
        gaps = (duration(gap_ns) for gap_ns in (row.longest_gap_ns, row.head_gap_ns, row.tail_gap_ns))
        cells.append((row.name, row.message_type, row.count, rate(row.rate_hz), *gaps))
    table(["topic", "type", "count", "rate", "longest gap", "head gap", "tail gap"], cells)


def _show(file: FileRead) -> None:
    loss = None
    if file.lost is not None:
        messages = file.lost.messages
        loss = "an unknown number of messages" if messages is None else count_of(messages, "message")
        loss += f", {size(file.lost.bytes)} in {count_of(file.lost.chunks, 'chunk')}"
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
            ("lost", loss),
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


def move(
    client: Client,
    files: Annotated[Many, argument("FILES", "Paths, globs or ids of files. Default: all of the mission.")] = None,
    project: options.ProjectsOption = None,
    mission: options.MissionsOption = None,
    to_project: Annotated[Text, option("--to-project", "PROJECT", "Move to this project.")] = None,
    to_mission: Annotated[Text, option("--to-mission", "MISSION", "Move to this mission.")] = None,
    dry_run: options.DryRun = False,
) -> Output:
    """Move files to another mission, or a mission to another project. No bytes are copied."""
    verb = "Would move" if dry_run else "Moved"
    if to_mission is not None and not files:
        raise InvalidInput(what="The command", reason="specify the files to move to the other mission ('*' for all)")
    if to_mission is None and files:
        raise InvalidInput(what="The command", reason="files move to a mission: specify --to-mission")
    if to_mission is not None and files:
        target = client.missions.get(to_mission, project=to_project or options.the_only("project", project))
        moving = _chosen(client, Choice(project=project, mission=mission), files)
        if not dry_run:
            moving = [client.files.update(file.id, mission_id=target.id) for file in moving]
        note(f"{verb} {count_of(len(moving), 'file')} to {target.project.name}/{target.name}.")
        return Output({"dry_run": dry_run, "items": moving}, (lambda: show_files(moving)) if dry_run else ())
    ref = options.the_ref("mission", None, options.the_only("mission", mission))
    chosen = client.missions.get(ref, project=options.the_only("project", project))
    destination = client.projects.get(options.the_ref("project to move to", None, to_project))
    moved = chosen if dry_run else client.missions.update(chosen.id, project_id=destination.id)
    note(f"{verb} {chosen.name} to the project {destination.name}.")
    return Output({"dry_run": dry_run, "mission": moved})


def rename(
    client: Client,
    new_name: Annotated[str, argument("NEW_NAME")],
    project: options.ProjectOption = None,
    mission: options.MissionOption = None,
    file: Annotated[Text, option("--file -f", "FILE", "Select the file by path or id.")] = None,
) -> Output:
    """Rename a file (-f), else a mission (-m), else a project (-p)."""
    renamed: BaseModel
    if file is not None:
        chosen = client.files.get(file, mission=mission, project=project)
        old, renamed = chosen.path, client.files.update(chosen.id, if_match=chosen.etag, path=new_name)
    elif mission is not None:
        target = client.missions.get(mission, project=project)
        old, renamed = target.name, client.missions.update(target.id, if_match=target.etag, name=new_name)
    else:
        parent = client.projects.get(options.the_ref("project", None, project))
        old, renamed = parent.name, client.projects.update(parent.id, if_match=parent.etag, name=new_name)
    return Output(renamed, f"Renamed {old} to {new_name}.")
