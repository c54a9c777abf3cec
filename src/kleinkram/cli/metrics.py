"""`klein metrics …`: tables of the metrics that runs reported, for the terminal, papers and spreadsheets."""

import enum
import sys
from typing import Annotated

from kleinkram.cli import options
from kleinkram.cli.commands import Subcommands, Text, flag, option
from kleinkram.cli.filters import WhereOption, filter_of, ids_of
from kleinkram.cli.render import Output, line, note, show_json, table
from kleinkram.cli.run_reports import split_version
from kleinkram.client import Client
from kleinkram.client.metrics import MetricTable, row_group
from kleinkram.contract.actions import Better
from kleinkram.contract.metrics import (
    DEFAULT_DIGITS,
    Aggregate,
    MetricNameFilter,
    MetricNames,
    MetricTableQuery,
    TextFormat,
)
from kleinkram.contract.text_tables import (
    TableValue,
    metric_text_table,
    metric_title,
    significant,
    write_table,
)

app = Subcommands("Show and compare the metrics that runs reported.")
ActionOption = Annotated[Text, option("--action", "GLOB", "Select by the name of the action, or NAME@VERSION.")]


class OutputFormat(str, enum.Enum):
    """How a table is printed."""

    text = "text"
    csv = "csv"
    markdown = "markdown"
    latex = "latex"
    json = "json"


@app.command("list")
def list_metrics(
    client: Client,
    project: options.ProjectsOption = None,
    mission: options.MissionsOption = None,
    action: ActionOption = None,
) -> Output:
    """List the metrics that runs reported."""
    fields = {**_action(action), **ids_of(client, project, mission)}
    names = client.metrics.get_names(filter_of(MetricNameFilter, fields))
    return Output(names, lambda: _show_names(names))


def _show_names(names: MetricNames) -> None:
    headers = ["metric", "unit", "better", "runs", "description"]
    rows = [
        (row.name, row.unit, None if row.better is Better.none else row.better.value, row.run_count, row.description)
        for row in names.items
    ]
    table(headers, rows)
    if names.truncated:
        note(f"There are more than {len(rows)} metrics; --project, --mission and --action select some.")


@app.command("table")
def show_table(
    client: Client,
    metric: Annotated[str, option("--metric", "NAME", "The metric, such as ate_rmse.")],
    rows: Annotated[
        str, option("--rows", "ROWS", "Make a row of each mission, project, or value of a FIELD.")
    ] = "mission",
    columns: Annotated[
        str,
        option(
            "--columns", "COLUMNS", "Make columns by action, version, param.NAME, label.NAME, topic; comma-separated."
        ),
    ] = "action,version",
    aggregate: Annotated[
        Aggregate, option("--aggregate", None, "Choose how several values of a cell become one.")
    ] = Aggregate.median,
    compare: Annotated[
        tuple[str, str] | None,
        option("--compare", "A B", "Compare column B with column A, row by row: labels, or parts of them."),
    ] = None,
    better: Annotated[
        Better | None, option("--better", None, "Set which values are better, if the action does not declare it.")
    ] = None,
    project: options.ProjectsOption = None,
    mission: options.MissionsOption = None,
    query: Annotated[Text, option("--query -q", "QUERY", "Select the missions that the query finds.")] = None,
    where: WhereOption = None,
    action: ActionOption = None,
    topic: Annotated[Text, option("--topic -t", "GLOB", "Select by the topic of the metric.")] = None,
    all_rows: Annotated[bool, flag("--all-rows", "Show also rows without any run.")] = False,
    output_format: Annotated[OutputFormat, option("--format", None, "Choose how to print it.")] = OutputFormat.text,
    digits: Annotated[int, option("--digits", "N", "Print N significant digits.", min=1, max=17)] = DEFAULT_DIGITS,
) -> Output:
    """Print a table of a metric: missions by version, parameter, label or topic.

    Only results that count are in it: of the latest run that is done, of each mission and action with the same
    parameters; where the version is a column, of each version. The best value of each row is marked. --where compares
    metadata (robot=anymal), parameters (param.method=kiss-icp) and labels (label.alignment=se3).
    """
    fields = {
        "metric": metric,
        "rows": row_group(rows),
        "columns": [name.strip() for name in columns.split(",")],
        "aggregate": aggregate,
        "compare": [*compare] if compare else None,
        "better": better,
        "query": query,
        "where": where,
        "topic": topic,
        "all_rows": all_rows,
        **_action(action),
        **ids_of(client, project, mission),
    }
    read = client.metrics.get_table(filter_of(MetricTableQuery, fields))
    return Output(read, lambda: _print(read, output_format, digits))


def _action(ref: str | None) -> dict[str, object]:
    name, version = (None, None) if ref is None else split_version(ref)
    return {"action": name, "version": version}


def _print(read: MetricTable, output_format: OutputFormat, digits: int) -> None:
    if output_format is OutputFormat.json:
        show_json(read)
    elif output_format is not OutputFormat.text:
        sys.stdout.write(write_table(metric_text_table(read), TextFormat(output_format.value), digits))
    elif not read.rows:
        note(f"No run that you can see reported {read.metric}. `klein metrics list` shows the metrics.")
    else:
        _show(read, digits)


def _show(read: MetricTable, digits: int) -> None:
    written = metric_text_table(read)

    def cell(at: int, column: int, value: TableValue) -> str | None:
        if value is None or isinstance(value, str):
            return value
        # So that digits stay in line, beside the column of differences.
        no_mark = " " if written.best and column <= len(read.columns) else ""
        return significant(value, digits) + ("*" if (at, column) in written.best else no_mark)

    cells = [[cell(at, column, value) for column, value in enumerate(row)] for at, row in enumerate(written.rows)]
    line(metric_title(read) + (" (* best of its row)" if written.best else ""))
    table(written.headers, cells)
    for text in written.notes:
        line(text)
