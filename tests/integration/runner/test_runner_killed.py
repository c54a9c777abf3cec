"""A runner is killed while it starts or removes a container: the next one continues with exactly one."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys

import pytest

from kleinkram.contract.runs import EndReason
from kleinkram.runner import state_directory
from kleinkram.runner.executors import process_supervisor
from kleinkram.runner.executors.base import wait_for_end
from kleinkram.runner.executors.docker.executor import DockerExecutor
from tests.integration.runner.conftest import EVERYWHERE, LOCALLY_EVERYWHERE, Bench, log_of
from tests.integration.runner.test_executors import LASTING, until_logged_by


class Killed(BaseException):
    """Raised to end a runner in the middle of a function."""


PROCESS_ONLY = pytest.mark.parametrize("bench", ["process"], indirect=True)


@PROCESS_ONLY
def test_a_runner_killed_before_it_recorded_the_pid_finds_the_job_again(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The next runner must not start it again in the same directory: two jobs would mix their results."""
    job = bench.job("print('once')")

    def die(*_: object) -> None:
        raise Killed

    with monkeypatch.context() as patched:
        patched.setattr(process_supervisor, "write_pid", die)
        with pytest.raises(Killed):
            bench.executor.submit(job)
    ending = wait_for_end(bench.again(), job, timeout_s=40)
    assert ending is not None
    assert (ending.reason, log_of(job)) == (EndReason.done, "once\n")


@PROCESS_ONLY
def test_a_supervisor_without_its_job_does_nothing(bench: Bench) -> None:
    job = bench.job("print('once')")
    (job.directory / "supervisor").touch()
    lock = os.open(job.directory / "supervisor", os.O_RDWR)
    subprocess.run(
        [sys.executable, "-m", process_supervisor.__name__, str(job.directory), str(lock)], pass_fds=[lock], check=True
    )
    os.close(lock)
    ending = bench.executor.poll(job)
    assert ending is not None
    assert (ending.reason, log_of(job)) == (EndReason.lost, "")


@EVERYWHERE
def test_a_runner_killed_right_after_it_submitted_a_job_finds_it_again(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    job = bench.job("print('once')")
    bench.executor.submit(job)
    next_one = bench.again()
    if isinstance(bench.executor, DockerExecutor):
        bench.executor._monitors.pop(job.key).close()
    ending = wait_for_end(next_one, job, timeout_s=40)
    assert ending is not None
    assert (ending.reason, log_of(job)) == (EndReason.done, "once\n")


@LOCALLY_EVERYWHERE
def test_a_removed_container_is_reported_lost_and_may_be_started_again(bench: Bench) -> None:
    """As by Ctrl-C: the next runner starts the run again and keeps its log, which is already in the store."""
    job = bench.job(LASTING)
    bench.executor.submit(job)
    until_logged_by(bench, LASTING, "ready\n")
    bench.executor.remove(job)
    next_one = bench.again()
    ending = wait_for_end(next_one, job, timeout_s=0)
    assert ending is not None
    assert ending.reason is EndReason.lost
    for path in job.directory.iterdir():
        if path.name not in state_directory._PRESERVED:
            shutil.rmtree(path) if path.is_dir() else path.unlink()
    (job.directory / "in").mkdir()
    next_one.submit(job)
    bench.executor = next_one
    until_logged_by(bench, LASTING, "ready\nready\n")
    next_one.cancel(job)
    ending = wait_for_end(next_one, job, timeout_s=40)
    assert ending is not None
    assert ending.reason is EndReason.cancelled
