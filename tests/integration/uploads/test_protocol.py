"""The upload protocol through HTTP on a real store: success, refusals, and no byte sent twice."""

import os
import uuid
from typing import Any

import pytest

from tests.integration import upload_client
from tests.integration.api_server import Api
from tests.integration.upload_client import begin, complete, crc64, fetch, parts_of, put, send, sha256, sign, upload

_PART = 5 * 1024 * 1024


@pytest.fixture(name="one")
def _one() -> bytes:
    return os.urandom(16)


@pytest.fixture(name="two")
def _two() -> bytes:
    return os.urandom(16)


@pytest.mark.parametrize("size_bytes", [0, 1, _PART - 1, _PART, _PART + 1, 2 * _PART + 5])
def test_files_of_any_size_are_downloaded_unchanged(api: Api, mission_id: str, size_bytes: int) -> None:
    body = os.urandom(size_bytes)
    file = upload(api, mission_id, "a/run.bin", body)
    assert (file["path"], file["size_bytes"], file["state"]) == ("a/run.bin", size_bytes, "stored")
    assert (file["sha256"], file["crc64nvme"], file["md5"]) == (sha256(body), crc64(body), None)
    link = api.post("/files/download", {"file_ids": [file["id"]]}).ok()["items"][0]
    assert fetch(link["url"]) == (200, body)


def test_many_small_files_take_three_requests(api: Api, mission_id: str) -> None:
    bodies = {f"small/{number:03}": os.urandom(100 + number) for number in range(50)}
    decisions = begin(api, mission_id, bodies)
    uploads = [decision["upload"] for decision in decisions]
    expected = [{"upload_id": item["id"], "number": 1, "checksum": crc64(bodies[item["path"]])} for item in uploads]
    for item, signed in zip(uploads, api.post("/uploads/parts", {"parts": expected}).ok()["items"], strict=True):
        assert put(signed, bodies[item["path"]]) == 200
    finishes = [
        {"upload_id": item["id"], "sha256": sha256(bodies[item["path"]]), "crc64nvme": crc64(bodies[item["path"]])}
        for item in uploads
    ]
    with api.statements() as statements:
        outcomes = api.post("/uploads/complete", {"uploads": finishes}).ok()["items"]
    assert {outcome["outcome"] for outcome in outcomes} == {"completed"}
    assert len(statements) < 40, "the number of statements must not grow with the number of files"


def test_the_same_file_again_is_present_and_sends_nothing(api: Api, mission_id: str, one: bytes) -> None:
    file = upload(api, mission_id, "run.bin", one)
    assert begin(api, mission_id, {"run.bin": one}, hashed=False)[0]["decision"] == "hash_required"
    decision = begin(api, mission_id, {"run.bin": one})[0]
    assert (decision["decision"], decision["file"]["id"]) == ("already_present", file["id"])


def test_the_same_content_elsewhere_is_linked_without_a_byte(api: Api, mission_id: str) -> None:
    body = os.urandom(1000)
    first = upload(api, mission_id, "first.bin", body)
    other = str(api.mission(api.project()["id"])["id"])
    assert begin(api, other, {"second.bin": body}, hashed=False)[0]["decision"] == "hash_required"
    decision = begin(api, other, {"second.bin": body})[0]
    assert (decision["decision"], decision["file"]["origin"]) == ("deduplicated", "link")
    assert api.sql(
        "SELECT count(DISTINCT blob_id) FROM file WHERE id IN (%s, %s)", first["id"], decision["file"]["id"]
    ) == [(1,)]
    assert [event["operation"] for event in api.events(decision["file"]["id"])] == ["file.link"]


