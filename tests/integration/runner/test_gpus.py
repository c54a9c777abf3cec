"""GPUs: which there are, which a runner gets, and which its jobs get."""

from __future__ import annotations

import os
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from kleinkram.client.errors import InvalidInput
from kleinkram.contract.actions import Network, Resources
from kleinkram.contract.runners import Capacity
from kleinkram.contract.runs import RunPlacement
from kleinkram.runner.executors import machine_locks, process_sandbox
from kleinkram.runner.executors.base import RunJob, wait_for_end
from kleinkram.runner.executors.docker.client import EngineInfo
from kleinkram.runner.executors.gpu_pool import GpuPool, GpusUnavailable, acquire_gpus
from kleinkram.runner.executors.gpus import Gpu, GpuRequest, find_gpus, select_named
from kleinkram.runner.executors.local import Machine, MachineShare
from kleinkram.runner.executors.machine_locks import MachineLock, announce
from kleinkram.runner.executors.process import ProcessExecutor
from tests.integration.runner.fake_gpus import NODE, FakeGpus, described

ALL = GpuRequest(count=None)
DOCKER = EngineInfo("amd64", is_podman=False, ends_with_containers=True)
PODMAN = EngineInfo("amd64", is_podman=True, ends_with_containers=False, has_cdi=True)


@pytest.fixture
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> FakeGpus:
    """A machine with four GPUs, and a fifth that is divided into two MIG devices."""
    made = FakeGpus(tmp_path / "machine", count=4, slices=2, specification=described(4, 2))
    made.install(monkeypatch)
    return made


@pytest.fixture
def pools(tmp_path: Path) -> Iterator[Pools]:
    made = Pools(tmp_path)
    yield made
    for pool in made.acquired:
        pool.close()


