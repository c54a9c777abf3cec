"""The timeline of a mission, and statistics of missions in a limited number of buckets."""

import math
import sys
import uuid
from collections.abc import Iterable, Sequence

from kleinkram.contract.errors import InvalidQuery, NotFound
from kleinkram.contract.files import FileFilter, MissionTimeline
from kleinkram.contract.metadata import FieldType, MetadataField
from kleinkram.contract.search import Bucket, Overview, StatsRow
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import sees_whole_missions
from kleinkram.server.db import Connection
from kleinkram.server.overviews import queries
from kleinkram.server.pagination import PageRequest, fetch_page
from kleinkram.server.projects import service as projects
from kleinkram.server.search.statistics import add_up, get_stats


async def get_timeline(db: Connection, actor: Actor, *, mission_id: uuid.UUID, page: PageRequest) -> MissionTimeline:
    """Return start and end of the files of a mission, by path.

    Raises:
        NotFound: the mission does not exist, or is not visible.
        InvalidCursor: the cursor belongs to another list.
    """
    span = (await db.execute(queries.mission_span(actor, mission_id))).one_or_none()
    if span is None:
        raise NotFound(resource_type="mission", ref=str(mission_id))
    rows = await fetch_page(db, queries.timeline_files(actor, mission_id), queries.TIMELINE_ORDER, page)
    items = [queries.to_timeline_file(row) for row in rows.items]
    return MissionTimeline(start_ns=span.start_ns, end_ns=span.end_ns, items=items, next=rows.next)


_MONTH = "month"


async def get_project_stats(
    db: Connection, actor: Actor, *, project_id: uuid.UUID, by: str, max_buckets: int
) -> Overview:
    """Return statistics of a project.

    Raises:
        NotFound: the project does not exist, or is not visible.
        InvalidQuery: as in `get_overview`.
    """
    declared = (await projects.get_project(db, actor, project_id)).metadata_fields.fields
    named = by.removeprefix("metadata.") if by != _MONTH else None
    field = next((field for field in declared if field.name == named), None)
    return await get_overview(db, actor, project_id=project_id, by=by, max_buckets=max_buckets, field=field)


async def get_overview(
    db: Connection,
    actor: Actor,
    *,
    project_id: uuid.UUID | None,
    by: str,
    max_buckets: int,
    field: MetadataField | None = None,
) -> Overview:
    """Return statistics of all visible missions, or of one project; `field` is the declaration of `by`.

    Raises:
        InvalidQuery: no mission has this field, it has too many values, or its values are not visible.
    """
    group = by if by == _MONTH or by.startswith("metadata.") else f"metadata.{by}"
    stats = await get_stats(db, actor, by=group, matching=FileFilter(project_id=project_id))
    if field is None and by != _MONTH and stats.rows and all(row.group is None for row in stats.rows):
        raise InvalidQuery(expression=by, reason="no mission has this field; specify month or a metadata field")
    with_value = [row for row in stats.rows if row.group is not None]
    buckets, other = _bucketed(with_value, field, max_buckets) if by != _MONTH else (_one_bucket_each(with_value), None)
    topics = None
    if sees_whole_missions(actor):
        topics = (await db.execute(queries.topic_count(actor, project_id))).scalar_one()
    return Overview(
        by=by,
        unit=field.unit if field else None,
        buckets=[*buckets, *(Bucket(value=None, stats=row) for row in stats.rows if row.group is None)],
        other=other,
        total=stats.total,
        topics=topics,
    )


def _one_bucket_each(rows: Iterable[StatsRow]) -> list[Bucket]:
    return [Bucket(value=row.group, stats=row) for row in rows]


def _bucketed(
    rows: Sequence[StatsRow], field: MetadataField | None, max_buckets: int
) -> tuple[list[Bucket], StatsRow | None]:
    numbers = {row.group: number for row in rows if (number := _number(row.group)) is not None}
    # An undeclared field is numeric if all of its values are numbers.
    is_number = field.type is FieldType.number if field else len(numbers) == len(rows)
    if not is_number:
        ranked = sorted(rows, key=lambda row: (-row.duration_ns, -row.size_bytes, row.group or ""))
        return _one_bucket_each(ranked[:max_buckets]), add_up(ranked[max_buckets:]) if ranked[max_buckets:] else None
    counted = sorted((row for row in rows if row.group in numbers), key=lambda row: numbers[row.group])
    non_numeric = [row for row in rows if row.group not in numbers]
    ranges = _one_bucket_each(counted) if len(counted) <= max_buckets else _ranges(counted, numbers, max_buckets)
    return ranges, add_up(non_numeric) if non_numeric else None


def _ranges(rows: Sequence[StatsRow], numbers: dict[str | None, float], max_buckets: int) -> list[Bucket]:
    values = [numbers[row.group] for row in rows]
    step = _step(values[0], values[-1], max_buckets)
    inside: dict[int, list[StatsRow]] = {}
    for row, value in zip(rows, values, strict=True):
        inside.setdefault(math.floor(value / step), []).append(row)
    return [
        Bucket(value=None, low=_edge(number * step), high=_edge((number + 1) * step), stats=add_up(rows_inside))
        for number, rows_inside in inside.items()
    ]


def _step(low: float, high: float, max_buckets: int) -> float:
    """Return a step of 1, 2 or 5 times a power of ten, for at most `max_buckets` + 1 steps."""
    min_step = min(max(high / max_buckets - low / max_buckets, 1e-300), 1e308)
    power = 10.0 ** math.floor(math.log10(min_step))
    return next(times * power for times in (1, 2, 5, 10) if times * power >= min_step)


def _edge(number: float) -> float:
    # JSON has no infinity.
    return max(-sys.float_info.max, min(sys.float_info.max, number))


def _number(text: str | None) -> float | None:
    try:
        number = float(text or "")
    except ValueError:
        return None
    return number if math.isfinite(number) else None
