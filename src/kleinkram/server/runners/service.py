"""Registration of runners, claims of runs, and heartbeats."""

import datetime
import time
import uuid
from typing import Any

from sqlalchemy import Row, exists, func, insert, select, update
from sqlalchemy.dialects.postgresql import insert as upsert

from kleinkram.contract.access import Right, Scope, TokenKind
from kleinkram.contract.actions import ActionDefinition, Network
from kleinkram.contract.audit import ChangeKind
from kleinkram.contract.base import Page
from kleinkram.contract.errors import Forbidden, NotFound
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.runners import (
    LEASE_S,
    AssignedInput,
    ClaimReply,
    ClaimRequest,
    Heartbeat,
    HeartbeatReplies,
    HeartbeatReply,
    Heartbeats,
    LeaseStatus,
    RunAssignment,
    RunnerRead,
    RunnerRegistration,
)
from kleinkram.contract.runs import MAX_SAMPLES, ActionRef, EndReason, RunState
from kleinkram.contract.tokens import SecretKind
from kleinkram.server.access.actor import Actor, find_person, new_secret, unexpired
from kleinkram.server.access.visible import level_on_mission, visible_missions
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.change_events import ChangeEvent, publish
from kleinkram.server.context import AppContext
from kleinkram.server.db import Connection
from kleinkram.server.events.hub import EventFilter, Hub
from kleinkram.server.pagination import PageRequest, fetch_page
from kleinkram.server.runners import queries
from kleinkram.server.runners.eligibility import has_single_person, with_limits
from kleinkram.server.runs.lifecycle import end_run, requeue_lost_runs
from kleinkram.server.tables import action_version, mission, project, run, run_input, runner, token, token_limit
from kleinkram.server.tables.runs import ASSIGNED

_SCOPES = {
    Right.read: [Scope.read],
    Right.create: [Scope.read, Scope.upload],
    Right.write: [Scope.write],
    Right.delete: [Scope.write],
}
_ORDER = {RunState.preparing: 0, RunState.running: 1, RunState.collecting: 2}
# The end of a lease publishes no event.
_CHECK_EVERY_S = 5.0
_QUEUE = EventFilter(frozenset({"run"}))
_LEASE = datetime.timedelta(seconds=LEASE_S)
# Results are being uploaded: an outage of minutes must not discard hours of work.
_COLLECTING_LEASE = datetime.timedelta(minutes=15)
# A token ends with its run, and at the latest this long after the time limit of the run.
_TOKEN_MARGIN_S = 3600


async def register_runner(db: Connection, actor: Actor, *, registration: RunnerRegistration) -> RunnerRead:
    """Register a runner. The first runner that uses a token is the only one that may use it from then on.

    Raises:
        Forbidden: it is another person's runner, its token is another runner's, or limited to other labels.
    """
    await _bind(db, actor, registration.id)
    await _check_labels(db, actor, registration)
    known = (await db.execute(select(runner).where(runner.c.id == registration.id).with_for_update())).one_or_none()
    if known and known.person_id != actor.person_id:
        raise Forbidden(noun="server", operation="be this runner", needs="a token of the same person as before")
    values = registration.model_dump(mode="json", exclude={"id"})
    values |= {"token_id": actor.token_id}
    stmt = upsert(runner).values(id=registration.id, person_id=actor.person_id, last_seen_at=func.now(), **values)
    same = {name: stmt.excluded[name] for name in (*values, "last_seen_at")}
    await db.execute(stmt.on_conflict_do_update(index_elements=["id"], set_=same))
    if known is None:
        event = Event(
            "runner.arrive",
            "runner",
            registration.id,
            registration.name,
            None,
            after={"labels": list(registration.labels)},
        )
        await audit(db, actor, event)
    await publish(db, [ChangeEvent("runner", ChangeKind.changed, registration.id)])
    row = (await db.execute(queries.runner_rows().where(runner.c.id == registration.id))).one()
    return queries.to_runner(row, (await db.execute(queries.projects_of([row.token_id]))).all())


