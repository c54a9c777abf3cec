"""`klein mission …`"""

from pathlib import Path
from typing import Annotated

import typer

from kleinkram import connect
from kleinkram.cli.commands import Noun
from kleinkram.cli.completion import complete_mission, complete_project
from kleinkram.cli.filters import Many, projects_of
from kleinkram.cli.mission_view import show_changes, show_contents, show_mission, show_missions
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
    confirm,
    read_text,
    the_ref,
)
from kleinkram.cli.render import escape, line, note, show_json, show_json_list
from kleinkram.cli.units import count, size
from kleinkram.client._nouns import checked
from kleinkram.client.errors import InvalidInput
from kleinkram.contract.missions import MissionFilter, MissionSort
from kleinkram.contract.names import is_id

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
    given: dict[str, object] = {"text": text, "where": where, "topic": topic}
    given["satisfied"] = False if unsatisfied else None
    with connect() as client:
        refs = [str(client.missions.id_of(ref)) if "/" in ref else ref for ref in [*(names or []), *(mission or [])]]
        given |= {"name": refs[0]} if len(refs) == 1 and not is_id(refs[0]) else {"missions": refs}
        given |= projects_of(client, project)
        matching = checked(MissionFilter, "The filter", **{key: value for key, value in given.items() if value})
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
        found = client.missions.get(the_ref("mission", name, mission), project=project)
        show_contents(client, found, as_json)


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
    given: dict[str, str | bool] = {"name": new_name} if new_name is not None else {}
    given |= {"notes": notes} if notes is not None else {}
    if text is not None:
        given |= {"metadata_yaml": text, "merge_yaml": not replace}
    with connect() as client:
        found = client.missions.get(the_ref("mission", name, mission), project=project)
        changed = client.missions.update(found.id, if_match=etag or found.etag, **given)
    if as_json:
        show_json(changed)
        return
    show_changes(found, changed)


@app.command("complete")
def complete(
    name: NameArgument = None, project: ProjectOption = None, mission: MissionOption = None, as_json: AsJson = False
) -> None:
    """Say that all of a mission has been uploaded."""
    with connect() as client:
        found = client.missions.get(the_ref("mission", name, mission), project=project)
        changed = client.missions.complete(found.id)
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
        found = client.projects.get(the_ref("project", name, project))
        form = client.projects.template(found.id)
    if as_json:
        show_json(form)
        return
    if form.prefilled_from is not None and form.carried:
        note(f"Values of {escape(form.prefilled_from.name)} stand in comments: write those that hold again.")
    for each in form.yaml.rstrip("\n").split("\n"):
        line(each)


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
        found = client.missions.get(the_ref("mission", name, mission), project=project)
        would = client.missions.delete(found.id, dry_run=True)
        what = f"{found.project.name}/{found.name}: {count(would.files, 'file')}, {size(would.size_bytes)}"
        if not dry_run:
            confirm(f"Move to the trash {what}?", yes)
            would = client.missions.delete(found.id)
    show_json(would) if as_json else note(f"{'Would move' if dry_run else 'Moved'} to the trash: {what}")
