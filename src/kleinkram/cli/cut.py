"""`klein cut`: topics, or a time range, of local recordings or of those of a mission, as one MCAP."""

import contextlib
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import asdict
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path
from typing import Annotated

from kleinkram.cli import options
from kleinkram.cli.commands import Many, Text, flag, option
from kleinkram.cli.commands import argument as positional
from kleinkram.cli.errors import Interrupted
from kleinkram.cli.event_slices import EventChoice, cut_around_events
from kleinkram.cli.render import Output, details, escape, note
from kleinkram.cli.units import count, instant, size, span
from kleinkram.client import Client, connect
from kleinkram.client.errors import InvalidInput, NothingToDo
from kleinkram.client.transfer.slices import time_range_errors
from kleinkram.contract.errors import FileUnavailable, NotFound
from kleinkram.contract.files import RecordingRead
from kleinkram.recordings import (
    ChunkCompression,
    McapOptions,
    McapResult,
    NotARecording,
    Recording,
)
from kleinkram.recordings.formats.rosbag2.metadata import METADATA_NAME
from kleinkram.recordings.messages import END_OF_TIME_NS, Selection, Time
from kleinkram.recordings.open_paths import find_recordings
from kleinkram.recordings.writing.mcap import may_overlap, merge_to_mcap, select_range, select_slice


def cut(
    sources: Annotated[
        Many, positional("SOURCE", "Files and folders; with -m, names or globs of recordings in the mission.")
    ] = None,
    project: options.ProjectOption = None,
    mission: options.MissionOption = None,
    topics: options.TopicsOption = None,
    start: options.StartOption = None,
    end: options.EndOption = None,
    output: Annotated[
        Path | None, option("--output -o", "FILE", "The MCAP to write, which must not exist; with --event, a folder.")
    ] = None,
    event: Annotated[Many, option("--event", "GLOB", "Cut around each event of this name instead; repeatable.")] = None,
    around: Annotated[
        Text, option("--around", "TIME", "Take so much before and after an event: 5s by default.")
    ] = None,
    attachments: Annotated[bool, flag("--attachments/--no-attachments", "Copy the attachments.")] = True,
    metadata: Annotated[bool, flag("--metadata/--no-metadata", "Copy the metadata records.")] = True,
    latched: Annotated[
        bool,
        flag("--latched/--no-latched", "Begin with the valid messages of latched topics from before the start."),
    ] = True,
    compression: Annotated[
        ChunkCompression, option("--compression", "NAME", "Compress chunks with zstd, lz4 or none.")
    ] = ChunkCompression.zstd,
    dry_run: options.DryRun = False,
) -> Output:
    """Write topics, or a time range, of recordings as one MCAP. Several recordings are merged in log time order.

    Only the indexes and the chunks that are needed are read; from a server (-p, -m), they are fetched from the store.
    Without SOURCE, all recordings of the mission are read, except those that runs made. With --event, one MCAP for
    each event of the mission, or of all missions of the project, is written to a folder.
    """
    how = McapOptions(compression, attachments=attachments, metadata=metadata, latched=latched)
    if event:
        if sources or start is not None or end is not None:
            raise InvalidInput(what="--event", reason="the events say what is cut: leave out SOURCE, --start and --end")
        choice = EventChoice(event, around or "5s", project, mission)
        names = options.topic_names(topics)
        with connect() as client:
            return cut_around_events(client, choice, output or Path(), topics=names, how=how, dry_run=dry_run)
    if around is not None:
        raise InvalidInput(what="--around", reason="it requires --event")
    if output is None and not dry_run:
        raise InvalidInput(what="The command", reason="specify the file to write: -o out.mcap")
    with ExitStack() as stack:
        times: tuple[Time | None, Time | None] = start, end
        if mission is not None:
            client = stack.enter_context(connect())
            rows = _find_remote(client, mission, project, sources or [])
            times, rows = _in_range(rows, times)
            recordings = _open_all(stack, (partial(client.recordings.open, row) for row in rows))
        elif project is not None or not sources:
            raise InvalidInput(what="The command", reason="specify files or folders, or a mission with -m")
        else:
            recordings = _open_all(stack, (item.open for item in find_recordings(sources)))
        selection = _select(recordings, options.topic_names(topics), *times)
        if dry_run or output is None:
            return _estimate(recordings, selection)
        result = _write(recordings, output, selection, how)
    return _output(recordings, selection, result)


def _select(
    recordings: Sequence[Recording], topics: Sequence[str] | None, start: Time | None, end: Time | None
) -> Selection:
    with time_range_errors():
        selection = select_slice(recordings, topics, start, end)
    if selection.topics is not None and not selection.topics:
        raise NothingToDo(reason=f"No topic matches {', '.join(topics or [])}")
    return selection


def _open_all(stack: ExitStack, openers: Iterable[Callable[[], Recording]]) -> list[Recording]:
    """Open recordings; note those that cannot be read, if there are others."""
    results = [open_readable(opener) for opener in openers]
    recordings = [stack.enter_context(result) for result in results if isinstance(result, Recording)]
    failures = [result for result in results if not isinstance(result, Recording)]
    if not recordings:
        raise failures[0] if failures else NothingToDo(reason="There is no recording")
    for failure in failures:
        note(f"Left out: {failure}")
    return recordings


