"""What the actions that a project names say of its missions: of each, the result that counts.

That is the latest run that has ended, of the latest version, with the parameters of the project, on the present inputs:
bytes of files, and the metadata, checks and reference that the action declares. Older results are history.
"""

import enum
import uuid
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from sqlalchemy import Row, Select, select

from kleinkram.contract.actions import ActionDefinition, ParametersWrong, ParameterValues
from kleinkram.contract.checks import Check, CheckStatus, Verdict
from kleinkram.contract.files import FileFilter
from kleinkram.contract.reports import Finding, Severity
from kleinkram.contract.runs import RunState
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import visible_files
from kleinkram.server.db import Connection, among
from kleinkram.server.filters.files import filter_files
from kleinkram.server.runs.declared_inputs import DeclaredInputs, read_declared_inputs
from kleinkram.server.runs.launch import inputs_fingerprint
from kleinkram.server.tables import (
    DERIVED_ORIGIN,
    action,
    action_version,
    blob,
    file,
    mission,
    project_action,
    project_action_mission,
    run,
    run_check,
    run_finding,
)
from kleinkram.server.tables.runs import ACTIVE

# Sees the files of all missions, for jobs that act for nobody.
_SERVER = Actor(None, "the server", None, None, is_admin=True)
_ENDED = frozenset((RunState.done.value, RunState.failed.value))


class ResultState(str, enum.Enum):
    """State of the result of an action on a mission.

    failed: every run on the present inputs failed. outdated: there are only results of an earlier version, or of other
    inputs. missing: there are none at all. without_input: no file of the mission is an input of the action.
    """

    done = "done"
    failed = "failed"
    running = "running"
    outdated = "outdated"
    missing = "missing"
    without_input = "without_input"


@dataclass(frozen=True)
class ActionResult:
    """What an action that a project names says of a mission. Checks and findings are empty unless it is `done`.

    Attributes:
        version: the latest one of the action.
        run_id: the run with this state; None for `missing` and `without_input`.
        source_run_id: the run that reported the results: `run_id`, or the run that it reuses. Only if it is `done`.
        is_running: a run that would count has not ended. An earlier one that has ended counts until then.
        message: how the run ended; of a missing one, the problem for which it did not start.
        findings: warnings and errors.
    """

    mission_id: uuid.UUID
    action_id: uuid.UUID
    name: str
    version: int
    state: ResultState
    run_id: uuid.UUID | None = None
    source_run_id: uuid.UUID | None = None
    is_running: bool = False
    message: str = ""
    verdict: Verdict | None = None
    checks: Sequence[Check] = ()
    findings: Sequence[Finding] = ()


class _Named(NamedTuple):
    id: uuid.UUID
    project_id: uuid.UUID
    action_id: uuid.UUID
    parameters: ParameterValues
    name: str
    version_id: uuid.UUID
    number: int
    definition: ActionDefinition


class PresentInput(NamedTuple):
    """A file of a mission that an action would read now."""

    path: str
    sha256: bytes


async def project_results(
    db: Connection, mission_ids: Sequence[uuid.UUID]
) -> Mapping[uuid.UUID, Sequence[ActionResult]]:
    """Return the results that count, of each action that the project of a mission names, by mission.

    A few statements for each action that is named, for any number of missions.
    """
    projects = {row.id: row.project_id for row in await db.execute(_missions(mission_ids))}
    results: dict[uuid.UUID, list[ActionResult]] = {mission_id: [] for mission_id in mission_ids}
    for named in await _named_actions(db, {*projects.values()}):
        own = [mission_id for mission_id, project_id in projects.items() if project_id == named.project_id]
        inputs = await present_inputs(db, named.definition, own)
        declared = await read_declared_inputs(db, named.definition.inputs, [*inputs])
        runs = await _runs(db, named.action_id, [*inputs])
        problems = await _problems(db, named, [*inputs])
        for mission_id in own:
            present = inputs.get(mission_id, ()), declared.get(mission_id, DeclaredInputs())
            result = _result(named, mission_id, *present, runs.get(mission_id, ()))
            if result.state is ResultState.missing:
                result = replace(result, message=problems.get(mission_id, ""))
            results[mission_id].append(result)
    await _add_reports(db, results)
    return results


def _result(
    named: _Named,
    mission_id: uuid.UUID,
    inputs: Sequence[PresentInput],
    declared: DeclaredInputs,
    runs: Sequence[Row[Any]],
) -> ActionResult:
    """Return the result of the runs of an action on a mission, latest first."""
    missing = ActionResult(mission_id, named.action_id, named.name, named.number, ResultState.missing)
    try:
        parameters = named.definition.fill_in(named.parameters)
    except ParametersWrong as error:  # a later version has other parameters
        return replace(missing, state=ResultState.failed, message=str(error))
    if not inputs:
        return replace(missing, state=ResultState.without_input)
    fingerprint = inputs_fingerprint(named.version_id, parameters, inputs, declared)
    current = [row for row in runs if row.inputs_fingerprint == fingerprint]
    running = next((row for row in current if row.state in ACTIVE), None)
    done = next((row for row in current if row.state == RunState.done.value), None)
    # A later attempt that failed says nothing about the mission, and does not hide what an earlier one found.
    counting = done or next((row for row in current if row.state in _ENDED), None)
    if counting is not None:
        verdict = None if counting.verdict is None else Verdict(counting.verdict)
        result = replace(missing, state=ResultState(counting.state), run_id=counting.id, message=counting.message)
        return replace(result, is_running=running is not None, verdict=verdict)
    if running is not None:
        return replace(missing, state=ResultState.running, run_id=running.id, is_running=True)
    earlier = next((row for row in runs if row.state in _ENDED), None)
    if earlier is not None:
        return replace(missing, state=ResultState.outdated, run_id=earlier.id)
    return missing


