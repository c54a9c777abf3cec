"""Reads runs, their inputs, reports, artifacts and lineage."""

import datetime
import uuid
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, TypeVar

from sqlalchemy import ColumnElement, RowMapping, or_, select

from kleinkram.contract import runs
from kleinkram.contract.access import Right, Scope
from kleinkram.contract.actions import ActionDefinition
from kleinkram.contract.base import Page
from kleinkram.contract.checks import Check, CheckStatus
from kleinkram.contract.errors import FileUnavailable, NotFound
from kleinkram.contract.files import BlobState, FetchPurpose
from kleinkram.contract.isolation import Isolation
from kleinkram.contract.locks import pinned_versions
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.missions import MissionRef
from kleinkram.contract.people import PersonRef
from kleinkram.contract.projects import ProjectRef
from kleinkram.contract.reports import Finding, Metric, Severity
from kleinkram.server import metrics
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import visible_files
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.context import AppContext
from kleinkram.server.db import Connection, among
from kleinkram.server.pagination import PageRequest, fetch_page, read_page
from kleinkram.server.runs import queries
from kleinkram.server.runs.eligibility import Needs, known_runners, to_needs
from kleinkram.server.tables import blob, file, run, run_artifact, run_input
from kleinkram.server.tables.runs import ACTIVE

_MAX_LINEAGE_RUNS = 100
_MAX_LINEAGE_FILES = 1000
_FETCHED = {FetchPurpose.download: "run.download", FetchPurpose.preview: "run.preview"}
UNREADABLE = {BlobState.lost.value, BlobState.corrupt.value}
# The fields of `RunRead` that are columns of the same name.
_SAME = (
    *("id", "version_id", "network", "parameters", "state", "reason", "message", "exit_code", "progress"),
    *(
        "attempt",
        "priority",
        "isolation",
        "placement",
        "is_recorded",
        "image_digest",
        "usage",
        "input_count",
        "input_bytes",
        "artifact_count",
        "metric_count",
    ),
    *(
        "finding_counts",
        "check_counts",
        "verdict",
        "reuses_id",
        "created_at",
        "claimed_at",
        "started_at",
        "ended_at",
        "cancel_requested_at",
    ),
)


class VisibleRun(NamedTuple):
    """A run without its metrics and what it waits for, the actor's level on its mission, and who launched it."""

    run: runs.RunRead
    needs: Needs
    level: int
    started_by_id: uuid.UUID

    @property
    def results_id(self) -> uuid.UUID:
        """The run with its results: itself, or the earlier one that it reuses."""
        return self.run.reuses_id or self.run.id


async def list_runs(
    db: Connection, actor: Actor, *, matching: runs.RunFilter, page: PageRequest, weakest: Isolation
) -> Page[runs.RunRead]:
    """Return a page of the runs that match, latest first. `weakest` is the setting `weakest_isolation`.

    Raises:
        InvalidCursor: the cursor is not of this list.
    """
    stmt = queries.run_rows(actor, queries.filter_runs(actor, queries.visible_runs(actor), matching))
    rows = await fetch_page(db, stmt, queries.RUN_ORDER, page)
    items = await _complete(db, actor, weakest, [_to_run(actor, row._mapping) for row in rows.items])
    return Page(items=items, next=rows.next, total=rows.total)


async def get_run(db: Connection, actor: Actor, run_id: uuid.UUID, *, weakest: Isolation) -> runs.RunRead:
    """Return one run. `weakest` is the setting `weakest_isolation`.

    Raises:
        NotFound: it is not there, or not for this actor.
    """
    (complete,) = await _complete(db, actor, weakest, [await find_run(db, actor, run_id)])
    return complete


async def get_detail(db: Connection, actor: Actor, run_id: uuid.UUID, *, weakest: Isolation) -> runs.RunDetail:
    """Return one run with its details. `weakest` is the setting `weakest_isolation`.

    Raises:
        NotFound: it is not there, or not for this actor.
    """
    row = await _find_row(db, actor, run_id)
    (complete,) = await _complete(db, actor, weakest, [_to_run(actor, row)])
    definition = row["definition"]
    return runs.RunDetail(
        **dict(complete),
        definition=ActionDefinition.model_validate(definition | {"lock": None}),
        packages=pinned_versions(definition.get("lock")),
        problems=row["problems"],
        metadata=row["proposed"],
        previews=row["previews"],
        samples=row["samples"],
    )


async def find_run(db: Connection, actor: Actor, run_id: uuid.UUID) -> VisibleRun:
    """Return one run with what operations on it check.

    Raises:
        NotFound: it is not there, or not for this actor.
    """
    return _to_run(actor, await _find_row(db, actor, run_id))


