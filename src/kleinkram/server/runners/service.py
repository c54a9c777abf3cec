"""Registration of runners, and the list of them."""

import uuid
from collections.abc import Collection

from sqlalchemy import exists, func, select, update
from sqlalchemy.dialects.postgresql import insert as upsert

from kleinkram.contract.audit import ChangeKind
from kleinkram.contract.base import Page
from kleinkram.contract.errors import Forbidden
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.projects import ProjectRef
from kleinkram.contract.runners import (
    RunnerRead,
    RunnerRegistration,
    RunnerToken,
)
from kleinkram.server.access.actor import Actor, unexpired
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.change_events import ChangeEvent, publish
from kleinkram.server.db import Connection, among
from kleinkram.server.pagination import Order, PageRequest, fetch_page
from kleinkram.server.runners.assigned_runs import OWN_TOKEN
from kleinkram.server.runs.eligibility import (
    is_alive,
    with_token_limits,
)
from kleinkram.server.tables import project, run, runner, token, token_limit
from kleinkram.server.tables.runs import ASSIGNED

_RUNNER_ORDER = Order([runner.c.name, runner.c.id])


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
