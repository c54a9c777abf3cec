"""Where files come from, and what came from them."""

import uuid
from collections.abc import Sequence
from typing import Any

from sqlalchemy import Row, or_, select

from kleinkram.contract.errors import NotFound
from kleinkram.contract.runs import LineageFile, LineageRead, LineageRun
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import visible_files
from kleinkram.server.db import Connection, among
from kleinkram.server.runs import queries
from kleinkram.server.tables import blob, file, run, run_artifact, run_input

_MOST_RUNS = 100
_MOST_FILES = 1000


async def get_lineage(db: Connection, actor: Actor, *, file_id: uuid.UUID) -> LineageRead:
    """Return the run that made a file, and those that read it, with what they made, as far as `actor` may see them.

    Raises:
        NotFound: the file is not there, or not for this actor.
    """
    columns = (file.c.id, file.c.path, blob.c.sha256, file.c.blob_id)
    stmt = visible_files(actor).with_only_columns(*columns, maintain_column_froms=True).where(file.c.id == file_id)
    row = (await db.execute(stmt)).one_or_none()
    if row is None:
        raise NotFound(noun="file", ref=str(file_id))
    maker = select(run_artifact.c.run_id, run_artifact.c.made_from).where(run_artifact.c.file_id == file_id)
    made = (await db.execute(maker)).one_or_none()
    # By its bytes too: what was read under another name, or before it was moved, was the same.
    readers = select(run_input.c.run_id).where(
        or_(run_input.c.file_id == file_id, run_input.c.blob_id == row.blob_id), run_input.c.sha256 == row.sha256
    )
    found = await _runs(db, actor, run.c.id.in_(readers))
    makers = [] if made is None else await _runs(db, actor, run.c.id == made.run_id)
    named = await _with_files(db, actor, [*found[:_MOST_RUNS], *makers])
    made_by = None if not makers else _only_sources(named[makers[0].id], made.made_from if made else [])
    return LineageRead(
        file=LineageFile(id=row.id, path=row.path, sha256=row.sha256.hex()),
        made_by=made_by,
        read_by=[named[each.id] for each in found[:_MOST_RUNS]],
        truncated=len(found) > _MOST_RUNS,
    )


async def _runs(db: Connection, actor: Actor, condition: Any) -> Sequence[Row[Any]]:
    stmt = queries.run_rows(actor, queries.visible_runs(actor).where(condition))
    return (await db.execute(stmt.order_by(run.c.created_at.desc()).limit(_MOST_RUNS + 1))).all()


async def _with_files(db: Connection, actor: Actor, rows: Sequence[Row[Any]]) -> dict[uuid.UUID, LineageRun]:
    run_ids = {row.id for row in rows}
    stmt = queries.inputs_of(actor, [*run_ids])
    given = (await db.execute(stmt.order_by(run_input.c.path).limit(_MOST_FILES))).all()
    columns = (run_artifact.c.run_id, run_artifact.c.file_id, file.c.path, blob.c.sha256)
    stmt = select(*columns).join_from(run_artifact, file, file.c.id == run_artifact.c.file_id)
    joined = stmt.join(blob, blob.c.id == file.c.blob_id).join(run, run.c.id == run_artifact.c.run_id)
    shown_files = among(run_artifact.c.run_id, run_ids) & ~queries.is_hidden(actor, run_artifact.c.file_id)
    made = (await db.execute(joined.where(shown_files).order_by(file.c.path).limit(_MOST_FILES))).all()
    ids = {row.file_id for row in [*given, *made] if row.file_id}
    seen = visible_files(actor).with_only_columns(file.c.id, maintain_column_froms=True)
    visible = set((await db.execute(seen.where(among(file.c.id, ids)))).scalars())

    def shown(row: Row[Any]) -> LineageFile:
        return LineageFile(id=row.file_id if row.file_id in visible else None, path=row.path, sha256=row.sha256.hex())

    return {
        row.id: LineageRun(
            run=queries.to_run(actor, row),
            inputs=[shown(each) for each in given if each.run_id == row.id],
            files=[shown(each) for each in made if each.run_id == row.id],
            artifact_count=row.artifact_count,
        )
        for row in rows
    }


def _only_sources(made_by: LineageRun, made_from: Sequence[str] | None) -> LineageRun:
    """Return the run that made a file with those of its inputs alone that it said the file is made from."""
    if not made_from:
        return made_by
    return made_by.model_copy(update={"inputs": [each for each in made_by.inputs if each.path in made_from]})