def open_readable(opener: Callable[[], Recording]) -> Recording | NotARecording | FileUnavailable:
    """Open a recording, or return why it cannot be read."""
    try:
        return opener()
    except (NotARecording, FileUnavailable) as error:
        return error


def _find_remote(client: Client, mission: str, project: str | None, names: Sequence[str]) -> list[RecordingRead]:
    """Return recordings of a mission: those of these names, globs or paths, else all that no run made."""
    rows = [*client.recordings.list(client.missions.get(mission, project=project).id)]
    selected = [row for row in rows if not row.is_derived]
    if names:
        selected = [row for row in rows if any(_is_named(name, [row.name, *row.paths]) for name in names)]
        for name in names:
            if not any(_is_named(name, [row.name, *row.paths]) for row in rows):
                raise NotFound(resource_type="recording", ref=name)
    return selected


def _in_range(
    rows: list[RecordingRead], times: tuple[Time | None, Time | None]
) -> tuple[tuple[Time | None, Time | None], list[RecordingRead]]:
    """Return the log times of a range, and the recordings that may have messages in it: only these are opened."""
    # Where the server does not know all times yet, those in the recordings decide.
    if not rows or times == (None, None) or any(row.start_ns is None for row in rows):
        return times, rows
    name = rows[0].name if len(rows) == 1 else f"the {len(rows)} recordings"
    with time_range_errors():
        start_ns, end_ns = select_range(rows, *times, name=name)
    return (start_ns, end_ns), [row for row in rows if may_overlap(row, Selection(None, start_ns, end_ns))]


def _is_named(name: str, names: Iterable[str]) -> bool:
    return any(name == other or fnmatchcase(other, name) for other in names)


def _estimate(recordings: Sequence[Recording], selection: Selection) -> Output:
    """Return how many bytes of chunks would be read of each recording."""
    items = []
    for recording in recordings:
        own = [topic.name for topic in recording.topics if selection.has_topic(topic.name)]
        needed = (
            segment.size_bytes
            for segment in recording.segments(own)
            if segment.first_ns < selection.end_ns and segment.last_ns >= selection.start_ns
        )
        items.append({"recording": _name_of(recording), "topics": own, "chunk_bytes": sum(needed)})
    total = sum(int(str(item["chunk_bytes"])) for item in items)
    text = f"Would read {size(total)} of {count(len(items), 'recording')}."
    return Output({"dry_run": True, "items": items}, text)


def _write(recordings: Sequence[Recording], output: Path, selection: Selection, how: McapOptions) -> McapResult:
    topics = None if selection.topics is None else sorted(selection.topics)
    start_ns, end_ns = selection.start_ns, selection.end_ns
    with watch_shares() as watch:
        return merge_to_mcap(
            recordings, output, topics, start=start_ns, end=end_ns, options=how, on_progress=watch(output.name)
        )


Watch = Callable[[str], Callable[[float], None] | None]
"""Shows a bar of this name; returns what takes the share that is done, None where there is no terminal."""


@contextlib.contextmanager
def watch_shares(remedy: str = "Nothing was written.") -> Iterator[Watch]:
    """Show bars on a terminal. Ctrl-C raises Interrupted, which names a remedy; no incomplete file is left then."""
    try:
        if not sys.stderr.isatty():
            yield lambda _name: None
            return
        from rich.console import Console
        from rich.progress import Progress, TextColumn

        name_column = TextColumn("{task.description}", markup=False)  # names may have brackets
        columns = name_column, *Progress.get_default_columns()[1:]
        with Progress(*columns, console=Console(stderr=True), transient=True) as progress:

            def watch(name: str) -> Callable[[float], None]:
                task = progress.add_task(escape(name), total=1.0)
                return lambda share: progress.update(task, completed=share)

            yield watch
    except KeyboardInterrupt:
        raise Interrupted(remedy) from None


def _name_of(recording: Recording) -> str:
    return recording.name.removesuffix(f"/{METADATA_NAME}")


def _output(recordings: Sequence[Recording], selection: Selection, result: McapResult) -> Output:
    start_ns = selection.start_ns or None
    end_ns = None if selection.end_ns == END_OF_TIME_NS else selection.end_ns
    document = {
        "path": str(result.path),
        "size_bytes": result.size_bytes,
        "message_count": result.message_count,
        "latched_count": result.latched_count,
        "start_ns": start_ns,
        "end_ns": end_ns,
        "topics": None if selection.topics is None else sorted(selection.topics),
        "recordings": [_name_of(recording) for recording in recordings],
        "losses": [asdict(loss) for loss in result.losses],
    }
    for loss in result.losses:
        note(f"Lost: {loss.file}: {loss.reason}")
    rows = [
        ("file", str(result.path)),
        ("size", size(result.size_bytes)),
        ("messages", result.message_count),
        ("latched", result.latched_count or None),
        ("start", instant(start_ns)),
        ("span", span(start_ns, end_ns)),
    ]
    return Output(document, lambda: details(rows))
