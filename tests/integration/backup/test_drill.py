"""The drill: back up while people work and the sweep runs, lose the site, restore, compare all as of that moment.

And kill -9 in the middle of backups and of restores: the same command again gets there. A failure names its seed.
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
from kleinkram.server.blobs.jobs import collect_garbage
from kleinkram.server.settings import Settings, plain_dsn
from tests.integration.api_server import Api
from tests.integration.backup.sites import (
    LEFT,
    Sites,
    as_kept,
    back_up,
    content_files,
    contents,
    fill,
    look,
    rows,
    settings_of,
)
from tests.integration.backup.verification import complaints
from tests.integration.conftest import StartApi
from tests.integration.jobs import on_site
from tests.integration.upload_client import begin, send, upload, upload_all
from tests.services import RunningPostgres

pytestmark = pytest.mark.slow
_RATE_BYTES_PER_S = 4_000_000  # so that people get something done meanwhile
_SEED = int(os.environ.get("KLEINKRAM_BACKUP_SEED", "1"))


@pytest.mark.timeout(300)
def test_back_up_under_load_and_restore(
    start_api: StartApi,
    sites: Sites,
    postgres: RunningPostgres,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    api = start_api(trash_days=0, sweep_grace_s=0)
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
            if table not in LEFT:
                rows_of_table = connection.execute(f"SELECT to_jsonb(t) FROM {table} t".encode()).fetchall()
                seen[table] = sorted(as_kept(table, cast("dict[str, Any]", row[0])) for row in rows_of_table)
        return facts

    monkeypatch.setattr(backup_database, "database_facts", facts_and_rows)
    with at_work(api, mission, [each["id"] for each in small.values()]) as done:
        made = back_up(source, tmp_path, bytes_per_s=_RATE_BYTES_PER_S)
        during = dict(done)
    assert min(during.values()) > 2, f"people got nothing done meanwhile: {during}"
    assert made.problems.first == []
    assert rows(source) != seen, "nothing changed meanwhile"
    stated = _stated(seen["blob"])
    name = plain_dsn(source.database_url).rpartition("/")[2]
    api.database.close()
    postgres.drop_database(name)  # the site is gone
    assert look(tmp_path).damage.first == []
    with sites.empty() as target:
        assert fill(target, tmp_path).unavailable == []
        assert rows(target) == seen
        found = contents(target)
        assert {key: found[key] for key in stated} == stated
        assert complaints(target) == []


@contextmanager
def at_work(api: Api, mission: str, file_ids: list[str]) -> Iterator[dict[str, int]]:
    """People upload, edit and delete, and the sweep lets go of what they deleted, until the block ends."""
    over, done = threading.Event(), dict.fromkeys(("uploads", "half uploads", "edits", "deletions", "sweeps"), 0)
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
        "sweeps": lambda: on_site(api, collect_garbage),
    }
    failures: list[BaseException] = []

    def go_on(what: str) -> None:
        try:
            while not over.is_set():
                acts[what]()
                done[what] += 1
                over.wait(0.2)
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


def _stated(blobs: list[str]) -> dict[str, str]:
    """What blobs that were not about to go are said to hold, by key."""
    every = [json.loads(each) for each in blobs]
    return {each["key"]: each["sha256"].removeprefix("\\x") for each in every if each["doomed_at"] is None}


@pytest.mark.timeout(300)
def test_killed_anywhere(start_api: StartApi, sites: Sites, tmp_path: Path) -> None:
    _rounds(start_api(), sites, tmp_path, seed=_SEED, count=2)


@pytest.mark.soak
def test_killed_anywhere_often(start_api: StartApi, sites: Sites, tmp_path: Path) -> None:
    for seed in range(_SEED, _SEED + int(os.environ.get("KLEINKRAM_SOAK_ROUNDS", "20"))):
        _rounds(start_api(), sites, tmp_path / str(seed), seed=seed, count=10)


def _rounds(api: Api, sites: Sites, folder: Path, *, seed: int, count: int) -> None:
    """Kill backups at random moments, then restores; each time the next one goes on, and nothing is damaged."""
    chance = random.Random(seed)
    mission = api.mission(api.project()["id"])["id"]
    for number in range(3):
        upload(api, mission, f"large {number}", chance.randbytes(9_000_000))
    upload_all(api, mission, {f"small {n}": chance.randbytes(2000) for n in range(200)})
    source = settings_of(api)
    place = folder / "backups"
    order = {"command": "create", "place": str(place), "as_json": True, "bytes_per_s": 15e6}
    began = time.monotonic()
    first = _carry_out(order, source, None)
    took_s = time.monotonic() - began  # by which moments are chosen: on a busy machine it only begins after seconds
    assert first["objects"] == 203
    held = len(content_files(place))
    for path in content_files(place)[:: 2 if seed % 2 else 3]:  # begin anew, with some of it there
        path.unlink()
    shutil.rmtree(place / "snapshots")
    for _ in range(count):
        _carry_out(order, source, chance.uniform(0.2, 1) * took_s)
        assert look(place).damage.first == [], f"seed {seed}"
    assert _carry_out(order, source, None)["problems"] == []
    assert look(place).damage.first == []
    assert len(content_files(place)) >= held
    order = {"command": "restore", "place": str(place), "as_json": True, "bytes_per_s": 15e6}
    with sites.empty() as target:
        for _ in range(count):
            told = _carry_out(order, target, chance.uniform(0.2, 1.5) * took_s)
            if told is None:
                with psycopg.connect(plain_dsn(target.database_url)) as database:
                    shown = database.execute("SELECT to_regclass('public.file') IS NOT NULL").fetchall()
                if shown == [(True,)]:  # it was whole already
                    assert rows(target) == rows(source), f"seed {seed}"
        if told is None:
            told = _carry_out(order, target, None)
        assert told["problems"] == []
        assert rows(target) == rows(source), f"seed {seed}"
        assert contents(target) == contents(source), f"seed {seed}"


def _carry_out(order: dict[str, object], settings: Settings, kill_after_s: float | None) -> Any:
    """Let a process do it; killed after a while, if it has not ended by then. Returns what it told, None if killed."""
    values = {
        "DATABASE_URL": plain_dsn(settings.database_url),
        "S3_INTERNAL_URL": settings.s3_internal_url,
        "S3_BUCKET": settings.s3_bucket,
        "S3_ACCESS_KEY": settings.s3_access_key,
        "S3_SECRET_KEY": settings.s3_secret_key.get_secret_value(),
    }
    if settings.migration_database_url is not None:
        values["MIGRATION_DATABASE_URL"] = plain_dsn(settings.migration_database_url)
    kept = {name: value for name, value in os.environ.items() if not name.startswith("KLEINKRAM_")}
    process = subprocess.Popen(
        [sys.executable, "-m", "kleinkram.server.backup", json.dumps(order)],
        env=kept | {f"KLEINKRAM_{name}": value for name, value in values.items()},
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
    if process.returncode == 5 and order["command"] == "restore":  # an earlier one had got to its end
        return {"problems": []}
    assert process.returncode == 0
    return json.loads(out)
