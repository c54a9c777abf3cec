"""How a mission, its recordings and topics look."""

from collections.abc import Iterable

from kleinkram.cli.render import details, line, note, show_json, table
from kleinkram.cli.units import count, duration, instant, rate, size, span
from kleinkram.client import Client
from kleinkram.contract.files import BlobState, FileFilter, FileRead, RecordingRead, TopicRead
from kleinkram.contract.missions import MissionRead
from kleinkram.contract.topics import MissionTopic

_DAMAGED = {BlobState.lost, BlobState.corrupt}


def show_mission(mission: MissionRead) -> None:
    """Print a mission's own properties and metadata."""
    details(
        [
            ("mission", mission.name),
            ("project", mission.project.name),
            ("id", mission.id),
            ("created", f"{mission.created_at:%Y-%m-%d %H:%M}Z by {mission.created_by.name}"),
            ("completed", mission.completed_at),
            ("start", instant(mission.start_ns)),
            ("span", span(mission.start_ns, mission.end_ns)),
            ("files", f"{mission.file_count}, {size(mission.size_bytes)}"),
            ("messages", mission.message_count),
            ("not read yet", count(mission.pending_file_count, "file") if mission.pending_file_count else None),
            ("etag", mission.etag),
            ("notes", mission.notes),
            *((f"  {name}", _value(value)) for name, value in mission.metadata.items()),
            *((f"problem with {problem.field}", problem.message) for problem in mission.metadata_problems),
        ]
    )


def show_changes(before: MissionRead, after: MissionRead) -> None:
    """Print what a change made different, a line for each field: the old value and the new one."""
    own = [(name, getattr(before, name), getattr(after, name)) for name in ("name", "notes")]
    fields = sorted({*before.metadata, *after.metadata})  # the database does not keep their order
    pairs = [*own, *((name, before.metadata.get(name), after.metadata.get(name)) for name in fields)]
    changes = [(name, old, new) for name, old, new in pairs if old != new]
    if not changes:
        note(f"{after.project.name}/{after.name} is as it was: nothing changed.")
        return
    line(f"Changed {after.project.name}/{after.name}")
    for name, old, new in changes:
        line(f"  {name}: {_shown(old)} -> {_shown(new)}")


def _shown(value: object) -> str:
    return "(none)" if value in (None, "") else str(_value(value))


def show_contents(client: Client, mission: MissionRead, as_json: bool) -> None:
    """Print a mission with its recordings, files and topics."""
    matching = FileFilter(mission_id=mission.id)
    recordings = [*client.recordings.list(mission.id)]
    files = [*client.files.list(matching)]
    if as_json:
        by_file = [*client.files.find_topics(matching)]
        show_json({"mission": mission, "recordings": recordings, "files": files, "topics": by_file})
        return
    show_mission(mission)
    if recordings:
        line("")
        line("Recordings")
        show_recordings(recordings)
    if files:
        line("")
        line("Files")
        show_files(files)
        _show_damage(files)
    topics = client.missions.topics(mission.id, bins=0).items
    if topics:
        line("")
        line("Topics")
        show_mission_topics(topics)


def _show_damage(files: Iterable[FileRead]) -> None:
    damaged = [file for file in files if file.state in _DAMAGED]
    if damaged:
        line("")
        line("Not what was uploaded: upload these again to mend them")
        table(
            ["path", "bytes", "since", "what differs"],
            [(file.path, file.state.value, file.damaged_at, file.state_reason) for file in damaged],
        )


def show_missions(missions: Iterable[MissionRead]) -> None:
    """Print missions of any projects as a table."""
    table(
        ["project", "mission", "files", "size", "start", "span", "id"],
        [
            (
                row.project.name,
                row.name,
                row.file_count,
                size(row.size_bytes),
                instant(row.start_ns),
                span(row.start_ns, row.end_ns),
                row.id,
            )
            for row in missions
        ],
    )


def show_recordings(recordings: Iterable[RecordingRead]) -> None:
    """Print recordings as a table, and what is odd about them below."""
    rows = [*recordings]
    table(
        ["recording", "kind", "files", "content", "messages", "start", "span", "size"],
        [
            (
                row.name,
                row.kind,
                len(row.file_ids),
                row.content.value,
                row.message_count,
                instant(row.start_ns),
                span(row.start_ns, row.end_ns),
                size(row.size_bytes),
            )
            for row in rows
        ],
    )
    odd = [
        *((row.name, row.content.value, row.content_reason) for row in rows if row.content_reason),
        *((row.name, problem.where, problem.message) for row in rows for problem in row.problems),
    ]
    if odd:
        line("")
        table(["recording", "what", "to know"], odd)


def show_files(files: Iterable[FileRead]) -> None:
    """Print files of one mission as a table."""
    table(
        ["path", "size", "bytes", "content", "format", "messages", "start", "span", "id"],
        [
            (
                row.path,
                size(row.size_bytes),
                row.state.value,
                row.content.value,
                row.format,
                row.message_count,
                instant(row.start_ns),
                span(row.start_ns, row.end_ns),
                row.id,
            )
            for row in files
        ],
    )


def show_mission_topics(topics: Iterable[MissionTopic]) -> None:
    """Print the topics of a mission as a table, a line each, over all its files."""
    table(
        ["topic", "type", "count", "rate", "longest gap", "files"],
        [
            (row.name, row.message_type, row.count, rate(row.rate_hz), duration(row.longest_gap_ns), row.file_count)
            for row in topics
        ],
    )


def show_topics(topics: Iterable[TopicRead]) -> None:
    """Print the topics of one file as a table."""
    table(
        ["topic", "type", "count", "rate", "longest gap", "head gap", "tail gap"],
        [
            (
                row.name,
                row.message_type,
                row.count,
                rate(row.rate_hz),
                duration(row.longest_gap_ns),
                duration(row.head_gap_ns),
                duration(row.tail_gap_ns),
            )
            for row in topics
        ],
    )


def _value(value: object) -> object:
    if isinstance(value, dict):
        return ", ".join(f"{key} {one}" for key, one in value.items() if one is not None)
    return value
