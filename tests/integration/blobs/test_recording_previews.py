"""Previews of recordings on the server: made, shared by duplicates, replaced, deleted, and never a reason to fail."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import itertools
import sqlite3
import uuid
from pathlib import Path
from typing import Any

import pytest

from kleinkram.contract.access import Right
from kleinkram.recordings import FailureKind, Recording, SummaryFailed
from kleinkram.recordings.isolation import PreviewAnswer, read_preview_answer
from kleinkram.recordings.previews import PREVIEW_VERSION, make_preview, read_preview
from kleinkram.recordings.sample import SampleFormat, generate_file, generate_mcap
from kleinkram.server.blobs import preview_jobs, recording_previews
from kleinkram.server.blobs.queries import SMALL_BYTES
from kleinkram.server.maintenance import collect_garbage
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.jobs import on_site, run_jobs
from tests.integration.upload_client import begin, fetch, upload

_JOB = "make_recording_preview"
_SEEDS = itertools.count(1_000)


@pytest.fixture(name="api", scope="module")
def _api(start_api: Any) -> Api:
    """An API of its own: its jobs are run by these tests alone."""
    api: Api = start_api(garbage_grace_s=0)
    return api


@pytest.fixture(name="body", scope="module")
def _body(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("previews") / "run.mcap"
    generate_mcap(path, size_bytes=2_000_000, seed=3)
    return path.read_bytes()


def _unique(body: bytes, tmp_path: Path) -> bytes:
    """Return a recording that no other test uploads."""
    path = tmp_path / f"{uuid.uuid4().hex}.mcap"
    generate_mcap(path, size_bytes=400_000, seed=next(_SEEDS))
    return path.read_bytes()


def _preview(api: Api, file_id: str) -> dict[str, Any]:
    read: dict[str, Any] = api.get(f"/files/{file_id}/preview").ok()
    return read


def _key(api: Api, file_id: str) -> str | None:
    rows = api.sql(
        "SELECT p.key FROM recording_preview p JOIN file f ON f.blob_id = p.blob_id WHERE f.id = %s", file_id
    )
    return rows[0][0] if rows else None


def _is_stored(api: Api, key: str) -> bool:
    return on_site(api, lambda site: site.storage.find(key)) is not None


@pytest.mark.parametrize("kind", [SampleFormat.mcap, SampleFormat.bag, SampleFormat.db3])
def test_a_new_recording_has_a_preview_of_its_messages(
    api: Api, mission_id: str, tmp_path: Path, kind: SampleFormat
) -> None:
    truth = generate_file(tmp_path / f"run.{kind.value}", kind=kind, size_bytes=1_500_000, seed=4)
    file = upload(api, mission_id, truth.path.name, truth.path.read_bytes())
    assert _preview(api, file["id"])["state"] == "none"
    assert _JOB in run_jobs(api)
    read = _preview(api, file["id"])
    assert (read["state"], read["reason"], read["version"]) == ("ready", None, PREVIEW_VERSION)
    status, data = fetch(read["url"])
    assert (status, len(data)) == (200, read["size_bytes"])
    with Recording.open(truth.path) as recording:
        assert data == make_preview(recording), "the child makes what the library makes"
    preview = read_preview(data)
    counts = {topic.name: topic.count for topic in truth.topics}
    assert preview.series
    assert all(counts[series.topic] == series.message_count for series in preview.series)
    assert api.get(f"/files/{file['id']}").ok()["state"] == "verified"
    status, beginning = fetch(read["url"], Range="bytes=0-7")
    assert (status, beginning) == (206, b"KLPREV1\n")


def test_files_with_the_same_bytes_share_a_preview(api: Api, mission_id: str, body: bytes) -> None:
    first = upload(api, mission_id, "first.mcap", body)
    run_jobs(api)
    (decision,) = begin(api, mission_id, {"second.mcap": body})
    second = decision["file"]
    assert _JOB not in run_jobs(api)
    assert _preview(api, second["id"])["state"] == "ready"
    assert _key(api, first["id"]) == _key(api, second["id"])


def test_lists_show_a_picture_of_a_camera_of_the_largest_recording(api: Api, tmp_path: Path, body: bytes) -> None:
    project_id = api.project()["id"]
    missions = [api.mission(project_id)["id"] for _ in range(2)]
    generate_mcap(tmp_path / "large.mcap", size_bytes=800_000, seed=next(_SEEDS))
    large = upload(api, missions[0], "large.mcap", (tmp_path / "large.mcap").read_bytes())
    upload(api, missions[0], "small.mcap", _unique(body, tmp_path))
    assert _thumbnails(api, missions) == []
    run_jobs(api)
    (thumbnail,) = _thumbnails(api, missions)
    assert (thumbnail["mission_id"], thumbnail["file_id"]) == (missions[0], large["id"])
    preview = read_preview(fetch(_preview(api, large["id"])["url"])[1])
    strips = [[one.jpeg for one in strip.thumbnails] for strip in preview.cameras]
    assert base64.b64decode(thumbnail["jpeg"]) in [strip[len(strip) // 2] for strip in strips]
    assert _thumbnails(api.as_(people.person(api).token), missions) == []
    api.delete(f"/files/{large['id']}/preview").ok()
    (other,) = _thumbnails(api, missions)
    assert other["file_id"] != large["id"]


def test_lists_of_files_show_a_picture_of_a_camera_and_those_of_a_link_only_of_its_files(
    api: Api, tmp_path: Path, body: bytes
) -> None:
    project_id = api.project()["id"]
    mission_id = api.mission(project_id)["id"]
    shared, hidden = (upload(api, mission_id, f"{name}.mcap", _unique(body, tmp_path))["id"] for name in ("a", "b"))
    other = upload(api, mission_id, "notes.txt", b"no recording")["id"]
    run_jobs(api)
    ids = {"file_ids": [shared, hidden, other, str(uuid.uuid4())]}
    with api.statements() as statements:
        thumbnails = {item["file_id"]: item["jpeg"] for item in api.post("/files/thumbnails", ids).ok()["items"]}
    assert thumbnails.keys() == {shared, hidden}
    assert base64.b64decode(thumbnails[shared])[:3] == b"\xff\xd8\xff"
    own = [one for one in statements if "recording_preview" in one or "audit_event" in one]
    assert len(own) == 2, "one statement for all pictures, and one for the audit log"
    (event,) = [event for event in api.events(mission_id) if event["operation"] == "mission.preview"]
    assert (event["after"], event["as_admin"]) == ({"files": 2}, False)
    guest = api.as_(people.share(api, mission_id, file_ids=[shared]).secret)
    assert [item["file_id"] for item in guest.post("/files/thumbnails", ids).ok()["items"]] == [shared]
    assert api.as_(people.person(api).token).post("/files/thumbnails", ids).ok()["items"] == []
    api.post("/files/thumbnails", {"file_ids": []}).refused(422, "invalid_request")


def _thumbnails(api: Api, mission_ids: list[str]) -> list[dict[str, Any]]:
    answer = api.post("/missions/pictures", {"mission_ids": mission_ids}).ok()
    assert answer["items"] == []
    return list(answer["thumbnails"])


def test_maps_have_the_first_fix_of_a_recording_until_its_preview_is_deleted(api: Api, tmp_path: Path) -> None:
    project_id = api.project()["id"]
    mission = api.mission(project_id)
    generate_mcap(tmp_path / "drive.mcap", size_bytes=400_000, seed=next(_SEEDS))
    file = upload(api, mission["id"], "drive.mcap", (tmp_path / "drive.mcap").read_bytes())
    query = {"project_id": project_id}
    assert api.get("/mission-positions", query).ok()["items"] == []
    run_jobs(api)
    # As a worker of an earlier version leaves it.
    api.sql(
        "UPDATE recording_preview p SET is_position_known = false, latitude = NULL, longitude = NULL"
        " FROM file f WHERE f.blob_id = p.blob_id AND f.id = %s",
        file["id"],
    )
    on_site(api, collect_garbage)
    assert run_jobs(api).count(_JOB) == 1
    (shown,) = api.get("/mission-positions", query).ok()["items"]
    with Recording.open(tmp_path / "drive.mcap") as recording:
        fixes = [message.value for message in recording.messages("/gps/fix")]
    first = next(fix for fix in fixes if fix.status.status >= 0)
    assert (shown["latitude"], shown["longitude"]) == (first.latitude, first.longitude)
    api.delete(f"/files/{file['id']}/preview").ok()
    assert api.get("/mission-positions", query).ok()["items"] == []


@pytest.mark.parametrize("position", ["[91, 8]", "[NaN, 8]", "[0, 0]", "[1e999, 8]"])
def test_a_position_that_a_reader_falsified_is_none(position: str) -> None:
    answer = f'{{"preview": {{"data": "", "thumbnail": null, "position": {position}}}}}'.encode()
    assert read_preview_answer(answer, b"", 0).position is None


@pytest.mark.parametrize("position", ['["47", "8"]', "[47]", "47", '{"latitude": 47}', "[[47], 8]"])
def test_an_answer_with_a_malformed_position_is_refused(position: str) -> None:
    answer = f'{{"preview": {{"data": "", "thumbnail": null, "position": {position}}}}}'.encode()
    with pytest.raises(SummaryFailed, match="its answer cannot be understood"):
        read_preview_answer(answer, b"", 0)


def test_small_recordings_and_other_files_have_a_preview_on_request_only(
    api: Api, mission_id: str, tmp_path: Path
) -> None:
    generate_mcap(tmp_path / "small.mcap", size_bytes=80_000, seed=7)
    small = (tmp_path / "small.mcap").read_bytes()
    assert len(small) <= SMALL_BYTES
    files = [upload(api, mission_id, "small.mcap", small), upload(api, mission_id, "big.bin", bytes(SMALL_BYTES + 1))]
    assert _JOB not in run_jobs(api)
    assert [_preview(api, file["id"])["state"] for file in files] == ["none", "none"]
    assert api.post(f"/files/{files[0]['id']}/preview").ok(202)["state"] == "making"
    api.post(f"/files/{files[1]['id']}/preview").refused(422, "invalid_request")
    assert _JOB in run_jobs(api)
    assert _preview(api, files[0]["id"])["state"] == "ready"


def test_a_deleted_preview_is_made_again_only_on_request(
    api: Api, mission_id: str, tmp_path: Path, body: bytes
) -> None:
    file = upload(api, mission_id, "run.mcap", _unique(body, tmp_path))
    run_jobs(api)
    key = _key(api, file["id"])
    assert key is not None
    assert api.delete(f"/files/{file['id']}/preview").ok()["state"] == "deleted"
    assert "url" not in {name for name, value in _preview(api, file["id"]).items() if value is not None}
    on_site(api, collect_garbage)
    assert not _is_stored(api, key)
    on_site(api, collect_garbage)
    assert _JOB not in run_jobs(api)
    assert api.post(f"/files/{file['id']}/preview").ok(202)["state"] == "making"
    run_jobs(api)
    assert _preview(api, file["id"])["state"] == "ready"
    assert fetch(_preview(api, file["id"])["url"])[0] == 200
    operations = [event["operation"] for event in api.events(file["id"])]
    assert operations[0] == "file.preview"
    assert {"file.make_preview", "file.delete_preview"} <= set(operations)


def test_a_preview_that_is_made_again_replaces_its_object(
    api: Api, mission_id: str, tmp_path: Path, body: bytes
) -> None:
    file = upload(api, mission_id, "run.mcap", _unique(body, tmp_path))
    run_jobs(api)
    before = _key(api, file["id"])
    api.post(f"/files/{file['id']}/preview").ok(202)
    run_jobs(api)
    after = _key(api, file["id"])
    assert before is not None
    assert after is not None
    assert (before != after, _is_stored(api, before), _is_stored(api, after)) == (True, False, True)


def test_a_preview_is_deleted_with_its_blob(api: Api, mission_id: str, tmp_path: Path, body: bytes) -> None:
    file = upload(api, mission_id, "run.mcap", _unique(body, tmp_path))
    run_jobs(api)
    key = _key(api, file["id"])
    assert key is not None
    api.delete(f"/files/{file['id']}").ok()
    api.sql("UPDATE file SET deleted_at = now() - interval '31 days' WHERE id = %s", file["id"])
    for _ in range(2):
        on_site(api, collect_garbage)
    assert not _is_stored(api, key)
    assert api.sql("SELECT count(*) FROM recording_preview WHERE key = %s", key) == [(0,)]


def test_recordings_of_earlier_versions_get_previews_in_time(
    api: Api, mission_id: str, tmp_path: Path, body: bytes
) -> None:
    files = [upload(api, mission_id, name, _unique(body, tmp_path)) for name in ("none.mcap", "old.mcap")]
    run_jobs(api)
    key = _key(api, files[0]["id"])
    assert key is not None
    on_site(api, lambda site: site.storage.delete(key))
    api.sql("DELETE FROM recording_preview p USING file f WHERE f.blob_id = p.blob_id AND f.id = %s", files[0]["id"])
    api.sql(
        "UPDATE recording_preview p SET version = 0 FROM file f WHERE f.blob_id = p.blob_id AND f.id = %s",
        files[1]["id"],
    )
    on_site(api, collect_garbage)
    assert run_jobs(api).count(_JOB) == 2
    assert [_preview(api, file["id"])["version"] for file in files] == [recording_previews.VERSION] * 2
    on_site(api, collect_garbage)
    assert _JOB not in run_jobs(api)


def test_a_preview_that_fails_leaves_the_verification(
    api: Api, mission_id: str, tmp_path: Path, body: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(preview_jobs, "MAX_PREVIEW_BYTES", 100)
    file = upload(api, mission_id, "run.mcap", _unique(body, tmp_path))
    run_jobs(api)
    read = _preview(api, file["id"])
    assert (read["state"], read["url"]) == ("failed", None)
    assert "bytes" in read["reason"]
    stored = api.get(f"/files/{file['id']}").ok()
    assert (stored["state"], stored["content"]) == ("verified", "indexed")
    on_site(api, collect_garbage)
    assert _JOB not in run_jobs(api), "it would fail again"
    key = _key(api, file["id"])
    assert key is None


def test_a_reader_without_memory_is_a_failed_preview(start_api: Any, tmp_path: Path, body: bytes) -> None:
    api: Api = start_api(summary_memory_bytes=128 * 2**20)
    mission_id = api.mission(api.project()["id"])["id"]
    file = upload(api, mission_id, "run.mcap", body)
    run_jobs(api)
    read = _preview(api, file["id"])
    assert (read["state"], read["url"]) == ("failed", None)
    assert "memory" in read["reason"]
    assert api.get(f"/files/{file['id']}").ok()["state"] == "verified"


def test_the_setting_leaves_previews_to_requests(start_api: Any, body: bytes) -> None:
    api: Api = start_api(recording_previews=False)
    mission_id = api.mission(api.project()["id"])["id"]
    file = upload(api, mission_id, "run.mcap", body)
    assert _JOB not in run_jobs(api)
    on_site(api, collect_garbage)
    assert _JOB not in run_jobs(api)
    api.post(f"/files/{file['id']}/preview").ok(202)
    run_jobs(api)
    assert _preview(api, file["id"])["state"] == "ready"


def test_a_job_that_is_overtaken_leaves_no_object(
    api: Api, mission_id: str, tmp_path: Path, body: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = upload(api, mission_id, "run.mcap", _unique(body, tmp_path))
    make = preview_jobs._make
    keys: list[str | None] = []

    async def make_and_delete(*arguments: Any) -> PreviewAnswer:
        data = await make(*arguments)
        keys.append(await asyncio.to_thread(_key, api, file["id"]))
        await asyncio.to_thread(lambda: api.delete(f"/files/{file['id']}/preview").ok())
        return data

    monkeypatch.setattr(preview_jobs, "_make", make_and_delete)
    run_jobs(api)
    assert _preview(api, file["id"])["state"] == "deleted"
    (key,) = keys
    assert key is not None
    assert not _is_stored(api, key)


def test_readers_see_previews_and_owners_change_them(api: Api, mission_id: str, tmp_path: Path, body: bytes) -> None:
    file = upload(api, mission_id, "run.mcap", _unique(body, tmp_path))
    run_jobs(api)
    path = f"/files/{file['id']}/preview"
    stranger, reader = people.person(api), people.person(api)
    project_id = api.get(f"/missions/{mission_id}").ok()["project"]["id"]
    people.grant(api, reader, project_id=project_id, right=Right.read)
    as_stranger = api.as_(people.token(api, stranger).secret)
    for answer in (as_stranger.get(path), as_stranger.post(path), as_stranger.delete(path)):
        answer.refused(404, "not_found")
    as_reader = api.as_(people.token(api, reader).secret)
    assert as_reader.get(path).ok()["state"] == "ready"
    as_reader.post(path).refused(403, "forbidden")
    as_reader.delete(path).refused(403, "forbidden")
    guest = api.as_(people.share(api, mission_id).secret)
    assert fetch(guest.get(path).ok()["url"])[0] == 200
    guest.delete(path).refused(403, "scope_missing")


def test_a_link_to_bytes_of_others_gives_no_right_to_their_preview(
    api: Api, mission_id: str, tmp_path: Path, body: bytes
) -> None:
    theirs = _unique(body, tmp_path)
    file = upload(api, mission_id, "run.mcap", theirs)
    run_jobs(api)
    project_id = api.get(f"/missions/{mission_id}").ok()["project"]["id"]
    other = people.person(api)
    people.grant(api, other, project_id=project_id, right=Right.read)
    as_other = api.as_(people.token(api, other).secret)
    (decision,) = begin(as_other, as_other.mission(as_other.project()["id"])["id"], {"copy.mcap": theirs})
    path = f"/files/{decision['file']['id']}/preview"
    assert as_other.get(path).ok()["state"] == "ready"
    as_other.delete(path).refused(403, "forbidden")
    assert _preview(api, file["id"])["state"] == "ready"
    api.delete(f"/files/{file['id']}/preview").ok()
    as_other.post(path).refused(403, "forbidden")
    assert _preview(api, file["id"])["state"] == "deleted"
    people.grant(api, other, project_id=project_id, right=Right.delete)
    assert as_other.post(path).ok(202)["state"] == "making"
    run_jobs(api)
    assert _preview(api, file["id"])["state"] == "ready"


def test_requests_to_make_previews_are_limited(start_api: Any, body: bytes) -> None:
    api: Api = start_api(verifications_per_minute=2)
    file = upload(api, api.mission(api.project()["id"])["id"], "run.mcap", body)
    run_jobs(api)
    path = f"/files/{file['id']}/preview"
    for _ in range(2):
        api.post(path).ok(202)
    api.post(path).refused(429, "rate_limited")


def test_garbage_collection_leaves_the_key_to_a_job_that_runs(
    api: Api, mission_id: str, tmp_path: Path, body: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = upload(api, mission_id, "run.mcap", _unique(body, tmp_path))
    path, make, keys = f"/files/{file['id']}/preview", preview_jobs._make, list[str | None]()

    async def make_after_deletion(*arguments: Any) -> PreviewAnswer:
        data = await make(*arguments)
        if not keys:
            await asyncio.to_thread(lambda: api.delete(path).ok())
            await asyncio.to_thread(lambda: on_site(api, collect_garbage))
            keys.append(await asyncio.to_thread(_key, api, file["id"]))
            await asyncio.to_thread(lambda: api.post(path).ok(202))
        return data

    monkeypatch.setattr(preview_jobs, "_make", make_after_deletion)
    run_jobs(api)
    run_jobs(api)
    assert keys[0] is not None
    assert _preview(api, file["id"])["state"] == "ready"
    key = _key(api, file["id"])
    assert key is not None
    assert _is_stored(api, key)
    assert key == keys[0] or not _is_stored(api, keys[0])


def test_a_request_after_a_running_job_recorded_its_result_is_not_lost(
    api: Api, mission_id: str, tmp_path: Path, body: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = upload(api, mission_id, "run.mcap", _unique(body, tmp_path))
    record, keys = recording_previews.record_ready, list[str | None]()

    async def record_and_request(*arguments: Any, **more: Any) -> bool:
        is_recorded = await record(*arguments, **more)
        if not keys:
            db = arguments[0]
            await recording_previews.make_again(db, arguments[1])
            keys.append(more["key"])
        return is_recorded

    monkeypatch.setattr(recording_previews, "record_ready", record_and_request)
    run_jobs(api)
    run_jobs(api)
    assert _preview(api, file["id"])["state"] == "ready"
    assert _key(api, file["id"]) != keys[0]


def test_a_temporary_failure_is_tried_once_more_after_a_day(
    api: Api, mission_id: str, tmp_path: Path, body: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = upload(api, mission_id, "run.mcap", _unique(body, tmp_path))

    async def take_too_long(*_: Any) -> bytes:
        raise SummaryFailed("it takes too long", kind=FailureKind.time)

    def collect_a_day_later() -> list[str]:
        api.sql(
            "UPDATE recording_preview p SET made_at = now() - interval '25 hours' FROM file f"
            " WHERE f.blob_id = p.blob_id AND f.id = %s",
            file["id"],
        )
        on_site(api, collect_garbage)
        return run_jobs(api)

    monkeypatch.setattr(preview_jobs, "_make", take_too_long)
    run_jobs(api)
    on_site(api, collect_garbage)
    assert _JOB not in run_jobs(api), "not before a day has passed"
    assert _preview(api, file["id"])["state"] == "failed"
    assert _JOB in collect_a_day_later()
    assert _JOB not in collect_a_day_later(), "it failed twice"
    monkeypatch.undo()
    api.post(f"/files/{file['id']}/preview").ok(202)
    run_jobs(api)
    assert _preview(api, file["id"])["state"] == "ready"


def test_a_database_that_is_too_large_has_a_reason_for_people(
    api: Api, mission_id: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(preview_jobs, "_MAX_SCAN_BYTES", 1_000_000)
    truth = generate_file(tmp_path / "run.db3", kind=SampleFormat.db3, size_bytes=1_500_000, seed=5)
    file = upload(api, mission_id, "run.db3", truth.path.read_bytes())
    run_jobs(api)
    read = _preview(api, file["id"])
    assert read["state"] == "failed"
    assert "at most 1,000,000 are" in read["reason"]
    assert "max_bytes" not in read["reason"]


def test_a_preview_of_a_database_has_what_is_in_the_log_beside_it(api: Api, mission_id: str, tmp_path: Path) -> None:
    truth = generate_file(tmp_path / "run.db3", kind=SampleFormat.db3, size_bytes=1_500_000, seed=6)
    path, log = truth.path, Path(f"{truth.path}-wal")
    with contextlib.closing(sqlite3.connect(path)) as writer:
        assert writer.execute("PRAGMA journal_mode=WAL").fetchone() == ("wal",)
        writer.execute("PRAGMA wal_autocheckpoint=0")
        writer.execute(
            "INSERT INTO messages (topic_id, timestamp, data) SELECT topic_id, timestamp, data FROM messages"
        )
        writer.commit()
        database, log_bytes = path.read_bytes(), log.read_bytes()
    file = upload(api, mission_id, "run.db3", database)
    run_jobs(api)
    before = read_preview(fetch(_preview(api, file["id"])["url"])[1])
    upload(api, mission_id, "run.db3-wal", log_bytes)
    run_jobs(api)
    after = read_preview(fetch(_preview(api, file["id"])["url"])[1])
    counts = {series.topic: series.message_count for series in before.series}
    assert counts
    assert {series.topic: series.message_count for series in after.series} == {
        topic: 2 * count for topic, count in counts.items()
    }


def test_a_scrub_counts_no_preview_as_unknown(api: Api, mission_id: str, tmp_path: Path, body: bytes) -> None:
    upload(api, mission_id, "run.mcap", _unique(body, tmp_path))
    run_jobs(api)
    api.post("/admin/scrub", {}).ok(202)
    run_jobs(api)
    (unknown, reason) = api.sql("SELECT unknown, aborted_reason FROM scrub ORDER BY created_at DESC LIMIT 1")[0]
    assert (unknown, reason) == (0, None)


def test_the_version_is_that_of_the_library() -> None:
    assert recording_previews.VERSION == PREVIEW_VERSION
