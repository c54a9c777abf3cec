"""Reads runs, their inputs, reports, artifacts and lineage."""

import datetime
import uuid
from collections.abc import Sequence
from typing import Any

from sqlalchemy import ColumnElement, Row, or_, select

from kleinkram.contract.base import Page
from kleinkram.contract.errors import FileUnavailable, NotFound
from kleinkram.contract.files import BlobState
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.reports import Metric
from kleinkram.contract.runs import (
    ArtifactRead,
    ArtifactUrl,
    FindingRead,
    LineageFile,
    LineageRead,
    LineageRun,
    MetricRead,
    ReportFilter,
    RunDetail,
    RunFilter,
    RunInput,
    RunRead,
    RunState,
)
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import visible_files
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.context import AppContext
from kleinkram.server.db import Connection, among
from kleinkram.server.pagination import PageRequest, fetch_page
from kleinkram.server.runners.eligibility import has_single_person, known_runners, reason_waiting
from kleinkram.server.runs import queries
from kleinkram.server.tables import blob, file, run, run_artifact, run_input

_MAX_LINEAGE_RUNS = 100
_MAX_LINEAGE_FILES = 1000
_UNREADABLE = {BlobState.lost.value, BlobState.corrupt.value}


async def list_runs(db: Connection, actor: Actor, *, matching: RunFilter, page: PageRequest) -> Page[RunRead]:
    """Return a page of the runs that match, latest first.

    Raises:
        InvalidCursor: the cursor is not of this list.
    """
    rows_by_id = queries.run_rows(actor, queries.narrow(actor, queries.visible_runs(actor), matching))
    rows = await fetch_page(db, rows_by_id, queries.RUN_ORDER, page)
    waiting, metrics = await _waiting(db, rows.items), await _metrics(db, actor, rows.items)
    items = [
        queries.to_run(actor, row, waits_for=waiting.get(row.id), metrics=metrics.get(row.id, ())) for row in rows.items
    ]
    return Page(items=items, next=rows.next, total=rows.total)


async def get_run(db: Connection, actor: Actor, run_id: uuid.UUID) -> RunRead:
    """Return one run.

    Raises:
        NotFound: it is not there, or not for this actor.
    """
    row = await find_run_row(db, actor, run_id)
    waiting, metrics = await _waiting(db, [row]), await _metrics(db, actor, [row])
    return queries.to_run(actor, row, waits_for=waiting.get(row.id), metrics=metrics.get(row.id, ()))


async def get_detail(db: Connection, actor: Actor, run_id: uuid.UUID) -> RunDetail:
    """Return one run with its details.

    Raises:
        NotFound: it is not there, or not for this actor.
    """
    row = await find_run_row(db, actor, run_id)
    waiting, metrics = await _waiting(db, [row]), await _metrics(db, actor, [row])
    return queries.to_detail(actor, row, waits_for=waiting.get(row.id), metrics=metrics.get(row.id, ()))


async def find_run_row(db: Connection, actor: Actor, run_id: uuid.UUID) -> Row[Any]:
    """Return the row of a run, as `queries.whole_run` selects it.

    Raises:
        NotFound: it is not there, or not for this actor.
    """
    row = (await db.execute(queries.whole_run(actor, run_id))).one_or_none()
    if row is None:
        raise NotFound(noun="run", ref=str(run_id))
    return row


async def _waiting(db: Connection, rows: Sequence[Row[Any]]) -> dict[uuid.UUID, str]:
    queued = [row for row in rows if row.state == RunState.queued.value]
    if not queued:
        return {}
    known, alone = await known_runners(db), await has_single_person(db)
    return {row.id: reason_waiting(row, known, single_person=alone) for row in queued}


async def _metrics(db: Connection, actor: Actor, rows: Sequence[Row[Any]]) -> dict[uuid.UUID, list[Metric]]:
    results = {row.id: row.reuses_id or row.id for row in rows if row.metric_count > 0}
    if not results:
        return {}
    reported: dict[uuid.UUID, list[Metric]] = {}
    for entry in await db.execute(queries.first_metrics(actor, [*results.values()])):
        metric = Metric.model_construct(name=entry.name, value=entry.value, unit=entry.unit, file=entry.file)
        reported.setdefault(entry.run_id, []).append(metric)
    return {run_id: reported.get(result, []) for run_id, result in results.items()}