def test_bytes_that_only_others_claim_are_not_linked(api: Api, mission_id: str) -> None:
    body = os.urandom(1000)
    file = upload(api, mission_id, "theirs.bin", body)
    stranger = uuid.uuid4()
    api.sql("INSERT INTO person (id, name) VALUES (%s, 'another person')", stranger)
    api.sql(
        "UPDATE blob SET uploaded_by_id = %s WHERE id = (SELECT blob_id FROM file WHERE id = %s)", stranger, file["id"]
    )
    assert begin(api, mission_id, {"mine.bin": body})[0]["decision"] == "upload"
    api.sql(
        "UPDATE blob SET state = 'verified', md5 = decode(repeat('00', 16), 'hex'), verified_at = now()"
        " WHERE id = (SELECT blob_id FROM file WHERE id = %s)",
        file["id"],
    )
    assert begin(api, mission_id, {"yours.bin": body})[0]["decision"] == "deduplicated"


def test_other_content_under_the_same_name_is_refused_naming_both_hashes(
    api: Api, mission_id: str, one: bytes, two: bytes
) -> None:
    upload(api, mission_id, "run.bin", one)
    decision = begin(api, mission_id, {"run.bin": two})[0]
    assert (decision["decision"], decision["problem"]["code"]) == ("refused", "file_exists")
    assert sha256(one) in decision["problem"]["detail"]
    assert sha256(two) in decision["problem"]["detail"]


@pytest.mark.parametrize("path", ["RUN.bin", "run.bin/below"])
def test_a_name_that_differs_only_in_case_or_form_is_a_conflict(
    api: Api, mission_id: str, path: str, one: bytes, two: bytes
) -> None:
    upload(api, mission_id, "run.bin", one)
    decision = begin(api, mission_id, {path: two})[0]
    assert (decision["decision"], decision["problem"]["code"]) == ("refused", "path_conflict")
    assert "run.bin" in decision["problem"]["detail"]


def test_a_file_may_not_stand_where_a_folder_is(api: Api, mission_id: str, one: bytes, two: bytes) -> None:
    upload(api, mission_id, "day/run.bin", one)
    assert begin(api, mission_id, {"day": two})[0]["problem"]["code"] == "path_conflict"


def test_equal_names_in_one_request_do_not_both_begin(api: Api, mission_id: str, one: bytes, two: bytes) -> None:
    decisions = begin(api, mission_id, {"Zürich.bin": one, "ZU\u0308RICH.bin": two})
    assert [decision["decision"] for decision in decisions] == ["upload", "refused"]


def test_other_bytes_are_refused_by_the_store(api: Api, mission_id: str) -> None:
    body = os.urandom(1000)
    started = begin(api, mission_id, {"run.bin": body})[0]["upload"]
    signed = sign(api, started, [(1, body)]).ok()["items"][0]
    without = {name: value for name, value in signed["headers"].items() if name == "Content-Length"}
    assert put(signed, body[:-1] + bytes([body[-1] ^ 1])) in {400, 403}
    assert put(signed, body + b"!", {**signed["headers"], "Content-Length": "1001"}) in {400, 403}
    assert put(signed, body, without) in {400, 403}
    assert put({**signed, "url": signed["url"].replace(started["id"], str(uuid.uuid4()))}, body) in {400, 403}
    assert complete(api, started, body)["problem"]["code"] == "upload_incomplete"
    assert put(signed, body) == 200
    assert complete(api, started, body)["outcome"] == "completed"


def test_a_signed_url_expires(start_api: Any) -> None:
    api = start_api(part_url_s=1)
    mission_id = api.mission(api.project()["id"])["id"]
    started = begin(api, mission_id, {"run.bin": b"body"})[0]["upload"]
    signed = sign(api, started, [(1, b"body")]).ok()["items"][0]
    upload_client.wait_until(lambda: put(signed, b"evil") == 403)  # alive, it answers 400 to these
    # Good for less than a second, since addresses count whole ones: on a busy machine not for long enough each time.
    upload_client.wait_until(lambda: put(sign(api, started, [(1, b"body")]).ok()["items"][0], b"body") == 200)


def test_a_file_that_changes_after_its_announcement_is_gone(api: Api, mission_id: str, one: bytes, two: bytes) -> None:
    started = begin(api, mission_id, {"run.bin": one})[0]["upload"]
    sign(api, started, [(1, one)]).ok()
    sign(api, started, [(1, two)]).refused(410, "upload_gone")


