"""Reads tables of metrics: cells, why cells are missing, which value of a row is best, and a comparison of columns."""

import math
import statistics
import uuid
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from sqlalchemy import RowMapping

from kleinkram.contract.actions import Better, ParameterValue
from kleinkram.contract.errors import InvalidQuery
from kleinkram.contract.metrics import (
    MAX_CELLS,
    MAX_COLUMNS,
    MAX_METRIC_NAMES,
    MAX_ROWS,
    Aggregate,
    MetricCell,
    MetricColumn,
    MetricComparison,
    MetricDimension,
    MetricName,
    MetricNameFilter,
    MetricNames,
    MetricRow,
    MetricTableQuery,
    MetricTableRead,
    Missing,
    Rank,
)
from kleinkram.contract.missions import MissionRef
from kleinkram.contract.names import is_id, name_key
from kleinkram.contract.projects import ProjectRef
from kleinkram.contract.runs import RunState
from kleinkram.contract.text_tables import metric_text_table, write_table
from kleinkram.server.access.actor import Actor
from kleinkram.server.db import Connection
from kleinkram.server.runs import metric_queries as queries

_MAX_DIMENSIONS = 100
_MISSING = {
    RunState.done.value: Missing.no_metric,
    RunState.failed.value: Missing.failed,
    RunState.cancelled.value: Missing.cancelled,
}


class _KeyPart(NamedTuple):
    """The value of one dimension of a column. In Python, true and 1 are equal, which are two values in JSON."""

    value: ParameterValue | None
    is_boolean: bool


# Of a column: its values by dimension.
_Key = tuple[_KeyPart, ...]
_NOTHING = _KeyPart(None, False)


@dataclass(frozen=True)
class _Declared:
    """What actions declare of a metric. `unit` is None, and `better` none, where they disagree."""

    unit: str | None = None
    better: Better = Better.none
    description: str = ""


class _State(NamedTuple):
    state: str
    run_id: uuid.UUID


@dataclass(frozen=True)
class _Content:
    """What the database has of a table.

    Attributes:
        names: project id, project name and mission name by row.
        cells: by row and column.
        states: what became of the runs, by row, and by the dimensions that runs have.
        actions: the names of actions by their keys.
        units: those that were reported; None among them where a value has none.
    """

    names: Mapping[str | None, tuple[str, str, str]]
    cells: Mapping[tuple[str | None, _Key], MetricCell]
    states: Mapping[tuple[str | None, _Key], _State]
    actions: Mapping[str, str]
    units: frozenset[str | None]


async def get_metric_table(db: Connection, actor: Actor, *, matching: MetricTableQuery) -> MetricTableRead:
    """Return a table of a metric; one without rows where nothing that `actor` may see matches.

    Raises:
        InvalidQuery: a filter cannot be used, the table is too large, its values have several units, or `compare`
            names no column, or several.
    """
    runs = queries.metric_runs(actor, matching)
    declarations = await _declarations(db, runs, matching.metric)
    keys = {*(row.action_key for row in await db.execute(queries.reporting_actions(runs, matching.metric)))}
    relevant = queries.relevant_runs(runs, sorted(keys | declarations.by_action.keys()), matching.columns)
    results = queries.results(relevant, matching, declarations.units)
    content = await _read_content(db, actor, matching, relevant, results)
    dimensions = await _dimensions(db, results)
    columns = _columns(matching.columns, content)
    row_keys = _row_keys(matching.rows, content)
    _check_size(matching, len(row_keys), len(columns))
    summary = _agreed(declarations.by_action.values())
    better = Better.none if matching.aggregate is Aggregate.count else matching.better or summary.better
    rows = [_row(matching, content, key, columns, better) for key in row_keys]
    table = MetricTableRead(
        metric=matching.metric,
        unit=_unit(matching, content.units, summary),
        better=better,
        description=summary.description,
        aggregate=matching.aggregate,
        row_group=matching.rows,
        column_dimensions=matching.columns,
        columns=_described(matching.columns, columns, content.actions),
        rows=rows,
        dimensions=dimensions,
        varying=await _varying(db, matching, results, dimensions),
    )
    if matching.compare:
        table = table.model_copy(update={"comparison": _compare(table, matching.compare)})
    if matching.text is None:
        return table
    text = write_table(metric_text_table(table), matching.text, matching.digits)
    return table.model_copy(update={"text": text})


