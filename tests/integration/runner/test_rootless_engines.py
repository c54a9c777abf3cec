"""Docker and Podman of an ordinary user, with a runner of the same user."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from kleinkram.contract.actions import Network, Resources
from kleinkram.runner.executors.base import RunJob, wait_for_end
from kleinkram.runner.executors.docker.executor import DockerExecutor
from tests.integration.runner import engines
from tests.integration.runner.rootless_engines import (
    DOCKERD_ROOTLESS,
    PROGRAMS,
    RootlessDockerd,
    RootlessEngine,
    RootlessPodman,
    call_as,
    rootless,
)
from tests.requirements import missing, need

WRITES = """
import os
open("/out/copy", "w").write(open("/in/drive.txt").read())
open("/tmp/scratch", "w").write("x")
caps = [line.split()[1] for line in open("/proc/self/status") if line.startswith("CapEff")]
print(os.getuid(), caps, os.access("/usr", os.W_OK), os.access("/in", os.W_OK), os.listdir("/sys/class/net"))
"""
FILLS = "with open('/out/big', 'wb') as big:\n    while True: big.write(bytes(1_000_000))"


_ENGINES = [
    pytest.param(RootlessDockerd, marks=pytest.mark.slow, id="docker"),
    # Importing the image takes it long.
    pytest.param(RootlessPodman, marks=pytest.mark.soak, id="podman"),
]


@pytest.fixture(params=_ENGINES)
def engine(request: pytest.FixtureRequest) -> Iterator[RootlessEngine]:
    """An engine of an ordinary user."""
    if os.geteuid() != 0:
        missing("an ordinary user with a range of ids is made by root")
    need(*PROGRAMS)
    if request.param is RootlessDockerd and not DOCKERD_ROOTLESS.exists():
        missing(f"{DOCKERD_ROOTLESS} of docker.io is not installed")
    if Path("/sys/fs/cgroup/cgroup.controllers").exists():
        missing("control groups of version 2 are delegated to users by systemd, which this test does not run")
    with rootless(request.param) as made:
        yield made


def test_a_runner_without_root_runs_actions_in_an_engine_without_root(engine: RootlessEngine) -> None:
    def run_all() -> list[Any]:
        executor = DockerExecutor(engine.engine)
        image = executor.prepare_image(engines.IMAGE).reference
        results: list[Any] = [[sorted(executor.abilities.networks), executor.abilities.bounds_memory]]
        for text, network, changes in (
            (WRITES, Network.none, {}),
            ("import os; print(len(os.listdir('/sys/class/net')))", Network.open, {}),
            (FILLS, Network.none, {"disk_bytes": 20_000_000}),
            ("import time; time.sleep(60)", Network.none, {"time_s": 1}),
        ):
            folder = engine.folder / f"run-{len(results)}"
            (folder / "in").mkdir(parents=True)
            (folder / "in" / "drive.txt").write_text("bytes of a drive")
            resources = Resources.model_validate({"memory_bytes": 200_000_000, "time_s": 30, **changes})
            job = RunJob(folder.name, folder, ["python3", "-c", text], image, resources, network)
            executor.submit(job)
            ending = wait_for_end(executor, job, timeout_s=40)
            owners = {path.name: path.stat().st_uid for path in (folder / "out").iterdir()}
            results.append([ending and ending.reason.value, (folder / "log").read_text(), owners])
            executor.remove(job)
        return results

    abilities, writes, reaches, fills, sleeps = call_as(engine.user, run_all)
    # Nothing but the runner's warning tells that memory is not limited.
    assert abilities == [["none", "open"], False]
    assert writes == ["done", "0 ['0000000000000000'] False False ['lo']\n", {"copy": engine.user}]
    assert (engine.folder / "run-1" / "out" / "copy").read_text() == "bytes of a drive"
    assert reaches[:2] == ["done", "2\n"]
    assert (fills[0], fills[2]) == ("disk", {"big": engine.user})
    assert sleeps[0] == "time"
