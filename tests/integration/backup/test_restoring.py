"""Restore every row and every byte, and report what is missing."""

import json
from collections.abc import Collection
from hashlib import sha256
from pathlib import Path

import psycopg
import pytest

from kleinkram.server.backup import database as backup_database
from kleinkram.server.backup.errors import BackupConflict, BackupError, BackupUnreachable
from kleinkram.server.backup.rclone import Rclone
from kleinkram.server.settings import plain_dsn
from tests.integration.api_server import Api
from tests.integration.backup.instances import (
    EmptyInstances,
    back_up,
    content_files,
    contents,
    delete_object,
    restore_to,
    rows,
    settings_of,
    verify_place,
    write_object,
)
from tests.integration.conftest import StartApi
from tests.integration.next_migration import NEXT, add_migration
from tests.integration.upload_client import upload


def test_every_row_and_every_byte_are_restored(populated: Api, instances: EmptyInstances, tmp_path: Path) -> None:
    source = settings_of(populated)
    made = back_up(source, tmp_path)
    assert made.problems.first == []
    with instances.empty() as target:
        restored = restore_to(target, tmp_path)
        assert restored.unavailable == []
        assert rows(target) == rows(source)
        assert contents(target) == contents(source)
        assert len(contents(target)) == 7  # 4 files, an artifact and a log of a run, a log chunk of another
        with psycopg.connect(plain_dsn(target.database_url)) as database:
            states = "SELECT DISTINCT state FROM blob WHERE marked_for_deletion_at IS NULL"
            assert database.execute(states).fetchall() == [("stored",)]  # to be verified in the new store
            # The uploader starts again, and the name is free.
            assert database.execute("SELECT DISTINCT state FROM upload WHERE path = 'half.bin'").fetchall() == [
                ("expired",)
            ]
            running = "SELECT count(*) FROM run WHERE state = 'running' AND lease_ends_at <= now()"
            assert database.execute(running).fetchall() == [(1,)]  # its lease has expired
            # The serving role cannot see sequences of newer tables; they continue above the highest id all the same.
            last = "SELECT max(id) FROM mission_topic"
            assert database.execute(last).fetchall() == populated.sql(last)
            event = (
                "INSERT INTO audit_event (operation, resource_type, resource_name) VALUES ('t', 't', 't') RETURNING id"
            )
            highest = populated.sql("SELECT max(id) FROM audit_event")[0][0]
            row = database.execute(event).fetchone()
            assert row is not None
            assert row[0] > highest
            database.rollback()


def test_deleted_previews_stay_deleted_and_others_are_made_again(
    populated: Api, instances: EmptyInstances, tmp_path: Path
) -> None:
    populated.sql(
        "INSERT INTO recording_preview (blob_id, key, state, version, size_bytes)"
        " SELECT id, 'previews/' || key, CASE WHEN row_number() OVER (ORDER BY id) = 1 THEN 'deleted' ELSE 'ready' END,"
        " 1, 1 FROM blob"
    )
    try:
        back_up(settings_of(populated), tmp_path)
    finally:
        populated.sql("DELETE FROM recording_preview")
    with instances.empty() as target:
        restore_to(target, tmp_path)
        with psycopg.connect(plain_dsn(target.database_url)) as database:
            previews = database.execute("SELECT state, key, store_id FROM recording_preview").fetchall()
            assert previews == [("deleted", None, target.store_id)]


def test_only_new_and_truncated_objects_are_copied(populated: Api, backed_up: Path) -> None:
    assert len(content_files(backed_up)) == 7  # a duplicate is the same object
    *_, largest = content_files(backed_up)
    second = back_up(settings_of(populated), backed_up)
    assert (second.copied.count, second.snapshot.objects) == (0, 7)
    with largest.open("r+b") as file:
        file.truncate(1000)  # as a power cut may leave it
    third = back_up(settings_of(populated), backed_up)
    assert third.copied.count == 1
    assert verify_place(backed_up).damage.first == []


@pytest.mark.slow
def test_lost_and_corrupt_objects_are_reported_and_others_backed_up(
    start_api: StartApi, instances: EmptyInstances, tmp_path: Path
) -> None:
    api = start_api()
    mission = api.mission(api.project()["id"])["id"]
    for path in ("lost", "corrupt", "fine"):
        upload(api, mission, path, path.encode())
    source = settings_of(api)
    by_path = dict(api.sql("SELECT file.path, key FROM blob JOIN file ON file.blob_id = blob.id"))
    delete_object(source, by_path["lost"])
    write_object(source, by_path["corrupt"], b"other bytes")
    made = back_up(source, tmp_path)
    assert sorted(made.problems.first) == sorted([f"{by_path['lost']}: lost", f"{by_path['corrupt']}: corrupt"])
    assert verify_place(tmp_path).damage.first == []
    with instances.empty() as target:
        restored = restore_to(target, tmp_path)
        assert {entry.key: entry.state for entry in restored.unavailable} == {
            by_path["lost"]: "lost",
            by_path["corrupt"]: "corrupt",
        }
        assert contents(target) == contents(source)
        states = "SELECT file.path, state FROM blob JOIN file ON file.blob_id = blob.id"
        with psycopg.connect(plain_dsn(target.database_url)) as database:
            assert dict(database.execute(states).fetchall()) == {"lost": "lost", "corrupt": "corrupt", "fine": "stored"}


