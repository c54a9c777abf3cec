"""The verdict of a mission: checks from the index, of uploaders and of actions, and what people accepted. Pure."""

import uuid
from collections import Counter
from collections.abc import Iterable, Sequence, Set
from dataclasses import dataclass, field
from typing import NamedTuple

from kleinkram.checks.outcomes import LEFT_OUT
from kleinkram.contract.base import construct
from kleinkram.contract.checks import (
    MAX_CHECKS,
    WORST_FIRST,
    CellStatus,
    Check,
    CheckSource,
    CheckStatus,
    MissionCheck,
    Verdict,
    verdict_of,
)

_FAILED = (CheckStatus.error, CheckStatus.warning, CheckStatus.not_made)
_CELLS = {status: CellStatus(status.value) for status in CheckStatus}
_RANKS = {status: rank for rank, status in enumerate(CellStatus)}  # worst first
_FROM_INDEX = ("file.", "recording.", "topic.", "checks.")
_ALSO_FROM_INDEX = "clock.jump"
_ADDED = {name: field.default for name, field in MissionCheck.model_fields.items() if name not in Check.model_fields}
_ADDED_BY_SOURCE = {source: {**_ADDED, "source": source} for source in CheckSource}


class Failure(NamedTuple):
    """What identifies a failing check of this name while the files are the same: other rules make other failures.

    `message`: of what an action reports, which may differ from run to run; else None.
    """

    status: CheckStatus
    topic: str | None
    file: str | None
    limit: float | None
    action: str | None
    action_version: int | None
    message: str | None


@dataclass(frozen=True)
class Acceptance:
    """What failed of a check when a person accepted it."""

    id: uuid.UUID
    check: str
    failures: Set[Failure]


@dataclass(frozen=True)
class UploaderReport:
    """Checks of the present files, by an uploader.

    `is_by_present_rules`: by the present `checks.yaml`, and by the profiles of it that apply now.
    """

    person_id: uuid.UUID
    checks: Sequence[Check]
    is_by_present_rules: bool
    has_content: bool


@dataclass(frozen=True)
class CombinedChecks:
    """All checks of a mission, worst first, and what they amount to.

    Attributes:
        counts: by status of those that count, and `accepted`.
        statuses: of each check, the worst status over topics and sources.
        failed: names of the checks with warnings or errors that nobody accepted.
    """

    verdict: Verdict
    checks: list[MissionCheck]
    counts: dict[str, int]
    statuses: dict[str, CellStatus]
    failed: list[str]


@dataclass(frozen=True)
class Sources:
    """Everything that a verdict is made of.

    Attributes:
        index: checks that the server made from the index; None if the project has no `checks.yaml`.
        reports: latest first; of each person, the latest counts.
        actions: checks of the project's actions.
        is_running: a source is still being made.
        is_outdated: a source was made of earlier files or rules, and was not made again.
    """

    index: Sequence[Check] | None = None
    reports: Sequence[UploaderReport] = ()
    actions: Sequence[MissionCheck] = ()
    acceptances: Sequence[Acceptance] = ()
    is_running: bool = False
    is_outdated: bool = False


@dataclass
class _Summary:
    counts: Counter[str] = field(default_factory=Counter)
    statuses: dict[str, CellStatus] = field(default_factory=dict)
    failed: set[str] = field(default_factory=set)

    def add(self, check: MissionCheck) -> None:
        status = _CELLS[check.status] if check.acceptance_id is None else CellStatus.accepted
        self.counts[status.value] += 1
        known = self.statuses.get(check.name)
        if known is None or _RANKS[status] < _RANKS[known]:
            self.statuses[check.name] = status
        if status in (CellStatus.error, CellStatus.warning):
            self.failed.add(check.name)


def reads_content(name: str) -> bool:
    """Return whether a check of this name reads messages."""
    return not name.startswith(_FROM_INDEX) and name != _ALSO_FROM_INDEX


def combine(sources: Sources) -> CombinedChecks:
    """Return all checks and the verdict. An error that counts makes a mission bad, whatever is outdated or running."""
    summary, by_status = _Summary(), {status: list[MissionCheck]() for status in WORST_FIRST}
    for check in _accepted(_all_checks(sources), sources.acceptances):
        summary.add(check)
        by_status[check.status].append(check)
    made = {CheckStatus(name) for name, count in summary.counts.items() if count and name != "accepted"}
    if summary.counts["accepted"]:
        made.add(CheckStatus.ok)
    verdict = verdict_of(made)
    if verdict is not Verdict.bad and (sources.is_running or sources.is_outdated):
        verdict = Verdict.running if sources.is_running else Verdict.outdated
    return CombinedChecks(
        verdict=verdict,
        checks=_bounded([check for status in WORST_FIRST for check in by_status[status]]),
        counts=dict(summary.counts),
        statuses=summary.statuses,
        failed=sorted(summary.failed),
    )


