"""`klein runner …`. The package `runner` is imported only when a command runs."""

import os

from kleinkram.cli.commands import Subcommands, with_option_groups
from kleinkram.cli.render import Output, as_table, moment
from kleinkram.cli.runner_options import (
    BatchOptions,
    ClusterOptions,
    CommonOptions,
    MachineOptions,
    StorageOptions,
    runner_command,
)
from kleinkram.cli.units import size
from kleinkram.client import Client
from kleinkram.contract.runners import RunnerRead

app = Subcommands("Run and list runners: machines that run actions.")


@app.command("start")
@with_option_groups
def start(machine: MachineOptions, storage: StorageOptions, common: CommonOptions) -> None:
    """Run actions on this machine. Ctrl-C ends the runner and its runs; SIGTERM leaves its runs to the next one."""
    _become(runner_command(common, machine, storage))


@app.command("slurm")
@with_option_groups
def slurm(batch: BatchOptions, storage: StorageOptions, common: CommonOptions) -> None:
    """Run actions as jobs of Slurm, from a login node. Its folder must be on a file system that all nodes see."""
    _become(runner_command(common, batch, storage, suffix="-slurm"))


@app.command("kubernetes")
@with_option_groups
def kubernetes(cluster: ClusterOptions, common: CommonOptions) -> None:
    """Run actions as Jobs of a Kubernetes cluster, from inside or outside of it. SIGTERM leaves runs to the next."""
    _become(runner_command(common, cluster, suffix="-kubernetes"))


def _become(command: list[str]) -> None:
    # A runner runs for a long time; its own process needs less memory than this one.
    os.execv(command[0], command)  # noqa: S606  (our own interpreter, no shell)


@app.command("list")
def list_(client: Client) -> Output:
    """List the runners; for admins."""
    headers = ["name", "seen", "runs", "executor", "isolation", "cores", "memory", "gpus", "labels", "lease", "token"]
    return as_table(client.runners.list(), [*headers, "version", "id"], _cells)


def _cells(row: RunnerRead) -> tuple[object, ...]:
    token = None
    if row.token is not None:
        limits = [f"project {project.name}" for project in row.token.projects or []]
        limits += [f"label {label}" for label in row.token.labels or []]
        token = f"{row.token.name} (only {', '.join(limits)})" if limits else row.token.name
    seen = "now" if row.is_alive else moment(row.last_seen_at)
    executor = (row.abilities.executor, row.abilities.isolation.value)
    resources = (f"{row.capacity.cores:g}", size(row.capacity.memory_bytes), row.capacity.gpus)
    more = (", ".join(row.labels) or None, f"{row.lease_s} s", token)
    return row.name, seen, row.active_runs, *executor, *resources, *more, row.version, row.id
