"""Verify, encrypt and prune backups, in folders and buckets; locks, and objects that must not be deleted meanwhile."""

import os
import subprocess
import time
from pathlib import Path

import psycopg
import pytest

from kleinkram.server.backup import database as backup_database
from kleinkram.server.backup import lock as lock_module
from kleinkram.server.backup import operations
from kleinkram.server.backup.database import deletion_lock
from kleinkram.server.backup.errors import (
    BackupConflict,
    BackupDamaged,
    BackupLocationFull,
    BackupNotFound,
    BackupRequestInvalid,
    BackupUnreachable,
    PassphraseWrong,
)
from kleinkram.server.backup.objects import ObjectIndex
from kleinkram.server.backup.operations import Messages
from kleinkram.server.backup.rclone import Rclone
from kleinkram.server.backup.repository import open_repository
from kleinkram.server.maintenance import collect_garbage
from kleinkram.server.settings import plain_dsn
from tests.integration.api_server import Api
from tests.integration.backup.conftest import LARGE
from tests.integration.backup.instances import (
    EmptyInstances,
    back_up,
    content_files,
    contents,
    prune_place,
    restore_to,
    rows,
    settings_of,
    verify_place,
)
from tests.integration.conftest import StartApi
from tests.integration.jobs import on_site
from tests.integration.upload_client import upload
from tests.requirements import missing
from tests.services import RunningStore


def test_verifying_creates_no_folder(tmp_path: Path) -> None:
    with pytest.raises(BackupNotFound, match="There are no backups"):
        verify_place(tmp_path / "none")
    assert not (tmp_path / "none").exists()


