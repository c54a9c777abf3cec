"""A scrub finds objects that vanished, were truncated, altered, or came back."""

import os
import uuid
from collections.abc import AsyncIterator
from typing import Any

import pytest

from kleinkram.contract.errors import StoreUnavailable
from kleinkram.server.blobs import scrub
from kleinkram.server.context import AppContext
from kleinkram.server.maintenance import collect_garbage
from kleinkram.server.s3.storage import Storage
from tests.integration.api_server import Api
from tests.integration.conftest import StartApi
from tests.integration.jobs import on_site, run_jobs
from tests.integration.upload_client import begin, fetch, send, upload, upload_all, wait_until

_AT_LEISURE = "SELECT args ->> 'ref' FROM procrastinate_jobs WHERE status = 'todo' AND priority < 0"


@pytest.fixture(name="api", scope="module")
def _api(start_api: StartApi) -> Api:
    """An API of its own, because a scrub compares all objects of the store."""
    return start_api(garbage_grace_s=0)


def _key(api: Api, file_id: str) -> str:
    return str(api.sql("SELECT b.key FROM blob b JOIN file f ON f.blob_id = b.id WHERE f.id = %s", file_id)[0][0])


def _scrub(api: Api, **expected: Any) -> Any:
    scrub_id = uuid.UUID(api.post("/admin/scrub", expected).ok(202)["id"])
    on_site(api, lambda context: scrub.scrub_store(context, scrub_id))
    return api.get("/admin/scrub").ok()["last"]


def _counts(last: Any) -> tuple[int, int, int]:
    assert last["aborted_reason"] is None
    assert last["ended_at"] is not None
    return last["lost"], last["corrupt"], last["recovered"]


def _put(api: Api, key: str, body: bytes) -> None:
    on_site(api, lambda context: context.storage.put_object(key, body))


def _remove(api: Api, key: str) -> None:
    on_site(api, lambda context: context.storage.delete(key))


def _read(api: Api, file: Any) -> Any:
    return api.get(f"/files/{file['id']}").ok()


def _verified(api: Api, mission_id: str, number: int = 4) -> list[tuple[Any, bytes]]:
    bodies = {f"{place}.bin": os.urandom(3000) for place in range(number)}
    files = upload_all(api, mission_id, bodies)
    api.sql("UPDATE blob SET state = 'verified', md5 = %s, verified_at = now() WHERE state = 'stored'", bytes(16))
    api.sql("DELETE FROM procrastinate_jobs")
    return [(files[path], body) for path, body in bodies.items()]


def test_a_scrub_of_intact_objects_marks_nothing(api: Api, mission_id: str) -> None:
    files = _verified(api, mission_id)
    begun = begin(api, mission_id, {"under way.bin": b"abc"})[0]["upload"]
    send(api, begun, b"abc")  # an object, and no blob yet
    last = _scrub(api)
    assert _counts(last) == (0, 0, 0)
    assert last["unknown"] == 0
    assert last["compared"] >= len(files)
    assert {_read(api, file)["state"] for file, _ in files} == {"verified"}


def test_a_vanished_object_is_missing_and_repaired_by_uploading_again(api: Api, mission_id: str) -> None:
    (file, body), *_ = _verified(api, mission_id)
    _remove(api, _key(api, file["id"]))
    assert _counts(_scrub(api)) == (1, 0, 0)
    read = _read(api, file)
    assert (read["state"], read["state_reason"]) == ("lost", "the store no longer has the object")
    assert read["damaged_at"] is not None
    assert api.events(file["id"])[0]["operation"] == "file.damage"
    assert _counts(_scrub(api)) == (0, 0, 0), "it is told once"
    assert _read(api, file)["damaged_at"] == read["damaged_at"]
    repaired = upload(api, mission_id, file["path"], body)
    run_jobs(api)
    assert (repaired["id"], _read(api, file)["state"], _read(api, file)["damaged_at"]) == (file["id"], "verified", None)
    link = api.post("/files/download", {"file_ids": [file["id"]]}).ok()["items"][0]
    assert fetch(link["url"]) == (200, body)


def test_a_truncated_object_is_corrupt_with_a_reason(api: Api, mission_id: str) -> None:
    (file, body), *_ = _verified(api, mission_id)
    _put(api, _key(api, file["id"]), body[:1000])
    assert _counts(_scrub(api)) == (0, 1, 0)
    read = _read(api, file)
    assert (read["state"], read["state_reason"]) == ("corrupt", "it has 1000 bytes instead of 3000")


