"""Instances of `klein up` with real PostgreSQL and S3 and a fake server."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from kleinkram.standalone.__main__ import arguments
from kleinkram.standalone.address import Listening
from kleinkram.standalone.processes import marked_processes
from kleinkram.standalone.services import UpOptions
from tests.ports import choose_port

FAKE_SERVER = (sys.executable, str(Path(__file__).with_name("fake_server.py")))


def wait_until(condition: Callable[[], object], *, timeout_s: float = 60) -> None:
    """Wait for a condition; fail the test after a timeout."""
    deadline = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline, "the condition did not come true in time"
        time.sleep(0.02)


@dataclass
class Instance:
    """One data directory and the supervisors that a test starts on it."""

    data_dir: Path
    listening: Listening
    _processes: list["subprocess.Popen[str]"] = field(default_factory=list)

    def spawn(self, *, stdout: int = subprocess.PIPE, **changes: Any) -> "subprocess.Popen[str]":
        """Start a supervisor; does not wait for it."""
        options = {"listening": self.listening, "server": FAKE_SERVER, "with_runner": False, **changes}
        process = subprocess.Popen(
            arguments(UpOptions(data_dir=self.data_dir, **options)),
            stdout=stdout,
            stderr=subprocess.PIPE,
            text=True,
            cwd="/",
        )
        self._processes.append(process)
        return process

    def up(self, **changes: Any) -> "subprocess.Popen[str]":
        """Start a supervisor and wait for its line."""
        process = self.spawn(**changes)
        assert process.stdout is not None
        line = process.stdout.readline()
        if "answers at" not in line:
            pytest.fail(f"klein up failed: {line}{process.communicate()[1]}")
        return process

    def refused(self, **changes: Any) -> str:
        """Start a supervisor that must refuse; returns its sentence."""
        process = self.spawn(**changes)
        out, err = process.communicate(timeout=60)
        assert process.returncode == 1
        assert out == ""
        assert "Traceback" not in err
        return err

    @property
    def runtime_info(self) -> dict[str, Any]:
        """The content of instance.json."""
        content: dict[str, Any] = json.loads((self.data_dir / "instance.json").read_text())
        return content

    @property
    def processes(self) -> list[int]:
        """All living processes of this data directory."""
        return marked_processes(self.data_dir)

    def clean(self) -> None:
        """End what a failed test has left."""
        for process in self._processes:
            if process.poll() is None:
                process.terminate()
            process.communicate(timeout=60)
        for pid in self.processes:
            os.kill(pid, 9)


@pytest.fixture(scope="session")
def _made_once(tmp_path_factory: pytest.TempPathFactory) -> Instance:
    return _make_instance(tmp_path_factory.mktemp("instance"))


@pytest.fixture
def shared_instance(_made_once: Instance) -> Iterator[Instance]:
    """An instance whose database is made once per session; nothing of it runs when a test begins."""
    yield _made_once
    _made_once.clean()


@pytest.fixture
def instance(tmp_path: Path) -> Iterator[Instance]:
    """A fresh instance."""
    instance = _make_instance(tmp_path / "data")
    yield instance
    instance.clean()


def _make_instance(data_dir: Path) -> Instance:
    return Instance(data_dir, Listening(port=choose_port(), s3_port=choose_port()))
