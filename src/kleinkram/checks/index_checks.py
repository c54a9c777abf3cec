"""Checks that read no message: what the indexes of the files say, against the rules of `checks.yaml`.

Pure. The server makes them for all missions of a project whenever its file of checks changes, so a mission with 40
topics must take a few milliseconds.

A check that fails only because something is not known (a file that was not read, a clock that was set while it
recorded) is `not_made`, with the reason.
"""

from collections.abc import Iterator, Sequence, Set
from dataclasses import dataclass

from kleinkram.checks.content.families import (
    TopicOfRecording,
    optional_topics,
    planned_rules,
    unmade_checks,
    why_none,
)
from kleinkram.checks.document import ClockRule, CountRange, FileRule, Profile, RecordingRule, Rule, TopicRule
from kleinkram.checks.facts import FileFacts, MissionFacts, RecordingFacts, TopicFacts
from kleinkram.checks.globs import Comparisons, glob_matcher, path_matches
from kleinkram.checks.outcomes import Measured, against, collect, failed, hertz, make_check, percent, seconds, size
from kleinkram.contract.checks import Check, CheckStatus
from kleinkram.recordings.model import Content, counted

_UNREAD = frozenset((None, Content.pending, Content.error))
_DAMAGED = frozenset((Content.recovered, Content.broken))
_MAX_NAMED = 3


def check_index(profiles: Sequence[Profile], facts: MissionFacts) -> list[Check]:
    """Return the outcomes of the checks that need no message, worst first, at most `MAX_CHECKS`.

    `results.evaluate_index` adds the checks that need messages, and the verdict.
    """
    return collect(index_checks(profiles, facts)).checks


def index_checks(profiles: Sequence[Profile], facts: MissionFacts) -> Iterator[Check]:
    """Yield the outcomes of the checks that need no message, in the order of the rules; there may be very many."""
    index = _Index(facts, optional_topics(profiles))
    for profile in profiles:
        for glob, file_rules in profile.files.items():
            for file_rule in file_rules:
                yield from _check_files(glob, file_rule, index)
        for glob, recording_rules in profile.recordings.items():
            for recording_rule in recording_rules:
                yield from _check_recordings(glob, recording_rule, index)
        for glob, topic_rules in profile.topics.items():
            for topic_rule in topic_rules:
                yield from _check_topics(glob, topic_rule, index)
        for glob, clock_rules in profile.clocks.items():
            for clock_rule in clock_rules:
                yield from _check_clocks(glob, clock_rule, index)
    if profiles:
        yield from _unjudged_recordings(index)


def checks_needing_content(profiles: Sequence[Profile], facts: MissionFacts) -> Iterator[Check]:
    """Yield the checks that read messages: `needs_content`, or `not_made` if their rule applies to no topic."""
    unread = _Index(facts).unread
    topics = [
        TopicOfRecording(recording, topic.name, topic.message_type or "")
        for topic in facts.topics
        for recording in topic.recordings
    ]
    for planned in planned_rules(profiles, topics):
        if planned.topics:
            message = "it reads messages, and only the index was read"
            yield from unmade_checks(planned, CheckStatus.needs_content, message)
        else:
            message = why_none(planned) + (f", but {unread}" if unread else "")
            yield from unmade_checks(planned, CheckStatus.not_made, message)


