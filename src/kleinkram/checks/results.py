"""What the checks of a mission amount to: its verdict, with the checks, their numbers and the profiles applied."""

import hashlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from itertools import chain
from typing import TYPE_CHECKING, NamedTuple

from pydantic import JsonValue

from kleinkram.checks.content.families import need_content
from kleinkram.checks.document import ChecksDocument, MatchedMetadata, Profile
from kleinkram.checks.facts import MissionFacts
from kleinkram.checks.index_checks import checks_needing_content, index_checks
from kleinkram.checks.local import LocalMission, LocalRecording
from kleinkram.checks.outcomes import ShowProgress, collect, show_nothing
from kleinkram.contract.checks import (
    WORST_FIRST,
    Check,
    CheckDepth,
    CheckReportCreate,
    CheckStatus,
    Verdict,
    verdict_of,
)
from kleinkram.recordings.errors import RecordingError

if TYPE_CHECKING:
    from kleinkram.checks.content import OpenRecording


@dataclass(frozen=True)
class UnmatchedProfile:
    """A profile that does not apply to a mission, and why."""

    name: str
    reason: str


class ChosenProfiles(NamedTuple):
    """The profiles that apply to a mission, and the others, in the order of the document."""

    applied: list[Profile]
    left_out: list[UnmatchedProfile]


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

    def to_report(self, text: str, files: Mapping[str, str]) -> CheckReportCreate:
        """Return the results as a report for a server: by the rules in `text`, of files (SHA-256 in hex by path)."""
        return CheckReportCreate(
            checks=[*self.checks],
            depth=self.depth,
            document_sha256=hashlib.sha256(text.encode()).hexdigest(),
            profiles_applied=[*self.profiles_applied],
            files=dict(files),
        )


def evaluate_index(document: ChecksDocument, facts: MissionFacts) -> CheckResults:
    """Check a mission by the indexes of its files; checks that need messages are listed as `needs_content`."""
    chosen = choose_profiles(document, facts.metadata)
    rows = chain(index_checks(chosen.applied, facts), checks_needing_content(chosen.applied, facts))
    return _results(chosen, _without_repetition(rows), CheckDepth.index)


def evaluate(
    document: ChecksDocument,
    mission: LocalMission,
    depth: CheckDepth,
    *,
    more: Iterable[Check] = (),
    show: ShowProgress = show_nothing,
) -> CheckResults:
    """Check local files by their indexes and, with `CheckDepth.content`, by samples of their messages.

    `more`: other checks that count. `show`: of the recordings whose messages are read.
    """
    chosen = choose_profiles(document, mission.facts.metadata)
    profiles = chosen.applied
    others = (
        content_checks(profiles, mission, show)
        if depth is CheckDepth.content
        else checks_needing_content(profiles, mission.facts)
    )
    checks = chain(more, _without_repetition(chain(index_checks(profiles, mission.facts), others)))
    return _results(chosen, checks, depth)


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


def content_checks(
    profiles: Sequence[Profile], mission: LocalMission, show: ShowProgress = show_nothing
) -> Iterator[Check]:
    """Open the recordings of a mission and check samples of their messages, in the order of the rules."""
    if not need_content(profiles):
        return
    from kleinkram.checks.content import check_content

    with ExitStack() as stack:
        opened = [_opened(recording, stack) for recording in mission.recordings]
        yield from check_content(profiles, opened, show=show)


def _opened(recording: LocalRecording, stack: ExitStack) -> "OpenRecording":
    from kleinkram.checks.content import OpenRecording

    try:
        return OpenRecording(recording.name, stack.enter_context(recording.open()))
    except (RecordingError, OSError) as error:
        return OpenRecording(recording.name, None, str(error))


def _results(chosen: ChosenProfiles, checks: Iterable[Check], depth: CheckDepth) -> CheckResults:
    collected = collect(checks)
    return CheckResults(
        verdict=verdict_of({status for status, count in collected.counts.items() if count}),
        depth=depth,
        checks=tuple(collected.checks),
        counts=collected.counts,
        profiles_applied=tuple(profile.name for profile in chosen.applied),
        profiles_left_out=tuple(chosen.left_out),
    )


def choose_profiles(document: ChecksDocument, metadata: Mapping[str, JsonValue]) -> ChosenProfiles:
    """Compare the conditions of all profiles with the metadata of a mission, each once."""
    chosen, matched = ChosenProfiles([], []), MatchedMetadata(metadata)
    for profile in document.profiles:
        name = profile.mismatch(matched)
        if name is None:
            chosen.applied.append(profile)
        else:
            chosen.left_out.append(UnmatchedProfile(profile.name, _why_not(profile, name, metadata)))
    return chosen


def _why_not(profile: Profile, name: str, metadata: Mapping[str, JsonValue]) -> str:
    expected = _choices_text(profile.when[name])
    if name not in metadata:
        return f"{name} is not set; it must be {expected}"
    return f"{name} is {_value_text(metadata[name])}; it must be {expected}"


def _choices_text(expected: JsonValue) -> str:
    return " or ".join(map(_value_text, expected)) if isinstance(expected, list) else _value_text(expected)


def _value_text(value: JsonValue) -> str:
    text = value if isinstance(value, str) else str(value).lower() if isinstance(value, bool) else repr(value)
    return text if len(text) <= 100 else f"{text[:99]}…"
