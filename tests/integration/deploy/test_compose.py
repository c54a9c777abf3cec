"""The Compose project, started for real: claim, upload, verify, kill, back up, watch, upgrade."""

import hashlib
import json
import os
import re
import signal
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import datetime
from functools import partial
from pathlib import Path
from urllib.parse import urlencode

import pytest
import urllib3

from tests.integration.deploy import images, monitors
from tests.integration.deploy.compose import NETWORK, Project, initialise, project
from tests.integration.runner import engines
from tests.integration.runner.engines import Dockerd
from tests.integration.upload_client import wait_until
from tests.requirements import missing, need, need_compose

# Building the base and the images takes minutes.
pytestmark = [pytest.mark.soak, pytest.mark.timeout(900)]
_PASSWORD = "correct horse battery"
_SERVICES = ("postgres", "store", "api-1", "api-2", "worker", "proxy", "backup")
_SERVER_SERVICES = ("api-1", "api-2", "worker", "backup")
# Not every machine of tests shares the mounts of its root. The socket is that of the daemon for tests: where this
# machine has none, Docker would make a directory of that name.
_OVERRIDE = """\
services:
  node: {volumes: !override ["/:/host:ro"]}
  alloy: {volumes: ["SOCKET:/var/run/docker.sock:ro"]}
"""
_QUERY = "import sys, urllib.request as r; print(r.urlopen(sys.argv[1]).read().decode())"


@dataclass
class Site:
    """A running project with its first admin, and the SHA-256 of the file in each mission."""

    project: Project
    token: str
    missions: dict[str, str] = field(default_factory=dict)

    def upload(self, mission: str, folder: Path) -> None:
        """Upload a generated recording, and wait until the server has read it."""
        path = folder / f"{mission}.mcap"
        self.project.klein(self.token, "sample", folder / mission, "--size", "20MB", "--format", "mcap")
        (recording,) = (folder / mission).rglob("*.mcap")
        recording.rename(path)
        self.project.klein(self.token, "upload", "-p", "lab", "-m", mission, "--create", "--wait", path)
        self.missions[mission] = hashlib.sha256(path.read_bytes()).hexdigest()

    def check_files(self, folder: Path) -> None:
        """Download and compare every file."""
        for mission, expected in self.missions.items():
            target = folder / f"back-{mission}"
            self.project.klein(self.token, "download", "-p", "lab", "-m", mission, "-o", target)
            (path,) = target.rglob("*.mcap")
            assert hashlib.sha256(path.read_bytes()).hexdigest() == expected


@pytest.fixture(scope="module")
def docker() -> Iterator[Dockerd]:
    """An engine with all images."""
    if os.geteuid() != 0:
        missing("a Docker for tests needs root")
    need(*engines.PROGRAMS, "debootstrap", *(it.program for it in images.MONITORS.values() if it.program))
    need_compose()
    with engines.bridge() as (name, gateway), engines.dockerd(name, gateway) as docker:
        images.load_base(docker)
        images.build(docker, "server", images.SERVER)
        images.build_next(docker)
        images.build_substitutes(docker)
        images.build_monitors(docker)
        yield docker


