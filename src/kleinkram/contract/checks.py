"""Checks and verdicts: the outcome of each check of a recording or mission, and what they amount to.

A check has a dotted name such as `topic.rate`. The rules come from `checks.yaml` (package `kleinkram.checks`), from an
action that reports checks, or from the report of an uploader.
"""

import datetime
import enum
import uuid
from typing import Annotated, Any

from pydantic import AfterValidator, Field, FiniteFloat

from kleinkram.contract.base import ETag, NamedRef, Request, Response, etag_of
from kleinkram.contract.names import FilePath, Term, check_text
from kleinkram.contract.people import PersonRef

MAX_CHECKS = 10_000
MAX_CHECKS_CHARACTERS = 200_000
"""Of a `checks.yaml`."""

CheckName = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_-]{0,31}(\.[a-z0-9][a-z0-9_-]{0,31}){1,3}$")]
NameOfMissionCheck = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_.-]{0,130}$")]
"""A `CheckName`, or the code of a finding, which counts as a check of that name."""
CheckMessage = Annotated[str, AfterValidator(check_text), Field(min_length=1, max_length=2000)]
CheckedTopic = Annotated[str, AfterValidator(check_text), Field(min_length=1, max_length=1024)]
LogTime = Annotated[int, Field(ge=0, lt=2**63)]


class CheckSeverity(str, enum.Enum):
    """What it means that a check fails."""

    warning = "warning"
    error = "error"


class CheckStatus(str, enum.Enum):
    """Outcome of one check.

    not_made: it could not be made, with the reason in its message; counts as a warning. needs_content: it reads the
    messages themselves, and only the index was read; while there is such a check, nothing is good.
    """

    ok = "ok"
    warning = "warning"
    error = "error"
    not_made = "not_made"
    needs_content = "needs_content"


class CheckDepth(str, enum.Enum):
    """What was read for checks: only the indexes of recordings, or also the messages that samples need."""

    index = "index"  # type: ignore[assignment]  # hides str.index
    content = "content"


class Verdict(str, enum.Enum):
    """What the checks of a mission amount to.

    outdated: files, the file of checks, or the version of an action are newer than the results. running: checks are
    being made. unchecked: there are none, or some are still to be made and none has failed.
    """

    good = "good"
    warnings = "warnings"
    bad = "bad"
    outdated = "outdated"
    running = "running"
    unchecked = "unchecked"


WORST_VERDICT_FIRST = (
    Verdict.bad,
    Verdict.warnings,
    Verdict.outdated,
    Verdict.running,
    Verdict.unchecked,
    Verdict.good,
)


class Check(Request):
    """The outcome of one check.

    `value` was measured and `limit` is the bound that it is compared with, both in `unit`. `topic`, `file` (or the
    name of a recording) and `time_ns` (log time, ns since 1970) say where; null where they do not apply.
    """

    name: CheckName
    status: CheckStatus
    message: CheckMessage
    value: FiniteFloat | None = None
    limit: FiniteFloat | None = None
    unit: Annotated[str, Field(max_length=32)] | None = None
    topic: CheckedTopic | None = None
    file: FilePath | None = None
    time_ns: LogTime | None = None


WORST_FIRST = (
    CheckStatus.error,
    CheckStatus.warning,
    CheckStatus.not_made,
    CheckStatus.needs_content,
    CheckStatus.ok,
)
_VERDICTS = {
    CheckStatus.error: Verdict.bad,
    CheckStatus.warning: Verdict.warnings,
    CheckStatus.not_made: Verdict.warnings,
    CheckStatus.needs_content: Verdict.unchecked,
    CheckStatus.ok: Verdict.good,
}


def verdict_of(statuses: "set[CheckStatus]") -> Verdict:
    """Return what checks with these statuses amount to: good, warnings, bad, or unchecked.

    Unchecked is what has no checks, and what only passed those that were made while others need the messages.
    """
    return next((_VERDICTS[status] for status in WORST_FIRST if status in statuses), Verdict.unchecked)


