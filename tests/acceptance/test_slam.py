"""Odometry and evaluation run by themselves on a real server, with the packages of their locks."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.acceptance.conftest import Terminal, _terminal, running_instance, wait_until
from tests.acceptance.test_action_images import add_stock
from tests.integration.runner.conftest import docker
from tests.integration.runner.engines import Dockerd
from tests.requirements import missing

__all__ = ["docker"]

# Both sets of packages are downloaded, 300 MB together.
pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]

PROJECT = ("-p", "slam")
TRAJECTORY = "derived/lidar-odometry.tum"
MAX_ATE_M = 0.05


@pytest.fixture
def lab(docker: Dockerd, tmp_path: Path) -> Iterator[Terminal]:
    """A terminal of an instance that installs packages, and runs actions in containers; `make story` has processes."""
    settings = {"KLEINKRAM_PACKAGE_INDEX": os.environ.get("KLEINKRAM_PACKAGE_INDEX", "pypi")}
    add_stock(docker, tmp_path / "base")
    (tmp_path / "up").mkdir()
    with running_instance(tmp_path / "up", **settings, DOCKER_HOST=f"unix://{docker.socket}") as instance:
        terminal = _terminal(instance, tmp_path / "terminal")
        yield terminal
        (runner,) = terminal.run("runner", "list", "--json").json()["items"]
        assert runner["abilities"]["executor"] == "docker"


def add(lab: Terminal, name: str, *, by_itself: bool) -> None:
    """Add a shipped action; skip the test where its packages cannot be had."""
    ran = lab.run("action", "add", f"kleinkram/{name}", *PROJECT, code=None)
    if ran.code != 0 and "package index" in ran.err:
        missing(f"the packages of {name} cannot be fetched: {ran.err.strip()}")
    assert ran.code == 0, ran
    if by_itself:
        lab.run("project", "actions", "add", name, *PROJECT, "--on", "complete")


def runs_of(lab: Terminal) -> list[Any]:
    listed: list[Any] = lab.run("run", "list", *PROJECT, "--json").json()["items"]
    return listed


def have_ended(lab: Terminal) -> bool:
    """Whether the evaluation has ended, or any run badly."""
    ended = {run["action"]["name"]: run["state"] for run in runs_of(lab) if run["ended_at"] is not None}
    return "slam-evaluate" in ended or bool({"failed", "cancelled"} & {*ended.values()})


def test_a_complete_mission_gets_a_trajectory_and_its_error(lab: Terminal, tmp_path: Path) -> None:
    lab.run("project", "create", "slam")
    add(lab, "slam-evaluate", by_itself=True)
    add(lab, "lidar-odometry", by_itself=True)
    lab.run("sample", tmp_path / "drive", "--duration", "10", "--format", "mcap")
    (tmp_path / "mission.yaml").write_text("reference: /odom\n")
    mission = (*PROJECT, "-m", "drive")
    lab.run("upload", *mission, "--create", "--metadata", tmp_path / "mission.yaml", "--wait", tmp_path / "drive")
    lab.run("mission", "complete", "drive", *PROJECT)

    wait_until(lambda: have_ended(lab), "the evaluation of the trajectory", timeout_s=600)
    runs = runs_of(lab)
    listed = [(run["action"]["name"], run["action"]["version"], run["state"], run["message"]) for run in runs]
    assert listed == [("slam-evaluate", 1, "done", ""), ("lidar-odometry", 1, "done", "")]
    (row,) = lab.run("run", "metrics", *mission, "--name", "ate_rmse", "--json").json()["items"]
    assert row["metric"]["labels"]["estimate"] == TRAJECTORY
    assert row["metric"]["labels"]["reference"] == "/odom"
    assert 0 < row["metric"]["value"] < MAX_ATE_M
    lineage = lab.run("lineage", TRAJECTORY, *mission, "--json").json()
    assert lineage["made_by"]["run"]["action"]["name"] == "lidar-odometry"
    assert [entry["run"]["action"]["name"] for entry in lineage["read_by"]] == ["slam-evaluate"]
