"""From every earlier schema to this one, with data in it, while an old server reads and writes."""

import os
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import psycopg
import pytest
from alembic import command
from alembic.script import ScriptDirectory

from kleinkram.server.migrations import HEAD, alembic_config
from kleinkram.server.migrations.upgrading import LOCK, MigrationBlocked, Patience, migrate
from tests.integration.conftest import StartApi
from tests.integration.migrations.filling import BEFORE_RIGHTS, FILLS, NAMES, OLD_READS, OLD_WRITES
from tests.services import RunningPostgres

_ROLE = "kleinkram_serve"
# Every revision: nothing bears a version number yet, so whatever was on the main branch may be running somewhere.
REVISIONS = [each.revision for each in ScriptDirectory.from_config(alembic_config("", _ROLE)).walk_revisions()][::-1]
# The first goes through all of them; the others have what later ones brought. All the rest in `make soak`.
_USUAL = {"0001", "0008", "0015"}
_CHANGES_BLOBS = "0017"
_TABLES = "SELECT table_name FROM information_schema.tables WHERE table_schema = 'public' AND table_type = 'BASE TABLE'"
# Of a lock that is waited for, and a machine that is busy (4.9 s was seen on one that was slow by half).
_LONGEST_S = 2.0 + 13.0


def _url(postgres: RunningPostgres, name: str) -> str:
    return postgres.migrate_url(name).replace("postgresql://", "postgresql+psycopg://", 1)


def _ids(number: str) -> dict[str, Any]:
    return {"n": number, **{name: str(uuid.uuid4()) for name in NAMES}}


def _fill(postgres: RunningPostgres, name: str, revision: str) -> dict[str, Any]:
    """Write what a server of this revision would have; returns the ids of what it wrote."""
    ids = _ids(revision)
    with psycopg.connect(postgres.serve_url(name), cursor_factory=psycopg.ClientCursor) as database:
        for since, script in FILLS.items():
            if since <= revision:
                _run(database, script, ids)
        if revision < "0004":
            _run(database, BEFORE_RIGHTS, ids)
    return ids


def _run(database: "psycopg.Connection[Any]", script: str, ids: dict[str, Any]) -> None:
    for statement in filter(None, (each.strip() for each in script.split(";\n"))):
        database.execute(statement.rstrip(";"), ids)


@pytest.fixture(scope="module")
def filled(postgres: RunningPostgres) -> dict[str, tuple[str, dict[str, Any]]]:
    """A database for each revision, filled at it and at all before it, with the ids of what it was filled with last."""
    found: dict[str, tuple[str, dict[str, Any]]] = {}
    template = "template0"
    for revision in REVISIONS:
        name = postgres.create_database(template=template)
        command.upgrade(alembic_config(_url(postgres, name), _ROLE), revision)
        found[revision] = (name, _fill(postgres, name, revision))
        template = name
    return found


@dataclass
class _Load:
    """What an old server did meanwhile: how many rounds, how long the longest statement took, what went wrong."""

    rounds: int = 0
    longest_s: float = 0.0
    errors: list[str] = field(default_factory=list)
    files: list[str] = field(default_factory=list)


@contextmanager
def _old_server(postgres: RunningPostgres, name: str, ids: dict[str, Any]) -> Iterator[_Load]:
    load, ended = _Load(), threading.Event()

    def work() -> None:
        url = postgres.serve_url(name)
        with psycopg.connect(url, autocommit=True, cursor_factory=psycopg.ClientCursor) as database:
            while not ended.is_set():
                _round(database, ids, load)

    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield load
    finally:
        ended.set()
        thread.join(30)


def _round(database: "psycopg.Connection[Any]", ids: dict[str, Any], load: _Load) -> None:
    number = uuid.uuid4().hex
    values = {**ids, "n": number, "blob": str(uuid.uuid4()), "file": str(uuid.uuid4())}
    try:
        with database.transaction():
            for statement in (*OLD_READS, *OLD_WRITES):
                began = time.monotonic()
                database.execute(statement, values if statement in OLD_WRITES else None)
                load.longest_s = max(load.longest_s, time.monotonic() - began)
    except psycopg.errors.DeadlockDetected:
        return  # of two that want each other's tables one is told to try again, which servers do
    except psycopg.Error as error:
        load.errors.append(repr(error))
        return
    load.rounds += 1
    load.files.append(values["file"])


def _counts(postgres: RunningPostgres, name: str) -> dict[str, int]:
    with psycopg.connect(postgres.migrate_url(name)) as database:
        tables = [row[0] for row in database.execute(_TABLES) if row[0] != "alembic_version"]
        return {each: database.execute(f'SELECT count(*) FROM "{each}"').fetchall()[0][0] for each in tables}


