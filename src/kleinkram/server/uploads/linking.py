"""Files made of blobs that are kept already: nothing is sent for them."""

import uuid
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from sqlalchemy import Row, select

from kleinkram.contract.names import name_key
from kleinkram.server.access.actor import Actor
from kleinkram.server.audit.service import Event, record_all
from kleinkram.server.db import Connection, upsert_rows
from kleinkram.server.missions import service as missions
from kleinkram.server.recordings.service import regroup
from kleinkram.server.tables import blob, file
from kleinkram.server.uploads import queries
from kleinkram.server.uploads.rules import UNREADABLE, Decision, Way


async def link_twins(
    db: Connection, actor: Actor, *, mission_id: uuid.UUID, decisions: list[Decision]
) -> list[Decision]:
    """Make files of blobs that are kept already; a file whose own blob is lost or corrupt gets the good one."""
    linked = [decision for decision in decisions if decision.way is Way.link]
    if not linked:
        return decisions
    rows = [
        {
            "id": uuid.uuid4(),
            "mission_id": mission_id,
            "blob_id": decision.ref,
            "path": decision.wanted.path,
            "path_key": name_key(decision.wanted.path),
            "origin": "link",
            "uploaded_by_id": actor.person_id,
        }
        for decision in linked
    ]
    statement = upsert_rows(file, rows)
    statement = statement.on_conflict_do_update(
        index_elements=["mission_id", "path_key"],
        index_where=file.c.deleted_at.is_(None),
        set_={"blob_id": statement.excluded.blob_id},
        # Only what nobody can read any more gives way; the lock on the mission keeps others out meanwhile.
        where=file.c.blob_id.in_(select(blob.c.id).where(blob.c.state.in_(UNREADABLE))),
    )
    made = {row.path: row.id for row in await db.execute(statement.returning(file.c.path, file.c.id))}
    project_id = (await missions.get_mission_row(db, actor, mission_id)).project_id
    events = [
        Event(
            "file.link",
            "file",
            made[d.wanted.path],
            d.wanted.path,
            project_id,
            after={"sha256": d.wanted.sha256},
            mission_id=mission_id,
        )
        for d in linked
        if d.wanted.path in made
    ]
    await record_all(db, actor, events)
    await regroup(db, mission_id)
    # What was unreadable a moment ago may have been verified since: then it is as good as the twin.
    healed = [name_key(d.wanted.path) for d in linked if d.wanted.path not in made]
    there = await queries.live_files(db, mission_id, healed) if healed else {}
    return [_linked(d, made, there) if d.way is Way.link else d for d in decisions]


def _linked(decision: Decision, made: Mapping[str, uuid.UUID], there: Mapping[str, Row[Any]]) -> Decision:
    if file_id := made.get(decision.wanted.path):
        return replace(decision, ref=file_id)
    return replace(decision, way=Way.present, ref=there[name_key(decision.wanted.path)].id)