@pytest.mark.parametrize("was", ["lost", "corrupt"])
def test_a_file_that_reappears_is_verified_again(api: Api, mission_id: str, was: str) -> None:
    (file, body), *_ = _verified(api, mission_id)
    key = _key(api, file["id"])
    _remove(api, key) if was == "lost" else _put(api, key, b"another")
    _scrub(api)
    assert _read(api, file)["state"] == was
    _put(api, key, body)  # as from a backup of the store
    assert _counts(_scrub(api)) == (0, 0, int(was == "lost"))
    run_jobs(api)
    read = _read(api, file)
    assert (read["state"], read["state_reason"], read["damaged_at"]) == ("verified", None, None)
    event = api.events(file["id"])[0]
    assert (event["operation"], event["before"]) == ("file.recover", {"state": was})


def test_the_next_verification_finds_altered_bytes(api: Api, mission_id: str) -> None:
    (file, body), (other, _), *_ = _verified(api, mission_id)
    _put(api, _key(api, file["id"]), body[:-1] + bytes([body[-1] ^ 1]))
    _scrub(api)
    assert _read(api, file)["state"] == "verified", "a list shows sizes alone"
    before = _read(api, other)["verified_at"]
    on_site(api, collect_garbage)
    assert api.sql(_AT_LEISURE) == [], "nothing is old enough"
    old = [api.sql("SELECT blob_id FROM file WHERE id = %s", item["id"])[0][0] for item in (file, other)]
    api.sql("UPDATE blob SET verified_at = now() - interval '91 days' WHERE id = ANY(%s)", old)
    on_site(api, collect_garbage)
    assert {row[0] for row in api.sql(_AT_LEISURE)} == {str(item) for item in old}
    run_jobs(api)
    assert _read(api, file)["state"] == "corrupt"
    assert _read(api, other)["verified_at"] > before