async def results_of(db: Connection, actor: Actor, run_id: uuid.UUID) -> uuid.UUID:
    """Return the run with the results of a run: itself, or the earlier one that it reuses.

    Raises:
        NotFound: it is not there, or not for this actor.
    """
    row = await find_run_row(db, actor, run_id)
    rows_by_id: uuid.UUID = row.reuses_id or row.id
    return rows_by_id


async def list_inputs(db: Connection, actor: Actor, *, run_id: uuid.UUID, page: PageRequest) -> Page[RunInput]:
    """Return a page of the inputs of a run, by path, without files that were moved out of `actor`'s sight.

    Raises:
        NotFound: the run is not there, or not for this actor.
        InvalidCursor: the cursor is not of this list.
    """
    await find_run_row(db, actor, run_id)
    rows = await fetch_page(db, queries.inputs_of(actor, [run_id]), queries.INPUT_ORDER, page)
    return Page(items=[queries.to_input(row) for row in rows.items], next=rows.next, total=rows.total)


async def list_artifacts(db: Connection, actor: Actor, *, run_id: uuid.UUID, page: PageRequest) -> Page[ArtifactRead]:
    """Return a page of the artifacts of a run, by path.

    Raises:
        NotFound: the run is not there, or not for this actor.
        InvalidCursor: the cursor is not of this list.
    """
    stmt = queries.artifacts_of(actor, await results_of(db, actor, run_id))
    rows = await fetch_page(db, stmt, queries.ARTIFACT_ORDER, page)
    return Page(items=[queries.to_artifact(row) for row in rows.items], next=rows.next, total=rows.total)


async def link_artifacts(
    context: AppContext, actor: Actor, *, run_id: uuid.UUID, artifact_ids: Sequence[uuid.UUID]
) -> list[ArtifactUrl]:
    """Return URLs of artifacts, in the requested order, and record the download.

    Raises:
        NotFound: one of them is not there, or not for this actor.
        FileUnavailable: the store's copy of one is lost or corrupt.
    """
    async with context.database.begin() as db:
        run_row = await find_run_row(db, actor, run_id)
        stmt = queries.artifacts_of(actor, run_row.reuses_id or run_id).where(among(run_artifact.c.id, artifact_ids))
        rows_by_id = {row.id: row for row in await db.execute(stmt)}
        for entry in artifact_ids:
            if entry not in rows_by_id:
                raise NotFound(noun="artifact", ref=str(entry))
            if rows_by_id[entry].state in _UNREADABLE:
                raise FileUnavailable(path=rows_by_id[entry].path, state=rows_by_id[entry].state)
        after: Metadata = {"files": len(rows_by_id)}
        name, project_id = run_row.action_name, run_row.project_id
        fetched = Event("run.download", "run", run_id, name, project_id, after=after, mission_id=run_row.mission_id)
        await audit(db, actor, fetched)
    expires_s = context.settings.download_url_s
    expires_at = datetime.datetime.now(datetime.timezone.utc) + datetime.timedelta(seconds=expires_s)
    return [
        ArtifactUrl(
            artifact=queries.to_artifact(rows_by_id[entry]),
            url=context.storage.sign_get(rows_by_id[entry].key, path=rows_by_id[entry].path, expires_s=expires_s),
            expires_at=expires_at,
        )
        for entry in artifact_ids
    ]


async def list_findings(
    db: Connection, actor: Actor, *, matching: ReportFilter, page: PageRequest
) -> Page[FindingRead]:
    """Return a page of findings, latest first.

    Raises:
        NotFound: a run is named that is not there, or not for this actor.
        InvalidCursor: the cursor is not of this list.
    """
    stmt = queries.findings(actor, await _of_results(db, actor, matching))
    rows = await fetch_page(db, stmt, queries.FINDING_ORDER, page)
    return Page(items=[queries.to_finding(row) for row in rows.items], next=rows.next, total=rows.total)


async def list_metrics(db: Connection, actor: Actor, *, matching: ReportFilter, page: PageRequest) -> Page[MetricRead]:
    """Return a page of metrics, latest first.

    Raises:
        NotFound: a run is named that is not there, or not for this actor.
        InvalidCursor: the cursor is not of this list.
    """
    stmt = queries.metrics(actor, await _of_results(db, actor, matching))
    rows = await fetch_page(db, stmt, queries.METRIC_ORDER, page)
    return Page(items=[queries.to_metric(row) for row in rows.items], next=rows.next, total=rows.total)


async def _of_results(db: Connection, actor: Actor, matching: ReportFilter) -> ReportFilter:
    if matching.run_id is None:
        return matching
    return matching.model_copy(update={"run_id": await results_of(db, actor, matching.run_id)})


