"""Which runner could do a run, and why none does."""

import datetime
from collections.abc import Collection, Sequence
from typing import Any

from sqlalchemy import Row, Select, case, func, select

from kleinkram.contract.actions import Network
from kleinkram.contract.runners import LEASE_S, Abilities, Capacity, Isolation
from kleinkram.server.db import Connection
from kleinkram.server.tables import person, runner, token, token_limit

_ALIVE = datetime.timedelta(seconds=LEASE_S)


def is_alive() -> Any:
    """Say of a `runner` whether it was heard of lately."""
    return runner.c.last_seen_at > func.now() - _ALIVE


def with_limits(stmt: Select[Any]) -> Select[Any]:
    """Add to a select of runners what their tokens limit them to: `only_project_ids` and `only_labels`, or null."""
    projects = select(token_limit.c.project_id).where(token_limit.c.token_id == token.c.id).correlate(token)
    only = case((token.c.is_limited, func.array(projects.scalar_subquery())))
    stmt = stmt.outerjoin(token, token.c.id == runner.c.token_id)
    return stmt.add_columns(only.label("only_project_ids"), token.c.runner_labels.label("only_labels"))


def alive_stmt() -> Select[Any]:
    """Return the runners that were heard of lately, with what their tokens limit them to."""
    return with_limits(select(runner)).where(is_alive())


async def alive_runners(db: Connection) -> Sequence[Row[Any]]:
    """Return the runners that were heard of lately."""
    return (await db.execute(alive_stmt())).all()


async def is_owners_alone(db: Connection) -> bool:
    """Say whether one person alone has an account here: runs that are badly isolated can then harm nobody else."""
    active = select(func.count()).select_from(person).where(person.c.deactivated_at.is_(None))
    return bool((await db.execute(active)).scalar_one() <= 1)


def runs_scripts(each: Row[Any], abilities: Abilities) -> bool:
    """Say whether a runner has what scripts run on: an image for that, where it runs images; its own Python, else."""
    return not abilities.images or each.stock_image is not None


def refusal(run: Row[Any], each: Row[Any], *, owners_alone: bool) -> str | None:
    """Return why a runner could never do a run; None where it could, once enough of it is free."""
    abilities = Abilities.model_validate(each.abilities)
    capacity = Capacity.model_validate(each.capacity)
    if abilities.isolation is not Isolation.container and not owners_alone:
        return f"it runs actions as {abilities.executor}, which is only for a server with nobody but its owner"
    if each.only_project_ids is not None and run.project_id not in each.only_project_ids:
        return "its token is limited to other projects"
    if each.only_labels is not None and not set(run.labels) & set(each.only_labels):
        return f"its token is limited to actions that ask for the label {' or '.join(sorted(each.only_labels))}"
    if lacking := sorted(set(run.labels) - set(each.labels)):
        return f"it has no label {lacking[0]}"
    if run.needs_images and not abilities.images:
        return "it has no engine of containers, and the action is an image"
    if not run.needs_images and not runs_scripts(each, abilities):
        return "it has no image that scripts run on"
    if Network(run.network) not in abilities.networks:
        return f"its runs cannot have the network {run.network!r}"
    if run.gpus and not abilities.gpus:
        return "it gives no GPUs to runs"
    wanted = {"cores": run.cores, "memory_bytes": run.memory_bytes, "disk_bytes": run.disk_bytes, "gpus": run.gpus}
    for name, amount in wanted.items():
        most = getattr(capacity, name)
        if amount > most:
            return f"it has {most:g} {name.removesuffix('_bytes')} and {amount:g} are asked for"
    return None


def why_waiting(run: Row[Any], runners: Collection[Row[Any]], *, owners_alone: bool) -> str:
    """Return, as a sentence, why a run that is queued has not begun."""
    if not runners:
        return "No runner is there. Start one with `klein runner start`."
    reasons = {each.name: refusal(run, each, owners_alone=owners_alone) for each in runners}
    able = [name for name, reason in reasons.items() if reason is None]
    if able:
        return f"It waits for its turn with {' or '.join(sorted(able)[:3])}."
    # Those that are called as it asks for first: what they lack is what can be mended.
    lacking = {each.name for each in runners if set(run.labels) - set(each.labels)}
    ordered = sorted(reasons.items(), key=lambda each: (each[0] in lacking, each[0]))
    told = "; ".join(f"{name}: {reason}" for name, reason in ordered[:3])
    return f"No runner that is there can do it ({told})."
