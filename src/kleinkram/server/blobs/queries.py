"""What is asked of blobs."""

import uuid
from typing import Any

from sqlalchemy import Select, select

from kleinkram.server.tables import blob, file


def blob_with_path(blob_id: uuid.UUID) -> Select[Any]:
    """Return a blob that is not doomed, with the path of its oldest file (null where all are swept)."""
    path = (
        select(file.c.path).where(file.c.blob_id == blob.c.id).order_by(file.c.created_at, file.c.id).limit(1)
    ).scalar_subquery()
    return select(blob, path.label("path")).where(blob.c.id == blob_id, blob.c.doomed_at.is_(None))