async def _bind(db: Connection, actor: Actor, runner_id: uuid.UUID) -> None:
    """Check that a token is this runner's; an unused one is bound to it.

    Raises:
        Forbidden: it is another runner's, or this runner has another valid token.
    """
    if actor.runner_id == runner_id:
        return
    others = token.alias("other_token")
    taken = exists().where(
        others.c.runner_id == runner_id,
        others.c.id != actor.token_id,
        others.c.revoked_at.is_(None),
        unexpired(others.c.expires_at),
    )
    unbound = (token.c.id == actor.token_id) & token.c.runner_id.is_(None) & ~taken
    stmt = update(token).where(unbound | ((token.c.id == actor.token_id) & (token.c.runner_id == runner_id)))
    bound = await db.execute(stmt.values(runner_id=runner_id).returning(token.c.id))
    if bound.first() is None:
        needs = "a token of its own: `klein token create NAME --kind runner`; to replace one, revoke it first"
        raise Forbidden(noun="server", operation="be this runner", needs=needs)
    name = (await db.execute(select(token.c.name).where(token.c.id == actor.token_id))).scalar_one()
    after: Metadata = {"runner_id": str(runner_id)}
    await audit(db, actor, Event("token.bind", "token", actor.token_id, name, None, after=after))


async def _check_labels(db: Connection, actor: Actor, registration: RunnerRegistration) -> None:
    stmt = select(token.c.runner_labels).where(token.c.id == actor.token_id)
    allowed: list[str] | None = (await db.execute(stmt)).scalar_one()
    surplus = sorted(set(registration.labels) - set(allowed)) if allowed is not None else []
    if surplus:
        needs = f"a token for it; this one is limited to {', '.join(allowed or [])}"
        raise Forbidden(noun="server", operation=f"be a runner with the label {surplus[0]}", needs=needs)


async def list_runners(db: Connection, *, page: PageRequest) -> Page[RunnerRead]:
    """Return a page of all runners, by name.

    Raises:
        InvalidCursor: the cursor is not of this list.
    """
    rows = await fetch_page(db, queries.runner_rows(), queries.RUNNER_ORDER, page)
    token_ids = {row.token_id for row in rows.items if row.token_id is not None}
    projects = (await db.execute(queries.projects_of(token_ids))).all()
    return Page(items=[queries.to_runner(row, projects) for row in rows.items], next=rows.next, total=rows.total)


async def claim(
    context: AppContext, hub: Hub, actor: Actor, *, runner_id: uuid.UUID, requested: ClaimRequest
) -> ClaimReply:
    """Assign the oldest run that fits the free resources of a runner; wait for one where there is none.

    Raises:
        NotFound: nobody of this person's is that runner: it must say registration first.
        Forbidden: the token is another runner's.
        TooManyStreams: too many requests of this runner wait already.
    """
    until = time.monotonic() + requested.wait_s
    with hub.long_poll(runner_id, _QUEUE) as listener:
        while True:
            async with context.database.begin() as db:
                candidate = await _claim_now(db, actor, runner_id, requested)
            left_s = until - time.monotonic()
            if candidate is not None or left_s <= 0 or hub.is_closed:
                return ClaimReply(run=candidate)
            await hub.next_event(listener, timeout_s=min(left_s, _CHECK_EVERY_S))