def _missions(mission_ids: Sequence[uuid.UUID]) -> Select[Any]:
    return select(mission.c.id, mission.c.project_id).where(among(mission.c.id, mission_ids))


async def _named_actions(db: Connection, project_ids: set[uuid.UUID]) -> list[_Named]:
    """Return the actions that projects name, in their latest versions, in the order in which they were added."""
    named = (project_action.c.id, project_action.c.project_id, project_action.c.action_id, project_action.c.parameters)
    columns = (*named, action.c.name)
    version = (action_version.c.id.label("version_id"), action_version.c.number, action_version.c.definition)
    stmt = (
        select(*columns, *version)
        .distinct(project_action.c.created_at, project_action.c.id)
        .join_from(project_action, action, action.c.id == project_action.c.action_id)
        .join(action_version, action_version.c.action_id == action.c.id)
        .where(among(project_action.c.project_id, project_ids))
        .order_by(project_action.c.created_at, project_action.c.id, action_version.c.number.desc())
    )
    return [
        _Named._make(row)._replace(definition=ActionDefinition.model_validate(row.definition))
        for row in await db.execute(stmt)
    ]


async def present_inputs(
    db: Connection, definition: ActionDefinition, mission_ids: Sequence[uuid.UUID]
) -> Mapping[uuid.UUID, list[PresentInput]]:
    """Return the files that an action would read now, by mission and in the order of their paths."""
    requested = definition.inputs
    matching = FileFilter(path=requested.paths, topic=requested.topics, message_type=requested.message_types)
    columns = (file.c.mission_id, file.c.path, blob.c.sha256)
    stmt = filter_files(_SERVER, visible_files(_SERVER), matching).with_only_columns(
        *columns, maintain_column_froms=True
    )
    stmt = stmt.where(among(file.c.mission_id, mission_ids))
    if not requested.derived:
        stmt = stmt.where(file.c.origin != DERIVED_ORIGIN)
    inputs: dict[uuid.UUID, list[PresentInput]] = defaultdict(list)
    for row in await db.execute(stmt.order_by(file.c.mission_id, file.c.path)):
        inputs[row.mission_id].append(PresentInput(row.path, row.sha256))
    return inputs


async def _problems(db: Connection, named: _Named, mission_ids: Sequence[uuid.UUID]) -> Mapping[uuid.UUID, str]:
    """Return why an action that was due did not start, by mission."""
    decided = project_action_mission
    stmt = select(decided.c.mission_id, decided.c.problem).where(decided.c.project_action_id == named.id)
    rows = await db.execute(stmt.where(among(decided.c.mission_id, mission_ids), decided.c.problem.is_not(None)))
    return {row.mission_id: row.problem for row in rows}


async def _runs(
    db: Connection, action_id: uuid.UUID, mission_ids: Sequence[uuid.UUID]
) -> Mapping[uuid.UUID, list[Row[Any]]]:
    """Return the runs of all versions of an action by mission, latest first."""
    names = ("id", "mission_id", "state", "verdict", "message", "inputs_fingerprint")
    stmt = select(*(run.c[name] for name in names)).join(action_version, action_version.c.id == run.c.version_id)
    stmt = stmt.where(action_version.c.action_id == action_id, among(run.c.mission_id, mission_ids))
    runs: dict[uuid.UUID, list[Row[Any]]] = defaultdict(list)
    for row in await db.execute(stmt.order_by(run.c.created_at.desc(), run.c.id.desc())):
        runs[row.mission_id].append(row)
    return runs


async def _add_reports(db: Connection, results: dict[uuid.UUID, list[ActionResult]]) -> None:
    """Replace results that are done by ones with the checks and findings of their runs."""
    done = {result.run_id for listed in results.values() for result in listed if result.state is ResultState.done}
    rows = await db.execute(select(run.c.id, run.c.reuses_id).where(among(run.c.id, done)))
    reporting = {row.id: row.reuses_id or row.id for row in rows}
    checks: dict[uuid.UUID, list[Check]] = defaultdict(list)
    findings: dict[uuid.UUID, list[Finding]] = defaultdict(list)
    own = among(run_check.c.run_id, {*reporting.values()})
    for row in (await db.execute(select(run_check).where(own).order_by(run_check.c.id))).mappings():
        fields = {name: row[name] for name in Check.model_fields} | {"status": CheckStatus(row["status"])}
        checks[row["run_id"]].append(Check.model_construct(**fields))
    own = among(run_finding.c.run_id, {*reporting.values()}) & (run_finding.c.severity != Severity.info.value)
    for row in (await db.execute(select(run_finding).where(own).order_by(run_finding.c.id))).mappings():
        fields = {name: row[name] for name in Finding.model_fields} | {"severity": Severity(row["severity"])}
        findings[row["run_id"]].append(Finding.model_construct(**fields))
    for listed in results.values():
        for number, result in enumerate(listed):
            if result.state is ResultState.done and result.run_id is not None:
                source = reporting[result.run_id]
                reported = {"source_run_id": source, "checks": checks[source], "findings": findings[source]}
                listed[number] = replace(result, **reported)