def is_content_outdated(sources: Sources) -> bool:
    """Return whether content was checked, but not by the rules that apply now.

    These differ if the `checks.yaml` changed, or the metadata by which its profiles are chosen.
    """
    needed = {check.name for check in sources.index or () if check.status is CheckStatus.needs_content}
    by_content = [report for report in sources.reports if report.has_content]
    if not needed or not by_content:
        return False
    return not needed <= _content_checks(_counting([one for one in by_content if one.is_by_present_rules]), needed)


def _content_checks(checks: Iterable[Check], needed: Set[str]) -> Set[str]:
    """Return the names of the checks of content that reports have; of one that is too long, it has all."""
    names = {check.name for check in checks}
    return needed if LEFT_OUT in names else {name for name in names if reads_content(name)}


def _counting(reports: Iterable[UploaderReport]) -> list[Check]:
    """Return the checks that count: of each person, those of the latest report; of several people, the worse outcome.

    A person who may only add files can thus not overrule what another one found.
    """
    by_subject: dict[tuple[str, str | None, str | None], list[Check]] = {}
    people: set[uuid.UUID] = set()
    for report in reports:
        if report.person_id in people:
            continue
        people.add(report.person_id)
        own: dict[tuple[str, str | None, str | None], list[Check]] = {}
        for check in report.checks:
            own.setdefault((check.name, check.topic, check.file), []).append(check)
        for subject, checks in own.items():
            known = by_subject.get(subject)
            if known is None or _worst(checks) < _worst(known):
                by_subject[subject] = checks
    return [check for checks in by_subject.values() for check in checks]


def _worst(checks: Iterable[Check]) -> int:
    return min(WORST_FIRST.index(check.status) for check in checks)


def _all_checks(sources: Sources) -> Iterable[MissionCheck]:
    """Yield the checks that count: from the index by the server, from the content by the valid reports."""
    valid = [report for report in sources.reports if report.is_by_present_rules]
    content = [report for report in valid if report.has_content]
    if sources.index is None:
        yield from (_read(check, CheckSource.report) for check in _counting(content or valid))
    else:
        reported = _counting(content)
        needed = {check.name for check in sources.index if check.status is CheckStatus.needs_content}
        made = _content_checks(reported, needed)
        for check in sources.index:
            if check.name not in made:
                yield _read(check, CheckSource.server)
        for check in reported:
            if reads_content(check.name) or (check.name == LEFT_OUT and check.status is not CheckStatus.ok):
                yield _read(check, CheckSource.report)
    yield from sources.actions


def _read(check: Check, source: CheckSource) -> MissionCheck:
    return construct(MissionCheck, check.__dict__ | _ADDED_BY_SOURCE[source])


def failure_of(check: MissionCheck) -> Failure:
    """Return what identifies a failing check among those of its name."""
    message = check.message if check.source is CheckSource.action else None
    return Failure(check.status, check.topic, check.file, check.limit, check.action, check.action_version, message)


def _accepted(checks: Iterable[MissionCheck], acceptances: Sequence[Acceptance]) -> Iterable[MissionCheck]:
    by_name: dict[str, list[Acceptance]] = {}
    for acceptance in acceptances:
        by_name.setdefault(acceptance.check, []).append(acceptance)
    for check in checks:
        matching = by_name.get(check.name, ()) if check.status in _FAILED else ()
        applied = next((one for one in matching if failure_of(check) in one.failures), None)
        yield check if applied is None else check.model_copy(update={"acceptance_id": applied.id})


def _bounded(checks: list[MissionCheck]) -> list[MissionCheck]:
    if len(checks) <= MAX_CHECKS:
        return checks
    listed, left_out = checks[: MAX_CHECKS - 1], len(checks) - MAX_CHECKS + 1
    message = f"{left_out} more checks are not listed"
    return [*listed, MissionCheck(name=LEFT_OUT, status=CheckStatus.not_made, message=message)]
