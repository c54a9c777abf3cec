"""`klein event …`: moments and spans of missions that are marked by name."""

import csv
import sys
from collections.abc import Sequence
from typing import Annotated

from kleinkram.cli import options
from kleinkram.cli.commands import AsJson, Many, Subcommands, Text, argument, flag, option
from kleinkram.cli.filters import filter_of, ids_of
from kleinkram.cli.render import Output, as_list, as_total, details, moment, table
from kleinkram.cli.units import instant, parse_time, span
from kleinkram.client import Client
from kleinkram.client._resources import known_id
from kleinkram.client.errors import InvalidInput, NothingToDo
from kleinkram.client.mission_events import MissionEventDetails
from kleinkram.contract.mission_events import EventReference, MissionEventFilter, MissionEventRead, MissionEventSort
from kleinkram.contract.runs import FindingFilter
from kleinkram.contract.text_tables import csv_text
from kleinkram.recordings.time_range import resolve_time

app = Subcommands("Mark moments and spans of missions by name, and list them; `klein cut --event` cuts them.")
EventArgument = Annotated[str, argument("EVENT", "Id of the event; `klein event list --json` shows it.")]
StartOption = Annotated[
    Text, option("--start", "TIME", "Log time: 2026-05-01T10:00:00Z, 10:00 (UTC), or +20s after the mission's start.")
]
EndOption = Annotated[Text, option("--end", "TIME", "End of a span, written like the start.")]
LabelOption = Annotated[Many, option("--label", "LABEL", "Set a label; repeatable.")]
ColourOption = Annotated[Text, option("--colour", "#RRGGBB", "Set the colour, such as #ff8800.")]
NoteOption = Annotated[Text, option("--note", None, "Set the note.")]
FileOption = Annotated[Text, option("--file", "PATH", "Refer to this file of the mission, by path or id.")]
TopicOption = Annotated[Text, option("--topic -t", None, "Refer to this topic.")]


@app.command("add")
def add(
    client: Client,
    name: Annotated[str, argument("NAME", "Name of the event, such as stumble.")],
    mission: options.MissionOption = None,
    project: options.ProjectOption = None,
    start: StartOption = None,
    end: EndOption = None,
    label: LabelOption = None,
    colour: ColourOption = None,
    note: NoteOption = None,
    file: FileOption = None,
    topic: TopicOption = None,
) -> Output:
    """Mark a moment of a mission, or with --end a span."""
    if start is None:
        raise InvalidInput(what="The command", reason="specify when it happened: --start TIME")
    target = client.missions.get(options.the_ref("mission", None, mission), project=project)
    more: MissionEventDetails = {"labels": label or [], "colour": colour, "note": note or "", "topic": topic}
    if file is not None:
        more["file_id"] = client.files.get(file, mission=target).id
    return _output(client.mission_events.add(target, name, start, end, **more))


@app.command("list")
def list_(
    client: Client,
    names: Annotated[Many, argument("GLOB", "Names of events, or globs.")] = None,
    project: options.ProjectsOption = None,
    mission: options.MissionsOption = None,
    label: Annotated[Many, option("--label", "LABEL", "Select events with this label; repeatable.")] = None,
    run: Annotated[Text, option("--run", "RUN", "Select the events of a run, by its id.")] = None,
    after: Annotated[Text, option("--after", "TIME", "Select events that end at TIME or later.")] = None,
    before: Annotated[Text, option("--before", "TIME", "Select events that begin at TIME or earlier.")] = None,
    sort: Annotated[MissionEventSort | None, option("--sort", None, "Set the order; a leading - reverses it.")] = None,
    limit: options.Limit = None,
    count: options.Count = False,
    as_csv: Annotated[bool, flag("--csv", "Print CSV on stdout.")] = False,
    as_json: AsJson = False,
) -> None:
    """List the events of missions, by start; --csv and --json export them."""
    if sum((as_csv, as_json, count)) > 1 and not (as_json and count):
        raise InvalidInput(what="The command", reason="specify one of --csv, --json and --count")
    times = {"after": parse_time(after), "before": parse_time(before)}
    fields = {"name": names, "label": label, "run_id": run, **times, **ids_of(client, project, mission)}
    matching = filter_of(MissionEventFilter, fields)
    if count:
        as_total(client.mission_events.count(matching)).show(as_json)
        return
    rows = [*client.mission_events.list(matching, sort=sort, limit=limit)]
    if as_csv:
        _write_csv(rows)
    else:
        as_list(rows, show_events).show(as_json)


@app.command("info")
def info(client: Client, event: EventArgument) -> Output:
    """Show an event."""
    return _output(client.mission_events.get(event))


