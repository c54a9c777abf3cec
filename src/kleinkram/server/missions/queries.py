"""Selects of missions and their totals, and what their rows become; they touch no connection."""

import functools
import json
import uuid
from collections.abc import Collection, Sequence
from typing import Any

from sqlalchemy import (
    ARRAY,
    BigInteger,
    ColumnElement,
    Row,
    Select,
    Update,
    and_,
    bindparam,
    case,
    func,
    literal,
    null,
    select,
    true,
    type_coerce,
    update,
)
from sqlalchemy.dialects.postgresql import JSONB, array

from kleinkram.contract.access import Right
from kleinkram.contract.checks import WORST_VERDICT_FIRST
from kleinkram.contract.files import BlobState, ContentState, FileFilter
from kleinkram.contract.missions import MissionFilter, MissionOrder, MissionRead, MissionRef, MissionSort
from kleinkram.contract.projects import ProjectRef
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import (
    joined_missions,
    level_on_mission,
    sees_whole_missions,
    shown_files,
    shown_recordings,
    shown_span,
    visible_missions,
    visible_projects,
)
from kleinkram.server.db import among, by_name
from kleinkram.server.filters.files import metadata_key
from kleinkram.server.filters.missions import filter_missions, filter_missions_by_files
from kleinkram.server.filters.plan import NO_PLAN, SearchPlan
from kleinkram.server.filters.verdicts import join_checks, shown_counts, shown_verdict
from kleinkram.server.pagination import Order, PagedQuery
from kleinkram.server.tables import DERIVED_ORIGIN, blob, file, mission, person, project, recording

_LAST, _FIRST = 2**63 - 1, -(2**63)
_BY_VERDICT = (MissionSort.verdict, MissionSort.verdict_desc)
_TOTALS = ("file_count", "size_bytes", "message_count", "pending_file_count")


def mission_rows(actor: Actor, stmt: Select[Any]) -> Select[Any]:
    """Return the rows that `to_missions` reads, of a select that began with `visible_missions`."""
    start_ns, end_ns = shown_span(actor)
    extra = (
        project.c.name.label("project_name"),
        person.c.name.label("created_by_name"),
        literal(sees_whole_missions(actor)).label("is_whole"),
        level_on_mission(actor).label("level"),
        start_ns.label("shown_start_ns"),
        end_ns.label("shown_end_ns"),
        mission_totals(actor).label("totals"),
        shown_verdict(actor).label("verdict"),
        shown_counts(actor).label("checks"),
    )
    return join_checks(stmt).add_columns(*extra).join(person, person.c.id == mission.c.created_by_id)


def to_missions(rows: Sequence[Row[Any]]) -> list[MissionRead]:
    """Return the missions that rows of `mission_rows` stand for."""
    return [_to_mission(values) for values in by_name(rows)]


def _to_mission(values: dict[str, Any]) -> MissionRead:
    values["project"] = {"id": values["project_id"], "name": values["project_name"]}
    values["created_by"] = {"id": values["created_by_id"], "name": values["created_by_name"]}
    if not values["is_whole"]:
        values |= {"metadata": {}, "metadata_yaml": None, "metadata_problems": [], "notes": ""}
    values |= zip(_TOTALS, map(int, values["totals"]), strict=True)
    values["start_ns"], values["end_ns"] = values["shown_start_ns"], values["shown_end_ns"]
    values["recordings_current"] = values["derived_revision"] == values["files_revision"]
    values["right"] = Right.of_level(values["level"])
    return MissionRead.model_validate(values)


_REF_COLUMNS = (mission.c.id, mission.c.name, mission.c.project_id, project.c.name)


def mission_ref(mission_id: uuid.UUID, name: str, project_id: uuid.UUID, project_name: str) -> MissionRef:
    """Return the names of a mission and its project, for responses."""
    return MissionRef(id=mission_id, name=name, project=ProjectRef(id=project_id, name=project_name))