async def _claim_now(
    db: Connection, actor: Actor, runner_id: uuid.UUID, requested: ClaimRequest
) -> RunAssignment | None:
    await _note_seen(db, actor, runner_id)
    row = (await db.execute(with_limits(select(runner)).where(runner.c.id == runner_id))).one()
    await requeue_lost_runs(db)
    unheard = (await db.execute(queries.unanswered_claim(runner_id, requested.active_run_ids))).one_or_none()
    if unheard is not None:
        return await _assign(db, unheard, runner_id, unheard.attempt)
    stmt = queries.next_run(row, requested, single_person=await has_single_person(db))
    while stmt is not None:
        candidate = (await db.execute(stmt)).one_or_none()
        if candidate is None:
            break
        if await _may_still(db, candidate):
            return await _assign(db, candidate, runner_id, candidate.attempt + 1)
        message = "The person who launched it may not run it on this mission any more."
        await end_run(db, candidate, EndReason.cancelled, message)
    return None


async def _note_seen(db: Connection, actor: Actor, runner_id: uuid.UUID) -> None:
    """Record that a runner was seen. One from before tokens were bound is bound to its token."""
    mine = (runner.c.id == runner_id) & (runner.c.person_id == actor.person_id)
    values = {"last_seen_at": func.now(), "token_id": actor.token_id}
    if (await db.execute(update(runner).where(mine).values(values).returning(runner.c.id))).first() is None:
        raise NotFound(noun="runner", ref=str(runner_id))
    await _bind(db, actor, runner_id)


async def _may_still(db: Connection, row: Row[Any]) -> bool:
    starter = await find_person(db, row.started_by_id)
    if starter is None:
        return False
    needed = max(Right.create, Right(row.definition["right"]), key=lambda right: right.level)
    levels = visible_missions(starter).with_only_columns(level_on_mission(starter), maintain_column_froms=True)
    level: int | None = (await db.execute(levels.where(mission.c.id == row.mission_id))).scalar_one_or_none()
    return level is not None and level >= needed.level


async def _assign(db: Connection, row: Row[Any], runner_id: uuid.UUID, attempt: int) -> RunAssignment:
    state = RunState.preparing.value if attempt != row.attempt else row.state
    lease = {"state": state, "runner_id": runner_id, "attempt": attempt, "lease_ends_at": func.now() + _LEASE}
    claimed_at = func.coalesce(run.c.claimed_at, func.now())
    await db.execute(update(run).where(run.c.id == row.id).values(claimed_at=claimed_at, **lease))
    await publish(db, [ChangeEvent("run", ChangeKind.changed, row.id, mission_id=row.mission_id)])
    definition = ActionDefinition.model_validate(row.definition)
    inputs = select(run_input).where(run_input.c.run_id == row.id).order_by(run_input.c.path)
    return RunAssignment(
        run_id=row.id,
        attempt=attempt,
        project_id=row.project_id,
        mission_id=row.mission_id,
        action=ActionRef(id=row.action_id, name=definition.name, version=row.number),
        image=definition.image,
        image_digest=row.pinned_digest,
        command=definition.command,
        script=definition.script,
        dependencies=definition.dependencies,
        parameters=row.parameters,
        resources=definition.resources,
        network=definition.network,
        inputs=[
            AssignedInput(path=entry.path, size_bytes=entry.size_bytes, sha256=entry.sha256.hex())
            for entry in await db.execute(inputs)
        ],
        token=None if definition.network is Network.none else await _run_token(db, row, definition),
        lease_s=LEASE_S,
    )


async def _run_token(db: Connection, row: Row[Any], definition: ActionDefinition) -> str:
    """Create the token of a run, limited to its mission and to the right that its action declares.

    Earlier tokens of the same attempt stay valid: a claim that its runner has given up, but that still waits here, is
    answered with the run once more, and the running job must not lose its token.
    """
    secret, token_id = new_secret(SecretKind.run), uuid.uuid4()
    lasts = datetime.timedelta(seconds=definition.resources.time_s + _TOKEN_MARGIN_S)
    values = {
        "person_id": row.started_by_id,
        "kind": TokenKind.run.value,
        "name": definition.name,
        "prefix": secret.prefix,
        "secret_sha256": secret.sha256,
        "scopes": [scope.value for scope in _SCOPES[definition.right]],
        "run_id": row.id,
        "max_right": definition.right.value,
    }
    await db.execute(insert(token).values(id=token_id, is_limited=True, expires_at=func.now() + lasts, **values))
    await db.execute(insert(token_limit).values(id=uuid.uuid4(), token_id=token_id, mission_id=row.mission_id))
    return secret.text


