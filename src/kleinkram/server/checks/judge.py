"""Judges missions: reads what is known of them, makes the checks from the index, and stores the verdict.

May run twice, and at any time. It locks the missions first, so that what it reads belongs together; a change that
follows has them judged again.
"""

import asyncio
import datetime
import math
import time
import uuid
from collections import defaultdict
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from pydantic import TypeAdapter
from sqlalchemy import ColumnElement, case, delete, func, or_, select, update
from sqlalchemy.dialects.postgresql import insert

from kleinkram.checks.document import ChecksDocument
from kleinkram.checks.results import CheckResults, choose_profiles, evaluate_index
from kleinkram.contract.audit import ChangeKind
from kleinkram.contract.checks import AcceptanceEnd, Check, CheckDepth, CheckStatus, MissionCheck, Verdict
from kleinkram.contract.errors import YamlInvalid
from kleinkram.server.change_events import ChangeEvent, publish
from kleinkram.server.checks.action_checks import checks_of_result
from kleinkram.server.checks.combine import (
    Acceptance,
    CombinedChecks,
    Failure,
    Sources,
    UploaderReport,
    combine,
    is_content_outdated,
)
from kleinkram.server.checks.facts import JudgedMission, read_missions
from kleinkram.server.checks.queries import AppliedRules, counting_reports, reporting_runs
from kleinkram.server.db import Connection, among
from kleinkram.server.jobs.rejudge import lock_what_projects_name
from kleinkram.server.missions import service as missions
from kleinkram.server.projects.checks_documents import document_of
from kleinkram.server.runs.project_results import ActionResult, ResultState, project_results
from kleinkram.server.tables import check_acceptance, check_report, mission_checks

_CHECKS = TypeAdapter(list[Check])
_MISSION_CHECKS = TypeAdapter(list[MissionCheck])
# Each may have tens of thousands of checks, which are in memory together.
_AT_ONCE = 10


@dataclass(frozen=True)
class _Rules:
    """The `checks.yaml` of a project. `document` is None if it cannot be read, for a `reason`."""

    document: ChecksDocument | None
    sha256: bytes
    reason: str = ""

    def applied_to(self, judged: JudgedMission) -> AppliedRules:
        profiles = choose_profiles(self.document, judged.metadata).applied if self.document is not None else ()
        return AppliedRules(self.sha256, sorted(profile.name for profile in profiles))


@dataclass(frozen=True)
class _Judgement:
    """What is stored of one mission."""

    mission: JudgedMission
    results: CheckResults | None
    combined: CombinedChecks


class _Reports(NamedTuple):
    """Reports that count, latest first, and the runs among whose results they are."""

    counting: Sequence[UploaderReport] = ()
    run_ids: Set[uuid.UUID] = frozenset()


_Inputs = tuple[JudgedMission, _Rules | None, _Reports, Sequence[Acceptance], Sequence[ActionResult]]


async def judge_missions(
    db: Connection, mission_ids: Sequence[uuid.UUID], *, within_s: float = math.inf
) -> uuid.UUID | None:
    """Judge missions, by id, in the caller's transaction, which should be short: it locks them.

    Those whose recordings are not derived yet are left out: deriving them has them judged. After `within_s`, the others
    are left as they are; the last one that was judged is returned then.
    """
    deadline = time.monotonic() + within_s
    locked = await missions.lock_missions(db, mission_ids)
    await lock_what_projects_name(db, locked)
    judged = [one for one in await read_missions(db, [*locked]) if one.facts is not None]
    if not judged:
        return None
    await _end_acceptances(db, judged)
    rules = {key: await _rules(db, *key) for key in {(one.project_id, one.checks_number) for one in judged}}
    acceptances = await current_acceptances(db, [one.id for one in judged])
    with_reports = await _with_reports(db, judged)
    count = 0
    while count < len(judged) and (count == 0 or time.monotonic() < deadline):
        some = judged[count : count + _AT_ONCE]
        results = await project_results(db, [one.id for one in some])
        inputs = []
        for one in some:
            own_rules = rules[one.project_id, one.checks_number]
            reports = await _reports(db, one, own_rules) if one.id in with_reports else _Reports()
            inputs.append((one, own_rules, reports, acceptances[one.id], results.get(one.id, ())))
        judgements = await asyncio.to_thread(_judge_until, deadline, inputs)
        await _store(db, judgements)
        count += len(judgements)
    await publish(db, _events(judged[:count]))
    return judged[count - 1].id if count < len(judged) else None


