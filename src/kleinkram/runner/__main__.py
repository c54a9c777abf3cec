"""`python -m kleinkram.runner ARGUMENTS`: a runner as a process, without the imports of the CLI.

ARGUMENTS is the JSON of `Arguments`. SIGTERM ends the runner but not its runs, which the next one continues; SIGINT
ends its runs, too, which the next one starts again.
"""

import contextlib
import logging
import os
import signal
import sys
import threading
from collections.abc import Sequence

from kleinkram import traces
from kleinkram.client.errors import InvalidInput
from kleinkram.contract.errors import KleinkramError
from kleinkram.contract.runners import Capacity
from kleinkram.json_logs import JsonLines
from kleinkram.machine import memory_bytes
from kleinkram.runner.arguments import Arguments, find_token
from kleinkram.runner.choose_executor import (
    ImagePolicy,
    choose_executor,
    find_index,
    kubernetes_executor,
    slurm_executor,
)
from kleinkram.runner.executors.base import Executor
from kleinkram.runner.executors.local import Machine, MachineShare
from kleinkram.runner.executors.machine_locks import announce
from kleinkram.runner.loop import Runner, RunnerOptions
from kleinkram.runner.state_directory import StateDirectory, open_state_directory

_log = logging.getLogger("kleinkram.runner")
_CHECK_SIGNALS_EVERY_S = 1.0


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
                token_file=arguments.token_file,
            )
            machine = _machine_of(arguments, state)
            announcement = None
            if arguments.slurm is None and arguments.kubernetes is None:
                announcement, others = announce(str(state.runner_id), machine.capacity)
                _warn_if_shared_out([machine.capacity, *others])
            runner = Runner(options, state, _executor_of(arguments, state, machine, options.token))
            with _serve_metrics(runner, arguments):
                code = _run_until_signal(runner, once=arguments.once)
            if announcement is not None:
                announcement.remove()
    except KleinkramError as error:
        sys.exit(f"Error: {error}")
    traces.stop()
    # Do not wait for threads that wait for an unavailable server.
    logging.shutdown()
    os._exit(code)


def _machine_of(arguments: Arguments, state: StateDirectory) -> Machine:
    share = MachineShare(
        arguments.cores,
        arguments.memory_bytes,
        arguments.disk_bytes,
        arguments.gpu_request,
        arguments.cache_bytes,
        arguments.environments_bytes,
        arguments.cache_age_days,
        arguments.images_bytes,
    )
    return Machine(state.path, share, find_index(arguments.package_index))


def _executor_of(arguments: Arguments, state: StateDirectory, machine: Machine, token: str) -> Executor:
    runner = str(state.runner_id)
    if arguments.kubernetes is not None:
        return kubernetes_executor(arguments.kubernetes, runner=runner, url=arguments.url, token=token)
    policy, default_image, images = (
        ImagePolicy(arguments.pull, arguments.registries),
        arguments.default_image,
        arguments.images,
    )
    if arguments.slurm is not None:
        return slurm_executor(
            arguments.slurm, state.path, policy, default_image, images=images, runner=runner, machine=machine
        )
    return choose_executor(arguments.executor, policy, default_image, images=images, runner=runner, machine=machine)


def _warn_if_shared_out(capacities: Sequence[Capacity]) -> None:
    """Warn where the runners of this machine together offer more than it has."""
    cores, memory = (sum(one.cores for one in capacities), sum(one.memory_bytes for one in capacities))
    has_cores, has_memory = len(os.sched_getaffinity(0)), memory_bytes()
    if len(capacities) > 1 and (cores > has_cores or memory > has_memory):
        _log.warning(
            "the %d runners of this machine together offer %g cores and %.1f GB memory, and it has %d and %.1f GB: "
            "divide them by --cores and --memory",
            len(capacities),
            cores,
            memory / 1e9,
            has_cores,
            has_memory / 1e9,
        )


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
        except Exception as error:
            _log.exception("an unexpected error ends the runner; its runs go on")
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
    # A signal that comes just before a wait, or to another thread, does not interrupt it.
    while not has_ended.wait(_CHECK_SIGNALS_EVERY_S):
        pass
    runner.close(kill=signal.SIGINT in signals)
    for error in errors:
        sys.stderr.write(f"Error: {error}\n")
    return 1 if errors else 0


if __name__ == "__main__":
    main()
