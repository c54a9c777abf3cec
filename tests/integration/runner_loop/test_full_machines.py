"""A machine without disk space or process slots: the runner reports it and continues."""

from __future__ import annotations

import errno
from pathlib import Path

import pytest

from kleinkram.contract.runs import EndReason, RunState
from kleinkram.runner import active_run
from kleinkram.runner.executors import supervision
from kleinkram.runner.executors.base import RunJob
from kleinkram.runner.executors.process import ProcessExecutor
from kleinkram.runner.loop import Runner
from kleinkram.runner.state_directory import Attempt
from tests.integration.runner_loop.conftest import Runners, ended, wait_until
from tests.integration.runner_loop.fake_server import FakeServer
from tests.system.chaos.disks import MIB, need_small_disks, small_disk

FULL = Path("/dev/full")
LASTING = "import time\ntime.sleep(60)"


def _cancel_a_run(server: FakeServer, runner: Runner) -> None:
    run = server.launch(LASTING)
    wait_until(lambda: RunState.running in run.states)
    run.is_cancelled = True
    runner._has_changes.set()
    assert ended(run).finishes[0].reason is EndReason.cancelled


def test_heartbeats_continue_on_a_full_disk(
    server: FakeServer, runners: Runners, caplog: pytest.LogCaptureFixture
) -> None:
    runner = runners.start()
    wait_until(lambda: server.registrations)
    (runners.folder / "last-heartbeat").symlink_to(FULL)
    _cancel_a_run(server, runner)
    assert caplog.text.count("No space left on device") == 1


class WithoutProcesses(ProcessExecutor):
    """An executor that cannot cancel at first, as on a machine without free process slots."""

    requested = 0

    def cancel(self, job: RunJob) -> None:
        """Ask a run to end."""
        self.requested += 1
        if self.requested < 3:
            raise OSError(errno.EAGAIN, "Resource temporarily unavailable")
        super().cancel(job)


def test_a_failed_cancellation_is_repeated(
    server: FakeServer, runners: Runners, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(active_run, "_CANCEL_EVERY_S", 0.05)
    runner = runners.start(WithoutProcesses())
    _cancel_a_run(server, runner)
    assert caplog.text.count("cannot be stopped yet") == 1


def test_a_run_whose_log_fills_the_disk_ends_with_that_reason(
    server: FakeServer, runners: Runners, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun = Attempt.change

    def with_full_files(self: Attempt, **changes: object) -> None:
        begun(self, **changes)
        if changes.get("stage") is RunState.running:
            (self.directory / "log").symlink_to(FULL)
            (self.directory / "usage.json.new").symlink_to(FULL)

    monkeypatch.setattr(Attempt, "change", with_full_files)
    monkeypatch.setattr(ProcessExecutor, "read_log", lambda *_: b"")
    runners.start()
    run = server.launch("import time\nprint('word', flush=True)\ntime.sleep(60)")
    finish = ended(run).finishes[0]
    assert (finish.reason, run.attempt) == (EndReason.disk, 1)
    assert "disk of its runner is full" in finish.message


def test_a_run_whose_ending_cannot_be_recorded_is_not_started_again(
    server: FakeServer, runners: Runners, monkeypatch: pytest.MonkeyPatch
) -> None:
    noted = Attempt.change

    def without_room(self: Attempt, **changes: object) -> None:
        if changes.get("stage") is RunState.collecting:
            raise OSError(errno.ENOSPC, "No space left on device")
        noted(self, **changes)

    monkeypatch.setattr(Attempt, "change", without_room)
    runners.start()
    run = server.launch("print('done')")
    finish = ended(run).finishes[0]
    assert (finish.reason, run.attempt) == (EndReason.disk, 1)
    assert "disk of its runner is full" in finish.problems[0]
    wait_until(lambda: not [*runners.folder.glob("runs/*")])


def test_reserved_files_can_be_written_on_a_full_disk(tmp_path: Path) -> None:
    need_small_disks()
    with small_disk(tmp_path, MIB) as disk:
        ending, lease = disk.path("ending.json"), disk.path("lease")
        supervision.reserve(ending)
        supervision.write_in_place(lease, "1.5")
        disk.fill()
        with pytest.raises(OSError, match="No space left"):
            supervision.write_atomically(disk.path("other.json"), '{"reason": "done"}')
        supervision.write_atomically(ending, '{"reason": "done"}')
        supervision.write_in_place(lease, "12.25")
        assert ending.read_text() == '{"reason": "done"}'
        assert float(lease.read_text()) == 12.25
