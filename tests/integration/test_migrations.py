"""The schema: migrations match the tables, upgrades run under load, the serving role has minimal rights."""

import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import psycopg
import pytest
from alembic import command
from alembic.script import ScriptDirectory
from sqlalchemy import create_engine, text

import kleinkram.server.migrations.migrate
from kleinkram.server.migrations import HEAD, INITIAL, alembic_config
from kleinkram.server.migrations.migrate import LOCK, LockTimeouts, MigrationBlocked, SchemaUnsupported, migrate
from kleinkram.server.tables import metadata
from tests.integration.next_migration import NEXT, add_migration
from tests.services import RunningPostgres

_ROLE = "kleinkram_serve"
# A lock that is waited for, on a machine that is busy (4.9 s was seen on one that was slow by half).
_LONGEST_S = 2.0 + 13.0
# Not compared by Alembic: CHECKs, and indexes in all detail.
_CONSTRAINTS = """
SELECT conrelid::regclass::text, conname, pg_get_constraintdef(oid) FROM pg_constraint
WHERE connamespace = 'public'::regnamespace AND conrelid::regclass::text !~ 'procrastinate|alembic'
  AND conname !~ 'procrastinate' ORDER BY 1, 2
"""
_INDEXES = """
SELECT indexname, regexp_replace(indexdef, ' WITH \\(gin_pending_list_limit=''256''\\)', '') FROM pg_indexes
WHERE schemaname = 'public' AND tablename !~ 'procrastinate|alembic' ORDER BY 1
"""
_PENDING_LISTS = """
SELECT index.reloptions::text FROM pg_class index JOIN pg_am ON pg_am.oid = index.relam
  WHERE amname = 'gin' AND index.relnamespace = 'public'::regnamespace
"""
_TABLES = "SELECT relname FROM pg_class WHERE relkind = 'r' AND relnamespace = 'public'::regnamespace"
# By this transaction, against others that write.
_LOCKED = """
SELECT relname FROM pg_locks JOIN pg_class ON pg_class.oid = relation
WHERE pid = pg_backend_pid() AND relkind = 'r'
  AND mode IN ('ShareLock', 'ShareRowExclusiveLock', 'ExclusiveLock', 'AccessExclusiveLock')
"""
_FILL = """
INSERT INTO person (id, name) VALUES (%(person)s, 'Ada');
INSERT INTO project (id, name, name_key, metadata_fields, created_by_id)
  VALUES (%(project)s, 'walk', 'walk', '{"undeclared": "accept", "fields": []}', %(person)s);
INSERT INTO mission (id, project_id, name, name_key, metadata, notes, created_by_id, files_revision, derived_revision)
  VALUES (%(mission)s, %(project)s, 'Day 1', 'day 1', '{"robot": "anymal"}', 'rain', %(person)s, 3, 3)
"""
_ACCEPTED = """
INSERT INTO action (id, name, name_key, project_id, created_by_id)
  VALUES (%(action)s, 'verify', 'verify', %(project)s, %(person)s);
INSERT INTO action_version (id, action_id, number, definition, definition_sha256, created_by_id)
  VALUES (%(version)s, %(action)s, 3, '{}', sha256('x'), %(person)s);
INSERT INTO run (id, version_id, mission_id, parameters, network, cores, memory_bytes, disk_bytes, gpus, needs_images,
    inputs_fingerprint, started_by_id, input_count, input_bytes)
  VALUES (%(run)s, %(version)s, %(mission)s, '{}', 'none', 1, 1, 1, 0, false, sha256('x'), %(person)s, 1, 1);
INSERT INTO check_acceptance (id, mission_id, check_name, because, inputs_sha256, created_by_id, ended, ended_at)
  VALUES (%(current)s, %(mission)s, 'topic.rate', 'Known.', sha256('x'), %(person)s, NULL, NULL),
    (%(withdrawn)s, %(mission)s, 'topic.rate', 'Known.', sha256('x'), %(person)s, 'withdrawn', now());
INSERT INTO mission_checks (mission_id, verdict, files_revision, project_id, checks_number, counts, statuses, checks)
  VALUES (%(mission)s, 'good', 3, %(project)s, 0, '{}', '{}', jsonb_build_array(
    '{"name": "topic.rate", "status": "error", "topic": "/imu", "limit": 100.5}'
      ::jsonb || jsonb_build_object('acceptance_id', %(current)s),
    '{"name": "topic.rate", "status": "warning", "file": "a.mcap", "source": "action", "action": "verify"}'
      ::jsonb || jsonb_build_object('acceptance_id', %(current)s, 'run_id', %(run)s, 'message', 'Slow.'),
    '{"name": "topic.rate", "status": "error", "topic": "/other"}'::jsonb))
"""
_DECIDED = """
INSERT INTO project_action (id, project_id, action_id, trigger, parameters, added_by_id)
  VALUES (%(named)s, %(project)s, %(action)s, 'complete', '{}', %(person)s);
INSERT INTO project_action_mission (project_action_id, mission_id, files_revision) VALUES (%(named)s, %(mission)s, 3);
UPDATE project SET checks_number = 5
"""
# What a server of the earlier schema reads and writes while its database is upgraded.
_READS = (
    "SELECT f.path, b.state, m.name, p.name, a.name FROM file f JOIN blob b ON b.id = f.blob_id"
    " JOIN mission m ON m.id = f.mission_id JOIN project p ON p.id = m.project_id"
    " JOIN person a ON a.id = f.uploaded_by_id WHERE f.deleted_at IS NULL ORDER BY f.path LIMIT 100",
    "SELECT t.name, t.count FROM topic t JOIN blob b ON b.id = t.blob_id LIMIT 100",
    "SELECT count(*) FROM upload WHERE state IN ('open', 'completing')",
)
_WRITES = (
    "INSERT INTO blob (id, key, size_bytes, sha256, uploaded_by_id)"
    " VALUES (%(blob)s, 'load/' || %(n)s, 1, sha256('x'), %(person)s)",
    "INSERT INTO file (id, mission_id, blob_id, path, path_key, origin, uploaded_by_id)"
    " VALUES (%(file)s, %(mission)s, %(blob)s, 'load ' || %(n)s, 'load ' || %(n)s, 'upload', %(person)s)",
    "INSERT INTO audit_event (actor_id, operation, resource_type, resource_id, resource_name, project_id)"
    " VALUES (%(person)s, 'file.upload', 'file', %(file)s, 'load ' || %(n)s, %(project)s)",
    "UPDATE mission SET notes = notes || '.', files_revision = files_revision + 1 WHERE id = %(mission)s",
)


