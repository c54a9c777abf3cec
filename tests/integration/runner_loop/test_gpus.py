"""Runs with GPUs: none shares one, and each keeps its own over restarts of the runner."""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys
from pathlib import Path

import pytest

from kleinkram.contract.runners import Capacity
from kleinkram.contract.runs import EndReason, RunPlacement, RunState
from kleinkram.runner.__main__ import _warn_if_shared_out
from kleinkram.runner.arguments import TOKEN_VARIABLE
from kleinkram.runner.executors.gpus import GpuRequest
from kleinkram.runner.executors.local import MachineShare
from kleinkram.runner.loop import Runner
from tests.integration.runner.fake_gpus import FakeGpus, described
from tests.integration.runner_loop.conftest import Runners, ended, wait_until
from tests.integration.runner_loop.fake_http import RUNNER_TOKEN
from tests.integration.runner_loop.fake_runs import FakeRun
from tests.integration.runner_loop.fake_server import FakeServer

SHARE = MachineShare(cores=2, memory_bytes=4 * 10**9, disk_bytes=10**9, cache_bytes=10**9, gpus=GpuRequest(count=None))
LASTING = "import os, time\nprint(os.environ['CUDA_VISIBLE_DEVICES'], flush=True)\ntime.sleep(120)\n"


@pytest.fixture
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> FakeGpus:
    """A machine with four GPUs, and a fifth that is divided into two MIG devices."""
    made = FakeGpus(tmp_path / "machine", count=4, slices=2, specification=described(4, 2))
    made.install(monkeypatch)
    return made


def launch(server: FakeServer, code: str = LASTING, gpus: int = 1) -> FakeRun:
    resources = {"gpus": gpus, "cores": 0.1, "memory_bytes": 200_000_000, "disk_bytes": 5_000_000}
    return server.launch(code, resources=resources)


def gpus_of(run: FakeRun) -> list[str]:
    return run.placement.gpus if run.placement is not None else []


def stop(runner: Runner) -> None:
    """End a runner, but not its runs, as SIGTERM does."""
    runner.stop()
    runner.close(kill=False)
    machine = runner._executor._machine  # type: ignore[attr-defined]
    machine.gpus.close()


def test_no_run_shares_a_gpu_and_each_keeps_its_own_over_a_restart(
    server: FakeServer, runners: Runners, machine: FakeGpus
) -> None:
    first = runners.start(share=SHARE)
    runs = [launch(server) for _ in range(6)]
    wait_until(lambda: all(gpus_of(run) and run.shown_log for run in runs))
    assigned = [gpus_of(run) for run in runs]
    assert sorted(gpu for gpus in assigned for gpu in gpus) == machine.uuids
    assert [run.shown_log.decode().split() for run in runs] == assigned
    server.is_silent.set()
    server.wake()
    stop(first)
    server.is_silent.clear()
    for run in runs:
        run.placement = None
    runners.start(share=SHARE)
    waiting = launch(server, "import os\nprint(os.environ['CUDA_VISIBLE_DEVICES'])\n")
    wait_until(lambda: all(map(gpus_of, runs)))
    assert [gpus_of(run) for run in runs] == assigned
    assert (waiting.state, server.requested[-1].free.gpus) == (RunState.queued, 0)
    runs[3].is_cancelled = True
    finish = ended(waiting).finishes[0]
    assert (finish.reason, finish.placement) == (EndReason.done, RunPlacement(gpus=assigned[3]))
    assert all(not run.finishes for run in runs[:3] + runs[4:])


@pytest.mark.usefixtures("machine")
def test_two_runners_of_a_machine_share_nothing(server: FakeServer, runners: Runners, tmp_path: Path) -> None:
    others = Runners(server, tmp_path / "another")
    try:
        half = dataclasses.replace(SHARE, gpus=GpuRequest(count=3))
        hosts = [runners.start(share=half), others.start(share=half)]
        runs = [launch(server, gpus=gpus) for gpus in (2, 2, 1, 1)]
        wait_until(lambda: all(map(gpus_of, runs)))
        assigned = [gpu for run in runs for gpu in gpus_of(run)]
        assert len(set(assigned)) == len(assigned) == 6
        assert {run.runner_id for run in runs} == {host._state.runner_id for host in hosts}
        first = {gpu for run in runs if run.runner_id == hosts[0]._state.runner_id for gpu in gpus_of(run)}
        assert first in ({"GPU-0", "GPU-1", "GPU-2"}, {"GPU-3", "MIG-0", "MIG-1"})
    finally:
        others.close()


@pytest.mark.parametrize(
    ("options", "error"),
    [
        (["--gpus", "7"], "7 are requested, and this machine has GPU-0 (0), GPU-1 (1)"),
        (["--gpus", "two"], "'two' is neither a number nor `all`"),
        (["--gpus", "1", "--gpu", "0"], "--gpu chooses the GPUs already"),
    ],
)
def test_a_start_with_other_gpus_than_there_are_ends_with_a_sentence(
    machine: FakeGpus, tmp_path: Path, options: list[str], error: str
) -> None:
    command = [str(Path(sys.executable).with_name("klein")), "runner", "start", "--executor", "process", *options]
    environment = {**os.environ, TOKEN_VARIABLE: RUNNER_TOKEN, "HOME": str(machine.folder)}
    place = ["--url", "http://127.0.0.1:1", "--data-dir", str(tmp_path / "runner")]
    done = subprocess.run([*command, *place], env=environment, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode != 0
    assert error in " ".join(done.stderr.split())


def test_runners_that_offer_more_than_the_machine_has_warn(caplog: pytest.LogCaptureFixture) -> None:
    offers = [Capacity(cores=cores, memory_bytes=10**9, disk_bytes=1, gpus=0) for cores in (0.1, 10_000)]
    _warn_if_shared_out(offers[1:])
    _warn_if_shared_out(offers[:1] * 2)
    assert not caplog.text
    _warn_if_shared_out(offers)
    assert "the 2 runners of this machine together offer 10000.1 cores and 2.0 GB memory, and it has" in caplog.text
