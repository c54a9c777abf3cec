"""What a machine without room, or without another process, does to a runner: it says so, and goes on."""

from __future__ import annotations

import errno
from pathlib import Path

import pytest

from kleinkram.contract.runs import EndReason, RunState
from kleinkram.runner import held
from kleinkram.runner.process.executor import ProcessExecutor
from kleinkram.runner.work import Work
from tests.integration.runner_loop.conftest import Runners, ended, wait_until
from tests.integration.runner_loop.fake_server import FakeServer

FULL = Path("/dev/full")
LASTING = "import time\ntime.sleep(60)"


def test_beats_go_on_though_the_disk_is_full(
    server: FakeServer, runners: Runners, caplog: pytest.LogCaptureFixture
) -> None:
    runner = runners.start()
    wait_until(lambda: server.hellos)
    (runners.folder / "heard").symlink_to(FULL)
    run = server.launch(LASTING)
    wait_until(lambda: RunState.running in run.states)
    run.is_cancelled = True
    runner._news.set()
    assert ended(run).finishes[0].reason is EndReason.cancelled
    assert caplog.text.count("No space left on device") == 1


class WithoutProcesses(ProcessExecutor):
    """Cannot ask for an end at first, as where the machine gives no process for that."""

    asked = 0

    def stop(self, work: Work) -> None:
        """Ask a run to end."""
        self.asked += 1
        if self.asked < 3:
            raise OSError(errno.EAGAIN, "Resource temporarily unavailable")
        super().stop(work)


def test_an_end_that_cannot_be_asked_for_is_asked_for_again(
    server: FakeServer, runners: Runners, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(held, "_STOP_EVERY_S", 0.05)
    runner = runners.start(WithoutProcesses())
    run = server.launch(LASTING)
    wait_until(lambda: RunState.running in run.states)
    run.is_cancelled = True
    runner._news.set()
    assert ended(run).finishes[0].reason is EndReason.cancelled
    assert caplog.text.count("cannot be ended yet") == 1