class Pools:
    """The GPUs of some runners, each with a directory of its own."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.acquired: list[GpuPool] = []

    def acquire(self, runner: str, request: GpuRequest) -> GpuPool:
        (self.folder / runner / "runs").mkdir(parents=True, exist_ok=True)
        pool = acquire_gpus(request, self.folder / runner / "runs")
        assert pool is not None
        self.acquired.append(pool)
        return pool

    def job(self, runner: str, key: str, count: int = 1) -> RunJob:
        directory = self.folder / runner / "runs" / key
        directory.mkdir(parents=True, exist_ok=True)
        return RunJob(key, directory, [], None, Resources(gpus=count), Network.none)


def ids_of(listed: tuple[Gpu, ...] | list[Gpu]) -> list[str]:
    return [gpu.id for gpu in listed]


# -- which there are ---------------------------------------------------------------------------------------------------


def test_a_divided_gpu_is_listed_by_its_mig_devices(machine: FakeGpus) -> None:
    listed = find_gpus()
    assert ids_of(listed) == machine.uuids == ["GPU-0", "GPU-1", "GPU-2", "GPU-3", "MIG-0", "MIG-1"]
    assert [gpu.index for gpu in listed] == ["0", "1", "2", "3", "4:0", "4:1"]
    assert listed[5].cdi_names == ("nvidia.com/gpu=4:1",)


def test_a_gpu_in_mig_mode_without_mig_devices_is_not_listed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = FakeGpus(tmp_path, count=1, slices=1)
    made.install(monkeypatch)
    lines = (tmp_path / "list").read_text().splitlines(keepends=True)
    (tmp_path / "list").write_text("".join(line for line in lines if "MIG" not in line))
    assert ids_of(find_gpus()) == ["GPU-0"]


def test_gpus_of_a_driver_that_does_not_know_mig(machine: FakeGpus) -> None:
    (machine.folder / "modes").unlink()
    assert "GPU-0" in ids_of(find_gpus())


def test_without_nvidia_smi_the_driver_lists_gpus(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    FakeGpus(tmp_path).install(monkeypatch)
    for bus, minor in (("0000:41:00.0", 1), ("0000:01:00.0", 0)):
        facts = tmp_path / "driver" / "gpus" / bus
        facts.mkdir(parents=True)
        text = f"Model: \t\t NVIDIA RTX\nGPU UUID: \t GPU-{minor}\nBus Location: \t {bus}\nDevice Minor: \t {minor}\n"
        (facts / "information").write_text(text)
    listed = find_gpus()
    assert [(gpu.id, gpu.index, gpu.nodes) for gpu in listed] == [
        ("GPU-0", "0", ("/dev/nvidia0",)),
        ("GPU-1", "1", ("/dev/nvidia1",)),
    ]
    (tmp_path / "driver" / "capabilities" / "gpu0" / "mig" / "gi1").mkdir(parents=True)
    with pytest.raises(InvalidInput, match="install nvidia-smi"):
        find_gpus()


def test_gpus_with_several_names_in_cdi_are_listed_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = FakeGpus(tmp_path)
    made.install(monkeypatch)
    by_names: dict[str, object] = {"0": ["/dev/nvidia0"], "1": ["/dev/nvidia1"], "GPU-b": ["/dev/nvidia1"]}
    made.write_cdi("nvidia.com/gpu", by_names | {"all": ["/dev/nvidia0", "/dev/nvidia1"]})
    made.write_cdi("amd.com/gpu", {"0": ["/dev/kfd", "/dev/dri/renderD128"], "all": ["/dev/kfd"]})
    made.write_cdi("lab.example/camera", {"0": ["/dev/video0"]})
    listed = {gpu.id: gpu for gpu in find_gpus()}
    assert list(listed) == ["amd.com/gpu=0", "nvidia.com/gpu=0", "GPU-b"]
    assert listed["GPU-b"].cdi_names == ("nvidia.com/gpu=GPU-b", "nvidia.com/gpu=1")
    assert ids_of(select_named([*listed.values()], ["1", "amd.com/gpu=0"])) == ["GPU-b", "amd.com/gpu=0"]


@pytest.mark.parametrize("text", ["kind: [", "kind: nvidia.com/gpu\ndevices: 3\n", "- 1\n", "\x00", ""])
def test_a_broken_specification_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str) -> None:
    FakeGpus(tmp_path).install(monkeypatch)
    (tmp_path / "cdi" / "vendor.yaml").write_text(text)
    with pytest.raises(InvalidInput, match=r"CDI specification .*vendor\.yaml is invalid"):
        find_gpus()


def test_what_nvidia_smi_says_when_it_fails_is_reported(machine: FakeGpus) -> None:
    (machine.folder / "bin" / "nvidia-smi").write_text("#!/bin/sh\necho NVIDIA-SMI has failed, no driver; exit 9\n")
    with pytest.raises(InvalidInput, match="NVIDIA-SMI has failed, no driver"):
        find_gpus()


# -- which a runner gets -----------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("machine")
def test_two_runners_share_no_gpu(pools: Pools) -> None:
    first, second = pools.acquire("first", GpuRequest(3)), pools.acquire("second", ALL)
    assert ids_of(first.gpus) == ["GPU-0", "GPU-1", "GPU-2"]
    assert ids_of(second.gpus) == ["GPU-3", "MIG-0", "MIG-1"]
    for request, number in ((GpuRequest(1), 1), (ALL, 6), (GpuRequest(names=("4:1",)), 1)):
        with pytest.raises(InvalidInput, match=f"{number} GPUs are requested, and 0 are free.*another runner"):
            pools.acquire("third", request)
    first.close()
    assert ids_of(pools.acquire("third", GpuRequest(1)).gpus) == ["GPU-0"]


@pytest.mark.parametrize(
    ("request_", "error"),
    [
        (GpuRequest(7), "7 are requested, and this machine has GPU-0 .*MIG-1"),
        (GpuRequest(names=("9",)), "there is no GPU 9; this machine has GPU-0"),
    ],
)
@pytest.mark.usefixtures("machine")
def test_a_start_with_gpus_that_are_not_there_is_refused(pools: Pools, request_: GpuRequest, error: str) -> None:
    with pytest.raises(InvalidInput, match=error):
        pools.acquire("first", request_)


@pytest.mark.parametrize("request_", [GpuRequest(1), ALL])
def test_a_start_with_gpus_on_a_machine_without_any_is_refused(
    pools: Pools, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request_: GpuRequest
) -> None:
    FakeGpus(tmp_path / "machine").install(monkeypatch)
    with pytest.raises(InvalidInput, match=r"has none: nvidia-smi .*Install the driver"):
        pools.acquire("first", request_)


@pytest.mark.usefixtures("machine")
def test_gpus_of_a_stopped_runner_stay_those_of_its_jobs(pools: Pools) -> None:
    first = pools.acquire("first", GpuRequest(names=("1", "4:0")))
    job = pools.job("first", "a-run")
    assert ids_of(first.assign(job)) == ["GPU-1"]
    first.close()
    with pytest.raises(InvalidInput, match=r"GPU-1 is used by a run of another runner, in .*first/runs"):
        pools.acquire("second", GpuRequest(names=("1",)))
    assert ids_of(pools.acquire("second", GpuRequest(names=("4:0",))).gpus) == ["MIG-0"]
    # It would have been the second GPU otherwise.
    again = pools.acquire("first", GpuRequest(1))
    assert ids_of(again.gpus) == ["GPU-1"]
    again.release(job)
    again.close()
    assert ids_of(pools.acquire("second", GpuRequest(names=("1",))).gpus) == ["GPU-1"]


@pytest.mark.usefixtures("machine")
def test_jobs_of_a_removed_runner_block_no_gpu(pools: Pools) -> None:
    first = pools.acquire("first", GpuRequest(1))
    job = pools.job("first", "a-run")
    first.assign(job)
    first.close()
    (job.directory / "gpus.json").unlink()
    assert ids_of(pools.acquire("second", GpuRequest(1)).gpus) == ["GPU-0"]


@pytest.mark.skipif(os.geteuid() != 0, reason="other users exist only for root")
def test_locks_are_shared_by_all_users(monkeypatch: pytest.MonkeyPatch) -> None:
    with tempfile.TemporaryDirectory() as place:
        Path(place).chmod(0o1777)
        monkeypatch.setattr(machine_locks, "places", lambda: [Path(place)])
        lock = MachineLock("gpu-a/b=0")
        assert lock.try_acquire()
        assert lock.path == Path(place) / "kleinkram" / "gpu-a_b_0"
        assert stat.S_IMODE(lock.path.stat().st_mode) == 0o666
        assert stat.S_IMODE(lock.path.parent.stat().st_mode) == 0o1777
        assert not is_free_for_nobody("gpu-a/b=0")
        lock.close()
        assert is_free_for_nobody("gpu-a/b=0")


def is_free_for_nobody(name: str) -> bool:
    """Return whether the user `nobody` can take a lock."""
    pid = os.fork()
    if pid == 0:
        try:
            os.setuid(65534)
            os._exit(int(MachineLock(name).try_acquire()))
        finally:
            os._exit(2)
    code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    assert code in (0, 1)
    return code == 1


def test_a_machine_without_a_folder_for_locks_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine_locks, "places", lambda: [tmp_path / "missing"])
    with pytest.raises(InvalidInput, match=r"none of these can be written to: .*missing/kleinkram"):
        MachineLock("gpu-0")
    assert announce("a-runner", Capacity(cores=1, memory_bytes=1, disk_bytes=1, gpus=0)) == (None, [])


@pytest.mark.usefixtures("machine")
def test_runners_of_a_machine_know_what_the_others_offer() -> None:
    offers = [Capacity(cores=n, memory_bytes=n, disk_bytes=n, gpus=0) for n in (1, 2, 3)]
    first, none = announce("first", offers[0])
    second, of_first = announce("second", offers[1])
    assert first is not None
    first.close()
    third, of_second = announce("third", offers[2])
    assert (none, of_first, of_second) == ([], offers[:1], offers[1:2])
    # That of the first, which has ended without removing it, is gone.
    assert sorted(path.name for path in machine_locks.lock_directory().iterdir()) == ["runner-second", "runner-third"]
    for lock in (second, third):
        assert lock is not None
        lock.close()


# -- which jobs get ----------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("machine")
def test_no_two_jobs_have_the_same_gpu(pools: Pools) -> None:
    pool = pools.acquire("first", ALL)
    jobs = [pools.job("first", f"run-{n}") for n in range(6)]
    assert [ids_of(pool.assign(job)) for job in jobs] == [[gpu.id] for gpu in pool.gpus]
    assert pool.free_count(reserved=6) == 0
    pool.close()
    pool = pools.acquire("first", ALL)
    with pytest.raises(GpusUnavailable, match="needs 1 GPUs, and 0 of its runner's 6 are free"):
        pool.assign(pools.job("first", "run-6"))
    pool.release(jobs[4])
    # Reserved by five jobs that have theirs, and one that waits for its inputs.
    assert (pool.free_count(reserved=5), pool.free_count(reserved=6)) == (1, 0)
    assert ids_of(pool.assign(pools.job("first", "run-6"))) == ["MIG-0"]


@pytest.mark.usefixtures("machine")
def test_sharing_limits_the_jobs_of_a_gpu(pools: Pools) -> None:
    pool = pools.acquire("first", GpuRequest(2, sharing=2))
    assigned = [ids_of(pool.assign(pools.job("first", f"run-{n}"))) for n in range(3)]
    assert assigned == [["GPU-0"], ["GPU-1"], ["GPU-0"]]
    # A run never has one twice.
    assert pool.free_count(reserved=3) == 1
    with pytest.raises(GpusUnavailable):
        pool.assign(pools.job("first", "run-3", count=2))
    pool.release(pools.job("first", "run-0"))
    assert ids_of(pool.assign(pools.job("first", "run-3", count=2))) == ["GPU-0", "GPU-1"]
    assert pool.free_count(reserved=4) == 0


@pytest.mark.usefixtures("machine")
def test_a_process_sees_the_files_of_its_gpus(tmp_path: Path) -> None:
    node = Path("/dev/fuse")
    if not node.exists():
        node = Path(NODE)
    FakeGpus.write_cdi(FakeGpus(tmp_path / "machine"), "nvidia.com/gpu", {"0": [str(node)], "4:1": [str(node)]})
    machine = Machine(tmp_path, MachineShare(1, 10**9, 10**9, GpuRequest(names=("4:1",)), 10**9))
    executor = ProcessExecutor(machine)
    executor.check_gpus()
    assert executor.abilities.gpus
    assert executor.capacity.gpus == 1
    text = f"import os; print(os.environ['CUDA_VISIBLE_DEVICES'], os.path.exists({str(node)!r}), os.listdir('/dev'))"
    command = [os.environ.get("PYTHON", "python3"), "-c", text]
    directory = tmp_path / "runs" / "a-run"
    (directory / "in").mkdir(parents=True)
    job = RunJob("a-run", directory, command, None, Resources(gpus=1, memory_bytes=10**9, time_s=60), Network.open)
    executor.submit(job)
    ending = wait_for_end(executor, job, timeout_s=40)
    assert (ending is not None, (directory / "log").read_text().split()[:2]) == (True, ["MIG-1", "True"]), ending
    assert executor.placement(job) == RunPlacement(gpus=["MIG-1"])
    executor.remove(job)
    assert executor.placement(job) is None
    assert machine.gpus is not None
    machine.gpus.close()


def test_a_process_cannot_have_a_gpu_without_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    FakeGpus(tmp_path / "machine", slices=1).install(monkeypatch)
    machine = Machine(tmp_path, MachineShare(gpus=ALL))
    if process_sandbox.is_available():
        with pytest.raises(InvalidInput, match="which files below /dev belong to MIG-0: run `nvidia-ctk cdi generate"):
            ProcessExecutor(machine).check_gpus()
    assert machine.gpus is not None
    machine.gpus.close()