# Content too expensive to summarise is read by the verification; damaged bytes are never read.
_UNREAD = blob.c.summarised_at.is_(None) | (blob.c.content == ContentState.pending.value)
AWAITS_READING = blob.c.summarised_at.is_(None) | (
    (blob.c.content == ContentState.pending.value) & (blob.c.state == BlobState.stored.value)
)
# Files that runs made count as files and bytes, which they are in the store, and not as messages and hours.
_IS_RECORDED = file.c.origin != DERIVED_ORIGIN
_STORED = ("file_count", "size_bytes", "message_count", "unread_count")
# The totals of a mission without files.
NO_TOTALS = {"file_count": 0, "size_bytes": 0, "message_count": 0, "unread_count": 0, "duration_ns": 0}
# The other totals are as old as that one.
_IS_STORED = mission.c.file_count.is_not(None)


def mission_totals(actor: Actor) -> ColumnElement[Any]:
    """Return number and bytes of each `mission`'s files, messages of the recorded ones, and how many are unread.

    One array.

    They are stored when recordings are derived. A trigger clears the number of files when these change; until it is
    stored again, the totals are added up from the files. So they are always current, and a list of a thousand missions
    reads no file.
    """
    return _stored_or_added_totals() if sees_whole_missions(actor) else _added_totals(shown_files(actor))


@functools.cache
def _stored_or_added_totals() -> ColumnElement[Any]:
    stored = _as_integers(*(mission.c[name] for name in _STORED))
    # A file may be read without its mission being derived again; where none is unread, none becomes so.
    return case((and_(_IS_STORED, mission.c.unread_count == 0), stored), else_=_added_totals(true()))


def _added_totals(shown: ColumnElement[bool]) -> ColumnElement[Any]:
    messages = func.sum(blob.c.message_count).filter(_IS_RECORDED)
    numbers = (func.count(), func.sum(blob.c.size_bytes), messages, func.count().filter(AWAITS_READING))
    return _of_files(shown, _as_integers(*numbers))


def file_totals(actor: Actor) -> tuple[ColumnElement[Any], ColumnElement[Any]]:
    """Return number and bytes of each `mission`'s files, to be added up over missions."""
    shown = shown_files(actor)
    count, size_bytes = _of_files(shown, func.count()), _of_files(shown, func.coalesce(func.sum(blob.c.size_bytes), 0))
    if not sees_whole_missions(actor):
        return count, size_bytes
    return (
        case((_IS_STORED, mission.c.file_count), else_=count),
        case((_IS_STORED, mission.c.size_bytes), else_=size_bytes),
    )


def total_duration(actor: Actor) -> ColumnElement[Any]:
    """Return the nanoseconds that each `mission` recorded, to be added up over missions; null for none."""
    durations = select(func.sum(recording.c.end_ns - recording.c.start_ns)).where(
        recording.c.mission_id == mission.c.id, recording.c.is_derived.is_(False)
    )
    added = durations.where(shown_recordings(actor)).correlate(mission).scalar_subquery()
    if not sees_whole_missions(actor):
        return added
    # Recordings only change when they are derived, which stores this too.
    return case((mission.c.duration_ns.is_not(None), mission.c.duration_ns), else_=added)


def store_totals(mission_id: uuid.UUID, **values: object) -> Update:
    """Return the statement that stores the totals of a mission, and other derived values."""
    numbers = (func.count(), func.coalesce(func.sum(blob.c.size_bytes), 0))
    messages = func.sum(blob.c.message_count).filter(_IS_RECORDED)
    read = (func.coalesce(messages, 0), func.count().filter(_UNREAD))
    inside = select(_as_integers(*numbers, *read).label("numbers")).join_from(file, blob, blob.c.id == file.c.blob_id)
    added = inside.where(file.c.mission_id == mission_id, file.c.deleted_at.is_(None)).cte("found")
    duration = select(func.coalesce(func.sum(recording.c.end_ns - recording.c.start_ns), 0))
    derived = {name: select(added.c.numbers[index]).scalar_subquery() for index, name in enumerate(_STORED, start=1)}
    own = (recording.c.mission_id == mission_id, recording.c.is_derived.is_(False))
    derived["duration_ns"] = duration.where(*own).scalar_subquery()
    return update(mission).where(mission.c.id == mission_id).values(**values, **derived)


