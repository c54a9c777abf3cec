"""The live log of a run: in order, complete, and without secrets."""

from __future__ import annotations

import pytest

from kleinkram.contract.actions import Network
from kleinkram.contract.runners import LOG_PATH
from kleinkram.contract.runs import EndReason
from tests.integration.runner_loop.conftest import Runners, ended, wait_until
from tests.integration.runner_loop.fake_http import RUN_TOKEN, RUNNER_TOKEN
from tests.integration.runner_loop.fake_server import FakeServer


@pytest.mark.slow
def test_a_log_is_uploaded_while_it_grows(server: FakeServer, runners: Runners) -> None:
    runners.start()
    run = server.launch(
        "import time\nfrom kleinkram.action import progress\n"
        "for n in range(4):\n    progress(n / 4)\n    print('line', n, flush=True)\n    time.sleep(0.6 if n else 5)\n"
    )
    wait_until(lambda: run.shown_log)
    assert run.finishes == []
    ended(run)
    whole = b"line 0\nline 1\nline 2\nline 3\n"
    assert run.artifacts[LOG_PATH] == whole
    assert whole.startswith(run.shown_log)
    assert len(run.segments) <= 4
    assert run.progress
    fractions = [entry.fraction for entry in run.progress]
    assert fractions == sorted(fractions)


def test_secrets_are_redacted(server: FakeServer, runners: Runners) -> None:
    runners.start()
    run = server.launch(
        f"print('mine: {RUN_TOKEN}', 'its: {RUNNER_TOKEN}')\n"
        "print('GET /x?X-Amz-Signature=0123456789abcdef0123456789abcdef&x=1')",
        network=Network.open,
        token=RUN_TOKEN,
    )
    ended(run)
    log = run.artifacts[LOG_PATH].decode()
    assert log == "mine: [redacted] its: [redacted]\nGET /x?X-Amz-Signature=[redacted]&x=1\n"


@pytest.mark.slow
def test_a_large_log_is_complete_after_the_runner_is_killed(server: FakeServer, runners: Runners) -> None:
    count = 600_000
    first = runners.spawn()
    run = server.launch(
        "import sys, time\n"
        f"for n in range({count}):\n"
        "    sys.stdout.write(f'line {n:09} of a flood of words\\n')\n"
        "    if n % 60_000 == 0:\n        sys.stdout.flush(); time.sleep(0.2)\n"
    )
    wait_until(lambda: len(run.segments) >= 2)
    runners.kill(first)
    runners.spawn()
    finish = ended(run).finishes[0]
    assert finish.reason is EndReason.done
    lines = run.artifacts[LOG_PATH].splitlines()
    assert len(lines) == count
    assert lines == [f"line {n:09} of a flood of words".encode() for n in range(count)]
    assert run.artifacts[LOG_PATH].startswith(run.shown_log)
