"""Which runners are eligible for a run, and why none is."""

import datetime
import uuid
from collections.abc import Collection, Sequence
from typing import Any, NamedTuple

from sqlalchemy import Row, Select, case, func, select

from kleinkram.contract.actions import Network
from kleinkram.contract.runners import LEASE_S, Capacity, ExecutorAbilities, Isolation
from kleinkram.server.db import Connection
from kleinkram.server.tables import person, runner, token, token_limit

_ALIVE = datetime.timedelta(seconds=LEASE_S)
# A runner that is switched off for a weekend comes back; one that was away longer does not count.
_EXPECTED_BACK = datetime.timedelta(days=7)
_MOST_NAMED = 3
_REMEDY = "Start a runner that has what the run needs with `klein runner start`, or ask for less in the action."
CONTAINERS_REMEDY = (
    "Install Docker or Podman on the runner's machine and restart the runner (of `klein up`: `klein down`, then "
    "`klein up`), or start a runner on a machine that has it with `klein runner start`."
)


def is_alive() -> Any:
    """Whether a `runner` was seen within the length of a lease."""
    return runner.c.last_seen_at > func.now() - _ALIVE


def with_limits(stmt: Select[Any]) -> Select[Any]:
    """Add the limits of the tokens of runners: `only_project_ids` and `only_labels`, or null."""
    projects = select(token_limit.c.project_id).where(token_limit.c.token_id == token.c.id).correlate(token)
    only = case((token.c.is_limited, func.array(projects.scalar_subquery())))
    stmt = stmt.outerjoin(token, token.c.id == runner.c.token_id)
    return stmt.add_columns(only.label("only_project_ids"), token.c.runner_labels.label("only_labels"))


def alive_stmt() -> Select[Any]:
    """Return the runners that are alive, with the limits of their tokens."""
    return with_limits(select(runner)).where(is_alive())


async def alive_runners(db: Connection) -> Sequence[Row[Any]]:
    """Return the runners that are alive."""
    return (await db.execute(alive_stmt())).all()


async def has_single_person(db: Connection) -> bool:
    """Whether a single person has an account: weakly isolated runs can then harm nobody else."""
    active = select(func.count()).select_from(person).where(person.c.deactivated_at.is_(None))
    return bool((await db.execute(active)).scalar_one() <= 1)


async def known_runners(db: Connection) -> Sequence[Row[Any]]:
    """Return the runners seen in the last week, with `is_alive`: a queued run may still start on them."""
    expected = runner.c.last_seen_at > func.now() - _EXPECTED_BACK
    return (await db.execute(with_limits(select(runner, is_alive().label("is_alive"))).where(expected))).all()


class Needs(NamedTuple):
    """Requirements of a run, named as the columns of `run`. `project_id` is of its mission; None: any."""

    project_id: uuid.UUID | None
    labels: Sequence[str]
    needs_images: bool
    network: str
    cores: float
    memory_bytes: int
    disk_bytes: int
    gpus: int


def runs_scripts(known_runner: Row[Any], abilities: ExecutorAbilities) -> bool:
    """Whether a runner can run scripts: it has the default image, or runs no images at all."""
    return not abilities.images or known_runner.default_image is not None


def is_single_person_only(abilities: ExecutorAbilities) -> bool:
    """Whether the isolation of a runner is too weak for a server with several accounts."""
    return abilities.isolation is not Isolation.container


