"""The options that say which files: the same on `search`, `stats`, `file list` and `download`."""

import functools
import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import typer

from kleinkram.cli.options import MissionsOption, ProjectsOption, the_only
from kleinkram.cli.units import parse_size, parse_time
from kleinkram.client import Client
from kleinkram.client._nouns import checked, is_glob
from kleinkram.contract.errors import NotFound
from kleinkram.contract.files import FileFilter, FileRead
from kleinkram.contract.missions import MissionFilter, MissionRead
from kleinkram.contract.names import is_id, name_key
from kleinkram.contract.projects import ProjectRead
from kleinkram.contract.query import render, whole
from kleinkram.contract.search import FileQuery

Many = list[str] | None


@dataclass(frozen=True)
class Choice:
    """What the filter options said, as they were given."""

    query: Annotated[
        str | None, typer.Option("--query", metavar="QUERY", help="All in one text: 'alps topic:/imu -label:night'.")
    ] = None
    project: ProjectsOption = None
    mission: MissionsOption = None
    text: Annotated[str | None, typer.Option("--text", metavar="TEXT", help="Found in names, notes and metadata.")] = (
        None
    )
    where: Annotated[
        Many, typer.Option("--where", "-w", metavar="FIELD=VALUE", help="Metadata: robot=anymal, temperature>20.")
    ] = None
    topic: Annotated[Many, typer.Option("--topic", "-t", metavar="GLOB", help="Has such a topic.")] = None
    message_type: Annotated[Many, typer.Option("--type", metavar="GLOB", help="Has such a message type.")] = None
    file_format: Annotated[Many, typer.Option("--format", metavar="FORMAT", help="mcap, rosbag1, db3, …")] = None
    label: Annotated[Many, typer.Option("--label", metavar="LABEL", help="Has this label.")] = None
    state: Annotated[Many, typer.Option("--state", metavar="STATE", help="Bytes: stored, verified, lost, corrupt.")] = (
        None
    )
    content: Annotated[
        Many,
        typer.Option("--content", metavar="STATE", help="Content: pending, indexed, recovered, broken, opaque, error."),
    ] = None
    after: Annotated[str | None, typer.Option("--after", metavar="TIME", help="Recorded after this time.")] = None
    before: Annotated[str | None, typer.Option("--before", metavar="TIME", help="Recorded before this time.")] = None
    min_size: Annotated[str | None, typer.Option("--min-size", metavar="SIZE", help="At least so large.")] = None
    max_size: Annotated[str | None, typer.Option("--max-size", metavar="SIZE", help="At most so large.")] = None

    def is_empty(self) -> bool:
        """Say whether nothing was given."""
        return all(value in (None, []) for value in vars(self).values())


