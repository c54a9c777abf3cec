"""Claims: a runner asks for queued runs that it can execute, and gets them with a lease."""

import datetime
import itertools
import time
import uuid
from collections.abc import Mapping, Sequence

from sqlalchemy import case, func, insert, select, update

from kleinkram.contract.access import Right, Scope, TokenKind
from kleinkram.contract.actions import ActionDefinition, Network
from kleinkram.contract.audit import ChangeKind
from kleinkram.contract.isolation import Isolation
from kleinkram.contract.runners import AssignedInput, ClaimReply, ClaimRequest, RunAssignment
from kleinkram.contract.runs import ActionRef, EndReason, RunState
from kleinkram.contract.token_format import SecretKind
from kleinkram.server import metrics
from kleinkram.server.access.actor import Actor, find_person, new_secret
from kleinkram.server.access.visible import level_on_mission, visible_missions
from kleinkram.server.change_events import ChangeEvent, publish
from kleinkram.server.context import AppContext
from kleinkram.server.db import Connection, among, insert_rows
from kleinkram.server.events.hub import EventFilter, Hub
from kleinkram.server.runners.assigned_runs import (
    AssignedRun,
    find_definitions,
    lock_runs,
    lock_unknown_runs,
    record_seen,
    token_lifetime,
)
from kleinkram.server.runners.queue import lock_next_runs
from kleinkram.server.runs.eligibility import (
    NEEDS_COLUMNS,
    IsolationRule,
    KnownRunner,
    find_runner,
    isolation_rule,
    known_runners,
    to_needs,
)
from kleinkram.server.runs.lifecycle import end_run, requeue_lost_runs
from kleinkram.server.tables import mission, project, run, run_input, runner, token, token_limit

_SCOPES = {
    Right.read: [Scope.read],
    Right.create: [Scope.read, Scope.upload],
    Right.write: [Scope.write],
    Right.delete: [Scope.write],
}
# New runs end the wait of a claim. Whatever else lets a run start, as the end of a lease, is noticed by this time.
_CHECK_EVERY_S = 5.0
# Where many are launched, a waiting claim looks no more often than this.
_CHECK_PAUSE_S = 0.25
_NEW_RUNS = EventFilter(frozenset({"run"}), change=ChangeKind.created)
# The fields of an assignment that are those of the definition.
_OF_DEFINITION = (
    *("image", "command", "script", "dependencies", "requires_python", "lock"),
    *("resources", "cluster", "network"),
)


async def claim(
    context: AppContext, hub: Hub, actor: Actor, *, runner_id: uuid.UUID, requested: ClaimRequest
) -> ClaimReply:
    """Assign the next runs that fit the free resources of a runner; wait for one where there is none.

    Raises:
        NotFound: this person has no such runner.
        Forbidden: the token is another runner's.
        TooManyStreams: too many requests of this runner wait already.
    """
    until = time.monotonic() + requested.wait_s
    with hub.long_poll(runner_id, _NEW_RUNS) as listener:
        while True:
            async with context.database.begin() as db:
                weakest = context.settings.weakest_isolation
                assigned = await _claim_now(db, actor, runner_id, requested, weakest)
            left_s = until - time.monotonic()
            if assigned or left_s <= 0 or hub.is_closed:
                return ClaimReply(run=assigned[0] if assigned else None, more=assigned[1:])
            await hub.sleep(min(left_s, _CHECK_PAUSE_S))
            await hub.next_event(listener, timeout_s=min(left_s, _CHECK_EVERY_S))


