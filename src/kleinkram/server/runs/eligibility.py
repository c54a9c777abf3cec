"""Which runners can execute a run, and why none can."""

import datetime
import uuid
from collections.abc import Collection, Sequence
from typing import Any, NamedTuple

from sqlalchemy import ColumnElement, Select, case, func, select

from kleinkram.contract.actions import Network
from kleinkram.contract.runners import LEASE_S, Capacity, ExecutorAbilities, Isolation
from kleinkram.server.db import Connection
from kleinkram.server.tables import mission, person, run, runner, token, token_limit

_ALIVE = datetime.timedelta(seconds=LEASE_S)
# A runner that is switched off for a weekend comes back; one that was away longer does not count.
_EXPECTED_BACK = datetime.timedelta(days=7)
_MOST_NAMED = 3
_REMEDY = "Start a runner that has what the run needs with `klein runner start`, or ask for less in the action."
CONTAINERS_REMEDY = (
    "Install Docker or Podman on the runner's machine and restart the runner (of `klein up`: `klein down`, then "
    "`klein up`), or start a runner on a machine that has it with `klein runner start`."
)


# Among the labels of a run that requires an environment, and of a runner that can build one.
ENVIRONMENTS_LABEL = "kleinkram:environments"


class Needs(NamedTuple):
    """Requirements of a run, named as the columns of `run`. `project_id` is of its mission; None: any."""

    labels: Sequence[str]
    needs_images: bool
    network: str
    cores: float
    memory_bytes: int
    disk_bytes: int
    gpus: int
    project_id: uuid.UUID | None = None


NEEDS_COLUMNS = (*(run.c[name] for name in Needs._fields[:-1]), mission.c.project_id)
"""The columns of `Needs`, in its order."""


class QueuedRuns(NamedTuple):
    """The number of queued runs with the same requirements."""

    needs: Needs
    run_count: int


class KnownRunner(NamedTuple):
    """A runner, with the limits of its token; None: unlimited."""

    id: uuid.UUID
    name: str
    labels: Sequence[str]
    capacity: Capacity
    abilities: ExecutorAbilities
    default_image: str | None
    is_alive: bool
    only_project_ids: Sequence[uuid.UUID] | None
    only_labels: Sequence[str] | None

    @property
    def runs_scripts(self) -> bool:
        """Whether it can run scripts: it has the default image, or runs no images at all."""
        return not self.abilities.images or self.default_image is not None

    @property
    def offered_labels(self) -> list[str]:
        """Its labels, and those of its abilities."""
        return [*self.labels, *([ENVIRONMENTS_LABEL] if self.abilities.environments else [])]

    @property
    def is_single_person_only(self) -> bool:
        """Whether its isolation is too weak for a server with several accounts."""
        return self.abilities.isolation is not Isolation.container

    def refusal(self, needs: Needs, *, is_single_person: bool) -> str | None:
        """Return why it can never execute a run; None where it can, once it has enough free resources."""
        abilities = self.abilities
        if self.is_single_person_only and not is_single_person:
            return "it runs actions without containers, which is allowed only while one person alone has an account"
        if self.only_project_ids is not None and needs.project_id not in {None, *self.only_project_ids}:
            return "its token is limited to other projects"
        if self.only_labels is not None and not set(needs.labels) & set(self.only_labels):
            return f"its token is limited to actions that ask for the label {' or '.join(sorted(self.only_labels))}"
        if lacking := sorted(set(needs.labels) - {ENVIRONMENTS_LABEL} - set(self.labels)):
            return f"it has no label {lacking[0]}"
        if ENVIRONMENTS_LABEL in needs.labels and not abilities.environments:
            return "it installs no packages, and the script has dependencies"
        if needs.needs_images and not abilities.images:
            return "it has no container engine, and the action is an image"
        if not needs.needs_images and not self.runs_scripts:
            return "it has no image that scripts run on"
        if Network(needs.network) not in abilities.networks:
            return f"its runs cannot have the network {needs.network!r}"
        if needs.gpus and not abilities.gpus:
            return "it gives no GPUs to runs"
        for name in ("cores", "memory_bytes", "disk_bytes", "gpus"):
            amount, most = getattr(needs, name), getattr(self.capacity, name)
            if amount > most:
                return f"it has {most:g} {name.removesuffix('_bytes')} and {amount:g} are asked for"
        return None


