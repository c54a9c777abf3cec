"""The verdict of a mission as SQL: as stored, unless its files, its project or their `checks.yaml` changed since."""

import functools
from typing import Any

from sqlalchemy import ColumnElement, Select, Text, and_, case, func, literal, literal_column, type_coerce
from sqlalchemy.dialects.postgresql import JSONB

from kleinkram.contract.checks import Verdict
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import sees_whole_missions
from kleinkram.server.tables import mission, mission_checks, project


def join_checks(stmt: Select[Any]) -> Select[Any]:
    """Join the stored checks to a select of missions and projects, for `shown_verdict` and `shown_counts`."""
    return stmt.outerjoin(mission_checks, mission_checks.c.mission_id == mission.c.id)


def shown_verdict(actor: Actor) -> ColumnElement[str]:
    """Return the verdict of each mission; `unchecked` for actors who do not see whole missions."""
    return _verdict() if sees_whole_missions(actor) else literal(Verdict.unchecked.value, Text)


def shown_counts(actor: Actor) -> ColumnElement[Any]:
    """Return the number of checks of each mission by status, as an object."""
    nothing = literal_column("'{}'::jsonb", JSONB)
    return func.coalesce(mission_checks.c.counts, nothing) if sees_whole_missions(actor) else nothing


@functools.cache
def is_current() -> ColumnElement[bool]:
    """Whether the stored checks of a mission are of its present files and by the present `checks.yaml`."""
    return and_(
        ~mission_checks.c.is_outdated,
        mission_checks.c.files_revision == mission.c.files_revision,
        mission_checks.c.project_id == mission.c.project_id,
        mission_checks.c.checks_number == project.c.checks_number,
    )


@functools.cache
def _verdict() -> ColumnElement[str]:
    is_first_time = and_(project.c.checks_number > 0, mission.c.files_revision > 0)
    missing = case((is_first_time, Verdict.running.value), else_=Verdict.unchecked.value)
    stored = case((is_current(), mission_checks.c.verdict), else_=Verdict.outdated.value)
    return type_coerce(case((mission_checks.c.mission_id.is_(None), missing), else_=stored), Text)
