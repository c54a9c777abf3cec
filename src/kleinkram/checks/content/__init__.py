"""Checks of the content of messages: images, clocks, inertial measurements, positions, and more.

Only the segments (chunks) that samples need are read, each once. The memory is that of a segment and of numbers about
the messages. Reading needs the extra `reading`; without it, every check is not made and says so.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from itertools import islice
from typing import TYPE_CHECKING

from kleinkram.checks.content.families import (
    PlannedRule,
    TopicOfRecording,
    planned_rules,
    unmade_checks,
    why_none,
)
from kleinkram.checks.document import Profile
from kleinkram.checks.outcomes import LEFT_OUT, ShowProgress, make_check, show_nothing
from kleinkram.contract.checks import MAX_CHECKS, Check, CheckStatus

if TYPE_CHECKING:
    from kleinkram.recordings.recording import Recording

__all__ = ["OpenRecording", "TopicOfRecording", "check_content"]


@dataclass(frozen=True)
class OpenRecording:
    """A recording of the mission.

    `name`: as in `RecordingFacts`, different for each. `recording`: None if it could not be opened, for `reason`.
    """

    name: str
    recording: Recording | None
    reason: str | None = None


def check_content(
    profiles: Sequence[Profile],
    recordings: Sequence[OpenRecording],
    *,
    budget_bytes: int | None = None,
    show: ShowProgress = show_nothing,
) -> list[Check]:
    """Return the checks that read messages: first those that apply to no topic, then the others in their order.

    At most `MAX_CHECKS` topics of rules are checked; a last row has the number of the others.

    Args:
        profiles: those that apply to the mission.
        recordings: opened; they stay open.
        budget_bytes: about how many bytes of segments are read at most; None: 64 MB, of larger missions 4 %. Within
            it, all messages of the topics are read if they are not too many, else samples.
        show: progress by recordings.
    """
    topics = [
        TopicOfRecording(item.name, topic.name, topic.message_type)
        for item in recordings
        if item.recording is not None
        for topic in item.recording.topics
    ]
    rules, left_out = _bounded(planned_rules(profiles, topics))
    rows = list(islice(_unplanned(rules, recordings), MAX_CHECKS))
    opened = {item.name: item.recording for item in recordings if item.recording is not None}
    rows += _made([planned for planned in rules if planned.topics], opened, budget_bytes, show)
    if left_out:
        message = f"{left_out} topics of rules were left out: at most {MAX_CHECKS} are checked"
        rows.append(make_check(LEFT_OUT, CheckStatus.not_made, message))
    return rows


def _made(
    rules: Sequence[PlannedRule], recordings: dict[str, Recording], budget_bytes: int | None, show: ShowProgress
) -> list[Check]:
    if not rules:
        return []
    try:
        for library in ("numpy", "PIL"):
            import_module(library)
    except ImportError as error:
        from kleinkram.recordings.decoding import ReadingExtraMissing  # reading is not needed to list checks

        message = str(ReadingExtraMissing("pillow" if error.name == "PIL" else error.name or "numpy"))
        return [row for rule in rules for row in unmade_checks(rule, CheckStatus.not_made, message)]
    from kleinkram.checks.content.run import run_checks  # imports numpy

    return run_checks(rules, recordings, budget_bytes, show)


def _bounded(rules: Iterator[PlannedRule]) -> tuple[list[PlannedRule], int]:
    """Return the rules without the topics beyond the limit, and how many topics were left out."""
    bounded: list[PlannedRule] = []
    room, left_out = MAX_CHECKS, 0
    for planned in rules:
        topics = planned.topics[:room]
        left_out += len(planned.topics) - len(topics)
        if topics or not planned.topics:
            bounded.append(planned._replace(topics=topics))
        room -= len(topics)
    return bounded, left_out


def _unplanned(rules: Sequence[PlannedRule], recordings: Sequence[OpenRecording]) -> Iterator[Check]:
    """Yield the checks of rules that apply to no topic, and of recordings that could not be opened."""
    unopened = [item for item in recordings if item.recording is None]
    for planned in rules:
        if not planned.topics:
            message = why_none(planned)
            if unopened:
                message = f"{message}; {unopened[0].name} could not be read: {unopened[0].reason}"
            yield from unmade_checks(planned, CheckStatus.not_made, message)
            continue
        for item in unopened:
            message = f"{item.name} could not be read: {item.reason}"
            yield from unmade_checks(planned._replace(topics=[]), CheckStatus.not_made, message, item.name)
