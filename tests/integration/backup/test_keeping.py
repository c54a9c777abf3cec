"""Backups are looked at, sealed, dropped, kept in a bucket; nothing is deleted from under one that is being made."""

import asyncio
from pathlib import Path
from typing import Any

import psycopg
import pytest

from kleinkram.server.backup import creating, locking
from kleinkram.server.backup import hold as hold_module
from kleinkram.server.backup.copying import side_by_side
from kleinkram.server.backup.failing import (
    CannotBeMeant,
    Damaged,
    InTheWay,
    NothingThere,
    NotOpened,
    Unreachable,
)
from kleinkram.server.backup.forgetting import forget
from kleinkram.server.backup.hold import holding_back
from kleinkram.server.backup.locking import at_work
from kleinkram.server.backup.repository import open_place
from kleinkram.server.blobs.jobs import collect_garbage
from kleinkram.server.settings import plain_dsn
from tests.integration.api_server import Api
from tests.integration.backup.conftest import LARGE
from tests.integration.backup.sites import (
    Sites,
    back_up,
    content_files,
    contents,
    fill,
    look,
    rows,
    settings_of,
)
from tests.integration.conftest import StartApi
from tests.integration.jobs import on_site
from tests.integration.upload_client import upload
from tests.services import RunningStore


def test_looking_makes_no_folder(tmp_path: Path) -> None:
    with pytest.raises(NothingThere, match="no such folder"):
        look(tmp_path / "none")
    assert not (tmp_path / "none").exists()


