"""The lease file of a job."""

from pathlib import Path

import pytest

from kleinkram.contract.actions import Network, Resources
from kleinkram.runner.executors.base import RunJob
from kleinkram.runner.executors.process import ProcessExecutor
from kleinkram.runner.executors.supervision import LEASE


def test_a_directory_that_is_being_removed_does_not_get_its_lease_back(tmp_path: Path) -> None:
    executor = ProcessExecutor()
    job = RunJob("a-job", tmp_path, [], None, Resources(), Network.none)
    with pytest.raises(FileNotFoundError):
        executor.set_lease(job, 1.0)
    assert [*tmp_path.iterdir()] == []
    executor.set_lease(job, 1.0, create=True)
    executor.set_lease(job, 1e6)
    assert float((tmp_path / LEASE).read_text()) == 1e6