def test_a_wrong_file_checksum_makes_no_file(api: Api, mission_id: str) -> None:
    body = os.urandom(_PART + 10)
    started = begin(api, mission_id, {"run.bin": body})[0]["upload"]
    send(api, started, body)
    finish = {"upload_id": started["id"], "sha256": sha256(body), "crc64nvme": "00" * 8}
    for _ in range(2):  # the same answer, however often it is asked
        outcome = api.post("/uploads/complete", {"uploads": [finish]}).ok()["items"][0]
        assert outcome["problem"]["code"] == "checksum_mismatch"
    assert api.all("/files", {"mission_id": mission_id}) == []
    assert begin(api, mission_id, {"run.bin": body})[0]["decision"] == "upload", "the name is free again"


def test_missing_parts_are_named_and_the_upload_continues(api: Api, mission_id: str) -> None:
    body = os.urandom(2 * _PART + 10)
    started = begin(api, mission_id, {"run.bin": body})[0]["upload"]
    send(api, started, body, only=[1, 3])
    problem = complete(api, started, body)["problem"]
    assert problem["code"] == "upload_incomplete"
    assert "1 of 3 parts, the first is 2" in problem["detail"]
    send(api, started, body, only=[2])
    assert complete(api, started, body)["outcome"] == "completed"


def test_completing_twice_gives_the_same_file_once(api: Api, mission_id: str) -> None:
    body = os.urandom(_PART + 10)
    started = begin(api, mission_id, {"run.bin": body})[0]["upload"]
    send(api, started, body)
    first, second = complete(api, started, body), complete(api, started, body)
    assert first["file"]["id"] == second["file"]["id"]
    assert [event["operation"] for event in api.events(first["file"]["id"])] == ["file.upload"]


def test_resuming_an_upload_lists_the_parts_in_the_store(api: Api, mission_id: str) -> None:
    body = os.urandom(3 * _PART)
    started = begin(api, mission_id, {"run.bin": body}, hashed=False)[0]["upload"]
    send(api, started, body, only=[1, 3])
    resumed = begin(api, mission_id, {"run.bin": body}, hashed=False, upload_id=started["id"])[0]["upload"]
    assert resumed["id"] == started["id"]
    assert [part["number"] for part in resumed["parts"]] == [1, 3]
    assert api.get(f"/uploads/{started['id']}").ok()["parts"] == resumed["parts"]


def test_a_repeated_begin_returns_the_same_upload(api: Api, mission_id: str, one: bytes) -> None:
    wished = str(uuid.uuid4())
    shown = [begin(api, mission_id, {"run.bin": one}, upload_id=wished)[0] for _ in range(2)]
    assert [item["upload"]["id"] for item in shown] == [wished, wished], "the first answer may have been lost"
    other = begin(api, mission_id, {"other.bin": one}, upload_id=wished)[0]["upload"]
    assert other["id"] != wished, "an id is used once"
    assert begin(api, mission_id, {"run.bin": one})[0]["problem"]["code"] == "name_leased"


def test_a_multipart_upload_unknown_to_the_database_is_resumed(api: Api, mission_id: str) -> None:
    body, wished = os.urandom(2 * _PART), str(uuid.uuid4())
    begin(api, mission_id, {"run.bin": body}, hashed=False, upload_id=wished)
    (opened,) = api.sql("SELECT multipart_id FROM upload WHERE id = %s", wished)
    api.sql("UPDATE upload SET multipart_id = NULL WHERE id = %s", wished)  # the process died before it could
    begin(api, mission_id, {"run.bin": body}, hashed=False, upload_id=wished)
    assert api.sql("SELECT multipart_id FROM upload WHERE id = %s", wished) == [opened]


def test_a_reserved_name_is_reported_with_its_owner_and_expiry(api: Api, mission_id: str, one: bytes) -> None:
    started = begin(api, mission_id, {"run.bin": one})[0]["upload"]
    decision = begin(api, mission_id, {"run.bin": one})[0]
    assert decision["problem"]["code"] == "name_leased"
    assert decision["problem"]["lease_ends_at"][:16] == started["lease_ends_at"][:16]