def _of_files(shown: ColumnElement[bool], what: ColumnElement[Any]) -> ColumnElement[Any]:
    inside = (file.c.mission_id == mission.c.id, file.c.deleted_at.is_(None), shown)
    stmt: Select[Any] = select(what).join_from(file, blob, blob.c.id == file.c.blob_id).where(*inside)
    return stmt.correlate(mission).scalar_subquery()


def _as_integers(*numbers: ColumnElement[Any]) -> ColumnElement[Any]:
    # One array, so that one pass over a mission's files gives all numbers.
    return type_coerce(array([func.coalesce(number, 0) for number in numbers]), ARRAY(BigInteger))


def mission_ref_row(actor: Actor, mission_id: uuid.UUID) -> Select[Any]:
    """Return the arguments of `mission_ref` for a visible mission."""
    return (
        visible_missions(actor)
        .with_only_columns(*_REF_COLUMNS, maintain_column_froms=True)
        .where(mission.c.id == mission_id)
    )


def complete_missions(actor: Actor, mission_ids: Collection[uuid.UUID]) -> Select[Any]:
    """Return those of some missions that are visible, as `to_missions` reads them."""
    return mission_rows(actor, visible_missions(actor).where(among(mission.c.id, mission_ids)))


def lock_projects_of(mission_ids: Collection[uuid.UUID]) -> Select[Any]:
    """Lock the projects of missions against being deleted, restored or purged."""
    holding = select(mission.c.project_id).where(among(mission.c.id, mission_ids))
    locked = select(project.c.id).where(project.c.id.in_(holding)).order_by(project.c.id)
    return locked.with_for_update(read=True, key_share=True)


def lock_missions(mission_ids: Collection[uuid.UUID]) -> Select[Any]:
    """Lock missions against changes of them and of their content."""
    locked = select(mission.c.id).where(among(mission.c.id, mission_ids)).order_by(mission.c.id)
    return locked.with_for_update(key_share=True)


def fields_of_project(actor: Actor, project_id: uuid.UUID) -> Select[Any]:
    """Return a visible project's metadata fields, and lock the project against changes and deletion."""
    one = visible_projects(actor).with_only_columns(project.c.name, project.c.metadata_fields)
    return one.where(project.c.id == project_id).with_for_update(read=True)


def fields_of_mission(mission_id: uuid.UUID) -> Select[Any]:
    """Return the metadata fields of the project that a mission is in, and lock the project.

    For actors who may write the mission, whatever they see of the project: they learn what their metadata lacks.
    """
    one = select(project.c.name, project.c.metadata_fields).join(mission, mission.c.project_id == project.c.id)
    return one.where(mission.c.id == mission_id, project.c.deleted_at.is_(None)).with_for_update(read=True, of=project)


def mission_listing(
    actor: Actor,
    matching: MissionFilter,
    by_files: FileFilter | None = None,
    *,
    plan: SearchPlan = NO_PLAN,
    sort: MissionOrder,
) -> PagedQuery[MissionRead]:
    """Return the visible missions that match, among those that a filter of files finds, where there is one."""

    def select_by_id(mission_id: ColumnElement[uuid.UUID]) -> Select[Any]:
        return mission_rows(actor, joined_missions().where(mission.c.id == mission_id))

    matched = filter_missions(actor, visible_missions(actor), matching, plan)
    if by_files is not None:
        matched = filter_missions_by_files(actor, matched, by_files, plan)
    if sort in _BY_VERDICT:
        matched = join_checks(matched)
    return PagedQuery(matched, mission_order(actor, sort), to_missions, select_by_id)


