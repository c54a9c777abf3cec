"""Which project, mission, person or group a request is about, as its address says; for notes on what is no change."""

import uuid
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Select, Uuid, literal, null, select

from kleinkram.server.tables import access_group, file, mission, person, project, recording, upload

_IN_QUERY = ("project_id", "mission_id")
# What lies in a mission, and by which name an address speaks of it.
_INSIDE = {"file_id": file, "recording_id": recording, "upload_id": upload}
# What is no id is nobody's.
_NOBODYS = uuid.UUID(int=0)
_OTHERS = {"person_id": person, "group_id": access_group}


@dataclass(frozen=True)
class Named:
    """What a request's address names: the kind of id, and the id."""

    kind: str
    id: uuid.UUID


def named(path: Mapping[str, object], query: Mapping[str, str]) -> Named | None:
    """Return the one thing that a request's path names, else its filter; None for everything there is."""
    inner_first = [*_INSIDE, "mission_id", "project_id", *_OTHERS]
    given = {name: query[name] for name in _IN_QUERY if name in query} | {name: str(path[name]) for name in path}
    return next((Named(kind, _parse(given[kind])) for kind in inner_first if kind in given), None)


def whereabouts(of: Named) -> Select[Any]:
    """Return `noun`, `noun_id`, `noun_name`, `project_id` and `mission_id` of a thing's mission or project, or its own.

    Where it is a mission's or a project's, the select holds `project`, and `mission`, for a condition on rights.
    """
    if of.kind in _OTHERS:
        table = _OTHERS[of.kind]
        noun = of.kind.removesuffix("_id")
        nowhere = null().cast(Uuid)
        return _row(noun, table, nowhere.label("project_id"), nowhere.label("mission_id")).where(table.c.id == of.id)
    if of.kind == "project_id":
        row = _row("project", project, project.c.id.label("project_id"), null().cast(Uuid).label("mission_id"))
        return row.where(project.c.id == of.id)
    row = _row("mission", mission, mission.c.project_id, mission.c.id.label("mission_id")).join(
        project, project.c.id == mission.c.project_id
    )
    if of.kind == "mission_id":
        return row.where(mission.c.id == of.id)
    inside = _INSIDE[of.kind]
    return row.join(inside, inside.c.mission_id == mission.c.id).where(inside.c.id == of.id)


def _row(noun: str, table: Any, *place: Any) -> Select[Any]:  # Any: columns and labels alike
    return select(literal(noun).label("noun"), table.c.id.label("noun_id"), table.c.name.label("noun_name"), *place)


def _parse(text: str) -> uuid.UUID:
    try:
        return uuid.UUID(text)
    except ValueError:
        return _NOBODYS
