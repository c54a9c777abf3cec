"""Selects of tables of metrics. Functions do not execute them.

A run is described by `d0`, `d1`, …: its values of those columns of the table that runs have. A result, which is a value
of the metric, has them all.
"""

import re
import uuid
from collections.abc import Mapping, Sequence
from typing import Any

from sqlalchemy import (
    ARRAY,
    CTE,
    ColumnElement,
    CompoundSelect,
    Double,
    Select,
    Text,
    Uuid,
    and_,
    bindparam,
    case,
    cast,
    column,
    distinct,
    func,
    literal,
    or_,
    select,
    true,
    union_all,
)
from sqlalchemy.dialects.postgresql import JSONB, aggregate_order_by

from kleinkram.contract.errors import InvalidQuery
from kleinkram.contract.metrics import MAX_CELL_RUNS, Aggregate, MetricNameFilter, MetricTableQuery
from kleinkram.contract.query import parse
from kleinkram.contract.runs import RunState
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import visible_missions
from kleinkram.server.db import among, matches, unnest_rows
from kleinkram.server.filters.files import metadata_condition, metadata_text, refuse_metadata, scalars_of
from kleinkram.server.filters.missions import filter_missions_by_files
from kleinkram.server.runs.queries import ACTION_NAME, of_actions, of_missions, visible_runs
from kleinkram.server.tables import action, action_version, mission, project, run, run_metric
from kleinkram.server.tables.runs import ACTIVE

# A comparison with a parameter or label.
_RUN_WHERE = re.compile(
    r"(?P<kind>param|label)\.(?P<name>[a-z][a-z0-9_.-]*)\s*(?P<operator>!=|=|<|>|~)\s*(?P<value>.*)"
)
_ACTION_KEY = func.coalesce(cast(action.c.id, Text), ACTION_NAME)
# Units that are named where the values of one metric have several.
_MAX_UNITS = 5
# Dimensions that belong to values of a metric, not to runs.
_OF_VALUES = ("topic", "label")


def of_runs(dimension: str) -> bool:
    """Whether a column of a table is one that runs have."""
    return dimension.partition(".")[0] not in _OF_VALUES


def metric_runs(actor: Actor, matching: MetricTableQuery) -> Select[Any]:
    """Return the visible runs that a table may cover, in any state.

    Raises:
        InvalidQuery: a `where` or the query cannot be used, or the actor does not see the metadata of missions.
    """
    row_key = _row_key(actor, matching.rows)
    columns = (
        run.c.id.label("run_id"),
        func.coalesce(run.c.reuses_id, run.c.id).label("result_id"),
        run.c.mission_id,
        run.c.parameters,
        run.c.state,
        run.c.created_at,
        cast(row_key, Text).label("row_key"),
        cast(project.c.id, Text).label("project_id"),
        project.c.name.label("project_name"),
        mission.c.name.label("mission_name"),
        run.c.version_id,
        _ACTION_KEY.label("action_key"),
        func.coalesce(action.c.name, ACTION_NAME).label("action_name"),
        action_version.c.number,
    )
    stmt = visible_runs(actor).with_only_columns(*columns, maintain_column_froms=True)
    conditions = [*_mission_conditions(actor, matching), *of_actions(matching)]
    if matching.version is not None:
        conditions.append(action_version.c.number == matching.version)
    conditions += [_equals(match, run.c.parameters[match["name"]]) for match in _run_wheres(matching, "param")]
    return stmt.where(*conditions)


def rows_without_runs(actor: Actor, matching: MetricTableQuery) -> Select[Any]:
    """Return the rows of all missions that match: `row_key`, and the names of a mission and its project."""
    columns = (
        cast(_row_key(actor, matching.rows), Text).label("row_key"),
        cast(project.c.id, Text).label("project_id"),
        project.c.name.label("project_name"),
        mission.c.name.label("mission_name"),
    )
    visible = visible_missions(actor).with_only_columns(*columns, maintain_column_froms=True)
    missions = visible.where(*_mission_conditions(actor, matching)).subquery()
    return select(missions.c.row_key, *_names(missions)).group_by(missions.c.row_key)


def declarations(runs: Select[Any]) -> Select[Any]:
    """Return what the versions of these runs declare of metrics, by action, in the order in which they were published.

    A definition may be large: it is read once for each version, not for each run.
    """
    versions = select(runs.subquery().c.version_id)
    declared = action_version.c.definition["metrics"]
    has_some = func.jsonb_array_length(func.coalesce(declared, cast("[]", JSONB))) > 0
    columns = (action_version.c.id, _ACTION_KEY.label("action_key"), declared.label("declared"))
    stmt = select(*columns).outerjoin_from(action_version, action, action.c.id == action_version.c.action_id)
    stmt = stmt.where(action_version.c.id.in_(versions), has_some)
    return stmt.order_by(action_version.c.created_at, action_version.c.id)


