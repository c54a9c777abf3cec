"""Selects of files and their topics, and what their rows become; they touch no connection."""

import datetime
import functools
import uuid
from collections.abc import Collection, Sequence
from typing import Any, NamedTuple

from sqlalchemy import (
    ARRAY,
    BigInteger,
    ColumnElement,
    Row,
    Select,
    Text,
    Update,
    any_,
    bindparam,
    false,
    func,
    literal,
    or_,
    select,
    true,
    tuple_,
    update,
)

from kleinkram.contract.access import Right
from kleinkram.contract.files import Density, FileFilter, FileRead, FileSort, TopicRead
from kleinkram.contract.missions import MissionFilter
from kleinkram.recordings.message_density import unpack
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import joined_files, visible_files, visible_missions
from kleinkram.server.db import among, among_parameter, by_name
from kleinkram.server.filters.files import filter_files, filter_files_in_order
from kleinkram.server.filters.missions import filter_missions
from kleinkram.server.filters.plan import NO_PLAN, SearchPlan
from kleinkram.server.missions.queries import file_totals
from kleinkram.server.pagination import Order, PagedQuery
from kleinkram.server.tables import (
    blob,
    file,
    mission,
    person,
    project,
    recording_preview,
    run,
    run_artifact,
    run_input,
    topic,
)

_LAST, _FIRST = 2**63 - 1, -(2**63)
# At most so many files that runs made from a file are listed when it is deleted.
_MAX_MADE = 100

_COLUMNS: tuple[ColumnElement[Any], ...] = (
    file.c.id,
    file.c.path,
    file.c.recording_id,
    file.c.labels,
    file.c.origin,
    file.c.created_at,
    file.c.mission_id,
    mission.c.name.label("mission_name"),
    mission.c.project_id,
    project.c.name.label("project_name"),
    file.c.uploaded_by_id,
    person.c.name.label("uploaded_by_name"),
    blob.c.id.label("blob_id"),
    blob.c.key,
    *(
        blob.c[name]
        for name in (
            "size_bytes",
            "state",
            "state_reason",
            "content",
            "content_reason",
            "format",
            "sha256",
            "md5",
            "crc64nvme",
            "verified_at",
            "damaged_at",
            "summarised_at",
            "message_count",
            "start_ns",
            "end_ns",
            "compression",
            "problems",
            "depth",
            "lost",
            "facts",
        )
    ),
)


class FileWithBlob(NamedTuple):
    """A file, with the blob of its content and the key of the object that holds it."""

    read: FileRead
    blob_id: uuid.UUID
    key: str


def file_rows(stmt: Select[Any]) -> Select[Any]:
    """Return the rows that `to_files` reads, of a select that began with `visible_files`."""
    narrowed = stmt.with_only_columns(*_COLUMNS, maintain_column_froms=True)
    return narrowed.join(person, person.c.id == file.c.uploaded_by_id)


@functools.cache
def _rows_of_all() -> Select[Any]:
    return file_rows(joined_files())


def to_files(rows: Sequence[Row[Any]]) -> list[FileRead]:
    """Return the files in rows of `file_rows`."""
    return [_to_file(values) for values in by_name(rows)]


def to_stored_files(rows: Sequence[Row[Any]]) -> dict[uuid.UUID, FileWithBlob]:
    """Return the files in rows of `file_rows` by id, with where their content is stored."""
    return {row.id: FileWithBlob(read, row.blob_id, row.key) for row, read in zip(rows, to_files(rows), strict=True)}


def _to_file(values: dict[str, Any]) -> FileRead:
    in_project = {"id": values["project_id"], "name": values["project_name"]}
    values["mission"] = {"id": values["mission_id"], "name": values["mission_name"], "project": in_project}
    values["uploaded_by"] = {"id": values["uploaded_by_id"], "name": values["uploaded_by_name"]}
    for name in ("sha256", "md5", "crc64nvme"):
        values[name] = None if values[name] is None else values[name].hex()
    return FileRead.model_validate(values)


def topic_rows(stmt: Select[Any]) -> Select[Any]:
    """Return the topics of the files of a select that began with `visible_files`, as `to_topics` reads them."""
    columns = [column for column in topic.c if column.name not in {"id", "blob_id", "density"}]
    narrowed = stmt.with_only_columns(file.c.id.label("file_id"), *columns, maintain_column_froms=True)
    return narrowed.join(topic, topic.c.blob_id == file.c.blob_id)


