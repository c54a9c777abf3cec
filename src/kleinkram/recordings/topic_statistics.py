"""Topic summaries from a timeline, quality warnings, and the wording of problems."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from typing import NamedTuple

from kleinkram.recordings.density import add_up, most_bins
from kleinkram.recordings.errors import Malformed
from kleinkram.recordings.limits import MAX_PROBLEMS
from kleinkram.recordings.message_counts import Lateness
from kleinkram.recordings.model import (
    Content,
    Lost,
    Problem,
    RecordingFormat,
    RecordingSummary,
    TopicSummary,
    counted,
    span_text,
)
from kleinkram.recordings.timeline import Jump, StampRun, Timeline, TopicTimes, bulk, within

_HOUR_NS = 3600 * 10**9


class TopicType(NamedTuple):
    """The type and encodings of a channel or connection."""

    message_type: str
    schema_encoding: str
    message_encoding: str


@dataclass(frozen=True)
class Measured:
    """The topics of a file, and its span."""

    topics: tuple[TopicSummary, ...]
    message_count: int
    start_ns: int | None
    end_ns: int | None
    problems: tuple[Problem, ...]


def measure(timeline: Timeline, types: Mapping[str, Sequence[TopicType]]) -> Measured:
    """Return the topics of a settled timeline. `types`: the distinct types of each topic, in file order."""
    island = bulk(run for times in timeline.topics.values() for run in times.runs)
    topics: list[TopicSummary] = []
    problems: list[Problem] = []
    for name in sorted(timeline.topics):
        times = timeline.topics[name]
        run = within(times.runs, island)
        topic = _summarise_topic(name, types[name][0], times, run, island, most_bins(len(timeline.topics)))
        topics.append(topic)
        problems += _problems_of_topic(topic, types[name], times)
    jumps = {name: times.jump for name, times in timeline.topics.items() if times.jump is not None}
    problems += clock_jump_problems(jumps)
    # The silence that a jump of the clock leaves is none.
    longest_ns = min((jump.before_ns - jump.after_ns for jump in jumps.values()), default=None)
    longest_ns = longest_ns // 2 if longest_ns is not None else None
    span_ns = island.last_ns - island.first_ns if island else None
    return Measured(
        topics=tuple(topics),
        message_count=sum(times.count for times in timeline.topics.values()),
        start_ns=island.first_ns if island else None,
        end_ns=island.last_ns if island else None,
        problems=(*problems, *find_quality_warnings(topics, span_ns, longest_silence_ns=longest_ns)),
    )


def _summarise_topic(
    name: str, kind: TopicType, times: TopicTimes, run: StampRun | None, island: StampRun | None, bins: int
) -> TopicSummary:
    return TopicSummary(
        name=name,
        message_type=kind.message_type,
        schema_name=kind.message_type,
        schema_encoding=kind.schema_encoding,
        message_encoding=kind.message_encoding,
        count=times.count,
        first_ns=run.first_ns if run else None,
        last_ns=run.last_ns if run else None,
        rate_hz=rate_hz(run.count, run.first_ns, run.last_ns) if run else None,
        longest_gap_ns=run.longest_gap_ns if run and run.count > 1 else None,
        head_gap_ns=run.first_ns - island.first_ns if run and island else None,
        tail_gap_ns=island.last_ns - run.last_ns if run and island else None,
        out_of_order_count=times.out_of_order,
        stored_bytes=times.stored_bytes,
        suspect_count=times.count - (run.count if run else 0),
        density=add_up([run.density], most=bins) if run and run.density else None,
    )


def rate_hz(count: int, first_ns: int, last_ns: int) -> float | None:
    """Return (count - 1) / (last - first) in messages a second; None below two messages or without a span."""
    if count < 2 or last_ns <= first_ns:
        return None
    return (count - 1) * 1e9 / (last_ns - first_ns)


def _problems_of_topic(topic: TopicSummary, types: Sequence[TopicType], times: TopicTimes) -> list[Problem]:
    problems: list[Problem] = []
    if topic.suspect_count:
        stamped = counted(topic.suspect_count, "message is", "messages are")
        message = f"{stamped} stamped more than a year away from the rest; left out of the span"
        problems.append(Problem("suspect-stamps", topic.name, message))
    if times.gaps_are_upper_bounds:
        message = "its messages are too far out of order to determine the longest gap; the value is an upper bound"
        problems.append(Problem("gaps-upper-bound", topic.name, message))
    if len(types) > 1:
        names = ", ".join(kind.message_type or "(no type)" for kind in types)
        problems.append(Problem("topic-types-differ", topic.name, f"published with different types: {names}"))
    return problems


def pending(kind: RecordingFormat, size_bytes: int, why: str, problems: Sequence[Problem] = ()) -> RecordingSummary:
    """Return the summary of a recording that would have to be scanned."""
    reason = f"{why}; to know its content, all its {size_bytes} bytes must be read (a scan)"
    return RecordingSummary(kind, Content.pending, reason, problems=bounded(problems))


def clock_jump_problems(jumps: Mapping[str, Jump]) -> list[Problem]:
    """Report where the clock was set back, by the topic with the largest jump."""
    if not jumps:
        return []
    name, jump = max(jumps.items(), key=lambda item: item[1].before_ns - item[1].after_ns)
    back = f"log times jump back by {_span(jump.before_ns - jump.after_ns)} at {_time(jump.before_ns)}"
    reader = f", and forward again at {_time(jump.return_ns)}" if jump.return_ns is not None else ""
    where = name if len(jumps) == 1 else f"{len(jumps)} topics"
    message = f"{back}{reader}: the clock was set while it recorded, so order, span and gaps are unreliable"
    return [Problem("clock-jump", where, message)]


def _span(time_ns: int) -> str:
    return f"{time_ns / _HOUR_NS:.3g} h" if time_ns > 0.9 * _HOUR_NS else f"{time_ns / 1e9:.1f} s"


def _time(stamp_ns: int) -> str:
    return f"{datetime.fromtimestamp(stamp_ns // 10**9, timezone.utc):%Y-%m-%dT%H:%M:%SZ}"


def publish_time_problems(lateness: Mapping[str, Lateness]) -> list[Problem]:
    """Report topics that were logged long before or after they were published."""
    problems = []
    for topic, late in sorted(lateness.items()):
        median_ns = sorted(late.sample)[len(late.sample) // 2]
        message = (
            f"{counted(late.count, 'message was', 'messages were')} logged more than 1 s away from their publish time: "
            f"typically {span_text(median_ns, '+')}, at most {span_text(late.largest_ns, '+')}"
        )
        problems.append(Problem("publish-time-differs", topic, message))
    return merge_similar(problems)


def duplicate_channel_problems(channels: Iterable[tuple[str, str, str]]) -> list[Problem]:
    """Report publishers with several channels of one topic and type.

    `channels`: topic, type and publisher of each.
    """
    counts = Counter(channel for channel in channels if channel[2])
    problems = []
    for (topic, _, publisher), count in sorted(counts.items()):
        if count > 1:
            message = f"{publisher} has {count} channels of it with the same type: its messages may be there twice"
            problems.append(Problem("doubled-channel", topic, message))
    return merge_similar(problems)


def describe_readable(messages: int, lost: Lost | None) -> str:
    """Describe what can be read of a damaged file, and what is lost."""
    readable = f"{counted(messages, 'message')} can be read"
    if lost is None:
        return readable
    if lost == Lost(0, 0, 0):
        return f"{readable}; nothing is lost"
    if lost == Lost(0, 0, None):
        return f"{readable}; whether more was recorded is unknown"
    parts = [f"{lost.bytes} bytes"]
    if lost.chunks:
        parts.insert(0, counted(lost.chunks, "chunk"))
    parts.append("an unknown number of messages" if lost.messages is None else counted(lost.messages, "message"))
    return f"{readable}; lost: {', '.join(parts)}"


def describe_damage(damage: Sequence[Malformed]) -> str:
    """Describe where a file is damaged: "at byte 5: …", "in the chunk at byte 5: …"."""
    first = damage[0]
    place = f"at {first.where}" if first.where.startswith("byte ") else f"in the {first.where}"
    more = f" (and {counted(len(damage) - 1, 'more damaged place')})" if len(damage) > 1 else ""
    return f"{place}: {first.message}{more}"


def bounded(problems: Sequence[Problem]) -> tuple[Problem, ...]:
    """Limit a list of problems to `MAX_PROBLEMS`."""
    if len(problems) <= MAX_PROBLEMS:
        return tuple(problems)
    left_out = len(problems) - MAX_PROBLEMS + 1
    return (
        *problems[: MAX_PROBLEMS - 1],
        Problem("more-problems", "file", f"{counted(left_out, 'more problem is', 'more problems are')} not listed"),
    )


_LEAST_MESSAGES = 10
_PERIODS = 10
_PERIODS_FOR_GAPS = 50
_LEAST_SILENCE_NS = 5_000_000_000
_SHARE_OF_SPAN = 10
_MOST_OF_A_KIND = 3
_MOST_NAMED = 5
_OF_ROS_ITSELF = frozenset(("/rosout", "/rosout_agg", "/parameter_events", "/events/write_split"))
"""Topics that speak when something happens, and are silent in the best of recordings."""


def find_quality_warnings(
    topics: Iterable[TopicSummary], span_ns: int | None, *, longest_silence_ns: int | None = None
) -> list[Problem]:
    """Return warnings about topics: silent, late, early or with long gaps; some of each kind.

    `span_ns`: of the whole recording. `longest_silence_ns`: what is longer is the clock's doing; None: nothing is.
    """
    silent, late, early, gaps = [], [], [], []
    for topic in topics if longest_silence_ns is None else (_credible(one, longest_silence_ns) for one in topics):
        if topic.name in _OF_ROS_ITSELF:
            continue
        if not topic.count:
            silent.append(Problem("silent-topic", topic.name, "it is defined, but has no message"))
        elif span_ns is not None and topic.rate_hz is not None and topic.count >= _LEAST_MESSAGES:
            late += _starts_late(topic, topic.rate_hz, span_ns)
            early += _stops_early(topic, topic.rate_hz, span_ns)
            gaps += _has_long_gap(topic, topic.rate_hz, span_ns)
    return [*merge_similar(silent), *merge_similar(late), *merge_similar(early), *merge_similar(gaps)]


def _credible(topic: TopicSummary, longest_ns: int) -> TopicSummary:
    """Return a topic without gaps that the clock caused."""
    head_ns, tail_ns, gap_ns = (
        None if silence_ns is None or silence_ns > longest_ns else silence_ns
        for silence_ns in (topic.head_gap_ns, topic.tail_gap_ns, topic.longest_gap_ns)
    )
    return replace(topic, head_gap_ns=head_ns, tail_gap_ns=tail_ns, longest_gap_ns=gap_ns)


def _starts_late(topic: TopicSummary, rate_hz: float, span_ns: int) -> list[Problem]:
    if not _is_long(topic.head_gap_ns, rate_hz, span_ns, _PERIODS):
        return []
    return [Problem("starts-late", topic.name, f"its first message comes {span_text(topic.head_gap_ns or 0)} late")]


def _stops_early(topic: TopicSummary, rate_hz: float, span_ns: int) -> list[Problem]:
    if not _is_long(topic.tail_gap_ns, rate_hz, span_ns, _PERIODS):
        return []
    message = f"its last message comes {span_text(topic.tail_gap_ns or 0)} before the end of the recording"
    return [Problem("stops-early", topic.name, message)]


def _has_long_gap(topic: TopicSummary, rate_hz: float, span_ns: int) -> list[Problem]:
    if not _is_long(topic.longest_gap_ns, rate_hz, span_ns, _PERIODS_FOR_GAPS):
        return []
    message = f"it is silent for {span_text(topic.longest_gap_ns or 0)} in between, at {rate_hz:.3g} Hz on average"
    return [Problem("long-gap", topic.name, message)]


def merge_similar(problems: Sequence[Problem], what: str = "topics") -> list[Problem]:
    """Merge problems of one kind into one, if there are more than three."""
    if len(problems) <= _MOST_OF_A_KIND:
        return list(problems)
    first = problems[0]
    others = ", ".join(problem.where for problem in problems[1 : _MOST_NAMED + 1])
    more = ", ..." if len(problems) > _MOST_NAMED + 1 else ""
    message = f"{first.where}: {first.message}; likewise {others}{more}"
    return [Problem(first.code, f"{len(problems)} {what}", message)]


def _is_long(silence_ns: int | None, rate_hz: float, span_ns: int, periods: int) -> bool:
    if silence_ns is None:
        return False
    return silence_ns > max(periods * 1e9 / rate_hz, _LEAST_SILENCE_NS, span_ns // _SHARE_OF_SPAN)