async def lock_run(db: Connection, run_id: uuid.UUID) -> None:
    """Lock a run until this transaction ends."""
    await db.execute(run.select().where(run.c.id == run_id).with_for_update(key_share=True))


async def get_lineage(db: Connection, actor: Actor, *, file_id: uuid.UUID) -> LineageRead:
    """Return the run that produced a file and those that read it, with their results, as far as `actor` may see them.

    Raises:
        NotFound: the file is not there, or not for this actor.
    """
    columns = (file.c.id, file.c.path, blob.c.sha256, file.c.blob_id)
    stmt = visible_files(actor).with_only_columns(*columns, maintain_column_froms=True).where(file.c.id == file_id)
    row = (await db.execute(stmt)).one_or_none()
    if row is None:
        raise NotFound(noun="file", ref=str(file_id))
    maker = select(run_artifact.c.run_id, run_artifact.c.made_from).where(run_artifact.c.file_id == file_id)
    made = (await db.execute(maker)).one_or_none()
    # By content, too: it may have been read under another name, or before it was moved.
    readers = select(run_input.c.run_id).where(
        or_(run_input.c.file_id == file_id, run_input.c.blob_id == row.blob_id), run_input.c.sha256 == row.sha256
    )
    rows_by_id = await _runs(db, actor, run.c.id.in_(readers))
    makers = [] if made is None else await _runs(db, actor, run.c.id == made.run_id)
    named = await _with_files(db, actor, [*rows_by_id[:_MAX_LINEAGE_RUNS], *makers])
    made_by = None if not makers else _only_sources(named[makers[0].id], made.made_from if made else [])
    return LineageRead(
        file=LineageFile(id=row.id, path=row.path, sha256=row.sha256.hex()),
        made_by=made_by,
        read_by=[named[entry.id] for entry in rows_by_id[:_MAX_LINEAGE_RUNS]],
        truncated=len(rows_by_id) > _MAX_LINEAGE_RUNS,
    )


async def _runs(db: Connection, actor: Actor, condition: ColumnElement[bool]) -> Sequence[Row[Any]]:
    stmt = queries.run_rows(actor, queries.visible_runs(actor).where(condition))
    return (await db.execute(stmt.order_by(run.c.created_at.desc()).limit(_MAX_LINEAGE_RUNS + 1))).all()


async def _with_files(db: Connection, actor: Actor, rows: Sequence[Row[Any]]) -> dict[uuid.UUID, LineageRun]:
    run_ids = {row.id for row in rows}
    stmt = queries.inputs_of(actor, [*run_ids])
    input_rows = (await db.execute(stmt.order_by(run_input.c.path).limit(_MAX_LINEAGE_FILES))).all()
    columns = (run_artifact.c.run_id, run_artifact.c.file_id, file.c.path, blob.c.sha256)
    stmt = select(*columns).join_from(run_artifact, file, file.c.id == run_artifact.c.file_id)
    joined = stmt.join(blob, blob.c.id == file.c.blob_id).join(run, run.c.id == run_artifact.c.run_id)
    shown_files = among(run_artifact.c.run_id, run_ids) & ~queries.is_hidden(actor, run_artifact.c.file_id)
    made = (await db.execute(joined.where(shown_files).order_by(file.c.path).limit(_MAX_LINEAGE_FILES))).all()
    ids = {row.file_id for row in [*input_rows, *made] if row.file_id}
    seen = visible_files(actor).with_only_columns(file.c.id, maintain_column_froms=True)
    visible = set((await db.execute(seen.where(among(file.c.id, ids)))).scalars())

    def shown(row: Row[Any]) -> LineageFile:
        return LineageFile(id=row.file_id if row.file_id in visible else None, path=row.path, sha256=row.sha256.hex())

    return {
        row.id: LineageRun(
            run=queries.to_run(actor, row),
            inputs=[shown(entry) for entry in input_rows if entry.run_id == row.id],
            files=[shown(entry) for entry in made if entry.run_id == row.id],
            artifact_count=row.artifact_count,
        )
        for row in rows
    }


def _only_sources(made_by: LineageRun, made_from: Sequence[str] | None) -> LineageRun:
    """Return the run that produced a file with only those inputs that it reported as sources."""
    if not made_from:
        return made_by
    return made_by.model_copy(update={"inputs": [entry for entry in made_by.inputs if entry.path in made_from]})
