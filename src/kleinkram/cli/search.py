"""`klein search`, `klein stats` and `klein lineage`"""

import csv
import enum
import sys
from dataclasses import replace
from typing import Annotated

from kleinkram.cli import options
from kleinkram.cli.commands import AsJson, Many, Text, argument, flag, option, with_option_groups
from kleinkram.cli.filters import Choice, file_filter, mission_query
from kleinkram.cli.mission import show_files, show_missions
from kleinkram.cli.render import Output, as_list, as_table, as_total, details, line, note, show_json, table
from kleinkram.cli.run_view import action_name, mission_name, status_text
from kleinkram.cli.units import size
from kleinkram.client import Client
from kleinkram.client.errors import InvalidInput
from kleinkram.contract.files import FileSort
from kleinkram.contract.metrics import TextFormat
from kleinkram.contract.query import render
from kleinkram.contract.runs import LineageFile, LineageRead
from kleinkram.contract.search import StatsRead, StatsRow
from kleinkram.contract.text_tables import NO_GROUP, TableValue, TextTable, csv_text, write_table

_GROUPS = frozenset(("project", "mission", "topic", "type", "month", "format"))
_NS_PER_HOUR = 3600 * 1_000_000_000
_SIZE_UNITS = (("TB", 10**12), ("GB", 10**9), ("MB", 10**6), ("kB", 10**3), ("B", 1))


class Shown(str, enum.Enum):
    """What a search lists."""

    files = "files"
    missions = "missions"
    topics = "topics"
    facets = "facets"


@with_option_groups
def search(
    client: Client,
    choice: Choice,
    words: Annotated[Text, argument("QUERY", "Words and terms: 'alps topic:/imu meta.speed>3'.")] = None,
    show: Annotated[Shown, option("--show", None, "Choose what to list.")] = Shown.files,
    path: Annotated[Many, option("--path", "GLOB", "Select by path in the mission.")] = None,
    sort: Annotated[FileSort | None, option("--sort", None, "Set the order of files; a leading - reverses it.")] = None,
    limit: options.Limit = None,
    count: options.Count = False,
) -> Output:
    """Find files, missions or topics in all projects by text, metadata, topic, type, time, size and more.

    QUERY is the query of the search page of the web. It can do all that the options can. Words match names, notes,
    metadata, labels and topics. Terms are project: mission: path: topic: type: label: format: content: state: month:
    after: before: size> duration< meta.FIELD: and -TERM to exclude.
    """
    if words is not None:
        if choice.query is not None:
            raise InvalidInput(what="The command", reason="specify the query once: as an argument or with --query")
        choice = replace(choice, query=words)
    paths = path or []
    if show is Shown.facets:
        return _facets(client, render(file_filter(client, choice, paths)))
    if show is Shown.missions:
        query = mission_query(client, choice, paths)
        if count:
            return as_total(client.missions.count(query=query))
        return as_list(client.missions.list(query=query, limit=limit), show_missions)
    matching = file_filter(client, choice, paths)
    if show is Shown.topics:
        topics = client.files.topics_found(matching)
        if count:
            return as_total(len(topics))
        return as_table(
            topics[:limit],
            ["topic", "type", "files", "messages"],
            lambda row: (row.name, row.message_type, row.file_count, row.message_count),
        )
    if count:
        return as_total(client.files.count(matching))
    return as_list(client.files.list(matching, sort=sort, limit=limit), show_files)


def _facets(client: Client, query: str) -> Output:
    facets = client.search.facets(query)

    def show() -> None:
        rows = [(row.name, item.value, item.file_count, item.query) for row in facets.facets for item in row.values]
        table(["facet", "value", "files", "query"], rows)
        if not facets.is_exact:
            note(f"To save time only {facets.file_count} files were counted. Narrow the query to count all that match.")

    return Output(facets, show)