def test_old_verifications_are_repeated_oldest_first_in_batches(
    api: Api, mission_id: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = [file for file, _ in _verified(api, mission_id)]
    for days, file in enumerate(files, 200):
        api.sql(
            "UPDATE blob SET verified_at = now() - make_interval(days => %s)"
            " WHERE id = (SELECT blob_id FROM file WHERE id = %s)",
            *(days, file["id"]),
        )
    monkeypatch.setattr("kleinkram.server.maintenance._MAX_REVERIFIED", 2)
    on_site(api, collect_garbage)
    on_site(api, collect_garbage)
    waiting = {row[0] for row in api.sql(_AT_LEISURE)}
    oldest = {str(api.sql("SELECT blob_id FROM file WHERE id = %s", file["id"])[0][0]) for file in files[-2:]}
    assert waiting == oldest
    api.post(f"/files/{files[-1]['id']}/verify").ok(202)
    assert api.sql("SELECT max(priority) FROM procrastinate_jobs") == [(10,)], "asked for, it is done soon"
    api.sql("UPDATE blob SET verified_at = now() WHERE state = 'verified'")


@pytest.mark.parametrize("how", ["empty", pytest.param("another", marks=pytest.mark.slow)])
def test_another_store_marks_nothing_until_losses_are_accepted(start_api: StartApi, how: str) -> None:
    api = start_api()
    mission_id = str(api.mission(api.project()["id"])["id"])
    files = _verified(api, mission_id, 12)
    keys = list(on_site(api, lambda context: context.storage.sizes("")))
    for key in keys if how == "empty" else keys[1:]:
        _remove(api, key)
    last = _scrub(api)
    assert (last["lost"], last["compared"]) == (0, 12)
    assert "KLEINKRAM_S3_BUCKET" in last["aborted_reason"]
    assert f"{12 if how == 'empty' else 11} are not in the list" in last["aborted_reason"]
    assert {_read(api, file)["state"] for file, _ in files} == {"verified"}
    assert "scrub_stopped" in {item["kind"] for item in api.get("/home").ok()["attention"]}
    wait_until(lambda: "kleinkram_scrub_stopped 1.0" in api.metrics())
    last = _scrub(api, accept_losses=True)
    assert _counts(last) == (12 if how == "empty" else 11, 0, 0)
    wait_until(lambda: "kleinkram_scrub_stopped 0.0" in api.metrics())


def test_an_object_without_a_row_is_counted_and_left(start_api: StartApi) -> None:
    api = start_api()
    _put(api, "stray/object", b"abc")
    assert _scrub(api)["unknown"] == 1
    assert on_site(api, lambda context: context.storage.sizes("")) == {"stray/object": 3}


def test_blobs_added_and_removed_during_a_scrub_are_not_reported_missing(
    api: Api, mission_id: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    (going, _), *_ = _verified(api, mission_id)
    listed = Storage.size_pages
    came: list[Any] = []

    async def pages(self: Storage, prefix: str = "") -> AsyncIterator[dict[str, int]]:
        async for page in listed(self, prefix):
            yield page
        if not came:  # only now, when all is listed: a file comes, and another one goes for good
            came.append(None)
            came.append(upload(api, mission_id, "late.bin", os.urandom(10)))
            api.delete(f"/files/{going['id']}").ok()
            api.sql("UPDATE file SET deleted_at = now() - interval '31 days' WHERE id = %s", going["id"])

    monkeypatch.setattr(Storage, "size_pages", pages)

    async def scrub_during_garbage_collection(context: AppContext) -> None:
        async with context.database.begin() as db:
            await scrub.begin_due_scrub(db, context.settings.model_copy(update={"scrub_hours": 1e-9}))
            row = await scrub.last_scrub(db, context.settings.store_id)
        assert row is not None
        await scrub.scrub_store(context, row.id)
        await collect_garbage(context)
        await collect_garbage(context)

    on_site(api, scrub_during_garbage_collection)
    last = api.get("/admin/scrub").ok()["last"]
    assert _counts(last) == (0, 0, 0)
    assert _read(api, came[1])["state"] == "stored"
    assert _counts(_scrub(api)) == (0, 0, 0)


def test_a_scrub_with_an_incomplete_listing_marks_nothing(
    api: Api, mission_id: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = _verified(api, mission_id)
    _remove(api, _key(api, files[0][0]["id"]))

    async def pages(_self: Storage, _prefix: str = "") -> AsyncIterator[dict[str, int]]:
        yield {}
        raise StoreUnavailable(reason="it went away")

    async def begin_and_scrub(context: AppContext) -> None:
        async with context.database.begin() as db:
            await scrub.begin_due_scrub(db, context.settings.model_copy(update={"scrub_hours": 1e-9}))
            row = await scrub.last_scrub(db, context.settings.store_id)
        assert row is not None
        monkeypatch.setattr(Storage, "size_pages", pages)
        with pytest.raises(StoreUnavailable):
            await scrub.scrub_store(context, row.id)
        monkeypatch.undo()

    on_site(api, begin_and_scrub)
    assert {_read(api, file)["state"] for file, _ in files} == {"verified"}
    run_jobs(api)  # the job that waited all the while begins anew
    assert _counts(api.get("/admin/scrub").ok()["last"]) == (1, 0, 0)


def test_many_are_compared_page_by_page(api: Api, mission_id: str, monkeypatch: pytest.MonkeyPatch) -> None:
    files = _verified(api, mission_id, 23)
    monkeypatch.setattr(scrub, "_BATCH", 2)
    listed = Storage.size_pages

    async def small_pages(self: Storage, prefix: str = "") -> AsyncIterator[dict[str, int]]:
        async for page in listed(self, prefix):
            keys = sorted(page)
            for start in range(0, len(keys), 5):
                yield {key: page[key] for key in keys[start : start + 5]}

    monkeypatch.setattr(Storage, "size_pages", small_pages)
    gone = [files[place][0] for place in (0, 11, 22)]
    for file in gone:
        _remove(api, _key(api, file["id"]))
    assert _counts(_scrub(api)) == (3, 0, 0)
    assert [_read(api, file)["state"] for file in gone] == ["lost"] * 3


def test_one_scrub_runs_at_a_time_when_it_is_due(start_api: StartApi) -> None:
    api = start_api()
    first = api.post("/admin/scrub", {}).ok(202)
    assert api.post("/admin/scrub", {}).ok(202)["id"] == first["id"], "it is under way already"
    forceful = api.post("/admin/scrub", {"accept_losses": True}).ok(202)
    assert forceful["id"] != first["id"]
    run_jobs(api)
    assert api.get("/admin/scrub").ok()["last"]["id"] == forceful["id"]
    assert "replaced this one" in api.sql("SELECT aborted_reason FROM scrub WHERE id = %s", first["id"])[0][0]

    def due(hours: float) -> int:
        async def look(context: AppContext) -> None:
            async with context.database.begin() as db:
                await scrub.begin_due_scrub(db, context.settings.model_copy(update={"scrub_hours": hours}))

        on_site(api, look)
        return int(api.sql("SELECT count(*) FROM scrub")[0][0])

    assert due(24) == 2
    api.sql("UPDATE scrub SET created_at = now() - interval '25 hours'")
    assert due(0) == 2
    assert due(24) == 3
    assert due(24) == 3
    api.sql("DELETE FROM procrastinate_jobs")  # given up, or forgotten
    assert due(24) == 3
    run_jobs(api)
    assert api.get("/admin/scrub").ok()["last"]["ended_at"] is not None
