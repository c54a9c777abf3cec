"""The pipelines of `examples/workflows` read slices with a robot's token and put results back with their lineage."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.acceptance.conftest import Terminal, _terminal, running_instance
from tests.requirements import need_workflows
from tests.slurm_cluster import SlurmCluster

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

_EXAMPLES = Path(__file__).parents[2] / "examples" / "workflows"
_TABLE = "derived/imu-gaps.csv"
_TIMEOUT_S = 200


@pytest.fixture(scope="module", name="lab")
def _lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Terminal]:
    """A terminal of an instance whose project `alpine` has the missions `day-1` and `day-2`."""
    home = tmp_path_factory.mktemp("workflows")
    with running_instance(home) as instance:
        terminal = _terminal(instance, home / "terminal")
        terminal.run("project", "create", "alpine")
        for seed in (1, 2):
            folder = home / str(seed)
            terminal.run("sample", folder, "--size", "3MB", "--format", "mcap", "--seed", seed)
            (recording,) = (path for path in folder.rglob("*.mcap"))
            body = folder / "drive.mcap"
            shutil.move(recording, body)
            terminal.run("upload", "-p", "alpine", "-m", f"day-{seed}", "--create", "--wait", body)
        yield terminal


@pytest.fixture(name="robot")
def _robot(lab: Terminal, tmp_path: Path, request: pytest.FixtureRequest) -> dict[str, str]:
    """The environment of a pipeline: a robot's token for the project, and no other configuration."""
    name = f"{request.node.name[:40]}-{os.getpid()}"
    token = lab.run(
        "token", "create", name, "--kind", "robot", "-p", "alpine", "--scope", "read", "--scope", "upload"
    ).out
    url = lab.run("whoami", "--json").json()["url"]
    inherited = {key: value for key, value in lab.environment.items() if not key.startswith(("KLEINKRAM_", "XDG_"))}
    python = need_workflows()
    path = f"{python.parent}:{Path(sys.executable).parent}:{os.environ['PATH']}"
    own = {"HOME": str(tmp_path), "PATH": path, "KLEINKRAM_URL": url, "KLEINKRAM_TOKEN": token.strip()}
    return inherited | own


def run(command: list[object], environment: dict[str, str], folder: Path) -> str:
    """Run a program to its end, and return its output."""
    words = [str(word) for word in command]
    done = subprocess.run(
        words, env=environment, cwd=folder, capture_output=True, text=True, timeout=_TIMEOUT_S, check=False
    )
    assert done.returncode == 0, f"{words}\n{done.stdout[-3000:]}\n{done.stderr[-6000:]}"
    return done.stdout


def recorded(lab: Terminal, name: str) -> list[Any]:
    """Return the recorded runs with this name."""
    rows = lab.run("run", "list", "-p", "alpine", "--action", name, "--json").json()["items"]
    assert all(row["is_recorded"] and row["state"] == "done" for row in rows)
    return list(rows)


def check_lineage(lab: Terminal, mission: str) -> None:
    """Check that the table of a mission comes from its recording, by a run with numbers."""
    lineage = lab.run("lineage", _TABLE, "-p", "alpine", "-m", mission, "--json").json()
    assert [entry["path"] for entry in lineage["made_by"]["inputs"]] == ["drive.mcap"]
    metrics = lab.run("metrics", "list", "-p", "alpine", "-m", mission, "--json", code=None)
    assert "longest_gap" in metrics.out, metrics


def test_a_snakemake_pipeline(lab: Terminal, robot: dict[str, str], tmp_path: Path) -> None:
    shutil.copytree(_EXAMPLES, tmp_path / "pipeline")
    command = ["snakemake", "--cores", 2, "--config", "project=alpine", "--directory", tmp_path / "work"]
    run([*command, "--snakefile", tmp_path / "pipeline" / "Snakefile"], robot, tmp_path)
    runs = recorded(lab, "imu-gaps")
    assert {row["mission"]["name"] for row in runs} == {"day-1", "day-2"}
    assert {(tmp_path / "work" / day / "run-id.txt").read_text().strip() for day in ("day-1", "day-2")} == {
        row["id"] for row in runs
    }
    for mission in ("day-1", "day-2"):
        check_lineage(lab, mission)


def test_a_job_array_of_slurm_finds_the_same(
    lab: Terminal, robot: dict[str, str], slurm: SlurmCluster, tmp_path: Path
) -> None:
    """Its results are those that Snakemake had already put back, or new."""
    (tmp_path / "missions.txt").write_text("day-1\nday-2\n")
    for name in ("imu_gaps.py", "imu_gaps.sbatch"):
        shutil.copy(_EXAMPLES / name, tmp_path)
    job_array: list[object] = ["sbatch", "--wait", "--array=1-2%10", "imu_gaps.sbatch", "alpine", "missions.txt"]
    try:
        run(job_array, {**robot, **slurm.environment}, tmp_path)
    finally:
        sys.stderr.write("".join(path.read_text() for path in tmp_path.glob("slurm-*.out")))
    assert len(recorded(lab, "imu-gaps")) == 2
    check_lineage(lab, "day-2")


def test_workers_of_dask_read_what_a_search_finds(lab: Terminal, robot: dict[str, str], tmp_path: Path) -> None:
    query = "project:alpine topic:/imu/data"
    lines = run(["python", _EXAMPLES / "search_with_dask.py", query, "/imu/data"], robot, tmp_path).splitlines()
    rates = [float(line.split()[1]) for line in lines if line.endswith(" Hz")]
    assert len(rates) == 2
    assert all(150 < rate < 250 for rate in rates), lines


@pytest.mark.soak
def test_workers_of_ray_read_what_a_search_finds(lab: Terminal, robot: dict[str, str], tmp_path: Path) -> None:
    query = "project:alpine topic:/imu/data"
    quiet = {"RAY_TMPDIR": "/tmp", "RAY_USAGE_STATS_ENABLED": "0", "RAY_DATA_DISABLE_PROGRESS_BARS": "1"}
    out = run(["python", _EXAMPLES / "search_with_ray.py", query, "/imu/data"], robot | quiet, tmp_path)
    (gravity,) = [float(line.split()[1]) for line in out.splitlines() if line.startswith("z ")]
    assert 9 < gravity < 11, out


def test_a_notebook_on_a_login_node(lab: Terminal, robot: dict[str, str], tmp_path: Path) -> None:
    shutil.copy(_EXAMPLES / "mission.ipynb", tmp_path)
    execute = "import nbclient, nbformat; nbclient.NotebookClient(nbformat.read('mission.ipynb', 4)).execute()"
    run(["python", "-c", execute], robot | {"PROJECT": "alpine"}, tmp_path)
    (row,) = recorded(lab, "look")
    assert row["parameters"] == {"topic": "/odom"}
