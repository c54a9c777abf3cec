"""Heartbeats: a runner reports the states of its runs, which renews their leases.

A few statements for any number of runs: a cluster has 500, and sends heartbeats every four seconds. Of most, nothing is
new: the runner only names them, and they are only looked up. A long lease is not renewed before a part of it is over.
"""

import uuid
from collections.abc import Sequence
from typing import Any, NamedTuple

from pydantic_core import to_json
from sqlalchemy import text

from kleinkram.contract.audit import ChangeKind
from kleinkram.contract.runners import (
    LEASE_S,
    Heartbeat,
    HeartbeatReplies,
    HeartbeatReply,
    Heartbeats,
    LeaseStatus,
    RunAttempt,
)
from kleinkram.contract.runs import MAX_SAMPLES, RunState
from kleinkram.server.access.actor import Actor
from kleinkram.server.change_events import ChangeEvent, publish
from kleinkram.server.db import Connection
from kleinkram.server.runners.assigned_runs import TOKEN_MARGIN, pin_images, record_seen, thinned

_ORDER = {RunState.preparing: 0, RunState.running: 1, RunState.collecting: 2}
# Results are being uploaded: an outage of minutes must not discard hours of work.
_COLLECTING_LEASE_S = 15 * 60
# `publish` replaces more events at once by one that has all pages reload everything.
_EVENTS = 100
_RECORD = text("""
UPDATE run SET
  lease_ends_at = now() + make_interval(secs => news.lease_s),
  state = coalesce(news.state, run.state),
  started_at = CASE WHEN news.has_started THEN coalesce(run.started_at, now()) ELSE run.started_at END,
  image_digest = coalesce(run.image_digest, news.image_digest),
  progress = CASE WHEN news.has_progress THEN news.progress ELSE run.progress END,
  placement = coalesce(news.placement, run.placement),
  usage = coalesce(news.usage, run.usage),
  samples = coalesce(news.all_samples, run.samples || news.samples, run.samples)
FROM jsonb_to_recordset(CAST(:news AS jsonb)) AS news(
  id uuid, lease_s double precision, state text, has_started boolean, image_digest text, has_progress boolean,
  progress jsonb, placement jsonb, usage jsonb, samples jsonb, all_samples jsonb
)
WHERE run.id = news.id
""")

# As text: SQLAlchemy takes longer to build it than PostgreSQL to run it.
_READ_SQL = """
SELECT run.id, run.mission_id, version_id, attempt, run.state, started_at IS NOT NULL, image_digest, progress,
  placement, usage,
  CASE WHEN run.id = ANY (CAST(:with_samples AS uuid[])) AND jsonb_array_length(samples) > :most_samples
    THEN samples END,
  coalesce(cancel_requested_at, mission.deleted_at, project.deleted_at) IS NOT NULL,
  CAST(extract(epoch FROM lease_ends_at - now()) AS double precision)
FROM run JOIN mission ON mission.id = run.mission_id JOIN project ON project.id = mission.project_id
WHERE run.id = ANY (CAST(:run_ids AS uuid[])) AND runner_id = :runner_id
  AND run.state IN ('preparing', 'running', 'collecting')
ORDER BY run.id
"""
_READ, _LOCK = text(_READ_SQL), text(f"{_READ_SQL} FOR NO KEY UPDATE OF run")
# Of the runs of which nothing is new, those whose lease is due, that are to be cancelled, or that are lost.
_READ_NOTABLE = text("""
SELECT named.run_id, named.attempt, coalesce(run.state, 'preparing')
FROM unnest(CAST(:run_ids AS uuid[]), CAST(:attempts AS integer[])) AS named(run_id, attempt)
LEFT JOIN (run JOIN mission ON mission.id = run.mission_id JOIN project ON project.id = mission.project_id)
  ON run.id = named.run_id AND run.attempt = named.attempt AND runner_id = :runner_id
    AND run.state IN ('preparing', 'running', 'collecting')
WHERE run.id IS NULL OR coalesce(cancel_requested_at, mission.deleted_at, project.deleted_at) IS NOT NULL
  OR lease_ends_at - now()
    < make_interval(secs => CASE WHEN run.state = 'collecting' THEN :collecting_due_s ELSE :due_s END)
""")
# A job may wait in the queue of a cluster for days, at first or after a failure of its node: its token lasts longer.
_EXTEND_TOKENS = text("""
UPDATE token SET expires_at = now() + unfinished.lasts
FROM (
  SELECT run.id, make_interval(secs => (definition #>> '{resources,time_s}')::integer + :margin_s) AS lasts
  FROM run JOIN action_version ON action_version.id = run.version_id WHERE run.id = ANY (CAST(:run_ids AS uuid[]))
) AS unfinished
WHERE token.run_id = unfinished.id AND token.revoked_at IS NULL
  AND token.expires_at < now() + unfinished.lasts - make_interval(secs => CAST(:margin_s AS double precision) / 2)
""")