def test_the_name_of_a_dead_client_is_free_after_the_lease(api: Api, mission_id: str, one: bytes) -> None:
    dead = begin(api, mission_id, {"run.bin": one})[0]["upload"]
    api.sql("UPDATE upload SET lease_ends_at = now() WHERE id = %s", dead["id"])
    alive = begin(api, mission_id, {"run.bin": one})[0]["upload"]
    assert alive["id"] != dead["id"]
    send(api, alive, one)
    assert complete(api, alive, one)["outcome"] == "completed"
    assert complete(api, dead, one)["problem"]["code"] == "upload_gone"
    sign(api, dead, [(1, one)]).refused(410, "upload_gone")


def test_an_upload_can_be_cancelled(api: Api, mission_id: str, one: bytes) -> None:
    started = begin(api, mission_id, {"run.bin": one})[0]["upload"]
    assert [item["id"] for item in api.all(f"/missions/{mission_id}/uploads")] == [started["id"]]
    api.delete(f"/uploads/{started['id']}").ok(204)
    assert api.all(f"/missions/{mission_id}/uploads") == []
    assert begin(api, mission_id, {"run.bin": one})[0]["decision"] == "upload"


def test_a_mission_deleted_during_an_upload_gets_no_file(api: Api, one: bytes) -> None:
    project = api.project()
    mission_id = api.mission(project["id"])["id"]
    started = begin(api, mission_id, {"run.bin": one})[0]["upload"]
    send(api, started, one)
    api.delete(f"/projects/{project['id']}").ok()
    assert complete(api, started, one)["problem"]["code"] == "upload_gone"
    api.post(f"/missions/{mission_id}/uploads", {"files": [{"path": "b", "size_bytes": 1}]}).refused(404, "not_found")
    api.post(f"/trash/project/{project['id']}/restore").ok(204)
    assert api.all("/files", {"mission_id": mission_id}) == []


def test_a_part_that_the_file_does_not_have_is_refused(api: Api, mission_id: str, one: bytes) -> None:
    started = begin(api, mission_id, {"run.bin": one})[0]["upload"]
    problem = sign(api, started, [(2, one)]).refused(422, "invalid_request")
    assert "part 2" in problem["detail"]


def test_an_unknown_upload_is_gone(api: Api) -> None:
    unknown = {"id": str(uuid.uuid4()), "checksum": "crc64nvme"}
    sign(api, unknown, [(1, b"")]).refused(410, "upload_gone")
    assert complete(api, unknown, b"")["problem"]["code"] == "upload_gone"
    api.get(f"/uploads/{unknown['id']}").refused(404, "not_found")
    api.delete(f"/uploads/{unknown['id']}").refused(404, "not_found")


@pytest.mark.parametrize("path", ["../x", "/x", "a//b", "nul\0", "line\nbreak", "x" * 300])
def test_a_path_that_leaves_the_mission_is_refused(api: Api, mission_id: str, path: str) -> None:
    answer = api.post(f"/missions/{mission_id}/uploads", {"files": [{"path": path, "size_bytes": 1}]})
    assert "files.0.path" in answer.refused(422, "invalid_request")["problems"][0]["field"]


def test_all_clients_use_the_same_part_sizes(api: Api, mission_id: str) -> None:
    body = bytes(2 * _PART + 1)
    started = begin(api, mission_id, {"run.bin": body}, hashed=False)[0]["upload"]
    assert [len(piece) for _, piece in parts_of(started, body)] == [_PART, _PART, 1]


def test_one_part_is_signed_for_one_checksum_only(api: Api, mission_id: str, one: bytes, two: bytes) -> None:
    started = begin(api, mission_id, {"run.bin": one})[0]["upload"]
    sign(api, started, [(1, one), (1, two)]).refused(422, "invalid_request")


def test_announcing_both_hashes_of_a_small_file_returns_its_url(
    api: Api, mission_id: str, one: bytes, two: bytes
) -> None:
    [shown] = begin(api, mission_id, {"run.bin": one}, crc64nvme=crc64(one))
    started = shown["upload"]
    sign(api, started, [(1, two)]).refused(410, "upload_gone")
    again = begin(api, mission_id, {"run.bin": one}, crc64nvme=crc64(one), upload_id=started["id"])[0]
    assert again["part"]["headers"] == shown["part"]["headers"]
    assert put(again["part"], two) >= 400
    assert put(again["part"], one) == 200
    assert complete(api, started, one)["outcome"] == "completed"