async def _claim_now(
    db: Connection, actor: Actor, runner_id: uuid.UUID, requested: ClaimRequest, weakest: Isolation
) -> list[RunAssignment]:
    lease_s = await record_seen(db, actor, runner_id)
    await requeue_lost_runs(db)
    # The answer to an earlier claim was lost.
    if unanswered := await lock_unknown_runs(db, runner_id, requested.active_run_ids, limit=requested.max_runs):
        return await _assign(db, unanswered, await find_definitions(db, unanswered), runner_id, lease_s)
    claiming = await find_runner(db, runner_id)
    rule = await isolation_rule(db, weakest)
    while run_ids := await _next_runs(db, claiming, requested, rule):
        rows = {row.id: row for row in await lock_runs(db, run_ids)}
        candidates = [rows[run_id] for run_id in run_ids]
        definitions = await find_definitions(db, candidates)
        allowed = await _still_allowed(db, candidates, definitions)
        for candidate in candidates:
            if candidate.id not in allowed:
                message = "The person who launched it may not run it on this mission any more."
                await end_run(db, candidate.id, EndReason.cancelled, message)
        if allowed:
            assigned = [row for row in candidates if row.id in allowed]
            return await _assign(db, assigned, definitions, runner_id, lease_s)
    return []


async def _next_runs(
    db: Connection, claiming: KnownRunner, requested: ClaimRequest, rule: IsolationRule
) -> list[uuid.UUID]:
    """Return the next runs for a runner, locked: none behind one that keeps its resources free."""
    free, max_runs = requested.free, requested.max_runs
    candidates = await lock_next_runs(db, claiming, free, max_runs, rule, may_keep_room=True)
    large = next((candidate.id for candidate in candidates if candidate.keeps_room), None)
    if large is not None and not await _keeps_room_here(db, claiming, large, rule):
        candidates = await lock_next_runs(db, claiming, free, max_runs, rule, may_keep_room=False)
    return [candidate.id for candidate in itertools.takewhile(lambda one: not one.keeps_room, candidates)]


async def _keeps_room_here(db: Connection, claiming: KnownRunner, run_id: uuid.UUID, rule: IsolationRule) -> bool:
    """Whether a runner is the one that keeps room for a run: one alone does, of those that can execute it."""
    stmt = select(*NEEDS_COLUMNS).join_from(run, mission, mission.c.id == run.c.mission_id)
    stmt = stmt.join(project, project.c.id == mission.c.project_id).where(run.c.id == run_id)
    needs = to_needs((await db.execute(stmt)).mappings().one())
    known = await known_runners(db, rule.weakest)
    able = [one.id for one in known.runners if one.is_alive and one.refusal(needs, rule) is None]
    return claiming.id == min(able, default=claiming.id)


async def _still_allowed(
    db: Connection, candidates: Sequence[AssignedRun], definitions: Mapping[uuid.UUID, ActionDefinition]
) -> set[uuid.UUID]:
    """Return the runs whose launchers still have the right that the action requires."""
    allowed: set[uuid.UUID] = set()
    for person_id in {candidate.started_by_id for candidate in candidates}:
        starter = await find_person(db, person_id)
        if starter is None:
            continue
        own = [candidate for candidate in candidates if candidate.started_by_id == person_id]
        columns = (mission.c.id, level_on_mission(starter).label("level"))
        stmt = visible_missions(starter).with_only_columns(*columns, maintain_column_froms=True)
        seen = await db.execute(stmt.where(among(mission.c.id, {candidate.mission_id for candidate in own})))
        levels: dict[uuid.UUID, int] = {row.id: row.level for row in seen}
        for candidate in own:
            needed = max(Right.create, definitions[candidate.version_id].right, key=lambda right: right.level)
            if levels.get(candidate.mission_id, 0) >= needed.level:
                allowed.add(candidate.id)
    return allowed