def test_an_unavailable_store_fails_the_backup(
    populated: Api, backed_up: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("RCLONE_RETRIES", "1")  # else it waits for the store
    monkeypatch.setenv("RCLONE_LOW_LEVEL_RETRIES", "1")
    monkeypatch.setenv("RCLONE_RETRIES_SLEEP", "0")
    source = settings_of(populated)
    content_files(backed_up)[0].unlink()  # only one is missing: rclone pauses for up to 2 s after each failed request
    with pytest.raises(BackupUnreachable, match="does not answer"):
        back_up(source.model_copy(update={"s3_internal_url": "http://127.0.0.1:9"}), backed_up)
    assert len([*backed_up.glob("snapshots/*.json")]) == 1
    made = back_up(source, backed_up)
    assert (made.problems.first, made.copied.count) == ([], 1)
    assert verify_place(backed_up).damage.first == []


def test_an_instance_that_is_not_empty_is_not_restored_to(
    populated: Api, instances: EmptyInstances, backed_up: Path
) -> None:
    with instances.empty() as target:
        write_object(target, "somebody's", b"bytes")
        with pytest.raises(BackupConflict, match="is not empty"):
            restore_to(target, backed_up)
    with instances.empty() as target:
        lived = settings_of(populated).model_copy(update={"s3_bucket": target.s3_bucket})
        lived = lived.model_copy(update={"migration_database_url": lived.database_url})
        with pytest.raises(BackupConflict, match="The database is not empty"):
            restore_to(lived, backed_up)


@pytest.mark.slow
def test_an_interrupted_restore_continues(
    populated: Api, instances: EmptyInstances, backed_up: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = settings_of(populated)
    [document] = backed_up.glob("snapshots/*.json")
    snapshot_id = document.stem
    other = back_up(source, backed_up)
    copy, adjust_rows = Rclone.copy, backup_database._adjust_rows

    def copy_two(self: Rclone, source: str, target: str, paths: Collection[str]) -> dict[str, str]:
        copy(self, source, target, [*paths][:2])
        raise BackupError("ended")

    def fail(*_: object) -> None:
        raise BackupError("ended")

    with instances.empty() as target:
        monkeypatch.setattr(Rclone, "copy", copy_two)
        with pytest.raises(BackupError, match="ended"):
            restore_to(target, backed_up, snapshot_id=snapshot_id)
        monkeypatch.setattr(Rclone, "copy", copy)
        with pytest.raises(BackupConflict, match="was not finished"):
            restore_to(target, backed_up, snapshot_id=other.snapshot.id)
        monkeypatch.setattr(backup_database, "_adjust_rows", fail)
        with pytest.raises(BackupError, match="ended"):
            restore_to(target, backed_up, snapshot_id=snapshot_id)
        with psycopg.connect(plain_dsn(target.database_url)) as database:
            tables = database.execute("SELECT count(*) FROM pg_tables WHERE schemaname = 'public'").fetchall()
        assert tables == [(0,)]  # all or nothing
        monkeypatch.setattr(backup_database, "_adjust_rows", adjust_rows)
        assert restore_to(target, backed_up, snapshot_id=snapshot_id).sent == 0
        assert rows(target) == rows(source)
        assert contents(target) == contents(source)


def test_a_backup_of_an_earlier_schema_is_upgraded(
    instances: EmptyInstances, backed_up: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    add_migration(backup_database, tmp_path, monkeypatch)
    with instances.empty() as target:
        restore_to(target, backed_up)
        with psycopg.connect(plain_dsn(target.database_url)) as database:
            assert database.execute("SELECT version_num FROM alembic_version").fetchall() == [(NEXT,)]
            assert database.execute("SELECT count(*) FROM file WHERE added <> path").fetchall() == [(0,)]


def test_a_backup_of_a_later_schema_is_refused(instances: EmptyInstances, backed_up: Path) -> None:
    [document] = backed_up.glob("snapshots/*.json")
    document_values = json.loads(document.read_bytes().partition(b"\n")[2])
    body = json.dumps({**document_values, "revision": "9999", "kleinkram": "7.0.0"}).encode()
    document.write_bytes(sha256(body).hexdigest().encode() + b"\n" + body)
    with instances.empty() as target, pytest.raises(BackupError, match=r"restore it with 7\.0\.0 or later"):
        restore_to(target, backed_up)
