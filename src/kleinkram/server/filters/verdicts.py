"""The verdict of a mission as SQL: as stored, unless its files, its project or their `checks.yaml` changed since.

And the conditions of filters on verdicts, checks, and the results of runs. A filter by results covers the latest run
that is done, of each action with the same parameters.
"""

import functools
import operator
import uuid
from collections.abc import Callable, Sequence
from typing import Any

from sqlalchemy import (
    CTE,
    ColumnElement,
    Double,
    Select,
    Text,
    Uuid,
    and_,
    any_,
    case,
    column,
    exists,
    func,
    literal,
    literal_column,
    or_,
    select,
    tuple_,
    type_coerce,
    union_all,
)
from sqlalchemy.dialects.postgresql import ARRAY, JSONB

from kleinkram.contract.checks import Verdict
from kleinkram.contract.errors import InvalidQuery
from kleinkram.contract.files import FileFilter
from kleinkram.contract.missions import MissionFilter
from kleinkram.contract.query import METRIC_EXPRESSION, is_glob
from kleinkram.contract.runs import RunState
from kleinkram.server.access.actor import Actor, ActorKind
from kleinkram.server.access.visible import sees_whole_missions
from kleinkram.server.db import matches_any
from kleinkram.server.tables import action_version, mission, mission_checks, project, run, run_finding, run_metric

_HIDDEN = "this credential does not show the checks of missions"
_COMPARISONS: dict[str, Callable[[Any, Any], ColumnElement[bool]]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "=": operator.eq,
    "!=": operator.ne,
}


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
def facet_columns() -> tuple[ColumnElement[str | None], ColumnElement[Any]]:
    """Return the verdict of each `mission`, null for unchecked ones, and the names of its checks that fail."""
    own = mission_checks.c.mission_id == mission.c.id
    stored = select(_stored_verdict()).where(own).correlate(mission, project).scalar_subquery()
    failed = select(mission_checks.c.failed).where(own).correlate(mission, project).scalar_subquery()
    return func.nullif(func.coalesce(stored, _missing_verdict()), Verdict.unchecked.value), failed


@functools.cache
def _verdict() -> ColumnElement[str]:
    is_missing = mission_checks.c.mission_id.is_(None)
    return type_coerce(case((is_missing, _missing_verdict()), else_=_stored_verdict()), Text)


def _stored_verdict() -> ColumnElement[str]:
    return case((is_current(), mission_checks.c.verdict), else_=Verdict.outdated.value)


def _missing_verdict() -> ColumnElement[str]:
    is_first_time = and_(project.c.checks_number > 0, mission.c.files_revision > 0)
    return case((is_first_time, Verdict.running.value), else_=Verdict.unchecked.value)


def check_conditions(actor: Actor, matching: MissionFilter | FileFilter) -> list[ColumnElement[bool]]:
    """Return the conditions of a filter on the verdict, the checks and the runs of `mission`.

    Raises:
        InvalidQuery: a metric cannot be compared that way, or the actor does not see checks or runs.
    """
    results = [*matching.finding, *matching.metric]
    _refuse([*(verdict.value for verdict in matching.verdict), *matching.check], sees_whole_missions(actor))
    _refuse(results, sees_whole_missions(actor) and actor.kind is ActorKind.person)
    conditions: list[ColumnElement[bool]] = []
    if matching.verdict:
        conditions.append(mission.c.id.in_(_with_verdict([verdict.value for verdict in matching.verdict])))
    if matching.check:
        conditions.append(mission.c.id.in_(_with_failed_check(matching.check)))
    if matching.finding:
        conditions.append(_is_among(_with_finding((*matching.finding,))))
    conditions += [_is_among(_with_metric(expression)) for expression in matching.metric]
    return conditions


def _refuse(expressions: Sequence[str], is_shown: bool) -> None:
    for expression in [] if is_shown else expressions:
        raise InvalidQuery(expression=expression, reason=_HIDDEN)


