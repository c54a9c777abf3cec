"""Registration of runners, and claims of runs."""

import datetime
import time
import uuid
from collections.abc import Collection

from sqlalchemy import ARRAY, ColumnElement, Text, exists, func, insert, literal, or_, select, update
from sqlalchemy.dialects.postgresql import insert as upsert

from kleinkram.contract.access import Right, Scope, TokenKind
from kleinkram.contract.actions import Network
from kleinkram.contract.audit import ChangeKind
from kleinkram.contract.base import Page
from kleinkram.contract.errors import Forbidden
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.projects import ProjectRef
from kleinkram.contract.runners import (
    AssignedInput,
    Capacity,
    ClaimReply,
    ClaimRequest,
    RunAssignment,
    RunnerRead,
    RunnerRegistration,
    RunnerToken,
)
from kleinkram.contract.runs import ActionRef, EndReason, RunState
from kleinkram.contract.tokens import SecretKind
from kleinkram.server import metrics
from kleinkram.server.access.actor import Actor, find_person, new_secret, unexpired
from kleinkram.server.access.visible import level_on_mission, visible_missions
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.change_events import ChangeEvent, publish
from kleinkram.server.context import AppContext
from kleinkram.server.db import Connection, among
from kleinkram.server.events.hub import EventFilter, Hub
from kleinkram.server.pagination import Order, PageRequest, fetch_page
from kleinkram.server.runners.assigned_runs import OWN_TOKEN, AssignedRun, lock_run, record_seen, token_lifetime
from kleinkram.server.runs.eligibility import (
    KnownRunner,
    find_runner,
    has_single_person,
    is_alive,
    with_token_limits,
)
from kleinkram.server.runs.lifecycle import end_run, requeue_lost_runs
from kleinkram.server.tables import mission, project, run, run_input, runner, token, token_limit
from kleinkram.server.tables.runs import ASSIGNED

_RUNNER_ORDER = Order([runner.c.name, runner.c.id])
_SCOPES = {
    Right.read: [Scope.read],
    Right.create: [Scope.read, Scope.upload],
    Right.write: [Scope.write],
    Right.delete: [Scope.write],
}
# The end of a lease publishes no event.
_CHECK_EVERY_S = 5.0
_QUEUE = EventFilter(frozenset({"run"}))
# Fractions of cores are summed as floats.
_ROUNDING = 1e-6


async def register_runner(db: Connection, actor: Actor, *, registration: RunnerRegistration) -> RunnerRead:
    """Register a runner. The first runner that uses a token is the only one that may use it from then on.

    Raises:
        Forbidden: it is another person's runner, its token is another runner's, or limited to other labels.
    """
    await _bind(db, actor, registration.id)
    stmt = select(token.c.runner_labels).where(token.c.id == actor.token_id)
    allowed: list[str] | None = (await db.execute(stmt)).scalar_one()
    if allowed is not None and (not_allowed := sorted(set(registration.labels) - set(allowed))):
        needs = f"a token for it; this one is limited to {', '.join(allowed)}"
        raise Forbidden(resource_type="server", operation=f"be a runner with the label {not_allowed[0]}", needs=needs)
    owner = select(runner.c.person_id).where(runner.c.id == registration.id).with_for_update()
    owner_id = (await db.execute(owner)).scalar_one_or_none()
    if owner_id not in {None, actor.person_id}:
        raise Forbidden(
            resource_type="server", operation="be this runner", needs="a token of the same person as before"
        )
    values = registration.model_dump(mode="json", exclude={"id"})
    values |= {"token_id": actor.token_id}
    write = upsert(runner).values(id=registration.id, person_id=actor.person_id, last_seen_at=func.now(), **values)
    same = {name: write.excluded[name] for name in (*values, "last_seen_at")}
    await db.execute(write.on_conflict_do_update(index_elements=["id"], set_=same))
    if owner_id is None:
        after: Metadata = {"labels": list(registration.labels)}
        await audit(
            db, actor, Event("runner.register", "runner", registration.id, registration.name, None, after=after)
        )
    await publish(db, [ChangeEvent("runner", ChangeKind.changed, registration.id)])
    (read,) = await _read_runners(db, [registration.id])
    return read