class _Index:
    """Facts of a mission, prepared for rules.

    Attributes:
        unread: which files were not read, as a part of a sentence; None if all were.
        span_ns: of the mission; None if it is unknown or has no length.
        optional_topics: names and globs of topics that may be missing.
        judged: recordings and files of which a rule said whether they are complete, or that they need not be.
    """

    def __init__(self, facts: MissionFacts, optional: Set[str] = frozenset()) -> None:
        self.facts = facts
        self.optional_topics = optional
        self.judged: set[str] = set()
        unread = [*(recording.name for recording in facts.recordings if recording.content in _UNREAD)]
        self.unread = f"{_enumeration(unread)} {'was' if len(unread) == 1 else 'were'} not read" if unread else None
        self.span_ns = (
            facts.end_ns - facts.start_ns
            if facts.start_ns is not None and facts.end_ns is not None and facts.end_ns > facts.start_ns
            else None
        )
        self._jumped = {
            recording.name
            for recording in facts.recordings
            if any(problem.code == "clock-jump" for problem in recording.problems)
        }
        self._bounded_gaps = {
            problem.where
            for recording in facts.recordings
            for problem in recording.problems
            if problem.code == "gaps-upper-bound"
        }
        self.topics_by_name: dict[str, list[TopicFacts]] = {}
        for topic in facts.topics:
            self.topics_by_name.setdefault(topic.name, []).append(topic)
        self._of_files = Comparisons([file.path for file in facts.files])
        self._of_recordings = Comparisons([name for recording in facts.recordings for name in _names_of(recording)])
        self._of_topics = Comparisons([topic.name for topic in facts.topics])

    def files_matching(self, glob: str) -> list[FileFacts]:
        """Raises TooManyComparisons, like the other methods that take a glob."""
        self._of_files.add(glob, 2)
        return [file for file in self.facts.files if path_matches(file.path, glob)]

    def recordings_matching(self, glob: str) -> list[RecordingFacts]:
        """Return recordings whose name or one of whose files matches: the recording `nuc` has the file `nuc/0.mcap`."""
        self._of_recordings.add(glob, 2)
        recordings = self.facts.recordings
        return [one for one in recordings if any(path_matches(name, glob) for name in _names_of(one))]

    def topics_matching(self, glob: str) -> list[TopicFacts]:
        matcher = glob_matcher(glob)
        if matcher is None:
            return self.topics_by_name.get(glob, [])
        self._of_topics.add(glob)
        return [topic for topic in self.facts.topics if matcher(topic.name)]

    def clock_doubt(self, topic: TopicFacts) -> str | None:
        """Return why the times of a topic are unreliable."""
        jumped = self._jumped.intersection(topic.recordings) if self._jumped else ()
        return _set_clock(min(jumped)) if jumped else None

    def recording_doubt(self, recording: RecordingFacts) -> str | None:
        """Return why the times of a recording are unreliable."""
        return _set_clock(recording.name) if recording.name in self._jumped else None

    def gap_doubt(self, topic: TopicFacts) -> str | None:
        """Return why the longest gap of a topic is unreliable."""
        if topic.name in self._bounded_gaps:
            return "the index gives only an upper bound, because the messages are far out of order"
        return self.clock_doubt(topic)


def _set_clock(recording: str) -> str:
    return f"the clock was set while {recording} was recorded"


@dataclass(frozen=True)
class _Outcomes:
    """Makes the rows of one rule about one subject."""

    rule: Rule
    topic: str | None = None
    file: str | None = None

    def ok(self, name: str, message: str, doubt: str | None = None, measured: Measured | None = None) -> Check:
        """Return a passed check; with `doubt`, one that could not be made."""
        if doubt is not None:
            return self.not_made(name, f"{message}, but {doubt}", measured=measured)
        return make_check(name, CheckStatus.ok, message, topic=self.topic, file=self.file, measured=measured)

    def fails(self, name: str, message: str, doubt: str | None = None, measured: Measured | None = None) -> Check:
        """Return a failed check; with `doubt`, one that could not be made."""
        if doubt is not None:
            return self.not_made(name, f"{message}, but {doubt}", measured=measured)
        return make_check(
            name, failed(self.rule.severity), message, topic=self.topic, file=self.file, measured=measured
        )

    def not_made(self, name: str, message: str, measured: Measured | None = None) -> Check:
        return make_check(name, CheckStatus.not_made, message, topic=self.topic, file=self.file, measured=measured)

    def count(self, name: str, number: int, allowed: CountRange, noun: str, doubt: str | None = None) -> Check:
        """Compare a number with its range; `doubt`: why there may be more."""
        text = counted(number, noun)
        if number < allowed.min:
            message = f"{text}; expected {_range_text(allowed)}"
            return self.fails(name, message, doubt, measured=Measured(number, allowed.min))
        if allowed.max is not None and number > allowed.max:
            return self.fails(name, f"{text}; expected {_range_text(allowed)}", measured=Measured(number, allowed.max))
        return self.ok(name, text, doubt if allowed.max is not None else None, Measured(number, allowed.min))

    def span(self, name: str, span_ns: int, limit_ns: int, what: str, doubt: str | None = None) -> Check:
        """Compare a span with its upper bound; `what` has `{}` for the span."""
        measured = Measured(span_ns / 1e9, limit_ns / 1e9, "s")
        if span_ns <= limit_ns:
            return self.ok(name, what.format(seconds(span_ns)), doubt, measured)
        value, limit = against(span_ns, limit_ns, seconds)
        return self.fails(name, f"{what.format(value)}; allowed are {limit}", doubt, measured=measured)

    def coverage(self, name: str, share: float, smallest: float, what: str, doubt: str | None = None) -> Check:
        measured = Measured(share, smallest)
        if share >= smallest:
            return self.ok(name, f"{what} {percent(share)} of the mission", doubt, measured)
        value, limit = against(share, smallest, percent)
        return self.fails(name, f"{what} {value} of the mission; expected at least {limit}", doubt, measured=measured)


