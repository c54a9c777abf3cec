"""GPUs of containers: what engines are requested to give, and what they give."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

import pytest

from kleinkram.client.errors import InvalidInput
from kleinkram.contract.actions import Network, Resources
from kleinkram.contract.runs import EndReason, RunPlacement
from kleinkram.runner.executors import gpus
from kleinkram.runner.executors.base import CannotStart, RunJob
from kleinkram.runner.executors.docker.client import EngineInfo
from kleinkram.runner.executors.docker.container import describe, describe_tool
from kleinkram.runner.executors.docker.device_requests import gpu_obstacle, with_gpus
from kleinkram.runner.executors.docker.executor import DockerExecutor
from kleinkram.runner.executors.gpu_pool import acquire_gpus
from kleinkram.runner.executors.gpus import Gpu, GpuRequest
from kleinkram.runner.executors.local import Machine, MachineShare
from tests.http_server import QuietHandler
from tests.integration.runner.conftest import Bench, lent, log_of
from tests.integration.runner.engines import Dockerd
from tests.integration.runner.fake_gpus import FakeGpus, described
from tests.integration.runner.podman_engines import Podman
from tests.integration.runner.scripted_engine import with_engine

DOCKER = EngineInfo("amd64", is_podman=False, ends_with_containers=True)
PODMAN = EngineInfo("amd64", is_podman=True, ends_with_containers=False, has_cdi=True)


@pytest.fixture
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> FakeGpus:
    """A machine with four GPUs, and a fifth that is divided into two MIG devices."""
    made = FakeGpus(tmp_path / "machine", count=4, slices=2, specification=described(4, 2))
    made.install(monkeypatch)
    return made


@pytest.fixture
def job_folder(tmp_path: Path) -> Path:
    """The directory of the directories of the jobs of a runner."""
    folder = tmp_path / "runner" / "runs"
    folder.mkdir(parents=True)
    return folder


SLICE = Gpu("MIG-1", "MIG 3g.20gb", "4:1", ("nvidia.com/gpu=4:1",))
BARE = Gpu("GPU-0", "RTX", "0")
FOREIGN = Gpu("amd.com/gpu=0", cdi_names=("amd.com/gpu=0",))


@pytest.mark.parametrize(
    ("gpu", "engine", "advice"),
    [
        (BARE, DOCKER._replace(has_nvidia=True), None),
        (SLICE, DOCKER._replace(has_cdi=True), None),
        (SLICE, PODMAN, None),
        (FOREIGN, DOCKER._replace(has_cdi=True, has_nvidia=True), None),
        (BARE, DOCKER, "install nvidia-container-toolkit, run `nvidia-ctk runtime configure"),
        (SLICE, DOCKER, '"cdi": true'),
        (BARE, DOCKER._replace(has_cdi=True), "write one by `nvidia-ctk cdi generate"),
        (BARE, PODMAN, "write one by `nvidia-ctk cdi generate"),
        (FOREIGN, DOCKER._replace(has_nvidia=True), "Docker here has no CDI"),
    ],
)
def test_an_engine_that_cannot_give_gpus_is_reported_with_what_to_do(
    gpu: Gpu, engine: EngineInfo, advice: str | None
) -> None:
    obstacle = gpu_obstacle(gpu, engine)
    assert obstacle is None if advice is None else advice in str(obstacle)


def test_gpus_are_requested_by_id(tmp_path: Path) -> None:
    job = RunJob("run-1", tmp_path, ["ls"], "sha256:1", Resources(gpus=2), Network.none)
    plain = describe(job, user="1:1", volumes=(), labels={})
    docker = with_gpus(plain, [BARE, SLICE, FOREIGN], DOCKER._replace(has_nvidia=True, has_cdi=True))
    assert docker["HostConfig"]["DeviceRequests"] == [
        {"Driver": "nvidia", "DeviceIDs": ["GPU-0", "MIG-1"], "Capabilities": [["gpu"]]},
        {"Driver": "cdi", "DeviceIDs": ["amd.com/gpu=0"]},
    ]
    assert docker["Labels"] == {"kleinkram.gpus": "GPU-0,MIG-1,amd.com/gpu=0"}
    assert "NVIDIA_VISIBLE_DEVICES=GPU-0,MIG-1" in docker["Env"]
    by_cdi = with_gpus(plain, [SLICE], DOCKER._replace(has_cdi=True))["HostConfig"]
    assert by_cdi["DeviceRequests"] == [{"Driver": "cdi", "DeviceIDs": ["nvidia.com/gpu=4:1"]}]


def test_an_image_that_asks_for_all_gpus_gets_none(tmp_path: Path) -> None:
    """Images of CUDA set this variable to `all`, which NVIDIA's runtime obeys where it is Docker's default."""
    job = RunJob("run-1", tmp_path, ["ls"], "sha256:1", Resources(), Network.none)
    container = describe(job, user="1:1", volumes=(), labels={})
    tool = describe_tool("sha256:1", ["python3"], user="1:1", labels={}, folder=None)
    for plain in (container, tool):
        limited = with_gpus(plain, [], DOCKER._replace(has_nvidia=True))
        assert "NVIDIA_VISIBLE_DEVICES=void" in limited["Env"]
        assert limited["HostConfig"]["DeviceRequests"] == []


class Recording(QuietHandler):
    """A Docker with NVIDIA's runtime that starts everything, and has a container of another runner with GPU-0."""

    created: ClassVar[list[dict[str, Any]]] = []
    running: ClassVar[list[dict[str, Any]]] = []

    def do_GET(self) -> None:
        """Answer what is there."""
        answers: dict[str, object] = {
            "/version": {"Arch": "amd64"},
            "/info": {"Runtimes": {"nvidia": {}}},
            "/images/an-image/json": {"Id": "sha256:1", "RepoDigests": [], "Architecture": "amd64"},
            "/containers/json": self.running,
        }
        path = self.path.partition("?")[0]
        self._answer(200 if path in answers else 404, answers.get(path, {"message": "no such thing"}))

    def do_POST(self) -> None:
        """Note what is created."""
        body = self.body()
        if self.path.startswith("/containers/create"):
            self.created.append(json.loads(body))
        self._answer(200, {"Id": "1"})

    def do_DELETE(self) -> None:
        """Remove."""
        self._answer(204, None)

    def _answer(self, status: int, content: object) -> None:
        self.send(status, b"" if content is None else json.dumps(content).encode())


