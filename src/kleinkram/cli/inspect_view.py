"""What `klein inspect` shows to a person."""

from collections.abc import Iterable
from pathlib import Path

from kleinkram.cli.render import details, escape, line, table
from kleinkram.cli.units import count, duration, instant, rate, size, span
from kleinkram.recordings.inspect import Inspection
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