@with_option_groups
def stats(
    client: Client,
    choice: Choice,
    by: Annotated[
        str, option("--by", "GROUP", "Group by project, mission, topic, type, month, format or a metadata FIELD.")
    ] = "project",
    derived: Annotated[bool, flag("--derived", "Count also files that runs made from others.")] = False,
    as_csv: Annotated[bool, flag("--csv", "Print CSV on stdout.")] = False,
    as_markdown: Annotated[bool, flag("--markdown", "Print a Markdown table on stdout.")] = False,
    as_latex: Annotated[bool, flag("--latex", "Print a LaTeX table on stdout; it needs booktabs.")] = False,
    as_json: AsJson = False,
) -> None:
    """Count the hours, bytes, files, messages and missions of what was recorded, or of what the options select."""
    if sum((as_csv, as_markdown, as_latex, as_json)) > 1:
        raise InvalidInput(what="The command", reason="specify one of --csv, --markdown, --latex and --json")
    group = by if by in _GROUPS or by.startswith("metadata.") else f"metadata.{by}"
    read = client.stats.get(group, file_filter(client, choice), derived=derived)
    if as_json:
        show_json(read)
    elif as_csv:
        writer = csv.writer(sys.stdout, lineterminator="\n")
        writer.writerow([read.by, "missions", "files", "recordings", "duration_ns", "size_bytes", "messages"])
        for row in read.rows:
            counts = [row.missions, row.files, row.recordings, row.duration_ns, row.size_bytes, row.messages]
            writer.writerow([csv_text(row.group or ""), *counts])
    elif as_markdown or as_latex:
        written = _stats_table(by, read)
        sys.stdout.write(write_table(written, TextFormat.markdown if as_markdown else TextFormat.latex))
    else:
        rows = [_stats_cells(row.group or NO_GROUP, row) for row in read.rows]
        headers = [by, "missions", "files", "recordings", "hours", "size", "messages"]
        table(headers, [*rows, _stats_cells("total", read.total)])


def _stats_cells(group: str, row: StatsRow) -> tuple[object, ...]:
    hours = f"{row.duration_ns / _NS_PER_HOUR:.4f}"
    return group, row.missions, row.files, row.recordings, hours, size(row.size_bytes), row.messages


def _stats_table(by: str, read: StatsRead) -> TextTable:
    """Return statistics with units: hours, and bytes in the unit that suits the total."""
    unit, bytes_per_unit = next(
        ((name, number) for name, number in _SIZE_UNITS if read.total.size_bytes >= number), _SIZE_UNITS[-1]
    )

    def cells(group: str, row: StatsRow) -> list[TableValue]:
        counts = [row.missions, row.files, row.recordings]
        return [group, *counts, row.duration_ns / _NS_PER_HOUR, row.size_bytes / bytes_per_unit, row.messages]

    headers = [by, "missions", "files", "recordings", "duration [h]", f"size [{unit}]", "messages"]
    rows = [cells(row.group or NO_GROUP, row) for row in read.rows]
    return TextTable(headers, rows, totals=[cells("total", read.total)])


def lineage(
    client: Client,
    file: options.FileArgument,
    project: options.ProjectOption = None,
    mission: options.MissionOption = None,
) -> Output:
    """Show which run created a file and from what, and which runs read it and what they created."""
    read = client.files.lineage(client.files.get(file, mission=mission, project=project).id)
    return Output(read, lambda: _show_lineage(read))


def _show_lineage(read: LineageRead) -> None:
    line(f"{read.file.path}  sha256 {read.file.sha256}")
    line("")
    if read.made_by is None:
        line("Uploaded, not created by a run.")
    else:
        run = read.made_by.run
        line("Created by")
        details(
            [
                ("run", run.id),
                ("action", action_name(run.action)),
                ("version", run.version_id),
                ("image", run.image_digest),
                ("runner", run.runner),
                ("isolation", run.isolation and run.isolation.value),
                ("started", run.started_at),
                ("ended", run.ended_at),
                *((f"  {name}", value) for name, value in run.parameters.items()),
            ]
        )
        line("")
        table(["of the file", "sha256", "id"], [(_path(row), row.sha256, row.id) for row in read.made_by.inputs])
    if read.read_by:
        line("")
        line("Read by")
        cells = []
        for row in read.read_by:
            state = (status_text(row.run), row.run.ended_at)
            made = [_path(file) for file in row.files] or None
            action = action_name(row.run.action)
            cells.append((mission_name(row.run), action, *state, made, row.artifact_count, row.run.id))
        table(["mission", "action", "state", "ended", "files made", "artifacts", "run"], cells)
    if read.truncated:
        note("More runs read it; `klein run list` lists all.")


def _path(file: LineageFile) -> str:
    return file.path if file.id is not None else f"{file.path} (deleted, or not visible to you)"
