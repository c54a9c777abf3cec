"""`klein run checks`, `findings` and `metrics`: what runs reported, as a table, CSV or JSON."""

import csv
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, TypeVar

from kleinkram.cli import options
from kleinkram.cli.commands import AsJson, Text, argument, flag, option, with_option_groups
from kleinkram.cli.filters import filter_of, ids_of
from kleinkram.cli.render import moment, show_json, table
from kleinkram.cli.run_view import action_name, labels_text, number_text
from kleinkram.cli.units import instant
from kleinkram.client import Client
from kleinkram.client.errors import InvalidInput
from kleinkram.contract.checks import CheckStatus
from kleinkram.contract.reports import Severity
from kleinkram.contract.runs import (
    CheckFilter,
    CheckRead,
    FindingFilter,
    FindingRead,
    MetricFilter,
    MetricRead,
    ReportFilter,
)
from kleinkram.contract.text_tables import csv_text

ReadT = TypeVar("ReadT", bound=CheckRead | FindingRead | MetricRead)
FilterT = TypeVar("FilterT", bound=ReportFilter)


@dataclass(frozen=True)
class ReportChoice:
    """The options that select what runs reported, named as the fields of `ReportFilter`."""

    project: options.ProjectsOption = None
    mission: options.MissionsOption = None
    action: Annotated[Text, option("--action", "GLOB", "Select by the name of the action, or NAME@VERSION.")] = None
    topic: Annotated[Text, option("--topic", "GLOB", "Select by topic.")] = None
    latest: Annotated[
        bool, flag("--latest", "Select only the latest run that is done of each mission, action and parameters.")
    ] = False


RunFilterArgument = Annotated[Text, argument("RUN", "Id of a run.")]
CsvOption = Annotated[bool, flag("--csv", "Print CSV on stdout, with a column for each parameter.")]


@with_option_groups
def checks(
    client: Client,
    choice: ReportChoice,
    run: RunFilterArgument = None,
    name: Annotated[Text, option("--name", "GLOB", "Select by name, such as 'imu.*'.")] = None,
    status: Annotated[list[CheckStatus] | None, option("--status", None, "Select by status; repeatable.")] = None,
    limit: options.Limit = None,
    as_csv: CsvOption = False,
    as_json: AsJson = False,
) -> None:
    """List the checks that one run reported, or the runs of a mission, of a project, or all."""
    matching = _filter(client, CheckFilter, run, choice, {"name": name, "status": status})
    headers = ["check", "status", "message", "value", "limit", "unit", "topic", "file", "at"]
    show_rows(client.runs.checks(matching, limit=limit), headers, _check_cells, as_csv=as_csv, as_json=as_json)


@with_option_groups
def findings(
    client: Client,
    choice: ReportChoice,
    run: RunFilterArgument = None,
    code: Annotated[Text, option("--code --name", "GLOB", "Select by code, such as 'imu.*'.")] = None,
    severity: Annotated[list[Severity] | None, option("--severity", None, "Select by severity; repeatable.")] = None,
    limit: options.Limit = None,
    as_csv: CsvOption = False,
    as_json: AsJson = False,
) -> None:
    """List the findings of one run, or of the runs of a mission, of a project, or of all."""
    matching = _filter(client, FindingFilter, run, choice, {"code": code, "severity": severity})
    headers = ["severity", "finding", "message", "topic", "file", "at"]
    show_rows(client.runs.findings(matching, limit=limit), headers, _finding_cells, as_csv=as_csv, as_json=as_json)


@with_option_groups
def metrics(
    client: Client,
    choice: ReportChoice,
    run: RunFilterArgument = None,
    name: Annotated[Text, option("--name", "GLOB", "Select by name, such as 'ate_*'.")] = None,
    limit: options.Limit = None,
    as_csv: CsvOption = False,
    as_json: AsJson = False,
) -> None:
    """List the metrics of one run, or of the runs of a mission, of a project, or of all, with their parameters."""
    matching = _filter(client, MetricFilter, run, choice, {"name": name})
    headers = ["metric", "value", "unit", "topic", "labels", "file"]
    show_rows(client.runs.metrics(matching, limit=limit), headers, _metric_cells, as_csv=as_csv, as_json=as_json)