def _range_text(allowed: CountRange) -> str:
    if allowed.max is None:
        return f"at least {allowed.min}"
    return f"{allowed.min}" if allowed.min == allowed.max else f"{allowed.min} to {allowed.max}"


# -- files ------------------------------------------------------------------------------------------------------------


def _check_files(glob: str, rule: FileRule, index: _Index) -> Iterator[Check]:
    files = index.files_matching(glob)
    outcomes = _Outcomes(rule, file=glob)
    if not files and rule.required:
        yield outcomes.fails("file.missing", f"no file matches {glob}")
        return
    yield outcomes.ok("file.missing", _match_text(len(files), "file", glob))
    if rule.count is not None:
        yield outcomes.count("file.count", len(files), rule.count, "file")
    if rule.complete:
        index.judged.update(file.path for file in files if file.content in _UNREAD | _DAMAGED)
        yield from _check_completeness(files, rule, outcomes)
    elif "complete" in rule.model_fields_set:
        index.judged.update(file.path for file in files)
    if rule.min_size is not None and files:
        small = [file for file in files if file.size_bytes < rule.min_size]
        for file in small:
            value, limit = against(file.size_bytes, rule.min_size, size)
            message = f"it has {value}; expected at least {limit}"
            measured = Measured(file.size_bytes, rule.min_size, "B")
            yield _Outcomes(rule, file=file.path).fails("file.size", message, measured=measured)
        if not small:
            smallest = min(file.size_bytes for file in files)
            measured = Measured(smallest, rule.min_size, "B")
            yield outcomes.ok("file.size", f"the smallest has {size(smallest)}", measured=measured)


def _check_completeness(files: Sequence[FileFacts], rule: FileRule, all_files: _Outcomes) -> Iterator[Check]:
    """Yield a row for each file that is not complete, or one for all."""
    complete_count = other_count = 0
    for file in files:
        outcomes = _Outcomes(rule, file=file.path)
        if file.content in _UNREAD:
            yield outcomes.not_made("file.incomplete", file.reason or "it was not read")
        elif file.content in _DAMAGED:
            yield outcomes.fails("file.incomplete", file.reason or "it is damaged")
        elif file.content is Content.indexed:
            complete_count += 1
        else:
            other_count += 1
    if complete_count + other_count == len(files):
        yield all_files.ok("file.incomplete", f"{counted(complete_count, 'recording')} complete")


def _match_text(number: int, noun: str, glob: str) -> str:
    if number == 0:
        return f"no {noun} matches {glob}, and none is required"
    return f"{counted(number, noun)} {'matches' if number == 1 else 'match'} {glob}"


# -- recordings -------------------------------------------------------------------------------------------------------