def test_damage_is_found_and_named(lived_in: Api, tmp_path: Path) -> None:
    made = back_up(settings_of(lived_in), tmp_path)
    *_, largest = content_files(tmp_path)
    whole = largest.read_bytes()

    flipped = bytearray(whole)
    flipped[len(whole) // 2] ^= 1
    largest.write_bytes(flipped)
    assert look(tmp_path, read_all=False).damage.first == []  # names and sizes say nothing of it
    [sentence] = look(tmp_path).damage.first
    assert largest.name in sentence
    assert "changed or cut off" in sentence

    largest.write_bytes(whole[:-1])
    [sentence] = look(tmp_path, read_all=False).damage.first
    assert f"has {len(whole) - 1} bytes and should have {len(whole)}" in sentence

    largest.unlink()
    [sentence] = look(tmp_path, read_all=False).damage.first
    assert "is missing" in sentence
    assert made.snapshot.id in sentence

    largest.write_bytes(whole)
    [document] = tmp_path.glob("snapshots/*.json")
    document.write_bytes(document.read_bytes()[:-10])
    [sentence] = look(tmp_path, read_all=False).damage.first
    assert made.snapshot.id in sentence
    assert "cannot be restored" in sentence
    with pytest.raises(Damaged):
        asyncio.run(forget(str(tmp_path), None, keep=1))
    assert largest.exists()


@pytest.mark.slow
def test_what_is_sealed_tells_nothing_and_comes_back(lived_in: Api, sites: Sites, tmp_path: Path) -> None:
    source = settings_of(lived_in)
    with pytest.raises(CannotBeMeant, match="needs a passphrase"):
        back_up(source, tmp_path, sealed=True)
    made = back_up(source, tmp_path, sealed=True, passphrase="horse staple")
    assert back_up(source, tmp_path, passphrase="horse staple").tally.copied == 0
    known = {entry.sha256 for table in made.snapshot.tables for entry in table.pieces} | {*contents(source).values()}
    files = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert not {path.name for path in files} & known
    assert not any(LARGE[:64] in path.read_bytes() or b"large.bin" in path.read_bytes() for path in files)
    for passphrase, sentence in ((None, "are sealed"), ("another", "is not the one")):
        with pytest.raises(NotOpened, match=sentence):
            look(tmp_path, passphrase=passphrase)
    assert look(tmp_path, passphrase="horse staple").damage.first == []
    with sites.empty() as target:
        fill(target, tmp_path, passphrase="horse staple")
        assert rows(target) == rows(source)
        assert contents(target) == contents(source)
    *_, largest = content_files(tmp_path)
    largest.write_bytes(largest.read_bytes()[: -(1024 * 1024)])  # a whole frame less
    assert len(look(tmp_path, passphrase="horse staple").damage.first) == 2 + 1  # each backup, and the bytes themselves


@pytest.mark.slow
def test_old_backups_go_with_what_only_they_held(start_api: StartApi, tmp_path: Path) -> None:
    api = start_api(trash_days=0, garbage_grace_s=0)
    mission = api.mission(api.project()["id"])["id"]
    kept = upload(api, mission, "kept", b"kept")
    gone = upload(api, mission, "gone", b"gone")
    source = settings_of(api)
    first = back_up(source, tmp_path)
    api.delete(f"/files/{gone['id']}").ok()
    on_site(api, collect_garbage)
    on_site(api, collect_garbage)
    assert api.sql("SELECT count(*) FROM blob") == [(1,)]
    second = back_up(source, tmp_path)
    assert second.tally.objects == 1
    with pytest.raises(CannotBeMeant):
        asyncio.run(forget(str(tmp_path), None, keep=0))

    async def forget_beside() -> None:
        async with open_place(str(tmp_path)) as shelf, at_work(shelf, alone=False):
            await forget(str(tmp_path), None, keep=1)

    with pytest.raises(InTheWay, match="at work"):
        asyncio.run(forget_beside())
    done = asyncio.run(forget(str(tmp_path), None, keep=1))
    assert done.forgotten == (first.snapshot.id,)
    assert done.removed >= 1
    assert kept["id"]
    found = look(tmp_path)
    assert (found.snapshots, found.damage.first, found.unused) == (1, [], 0)


@pytest.fixture
def in_bucket(store: RunningStore, monkeypatch: pytest.MonkeyPatch) -> str:
    """A place for backups in a bucket of its own, and in the environment how to get there."""
    monkeypatch.setenv("KLEINKRAM_BACKUP_S3_URL", store.endpoint)
    monkeypatch.setenv("KLEINKRAM_BACKUP_S3_ACCESS_KEY", store.access_key)
    monkeypatch.setenv("KLEINKRAM_BACKUP_S3_SECRET_KEY", store.secret_key)
    return f"s3://{store.create_bucket()}/klein"


@pytest.mark.slow
def test_a_bucket_keeps_backups_too(
    lived_in: Api, sites: Sites, in_bucket: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    source, place = settings_of(lived_in), in_bucket
    with monkeypatch.context() as bare:
        bare.delenv("KLEINKRAM_BACKUP_S3_URL")
        with pytest.raises(CannotBeMeant, match="KLEINKRAM_BACKUP_S3_URL"):
            back_up(source, place)
    with pytest.raises(NothingThere):
        look(place)
    assert back_up(source, place, sealed=True, passphrase="p").tally.copied == 7
    assert back_up(source, place, sealed=True, passphrase="p").tally.copied == 0
    assert asyncio.run(forget(place, "p", keep=1)).kept
    found = look(place, passphrase="p")
    assert (found.damage.first, found.snapshots, found.unused) == ([], 1, 0)
    with sites.empty() as target:
        fill(target, place, passphrase="p")
        assert contents(target) == contents(source)


def test_who_was_taken_for_gone_says_and_removes_nothing_more(
    lived_in: Api, in_bucket: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = settings_of(lived_in)
    first = back_up(source, in_bucket)

    async def come_later(*what: Any) -> None:
        """Do it, and then let somebody else come after ten minutes of silence."""
        await side_by_side(*what)
        monkeypatch.setattr(locking, "_STALE_S", -1)
        async with open_place(in_bucket) as shelf, at_work(shelf, alone=True):
            pass

    async def snapshots_and_forget() -> list[str]:
        async with open_place(in_bucket) as shelf, at_work(shelf, alone=True) as mine:
            await mine.confirm()
            async with at_work(shelf, alone=True):
                pass
            with pytest.raises(InTheWay, match="somebody else may have been at work"):
                await mine.confirm()
            return [item.path async for item in shelf.listed("snapshots/")]

    monkeypatch.setattr(creating, "side_by_side", come_later)
    with pytest.raises(InTheWay, match="somebody else may have been at work"):
        back_up(source, in_bucket)
    assert asyncio.run(snapshots_and_forget()) == [f"snapshots/{first.snapshot.id}.json"]


def test_nothing_is_swept_while_a_backup_copies(start_api: StartApi) -> None:
    api = start_api(trash_days=0, garbage_grace_s=0)
    mission = api.mission(api.project()["id"])["id"]
    file = upload(api, mission, "file", b"bytes")
    before = contents(settings_of(api))
    api.delete(f"/files/{file['id']}").ok()

    async def sweep_beside() -> None:
        async with holding_back(plain_dsn(settings_of(api).database_url)) as hold:
            for _ in range(3):
                await asyncio.to_thread(on_site, api, collect_garbage)
            hold.check()

    asyncio.run(sweep_beside())
    assert contents(settings_of(api)) == before
    on_site(api, collect_garbage)
    assert contents(settings_of(api)) == {}


def test_a_hold_that_the_database_ended_is_noticed(start_api: StartApi, monkeypatch: pytest.MonkeyPatch) -> None:
    api = start_api()
    monkeypatch.setattr(hold_module, "_ASK_EVERY_S", 0.01)

    dsn = plain_dsn(settings_of(api).database_url)

    async def cut() -> None:
        async with holding_back(dsn) as hold:
            await _end_connections(dsn)
            while True:
                await asyncio.sleep(0.01)
                hold.check()

    with pytest.raises(Unreachable, match="held back the sweep"):
        asyncio.run(cut())


def test_a_hold_that_ended_just_now_makes_no_backup(
    lived_in: Api, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def copy_and_cut(*what: Any) -> None:
        await side_by_side(*what)
        await _end_connections(plain_dsn(settings_of(lived_in).database_url))

    monkeypatch.setattr(creating, "side_by_side", copy_and_cut)
    with pytest.raises(Unreachable, match="held back the sweep"):
        back_up(settings_of(lived_in), tmp_path)
    assert not any(tmp_path.glob("snapshots/*"))


async def _end_connections(dsn: str) -> None:
    """Let the database end those of backups, as when it is started again."""
    query = "SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE application_name = 'kleinkram backup'"
    async with await psycopg.AsyncConnection.connect(dsn) as other:
        await other.execute(f"{query} AND datname = current_database()")