async def list_metric_names(db: Connection, actor: Actor, *, matching: MetricNameFilter) -> MetricNames:
    """Return the metrics that visible runs reported, by name."""
    names, declarations = queries.metric_names(actor, matching)
    by_action: dict[str, dict[str, _Declared]] = {}
    for row in await db.execute(declarations):
        for entry in row.declared:
            by_action.setdefault(entry["name"], {})[row.action_key] = _to_declared(entry)
    declared = {name: _agreed(entries.values()) for name, entries in by_action.items()}
    rows = (await db.execute(names.limit(MAX_METRIC_NAMES + 1))).all()
    items = []
    for row in rows[:MAX_METRIC_NAMES]:
        known = declared.get(row.name, _Declared())
        # Those without a unit have the declared one.
        units = dict.fromkeys(unit or known.unit for unit in row.units)
        unit = ", ".join(sorted(unit for unit in units if unit)) or None
        described = {"unit": unit, "better": known.better, "description": known.description}
        items.append(MetricName(name=row.name, run_count=row.run_count, **described))
    return MetricNames(items=items, truncated=len(rows) > MAX_METRIC_NAMES)


class _Declarations(NamedTuple):
    """What is declared of a metric: by the latest version of each action that declares it, and units by version."""

    by_action: dict[str, _Declared]
    units: dict[uuid.UUID, str]


async def _declarations(db: Connection, runs: Any, metric: str) -> _Declarations:
    declarations = _Declarations({}, {})
    for row in await db.execute(queries.declarations(runs)):
        for entry in row.declared:
            if entry["name"] == metric:
                declared = declarations.by_action[row.action_key] = _to_declared(entry)
                if declared.unit:
                    declarations.units[row.id] = declared.unit
    return declarations


def _to_declared(entry: Mapping[str, Any]) -> _Declared:
    return _Declared(entry["unit"], Better(entry["better"]), entry["description"])


def _agreed(declared: Iterable[_Declared]) -> _Declared:
    several = [*declared]
    if not several:
        return _Declared()
    units = {entry.unit for entry in several if entry.unit}
    directions = {entry.better for entry in several}
    return _Declared(
        unit=units.pop() if len(units) == 1 else None,
        better=directions.pop() if len(directions) == 1 else Better.none,
        description=several[0].description,
    )


async def _read_content(
    db: Connection, actor: Actor, matching: MetricTableQuery, relevant: Any, results: Any
) -> _Content:
    dimensions = matching.columns
    of_runs = [at for at, name in enumerate(dimensions) if queries.of_runs(name)]
    names: dict[str | None, tuple[str, str, str]] = {}
    actions: dict[str, str] = {}
    states: dict[tuple[str | None, _Key], _State] = {}
    limit = MAX_ROWS * MAX_COLUMNS + 1
    for row in (await db.execute(queries.run_states(relevant, dimensions).limit(limit))).mappings():
        names[row["row_key"]] = (row["project_id"], row["project_name"], row["mission_name"])
        key = _key_of(row, of_runs)
        states[row["row_key"], key] = _State(row["state"], row["run_id"])
        _note_action(actions, dimensions, row)
    if len(states) == limit:
        _check_size(matching, len(names), len({key for _, key in states}))
    cells: dict[tuple[str | None, _Key], MetricCell] = {}
    units: set[str | None] = set()
    for row in (await db.execute(queries.cells(results, matching).limit(limit))).mappings():
        key = _key_of(row, range(len(dimensions)))
        numbers = {name: row[name] for name in ("value", "count", "run_count", "run_ids")}
        cells[row["row_key"], key] = MetricCell(**numbers)
        units |= {row["first_unit"], row["last_unit"]}
        _note_action(actions, dimensions, row)
    if matching.all_rows:
        stmt = queries.rows_without_runs(actor, matching).limit(MAX_ROWS + 1)
        for row in (await db.execute(stmt)).mappings():
            names.setdefault(row["row_key"], (row["project_id"], row["project_name"], row["mission_name"]))
    return _Content(names, cells, states, actions, frozenset(units))


def _key_of(row: RowMapping, places: Iterable[int]) -> _Key:
    values = (row[f"d{at}"] for at in places)
    return tuple(_KeyPart(value, isinstance(value, bool)) for value in values)


def _note_action(actions: dict[str, str], dimensions: Sequence[str], row: RowMapping) -> None:
    if "action" in dimensions:
        actions[row[f"d{dimensions.index('action')}"]] = row["action_name"]


async def _dimensions(db: Connection, results: Any) -> list[MetricDimension]:
    counts = await db.execute(queries.dimension_counts(results))
    several = sorted((row.name, row.value_count) for row in counts if row.value_count > 1)
    return [MetricDimension(name=name, value_count=number) for name, number in several[:_MAX_DIMENSIONS]]