def _check_recordings(glob: str, rule: RecordingRule, index: _Index) -> Iterator[Check]:
    recordings = index.recordings_matching(glob)
    outcomes = _Outcomes(rule, file=glob)
    if not recordings and rule.required:
        names = [recording.name for recording in index.facts.recordings]
        there = f"; there {'is' if len(names) == 1 else 'are'} {_enumeration(names)}" if names else ""
        yield outcomes.fails("recording.missing", f"no recording matches {glob}{there}")
        return
    yield outcomes.ok("recording.missing", _match_text(len(recordings), "recording", glob))
    if rule.count is not None:
        yield outcomes.count("recording.count", len(recordings), rule.count, "recording")
    index.judged.update(recording.name for recording in recordings)
    for recording in recordings:
        yield from _check_recording(recording, rule, index)


def _unjudged_recordings(index: _Index) -> Iterator[Check]:
    """Yield a row for each recording that is not complete, and of which no rule says what that means."""
    for recording in index.facts.recordings:
        if recording.content is not Content.indexed and index.judged.isdisjoint(_names_of(recording)):
            outcomes = _Outcomes(RecordingRule(), file=recording.name)
            yield outcomes.not_made("recording.incomplete", _why_incomplete(recording))


def _names_of(recording: RecordingFacts) -> tuple[str, ...]:
    return (recording.name, *recording.paths)


def _enumeration(names: Sequence[str]) -> str:
    more = len(names) - _MAX_NAMED
    return ", ".join(names[:_MAX_NAMED]) + (f" and {more} more" if more > 0 else "")


def _check_recording(recording: RecordingFacts, rule: RecordingRule, index: _Index) -> Iterator[Check]:
    outcomes = _Outcomes(rule, file=recording.name)
    if rule.complete:
        yield _check_recording_is_complete(recording, outcomes)
    facts = index.facts
    bounds = {
        "recording.coverage": rule.covers,
        "recording.start_skew": rule.max_start_skew,
        "recording.end_skew": rule.max_end_skew,
    }
    if recording.start_ns is None or recording.end_ns is None or facts.start_ns is None or facts.end_ns is None:
        why = recording.reason or "it has no messages"
        yield from (outcomes.not_made(name, why) for name, bound in bounds.items() if bound is not None)
        return
    doubt = index.recording_doubt(recording)
    if rule.covers is not None:
        shared_ns = min(recording.end_ns, facts.end_ns) - max(recording.start_ns, facts.start_ns)
        share = max(0, shared_ns) / index.span_ns if index.span_ns else 1.0
        yield outcomes.coverage("recording.coverage", share, rule.covers, "it covers", doubt)
    if rule.max_start_skew is not None:
        skew_ns = recording.start_ns - facts.start_ns
        what = "it starts {} after the mission" if skew_ns >= 0 else "it starts {} before the mission: its clock is off"
        yield outcomes.span("recording.start_skew", abs(skew_ns), rule.max_start_skew, what, doubt)
    if rule.max_end_skew is not None:
        skew_ns = facts.end_ns - recording.end_ns
        what = "it ends {} before the mission" if skew_ns >= 0 else "it ends {} after the mission: its clock is off"
        yield outcomes.span("recording.end_skew", abs(skew_ns), rule.max_end_skew, what, doubt)


def _check_recording_is_complete(recording: RecordingFacts, outcomes: _Outcomes) -> Check:
    if recording.content in _UNREAD:
        return outcomes.not_made("recording.incomplete", _why_incomplete(recording))
    if recording.content is Content.indexed:
        return outcomes.ok("recording.incomplete", "complete")
    return outcomes.fails("recording.incomplete", _why_incomplete(recording))


def _why_incomplete(recording: RecordingFacts) -> str:
    if recording.reason:
        return recording.reason
    if recording.content in _UNREAD:
        return "it was not read"
    return "it is not a recording" if recording.content is Content.opaque else "it is damaged"


# -- topics -----------------------------------------------------------------------------------------------------------


