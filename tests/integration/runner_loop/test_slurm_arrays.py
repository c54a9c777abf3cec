"""Runs that are ready together are one job array of Slurm, whose tasks live and end each by itself."""

from __future__ import annotations

import json

import pytest

from kleinkram.contract.runners import LOG_PATH
from kleinkram.contract.runs import EndReason
from tests.integration.runner_loop.conftest import Runners, ended, wait_until
from tests.integration.runner_loop.fake_runs import FakeRun, queued
from tests.integration.runner_loop.fake_server import FakeServer
from tests.integration.runner_loop.test_faults import LASTING
from tests.integration.runner_loop.test_slurm import RESTARTED, site, until_shown, whole  # noqa: F401  fixtures
from tests.slurm_cluster import SlurmCluster

pytestmark = pytest.mark.slow


def jobs_of(slurm: SlurmCluster) -> list[str]:
    """Return the ids of the submissions that wait or run."""
    return slurm.command("squeue", "--noheader", "--array", "--format=%F").stdout.split()


def job_id(run: FakeRun) -> str:
    """Return the id of the job of a run, as its runner reported it."""
    wait_until(lambda: run.placement is not None and run.placement.job_id)
    assert run.placement is not None
    assert run.placement.job_id is not None
    return run.placement.job_id


def test_the_tasks_of_an_array_end_each_by_itself(server: FakeServer, runners: Runners, slurm: SlurmCluster) -> None:
    runners.spawn(slurm=slurm, max_tasks=3)
    wait_until(lambda: server.registrations)
    runs = server.launch_all(
        [queued(code, {}, {}) for code in (LASTING, "raise SystemExit(3)", RESTARTED, "print('last')")]
    )
    cancelled, failed, restarted, waiting = runs
    ids = [job_id(run).partition("_") for run in runs]
    assert len({array for array, _, _ in ids}) == 1, "one submission"
    assert sorted(int(task) for _, _, task in ids) == [0, 1, 2, 3]
    wait_until(lambda: restarted.states and list(runners.folder.glob(f"runs/{restarted.claim.run_id}-1/out/*")))
    slurm.command("scontrol", "requeue", job_id(restarted))
    assert ended(failed).finishes[0].exit_code == 3
    assert ended(waiting).artifacts == {LOG_PATH: b"last\n"}
    cancelled.is_cancelled = True
    assert ended(cancelled).finishes[0].reason is EndReason.cancelled
    (finish,) = ended(restarted).finishes
    assert (finish.reason, len(restarted.artifacts)) == (EndReason.done, 2)
    assert finish.placement is not None
    assert (finish.placement.job_id, finish.placement.requeues) == (job_id(restarted), 1)
    wait_until(lambda: not jobs_of(slurm))


def test_a_runner_killed_while_it_submits_an_array_finds_its_tasks(
    server: FakeServer, runners: Runners, slurm: SlurmCluster
) -> None:
    """Whether it had recorded the answer of sbatch or not: here, it had not."""
    first = runners.spawn(slurm=slurm)
    wait_until(lambda: server.registrations)
    slurm.command("scontrol", "update", "PartitionName=main", "State=DOWN")
    runs = server.launch_all([queued("print('began')", {}, {}) for _ in range(3)])
    for run in runs:
        until_shown(run, "its partition is down")
    runners.kill(first)
    (array,) = {*jobs_of(slurm)}
    for record in runners.folder.glob("runs/*/slurm.json"):
        values = json.loads(record.read_text())
        record.write_text(json.dumps({**values, "job_id": ""}))
    runners.spawn(slurm=slurm)
    slurm.command("scontrol", "update", "PartitionName=main", "State=UP")
    for run in runs:
        assert [finish.reason for finish in ended(run).finishes] == [EndReason.done]
        assert (run.attempt, run.artifacts) == (1, {LOG_PATH: b"began\n"})
    assert {job_id(run).partition("_")[0] for run in runs} == {array}