def topic_listing(stmt: Select[Any]) -> PagedQuery[TopicRead]:
    """Return the topics of a select by `topic_rows`, by name."""
    return PagedQuery(stmt, Order([topic.c.name, topic.c.id, file.c.id]), to_topics)


def to_topics(rows: Sequence[Row[Any]]) -> list[TopicRead]:
    """Return the topics in rows of `topic_rows`, with their density where the rows have it."""
    topics = by_name(rows)
    for values in topics:
        if values.get("density") is not None:
            known = unpack(values["density"])
            values["density"] = Density(start_ns=known.start_ns, bin_ns=known.bin_ns, counts=[*known.counts])
    return [TopicRead.model_validate(values) for values in topics]


def files_by_id(actor: Actor, file_ids: Collection[uuid.UUID]) -> Select[Any]:
    """Return those of some files that are visible, as `to_files` reads them."""
    return file_rows(visible_files(actor)).where(among(file.c.id, file_ids))


def ids_among(actor: Actor, file_ids: Collection[uuid.UUID], right: Right) -> Select[Any]:
    """Return the ids of those of some files on which `actor` has a right."""
    return visible_files(actor, right).with_only_columns(file.c.id).where(among(file.c.id, file_ids))


def own_fresh_file(actor: Actor, file_id: uuid.UUID) -> Select[Any]:
    """Return a file's id where `actor` uploaded it in the last hour, and may still add files there.

    A run did not upload the files of the person who started it.
    """
    is_own = (file.c.uploaded_by_id == actor.person_id, file.c.created_at > func.now() - datetime.timedelta(hours=1))
    stmt = visible_files(actor, Right.create).with_only_columns(file.c.id).where(file.c.id == file_id, *is_own)
    return stmt if actor.run_id is None else stmt.where(false())


def matching_files(actor: Actor, matching: FileFilter, plan: SearchPlan = NO_PLAN) -> Select[Any]:
    """Return the visible files that match."""
    narrow = filter_files_in_order if plan.is_common else filter_files
    return narrow(actor, visible_files(actor), matching, plan)


def file_listing(actor: Actor, matching: FileFilter, *, plan: SearchPlan, sort: FileSort) -> PagedQuery[FileRead]:
    """Return the visible files that match, in an order."""

    def select_by_id(file_id: ColumnElement[uuid.UUID]) -> Select[Any]:
        return _rows_of_all().where(file.c.id == file_id)

    matched = matching_files(actor, matching, plan)
    if plan.matched is not None:
        matched = matched.where(among_parameter(file.c.id, "matched_first_ids"))
    return PagedQuery(matched, file_order(sort, by_index=not plan.is_selective), to_files, select_by_id)


@functools.cache
def file_order(sort: FileSort, *, by_index: bool = True) -> Order:
    """Return a list's order. Files without a time come last, whichever way the list runs.

    Not `by_index` where few rows are to be sorted: PostgreSQL would read the index of times past nearly all files to
    find them, and has no index of a sum with a time.
    """
    descending = sort.value.startswith("-")
    key = sort.value.removeprefix("-")
    if key == "path":
        return Order([project.c.name, mission.c.name, file.c.path, file.c.id], descending)
    start = func.coalesce(file.c.start_ns, literal(_FIRST if descending else _LAST, BigInteger))
    columns: dict[str, ColumnElement[Any]] = {
        "created": file.c.created_at,
        "size": blob.c.size_bytes,
        "start": start if by_index else start + literal(0, BigInteger),
    }
    return Order([columns[key], file.c.id], descending, name=f"files by {key}")


def count_all(actor: Actor, *, plan: SearchPlan) -> Select[Any]:
    """Return the number of all visible files, as their missions know it."""
    number = func.coalesce(func.sum(file_totals(actor)[0]), 0)
    return visible_missions(actor).with_only_columns(number, maintain_column_froms=True)


