"""The `checks.yaml` of projects, parsed. A long one takes a second, and is needed often."""

import asyncio
import contextlib
import uuid
from collections.abc import Collection, Mapping
from functools import lru_cache

from sqlalchemy import select

from kleinkram.checks.document import ChecksDocument, read_checks
from kleinkram.contract.errors import YamlInvalid
from kleinkram.server.db import Connection, among
from kleinkram.server.tables import project_checks


async def document_of(db: Connection, project_id: uuid.UUID, number: int) -> tuple[ChecksDocument, bytes]:
    """Return a version of a project's rules, and the hash of its text. Raises YamlInvalid."""
    columns = (project_checks.c.text, project_checks.c.sha256)
    stored = select(*columns).where(project_checks.c.project_id == project_id, project_checks.c.number == number)
    row = (await db.execute(stored)).one()
    return await asyncio.to_thread(_parsed, row.text), row.sha256


async def documents_by_hash(db: Connection, hashes: Collection[bytes]) -> Mapping[bytes, ChecksDocument]:
    """Return the rules whose texts have these hashes, without those that this program cannot read."""
    if not hashes:
        return {}
    columns = (project_checks.c.sha256, project_checks.c.text)
    stmt = select(*columns).distinct(project_checks.c.sha256).where(among(project_checks.c.sha256, hashes))
    documents = {}
    for row in await db.execute(stmt):
        with contextlib.suppress(YamlInvalid):  # written for an earlier version of this program; the verdict says so
            documents[row.sha256] = await asyncio.to_thread(_parsed, row.text)
    return documents


@lru_cache(maxsize=8)
def _parsed(text: str) -> ChecksDocument:
    return read_checks(text)
