"""Faults of a server on own parts under twenty clients: each client succeeds, and nothing is lost or duplicated.

PostgreSQL restarts, the store is away, a worker's host is gone, an API process is stopped behind the proxy. Prints a
table of figures (`pytest -s`).
"""

import os
import secrets
import signal
import subprocess
import threading
import time
import uuid
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from kleinkram.client import Client, connect
from kleinkram.client.transfer import plan_upload, upload
from kleinkram.contract.files import FileFilter
from kleinkram.standalone import object_store, processes
from kleinkram.standalone import postgres as pg
from tests.integration.deploy.rolling_site import SOURCE, START_S, Site, proxied_site
from tests.integration.upload_client import wait_until
from tests.ports import choose_port

pytestmark = [pytest.mark.soak, pytest.mark.timeout(900)]
_CLIENTS = 20
_FILE_BYTES = 200_000
_AWAY_S = 10.0


class _Parts:
    """A PostgreSQL and a store of this test, which may be stopped and started."""

    def __init__(self, folder: Path) -> None:
        self.cluster = pg.PostgresCluster(
            binaries=pg.locate_postgres(),
            data_dir=folder,
            folder=folder / "postgres",
            log=folder / "postgres.log",
            port=choose_port(),
            passwords={pg.ADMIN: "admin", pg.MIGRATE: "migrate", pg.SERVE: "serve"},
        )
        self.store = object_store.StoreFolder(
            program=object_store.locate_weed(),
            data_dir=folder,
            folder=folder / "store",
            log=folder / "store.log",
            ports={name: choose_port() for name in object_store.PORT_NAMES},
            access_key=secrets.token_hex(10),
            secret_key=secrets.token_hex(20),
        )
        self.store.folder.mkdir()
        pg.initialise(self.cluster)
        self.start_postgres()
        pg.prepare_database(self.cluster)
        self.start_store()

    def start_postgres(self) -> None:
        """Start PostgreSQL and wait until it is ready."""
        self._postgres = pg.start(self.cluster, extra={"fsync": "off", "max_connections": "200"})
        wait_until(lambda: pg.is_ready(self.cluster, self._postgres), limit_s=START_S)

    def start_store(self) -> None:
        """Start the store and wait until it takes objects."""
        self._store = object_store.start(self.store, extra=["-master.volumeSizeLimitMB=64"])
        wait_until(lambda: object_store.is_ready(self.store.access, object_store.BUCKET), limit_s=START_S)

    def restart_postgres(self) -> None:
        """Restart it as `systemctl restart postgresql` does."""
        processes.stop(self._postgres, sign=signal.SIGINT, timeout_s=60)
        self.start_postgres()

    def interrupt_store(self) -> None:
        """Kill the store, and start it some seconds later."""
        processes.stop(self._store, sign=signal.SIGKILL, timeout_s=10)
        threading.Event().wait(_AWAY_S)
        self.start_store()

    def stop(self) -> None:
        """End both."""
        processes.stop(self._store, sign=signal.SIGKILL, timeout_s=10)
        processes.stop(self._postgres, sign=signal.SIGQUIT, timeout_s=10)
        object_store.remove_sockets(self.store)


@dataclass
class _Figures:
    """Uploads that ended during or after one fault: how many, and the seconds of the longest."""

    uploads: int = 0
    longest_s: float = 0.0


@dataclass
class _Load:
    """What twenty clients do."""

    phase: str = "no fault"
    figures: dict[str, _Figures] = field(default_factory=dict)
    sent: Counter[uuid.UUID] = field(default_factory=Counter)
    is_over: threading.Event = field(default_factory=threading.Event)
    lock: threading.Lock = field(default_factory=threading.Lock)

    def work(self, client: Client, mission_id: uuid.UUID, folder: Path) -> None:
        """Upload files and list them until the load is over."""
        number = 0
        while not self.is_over.is_set():
            number += 1
            file = folder / f"{number}.bin"
            file.write_bytes(os.urandom(_FILE_BYTES))
            start = time.monotonic()
            (result,) = upload(client, mission_id, plan_upload([file])).results
            seconds, phase = time.monotonic() - start, self.phase
            assert result.error is None, f"{phase}: {result}"
            with self.lock:
                figures = self.figures.setdefault(phase, _Figures())
                figures.uploads += 1
                figures.longest_s = max(figures.longest_s, seconds)
                self.sent[mission_id] += 1
            file.unlink()

    def wait_for_each_client(self) -> None:
        """Wait until every client has uploaded a file from now on."""
        before = dict(self.sent)
        wait_until(lambda: all(self.sent[one] > count for one, count in before.items()), limit_s=180)


