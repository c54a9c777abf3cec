"""Topics across files, and statistics. Functions return selects; they touch no connection."""

import re
from collections.abc import Iterable, Sequence
from typing import Any

from sqlalchemy import (
    BigInteger,
    ColumnElement,
    Integer,
    Row,
    Select,
    Text,
    and_,
    bindparam,
    case,
    cast,
    distinct,
    func,
    literal,
    null,
    select,
    text,
    true,
)

from kleinkram.contract.files import FileFilter
from kleinkram.contract.search import StatsRow, TopicFound
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import shown_recordings, visible_files, visible_missions, visible_projects
from kleinkram.server.db import Written
from kleinkram.server.files.queries import topic_rows
from kleinkram.server.filters.files import filter_files, filter_topics
from kleinkram.server.filters.metadata import metadata_text
from kleinkram.server.filters.plan import SearchPlan, rounded
from kleinkram.server.filters.text import contains, words_of
from kleinkram.server.tables import blob, file, mission, project, recording, topic

_METADATA = re.compile(r"metadata\.([^.]+(?:\.[^.]+)*)")
_NUMBERS = ("missions", "files", "recordings", "size_bytes", "duration_ns", "messages")


def matching_topics(actor: Actor, matching: FileFilter) -> Select[Any]:
    """Return the topics of the files that match, with those files; topic and type globs narrow the topics too."""
    return filter_topics(topic_rows(filter_files(actor, visible_files(actor), matching)), matching)


# Enough memory to count many topics, until the transaction ends.
ENLARGE_WORK_MEMORY = text("SELECT set_config('work_mem', '32MB', true)")
# Has lists read in the order of an index until the transaction ends.
AVOID_SORTING = text("SELECT set_config('enable_sort', 'off', true)")


def topics_found(actor: Actor, matching: FileFilter, *, plan: SearchPlan, by_blobs: bool, limit: int) -> Select[Any]:
    """Return the first topics of the files that match, each name and type once, with the `total` of them all.

    With `by_blobs`, of the `topic_blob_ids`, which this very request has found among the files that match.

    Those whose names contain the most words of the filter come first, then those of the most files.
    """
    if by_blobs:
        files = select(func.unnest(bindparam("topic_blob_ids", type_=Written("UUID"))).label("blob_id"))
    else:
        files = filter_files(actor, visible_files(actor), matching, plan)
        files = files.with_only_columns(file.c.blob_id, maintain_column_froms=True)
    files_found = files.cte("found").prefix_with("MATERIALIZED")
    # A blob names each topic once, so that there is a row for each of its files. OFFSET 0 keeps PostgreSQL from
    # reading all topics there are instead of those of each blob.
    its_topics = filter_topics(select(topic).where(topic.c.blob_id == files_found.c.blob_id), matching)
    one_topic = its_topics.offset(0).lateral("each_topic")
    name, message_type, file_count = one_topic.c.name, one_topic.c.message_type, func.count()
    columns = (
        name,
        message_type,
        file_count.label("file_count"),
        func.sum(one_topic.c.count).label("message_count"),
        func.count().over().label("total"),
    )
    label = name.concat(func.coalesce(literal(" ").concat(message_type), ""))
    words = map(plan.word, words_of(matching.text))
    word_count = sum((case((contains(label, word), 1), else_=0) for word in words), literal(0, Integer))
    grouped = select(*columns).join_from(files_found, one_topic, true()).group_by(name, message_type)
    return grouped.order_by(word_count.desc(), file_count.desc(), name, message_type).limit(limit)


def to_topic_found(row: Row[Any], times: float) -> TopicFound:
    """Return the topic that a row of `topics_found` stands for; one file drawn stands for so many."""
    messages = row.message_count
    return TopicFound(
        name=row.name,
        message_type=row.message_type,
        file_count=row.file_count if times == 1 else rounded(round(row.file_count * times)),
        message_count=messages if messages is None or times == 1 else rounded(round(float(messages) * times)),
    )


def group_column(by: str) -> ColumnElement[Any] | None:
    """Return what statistics group by, or None where there is no such group."""
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


def has_field(actor: Actor, by: str) -> Select[Any]:
    """Return whether a visible mission has the field of `metadata.FIELD`, or a visible project declares it."""
    path = by.removeprefix("metadata.").split(".")
    is_present = visible_missions(actor).with_only_columns(true()).where(metadata_text(path).is_not(None)).limit(1)
    declares = project.c.metadata_fields.contains({"fields": [{"name": path[0]}]})
    declared = visible_projects(actor).with_only_columns(true()).where(declares).limit(1)
    return select(is_present.exists() | declared.exists())


def field_names(actor: Actor) -> Select[Any]:
    """Return the names of metadata fields of visible missions, in order."""
    name = func.jsonb_object_keys(mission.c.metadata).label("name")
    return (
        visible_missions(actor).with_only_columns(name, maintain_column_froms=True).distinct().order_by(name).limit(20)
    )


def shares_no_mission(by: str) -> bool:
    """Say whether each mission is in one group, with all that it holds: then the groups add up to the whole."""
    return by in {"project", "mission"} or _METADATA.fullmatch(by) is not None


def statistics(
    actor: Actor, matching: FileFilter, *, group: ColumnElement[Any], by_topic: bool, whole: bool
) -> Select[Any]:
    """Return one row a group, by group, or with `whole` the one row over all groups.

    A file counts once in each of its groups, and so does a recording.
    """
    files = _grouped_files(actor, matching, group=null() if whole else group, by_topic=by_topic).cte("files")
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
    chosen = select(*sums.c, spans.c.recordings, spans.c.duration_ns).select_from(joined)
    return chosen.order_by(sums.c.group.collate("C").nulls_last())


def _grouped_files(actor: Actor, matching: FileFilter, *, group: ColumnElement[Any], by_topic: bool) -> Select[Any]:
    own_recording = and_(recording.c.id == file.c.recording_id, shown_recordings(actor))
    stmt = filter_files(actor, visible_files(actor), matching).outerjoin(recording, own_recording)
    if by_topic:
        # Files without topics stay, in the group without a name, unless topics were asked for.
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


def to_stats(row: Row[Any] | None) -> StatsRow:
    """Return the statistics that a row stands for; without a row, none of anything."""
    counted = {name: int((row._mapping[name] if row else None) or 0) for name in _NUMBERS}
    return StatsRow(group=row.group if row else None, **counted)


def add_up(rows: Iterable[StatsRow]) -> StatsRow:
    """Return what groups that have nothing in common amount to together."""
    all_rows = list(rows)
    return StatsRow(group=None, **{name: sum(getattr(row, name) for row in all_rows) for name in _NUMBERS})
