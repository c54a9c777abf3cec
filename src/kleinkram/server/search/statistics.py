"""Statistics of the files that match a filter: hours, bytes, files and messages, by group and in total."""

import re
from collections.abc import Iterable, Sequence
from typing import Any

from sqlalchemy import (
    BigInteger,
    ColumnElement,
    Select,
    Text,
    and_,
    cast,
    distinct,
    func,
    null,
    select,
    true,
)

from kleinkram.contract.errors import InvalidQuery
from kleinkram.contract.files import FileFilter
from kleinkram.contract.search import StatsRead, StatsRow
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import (
    sees_whole_missions,
    shown_recordings,
    visible_files,
    visible_missions,
    visible_projects,
)
from kleinkram.server.db import Connection
from kleinkram.server.filters.files import filter_files, filter_topics, metadata_text
from kleinkram.server.search.planner import ENLARGE_WORK_MEMORY
from kleinkram.server.tables import DERIVED_ORIGIN, blob, file, mission, project, recording, topic

# More rows than anybody reads, and few enough for one response.
MAX_GROUPS = 10_000
_METADATA = re.compile(r"metadata\.([^.]+(?:\.[^.]+)*)")
_NUMBERS = ("missions", "files", "size_bytes", "messages", "recordings", "duration_ns")


async def get_stats(
    db: Connection, actor: Actor, *, by: str, matching: FileFilter, with_derived: bool = False
) -> StatsRead:
    """Return statistics of the files that match, grouped by `by`, and in total.

    Files that runs made count only `with_derived`.

    Raises:
        InvalidQuery: there is no such grouping, it has more than `MAX_GROUPS` groups, or a `where` cannot be used.
    """
    group = _group_column(by)
    if group is None:
        reason = "statistics go by project, mission, topic, type, month, format or metadata.FIELD"
        raise InvalidQuery(expression=by, reason=reason)
    if by.startswith("metadata."):
        await _require_field(db, actor, by.removeprefix("metadata."))
    by_topic = by in {"topic", "type"}
    await db.execute(ENLARGE_WORK_MEMORY)
    chosen = true() if with_derived else file.c.origin != DERIVED_ORIGIN
    grouped = _statistics(actor, matching, chosen, group=group, by_topic=by_topic)
    rows = [_to_stats(*row) for row in await db.execute(grouped.limit(MAX_GROUPS + 1))]
    if len(rows) > MAX_GROUPS:
        reason = f"these files make more than {MAX_GROUPS} groups; narrow the filter, or group by something coarser"
        raise InvalidQuery(expression=by, reason=reason)
    if by in {"project", "mission"} or by.startswith("metadata."):
        # Each mission is in one group.
        return StatsRead(by=by, rows=rows, total=add_up(rows))
    total = (await db.execute(_statistics(actor, matching, chosen, group=null(), by_topic=by_topic))).one_or_none()
    return StatsRead(by=by, rows=rows, total=add_up([]) if total is None else _to_stats(*total))


def add_up(rows: Iterable[StatsRow]) -> StatsRow:
    """Return the total of groups that share no mission."""
    all_rows = list(rows)
    return StatsRow(group=None, **{name: sum(getattr(row, name) for row in all_rows) for name in _NUMBERS})


def _to_stats(group: str | None, *numbers: int | None) -> StatsRow:
    return StatsRow(group=group, **{name: int(number or 0) for name, number in zip(_NUMBERS, numbers, strict=True)})


