"""Which runners can execute a run, and why none can."""

import datetime
import uuid
from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

from sqlalchemy import ColumnElement, Select, case, func, select

from kleinkram.contract.actions import Network
from kleinkram.contract.isolation import Isolation, strongest
from kleinkram.contract.runners import LEASE_S, Capacity, ExecutorAbilities
from kleinkram.server.db import Connection
from kleinkram.server.tables import mission, person, project, run, runner, token, token_limit

_ALIVE = datetime.timedelta(seconds=LEASE_S)
# A runner that is switched off for a weekend comes back; one that was away longer does not count.
_EXPECTED_BACK = datetime.timedelta(days=7)
_MOST_NAMED = 3
_REMEDY = "Start a runner that has what the run needs with `klein runner start`, or ask for less in the action."
_CONTAINERS_REMEDY = (
    "Otherwise, install Docker or Podman on the runner's machine and restart the runner (of `klein up`: `klein down`, "
    "then `klein up`), or start a runner on a machine that has it with `klein runner start`."
)
_ISOLATIONS = {
    Isolation.container: "in containers",
    Isolation.namespaces: "in namespaces, without containers",
    Isolation.none: "without any isolation",
}

# Among the labels of a run that requires an environment, and of a runner that can build one.
ENVIRONMENTS_LABEL = "kleinkram:environments"


class Needs(NamedTuple):
    """Requirements of a run, named as the columns of `run`, and of its mission's project, as it is now.

    `project_id` None: of any project. `project_isolation` is the weakest class that the project allows.
    """

    labels: Sequence[str]
    needs_images: bool
    network: str
    cores: float
    memory_bytes: int
    disk_bytes: int
    gpus: int
    project_id: uuid.UUID | None = None
    project_isolation: Isolation = Isolation.container


_OF_RUN = Needs._fields[:-2]
PROJECT_ISOLATION = project.c.isolation.label("project_isolation")
NEEDS_COLUMNS = (*(run.c[name] for name in _OF_RUN), mission.c.project_id, PROJECT_ISOLATION)
"""The columns of `Needs`, in its order."""


def to_needs(row: Mapping[Any, Any]) -> Needs:
    """Return the needs of a row with `NEEDS_COLUMNS`."""
    needs = Needs(*(row[name] for name in Needs._fields))
    return needs._replace(labels=(*needs.labels,), project_isolation=Isolation(needs.project_isolation))


class IsolationRule(NamedTuple):
    """What isolation runs must have. While a single person has an account, they can harm nobody else.

    `weakest` is the class that the server's settings ask for at least.
    """

    is_single_person: bool
    weakest: Isolation

    def required(self, of_project: Isolation) -> Isolation:
        """Return the weakest isolation that runs in a project may have, by the class that the project allows."""
        return Isolation.none if self.is_single_person else strongest(of_project, self.weakest)

    def projects_of(self, isolation: Isolation) -> list[str]:
        """Return which classes a project may allow so that a runner with this isolation may execute its runs."""
        return [allowed.value for allowed in Isolation if isolation.is_at_least(self.required(allowed))]


class QueuedRuns(NamedTuple):
    """The number of queued runs with the same requirements."""

    needs: Needs
    run_count: int


