"""Containers whose first process has ended before the executor inspects them."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import ClassVar

import pytest

from kleinkram.contract.actions import Network, Resources
from kleinkram.contract.runs import EndReason
from kleinkram.runner.executors.base import RunJob, wait_for_end
from kleinkram.runner.executors.docker.executor import DockerExecutor
from tests.http_server import QuietHandler
from tests.integration.runner.scripted_engine import with_engine
from tests.requirements import missing, need

WORDS = b"ERROR (catatonit:2): failed to exec pid1: No such file or directory\n"
BORN = {"StartedAt": "2026", "OOMKilled": False}


class Podman(QuietHandler):
    """An engine whose only container exits after some inspections."""

    pid: ClassVar[int]
    stumbles: ClassVar[int]
    looks: ClassVar[int]
    done: ClassVar[set[str]]

    def do_GET(self) -> None:
        """Say how the container is, or what it wrote."""
        name = self.path.partition("?")[0].rpartition("/")[2]
        if name == "logs":
            self._say(200, bytes([2, 0, 0, 0]) + len(WORDS).to_bytes(4, "big") + WORDS)
        elif name == "_ping":
            self._say(200, b"OK")
        elif name != "json" or "/images/" in self.path:
            about = {"Id": "sha256:1", "RepoDigests": [], "Architecture": "amd64", "Arch": "amd64"}
            self._say(200, json.dumps(about).encode())
        elif "start" not in self.done:
            self._say(404, b"{}")
        elif type(self).stumbles:
            type(self).stumbles -= 1
            self._say(500, json.dumps({"message": f"read /proc/{self.pid}/cgroup: no such process"}).encode())
        else:
            self._say(200, json.dumps({"Id": "one", "State": self._state()}).encode())

    def _state(self) -> dict[str, object]:
        type(self).looks -= 1
        if self.looks < 0:
            return {**BORN, "Status": "exited", "Pid": 0, "ExitCode": 1, "FinishedAt": "2026"}
        return {**BORN, "Status": "running", "Pid": self.pid, "ExitCode": 0, "FinishedAt": "0001-"}

    def do_POST(self) -> None:
        """Handle a request."""
        self.body()
        name = self.path.partition("?")[0].rpartition("/")[2]
        self.done.add(name)
        self._say(200, b"{}")

    def _say(self, status: int, values: bytes) -> None:
        # Who only wants to know whether there is an answer reads none.
        with contextlib.suppress(BrokenPipeError):
            self.send(status, values)


@contextmanager
def first_process(how: str) -> Iterator[int]:
    """Yield the pid of a process that is `ending`, `unreaped` or `gone`."""
    if how == "ending":
        with ending_process() as pid:
            yield pid
        return
    with subprocess.Popen(["true"]) as over:
        os.waitid(os.P_PID, over.pid, os.WEXITED | os.WNOWAIT)
        if how == "gone":
            over.wait()
        yield over.pid


@contextmanager
def ending_process() -> Iterator[int]:
    """Yield the pid of a killed first process of a namespace, which waits until another process of it is reaped."""
    need("unshare", "nsenter")
    namespaces = ["--user", "--pid"]
    with says_made("unshare", *namespaces, "--map-root-user", "--fork") as house:
        pid = int(Path(f"/proc/{house.pid}/task/{house.pid}/children").read_text())
        with says_made("nsenter", "--target", str(pid), *namespaces) as guest:
            guest.send_signal(signal.SIGSTOP)
            # Until it has stopped it would still reap.
            os.waitid(os.P_PID, guest.pid, os.WSTOPPED)
            os.kill(pid, signal.SIGKILL)
            try:
                until = time.monotonic() + 60
                while has_memory(pid):
                    assert time.monotonic() < until
                    time.sleep(0.01)
                yield pid
            finally:
                guest.send_signal(signal.SIGCONT)


@contextmanager
def says_made(*words: str) -> Iterator[subprocess.Popen[bytes]]:
    """Run a shell by these words until it is killed, and yield once it is ready."""
    made = subprocess.Popen([*words, "sh", "-c", "echo made; exec sleep 60"], stdout=subprocess.PIPE)
    assert made.stdout is not None
    with made:
        if made.stdout.readline() != b"made\n":
            missing("this kernel gives no namespaces to this user")
        yield made


def has_memory(pid: int) -> bool:
    """Whether a process still has its memory, which it loses after it is marked as exiting."""
    return bool(Path(f"/proc/{pid}/cmdline").read_bytes())


@pytest.fixture
def executor(tmp_path: Path) -> Iterator[DockerExecutor]:
    """An executor with this engine."""
    Podman.done, Podman.stumbles, Podman.looks = set(), 0, 2
    with with_engine(Podman, tmp_path) as played:
        yield played


def a_run(folder: Path) -> RunJob:
    (folder / "run").mkdir()
    return RunJob("a-run", folder / "run", ["/usr/bin/odd"], "an-image", Resources(), Network.none)


@pytest.mark.parametrize(("how", "stumbles"), [("ending", 0), ("unreaped", 0), ("gone", 0), ("gone", 1)])
def test_a_missing_command_is_reported(executor: DockerExecutor, tmp_path: Path, how: str, stumbles: int) -> None:
    """The control groups of such a process are those of the machine, and Podman may fail on it."""
    job = a_run(tmp_path)
    Podman.stumbles = stumbles
    with first_process(how) as Podman.pid:
        executor.submit(job)
        ending = wait_for_end(executor, job, timeout_s=20)
    assert ending is not None
    assert (ending.reason, "/usr/bin/odd: No such file" in ending.message) == (EndReason.command_not_found, True)
    assert executor.usage(job) is None, "the usage of the whole machine was reported as the job's"