# -- checks and verdicts of the server --------------------------------------------------------------------------------

MAX_REPORT_FILES = 20_000
MAX_REASON_CHARACTERS = 2000

Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
Reason = Annotated[str, AfterValidator(check_text), Field(min_length=1, max_length=MAX_REASON_CHARACTERS)]


class ProjectChecksUpdate(Request):
    """The new `checks.yaml` of a project; an empty text removes it."""

    text: Annotated[str, AfterValidator(check_text), Field(max_length=MAX_CHECKS_CHARACTERS)]


def _checks_etag(values: dict[str, Any]) -> str:
    return etag_of(values["number"], values["text"])


class ProjectChecksRead(Response):
    """The `checks.yaml` of a project: `text` is empty while there is none, and `number` is that of its version.

    `sha256` is the hash of the text in UTF-8, by which reports name the file that they were made by. `created_at` and
    `created_by` are null where there never was a file; `number` is 0 then.
    """

    text: str
    number: int
    sha256: str
    created_at: datetime.datetime | None
    created_by: PersonRef | None
    etag: ETag = Field(default_factory=_checks_etag)


class ChecksVersionRead(Response):
    """A version of a project's `checks.yaml`. `is_removal`: its text is empty."""

    number: int
    sha256: str
    is_removal: bool
    created_at: datetime.datetime
    created_by: PersonRef


class CheckReportCreate(Request):
    """Checks by an uploader or a run, by profiles of the `checks.yaml` with this hash, of files (SHA-256 by path).

    They count while exactly these are the recorded files of the mission, and exactly these profiles apply to it.
    """

    checks: Annotated[list[Check], Field(max_length=MAX_CHECKS)]
    depth: CheckDepth
    document_sha256: Sha256
    profiles_applied: Annotated[list[Annotated[str, Field(max_length=200)]], Field(max_length=1000)]
    files: Annotated[dict[FilePath, Sha256], Field(min_length=1, max_length=MAX_REPORT_FILES)]


class CheckReportRead(Response):
    """A report of checks by an uploader or a run, without the checks.

    `is_current`: it was made of the present files and by the present `checks.yaml` (by any, while the project has
    none), so that it counts. `run_id`: the run that made it, which acted for `created_by`.
    """

    id: uuid.UUID
    verdict: Verdict
    depth: CheckDepth
    document_sha256: str
    check_count: int
    file_count: int
    is_current: bool
    created_at: datetime.datetime
    created_by: PersonRef
    run_id: uuid.UUID | None = None


class CheckSource(str, enum.Enum):
    """Who made a check: the server, from the index; the report of an uploader or run; or an action of the project."""

    server = "server"
    report = "report"
    action = "action"


class MissionCheck(Response):
    """The outcome of one check of a mission, as in `Check`.

    `action`, `action_version` and `run_id` name the run that made it; without an account, `run_id` is not shown.
    `acceptance_id`: a person accepted that it fails, so that it does not count.
    """

    name: str
    status: CheckStatus
    message: str
    value: float | None = None
    limit: float | None = None
    unit: str | None = None
    topic: str | None = None
    file: str | None = None
    time_ns: int | None = None
    source: CheckSource = CheckSource.server
    action: str | None = None
    action_version: int | None = None
    run_id: uuid.UUID | None = None
    acceptance_id: uuid.UUID | None = None


class CheckCounts(Response):
    """The number of checks of a mission by status. Accepted ones are only in `accepted`."""

    error: int = 0
    warning: int = 0
    not_made: int = 0
    ok: int = 0
    needs_content: int = 0
    accepted: int = 0


class ProfileLeftOut(Response):
    """A profile of `checks.yaml` that does not apply to a mission, and why."""

    name: str
    reason: str


class CheckAcceptanceCreate(Request):
    """Accept that a check of a mission fails as it does now. Without a topic, on all topics on which it fails now."""

    check: NameOfMissionCheck
    topic: CheckedTopic | None = None
    because: Reason