async def _find_row(db: Connection, actor: Actor, run_id: uuid.UUID) -> RowMapping:
    row = (await db.execute(queries.one_run(actor, run_id))).mappings().one_or_none()
    if row is None:
        raise NotFound(resource_type="run", ref=str(run_id))
    return row


def _to_run(actor: Actor, mapping: RowMapping) -> VisibleRun:
    """Convert a row of `queries.run_rows`."""
    # A list has thousands of values: of a dictionary, they are read faster.
    row = dict(mapping)
    started_by_id: uuid.UUID = row["started_by_id"]
    needed = Right.create if started_by_id == actor.person_id else Right.delete
    starter = PersonRef(id=started_by_id, name=row["started_by_name"])
    read = runs.RunRead(
        **{name: row[name] for name in _SAME},
        mission=_to_mission(row),
        action=_to_action(row),
        cause=runs.Cause(person=starter, retry_of_id=row["retry_of_id"]),
        runner=row["runner_name"],
        waits_for=None,
        metrics=[],
        may_cancel=row["level"] >= needed.level and Scope.run in actor.scopes and row["state"] in ACTIVE,
    )
    return VisibleRun(read, to_needs(row), row["level"], started_by_id)


def _to_mission(row: Mapping[Any, Any]) -> MissionRef:
    project = ProjectRef(id=row["project_id"], name=row["project_name"])
    return MissionRef(id=row["mission_id"], name=row["mission_name"], project=project)


def _to_action(row: Mapping[Any, Any]) -> runs.ActionRef:
    return runs.ActionRef(id=row["action_id"], name=row["action_name"], version=row["action_number"])


async def _complete(
    db: Connection, actor: Actor, weakest: Isolation, visible: Sequence[VisibleRun]
) -> list[runs.RunRead]:
    """Add what queued runs wait for, and the first metrics."""
    waits_for: dict[uuid.UUID, str] = {}
    if queued := [entry for entry in visible if entry.run.state is runs.RunState.queued]:
        known = await known_runners(db, weakest)
        # Runs that are launched together need the same.
        reasons = {needs: known.reason_waiting(needs) for needs in {entry.needs for entry in queued}}
        waits_for = {entry.run.id: reasons[entry.needs] for entry in queued}
    metrics: dict[uuid.UUID, list[Metric]] = {}
    if with_metrics := {entry.results_id for entry in visible if entry.run.metric_count > 0}:
        for row in await db.execute(queries.first_metrics(actor, [*with_metrics])):
            metric = Metric.model_construct(**{name: getattr(row, name) for name in Metric.model_fields})
            metrics.setdefault(row.run_id, []).append(metric)
    return [
        entry.run.model_copy(
            update={"waits_for": waits_for.get(entry.run.id), "metrics": metrics.get(entry.results_id, [])}
        )
        for entry in visible
    ]


async def list_inputs(db: Connection, actor: Actor, *, run_id: uuid.UUID, page: PageRequest) -> Page[runs.RunInput]:
    """Return a page of the inputs of a run, by path, without files that were moved out of `actor`'s sight.

    Raises:
        NotFound: the run is not there, or not for this actor.
        InvalidCursor: the cursor is not of this list.
    """
    await _find_row(db, actor, run_id)
    rows = await fetch_page(db, queries.inputs_of(actor, [run_id]), queries.INPUT_ORDER, page)
    items = [
        runs.RunInput(path=row.path, size_bytes=row.size_bytes, sha256=row.sha256.hex(), file_id=row.file_id)
        for row in rows.items
    ]
    return Page(items=items, next=rows.next, total=rows.total)


async def list_artifacts(
    db: Connection, actor: Actor, *, run_id: uuid.UUID, page: PageRequest
) -> Page[runs.ArtifactRead]:
    """Return a page of the artifacts of a run, by path.

    Raises:
        NotFound: the run is not there, or not for this actor.
        InvalidCursor: the cursor is not of this list.
    """
    stmt = queries.artifacts_of(actor, (await find_run(db, actor, run_id)).results_id)
    return await read_page(db, stmt, queries.ARTIFACT_ORDER, page, lambda row: _to_artifact(row._mapping))


def _to_artifact(row: RowMapping) -> runs.ArtifactRead:
    same = {name: row[name] for name in ("id", "run_id", "path", "size_bytes", "file_id")}
    return runs.ArtifactRead(**same, sha256=row["sha256"].hex())


