"""Processes of the Helm chart, run with the command, environment, secrets, user and restrictions of their containers.

The restrictions are those of the systemd units, which are at least as strict as a container's. Memory is not limited.
"""

import os
import re
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
import urllib3

from tests.integration.deploy.chart import MINIMAL, SECRETS, Chart, Manifest, merged, render, secret_files, variables
from tests.integration.deploy.units import ROOT, clean_environment, load_unit
from tests.integration.upload_client import wait_until
from tests.ports import choose_port
from tests.requirements import missing
from tests.services import RunningPostgres, RunningStore, fast_folder

pytestmark = pytest.mark.slow
_UID = 10001
_HTTP = urllib3.PoolManager(retries=False, timeout=10)


@dataclass(frozen=True)
class Node:
    """Runs containers as a node does, with secrets and backups in `folder`. `places`: texts to replace."""

    folder: Path
    chart: Chart
    places: Mapping[str, str]
    api_port: int

    def run(self, name: str) -> str:
        """Run the containers of a pod to their end, one after the other; return what they print."""
        output = ""
        for container in self._containers(name):
            done = subprocess.run(
                self._command(container),
                env=self._environment(container, choose_port()),
                cwd=ROOT,
                check=False,
                capture_output=True,
                text=True,
                timeout=100,
            )
            output += done.stdout + done.stderr
            assert done.returncode == 0, output
        return output

    @contextmanager
    def running(self, name: str) -> Iterator[Mapping[str, str]]:
        """Run the container of a pod until it is stopped; yields its probes' URLs once it has started."""
        (container,) = self._containers(name)
        metrics_port = choose_port()
        ports = {"http": self.api_port, "metrics": metrics_port}
        probes = {key: container[key]["httpGet"] for key in ("startupProbe", "readinessProbe", "livenessProbe")}
        urls = {key: f"http://127.0.0.1:{ports[probe['port']]}{probe['path']}" for key, probe in probes.items()}
        log = self.folder / f"{name}.log"
        with log.open("wb") as file:
            process = subprocess.Popen(
                self._command(container),
                env=self._environment(container, metrics_port),
                cwd=ROOT,
                stdout=file,
                stderr=file,
            )
        try:
            wait_until(lambda: process.poll() is not None or _answers(urls["startupProbe"]), limit_s=60)
            assert process.poll() is None, log.read_text()[-4000:]
            yield urls
            process.terminate()
            assert process.wait(30) in {0, -signal.SIGTERM}
        finally:
            process.kill()
            process.wait()

    def _containers(self, name: str) -> list[Manifest]:
        spec = self.chart.pods()[name]["spec"]
        return [*spec.get("initContainers", ()), *spec["containers"]]

    def _command(self, container: Manifest) -> list[str]:
        words = [self._placed(word) for word in container["command"]]
        unit = load_unit("kleinkram-worker@1.service")
        strict = unit.restrictions(shown=[self.folder, ROOT], writable=[self.folder / "backups"], uid=_UID)
        return replace(strict, proc_options="", denies_write_execute=False, limits={}).command(*words)

    def _environment(self, container: Manifest, metrics_port: int) -> dict[str, str]:
        own = {name: self._placed(value) for name, value in variables(container).items()}
        # The image's PATH has its programs first.
        path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
        return {**clean_environment(), **own, "PATH": path, "KLEINKRAM_METRICS_PORT": str(metrics_port)}

    def _placed(self, text: str) -> str:
        for old, new in self.places.items():
            text = text.replace(old, new)
        return text


@pytest.fixture(scope="module")
def node(postgres: RunningPostgres, store: RunningStore) -> Iterator[Node]:
    if os.geteuid() != 0:
        missing("only root can apply the restrictions of a container")
    database, port = postgres.create_database(), choose_port()
    urls = {"url": postgres.serve_url(database), "migration": postgres.migrate_url(database)}
    passwords = {name: re.sub(r".*://\w+:(\w+)@.*", r"\1", url) for name, url in urls.items()}
    plain = {name: re.sub(r":\w+@", "@", url) for name, url in urls.items()}
    changes = {
        "publicUrl": f"http://127.0.0.1:{port}",
        "listenAddress": "0.0.0.0",
        "database": {"url": plain["url"], "migration": {"url": plain["migration"]}},
        "store": {"url": store.endpoint, "accessKey": store.access_key, "bucket": store.create_bucket()},
        "backup": {"enabled": True, "location": "/backups", "persistentVolumeClaim": "backups", "keep": 1},
    }
    contents = {("database", "serve"): passwords["url"], ("database", "migrate"): passwords["migration"]}
    contents["store", "secret"] = store.secret_key
    with tempfile.TemporaryDirectory(prefix="klein-chart-", dir=fast_folder()) as name:
        folder = Path(name)
        folder.chmod(0o755)
        for part in ("secrets", "backups"):
            (folder / part).mkdir()
        os.chown(folder / "backups", _UID, _UID)
        chart = render(merged(MINIMAL, changes))
        for file, key in secret_files(chart.pods()["backup"]["spec"]).items():
            path = folder / "secrets" / file
            path.write_text(contents[key] + "\n")
            os.chown(path, 0, _UID)
            path.chmod(0o440)
        places = {SECRETS: str(folder / "secrets"), "/backups": str(folder / "backups")}
        places |= {"0.0.0.0": "127.0.0.1", "8000": str(port)}
        yield Node(folder, chart, places, port)
    postgres.drop_database(database)


def test_a_release_migrates_serves_works_checks_and_backs_up(node: Node) -> None:
    node.run("migrate")
    with node.running("api") as api, node.running("worker") as worker:
        assert _HTTP.request("GET", api["readinessProbe"]).status == 200
        for urls in (api, worker):
            assert _HTTP.request("GET", urls["livenessProbe"]).data == b"live\n"
        metrics = _HTTP.request("GET", worker["livenessProbe"].replace("/health/live", "/metrics")).data
        assert b"kleinkram_workers 1.0" in metrics
        report = node.run("check")
        assert "It reads a recording within its limits." in report
        assert "The API answers" in report
        node.run("backup")
        assert [*(node.folder / "backups").iterdir()]


def _answers(url: str) -> bool:
    try:
        return _HTTP.request("GET", url).status == 200
    except urllib3.exceptions.HTTPError:
        return False