async def _bind(db: Connection, actor: Actor, runner_id: uuid.UUID) -> None:
    """Bind an unused token to a runner. Raises Forbidden: it is another runner's, or this one has another."""
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
        raise Forbidden(resource_type="server", operation="be this runner", needs=OWN_TOKEN)
    name = (await db.execute(select(token.c.name).where(token.c.id == actor.token_id))).scalar_one()
    after: Metadata = {"runner_id": str(runner_id)}
    await audit(db, actor, Event("token.bind", "token", actor.token_id, name, None, after=after))


async def list_runners(db: Connection, *, page: PageRequest) -> Page[RunnerRead]:
    """Return a page of all runners, by name.

    Raises:
        InvalidCursor: the cursor is not of this list.
    """
    rows = await fetch_page(db, select(runner.c.id, runner.c.name), _RUNNER_ORDER, page)
    return Page(items=await _read_runners(db, [row.id for row in rows.items]), next=rows.next, total=rows.total)


async def _read_runners(db: Connection, runner_ids: Collection[uuid.UUID]) -> list[RunnerRead]:
    """Return runners with their tokens, by name."""
    limits = select(token_limit.c.token_id, project.c.id, project.c.name).join_from(token_limit, project)
    of_runners = limits.join(runner, runner.c.token_id == token_limit.c.token_id).where(among(runner.c.id, runner_ids))
    projects: dict[uuid.UUID, list[ProjectRef]] = {}
    for row in await db.execute(of_runners.order_by(project.c.name)):
        projects.setdefault(row.token_id, []).append(ProjectRef(id=row.id, name=row.name))
    assigned = select(func.count()).where(run.c.runner_id == runner.c.id, run.c.state.in_(ASSIGNED))
    active = assigned.correlate(runner).scalar_subquery().label("active_runs")
    stmt = with_token_limits(select(runner, is_alive().label("is_alive"), active).where(among(runner.c.id, runner_ids)))
    named = stmt.add_columns(token.c.name.label("token_name"), token.c.expires_at.label("token_expires_at"))
    items = []
    for row in await db.execute(named.order_by(*_RUNNER_ORDER.columns)):
        bound: RunnerToken | None = None
        if row.token_name is not None:
            bound = RunnerToken(
                id=row.token_id,
                name=row.token_name,
                expires_at=row.token_expires_at,
                projects=None if row.only_project_ids is None else projects.get(row.token_id, []),
                labels=row.only_labels,
            )
        values = {name: row._mapping[name] for name in RunnerRead.model_fields if name != "token"}
        items.append(RunnerRead(**values, token=bound))
    return items