def with_choice(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command the filter options; it gets them as `choice`."""
    own = [parameter for name, parameter in inspect.signature(command).parameters.items() if name != "choice"]
    shared = [*inspect.signature(Choice).parameters.values()]
    names = {parameter.name for parameter in shared}

    @functools.wraps(command)
    def run(**all_fields: Any) -> None:  # Any: Typer calls with what the options are
        choice = Choice(**{name: value for name, value in all_fields.items() if name in names})
        command(choice=choice, **{name: value for name, value in all_fields.items() if name not in names})

    every = sorted([*own, *shared], key=lambda parameter: parameter.default is not inspect.Parameter.empty)
    every = [parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY) for parameter in every]
    run.__signature__ = inspect.Signature(every)  # type: ignore[attr-defined]  # how inspect lets itself be told
    run.__annotations__ = {parameter.name: parameter.annotation for parameter in every}
    del run.__wrapped__
    return run


def file_filter(client: Client, choice: Choice, paths: Sequence[str] = ()) -> FileFilter:
    """Return the filter that the options mean; a project or mission that is named, not a glob, must exist.

    A query holds beside the other options, as if all had been said in one text.

    Raises:
        NotFound, AmbiguousName: of a project or mission that was named by an option.
        InvalidQuery: the query cannot be read, or an option says again what may be said once.
        InvalidInput: a value is not usable.
    """
    return _filter(choice, _place(client, choice), paths)


def mission_query(client: Client, choice: Choice, paths: Sequence[str] = ()) -> str:
    """Return the text of the query for the missions that the options mean; several may have the name that was given.

    Raises:
        NotFound, AmbiguousName: of a project that was named by an option.
        InvalidQuery, InvalidInput: as in `file_filter`.
    """
    missions = choice.mission or []
    named: dict[str, object] = {"missions": missions}
    if len(missions) == 1:
        named = {"mission_id" if is_id(missions[0]) else "mission": missions[0]}
    return render(_filter(choice, {**projects_of(client, choice.project), **named}, paths))


def _filter(choice: Choice, place: dict[str, object], paths: Sequence[str]) -> FileFilter:
    all_fields: dict[str, object] = {
        **place,
        "text": choice.text,
        "path": [*paths],
        "where": choice.where,
        "topic": choice.topic,
        "message_type": choice.message_type,
        "format": choice.file_format,
        "label": choice.label,
        "state": choice.state,
        "content": choice.content,
        "recorded_after": parse_time(choice.after),
        "recorded_before": parse_time(choice.before),
        "min_size_bytes": None if choice.min_size is None else parse_size(choice.min_size),
        "max_size_bytes": None if choice.max_size is None else parse_size(choice.max_size),
        "query": choice.query,
    }
    set_fields = {key: value for key, value in all_fields.items() if value not in (None, [])}
    return whole(checked(FileQuery, "The filter", **set_fields))


def select_files(client: Client, choice: Choice, refs: Sequence[str]) -> list[FileRead]:
    """Return the files that these ids, paths and globs mean, among those that the options choose.

    Raises:
        NotFound: an id or a path without wildcards means no file.
    """
    ids = [ref for ref in refs if is_id(ref)]
    paths = [ref for ref in refs if not is_id(ref)]
    matches = [client.files.get(ref) for ref in ids]
    if paths or not ids:
        matches += client.files.list(file_filter(client, choice, paths))
    there = {name_key(file.path) for file in matches}
    for path in paths:
        if not is_glob(path) and name_key(path) not in there:
            raise NotFound(noun="file", ref=path)
    return [*{file.id: file for file in matches}.values()]


def projects_of(client: Client, refs: Sequence[str] | None) -> dict[str, object]:
    """Return the part of a filter that says which projects; one that is named must exist.

    Raises:
        NotFound, AmbiguousName: of a project that was named.
    """
    within = [client.missions.within(ref).model_dump(exclude_defaults=True) for ref in refs or [] if not is_glob(ref)]
    globs = [ref for ref in refs or [] if is_glob(ref)]
    if len(within) == 1 and not globs:
        return within[0]
    if len(globs) == 1 and not within:
        return {"project": globs[0]}
    return {"projects": [*(str(value) for scope_part in within for value in scope_part.values()), *globs]}


def ids_of(client: Client, projects: Sequence[str] | None, missions: Sequence[str] | None) -> dict[str, object]:
    """Return the ids of the missions that are meant, or else of the projects, for filters that know only ids.

    Raises:
        NotFound: a name or glob means none.
        AmbiguousName: no project was named, and several have a mission of that name.
    """
    if missions:
        matches = [mission.id for ref in missions for mission in find_missions(client, ref, projects)]
        return {"mission_id": matches[0]} if len(matches) == 1 else {"mission_ids": [*dict.fromkeys(matches)]}
    if not projects:
        return {}
    named = [project.id for ref in projects for project in _projects(client, ref)]
    return {"project_id": named[0]} if len(named) == 1 else {"project_ids": [*dict.fromkeys(named)]}


def find_missions(client: Client, ref: str, projects: Sequence[str] | None) -> list[MissionRead]:
    """Return the missions of this id or name, or whose names match a glob, in each of the projects.

    Raises:
        NotFound: there is none.
        AmbiguousName: no project was named, and several have a mission of that name.
    """
    is_in_one = not projects or (len(projects) == 1 and not is_glob(projects[0]))
    if (is_id(ref) or is_in_one) and not is_glob(ref):
        return [client.missions.get(ref, project=projects[0] if projects else None)]
    within = checked(MissionFilter, "The filter", name=ref, **projects_of(client, projects))
    matches = [row for row in client.missions.list(within) if is_glob(ref) or name_key(row.name) == name_key(ref)]
    if not matches:
        raise NotFound(noun="mission", ref=ref)
    return matches


def _projects(client: Client, ref: str) -> list[ProjectRead]:
    if not is_glob(ref):
        return [client.projects.get(ref)]
    if not (matches := [*client.projects.list(name=ref)]):
        raise NotFound(noun="project", ref=ref)
    return matches


def _place(client: Client, choice: Choice) -> dict[str, object]:
    projects, missions = choice.project, choice.mission
    is_wide = projects is not None and (len(projects) > 1 or any(map(is_glob, projects)))
    if not missions:
        return projects_of(client, projects)
    if len(missions) == 1 and (is_glob(missions[0]) or (is_wide and not is_id(missions[0]))):
        return {**projects_of(client, projects), "mission": missions[0]}
    if len(missions) == 1:
        return {"mission_id": client.missions.get(missions[0], project=the_only("project", projects)).id}
    if is_wide:
        return {**projects_of(client, projects), "missions": missions}
    globs = [ref for ref in missions if is_glob(ref)]
    names = [ref for ref in missions if not is_glob(ref)]
    named = [str(mission.id) for ref in names for mission in find_missions(client, ref, projects)]
    within = projects_of(client, projects) if globs else {}
    return {**within, "missions": [*named, *globs]}