def test_announcing_large_or_unhashed_files_returns_no_url(api: Api, mission_id: str, one: bytes) -> None:
    large = os.urandom(_PART + 1)
    assert begin(api, mission_id, {"run.bin": one})[0]["part"] is None
    assert begin(api, mission_id, {"large.bin": large}, crc64nvme=crc64(large))[0]["part"] is None


def test_announcing_a_file_signed_for_other_bytes_returns_no_url(
    api: Api, mission_id: str, one: bytes, two: bytes
) -> None:
    started = begin(api, mission_id, {"run.bin": one})[0]["upload"]
    sign(api, started, [(1, one)]).ok()
    again = begin(api, mission_id, {"run.bin": two}, crc64nvme=crc64(two), upload_id=started["id"])[0]
    assert (again["upload"]["id"], again["part"]) == (started["id"], None)


def test_a_signed_url_writes_once(api: Api, mission_id: str, one: bytes) -> None:
    started = begin(api, mission_id, {"run.bin": one})[0]["upload"]
    signed = sign(api, started, [(1, one)]).ok()["items"][0]
    assert put(signed, one) == 200
    assert put(signed, one) == 412, "so that nobody can replace verified bytes"
    assert complete(api, started, one)["outcome"] == "completed"


def test_a_checksum_of_the_wrong_kind_is_refused_without_side_effects(api: Api, mission_id: str, one: bytes) -> None:
    started = begin(api, mission_id, {"run.bin": one})[0]["upload"]
    wrong = {"upload_id": started["id"], "number": 1, "checksum": sha256(one)}
    problem = api.post("/uploads/parts", {"parts": [wrong]}).refused(422, "invalid_request")
    assert "16 hex digits" in problem["detail"]
    api.post("/uploads/parts", {"parts": [{**wrong, "checksum": "ab" * 8 + "c"}]}).refused(422, "invalid_request")
    send(api, started, one)
    assert complete(api, started, one)["outcome"] == "completed"


def test_a_file_and_a_folder_of_one_name_conflict(api: Api, mission_id: str, one: bytes, two: bytes) -> None:
    assert [item["decision"] for item in begin(api, mission_id, {"day": one, "day/run": two})] == ["upload", "refused"]
    other = begin(api, mission_id, {"day/run": two})[0]["upload"]
    first = api.all(f"/missions/{mission_id}/uploads")[0]
    for upload_read, body in ((first, one), (other, two)):
        send(api, upload_read, body)
    finishes = [
        {"upload_id": item["id"], "sha256": sha256(body), "crc64nvme": crc64(body)}
        for item, body in ((first, one), (other, two))
    ]
    outcomes = api.post("/uploads/complete", {"uploads": finishes}).ok()["items"]
    assert [outcome["outcome"] for outcome in outcomes] == ["completed", "refused"]
    assert outcomes[1]["problem"]["code"] == "path_conflict"


def test_completing_a_batch_again_omits_only_deleted_files(api: Api, mission_id: str, one: bytes, two: bytes) -> None:
    uploads = [item["upload"] for item in begin(api, mission_id, {"one": one, "two": two})]
    for item, body in zip(uploads, (one, two), strict=True):
        send(api, item, body)
    finishes = [
        {"upload_id": item["id"], "sha256": sha256(body), "crc64nvme": crc64(body)}
        for item, body in zip(uploads, (one, two), strict=True)
    ]
    made = api.post("/uploads/complete", {"uploads": finishes}).ok()["items"]
    api.delete(f"/files/{made[0]['file']['id']}").ok()
    again = api.post("/uploads/complete", {"uploads": finishes}).ok()["items"]
    assert again[0]["problem"]["code"] == "upload_gone"
    assert again[1]["file"]["id"] == made[1]["file"]["id"]
