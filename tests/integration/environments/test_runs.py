"""Runs have the packages that their script names, and neither the network nor a way to change them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from kleinkram.contract.isolation import Isolation
from kleinkram.contract.runs import EndReason, RunState
from kleinkram.environments.uv import parse_index
from kleinkram.runner.executors.docker.executor import DockerExecutor
from kleinkram.runner.executors.local import LocalExecutor, Machine, MachineShare
from kleinkram.runner.executors.process import ProcessExecutor
from tests.integration.environments.test_cache import lock_of
from tests.integration.runner import engines
from tests.integration.runner_loop.conftest import Runners, ended, wait_until
from tests.integration.runner_loop.fake_runs import FakeRun
from tests.integration.runner_loop.fake_server import FakeServer
from tests.package_index import PackageIndex
from tests.requirements import missing

# A .pth file is processed, as in a folder of installed packages.
PTH = {"lamp.py": "ON = True\n", "lamp.pth": "sub\n", "sub/beam.py": "COLOUR = 'red'\n"}
SCRIPT = """\
import os, socket, sys
import robot, arm, beam
print(robot.VERSION, arm.VERSION, beam.COLOUR, arm.__file__)
try:
    open(os.path.join(os.path.dirname(arm.__file__), "new.py"), "w")
except OSError as error:
    print("read-only:", error.strerror)
try:
    socket.create_connection(("127.0.0.1", int(PORT)), 2)
except OSError as error:
    print("no network:", error.strerror)
"""


def script(index: PackageIndex) -> str:
    return SCRIPT.replace("PORT", repr(index.url.rpartition(":")[2].partition("/")[0]))


def launch(server: FakeServer, index: PackageIndex, code: str, *dependencies: str, **values: Any) -> FakeRun:
    return server.launch(code, {}, dependencies=list(dependencies), lock=lock_of(index, *dependencies), **values)


@pytest.fixture(params=["process", pytest.param("docker", marks=pytest.mark.slow)])
def executor(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> LocalExecutor:
    """Each executor. Containers have the image of the tests, with the library's Python packages beside it."""
    if request.param == "process":
        made = ProcessExecutor()
        if made.abilities.isolation is Isolation.none:
            missing("this kernel gives no namespaces to this user")
        return made
    return DockerExecutor(request.getfixturevalue("docker").engine)


def test_a_script_imports_what_it_names(
    server: FakeServer, runners: Runners, index: PackageIndex, executor: LocalExecutor
) -> None:
    index.add("lamp", "1.0", PTH)
    values: dict[str, Any] = {}
    code = script(index)
    if isinstance(executor, DockerExecutor):
        # The image of the tests has Python alone.
        values = {"image": engines.IMAGE, "script": None, "command": ["python3", "-c", _with_pth(code)]}
    lock = lock_of(index, "robot", "lamp")
    runners.start(executor, index=index.url)
    run = server.launch(code, {}, lock=lock, **values)
    assert ended(run).finishes[0].reason is EndReason.done, run.shown_log
    log = run.artifacts[".kleinkram/log"].decode()
    assert "1.0 1.0 red /env/arm.py" in log
    assert "read-only: Read-only file system" in log
    assert "no network: " in log
    assert "Installing 3 packages" in {progress.message for progress in run.progress}

    index.requests.clear()
    again = server.launch(code, {}, lock=lock, **values)
    assert ended(again).finishes[0].reason is EndReason.done
    assert index.requests == []


def _with_pth(code: str) -> str:
    return "import os, site; site.addsitedir(os.environ['KLEINKRAM_PACKAGES'])\n" + code


def test_the_packages_stand_before_those_of_the_runner(
    server: FakeServer, runners: Runners, index: PackageIndex
) -> None:
    index.add("packaging", "99.0", {"packaging_probe.py": ""})
    runners.start(index=index.url)
    code = "import importlib.metadata; print('version', importlib.metadata.version('packaging'))"
    index.add("tool", "1.0", requires=["packaging>=90"])
    run = launch(server, index, code, "tool")
    assert ended(run).finishes[0].reason is EndReason.done
    assert b"version 99.0" in run.artifacts[".kleinkram/log"]


