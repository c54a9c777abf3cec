"""The drill: back up during use and garbage collection, drop the instance, restore, compare everything.

And kill -9 in the middle of backups and restores: the same command continues. A failure names its seed.
"""

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

import psycopg
import pytest

from kleinkram.server.backup import database as backup_database
from kleinkram.server.backup.database import Connection, DatabaseFacts
from kleinkram.server.maintenance import collect_garbage
from kleinkram.server.settings import Settings, plain_dsn
from tests.integration.api_server import Api
from tests.integration.backup.instances import (
    EXCLUDED,
    EmptyInstances,
    back_up,
    comparable_row,
    content_files,
    contents,
    restore_to,
    rows,
    settings_of,
    verify_place,
)
from tests.integration.backup.verification import complaints
from tests.integration.conftest import StartApi
from tests.integration.jobs import on_site
from tests.integration.upload_client import begin, send, upload, upload_all
from tests.services import RunningPostgres

pytestmark = pytest.mark.slow
_RATE_BYTES_PER_S = 4_000_000  # so that it takes a while
_SEED = int(os.environ.get("KLEINKRAM_BACKUP_SEED", "1"))


@pytest.mark.timeout(300)
def test_back_up_under_load_and_restore(
    start_api: StartApi,
    instances: EmptyInstances,
    postgres: RunningPostgres,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    api = start_api(trash_days=0, garbage_grace_s=0)
    mission = api.mission(api.project()["id"])["id"]
    for number in range(3):
        upload(api, mission, f"large {number}", random.Random(number).randbytes(8_000_000))
    small = upload_all(api, mission, {f"small {n}": f"small {n}".encode() for n in range(200)})
    source = settings_of(api)
    seen: dict[str, list[str]] = {}

    database_facts = backup_database.database_facts

    def facts_and_rows(connection: Connection, store_id: str) -> DatabaseFacts:
        """Read all rows of the backup's own moment, in another way than it copies them."""
        facts = database_facts(connection, store_id)
        for table in facts.tables:
            if table not in EXCLUDED:
                rows_of_table = connection.execute(f"SELECT to_jsonb(t) FROM {table} t".encode()).fetchall()
                seen[table] = sorted(comparable_row(table, cast("dict[str, Any]", row[0])) for row in rows_of_table)
        return facts

    monkeypatch.setattr(backup_database, "database_facts", facts_and_rows)
    with at_work(api, mission, [file["id"] for file in small.values()]) as done:
        made = back_up(source, tmp_path, bytes_per_s=_RATE_BYTES_PER_S)
        during = dict(done)
    assert min(during.values()) > 2, f"nothing was done meanwhile: {during}"
    assert made.problems.first == []
    assert rows(source) != seen, "nothing changed meanwhile"
    stated = _recorded_checksums(seen["blob"])
    name = plain_dsn(source.database_url).rpartition("/")[2]
    api.database.close()
    postgres.drop_database(name)  # the instance is lost
    assert verify_place(tmp_path).damage.first == []
    with instances.empty() as target:
        assert restore_to(target, tmp_path).unavailable == []
        assert rows(target) == seen
        restored = contents(target)
        assert {key: restored[key] for key in stated} == stated
        assert complaints(target) == []


@contextmanager
def at_work(api: Api, mission: str, file_ids: list[str]) -> Iterator[dict[str, int]]:
    """Upload, edit, delete and collect garbage in threads until the block ends."""
    over, done = threading.Event(), dict.fromkeys(("uploads", "half uploads", "edits", "deletions", "collections"), 0)
    left = iter(file_ids)

    def half_upload() -> None:
        body = os.urandom(9_000_000)
        [decision] = begin(api, mission, {f"half {uuid.uuid4().hex}": body})
        send(api, decision["upload"], body, only=[1])

    acts: dict[str, Callable[[], Any]] = {
        "uploads": lambda: upload(api, mission, f"new {uuid.uuid4().hex}", os.urandom(5000)),
        "half uploads": half_upload,
        "edits": lambda: api.patch(f"/missions/{mission}", {"notes": uuid.uuid4().hex}).ok(),
        "deletions": lambda: api.delete(f"/files/{next(left)}").ok(),
        "collections": lambda: on_site(api, collect_garbage),
    }
    failures: list[BaseException] = []

    def go_on(what: str) -> None:
        try:
            while not over.is_set():
                acts[what]()
                done[what] += 1
                over.wait(0.5)
        except BaseException as error:
            failures.append(error)

    threads = [threading.Thread(target=go_on, args=(what,)) for what in acts]
    for thread in threads:
        thread.start()
    try:
        yield done
    finally:
        over.set()
        for thread in threads:
            thread.join()
    assert failures == []


def _recorded_checksums(blobs: list[str]) -> dict[str, str]:
    """Return the recorded SHA-256 of all blobs that are not marked for deletion, by key."""
    rows = [json.loads(text) for text in blobs]
    return {row["key"]: row["sha256"].removeprefix("\\x") for row in rows if row["marked_for_deletion_at"] is None}


@pytest.mark.timeout(300)
def test_killed_backups_and_restores_continue(start_api: StartApi, instances: EmptyInstances, tmp_path: Path) -> None:
    _rounds(start_api(), instances, tmp_path, seed=_SEED, count=1)


@pytest.mark.soak
def test_backups_and_restores_killed_many_times_continue(
    start_api: StartApi, instances: EmptyInstances, tmp_path: Path
) -> None:
    for seed in range(_SEED, _SEED + int(os.environ.get("KLEINKRAM_SOAK_ROUNDS", "20"))):
        _rounds(start_api(), instances, tmp_path / str(seed), seed=seed, count=10)


def _rounds(api: Api, instances: EmptyInstances, folder: Path, *, seed: int, count: int) -> None:
    """Kill backups at random moments, then restores; the next one continues, and nothing is damaged."""
    chance = random.Random(seed)
    mission = api.mission(api.project()["id"])["id"]
    for number in range(3):
        upload(api, mission, f"large {number}", chance.randbytes(9_000_000))
    upload_all(api, mission, {f"small {n}": chance.randbytes(2000) for n in range(200)})
    source = settings_of(api)
    place = folder / "backups"
    request = {"command": "create", "location": str(place), "as_json": True, "bytes_per_s": 15e6}
    began = time.monotonic()
    first = _carry_out(request, source, None)
    took_s = time.monotonic() - began  # moments are chosen by this: on a busy machine it begins only after seconds
    assert first["objects"] == 203
    object_count = len(content_files(place))
    for path in content_files(place)[:: 2 if seed % 2 else 3]:  # start again, with some objects present
        path.unlink()
    shutil.rmtree(place / "snapshots")
    for _ in range(count):
        _carry_out(request, source, chance.uniform(0.2, 1) * took_s)
        assert verify_place(place).damage.first == [], f"seed {seed}"
    assert _carry_out(request, source, None)["problems"] == []
    assert verify_place(place).damage.first == []
    assert len(content_files(place)) >= object_count
    request = {"command": "restore", "location": str(place), "as_json": True, "bytes_per_s": 15e6}
    with instances.empty() as target:
        for _ in range(count):
            result = _carry_out(request, target, chance.uniform(0.2, 1.5) * took_s)
            if result is None:
                with psycopg.connect(plain_dsn(target.database_url)) as database:
                    shown = database.execute("SELECT to_regclass('public.file') IS NOT NULL").fetchall()
                if shown == [(True,)]:  # it was complete already
                    assert rows(target) == rows(source), f"seed {seed}"
        if result is None:
            result = _carry_out(request, target, None)
        assert result["problems"] == []
        assert rows(target) == rows(source), f"seed {seed}"
        assert contents(target) == contents(source), f"seed {seed}"


def _carry_out(request: dict[str, object], settings: Settings, kill_after_s: float | None) -> Any:
    """Run a process, killed after a while if it still runs. Returns its result, None if it was killed."""
    values = {
        "DATABASE_URL": plain_dsn(settings.database_url),
        "S3_INTERNAL_URL": settings.s3_internal_url,
        "S3_BUCKET": settings.s3_bucket,
        "S3_ACCESS_KEY": settings.s3_access_key,
        "S3_SECRET_KEY": settings.s3_secret_key.get_secret_value(),
    }
    if settings.migration_database_url is not None:
        values["MIGRATION_DATABASE_URL"] = plain_dsn(settings.migration_database_url)
    environment = {name: value for name, value in os.environ.items() if not name.startswith("KLEINKRAM_")}
    process = subprocess.Popen(
        [sys.executable, "-m", "kleinkram.server.backup", json.dumps(request)],
        env=environment | {f"KLEINKRAM_{name}": value for name, value in values.items()},
        stdout=subprocess.PIPE,
    )
    if kill_after_s is not None:
        deadline = time.monotonic() + kill_after_s
        while process.poll() is None and time.monotonic() < deadline:
            time.sleep(0.01)
        process.kill()
    out, _ = process.communicate()
    if process.returncode == -signal.SIGKILL:
        return None
    if process.returncode == 5 and request["command"] == "restore":  # an earlier one had finished
        return {"problems": []}
    assert process.returncode == 0
    return json.loads(out)