@pytest.mark.slow
@pytest.mark.parametrize(
    "revision", [pytest.param(each, marks=[] if each in _USUAL else pytest.mark.soak) for each in REVISIONS[:-1]]
)
def test_from_every_schema_with_data_in_it_under_load(
    postgres: RunningPostgres, filled: dict[str, tuple[str, dict[str, Any]]], revision: str
) -> None:
    template, ids = filled[revision]
    name = postgres.create_database(template=template)
    before = _counts(postgres, name)
    with _old_server(postgres, name, ids) as load:
        while load.rounds < 5 and not load.errors:
            time.sleep(0.01)
        assert migrate(_url(postgres, name), _ROLE) == REVISIONS[REVISIONS.index(revision) + 1 :]
        at_end = load.rounds
        while load.rounds < at_end + 5 and not load.errors:
            time.sleep(0.01)
    assert load.errors == []
    assert load.longest_s < _LONGEST_S
    after = _counts(postgres, name)
    grown = {table: after[table] - number for table, number in before.items() if after[table] < number}
    assert grown == {}, "rows went"
    with psycopg.connect(postgres.serve_url(name)) as database:
        written = database.execute("SELECT id::text FROM file WHERE path LIKE 'load %'").fetchall()
        assert {row[0] for row in written} == set(load.files)
        said = database.execute("SELECT notes, metadata FROM mission WHERE id = %s", [ids["mission"]]).fetchall()
        assert said == [("rain" + "." * load.rounds, {"robot": "anymal"})]
    postgres.drop_database(name)


@pytest.mark.slow
def test_today_s_server_works_on_what_the_first_wrote(
    postgres: RunningPostgres, filled: dict[str, tuple[str, dict[str, Any]]], start_api: StartApi
) -> None:
    template, ids = filled["0001"]
    name = postgres.create_database(template=template)
    environment = {
        "KLEINKRAM_DATABASE_URL": postgres.serve_url(name),
        "KLEINKRAM_MIGRATION_DATABASE_URL": postgres.migrate_url(name),
        "KLEINKRAM_S3_INTERNAL_URL": "http://127.0.0.1:1",
        "KLEINKRAM_S3_ACCESS_KEY": "unused",
        "KLEINKRAM_S3_SECRET_KEY": "unused",
    }
    subprocess.run([sys.executable, "-m", "kleinkram.server", "migrate"], env={**os.environ, **environment}, check=True)
    api = start_api(database_url=postgres.serve_url(name))
    secret = "a token of the first schema"
    with psycopg.connect(postgres.migrate_url(name), autocommit=True) as database:
        found = database.execute(
            "UPDATE token SET secret_sha256 = sha256(%s::bytea) WHERE id = %s", [secret, ids["token"]]
        )
        assert found.rowcount == 1
    old = api.as_(secret)
    assert [each["name"] for each in old.all("/projects")] == ["walk 0001"]
    file = old.get(f"/files/{ids['file']}").ok()
    assert (file["path"], file["labels"], file["depth"], file["message_count"]) == ("run.mcap", ["night"], "summary", 7)
    assert {each["name"] for each in old.all(f"/files/{ids['file']}/topics")} == {"/imu", "/tf"}
    assert old.patch(f"/missions/{ids['mission']}", {"notes": "sun"}).ok()["notes"] == "sun"
    assert old.post(f"/missions/{ids['mission']}/uploads", {"files": [{"path": "new", "size_bytes": 1}]}).status == 200


@pytest.mark.slow
def test_two_migrators_at_once_migrate_once(postgres: RunningPostgres) -> None:
    name = postgres.create_database()
    with ThreadPoolExecutor(2) as pool:
        holder = psycopg.connect(postgres.migrate_url(name), autocommit=True)
        holder.execute("SELECT pg_advisory_lock(%s)", [LOCK])  # as a third that is at work
        both = [pool.submit(_migrate_apart, postgres, name) for _ in range(2)]
        time.sleep(0.3)
        assert not any(each.done() for each in both)
        holder.close()
        codes = [each.result(120) for each in both]
    assert codes == [0, 0]
    assert postgres.sql("SELECT version_num FROM alembic_version", database=name).strip() == HEAD


def _migrate_apart(postgres: RunningPostgres, name: str) -> int:
    script = (
        "import sys; from kleinkram.server.migrations.upgrading import migrate; migrate(sys.argv[1], 'kleinkram_serve')"
    )
    return subprocess.run([sys.executable, "-c", script, _url(postgres, name)], check=False).returncode


@pytest.mark.slow
def test_a_table_in_use_keeps_nobody_else_waiting_long(postgres: RunningPostgres) -> None:
    name = postgres.create_database()
    url, at = _url(postgres, name), REVISIONS.index(_CHANGES_BLOBS)
    command.upgrade(alembic_config(url, _ROLE), REVISIONS[at - 1])
    reader = psycopg.connect(postgres.serve_url(name))
    reader.execute("SELECT count(*) FROM blob")  # and keeps its transaction open
    with pytest.raises(MigrationBlocked, match=f"Revision {_CHANGES_BLOBS} .* pg_stat_activity"):
        migrate(url, _ROLE, Patience(lock_s=0.05, whole_s=0.3))
    assert "damaged_at" not in postgres.sql("SELECT column_name FROM information_schema.columns", database=name)
    with ThreadPoolExecutor(1) as pool:
        migrating = pool.submit(migrate, url, _ROLE, Patience(lock_s=0.1, whole_s=60))
        longest_s = 0.0
        for _ in range(10):
            began = time.monotonic()
            with psycopg.connect(postgres.serve_url(name)) as other:
                other.execute("SELECT count(*) FROM blob")
            longest_s = max(longest_s, time.monotonic() - began)
        assert not migrating.done()
        reader.close()
        assert migrating.result(60) == REVISIONS[at:]
    assert longest_s < 10, "it waits for its lock a tenth of a second at a time; whoever came after waits no longer"
