"""An engine that does not remove a container: the runner still starts and ends its runs."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar

import pytest

from kleinkram.contract.actions import Network, Resources
from kleinkram.runner.executors.base import CannotStart, RunJob
from kleinkram.runner.executors.docker.container import JOB_LABEL
from kleinkram.runner.executors.docker.executor import DockerExecutor
from tests.http_server import QuietHandler
from tests.integration.runner.scripted_engine import with_engine

STATE = {"Status": "running", "Pid": 1, "ExitCode": 0, "StartedAt": "2026", "FinishedAt": "0001-", "OOMKilled": False}


class Refusing(QuietHandler):
    """An engine with two containers of runs that removes none."""

    removal_requests: ClassVar[list[str]] = []
    answers: ClassVar[dict[str, object]] = {
        "/version": {"Arch": "amd64"},
        "/info": {},
        "/containers/json": [{"Id": name, "Labels": {JOB_LABEL: name}} for name in ("one", "other")],
        "/containers/kleinkram-a-run/json": {"Id": "one", "State": STATE},
        "/images/an-image/json": {"Id": "sha256:1", "RepoDigests": [], "Architecture": "amd64"},
    }

    def do_GET(self) -> None:
        """Say what there is."""
        path = self.path.partition("?")[0]
        self._say(200 if path in self.answers else 404, self.answers.get(path, {"message": "no such thing"}))

    def do_DELETE(self) -> None:
        """Refuse."""
        self.removal_requests.append(self.path.partition("?")[0])
        self._say(500, {"message": "device or resource busy"})

    def _say(self, status: int, values: object) -> None:
        self.send(status, json.dumps(values).encode())


@pytest.fixture
def executor(tmp_path: Path) -> Iterator[DockerExecutor]:
    """An executor with this engine."""
    Refusing.removal_requests.clear()
    with with_engine(Refusing, tmp_path) as played:
        yield played


def a_run(folder: Path) -> RunJob:
    return RunJob("a-run", folder, [], "an-image", Resources(), Network.none)


def test_removing_continues_after_a_container_that_stays(
    executor: DockerExecutor, caplog: pytest.LogCaptureFixture
) -> None:
    executor.remove_others([])
    assert Refusing.removal_requests == ["/containers/one", "/containers/other"]
    assert caplog.text.count("was not removed: device or resource busy") == 2


def test_a_run_is_removed_even_if_its_container_stays(
    executor: DockerExecutor, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    executor.remove(a_run(tmp_path))
    assert "kleinkram-a-run was not removed: device or resource busy" in caplog.text


def test_the_container_of_an_earlier_start_is_not_taken_for_the_run(executor: DockerExecutor, tmp_path: Path) -> None:
    with pytest.raises(CannotStart, match="does not remove the container of an earlier start"):
        executor.submit(a_run(tmp_path))