async def _assign(
    db: Connection,
    rows: Sequence[AssignedRun],
    definitions: Mapping[uuid.UUID, ActionDefinition],
    runner_id: uuid.UUID,
    lease_s: int,
) -> list[RunAssignment]:
    """Assign queued runs to a runner, or return again those that it has."""
    is_queued = run.c.state == RunState.queued.value
    attempt = case((is_queued, run.c.attempt + 1), else_=run.c.attempt)
    isolation = select(runner.c.abilities["isolation"].astext).where(runner.c.id == runner_id).scalar_subquery()
    values = {
        "state": case((is_queued, RunState.preparing.value), else_=run.c.state),
        "attempt": attempt,
        "runner_id": runner_id,
        "isolation": case((is_queued, isolation), else_=run.c.isolation),
        "lease_ends_at": func.now() + datetime.timedelta(seconds=lease_s),
        "claimed_at": func.coalesce(run.c.claimed_at, func.now()),
    }
    waited_s = func.extract("epoch", func.now() - run.c.created_at)
    run_ids = [row.id for row in rows]
    stmt = update(run).where(among(run.c.id, run_ids)).values(**values).returning(run.c.id, run.c.attempt, waited_s)
    attempts: dict[uuid.UUID, int] = {}
    waits_s: dict[uuid.UUID, float] = {}
    for run_id, number, seconds in await db.execute(stmt):
        attempts[run_id], waits_s[run_id] = number, float(seconds)
    for row in rows:
        if row.attempt == 0:
            metrics.RUN_WAIT_SECONDS.observe(waits_s[row.id])
    await publish(db, [ChangeEvent("run", ChangeKind.changed, row.id, mission_id=row.mission_id) for row in rows])
    inputs: dict[uuid.UUID, list[AssignedInput]] = {}
    of_runs = select(run_input.c.run_id, run_input.c.path, run_input.c.size_bytes, run_input.c.sha256)
    of_runs = of_runs.where(among(run_input.c.run_id, run_ids)).order_by(run_input.c.run_id, run_input.c.path)
    for entry in await db.execute(of_runs):
        assigned = AssignedInput(path=entry.path, size_bytes=entry.size_bytes, sha256=entry.sha256.hex())
        inputs.setdefault(entry.run_id, []).append(assigned)
    tokens = await _create_tokens(db, rows, definitions)
    return [
        RunAssignment(
            run_id=row.id,
            attempt=attempts[row.id],
            project_id=row.project_id,
            mission_id=row.mission_id,
            action=ActionRef(id=row.action_id, name=row.action_name, version=row.version_number),
            image_digest=row.pinned_digest,
            parameters=row.parameters,
            inputs=inputs.get(row.id, []),
            token=tokens.get(row.id),
            lease_s=lease_s,
            traceparent=row.traceparent,
            **{name: getattr(definitions[row.version_id], name) for name in _OF_DEFINITION},
        )
        for row in rows
    ]


async def _create_tokens(
    db: Connection, rows: Sequence[AssignedRun], definitions: Mapping[uuid.UUID, ActionDefinition]
) -> dict[uuid.UUID, str]:
    """Create the tokens of runs, each limited to its mission and to the right that its action declares.

    Earlier tokens of the same attempt stay valid: a claim that its runner has given up may be answered with the run
    again, and the running job must not lose its token.
    """
    secrets: dict[uuid.UUID, str] = {}
    tokens, limits = [], []
    for row in rows:
        definition = definitions[row.version_id]
        if definition.network is Network.none:
            continue
        secret, token_id = new_secret(SecretKind.run), uuid.uuid4()
        secrets[row.id] = secret.text
        values = {
            "id": token_id,
            "person_id": row.started_by_id,
            "kind": TokenKind.run.value,
            "name": definition.name,
            "prefix": secret.prefix,
            "secret_sha256": secret.sha256,
            "scopes": [scope.value for scope in _SCOPES[definition.right]],
            "run_id": row.id,
            "max_right": definition.right.value,
            "is_limited": True,
            "expires_at": func.now() + token_lifetime(definition),
        }
        tokens.append(values)
        limits.append({"id": uuid.uuid4(), "token_id": token_id, "mission_id": row.mission_id})
    if tokens:
        await db.execute(insert(token).values(tokens))
        await db.execute(insert_rows(token_limit, limits))
    return secrets