@app.command("update")
def update(
    client: Client,
    event: EventArgument,
    name: Annotated[Text, option("--name", None, "Set the name.")] = None,
    start: StartOption = None,
    end: EndOption = None,
    label: LabelOption = None,
    colour: ColourOption = None,
    note: NoteOption = None,
    topic: TopicOption = None,
    etag: options.IfMatch = None,
) -> Output:
    """Change an event. --label replaces all labels; an empty --end makes it a moment; empty values remove."""
    old = client.mission_events.get(event)
    changes: dict[str, str | int | Sequence[str] | None] = {"name": name, "note": note}
    changes |= {"labels": None if label is None else [one for one in label if one]}
    changes = {field: value for field, value in changes.items() if value is not None}
    for field, text in (("start_ns", start), ("end_ns", end)):
        if text is not None:
            changes[field] = _time_in(client, old, text) if text else None
    changes |= {field: text or None for field, text in (("colour", colour), ("topic", topic)) if text is not None}
    if not changes:
        raise InvalidInput(what="The command", reason="specify what to change, such as --name or --note")
    return _output(client.mission_events.update(old.id, if_match=etag or old.etag, **changes))


@app.command("delete")
def delete(client: Client, event: EventArgument, yes: options.Yes = False) -> Output:
    """Delete an event, which cannot be undone."""
    old = client.mission_events.get(event)
    options.confirm(f"Delete the event {old.name} at {instant(old.start_ns)}?", yes)
    client.mission_events.delete(old.id)
    return Output(old, f"Deleted the event {old.name} of {old.mission.project.name}/{old.mission.name}.")


@app.command("from-run")
def from_run(
    client: Client,
    run: Annotated[str, argument("RUN", "Id of a run.")],
    code: Annotated[Text, option("--code", "GLOB", "Take only findings with this code, such as 'imu.*'.")] = None,
) -> Output:
    """Add the findings of a run that have a time as events of its mission, each once."""
    run_id = known_id(client.runs.get(run), "run")
    findings = client.runs.findings(filter_of(FindingFilter, {"run_id": run_id, "code": code}))
    timed = [row for row in findings if row.finding.time_ns is not None]
    if not timed:
        raise NothingToDo(reason="The run has no such finding with a time")
    return as_list((client.mission_events.add_finding(row) for row in timed), show_events)


def _time_in(client: Client, event: MissionEventRead, text: str) -> int:
    """Return a time of an event's mission in nanoseconds."""
    mission = client.missions.get(event.mission.id)
    try:
        return resolve_time(text, mission.start_ns, mission.end_ns)
    except ValueError as error:
        raise InvalidInput(what="The time of the event", reason=str(error)) from None


def show_events(events: Sequence[MissionEventRead]) -> None:
    """Print events of any missions as a table."""
    headers = ["project", "mission", "event", "start", "span", "labels", "topic", "file", "by", "note", "id"]
    table(headers, [(*_place(row), *_cells(row), row.note.partition("\n")[0], row.id) for row in events])


def _place(row: MissionEventRead) -> tuple[str, str]:
    return row.mission.project.name, row.mission.name


def _cells(row: MissionEventRead) -> tuple[object, ...]:
    times = (instant(row.start_ns), span(row.start_ns, row.end_ns))
    return row.name, *times, row.labels, row.topic, _source(row), row.created_by and row.created_by.name


def _source(row: MissionEventRead) -> str | None:
    """Return the file or the recording that an event refers to, also where the mission no longer has it."""
    return _reference(row, EventReference.file) or _reference(row, EventReference.recording)


def _reference(row: MissionEventRead, kind: EventReference) -> str | None:
    """Return the name of what an event refers to, if it is of this kind."""
    if row.refers_to is not kind:
        return None
    name = row.file.path if row.file is not None else row.recording and row.recording.name
    return name or "not in the mission"


def _write_csv(rows: Sequence[MissionEventRead]) -> None:
    """Print events with all digits, times also in UTC."""
    writer = csv.writer(sys.stdout, lineterminator="\n")
    names = ("id", "project", "mission", "name", "start_ns", "end_ns", "start", "end", "labels", "colour", "note")
    writer.writerow([*names, "refers_to", "file", "recording", "topic", "run", "created_at", "created_by"])
    for row in rows:
        times = (row.start_ns, row.end_ns, instant(row.start_ns), instant(row.end_ns))
        texts = (", ".join(row.labels), row.colour, row.note)
        sources = (row.refers_to.value, row.file and row.file.path, row.recording and row.recording.name)
        made = (moment(row.created_at), row.created_by and row.created_by.name)
        cells = (row.id, *_place(row), row.name, *times, *texts, *sources, row.topic, row.run_id, *made)
        writer.writerow([csv_text(cell) if isinstance(cell, str) else cell for cell in cells])


def _output(event: MissionEventRead) -> Output:
    rows = [
        ("event", event.name),
        ("project", event.mission.project.name),
        ("mission", event.mission.name),
        ("id", event.id),
        ("start", instant(event.start_ns)),
        ("span", span(event.start_ns, event.end_ns)),
        ("labels", event.labels),
        ("colour", event.colour),
        ("file", _reference(event, EventReference.file)),
        ("recording", _reference(event, EventReference.recording)),
        ("topic", event.topic),
        ("run", event.run_id),
        ("added", f"{moment(event.created_at)} by {event.created_by.name}" if event.created_by else event.created_at),
        ("etag", event.etag),
        ("note", event.note),
    ]
    return Output(event, lambda: details(rows))
