"""The schema goes from empty to head, agrees with the tables, and gives the serving role no more than it needs."""

import subprocess
import sys

import psycopg
import pytest
from alembic import command
from alembic.script import ScriptDirectory

from kleinkram.server.migrations import HEAD, alembic_config
from tests.services import RunningPostgres

_WORDS = """
SELECT index.reloptions::text FROM pg_class index JOIN pg_am ON pg_am.oid = index.relam
  WHERE amname = 'gin' AND index.relnamespace = 'public'::regnamespace
"""


@pytest.fixture(name="database", scope="module")
def _database(postgres: RunningPostgres) -> str:
    name = postgres.create_database()
    _migrate(postgres, name)
    return name


def _migrate(postgres: RunningPostgres, name: str) -> None:
    environment = {
        "KLEINKRAM_DATABASE_URL": postgres.serve_url(name),
        "KLEINKRAM_MIGRATION_DATABASE_URL": postgres.migrate_url(name),
        "KLEINKRAM_S3_INTERNAL_URL": "http://127.0.0.1:1",
        "KLEINKRAM_S3_ACCESS_KEY": "unused",
        "KLEINKRAM_S3_SECRET_KEY": "unused",
    }
    subprocess.run([sys.executable, "-m", "kleinkram.server", "migrate"], env=environment, check=True)


def test_models_and_migrations_agree(postgres: RunningPostgres, database: str) -> None:
    url = postgres.migrate_url(database).replace("postgresql://", "postgresql+psycopg://", 1)
    command.check(alembic_config(url, "kleinkram_serve"))  # raises where they differ
    with psycopg.connect(postgres.serve_url(database)) as connection:
        assert connection.execute("SELECT count(*) FROM alembic_version").fetchone() == (1,)


def test_what_an_index_of_words_has_not_taken_in_yet_is_soon_read(postgres: RunningPostgres, database: str) -> None:
    words = postgres.sql(_WORDS, database=database).split()
    assert words == ["{gin_pending_list_limit=256}"] * 9


def test_the_newest_revision_is_the_one_written_down() -> None:
    assert ScriptDirectory.from_config(alembic_config("postgresql://", "role")).get_current_head() == HEAD


def test_migrating_twice_changes_nothing(postgres: RunningPostgres, database: str) -> None:
    before = postgres.sql("SELECT count(*) FROM pg_class", database=database)
    _migrate(postgres, database)
    assert postgres.sql("SELECT count(*) FROM pg_class", database=database) == before


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
def test_the_serving_role_cannot_rewrite_the_record_or_the_schema(
    postgres: RunningPostgres, database: str, statement: str
) -> None:
    with (
        psycopg.connect(postgres.serve_url(database)) as connection,
        pytest.raises(psycopg.errors.InsufficientPrivilege),
    ):
        connection.execute(statement)
