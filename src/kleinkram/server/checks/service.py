"""The checks of a mission, and what people and uploaders add to them: acceptances, notes, reports.

Every change has the mission judged again.
"""

import uuid
from collections.abc import Set
from typing import Any

from sqlalchemy import Row, delete, func, insert, select, update

from kleinkram.contract.checks import (
    AcceptanceEnd,
    CheckAcceptanceCreate,
    CheckAcceptanceRead,
    CheckCounts,
    CheckNoteCreate,
    CheckNoteRead,
    CheckReportCreate,
    CheckReportRead,
    MissionCheck,
    MissionCheckFilter,
    MissionChecksRead,
    ProfileLeftOut,
    Verdict,
    verdict_of,
)
from kleinkram.contract.errors import FieldProblem, InvalidRequest, NotFound
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.missions import MissionRef
from kleinkram.contract.people import PersonRef
from kleinkram.server.access.actor import Actor, ActorKind
from kleinkram.server.access.rights import require_mission
from kleinkram.server.access.visible import sees_whole_missions
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.checks import queries
from kleinkram.server.checks.action_checks import without_run
from kleinkram.server.checks.combine import Failure, failure_of
from kleinkram.server.checks.facts import JudgedMission, read_missions
from kleinkram.server.checks.judge import current_acceptances, present_rules
from kleinkram.server.db import Connection
from kleinkram.server.jobs.rejudge import judge_again
from kleinkram.server.missions import service as missions
from kleinkram.server.pagination import PageRequest, Rows, fetch_page
from kleinkram.server.runs.declared_inputs import present_reference
from kleinkram.server.tables import check_acceptance, check_note, check_report, mission_checks

_MAX_NOTES = 1000
_MAX_REPORTS_OF_PERSON = 5


async def get_mission_checks(
    db: Connection,
    actor: Actor,
    *,
    mission_id: uuid.UUID,
    matching: MissionCheckFilter,
    page: PageRequest,
    with_history: bool,
) -> MissionChecksRead:
    """Return a page of the checks of a mission, worst first, and what else is known of its verdict.

    With history, also acceptances that ended and outdated reports. Actors who see only some of its files get none.
    Those without an account get no notes, reports, runs and names of people, and only the acceptances that apply.

    Raises:
        NotFound: the mission does not exist, or is not visible.
        InvalidCursor: the cursor belongs to another list.
    """
    row = (await db.execute(queries.checks_of_mission(actor, mission_id))).one_or_none()
    if row is None:
        raise NotFound(resource_type="mission", ref=str(mission_id))
    is_shown = sees_whole_missions(actor) and row.evaluated_at is not None
    rows = Rows([], None, None)
    if is_shown:
        rows = await fetch_page(db, *queries.listed_checks(mission_id, matching), page)
    checks = [MissionCheck.model_validate(one.stored) for one in rows.items]
    has_additions = sees_whole_missions(actor) and page.cursor is None
    acceptances, notes, reports = await _additions(db, mission_id) if has_additions else ([], [], [])
    if actor.kind is not ActorKind.person:
        checks, notes, reports, with_history = [without_run(check) for check in checks], [], [], False
        acceptances = [one.model_copy(update={"created_by": None}) for one in acceptances]
    return MissionChecksRead(
        verdict=row.verdict,
        counts=CheckCounts.model_validate(row.counts),
        checks=checks,
        next=rows.next,
        checks_number=row.checks_number or 0 if is_shown else 0,
        profiles_applied=row.profiles_applied if is_shown else [],
        profiles_left_out=[ProfileLeftOut.model_validate(one) for one in row.profiles_left_out] if is_shown else [],
        reference=await present_reference(db, mission_id) if has_additions else None,
        is_current=bool(row.is_current) and is_shown,
        evaluated_at=row.evaluated_at if is_shown else None,
        bad_since=row.bad_since if is_shown else None,
        acceptances=[one for one in acceptances if with_history or one.ended is None],
        notes=notes,
        reports=[one for one in reports if with_history or one.is_current],
    )


