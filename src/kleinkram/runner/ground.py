"""What all runs of a runner share, and what an executor is told of one."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from kleinkram.client.runners import Runners
from kleinkram.client.service import Service
from kleinkram.client.transfer.store import StoreClient
from kleinkram.contract.actions import Network
from kleinkram.contract.runners import Isolation
from kleinkram.runner.attempts import Attempt
from kleinkram.runner.cache import Cache
from kleinkram.runner.doorways import doors_to
from kleinkram.runner.given import AUTHORITIES, script_command
from kleinkram.runner.work import Executor, Work


@dataclass(frozen=True)
class Ground:
    """What all runs share. `changed` is called when a run is at something else."""

    executor: Executor
    runners: Runners
    store: StoreClient
    cache: Cache
    url: str
    token: str
    service: Service
    default_image: str | None
    changed: Callable[[], None]


def work_of(ground: Ground, attempt: Attempt) -> Work:
    """Return what an executor is told of an attempt: always the same, also after a restart."""
    claim, image = attempt.state.claim, attempt.state.image
    command = claim.command
    if claim.script is not None:
        command = script_command(claim.dependencies, in_image=image is not None)
    with_api = claim.network is Network.api
    environment = {
        "KLEINKRAM_URL": ground.url,
        "KLEINKRAM_TOKEN": claim.token or "",
        "KLEINKRAM_PROJECT_ID": str(claim.project_id),
        "KLEINKRAM_MISSION_ID": str(claim.mission_id),
        "KLEINKRAM_RUN_ID": str(claim.run_id),
    }
    if (attempt.folder / "in" / AUTHORITIES).is_file():
        root = attempt.folder if ground.executor.abilities.isolation is Isolation.none else Path("/")
        environment["SSL_CERT_FILE"] = str(root / "in" / AUTHORITIES)
    return Work(
        key=attempt.key,
        folder=attempt.folder,
        command=command,
        image=image,
        resources=claim.resources,
        network=claim.network,
        environment=environment if claim.token else {},
        doors=doors_to(ground.url, attempt.state.store_url) if with_api else (),
    )
