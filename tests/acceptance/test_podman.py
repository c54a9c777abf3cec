"""Podman instead of Docker: the demo with its server and runner, and an action that is built and tested."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from tests.acceptance.conftest import Terminal
from tests.acceptance.test_action_images import EXAMPLE, add_stock
from tests.integration.runner.conftest import podman  # noqa: F401  a fixture
from tests.integration.runner.podman_engines import Podman

pytestmark = pytest.mark.soak
DEMO = Path(__file__).parents[2] / "examples" / "demo.py"


@pytest.fixture
def socket(podman: Podman, tmp_path: Path) -> str:  # noqa: F811  the fixture
    """The `DOCKER_HOST` of a Podman that has the default image."""
    add_stock(podman, tmp_path / "base")
    return f"unix://{podman.socket}"


def test_the_demo_runs_its_script_in_a_container(socket: str) -> None:
    environment = {**os.environ, "DOCKER_HOST": socket}
    command = [sys.executable, str(DEMO)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=900)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    assert "Run a script on the mission, as a container" in done.stdout


def test_the_shipped_action_is_built_and_runs(
    socket: str, terminal: Terminal, project: str, recordings_dir: Path, tmp_path: Path
) -> None:
    beside = replace(terminal, environment={**terminal.environment, "DOCKER_HOST": socket})
    bag = recordings_dir / "ros1" / "robot_localization_test2_imu_odom_bz2.bag"
    place = ("-p", project, "-m", "drive")
    beside.run("upload", *place, "--create", "--wait", bag)
    ran = beside.run("action", "run-local", *place, "--json", "--out", tmp_path / "out", EXAMPLE)
    assert "Running extract-metadata in a container." in ran.err
    assert ran.json()["report"]["metadata"]["distance_m"] > 80
    assert (tmp_path / "out" / "track.csv").is_file()
