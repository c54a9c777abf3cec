"""Dashboards: each query of metrics returns data of an instance that has been used, when a real Prometheus runs it."""

import json
import re
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import urllib3

from tests.acceptance.conftest import Terminal, wait_until
from tests.integration.deploy import monitors
from tests.integration.deploy.monitors import Prometheus
from tests.ports import choose_port
from tests.system.cluster import Cluster

pytestmark = [pytest.mark.slow, pytest.mark.timeout(400)]
_PAGES = sorted((monitors.FOLDER / "grafana" / "dashboards").glob("*.json"))
_SCRIPT, _FAILING = "print('done')", "raise SystemExit(3)"
# Grafana replaces these.
_VARIABLES = {"$__rate_interval": "30s", "$__range": "5m"}


@pytest.fixture(scope="module")
def prometheus(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Prometheus]:
    """A Prometheus that has watched how an instance was used."""
    cluster, folder = Cluster(tmp_path_factory.mktemp("cluster")), tmp_path_factory.mktemp("prometheus")
    cluster.options = ["--no-runner"]  # one with metrics is started instead
    cluster.start()
    try:
        ports = json.loads((cluster.data_dir / "ports.json").read_text())
        runner_port = choose_port()
        targets = {"api": [ports["api_metrics"]], "worker": [ports["worker_metrics"]], "runner": [runner_port]}
        with _runner(cluster, runner_port), monitors.prometheus(folder, targets) as running:
            wait_until(lambda: len(running.query("up == 1")) == len(targets), "every process to be scraped")
            _use(cluster)
            wait_until(lambda: bool(running.query("kleinkram_files > 0")), "slow gauges to be read")
            yield running
    finally:
        cluster.end()


@contextmanager
def _runner(cluster: Cluster, metrics_port: int) -> Iterator[None]:
    token = cluster.terminal.run("token", "create", "desk", "--kind", "runner", "--json").json()["secret"]
    variables = {
        "KLEINKRAM_RUNNER_TOKEN": token,
        "DOCKER_HOST": f"unix://{cluster.home}/nothing",  # without an engine, runs are processes
    }
    terminal = Terminal(cluster.home, {**cluster.terminal.environment, **variables})
    options = ["--name", "desk", "--metrics-port", metrics_port, "--data-dir", cluster.home / "runner"]
    command = terminal.command("runner", "start", *options, "--cores", 2, "--memory", "4GB", "--disk", "20GB")
    with (cluster.home / "runner.log").open("wb") as log:
        process = subprocess.Popen(command, env=terminal.environment, stdout=log, stderr=log)
    try:
        yield
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(60)


def _use(cluster: Cluster) -> None:
    """Do what people and programs do: upload, search, run, fail, download, delete, scrub, back up, mistype tokens."""
    klein, url = cluster.terminal, f"http://127.0.0.1:{cluster.port}/api/v1"
    klein.run("project", "create", "p")
    klein.run("project", "update", "p", "--quota-bytes", "1GB")
    for number in range(3):
        notes = cluster.home / "drives" / f"drive-{number}" / "notes.txt"
        notes.parent.mkdir(parents=True)
        notes.write_text(f"notes of drive {number // 2}")  # two are the same
    klein.run("upload", "-p", "p", "--mission-per-folder", "--create", "--wait", cluster.home / "drives")
    for name, script, is_good in (("sizes", _SCRIPT, True), ("failing", _FAILING, False)):
        (cluster.home / f"{name}.py").write_text(script)
        klein.run("action", "create", cluster.home / f"{name}.py", "-p", "p")
        for mission in ("drive-0", "drive-1"):  # rates need a second run
            ran = klein.run("action", "run", name, "-p", "p", "-m", mission, "--follow", code=None)
            assert (ran.code == 0) is is_good, ran
    klein.run("search", "notes")
    klein.run("download", "-p", "p", "-m", "drive-0", "--dest", cluster.home / "copy")
    klein.run("mission", "delete", "drive-2", "-p", "p", "--yes")
    klein.run("admin", "scrub")
    klein.run("backup", "create", cluster.home / "backups")
    urllib3.request("GET", f"{url}/projects", headers={"Authorization": "Bearer wrong"})


def _panels(page: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    for panel in json.loads(page.read_text())["panels"]:
        if panel.get("datasource", {}).get("type") == "prometheus":
            yield from ((panel["title"], target) for target in panel["targets"])


@pytest.mark.parametrize("page", _PAGES, ids=lambda page: page.stem)
def test_each_query_returns_data(page: Path, prometheus: Prometheus) -> None:
    empty = {}
    for title, target in _panels(page):
        expression = re.sub(r"\$\w+", lambda match: _VARIABLES[match[0]], target["expr"])
        now = time.time()
        series = prometheus.query_range(expression, start=now - 300, end=now, step_s=5)
        if not any(value != "NaN" for one in series for _, value in one["values"]):
            empty[title] = expression
    assert not empty
