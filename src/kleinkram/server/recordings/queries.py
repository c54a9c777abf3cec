"""Selects of recordings, and what their rows become; they touch no connection."""

import uuid
from collections.abc import Collection, Sequence
from typing import Any

from sqlalchemy import ColumnElement, Row, Select, func, select
from sqlalchemy.dialects.postgresql import aggregate_order_by

from kleinkram.contract.files import FileProblem, RecordingRead
from kleinkram.recordings import group
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import shown_recordings, visible_missions
from kleinkram.server.db import among
from kleinkram.server.missions.queries import mission_ref
from kleinkram.server.pagination import Order
from kleinkram.server.tables import blob, file, mission, project, recording


def _of_members(what: ColumnElement[Any], name: str) -> ColumnElement[Any]:
    members = select(what).join_from(file, blob, blob.c.id == file.c.blob_id)
    live = members.where(file.c.recording_id == recording.c.id, file.c.deleted_at.is_(None))
    return live.correlate(recording).scalar_subquery().label(name)


def visible_recordings(actor: Actor) -> Select[Any]:
    """Return the recordings that `actor` may see, as `to_recording` reads them."""
    names = (
        mission.c.name.label("mission_name"),
        project.c.id.label("project_id"),
        project.c.name.label("project_name"),
    )
    members = (
        _of_members(func.array_agg(aggregate_order_by(file.c.id, file.c.path)), "file_ids"),
        _of_members(func.array_agg(aggregate_order_by(file.c.path, file.c.path)), "paths"),
        _of_members(func.coalesce(func.sum(blob.c.size_bytes), 0), "size_bytes"),
    )
    stmt = visible_missions(actor).with_only_columns(*recording.c, *names, *members, maintain_column_froms=True)
    return stmt.join(recording, recording.c.mission_id == mission.c.id).where(shown_recordings(actor))


def recordings_of(actor: Actor, mission_ids: Collection[uuid.UUID]) -> Select[Any]:
    """Return the recordings of visible missions."""
    return visible_recordings(actor).where(among(mission.c.id, mission_ids))


def recording_by_id(actor: Actor, recording_id: uuid.UUID) -> Select[Any]:
    """Return one visible recording."""
    return visible_recordings(actor).where(recording.c.id == recording_id)


RECORDING_ORDER = Order([recording.c.name, recording.c.id])


def _in_order(paths: Sequence[str]) -> list[int]:
    """Return the indices of paths with data files in the order of recording: `run_2` before `run_10`."""
    indices = {path: index for index, path in enumerate(paths)}
    members = [indices[path] for recording in group(paths) for path in recording.members]
    ordered, are_members = iter(members), set(members)
    return [next(ordered) if index in are_members else index for index in range(len(paths))]


def to_recording(row: Row[Any]) -> RecordingRead:
    """Return the recording in a row, with its data files in the order of recording."""
    order = _in_order(row.paths or [])
    return RecordingRead(
        id=row.id,
        mission=mission_ref(row.mission_id, row.mission_name, row.project_id, row.project_name),
        name=row.name,
        kind=row.kind,
        file_ids=[row.file_ids[number] for number in order],
        paths=[row.paths[number] for number in order],
        missing=row.missing,
        unlisted=row.unlisted,
        problems=[FileProblem(**problem) for problem in row.problems],
        content=row.content,
        content_reason=row.content_reason,
        lost=row.lost,
        start_ns=row.start_ns,
        end_ns=row.end_ns,
        message_count=row.message_count,
        is_derived=row.is_derived,
        size_bytes=int(row.size_bytes),
    )