class KnownRunners(NamedTuple):
    """The runners seen in the last week: a queued run may still start on them.

    `is_single_person`: a single person has an account, so that weakly isolated runs can harm nobody else.
    """

    runners: Sequence[KnownRunner]
    is_single_person: bool

    def reason_never_starts(self, needs: Needs) -> str | None:
        """Return why no runner can ever execute a run, and the remedy.

        None where one can, and where no runner is known yet: then a run waits for the first.
        """
        reasons = [(one, one.refusal(needs, is_single_person=self.is_single_person)) for one in self.runners]
        if not reasons or any(reason is None for _, reason in reasons):
            return None
        # Runners with the required labels come first: what those lack can be fixed.
        ordered = sorted(reasons, key=lambda pair: (not set(needs.labels) <= set(pair[0].offered_labels), pair[0].name))
        listed = "; ".join(f"{one.name}: {reason}" for one, reason in ordered[:_MOST_NAMED])
        is_too_weak = not self.is_single_person and any(one.is_single_person_only for one in self.runners)
        return f"No runner can do it ({listed}). {CONTAINERS_REMEDY if is_too_weak else _REMEDY}"

    def reason_waiting(self, needs: Needs) -> str:
        """Return a sentence about why a queued run has not started."""
        if not self.runners:
            return "No runner is registered. Start one with `klein runner start`."
        never = self.reason_never_starts(needs)
        if never is not None:
            return never
        able = [one for one in self.runners if one.refusal(needs, is_single_person=self.is_single_person) is None]
        alive = sorted(one.name for one in able if one.is_alive)
        if alive:
            return f"It is queued for {' or '.join(alive[:_MOST_NAMED])}."
        names = " or ".join(sorted(one.name for one in able)[:_MOST_NAMED])
        return f"It waits for {names}, which is not running. Start it again, or another with `klein runner start`."

    def runs_problem(self, queued: Collection[QueuedRuns]) -> str | None:
        """Return why queued runs, or any scripts, cannot start, and the remedy; None where they can."""
        stuck = [(entry.run_count, self.reason_never_starts(entry.needs)) for entry in queued]
        reasons = [(count, reason) for count, reason in stuck if reason is not None]
        if reasons:
            count = sum(count for count, _ in reasons)
            runs = "1 queued run can" if count == 1 else f"{count} queued runs can"
            return f"{runs} never start. {reasons[0][1]}"
        if self.is_single_person or not self.runners or not all(one.is_single_person_only for one in self.runners):
            return None
        return f"Actions cannot be run. {self.reason_never_starts(Needs([], False, Network.none.value, 0, 0, 0, 0))}"

    def invitation_warning(self) -> str | None:
        """Return what stops working once a second person has an account; None where nothing does."""
        weak = sorted(one.name for one in self.runners if one.is_single_person_only)
        if not self.is_single_person or not weak:
            return None
        return (
            f"Once a second person has an account, actions no longer run on {' and '.join(weak[:_MOST_NAMED])}: "
            f"without containers they are safe only for one person. {CONTAINERS_REMEDY}"
        )


def is_alive() -> ColumnElement[bool]:
    """Whether a `runner` was seen within the length of a lease."""
    return runner.c.last_seen_at > func.now() - _ALIVE


def with_token_limits(stmt: Select[Any]) -> Select[Any]:
    """Add the limits of the tokens of runners: `only_project_ids` and `only_labels`, or null."""
    projects = select(token_limit.c.project_id).where(token_limit.c.token_id == token.c.id).correlate(token)
    only = case((token.c.is_limited, func.array(projects.scalar_subquery())))
    stmt = stmt.outerjoin(token, token.c.id == runner.c.token_id)
    return stmt.add_columns(only.label("only_project_ids"), token.c.runner_labels.label("only_labels"))


async def find_runner(db: Connection, runner_id: uuid.UUID) -> KnownRunner:
    """Return one runner."""
    (known_runner,) = await _runners(db, runner.c.id == runner_id)
    return known_runner


async def known_runners(db: Connection) -> KnownRunners:
    """Return the runners that may execute queued runs."""
    runners = await _runners(db, runner.c.last_seen_at > func.now() - _EXPECTED_BACK)
    return KnownRunners(runners, await has_single_person(db))


async def has_single_person(db: Connection) -> bool:
    """Whether a single person has an account."""
    active = select(func.count()).select_from(person).where(person.c.deactivated_at.is_(None))
    return bool((await db.execute(active)).scalar_one() <= 1)


async def _runners(db: Connection, condition: ColumnElement[bool]) -> list[KnownRunner]:
    names = ("id", "name", "labels", "capacity", "abilities", "default_image")
    stmt = select(*(runner.c[name] for name in names), is_alive().label("is_alive")).select_from(runner)
    return [
        KnownRunner(*row)._replace(
            capacity=Capacity.model_validate(row.capacity), abilities=ExecutorAbilities.model_validate(row.abilities)
        )
        for row in await db.execute(with_token_limits(stmt).where(condition))
    ]
