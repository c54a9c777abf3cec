"""`python -m kleinkram.runner OPTIONS`: a runner as a process of its own, without the CLI's imports.

OPTIONS is the JSON of `Arguments`. SIGTERM ends the runner and leaves its runs, which the next one takes up; SIGINT
ends its runs, too, which the next one begins anew.
"""

import datetime
import json
import logging
import os
import signal
import sys
import threading
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict

from kleinkram.contract.errors import KleinkramError
from kleinkram.contract.names import Label
from kleinkram.runner.choosing import ExecutorChoice, ImagePolicy, choose
from kleinkram.runner.docker.images import Pull
from kleinkram.runner.home import open_home
from kleinkram.runner.machine import Share
from kleinkram.runner.runner import Runner, RunnerOptions
from kleinkram.runner.token import find_token

DEFAULT_IMAGE = "kleinkram/action-python:latest"


class Arguments(BaseModel):
    """All that a runner can be told. Its token is in `KLEINKRAM_RUNNER_TOKEN` or in a file."""

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
    gpus: int = 0
    executor: ExecutorChoice = ExecutorChoice.auto
    default_image: str = DEFAULT_IMAGE
    pull: Pull = Pull.missing
    registries: list[str] | None = None
    once: bool = False
    log_format: Literal["json", "text"] = "text"

    def command(self) -> list[str]:
        """Return the command line of such a runner."""
        return [sys.executable, "-m", "kleinkram.runner", self.model_dump_json(exclude_defaults=True)]


class _JsonLines(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        at = datetime.datetime.fromtimestamp(record.created, datetime.timezone.utc).isoformat(timespec="milliseconds")
        line = {"at": at, "level": record.levelname.lower(), "logger": record.name, "message": record.getMessage()}
        if record.exc_info:
            line["exception"] = self.formatException(record.exc_info)
        return json.dumps(line)


def main() -> None:
    """Run until asked to end; what keeps it from running is one sentence on stderr and exit code 1."""
    arguments = Arguments.model_validate_json(sys.argv[1])
    _set_up_logs(arguments.log_format)
    try:
        with open_home(arguments.data_dir) as home:
            options = RunnerOptions(
                url=arguments.url,
                token=find_token(arguments.token_file),
                name=arguments.name,
                labels=tuple(arguments.labels),
                share=Share(
                    arguments.cores,
                    arguments.memory_bytes,
                    arguments.disk_bytes,
                    arguments.gpus,
                    arguments.cache_bytes,
                ),
                default_image=arguments.default_image,
            )
            policy = ImagePolicy(arguments.pull, arguments.registries)
            executor = choose(arguments.executor, str(home.runner_id), policy, arguments.default_image)
            code = _carry_on(Runner(options, home, executor), once=arguments.once)
    except KleinkramError as error:
        sys.exit(f"Error: {error}")
    # Threads that wait for a server that is away are not waited for.
    logging.shutdown()
    os._exit(code)


def _carry_on(runner: Runner, *, once: bool) -> int:
    """Run until a signal or the end; return the exit code."""
    over = threading.Event()
    asked: list[int] = []
    failures: list[Exception] = []

    def run() -> None:
        try:
            runner.run(once=once)
        except (KleinkramError, OSError) as error:
            failures.append(error)
        finally:
            over.set()

    def stop(sign: int, _: object) -> None:
        asked.append(sign)
        runner.stop()
        over.set()

    for sign in (signal.SIGTERM, signal.SIGINT):
        signal.signal(sign, stop)
    threading.Thread(target=run, name="runner", daemon=True).start()
    over.wait()
    runner.leave(kill=signal.SIGINT in asked)
    for failure in failures:
        sys.stderr.write(f"Error: {failure}\n")
    return 1 if failures else 0


def _set_up_logs(log_format: str) -> None:
    handler = logging.StreamHandler(sys.stderr)
    text = logging.Formatter("%(asctime)s %(levelname)s %(name)s %(message)s")
    handler.setFormatter(_JsonLines() if log_format == "json" else text)
    logging.basicConfig(level=logging.INFO, handlers=[handler], force=True)
    # It would name addresses, and they are signed.
    logging.getLogger("urllib3").setLevel(logging.ERROR)


if __name__ == "__main__":
    main()
