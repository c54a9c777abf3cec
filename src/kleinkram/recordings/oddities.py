"""What is odd about the topics of a readable recording: sensors that died, started late, or never spoke.

Only what a person would want to be told. A topic with one or two messages (latched, static) is never late or early, and
one that speaks rarely has long pauses by nature: a silence counts from ten of the topic's own periods on.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from kleinkram.recordings.model import Problem, TopicSummary, span_text

_LEAST_MESSAGES = 10
_PERIODS = 10
_PERIODS_FOR_GAPS = 50
_LEAST_SILENCE_NS = 5_000_000_000
_SHARE_OF_SPAN = 10
_MOST_OF_A_KIND = 3
_MOST_NAMED = 5
_OF_ROS_ITSELF = frozenset(("/rosout", "/rosout_agg", "/parameter_events", "/events/write_split"))
"""Topics that speak when something happens, and are silent in the best of recordings."""


def name_oddities(
    topics: Iterable[TopicSummary], span_ns: int | None, *, longest_silence_ns: int | None = None
) -> list[Problem]:
    """Return what is odd, of each kind at most a few.

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
    return [*gathered(silent), *gathered(late), *gathered(early), *gathered(gaps)]


def _credible(topic: TopicSummary, longest_ns: int) -> TopicSummary:
    """Return a topic without the silences that are too long to be any."""
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


def gathered(problems: Sequence[Problem], what: str = "topics") -> list[Problem]:
    """Put what is said of more than a few topics, or of more than a few of `what`, into one problem."""
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