class _Reported(NamedTuple):
    """What is known of a run; `samples` only if there will be too many."""

    id: uuid.UUID
    mission_id: uuid.UUID
    version_id: uuid.UUID
    attempt: int
    state: str
    has_started: bool
    image_digest: str | None
    progress: dict[str, Any] | None
    placement: dict[str, Any] | None
    usage: dict[str, Any] | None
    samples: list[dict[str, Any]] | None
    is_over: bool
    lease_left_s: float


async def record_heartbeats(
    db: Connection, actor: Actor, *, runner_id: uuid.UUID, heartbeats: Heartbeats
) -> HeartbeatReplies:
    """Record that a runner was seen, and the states of its runs; renew their leases, and return their status.

    Raises:
        NotFound: this person has no such runner.
        Forbidden: the token is another runner's.
    """
    lease = _Lease(await record_seen(db, actor, runner_id))
    reported = [*heartbeats.runs, *await _notable(db, runner_id, heartbeats.unchanged, lease)]
    by_attempt = {(one.run_id, one.attempt): one for one in reported}
    read = await _read_reported(db, runner_id, reported, lock=False) if reported else []
    rows = {(row.id, row.attempt): row for row in read if (row.id, row.attempt) in by_attempt}
    changed = {key: by_attempt[key] for key, row in rows.items() if _is_changed(row, by_attempt[key], lease)}
    if changed:
        locked = await _read_reported(db, runner_id, [*changed.values()], lock=True)
        still_here = [(row, changed[row.id, row.attempt]) for row in locked if (row.id, row.attempt) in changed]
        await _record(db, still_here, lease)
        # Without those that were lost since they were read.
        rows = {key: row for key, row in rows.items() if key not in changed}
        rows |= {(row.id, row.attempt): row for row, _ in still_here}
    replies = []
    for heartbeat in reported:
        row = rows.get((heartbeat.run_id, heartbeat.attempt))
        status = LeaseStatus.lost
        if row is not None:
            status = LeaseStatus.cancel if row.is_over else LeaseStatus.active
        replies.append(HeartbeatReply(run_id=heartbeat.run_id, attempt=heartbeat.attempt, status=status))
    return HeartbeatReplies(runs=replies, lease_s=lease.left_s)


class _Lease(NamedTuple):
    """The lengths of the leases of a runner's runs in seconds."""

    lasts_s: int

    @property
    def left_s(self) -> float:
        """At least so much is left of a lease after a heartbeat: a usual lease is renewed by each."""
        return self.lasts_s - max(0, self.lasts_s - LEASE_S) / 10

    def of(self, state: RunState) -> float:
        """The length of the lease of a run in this state."""
        return max(self.lasts_s, _COLLECTING_LEASE_S) if state is RunState.collecting else self.lasts_s

    def due_s(self, state: RunState) -> float:
        """The lease of a run in this state is renewed once less is left of it."""
        return self.of(state) - (self.lasts_s - self.left_s)