class Refusal(NamedTuple):
    """Why a runner can never execute a run, and what to do."""

    reason: str
    remedy: str = _REMEDY


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

    def refusal(self, needs: Needs, rule: IsolationRule) -> Refusal | None:
        """Return why it can never execute a run; None where it can, once it has enough free resources."""
        if (lacking := self._lacking(needs)) is not None:
            return Refusal(lacking)
        # Last, so that the remedy is all that the run needs.
        if self.abilities.isolation.is_at_least(rule.required(needs.project_isolation)):
            return None
        return _too_weak(self.abilities.isolation, needs, rule)

    def _lacking(self, needs: Needs) -> str | None:
        """Return what it lacks for a run beside isolation."""
        abilities = self.abilities
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

    `allowed` are the classes of isolation that projects allow, the strongest first.
    """

    runners: Sequence[KnownRunner]
    rule: IsolationRule
    allowed: Sequence[Isolation]

    def reason_never_starts(self, needs: Needs) -> str | None:
        """Return why no runner can ever execute a run, and the remedy.

        None where one can, and where no runner is known yet: then a run waits for the first.
        """
        refusals = [(one, refusal) for one in self.runners if (refusal := one.refusal(needs, self.rule)) is not None]
        if len(refusals) < len(self.runners) or not refusals:
            return None
        # First those that lack only isolation, then those with the required labels: what they lack can be fixed.
        ordered = sorted(
            refusals,
            key=lambda pair: (
                pair[1].remedy == _REMEDY,
                not set(needs.labels) <= set(pair[0].offered_labels),
                [*Isolation].index(pair[0].abilities.isolation),
                pair[0].name,
            ),
        )
        listed = "; ".join(f"{one.name}: {refusal.reason}" for one, refusal in ordered[:_MOST_NAMED])
        return f"No runner can do it ({listed}). {ordered[0][1].remedy}"

    def reason_waiting(self, needs: Needs) -> str:
        """Return a sentence about why a queued run has not started."""
        if not self.runners:
            return "No runner is registered. Start one with `klein runner start`."
        never = self.reason_never_starts(needs)
        if never is not None:
            return never
        able = [one for one in self.runners if one.refusal(needs, self.rule) is None]
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
        usable = {allowed for one in self.runners for allowed in self.rule.projects_of(one.abilities.isolation)}
        if not self.runners or usable & {allowed.value for allowed in self.allowed}:
            return None
        needs = Needs([], False, Network.none.value, 0, 0, 0, 0, project_isolation=self.allowed[-1])
        return f"Actions cannot be run in any project. {self.reason_never_starts(needs)}"

    def invitation_warning(self) -> str | None:
        """Return what stops working once a second person has an account; None where nothing does."""
        if not self.rule.is_single_person:
            return None
        later = self.rule._replace(is_single_person=False)
        strict = [
            one
            for one in self.runners
            if not {allowed.value for allowed in self.allowed} <= {*later.projects_of(one.abilities.isolation)}
        ]
        if not strict:
            return None
        weakest = min((one.abilities.isolation for one in strict), key=[*Isolation].index)
        names = " and ".join(sorted(one.name for one in strict)[:_MOST_NAMED])
        needs = Needs([], False, Network.none.value, 0, 0, 0, 0)
        return (
            f"Once a second person has an account, actions on {names}, which run without containers, start only in "
            f"projects whose owners allow that. {_too_weak(weakest, needs, later).remedy}"
        )


def _too_weak(isolation: Isolation, needs: Needs, rule: IsolationRule) -> Refusal:
    """Return the refusal of a runner whose isolation is too weak, with who can allow it, and how."""
    how = f"it runs actions {_ISOLATIONS[isolation]}, which"
    if not isolation.is_at_least(rule.weakest):
        setting = f"`KLEINKRAM_WEAKEST_ISOLATION={isolation.value}`"
        return Refusal(
            f"{how} this server does not allow",
            f"An admin can let owners of projects allow it with the setting {setting}. {_CONTAINERS_REMEDY}",
        )
    command = f"klein project update {needs.project_id or 'PROJECT'} --isolation {isolation.value}"
    return Refusal(
        f"{how} the project does not allow",
        f"An owner of the project can allow it in its settings, or with `{command}`. {_CONTAINERS_REMEDY}",
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


# Built once, because each list of runs executes them.
_IS_EXPECTED = runner.c.last_seen_at > func.now() - _EXPECTED_BACK
_ACTIVE_PERSON_COUNT = select(func.count()).select_from(person).where(person.c.deactivated_at.is_(None))
_PROJECT_ISOLATIONS = select(project.c.isolation).where(project.c.deleted_at.is_(None)).distinct()
_ACCOUNTS_AND_PROJECTS = select(
    _ACTIVE_PERSON_COUNT.scalar_subquery().label("person_count"),
    func.array(_PROJECT_ISOLATIONS.scalar_subquery()).label("isolations"),
)
_RUNNERS = with_token_limits(
    select(
        *(runner.c[name] for name in ("id", "name", "labels", "capacity", "abilities", "default_image")),
        is_alive().label("is_alive"),
    ).select_from(runner)
)


async def find_runner(db: Connection, runner_id: uuid.UUID) -> KnownRunner:
    """Return one runner."""
    (known_runner,) = await _runners(db, runner.c.id == runner_id)
    return known_runner


async def known_runners(db: Connection, weakest: Isolation) -> KnownRunners:
    """Return the runners that may execute queued runs. `weakest` is the setting `weakest_isolation`."""
    runners = await _runners(db, _IS_EXPECTED)
    row = (await db.execute(_ACCOUNTS_AND_PROJECTS)).one()
    allowed = {*map(Isolation, row.isolations)} or {Isolation.container}
    rule = IsolationRule(row.person_count <= 1, weakest)
    return KnownRunners(runners, rule, [one for one in Isolation if one in allowed])


async def isolation_rule(db: Connection, weakest: Isolation) -> IsolationRule:
    """Return what isolation runs must have now. `weakest` is the setting `weakest_isolation`."""
    return IsolationRule((await db.execute(_ACTIVE_PERSON_COUNT)).scalar_one() <= 1, weakest)


async def _runners(db: Connection, condition: ColumnElement[bool]) -> list[KnownRunner]:
    return [
        KnownRunner(*row)._replace(
            capacity=Capacity.model_validate(row.capacity), abilities=ExecutorAbilities.model_validate(row.abilities)
        )
        for row in await db.execute(_RUNNERS.where(condition))
    ]
