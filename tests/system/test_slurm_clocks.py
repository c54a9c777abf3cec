"""A node of Slurm whose clock is an hour off: runs work, and their times are those of the server and the controller."""

from __future__ import annotations

import datetime
from pathlib import Path

import pytest

from kleinkram.contract.actions import ActionDefinition, Resources
from tests.acceptance.conftest import wait_until
from tests.system.chaos.clocks import wrong_clock
from tests.system.slurm_lab import lab

_SCRIPT = """
import datetime
from kleinkram.action import inputs, out
(out / "copy").write_bytes(inputs()[0].read_bytes())
"""


@pytest.mark.slow
@pytest.mark.soak
@pytest.mark.parametrize("hours", [1, -1])
def test_a_node_whose_clock_is_an_hour_off_reads_and_writes(tmp_path: Path, hours: int) -> None:
    """The node itself downloads and uploads, by URLs that are signed for some minutes."""
    began = datetime.datetime.now(datetime.timezone.utc)
    with lab(tmp_path, wrong_clock(hours), transfers_on_nodes=True) as made:
        resources = Resources(cores=1, memory_bytes=200_000_000, disk_bytes=50_000_000, time_s=60)
        ids = made.launch(ActionDefinition(name="copy", script=_SCRIPT, resources=resources))
        wait_until(lambda: made.active() == 0, "the runs to end", timeout_s=100)
        for run in map(made.client.runs.get, ids):
            assert (run.state.value, run.message, run.problems, run.artifact_count) == ("done", "", [], 1)
            assert run.placement is not None
            assert run.placement.queued_s is not None
            assert run.placement.queued_s < 100
            assert run.started_at is not None
            assert run.ended_at is not None
            assert began < run.started_at < run.ended_at < datetime.datetime.now(datetime.timezone.utc)