def reporting_actions(runs: Select[Any], metric: str) -> Select[Any]:
    """Return the keys of the actions whose runs reported a metric."""
    inner = runs.subquery()
    joined = select(inner.c.action_key).join(run_metric, run_metric.c.run_id == inner.c.result_id)
    return joined.where(run_metric.c.name == metric).distinct()


def relevant_runs(runs: Select[Any], action_keys: Sequence[str], dimensions: Sequence[str]) -> CTE:
    """Return the runs of some actions with their values of the dimensions that runs have."""
    inner = runs.where(among(_ACTION_KEY, action_keys)).subquery()
    values = [_value_of(inner, name).label(f"d{at}") for at, name in enumerate(dimensions) if of_runs(name)]
    return select(inner, *values).cte("relevant")


def run_states(relevant: CTE, dimensions: Sequence[str]) -> Select[Any]:
    """Return what became of the runs of each row and column: `state`, and the `run_id` that has it.

    That is a run that is done, else one that has not ended, else the latest.
    """
    rank = case((relevant.c.state == RunState.done.value, 0), (relevant.c.state.in_(ACTIVE), 1), else_=2)
    order = (rank, relevant.c.created_at.desc(), relevant.c.run_id)
    keys = [relevant.c[f"d{at}"] for at, name in enumerate(dimensions) if of_runs(name)]
    return select(
        relevant.c.row_key,
        *keys,
        func.min(relevant.c.action_name).label("action_name"),
        *_names(relevant),
        _first(relevant.c.state, Text(), order).label("state"),
        _first(relevant.c.result_id, Uuid(), order).label("run_id"),
    ).group_by(relevant.c.row_key, *keys)


def results(relevant: CTE, matching: MetricTableQuery, units: Mapping[uuid.UUID, str]) -> CTE:
    """Return the values of the metric that count, with all dimensions.

    `units` are those that versions declare, for the values that were reported without one.
    """
    of = [relevant.c.mission_id, relevant.c.action_key, relevant.c.parameters]
    if "version" in matching.columns:
        of.append(relevant.c.number)
    done = select(relevant).where(relevant.c.state == RunState.done.value)
    latest = done.distinct(*of).order_by(*of, relevant.c.created_at.desc(), relevant.c.run_id.desc()).subquery()
    conditions = [run_metric.c.name == matching.metric]
    if matching.topic is not None:
        conditions.append(matches(run_metric.c.topic, matching.topic))
    conditions += [_equals(match, run_metric.c.labels[match["name"]]) for match in _run_wheres(matching, "label")]
    values = [
        _value_of(run_metric, name).label(f"d{at}") for at, name in enumerate(matching.columns) if not of_runs(name)
    ]
    rows = [{"version_id": version_id, "unit": unit} for version_id, unit in units.items()]
    declared = unnest_rows([column("version_id", Uuid), column("unit", Text)], rows)
    stmt = select(
        latest,
        *values,
        run_metric.c.id.label("metric_id"),
        run_metric.c.value,
        func.coalesce(run_metric.c.unit, declared.c.unit).label("unit"),
        run_metric.c.topic,
        run_metric.c.labels,
    )
    stmt = stmt.join_from(latest, run_metric, run_metric.c.run_id == latest.c.result_id)
    stmt = stmt.outerjoin_from(latest, declared, declared.c.version_id == latest.c.version_id)
    return stmt.where(*conditions).cte("results")


def cells(source: CTE, matching: MetricTableQuery) -> Select[Any]:
    """Return the cells that have a value, with the units and runs of the results."""
    keys = [source.c[f"d{at}"] for at in range(len(matching.columns))]
    runs: ColumnElement[Any] = func.array_agg(distinct(source.c.result_id), type_=ARRAY(Uuid()))
    return select(
        source.c.row_key,
        *keys,
        func.min(source.c.action_name).label("action_name"),
        _aggregated(source, matching.aggregate).label("value"),
        func.count().label("count"),
        func.count(distinct(source.c.result_id)).label("run_count"),
        runs[1:MAX_CELL_RUNS].label("run_ids"),
        func.min(source.c.unit).label("first_unit"),
        func.max(source.c.unit).label("last_unit"),
    ).group_by(source.c.row_key, *keys)


def dimension_counts(source: CTE) -> CompoundSelect[Any]:
    """Return the dimensions of results, with their numbers of values."""
    plain = [
        select(literal(name).label("name"), func.count(distinct(value)).label("value_count"))
        for name, value in (
            ("action", source.c.action_key),
            ("version", func.coalesce(source.c.number, 0)),
            ("topic", func.coalesce(source.c.topic, "")),
        )
    ]
    for prefix, document in (("param.", source.c.parameters), ("label.", source.c.labels)):
        entries = func.jsonb_each(document).table_valued(column("key", Text), column("value", JSONB))
        joined = select(literal(prefix).concat(entries.c.key), func.count(distinct(entries.c.value)))
        plain.append(joined.select_from(source.join(entries, true())).group_by(entries.c.key))
    return union_all(*plain)


