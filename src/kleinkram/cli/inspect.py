"""`klein inspect`"""

from typing import Annotated

import typer

from kleinkram.cli.options import AsJson
from kleinkram.cli.render import details, line, show_json, table
from kleinkram.cli.units import duration, instant, rate, span
from kleinkram.recordings.inspect import Inspection, inspect_paths, to_plain


def inspect(
    paths: Annotated[list[str], typer.Argument(metavar="PATH", help="Files and folders.", show_default=False)],
    as_json: AsJson = False,
) -> None:
    """Say what is in local recordings: topics, types, counts, times, rates and gaps. Needs no server."""
    found = inspect_paths(paths)
    if as_json:
        show_json({"items": [to_plain(one) for one in found]})
        return
    for number, one in enumerate(found):
        if number:
            line("")
        _show(one)


def _show(one: Inspection) -> None:
    summary = one.summary
    details(
        [
            (one.kind.value, one.path),
            ("files", [*one.members] if len(one.members) > 1 else None),
            ("format", summary.format.value),
            ("content", summary.content.value + (f": {summary.reason}" if summary.reason else "")),
            ("compression", [*summary.compression]),
            ("messages", summary.message_count),
            ("start", instant(summary.start_ns)),
            ("span", span(summary.start_ns, summary.end_ns)),
            *((f"problem at {problem.where}", problem.message) for problem in summary.problems),
        ]
    )
    if summary.topics:
        table(
            ["topic", "type", "count", "rate", "longest gap", "head gap", "tail gap"],
            [
                (
                    topic.name,
                    topic.message_type,
                    topic.count,
                    rate(topic.rate_hz),
                    duration(topic.longest_gap_ns),
                    duration(topic.head_gap_ns),
                    duration(topic.tail_gap_ns),
                )
                for topic in summary.topics
            ],
        )
