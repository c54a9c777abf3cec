"""Selects of runs. Functions do not execute them."""

import uuid
from collections.abc import Sequence
from typing import Any

from sqlalchemy import Column, ColumnElement, Select, Table, Text, case, exists, false, func, select

from kleinkram.contract.access import Scope
from kleinkram.contract.metrics import MetricNameFilter
from kleinkram.contract.runs import (
    MAX_LISTED_METRICS,
    CheckFilter,
    FindingFilter,
    MetricFilter,
    ReportFilter,
    RunFilter,
    RunState,
)
from kleinkram.server.access.actor import Actor, ActorKind
from kleinkram.server.access.visible import is_visible_mission, level_on_mission, visible_files
from kleinkram.server.db import among, matches, matches_key
from kleinkram.server.pagination import Order
from kleinkram.server.runs.eligibility import PROJECT_ISOLATION
from kleinkram.server.tables import (
    action,
    action_version,
    blob,
    file,
    mission,
    person,
    project,
    run,
    run_artifact,
    run_check,
    run_finding,
    run_input,
    run_metric,
    runner,
)
from kleinkram.server.tables.runs import ACTIVE

# Latest first.
RUN_ORDER = Order([run.c.created_at, run.c.id], descending=True)
INPUT_ORDER = Order([run_input.c.path])
ARTIFACT_ORDER = Order([run_artifact.c.path, run_artifact.c.id])
# Those of the latest run first; of each run, in the order in which it reported them.
CHECK_ORDER, FINDING_ORDER, METRIC_ORDER = (
    Order([run.c.created_at, run.c.id, -table.c.id], descending=True) for table in (run_check, run_finding, run_metric)
)
_file = file.alias("moved_file")
_MISSION = (
    mission.c.name.label("mission_name"),
    mission.c.project_id.label("project_id"),
    project.c.name.label("project_name"),
)
ACTION_NAME = action_version.c.definition["name"].astext
_unpublished = action_version.alias("unpublished")
# What only one run shows, and what no response has: it can be large.
_DETAILS = (run.c.samples, run.c.problems, run.c.proposed, run.c.previews)
_INTERNAL = (run.c.inputs_fingerprint, run.c.input_metadata, run.c.checks_sha256, run.c.log_blob_id, run.c.traceparent)
_LISTED = [column for column in run.c if column not in {*_DETAILS, *_INTERNAL}]
_OF_RUN = (run.c.mission_id, run.c.parameters, run.c.ended_at)
_ACTION = (
    action.c.id.label("action_id"),
    func.coalesce(action.c.name, ACTION_NAME).label("action_name"),
    action_version.c.number.label("action_number"),
)


def visible_runs(actor: Actor) -> Select[Any]:
    """Return the runs on missions that `actor` may read, joined with missions, projects and actions.

    The token of a run shows only that run; a share link shows none.
    """
    joined = (
        select(run)
        .join(mission, mission.c.id == run.c.mission_id)
        .join(project, project.c.id == mission.c.project_id)
        # Every run has a version. PostgreSQL drops an outer join if no column of it is used, as in a count.
        .outerjoin(action_version, action_version.c.id == run.c.version_id)
        .outerjoin(action, action.c.id == action_version.c.action_id)
    )
    if actor.kind is not ActorKind.person or Scope.read not in actor.scopes:
        return joined.where(false())
    visible = joined.where(is_visible_mission(actor))
    return visible if actor.run_id is None else visible.where(run.c.id == actor.run_id)


def run_rows(actor: Actor, stmt: Select[Any]) -> Select[Any]:
    """Return what lists show of a select that began with `visible_runs`, with names and the actor's level."""
    columns = (
        *_LISTED,
        *_MISSION,
        *_ACTION,
        person.c.name.label("started_by_name"),
        runner.c.name.label("runner_name"),
        PROJECT_ISOLATION,
        level_on_mission(actor).label("level"),
    )
    named = stmt.outerjoin(person, person.c.id == run.c.started_by_id)
    named = named.outerjoin(runner, runner.c.id == run.c.runner_id)
    return named.with_only_columns(*columns, maintain_column_froms=True)


