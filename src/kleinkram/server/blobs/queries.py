"""What is asked of blobs."""

import datetime
import uuid
from collections.abc import Collection, Iterable
from typing import Any

from sqlalchemy import ARRAY, ColumnElement, Select, Text, exists, func, literal, or_, select, text

from kleinkram.contract.files import BlobState, ContentState
from kleinkram.server.db import among
from kleinkram.server.tables import blob, file, log_chunk, run, run_artifact, run_input, upload
from kleinkram.server.tables.run import ACTIVE

# Read whole and at once, many after one another: what is in it and its verification are then one thing to do.
SMALL_BYTES = 100_000


def blobs_with_path(blob_ids: Iterable[uuid.UUID]) -> Select[Any]:
    """Return those blobs that are not doomed, each with the path of its oldest file (null where all are swept)."""
    path = (
        select(file.c.path).where(file.c.blob_id == blob.c.id).order_by(file.c.created_at, file.c.id).limit(1)
    ).scalar_subquery()
    return select(blob, path.label("path")).where(among(blob.c.id, blob_ids), blob.c.doomed_at.is_(None))


# The log and journal of an SQLite database, and what follows the database's own path in theirs.
LOG_SUFFIXES = ("-wal", "-journal")
_DATABASE = ".db3"


def logs_beside(blob_id: uuid.UUID) -> Select[Any]:
    """Return suffix, key and size of the logs beside a database: beside the oldest file of its blob.

    All missions that hold the blob share what is said of it. So a later copy with a log of its own, in a mission that
    others may not see, changes nothing.
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
            log.c.path.in_([database.c.path + each for each in LOG_SUFFIXES]),
            log.c.deleted_at.is_(None),
            log_blob.c.size_bytes > 0,
            log_blob.c.doomed_at.is_(None),
        )
    )


def databases_of_logs(blob_ids: Iterable[uuid.UUID]) -> Select[Any]:
    """Return ids of the blobs of databases beside which these blobs are logs."""
    database, log = file.alias("database"), file.alias("log")
    beside = or_(*(log.c.path == database.c.path + each for each in LOG_SUFFIXES))
    return (
        select(database.c.blob_id)
        .join_from(log, database, database.c.mission_id == log.c.mission_id)
        .where(
            among(log.c.blob_id, blob_ids),
            or_(*(log.c.path.endswith(f"{_DATABASE}{each}") for each in LOG_SUFFIXES)),
            beside,
            database.c.deleted_at.is_(None),
        )
    )


def small_among(blob_ids: Iterable[uuid.UUID]) -> Select[Any]:
    """Return ids of the small ones among some blobs."""
    return select(blob.c.id).where(among(blob.c.id, blob_ids), is_small())


def is_small() -> ColumnElement[bool]:
    """Say of a blob whether it is read whole at once."""
    return blob.c.size_bytes <= SMALL_BYTES


def is_referred() -> ColumnElement[bool]:
    """Say of a blob whether anything refers to it: a file, in the trash or out of it; a run that is not over and was
    given it; what a run left, and its log.
    """
    given = exists().where(run_input.c.blob_id == blob.c.id, run.c.id == run_input.c.run_id, run.c.state.in_(ACTIVE))
    left = exists().where(run_artifact.c.blob_id == blob.c.id)
    written = exists().where(run.c.log_blob_id == blob.c.id)
    return or_(exists().where(file.c.blob_id == blob.c.id), left, written, given)


def unread() -> ColumnElement[bool]:
    """Say of a blob that nobody summarised it for ten minutes, or that we failed to read it a day ago."""
    late = blob.c.summarised_at.is_(None) & (blob.c.created_at < func.now() - text("interval '10 minutes'"))
    failed = blob.c.content == ContentState.error.value
    again = failed & (blob.c.summarised_at < func.now() - text("interval '1 day'"))
    return late | again


def unverified() -> ColumnElement[bool]:
    """Select blobs that arrived over ten minutes ago and are not verified yet."""
    late = blob.c.created_at < func.now() - text("interval '10 minutes'")
    return (blob.c.state == BlobState.stored.value) & late


# How many blobs wait for another verification.
WAITING_AT_LEISURE = text(
    "SELECT count(*) FROM procrastinate_jobs WHERE task_name = 'verify_blob' AND status = 'todo' AND priority < 0"
)


def wanted_by_state() -> Select[Any]:
    """Return number and bytes of blobs by state; of the lost and corrupt, those that something still refers to."""
    said = (blob.c.state, func.count().label("number"), func.coalesce(func.sum(blob.c.size_bytes), 0))
    well = blob.c.state.in_((BlobState.stored.value, BlobState.verified.value))
    stmt = select(*said[:2], said[2].label("size_bytes")).where(blob.c.doomed_at.is_(None), or_(well, is_referred()))
    return stmt.group_by(blob.c.state).order_by(blob.c.state)


def oldest_verification() -> Select[Any]:
    """Return the oldest `verified_at` of all blobs."""
    verified = (blob.c.state == BlobState.verified.value, blob.c.doomed_at.is_(None))
    return select(func.min(blob.c.verified_at)).where(*verified)


def verified_before(at: ColumnElement[datetime.datetime]) -> Select[Any]:
    """Return ids of the blobs that were verified before, the oldest first."""
    old = (blob.c.state == BlobState.verified.value, blob.c.verified_at < at)
    return select(blob.c.id).where(blob.c.doomed_at.is_(None), *old).order_by(blob.c.verified_at)


def kept_between(
    store_id: str, after: str, until: str | None, *, since_before: datetime.datetime, limit: int
) -> Select[Any]:
    """Return blobs with keys above `after` up to `until` (None: to the last), by key: what a list of them must show.

    Not those that came at `since_before` or later, which it need not, nor the doomed, which it must not. Keys are
    compared by their bytes, as stores list them, whatever the database's collation; an index does the same.
    """
    kept = select(blob.c.id, blob.c.key, blob.c.size_bytes, blob.c.state)
    kept = kept.where(blob.c.store_id == store_id, blob.c.doomed_at.is_(None), blob.c.created_at < since_before)
    kept = kept.where(blob.c.key.op("~>~", is_comparison=True)(after))
    if until is not None:
        kept = kept.where(blob.c.key.op("~<=~", is_comparison=True)(until))
    return kept.order_by(text("blob.key USING ~<~")).limit(limit)


def unknown_among(store_id: str, keys: Collection[str]) -> Select[Any]:
    """Return how many of some keys no row of ours holds."""
    key = func.unnest(literal([*keys], ARRAY(Text))).column_valued("key")
    ours = [exists().where(table.c.store_id == store_id, table.c.key == key) for table in (blob, upload, log_chunk)]
    return select(func.count(key)).where(~or_(*ours))
