"""Deleting old events of the audit log, if `KLEINKRAM_AUDIT_DAYS` says so, and writing them to a folder before.

The serving role cannot delete events: a function of the migrations does, and only those that are older than the days
that `migrate` stored.
"""

import asyncio
import gzip
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pydantic_core import to_json
from sqlalchemy import ColumnElement, Row, exists, func, select, text

from kleinkram.server.access.actor import unexpired
from kleinkram.server.context import AppContext
from kleinkram.server.tables import audit_event, audit_retention, token

BATCH = 10_000
_LARGEST_ID = 2**63 - 1
# So that the events that are deleted are exactly those that were read.
_REPEATABLE = text("SET TRANSACTION ISOLATION LEVEL REPEATABLE READ")
_DELETE = text("SELECT delete_expired_audit_events(:up_to_id, :most)")


async def expire_events(context: AppContext) -> int:
    """Delete all expired events, and return their number; a batch that cannot be archived first stays.

    Raises OSError if the archive cannot be written.
    """
    total = 0
    while True:
        async with context.database.begin() as db:
            await db.execute(_REPEATABLE)
            up_to_id = _LARGEST_ID
            if context.settings.audit_archive is not None:
                rows = (
                    await db.execute(select(audit_event).where(_is_expired()).order_by(audit_event.c.id).limit(BATCH))
                ).all()
                if not rows:
                    return total
                await asyncio.to_thread(_archive, context.settings.audit_archive, rows)
                up_to_id = rows[-1].id
            deleted: int = (await db.execute(_DELETE, {"up_to_id": up_to_id, "most": BATCH})).scalar_one()
        total += deleted
        if deleted < BATCH:
            return total


def _is_expired() -> ColumnElement[bool]:
    """The condition of the database's function."""
    days = select(audit_retention.c.days).scalar_subquery()
    is_credential = (audit_event.c.operation == "token.create") & exists().where(
        token.c.id == audit_event.c.resource_id, token.c.revoked_at.is_(None), unexpired(token.c.expires_at)
    )
    return (audit_event.c.at < func.now() - func.make_interval(0, 0, 0, days)) & ~is_credential


def _archive(folder: Path, rows: Sequence[Row[Any]]) -> None:
    """Write events as gzipped JSON lines to a file that is named after their ids, complete or not at all."""
    path = folder / f"audit-{rows[0].id}-{rows[-1].id}.jsonl.gz"
    partial = path.with_name(f".{path.name}.partial")
    with os.fdopen(os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "wb") as file:
        with gzip.GzipFile(fileobj=file, mode="wb", mtime=0) as packed:
            packed.writelines(to_json(dict(row._mapping)) + b"\n" for row in rows)
        file.flush()
        os.fsync(file.fileno())
    partial.replace(path)
    directory = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(directory)
    finally:
        os.close(directory)
