"""Point-in-time recovery by PostgreSQL's own means, and what is then consistent between database and store.

As on the page `docs/operating.md`: a base backup, archived log, and a target time.
"""

import contextlib
import datetime
import os
import shutil
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import psycopg
import pytest

from kleinkram.server.migrations.migrate import migrate
from kleinkram.standalone import postgres as pg
from kleinkram.standalone import processes
from tests.integration.api_server import Api, serving
from tests.integration.jobs import run_jobs
from tests.integration.upload_client import fetch, upload, wait_until
from tests.ports import choose_port
from tests.services import RunningStore, fast_folder

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]


@dataclass(frozen=True)
class _Postgres:
    """A PostgreSQL of this test; `archive` receives its log."""

    cluster: pg.PostgresCluster
    archive: Path

    @contextmanager
    def running(self, **settings: str) -> Iterator[None]:
        process = pg.start(self.cluster, extra={"fsync": "off", "max_connections": "100", **settings})
        try:
            wait_until(lambda: pg.is_ready(self.cluster, process), limit_s=120)
            yield
        finally:
            processes.stop(process, sign=signal.SIGINT, timeout_s=60)

    def execute(self, statement: str, database: str = pg.DATABASE) -> list[tuple[Any, ...]]:
        with psycopg.connect(self.cluster.url(pg.ADMIN, database), autocommit=True) as connection:
            cursor = connection.execute(statement)
            return cursor.fetchall() if cursor.description else []

    def back_up(self, folder: Path) -> None:
        """Make a base backup. Source: PostgreSQL manual, "Making a Base Backup Using the Low Level API"."""
        with psycopg.connect(self.cluster.url(pg.ADMIN), autocommit=True) as connection:
            connection.execute("SELECT pg_backup_start('base', fast => true)")
            _copy(self.cluster.folder, folder)
            (label,) = connection.execute("SELECT labelfile FROM pg_backup_stop()").fetchone() or ("",)
        (folder / "backup_label").write_text(label)

    def archive_all(self) -> None:
        """Wait until everything so far is in the archive."""
        (segment,) = self.execute("SELECT pg_walfile_name(pg_switch_wal())")[0]
        wait_until(lambda: (self.archive / segment).exists(), limit_s=60)


def _copy(source: Path, target: Path) -> None:
    """Copy a running cluster: files may vanish meanwhile, and the log comes from the archive."""
    for folder, _, names in os.walk(source):
        copy = target / Path(folder).relative_to(source)
        copy.mkdir(mode=0o700)
        if copy.relative_to(target).parts[:1] == ("pg_wal",):
            continue
        for name in names:
            with contextlib.suppress(FileNotFoundError):
                if name != "postmaster.pid":
                    shutil.copy2(Path(folder) / name, copy / name)


@pytest.fixture(name="postgres_of_test")
def _postgres_of_test(tmp_path: Path) -> Iterator[_Postgres]:
    base = Path(fast_folder() or tmp_path) / f"klein-pitr-{os.getpid()}"
    archive = base / "archive"
    archive.mkdir(parents=True)
    cluster = pg.PostgresCluster(
        binaries=pg.locate_postgres(),
        data_dir=base,
        folder=base / "postgres",
        log=base / "postgres.log",
        port=choose_port(),
        passwords={pg.ADMIN: "admin", pg.MIGRATE: "migrate", pg.SERVE: "serve"},
    )
    try:
        pg.initialise(cluster)
        yield _Postgres(cluster, archive)
    finally:
        shutil.rmtree(base, ignore_errors=True)


@contextmanager
def _api(postgres: _Postgres, store: RunningStore, bucket: str, folder: Path) -> Iterator[Api]:
    settings: dict[str, Any] = {
        "database_url": postgres.cluster.url(pg.SERVE),
        "s3_internal_url": store.endpoint,
        "s3_bucket": bucket,
        "s3_region": store.region,
        "s3_access_key": store.access_key,
        "s3_secret_key": store.secret_key,
        "scrub_hours": 0,
        "package_index": "off",
    }
    with serving(settings, admin_url=postgres.cluster.url(pg.MIGRATE), folder=folder) as api:
        yield api


def test_a_moment_between_two_uploads_returns(postgres_of_test: _Postgres, store: RunningStore, tmp_path: Path) -> None:
    first, bucket = postgres_of_test, store.create_bucket()
    archiving = {"archive_mode": "on", "archive_command": f"cp %p {first.archive}/%f"}
    base = first.cluster.data_dir / "base"
    with first.running(**archiving):
        pg.prepare_database(first.cluster)
        migrate(first.cluster.url(pg.MIGRATE).replace("://", "+psycopg://", 1), pg.SERVE)
        first.back_up(base)
        with _api(first, store, bucket, tmp_path) as api:
            mission = api.mission(api.project()["id"])["id"]
            first_file = upload(api, mission, "kept.bin", b"kept")
            (moment,) = first.execute("SELECT clock_timestamp()")[0]
            upload(api, mission, "later.bin", b"later")
            api.delete(f"/files/{first_file['id']}").ok()
            first.archive_all()
    second = replace(first, cluster=replace(first.cluster, folder=base, port=choose_port()))
    (base / "recovery.signal").touch()
    with second.running(**_recovery(first.archive, moment)), _api(second, store, bucket, tmp_path) as api:
        files = api.all("/files", {"mission_id": mission})
        assert [item["path"] for item in files] == ["kept.bin"], "what was deleted later is back"
        (link,) = api.post("/files/download", {"file_ids": [first_file["id"]]}).ok()["items"]
        assert fetch(link["url"]) == (200, b"kept")
        api.post("/admin/scrub", {}).ok(202)
        run_jobs(api)
        last = api.get("/admin/scrub").ok()["last"]
        assert last["ended_at"] is not None, last
        assert (last["lost"], last["corrupt"]) == (0, 0), last
        upload(api, mission, "later.bin", b"later")
        run_jobs(api)
        assert {item["state"] for item in api.all("/files", {"mission_id": mission})} == {"verified"}


def _recovery(archive: Path, moment: datetime.datetime) -> dict[str, str]:
    return {
        "restore_command": f"cp {archive}/%f %p",
        "recovery_target_time": moment.isoformat(),
        "recovery_target_action": "promote",
    }