def refusal(run: Row[Any] | Needs, known_runner: Row[Any], *, single_person: bool) -> str | None:
    """Return why a runner can never execute a run; None where it can, once it has enough free resources."""
    abilities = ExecutorAbilities.model_validate(known_runner.abilities)
    capacity = Capacity.model_validate(known_runner.capacity)
    if is_single_person_only(abilities) and not single_person:
        return "it runs actions without containers, which is allowed only while one person alone has an account"
    if known_runner.only_project_ids is not None and run.project_id not in {None, *known_runner.only_project_ids}:
        return "its token is limited to other projects"
    if known_runner.only_labels is not None and not set(run.labels) & set(known_runner.only_labels):
        return f"its token is limited to actions that ask for the label {' or '.join(sorted(known_runner.only_labels))}"
    if lacking := sorted(set(run.labels) - set(known_runner.labels)):
        return f"it has no label {lacking[0]}"
    if run.needs_images and not abilities.images:
        return "it has no container engine, and the action is an image"
    if not run.needs_images and not runs_scripts(known_runner, abilities):
        return "it has no image that scripts run on"
    if Network(run.network) not in abilities.networks:
        return f"its runs cannot have the network {run.network!r}"
    if run.gpus and not abilities.gpus:
        return "it gives no GPUs to runs"
    for name in ("cores", "memory_bytes", "disk_bytes", "gpus"):
        amount, most = getattr(run, name), getattr(capacity, name)
        if amount > most:
            return f"it has {most:g} {name.removesuffix('_bytes')} and {amount:g} are asked for"
    return None


def reason_never_starts(run: Row[Any] | Needs, known: Collection[Row[Any]], *, single_person: bool) -> str | None:
    """Return why no known runner can ever execute a run, and the remedy.

    None where one can, and where no runner is known yet: then a run waits for the first.
    """
    reasons = [(known_runner, refusal(run, known_runner, single_person=single_person)) for known_runner in known]
    if not reasons or any(reason is None for _, reason in reasons):
        return None
    # Runners with the required labels come first: what those lack can be fixed.
    ordered = sorted(reasons, key=lambda pair: (not set(run.labels) <= set(pair[0].labels), pair[0].name))
    listed = "; ".join(f"{known_runner.name}: {reason}" for known_runner, reason in ordered[:_MOST_NAMED])
    remedy = _REMEDY
    if not single_person and any(
        is_single_person_only(ExecutorAbilities.model_validate(known_runner.abilities)) for known_runner in known
    ):
        remedy = CONTAINERS_REMEDY
    return f"No runner can do it ({listed}). {remedy}"


def reason_waiting(run: Row[Any], known: Collection[Row[Any]], *, single_person: bool) -> str:
    """Return a sentence about why a queued run has not started."""
    if not known:
        return "No runner is there. Start one with `klein runner start`."
    never = reason_never_starts(run, known, single_person=single_person)
    if never is not None:
        return never
    able = [known_runner for known_runner in known if refusal(run, known_runner, single_person=single_person) is None]
    alive = sorted(known_runner.name for known_runner in able if known_runner.is_alive)
    if alive:
        return f"It waits for its turn with {' or '.join(alive[:_MOST_NAMED])}."
    names = " or ".join(sorted(known_runner.name for known_runner in able)[:_MOST_NAMED])
    return f"It waits for {names}, which is not running. Start it again, or another with `klein runner start`."


def runs_problem(queued: Collection[Row[Any]], known: Collection[Row[Any]], *, single_person: bool) -> str | None:
    """Return why queued runs, or any scripts, cannot start, and the remedy; None where they can.

    `queued` says by `number` how many runs need the same.
    """
    stuck = [(row.number, reason_never_starts(row, known, single_person=single_person)) for row in queued]
    reasons = [(number, reason) for number, reason in stuck if reason is not None]
    if reasons:
        count = sum(number for number, _ in reasons)
        runs = "1 queued run can" if count == 1 else f"{count} queued runs can"
        return f"{runs} never start. {reasons[0][1]}"
    if single_person or not known:
        return None
    if all(is_single_person_only(ExecutorAbilities.model_validate(known_runner.abilities)) for known_runner in known):
        plain = Needs(None, [], False, Network.none.value, 0, 0, 0, 0)
        return f"Actions cannot be run. {reason_never_starts(plain, known, single_person=single_person)}"
    return None


def invitation_warning(known: Collection[Row[Any]], *, single_person: bool) -> str | None:
    """Return what stops working once a second person has an account; None where nothing does."""
    weak = sorted(
        known_runner.name
        for known_runner in known
        if is_single_person_only(ExecutorAbilities.model_validate(known_runner.abilities))
    )
    if not single_person or not weak:
        return None
    names = " and ".join(weak[:_MOST_NAMED])
    return (
        f"Once a second person has an account, actions no longer run on {names}: without containers they are safe "
        f"only for one person. {CONTAINERS_REMEDY}"
    )
