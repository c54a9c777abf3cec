"""Runners of a fake server that a test starts one after the other, in this process or as processes to kill."""

from __future__ import annotations

import os
import signal
import subprocess
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from kleinkram.runner.arguments import TOKEN_VARIABLE
from kleinkram.runner.loop import Runner
from tests.integration.runner_loop.fake_http import RUNNER_TOKEN
from tests.integration.runner_loop.fake_server import FakeServer


@dataclass
class StartedRunners:
    """The consecutive runners of one test, with the same state directory `folder`. Processes run as `user`."""

    server: FakeServer
    folder: Path
    user: int | None = None
    _threads: list[tuple[Runner, threading.Thread]] = field(default_factory=list, init=False)
    _processes: list[subprocess.Popen[bytes]] = field(default_factory=list, init=False)

    def run_in_thread(self, runner: Runner) -> Runner:
        """Start a runner in this process."""
        thread = threading.Thread(target=runner.run)
        thread.start()
        self._threads.append((runner, thread))
        return runner

    def run_as_process(self, command: Sequence[str], environment: Mapping[str, str]) -> subprocess.Popen[bytes]:
        """Start a runner as a process, with its token and these variables."""
        variables = {**os.environ, TOKEN_VARIABLE: RUNNER_TOKEN, **environment}
        process = subprocess.Popen(command, env=variables, user=self.user, group=self.user)
        self._processes.append(process)
        return process

    def kill(self, process: subprocess.Popen[bytes], sign: signal.Signals = signal.SIGKILL) -> None:
        """End the process of a runner."""
        process.send_signal(sign)
        process.wait(timeout=30)

    def close(self) -> None:
        """End what is left, runs included."""
        for runner, _ in self._threads:
            runner.stop()
        self.server.is_silent.set()
        self.server.wake()
        for runner, thread in self._threads:
            thread.join(10)
            runner.close(kill=True)
        for process in self._processes:
            if process.poll() is None:
                self.kill(process, signal.SIGINT)
