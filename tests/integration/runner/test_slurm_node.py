"""What a job of Slurm does on its node, without Slurm: its directory, its endings and its GPUs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from kleinkram.runner.executors import nvidia, process_supervisor
from kleinkram.runner.executors.process_supervisor import JobSupervisor
from kleinkram.runner.executors.slurm import node_job
from kleinkram.runner.executors.slurm.node_job import NodeJobSupervisor, SharedLease
from kleinkram.runner.executors.slurm.shared_files import NodeStart, Submission, read_start, write_start
from kleinkram.runner.executors.slurm.shared_files import write_submission as record_submission
from kleinkram.runner.executors.supervision import ending_file, reserve, write_atomically

JOB: dict[str, Any] = {
    "command": ["true"],
    "environment": {},
    "devices": [],
    "is_isolated": False,
    "has_network": True,
    "uid": None,
    "packages": None,
    "image": None,
    "volumes": 2,
    "gpus": 0,
    "variable_prefix": "",
    "has_own_isolation": False,
    "limits": [10**9, 10**9, 60, 10**6],
    "port_forwards": [],
}


@pytest.fixture
def directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The directory of a job that was submitted."""
    monkeypatch.setenv("SLURM_JOB_NAME", "a-job")
    for name in ("in", "out", "tmp", "tmp/.volume-0", "tmp/.volume-1"):
        (tmp_path / name).mkdir()
    record_submission(tmp_path, Submission("a-job"))
    (tmp_path / process_supervisor.JOB).write_text(json.dumps(JOB))
    reserve(ending_file(tmp_path))
    return tmp_path


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """The directories whose jobs were started."""
    directories: list[Path] = []
    monkeypatch.setattr(NodeJobSupervisor, "run", lambda self: directories.append(self._directory))
    return directories


def test_each_start_has_empty_volumes(directory: Path, started: list[Path]) -> None:
    node_job.run_job(directory)
    (directory / "tmp" / ".volume-0" / "half").write_text("x")
    (directory / "tmp" / ".volume-1").rmdir()
    node_job.run_job(directory)
    assert len(started) == 2
    assert sorted(path.relative_to(directory / "tmp").as_posix() for path in (directory / "tmp").rglob("*")) == [
        ".volume-0",
        ".volume-1",
    ]


def test_a_job_that_has_ended_is_not_started_again(directory: Path, started: list[Path]) -> None:
    node_job.run_job(directory)
    start = read_start(directory)
    assert start is not None
    ending_file(directory, start.token).write_text("{}")
    node_job.run_job(directory)
    assert len(started) == 1


def test_the_ending_of_a_start_that_is_written_late_is_not_that_of_the_next(
    directory: Path, started: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The network of the first node was away; meanwhile Slurm started the job on another one."""
    node_job.run_job(directory)
    first = read_start(directory)
    assert first is not None
    supervisor = NodeJobSupervisor(directory, JOB, first.token, SharedLease(directory))

    def write_late(path: Path, text: str) -> None:
        if path.name.startswith("ending"):
            node_job.run_job(directory)
        write_atomically(path, text)

    monkeypatch.setattr(process_supervisor, "write_atomically", write_late)
    supervisor._write_ending(0)
    second = read_start(directory)
    assert second is not None
    assert (len(started), second.token != first.token) == (2, True)
    assert ending_file(directory, first.token).exists()
    assert not ending_file(directory, second.token).exists()


def test_the_space_for_the_ending_is_that_of_the_last_start(directory: Path, started: list[Path]) -> None:
    for _ in range(2):
        node_job.run_job(directory)
    start = read_start(directory)
    assert start is not None
    (reserved,) = directory.glob("ending*.new")
    assert reserved.name == f"ending-{start.token}.json.new"
    assert reserved.stat().st_size > 0


def test_a_job_that_is_interrupted_each_time_is_not_started_for_ever(directory: Path, started: list[Path]) -> None:
    write_start(directory, NodeStart("a-token", "node1", node_job._MAX_RESTARTS - 1, []))
    node_job.run_job(directory)
    start = read_start(directory)
    assert start is not None
    ending = json.loads(ending_file(directory, start.token).read_text())
    assert (started, ending["reason"]) == ([], "lost")
    assert ending["message"] == "Slurm started its job 100 times, and it was interrupted each time."


@pytest.mark.parametrize(
    ("visible", "of_node", "gpus"),
    [
        ("0,1", "2,3", "2,3"),  # control groups limit the devices: programs count their own
        ("2,3", "2,3", "2,3"),
        ("3", None, "3"),
        ("MIG-5f2e", "4", "MIG-5f2e"),
        ("NoDevFiles", None, ""),
        (None, None, ""),
    ],
)
def test_the_gpus_of_a_job_are_those_of_its_node(visible: str | None, of_node: str | None, gpus: str) -> None:
    variables = {"CUDA_VISIBLE_DEVICES": visible, "SLURM_JOB_GPUS": of_node}
    assert nvidia.assigned_by_slurm({name: value for name, value in variables.items() if value is not None}) == gpus


@pytest.mark.parametrize("visible", ["0,1", "2,3"])
@pytest.mark.parametrize(("is_isolated", "shown"), [(True, "0,1"), (False, None)])
def test_a_sandbox_shows_the_gpus_of_its_job_alone(
    directory: Path, monkeypatch: pytest.MonkeyPatch, visible: str, is_isolated: bool, shown: str | None
) -> None:
    devices = directory / "dev"
    devices.mkdir()
    for name in ("nvidiactl", "nvidia0", "nvidia1", "nvidia2", "nvidia3"):
        (devices / name).touch()
    monkeypatch.setattr(nvidia, "_DEVICES", devices)
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", visible)
    monkeypatch.setenv("SLURM_JOB_GPUS", "2,3")
    job = {**JOB, "gpus": 2, "is_isolated": is_isolated, "environment": {}}
    supervisor = JobSupervisor(directory, 0, job)
    assert [path.name for path in supervisor._devices()] == ["nvidiactl", "nvidia2", "nvidia3"]
    assert job["environment"] == {"CUDA_VISIBLE_DEVICES": shown or visible}
