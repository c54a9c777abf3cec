"""Metrics of a runner."""

import socket
import sys
import time
from pathlib import Path

import pytest
import urllib3

from kleinkram import metric_definitions as definitions
from kleinkram.client.errors import InvalidInput
from kleinkram.metric_definitions import MetricSource
from kleinkram.runner.__main__ import _serve_metrics
from kleinkram.runner.arguments import Arguments
from kleinkram.runner.loop import Runner
from kleinkram.runner.metrics_server import serve_metrics
from tests.integration.exposition import assert_accepted_by_promtool, assert_defined, value
from tests.integration.runner_loop.conftest import Runners, ended, wait_until
from tests.integration.runner_loop.fake_server import FakeServer

_CLAIMS, _HEARTBEATS = "/runners/*/claims", "/runners/*/heartbeats"


def _scrape(port: int) -> str:
    return urllib3.request("GET", f"http://127.0.0.1:{port}/metrics", timeout=20).data.decode()


def test_a_runner_exports_every_metric_as_it_is_defined(server: FakeServer, runners: Runners, tmp_path: Path) -> None:
    server.fails = {_CLAIMS: 1, _HEARTBEATS: 1}
    runner = runners.start()
    with serve_metrics(runner, tmp_path, "127.0.0.1", 0) as port:
        first = server.launch("import time\ntime.sleep(1)\n", {"a.bag": b"ten bytes!"})
        wait_until(lambda: value(_scrape(port), definitions.RUNNER_RUNS) == 1)
        during = _scrape(port)
        assert value(during, definitions.RUNNER_CORES, kind="capacity") == 2
        assert 0 < value(during, definitions.RUNNER_CORES, kind="reserved") <= 2
        ended(first)
        ended(server.launch("raise SystemExit(3)\n", {"again.bag": b"ten bytes!", "b.bag": b"five!"}))
        wait_until(lambda: value(_scrape(port), definitions.RUNNER_RUNS) == 0)
        text = _scrape(port)
    assert_defined(text, MetricSource.process, MetricSource.runner)
    for definition, labels, expected in (
        (definitions.RUNNER_RUNS_ENDED, {"state": "done"}, 1),
        (definitions.RUNNER_RUNS_ENDED, {"state": "failed"}, 1),
        (definitions.RUNNER_RUNS_ENDED, {"state": "lost"}, 0),
        (definitions.RUNNER_SERVER_ERRORS, {"request": "claim"}, 1),
        (definitions.RUNNER_SERVER_ERRORS, {"request": "heartbeat"}, 1),
        (definitions.RUNNER_INPUT_BYTES, {"source": "store"}, 15),
        (definitions.RUNNER_INPUT_BYTES, {"source": "cache"}, 10),
        (definitions.RUNNER_CORES, {"kind": "reserved"}, 0),
    ):
        assert value(text, definition, **labels) == expected, (definition.name, labels)
    assert time.time() - value(text, definitions.RUNNER_LAST_CONTACT) < 60


@pytest.mark.slow
def test_promtool_accepts_the_metrics_of_a_runner(runners: Runners, tmp_path: Path) -> None:
    with serve_metrics(runners.start(), tmp_path, "127.0.0.1", 0) as port:
        assert_accepted_by_promtool(_scrape(port))


def test_a_run_that_another_runner_gets_is_lost(server: FakeServer, runners: Runners, tmp_path: Path) -> None:
    runner = runners.start()
    with serve_metrics(runner, tmp_path, "127.0.0.1", 0) as port:
        run = server.launch("import time\ntime.sleep(60)\n")
        wait_until(lambda: run.states)
        run.attempt += 1
        wait_until(lambda: value(_scrape(port), definitions.RUNNER_RUNS_ENDED, state="lost") == 1)


def test_a_port_in_use_is_one_sentence(runners: Runners, tmp_path: Path) -> None:
    runner = runners.start()
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with (
            pytest.raises(InvalidInput, match=f"cannot be served on 127.0.0.1:{port} .Address already in use"),
            serve_metrics(runner, tmp_path, "127.0.0.1", port),
        ):
            pass


def test_without_the_library_the_package_to_install_is_named(
    runners: Runners, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delitem(sys.modules, "kleinkram.runner.metrics_server", raising=False)
    monkeypatch.setitem(sys.modules, "prometheus_client", None)
    arguments = Arguments(url="http://127.0.0.1:1", data_dir=tmp_path, name="a", metrics_port=1)
    runner: Runner = runners.start()
    with pytest.raises(InvalidInput, match=r"pip install 'open-kleinkram\[metrics\]'"):
        _serve_metrics(runner, arguments)
