"""What happens to bytes after they arrived: their summary, their verification, their end."""

import datetime
import math
import time
import uuid
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from sqlalchemy import ColumnElement, Row, bindparam, delete, func, insert, select, true, update

from kleinkram.contract.events import ChangeKind
from kleinkram.contract.files import BlobState, ContentState, ReadDepth
from kleinkram.recordings import RecordingSummary
from kleinkram.recordings.density import pack
from kleinkram.server.audit.service import Event, record_all
from kleinkram.server.blobs import queries
from kleinkram.server.blobs.fitting import fit
from kleinkram.server.change_events import ChangeEvent, publish
from kleinkram.server.db import Connection, among, unnest_rows
from kleinkram.server.jobs.queue import Job, Urgency, enqueue, has_job, settle, start_now, waiting
from kleinkram.server.missions.service import lock_missions
from kleinkram.server.recordings.service import regroup
from kleinkram.server.tables import blob, file, mission, topic

_MAX_BIGINT = 2**63 - 1
_TOMORROW = datetime.timedelta(days=1)
# Where there are more blobs, a round of the sweep looks at its share of them: the rounds of four hours look at all. A
# prime number: rounds that are late, each as much as the other, still come to every share.
_ALL_AT_ONCE, _ROUNDS, _ROUND_S = 50_000, 23, 600


async def examine_blobs(db: Connection, blob_ids: Sequence[uuid.UUID]) -> None:
    """See to it that new blobs are summarised soon and verified in time: small ones at once, by a single job.

    A database beside which a new one is the log is read again, with it.
    """
    blob_ids = [*dict.fromkeys([*blob_ids, *(await db.execute(queries.databases_of_logs(blob_ids))).scalars()])]
    is_small = set((await db.execute(queries.small_among(blob_ids))).scalars())
    small = [str(each) for each in blob_ids if each in is_small]
    large = [str(each) for each in blob_ids if each not in is_small]
    await enqueue(db, Job.examine_blob, ids=small, urgency=Urgency.soon)
    await enqueue(db, Job.summarise_blob, ids=large, urgency=Urgency.soon)
    await enqueue(db, Job.verify_blob, ids=large, urgency=Urgency.whenever)


async def examine_forgotten(db: Connection, *, store_id: str, limit: int) -> None:
    """See to blobs whose jobs were given up (a store that was away for long): nothing waits for ever.

    What we failed to read is tried again once a day.
    """
    small = queries.is_small()
    by_itself = [(Job.summarise_blob, queries.unread()), (Job.verify_blob, queries.unverified())]
    wanted = [(Job.examine_blob, wanting & small) for _, wanting in by_itself]
    for job, wanting in wanted + [(job, wanting & ~small) for job, wanting in by_itself]:
        statement = (
            select(blob.c.id)
            .where(blob.c.doomed_at.is_(None), wanting, blob.c.store_id == store_id, ~has_job(job, blob.c.id))
            .order_by(blob.c.created_at)
            .limit(limit)
        )
        ids = [str(each) for each in (await db.execute(statement)).scalars()]
        await enqueue(db, job, ids=ids, urgency=Urgency.whenever)


async def examine_old(db: Connection, *, store_id: str, older_than_days: int, limit: int) -> None:
    """Queue the blobs that were verified longest ago for another verification, when no new blob waits for its first.

    At most `limit` wait for it at a time.
    """
    room = limit - (await db.execute(queries.WAITING_AT_LEISURE)).scalar_one()
    if older_than_days == 0 or room <= 0:
        return
    old = queries.verified_before(func.now() - datetime.timedelta(days=older_than_days))
    due = old.where(blob.c.store_id == store_id, ~has_job(Job.verify_blob, blob.c.id)).limit(room)
    ids = [str(each) for each in (await db.execute(due)).scalars()]
    await enqueue(db, Job.verify_blob, ids=ids, urgency=Urgency.at_leisure)


