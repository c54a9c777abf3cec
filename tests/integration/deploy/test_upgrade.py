"""A rolling upgrade behind a proxy under load: this version and the next one side by side, and back.

The next version is a copy of this one with another migration, which names this one as the oldest that works with it.
Every process is a real one. Old processes stay ready. No request may fail, but for few that clients repeat: 503 where
PostgreSQL ends a request that waits for the migration while the migration waits for it, and 502 where a proxy sends a
request on a connection that a stopping API process closes.
"""

import json
import os
import re
import shutil
import threading
import time
import uuid
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
import urllib3

import kleinkram
from kleinkram.server.migrations import HEAD
from tests.integration.deploy.rolling_site import SOURCE, START_S, Site, proxied_site
from tests.integration.next_migration import NEXT, migration_text
from tests.integration.upload_client import crc64, sha256, wait_until
from tests.services import RunningPostgres, RunningStore

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]
_CLIENTS = 20
_NEXT_VERSION = "999.0.0"
# Statuses after which our clients repeat a request.
_REPEATED = (502, 503)
_MAX_REPEATED_SHARE = 0.02


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
            if status >= 400 and status not in _REPEATED:
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
        if answer.status in _REPEATED:
            time.sleep(0.2)
            return self.send(method, url, body, headers)
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


@pytest.fixture(name="next_version")
def _next_version(tmp_path: Path) -> Path:
    """A folder with the package of the next version."""
    package = tmp_path / "next" / "kleinkram"
    shutil.copytree(SOURCE / "kleinkram", package, ignore=shutil.ignore_patterns("__pycache__"))
    _replace(package / "__init__.py", f'__version__ = "{kleinkram.__version__}"', f'__version__ = "{_NEXT_VERSION}"')
    _replace(package / "server" / "migrations" / "__init__.py", f'HEAD = "{HEAD}"', f'HEAD = "{NEXT}"')
    versions = package / "server" / "migrations" / "versions"
    (versions / f"{NEXT}_next.py").write_text(f'{migration_text()}\ncompatible_from = "{HEAD}"\n')
    return package.parent


def _replace(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


@pytest.fixture(name="site", params=["nginx", "caddy"])
def _site(
    request: pytest.FixtureRequest, postgres: RunningPostgres, store: RunningStore, tmp_path: Path
) -> Iterator[Site]:
    database = postgres.create_database()
    settings = {
        "KLEINKRAM_DATABASE_URL": postgres.serve_url(database),
        "KLEINKRAM_MIGRATION_DATABASE_URL": postgres.migrate_url(database),
        "KLEINKRAM_S3_BUCKET": store.create_bucket(),
        "KLEINKRAM_S3_REGION": store.region,
        "KLEINKRAM_S3_ACCESS_KEY": store.access_key,
        "KLEINKRAM_S3_SECRET_KEY": store.secret_key,
    }
    with proxied_site(tmp_path, settings, store=store.endpoint, proxy=request.param) as site:
        yield site
    postgres.drop_database(database)


@contextmanager
def _load(site: Site) -> Iterator[_Load]:
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


def test_no_request_fails_while_the_site_is_upgraded_and_rolled_back(site: Site, next_version: Path) -> None:
    this = SOURCE
    site.run(this, "migrate")
    for name in ("api1", "api2"):
        site.start(name, this, "api")
    site.start("worker", this, "worker")
    wait_until(lambda: site.worker_versions() == {kleinkram.__version__}, limit_s=START_S)
    with _load(site) as load:
        assert NEXT in site.run(next_version, "migrate")
        load.wait_for_files(_CLIENTS)
        assert site.is_ready("api1")
        assert site.is_ready("api2"), "an old API stays ready on the new schema"
        assert site.worker_versions() == {kleinkram.__version__}
        # The order of docs/operating.md: workers, then one API after the other.
        site.start("new worker", next_version, "worker")
        wait_until(lambda: _NEXT_VERSION in site.worker_versions(), limit_s=START_S)
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
    print(f"{load.statuses}, slowest: {load.slowest_s:.1f} s")  # noqa: T201
    assert {*load.statuses} <= {200, 201, *_REPEATED}
    repeated = sum(load.statuses[status] for status in _REPEATED)
    assert repeated <= _MAX_REPEATED_SHARE * sum(load.statuses.values())
    names = {str(row[0]) for row in site.sql("SELECT path FROM file WHERE deleted_at IS NULL")}
    assert names >= load.files.keys()
    unverified = "SELECT count(*) FROM blob WHERE state <> 'verified'"
    wait_until(lambda: site.sql(unverified) == [(0,)], limit_s=180)
    assert site.sql("SELECT count(*) FROM procrastinate_jobs WHERE status = 'failed'") == [(0,)]
    hashes = {
        (str(path), bytes(digest).hex())
        for path, digest in site.sql("SELECT f.path, b.sha256 FROM file f JOIN blob b ON b.id = f.blob_id")
    }
    assert hashes >= {*load.files.items()}