async def link_artifacts(
    context: AppContext, actor: Actor, *, run_id: uuid.UUID, requested: runs.ArtifactsRequest
) -> list[runs.ArtifactUrl]:
    """Return URLs of artifacts, in the requested order, and record who downloads or previews them.

    Raises:
        NotFound: one of them is not there, or not for this actor.
        FileUnavailable: the store's copy of one is lost or corrupt.
    """
    artifact_ids = requested.artifact_ids
    async with context.database.begin() as db:
        visible = await find_run(db, actor, run_id)
        stmt = queries.artifacts_of(actor, visible.results_id).where(among(run_artifact.c.id, artifact_ids))
        rows_by_id = {row.id: row for row in await db.execute(stmt)}
        for entry in artifact_ids:
            if entry not in rows_by_id:
                raise NotFound(resource_type="artifact", ref=str(entry))
            if rows_by_id[entry].state in UNREADABLE:
                raise FileUnavailable(path=rows_by_id[entry].path, state=rows_by_id[entry].state)
        after: Metadata = {"files": len(rows_by_id)}
        name, where = visible.run.action.name, visible.run.mission
        operation, project_id = _FETCHED[requested.purpose], where.project.id
        event = Event(operation, "run", run_id, name, project_id, after=after, mission_id=where.id)
        await audit(db, actor, event)
    size_bytes = sum(row.size_bytes for row in rows_by_id.values())
    metrics.count_downloads(files=len(rows_by_id), size_bytes=size_bytes)
    expires_s = context.settings.download_url_s
    expires_at = datetime.datetime.now(datetime.timezone.utc) + datetime.timedelta(seconds=expires_s)
    return [
        runs.ArtifactUrl(
            artifact=_to_artifact(rows_by_id[entry]._mapping),
            url=context.storage.sign_get(rows_by_id[entry].key, path=rows_by_id[entry].path, expires_s=expires_s),
            expires_at=expires_at,
        )
        for entry in artifact_ids
    ]


async def list_checks(
    db: Connection, actor: Actor, *, matching: runs.CheckFilter, page: PageRequest
) -> Page[runs.CheckRead]:
    """Return a page of the checks that runs reported, those of the latest run first, in the order of its report.

    Raises:
        NotFound: a run is named that is not there, or not for this actor.
        InvalidCursor: the cursor is not of this list.
    """
    stmt = queries.checks(actor, await _of_results(db, actor, matching))
    return await read_page(db, stmt, queries.CHECK_ORDER, page, lambda row: _to_check(row._mapping))


def _to_check(row: RowMapping) -> runs.CheckRead:
    names = Check.model_fields.keys() - {"status"}
    reported = Check.model_construct(
        status=CheckStatus(row["reported_status"]), **{name: row[f"reported_{name}"] for name in names}
    )
    return runs.CheckRead(**_reported_where(row), check=reported)


async def list_findings(
    db: Connection, actor: Actor, *, matching: runs.FindingFilter, page: PageRequest
) -> Page[runs.FindingRead]:
    """Return a page of findings, those of the latest run first, in the order of its report.

    Raises:
        NotFound: a run is named that is not there, or not for this actor.
        InvalidCursor: the cursor is not of this list.
    """
    stmt = queries.findings(actor, await _of_results(db, actor, matching))
    return await read_page(db, stmt, queries.FINDING_ORDER, page, lambda row: _to_finding(row._mapping))


def _to_finding(row: RowMapping) -> runs.FindingRead:
    names = ("code", "message", "file", "topic", "time_ns")
    reported = Finding.model_construct(
        severity=Severity(row["reported_severity"]), **{name: row[f"reported_{name}"] for name in names}
    )
    return runs.FindingRead(**_reported_where(row), finding=reported)


async def list_metrics(
    db: Connection, actor: Actor, *, matching: runs.MetricFilter, page: PageRequest
) -> Page[runs.MetricRead]:
    """Return a page of metrics, those of the latest run first, in the order of its report.

    Raises:
        NotFound: a run is named that is not there, or not for this actor.
        InvalidCursor: the cursor is not of this list.
    """
    stmt = queries.metrics(actor, await _of_results(db, actor, matching))
    return await read_page(db, stmt, queries.METRIC_ORDER, page, lambda row: _to_metric(row._mapping))


def _to_metric(row: RowMapping) -> runs.MetricRead:
    reported = Metric.model_construct(**{name: row[f"reported_{name}"] for name in Metric.model_fields})
    return runs.MetricRead(**_reported_where(row), metric=reported)


def _reported_where(row: RowMapping) -> dict[str, Any]:
    ids = {"id": row["reported_id"], "run_id": row["reported_run_id"]}
    of_run = {"parameters": row["parameters"], "ended_at": row["ended_at"]}
    return {**ids, **of_run, "mission": _to_mission(row), "action": _to_action(row)}


_FilterT = TypeVar("_FilterT", bound=runs.ReportFilter)


