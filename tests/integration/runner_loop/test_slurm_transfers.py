"""The nodes of Slurm download inputs to the shared cache, and upload results."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from kleinkram.contract.runners import LOG_PATH
from kleinkram.contract.runs import EndReason, RunState
from tests.integration.runner_loop.conftest import Runners, ended, wait_until
from tests.integration.runner_loop.fake_runs import FakeRun
from tests.integration.runner_loop.fake_server import FakeServer
from tests.integration.runner_loop.test_node_transfers import INPUTS, WORK, directory_of
from tests.integration.runner_loop.test_slurm import site, whole  # noqa: F401  fixtures
from tests.slurm_cluster import SlurmCluster

pytestmark = pytest.mark.slow

RESULTS = {LOG_PATH: b"bytes of a drive\n", "result.txt": b"BYTES OF A DRIVE"}


def uploads_of(run: FakeRun, server: FakeServer) -> bool:
    return bool(server.requests["/runner/runs/*/uploads"]) and run.states[-1] is RunState.collecting


def nodes_program(directory: Path) -> int:
    """Return the pid of the program of a node that has the directory of a job."""
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit() and (entry / "cmdline").exists():
            command = (entry / "cmdline").read_bytes().decode(errors="replace").split("\0")
            if str(directory) in command and command[3].endswith(".node_job"):
                return int(entry.name)
    raise LookupError


def test_a_node_downloads_an_input_once_and_uploads_results(
    server: FakeServer, runners: Runners, slurm: SlurmCluster
) -> None:
    server.slow_bytes_per_s = 8
    runners.spawn(slurm=slurm, transfers_on_nodes=True)
    runs = [server.launch(WORK, INPUTS) for _ in range(3)]
    for run in runs:
        finish = ended(run).finishes[0]
        assert (finish.reason, finish.problems) == (EndReason.done, [])
        assert run.artifacts == RESULTS
        assert finish.placement is not None
        assert finish.placement.node == "node1"
    shown = {progress.message for run in runs for progress in run.progress}
    assert "waits for the download of another job: drive.bag" in shown
    assert server.requests["GET store"] == 1


def test_a_run_is_cancelled_while_its_node_downloads(server: FakeServer, runners: Runners, slurm: SlurmCluster) -> None:
    server.slow_bytes_per_s = 0.1
    runners.spawn(slurm=slurm, transfers_on_nodes=True)
    run = server.launch(WORK, {"drive.bag": bytes(100)})
    wait_until(lambda: server.requests["GET store"])
    run.is_cancelled = True
    assert ended(run).finishes[0].reason is EndReason.cancelled
    # Nobody has its download any more.
    server.slow_bytes_per_s = None
    other = server.launch("", {"drive.bag": bytes(100)})
    assert ended(other).finishes[0].reason is EndReason.done


def test_what_a_node_did_not_upload_the_login_node_uploads(
    server: FakeServer, runners: Runners, slurm: SlurmCluster
) -> None:
    server.holds_uploads.set()
    runners.spawn(slurm=slurm, transfers_on_nodes=True)
    run = server.launch(WORK, INPUTS)
    wait_until(lambda: uploads_of(run, server))
    os.kill(nodes_program(directory_of(runners, run)), signal.SIGKILL)
    server.holds_uploads.clear()
    assert ended(run).finishes[0].reason is EndReason.done
    assert run.artifacts == RESULTS


def test_a_login_process_that_is_killed_finds_the_upload_of_the_node(
    server: FakeServer, runners: Runners, slurm: SlurmCluster
) -> None:
    server.holds_uploads.set()
    first = runners.spawn(slurm=slurm, transfers_on_nodes=True)
    run = server.launch(WORK, INPUTS)
    wait_until(lambda: uploads_of(run, server))
    runners.kill(first)
    runners.spawn(slurm=slurm, transfers_on_nodes=True)
    server.holds_uploads.clear()
    assert ended(run).finishes[0].reason is EndReason.done
    assert run.artifacts == RESULTS
    assert server.requests["/runner/runs/*/uploads"] == 1


def test_a_run_is_cancelled_while_its_node_uploads(server: FakeServer, runners: Runners, slurm: SlurmCluster) -> None:
    server.holds_uploads.set()
    runners.spawn(slurm=slurm, transfers_on_nodes=True)
    run = server.launch(WORK, INPUTS)
    wait_until(lambda: uploads_of(run, server))
    run.is_cancelled = True
    assert ended(run).finishes[0].reason is EndReason.cancelled
    server.holds_uploads.clear()
    assert not run.artifacts
