"""What the checks of a mission amount to: its verdict, with the checks, their numbers and the profiles applied."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from itertools import chain
from typing import TYPE_CHECKING

from pydantic import JsonValue

from kleinkram.checks.content.families import planned_rules
from kleinkram.checks.document import ChecksDocument, Profile, value_matches
from kleinkram.checks.facts import MissionFacts
from kleinkram.checks.index_checks import checks_needing_content, index_checks
from kleinkram.checks.local import LocalMission, LocalRecording
from kleinkram.checks.outcomes import collect
from kleinkram.contract.checks import WORST_FIRST, Check, CheckDepth, CheckStatus, Verdict, verdict_of
from kleinkram.recordings.errors import RecordingError

if TYPE_CHECKING:
    from kleinkram.checks.content import OpenRecording


@dataclass(frozen=True)
class UnmatchedProfile:
    """A profile that does not apply to a mission, and why."""

    name: str
    reason: str


@dataclass(frozen=True)
class CheckResults:
    """The outcome of all checks of one mission.

    Attributes:
        checks: worst first, at most `MAX_CHECKS`.
        counts: of all checks by status, also of those that are not listed.
        profiles_applied: names of the profiles whose rules were applied.
        profiles_left_out: the profiles whose `when` does not match, and why.
    """

    verdict: Verdict
    depth: CheckDepth
    checks: tuple[Check, ...]
    counts: Mapping[CheckStatus, int] = field(default_factory=dict)
    profiles_applied: tuple[str, ...] = ()
    profiles_left_out: tuple[UnmatchedProfile, ...] = ()

    def to_plain(self) -> dict[str, object]:
        """Return the results as what `json.dumps` takes: the stable shape of `klein check --json`."""
        return {
            "verdict": self.verdict.value,
            "depth": self.depth.value,
            "counts": {status.value: self.counts.get(status, 0) for status in WORST_FIRST},
            "profiles_applied": list(self.profiles_applied),
            "profiles_left_out": [vars(profile) for profile in self.profiles_left_out],
            "checks": [check.model_dump(mode="json") for check in self.checks],
        }


def evaluate_index(document: ChecksDocument, facts: MissionFacts) -> CheckResults:
    """Check a mission by the indexes of its files; checks that need messages are listed as `needs_content`."""
    profiles = document.applying_to(facts.metadata)
    checks = _without_repetition(chain(index_checks(profiles, facts), checks_needing_content(profiles, facts)))
    return to_results(document, facts.metadata, checks, CheckDepth.index)


def evaluate(
    document: ChecksDocument, mission: LocalMission, depth: CheckDepth, *, more: Iterable[Check] = ()
) -> CheckResults:
    """Check local files by their indexes and, with `CheckDepth.content`, by samples of their messages.

    `more`: other checks that count.
    """
    profiles = document.applying_to(mission.facts.metadata)
    others = (
        content_checks(profiles, mission)
        if depth is CheckDepth.content
        else checks_needing_content(profiles, mission.facts)
    )
    checks = chain(more, _without_repetition(chain(index_checks(profiles, mission.facts), others)))
    return to_results(document, mission.facts.metadata, checks, depth)


def _without_repetition(checks: Iterable[Check]) -> Iterator[Check]:
    """Yield checks; what could not be made for want of a topic is left out after a `topic.missing` that says so."""
    missing: set[str | None] = set()
    for check in checks:
        if check.name == "topic.missing" and check.status is not CheckStatus.ok:
            missing.add(check.topic)
        # A rule without topics names no file.
        is_unmade = check.status is CheckStatus.not_made and check.file is None and not check.name.startswith("topic.")
        if not is_unmade or check.topic not in missing:
            yield check


def content_checks(profiles: Sequence[Profile], mission: LocalMission) -> Iterator[Check]:
    """Open the recordings of a mission and check samples of their messages, in the order of the rules."""
    if next(planned_rules(profiles, ()), None) is None:
        return
    from kleinkram.checks.content import check_content

    with ExitStack() as stack:
        yield from check_content(profiles, [_opened(recording, stack) for recording in mission.recordings])


def _opened(recording: LocalRecording, stack: ExitStack) -> "OpenRecording":
    from kleinkram.checks.content import OpenRecording

    try:
        return OpenRecording(recording.name, stack.enter_context(recording.open()))
    except (RecordingError, OSError) as error:
        return OpenRecording(recording.name, None, str(error))


def to_results(
    document: ChecksDocument, metadata: Mapping[str, JsonValue], checks: Iterable[Check], depth: CheckDepth
) -> CheckResults:
    """Return the results of the checks of a mission with these metadata."""
    collected = collect(checks)
    return CheckResults(
        verdict=verdict_of({status for status, count in collected.counts.items() if count}),
        depth=depth,
        checks=tuple(collected.checks),
        counts=collected.counts,
        profiles_applied=tuple(profile.name for profile in document.applying_to(metadata)),
        profiles_left_out=tuple(profiles_left_out(document, metadata)),
    )


def profiles_left_out(document: ChecksDocument, metadata: Mapping[str, JsonValue]) -> list[UnmatchedProfile]:
    """Return the profiles that do not apply to a mission with these metadata, and why."""
    return [
        UnmatchedProfile(profile.name, _why_not(profile, metadata))
        for profile in document.profiles
        if not profile.applies_to(metadata)
    ]


def _why_not(profile: Profile, metadata: Mapping[str, JsonValue]) -> str:
    """Return the first field of a profile's `when` that does not match."""
    for name, expected in profile.when.items():
        if name not in metadata:
            return f"{name} is not set; it must be {_choices_text(expected)}"
        if not value_matches(metadata[name], expected):
            return f"{name} is {_value_text(metadata[name])}; it must be {_choices_text(expected)}"
    return ""


def _choices_text(expected: JsonValue) -> str:
    return " or ".join(map(_value_text, expected)) if isinstance(expected, list) else _value_text(expected)


def _value_text(value: JsonValue) -> str:
    text = value if isinstance(value, str) else str(value).lower() if isinstance(value, bool) else repr(value)
    return text if len(text) <= 100 else f"{text[:99]}…"
