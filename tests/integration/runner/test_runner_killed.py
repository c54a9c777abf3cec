"""A runner that is killed while it starts a run, or removes one: the next goes on with it, and never with two."""

from __future__ import annotations

import contextlib
import shutil
import time
from pathlib import Path
from typing import IO

import pytest

from kleinkram.contract.runs import EndReason
from kleinkram.runner import attempts, ward, wardens
from kleinkram.runner.work import Work
from tests.integration.runner.conftest import EVERYWHERE, Bench, log_of
from tests.integration.runner.test_executors import LASTING, until_said


def wardens_of(work: Work) -> list[str]:
    """Return the command lines of the wardens of a run that have not ended."""
    found = []
    for each in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):
            words = each.read_bytes().decode().split("\0")
            if str(work.folder) in words and any("warden" in word for word in words):
                found.append(f"{each.parent.name}: {' '.join(words)}")
    return found


class Killed(BaseException):
    """What ends a runner in the middle of a line."""


@EVERYWHERE
def test_a_runner_killed_before_it_noted_its_warden_leaves_no_run_behind(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The next one starts the run anew in the same folder: two of them there would spoil each other's results."""
    work = bench.work("print('once')")

    def die_late(*_: object) -> None:
        until = time.monotonic() + 1
        while not (work.folder / "ending.json").exists() and time.monotonic() < until:
            time.sleep(0.02)
        raise Killed

    with monkeypatch.context() as patched:
        patched.setattr(ward, "write_whole", die_late)
        with pytest.raises(Killed):
            bench.executor.start(work)
    until = time.monotonic() + 20
    while left := wardens_of(work):
        assert time.monotonic() < until, f"a warden that nobody knows goes on: {left}"
        time.sleep(0.05)
    assert not (work.folder / "ending.json").exists()
    next_one = bench.again()
    ending = next_one.wait(work, timeout_s=40)
    if ending is not None and ending.reason is EndReason.lost:  # of a container, the next warden has begun it
        next_one.start(work)
        ending = next_one.wait(work, timeout_s=40)
    assert ending is not None
    assert (ending.reason, log_of(work)) == (EndReason.done, "once\n")


@EVERYWHERE
def test_a_runner_killed_before_it_heard_that_a_run_began_finds_it_again(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    work = bench.work("print('once')")
    set_going = wardens.Wardens._set_going

    def die(wardens: wardens.Wardens, work: Work, telling: IO[bytes]) -> None:
        set_going(wardens, work, telling)
        raise Killed

    with monkeypatch.context() as patched:
        patched.setattr(wardens.Wardens, "_set_going", die)
        with pytest.raises(Killed):
            bench.executor.start(work)
    ending = bench.again().wait(work, timeout_s=40)
    assert ending is not None
    assert (ending.reason, log_of(work)) == (EndReason.done, "once\n")


@EVERYWHERE
def test_what_was_removed_is_lost_and_may_be_started_again(bench: Bench) -> None:
    """As by Ctrl-C: the next runner begins anew, with the log of before, which is in the store already."""
    work = bench.work(LASTING)
    bench.executor.start(work)
    until_said(bench, LASTING, "ready")
    bench.executor.remove(work)
    next_one = bench.again()
    ending = next_one.wait(work, timeout_s=0)
    assert ending is not None
    assert ending.reason is EndReason.lost
    for path in work.folder.iterdir():
        if path.name not in attempts._KEPT:
            shutil.rmtree(path) if path.is_dir() else path.unlink()
    (work.folder / "in").mkdir()
    next_one.start(work)
    until_said(bench, LASTING, "ready\nready")
    next_one.stop(work)
    ending = next_one.wait(work, timeout_s=40)
    assert ending is not None
    assert ending.reason is EndReason.cancelled