def one_run(actor: Actor, run_id: uuid.UUID) -> Select[Any]:
    """Return a row of `run_rows`, with its details and the definition of the action."""
    stmt = run_rows(actor, visible_runs(actor).where(run.c.id == run_id))
    return stmt.add_columns(*_DETAILS, action_version.c.definition)


def filter_runs(actor: Actor, stmt: Select[Any], matching: RunFilter) -> Select[Any]:
    """Apply a filter to a select of runs."""
    conditions = [*of_missions(matching), *of_actions(matching)]
    if matching.state:
        conditions.append(run.c.state.in_([state.value for state in matching.state]))
    if matching.verdict:
        conditions.append(run.c.verdict.in_([verdict.value for verdict in matching.verdict]))
    for name, value in (("job_id", matching.job_id), ("node", matching.node)):
        if value is not None:
            conditions.append(run.c.placement[name].astext == value)
    if matching.isolation:
        conditions.append(run.c.isolation.in_([isolation.value for isolation in matching.isolation]))
    if matching.active is not None:
        conditions.append(run.c.state.in_(ACTIVE) if matching.active else run.c.state.not_in(ACTIVE))
    if matching.mine:
        conditions.append(run.c.started_by_id == actor.person_id)
    return stmt.where(*conditions)


def inputs_of(actor: Actor, run_ids: Sequence[uuid.UUID]) -> Select[Any]:
    """Return the inputs of visible runs, without files that were moved out of `actor`'s sight."""
    columns = [column for column in run_input.c if column is not run_input.c.file_id]
    stmt = select(*columns, _visible_id(actor, run_input.c.file_id)).join(run, run.c.id == run_input.c.run_id)
    return stmt.where(run_input.c.run_id.in_(run_ids), ~is_hidden(actor, run_input.c.file_id))


def is_hidden(actor: Actor, file_id: Column[Any]) -> ColumnElement[bool]:
    """Whether a file of a joined `run` was moved to a mission that `actor` may not read."""
    moved = exists().where(_file.c.id == file_id, _file.c.mission_id != run.c.mission_id)
    # Explicit: inside of another EXISTS, SQLAlchemy would add `run` to its FROM.
    return moved.correlate(file_id.table, run) & ~_is_visible(actor, file_id)


def _is_visible(actor: Actor, file_id: Column[Any]) -> ColumnElement[bool]:
    seen = visible_files(actor).with_only_columns(file.c.id, maintain_column_froms=True)
    return seen.where(file.c.id == file_id).correlate(file_id.table).exists()


def _visible_id(actor: Actor, file_id: Column[Any]) -> ColumnElement[Any]:
    return case((_is_visible(actor, file_id), file_id)).label("file_id")


def artifacts_of(actor: Actor, run_id: uuid.UUID) -> Select[Any]:
    """Return the artifacts of a run, with their content; `file_id` where `actor` may read that file."""
    own = (run_artifact.c.id, run_artifact.c.run_id, run_artifact.c.path)
    columns = (*own, blob.c.size_bytes, blob.c.sha256, blob.c.key, blob.c.state)
    stmt = select(*columns, _visible_id(actor, run_artifact.c.file_id))
    joined = stmt.join_from(run_artifact, blob, blob.c.id == run_artifact.c.blob_id)
    return joined.where(run_artifact.c.run_id == run_id)


def checks(actor: Actor, matching: CheckFilter) -> Select[Any]:
    """Return the checks of visible runs, with columns `reported_…`."""
    stmt = _reported_by_runs(actor, run_check, matching)
    if matching.status:
        stmt = stmt.where(run_check.c.status.in_([status.value for status in matching.status]))
    return stmt if matching.name is None else stmt.where(matches(run_check.c.name, matching.name))


def findings(actor: Actor, matching: FindingFilter) -> Select[Any]:
    """Return the findings of visible runs, with columns `reported_…`."""
    stmt = _reported_by_runs(actor, run_finding, matching)
    if matching.severity:
        stmt = stmt.where(run_finding.c.severity.in_([severity.value for severity in matching.severity]))
    return stmt if matching.code is None else stmt.where(matches(run_finding.c.code, matching.code))


def metrics(actor: Actor, matching: MetricFilter) -> Select[Any]:
    """Return the metrics of visible runs, with columns `reported_…`."""
    stmt = _reported_by_runs(actor, run_metric, matching)
    return stmt if matching.name is None else stmt.where(matches(run_metric.c.name, matching.name))


