"""Database queries about blobs. Functions return statements and conditions; they touch no connection."""

import datetime
import uuid
from collections.abc import Collection, Iterable
from typing import Any, NamedTuple

from sqlalchemy import ARRAY, ColumnElement, Select, Text, exists, func, literal, or_, select, text

from kleinkram.contract.files import BlobState, ContentState
from kleinkram.server.db import among
from kleinkram.server.tables import blob, file, log_chunk, recording_preview, run, run_artifact, run_input, upload
from kleinkram.server.tables.runs import ACTIVE

SMALL_BYTES = 100_000
"""Up to this size, a blob is read whole, once, for its summary and its verification."""


class BlobRow(NamedTuple):
    """A blob that is not marked for deletion, with the path of its oldest file (None if it has none)."""

    id: uuid.UUID
    store_id: str
    key: str
    size_bytes: int
    sha256: bytes
    crc64nvme: bytes | None
    uploaded_by_id: uuid.UUID
    created_at: datetime.datetime
    content: str
    depth: str | None
    path: str | None


class SqliteLog(NamedTuple):
    """A log or journal beside an SQLite database: its recorder was killed. `suffix` follows the database's path."""

    suffix: str
    key: str
    size_bytes: int


class ExpectedBlob(NamedTuple):
    """A blob that a listing of the store must show."""

    id: uuid.UUID
    key: str
    size_bytes: int
    state: str


def blobs_with_path(blob_ids: Iterable[uuid.UUID]) -> Select[Any]:
    """Select blobs as `BlobRow`."""
    path = select(file.c.path).where(file.c.blob_id == blob.c.id).order_by(file.c.created_at, file.c.id).limit(1)
    columns = (blob.c[name] for name in BlobRow._fields[:-1])
    statement = select(*columns, path.scalar_subquery().label("path"))
    return statement.where(among(blob.c.id, blob_ids), blob.c.marked_for_deletion_at.is_(None))


LOG_SUFFIXES = ("-wal", "-journal")
_DATABASE = ".db3"


def sqlite_logs(blob_id: uuid.UUID) -> Select[Any]:
    """Select, as `SqliteLog`, the logs beside the oldest file of a database's blob.

    All missions with this blob share its summary. So a later copy with a log of its own, in a mission that others may
    not see, must not change it.
    """
    database, log, log_blob = file.alias("database"), file.alias("log"), blob.alias("log_blob")
    suffix = func.substr(log.c.path, func.length(database.c.path) + 1)
    oldest = (
        select(file.c.id)
        .where(file.c.blob_id == blob_id, file.c.deleted_at.is_(None))
        .order_by(file.c.created_at, file.c.id)
        .limit(1)
    )
    return (
        select(suffix.label("suffix"), log_blob.c.key, log_blob.c.size_bytes)
        .join_from(database, log, log.c.mission_id == database.c.mission_id)
        .join(log_blob, log_blob.c.id == log.c.blob_id)
        .where(
            database.c.id == oldest.scalar_subquery(),
            database.c.path.endswith(_DATABASE),
            log.c.path.in_([database.c.path + log_suffix for log_suffix in LOG_SUFFIXES]),
            log.c.deleted_at.is_(None),
            log_blob.c.size_bytes > 0,
            log_blob.c.marked_for_deletion_at.is_(None),
        )
    )


def databases_with_logs(blob_ids: Iterable[uuid.UUID]) -> Select[Any]:
    """Select the ids of the databases whose logs these blobs are."""
    database, log = file.alias("database"), file.alias("log")
    beside = or_(*(log.c.path == database.c.path + suffix for suffix in LOG_SUFFIXES))
    return (
        select(database.c.blob_id)
        .join_from(log, database, database.c.mission_id == log.c.mission_id)
        .where(
            among(log.c.blob_id, blob_ids),
            or_(*(log.c.path.endswith(f"{_DATABASE}{suffix}") for suffix in LOG_SUFFIXES)),
            beside,
            database.c.deleted_at.is_(None),
        )
    )


def is_small() -> ColumnElement[bool]:
    """Return the condition that a blob is small."""
    return blob.c.size_bytes <= SMALL_BYTES


def is_referenced() -> ColumnElement[bool]:
    """Return the condition that something refers to a blob.

    That is a file, also in the trash; an unfinished run of which it is an input; a run of which it is an artifact or
    the log.
    """
    by_file = exists().where(file.c.blob_id == blob.c.id)
    is_input = exists().where(run_input.c.blob_id == blob.c.id, run.c.id == run_input.c.run_id, run.c.state.in_(ACTIVE))
    is_artifact = exists().where(run_artifact.c.blob_id == blob.c.id)
    is_log = exists().where(run.c.log_blob_id == blob.c.id)
    return or_(by_file, is_artifact, is_log, is_input)


def is_unread() -> ColumnElement[bool]:
    """Return the condition that a blob has had no summary for ten minutes, or that reading it failed a day ago."""
    late = blob.c.summarised_at.is_(None) & (blob.c.created_at < func.now() - text("interval '10 minutes'"))
    failed = blob.c.content == ContentState.error.value
    again = failed & (blob.c.summarised_at < func.now() - text("interval '1 day'"))
    return late | again


def is_unverified() -> ColumnElement[bool]:
    """Return the condition that a blob arrived over ten minutes ago and is not verified yet."""
    late = blob.c.created_at < func.now() - text("interval '10 minutes'")
    return (blob.c.state == BlobState.stored.value) & late


def expected_between(
    store_id: str, after: str, until: str | None, *, since_before: datetime.datetime, limit: int
) -> Select[Any]:
    """Select, as `ExpectedBlob`, blobs with keys above `after` up to `until` (None: the last), ordered by key.

    Blobs that arrived at `since_before` or later are left out, since the listing may have passed their position, and so
    are blobs marked for deletion. Keys are compared by their bytes, as stores list them, whatever the database's
    collation; an index does the same.
    """
    expected = select(blob.c.id, blob.c.key, blob.c.size_bytes, blob.c.state)
    expected = expected.where(blob.c.store_id == store_id, blob.c.marked_for_deletion_at.is_(None))
    expected = expected.where(blob.c.created_at < since_before, blob.c.key.op("~>~", is_comparison=True)(after))
    if until is not None:
        expected = expected.where(blob.c.key.op("~<=~", is_comparison=True)(until))
    return expected.order_by(text("blob.key USING ~<~")).limit(limit)


def unknown_among(store_id: str, keys: Collection[str]) -> Select[Any]:
    """Select how many of these keys no row of the database has."""
    # A name that no column has: in the subqueries, `key` would be the column of their table.
    key = func.unnest(literal([*keys], ARRAY(Text))).column_valued("listed_key")
    ours = [
        exists().where(table.c.store_id == store_id, table.c.key == key)
        for table in (blob, upload, log_chunk, recording_preview)
    ]
    return select(func.count(key)).where(~or_(*ours))