@contextmanager
def _working(site: Site, folder: Path) -> Iterator[_Load]:
    token = Path(site.settings["KLEINKRAM_OWNER_TOKEN_FILE"]).read_text().strip()
    url, load = site.settings["KLEINKRAM_PUBLIC_URL"], _Load()
    with connect(url, token) as owner:
        project = owner.projects.create("chaos")
        missions = [owner.missions.create(f"client {n}", project=project.id).id for n in range(_CLIENTS)]
    load.sent.update(dict.fromkeys(missions, 0))

    def work(mission_id: uuid.UUID) -> None:
        own = folder / str(mission_id)
        own.mkdir()
        with connect(url, token) as client:
            load.work(client, mission_id, own)

    with ThreadPoolExecutor(_CLIENTS) as threads:
        working = [threads.submit(work, mission_id) for mission_id in missions]
        try:
            load.wait_for_each_client()
            yield load
        finally:
            load.is_over.set()
            for future in working:  # if a client failed, this is the reason of everything else
                future.result(180)
    with connect(url, token) as owner:
        for mission_id in missions:
            listed = [*owner.files.list(FileFilter(mission_id=mission_id))]
            assert len(listed) == load.sent[mission_id], "each file is there once"


@pytest.fixture(name="parts")
def _parts(tmp_path: Path) -> Iterator[_Parts]:
    folder = tmp_path / "parts"
    folder.mkdir(mode=0o755)
    parts = _Parts(folder)
    yield parts
    parts.stop()


@pytest.fixture(name="site")
def _site(parts: _Parts, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Site]:
    assert object_store.create_bucket(parts.store.access, "chaos")
    settings = {
        "KLEINKRAM_DATABASE_URL": parts.cluster.url(pg.SERVE),
        "KLEINKRAM_MIGRATION_DATABASE_URL": parts.cluster.url(pg.MIGRATE),
        "KLEINKRAM_S3_BUCKET": "chaos",
        "KLEINKRAM_S3_REGION": parts.store.access.region,
        "KLEINKRAM_S3_ACCESS_KEY": parts.store.access_key,
        "KLEINKRAM_S3_SECRET_KEY": parts.store.secret_key,
        "KLEINKRAM_UPLOAD_LEASE_S": "5",
    }
    with proxied_site(tmp_path, settings, store=parts.store.access.endpoint, proxy="caddy") as site:
        monkeypatch.setenv("SSL_CERT_FILE", str(tmp_path / "cert.pem"))
        site.run(SOURCE, "migrate")
        for name in ("api1", "api2"):
            site.start(name, SOURCE, "api")
        for name in ("worker", "worker of another host"):
            site.start(name, SOURCE, "worker")
        yield site


def _drain_api(site: Site) -> None:
    site.stop("api1")
    site.start("api1", SOURCE, "api")


def _lose_worker(site: Site) -> None:
    process: subprocess.Popen[bytes] = site.processes.pop("worker of another host")
    process.kill()
    process.wait()


def test_twenty_clients_succeed_through_all_faults(site: Site, parts: _Parts, tmp_path: Path) -> None:
    faults: dict[str, Callable[[], None]] = {
        "PostgreSQL restarted": parts.restart_postgres,
        f"store away for {_AWAY_S:.0f} s": parts.interrupt_store,
        "a worker's host gone": lambda: _lose_worker(site),
        "an API process restarted": lambda: _drain_api(site),
    }
    with _working(site, tmp_path) as load:
        load.wait_for_each_client()
        for load.phase, fault in faults.items():
            fault()
            load.wait_for_each_client()
    is_unfinished = "SELECT count(*) FROM blob WHERE state <> 'verified'"
    start = time.monotonic()
    wait_until(lambda: site.sql(is_unfinished) == [(0,)], limit_s=300)
    for phase, figures in load.figures.items():
        print(f"{phase:28} uploads: {figures.uploads:5}  longest: {figures.longest_s:5.1f} s")  # noqa: T201
    print(f"all verified {time.monotonic() - start:.0f} s after the last upload")  # noqa: T201
    duplicates = "SELECT mission_id, path FROM file WHERE deleted_at IS NULL GROUP BY 1, 2 HAVING count(*) > 1"
    assert site.sql(duplicates) == []
    assert site.sql("SELECT count(*) FROM procrastinate_jobs WHERE status = 'failed'") == [(0,)]
    assert {*load.figures} == {"no fault", *faults}