async def _varying(
    db: Connection, matching: MetricTableQuery, results: Any, dimensions: Sequence[MetricDimension]
) -> list[str]:
    others = [entry.name for entry in dimensions if entry.name not in matching.columns]
    if not others:
        return []
    counts = (await db.execute(queries.varying_counts(results, matching, others))).one()
    return [name for name, number in zip(others, counts, strict=True) if (number or 0) > 1]


def _columns(dimensions: Sequence[str], content: _Content) -> list[_Key]:
    """Return the columns in order: those with values, and those of runs that should have some."""
    of_runs = [at for at, name in enumerate(dimensions) if queries.of_runs(name)]
    with_values = {key for _, key in content.cells}
    known = {tuple(key[at] for at in of_runs) for key in with_values}
    for _, part in content.states:
        if part not in known:
            values = dict(zip(of_runs, part, strict=True))
            with_values.add(tuple(values.get(at, _NOTHING) for at in range(len(dimensions))))

    def order(key: _Key) -> list[tuple[int, float, str, str]]:
        values = [part.value for part in key]
        names = [
            content.actions.get(str(value), "") if dimensions[at] == "action" else value
            for at, value in enumerate(values)
        ]
        return [_sort_key(name) for name in [*names, *values]]

    return sorted(with_values, key=order)


def _sort_key(value: ParameterValue | None) -> tuple[int, float, str, str]:
    """Return the key of an order: numbers, then texts, then nothing."""
    if value is None:
        return 2, 0, "", ""
    if isinstance(value, str):
        return 1, 0, name_key(value), value
    try:
        return 0, float(value), "", str(value)
    except OverflowError:  # an integer of hundreds of digits
        return 0, math.inf if value > 0 else -math.inf, "", str(value)


def _row_keys(group: str, content: _Content) -> list[str | None]:
    """Return the rows by name; values of metadata that are numbers by number, and those without the field last."""

    def order(key: str | None) -> list[object]:
        project_id, project_name, mission_name = content.names[key]
        if group == "mission":
            return [_sort_key(project_name), project_id, _sort_key(mission_name), key]
        return [_sort_key(project_name), key] if group == "project" else [_sort_key(_as_number(key))]

    return sorted(content.names, key=order)


def _as_number(text: str | None) -> ParameterValue | None:
    try:
        number = float(text or "")
    except ValueError:
        return text
    return number if number == number else text  # NaN has no place in an order


def _check_size(matching: MetricTableQuery, rows: int, columns: int) -> None:
    if rows > MAX_ROWS:
        reason = f"these are more than {MAX_ROWS} rows; narrow the filter, or use coarser rows such as project"
        raise InvalidQuery(expression=matching.rows, reason=reason)
    if columns > MAX_COLUMNS:
        reason = f"these are more than {MAX_COLUMNS} columns; narrow the filter, or leave out a column"
        raise InvalidQuery(expression=",".join(matching.columns), reason=reason)
    if rows * columns > MAX_CELLS:
        reason = f"{rows} rows and {columns} columns are more than {MAX_CELLS} cells; narrow the filter"
        raise InvalidQuery(expression=matching.rows, reason=reason)


def _unit(matching: MetricTableQuery, reported: frozenset[str | None], declared: _Declared) -> str | None:
    """Return the unit of all values, or what is declared where there are no values."""
    if matching.aggregate is Aggregate.count:
        return None
    units = sorted(unit for unit in reported if unit)
    if len(units) > 1:
        named = " and ".join(units[:5])
        reason = f"its values have the units {named}; narrow the filter by action, version, topic or label"
        raise InvalidQuery(expression=matching.metric, reason=reason)
    return next(iter(units), None) if reported else declared.unit


def _row(
    matching: MetricTableQuery, content: _Content, key: str | None, columns: Sequence[_Key], better: Better
) -> MetricRow:
    of_runs = [at for at, name in enumerate(matching.columns) if queries.of_runs(name)]
    cells = []
    for column in columns:
        cell = content.cells.get((key, column))
        if cell is None:
            state = content.states.get((key, tuple(column[at] for at in of_runs)))
            cell = MetricCell(missing=Missing.no_run)
            if state is not None:
                cell = MetricCell(missing=_MISSING.get(state.state, Missing.running), run_ids=[state.run_id])
        cells.append(cell)
    cells = _ranked(cells, better)
    if matching.rows.startswith("metadata."):
        return MetricRow(label=key, cells=cells)
    project_id, project_name, mission_name = content.names[key]
    project = ProjectRef(id=uuid.UUID(project_id), name=project_name)
    if matching.rows == "project":
        return MetricRow(label=project_name, project=project, cells=cells)
    is_one_project = len({names[0] for names in content.names.values()}) == 1
    label = mission_name if is_one_project else f"{project_name}/{mission_name}"
    mission = MissionRef(id=uuid.UUID(key), name=mission_name, project=project)
    return MetricRow(label=label, mission=mission, project=project, cells=cells)