async def claim(
    context: AppContext, hub: Hub, actor: Actor, *, runner_id: uuid.UUID, requested: ClaimRequest
) -> ClaimReply:
    """Assign the oldest run that fits the free resources of a runner; wait for one where there is none.

    Raises:
        NotFound: this person has no such runner.
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
    lease_s = await record_seen(db, actor, runner_id)
    await requeue_lost_runs(db)
    # Assigned without the runner's knowledge: the answer to an earlier claim was lost.
    is_assigned = (run.c.runner_id == runner_id) & run.c.state.in_(ASSIGNED)
    unanswered = await lock_run(db, is_assigned & run.c.id.not_in(requested.active_run_ids))
    if unanswered is not None:
        return await _assign(db, unanswered, runner_id, unanswered.attempt, lease_s)
    claiming = await find_runner(db, runner_id)
    if claiming.is_single_person_only and not await has_single_person(db):
        return None
    while (candidate := await lock_run(db, _fits(claiming, requested.free), is_queued=True)) is not None:
        if await _may_still_run(db, candidate):
            return await _assign(db, candidate, runner_id, candidate.attempt + 1, lease_s)
        message = "The person who launched it may not run it on this mission any more."
        await end_run(db, candidate.id, EndReason.cancelled, message)
    return None


def _fits(claiming: KnownRunner, free: Capacity) -> ColumnElement[bool]:
    """Whether a queued run fits the free resources of a runner, and the runner may execute it."""
    abilities = claiming.abilities
    fits = (
        (run.c.state == RunState.queued.value)
        & mission.c.deleted_at.is_(None)
        & project.c.deleted_at.is_(None)
        & (run.c.cores <= free.cores + _ROUNDING)
        & (run.c.memory_bytes <= free.memory_bytes)
        & (run.c.disk_bytes <= free.disk_bytes)
        & (run.c.gpus <= (free.gpus if abilities.gpus else 0))
        & run.c.labels.op("<@", is_comparison=True)(literal(claiming.offered_labels, ARRAY(Text)))
        & run.c.network.in_([network.value for network in abilities.networks])
        & or_(~run.c.needs_images, literal(abilities.images))
        & or_(run.c.needs_images, literal(claiming.runs_scripts))
    )
    if claiming.only_project_ids is not None:
        fits &= mission.c.project_id.in_(claiming.only_project_ids)
    if claiming.only_labels is not None:
        fits &= run.c.labels.op("&&", is_comparison=True)(literal(claiming.only_labels, ARRAY(Text)))
    return fits


async def _may_still_run(db: Connection, candidate: AssignedRun) -> bool:
    """Whether the person who launched a run still has the right that its action requires."""
    starter = await find_person(db, candidate.started_by_id)
    if starter is None:
        return False
    needed = max(Right.create, candidate.definition.right, key=lambda right: right.level)
    levels = visible_missions(starter).with_only_columns(level_on_mission(starter), maintain_column_froms=True)
    level: int | None = (await db.execute(levels.where(mission.c.id == candidate.mission_id))).scalar_one_or_none()
    return level is not None and level >= needed.level


async def _assign(db: Connection, row: AssignedRun, runner_id: uuid.UUID, attempt: int, lease_s: int) -> RunAssignment:
    state = RunState.preparing.value if attempt != row.attempt else row.state
    ends_at = func.now() + datetime.timedelta(seconds=lease_s)
    lease = {"state": state, "runner_id": runner_id, "attempt": attempt, "lease_ends_at": ends_at}
    claimed_at = func.coalesce(run.c.claimed_at, func.now())
    waited_s = func.extract("epoch", func.now() - run.c.created_at)
    stmt = update(run).where(run.c.id == row.id).values(claimed_at=claimed_at, **lease).returning(waited_s)
    seconds = (await db.execute(stmt)).scalar_one()
    if row.attempt == 0:
        metrics.RUN_WAIT_SECONDS.observe(float(seconds))
    await publish(db, [ChangeEvent("run", ChangeKind.changed, row.id, mission_id=row.mission_id)])
    definition = row.definition
    inputs = select(run_input).where(run_input.c.run_id == row.id).order_by(run_input.c.path)
    return RunAssignment(
        run_id=row.id,
        attempt=attempt,
        project_id=row.project_id,
        mission_id=row.mission_id,
        action=ActionRef(id=row.action_id, name=definition.name, version=row.version_number),
        image=definition.image,
        image_digest=row.pinned_digest,
        command=definition.command,
        script=definition.script,
        dependencies=definition.dependencies,
        requires_python=definition.requires_python,
        lock=definition.lock,
        parameters=row.parameters,
        resources=definition.resources,
        cluster=definition.cluster,
        network=definition.network,
        inputs=[
            AssignedInput(path=entry.path, size_bytes=entry.size_bytes, sha256=entry.sha256.hex())
            for entry in await db.execute(inputs)
        ],
        token=None if definition.network is Network.none else await _create_token(db, row),
        lease_s=lease_s,
        traceparent=row.traceparent,
    )


async def _create_token(db: Connection, row: AssignedRun) -> str:
    """Create the token of a run, limited to its mission and to the right that its action declares.

    Earlier tokens of the same attempt stay valid: a claim that its runner has given up may be answered with the run
    again, and the running job must not lose its token.
    """
    definition = row.definition
    secret, token_id = new_secret(SecretKind.run), uuid.uuid4()
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
    await db.execute(
        insert(token).values(id=token_id, is_limited=True, expires_at=func.now() + token_lifetime(definition), **values)
    )
    await db.execute(insert(token_limit).values(id=uuid.uuid4(), token_id=token_id, mission_id=row.mission_id))
    return secret.text
