"""The checks of a mission that the result of an action amounts to. Pure."""

import uuid
from collections.abc import Iterator, Set
from typing import Any

from kleinkram.contract.checks import Check, CheckSource, CheckStatus, MissionCheck, Verdict
from kleinkram.contract.reports import Severity
from kleinkram.server.runs.project_results import ActionResult, ResultState

_STATUSES = {Severity.warning: CheckStatus.warning, Severity.error: CheckStatus.error}
_MISSING, _FAILED = "results.missing", "results.failed"
_VERDICTS = {Verdict.warnings: CheckStatus.warning, Verdict.bad: CheckStatus.error}


def checks_of_result(
    result: ActionResult, *, is_complete: bool, reporting: Set[uuid.UUID] = frozenset()
) -> Iterator[MissionCheck]:
    """Yield the checks that an action reported, its warnings and errors as checks named by their codes, and its end.

    Checks of the runs in `reporting` are left out: they sent them as a report of the project's checks, which counts.

    `results.missing`: it has not run, which counts as a warning once the mission is complete, or if it could not start.
    `results.failed`: it could not judge the mission. `results.verdict`: it ended well, with what it concludes beyond
    its checks and findings. One that ended well and judged nothing yields none.
    """
    name = f"{result.name}@{result.version}"
    if result.state is ResultState.missing:
        status = CheckStatus.not_made if is_complete or result.message else CheckStatus.needs_content
        message = f"{name} has not run on these files" + (f": {result.message}" if result.message else "")
        yield _check(result, _MISSING, status, message[:2000])
    elif result.state is ResultState.without_input:
        status = CheckStatus.not_made if is_complete else CheckStatus.needs_content
        yield _check(result, _MISSING, status, f"{name} has not run: no file of the mission is its input")
    elif result.state is ResultState.failed:
        yield _check(result, _FAILED, CheckStatus.not_made, f"{name} failed: {result.message}"[:2000])
    elif result.state is ResultState.done and (result.verdict or result.checks or result.findings):
        worst = {check.status for check in result.checks} | {_STATUSES[entry.severity] for entry in result.findings}
        status = _VERDICTS.get(result.verdict or Verdict.good, CheckStatus.ok)
        # What a check or a finding reports is not repeated.
        is_reported = status in worst or (status is CheckStatus.warning and bool(worst & {CheckStatus.not_made}))
        end = CheckStatus.ok if is_reported else status
        conclusion = "" if end is CheckStatus.ok or result.verdict is None else f", and says: {result.verdict.value}"
        yield _check(result, "results.verdict", end, f"{name} ended{conclusion}")
        for check in result.checks if result.source_run_id not in reporting else ():
            yield _of_run(result, check)
        for finding in result.findings:
            fields = {"topic": finding.topic, "file": finding.file, "time_ns": finding.time_ns}
            yield _check(result, finding.code, _STATUSES[finding.severity], finding.message, **fields)


def without_run(check: MissionCheck) -> MissionCheck:
    """Return a check as people without an account see it: not its run, nor why that failed, which may name people."""
    changes: dict[str, Any] = {"run_id": None}
    if check.source is CheckSource.action and check.name in (_MISSING, _FAILED):
        changes["message"] = check.message.partition(": ")[0]
    return check.model_copy(update=changes)


def _of_run(result: ActionResult, check: Check) -> MissionCheck:
    return MissionCheck.model_construct(**check.__dict__, **_source_of(result))


def _check(
    result: ActionResult, name: str, status: CheckStatus, message: str, **where: str | int | None
) -> MissionCheck:
    fields = {"name": name, "status": status, "message": message, **where}
    return MissionCheck.model_validate(fields | _source_of(result))


def _source_of(result: ActionResult) -> dict[str, Any]:
    source = {"source": CheckSource.action, "action": result.name, "action_version": result.version}
    return source | {"run_id": result.run_id}