def _url(postgres: RunningPostgres, name: str) -> str:
    return postgres.migrate_url(name).replace("postgresql://", "postgresql+psycopg://", 1)


@pytest.fixture(name="database", scope="module")
def _database(postgres: RunningPostgres) -> str:
    name = postgres.create_database()
    assert _migrate_as_process(postgres, name).returncode == 0
    return name


@pytest.fixture(name="next_migration")
def _next_migration(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    add_migration(kleinkram.server.migrations.migrate, tmp_path, monkeypatch)


def _migrate_as_process(postgres: RunningPostgres, name: str) -> "subprocess.CompletedProcess[str]":
    environment = {
        "KLEINKRAM_DATABASE_URL": postgres.serve_url(name),
        "KLEINKRAM_MIGRATION_DATABASE_URL": postgres.migrate_url(name),
        "KLEINKRAM_S3_INTERNAL_URL": "http://127.0.0.1:1",
        "KLEINKRAM_S3_ACCESS_KEY": "unused",
        "KLEINKRAM_S3_SECRET_KEY": "unused",
    }
    command_line = [sys.executable, "-m", "kleinkram.server", "migrate"]
    return subprocess.run(command_line, env=environment, check=False, capture_output=True, text=True)


def test_tables_and_migrations_agree(postgres: RunningPostgres, database: str) -> None:
    command.check(alembic_config(_url(postgres, database), _ROLE))  # raises where they differ
    created = postgres.create_database()
    postgres.sql(
        "CREATE EXTENSION pg_trgm; CREATE FUNCTION joined(labels text[]) RETURNS text LANGUAGE sql IMMUTABLE"
        " RETURN array_to_string(labels, '')",
        database=created,
    )
    engine = create_engine(_url(postgres, created))
    metadata.create_all(engine)
    engine.dispose()
    for query in (_CONSTRAINTS, _INDEXES):
        assert postgres.sql(query, database=database) == postgres.sql(query, database=created)
    with psycopg.connect(postgres.serve_url(database)) as connection:
        assert connection.execute("SELECT count(*) FROM alembic_version").fetchone() == (1,)


def test_word_indexes_have_short_pending_lists(postgres: RunningPostgres, database: str) -> None:
    options = postgres.sql(_PENDING_LISTS, database=database).split()
    assert options == ["{gin_pending_list_limit=256}"] * 11


def test_head_is_the_newest_revision() -> None:
    assert ScriptDirectory.from_config(alembic_config("postgresql://", "role")).get_current_head() == HEAD


def test_migrating_twice_changes_nothing(postgres: RunningPostgres, database: str) -> None:
    before = postgres.sql("SELECT count(*) FROM pg_class", database=database)
    assert _migrate_as_process(postgres, database).returncode == 0
    assert postgres.sql("SELECT count(*) FROM pg_class", database=database) == before


def test_later_revisions_lock_the_tables_that_they_change_first(postgres: RunningPostgres) -> None:
    """Else requests may lose deadlocks against them. Revisions up to 0106 were part of the first release."""
    name = postgres.create_database()
    config = alembic_config(_url(postgres, name), _ROLE)
    command.upgrade(config, "0106")
    steps = [*ScriptDirectory.from_config(config).iterate_revisions("head", "0106")]
    engine = create_engine(_url(postgres, name))
    for step in reversed(steps):
        with engine.begin() as connection:
            existing = {*connection.scalars(text(_TABLES))}
            config.attributes["connection"] = connection
            command.upgrade(config, step.revision)
            locked = {*connection.scalars(text(_LOCKED))} & existing
        assert len(locked) < 2 or locked <= {*getattr(step.module, "locked_tables", ())}, step.revision
    engine.dispose()
    postgres.drop_database(name)


def test_an_earlier_acceptance_covers_what_it_covered(postgres: RunningPostgres) -> None:
    name = postgres.create_database()
    config = alembic_config(_url(postgres, name), _ROLE)
    command.upgrade(config, "0104")
    names = ("person", "project", "mission", "current", "withdrawn", "action", "version", "run")
    ids = {one: str(uuid.uuid4()) for one in names}
    with psycopg.connect(postgres.migrate_url(name), cursor_factory=psycopg.ClientCursor) as connection:
        connection.execute(_FILL, ids)
        connection.execute(_ACCEPTED, ids)
    command.upgrade(config, "0105")
    with psycopg.connect(postgres.serve_url(name)) as connection:
        rows = connection.execute("SELECT ended, failures FROM check_acceptance ORDER BY ended NULLS FIRST").fetchall()
        assert rows[0][0] is None
        assert sorted(rows[0][1], key=str) == [
            ["error", "/imu", None, 100.5, None, None, None],
            ["warning", None, "a.mcap", None, "verify", 3, "Slow."],
        ]
        assert rows[1] == ("withdrawn", [])
        assert connection.execute("SELECT is_outdated FROM mission_checks").fetchall() == [(True,)]
    postgres.drop_database(name)


def test_what_was_decided_was_decided_by_the_present_checks(postgres: RunningPostgres) -> None:
    """Else every action that runs by itself would run again after the upgrade."""
    name = postgres.create_database()
    config = alembic_config(_url(postgres, name), _ROLE)
    command.upgrade(config, "0105")
    names = ("person", "project", "mission", "action", "version", "run", "current", "withdrawn", "named")
    ids = {one: str(uuid.uuid4()) for one in names}
    with psycopg.connect(postgres.migrate_url(name), cursor_factory=psycopg.ClientCursor) as connection:
        connection.execute(_FILL, ids)
        connection.execute(_ACCEPTED, ids)
        connection.execute(_DECIDED, ids)
    command.upgrade(config, "0106")
    with psycopg.connect(postgres.serve_url(name)) as connection:
        assert connection.execute("SELECT checks_number FROM project_action_mission").fetchall() == [(5,)]
        assert connection.execute("SELECT input_metadata, checks_sha256 FROM run").fetchall() == [(None, None)]
    postgres.drop_database(name)


@pytest.mark.parametrize(
    "statement",
    [
        "UPDATE audit_event SET operation = 'nothing happened'",
        "DELETE FROM audit_event",
        "TRUNCATE audit_event",
        "DELETE FROM alembic_version",
        "DROP TABLE file",
        "CREATE TABLE mine (id int)",
    ],
)
def test_the_serving_role_cannot_rewrite_the_audit_log_or_the_schema(
    postgres: RunningPostgres, database: str, statement: str
) -> None:
    with (
        psycopg.connect(postgres.serve_url(database)) as connection,
        pytest.raises(psycopg.errors.InsufficientPrivilege),
    ):
        connection.execute(statement)


@pytest.mark.parametrize("revision", ["0001", "0028"])
def test_a_development_schema_is_refused_and_left_unchanged(postgres: RunningPostgres, revision: str) -> None:
    name = postgres.create_database()
    postgres.sql(
        "CREATE TABLE alembic_version (version_num varchar(32) NOT NULL);"
        f"INSERT INTO alembic_version VALUES ('{revision}'); CREATE TABLE blob (id uuid);"
        f"GRANT ALL ON ALL TABLES IN SCHEMA public TO kleinkram_migrate",
        database=name,
    )
    assert revision < INITIAL
    with pytest.raises(SchemaUnsupported, match=rf"schema \({revision}\).*development version.*commit 530100f"):
        migrate(_url(postgres, name), _ROLE)
    process = _migrate_as_process(postgres, name)
    assert (process.returncode, "Nothing was changed" in process.stderr, "Traceback" in process.stderr) == (
        1,
        True,
        False,
    )
    assert postgres.sql("SELECT count(*) FROM pg_class WHERE relname = 'person'", database=name).strip() == "0"


@dataclass
class _Load:
    """What an old server did meanwhile: rounds, seconds of the longest statement, errors, ids of inserted files."""

    rounds: int = 0
    longest_s: float = 0.0
    errors: list[str] = field(default_factory=list)
    files: list[str] = field(default_factory=list)

    def wait_for_rounds(self, count: int) -> None:
        end = self.rounds + count
        while self.rounds < end and not self.errors:
            time.sleep(0.01)


@contextmanager
def _old_server(postgres: RunningPostgres, name: str, ids: dict[str, str]) -> Iterator[_Load]:
    load, is_stopped = _Load(), threading.Event()

    def work() -> None:
        url = postgres.serve_url(name)
        with psycopg.connect(url, autocommit=True, cursor_factory=psycopg.ClientCursor) as database:
            while not is_stopped.is_set():
                _run_round(database, ids, load)

    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield load
    finally:
        is_stopped.set()
        thread.join(30)


def _run_round(database: "psycopg.Connection[tuple[object, ...]]", ids: dict[str, str], load: _Load) -> None:
    values = {**ids, "n": uuid.uuid4().hex, "blob": str(uuid.uuid4()), "file": str(uuid.uuid4())}
    try:
        with database.transaction():
            for statement in (*_READS, *_WRITES):
                start = time.monotonic()
                database.execute(statement, values if statement in _WRITES else None)
                load.longest_s = max(load.longest_s, time.monotonic() - start)
    except psycopg.Error as error:
        load.errors.append(repr(error))
        return
    load.rounds += 1
    load.files.append(values["file"])


@pytest.mark.slow
@pytest.mark.usefixtures("next_migration")
def test_an_upgrade_keeps_all_rows_while_an_old_server_reads_and_writes(
    postgres: RunningPostgres, database: str
) -> None:
    name = postgres.create_database(template=database)
    ids = {resource_type: str(uuid.uuid4()) for resource_type in ("person", "project", "mission")}
    with psycopg.connect(postgres.serve_url(name), cursor_factory=psycopg.ClientCursor) as connection:
        connection.execute(_FILL, ids)
    with _old_server(postgres, name, ids) as load:
        load.wait_for_rounds(5)
        assert migrate(_url(postgres, name), _ROLE) == [NEXT]
        load.wait_for_rounds(5)
    assert load.errors == []
    assert load.longest_s < _LONGEST_S
    with psycopg.connect(postgres.serve_url(name)) as connection:
        files = connection.execute("SELECT id::text FROM file WHERE path LIKE 'load %'").fetchall()
        assert {row[0] for row in files} == set(load.files)
        mission = connection.execute("SELECT notes, metadata FROM mission").fetchall()
        assert mission == [("rain" + "." * load.rounds, {"robot": "anymal"})]
    postgres.drop_database(name)


@pytest.mark.slow
def test_two_migrators_at_once_migrate_once(postgres: RunningPostgres) -> None:
    name = postgres.create_database()
    with ThreadPoolExecutor(2) as threads:
        holder = psycopg.connect(postgres.migrate_url(name), autocommit=True)
        holder.execute("SELECT pg_advisory_lock(%s)", [LOCK])  # as a third migrator does
        both = [threads.submit(_migrate_as_process, postgres, name) for _ in range(2)]
        time.sleep(0.3)
        assert not any(process.done() for process in both)
        holder.close()
        codes = [process.result(120).returncode for process in both]
    assert codes == [0, 0]
    assert postgres.sql("SELECT version_num FROM alembic_version", database=name).strip() == HEAD


@pytest.mark.slow
@pytest.mark.usefixtures("next_migration")
def test_a_migration_waiting_for_a_lock_delays_others_only_briefly(postgres: RunningPostgres, database: str) -> None:
    name = postgres.create_database(template=database)
    url = _url(postgres, name)
    reader = psycopg.connect(postgres.serve_url(name))
    reader.execute("SELECT count(*) FROM blob")  # and keeps its transaction open
    with pytest.raises(MigrationBlocked, match=f"Revision {NEXT} .* pg_stat_activity"):
        migrate(url, _ROLE, LockTimeouts(attempt_s=0.05, total_s=0.3))
    columns = postgres.sql("SELECT column_name FROM information_schema.columns", database=name)
    assert "added" not in columns.split()
    with ThreadPoolExecutor(1) as threads:
        migrating = threads.submit(migrate, url, _ROLE, LockTimeouts(attempt_s=0.1, total_s=60))
        longest_s = 0.0
        for _ in range(10):
            start = time.monotonic()
            with psycopg.connect(postgres.serve_url(name)) as other:
                other.execute("SELECT count(*) FROM blob")
            longest_s = max(longest_s, time.monotonic() - start)
        assert not migrating.done()
        reader.close()
        assert migrating.result(60) == [NEXT]
    assert longest_s < 10, "each attempt waits a tenth of a second for its lock; statements behind it wait no longer"
