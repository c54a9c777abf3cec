"""The missions of a project by their checks: as a matrix, and over time."""

import uuid
from collections import Counter, defaultdict
from typing import Any

from sqlalchemy import DateTime, Numeric, Row, Select, cast, func, select

from kleinkram.contract.base import NamedRef
from kleinkram.contract.checks import (
    CellStatus,
    CheckCounts,
    CheckMatrix,
    CheckMatrixRow,
    CheckTrend,
    TrendBucket,
    TrendStep,
    Verdict,
)
from kleinkram.contract.missions import MissionSort
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.rights import require_project
from kleinkram.server.access.visible import sees_whole_missions, shown_span, visible_missions
from kleinkram.server.db import Connection
from kleinkram.server.filters.verdicts import join_checks, shown_counts, shown_verdict
from kleinkram.server.missions.queries import mission_order
from kleinkram.server.pagination import PageRequest, fetch_page
from kleinkram.server.tables import mission, mission_checks


async def get_matrix(db: Connection, actor: Actor, *, project_id: uuid.UUID, page: PageRequest) -> CheckMatrix:
    """Return a page of a project's missions, latest first, and of each check its worst status.

    Raises:
        NotFound: the project does not exist, or is not visible.
        InvalidCursor: the cursor belongs to another list.
    """
    await require_project(db, actor, "get_check_matrix", project_id)
    order = mission_order(actor, MissionSort.start_desc)
    rows = await fetch_page(db, _matrix_rows(actor, project_id), order, page)
    is_seen = sees_whole_missions(actor)
    items = [_to_row(row, is_seen=is_seen) for row in rows.items]
    return CheckMatrix(checks=_by_failures(items), items=items, next=rows.next, total=rows.total)


async def get_trend(db: Connection, actor: Actor, *, project_id: uuid.UUID, by: TrendStep) -> CheckTrend:
    """Return the number of missions by verdict and by the day or week of their recordings. Raises NotFound."""
    await require_project(db, actor, "get_check_trend", project_id)
    verdicts: dict[Any, dict[Verdict, int]] = defaultdict(dict)
    for start, verdict, count in await db.execute(_trend_rows(actor, project_id, by)):
        verdicts[start.date()][Verdict(verdict)] = count
    return CheckTrend(by=by, buckets=[TrendBucket(start=start, verdicts=verdicts[start]) for start in sorted(verdicts)])


def _matrix_rows(actor: Actor, project_id: uuid.UUID) -> Select[Any]:
    columns = (mission.c.id, mission.c.name, shown_span(actor)[0].label("shown_start_ns"), mission_checks.c.statuses)
    shown = (shown_verdict(actor).label("verdict"), shown_counts(actor).label("counts"))
    stmt = visible_missions(actor).with_only_columns(*columns, *shown, maintain_column_froms=True)
    return join_checks(stmt).where(mission.c.project_id == project_id)


def _to_row(row: Row[Any], *, is_seen: bool) -> CheckMatrixRow:
    return CheckMatrixRow(
        mission=NamedRef(id=row.id, name=row.name),
        start_ns=row.shown_start_ns,
        verdict=row.verdict,
        counts=CheckCounts.model_validate(row.counts),
        cells=row.statuses or {} if is_seen else {},
    )


def _by_failures(rows: list[CheckMatrixRow]) -> list[str]:
    failures: Counter[str] = Counter()
    for row in rows:
        for name, status in row.cells.items():
            failures[name] += status in (CellStatus.error, CellStatus.warning)
    return sorted(failures, key=lambda name: (-failures[name], name))


def _trend_rows(actor: Actor, project_id: uuid.UUID, by: TrendStep) -> Select[Any]:
    # Log time begins in 1970, in UTC.
    recorded_at = func.to_timestamp(cast(shown_span(actor)[0], Numeric) / 10**9)
    at = func.timezone("UTC", func.coalesce(recorded_at, mission.c.created_at))
    stmt = visible_missions(actor).with_only_columns(
        func.date_trunc(by.value, at, type_=DateTime).label("start"),
        shown_verdict(actor).label("verdict"),
        maintain_column_froms=True,
    )
    inside = join_checks(stmt).where(mission.c.project_id == project_id).subquery()
    counted = select(inside.c.start, inside.c.verdict, func.count())
    return counted.group_by(inside.c.start, inside.c.verdict)
