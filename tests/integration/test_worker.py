"""The worker continues after restarts of PostgreSQL, and no job is lost."""

import contextlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import psycopg
import pytest
import urllib3

from kleinkram.server.migrations.migrate import migrate
from kleinkram.standalone import postgres as pg
from kleinkram.standalone import processes
from tests.integration.upload_client import wait_until
from tests.ports import choose_port
from tests.services import RunningStore

pytestmark = pytest.mark.timeout(400)
_IN_WORKER = "SELECT count(*) FROM procrastinate_workers WHERE last_heartbeat > now() - interval '20 s'"


@dataclass
class _Cluster:
    """A PostgreSQL of a test's own, which it may restart."""

    cluster: pg.PostgresCluster
    process: "subprocess.Popen[bytes]"

    def restart(self, how: signal.Signals) -> None:
        """End it as `pg_ctl stop -m fast` (SIGINT) or `-m immediate` (SIGQUIT) does, and start it again."""
        processes.stop(self.process, sign=how, timeout_s=30)
        self.start()

    def start(self) -> None:
        self.process = pg.start(self.cluster, extra={"fsync": "off"})
        wait_until(lambda: pg.is_ready(self.cluster, self.process), limit_s=120)

    def sql(self, statement: str) -> str:
        return pg.run_sql(self.cluster, statement, database=pg.DATABASE)


@pytest.fixture(scope="module")
def database(tmp_path_factory: pytest.TempPathFactory) -> Iterator[_Cluster]:
    folder = tmp_path_factory.mktemp("pg")
    folder.chmod(0o755)
    passwords = {pg.ADMIN: "admin", pg.MIGRATE: "migrate", pg.SERVE: "serve"}
    cluster = pg.PostgresCluster(
        binaries=pg.locate_postgres(),
        data_dir=folder,
        folder=folder / "postgres",
        log=folder / "postgres.log",
        port=choose_port(),
        passwords=passwords,
    )
    pg.initialise(cluster)
    running = _Cluster(cluster, pg.start(cluster, extra={"fsync": "off"}))
    try:
        wait_until(lambda: pg.is_ready(cluster, running.process), limit_s=120)
        pg.prepare_database(cluster)
        migrate(cluster.url(pg.MIGRATE).replace("://", "+psycopg://", 1), pg.SERVE)
        yield running
    finally:
        processes.stop(running.process, sign=signal.SIGQUIT, timeout_s=10)


@dataclass
class _Worker:
    process: "subprocess.Popen[bytes]"
    log: Path
    metrics_port: int

    def lines(self) -> list[dict[str, object]]:
        return [json.loads(line) for line in self.log.read_text().splitlines()]

    def metrics(self) -> str:
        return urllib3.request("GET", f"http://127.0.0.1:{self.metrics_port}/metrics", timeout=20).data.decode()


@contextlib.contextmanager
def _working(database: _Cluster, store: RunningStore, log: Path) -> Iterator[_Worker]:
    port = choose_port()
    environment = {
        "KLEINKRAM_DATABASE_URL": database.cluster.url(pg.SERVE),
        "KLEINKRAM_S3_INTERNAL_URL": store.endpoint,
        "KLEINKRAM_S3_ACCESS_KEY": store.access_key,
        "KLEINKRAM_S3_SECRET_KEY": store.secret_key,
        "KLEINKRAM_S3_BUCKET": "unused",
        "KLEINKRAM_SCRUB_HOURS": "0",
    }
    with log.open("wb") as file:
        process = subprocess.Popen(
            [sys.executable, "-m", "kleinkram.server", "worker", "--metrics-port", str(port)],
            env={**os.environ, **environment},
            stderr=file,
        )
    try:
        wait_until(lambda: _does_jobs(database), limit_s=120)
        yield _Worker(process, log, port)
    finally:
        process.terminate()
        try:
            process.wait(60)
        finally:
            process.kill()


def _does_jobs(database: _Cluster) -> bool:
    """Whether a worker runs, listening with all its lanes."""
    try:
        return database.sql(_IN_WORKER) >= "4"
    except Exception:
        return False


def _defer(database: _Cluster, task: str) -> str:
    insert = "INSERT INTO procrastinate_jobs (queue_name, task_name, args) VALUES ('default',"
    return database.sql(f"{insert} '{task}', '{{\"timestamp\": 0}}') RETURNING id")


def _is_done(database: _Cluster, job_id: str) -> bool:
    return database.sql(f"SELECT count(*) FROM procrastinate_jobs WHERE id = {job_id}") == "0"


def test_a_worker_outlives_restarts_of_postgresql(database: _Cluster, store: RunningStore, tmp_path: Path) -> None:
    with _working(database, store, tmp_path / "log") as worker:
        for how in (signal.SIGINT, signal.SIGQUIT, signal.SIGQUIT):
            database.restart(how)
            job_id = _defer(database, "maintain_runs")
            wait_until(lambda job_id=job_id: _is_done(database, job_id), limit_s=120)  # type: ignore[misc]  # a default
        # A connection may go by itself, such as the one that a lane listens on.
        database.sql("SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE query LIKE 'LISTEN%'")
        job_id = _defer(database, "maintain_runs")
        wait_until(lambda: _is_done(database, job_id), limit_s=120)
        assert worker.process.poll() is None
        assert database.sql("SELECT count(*) FROM worker_process WHERE ended_at IS NULL") == "1"
        text = worker.metrics()
        assert "kleinkram_workers 1.0" in text
        assert 'kleinkram_job_attempts_total{outcome="succeeded",task="maintain_runs"}' in text
        assert any("the database went away" in str(line["message"]) for line in worker.lines())
    assert worker.process.returncode == 0
    assert database.sql("SELECT count(*) FROM worker_process WHERE ended_at IS NULL") == "0"


def test_a_worker_stops_on_request_while_postgresql_is_unavailable(
    database: _Cluster, store: RunningStore, tmp_path: Path
) -> None:
    with _working(database, store, tmp_path / "log") as worker:
        processes.stop(database.process, sign=signal.SIGQUIT, timeout_s=30)
        try:
            worker.process.terminate()
            assert worker.process.wait(120) == 0
        finally:
            database.start()


@pytest.mark.slow
def test_a_job_interrupted_by_a_restart_runs_again(database: _Cluster, store: RunningStore, tmp_path: Path) -> None:
    with _working(database, store, tmp_path / "log") as worker:
        blocker = psycopg.connect(database.cluster.url(pg.ADMIN))
        blocker.execute("LOCK TABLE run IN ACCESS EXCLUSIVE MODE")
        job_id = _defer(database, "maintain_runs")
        doing = f"SELECT count(*) FROM procrastinate_jobs WHERE id = {job_id} AND status = 'doing'"
        wait_until(lambda: database.sql(doing) == "1", limit_s=60)
        database.restart(signal.SIGQUIT)
        blocker.close()
        wait_until(lambda: _is_done(database, job_id), limit_s=240)
        assert worker.process.poll() is None
        assert database.sql("SELECT count(*) FROM procrastinate_jobs WHERE status = 'failed'") == "0"
