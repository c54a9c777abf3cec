"""Searches the texts that people wrote for a name or an address, to report where an erasure leaves it."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa

from kleinkram.contract.access import Right
from kleinkram.contract.names import name_key
from kleinkram.contract.people import Mention, MentionPlace
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import visible_files, visible_groups, visible_missions, visible_projects
from kleinkram.server.db import ESCAPE, Connection, containing
from kleinkram.server.tables import (
    access_group,
    action,
    action_version,
    check_acceptance,
    check_note,
    file,
    mission,
    mission_event,
    project,
    project_checks,
    run,
    share,
    viewer_layout,
)

# Of each kind of object: an admin who finds so many does not correct them one by one.
MOST = 500
# With a backslash, each of these characters stands for itself in PostgreSQL's regular expressions.
_NOT_WORD, _ESCAPED = re.compile(r"(\W)"), r"\\\1"


@dataclass(frozen=True)
class _Place:
    """Objects with texts: where their names are, and their fields, each with the expression that is searched.

    `is_visible` is the condition on the objects that an actor may see.
    """

    resource_type: MentionPlace
    rows: sa.FromClause
    id: sa.ColumnElement[object]
    name: sa.ColumnElement[str]
    fields: Mapping[str, sa.ColumnElement[str]]
    is_visible: Callable[[Actor], sa.ColumnElement[bool]]


def _in_project(column: sa.ColumnElement[Any]) -> Callable[[Actor], sa.ColumnElement[bool]]:
    return lambda actor: column.in_(visible_projects(actor).with_only_columns(project.c.id).correlate(None))


def _in_mission(column: sa.ColumnElement[Any], right: Right = Right.read) -> Callable[[Actor], sa.ColumnElement[bool]]:
    def condition(actor: Actor) -> sa.ColumnElement[bool]:
        missions = visible_missions(actor, right).with_only_columns(mission.c.id, maintain_column_froms=True)
        return column.in_(missions.correlate(None))

    return condition


def _is_visible_file(actor: Actor) -> sa.ColumnElement[bool]:
    files = visible_files(actor).with_only_columns(file.c.id, maintain_column_froms=True)
    return file.c.id.in_(files.correlate(None))


def _is_visible_group(actor: Actor) -> sa.ColumnElement[bool]:
    return access_group.c.id.in_(visible_groups(actor).with_only_columns(access_group.c.id).correlate(None))


def _is_visible_action(actor: Actor) -> sa.ColumnElement[bool]:
    return action.c.project_id.is_(None) | _in_project(action.c.project_id)(actor)


_PLACES = (
    _Place(
        MentionPlace.project,
        project,
        project.c.id,
        project.c.name,
        {name: project.c[name] for name in ("name", "description", "licence", "citation")},
        _in_project(project.c.id),
    ),
    _Place(
        MentionPlace.project,
        project_checks.join(project),
        project.c.id,
        project.c.name,
        {"checks.yaml": project_checks.c.text},
        _in_project(project.c.id),
    ),
    _Place(
        MentionPlace.project,
        viewer_layout.join(project),
        project.c.id,
        project.c.name,
        {"name of a layout": viewer_layout.c.name_key},
        lambda actor: viewer_layout.c.is_shared & _in_project(project.c.id)(actor),
    ),
    _Place(
        MentionPlace.mission,
        mission,
        mission.c.id,
        mission.c.name,
        {
            "name": mission.c.name_key,
            "notes": mission.c.notes,
            # As in the index of the words of metadata.
            "metadata": sa.cast(mission.c.metadata, sa.Text),
            "metadata_yaml": mission.c.metadata_yaml,
        },
        _in_mission(mission.c.id),
    ),
    _Place(
        MentionPlace.mission,
        check_note.join(mission, mission.c.id == check_note.c.mission_id),
        mission.c.id,
        mission.c.name,
        {"note on a check": check_note.c.text},
        _in_mission(mission.c.id),
    ),
    _Place(
        MentionPlace.mission,
        check_acceptance.join(mission, mission.c.id == check_acceptance.c.mission_id),
        mission.c.id,
        mission.c.name,
        {"accepted check": check_acceptance.c.because},
        _in_mission(mission.c.id),
    ),
    _Place(
        MentionPlace.mission,
        mission_event.join(mission, mission.c.id == mission_event.c.mission_id),
        mission.c.id,
        mission.c.name,
        {
            "name of an event": mission_event.c.name_key,
            "note of an event": mission_event.c.note,
            "labels of an event": sa.func.joined(mission_event.c.labels),
        },
        _in_mission(mission.c.id),
    ),
    _Place(
        MentionPlace.file,
        file,
        file.c.id,
        file.c.path,
        {"path": file.c.path_key, "labels": sa.func.joined(file.c.labels)},
        _is_visible_file,
    ),
    _Place(
        MentionPlace.action,
        action.join(action_version),
        action.c.id,
        action.c.name,
        {"name": action.c.name, "definition": sa.cast(action_version.c.definition, sa.Text)},
        _is_visible_action,
    ),
    _Place(
        MentionPlace.run,
        run.join(mission, mission.c.id == run.c.mission_id),
        run.c.id,
        mission.c.name,
        {
            "parameters": sa.cast(run.c.parameters, sa.Text),
            # Copies of the mission's, from then.
            "metadata": sa.func.concat(run.c.input_metadata, run.c.proposed),
            "message": run.c.message,
        },
        _in_mission(mission.c.id),
    ),
    _Place(
        MentionPlace.group,
        access_group,
        access_group.c.id,
        access_group.c.name,
        {"name": sa.case((access_group.c.kind == "custom", access_group.c.name), else_="")},
        _is_visible_group,
    ),
    _Place(
        MentionPlace.share,
        share,
        share.c.id,
        share.c.name,
        {"name": share.c.name},
        _in_mission(share.c.mission_id, Right.write),
    ),
)


async def find_mentions(db: Connection, terms: Sequence[str], *, visible_to: Actor | None = None) -> list[Mention]:
    """Return at most `MOST` objects of each kind with a text that contains one of the terms as whole words.

    With `visible_to`, only objects that this actor may see.
    """
    mentions: list[Mention] = []
    for place in _PLACES if terms else ():
        matches = {field: sa.or_(*(_contains(text, term) for term in terms)) for field, text in place.fields.items()}
        columns = [sa.func.coalesce(sa.func.bool_or(match), False).label(field) for field, match in matches.items()]
        stmt = sa.select(place.id.label("object_id"), place.name.label("object_name"), *columns)
        stmt = stmt.select_from(place.rows).where(sa.or_(*matches.values()))
        stmt = stmt if visible_to is None else stmt.where(place.is_visible(visible_to))
        stmt = stmt.group_by(place.id, place.name).order_by(place.id).limit(MOST)
        for row in (await db.execute(stmt)).mappings():
            fields = [field for field in matches if row[field]]
            mentions.append(
                Mention(resource_type=place.resource_type, id=row["object_id"], name=row["object_name"], fields=fields)
            )
    return mentions


def _contains(text: sa.ColumnElement[str], term: str) -> sa.ColumnElement[bool]:
    """Whether a text contains a term as whole words, in any case. The first condition is that of the indexes."""
    spellings = sorted({term.lower(), name_key(term)})
    return sa.or_(
        *(
            text.ilike(containing(spelling), escape=ESCAPE)
            & text.regexp_match(rf"(^|\W){re.sub(_NOT_WORD, _ESCAPED, spelling)}(\W|$)", flags="i")
            for spelling in spellings
        )
    )
