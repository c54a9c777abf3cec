"""Backups in this process, empty instances to restore to, and their rows and objects."""

import asyncio
import hashlib
import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psycopg

from kleinkram.server.backup.operations import (
    CreatedBackup,
    Pruned,
    Restored,
    Verification,
    create,
    prune,
    restore,
    verify,
)
from kleinkram.server.backup.rclone import Rclone
from kleinkram.server.backup.repository import Repository, make_repository, open_repository
from kleinkram.server.s3.storage import Storage, open_storage
from kleinkram.server.settings import Settings, plain_dsn
from tests.integration.api_server import Api
from tests.services import RunningPostgres, RunningStore

# Columns that restoring resets: nothing is verified in the new store, and no upload or run is active.
RESET = {
    "blob": ("state", "state_reason", "damaged_at"),
    "upload": ("state", "completing_since"),
    "run": ("lease_ends_at",),
}
EXCLUDED = {"alembic_version", "backup_attempt", "store_probe"}
_TABLES = "SELECT relname FROM pg_class WHERE relnamespace = 'public'::regnamespace AND relkind = 'r'"


def back_up(
    settings: Settings,
    place: object,
    *,
    encrypt: bool = False,
    passphrase: str | None = None,
    bytes_per_s: float | None = None,
) -> CreatedBackup:
    """Make a backup."""
    repository = make_repository(str(place), passphrase, Rclone({}, 4, bytes_per_s), encrypt=encrypt)
    return create(settings, repository, show_nothing)


def verify_place(place: object, *, passphrase: str | None = None, read_all: bool = True) -> Verification:
    """Verify backups, by default every byte."""
    return verify(opened(place, passphrase), None, show_nothing, read_all=read_all)


def restore_to(
    settings: Settings, place: object, *, passphrase: str | None = None, snapshot_id: str | None = None
) -> Restored:
    """Restore a backup."""
    return restore(settings, opened(place, passphrase), snapshot_id, show_nothing)


def prune_place(place: object, *, keep: int, passphrase: str | None = None) -> Pruned:
    """Prune backups."""
    return prune(opened(place, passphrase), keep=keep)


def opened(place: object, passphrase: str | None) -> Repository:
    """Open the backups in a location."""
    return open_repository(str(place), passphrase, Rclone({}, 4))


def show_nothing(_: str) -> None:
    """Show no progress."""


@dataclass(frozen=True)
class EmptyInstances:
    """Creates empty instances."""

    postgres: RunningPostgres
    store: RunningStore

    @contextmanager
    def empty(self) -> Iterator[Settings]:
        """A database without tables, and a bucket without objects."""
        name = self.postgres.create_database()
        settings: dict[str, Any] = {
            "database_url": self.postgres.serve_url(name),
            "migration_database_url": self.postgres.migrate_url(name),
            "s3_internal_url": self.store.endpoint,
            "s3_bucket": self.store.create_bucket(),
            "s3_access_key": self.store.access_key,
            "s3_secret_key": self.store.secret_key,
        }
        try:
            yield Settings(**settings)
        finally:
            self.postgres.drop_database(name)


def settings_of(api: Api) -> Settings:
    """The settings that an API runs with."""
    settings: Settings = api.app.state.settings
    return settings


def rows(settings: Settings) -> dict[str, list[str]]:
    """All rows of all tables, sorted, without the columns that restoring resets."""
    rows_by_table: dict[str, list[str]] = {}
    dsn = plain_dsn(settings.migration_database_url or settings.database_url)
    with psycopg.connect(dsn) as database:
        for (table,) in database.execute(_TABLES).fetchall():
            if table not in EXCLUDED:
                selected = database.execute(f"SELECT to_jsonb(t) FROM {table} t").fetchall()
                rows_by_table[table] = sorted(comparable_row(table, row) for (row,) in selected)
    return rows_by_table


def comparable_row(table: str, row: dict[str, Any]) -> str:
    """A row as text, without the columns that restoring resets."""
    return json.dumps({name: value for name, value in row.items() if name not in RESET.get(table, ())}, sort_keys=True)


def contents(settings: Settings) -> dict[str, str]:
    """Return the SHA-256 of every object of a blob or log chunk, by key; `lost` where it does not exist."""
    dsn = plain_dsn(settings.migration_database_url or settings.database_url)
    with psycopg.connect(dsn) as database:
        keys = [row[0] for row in database.execute("SELECT key FROM blob UNION SELECT key FROM log_chunk").fetchall()]
    return asyncio.run(_contents(settings, keys))


async def _contents(settings: Settings, keys: list[str]) -> dict[str, str]:
    async with open_storage(settings) as storage:
        return {key: await _content(storage, key) for key in keys}


async def _content(storage: Storage, key: str) -> str:
    digest = hashlib.sha256()
    try:
        async for piece in storage.read(key):
            digest.update(piece)
    except FileNotFoundError:
        return "lost"
    return digest.hexdigest()


def delete_object(settings: Settings, key: str) -> None:
    """Delete an object from the store."""

    async def go() -> None:
        async with open_storage(settings) as storage:
            await storage.delete(key)

    asyncio.run(go())


def write_object(settings: Settings, key: str, body: bytes) -> None:
    """Write other bytes under a key."""

    async def go() -> None:
        async with open_storage(settings) as storage:
            await storage.put_object(key, body)

    asyncio.run(go())


def content_files(place: Path) -> list[Path]:
    """The files of objects, the largest last."""
    files = [path for path in (place / "objects").rglob("*") if path.is_file()]
    return sorted(files, key=lambda path: path.stat().st_size)