def _events(judged: Sequence[JudgedMission]) -> list[ChangeEvent]:
    if len(judged) == 1:
        return [ChangeEvent("mission", ChangeKind.changed, one.id, one.project_id, one.id) for one in judged]
    return [
        ChangeEvent("mission", ChangeKind.changed, None, project_id)
        for project_id in {one.project_id for one in judged}
    ]


async def present_rules(db: Connection, judged: JudgedMission) -> AppliedRules | None:
    """Return the rules that apply to a mission; None if its project has none."""
    rules = await _rules(db, judged.project_id, judged.checks_number)
    return None if rules is None else rules.applied_to(judged)


async def _rules(db: Connection, project_id: uuid.UUID, number: int) -> _Rules | None:
    if number == 0:
        return None
    try:
        document, sha256 = await document_of(db, project_id, number)
    except YamlInvalid as error:  # written for an earlier version of this program
        return _Rules(None, b"", error.sentence())
    return _Rules(document, sha256)


def _judge_until(deadline: float, inputs: Sequence[_Inputs]) -> list[_Judgement]:
    """Judge missions in their order; the first, and others before the deadline."""
    judgements: list[_Judgement] = []
    for one in inputs:
        if judgements and time.monotonic() >= deadline:
            break
        judgements.append(_judge(*one))
    return judgements


def _judge(
    judged: JudgedMission,
    rules: _Rules | None,
    reports: _Reports,
    acceptances: Sequence[Acceptance],
    action_results: Sequence[ActionResult],
) -> _Judgement:
    results: CheckResults | None = None
    index: Sequence[Check] | None = None
    if rules is not None and judged.all_files and judged.facts is not None:
        if rules.document is None:
            index = [_unreadable(rules)]
        elif not judged.is_reading:
            results = evaluate_index(rules.document, judged.facts)
            index = results.checks
    sources = Sources(
        index=index,
        reports=reports.counting,
        actions=[
            check
            for result in action_results
            for check in checks_of_result(result, is_complete=judged.is_complete, reporting=reports.run_ids)
        ]
        if judged.all_files
        else [],
        acceptances=acceptances,
        is_running=judged.is_reading or any(one.is_running for one in action_results),
    )
    is_outdated = is_content_outdated(sources) or any(one.state is ResultState.outdated for one in action_results)
    combined = combine(replace(sources, is_outdated=is_outdated))
    return _Judgement(judged, results, combined)


def _unreadable(rules: _Rules) -> Check:
    message = f"the project's checks.yaml cannot be read: {rules.reason}"[:2000]
    return Check(name="checks.file", status=CheckStatus.not_made, message=message)


async def _end_acceptances(db: Connection, judged: Sequence[JudgedMission]) -> None:
    """End the acceptances of missions whose files changed."""
    own = check_acceptance.c.mission_id
    stmt = select(check_acceptance.c.id, own, check_acceptance.c.inputs_sha256)
    rows = (await db.execute(stmt.where(among(own, [one.id for one in judged]), _APPLIES))).all()
    inputs = {one.id: one.inputs_sha256 for one in judged}
    ended = [row.id for row in rows if row.inputs_sha256 != inputs[row.mission_id]]
    if ended:
        values = {"ended": AcceptanceEnd.files_changed.value, "ended_at": func.now()}
        await db.execute(update(check_acceptance).where(among(check_acceptance.c.id, ended)).values(**values))


_APPLIES: ColumnElement[bool] = check_acceptance.c.ended.is_(None)


