"""Selects of timelines, mission topics and statistics."""

import uuid
from typing import Any

from sqlalchemy import BigInteger, Row, Select, Uuid, and_, column, distinct, func, literal, select, true
from sqlalchemy.dialects.postgresql import aggregate_order_by, insert
from sqlalchemy.sql.dml import ReturningInsert

from kleinkram.contract.files import TimelineFile
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import (
    shown_files,
    shown_recordings,
    shown_span,
    visible_files,
    visible_missions,
)
from kleinkram.server.pagination import Order
from kleinkram.server.tables import DERIVED_ORIGIN, blob, file, mission, mission_topic, mission_topics, recording, topic

TIMELINE_ORDER = Order([file.c.path, file.c.id])


def mission_span(actor: Actor, mission_id: uuid.UUID) -> Select[Any]:
    """Return `start_ns` and `end_ns` of one mission, of its visible files."""
    start_ns, end_ns = shown_span(actor)
    columns = (start_ns.label("start_ns"), end_ns.label("end_ns"))
    return (
        visible_missions(actor)
        .with_only_columns(*columns, maintain_column_froms=True)
        .where(mission.c.id == mission_id)
    )


def timeline_files(actor: Actor, mission_id: uuid.UUID) -> Select[Any]:
    """Return the visible files of one mission, as `to_timeline_file` reads them."""
    columns = (file.c.id, file.c.path, file.c.recording_id, file.c.origin)
    known = (blob.c.start_ns, blob.c.end_ns, blob.c.size_bytes, blob.c.content, blob.c.state)
    stmt = visible_files(actor).with_only_columns(*columns, *known, maintain_column_froms=True)
    return stmt.where(mission.c.id == mission_id)


def to_timeline_file(row: Row[Any]) -> TimelineFile:
    """Return the file that a row of `timeline_files` stands for."""
    return TimelineFile(
        id=row.id,
        path=row.path,
        recording_id=row.recording_id,
        start_ns=row.start_ns,
        end_ns=row.end_ns,
        size_bytes=row.size_bytes,
        content=row.content,
        state=row.state,
        is_derived=row.origin == "run",
    )


def mission_topics_state(actor: Actor, mission_id: uuid.UUID) -> Select[Any]:
    """Return span and revision of one visible mission, and the header of its stored topics (null without one)."""
    start_ns, end_ns = shown_span(actor)
    columns = (start_ns.label("start_ns"), end_ns.label("end_ns"), mission.c.files_revision)
    stmt = visible_missions(actor).with_only_columns(
        *columns, mission_topics.c.revision, mission_topics.c.bin_ns, maintain_column_froms=True
    )
    return stmt.outerjoin(mission_topics, mission_topics.c.mission_id == mission.c.id).where(mission.c.id == mission_id)


def mission_state(mission_id: uuid.UUID) -> Select[Any]:
    """Return span and revision of a mission, without a check of rights."""
    return select(mission.c.start_ns, mission.c.end_ns, mission.c.files_revision).where(mission.c.id == mission_id)


def recordings_in_time(mission_id: uuid.UUID, actor: Actor | None = None) -> Select[Any]:
    """Return the visible recordings of a mission in order of time; all without an actor. Derived ones are left out."""
    stmt = select(recording.c.id, recording.c.name).where(recording.c.mission_id == mission_id)
    stmt = stmt.where(recording.c.is_derived.is_(False))
    stmt = stmt if actor is None else stmt.where(shown_recordings(actor))
    return stmt.order_by(recording.c.start_ns.nulls_last(), recording.c.name, recording.c.id)


def recordings_by_id(mission_id: uuid.UUID) -> Select[Any]:
    """Return the recordings that the stored topics refer to, by position; deleted ones have name null."""
    listed = func.unnest(mission_topics.c.recording_ids).table_valued(
        column("id", Uuid), with_ordinality="position", name="listed"
    )
    listed = listed.render_derived()
    recordings = select(listed.c.id, recording.c.name).select_from(mission_topics).join(listed, true())
    recordings = recordings.outerjoin(recording, recording.c.id == listed.c.id)
    return recordings.where(mission_topics.c.mission_id == mission_id).order_by(listed.c.position)


def topics_of_files(
    mission_id: uuid.UUID, start_ns: int | None, end_ns: int | None, actor: Actor | None = None
) -> Select[Any]:
    """Return the topics of a mission's recorded files, as `topics.merge` reads them.

    `is_placed` is false outside the mission's span: the clock of that file was never set.
    """
    span = (literal(start_ns, BigInteger), literal(end_ns, BigInteger))
    is_placed = func.coalesce(and_(topic.c.first_ns >= span[0], topic.c.last_ns <= span[1]), False)
    numbers = (topic.c.first_ns, topic.c.last_ns, topic.c.longest_gap_ns, topic.c.stored_bytes, topic.c.density)
    stmt = select(
        topic.c.name,
        topic.c.message_type,
        topic.c.count.label("message_count"),
        *numbers,
        file.c.recording_id,
        is_placed.label("is_placed"),
    ).join_from(file, topic, topic.c.blob_id == file.c.blob_id)
    is_recorded = file.c.origin != DERIVED_ORIGIN
    stmt = stmt.where(file.c.mission_id == mission_id, file.c.deleted_at.is_(None), is_recorded)
    stmt = stmt if actor is None else stmt.where(shown_files(actor))
    return stmt.order_by(topic.c.name, topic.c.message_type, file.c.recording_id, topic.c.first_ns)


def upsert_topics_header(**values: object) -> ReturningInsert[Any]:
    """Return the upsert of the header of stored topics; it returns no row if a later revision is stored."""
    statement = insert(mission_topics).values(**values)
    changed = {name: statement.excluded[name] for name in ("revision", "recording_ids", "bin_ns")}
    return statement.on_conflict_do_update(
        index_elements=["mission_id"], set_=changed, where=mission_topics.c.revision <= statement.excluded.revision
    ).returning(mission_topics.c.mission_id)


def derived_topics(mission_id: uuid.UUID) -> Select[Any]:
    """Return the stored topics of a mission, each with all message types of that name."""
    other = mission_topic.alias("other")
    types = (
        select(func.array_agg(aggregate_order_by(other.c.message_type, other.c.message_type)))
        .where(other.c.mission_id == mission_topic.c.mission_id, other.c.name == mission_topic.c.name)
        .correlate(mission_topic)
        .scalar_subquery()
    )
    counted = mission_topic.c.count.label("message_count")
    return select(mission_topic, counted, types.label("types")).where(mission_topic.c.mission_id == mission_id)


# By name and type: within a name, rows are inserted in the order of types.
DERIVED_TOPIC_ORDER = Order([mission_topic.c.name, mission_topic.c.id])


def topic_count(actor: Actor, project_id: uuid.UUID | None) -> Select[Any]:
    """Return the number of distinct topic names in the visible missions of one project, or of all."""
    stmt = visible_missions(actor).with_only_columns(
        func.count(distinct(mission_topic.c.name)), maintain_column_froms=True
    )
    stmt = stmt.join(mission_topic, mission_topic.c.mission_id == mission.c.id)
    return stmt if project_id is None else stmt.where(mission.c.project_id == project_id)
