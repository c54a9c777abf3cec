"""`klein runner …`. The package `runner` is imported only when a command runs."""

import os
import platform
from enum import Enum
from pathlib import Path
from typing import Annotated, Any

import platformdirs

from kleinkram.cli.commands import Many, Subcommands, Text, flag, option
from kleinkram.cli.render import Output, as_table, moment
from kleinkram.cli.units import parse_size, size
from kleinkram.client import Client
from kleinkram.contract.runners import RunnerRead

app = Subcommands("Run and list runners: machines that run actions.")
_FOLDER = "kleinkram-runner"


class ExecutorOption(str, Enum):
    """How a runner runs actions."""

    auto = "auto"
    docker = "docker"
    process = "process"


_TokenFile = Annotated[
    Path | None,
    option("--token-file", "F", "Read its token from a file with mode 0600. Default: KLEINKRAM_RUNNER_TOKEN."),
]
_PackageIndex = Annotated[
    Text,
    option(
        "--package-index",
        "URL",
        "Install packages of scripts from this index or folder of wheels; off: none. "
        "Default: KLEINKRAM_PACKAGE_INDEX, else PyPI.",
    ),
]
_Executor = Annotated[
    ExecutorOption, option("--executor", None, "Choose how to run actions; auto: in containers if possible.")
]
_DefaultImage = Annotated[
    Text, option("--default-image", "IMAGE", "Set the image of scripts. Default: kleinkram/action-python.")
]
_Registries = Annotated[
    Many, option("--registry", "R", "Allow images only from this registry; repeatable. Default: from anywhere.")
]

_MetricsPort = Annotated[
    int | None,
    option("--metrics-port", "PORT", "Serve Prometheus metrics on this port. Default: none.", min=1, max=65535),
]
_MetricsAddress = Annotated[
    str, option("--metrics-address", "ADDRESS", "Serve metrics on this address. They have no access control.")
]


def _limit(name: str, what: str, default: str) -> Any:  # Any: what `option` returns
    return option(name, "SIZE", f"Limit {what}. Default: {default}.")


@app.command("start")
def start(
    name: Annotated[Text, option("--name", "NAME", "Name the runner. Default: the name of this machine.")] = None,
    url: Annotated[Text, option("--url", "U", "Set the server. Default: the one in use.")] = None,
    token_file: _TokenFile = None,
    label: Annotated[Many, option("--label", "L", "Add a label that actions can require; repeatable.")] = None,
    cores: Annotated[float | None, option("--cores", "N", "Limit the cores for runs. Default: all.", min=0.1)] = None,
    memory: Annotated[Text, _limit("--memory", "the memory for runs", "80 %")] = None,
    disk: Annotated[Text, _limit("--disk", "the disk for runs", "half of the free space")] = None,
    cache: Annotated[Text, _limit("--cache", "the cache of inputs", "30 % of the free space")] = None,
    environments: Annotated[Text, _limit("--environments", "the packages of scripts", "10 % of the free space")] = None,
    package_index: _PackageIndex = None,
    gpus: Annotated[int, option("--gpus", "N", "Set the number of GPUs for runs.", min=0)] = 0,
    executor: _Executor = ExecutorOption.auto,
    default_image: _DefaultImage = None,
    registry: _Registries = None,
    data_dir: Annotated[Path | None, option("--data-dir", "D", "Set the folder of its runs and inputs.")] = None,
    once: Annotated[bool, flag("--once", "End after one run.")] = False,
    metrics_port: _MetricsPort = None,
    metrics_address: _MetricsAddress = "127.0.0.1",
    as_json: Annotated[bool, flag("--json", "Write its log as lines of JSON.")] = False,
) -> None:
    """Run actions on this machine. Ctrl-C ends the runner and its runs; SIGTERM leaves its runs to the next one."""
    from kleinkram.client.config import find_endpoint
    from kleinkram.runner.arguments import DEFAULT_IMAGE, Arguments, ExecutorChoice

    arguments = Arguments(
        url=url or find_endpoint().url,
        data_dir=(data_dir or Path(platformdirs.user_data_dir(_FOLDER))).expanduser().resolve(),
        name=name or platform.node() or "runner",
        token_file=token_file.resolve() if token_file else None,
        labels=label or [],
        cores=cores,
        memory_bytes=parse_size(memory) if memory else None,
        disk_bytes=parse_size(disk) if disk else None,
        cache_bytes=parse_size(cache) if cache else None,
        environments_bytes=parse_size(environments) if environments else None,
        package_index=package_index,
        gpus=gpus,
        executor=ExecutorChoice(executor.value),
        default_image=default_image or DEFAULT_IMAGE,
        registries=registry or None,
        once=once,
        metrics_port=metrics_port,
        metrics_address=metrics_address,
        log_format="json" if as_json else "text",
    )
    # A runner runs for a long time; its own process needs less memory than this one.
    command = arguments.command()
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