@pytest.mark.usefixtures("machine")
def test_containers_get_the_gpus_that_no_other_has(job_folder: Path, tmp_path: Path) -> None:
    Recording.created.clear()
    Recording.running[:] = [{"Id": "1", "Labels": {"kleinkram.run": "other", "kleinkram.gpus": "GPU-0,GPU-1"}}]
    machine = Machine(tmp_path / "runner", MachineShare(gpus=GpuRequest(4)))
    with with_engine(Recording, tmp_path) as executor:
        executor._machine = machine
        executor.check_gpus()
        folders = [job_folder / f"run-{n}" for n in range(3)]
        jobs = [RunJob(one.name, one, [], "an-image", Resources(gpus=1), Network.none) for one in folders]
        for folder in folders:
            folder.mkdir()
        for job in jobs[:2]:
            executor.submit(job)
        with pytest.raises(CannotStart, match="0 of its runner's 4 are free"):
            executor.submit(jobs[2])
        assert [executor.placement(job) for job in jobs[:2]] == [RunPlacement(gpus=[f"GPU-{n}"]) for n in (2, 3)]
        requested = [one["HostConfig"]["DeviceRequests"][0]["DeviceIDs"] for one in Recording.created]
        assert requested == [["GPU-2"], ["GPU-3"]]
        executor.remove(jobs[0])
        executor.submit(jobs[2])
        assert executor.placement(jobs[2]) == RunPlacement(gpus=["GPU-2"])
        for job in jobs:
            executor.remove(job)
    assert machine.gpus is not None
    machine.gpus.close()


