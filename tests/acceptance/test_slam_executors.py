"""An evaluation of SLAM (kiss-icp, evo) has the same numbers in processes, in containers and on Slurm."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.acceptance.conftest import Terminal, _terminal, running_instance, wait_until
from tests.acceptance.test_action_images import add_stock
from tests.acceptance.test_slam import PROJECT, add
from tests.integration.runner.conftest import docker
from tests.integration.runner.engines import Dockerd
from tests.klein import KLEIN
from tests.requirements import need
from tests.slurm_cluster import PROGRAMS, slurm_cluster

__all__ = ["docker"]

# Each executor installs 300 MB of packages once, and runs 40 jobs.
pytestmark = [pytest.mark.soak, pytest.mark.timeout(3600)]

_MISSIONS = 20
_LAUNCH_S = 900.0
_INDEX = {"KLEINKRAM_PACKAGE_INDEX": os.environ.get("KLEINKRAM_PACKAGE_INDEX", "pypi")}


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Terminal]:
    """A terminal of an instance without a runner, whose 20 missions have lidar scans and a reference."""
    (tmp_path / "up").mkdir()
    with running_instance(tmp_path / "up", "--no-runner", **_INDEX) as instance:
        terminal = _terminal(instance, tmp_path / "terminal")
        terminal.run("project", "create", "slam")
        add(terminal, "lidar-odometry", by_itself=False)
        add(terminal, "slam-evaluate", by_itself=False)
        (tmp_path / "mission.yaml").write_text("reference: /odom\n")
        for seed in range(_MISSIONS):
            drive = tmp_path / f"drive-{seed:02}"
            terminal.run("sample", drive, "--duration", "4", "--format", "mcap", "--seed", seed)
            mission = (*PROJECT, "-m", drive.name, "--create", "--metadata", tmp_path / "mission.yaml")
            terminal.run("upload", *mission, "--wait", drive)
        yield terminal


@contextmanager
def runner(lab: Terminal, folder: Path, *command: str, environment: Mapping[str, str]) -> Iterator[None]:
    """Run a runner with the name of its folder; its log is printed where the test fails."""
    folder.mkdir()
    token = folder / "token"
    token.touch(0o600)
    token.write_text(lab.run("token", "create", folder.name, "--kind", "runner").out)
    options = ("--data-dir", folder / "state", "--token-file", token, "--name", folder.name)
    words = [str(KLEIN), "runner", *command, *map(str, options)]
    with (folder / "log").open("wb") as log:
        process = subprocess.Popen(words, env={**lab.environment, **_INDEX, **environment}, stderr=log)
        try:
            yield
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(60)
            print((folder / "log").read_text()[-4000:])  # noqa: T201  the log, where the test fails


def launch(lab: Terminal, action: str, executor: str, **parameters: str) -> None:
    """Run an action on all missions as one launch, and wait for its runs; all must end well on this runner."""
    words = [word for name, value in parameters.items() for word in ("--set", f"{name}={value}")]
    lab.run("action", "run", action, "--query", "project:slam", "--yes", "--force", *words)
    active = ("run", "list", *PROJECT, "--active", "--count")
    wait_until(lambda: lab.run(*active).out.split()[0] == "0", f"{action} by {executor}", timeout_s=_LAUNCH_S)
    listed = lab.run("run", "list", *PROJECT, "--action", action, "--limit", str(_MISSIONS), "--json").json()["items"]
    ends = {(run["mission"]["name"], run["state"], run["message"], run["runner"]) for run in listed}
    assert ends == {(f"drive-{seed:02}", "done", "", executor) for seed in range(_MISSIONS)}


def evaluate(lab: Terminal, executor: str) -> dict[tuple[str, str, str], float]:
    """Run odometry and evaluation on all missions; return the numbers by mission, metric and labels."""
    trajectory = f"derived/{executor}.tum"
    launch(lab, "lidar-odometry", executor, to=trajectory)
    launch(lab, "slam-evaluate", executor, estimate=trajectory)
    metrics = ("run", "metrics", *PROJECT, "--action", "slam-evaluate", "--limit", "5000", "--json")
    numbers = {}
    for row in lab.run(*metrics).json()["items"]:
        labels = dict(row["metric"]["labels"])
        if labels.pop("estimate", None) == trajectory:
            key = (row["mission"]["name"], row["metric"]["name"], str(sorted(labels.items())))
            numbers[key] = row["metric"]["value"]
    return numbers


def trajectories(lab: Terminal, executor: str) -> dict[str, str]:
    """Return the SHA-256 of the trajectory of each mission."""
    files = lab.run("file", "list", f"derived/{executor}.tum", *PROJECT, "--json").json()["items"]
    return {file["mission"]["name"]: file["sha256"] for file in files}


def test_all_executors_give_the_same_numbers(lab: Terminal, docker: Dockerd, tmp_path: Path) -> None:
    need(*PROGRAMS)
    with runner(lab, tmp_path / "process", "start", "--executor", "process", environment={}):
        by_process = evaluate(lab, "process")
    add_stock(docker, tmp_path / "base")
    engine = {"DOCKER_HOST": f"unix://{docker.socket}"}
    with runner(lab, tmp_path / "docker", "start", "--executor", "docker", environment=engine):
        in_containers = evaluate(lab, "docker")
    with slurm_cluster() as cluster:
        slurm = ("slurm", "--partition", "main", "--max-jobs", "8")
        with runner(lab, tmp_path / "slurm", *slurm, environment=cluster.environment):
            on_slurm = evaluate(lab, "slurm")
    errors = {name for _, name, _ in by_process}
    assert {"ate_rmse", "rpe_rmse"} <= errors
    assert len({mission for mission, name, _ in by_process if name == "ate_rmse"}) == _MISSIONS
    assert trajectories(lab, "docker") == trajectories(lab, "process")
    assert trajectories(lab, "slurm") == trajectories(lab, "process")
    assert in_containers == by_process
    assert on_slurm == by_process
