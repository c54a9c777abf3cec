"""`klein stats`"""

import csv
import sys
from typing import Annotated

import typer

from kleinkram import connect
from kleinkram.cli.filters import Choice, file_filter, with_choice
from kleinkram.cli.options import AsJson
from kleinkram.cli.render import show_json, table
from kleinkram.cli.units import size
from kleinkram.client.errors import InvalidInput
from kleinkram.contract.stats import StatsRead, StatsRow

_GROUPS = frozenset(("project", "mission", "topic", "type", "month", "format"))
_NS_PER_HOUR = 3600 * 1_000_000_000


@with_choice
def stats(
    choice: Choice,
    by: Annotated[
        str,
        typer.Option("--by", metavar="GROUP", help="project, mission, topic, type, month, format or a metadata FIELD."),
    ] = "project",
    as_csv: Annotated[bool, typer.Option("--csv", help="Print CSV on stdout.")] = False,
    as_json: AsJson = False,
) -> None:
    """Count hours, bytes, files, messages and missions, grouped; of all files, or of those that the options choose."""
    if as_csv and as_json:
        raise InvalidInput(what="The command", reason="say --csv or --json, not both")
    with connect() as client:
        found = client.stats.get(_grouping(by), file_filter(client, choice))
    if as_json:
        show_json(found)
    elif as_csv:
        _write_csv(found)
    else:
        rows = [_row(row.group or "(none)", row) for row in found.rows]
        table([by, "missions", "files", "recordings", "hours", "size", "messages"], [*rows, _row("total", found.total)])


def _grouping(by: str) -> str:
    """Return how to group; what is no group by itself is the name of a field."""
    return by if by in _GROUPS or by.startswith("metadata.") else f"metadata.{by}"


def _row(group: str, row: StatsRow) -> tuple[object, ...]:
    hours = f"{row.duration_ns / _NS_PER_HOUR:.4f}"
    return (group, row.missions, row.files, row.recordings, hours, size(row.size_bytes), row.messages)


def _write_csv(found: StatsRead) -> None:
    writer = csv.writer(sys.stdout, lineterminator="\n")
    writer.writerow([found.by, "missions", "files", "recordings", "duration_ns", "size_bytes", "messages"])
    for row in found.rows:
        counts = [row.missions, row.files, row.recordings, row.duration_ns, row.size_bytes, row.messages]
        writer.writerow([row.group or "", *counts])
