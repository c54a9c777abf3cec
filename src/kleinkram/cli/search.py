"""`klein search` and `klein stats`"""

import csv
import enum
import sys
from collections.abc import Iterable
from dataclasses import replace
from typing import Annotated

import typer

from kleinkram import connect
from kleinkram.cli.file import show_found
from kleinkram.cli.filters import Choice, Many, file_filter, mission_query, with_choice
from kleinkram.cli.mission import show_missions
from kleinkram.cli.options import AsJson, Limit
from kleinkram.cli.render import note, show_json, show_json_list, table
from kleinkram.cli.units import size
from kleinkram.client import Client
from kleinkram.client.errors import InvalidInput
from kleinkram.contract.files import FileSort
from kleinkram.contract.overviews import StatsRead, StatsRow
from kleinkram.contract.query import render
from kleinkram.contract.search import FacetsRead, TopicFound


class Shown(str, enum.Enum):
    """What a search lists."""

    files = "files"
    missions = "missions"
    topics = "topics"
    facets = "facets"


@with_choice
def search(
    choice: Choice,
    words: Annotated[
        str | None,
        typer.Argument(metavar="QUERY", help="Words and terms: 'alps topic:/imu meta.speed>3'.", show_default=False),
    ] = None,
    show: Annotated[Shown, typer.Option("--show", help="What to list.")] = Shown.files,
    path: Annotated[Many, typer.Option("--path", metavar="GLOB", help="Path in the mission.")] = None,
    sort: Annotated[FileSort | None, typer.Option("--sort", help="Order of files; a - turns it round.")] = None,
    limit: Limit = None,
    count: Annotated[bool, typer.Option("--count", help="Only say how many.")] = False,
    as_json: AsJson = False,
) -> None:
    """Find files, missions or topics, in all projects: by text, metadata, topic, type, time, size and more.

    QUERY is what the search page of the web shows, and can do all that the options can: words that are found in names,
    notes, metadata, labels and topics, and terms: project: mission: path: topic: type: label: format: content: state:
    month: after: before: size> duration< meta.FIELD: and -TERM for what is left out.
    """
    if words is not None:
        if choice.query is not None:
            raise InvalidInput(what="The command", reason="say the query once, by itself or with --query")
        choice = replace(choice, query=words)
    with connect() as client:
        if show is Shown.facets:
            _show_facets(client.search.facets(render(file_filter(client, choice, path or []))), as_json)
        elif count:
            number = _count(client, choice, show, path or [])
            show_json({"total": number}) if as_json else typer.echo(str(number))
        elif show is Shown.missions:
            missions = [*client.missions.list(query=mission_query(client, choice, path or []), limit=limit)]
            show_json_list(missions) if as_json else show_missions(missions)
        elif show is Shown.topics:
            topics = client.files.topics_found(file_filter(client, choice, path or []))[:limit]
            show_json_list(topics) if as_json else _show_topics(topics)
        else:
            files = [*client.files.list(file_filter(client, choice, path or []), sort=sort, limit=limit)]
            show_json_list(files) if as_json else show_found(files)


def _count(client: Client, choice: Choice, show: Shown, paths: list[str]) -> int:
    if show is Shown.missions:
        return client.missions.count(query=mission_query(client, choice, paths))
    if show is Shown.topics:
        return len(client.files.topics_found(file_filter(client, choice, paths)))
    return client.files.count(file_filter(client, choice, paths))


def _show_topics(topics: Iterable[TopicFound]) -> None:
    rows = [(row.name, row.message_type, row.file_count, row.message_count) for row in topics]
    table(["topic", "type", "files", "messages"], rows)


def _show_facets(read: FacetsRead, as_json: bool) -> None:
    if as_json:
        show_json(read)
        return
    rows = [(row.name, value.value, value.file_count, value.query) for row in read.facets for value in row.values]
    table(["facet", "value", "files", "query"], rows)
    if not read.is_whole:
        note(f"To save time only {read.file_count} files were counted; say more to find fewer.")


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
        read = client.stats.get(_grouping(by), file_filter(client, choice))
    if as_json:
        show_json(read)
    elif as_csv:
        _write_csv(read)
    else:
        rows = [_row(row.group or "(none)", row) for row in read.rows]
        table([by, "missions", "files", "recordings", "hours", "size", "messages"], [*rows, _row("total", read.total)])


def _grouping(by: str) -> str:
    """Return how to group; what is no group by itself is the name of a field."""
    return by if by in _GROUPS or by.startswith("metadata.") else f"metadata.{by}"


def _row(group: str, row: StatsRow) -> tuple[object, ...]:
    hours = f"{row.duration_ns / _NS_PER_HOUR:.4f}"
    return (group, row.missions, row.files, row.recordings, hours, size(row.size_bytes), row.messages)


def _write_csv(read: StatsRead) -> None:
    writer = csv.writer(sys.stdout, lineterminator="\n")
    writer.writerow([read.by, "missions", "files", "recordings", "duration_ns", "size_bytes", "messages"])
    for row in read.rows:
        counts = [row.missions, row.files, row.recordings, row.duration_ns, row.size_bytes, row.messages]
        writer.writerow([row.group or "", *counts])