async def verify_again(db: Connection, blob_id: uuid.UUID) -> None:
    """See to it that a blob is read and compared with its checksums once more, ahead of routine verification.

    Asking again while a job for it waits only hastens that.
    """
    waiting = select(blob.c.id).where(blob.c.id == blob_id, has_job(Job.verify_blob, blob.c.id))
    if (await db.execute(waiting)).first() is not None:
        await start_now(db, Job.verify_blob, blob_id)
        return
    await enqueue(db, Job.verify_blob, ids=[str(blob_id)], urgency=Urgency.soon)


async def verify_tomorrow(db: Connection, blob_id: uuid.UUID) -> None:
    """See to it that a blob which the store failed to read is read once more: the store may have been at fault."""
    await enqueue(db, Job.verify_blob, ids=[str(blob_id)], urgency=Urgency.at_leisure, later=_TOMORROW)


async def get_blob(db: Connection, blob_id: uuid.UUID) -> Row[Any] | None:
    """Return a blob that is still there and not about to go, with the path of one of its files."""
    return (await db.execute(queries.blobs_with_path([blob_id]))).one_or_none()


async def logs_beside(db: Connection, blob_id: uuid.UUID) -> dict[str, Row[Any]]:
    """Return, by suffix, key and size of the log and journal beside a database: its recorder was killed."""
    return {row.suffix: row for row in await db.execute(queries.logs_beside(blob_id))}


async def taken_along(db: Connection, row: Row[Any], *, most: int) -> Sequence[Row[Any]]:
    """Return small blobs that wait to be examined as this one did, of the same person and store, as `get_blob` does."""
    ids = await waiting(db, Job.examine_blob, most=most)
    alike = (blob.c.uploaded_by_id == row.uploaded_by_id, blob.c.store_id == row.store_id, blob.c.id != row.id)
    return (await db.execute(queries.blobs_with_path(ids).where(*alike))).all()


async def keep_summary(db: Connection, blob_id: uuid.UUID, summary: RecordingSummary) -> None:
    """Keep what reading a blob said, in place of what was known before. What a scan said stays."""
    await keep_summaries(db, {blob_id: summary})


async def keep_summaries(db: Connection, summaries: Mapping[uuid.UUID, RecordingSummary]) -> None:
    """Do as `keep_summary` for several blobs."""
    if not summaries:
        return
    await _hold_missions(db, summaries)
    locked = select(blob.c.id, blob.c.depth).where(among(blob.c.id, summaries)).order_by(blob.c.id).with_for_update()
    known = {row.id: row.depth for row in await db.execute(locked)}
    is_news = {
        each: depth != ReadDepth.scan.value or summaries[each].depth.value == depth for each, depth in known.items()
    }
    news = {each: summaries[each] for each in known if is_news[each]}
    if not news:
        return
    await db.execute(delete(topic).where(among(topic.c.blob_id, news)))
    rows = [_topic_values(blob_id, each) for blob_id, summary in news.items() for each in summary.topics]
    if rows:
        await db.execute(insert(topic), rows)
    kept = update(blob).where(blob.c.id == bindparam("blob_id")).values(summarised_at=func.now())
    await db.execute(kept, [{"blob_id": blob_id, **_values(summary)} for blob_id, summary in news.items()])
    await _regroup_missions(db, news)


def _values(summary: RecordingSummary) -> dict[str, object]:
    start_ns, end_ns = summary.start_ns, summary.end_ns
    if _bigint(start_ns) is None or _bigint(end_ns) is None:
        start_ns = end_ns = None  # half a span is none
    return {
        "content": summary.content.value,
        "content_reason": fit(summary.reason),
        "format": summary.format.value,
        "message_count": _bigint(summary.message_count),
        "start_ns": start_ns,
        "end_ns": end_ns,
        "compression": [fit(each) for each in summary.compression],
        "problems": [{key: fit(value) for key, value in asdict(each).items()} for each in summary.problems],
        "depth": summary.depth.value,
        "lost": summary.lost and asdict(summary.lost),
        "facts": [{key: _fitting(value) for key, value in asdict(each).items()} for each in summary.facts],
    }