def _with_verdict(verdicts: Sequence[str]) -> Select[tuple[uuid.UUID]]:
    stmt = select(mission.c.id).join(project, project.c.id == mission.c.project_id).correlate(None)
    if not {Verdict.outdated.value, Verdict.running.value, Verdict.unchecked.value} & {*verdicts}:
        # By an index: other missions have no stored checks, or others.
        stmt = stmt.join(mission_checks, mission_checks.c.mission_id == mission.c.id)
        return stmt.where(mission_checks.c.verdict.in_(verdicts), is_current())
    return join_checks(stmt).where(_verdict().in_(verdicts))


def _with_failed_check(names: Sequence[str]) -> Select[tuple[uuid.UUID]]:
    failed = type_coerce(mission_checks.c.failed, ARRAY(Text))
    plain = [name for name in names if not is_glob(name)]
    conditions: list[ColumnElement[bool]] = [failed.overlap(plain)] if plain else []
    if globs := [name for name in names if is_glob(name)]:
        one = (
            func.unnest(mission_checks.c.failed).table_valued(column("name", Text)).render_derived(name="failed_check")
        )
        conditions.append(exists().select_from(one).where(matches_any(one.c.name, globs)))
    return select(mission_checks.c.mission_id).where(or_(*conditions)).correlate(None)


def _is_among(missions: CTE) -> ColumnElement[bool]:
    """Return whether `mission` is one of these, which are found once: a join would find them for each mission."""
    return mission.c.id == any_(func.array(select(missions.c.mission_id).scalar_subquery(), type_=ARRAY(Uuid)))


# Parts of one statement share the same object, so that the database finds the missions once.
@functools.lru_cache(maxsize=64)
def _with_finding(globs: tuple[str, ...]) -> CTE:
    return _with_result(run_finding, matches_any(run_finding.c.code, globs))


@functools.lru_cache(maxsize=64)
def _with_metric(expression: str) -> CTE:
    match = METRIC_EXPRESSION.fullmatch(expression.strip())
    if match is None:
        reason = "it is not a comparison of a metric with a number; write it like ate_rmse>0.5"
        raise InvalidQuery(expression=expression, reason=reason)
    compare = _COMPARISONS[match["operator"]]
    is_such = compare(run_metric.c.value, literal(float(match["value"]), Double))
    return _with_result(run_metric, and_(run_metric.c.name == match["name"], is_such))


def _with_result(table: Any, condition: ColumnElement[bool]) -> CTE:
    """Return the missions of whose latest results one matches. A run that reuses another has that one's results.

    The results that match come first, by an index of their names, so that other runs are not read.
    """
    version, later, its_version = action_version.alias(), run.alias("later"), action_version.alias()
    matching_results = select(table.c.run_id).where(condition).cte(f"matching_{table.name}")
    reusing = (
        select(run.c.id)
        .join(matching_results, matching_results.c.run_id == run.c.reuses_id)
        .where(run.c.reuses_id.is_not(None))
    )
    has_later = (
        exists()
        .select_from(later.join(its_version, its_version.c.id == later.c.version_id))
        .where(
            later.c.mission_id == run.c.mission_id,
            later.c.state == RunState.done.value,
            later.c.created_at >= run.c.created_at,  # for the index of runs of a mission
            tuple_(later.c.created_at, later.c.id) > tuple_(run.c.created_at, run.c.id),
            later.c.parameters == run.c.parameters,
            or_(later.c.version_id == run.c.version_id, its_version.c.action_id == version.c.action_id),
        )
        .correlate(run, version)
    )
    of_results = run.c.id.in_(union_all(select(matching_results.c.run_id), reusing.correlate(None)))
    stmt = select(run.c.mission_id).distinct().join(version, version.c.id == run.c.version_id)
    stmt = stmt.where(of_results, run.c.state == RunState.done.value, ~has_later).correlate(None)
    return stmt.cte(f"missions_by_{table.name}")
