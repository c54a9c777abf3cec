"""A rolling upgrade behind nginx under load: this version and the next one side by side, and back.

The next version is a copy of this one with another migration, which names this one as the oldest that works with it.
Every process is a real one. No request may fail, and old processes stay ready.
"""

import json
import os
import re
import secrets
import shutil
import signal
import subprocess
import sys
import threading
import time
import uuid
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import psycopg
import pytest
import urllib3

import kleinkram
from kleinkram.server.migrations import HEAD
from tests.certificate import make_certificate
from tests.integration.deploy.proxies import nginx_command, run
from tests.integration.next_migration import NEXT, migration_text
from tests.integration.upload_client import crc64, sha256, wait_until
from tests.ports import choose_port
from tests.services import RunningPostgres, RunningStore

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]
_CLIENTS = 20
_NEXT_VERSION = "999.0.0"
_START_S = 120
_THIS = Path(kleinkram.__file__).parent


@dataclass
class _Load:
    """What clients did: requests by status, failures, files by path, and seconds of the slowest request."""

    statuses: Counter[int] = field(default_factory=Counter)
    failures: list[str] = field(default_factory=list)
    files: dict[str, str] = field(default_factory=dict)
    slowest_s: float = 0.0
    is_over: threading.Event = field(default_factory=threading.Event)
    lock: threading.Lock = field(default_factory=threading.Lock)

    def note(self, what: str, status: int, seconds: float) -> None:
        with self.lock:
            self.statuses[status] += 1
            self.slowest_s = max(self.slowest_s, seconds)
            if status >= 400:
                self.failures.append(f"{what}: {status}")

    def wait_for_files(self, count: int) -> None:
        goal = len(self.files) + count
        wait_until(lambda: len(self.files) >= goal or bool(self.failures), limit_s=120)


@dataclass
class _Client:
    """A client that lists, uploads and downloads by the proxy, without retries."""

    url: str
    token: str
    pool: urllib3.PoolManager
    load: _Load

    def call(self, method: str, path: str, body: object = None) -> Any:
        url = path if path.startswith("https:") else f"{self.url}/api/v1{path}"
        headers = {"Authorization": f"Bearer {self.token}", "Content-Type": "application/json"}
        return json.loads(self.send(method, url, json.dumps(body).encode() if body is not None else None, headers))

    def send(self, method: str, url: str, body: bytes | None, headers: dict[str, str]) -> bytes:
        what, start = f"{method} {re.sub('[?].*', '', url)}", time.monotonic()
        try:
            answer = self.pool.request(method, url, body=body, headers=headers)
        except urllib3.exceptions.HTTPError as error:
            with self.load.lock:
                self.load.failures.append(f"{what}: {error!r}")
            raise
        self.load.note(what, answer.status, time.monotonic() - start)
        return answer.data

    def work(self, mission_id: str) -> None:
        """Upload and download small files until the load is over."""
        while not self.load.is_over.is_set() and not self.load.failures:
            path, body = f"{uuid.uuid4().hex}.bin", os.urandom(1000)
            self.call("GET", "/projects?limit=5")
            file_id = self.upload(mission_id, path, body)
            link = self.call("POST", "/files/download", {"file_ids": [file_id]})["items"][0]["url"]
            assert self.send("GET", link, None, {}) == body
            with self.load.lock:
                self.load.files[path] = sha256(body)

    def upload(self, mission_id: str, path: str, body: bytes) -> str:
        requested = {"files": [{"path": path, "size_bytes": len(body), "sha256": sha256(body)}]}
        upload = self.call("POST", f"/missions/{mission_id}/uploads", requested)["items"][0]["upload"]
        part = {"upload_id": upload["id"], "number": 1, "checksum": crc64(body)}
        signed = self.call("POST", "/uploads/parts", {"parts": [part]})["items"][0]
        self.send("PUT", signed["url"], body, signed["headers"])
        finish = {"upload_id": upload["id"], "sha256": sha256(body), "crc64nvme": crc64(body)}
        outcome = self.call("POST", "/uploads/complete", {"uploads": [finish]})["items"][0]
        assert outcome["outcome"] == "completed", outcome
        return str(outcome["file"]["id"])