def _fitting(value: str | int | float) -> str | int | float:
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)  # JSON has no word for it
    return fit(value) if isinstance(value, str) else value


def _topic_values(blob_id: uuid.UUID, each: Any) -> dict[str, object]:
    values = asdict(each)
    values.pop("suspect_count")
    values["density"] = pack(each.density) if each.density is not None else None
    texts = ("name", "message_type", "schema_name", "schema_encoding", "message_encoding")
    values |= {key: fit(values[key]) for key in texts}
    values |= {key: _bigint(value) for key, value in values.items() if isinstance(value, int)}
    return {"blob_id": blob_id, **values}


def _bigint(value: int | None) -> int | None:
    # Log times are unsigned 64 bit; one past the year 2262 fits no column and is nobody's recording.
    return value if value is None or value <= _MAX_BIGINT else None


async def keep_failure(db: Connection, blob_id: uuid.UUID, reason: str) -> None:
    """Keep that we failed to read a blob, and why; what was read of it before stays."""
    values = {"content": ContentState.error.value, "content_reason": fit(reason), "summarised_at": func.now()}
    await _hold_missions(db, [blob_id])
    unknown = blob.c.content.in_((ContentState.pending.value, ContentState.error.value))
    await db.execute(update(blob).where(blob.c.id == blob_id, unknown).values(**values))
    await _regroup_missions(db, [blob_id])


async def _hold_missions(db: Connection, blob_ids: Iterable[uuid.UUID]) -> None:
    # Before the blobs' own locks: the order in which linking takes them.
    await lock_missions(db, await _missions_of(db, blob_ids))


async def _regroup_missions(db: Connection, blob_ids: Iterable[uuid.UUID]) -> None:
    for mission_id in await _missions_of(db, blob_ids):
        await regroup(db, mission_id)
    await _tell_of_files(db, blob_ids)


async def _tell_of_files(db: Connection, blob_ids: Iterable[uuid.UUID]) -> None:
    made_of = select(file.c.id, file.c.mission_id).where(among(file.c.blob_id, blob_ids), file.c.deleted_at.is_(None))
    rows = await db.execute(made_of)
    await publish(db, [ChangeEvent("file", ChangeKind.changed, row.id, mission_id=row.mission_id) for row in rows])


async def _missions_of(db: Connection, blob_ids: Iterable[uuid.UUID]) -> list[uuid.UUID]:
    holding = select(file.c.mission_id).where(among(file.c.blob_id, blob_ids), file.c.deleted_at.is_(None))
    return sorted((await db.execute(holding.distinct())).scalars())


async def record_verified(db: Connection, md5s: Mapping[uuid.UUID, bytes]) -> None:
    """Keep that the server itself has read blobs, with the MD5 of each, and found their SHA-256.

    One that was lost or corrupt is so no more.
    """
    healed = await _damaged_before(db, md5s)
    said = unnest_rows([blob.c.id, blob.c.md5], [{"id": blob_id, "md5": md5} for blob_id, md5 in md5s.items()])
    values = {"state": BlobState.verified.value, "state_reason": None, "damaged_at": None, "md5": said.c.md5}
    await db.execute(update(blob).where(blob.c.id == said.c.id).values(**values, verified_at=func.now()))
    for blob_id, before in healed.items():
        await _record_of_files(db, blob_id, "file.heal", {"state": before}, {"state": BlobState.verified.value})
    await _tell_of_files(db, md5s)


async def keep_examined(
    db: Connection, summaries: Mapping[uuid.UUID, RecordingSummary], md5s: Mapping[uuid.UUID, bytes]
) -> None:
    """Store summaries and verifications of several small blobs: no job needs to examine any of them any more."""
    await keep_summaries(db, summaries)
    await record_verified(db, md5s)
    await settle(db, Job.examine_blob, md5s)