def show_rows(
    rows: Iterable[ReadT],
    headers: Sequence[str],
    cells: Callable[[ReadT], Sequence[object]],
    *,
    as_csv: bool,
    as_json: bool,
) -> None:
    """Print rows of runs. `cells` are those of the headers; mission, action, parameters and run are added."""
    if as_csv and as_json:
        raise InvalidInput(what="The command", reason="specify --csv or --json, not both")
    items = [*rows]
    if as_json:
        show_json({"items": items})
    elif as_csv:
        _write_csv(items)
    else:
        table(["mission", "action", *headers, "parameters", "run"], [_cells(row, cells(row)) for row in items])


def _cells(row: CheckRead | FindingRead | MetricRead, cells: Sequence[object]) -> Sequence[object]:
    return row.mission.name, action_name(row.action), *cells, labels_text(row.parameters), row.run_id


def _check_cells(row: CheckRead) -> Sequence[object]:
    check = row.check
    numbers = (number_text(check.value), number_text(check.limit), check.unit)
    return check.name, check.status.value, check.message, *numbers, check.topic, check.file, instant(check.time_ns)


def _finding_cells(row: FindingRead) -> Sequence[object]:
    finding = row.finding
    at = instant(finding.time_ns)
    return finding.severity.value, finding.code, finding.message, finding.topic, finding.file, at


def _metric_cells(row: MetricRead) -> Sequence[object]:
    metric = row.metric
    return metric.name, number_text(metric.value), metric.unit, metric.topic, labels_text(metric.labels), metric.file


def _write_csv(rows: Sequence[CheckRead | FindingRead | MetricRead]) -> None:
    """Print rows with all digits; each parameter, and each label of metrics, has a column of its own."""
    records = [_record(row) for row in rows]
    columns = [*dict.fromkeys(name for record in records for name in record)]
    # Those of parameters and labels come last, sorted, since they differ between actions.
    columns.sort(key=lambda name: (name.startswith(("label.", "parameter.")), name if "." in name else ""))
    writer = csv.DictWriter(sys.stdout, columns, restval="", lineterminator="\n")
    if columns:
        writer.writeheader()
    writer.writerows(
        {name: csv_text(value) if isinstance(value, str) else value for name, value in record.items()}
        for record in records
    )


def _record(row: CheckRead | FindingRead | MetricRead) -> dict[str, object]:
    reported = row.check if isinstance(row, CheckRead) else row.finding if isinstance(row, FindingRead) else row.metric
    fields = reported.model_dump(mode="json")
    labels: Mapping[str, object] = fields.pop("labels", {})
    return {
        "project": row.mission.project.name,
        "mission": row.mission.name,
        "action": row.action.name,
        "version": row.action.version,
        **fields,
        "run": row.run_id,
        "ended_at": row.ended_at and moment(row.ended_at),
        **{f"label.{name}": value for name, value in labels.items()},
        **{f"parameter.{name}": value for name, value in row.parameters.items()},
    }


def _filter(client: Client, kind: type[FilterT], run: Text, choice: ReportChoice, own: Mapping[str, object]) -> FilterT:
    selected = {**own, "topic": choice.topic, "latest": choice.latest}
    selected |= ids_of(client, choice.project, choice.mission)
    if choice.action is not None:
        selected["action"], selected["version"] = split_version(choice.action)
    if run is not None:
        selected["run_id"] = client.runs.get(run).id
    return filter_of(kind, selected)


def split_version(ref: str) -> tuple[str, int | None]:
    """Return the name and the number of `NAME@NUMBER`; any other reference is itself, without a number."""
    name, _, number = ref.rpartition("@")
    return (name, int(number)) if name and number.isdecimal() and number.isascii() else (ref, None)
