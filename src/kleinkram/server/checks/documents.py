"""The `checks.yaml` of a project and its versions."""

import asyncio
import hashlib
import uuid
from typing import Any

from sqlalchemy import Row, Select, func, insert, select, update

from kleinkram.checks.document import read_checks
from kleinkram.contract.base import Page
from kleinkram.contract.checks import ChecksVersionRead, ProjectChecksRead
from kleinkram.contract.errors import NotFound
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.people import PersonRef
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.rights import require_match, require_project
from kleinkram.server.access.visible import visible_projects
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.db import Connection
from kleinkram.server.jobs.queue import Job, Priority, enqueue
from kleinkram.server.pagination import Order, PageRequest, read_page
from kleinkram.server.runs.automatic import enqueue_automatic_runs
from kleinkram.server.tables import person, project, project_checks

_VERSION_ORDER = Order([project_checks.c.number], descending=True)
_EMPTY_SHA256 = hashlib.sha256(b"").digest()


async def get_project_checks(db: Connection, actor: Actor, project_id: uuid.UUID) -> ProjectChecksRead:
    """Return the `checks.yaml` of a project; an empty text if it has none. Raises NotFound."""
    await require_project(db, actor, "get_project_checks", project_id)
    return await _current(db, project_id)


async def set_project_checks(
    db: Connection, actor: Actor, *, project_id: uuid.UUID, text: str, if_match: str | None = None
) -> ProjectChecksRead:
    """Make a text the `checks.yaml` of a project, and have all its missions judged by it; an empty text removes it.

    Actions of the project that read the file start on the missions that are due. Where the text is the present one,
    nothing changes, and the ETag is not checked.

    Raises:
        NotFound: the project does not exist, or is not visible.
        Forbidden: the actor may not change it.
        YamlInvalid: the text is not a file of checks; with the line and column of its first problem.
        EditConflict: the ETag of the present file is not the one in `if_match`.
    """
    if text:
        await asyncio.to_thread(read_checks, text)
    await db.execute(visible_projects(actor).where(project.c.id == project_id).with_for_update(key_share=True))
    await require_project(db, actor, "set_project_checks", project_id)
    old = await _current(db, project_id)
    if text == old.text:
        return old
    name = (await db.execute(select(project.c.name).where(project.c.id == project_id))).scalar_one()
    require_match(if_match, old.etag, resource_type="project", name=name)
    number = old.number + 1
    values = {
        "project_id": project_id,
        "number": number,
        "text": text,
        "sha256": hashlib.sha256(text.encode()).digest(),
    }
    await db.execute(insert(project_checks).values(**values, created_by_id=actor.person_id))
    applied = number if text else 0
    await db.execute(update(project).where(project.c.id == project_id).values(checks_number=applied))
    await enqueue(db, Job.judge_project, ids=[str(project_id)], priority=Priority.high)
    await enqueue_automatic_runs(db, project_id=project_id)
    before: Metadata = {"checks": old.number if old.text else None}
    after: Metadata = {"checks": number if text else None}
    await audit(db, actor, Event("project.set_checks", "project", project_id, name, project_id, before, after))
    return await _current(db, project_id)


async def list_versions(
    db: Connection, actor: Actor, *, project_id: uuid.UUID, page: PageRequest
) -> Page[ChecksVersionRead]:
    """Return a page of the versions of a project's `checks.yaml`, latest first. Raises NotFound or InvalidCursor."""
    await require_project(db, actor, "list_checks_versions", project_id)
    return await read_page(db, _versions(project_id), _VERSION_ORDER, page, _to_version)


async def get_version(db: Connection, actor: Actor, *, project_id: uuid.UUID, number: int) -> ProjectChecksRead:
    """Return one version of a project's `checks.yaml`. Raises NotFound."""
    await require_project(db, actor, "get_checks_version", project_id)
    row = (await db.execute(_versions(project_id).where(project_checks.c.number == number))).one_or_none()
    if row is None:
        raise NotFound(resource_type="version of checks", ref=str(number))
    return _to_checks(row)


async def _current(db: Connection, project_id: uuid.UUID) -> ProjectChecksRead:
    newest = select(func.max(project_checks.c.number)).where(project_checks.c.project_id == project_id)
    stmt = _versions(project_id).where(project_checks.c.number == newest.scalar_subquery())
    row = (await db.execute(stmt)).one_or_none()
    if row is None:
        return ProjectChecksRead(text="", number=0, sha256=_EMPTY_SHA256.hex(), created_at=None, created_by=None)
    return _to_checks(row)


def _versions(project_id: uuid.UUID) -> Select[Any]:
    stmt = select(project_checks, person.c.name.label("created_by_name"))
    stmt = stmt.join(person, person.c.id == project_checks.c.created_by_id)
    return stmt.where(project_checks.c.project_id == project_id)


def _to_checks(row: Row[Any]) -> ProjectChecksRead:
    return ProjectChecksRead(
        text=row.text,
        number=row.number,
        sha256=row.sha256.hex(),
        created_at=row.created_at,
        created_by=PersonRef(id=row.created_by_id, name=row.created_by_name),
    )


def _to_version(row: Row[Any]) -> ChecksVersionRead:
    return ChecksVersionRead(
        number=row.number,
        sha256=row.sha256.hex(),
        is_removal=not row.text,
        created_at=row.created_at,
        created_by=PersonRef(id=row.created_by_id, name=row.created_by_name),
    )