@dataclass
class _Site:
    """The machine of a server: its settings, programs of two versions, and what runs."""

    folder: Path
    settings: dict[str, str]
    serve_url: str
    ports: dict[str, int]
    stack: ExitStack
    processes: dict[str, "subprocess.Popen[bytes]"] = field(default_factory=dict)

    def environment(self, source: Path) -> dict[str, str]:
        names = ("PATH", "LANG", "HOME")
        kept = {name: os.environ[name] for name in names if name in os.environ}
        return {**kept, **self.settings, "PYTHONPATH": str(source)}

    def run(self, source: Path, *arguments: str) -> str:
        command = [sys.executable, "-m", "kleinkram.server", *arguments]
        environment = self.environment(source)
        done = subprocess.run(command, env=environment, cwd=self.folder, check=False, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return done.stderr

    def start(self, name: str, source: Path, *arguments: str) -> None:
        """Start an API process (`api1`, `api2`) or worker, and wait until it is ready."""
        command = [sys.executable, "-m", "kleinkram.server", *arguments]
        if name.startswith("api"):
            command += ["--host", "127.0.0.1", "--port", str(self.ports[name])]
        with (self.folder / f"{name}.log").open("ab") as log:
            process = subprocess.Popen(command, env=self.environment(source), cwd=self.folder, stdout=log, stderr=log)
        self.processes[name] = process
        self.stack.callback(process.kill)
        if name.startswith("api"):
            wait_until(lambda: self.is_ready(name), limit_s=_START_S)

    def stop(self, name: str) -> None:
        """Stop a process as systemd does, and wait until it has finished its requests or jobs."""
        process = self.processes.pop(name)
        process.send_signal(signal.SIGTERM)
        assert process.wait(60) == 0, (self.folder / f"{name}.log").read_text()[-3000:]

    def is_ready(self, name: str) -> bool:
        assert self.processes[name].poll() is None, (self.folder / f"{name}.log").read_text()[-3000:]
        try:
            return urllib3.request("GET", f"http://127.0.0.1:{self.ports[name]}/health/ready", retries=False).status == 200
        except urllib3.exceptions.HTTPError:
            return False

    def sql(self, statement: str) -> list[tuple[Any, ...]]:
        with psycopg.connect(self.serve_url) as connection:
            return connection.execute(statement).fetchall()  # type: ignore[arg-type]  # of this file

    def worker_versions(self) -> set[str]:
        alive = "SELECT version FROM worker_process WHERE ended_at IS NULL AND seen_at > now() - interval '15 s'"
        return {str(row[0]) for row in self.sql(alive)}


@pytest.fixture(name="next_version")
def _next_version(tmp_path: Path) -> Path:
    """A folder with the package of the next version."""
    package = tmp_path / "next" / "kleinkram"
    shutil.copytree(_THIS, package, ignore=shutil.ignore_patterns("__pycache__"))
    _replace(package / "__init__.py", f'__version__ = "{kleinkram.__version__}"', f'__version__ = "{_NEXT_VERSION}"')
    _replace(package / "server" / "migrations" / "__init__.py", f'HEAD = "{HEAD}"', f'HEAD = "{NEXT}"')
    versions = package / "server" / "migrations" / "versions"
    (versions / f"{NEXT}_next.py").write_text(f'{migration_text()}\ncompatible_from = "{HEAD}"\n')
    return package.parent


def _replace(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


@pytest.fixture(name="site")
def _site(postgres: RunningPostgres, store: RunningStore, tmp_path: Path) -> Iterator[_Site]:
    database, bucket = postgres.create_database(), store.create_bucket()
    ports = {name: choose_port() for name in ("api1", "api2", "http", "https")}
    certificate, key = make_certificate(tmp_path, "127.0.0.1")
    url = f"https://127.0.0.1:{ports['https']}"
    settings = {
        "KLEINKRAM_DATABASE_URL": postgres.serve_url(database),
        "KLEINKRAM_MIGRATION_DATABASE_URL": postgres.migrate_url(database),
        "KLEINKRAM_S3_INTERNAL_URL": store.endpoint,
        "KLEINKRAM_S3_PUBLIC_URL": url,
        "KLEINKRAM_S3_BUCKET": bucket,
        "KLEINKRAM_S3_REGION": store.region,
        "KLEINKRAM_S3_ACCESS_KEY": store.access_key,
        "KLEINKRAM_S3_SECRET_KEY": store.secret_key,
        "KLEINKRAM_PUBLIC_URL": url,
        "KLEINKRAM_TRUSTED_PROXIES": "127.0.0.1",
        "KLEINKRAM_OWNER_TOKEN_FILE": str(tmp_path / "owner-token"),
        **{f"KLEINKRAM_{kind}_PER_MINUTE": "0" for kind in ("UPLOADS", "DOWNLOADS")},
    }
    Path(settings["KLEINKRAM_OWNER_TOKEN_FILE"]).write_text(secrets.token_hex(32))
    proxy = tmp_path / "proxy"
    proxy.mkdir()
    changes = {
        "127.0.0.1:8000": f"127.0.0.1:{ports['api1']}",
        "127.0.0.1:8001": f"127.0.0.1:{ports['api2']}",
        "127.0.0.1:9000": store.endpoint.removeprefix("http://"),
        "/kleinkram/": f"/{bucket}/",
        "/etc/ssl/kleinkram.pem": str(certificate),
        "/etc/ssl/kleinkram.key": str(key),
    }
    with ExitStack() as stack:
        stack.callback(postgres.drop_database, database)
        nginx = run(nginx_command(proxy, changes, ports), proxy)
        stack.callback(nginx.wait, 30)
        stack.callback(nginx.terminate)
        yield _Site(tmp_path, settings, postgres.serve_url(database), ports, stack)


@contextmanager
def _load(site: _Site) -> Iterator[_Load]:
    """Let clients work until the block ends."""
    load, url = _Load(), site.settings["KLEINKRAM_PUBLIC_URL"]
    token = Path(site.settings["KLEINKRAM_OWNER_TOKEN_FILE"]).read_text()
    pool = urllib3.PoolManager(ca_certs=str(site.folder / "cert.pem"), retries=False, timeout=60, maxsize=_CLIENTS)
    client = _Client(url, token, pool, load)
    project = client.call("POST", "/projects", {"name": "load"})
    missions = [
        client.call("POST", f"/projects/{project['id']}/missions", {"name": f"client {number}"})["id"]
        for number in range(_CLIENTS)
    ]
    with ThreadPoolExecutor(_CLIENTS) as threads:
        working = [threads.submit(client.work, mission_id) for mission_id in missions]
        try:
            load.wait_for_files(_CLIENTS)
            yield load
            load.wait_for_files(2 * _CLIENTS)
        finally:
            load.is_over.set()
        for future in working:
            future.result(120)


def test_no_request_fails_while_the_site_is_upgraded_and_rolled_back(site: _Site, next_version: Path) -> None:
    this = _THIS.parent
    site.run(this, "migrate")
    for name in ("api1", "api2"):
        site.start(name, this, "api")
    site.start("worker", this, "worker")
    wait_until(lambda: site.worker_versions() == {kleinkram.__version__}, limit_s=_START_S)
    with _load(site) as load:
        assert NEXT in site.run(next_version, "migrate")
        load.wait_for_files(_CLIENTS)
        assert site.is_ready("api1")
        assert site.is_ready("api2"), "an old API stays ready on the new schema"
        assert site.worker_versions() == {kleinkram.__version__}
        # The order of docs/operating.md: workers, then one API after the other.
        site.start("new worker", next_version, "worker")
        wait_until(lambda: _NEXT_VERSION in site.worker_versions(), limit_s=_START_S)
        load.wait_for_files(_CLIENTS)
        site.stop("worker")
        for name in ("api1", "api2"):
            site.stop(name)
            load.wait_for_files(_CLIENTS)
            site.start(name, next_version, "api")
            load.wait_for_files(_CLIENTS)
        # Back to the old programs, on the new schema.
        site.stop("new worker")
        site.start("worker", this, "worker")
        for name in ("api1", "api2"):
            site.stop(name)
            site.start(name, this, "api")
            load.wait_for_files(_CLIENTS)
    assert load.failures == []
    assert {*load.statuses} <= {200, 201}
    names = {str(row[0]) for row in site.sql("SELECT path FROM file WHERE deleted_at IS NULL")}
    assert names >= load.files.keys()
    unverified = "SELECT count(*) FROM blob WHERE state <> 'verified'"
    wait_until(lambda: site.sql(unverified) == [(0,)], limit_s=180)
    assert site.sql("SELECT count(*) FROM procrastinate_jobs WHERE status = 'failed'") == [(0,)]
    hashes = {(str(path), bytes(digest).hex()) for path, digest in site.sql(
        "SELECT f.path, b.sha256 FROM file f JOIN blob b ON b.id = f.blob_id"
    )}
    assert hashes >= {*load.files.items()}