async def keep_damage(db: Connection, blob_id: uuid.UUID, *, state: BlobState, reason: str) -> bool:
    """Keep that a blob is lost or corrupt, and how that showed; return whether that is news.

    Nothing is kept of a blob that is about to go: its object may be gone already.
    """
    before = (await _damaged_before(db, [blob_id])).get(blob_id)
    said = {"state": state.value, "state_reason": reason}
    values = {**said, "damaged_at": func.coalesce(blob.c.damaged_at, func.now())}
    marked = update(blob).where(blob.c.id == blob_id, blob.c.doomed_at.is_(None)).values(**values)
    if (await db.execute(marked)).rowcount == 0 or before == state.value:
        return False
    await _record_of_files(db, blob_id, "file.damage", {}, {"state": state.value, "reason": reason})
    await _tell_of_files(db, [blob_id])
    return True


async def _damaged_before(db: Connection, blob_ids: Iterable[uuid.UUID]) -> dict[uuid.UUID, str]:
    damaged = blob.c.state.in_((BlobState.lost.value, BlobState.corrupt.value))
    found = select(blob.c.id, blob.c.state).where(among(blob.c.id, blob_ids), damaged)
    return {row.id: row.state for row in await db.execute(found.order_by(blob.c.id).with_for_update())}


async def _record_of_files(
    db: Connection, blob_id: uuid.UUID, operation: str, before: dict[str, str], after: dict[str, str]
) -> None:
    """Add to the record what became of each file that a blob makes, out of the trash."""
    columns = (file.c.id, file.c.path, file.c.mission_id, mission.c.project_id)
    made_of = select(*columns).join_from(file, mission).where(file.c.blob_id == blob_id, file.c.deleted_at.is_(None))
    events = [
        Event(operation, "file", row.id, row.path, row.project_id, {**before}, {**after}, row.mission_id)
        for row in await db.execute(made_of)
    ]
    await record_all(db, None, events)


async def doom_unreferenced(db: Connection, *, limit: int) -> int:
    """Mark blobs that no file refers to, in the trash or out of it; return how many. Of very many, those in turn.

    First the candidates are locked, then looked at again: a file that was linked in between, under the lock that
    linking takes too, saves its blob.
    """
    referred = queries.is_referred()
    candidates = (
        select(blob.c.id)
        .where(blob.c.doomed_at.is_(None), ~referred, await _in_turn(db))
        .order_by(blob.c.id)
        .limit(limit)
        .with_for_update(skip_locked=True)
    )
    ids = (await db.execute(candidates)).scalars().all()
    if not ids:
        return 0
    result = await db.execute(update(blob).where(blob.c.id.in_(ids), ~referred).values(doomed_at=func.now()))
    return result.rowcount


async def _in_turn(db: Connection) -> ColumnElement[bool]:
    """Say of blobs whether it is their turn to be looked at; ids are random, so each round has as many."""
    others = select(blob.c.id).order_by(blob.c.id).offset(_ALL_AT_ONCE).limit(1)
    if (await db.execute(others)).first() is None:
        return true()
    turn = _turn()
    first, following = (2**128 * number // _ROUNDS for number in (turn, turn + 1))
    return blob.c.id.between(uuid.UUID(int=first), uuid.UUID(int=following - 1))


def _turn() -> int:
    return int(time.time()) // _ROUND_S % _ROUNDS


async def doomed_blobs(db: Connection, *, store_id: str, grace_s: float, limit: int) -> Sequence[Row[Any]]:
    """Return id and key of this store's blobs that were doomed longer ago than the grace."""
    before = func.now() - datetime.timedelta(seconds=grace_s)
    # Looked at once more, although nothing can link to a doomed blob: what goes now is gone.
    due = select(blob.c.id, blob.c.key).where(
        blob.c.store_id == store_id, blob.c.doomed_at < before, ~queries.is_referred()
    )
    return (await db.execute(due.order_by(blob.c.doomed_at).limit(limit))).all()


async def forget_blob(db: Connection, blob_id: uuid.UUID) -> None:
    """Drop the row of a doomed blob whose object is gone."""
    await db.execute(delete(blob).where(blob.c.id == blob_id, blob.c.doomed_at.is_not(None)))