async def accept_check(
    db: Connection, actor: Actor, *, mission_id: uuid.UUID, accepted: CheckAcceptanceCreate
) -> CheckAcceptanceRead:
    """Let what fails of a check no longer count, until the files change; replaces the acceptance that it had.

    Raises:
        NotFound: the mission does not exist, or is not visible.
        Forbidden: the actor may not change it.
        InvalidRequest: no such check of its present files fails, or it is accepted already.
    """
    ref, judged = await _lock(db, actor, "accept_check", mission_id)
    failures = await _failures(db, actor, judged, accepted)
    own = (check_acceptance.c.mission_id == mission_id, check_acceptance.c.check_name == accepted.check)
    alike = (check_acceptance.c.topic.is_not_distinct_from(accepted.topic), check_acceptance.c.ended.is_(None))
    replaced = {"ended": AcceptanceEnd.replaced.value, "ended_at": func.now(), "ended_by_id": actor.person_id}
    await db.execute(update(check_acceptance).where(*own, *alike).values(**replaced))
    acceptance_id = uuid.uuid4()
    values: dict[str, object] = {
        "check_name": accepted.check,
        "topic": accepted.topic,
        "because": accepted.because,
        "failures": [*failures],
    }
    values |= {"id": acceptance_id, "mission_id": mission_id, "inputs_sha256": judged.inputs_sha256}
    await db.execute(insert(check_acceptance).values(**values, created_by_id=actor.person_id))
    await judge_again(db, [mission_id])
    after: Metadata = {"check": accepted.check, "topic": accepted.topic, "because": accepted.because}
    await audit(db, actor, _event("mission.accept_check", ref, after=after))
    return await _acceptance(db, mission_id, acceptance_id)


async def withdraw_acceptance(
    db: Connection, actor: Actor, *, mission_id: uuid.UUID, acceptance_id: uuid.UUID
) -> CheckAcceptanceRead:
    """End an acceptance, so that the check counts again; nothing changes where it ended already.

    Raises:
        NotFound: the mission or the acceptance does not exist, or is not visible.
        Forbidden: the actor may not change the mission.
    """
    ref, _ = await _lock(db, actor, "withdraw_acceptance", mission_id)
    old = await _acceptance(db, mission_id, acceptance_id)
    if old.ended is not None:
        return old
    values = {"ended": AcceptanceEnd.withdrawn.value, "ended_at": func.now(), "ended_by_id": actor.person_id}
    await db.execute(update(check_acceptance).where(check_acceptance.c.id == acceptance_id).values(**values))
    await judge_again(db, [mission_id])
    before: Metadata = {"check": old.check, "topic": old.topic, "because": old.because}
    await audit(db, actor, _event("mission.withdraw_acceptance", ref, before=before))
    return await _acceptance(db, mission_id, acceptance_id)


async def create_note(db: Connection, actor: Actor, *, mission_id: uuid.UUID, note: CheckNoteCreate) -> CheckNoteRead:
    """Add a note to a check of a mission.

    Raises:
        NotFound: the mission does not exist, or is not visible.
        Forbidden: the actor may not change it.
        InvalidRequest: it has very many notes.
    """
    ref, _ = await _lock(db, actor, "create_check_note", mission_id)
    existing = select(func.count()).where(check_note.c.mission_id == mission_id)
    if (await db.execute(existing)).scalar_one() >= _MAX_NOTES:
        raise _invalid("text", f"a mission has at most {_MAX_NOTES} notes on checks")
    note_id = uuid.uuid4()
    values = {"id": note_id, "mission_id": mission_id, "check_name": note.check, "topic": note.topic, "text": note.text}
    await db.execute(insert(check_note).values(**values, created_by_id=actor.person_id))
    after: Metadata = {"check": note.check, "topic": note.topic, "text": note.text}
    await audit(db, actor, _event("mission.create_check_note", ref, after=after))
    rows = await db.execute(queries.notes_of(mission_id).where(check_note.c.id == note_id))
    return _to_note(rows.one())