def test_damage_is_reported(backed_up: Path) -> None:
    [document] = backed_up.glob("snapshots/*.json")
    *_, largest = content_files(backed_up)
    whole = largest.read_bytes()

    flipped = bytearray(whole)
    flipped[len(whole) // 2] ^= 1
    largest.write_bytes(flipped)
    assert verify_place(backed_up, read_all=False).damage.first == []  # names and sizes are unchanged
    [sentence] = verify_place(backed_up).damage.first
    assert largest.name in sentence
    assert "changed or cut off" in sentence

    largest.write_bytes(whole[:-1])
    [sentence] = verify_place(backed_up, read_all=False).damage.first
    assert f"has {len(whole) - 1} bytes instead of {len(whole)}" in sentence

    largest.unlink()
    [sentence] = verify_place(backed_up, read_all=False).damage.first
    assert "is missing" in sentence
    assert document.stem in sentence

    largest.write_bytes(whole)
    for name in ("database.zst", "objects.zst"):
        path = backed_up / "snapshots" / document.stem / name
        body = path.read_bytes()
        flipped_body = body[:20] + bytes([body[20] ^ 1]) + body[21:]
        for damaged, read_all in ((body[:-10], False), (flipped_body, True)):
            path.write_bytes(damaged)
            [sentence] = verify_place(backed_up, read_all=read_all).damage.first
            assert name in sentence
        path.write_bytes(body)
    assert verify_place(backed_up).damage.first == []

    document.write_bytes(document.read_bytes()[:-10])
    [sentence] = verify_place(backed_up, read_all=False).damage.first
    assert document.stem in sentence
    assert "cannot be restored" in sentence
    with pytest.raises(BackupDamaged):
        prune_place(backed_up, keep=1)
    assert largest.exists()


@pytest.mark.slow
def test_encrypted_backups_reveal_nothing_and_can_be_restored(
    populated: Api, instances: EmptyInstances, tmp_path: Path
) -> None:
    source = settings_of(populated)
    with pytest.raises(BackupRequestInvalid, match="needs a passphrase"):
        back_up(source, tmp_path, encrypt=True)
    made = back_up(source, tmp_path, encrypt=True, passphrase="horse staple")
    assert back_up(source, tmp_path, passphrase="horse staple").copied.count == 0
    known = {made.snapshot.id, *(Path(key).name for key in contents(source))}
    files = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert not {path.name for path in files} & known
    assert not any(LARGE[:64] in path.read_bytes() or b"large.bin" in path.read_bytes() for path in files)
    for passphrase, sentence in ((None, "are encrypted"), ("another", "is not the one")):
        with pytest.raises(PassphraseWrong, match=sentence):
            verify_place(tmp_path, passphrase=passphrase)
    assert verify_place(tmp_path, passphrase="horse staple").damage.first == []
    with instances.empty() as target:
        restore_to(target, tmp_path, passphrase="horse staple")
        assert rows(target) == rows(source)
        assert contents(target) == contents(source)
    largest = max(files, key=lambda path: path.stat().st_size)
    whole = largest.read_bytes()
    largest.write_bytes(whole[: -(64 * 1024 + 16)])  # a block less
    assert (
        len(verify_place(tmp_path, passphrase="horse staple").damage.first) == 2 + 1
    )  # each backup, and the bytes themselves
    largest.write_bytes(whole[:5000] + bytes([whole[5000] ^ 1]) + whole[5001:])
    [sentence] = verify_place(tmp_path, passphrase="horse staple").damage.first
    assert "changed or cut off" in sentence


@pytest.mark.slow
def test_pruning_removes_old_backups_and_their_objects(start_api: StartApi, tmp_path: Path) -> None:
    api = start_api(trash_days=0, garbage_grace_s=0)
    mission = api.mission(api.project()["id"])["id"]
    uploaded = upload(api, mission, "kept", b"kept")
    gone = upload(api, mission, "gone", b"gone")
    source = settings_of(api)
    first = back_up(source, tmp_path)
    api.delete(f"/files/{gone['id']}").ok()
    on_site(api, collect_garbage)
    on_site(api, collect_garbage)
    assert api.sql("SELECT count(*) FROM blob") == [(1,)]
    second = back_up(source, tmp_path)
    assert second.snapshot.objects == 1
    with pytest.raises(BackupRequestInvalid):
        prune_place(tmp_path, keep=0)

    with open_repository(str(tmp_path), None, Rclone()).locked():
        for write in (lambda: prune_place(tmp_path, keep=1), lambda: back_up(source, tmp_path)):
            with pytest.raises(BackupConflict, match="Another process"):
                write()
    done = prune_place(tmp_path, keep=1)
    assert done.removed == (first.snapshot.id,)
    assert done.removed_objects == 1
    assert uploaded["id"]
    result = verify_place(tmp_path)
    assert (result.snapshots, result.damage.first, result.unused) == (1, [], 0)


@pytest.fixture
def bucket_location(store: RunningStore, monkeypatch: pytest.MonkeyPatch) -> str:
    """A place for backups in a bucket of its own, and in the environment how to get there."""
    monkeypatch.setenv("KLEINKRAM_BACKUP_S3_URL", store.endpoint)
    monkeypatch.setenv("KLEINKRAM_BACKUP_S3_ACCESS_KEY", store.access_key)
    monkeypatch.setenv("KLEINKRAM_BACKUP_S3_SECRET_KEY", store.secret_key)
    return f"s3://{store.create_bucket()}/klein"


@pytest.mark.slow
def test_backups_in_a_bucket(
    populated: Api, instances: EmptyInstances, bucket_location: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    source, place = settings_of(populated), bucket_location
    with monkeypatch.context() as bare:
        bare.delenv("KLEINKRAM_BACKUP_S3_URL")
        with pytest.raises(BackupRequestInvalid, match="KLEINKRAM_BACKUP_S3_URL"):
            back_up(source, place)
    with pytest.raises(BackupNotFound):
        verify_place(place)
    assert back_up(source, place, encrypt=True, passphrase="p").copied.count == 7
    assert back_up(source, place, encrypt=True, passphrase="p").copied.count == 0
    assert prune_place(place, keep=1, passphrase="p").remaining
    result = verify_place(place, passphrase="p")
    assert (result.damage.first, result.snapshots, result.unused) == ([], 1, 0)
    with instances.empty() as target:
        restore_to(target, place, passphrase="p")
        assert contents(target) == contents(source)


def test_a_process_that_lost_its_lock_completes_and_removes_nothing(
    populated: Api, bucket_location: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = settings_of(populated)
    first = back_up(source, bucket_location)
    repository = open_repository(bucket_location, None, Rclone())
    find_problems = operations._find_problems

    def another_takes_over() -> None:
        """Another process comes after ten minutes of silence."""
        with monkeypatch.context() as patched:
            patched.setattr(lock_module, "_STALE_S", -1)
            with repository.locked():
                pass

    def take_over(index: ObjectIndex, dsn: str) -> Messages:
        another_takes_over()
        return find_problems(index, dsn)

    with repository.locked(), pytest.raises(BackupConflict, match="Another process"):
        back_up(source, bucket_location)
    with repository.locked() as confirm:
        confirm()
        another_takes_over()
        with pytest.raises(BackupConflict, match="another may have changed"):
            confirm()
    monkeypatch.setattr(operations, "_find_problems", take_over)
    with pytest.raises(BackupConflict, match="another may have changed"):
        back_up(source, bucket_location)
    assert repository.snapshot_ids() == [first.snapshot.id]


def test_a_lock_of_a_dead_process_of_this_machine_is_removed(bucket_location: str, populated: Api) -> None:
    source = settings_of(populated)
    back_up(source, bucket_location)
    repository = open_repository(bucket_location, None, Rclone())
    left = f"{lock_module._host()}.{2**22 - 1}.1.abc"
    repository.rclone.write(f"{repository.root}/locks/{left}", b"lock")
    assert back_up(source, bucket_location).copied.count == 0


@pytest.mark.parametrize("path", ["unfinished/thesis.tex", "lockers.csv", "objects/field-day.bag"])
def test_a_folder_with_other_files_is_left_unchanged(populated: Api, tmp_path: Path, path: str) -> None:
    theirs = tmp_path / path
    theirs.parent.mkdir(exist_ok=True)
    theirs.write_text("the only copy")
    with pytest.raises(BackupConflict, match=path):
        back_up(settings_of(populated), tmp_path)
    with pytest.raises(BackupNotFound):
        prune_place(tmp_path, keep=1)
    assert [file for file in tmp_path.rglob("*") if file.is_file()] == [theirs]


def test_a_backup_reaches_the_disk_before_its_document_names_it(
    populated: Api, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    documents: list[int] = []
    monkeypatch.setattr(os, "sync", lambda: documents.append(len([*tmp_path.glob("snapshots/*.json")])))
    back_up(settings_of(populated), tmp_path)
    assert documents == [0, 1]


def test_files_of_an_unfinished_backup_are_removed_by_the_next(populated: Api, backed_up: Path) -> None:
    half = backed_up / "snapshots" / "20260101T000000000000Z-abcdef" / "database.zst"
    half.parent.mkdir()
    half.write_text("half")
    made = back_up(settings_of(populated), backed_up)
    assert not half.exists()
    assert made.copied.count == 0


def test_backups_of_another_format_are_refused(tmp_path: Path) -> None:
    (tmp_path / "klein-backup.json").write_text('{"format": 1, "id": "x", "key": null}')
    with pytest.raises(BackupRequestInvalid, match="another format"):
        verify_place(tmp_path)


@pytest.mark.slow
def test_a_full_disk_fails_the_backup(populated: Api, tmp_path: Path) -> None:
    source, folder = settings_of(populated), tmp_path / "small"
    folder.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=4m", "tmpfs", folder], check=False, capture_output=True
    )
    if mounted.returncode != 0:
        missing("mounting needs root")
    try:
        with pytest.raises(BackupLocationFull, match="no space left"):
            back_up(source, folder / "backups")
        assert not any(folder.glob("backups/snapshots/*.json"))
        subprocess.run(["mount", "-o", "remount,size=60m", folder], check=True)
        assert back_up(source, folder / "backups").problems.first == []
        assert verify_place(folder / "backups").damage.first == []
    finally:
        subprocess.run(["umount", folder], check=True)


def test_no_garbage_is_collected_while_a_backup_copies(start_api: StartApi) -> None:
    api = start_api(trash_days=0, garbage_grace_s=0)
    mission = api.mission(api.project()["id"])["id"]
    file = upload(api, mission, "file", b"bytes")
    before = contents(settings_of(api))
    api.delete(f"/files/{file['id']}").ok()

    with deletion_lock(plain_dsn(settings_of(api).database_url)) as confirm:
        for _ in range(3):
            on_site(api, collect_garbage)
        confirm()
    assert contents(settings_of(api)) == before
    on_site(api, collect_garbage)
    assert contents(settings_of(api)) == {}


def test_a_deletion_lock_that_the_database_ended_makes_no_backup(
    populated: Api, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    find_problems = operations._find_problems

    def disconnect(index: ObjectIndex, dsn: str) -> Messages:
        """Let the database end the connections of backups, as when it is restarted."""
        result = find_problems(index, dsn)
        query = "SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE application_name = 'kleinkram backup'"
        with psycopg.connect(plain_dsn(settings_of(populated).database_url)) as other:
            other.execute(f"{query} AND datname = current_database()")
        return result

    monkeypatch.setattr(operations, "_find_problems", disconnect)
    with pytest.raises(BackupUnreachable, match="kept objects from being deleted"):
        back_up(settings_of(populated), tmp_path)
    assert not any(tmp_path.glob("snapshots/*.json"))


def test_a_process_that_hangs_loses_its_deletion_lock(start_api: StartApi, monkeypatch: pytest.MonkeyPatch) -> None:
    api = start_api()
    monkeypatch.setattr(backup_database, "_MAX_IDLE_MS", 200)
    with deletion_lock(plain_dsn(settings_of(api).database_url)) as confirm:
        time.sleep(1)
        with pytest.raises(BackupUnreachable):
            confirm()
