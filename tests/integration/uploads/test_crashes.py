"""A crash at each step of an upload, and its recovery."""

import os
import threading
from typing import Any

import pytest

from kleinkram.contract.access import Right, Scope
from kleinkram.contract.uploads import UploadFinish
from kleinkram.server.access.actor import Actor
from kleinkram.server.context import AppContext
from kleinkram.server.uploads import completion
from kleinkram.server.uploads.jobs import maintain_uploads
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.jobs import on_site
from tests.integration.upload_client import begin, complete, crc64, send, sha256, sign

_PART = 5 * 1024 * 1024


def _tend(api: Api) -> None:
    on_site(api, lambda context: maintain_uploads(context, stale_after_s=0))


def _mark_only(api: Api, upload: Any, body: bytes) -> None:
    """Do what `complete` does up to its first commit, and die."""

    async def mark(context: AppContext) -> None:
        finish = UploadFinish(upload_id=upload["id"], sha256=sha256(body), crc64nvme=crc64(body))
        row = api.sql("SELECT person_id FROM upload WHERE id = %s", upload["id"])[0]
        async with context.database.begin() as db:
            await completion._mark_completing(db, Actor(row[0], "owner", None, None), [finish])

    on_site(api, mark)


@pytest.mark.parametrize("size_bytes", [100, _PART + 100])
def test_a_crash_after_the_mark_is_finished_by_the_job(api: Api, mission_id: str, size_bytes: int) -> None:
    body = os.urandom(size_bytes)
    upload = begin(api, mission_id, {"run.bin": body})[0]["upload"]
    send(api, upload, body)
    _mark_only(api, upload, body)
    assert api.all("/files", {"mission_id": mission_id}) == []
    _tend(api)
    files = api.all("/files", {"mission_id": mission_id})
    assert [(file["path"], file["sha256"]) for file in files] == [("run.bin", sha256(body))]
    assert complete(api, upload, body)["file"]["id"] == files[0]["id"]


def test_a_crash_after_joining_the_parts_is_finished_by_the_job(api: Api, mission_id: str) -> None:
    body = os.urandom(_PART + 100)
    upload = begin(api, mission_id, {"run.bin": body})[0]["upload"]
    send(api, upload, body)
    _mark_only(api, upload, body)
    key, multipart_id = api.sql("SELECT key, multipart_id FROM upload WHERE id = %s", upload["id"])[0]
    crc = bytes.fromhex(crc64(body))
    on_site(api, lambda context: context.storage.complete_multipart(key, multipart_id, count=2, crc64nvme=crc))
    assert complete(api, upload, body)["outcome"] == "completed"


def test_a_marked_upload_without_its_parts_is_reopened(api: Api, mission_id: str) -> None:
    body = os.urandom(_PART + 100)
    upload = begin(api, mission_id, {"run.bin": body})[0]["upload"]
    send(api, upload, body, only=[1])
    _mark_only(api, upload, body)
    _tend(api)
    send(api, upload, body, only=[2])
    assert complete(api, upload, body)["outcome"] == "completed"


@pytest.mark.parametrize("size_bytes", [100, _PART + 100])
def test_uploading_again_does_not_wait_for_garbage_collection(api: Api, mission_id: str, size_bytes: int) -> None:
    body = os.urandom(size_bytes)
    upload = begin(api, mission_id, {"run.bin": body})[0]["upload"]
    send(api, upload, body)
    _mark_only(api, upload, body)
    file = {"path": "run.bin", "size_bytes": size_bytes, "sha256": sha256(body), "upload_id": upload["id"]}
    path = f"/missions/{mission_id}/uploads"
    api.as_(people.person(api).token).post(path, {"files": [file]}).refused(404, "not_found")
    assert begin(api, mission_id, {"run.bin": body})[0]["problem"]["code"] == "name_leased", "not gone on with"
    (decision,) = api.post(path, {"files": [file]}).ok()["items"]
    assert (decision["decision"], decision["file"]["sha256"]) == ("already_present", sha256(body))


def test_a_token_without_the_right_ends_no_uploads(api: Api, mission_id: str) -> None:
    body = os.urandom(100)
    ada = people.person(api)
    people.grant(api, ada, Right.create, mission_id=mission_id)
    elsewhere = api.mission(api.project()["id"])["id"]
    people.grant(api, ada, Right.create, mission_id=elsewhere)
    theirs = api.as_(ada.token)
    upload = begin(theirs, mission_id, {"run.bin": body})[0]["upload"]
    send(theirs, upload, body)
    _mark_only(api, upload, body)
    limited = api.as_(people.token(api, ada, [Scope.upload], limits=[elsewhere]).secret)
    file = {"path": "run.bin", "size_bytes": 100, "sha256": sha256(body), "upload_id": upload["id"]}
    limited.post(f"/missions/{mission_id}/uploads", {"files": [file]}).refused(404, "not_found")
    assert complete(theirs, upload, body)["outcome"] == "completed"


