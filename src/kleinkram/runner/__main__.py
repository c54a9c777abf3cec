"""`python -m kleinkram.runner ARGUMENTS`: a runner as a process, without the imports of the CLI.

ARGUMENTS is the JSON of `Arguments`. SIGTERM ends the runner but not its runs, which the next one continues; SIGINT
ends its runs, too, which the next one starts again.
"""

import contextlib
import enum
import logging
import os
import signal
import sys
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict

from kleinkram import traces
from kleinkram.client.errors import ConfigurationBroken, CredentialsExposed, InvalidInput, NotConfigured
from kleinkram.contract.errors import KleinkramError
from kleinkram.contract.names import Label
from kleinkram.contract.runners import Isolation
from kleinkram.environments.cache import EnvironmentCache
from kleinkram.environments.local import local_index
from kleinkram.environments.uv import PackageIndex
from kleinkram.json_logs import JsonLines
from kleinkram.runner.executors.base import CannotStart, Executor
from kleinkram.runner.executors.docker.client import DockerClient, EngineError, EngineUnavailable, find_socket
from kleinkram.runner.executors.docker.executor import DockerExecutor, Pull
from kleinkram.runner.executors.local import Machine, MachineShare
from kleinkram.runner.executors.process import ProcessExecutor
from kleinkram.runner.loop import Runner, RunnerOptions
from kleinkram.runner.state_directory import open_state_directory

DEFAULT_IMAGE = "kleinkram/action-python:latest"
TOKEN_VARIABLE = "KLEINKRAM_RUNNER_TOKEN"  # noqa: S105  the name of the variable

_log = logging.getLogger("kleinkram.runner")


class ExecutorChoice(str, enum.Enum):
    """`auto`: containers where an engine answers that has, or can pull, the default image; else processes."""

    auto = "auto"
    docker = "docker"
    process = "process"


@dataclass(frozen=True)
class ImagePolicy:
    """Which images may be pulled, and when. `allowed`: registries, or namespaces of them; None for all."""

    pull: Pull = Pull.missing
    allowed: Sequence[str] | None = None


