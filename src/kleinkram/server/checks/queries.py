"""Selects of checks: missions to be judged, stored results, and what people and uploaders added to them."""

import uuid
from typing import Any

from sqlalchemy import Select, and_, exists, not_, or_, select

from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import visible_missions
from kleinkram.server.filters.verdicts import is_current, join_checks, shown_counts, shown_verdict
from kleinkram.server.tables import (
    check_acceptance,
    check_note,
    check_report,
    mission,
    mission_checks,
    person,
    project,
    project_action,
)

_ender = person.alias("ender")


def outdated_missions() -> Select[Any]:
    """Return the ids of missions, by id, whose stored checks are outdated or missing, and can be made."""
    has_source = or_(
        project.c.checks_number > 0,
        exists().where(check_report.c.mission_id == mission.c.id),
        exists().where(project_action.c.project_id == mission.c.project_id),
    )
    is_missing = and_(mission_checks.c.mission_id.is_(None), has_source)
    is_outdated = and_(mission_checks.c.mission_id.is_not(None), not_(is_current()))
    stmt = join_checks(select(mission.c.id).join(project, project.c.id == mission.c.project_id))
    is_live = and_(mission.c.deleted_at.is_(None), project.c.deleted_at.is_(None))
    is_derived = and_(mission.c.files_revision > 0, mission.c.derived_revision == mission.c.files_revision)
    return stmt.where(is_live, is_derived, or_(is_missing, is_outdated)).order_by(mission.c.id)


def checks_of_mission(actor: Actor, mission_id: uuid.UUID) -> Select[Any]:
    """Return one visible mission with its stored checks; their columns are null where there are none."""
    names = (
        "checks",
        "checks_number",
        "files_revision",
        "profiles_applied",
        "profiles_left_out",
        "evaluated_at",
        "bad_since",
    )
    columns = (mission.c.id, *(mission_checks.c[name] for name in names), is_current().label("is_current"))
    shown = (shown_verdict(actor).label("verdict"), shown_counts(actor).label("counts"))
    stmt = visible_missions(actor).with_only_columns(*columns, *shown, maintain_column_froms=True)
    return join_checks(stmt).where(mission.c.id == mission_id)


def acceptances_of(mission_id: uuid.UUID) -> Select[Any]:
    """Return the acceptances of a mission, latest first."""
    stmt = select(check_acceptance, person.c.name.label("created_by_name"), _ender.c.name.label("ended_by_name"))
    stmt = stmt.join(person, person.c.id == check_acceptance.c.created_by_id)
    stmt = stmt.outerjoin(_ender, _ender.c.id == check_acceptance.c.ended_by_id)
    newest = (check_acceptance.c.created_at.desc(), check_acceptance.c.id)
    return stmt.where(check_acceptance.c.mission_id == mission_id).order_by(*newest)


def notes_of(mission_id: uuid.UUID) -> Select[Any]:
    """Return the notes of a mission, oldest first."""
    stmt = select(check_note, person.c.name.label("created_by_name"))
    stmt = stmt.join(person, person.c.id == check_note.c.created_by_id)
    return stmt.where(check_note.c.mission_id == mission_id).order_by(check_note.c.created_at, check_note.c.id)


def reports_of(mission_id: uuid.UUID) -> Select[Any]:
    """Return the reports of a mission, latest first."""
    stmt = select(check_report, person.c.name.label("created_by_name"))
    stmt = stmt.join(person, person.c.id == check_report.c.created_by_id)
    newest = (check_report.c.created_at.desc(), check_report.c.id)
    return stmt.where(check_report.c.mission_id == mission_id).order_by(*newest)