async def _notable(
    db: Connection, runner_id: uuid.UUID, unchanged: Sequence[RunAttempt], lease: _Lease
) -> list[Heartbeat]:
    """Return heartbeats, without news, of unchanged runs whose lease is due, that are to be cancelled, or are lost."""
    if not unchanged:
        return []
    values = {
        "run_ids": [one.run_id for one in unchanged],
        "attempts": [one.attempt for one in unchanged],
        "runner_id": runner_id,
        "due_s": lease.due_s(RunState.running),
        "collecting_due_s": lease.due_s(RunState.collecting),
    }
    rows = await db.execute(_READ_NOTABLE, values)
    return [Heartbeat(run_id=run_id, attempt=attempt, state=RunState(state)) for run_id, attempt, state in rows]


async def _read_reported(
    db: Connection, runner_id: uuid.UUID, reported: Sequence[Heartbeat], *, lock: bool
) -> list[_Reported]:
    """Return the runs that a runner has, in the order of their ids."""
    with_samples = {heartbeat.run_id for heartbeat in reported if heartbeat.samples}
    values = {
        "run_ids": list({heartbeat.run_id for heartbeat in reported}),
        "runner_id": runner_id,
        "with_samples": list(with_samples),
        "most_samples": MAX_SAMPLES - max((len(heartbeat.samples) for heartbeat in reported), default=0),
    }
    return [_Reported._make(row) for row in await db.execute(_LOCK if lock else _READ, values)]


def _is_changed(row: _Reported, heartbeat: Heartbeat, lease: _Lease) -> bool:
    """Whether a heartbeat says something new, or the lease is to be renewed."""
    is_due = row.lease_left_s < lease.due_s(heartbeat.state)
    return is_due or bool(_news(row, heartbeat))


def _news(row: _Reported, heartbeat: Heartbeat) -> dict[str, Any]:
    """Return what a heartbeat changes of a run, beside its lease."""
    news: dict[str, Any] = {}
    # The state never goes back.
    if heartbeat.state in _ORDER and _ORDER[heartbeat.state] > _ORDER[RunState(row.state)]:
        news["state"] = heartbeat.state.value
    if heartbeat.state is not RunState.preparing and not row.has_started:
        news["has_started"] = True
    if heartbeat.image_digest is not None and row.image_digest is None:
        news["image_digest"] = heartbeat.image_digest
    for name in ("progress", "placement", "usage"):
        reported = getattr(heartbeat, name)
        value = None if reported is None else reported.model_dump(mode="json")
        if value is not None and value != getattr(row, name):
            news[name] = value
    if "progress" in news or (news.get("state") == RunState.running.value and heartbeat.progress is None):
        # That of its preparation ends with it.
        news["has_progress"] = True
    if row.samples is not None and heartbeat.samples:
        news["all_samples"] = thinned(row.samples, heartbeat.samples)
    elif heartbeat.samples:
        news["samples"] = [sample.model_dump(mode="json") for sample in heartbeat.samples]
    return news


async def _record(db: Connection, reported: Sequence[tuple[_Reported, Heartbeat]], lease: _Lease) -> None:
    if not reported:
        return
    changes: list[dict[str, Any]] = []
    events: list[ChangeEvent] = []
    digests: dict[uuid.UUID, str] = {}
    for row, heartbeat in reported:
        news = _news(row, heartbeat)
        changes.append({"id": row.id, "lease_s": lease.of(heartbeat.state), **news})
        if news:
            events.append(ChangeEvent("run", ChangeKind.changed, row.id, mission_id=row.mission_id))
        if "image_digest" in news:
            digests[row.version_id] = news["image_digest"]
    await db.execute(_RECORD, {"news": to_json(changes).decode()})
    await pin_images(db, digests)
    if unfinished := [row.id for row, heartbeat in reported if heartbeat.state is not RunState.collecting]:
        await db.execute(_EXTEND_TOKENS, {"run_ids": unfinished, "margin_s": TOKEN_MARGIN.total_seconds()})
    for start in range(0, len(events), _EVENTS):
        await publish(db, events[start : start + _EVENTS])
