"""The options of sbatch for a job: what its run needs, what the runner is set to, and what an action asks for."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from kleinkram.contract.actions import ClusterRequest, Resources
from kleinkram.runner.executors.local import cannot_start

# For the supervisor of a job, which is in its allocation.
SUPERVISOR_BYTES = 128 * 2**20
# For its start, its lease and the grace at its end: the supervisor enforces the limit of the run itself.
_TIME_MARGIN_S = 180
# For the inputs and results of a job, if its node moves them. What takes longer is left to the login node.
_TRANSFERS_S = 1800
# What the executor sets itself, or what would have it lose the job.
RESERVED = frozenset(
    {
        *("job-name", "output", "error", "input", "open-mode", "parsable", "wrap", "wait", "test-only", "chdir"),
        *("export", "export-file", "requeue", "no-requeue", "array", "dependency", "hold", "begin", "ntasks", "nodes"),
        *("cpus-per-task", "mem", "mem-per-cpu", "mem-per-gpu", "time", "time-min", "gres", "gpus", "clusters"),
        *("uid", "gid", "get-user-env", "signal", "kill-on-invalid-dep", "no-kill", "container", "propagate"),
    }
)


_FEATURE = r"[A-Za-z0-9_.-]+"
_TERM = rf"(?:{_FEATURE}|\({_FEATURE}(?:[&|]{_FEATURE})*\))"
_COMBINABLE = re.compile(rf"{_TERM}(?:[&|]{_TERM})*")


@dataclass(frozen=True)
class SlurmOptions:
    """The options of a runner on Slurm.

    `extra` are further options of sbatch for all jobs, by their names without dashes; `allowed` are the names of those
    that actions may set. `python` is the interpreter on the nodes; `max_jobs` bounds those in the queue.
    `max_tasks` bounds the tasks of a job array that run at a time. `transfers_on_nodes`: the nodes move the files of
    their jobs.
    """

    max_jobs: int
    partition: str | None = None
    account: str | None = None
    qos: str | None = None
    constraint: str | None = None
    extra: Mapping[str, str] = field(default_factory=dict)
    allowed: frozenset[str] = frozenset()
    python: str | None = None
    max_tasks: int | None = None
    transfers_on_nodes: bool = False


def sbatch_options(options: SlurmOptions, resources: Resources, request: ClusterRequest) -> list[str]:
    """Return the options of the job of a run.

    Raises:
        CannotStart: the action asks for an option that the runner does not allow.
    """
    if refused := sorted(set(request.options) - options.allowed):
        names = ", ".join(f"--{name}" for name in refused)
        raise cannot_start(
            f"Its action sets the option {names} of sbatch, which its runner does not allow (--allow-option)."
        )
    margin_s = _TIME_MARGIN_S + (_TRANSFERS_S if options.transfers_on_nodes else 0)
    memory = math.ceil((resources.memory_bytes + SUPERVISOR_BYTES) / 2**20)
    result = [
        "--nodes=1",
        "--ntasks=1",
        f"--cpus-per-task={math.ceil(resources.cores)}",
        f"--mem={memory}M",
        f"--time={math.ceil((resources.time_s + margin_s) / 60)}",
        *usual_options(options, request.constraint),
        *_assignments({**options.extra, **request.options}),
    ]
    if resources.gpus:
        result.append(f"--gres=gpu:{resources.gpus}")
    if request.exclusive:
        result.append("--exclusive")
    return result


def array_option(options: SlurmOptions, count: int) -> str:
    """Return the option that makes a job an array of so many tasks."""
    return f"--array=0-{count - 1}" + (f"%{options.max_tasks}" if options.max_tasks else "")


def usual_options(options: SlurmOptions, constraint: str | None = None) -> list[str]:
    """Return where the jobs of a runner run, and who pays for them.

    Raises:
        CannotStart: the constraint of an action cannot be combined with that of the runner.
    """
    values = {
        "partition": options.partition,
        "account": options.account,
        "qos": options.qos,
        "constraint": _both(options.constraint, constraint),
    }
    return _assignments({name: value for name, value in values.items() if value})


def minimal_options(options: SlurmOptions) -> list[str]:
    """Return the options of a small job with everything that the runner itself is set to."""
    small = ["--nodes=1", "--ntasks=1", "--cpus-per-task=1", "--mem=256M", "--time=5"]
    return [*small, *usual_options(options), *_assignments(options.extra)]


def _both(own: str | None, requested: str | None) -> str | None:
    """Return a constraint that holds only where both do.

    Slurm gives `&` no precedence over `|`, and reads no nested parentheses.
    """
    if not own or not requested:
        return own or requested
    if not (_COMBINABLE.fullmatch(own) and _COMBINABLE.fullmatch(requested)):
        raise cannot_start(
            f"Its action's constraint {requested} cannot be combined with {own}, that of its runner. Use names of "
            "features, & and |, and parentheses that are not nested."
        )
    return f"{_group(own)}&{_group(requested)}"


def _group(constraint: str) -> str:
    has_choice = "|" in re.sub(r"\([^)]*\)", "", constraint)
    if has_choice and "(" in constraint:
        raise cannot_start(f"The constraint {constraint} takes nested parentheses to be combined with another one.")
    return f"({constraint})" if has_choice else constraint


def reserved_names(names: Sequence[str]) -> list[str]:
    """Return which of these options of sbatch nobody but the executor may set."""
    return sorted(set(names) & RESERVED)


def _assignments(values: Mapping[str, str]) -> list[str]:
    """Return one argument per option, so that no value is read as another option."""
    return [f"--{name}={value}" if value else f"--{name}" for name, value in values.items()]