def varying_counts(source: CTE, matching: MetricTableQuery, dimensions: Sequence[str]) -> Select[Any]:
    """Return, of each dimension, the highest number of its values within one column."""
    keys = [source.c[f"d{at}"] for at in range(len(matching.columns))]
    counts = [func.count(distinct(_value_of(source, name))).label(f"n{at}") for at, name in enumerate(dimensions)]
    by_column = select(*counts).group_by(*keys).subquery()
    return select(*(func.max(count) for count in by_column.c))


def metric_names(actor: Actor, matching: MetricNameFilter) -> tuple[Select[Any], Select[Any]]:
    """Return the names of the metrics of visible runs with their numbers of runs and units, and `declarations`."""
    stmt = visible_runs(actor).where(*of_missions(matching), *of_actions(matching))
    if matching.version is not None:
        stmt = stmt.where(action_version.c.number == matching.version)
    joined = stmt.join(run_metric, run_metric.c.run_id == run.c.id)
    units: ColumnElement[Any] = func.array_agg(distinct(run_metric.c.unit), type_=ARRAY(Text))
    counts = (func.count(distinct(run.c.id)).label("run_count"), units[1:_MAX_UNITS].label("units"))
    names = joined.with_only_columns(run_metric.c.name, *counts, maintain_column_froms=True)
    return names.group_by(run_metric.c.name).order_by(run_metric.c.name), declarations(stmt)


def _row_key(actor: Actor, rows: str) -> ColumnElement[Any]:
    if rows == "mission":
        return mission.c.id
    if rows == "project":
        return project.c.id
    refuse_metadata(actor, [rows])
    return metadata_text(rows.split(".")[1:])


def _names(source: Any) -> list[ColumnElement[Any]]:
    return [func.min(source.c[name]).label(name) for name in ("project_id", "project_name", "mission_name")]


def _mission_conditions(actor: Actor, matching: MetricTableQuery) -> list[ColumnElement[bool]]:
    of_metadata = [text for text in matching.where if _RUN_WHERE.fullmatch(text.strip()) is None]
    refuse_metadata(actor, of_metadata)
    conditions = [*of_missions(matching, mission.c.id), *(metadata_condition(text) for text in of_metadata)]
    if matching.query:
        matched = filter_missions_by_files(actor, visible_missions(actor), parse(matching.query))
        ids = matched.with_only_columns(mission.c.id, maintain_column_froms=True).correlate(None)
        conditions.append(mission.c.id.in_(ids))
    return conditions


def _run_wheres(matching: MetricTableQuery, kind: str) -> list[re.Match[str]]:
    """Return the comparisons with parameters, or with labels. Raises InvalidQuery."""
    compared = [match for text in matching.where if (match := _RUN_WHERE.fullmatch(text.strip())) is not None]
    for match in compared:
        if match["operator"] not in {"=", "!="}:
            raise InvalidQuery(expression=match[0], reason="parameters and labels are compared with = or !=")
    return [match for match in compared if match["kind"] == kind]


def _equals(match: re.Match[str], stored: ColumnElement[Any]) -> ColumnElement[bool]:
    """Return the condition that a JSON value is what a comparison says: a text, number or boolean."""
    equal = or_(*(stored == bindparam(None, scalar, JSONB) for scalar in scalars_of(match["value"].strip())))
    return equal if match["operator"] == "=" else and_(stored.is_not(None), ~equal)


def _value_of(source: Any, dimension: str) -> ColumnElement[Any]:
    kind, _, name = dimension.partition(".")
    if kind == "param":
        return cast(source.c.parameters[name], JSONB)
    if kind == "label":
        text: ColumnElement[Any] = source.c.labels[name].astext
        return text
    value: ColumnElement[Any] = source.c[{"action": "action_key", "version": "number", "topic": "topic"}[kind]]
    return value


def _aggregated(source: CTE, aggregate: Aggregate) -> ColumnElement[Any]:
    value = source.c.value
    if aggregate is Aggregate.median:
        return func.percentile_cont(0.5).within_group(value)
    if aggregate is Aggregate.latest:
        return _first(value, Double(), (source.c.created_at.desc(), source.c.metric_id.desc()))
    others: dict[Aggregate, ColumnElement[Any]] = {
        Aggregate.mean: func.avg(value),
        Aggregate.min: func.min(value),
        Aggregate.max: func.max(value),
        Aggregate.count: cast(func.count(), Double),
    }
    return others[aggregate]


def _first(value: ColumnElement[Any], kind: Any, order: Sequence[ColumnElement[Any]]) -> ColumnElement[Any]:
    first: ColumnElement[Any] = func.array_agg(aggregate_order_by(value, *order), type_=ARRAY(kind))[1]
    return first
