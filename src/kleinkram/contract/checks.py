"""Checks and verdicts: the outcome of each check of a recording or mission, and what they amount to.

A check has a dotted name such as `topic.rate`. The rules come from `checks.yaml` (package `kleinkram.checks`), from an
action that reports checks, or from the report of an uploader.
"""

import enum
from typing import Annotated

from pydantic import AfterValidator, Field, FiniteFloat

from kleinkram.contract.base import Request
from kleinkram.contract.names import FilePath, check_text

MAX_CHECKS = 10_000
MAX_CHECKS_CHARACTERS = 200_000
"""Of a `checks.yaml`."""

CheckName = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_-]{0,31}(\.[a-z0-9][a-z0-9_-]{0,31}){1,3}$")]
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
    messages themselves, and only the index was read; counts neither as passed nor as failed.
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
    being made. unchecked: there are none.
    """

    good = "good"
    warnings = "warnings"
    bad = "bad"
    outdated = "outdated"
    running = "running"
    unchecked = "unchecked"


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
    CheckStatus.ok,
    CheckStatus.needs_content,
)
_VERDICTS = {
    CheckStatus.error: Verdict.bad,
    CheckStatus.warning: Verdict.warnings,
    CheckStatus.not_made: Verdict.warnings,
    CheckStatus.ok: Verdict.good,
}


def verdict_of(statuses: "set[CheckStatus]") -> Verdict:
    """Return what checks with these statuses amount to: good, warnings, bad, or unchecked where none was made."""
    return next((_VERDICTS[status] for status in WORST_FIRST[:4] if status in statuses), Verdict.unchecked)