async def record_heartbeats(
    db: Connection, actor: Actor, *, runner_id: uuid.UUID, heartbeats: Heartbeats
) -> HeartbeatReplies:
    """Record the states of a runner's runs, renew their leases, and return their status.

    Raises:
        NotFound: this person has no such runner.
        Forbidden: the token is another runner's.
    """
    await _note_seen(db, actor, runner_id)
    answers = [
        await _record_heartbeat(db, runner_id, heartbeat)
        for heartbeat in sorted(heartbeats.runs, key=lambda heartbeat: heartbeat.run_id)
    ]
    return HeartbeatReplies(runs=answers, lease_s=LEASE_S)


async def _record_heartbeat(db: Connection, runner_id: uuid.UUID, heartbeat: Heartbeat) -> HeartbeatReply:
    assigned = (run.c.id == heartbeat.run_id) & (run.c.attempt == heartbeat.attempt) & (run.c.runner_id == runner_id)
    gone = func.coalesce(mission.c.deleted_at, project.c.deleted_at).is_not(None).label("is_gone")
    image = action_version.c.definition["image"].astext.label("image")
    joined = select(run, gone, image).join_from(run, mission, mission.c.id == run.c.mission_id).join(project)
    stmt = joined.join(action_version, action_version.c.id == run.c.version_id).where(
        assigned, run.c.state.in_(ASSIGNED)
    )
    row = (await db.execute(stmt.with_for_update(of=run, key_share=True))).one_or_none()
    if row is None:
        return HeartbeatReply(run_id=heartbeat.run_id, attempt=heartbeat.attempt, status=LeaseStatus.lost)
    values = _changes_of(row, heartbeat)
    lease = _COLLECTING_LEASE if heartbeat.state is RunState.collecting else _LEASE
    await db.execute(update(run).where(run.c.id == row.id).values(lease_ends_at=func.now() + lease, **values))
    if heartbeat.image_digest is not None and row.image is not None:
        await db.execute(queries.pin_image(row.version_id, heartbeat.image_digest))
    if values:
        await publish(db, [ChangeEvent("run", ChangeKind.changed, row.id, mission_id=row.mission_id)])
    is_over = row.cancel_requested_at is not None or row.is_gone
    return HeartbeatReply(
        run_id=heartbeat.run_id, attempt=heartbeat.attempt, status=LeaseStatus.cancel if is_over else LeaseStatus.active
    )


def _changes_of(row: Row[Any], heartbeat: Heartbeat) -> dict[str, Any]:
    """Return the columns that a heartbeat changes; the state never goes back."""
    values: dict[str, Any] = {}
    if heartbeat.state in _ORDER and _ORDER[heartbeat.state] > _ORDER[RunState(row.state)]:
        values["state"] = heartbeat.state.value
    if heartbeat.state is not RunState.preparing and row.started_at is None:
        values["started_at"] = func.now()
    if heartbeat.image_digest is not None and row.image_digest is None:
        values["image_digest"] = heartbeat.image_digest
    for name in ("progress", "usage"):
        reported = getattr(heartbeat, name)
        if reported is not None and reported.model_dump(mode="json") != getattr(row, name):
            values[name] = reported.model_dump(mode="json")
    if heartbeat.samples:
        values["samples"] = thinned([*row.samples, *(entry.model_dump(mode="json") for entry in heartbeat.samples)])
    return values


def thinned(samples: list[Any]) -> list[Any]:
    """Return at most `MAX_SAMPLES` samples: of more, every second one and the last."""
    while len(samples) > MAX_SAMPLES:
        samples = [*samples[:-1:2], samples[-1]]
    return samples
