"""What a machine without room, or without another process, does to a runner: it says so, and goes on."""

from __future__ import annotations

import errno
from pathlib import Path

import pytest

from kleinkram.contract.runs import EndReason, RunState
from kleinkram.runner import held, logs, ward
from kleinkram.runner.attempts import Attempt, Stage
from kleinkram.runner.disk import write_over
from kleinkram.runner.process.executor import ProcessExecutor
from kleinkram.runner.runner import Runner
from kleinkram.runner.work import Work
from tests.integration.runner_loop.conftest import Runners, ended, wait_until
from tests.integration.runner_loop.fake_server import FakeServer
from tests.system.chaos.disks import MIB, need_small_disks, small_disk

FULL = Path("/dev/full")
LASTING = "import time\ntime.sleep(60)"


def _cancel_a_run(server: FakeServer, runner: Runner) -> None:
    run = server.launch(LASTING)
    wait_until(lambda: RunState.running in run.states)
    run.is_cancelled = True
    runner._news.set()
    assert ended(run).finishes[0].reason is EndReason.cancelled


def test_beats_go_on_though_the_disk_is_full(
    server: FakeServer, runners: Runners, caplog: pytest.LogCaptureFixture
) -> None:
    runner = runners.start()
    wait_until(lambda: server.hellos)
    (runners.folder / "heard").symlink_to(FULL)
    _cancel_a_run(server, runner)
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
    _cancel_a_run(server, runner)
    assert caplog.text.count("cannot be ended yet") == 1


def test_a_run_whose_log_finds_no_room_ends_with_that(
    server: FakeServer, runners: Runners, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun = Attempt.change

    def with_full_files(self: Attempt, **changes: object) -> None:
        begun(self, **changes)
        if changes.get("stage") is Stage.running:
            (self.folder / "log").symlink_to(FULL)
            (self.folder / "usage.json.new").symlink_to(FULL)

    monkeypatch.setattr(Attempt, "change", with_full_files)
    monkeypatch.setattr(logs, "_read_raw", lambda *_: b"")
    runners.start()
    run = server.launch("import time\nprint('word', flush=True)\ntime.sleep(60)")
    finish = ended(run).finishes[0]
    assert (finish.reason, run.attempt) == (EndReason.disk, 1)
    assert "disk of its runner is full" in finish.message


def test_a_run_that_ends_without_room_to_note_it_is_not_started_again(
    server: FakeServer, runners: Runners, monkeypatch: pytest.MonkeyPatch
) -> None:
    noted = Attempt.change

    def without_room(self: Attempt, **changes: object) -> None:
        if changes.get("stage") is Stage.collecting:
            raise OSError(errno.ENOSPC, "No space left on device")
        noted(self, **changes)

    monkeypatch.setattr(Attempt, "change", without_room)
    runners.start()
    run = server.launch("print('done')")
    finish = ended(run).finishes[0]
    assert (finish.reason, run.attempt) == (EndReason.disk, 1)
    assert "no room" in finish.problems[0]
    wait_until(lambda: not [*runners.folder.glob("runs/*")])


def test_what_was_reserved_is_written_on_a_full_disk(tmp_path: Path) -> None:
    need_small_disks()
    with small_disk(tmp_path, MIB) as disk:
        ending, lease = disk.path("ending.json"), disk.path("held")
        ward.reserve(ending)
        write_over(lease, "1.5")
        disk.fill()
        with pytest.raises(OSError, match="No space left"):
            ward.write_whole(disk.path("other.json"), {"reason": "done"})
        ward.write_whole(ending, {"reason": "done"})
        write_over(lease, "12.25")
        assert ending.read_text() == '{"reason": "done"}'
        assert float(lease.read_text()) == 12.25
