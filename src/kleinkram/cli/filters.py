"""The options of `search`, `stats`, `file list` and `download` that select files, and the filters that they mean."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, TypeVar

from pydantic import BaseModel

from kleinkram.cli.commands import Many, Text, option
from kleinkram.cli.options import MissionsOption, ProjectsOption, the_only
from kleinkram.cli.units import parse_size, parse_time
from kleinkram.client import Client
from kleinkram.client._resources import checked, is_glob
from kleinkram.contract.errors import NotFound
from kleinkram.contract.files import FileFilter, FileRead
from kleinkram.contract.missions import MissionFilter, MissionRead
from kleinkram.contract.names import is_id, name_key
from kleinkram.contract.query import combined_filter, render
from kleinkram.contract.search import FileQuery

FilterT = TypeVar("FilterT", bound=BaseModel)
WhereOption = Annotated[
    Many, option("--where -w", "FIELD=VALUE", "Select by metadata: robot=anymal, temperature>20; repeatable.")
]


@dataclass(frozen=True)
class Choice:
    """The values of the filter options, named as the fields of `FileQuery`."""

    query: Annotated[Text, option("--query", "QUERY", "Select by one query: 'alps topic:/imu -label:night'.")] = None
    project: ProjectsOption = None
    mission: MissionsOption = None
    text: Annotated[Text, option("--text", "TEXT", "Search names, notes and metadata for TEXT.")] = None
    where: WhereOption = None
    topic: Annotated[Many, option("--topic -t", "GLOB", "Select files with a matching topic.")] = None
    message_type: Annotated[Many, option("--type", "GLOB", "Select files with a matching message type.")] = None
    format: Annotated[Many, option("--format", "FORMAT", "Select by format: mcap, rosbag1, db3, …")] = None
    label: Annotated[Many, option("--label", "LABEL", "Select files with this label.")] = None
    event: Annotated[Many, option("--event", "GLOB", "Select files recorded during an event of this name.")] = None
    state: Annotated[
        Many, option("--state", "STATE", "Select by state of the bytes: stored, verified, lost, corrupt.")
    ] = None
    content: Annotated[
        Many, option("--content", "STATE", "Select by content: pending, indexed, recovered, broken, opaque, error.")
    ] = None
    recorded_after: Annotated[Text, option("--after", "TIME", "Select files recorded after TIME.")] = None
    recorded_before: Annotated[Text, option("--before", "TIME", "Select files recorded before TIME.")] = None
    min_size_bytes: Annotated[Text, option("--min-size", "SIZE", "Select files of at least SIZE.")] = None
    max_size_bytes: Annotated[Text, option("--max-size", "SIZE", "Select files of at most SIZE.")] = None

    def is_empty(self) -> bool:
        """Say whether no option was given."""
        return all(value in (None, []) for value in vars(self).values())


def file_filter(client: Client, choice: Choice, paths: Sequence[str] = ()) -> FileFilter:
    """Return the filter of the options; a project or mission without wildcards must exist.

    A query applies together with the other options.
    """
    projects, missions = choice.project, choice.mission
    is_wide = projects is not None and (len(projects) > 1 or any(map(is_glob, projects)))
    location: dict[str, object]
    if not missions:
        location = projects_of(client, projects)
    elif len(missions) == 1 and (is_glob(missions[0]) or (is_wide and not is_id(missions[0]))):
        location = {**projects_of(client, projects), "mission": missions[0]}
    elif len(missions) == 1:
        location = {"mission_id": client.missions.get(missions[0], project=the_only("project", projects)).id}
    elif is_wide:
        location = {**projects_of(client, projects), "missions": missions}
    else:
        globs = [ref for ref in missions if is_glob(ref)]
        names = [ref for ref in missions if not is_glob(ref)]
        ids = [str(mission.id) for ref in names for mission in find_missions(client, ref, projects)]
        location = {**(projects_of(client, projects) if globs else {}), "missions": [*ids, *globs]}
    return _filter(choice, location, paths)


def mission_query(client: Client, choice: Choice, paths: Sequence[str] = ()) -> str:
    """Return the query for the missions of the options; several missions may have the same name."""
    missions = choice.mission or []
    location: dict[str, object] = {"missions": missions}
    if len(missions) == 1:
        location = {"mission_id" if is_id(missions[0]) else "mission": missions[0]}
    return render(_filter(choice, {**projects_of(client, choice.project), **location}, paths))


def _filter(choice: Choice, location: dict[str, object], paths: Sequence[str]) -> FileFilter:
    fields = {name: value for name, value in vars(choice).items() if name not in {"project", "mission"}}
    fields |= {**location, "path": [*paths]}
    for name in ("recorded_after", "recorded_before"):
        fields[name] = parse_time(fields[name])
    for name in ("min_size_bytes", "max_size_bytes"):
        fields[name] = fields[name] and parse_size(fields[name])
    return combined_filter(filter_of(FileQuery, fields))


def filter_of(kind: type[FilterT], fields: Mapping[str, object]) -> FilterT:
    """Return a filter with the fields that are set; raise InvalidInput if one is invalid."""
    set_fields = {name: value for name, value in fields.items() if value is not False and value not in (None, [], "")}
    return checked(kind, "The filter", **set_fields)


def select_files(client: Client, choice: Choice, refs: Sequence[str]) -> list[FileRead]:
    """Return the files of these ids, paths and globs, among those that the options select.

    Raises:
        NotFound: there is no file of an id or of a path without wildcards.
    """
    ids = [ref for ref in refs if is_id(ref)]
    paths = [ref for ref in refs if not is_id(ref)]
    matches = [client.files.get(ref) for ref in ids]
    if paths or not ids:
        matches += client.files.list(file_filter(client, choice, paths))
    keys = {name_key(file.path) for file in matches}
    for path in paths:
        if not is_glob(path) and name_key(path) not in keys:
            raise NotFound(resource_type="file", ref=path)
    return [*{file.id: file for file in matches}.values()]


def projects_of(client: Client, refs: Sequence[str] | None) -> dict[str, object]:
    """Return the filter fields for these projects; one without wildcards must exist."""
    within = [client.missions.within(ref).model_dump(exclude_defaults=True) for ref in refs or [] if not is_glob(ref)]
    globs = [ref for ref in refs or [] if is_glob(ref)]
    if len(within) == 1 and not globs:
        return within[0]
    if len(globs) == 1 and not within:
        return {"project": globs[0]}
    return {"projects": [*(str(value) for fields in within for value in fields.values()), *globs]}


def ids_of(client: Client, projects: Sequence[str] | None, missions: Sequence[str] | None) -> dict[str, object]:
    """Return the filter fields for these missions, or else these projects, by id.

    Raises:
        NotFound: a name or glob means none.
        AmbiguousName: no project was named, and several have a mission of that name.
    """
    if missions:
        ids = [mission.id for ref in missions for mission in find_missions(client, ref, projects)]
        return {"mission_id": ids[0]} if len(ids) == 1 else {"mission_ids": [*dict.fromkeys(ids)]}
    if not projects:
        return {}
    ids = []
    for ref in projects:
        rows = [*client.projects.list(name=ref)] if is_glob(ref) else [client.projects.get(ref)]
        if not rows:
            raise NotFound(resource_type="project", ref=ref)
        ids += [row.id for row in rows]
    return {"project_id": ids[0]} if len(ids) == 1 else {"project_ids": [*dict.fromkeys(ids)]}


def find_missions(client: Client, ref: str, projects: Sequence[str] | None) -> list[MissionRead]:
    """Return the missions of this id or name, or whose names match a glob, in each of the projects.

    Raises:
        NotFound: there is none.
        AmbiguousName: no project was named, and several have a mission of that name.
    """
    is_in_one = not projects or (len(projects) == 1 and not is_glob(projects[0]))
    if (is_id(ref) or is_in_one) and not is_glob(ref):
        return [client.missions.get(ref, project=projects[0] if projects else None)]
    within = filter_of(MissionFilter, {"name": ref, **projects_of(client, projects)})
    matches = [row for row in client.missions.list(within) if is_glob(ref) or name_key(row.name) == name_key(ref)]
    if not matches:
        raise NotFound(resource_type="mission", ref=ref)
    return matches
