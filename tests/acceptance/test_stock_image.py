"""The default image of script actions, built as docs say on a base made here: scripts, shipped action and the demo."""

import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from tests.acceptance.conftest import Terminal
from tests.integration.deploy import images
from tests.integration.runner import engines
from tests.integration.runner.engines import Dockerd
from tests.requirements import missing, need

pytestmark = pytest.mark.soak

ROOT = Path(__file__).parents[2]
_STOCK = "kleinkram/action-python"
# Uses each library that the image provides, to make a picture and a table.
_SCRIPT = """\
# /// script
# dependencies = ["open-kleinkram", "matplotlib", "mcap", "numpy", "pandas", "pyarrow", "rosbags", "scipy"]
#
# [tool.kleinkram]
# image = "kleinkram/action-python"
# inputs = {paths = ["*.mcap"]}
# ///
import matplotlib.pyplot as plot
import numpy, pandas, rosbags.highlevel, scipy.signal
import mcap.reader, pyarrow.parquet
from kleinkram.action import context, out, report

rates = pandas.DataFrame([(topic.name, topic.count) for topic in context().topics], columns=["topic", "count"])
rates.to_parquet(out / "counts.parquet")
assert pyarrow.parquet.read_table(out / "counts.parquet").num_rows == len(rates) > 0
smooth = scipy.signal.savgol_filter(numpy.asarray(rates["count"], dtype=float), 3, 1)
plot.plot(smooth)
plot.savefig(out / "counts.png")
report.metric("topics", len(rates), unit="1")
"""


@pytest.fixture(scope="module")
def docker() -> Iterator[Dockerd]:
    """An engine for this module with the default image, whose build takes minutes."""
    if os.geteuid() != 0:
        missing("a Docker for tests needs root")
    need(*engines.PROGRAMS, "debootstrap")
    with engines.bridge() as (name, gateway), engines.dockerd(name, gateway) as made:
        _build(made)
        yield made


def _build(docker: Dockerd) -> None:
    images.load_base(docker)
    images.build(docker, "action-python", _STOCK)


@pytest.fixture
def beside(docker: Dockerd, terminal: Terminal) -> Terminal:
    """A terminal with that engine."""
    return replace(terminal, environment={**terminal.environment, "DOCKER_HOST": f"unix://{docker.socket}"})


def test_the_default_image_has_the_documented_libraries(beside: Terminal, project: str, tmp_path: Path) -> None:
    beside.run("sample", tmp_path / "drive", "--size", "2MB", "--format", "mcap")
    beside.run("upload", "-p", project, "-m", "drive", "--create", "--wait", tmp_path / "drive")
    (tmp_path / "all.py").write_text(_SCRIPT)
    place = ("-p", project, "-m", "drive")
    ran = beside.run("action", "run-local", tmp_path / "all.py", *place, "--json", "--out", tmp_path / "out")
    assert "in a container" in ran.err
    assert {path.name for path in (tmp_path / "out").iterdir()} >= {"counts.parquet", "counts.png"}
    (metric,) = ran.json()["report"]["metrics"]
    assert (metric["name"], metric["value"] > 5) == ("topics", True)


def test_the_shipped_action_runs_on_the_default_image(
    beside: Terminal, project: str, recordings_dir: Path, tmp_path: Path
) -> None:
    bag = recordings_dir / "ros1" / "robot_localization_test2_imu_odom_bz2.bag"
    place = ("-p", project, "-m", "metadata")
    beside.run("upload", *place, "--create", "--wait", bag)
    example = ROOT / "examples" / "actions" / "extract-metadata"
    reported = beside.run("action", "run-local", *place, "--json", "--out", tmp_path / "out", example)
    assert "Running extract-metadata in a container." in reported.err
    assert reported.json()["report"]["metadata"]["distance_m"] > 80


def test_the_demo_runs_its_script_in_a_container(docker: Dockerd) -> None:
    environment = {**os.environ, "DOCKER_HOST": f"unix://{docker.socket}"}
    command = [sys.executable, str(ROOT / "examples" / "demo.py")]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    assert "Run a script on the mission, as a container" in done.stdout