class Arguments(BaseModel):
    """The options of a runner. Its token is in `KLEINKRAM_RUNNER_TOKEN` or in a file.

    `package_index` is by default that of `KLEINKRAM_PACKAGE_INDEX`, else PyPI.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    url: str
    data_dir: Path
    name: Label
    token_file: Path | None = None
    labels: list[Label] = []
    cores: float | None = None
    memory_bytes: int | None = None
    disk_bytes: int | None = None
    cache_bytes: int | None = None
    environments_bytes: int | None = None
    package_index: str | None = None
    gpus: int = 0
    executor: ExecutorChoice = ExecutorChoice.auto
    default_image: str = DEFAULT_IMAGE
    pull: Pull = Pull.missing
    registries: list[str] | None = None
    once: bool = False
    metrics_port: int | None = None
    metrics_address: str = "127.0.0.1"
    log_format: Literal["json", "text"] = "text"

    def command(self) -> list[str]:
        """Return the command line of a runner with these options."""
        return [sys.executable, "-m", "kleinkram.runner", self.model_dump_json(exclude_defaults=True)]


def main() -> None:
    """Run until a signal; an error is one sentence on stderr and exit code 1."""
    arguments = Arguments.model_validate_json(sys.argv[1])
    handler = logging.StreamHandler(sys.stderr)
    text = logging.Formatter("%(asctime)s %(levelname)s %(name)s %(message)s")
    handler.setFormatter(JsonLines("runner") if arguments.log_format == "json" else text)
    logging.basicConfig(level=logging.INFO, handlers=[handler], force=True)
    # It would log URLs, which are signed.
    logging.getLogger("urllib3").setLevel(logging.ERROR)
    traces.start("kleinkram-runner")
    try:
        with open_state_directory(arguments.data_dir) as state:
            options = RunnerOptions(
                url=arguments.url,
                token=find_token(arguments.token_file),
                name=arguments.name,
                labels=tuple(arguments.labels),
                default_image=arguments.default_image,
            )
            share = MachineShare(
                arguments.cores,
                arguments.memory_bytes,
                arguments.disk_bytes,
                arguments.gpus,
                arguments.cache_bytes,
                arguments.environments_bytes,
            )
            executor = choose_executor(
                arguments.executor,
                ImagePolicy(arguments.pull, arguments.registries),
                arguments.default_image,
                runner=str(state.runner_id),
                machine=Machine(state.path, share, find_index(arguments.package_index)),
            )
            runner = Runner(options, state, executor)
            with _serve_metrics(runner, arguments):
                code = _run_until_signal(runner, once=arguments.once)
    except KleinkramError as error:
        sys.exit(f"Error: {error}")
    traces.stop()
    # Do not wait for threads that wait for an unavailable server.
    logging.shutdown()
    os._exit(code)


def _serve_metrics(runner: Runner, arguments: Arguments) -> contextlib.AbstractContextManager[object]:
    """Serve the metrics of a runner, if it is to.

    Raises:
        InvalidInput: the library is not installed, or the port cannot be opened.
    """
    if arguments.metrics_port is None:
        return contextlib.nullcontext()
    try:
        from kleinkram.runner.metrics_server import serve_metrics
    except ImportError:
        reason = "metrics need another package: pip install 'open-kleinkram[metrics]'"
        raise InvalidInput(what="The option --metrics-port", reason=reason) from None
    return serve_metrics(runner, arguments.data_dir, arguments.metrics_address, arguments.metrics_port)


def find_token(file: Path | None) -> str:
    """Return the token of the runner, from a file or from the environment.

    Raises:
        NotConfigured: there is none.
        CredentialsExposed: others can read the file.
        ConfigurationBroken: the file cannot be read.
    """
    if file is None:
        # Removed from the environment, so that child processes do not get it.
        token = os.environ.pop(TOKEN_VARIABLE, "")
        if not token:
            raise NotConfigured(reason=f"a runner needs its token, in {TOKEN_VARIABLE} or in a file (--token-file)")
        return token.strip()
    try:
        mode = file.stat().st_mode & 0o777
        if mode & 0o077:
            raise CredentialsExposed(file=str(file), mode=f"{mode:o}")
        return file.read_text(encoding="ascii").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationBroken(file=str(file), reason=str(error)) from error


def find_index(text: str | None) -> PackageIndex | None:
    """Return the package index of this name, else of the environment, else PyPI; None where it is `off`.

    Raises:
        InvalidInput: it is neither the URL of an index nor a folder.
    """
    try:
        return local_index(text)
    except ValueError as error:
        raise InvalidInput(what="The package index", reason=str(error)) from None


def choose_executor(
    choice: ExecutorChoice,
    policy: ImagePolicy,
    default_image: str,
    *,
    runner: str = "local",
    machine: Machine | None = None,
    environments: EnvironmentCache | None = None,
) -> Executor:
    """Return the executor of a runner. The default image may be pulled first, which may take long.

    `environments` are those of scripts; by default the machine's.

    Raises:
        InvalidInput: `choice` is `docker`, and no engine answers.
    """
    socket = None if choice is ExecutorChoice.process else find_socket()
    if choice is ExecutorChoice.docker and socket is None:
        raise InvalidInput(what="The executor docker", reason="no socket of a container engine was found")
    if socket is not None:
        try:
            client = DockerClient(socket)
            containers = DockerExecutor(
                client, machine, runner=runner, pull=policy.pull, allowed=policy.allowed, environments=environments
            )
            if choice is ExecutorChoice.auto:
                containers.prepare_image(default_image)
            return containers
        except (EngineUnavailable, EngineError) as error:
            if choice is ExecutorChoice.docker:
                raise InvalidInput(what="The executor docker", reason=str(error)) from error
            _log.info("no container engine answers (%s): scripts run as processes", error)
        except CannotStart as error:
            _log.warning(
                "%s So scripts run as processes, and images do not run; to change this: --executor docker", error
            )
    elif choice is ExecutorChoice.auto:
        _log.info("no socket of a container engine was found: scripts run as processes")
    executor = ProcessExecutor(machine, environments)
    if executor.abilities.isolation is Isolation.none:
        _log.warning("this kernel allows this user no namespaces: runs can read and change whatever the runner can")
    return executor


def _run_until_signal(runner: Runner, *, once: bool) -> int:
    """Run until a signal or the end; return the exit code."""
    has_ended = threading.Event()
    signals: list[int] = []
    errors: list[Exception] = []

    def run() -> None:
        try:
            runner.run(once=once)
        except (KleinkramError, OSError) as error:
            errors.append(error)
        finally:
            has_ended.set()

    def stop(number: int, _: object) -> None:
        signals.append(number)
        runner.stop()
        has_ended.set()

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, stop)
    threading.Thread(target=run, name="runner", daemon=True).start()
    has_ended.wait()
    runner.close(kill=signal.SIGINT in signals)
    for error in errors:
        sys.stderr.write(f"Error: {error}\n")
    return 1 if errors else 0


if __name__ == "__main__":
    main()
