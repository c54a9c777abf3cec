"""What is asked of blobs."""

import uuid
from typing import Any

from sqlalchemy import ColumnElement, Select, exists, func, or_, select, text

from kleinkram.contract.files import BlobState, ContentState
from kleinkram.server.tables import blob, file, run, run_artifact, run_input
from kleinkram.server.tables.run import ACTIVE


def blob_with_path(blob_id: uuid.UUID) -> Select[Any]:
    """Return a blob that is not doomed, with the path of its oldest file (null where all are swept)."""
    path = (
        select(file.c.path).where(file.c.blob_id == blob.c.id).order_by(file.c.created_at, file.c.id).limit(1)
    ).scalar_subquery()
    return select(blob, path.label("path")).where(blob.c.id == blob_id, blob.c.doomed_at.is_(None))


def is_referred() -> ColumnElement[bool]:
    """Say of a blob whether anything refers to it: a file, in the trash or out of it; a run that is not over and was
    given it; what a run left, and its log.
    """
    given = exists().where(run_input.c.blob_id == blob.c.id, run.c.id == run_input.c.run_id, run.c.state.in_(ACTIVE))
    left = exists().where(run_artifact.c.blob_id == blob.c.id)
    written = exists().where(run.c.log_blob_id == blob.c.id)
    return or_(exists().where(file.c.blob_id == blob.c.id), left, written, given)


def unread() -> Select[Any]:
    """Return ids of blobs that nobody summarised for ten minutes, or that we failed to read a day ago."""
    late = blob.c.summarised_at.is_(None) & (blob.c.created_at < func.now() - text("interval '10 minutes'"))
    failed = blob.c.content == ContentState.error.value
    again = failed & (blob.c.summarised_at < func.now() - text("interval '1 day'"))
    return select(blob.c.id).where(blob.c.doomed_at.is_(None), late | again)


def unproven() -> Select[Any]:
    """Return ids of blobs that nobody has proven for ten minutes."""
    late = blob.c.created_at < func.now() - text("interval '10 minutes'")
    return select(blob.c.id).where(blob.c.doomed_at.is_(None), blob.c.state == BlobState.stored.value, late)