async def _of_results(db: Connection, actor: Actor, matching: _FilterT) -> _FilterT:
    if matching.run_id is None:
        return matching
    return matching.model_copy(update={"run_id": (await find_run(db, actor, matching.run_id)).results_id})


async def get_lineage(db: Connection, actor: Actor, *, file_id: uuid.UUID) -> runs.LineageRead:
    """Return the run that produced a file and those that read it, with their results, as far as `actor` may see them.

    Raises:
        NotFound: the file is not there, or not for this actor.
    """
    columns = (file.c.id, file.c.path, blob.c.sha256, file.c.blob_id)
    stmt = visible_files(actor).with_only_columns(*columns, maintain_column_froms=True).where(file.c.id == file_id)
    row = (await db.execute(stmt)).one_or_none()
    if row is None:
        raise NotFound(resource_type="file", ref=str(file_id))
    producers = select(run_artifact.c.run_id, run_artifact.c.derived_from).where(run_artifact.c.file_id == file_id)
    produced = (await db.execute(producers)).one_or_none()
    # By content, too: it may have been read under another name, or before it was moved.
    readers = select(run_input.c.run_id).where(
        or_(run_input.c.file_id == file_id, run_input.c.blob_id == row.blob_id), run_input.c.sha256 == row.sha256
    )
    read_by = await _find_runs(db, actor, run.c.id.in_(readers))
    made_by = [] if produced is None else await _find_runs(db, actor, run.c.id == produced.run_id)
    lineage_runs = await _with_files(db, actor, [*read_by[:_MAX_LINEAGE_RUNS], *made_by])
    maker = lineage_runs[made_by[0].id] if made_by else None
    if maker is not None and produced is not None and produced.derived_from:
        # Only those inputs that it reported as sources.
        sources = [entry for entry in maker.inputs if entry.path in produced.derived_from]
        maker = maker.model_copy(update={"inputs": sources})
    return runs.LineageRead(
        file=runs.LineageFile(id=row.id, path=row.path, sha256=row.sha256.hex()),
        made_by=maker,
        read_by=[lineage_runs[entry.id] for entry in read_by[:_MAX_LINEAGE_RUNS]],
        truncated=len(read_by) > _MAX_LINEAGE_RUNS,
    )


async def _find_runs(db: Connection, actor: Actor, condition: ColumnElement[bool]) -> list[runs.RunRead]:
    stmt = queries.run_rows(actor, queries.visible_runs(actor).where(condition))
    rows = await db.execute(stmt.order_by(run.c.created_at.desc()).limit(_MAX_LINEAGE_RUNS + 1))
    return [_to_run(actor, row).run for row in rows.mappings()]


async def _with_files(
    db: Connection, actor: Actor, shown_runs: Sequence[runs.RunRead]
) -> dict[uuid.UUID, runs.LineageRun]:
    run_ids = {entry.id for entry in shown_runs}
    stmt = queries.inputs_of(actor, [*run_ids]).order_by(run_input.c.path).limit(_MAX_LINEAGE_FILES)
    inputs = [_LineageRow(row.run_id, row.file_id, row.path, row.sha256) for row in await db.execute(stmt)]
    columns = (run_artifact.c.run_id, run_artifact.c.file_id, file.c.path, blob.c.sha256)
    stmt = select(*columns).join_from(run_artifact, file, file.c.id == run_artifact.c.file_id)
    joined = stmt.join(blob, blob.c.id == file.c.blob_id).join(run, run.c.id == run_artifact.c.run_id)
    shown_files = among(run_artifact.c.run_id, run_ids) & ~queries.is_hidden(actor, run_artifact.c.file_id)
    made_stmt = joined.where(shown_files).order_by(file.c.path).limit(_MAX_LINEAGE_FILES)
    made = [_LineageRow._make(row) for row in await db.execute(made_stmt)]
    ids = {row.file_id for row in [*inputs, *made] if row.file_id}
    seen = visible_files(actor).with_only_columns(file.c.id, maintain_column_froms=True)
    visible = set((await db.execute(seen.where(among(file.c.id, ids)))).scalars())

    def files_of(rows: Sequence[_LineageRow], run_id: uuid.UUID) -> list[runs.LineageFile]:
        return [
            runs.LineageFile(id=row.file_id if row.file_id in visible else None, path=row.path, sha256=row.sha256.hex())
            for row in rows
            if row.run_id == run_id
        ]

    return {
        entry.id: runs.LineageRun(
            run=entry,
            inputs=files_of(inputs, entry.id),
            files=files_of(made, entry.id),
            artifact_count=entry.artifact_count,
        )
        for entry in shown_runs
    }


class _LineageRow(NamedTuple):
    run_id: uuid.UUID
    file_id: uuid.UUID | None
    path: str
    sha256: bytes