def first_missions(
    actor: Actor, matching: MissionFilter, *, plan: SearchPlan, is_first: bool, descending: bool, limit: int
) -> Select[Any]:
    """Return the ids of the first visible missions by name of project and mission, from `after_0`, `after_1` on."""
    named = (project.c.name, mission.c.name)
    stmt = filter_missions(actor, visible_missions(actor), matching, plan)
    stmt = stmt.with_only_columns(mission.c.id, maintain_column_froms=True)
    if not is_first:
        start, row = tuple_(*(bindparam(f"after_{at}", type_=Text()) for at in range(2))), tuple_(*named)
        stmt = stmt.where(row <= start if descending else row >= start)
    in_order = [name.desc() if descending else name for name in (*named, mission.c.id)]
    return stmt.order_by(*in_order).limit(limit)


def topics_of_file(actor: Actor, file_id: uuid.UUID) -> Select[Any]:
    """Return the topics of a visible file, and how densely their messages lie."""
    return topic_rows(visible_files(actor).where(file.c.id == file_id)).add_columns(topic.c.density)


def runs_that_read(actor: Actor, file_id: uuid.UUID) -> Select[Any]:
    """Return the number of runs that had a file as input, on missions that `actor` may read."""
    missions = visible_missions(actor).with_only_columns(mission.c.id, maintain_column_froms=True)
    stmt = select(func.count()).select_from(run_input).join(run, run.c.id == run_input.c.run_id)
    return stmt.where(run_input.c.file_id == file_id, run.c.mission_id.in_(missions))


def derived_from(actor: Actor, file_id: uuid.UUID) -> Select[Any]:
    """Return the paths of visible files that runs made from a file."""
    from_it = or_(
        func.cardinality(run_artifact.c.derived_from) == 0, run_input.c.path == any_(run_artifact.c.derived_from)
    )
    joined = visible_files(actor).with_only_columns(file.c.path, maintain_column_froms=True)
    joined = joined.join(run_artifact, run_artifact.c.file_id == file.c.id)
    joined = joined.join(run_input, run_input.c.run_id == run_artifact.c.run_id)
    return joined.where(run_input.c.file_id == file_id, from_it).order_by(file.c.path).limit(_MAX_MADE)


def change_file(file_id: uuid.UUID, **values: object) -> Update:
    """Return the statement that changes one file."""
    return update(file).where(file.c.id == file_id).values(**values)


def set_labels() -> Update:
    """Return the statement that gives the file `ref` its `new_labels`, for executing with many rows."""
    return update(file).where(file.c.id == bindparam("ref")).values(labels=bindparam("new_labels"))


def files_at(mission_id: uuid.UUID, keys: Collection[str], *, except_id: uuid.UUID | None = None) -> Select[Any]:
    """Return `path_key` and `path` of a mission's files under the given keys."""
    files = _in_mission(mission_id, except_id).with_only_columns(file.c.path_key, file.c.path)
    return files.where(among(file.c.path_key, keys))


def files_below(mission_id: uuid.UUID, keys: Sequence[str], *, except_id: uuid.UUID | None = None) -> Select[Any]:
    """Return, for each key that is a folder in a mission, the `key` and the `path` of one file inside."""
    key = func.unnest(literal([*keys], ARRAY(Text))).column_valued("key")
    # "0" follows "/" by code point: the keys between are those inside, a range that the index on path_key serves.
    inside = _in_mission(mission_id, except_id).where(file.c.path_key > key + "/", file.c.path_key < key + "0")
    one = inside.with_only_columns(file.c.path).limit(1).lateral("below")
    return select(key, one.c.path).join(one, true())


def _in_mission(mission_id: uuid.UUID, except_id: uuid.UUID | None) -> Select[Any]:
    live = select(file).where(file.c.mission_id == mission_id, file.c.deleted_at.is_(None))
    return live if except_id is None else live.where(file.c.id != except_id)


def thumbnails_of(actor: Actor, file_ids: Collection[uuid.UUID]) -> Select[Any]:
    """Return the thumbnails of those of some files that are visible and have one, with the missions of the files."""
    of_mission = (mission.c.id.label("mission_id"), mission.c.name.label("mission_name"), mission.c.project_id)
    columns = (file.c.id, recording_preview.c.thumbnail, *of_mission)
    stmt = visible_files(actor).with_only_columns(*columns, maintain_column_froms=True)
    stmt = stmt.join(recording_preview, recording_preview.c.blob_id == file.c.blob_id)
    return stmt.where(among(file.c.id, file_ids), recording_preview.c.thumbnail.is_not(None))
