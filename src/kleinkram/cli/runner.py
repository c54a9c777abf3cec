"""`klein runner …`: be a runner, and see which there are.

`runner` is imported when a command runs, never before: a list must not pay for it.
"""

import os
import platform
from enum import Enum
from pathlib import Path
from typing import Annotated

import platformdirs
import typer

from kleinkram import connect
from kleinkram.cli.commands import Noun
from kleinkram.cli.options import AsJson
from kleinkram.cli.render import moment, show_json_list, table
from kleinkram.cli.units import parse_size, size
from kleinkram.contract.runners import RunnerToken

app = Noun("Runners: machines that run actions.")


_FOLDER = "kleinkram-runner"


class Executor(str, Enum):
    """How it runs actions."""

    auto = "auto"
    docker = "docker"
    process = "process"


@app.command("start")
def start(
    name: Annotated[str | None, typer.Option("--name", metavar="NAME", help="Default: this machine's.")] = None,
    url: Annotated[str | None, typer.Option("--url", metavar="U", help="The server. Default: the usual one.")] = None,
    token_file: Annotated[
        Path | None, typer.Option(metavar="F", help="Holds its token, mode 0600. Default: KLEINKRAM_RUNNER_TOKEN.")
    ] = None,
    label: Annotated[
        list[str] | None, typer.Option("--label", metavar="L", help="What actions may ask for; may be repeated.")
    ] = None,
    cores: Annotated[float | None, typer.Option(metavar="N", min=0.1, help="For runs. Default: all.")] = None,
    memory: Annotated[str | None, typer.Option(metavar="SIZE", help="For runs. Default: 80 %.")] = None,
    disk: Annotated[str | None, typer.Option(metavar="SIZE", help="For runs. Default: half of what is free.")] = None,
    cache: Annotated[str | None, typer.Option(metavar="SIZE", help="For inputs. Default: 30 % of the same.")] = None,
    gpus: Annotated[int, typer.Option(metavar="N", min=0, help="For runs.")] = 0,
    executor: Annotated[Executor, typer.Option(help="auto: containers where an engine answers.")] = Executor.auto,
    default_image: Annotated[
        str | None, typer.Option(metavar="IMAGE", help="What scripts run on. Default: kleinkram/action-python.")
    ] = None,
    registry: Annotated[
        list[str] | None,
        typer.Option("--registry", metavar="R", help="Images come only from here; may be repeated. Default: anywhere."),
    ] = None,
    data_dir: Annotated[Path | None, typer.Option(metavar="D", help="Its folder: runs and inputs.")] = None,
    once: Annotated[bool, typer.Option("--once", help="End after one run.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Write its log as lines of JSON.")] = False,
) -> None:
    """Run actions on this machine. Ctrl-C ends it and its runs; SIGTERM leaves them to the next one."""
    from kleinkram.client.config import find_endpoint
    from kleinkram.runner.__main__ import DEFAULT_IMAGE, Arguments, ExecutorChoice

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
        gpus=gpus,
        executor=ExecutorChoice(executor.value),
        default_image=default_image or DEFAULT_IMAGE,
        registries=registry or None,
        once=once,
        log_format="json" if as_json else "text",
    )
    # It stays for long: as a process of its own kind it needs less memory than this one.
    command = arguments.command()
    os.execv(command[0], command)  # noqa: S606  (our own interpreter, no shell)


@app.command("list")
def list_(as_json: AsJson = False) -> None:
    """List the runners, for admins."""
    with connect() as client:
        rows = [*client.runners.list()]
    if as_json:
        show_json_list(rows)
        return
    table(
        ["name", "seen", "runs", "executor", "cores", "memory", "gpus", "labels", "token", "version", "id"],
        [
            (
                row.name,
                "now" if row.is_alive else moment(row.last_seen_at),
                row.active_runs,
                row.abilities.executor,
                f"{row.capacity.cores:g}",
                size(row.capacity.memory_bytes),
                row.capacity.gpus,
                ", ".join(row.labels) or None,
                _token(row.token),
                row.version,
                row.id,
            )
            for row in rows
        ],
    )


def _token(token: RunnerToken | None) -> str | None:
    """Return the name of a runner's token, and what it is limited to."""
    if token is None:
        return None
    limits = [f"project {each.name}" for each in token.projects or []] + [
        f"label {each}" for each in token.labels or []
    ]
    return f"{token.name} (only {', '.join(limits)})" if limits else token.name
