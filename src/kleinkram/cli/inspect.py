"""`klein inspect`: what is in local recordings."""

import contextlib
import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kleinkram.cli.errors import ExitCode
from kleinkram.cli.options import AsJson
from kleinkram.cli.render import details, escape, line, note, show_json, table
from kleinkram.cli.units import count, duration, instant, rate, size, span
from kleinkram.client.errors import InvalidInput
from kleinkram.recordings.inspect import Inspection, ScanProgress, inspect_paths, to_plain
from kleinkram.recordings.model import (
    Content,
    Depth,
    Fact,
    Lost,
    Problem,
    RecordingFormat,
    RecordingSummary,
    TopicSummary,
)

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID


@contextlib.contextmanager
def watching(deep: bool) -> Iterator[ScanProgress | None]:
    """Show a bar for each file that is scanned, for as long as it is."""
    if not deep or not sys.stderr.isatty():
        yield None
        return
    # Slow to import, and only for this.
    from rich.console import Console
    from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TimeRemainingColumn, TransferSpeedColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        DownloadColumn(),
        TransferSpeedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        yield _Bar(progress)


class _Bar:
    """The bar of the file that is being read."""

    def __init__(self, progress: "Progress") -> None:
        self._progress = progress
        self._task: TaskID | None = None

    def began(self, path: str, size_bytes: int) -> None:
        """Show a bar for the next file."""
        from rich.markup import escape as escape_markup

        self._task = self._progress.add_task(escape_markup(escape(path)), total=size_bytes)

    def moved(self, size_bytes: int) -> None:
        """Move the bar on."""
        if self._task is not None:
            self._progress.advance(self._task, size_bytes)

    def ended(self) -> None:
        """Take the bar away."""
        if self._task is not None:
            self._progress.remove_task(self._task)
            self._task = None


_WORDS = {
    Content.indexed: "whole",
    Content.recovered: "damaged, read as far as it can be",
    Content.broken: "nothing of it can be read",
    Content.pending: "not read yet",
    Content.opaque: "not a recording",
    Content.error: "could not be read",
}


def show(one: Inspection) -> None:
    """Print what is in one file or recording: what it is, its topics, and what a person should know."""
    summary = one.summary
    details(
        [
            (one.kind.value, one.path),
            ("files", [Path(member).name for member in one.members] if len(one.members) > 1 else None),
            ("format", _format(summary)),
            ("content", _content(summary)),
            ("reason", summary.reason),
            ("lost", _lost(summary)),
            ("messages", _messages(summary)),
            ("start", instant(summary.start_ns)),
            ("span", span(summary.start_ns, summary.end_ns)),
            ("written by", ", ".join(text for text in (summary.library, summary.profile) if text)),
            *_facts(summary.facts),
        ]
    )
    if summary.topics:
        line("")
        _show_topics(summary.topics)
    if summary.problems:
        line("")
        _show_problems(summary.problems)


def _format(summary: RecordingSummary) -> str:
    compression = ", ".join(name for name in summary.compression if name != "none")
    return f"{summary.format.value} ({compression})" if compression else summary.format.value


def _content(summary: RecordingSummary) -> str:
    checked = ", every byte checked" if summary.depth is Depth.scan and summary.content is Content.indexed else ""
    return f"{summary.content.value} ({_WORDS[summary.content]}{checked})"


def _lost(summary: RecordingSummary) -> str | None:
    lost = summary.lost
    if lost is None:
        return None
    if lost == Lost(0, 0, 0):
        return "nothing"
    # A database has pages where others have chunks.
    piece = "page" if summary.format is RecordingFormat.rosbag2_db3 else "chunk"
    parts = [count(lost.messages, "message") if lost.messages is not None else "messages, nobody knows how many"]
    if lost.chunks:
        parts.append(f"{lost.chunks} {piece}{'' if lost.chunks == 1 else 's'}")
    if lost.bytes:
        parts.append(f"{size(lost.bytes)}")
    return ", ".join(parts)


def _messages(summary: RecordingSummary) -> str | None:
    if summary.message_count is None:
        return None
    count = len(summary.topics)
    return f"{summary.message_count} in {count} {'topic' if count == 1 else 'topics'}"


def _facts(facts: Iterable[Fact]) -> list[tuple[str, object]]:
    """Return facts as properties: those of one name in one line."""
    by_name: dict[str, list[str]] = {}
    for fact in facts:
        value = f"{fact.value} {fact.unit}".strip()
        by_name.setdefault(fact.name.replace("_", " "), []).append(value)
    return [*by_name.items()]


def _show_topics(topics: Iterable[TopicSummary]) -> None:
    topics = tuple(topics)
    is_disordered = any(topic.out_of_order_count for topic in topics)
    headers = ["topic", "type", "count", "rate", "longest gap", "head gap", "tail gap"]
    rows = [
        [
            topic.name,
            topic.message_type or None,
            topic.count,
            rate(topic.rate_hz),
            duration(topic.longest_gap_ns),
            duration(topic.head_gap_ns),
            duration(topic.tail_gap_ns),
            *([topic.out_of_order_count] if is_disordered else []),
        ]
        for topic in topics
    ]
    table([*headers, "out of order"] if is_disordered else headers, rows)


def _show_problems(problems: Iterable[Problem]) -> None:
    """Print what a person should know, a line each: where, and what."""
    line("To know:")
    for problem in problems:
        line(f"  {escape(problem.where)}: {escape(problem.message)}")


def inspect(
    paths: Annotated[list[str], typer.Argument(metavar="PATH", help="Files and folders.", show_default=False)],
    deep: Annotated[
        bool, typer.Option("--deep", help="Read every byte: check all checksums, save what can be saved.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Say what is in local recordings: topics, types, counts, times, rates and gaps. Needs no server.

    A broken file is an answer too: exit code 0. Exit code 8 if a file or folder cannot be read, 2 if a path does not
    exist.
    """
    try:
        with watching(deep) as watch:
            found = inspect_paths(paths, depth=Depth.scan if deep else Depth.summary, progress=watch)
    except FileNotFoundError as error:
        raise InvalidInput(what=f"The path {error.filename}", reason="there is no such file or folder") from error
    if as_json:
        show_json({"items": [to_plain(one) for one in found]})
    else:
        _show_all(found)
    unreadable = [one for one in found if one.summary.content is Content.error]
    for one in unreadable:
        note(escape(one.summary.reason or one.path))
    if unreadable:
        raise typer.Exit(ExitCode.local_file)


def _show_all(found: Sequence[Inspection]) -> None:
    if not found:
        note("There are no recordings in it.")
    for number, one in enumerate(found):
        if number:
            line("")
        show(one)