def mission_order(actor: Actor, sort: MissionOrder) -> Order:
    """Return a list's order. Missions without a time or the field come last in both directions.

    Actors who do not see metadata get no order by it.
    """
    if not isinstance(sort, MissionSort):
        return _order_by_metadata(sort, is_seen=sees_whole_missions(actor))
    if sort in _BY_VERDICT:
        return _order_by_verdict(actor, is_descending=sort is MissionSort.verdict_desc)
    return _order_of_whole(sort) if sees_whole_missions(actor) else _order(sort, shown_span(actor)[0])


@functools.cache
def _order_of_whole(sort: MissionSort) -> Order:
    return _order(sort, mission.c.start_ns)


def _order(sort: MissionSort, start_ns: ColumnElement[int | None]) -> Order:
    descending = sort.value.startswith("-")
    unknown = literal(_FIRST if descending else _LAST, BigInteger)
    columns: dict[str, list[ColumnElement[Any]]] = {
        "name": [mission.c.name, project.c.name],
        "created": [mission.c.created_at],
        "start": [func.coalesce(start_ns, unknown)],
    }
    return Order([*columns[sort.value.removeprefix("-")], mission.c.id], descending)


def _order_by_verdict(actor: Actor, *, is_descending: bool) -> Order:
    """Return the order by verdict, of a select with `join_checks`."""
    rank = case({verdict.value: at for at, verdict in enumerate(WORST_VERDICT_FIRST)}, value=shown_verdict(actor))
    start_ns = shown_span(actor)[0]
    # The latest missions first, in the direction of the order; those without a time last.
    start = func.coalesce(start_ns, _FIRST) if is_descending else func.coalesce(-start_ns, _LAST)
    return Order([rank, start, mission.c.id], is_descending)


def _order_by_metadata(sort: str, *, is_seen: bool) -> Order:
    descending = sort.startswith("-")
    path = sort.removeprefix("-").split(".")[1:]
    value = metadata_key(path) if is_seen else null()
    has_none = value.is_(None) if not descending else value.is_not(None)
    columns = [case((has_none, 1), else_=0), func.coalesce(value, bindparam(None, "", JSONB)), mission.c.id]
    return Order(columns, descending, name="meta." + json.dumps(path))


def last_mission(actor: Actor, project_id: uuid.UUID) -> Select[Any]:
    """Return the newest visible mission of a project: the arguments of `mission_ref`, and its metadata."""
    newest = visible_missions(actor).with_only_columns(*_REF_COLUMNS, mission.c.metadata, maintain_column_froms=True)
    newest = newest.where(mission.c.project_id == project_id)
    return newest.order_by(mission.c.created_at.desc(), mission.c.id.desc()).limit(1)


def contents(actor: Actor, mission_id: uuid.UUID) -> Select[Any]:
    """Return the number and bytes of a visible mission's files."""
    sums = select(func.count(file.c.id), func.coalesce(func.sum(blob.c.size_bytes), 0))
    inside = visible_missions(actor).with_only_columns(mission.c.id).where(mission.c.id == mission_id)
    return sums.join_from(file, blob, blob.c.id == file.c.blob_id).where(
        file.c.mission_id.in_(inside), file.c.deleted_at.is_(None)
    )


def change_mission(mission_id: uuid.UUID, **values: object) -> Update:
    """Return the statement that changes one mission."""
    return update(mission).where(mission.c.id == mission_id).values(**values)


def metadata_of_project(project_id: uuid.UUID, *, after: uuid.UUID | None, limit: int) -> Select[Any]:
    """Return the next missions of a project, by id, with their metadata; those in the trash too."""
    stmt = select(mission.c.id, mission.c.metadata, mission.c.metadata_problems)
    stmt = stmt.where(mission.c.project_id == project_id).order_by(mission.c.id).limit(limit)
    return stmt if after is None else stmt.where(mission.c.id > after)


def set_problems() -> Update:
    """Return the statement that stores `problems` of the mission `ref`, for executing with many rows."""
    return update(mission).where(mission.c.id == bindparam("ref")).values(metadata_problems=bindparam("problems"))