def first_metrics(actor: Actor, run_ids: Sequence[uuid.UUID]) -> Select[Any]:
    """Return the first metrics of each run, those without a file before those of visible files."""
    hidden_input = exists().where(
        run_input.c.run_id == run_metric.c.run_id,
        run_input.c.path == run_metric.c.file,
        is_hidden(actor, run_input.c.file_id),
    )
    order = (run_metric.c.file.is_not(None), run_metric.c.id)
    rank = func.row_number().over(partition_by=run_metric.c.run_id, order_by=order).label("rank")
    stmt = select(run_metric, rank).join(run, run.c.id == run_metric.c.run_id)
    ranked = stmt.where(among(run_metric.c.run_id, run_ids), ~hidden_input).subquery()
    return select(ranked).where(ranked.c.rank <= MAX_LISTED_METRICS).order_by(ranked.c.run_id, ranked.c.rank)


def _reported_by_runs(actor: Actor, table: Table, matching: ReportFilter) -> Select[Any]:
    chosen = [column.label(f"reported_{column.name}") for column in table.c if column is not table.c.file]
    # The name of an input is hidden together with the file.
    its_input = exists().where(
        run_input.c.run_id == run.c.id, run_input.c.path == table.c.file, is_hidden(actor, run_input.c.file_id)
    )
    chosen.append(case((~its_input, table.c.file)).label("reported_file"))
    stmt = visible_runs(actor).with_only_columns(*chosen, *_OF_RUN, *_MISSION, *_ACTION, maintain_column_froms=True)
    stmt = stmt.join(table, table.c.run_id == run.c.id)
    if matching.run_id is not None:
        stmt = stmt.where(run.c.id == matching.run_id)
    if matching.version is not None:
        stmt = stmt.where(action_version.c.number == matching.version)
    if matching.topic is not None:
        stmt = stmt.where(matches(table.c.topic, matching.topic))
    if matching.latest:
        stmt = stmt.where(run.c.id.in_(_latest_results(matching)))
    return stmt.where(*of_missions(matching), *of_actions(matching))


def _latest_results(matching: ReportFilter) -> Select[Any]:
    """Return the runs with the results of the latest run that is done, of each mission, action and parameters."""
    of = (run.c.mission_id, func.coalesce(action.c.id.cast(Text), ACTION_NAME), run.c.parameters)
    joined = (
        select(func.coalesce(run.c.reuses_id, run.c.id))
        .join(mission, mission.c.id == run.c.mission_id)
        .join(action_version, action_version.c.id == run.c.version_id)
        .outerjoin(action, action.c.id == action_version.c.action_id)
    )
    done = joined.where(run.c.state == RunState.done.value, *of_missions(matching), *of_actions(matching))
    latest = done.distinct(*of).order_by(*of, run.c.created_at.desc(), run.c.id.desc())
    # Its own tables, not those of the select around it.
    return latest.correlate(None)


def of_actions(matching: RunFilter | ReportFilter | MetricNameFilter) -> list[ColumnElement[bool]]:
    """Return the conditions of a filter on the action."""
    conditions = []
    if matching.action_id is not None:
        conditions.append(action_version.c.action_id == matching.action_id)
    if matching.action is not None:
        published = matches_key(action.c.name_key, matching.action)
        # Once for each version, not for each run: its name is in the definition, which may be large.
        named = matches(_unpublished.c.definition["name"].astext, matching.action)
        unpublished = select(_unpublished.c.id).where(_unpublished.c.action_id.is_(None), named)
        conditions.append(published | run.c.version_id.in_(unpublished))
    return conditions


def of_missions(
    matching: RunFilter | ReportFilter | MetricNameFilter, mission_id: ColumnElement[uuid.UUID] = run.c.mission_id
) -> list[ColumnElement[bool]]:
    """Return the conditions of a filter on missions and projects. `mission_id`: the column with the mission."""
    values = (
        (mission_id, matching.mission_id, matching.mission_ids),
        (mission.c.project_id, matching.project_id, matching.project_ids),
    )
    conditions = [column == one for column, one, _ in values if one is not None]
    return conditions + [column.in_(several) for column, _, several in values if several]
