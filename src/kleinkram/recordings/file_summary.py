"""Builds the summary of one file from the log times of its topics: rates, gaps, quality warnings and problems."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from datetime import datetime, timezone
from typing import NamedTuple

from kleinkram.recordings import model
from kleinkram.recordings.limits import MAX_PROBLEMS
from kleinkram.recordings.message_density import add_up, bins_per_topic
from kleinkram.recordings.model import Content, Problem, RecordingFormat, RecordingSummary, TopicSummary, counted
from kleinkram.recordings.scanned_messages import Lateness
from kleinkram.recordings.timeline import Jump, StampSpan, Timeline, TopicTimes, main_cluster, span_in_cluster

_HOUR_NS = 3600 * 10**9


class TopicType(NamedTuple):
    """The type and encodings of a channel or connection."""

    message_type: str
    schema_encoding: str
    message_encoding: str


def types_by_topic(channels: Iterable[tuple[str, TopicType]]) -> dict[str, list[TopicType]]:
    """Return the distinct types of each topic, in file order."""
    types: dict[str, dict[TopicType, None]] = {}
    for topic, kind in channels:
        types.setdefault(topic, {})[kind] = None
    return {topic: list(kinds) for topic, kinds in types.items()}


def build_summary(
    kind: RecordingFormat,
    timeline: Timeline,
    types: Mapping[str, Sequence[TopicType]],
    problems: Iterable[Problem] = (),
) -> RecordingSummary:
    """Return the summary of an undamaged file by a finished timeline; `types` as in `types_by_topic`."""
    cluster = main_cluster(span for times in timeline.topics.values() for span in times.spans)
    bins = bins_per_topic(len(timeline.topics))
    topics: list[TopicSummary] = []
    warnings: list[Problem] = []
    for name in sorted(timeline.topics):
        times = timeline.topics[name]
        span, first_type = span_in_cluster(times.spans, cluster), types[name][0]
        topic = TopicSummary(
            name=name,
            message_type=first_type.message_type,
            schema_name=first_type.message_type,
            schema_encoding=first_type.schema_encoding,
            message_encoding=first_type.message_encoding,
            count=times.count,
            out_of_order_count=times.out_of_order,
            stored_bytes=times.stored_bytes,
            suspect_count=times.count - (span.count if span else 0),
            density=add_up([span.density], max_bins=bins) if span and span.density else None,
        )
        topic = with_times(topic, span, cluster)
        topics.append(topic)
        warnings += _problems_of_topic(topic, types[name], times)
    jumps = {name: times.jump for name, times in timeline.topics.items() if times.jump is not None}
    warnings += _clock_jump_problems(jumps)
    # A clock jump leaves a gap in the log times that is not one of the messages.
    longest_ns = min(((jump.before_ns - jump.after_ns) // 2 for jump in jumps.values()), default=None)
    span_ns = cluster.last_ns - cluster.first_ns if cluster else None
    warnings += find_quality_warnings(topics, span_ns, longest_silence_ns=longest_ns)
    return RecordingSummary(
        kind,
        Content.indexed,
        message_count=sum(times.count for times in timeline.topics.values()),
        start_ns=cluster.first_ns if cluster else None,
        end_ns=cluster.last_ns if cluster else None,
        topics=tuple(topics),
        problems=bounded([*problems, *warnings]),
    )


def with_times(topic: TopicSummary, span: StampSpan | None, cluster: StampSpan | None) -> TopicSummary:
    """Return a topic with times, rate and gaps of its messages inside the cluster, which are a span."""
    if span is None or cluster is None:
        return topic
    span_ns = span.last_ns - span.first_ns
    return replace(
        topic,
        first_ns=span.first_ns,
        last_ns=span.last_ns,
        rate_hz=(span.count - 1) * 1e9 / span_ns if span.count > 1 and span_ns > 0 else None,
        longest_gap_ns=span.longest_gap_ns if span.count > 1 else None,
        head_gap_ns=span.first_ns - cluster.first_ns,
        tail_gap_ns=cluster.last_ns - span.last_ns,
    )


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


def _clock_jump_problems(jumps: Mapping[str, Jump]) -> list[Problem]:
    """Report where the clock was set back, by the topic with the largest jump."""
    if not jumps:
        return []
    name, jump = max(jumps.items(), key=lambda item: item[1].before_ns - item[1].after_ns)
    back_ns = jump.before_ns - jump.after_ns
    span = f"{back_ns / _HOUR_NS:.3g} h" if back_ns > 0.9 * _HOUR_NS else f"{back_ns / 1e9:.1f} s"
    forward = f", and forward again at {_time(jump.return_ns)}" if jump.return_ns is not None else ""
    where = name if len(jumps) == 1 else f"{len(jumps)} topics"
    message = (
        f"log times jump back by {span} at {_time(jump.before_ns)}{forward}: the clock was set while it recorded, "
        "so order, span and gaps are unreliable"
    )
    return [Problem("clock-jump", where, message)]


def _time(stamp_ns: int) -> str:
    return f"{datetime.fromtimestamp(stamp_ns // 10**9, timezone.utc):%Y-%m-%dT%H:%M:%SZ}"


def publish_time_problems(lateness: Mapping[str, Lateness]) -> list[Problem]:
    """Report topics that were logged long before or after they were published."""
    problems = []
    for topic, late in sorted(lateness.items()):
        median_ns = sorted(late.sample)[len(late.sample) // 2]
        message = (
            f"{counted(late.count, 'message was', 'messages were')} logged more than 1 s away from their publish time: "
            f"typically {model.span_text(median_ns, '+')}, at most {model.span_text(late.largest_ns, '+')}"
        )
        problems.append(Problem("publish-time-differs", topic, message))
    return merge_similar(problems)


def duplicate_channel_problems(channels: Iterable[tuple[str, str, str]]) -> list[Problem]:
    """Report publishers with several channels of one topic and type. `channels`: topic, type and publisher of each."""
    counts = Counter(channel for channel in channels if channel[2])
    problems = []
    for (topic, _, publisher), count in sorted(counts.items()):
        if count > 1:
            message = f"{publisher} has {count} channels of it with the same type: its messages may be there twice"
            problems.append(Problem("doubled-channel", topic, message))
    return merge_similar(problems)


def bounded(problems: Sequence[Problem]) -> tuple[Problem, ...]:
    """Limit a list of problems to `MAX_PROBLEMS`."""
    if len(problems) <= MAX_PROBLEMS:
        return tuple(problems)
    left_out = len(problems) - MAX_PROBLEMS + 1
    return (
        *problems[: MAX_PROBLEMS - 1],
        Problem("more-problems", "file", f"{counted(left_out, 'more problem is', 'more problems are')} not listed"),
    )


_MIN_MESSAGES = 10
_PERIODS = 10
_PERIODS_FOR_GAPS = 50
_MIN_SILENCE_NS = 5_000_000_000
_SHARE_OF_SPAN = 10
_MAX_OF_A_KIND = 3
_MAX_NAMED = 5
_EVENT_TOPICS = frozenset(("/rosout", "/rosout_agg", "/parameter_events", "/events/write_split"))
"""Topics with messages only on events; they may be empty in complete recordings."""


def find_quality_warnings(
    topics: Iterable[TopicSummary], span_ns: int | None, *, longest_silence_ns: int | None = None
) -> list[Problem]:
    """Return warnings about topics: silent, late, early or with long gaps; some of each kind.

    `span_ns`: of the recording. `longest_silence_ns`: the clock caused longer ones; None: no clock jump.
    """
    silent, late, early, gaps = [], [], [], []
    for topic in topics if longest_silence_ns is None else (_credible(one, longest_silence_ns) for one in topics):
        if topic.name in _EVENT_TOPICS:
            continue
        if not topic.count:
            silent.append(Problem("silent-topic", topic.name, "it is defined, but has no message"))
        elif span_ns is not None and topic.rate_hz is not None and topic.count >= _MIN_MESSAGES:
            rate = topic.rate_hz
            if _is_long(head_ns := topic.head_gap_ns or 0, rate, span_ns, _PERIODS):
                late.append(
                    Problem("starts-late", topic.name, f"its first message comes {model.span_text(head_ns)} late")
                )
            if _is_long(tail_ns := topic.tail_gap_ns or 0, rate, span_ns, _PERIODS):
                message = f"its last message comes {model.span_text(tail_ns)} before the end of the recording"
                early.append(Problem("stops-early", topic.name, message))
            if _is_long(gap_ns := topic.longest_gap_ns or 0, rate, span_ns, _PERIODS_FOR_GAPS):
                message = f"it is silent for {model.span_text(gap_ns)} in between, at {rate:.3g} Hz on average"
                gaps.append(Problem("long-gap", topic.name, message))
    return [problem for kind in (silent, late, early, gaps) for problem in merge_similar(kind)]


def _credible(topic: TopicSummary, longest_ns: int) -> TopicSummary:
    """Return a topic without gaps that the clock caused."""
    head_ns, tail_ns, gap_ns = (
        None if silence_ns is None or silence_ns > longest_ns else silence_ns
        for silence_ns in (topic.head_gap_ns, topic.tail_gap_ns, topic.longest_gap_ns)
    )
    return replace(topic, head_gap_ns=head_ns, tail_gap_ns=tail_ns, longest_gap_ns=gap_ns)


def merge_similar(problems: Sequence[Problem], what: str = "topics") -> list[Problem]:
    """Merge problems of one kind into one, if there are more than three."""
    if len(problems) <= _MAX_OF_A_KIND:
        return list(problems)
    first = problems[0]
    others = ", ".join(problem.where for problem in problems[1 : _MAX_NAMED + 1])
    more = ", ..." if len(problems) > _MAX_NAMED + 1 else ""
    message = f"{first.where}: {first.message}; likewise {others}{more}"
    return [Problem(first.code, f"{len(problems)} {what}", message)]


def _is_long(silence_ns: int, rate_hz: float, span_ns: int, periods: int) -> bool:
    return silence_ns > max(periods * 1e9 / rate_hz, _MIN_SILENCE_NS, span_ns // _SHARE_OF_SPAN)
