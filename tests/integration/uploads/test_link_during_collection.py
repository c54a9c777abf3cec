"""Linking during garbage collection: the file has its bytes, or the client is asked to upload them."""

import os
import threading
from concurrent.futures import ThreadPoolExecutor

import psycopg
import pytest
from sqlalchemy import ColumnElement, func, or_, text

from kleinkram.server.blobs import garbage_collection, queries
from kleinkram.server.context import AppContext
from kleinkram.server.db import Connection
from kleinkram.server.maintenance import collect_garbage
from tests.integration.api_server import Api
from tests.integration.conftest import StartApi
from tests.integration.jobs import on_site
from tests.integration.races import racing
from tests.integration.upload_client import begin, complete, fetch, send, upload, wait_until

# A name is taken by a change that is not made in the end: who wants it waits with all locks taken, and then has it.
_LOCK_NAME = (
    "INSERT INTO file (id, mission_id, blob_id, path, path_key, origin, uploaded_by_id)"
    " SELECT gen_random_uuid(), %s, blob_id, 'run.bin', 'run.bin', 'upload', uploaded_by_id FROM file WHERE id = %s"
)
_USED = "SELECT b.key FROM file f JOIN blob b ON b.id = f.blob_id"
_LOCK_BLOB = "SELECT 1 FROM blob WHERE id = %s FOR UPDATE"
# Whether another transaction waits for this one.
_IS_AWAITED = text(
    "SELECT EXISTS (SELECT FROM pg_locks WHERE NOT granted AND pg_backend_pid() = ANY (pg_blocking_pids(pid)))"
    " FROM pg_sleep(0.01)"
)
_GATE = 7


@pytest.fixture(name="api", scope="module")
def _api(start_api: StartApi) -> Api:
    """An API of its own, whose garbage collection has no grace period."""
    return start_api(trash_days=0, garbage_grace_s=0)


class _Duplicate:
    """A file elsewhere, the only one that refers to its bytes."""

    def __init__(self, api: Api) -> None:
        self.api, self.body = api, os.urandom(1000)
        self.file = upload(api, api.mission(api.project()["id"])["id"], "copy.bin", self.body)
        [[self.blob_id, self.key]] = api.sql(
            "SELECT b.id, b.key FROM blob b JOIN file f ON f.blob_id = b.id WHERE f.id = %s", self.file["id"]
        )

    def leave(self) -> None:
        """Delete the file and its row, so that the next garbage collection marks its blob for deletion."""
        self.api.delete(f"/files/{self.file['id']}").ok()
        self.api.sql("DELETE FROM file WHERE id = %s", self.file["id"])


@pytest.fixture(name="other", scope="module")
def _other(api: Api) -> _Duplicate:
    """A blob without links that is not collected."""
    return _Duplicate(api)


def _collect(api: Api, rounds: int = 2) -> set[str]:
    """Collect garbage and return the keys left at the store: one round marks what the next one deletes."""

    async def work(context: AppContext) -> set[str]:
        for _ in range(rounds):
            await collect_garbage(context)
        return set(await context.storage.sizes(""))

    return on_site(api, work)


def _see_that_all_have_bytes(api: Api, mission_id: str, bodies: dict[str, bytes]) -> None:
    """Once more after the garbage collection: these files, and no row of any other refers to what is gone or goes."""
    there = _collect(api)
    assert {row[0] for row in api.sql(_USED)} <= there
    assert api.sql(f"{_USED} WHERE b.marked_for_deletion_at IS NOT NULL") == []
    files = {file["path"]: file["id"] for file in api.all("/files", {"mission_id": mission_id})}
    links = api.post("/files/download", {"file_ids": [files[path] for path in bodies]}).ok()["items"]
    assert [fetch(link["url"]) for link in links] == [(200, body) for body in bodies.values()]


def test_a_blob_being_linked_is_not_collected(api: Api, mission_id: str, other: _Duplicate) -> None:
    duplicate = _Duplicate(api)
    with racing(api, _LOCK_NAME, mission_id, other.file["id"]) as send_one:
        linked = send_one(begin, api, mission_id, {"run.bin": duplicate.body})
        duplicate.leave()
        assert duplicate.key in _collect(api)
    assert linked.result(30)[0]["decision"] == "deduplicated"
    _see_that_all_have_bytes(api, mission_id, {"run.bin": duplicate.body})


def test_a_blob_linked_during_garbage_collection_is_not_collected(
    api: Api, mission_id: str, other: _Duplicate, monkeypatch: pytest.MonkeyPatch
) -> None:
    duplicate = _Duplicate(api)
    referred = queries.is_referenced

    def looks_until_the_gate_opens() -> ColumnElement[bool]:
        # Comes to the gate with what it saw of the files, at each blob that none of them referred to.
        return or_(referred(), func.pg_advisory_xact_lock_shared(_GATE).is_(None))

    info = api.database.info
    monkeypatch.setattr(queries, "is_referenced", looks_until_the_gate_opens)
    with psycopg.connect(info.dsn, password=info.password) as gate, ThreadPoolExecutor() as pool:
        gate.execute("SELECT pg_advisory_xact_lock(%s)", [_GATE])
        with racing(api, _LOCK_NAME, mission_id, other.file["id"]) as send_one:
            linked = send_one(begin, api, mission_id, {"run.bin": duplicate.body})
            duplicate.leave()
            collected = pool.submit(_collect, api, 1)
            at_gate = "SELECT count(*) FROM pg_locks WHERE locktype = 'advisory' AND objid = %s AND NOT granted"
            wait_until(lambda: collected.done() or api.sql(at_gate, _GATE) == [(1,)])
            assert not collected.done()
        assert linked.result(30)[0]["decision"] == "deduplicated"
        gate.rollback()
        collected.result(30)
    monkeypatch.undo()
    _see_that_all_have_bytes(api, mission_id, {"run.bin": duplicate.body})


@pytest.mark.parametrize("is_gone", [pytest.param(False, marks=pytest.mark.slow), True])
def test_linking_a_collected_blob_requires_an_upload(
    api: Api, mission_id: str, monkeypatch: pytest.MonkeyPatch, is_gone: bool
) -> None:
    # Blobs are locked by their ids: at the first, which is held, it is known already that the second is there.
    first, second = sorted((_Duplicate(api), _Duplicate(api)), key=lambda duplicate: duplicate.blob_id.bytes)
    marked = threading.Event()
    mark = garbage_collection.mark_unreferenced

    async def mark_slowly(db: Connection, *, limit: int) -> int:
        count = await mark(db, limit=limit)
        marked.set()
        while not is_gone and not (await db.execute(_IS_AWAITED)).scalar_one():
            pass
        return count

    monkeypatch.setattr(garbage_collection, "mark_unreferenced", mark_slowly)
    with ThreadPoolExecutor() as pool, racing(api, _LOCK_BLOB, first.blob_id) as send_one:
        began = send_one(begin, api, mission_id, {"first.bin": first.body, "run.bin": second.body})
        second.leave()
        collected = pool.submit(_collect, api, 2 if is_gone else 1)
        assert marked.wait(30)
        if is_gone:
            assert second.key not in collected.result(30)
    collected.result(30)
    monkeypatch.undo()
    linked, message = began.result(30)
    assert (linked["decision"], message["decision"]) == ("deduplicated", "upload")
    send(api, message["upload"], second.body)
    assert complete(api, message["upload"], second.body)["outcome"] == "completed"
    _see_that_all_have_bytes(api, mission_id, {"first.bin": first.body, "run.bin": second.body})
