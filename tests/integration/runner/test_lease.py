"""The lease of a job: its file, and what is known of it on another machine."""

import math
from pathlib import Path

import pytest

from kleinkram.contract.actions import Network, Resources
from kleinkram.runner.executors.base import RunJob
from kleinkram.runner.executors.process import ProcessExecutor
from kleinkram.runner.executors.supervision import LEASE, JobLimits, LimitMonitor, boot_time_s, write_lease
from kleinkram.runner.state_directory import StateDirectory


def test_a_directory_that_is_being_removed_does_not_get_its_lease_back(tmp_path: Path) -> None:
    executor = ProcessExecutor()
    job = RunJob("a-job", tmp_path, [], None, Resources(), Network.none)
    with pytest.raises(FileNotFoundError):
        executor.set_lease(job, 1.0)
    assert [*tmp_path.iterdir()] == []
    executor.set_lease(job, 1.0, create=True)
    executor.set_lease(job, 1e6)
    assert float((tmp_path / LEASE).read_text().split()[0]) == 1e6


@pytest.mark.parametrize(("until_s", "is_expired"), [(1.0, True), (1e12, False)])
def test_a_lease_holds_by_the_clock_of_the_machine_that_wrote_it(
    tmp_path: Path, until_s: float, is_expired: bool
) -> None:
    limits = LimitMonitor(tmp_path, JobLimits(1, 1, 1, 1))
    assert not limits.is_lease_expired()
    write_lease(tmp_path, until_s, create=True)
    assert limits.is_lease_expired() is is_expired
    (tmp_path / LEASE).write_text(f"{until_s} 00000000-0000-0000-0000-000000000000")
    assert not limits.is_lease_expired()


def test_the_last_heartbeat_is_known_on_another_machine(tmp_path: Path) -> None:
    state = StateDirectory(tmp_path)
    assert state.last_heartbeat_s() == -math.inf
    sent_s = boot_time_s() - 100
    state.record_heartbeat(sent_s)
    assert state.last_heartbeat_s() == sent_s
    _, *times = (tmp_path / "last-heartbeat").read_text().split()
    (tmp_path / "last-heartbeat").write_text(" ".join(["00000000-0000-0000-0000-000000000000", "7", times[1]]))
    assert abs(state.last_heartbeat_s() - sent_s) < 10
    # A clock that is ahead, or behind, extends no lease beyond that of a heartbeat now.
    (tmp_path / "last-heartbeat").write_text("00000000-0000-0000-0000-000000000000 7 9999999999.0")
    assert state.last_heartbeat_s() <= boot_time_s()
