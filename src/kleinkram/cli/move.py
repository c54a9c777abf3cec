"""`klein move` and `klein rename`"""

from typing import Annotated

import typer
from pydantic import BaseModel

from kleinkram import connect
from kleinkram.cli.file import show_found
from kleinkram.cli.filters import Choice, Many, select_files
from kleinkram.cli.options import (
    AsJson,
    DryRun,
    MissionOption,
    MissionsOption,
    ProjectOption,
    ProjectsOption,
    the_only,
    the_ref,
)
from kleinkram.cli.render import escape, note, show_json
from kleinkram.cli.units import count
from kleinkram.client import Client
from kleinkram.client.errors import InvalidInput, NothingToDo


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
            found = client.files.get(file, mission=mission, project=project)
            old, renamed = found.path, client.files.update(found.id, if_match=found.etag, path=new_name)
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
    found = client.missions.get(mission, project=project)
    target = client.projects.get(the_ref("project to move to", None, to_project))
    moved = found if dry_run else client.missions.update(found.id, project_id=target.id)
    if as_json:
        show_json({"dry_run": dry_run, "mission": moved})
    note(f"{'Would move' if dry_run else 'Moved'} {escape(found.name)} to the project {escape(target.name)}.")


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
    found = select_files(client, choice, refs)
    if not found:
        raise NothingToDo(reason="No file matches")
    if not dry_run:
        found = [client.files.update(file.id, mission_id=target.id) for file in found]
    if as_json:
        show_json({"dry_run": dry_run, "items": found})
    elif dry_run:
        show_found(found)
    place = escape(f"{target.project.name}/{target.name}")
    note(f"{'Would move' if dry_run else 'Moved'} {count(len(found), 'file')} to {place}.")