def _ranked(cells: Sequence[MetricCell], better: Better) -> list[MetricCell]:
    """Return cells with their ranks, where they differ and one direction is better."""
    values = [cell.value for cell in cells if cell.value is not None]
    if better is Better.none or len(set(values)) < 2:
        return [*cells]
    best, worst = (min(values), max(values)) if better is Better.lower else (max(values), min(values))
    ranks = {best: Rank.best, worst: Rank.worst}
    return [cell if cell.value not in ranks else cell.model_copy(update={"rank": ranks[cell.value]}) for cell in cells]


def _described(dimensions: Sequence[str], columns: Sequence[_Key], actions: Mapping[str, str]) -> list[MetricColumn]:
    """Return the columns with labels such as `slam-evaluate@2, method=kiss-icp`."""
    names = [*actions.values()]
    described = []
    for key in columns:
        values = {name: part.value for name, part in zip(dimensions, key, strict=True)}
        action_key, action_id = values.get("action"), None
        parts = []
        if isinstance(action_key, str):
            name = actions[action_key]
            action_id = uuid.UUID(action_key) if is_id(action_key) else None
            # Several actions may have one name, in different projects.
            label = name if names.count(name) == 1 else f"{name} ({action_key[:8]})"
            values["action"] = name
            number = values.get("version")
            if "version" in values:
                label += " unpublished" if number is None else f"@{number}"
            parts.append(label)
        elif "version" in values:
            number = values["version"]
            parts.append("unpublished" if number is None else f"version {number}")
        parts += [_part(name, value) for name, value in values.items() if name not in {"action", "version"}]
        described.append(MetricColumn(label=", ".join(parts), values=values, action_id=action_id))
    return described


def _part(dimension: str, value: ParameterValue | None) -> str:
    if value is None:
        text = "-"
    elif isinstance(value, bool):
        text = str(value).lower()
    elif isinstance(value, float):
        short = f"{value:.15g}"
        text = short if float(short) == value else repr(value)
    else:
        text = str(value)
    return text if dimension == "topic" and value is not None else f"{dimension.rpartition('.')[2]}={text}"


def _compare(table: MetricTableRead, names: Sequence[str]) -> MetricComparison:
    first, second = (_find_column(table, name) for name in names)
    if first == second:
        raise InvalidQuery(expression=names[1], reason=f"both names are of the column {table.columns[first].label}")
    differences: list[float | None] = []
    for row in table.rows:
        before, after = row.cells[first].value, row.cells[second].value
        differences.append(None if before is None or after is None else after - before)
    pairs = [difference for difference in differences if difference is not None]
    is_better = {Better.lower: -1, Better.higher: 1}.get(table.better)
    return MetricComparison(
        first=first,
        second=second,
        differences=differences,
        pair_count=len(pairs),
        median_difference=statistics.median(pairs) if pairs else None,
        mean_difference=statistics.fmean(pairs) if pairs else None,
        wins=None if is_better is None else sum(is_better * difference > 0 for difference in pairs),
        losses=None if is_better is None else sum(is_better * difference < 0 for difference in pairs),
        ties=pairs.count(0),
    )


def _find_column(table: MetricTableRead, name: str) -> int:
    """Return the column of this label, in any case if that is one, or the only one whose label has all these parts.

    Raises:
        InvalidQuery: there is none, or several.
    """
    labels, name = [column.label for column in table.columns], name.strip()
    keys, key = [name_key(label) for label in labels], name_key(name)
    parts = {part.strip() for part in key.split(",")}
    for matching in (
        [at for at, label in enumerate(labels) if label == name],
        [at for at, label in enumerate(keys) if label == key],
        [at for at, label in enumerate(keys) if parts <= {*label.split(", ")}],
    ):
        if len(matching) == 1:
            return matching[0]
    shown = "; ".join(column.label for column in table.columns) or "none"
    reason = f"{'several columns have' if matching else 'no column has'} this label; the columns are {shown}"
    raise InvalidQuery(expression=name, reason=reason)