@pytest.fixture(scope="module")
def site(docker: Dockerd, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    """A project that has been started and claimed as docs say."""
    with project(docker, tmp_path_factory.mktemp("compose")) as started:
        started.compose("up", "--detach", "--wait")
        site = Site(started, _claim(started))
        started.klein(site.token, "project", "create", "lab")
        yield site


@pytest.fixture(scope="module")
def receiver(site: Site) -> Iterator[monitors.Receiver]:
    """What gets the alerts of the profile `observability`, which is started. Alerts fire after seconds."""
    folder = site.project.folder
    rules = folder.parent / "observability" / "prometheus" / "rules.yml"
    rules.write_text(re.sub(r"for: \d+[mhd]", "for: 5s", rules.read_text()))
    # No container reaches the public address, which is of this machine alone.
    (folder / "targets" / "public.yml").write_text('- targets: ["http://api-1:8000/health/ready"]\n')
    (folder / "compose.override.yaml").write_text(_OVERRIDE.replace("SOCKET", str(site.project.docker.socket)))
    site.project.change(COMPOSE_PROFILES="observability")
    with monitors.receiving(f"{NETWORK}.1") as receiver:
        monitors.save_yaml(folder / "alertmanager.yml", monitors.alertmanager_config(receiver))
        site.project.compose("up", "--detach", "--wait")
        yield receiver


def _claim(project: Project) -> str:
    """Become the first admin; return a token."""
    (code, *_) = re.findall(r"bootstrap code: ([\w-]+)", project.logs("api-1"))
    account = {"code": code, "name": "Ada", "email": "ada@lab.example", "password": _PASSWORD}
    answer = project.request("POST", "/api/v1/auth/bootstrap", account)
    assert answer.status == 200, answer.data
    cookies = "; ".join(line.split(";")[0] for line in answer.headers.getlist("set-cookie"))
    answer = project.request("POST", "/api/v1/tokens", {"name": "test"}, {"Cookie": cookies})
    assert answer.status == 201, answer.data
    return str(answer.json()["secret"])


def test_containers_have_no_rights_and_read_only_files(site: Site) -> None:
    for service in _SERVICES:
        host = site.project.inspect(service)["HostConfig"]
        assert (host["ReadonlyRootfs"], host["CapDrop"]) == (True, ["ALL"]), service
        assert "no-new-privileges:true" in host["SecurityOpt"]
    for service in _SERVER_SERVICES:
        status = site.project.compose("exec", service, "cat", "/proc/self/status")
        assert re.search(r"Uid:\s+10001\b", status)
        assert re.search(r"CapBnd:\s+0+\n", status), "no capability can be gained"


def test_no_secret_is_in_the_environment(site: Site) -> None:
    secrets = (site.project.folder / "secrets").iterdir()
    # The password for mail is empty at first.
    values = [path.read_text() for path in secrets if path.suffix != ".json" and path.stat().st_size]
    for service in _SERVICES:
        environment = "\n".join(site.project.inspect(service)["Config"]["Env"])
        assert not [value for value in values if value in environment], service


def test_check_finds_no_problem(site: Site) -> None:
    report = site.project.compose("run", "--rm", "--no-deps", "backup", "check")
    assert "kleinkram_serve cannot change the schema." in report


def test_metrics_are_not_public(site: Site) -> None:
    assert site.project.request("GET", "/metrics").status == 404
    inside = "import urllib.request as r; print(r.urlopen('http://api-1:9100/metrics').read().decode())"
    assert "kleinkram_" in site.project.compose("exec", "api-2", "python", "-c", inside)


def test_a_recording_is_uploaded_read_verified_and_downloaded(site: Site, tmp_path: Path) -> None:
    site.upload("drive", tmp_path)
    site.project.klein(site.token, "verify", "--remote", "-p", "lab", "-m", "drive")
    site.check_files(tmp_path)


def test_processes_that_are_killed_start_again(site: Site, tmp_path: Path) -> None:
    killed = ("postgres", "store", "api-1", "worker", "proxy")
    for service in killed:
        pid = site.project.inspect(service)["State"]["Pid"]
        assert pid > 0, f"{service} does not run; 0 would be the processes of this test"
        os.kill(pid, signal.SIGKILL)
    wait_until(lambda: all(site.project.inspect(service)["RestartCount"] for service in killed), limit_s=60)
    for service in ("postgres", "api-1", "worker"):
        wait_until(partial(_is_healthy, site.project, service), limit_s=120)
    wait_until(lambda: _is_ready(site.project), limit_s=60)
    site.check_files(tmp_path)
    site.upload("after-kills", tmp_path)


def test_the_project_keeps_its_data_when_it_is_taken_down(site: Site, tmp_path: Path) -> None:
    site.project.compose("down", "--timeout", "20")
    site.project.compose("up", "--detach", "--wait")
    site.check_files(tmp_path)


def test_a_backup_is_made_and_verified(site: Site) -> None:
    report = site.project.compose("exec", "backup", "kleinkram", "backup")
    assert "No damage found." in report
    assert [*(site.project.folder / "backups").iterdir()]
    assert _is_healthy(site.project, "backup")


@pytest.mark.parametrize("service", images.MONITORS)
def test_monitors_read_their_files_and_write_their_data(site: Site, receiver: monitors.Receiver, service: str) -> None:
    mounts = site.project.inspect(service)["Mounts"]
    others = ("/host", "/var/run/docker.sock")
    files = [it["Destination"] for it in mounts if it["Type"] == "bind" and it["Destination"] not in others]
    directories = [it["Destination"] for it in mounts if it["Type"] == "volume"]
    for name in files:
        site.project.compose("exec", service, "find", name, "-type", "f", "-exec", "cat", "{}", "+")
    for name in directories:
        site.project.compose("exec", service, "touch", f"{name}/test")


def test_prometheus_scrapes_every_process(site: Site, receiver: monitors.Receiver) -> None:
    jobs = {"kleinkram-api": 2, "kleinkram-worker": 1, "kleinkram-public": 1, "node": 1}
    wait_until(lambda: _query(site.project, "sum by (job) (up)") == jobs, limit_s=60)
    assert _query(site.project, "sum by (job) (probe_success)") == {"kleinkram-public": 1}
    assert _query(site.project, 'count by (job) (node_filesystem_size_bytes{mountpoint="/"})')["node"] >= 1


def test_an_alert_arrives(site: Site, receiver: monitors.Receiver) -> None:
    site.project.compose("stop", "worker")
    alert = receiver.wait_for("KleinkramNoWorker", "firing", limit_s=150)
    assert alert["labels"]["severity"] == "critical"
    site.project.compose("up", "--detach", "--wait", "worker")


def test_an_upgrade_fails_no_request(site: Site, tmp_path: Path) -> None:
    assert site.project.request("GET", "/health/ready").status == 200
    with _load(site) as answers:
        site.project.change(SERVER_IMAGE=images.NEXT)
        site.project.compose("run", "--rm", "migrate")
        assert _schema(site.project) == images.NEXT_HEAD
        for service in ("api-1", "api-2"):
            site.project.compose("up", "--detach", "--no-deps", "--wait", service)
        site.project.compose("up", "--detach", "--wait")
    assert set(answers) == {200}, answers
    assert sum(answers.values()) > 20
    assert site.project.inspect("worker")["Config"]["Image"] == images.NEXT
    site.check_files(tmp_path)
    site.upload("after-the-upgrade", tmp_path)


def test_prometheus_scrapes_the_processes_of_the_upgrade(site: Site, receiver: monitors.Receiver) -> None:
    started = datetime.fromisoformat(site.project.inspect("api-1")["State"]["StartedAt"][:19] + "+00:00")
    query = f'sum by (job) (process_start_time_seconds{{job=~"kleinkram-.*"}} >= bool {started.timestamp() - 1})'
    wait_until(lambda: _query(site.project, query) == {"kleinkram-api": 2, "kleinkram-worker": 1}, limit_s=60)


def test_secrets_are_rotated(site: Site, tmp_path: Path) -> None:
    secrets = site.project.folder / "secrets"
    for name in ("s3-secret-key", "store-identities.json", "database-password"):
        (secrets / name).unlink()
    initialise(site.project.folder, "localhost")
    command = f"ALTER ROLE kleinkram_serve PASSWORD '{(secrets / 'database-password').read_text()}'"
    site.project.compose("exec", "postgres", "psql", "--username", "postgres", "--command", command)
    services = ("store", "api-1", "api-2", "worker", "backup")
    site.project.compose("up", "--detach", "--wait", "--force-recreate", *services)
    site.check_files(tmp_path)
    site.upload("after-the-rotation", tmp_path)


def test_a_wrong_secret_is_named(site: Site) -> None:
    secret = site.project.folder / "secrets" / "s3-secret-key"
    right = secret.read_text()
    secret.write_text("wrong")
    try:
        report = site.project.compose("run", "--rm", "--no-deps", "backup", "check", check=False)
    finally:
        secret.write_text(right)
    assert "the secret key does not fit the access key" in report


def _query(project: Project, expression: str) -> dict[str, float]:
    """Return the values of a query of Prometheus by job; none if it does not answer."""
    url = f"http://127.0.0.1:9090/api/v1/query?{urlencode({'query': expression})}"
    answer = project.compose("exec", "watch", "python", "-c", _QUERY, url, check=False)
    series = json.loads(answer)["data"]["result"] if answer else []
    return {it["metric"]["job"]: float(it["value"][1]) for it in series}


def _is_healthy(project: Project, service: str) -> bool:
    return bool(project.inspect(service)["State"]["Health"]["Status"] == "healthy")


def _is_ready(project: Project) -> bool:
    try:
        return bool(project.request("GET", "/health/ready").status == 200)
    except urllib3.exceptions.HTTPError:
        return False


def _schema(project: Project) -> str:
    query = "SELECT version_num FROM alembic_version"
    words = ("exec", "postgres", "psql", "--username", "postgres", "--dbname", "kleinkram", "-Atc", query)
    return project.compose(*words).strip()


@contextmanager
def _load(site: Site) -> Iterator[Counter[int]]:
    """Read lists through the proxy from two threads; yields a count of statuses, 0 for no response."""
    answers, has_ended = Counter[int](), threading.Event()

    def read() -> None:
        headers = {"Authorization": f"Bearer {site.token}"}
        while not has_ended.is_set():
            try:
                answers[site.project.request("GET", "/api/v1/projects", headers=headers).status] += 1
            except urllib3.exceptions.HTTPError:
                answers[0] += 1
            time.sleep(0.1)

    threads = [threading.Thread(target=read) for _ in range(2)]
    for thread in threads:
        thread.start()
    try:
        yield answers
    finally:
        has_ended.set()
        for thread in threads:
            thread.join()