def _check_topics(glob: str, rule: TopicRule, index: _Index) -> Iterator[Check]:
    matching = topics = index.topics_matching(glob)
    if rule.recording is not None:
        names = {recording.name for recording in index.recordings_matching(rule.recording)}
        topics = [topic for topic in topics if not names.isdisjoint(topic.recordings)]
    filled = [topic for topic in topics if topic.count != 0]
    outcomes = _Outcomes(rule, topic=glob)
    if not filled and rule.required:
        yield outcomes.fails("topic.missing", _why_missing(glob, rule, matching), index.unread)
        return
    yield outcomes.ok("topic.missing", _found_text(filled, glob))
    for topic in topics if rule.required else filled:
        yield from _check_topic(topic, rule, index)
    if rule.count is not None and not rule.required:
        for topic in topics:
            if topic.count == 0:
                yield _Outcomes(rule, topic=topic.name).count("topic.count", 0, rule.count, "message", index.unread)


def _why_missing(glob: str, rule: TopicRule, topics: Sequence[TopicFacts]) -> str:
    recordings = dict.fromkeys(name for topic in topics for name in topic.recordings)
    if rule.recording is not None and recordings:
        return f"it is in {', '.join(recordings)}, but in no recording that matches {rule.recording}"
    if topics and len({topic.name for topic in topics}) == 1:
        return "it is defined, but has no message"
    if topics:
        return f"the topics that match {glob} have no message"
    return "it is not recorded" if glob_matcher(glob) is None else f"no topic matches {glob}"


def _found_text(topics: Sequence[TopicFacts], glob: str) -> str:
    if topics and all(topic.name == glob for topic in topics):  # several, if its types differ
        counts = [topic.count for topic in topics]
        return "it is recorded" if None in counts else counted(sum(count or 0 for count in counts), "message")
    return _match_text(len(topics), "topic", glob)


def _check_topic(topic: TopicFacts, rule: TopicRule, index: _Index) -> Iterator[Check]:
    outcomes = _Outcomes(rule, topic=topic.name)
    doubt = index.clock_doubt(topic)
    if rule.type is not None:
        yield _check_type(topic, rule.type, outcomes)
    if rule.rate is not None:
        yield _check_rate(topic, rule.rate, rule.tolerance, outcomes, doubt)
    if rule.max_gap is not None:
        yield _check_gap(topic, rule.max_gap, outcomes, index)
    if rule.count is not None:
        if topic.count is None:
            yield outcomes.not_made("topic.count", "its number of messages is not known")
        else:
            yield outcomes.count("topic.count", topic.count, rule.count, "message", index.unread)
    yield from _check_times(topic, rule, outcomes, index)


def _check_type(topic: TopicFacts, expected: str, outcomes: _Outcomes) -> Check:
    if topic.message_type is None:
        return outcomes.not_made("topic.type", "its type is not known")
    if topic.message_type.replace("/msg/", "/") == expected.replace("/msg/", "/"):
        return outcomes.ok("topic.type", topic.message_type)
    return outcomes.fails("topic.type", f"its type is {topic.message_type}; expected {expected}")


def _check_rate(
    topic: TopicFacts, expected_hz: float, tolerance: float, outcomes: _Outcomes, doubt: str | None
) -> Check:
    lowest, highest = expected_hz * (1 - tolerance), expected_hz * (1 + tolerance)
    expected = f"expected {hertz(expected_hz)} ± {percent(tolerance)}"
    if topic.count is not None and topic.count < 2:
        return outcomes.fails("topic.rate", f"{_count_text(topic.count)}; {expected}")
    rate_hz = topic.rate_hz
    if rate_hz is None:
        return outcomes.not_made("topic.rate", f"its rate is not known; {expected}")
    limit = lowest if rate_hz <= expected_hz else highest
    measured = Measured(rate_hz, limit, "Hz")
    # Rates are quotients; one that is at the bound must not fail by rounding.
    if lowest * (1 - 1e-9) <= rate_hz <= highest * (1 + 1e-9):
        return outcomes.ok("topic.rate", f"{hertz(rate_hz)}; {expected}", doubt, measured)
    return outcomes.fails("topic.rate", f"{hertz(rate_hz)}; {expected}", doubt, measured=measured)