async def delete_note(db: Connection, actor: Actor, *, mission_id: uuid.UUID, note_id: uuid.UUID) -> None:
    """Delete a note. Raises NotFound or Forbidden."""
    ref, _ = await _lock(db, actor, "delete_check_note", mission_id)
    row = (await db.execute(queries.notes_of(mission_id).where(check_note.c.id == note_id))).one_or_none()
    if row is None:
        raise NotFound(resource_type="note", ref=str(note_id))
    await db.execute(delete(check_note).where(check_note.c.id == note_id))
    before: Metadata = {"check": row.check_name, "topic": row.topic, "text": row.text}
    await audit(db, actor, _event("mission.delete_check_note", ref, before=before))


async def create_report(
    db: Connection, actor: Actor, *, mission_id: uuid.UUID, report: CheckReportCreate
) -> CheckReportRead:
    """Store the checks that an uploader or a run made, in place of an earlier report of the same files for this person.

    Of each person, the latest reports stay: those by themselves, and those of runs that acted for them.

    Raises:
        NotFound: the mission does not exist, or is not visible.
        Forbidden: the actor may not add files to it.
    """
    ref, judged = await _lock(db, actor, "create_check_report", mission_id)
    document, report_id = bytes.fromhex(report.document_sha256), uuid.uuid4()
    # A run whose report counts is known by it, so that an uploader replaces none.
    is_alike = check_report.c.run_id.is_(None) if actor.run_id is None else check_report.c.run_id.is_not(None)
    own = (check_report.c.mission_id == mission_id, check_report.c.created_by_id == actor.person_id, is_alike)
    profiles = sorted(report.profiles_applied)
    rules = (check_report.c.document_sha256 == document, check_report.c.profiles == profiles)
    alike = (*rules, check_report.c.depth == report.depth.value, check_report.c.files == report.files)
    await db.execute(delete(check_report).where(*own, *alike))
    verdict = verdict_of({check.status for check in report.checks})
    values = {
        "id": report_id,
        "mission_id": mission_id,
        "document_sha256": document,
        "depth": report.depth.value,
        "verdict": verdict.value,
        "profiles": profiles,
        "files": report.files,
        "checks": [check.model_dump(mode="json", exclude_none=True) for check in report.checks],
        "created_by_id": actor.person_id,
        "run_id": actor.run_id,
    }
    await db.execute(insert(check_report).values(**values))
    obsolete = (
        queries.reports_of(mission_id).where(*own).with_only_columns(check_report.c.id).offset(_MAX_REPORTS_OF_PERSON)
    )
    await db.execute(delete(check_report).where(check_report.c.id.in_(obsolete)))
    await judge_again(db, [mission_id])
    after: Metadata = {"verdict": verdict.value, "depth": report.depth.value, "checks": len(report.checks)}
    await audit(db, actor, _event("mission.report_checks", ref, after=after))
    row = (await db.execute(queries.reports_of(mission_id).where(check_report.c.id == report_id))).one()
    return _to_report(row, await _current_reports(db, judged))


async def _lock(
    db: Connection, actor: Actor, operation: str, mission_id: uuid.UUID
) -> tuple[MissionRef, JudgedMission]:
    """Lock a mission for a change of what its verdict depends on. Raises NotFound or Forbidden."""
    await missions.lock_mission(db, mission_id)
    await require_mission(db, actor, operation, mission_id)
    return await missions.get_mission_ref(db, actor, mission_id), (await read_missions(db, [mission_id]))[0]


async def _additions(
    db: Connection, mission_id: uuid.UUID
) -> tuple[list[CheckAcceptanceRead], list[CheckNoteRead], list[CheckReportRead]]:
    acceptances = [_to_acceptance(row) for row in await db.execute(queries.acceptances_of(mission_id))]
    notes = [_to_note(row) for row in await db.execute(queries.notes_of(mission_id))]
    rows = (await db.execute(queries.reports_of(mission_id))).all()
    if not rows:
        return acceptances, notes, []
    (judged,) = await read_missions(db, [mission_id])
    current = await _current_reports(db, judged)
    return acceptances, notes, [_to_report(row, current) for row in rows]