class AcceptanceEnd(str, enum.Enum):
    """Why an acceptance ended: a person withdrew it or accepted the check again, or the files changed."""

    withdrawn = "withdrawn"
    replaced = "replaced"
    files_changed = "files_changed"


class CheckAcceptanceRead(Response):
    """A person's decision that what failed of a check does not count, and nothing that fails later.

    `failure_count` is how many failures it covers. `ended` is null while it applies. Without an account, `created_by`
    is not shown.
    """

    id: uuid.UUID
    check: str
    topic: str | None
    because: str
    failure_count: int
    created_at: datetime.datetime
    created_by: PersonRef | None
    ended: AcceptanceEnd | None
    ended_at: datetime.datetime | None
    ended_by: PersonRef | None


class CheckNoteCreate(Request):
    """A note on a check of a mission; without a topic, on all topics."""

    check: NameOfMissionCheck
    topic: CheckedTopic | None = None
    text: Reason


class CheckNoteRead(Response):
    """A person's note on a check of a mission."""

    id: uuid.UUID
    check: str
    topic: str | None
    text: str
    created_at: datetime.datetime
    created_by: PersonRef


class MissionCheckFilter(Request):
    """A filter for the checks of a mission. `name` may be a glob; of several statuses, any may match."""

    name: Term | None = None
    status: Annotated[list[CheckStatus], Field(max_length=len(CheckStatus))] = []


class MissionChecksRead(Response):
    """One page of the checks of a mission, worst first, and its verdict and counts by all of them.

    `next` is the cursor of the next page, null on the last; acceptances, notes and reports come with the first one.
    `evaluated_at` is null while nothing was checked.
    `is_current`: the checks are of the present files and by the present `checks.yaml`, whose version is `checks_number`
    (0 for none). `reference` is the trajectory that estimates are compared with: of the mission's metadata, or else of
    the first profile that applies and names one; it comes with the first page. `bad_since` is when the mission became
    bad. With `all`, acceptances that ended are listed too. Without an account, there are no notes and no reports, and
    only acceptances that apply.
    """

    verdict: Verdict
    counts: CheckCounts
    checks: list[MissionCheck]
    next: str | None = None
    checks_number: int
    profiles_applied: list[str]
    profiles_left_out: list[ProfileLeftOut]
    reference: str | None = None
    is_current: bool
    evaluated_at: datetime.datetime | None
    bad_since: datetime.datetime | None
    acceptances: list[CheckAcceptanceRead]
    notes: list[CheckNoteRead]
    reports: list[CheckReportRead]


class CellStatus(str, enum.Enum):
    """The worst status of a check over its topics, worst first; `accepted`: people accepted all that failed."""

    error = "error"
    warning = "warning"
    not_made = "not_made"
    needs_content = "needs_content"
    accepted = "accepted"
    ok = "ok"


class CheckMatrixRow(Response):
    """One mission of the matrix: of each check that was made, the worst status over its topics."""

    mission: NamedRef
    start_ns: int | None
    verdict: Verdict
    counts: CheckCounts
    cells: dict[str, CellStatus]


class CheckMatrix(Response):
    """One page of a project's missions, latest first, and the names of all checks in it, by how often they fail."""

    checks: list[str]
    items: list[CheckMatrixRow]
    next: str | None = None
    total: int | None = None


class TrendStep(str, enum.Enum):
    """The width of the buckets of a trend. Weeks begin on Monday, in UTC."""

    day = "day"
    week = "week"


class TrendBucket(Response):
    """The number of missions by verdict that were recorded in one day or week (created, where nothing is recorded)."""

    start: datetime.date
    verdicts: dict[Verdict, int]


class CheckTrend(Response):
    """The verdicts of a project's missions over time; days or weeks without missions are left out."""

    by: TrendStep
    buckets: list[TrendBucket]
