"""Dashboards: each query of metrics returns data of an instance that has been used, when a real Prometheus runs it."""

import json
import re
import time
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import urllib3

from tests.acceptance.conftest import Terminal, wait_until
from tests.integration.deploy import monitoring
from tests.integration.deploy.monitoring import Prometheus
from tests.system.cluster import Cluster

pytestmark = [pytest.mark.slow, pytest.mark.timeout(400)]
_PAGES = sorted((monitoring.FOLDER / "grafana" / "dashboards").glob("*.json"))
_SCRIPT = """
from kleinkram.action import inputs, report
report.check("file.size", "ok" if all(path.stat().st_size for path in inputs()) else "error", "sizes were compared")
"""
_FAILING = "raise SystemExit(3)"
# Grafana replaces these.
_VARIABLES = {"$__rate_interval": "30s", "$__range": "5m"}


@pytest.fixture(scope="module")
def prometheus(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Prometheus]:
    """A Prometheus that has watched how an instance was used."""
    home, folder = tmp_path_factory.mktemp("cluster"), tmp_path_factory.mktemp("prometheus")
    cluster = Cluster(home)
    cluster.settings["DOCKER_HOST"] = f"unix://{home}/nothing"  # without an engine, runs are processes
    cluster.start()
    try:
        ports = json.loads((cluster.data_dir / "ports.json").read_text())
        targets = {name: [ports[f"{name}_metrics"]] for name in ("api", "worker", "runner")}
        with monitoring.prometheus(folder, targets) as running:
            wait_until(lambda: len(running.query("up == 1")) == len(targets), "every process to be scraped")
            _use(cluster)
            yield running
    finally:
        cluster.end()


def _use(cluster: Cluster) -> None:
    """Do what people and programs do: upload, search, download, delete, run, fail, sign in wrongly, back up."""
    klein = cluster.terminal
    klein.run("project", "create", "p")
    klein.run("project", "update", "p", "--quota-bytes", "1GB")
    for number in range(3):
        notes = cluster.home / "drives" / f"drive-{number}" / "notes.txt"
        notes.parent.mkdir(parents=True)
        notes.write_text(f"notes of drive {number // 2}")  # two are the same
    klein.run("upload", "-p", "p", "--mission-per-folder", "--create", "--wait", cluster.home / "drives")
    _run_actions(cluster, klein)
    klein.run("search", "notes")
    klein.run("download", "-p", "p", "-m", "drive-0", "-o", cluster.home / "copy")
    klein.run("mission", "delete", "drive-2", "-p", "p", "--yes")
    klein.run("admin", "scrub")
    klein.run("backup", "create", cluster.home / "backups", "--data-dir", cluster.data_dir)
    for token in ("wrong", f"klein_pat_{uuid.UUID(int=7).hex}"):
        headers = {"Authorization": f"Bearer {token}"}
        urllib3.request("GET", f"http://127.0.0.1:{cluster.port}/api/v1/projects", headers=headers)


def _run_actions(cluster: Cluster, klein: Terminal) -> None:
    for name, script in (("sizes", _SCRIPT), ("failing", _FAILING)):
        (cluster.home / f"{name}.py").write_text(script)
        klein.run("action", "create", cluster.home / f"{name}.py", "-p", "p")
        klein.run("action", "run", name, "-p", "p", "-m", "drive-0", "--wait", code=None)


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
