"""Selects of checks: missions to be judged, stored results, and what people and uploaders added to them."""

import uuid
from collections.abc import Sequence
from typing import Any, NamedTuple

from sqlalchemy import (
    BigInteger,
    ColumnElement,
    Select,
    and_,
    case,
    cast,
    column,
    exists,
    func,
    not_,
    or_,
    select,
    true,
)
from sqlalchemy.dialects.postgresql import JSONB

from kleinkram.contract.checks import CheckDepth, MissionCheckFilter
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import visible_missions
from kleinkram.server.checks.facts import JudgedMission
from kleinkram.server.db import matches
from kleinkram.server.filters.verdicts import is_current, join_checks, shown_counts, shown_verdict
from kleinkram.server.pagination import Order
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


class AppliedRules(NamedTuple):
    """A `checks.yaml`, by its hash, and the sorted names of the profiles of it that apply to a mission."""

    sha256: bytes
    profiles: Sequence[str]


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
    """Return one visible mission with what is stored of its checks, but not these; null where nothing is."""
    names = ("checks_number", "files_revision", "profiles_applied", "profiles_left_out", "evaluated_at", "bad_since")
    columns = (mission.c.id, *(mission_checks.c[name] for name in names), is_current().label("is_current"))
    shown = (shown_verdict(actor).label("verdict"), shown_counts(actor).label("counts"))
    stmt = visible_missions(actor).with_only_columns(*columns, *shown, maintain_column_froms=True)
    return join_checks(stmt).where(mission.c.id == mission_id)


def listed_checks(mission_id: uuid.UUID, matching: MissionCheckFilter) -> tuple[Select[Any], Order]:
    """Return the stored checks of a mission that match, each as JSON, and their order: worst first."""
    unnested = func.jsonb_array_elements(mission_checks.c.checks)
    one = unnested.table_valued(column("stored", JSONB), with_ordinality="number").render_derived(name="one")
    stmt = select(one.c.stored).join_from(mission_checks, one, true()).where(mission_checks.c.mission_id == mission_id)
    if matching.name is not None:
        stmt = stmt.where(matches(one.c.stored["name"].astext, matching.name))
    if matching.status:
        stmt = stmt.where(one.c.stored["status"].astext.in_([status.value for status in matching.status]))
    return stmt, Order([cast(one.c.number, BigInteger)], name="checks of a mission")


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
    """Return the reports of a mission, latest first, without their checks and files."""
    names = ("id", "document_sha256", "depth", "verdict", "created_at", "created_by_id", "run_id")
    columns: list[ColumnElement[Any]] = [check_report.c[name] for name in names]
    keys = func.jsonb_object_keys(check_report.c.files).table_valued("path")
    columns += [
        func.jsonb_array_length(check_report.c.checks).label("check_count"),
        select(func.count()).select_from(keys).scalar_subquery().label("file_count"),
    ]
    stmt = select(*columns, person.c.name.label("created_by_name"))
    stmt = stmt.join(person, person.c.id == check_report.c.created_by_id)
    newest = (check_report.c.created_at.desc(), check_report.c.id)
    return stmt.where(check_report.c.mission_id == mission_id).order_by(*newest)


def is_of_files(judged: JudgedMission) -> ColumnElement[bool]:
    """Whether a report is about the present files: all recorded ones, and none that changed or is gone."""
    files = check_report.c.files
    return and_(files.contained_by({**judged.all_files}), files.contains({**judged.recorded_files}))


def is_by_rules(rules: AppliedRules) -> ColumnElement[bool]:
    """Whether a report was made by these rules."""
    own = check_report.c
    return and_(own.document_sha256 == rules.sha256, own.profiles == [*rules.profiles])


def counting_reports(judged: JudgedMission, present_rules: AppliedRules | None) -> Select[Any]:
    """Return the reports about the present files of which the verdict is made, latest first.

    These are the latest of each person, depth, and by the present rules (any, if there are none) or others. Of others,
    the checks are null: it only counts that they exist.
    """
    own = check_report.c
    # Not a constant, which DISTINCT ON refuses.
    is_present = own.document_sha256.is_not(None) if present_rules is None else is_by_rules(present_rules)
    checks = case((is_present, own.checks)).label("checks")
    columns = (own.created_by_id, own.depth, is_present.label("is_by_present_rules"), own.created_at, own.id, checks)
    stmt = select(*columns).where(own.mission_id == judged.id, is_of_files(judged))
    latest = stmt.distinct(*columns[:3]).order_by(*columns[:3], own.created_at.desc(), own.id).subquery()
    return select(latest).order_by(latest.c.created_at.desc(), latest.c.id)


def reporting_runs(judged: JudgedMission, present_rules: AppliedRules | None) -> Select[tuple[uuid.UUID]]:
    """Return the runs that reported the content of the present files, by the present rules (any, if there are none)."""
    own = check_report.c
    stmt = select(own.run_id).where(own.mission_id == judged.id, own.run_id.is_not(None), is_of_files(judged))
    stmt = stmt.where(own.depth == CheckDepth.content.value)
    return stmt if present_rules is None else stmt.where(is_by_rules(present_rules))