def test_a_local_run_takes_the_gpus_that_it_needs(
    tmp_path: Path, machine: FakeGpus, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gpus, "_with_cdi", lambda gpu, _: gpu)
    Recording.created.clear()
    Recording.running.clear()
    directory = tmp_path / "local"
    (directory / "in").mkdir(parents=True)
    with with_engine(Recording, tmp_path) as executor:
        job = RunJob("local-1", directory, ["ls"], "an-image", Resources(gpus=5), Network.none)
        executor.submit(job)
        assert executor.placement(job) == RunPlacement(gpus=machine.uuids[:5])
        with pytest.raises(InvalidInput, match="2 GPUs are requested, and 1 are free"):
            acquire_gpus(GpuRequest(2), tmp_path / "another")
        executor.remove(job)
        assert executor._own_gpus is not None
        executor._own_gpus.close()


@pytest.mark.slow
@pytest.mark.usefixtures("machine", "job_folder")
def test_a_docker_without_nvidias_runtime_is_refused_at_the_start(docker: Dockerd, tmp_path: Path) -> None:
    machine = Machine(tmp_path / "runner", MachineShare(gpus=GpuRequest(1)))
    with pytest.raises(InvalidInput, match=r"no NVIDIA runtime and no CDI.*nvidia-container-toolkit"):
        DockerExecutor(docker.engine, machine).check_gpus()
    assert machine.gpus is not None
    machine.gpus.close()


@pytest.fixture
def podman_bench(request: pytest.FixtureRequest, job_folder: Path) -> Iterator[Bench]:
    """A bench for Podman."""
    yield from lent("podman", request, job_folder)


_LOOK = """
import os
print(sorted(name for name in os.listdir("/dev") if name == "fuse"), os.environ.get("GPU_OF_TEST"))
lines = open("/proc/self/status").read().splitlines() + open("/proc/self/limits").read().splitlines()
print([line for line in lines if line.startswith(("Cap", "NoNewPrivs", "Seccomp", "Max"))])
print(os.listdir("/sys/class/net"), os.access("/usr", os.W_OK), os.access("/in", os.W_OK), os.getpid())
"""
_ALIKE = (
    *("Memory", "MemorySwap", "NanoCpus", "PidsLimit", "ShmSize", "OomScoreAdj", "NetworkMode", "IpcMode", "PidMode"),
    *("CapDrop", "CapAdd", "Privileged", "ReadonlyRootfs", "SecurityOpt", "Ulimits", "RestartPolicy", "ExtraHosts"),
)


@pytest.mark.slow
def test_podman_gives_gpus_by_cdi_and_isolates_their_runs_like_others(
    podman_bench: Bench, machine: FakeGpus, tmp_path: Path
) -> None:
    """Containers with GPUs are created by another API than those without."""
    engine, executor = podman_bench.engine, podman_bench.executor
    assert isinstance(engine, Podman)
    assert isinstance(executor, DockerExecutor)
    edits = [{"deviceNodes": [{"path": "/dev/fuse"}], "env": [f"GPU_OF_TEST={n}"]} for n in range(2)]
    devices = [{"name": str(n), "containerEdits": edit} for n, edit in enumerate(edits)]
    text = json.dumps({"cdiVersion": "0.5.0", "kind": "nvidia.com/gpu", "devices": devices})
    engine.write_cdi(text)
    (machine.folder / "cdi" / "nvidia.yaml").write_text(text)
    executor._machine = host = Machine(tmp_path / "runner", MachineShare(gpus=GpuRequest(names=("GPU-1",))))
    executor.check_gpus()
    logs, hosts = [], []
    for count in (0, 1):
        job, ending = podman_bench.run(_LOOK, gpus=count)
        assert ending.reason is EndReason.done, log_of(job)
        logs.append(log_of(job).splitlines())
        inspected = json.loads(engine.docker("inspect", f"kleinkram-{job.key}"))[0]["HostConfig"]
        hosts.append({name: inspected.get(name) for name in _ALIKE})
    assert [lines[0] for lines in logs] == ["[] None", "['fuse'] 1"]
    assert logs[0][1:] == logs[1][1:]
    assert hosts[0] == hosts[1]
    # A device that the engine does not know: the run is not started without it.
    engine.write_cdi(text.replace('"name": "1"', '"name": "7"'))
    executor.remove(podman_bench.made[1])
    with pytest.raises(CannotStart, match=r"unresolvable CDI devices nvidia\.com/gpu=1"):
        executor.submit(podman_bench.job(_LOOK, gpus=1))
    assert host.gpus is not None
    host.gpus.close()