async def current_acceptances(db: Connection, mission_ids: Sequence[uuid.UUID]) -> Mapping[uuid.UUID, list[Acceptance]]:
    """Return the acceptances that have not ended, by mission."""
    own = check_acceptance.c.mission_id
    columns = (check_acceptance.c.id, own, check_acceptance.c.check_name, check_acceptance.c.failures)
    acceptances: dict[uuid.UUID, list[Acceptance]] = defaultdict(list)
    for row in await db.execute(select(*columns).where(among(own, mission_ids), _APPLIES)):
        failures = {Failure(CheckStatus(status), *others) for status, *others in row.failures}
        acceptances[row.mission_id].append(Acceptance(row.id, row.check_name, failures))
    return acceptances


async def _with_reports(db: Connection, judged: Sequence[JudgedMission]) -> set[uuid.UUID]:
    """Return the missions that have reports; most have none."""
    own = check_report.c.mission_id
    return {*(await db.execute(select(own).where(among(own, [one.id for one in judged])).distinct())).scalars()}


async def _reports(db: Connection, judged: JudgedMission, rules: _Rules | None) -> _Reports:
    """Return the reports that count: one mission may have many, of ten thousand checks each."""
    applied = None if rules is None else rules.applied_to(judged)
    run_ids = (await db.execute(reporting_runs(judged, applied))).scalars()
    rows = await db.execute(counting_reports(judged, applied))
    counting = [
        UploaderReport(
            person_id=row.created_by_id,
            checks=_CHECKS.validate_python(row.checks or ()),
            is_by_present_rules=row.is_by_present_rules,
            has_content=row.depth == CheckDepth.content.value,
        )
        for row in rows
    ]
    return _Reports(counting, {*run_ids})


async def _store(db: Connection, judgements: Sequence[_Judgement]) -> None:
    """Store results; where nothing was checked and nothing is to be checked, no row is left."""
    empty = [one.mission.id for one in judgements if _is_empty(one)]
    if empty:
        await db.execute(delete(mission_checks).where(among(mission_checks.c.mission_id, empty)))
    rows = [_values(one) for one in judgements if not _is_empty(one)]
    if rows:
        statement = insert(mission_checks)
        new = statement.excluded
        # Rows of missions that are not bad have none.
        stored = mission_checks.c.bad_since
        is_bad = new.verdict == Verdict.bad.value
        is_undecided = or_(new.verdict == Verdict.running.value, new.verdict == Verdict.outdated.value)
        since = case((is_bad, func.coalesce(stored, new.bad_since)), (is_undecided, stored), else_=None)
        changed = {name: new[name] for name in rows[0] if name not in ("mission_id", "bad_since")}
        statement = statement.on_conflict_do_update(
            index_elements=["mission_id"], set_={**changed, "bad_since": since, "evaluated_at": func.now()}
        )
        await db.execute(statement, rows)


def _is_empty(judgement: _Judgement) -> bool:
    has_state = judgement.combined.verdict in (Verdict.running, Verdict.outdated)
    return judgement.mission.checks_number == 0 and not judgement.combined.checks and not has_state


def _values(judgement: _Judgement) -> dict[str, Any]:
    judged, combined, results = judgement.mission, judgement.combined, judgement.results
    left_out = results.profiles_left_out if results else ()
    return {
        "mission_id": judged.id,
        "verdict": combined.verdict.value,
        "files_revision": judged.files_revision,
        "project_id": judged.project_id,
        "checks_number": judged.checks_number,
        "is_outdated": False,
        "counts": combined.counts,
        "checks": _MISSION_CHECKS.dump_python(combined.checks, mode="json", exclude_defaults=True),
        "statuses": {name: status.value for name, status in combined.statuses.items()},
        "profiles_applied": [*results.profiles_applied] if results else [],
        "profiles_left_out": [{"name": one.name, "reason": one.reason} for one in left_out],
        "failed": combined.failed,
        "bad_since": datetime.datetime.now(datetime.timezone.utc) if combined.verdict is Verdict.bad else None,
    }
