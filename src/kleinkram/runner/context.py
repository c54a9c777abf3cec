"""What all runs of a runner share, and the job of a run."""

from collections.abc import Callable
from dataclasses import dataclass
from urllib.parse import urlsplit

from kleinkram.client.runners import Runners
from kleinkram.client.server import Service
from kleinkram.client.transfer.store import StoreClient
from kleinkram.contract.actions import Network
from kleinkram.runner.executors.base import Executor, Job, PortForward
from kleinkram.runner.inputs import AUTHORITIES, script_command
from kleinkram.runner.state_directory import Attempt

_PORTS = {"http": 80, "https": 443}


@dataclass(frozen=True)
class RunnerContext:
    """What all runs of a runner share. `on_change` is called when the state of a run changes."""

    executor: Executor
    runners: Runners
    store: StoreClient
    url: str
    token: str
    service: Service
    default_image: str | None
    on_change: Callable[[], None]


def job_of(context: RunnerContext, attempt: Attempt) -> Job:
    """Return the job of an attempt, which is the same after a restart of the runner."""
    assignment, image = attempt.state.assignment, attempt.state.image
    command = assignment.command
    if assignment.script is not None:
        command = script_command(assignment.dependencies, in_image=image is not None)
    environment = {
        "KLEINKRAM_URL": context.url,
        "KLEINKRAM_TOKEN": assignment.token or "",
        "KLEINKRAM_PROJECT_ID": str(assignment.project_id),
        "KLEINKRAM_MISSION_ID": str(assignment.mission_id),
        "KLEINKRAM_RUN_ID": str(assignment.run_id),
    }
    if (attempt.directory / "in" / AUTHORITIES).is_file():
        environment["SSL_CERT_FILE"] = f"/in/{AUTHORITIES}"
    urls = (context.url, attempt.state.store_url) if assignment.network is Network.api else ()
    return Job(
        key=attempt.key,
        directory=attempt.directory,
        command=command,
        image=image,
        resources=assignment.resources,
        network=assignment.network,
        environment=environment if assignment.token else {},
        port_forwards=tuple(dict.fromkeys(_port_forward(url) for url in urls if url)),
    )


def _port_forward(url: str) -> PortForward:
    parts = urlsplit(url)
    host, port = parts.hostname or "", parts.port or _PORTS[parts.scheme]
    return PortForward(host, port, host, port)