def test_a_partial_upload_continues_after_it_was_marked(api: Api, mission_id: str) -> None:
    body = os.urandom(_PART + 100)
    upload = begin(api, mission_id, {"run.bin": body})[0]["upload"]
    send(api, upload, body, only=[1])
    _mark_only(api, upload, body)
    file = {"path": "run.bin", "size_bytes": len(body), "upload_id": upload["id"]}
    (decision,) = api.post(f"/missions/{mission_id}/uploads", {"files": [file]}).ok()["items"]
    assert (decision["decision"], [part["number"] for part in decision["upload"]["parts"]]) == ("upload", [1])
    send(api, decision["upload"], body, only=[2])
    assert complete(api, decision["upload"], body)["outcome"] == "completed"


def test_an_abandoned_upload_expires_and_is_removed_from_the_store(start_api: Any) -> None:
    api = start_api()
    mission_id = api.mission(api.project()["id"])["id"]
    large, small = os.urandom(_PART + 100), os.urandom(100)
    uploads = [item["upload"] for item in begin(api, mission_id, {"large": large, "small": small})]
    send(api, uploads[0], large, only=[1])
    send(api, uploads[1], small)
    api.sql("UPDATE upload SET expires_at = now(), lease_ends_at = now() - interval '1 hour'")
    _tend(api)
    assert {row[0] for row in api.sql("SELECT state FROM upload")} == {"expired"}
    assert api.sql("SELECT count(*) FROM upload WHERE cleaned_at IS NULL") == [(0,)]
    assert on_site(api, lambda context: context.storage.sizes("")) == {}
    assert on_site(api, lambda context: context.storage.list_multiparts("")) == []
    sign(api, uploads[1], [(1, small)]).refused(410, "upload_gone")
    assert begin(api, mission_id, {"small": small})[0]["decision"] == "upload"


def test_an_unrecorded_multipart_upload_is_aborted(api: Api, mission_id: str) -> None:
    body = os.urandom(_PART + 100)
    upload = begin(api, mission_id, {"run.bin": body})[0]["upload"]
    key = api.sql("SELECT key FROM upload WHERE id = %s", upload["id"])[0][0]
    on_site(api, lambda context: context.storage.create_multipart(key))  # the answer of this one was lost
    api.delete(f"/uploads/{upload['id']}").ok(204)
    assert len(on_site(api, lambda context: context.storage.list_multiparts(key))) == 2
    _tend(api)
    assert on_site(api, lambda context: context.storage.list_multiparts(key)) == []


def test_one_of_two_concurrent_clients_of_a_name_gets_a_conflict(api: Api, mission_id: str) -> None:
    bodies = [os.urandom(1000) for _ in range(8)]
    barrier = threading.Barrier(len(bodies))
    outcomes: list[str] = []

    def race(body: bytes) -> None:
        barrier.wait()
        decision = begin(api, mission_id, {"run.bin": body})[0]
        if decision["decision"] == "upload":
            send(api, decision["upload"], body)
            outcomes.append(complete(api, decision["upload"], body)["outcome"])
        else:
            outcomes.append(decision["problem"]["code"])

    threads = [threading.Thread(target=race, args=(body,)) for body in bodies]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert outcomes.count("completed") == 1
    assert set(outcomes) <= {"completed", "name_leased", "file_exists"}
    assert len(outcomes) == len(bodies)
    assert len(api.all("/files", {"mission_id": mission_id})) == 1


def test_completing_from_two_sides_at_once_makes_one_file(api: Api, mission_id: str) -> None:
    body = os.urandom(_PART + 100)
    upload = begin(api, mission_id, {"run.bin": body})[0]["upload"]
    send(api, upload, body)
    answers: list[Any] = []
    threads = [threading.Thread(target=lambda: answers.append(complete(api, upload, body))) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert {answer["outcome"] for answer in answers} == {"completed"}
    assert len({answer["file"]["id"] for answer in answers}) == 1
    assert len(api.all("/files", {"mission_id": mission_id})) == 1
