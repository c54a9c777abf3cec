"""Records summaries of recordings: what a blob contains, made to fit into the database's columns."""

import math
import uuid
from collections.abc import Iterable, Mapping
from dataclasses import asdict

from sqlalchemy import bindparam, delete, func, insert, select, update

from kleinkram.contract.audit import ChangeKind
from kleinkram.contract.files import ContentState, ReadDepth
from kleinkram.recordings import RecordingSummary, TopicSummary
from kleinkram.recordings.message_density import pack
from kleinkram.server.change_events import ChangeEvent, publish
from kleinkram.server.db import Connection, among, fit_text
from kleinkram.server.missions.service import lock_missions
from kleinkram.server.recordings.derive import derive_again
from kleinkram.server.tables import blob, file, topic

_MAX_BIGINT = 2**63 - 1


async def record_summaries(db: Connection, summaries: Mapping[uuid.UUID, RecordingSummary]) -> None:
    """Replace what is known of the contents of blobs. The result of a scan is not replaced by a mere summary."""
    if not summaries:
        return
    await lock_missions_of(db, summaries)
    locked = select(blob.c.id, blob.c.depth).where(among(blob.c.id, summaries)).order_by(blob.c.id).with_for_update()
    depths = {row.id: row.depth for row in await db.execute(locked)}
    better = {
        blob_id: summaries[blob_id]
        for blob_id, depth in depths.items()
        if depth != ReadDepth.scan.value or summaries[blob_id].depth.value == depth
    }
    if not better:
        return
    await db.execute(delete(topic).where(among(topic.c.blob_id, better)))
    topics = [_topic_columns(blob_id, one) for blob_id, summary in better.items() for one in summary.topics]
    if topics:
        await db.execute(insert(topic), topics)
    statement = update(blob).where(blob.c.id == bindparam("blob_id")).values(summarised_at=func.now())
    await db.execute(statement, [{"blob_id": blob_id, **_columns(summary)} for blob_id, summary in better.items()])
    await derive_missions_of(db, better)


async def record_read_failure(db: Connection, blob_id: uuid.UUID, reason: str) -> None:
    """Record that reading a blob failed, and why; an earlier summary stays."""
    values = {"content": ContentState.error.value, "content_reason": fit_text(reason), "summarised_at": func.now()}
    await lock_missions_of(db, [blob_id])
    has_no_summary = blob.c.content.in_((ContentState.pending.value, ContentState.error.value))
    await db.execute(update(blob).where(blob.c.id == blob_id, has_no_summary).values(**values))
    await derive_missions_of(db, [blob_id])


async def lock_missions_of(db: Connection, blob_ids: Iterable[uuid.UUID]) -> None:
    """Lock the missions of blobs; to be done before locking the blobs, as linking does."""
    await lock_missions(db, await _missions_of(db, blob_ids))


async def derive_missions_of(db: Connection, blob_ids: Iterable[uuid.UUID]) -> None:
    """Queue the recordings of these blobs' missions to be derived again, and publish that their files changed."""
    for mission_id in await _missions_of(db, blob_ids):
        await derive_again(db, mission_id)
    await publish_file_changes(db, blob_ids)


async def publish_file_changes(db: Connection, blob_ids: Iterable[uuid.UUID]) -> None:
    """Publish that the files of these blobs changed."""
    files = select(file.c.id, file.c.mission_id).where(among(file.c.blob_id, blob_ids), file.c.deleted_at.is_(None))
    rows = await db.execute(files)
    await publish(db, [ChangeEvent("file", ChangeKind.changed, row.id, mission_id=row.mission_id) for row in rows])


async def _missions_of(db: Connection, blob_ids: Iterable[uuid.UUID]) -> list[uuid.UUID]:
    missions = select(file.c.mission_id).where(among(file.c.blob_id, blob_ids), file.c.deleted_at.is_(None))
    return sorted((await db.execute(missions.distinct())).scalars())


def _columns(summary: RecordingSummary) -> dict[str, object]:
    start_ns, end_ns = summary.start_ns, summary.end_ns
    if _bigint(start_ns) is None or _bigint(end_ns) is None:
        start_ns = end_ns = None  # half a time span is none
    return {
        "content": summary.content.value,
        "content_reason": fit_text(summary.reason),
        "format": summary.format.value,
        "message_count": _bigint(summary.message_count),
        "start_ns": start_ns,
        "end_ns": end_ns,
        "compression": [fit_text(name) for name in summary.compression],
        "problems": [{key: fit_text(value) for key, value in asdict(problem).items()} for problem in summary.problems],
        "depth": summary.depth.value,
        "lost": summary.lost and asdict(summary.lost),
        "facts": [{key: _fit_value(value) for key, value in asdict(fact).items()} for fact in summary.facts],
    }


def _fit_value(value: str | int | float) -> str | int | float:
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)  # JSON cannot express it
    return fit_text(value) if isinstance(value, str) else value


def _topic_columns(blob_id: uuid.UUID, summary: TopicSummary) -> dict[str, object]:
    values = asdict(summary)
    values.pop("suspect_count")
    values["density"] = pack(summary.density) if summary.density is not None else None
    texts = ("name", "message_type", "schema_name", "schema_encoding", "message_encoding")
    values |= {key: fit_text(values[key]) for key in texts}
    values |= {key: _bigint(value) for key, value in values.items() if isinstance(value, int)}
    return {"blob_id": blob_id, **values}


def _bigint(value: int | None) -> int | None:
    # Log times are unsigned 64 bit; one after the year 2262 fits no column and is no real recording's.
    return value if value is None or value <= _MAX_BIGINT else None