def test_a_run_without_a_sandbox_has_its_packages(
    server: FakeServer, runners: Runners, index: PackageIndex, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("kleinkram.runner.executors.process_sandbox.is_available", lambda: False)
    runners.start(index=index.url)
    run = launch(server, index, "import arm; print(arm.__file__)", "arm", network="open")
    assert ended(run).finishes[0].reason is EndReason.done
    assert str(runners.folder / "environments") in run.artifacts[".kleinkram/log"].decode()


@pytest.mark.parametrize(
    ("place", "spoil", "message"),
    [
        ("index", lambda index: index.add("arm", "2.0", {"arm.py": "other"}), "do not have the hash of the lock"),
        ("index", lambda index: setattr(index, "status", 500), "The package index does not answer"),
        ("off", lambda index: None, "Its runner installs no packages for scripts."),
    ],
)
def test_a_run_that_cannot_have_its_packages_says_why(
    server: FakeServer,
    runners: Runners,
    index: PackageIndex,
    place: str,
    spoil: Callable[[PackageIndex], object],
    message: str,
) -> None:
    lock = lock_of(index, "arm")
    spoil(index)
    runners.start(index=index.url if place == "index" else place)
    run = server.launch("import arm", {}, lock=lock)
    finish = ended(run).finishes[0]
    assert finish.reason is EndReason.not_possible
    assert message in finish.message


def test_a_folder_of_wheels_does(server: FakeServer, runners: Runners, index: PackageIndex) -> None:
    lock = lock_of(index, "robot")
    index.requests.clear()
    runners.start(index=str(index.folder))
    assert ended(server.launch("import robot, arm", {}, lock=lock)).finishes[0].reason is EndReason.done
    assert index.requests == []


def test_a_cancelled_run_ends_its_build(server: FakeServer, runners: Runners, index: PackageIndex) -> None:
    lock = lock_of(index, "arm")
    index.delay_s = 30
    index.requests.clear()
    runners.start(index=index.url)
    run = server.launch("import arm", {}, lock=lock)
    wait_until(index.downloads)
    assert run.states[-1:] in ([RunState.preparing], [])
    run.is_cancelled = True
    server.wake()
    assert ended(run).finishes[0].reason is EndReason.cancelled


def test_packages_of_a_run_stay_for_the_next_runner(server: FakeServer, runners: Runners, index: PackageIndex) -> None:
    lock = lock_of(index, "arm")
    first = runners.start(index=index.url)
    code = "import os, time\nwhile not os.path.exists('/tmp/go'):\n    time.sleep(0.05)\nimport arm; print(arm.VERSION)"
    run = server.launch(code, {}, lock=lock)
    wait_until(lambda: RunState.running in run.states)
    first.stop()
    server.wake()
    first.close(kill=False)

    executor = ProcessExecutor()
    second = runners.start(executor, index=index.url)
    wait_until(lambda: second._active)
    (environment,) = (runners.folder / "environments").glob("*/packages")
    assert executor._machine is not None
    cache = executor._machine.environments
    assert cache is not None
    assert not cache._remove(environment.parent.name), "it is in use"
    (scratch,) = runners.folder.glob("runs/*/tmp")
    (scratch / "go").touch()
    assert ended(run).finishes[0].reason is EndReason.done
    wait_until(lambda: cache._remove(environment.parent.name))


def test_a_runner_without_index_or_uv_builds_no_environments(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    share, index = MachineShare(cores=1), parse_index("https://example.org/simple")
    assert ProcessExecutor(Machine(tmp_path, share, index)).abilities.environments
    assert not ProcessExecutor(Machine(tmp_path, share)).abilities.environments
    monkeypatch.setattr("kleinkram.runner.executors.local.find_uv", lambda: None)
    assert not ProcessExecutor(Machine(tmp_path, share, index)).abilities.environments
