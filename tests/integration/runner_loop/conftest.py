"""Runners against a fake server: in this process, or as a process to kill."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from kleinkram.environments.uv import parse_index
from kleinkram.runner.arguments import DEFAULT_IMAGE, Arguments, ExecutorChoice, ImageChoice
from kleinkram.runner.executors.local import LocalExecutor, Machine, MachineShare
from kleinkram.runner.executors.process import ProcessExecutor
from kleinkram.runner.executors.slurm.options import SlurmOptions
from kleinkram.runner.loop import Runner, RunnerOptions
from kleinkram.runner.state_directory import StateDirectory
from tests.integration.runner.engines import Dockerd
from tests.integration.runner_loop.fake_http import RUNNER_TOKEN
from tests.integration.runner_loop.fake_runs import FakeRun
from tests.integration.runner_loop.fake_server import FakeServer
from tests.integration.runner_loop.started_runners import StartedRunners
from tests.slurm_cluster import SlurmCluster

_SHARE = MachineShare(cores=2, memory_bytes=10**9, disk_bytes=10**9, cache_bytes=10**9)


def wait_until(condition: Callable[[], object], *, timeout_s: float = 60) -> None:
    """Wait for a condition; fail after the timeout."""
    until = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < until, "the condition did not come true in time"
        time.sleep(0.02)


@dataclass
class Runners(StartedRunners):
    """Runners of this machine or on Slurm. `python` is that of processes."""

    python: str = sys.executable

    def start(
        self,
        executor: LocalExecutor | None = None,
        share: MachineShare = _SHARE,
        index: str = "off",
        token_file: Path | None = None,
    ) -> Runner:
        """Start a runner in this process, which installs packages from an index."""
        self.folder.mkdir(exist_ok=True)
        executor = executor or ProcessExecutor()
        executor._machine = Machine(self.folder, share, parse_index(index))
        options = RunnerOptions(self.server.url, RUNNER_TOKEN, "a-runner", token_file=token_file)
        return self.run_in_thread(Runner(options, StateDirectory(self.folder), executor))

    def spawn(
        self,
        docker: Dockerd | None = None,
        slurm: SlurmCluster | None = None,
        default_image: str | None = None,
        **options: Any,
    ) -> subprocess.Popen[bytes]:
        """Start a runner as a process; with a default image, its processes run in images. `options`: of Slurm."""
        token_file = self.folder.with_name("token")
        token_file.touch(0o600)
        token_file.write_text(RUNNER_TOKEN)
        if self.user is not None:
            os.chown(token_file, self.user, self.user)
        arguments = Arguments(
            url=self.server.url,
            data_dir=self.folder,
            name="a-runner",
            token_file=token_file if slurm else None,
            cores=2,
            memory_bytes=10**9,
            disk_bytes=10**9,
            cache_bytes=10**9,
            executor=ExecutorChoice.docker if docker else ExecutorChoice.process,
            slurm=SlurmOptions(**{"max_jobs": 20, **options}) if slurm else None,
            images=ImageChoice.namespaces if default_image else ImageChoice.off,
            images_bytes=10**9,
            default_image=default_image or DEFAULT_IMAGE,
        )
        environment = {"DOCKER_HOST": f"unix://{docker.socket}"} if docker else {}
        environment |= slurm.environment if slurm else {}
        return self.run_as_process([self.python, *arguments.command()[1:]], environment)


@pytest.fixture
def server() -> Iterator[FakeServer]:
    """A fake server without runs."""
    made = FakeServer()
    yield made
    made.close()


@pytest.fixture
def runners(server: FakeServer, tmp_path: Path) -> Iterator[Runners]:
    """Runners of the fake server."""
    made = Runners(server, tmp_path / "runner")
    yield made
    made.close()


def ended(run: FakeRun, *, timeout_s: float = 60) -> FakeRun:
    """Wait until the end of a run was reported."""
    wait_until(lambda: run.finishes, timeout_s=timeout_s)
    return run