async def _require_field(db: Connection, actor: Actor, field: str) -> None:
    """Check that a visible mission has a metadata field, or that a visible project declares it. Raises InvalidQuery."""
    if not sees_whole_missions(actor):
        reason = "your token or link does not include the metadata of missions"
        raise InvalidQuery(expression=f"metadata.{field}", reason=reason)
    path = field.split(".")
    is_present = visible_missions(actor).with_only_columns(true()).where(metadata_text(path).is_not(None)).limit(1)
    declares = project.c.metadata_fields.contains({"fields": [{"name": path[0]}]})
    declared = visible_projects(actor).with_only_columns(true()).where(declares).limit(1)
    if not (await db.execute(select(is_present.exists() | declared.exists()))).scalar_one():
        name = func.jsonb_object_keys(mission.c.metadata).label("name")
        fields = visible_missions(actor).with_only_columns(name, maintain_column_froms=True).distinct()
        names = ", ".join((await db.execute(fields.order_by(name).limit(20))).scalars()) or "none"
        reason = f"no mission has such a field; say project, mission, topic, type, month, format or a field: {names}"
        raise InvalidQuery(expression=field, reason=reason)


def _group_column(by: str) -> ColumnElement[Any] | None:
    if metadata_path := _METADATA.fullmatch(by):
        return metadata_text(metadata_path[1].split("."))
    # Files of one recording belong to the month in which it began.
    start_ns = func.coalesce(recording.c.start_ns, blob.c.start_ns)
    began = func.to_timestamp(cast(start_ns / 1_000_000_000, BigInteger))
    columns: dict[str, ColumnElement[Any]] = {
        "project": project.c.name,
        "mission": project.c.name.concat("/").concat(mission.c.name),
        "topic": topic.c.name,
        "type": topic.c.message_type,
        "month": func.to_char(func.timezone("UTC", began), "YYYY-MM"),
        "format": blob.c.format,
    }
    return columns.get(by)


def _statistics(
    actor: Actor, matching: FileFilter, chosen: ColumnElement[bool], *, group: ColumnElement[Any], by_topic: bool
) -> Select[Any]:
    """Return one row for each group, in order: `group` and `_NUMBERS`.

    A file counts once in each of its groups, and so does a recording.
    """
    files = _grouped_files(actor, matching, group=group, by_topic=by_topic).where(chosen).cte("files")
    sums = (
        select(
            files.c.group,
            func.count(distinct(files.c.mission_id)).label("missions"),
            func.count().label("files"),
            func.sum(files.c.size_bytes).label("size_bytes"),
            func.sum(files.c.messages).label("messages"),
        )
        .group_by(files.c.group)
        .subquery()
    )
    seen = select(files.c.group, files.c.recording_id).where(files.c.recording_id.is_not(None)).distinct().subquery()
    spans = (
        select(
            seen.c.group,
            func.count().label("recordings"),
            func.sum(recording.c.end_ns - recording.c.start_ns).label("duration_ns"),
        )
        .join_from(seen, recording, recording.c.id == seen.c.recording_id)
        .group_by(seen.c.group)
        .subquery()
    )
    joined = sums.outerjoin(spans, sums.c.group.is_not_distinct_from(spans.c.group))
    rows = select(*sums.c, spans.c.recordings, spans.c.duration_ns).select_from(joined)
    return rows.order_by(sums.c.group.collate("C").nulls_last())


def _grouped_files(actor: Actor, matching: FileFilter, *, group: ColumnElement[Any], by_topic: bool) -> Select[Any]:
    own_recording = and_(recording.c.id == file.c.recording_id, shown_recordings(actor))
    stmt = filter_files(actor, visible_files(actor), matching).outerjoin(recording, own_recording)
    if by_topic:
        # Files without topics stay, in the group without a name, unless the filter names topics.
        stmt = filter_topics(stmt.outerjoin(topic, topic.c.blob_id == blob.c.id), matching)
    own: Sequence[ColumnElement[Any]] = (
        file.c.id,
        file.c.mission_id,
        recording.c.id.label("recording_id"),
        blob.c.size_bytes,
    )
    label = cast(group, Text).label("group")
    if not by_topic:  # a row is a file
        return stmt.with_only_columns(label, *own, blob.c.message_count.label("messages"), maintain_column_froms=True)
    messages = func.sum(topic.c.count).label("messages")
    return stmt.with_only_columns(label, *own, messages, maintain_column_froms=True).group_by(label, *own)