def _count_text(count: int) -> str:
    return "no message" if count == 0 else counted(count, "message")


def _check_gap(topic: TopicFacts, limit_ns: int, outcomes: _Outcomes, index: _Index) -> Check:
    if topic.count == 0:
        return outcomes.fails("topic.gap", f"no message; allowed are gaps of {seconds(limit_ns)}")
    if topic.longest_gap_ns is not None:
        doubt = index.gap_doubt(topic) if topic.longest_gap_ns > limit_ns else index.clock_doubt(topic)
        return outcomes.span("topic.gap", topic.longest_gap_ns, limit_ns, "longest gap {}", doubt)
    if topic.count == 1:
        return outcomes.not_made("topic.gap", "1 message, which makes no gap")
    return outcomes.not_made("topic.gap", "its longest gap is not known")


def _check_times(topic: TopicFacts, rule: TopicRule, outcomes: _Outcomes, index: _Index) -> Iterator[Check]:
    """Compare the first and last message with the mission's span."""
    facts = index.facts
    bounds = {
        "topic.coverage": rule.covers,
        "topic.silent_start": rule.max_silence_at_start,
        "topic.silent_end": rule.max_silence_at_end,
    }
    names = [name for name, bound in bounds.items() if bound is not None]
    if not names:
        return
    if topic.count == 0:
        yield from (outcomes.fails(name, "no message", index.unread) for name in names)
        return
    if topic.first_ns is None or topic.last_ns is None or facts.start_ns is None or facts.end_ns is None:
        yield from (outcomes.not_made(name, "its times are not known") for name in names)
        return
    doubt = index.clock_doubt(topic) or index.unread
    if rule.covers is not None:
        share = (topic.last_ns - topic.first_ns) / index.span_ns if index.span_ns else 1.0
        yield outcomes.coverage("topic.coverage", share, rule.covers, "its messages cover", doubt)
    if rule.max_silence_at_start is not None:
        what = "first message {} after the start of the mission"
        silence_ns = max(0, topic.first_ns - facts.start_ns)
        yield outcomes.span("topic.silent_start", silence_ns, rule.max_silence_at_start, what, doubt)
    if rule.max_silence_at_end is not None:
        what = "last message {} before the end of the mission"
        silence_ns = max(0, facts.end_ns - topic.last_ns)
        yield outcomes.span("topic.silent_end", silence_ns, rule.max_silence_at_end, what, doubt)


# -- clocks -----------------------------------------------------------------------------------------------------------


def _check_clocks(glob: str, rule: ClockRule, index: _Index) -> Iterator[Check]:
    """Yield a row for each recording that has topics of the rule."""
    if not rule.no_jump:
        return
    topics = index.topics_matching(glob)
    names = {name for topic in topics for name in topic.recordings}
    topic_names = {topic.name for topic in topics}
    recordings = [recording for recording in index.facts.recordings if recording.name in names]
    for recording in recordings:
        outcomes = _Outcomes(rule, file=recording.name)
        jumps = [problem for problem in recording.problems if problem.code == "clock-jump"]
        # A problem is of one topic, or of several, or of all topics of a file.
        ours = [jump for jump in jumps if jump.where not in index.topics_by_name or jump.where in topic_names]
        if ours:
            yield outcomes.fails("clock.jump", f"{ours[0].where}: {ours[0].message}")
        elif recording.content in _UNREAD:
            yield outcomes.not_made("clock.jump", recording.reason or "it was not read")
        else:
            yield outcomes.ok("clock.jump", "log times do not jump back")
    if not recordings and glob not in index.optional_topics:
        message = f"no topic with messages matches {glob}"
        unread = f", but {index.unread}" if index.unread else ""
        yield _Outcomes(rule, topic=glob).not_made("clock.jump", message + unread)
