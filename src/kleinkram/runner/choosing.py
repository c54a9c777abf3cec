"""Which executor a runner uses."""

import enum
import logging
from collections.abc import Sequence
from dataclasses import dataclass

from kleinkram.client.errors import InvalidInput
from kleinkram.contract.runners import Isolation
from kleinkram.runner.docker.engine import Engine, EngineAway, Refused, find_socket
from kleinkram.runner.docker.executor import DockerExecutor
from kleinkram.runner.docker.images import Pull
from kleinkram.runner.process.executor import ProcessExecutor
from kleinkram.runner.work import CannotStart, Executor

_log = logging.getLogger("kleinkram.runner")


class ExecutorChoice(str, enum.Enum):
    """`auto`: containers where an engine answers that has, or can fetch, the default image; else processes."""

    auto = "auto"
    docker = "docker"
    process = "process"


@dataclass(frozen=True)
class ImagePolicy:
    """Which images may be fetched, and when. `allowed`: registries, or folders of them; None for all."""

    pull: Pull = Pull.missing
    allowed: Sequence[str] | None = None


def choose(choice: ExecutorChoice, runner: str, policy: ImagePolicy, default_image: str) -> Executor:
    """Return the executor of a runner. The image may be fetched first, which may take long.

    Raises:
        InvalidInput: containers are wanted, and no engine answers.
    """
    if choice is not ExecutorChoice.process:
        try:
            containers = _docker(runner, policy)
            if choice is ExecutorChoice.auto:
                containers.prepare(default_image)
            return containers
        except (EngineAway, Refused) as error:
            if choice is ExecutorChoice.docker:
                raise InvalidInput(what="The executor docker", reason=str(error)) from error
            _log.info("no engine of containers here (%s): scripts run as processes", error)
        except CannotStart as error:
            _log.warning(
                "%s So scripts run as processes, and no images: with --executor docker, it is otherwise", error
            )
    made = ProcessExecutor()
    if made.abilities.isolation is Isolation.none:
        _log.warning("this kernel gives no namespaces to this user: runs can read and change whatever it can")
    return made


def _docker(runner: str, policy: ImagePolicy) -> Executor:
    socket = find_socket()
    if socket is None:
        raise EngineAway("there is no socket of one")
    return DockerExecutor(Engine(socket), runner=runner, pull=policy.pull, allowed=policy.allowed)