async def _current_reports(db: Connection, judged: JudgedMission) -> set[uuid.UUID]:
    """Return the reports of the present files and by the present rules; by any, if the project has none."""
    rules = await present_rules(db, judged)
    stmt = select(check_report.c.id).where(check_report.c.mission_id == judged.id, queries.is_of_files(judged))
    if rules is not None:
        stmt = stmt.where(queries.is_by_rules(rules))
    return {*(await db.execute(stmt)).scalars()}


async def _acceptance(db: Connection, mission_id: uuid.UUID, acceptance_id: uuid.UUID) -> CheckAcceptanceRead:
    stmt = queries.acceptances_of(mission_id).where(check_acceptance.c.id == acceptance_id)
    row = (await db.execute(stmt)).one_or_none()
    if row is None:
        raise NotFound(resource_type="acceptance", ref=str(acceptance_id))
    return _to_acceptance(row)


async def _failures(
    db: Connection, actor: Actor, judged: JudgedMission, accepted: CheckAcceptanceCreate
) -> set[Failure]:
    """Return the failures that a person accepts. Raises InvalidRequest."""
    stmt = queries.checks_of_mission(actor, judged.id).add_columns(mission_checks.c.checks)
    row = (await db.execute(stmt)).one()
    checked = (row.files_revision, row.checks_number)
    if row.checks is not None and checked != (judged.files_revision, judged.checks_number):
        raise _invalid("check", "files or rules of this mission changed since it was checked; wait for its new checks")
    meant = [MissionCheck.model_validate(check) for check in row.checks or () if _is_meant(check, accepted)]
    if not meant:
        raise _invalid("check", f"no check {accepted.check} of this mission fails{_on(accepted.topic)}")
    failures = {failure_of(check) for check in meant}
    current = (await current_acceptances(db, [judged.id]))[judged.id]
    if failures <= {failure for one in current if one.check == accepted.check for failure in one.failures}:
        raise _invalid("check", f"{accepted.check} is accepted already{_on(accepted.topic)}")
    return failures


def _is_meant(check: dict[str, Any], accepted: CheckAcceptanceCreate) -> bool:
    fails = check["name"] == accepted.check and check["status"] in ("error", "warning", "not_made")
    return fails and (accepted.topic is None or accepted.topic == check.get("topic"))


def _on(topic: str | None) -> str:
    return f" on {topic}" if topic is not None else ""


def _invalid(field: str, message: str) -> InvalidRequest:
    return InvalidRequest(problems=[FieldProblem(field=field, message=message)])


def _event(operation: str, ref: MissionRef, *, before: Metadata | None = None, after: Metadata | None = None) -> Event:
    place = (ref.id, ref.name, ref.project.id)
    return Event(operation, "mission", *place, before or {}, after or {}, mission_id=ref.id)


def _to_acceptance(row: Row[Any]) -> CheckAcceptanceRead:
    has_ender = row.ended_by_id is not None
    return CheckAcceptanceRead(
        id=row.id,
        check=row.check_name,
        topic=row.topic,
        because=row.because,
        failure_count=len(row.failures),
        created_at=row.created_at,
        created_by=PersonRef(id=row.created_by_id, name=row.created_by_name),
        ended=row.ended,
        ended_at=row.ended_at,
        ended_by=PersonRef(id=row.ended_by_id, name=row.ended_by_name) if has_ender else None,
    )


def _to_note(row: Row[Any]) -> CheckNoteRead:
    return CheckNoteRead(
        id=row.id,
        check=row.check_name,
        topic=row.topic,
        text=row.text,
        created_at=row.created_at,
        created_by=PersonRef(id=row.created_by_id, name=row.created_by_name),
    )


def _to_report(row: Row[Any], current_ids: Set[uuid.UUID]) -> CheckReportRead:
    return CheckReportRead(
        id=row.id,
        verdict=Verdict(row.verdict),
        depth=row.depth,
        document_sha256=row.document_sha256.hex(),
        check_count=row.check_count,
        file_count=row.file_count,
        is_current=row.id in current_ids,
        created_at=row.created_at,
        created_by=PersonRef(id=row.created_by_id, name=row.created_by_name),
        run_id=row.run_id,
    )
