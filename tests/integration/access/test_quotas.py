"""Quotas: no operation exceeds them, also when many run at the same time."""

import threading
from typing import Any

import pytest

from kleinkram.contract.access import Right, Scope
from tests.integration import people
from tests.integration.api_server import Answer, Api
from tests.integration.sample import Sample
from tests.integration.upload_client import begin, complete, send, sha256, upload


def _bounded(api: Api, **quota: int | None) -> tuple[Any, Any]:
    project = api.project()
    changed = api.patch(f"/projects/{project['id']}", quota).ok()
    assert {name: changed[name] for name in quota} == quota
    return changed, api.mission(project["id"])


def _begin(api: Api, mission_id: str, sizes: dict[str, int]) -> Answer:
    files = [{"path": path, "size_bytes": size, "sha256": sha256(path.encode())} for path, size in sizes.items()]
    return api.post(f"/missions/{mission_id}/uploads", {"files": files})


def test_an_upload_beyond_the_quota_is_refused_at_its_start_with_numbers(api: Api) -> None:
    project, mission = _bounded(api, quota_bytes=1000)
    upload(api, mission["id"], "first", b"x" * 700)
    refused = _begin(api, mission["id"], {"a": 200, "b": 101}).refused(507, "quota_exceeded")
    assert (refused["unit"], refused["used"], refused["requested"], refused["quota"]) == ("bytes", 700, 301, 1000)
    assert all(number in refused["detail"] for number in ("700", "301", "1000", project["name"]))
    assert api.all(f"/missions/{mission['id']}/uploads") == [], "nothing was begun"
    _begin(api, mission["id"], {"a": 200, "b": 100}).ok()
    seen = api.get(f"/projects/{project['id']}").ok()
    assert (seen["used_bytes"], seen["used_files"], seen["size_bytes"]) == (1000, 3, 700)


def test_quotas_limit_the_number_of_files(api: Api) -> None:
    _, mission = _bounded(api, quota_files=2)
    _begin(api, mission["id"], {"a": 1, "b": 1}).ok()
    refused = _begin(api, mission["id"], {"c": 0}).refused(507, "quota_exceeded")
    assert (refused["unit"], refused["used"], refused["requested"], refused["quota"]) == ("files", 2, 1, 2)


def test_an_abandoned_upload_frees_its_quota(api: Api) -> None:
    _, mission = _bounded(api, quota_bytes=100)
    (opened,) = _begin(api, mission["id"], {"a": 100}).ok()["items"]
    _begin(api, mission["id"], {"b": 1}).refused(507, "quota_exceeded")
    api.delete(f"/uploads/{opened['upload']['id']}").ok(204)
    _begin(api, mission["id"], {"b": 100}).ok()


def test_resumed_and_duplicate_uploads_need_no_more_quota(api: Api) -> None:
    _, mission = _bounded(api, quota_bytes=100, quota_files=2)
    body = b"x" * 60
    (opened,) = begin(api, mission["id"], {"a": body})
    (resumed,) = begin(api, mission["id"], {"a": body}, upload_id=opened["upload"]["id"])
    assert resumed["upload"]["id"] == opened["upload"]["id"]
    send(api, opened["upload"], body)
    complete(api, opened["upload"], body)
    (present,) = begin(api, mission["id"], {"a": body})
    assert present["decision"] == "already_present"
    other = b"y" * 60
    assert _begin(api, mission["id"], {"a": 60, "b": 60}).refused(507, "quota_exceeded")["requested"] == 60
    (linked,) = begin(api, mission["id"], {"b": other[:40]})
    assert linked["decision"] == "upload"


def test_duplicates_count_with_all_their_bytes(api: Api) -> None:
    _, mission = _bounded(api, quota_bytes=100)
    body = b"z" * 60
    upload(api, mission["id"], "a", body)
    api.post(
        f"/missions/{mission['id']}/uploads",
        {
            "files": [
                {"path": "b", "size_bytes": 60, "sha256": sha256(body)},
            ]
        },
    ).refused(507, "quota_exceeded")


def test_concurrent_uploads_cannot_exceed_the_quota(api: Api) -> None:
    project, _ = _bounded(api, quota_files=3)
    missions = [api.mission(project["id"])["id"] for _ in range(6)]
    gate, statuses = threading.Barrier(6), []

    def push(mission_id: str) -> None:
        gate.wait()
        statuses.append(_begin(api, mission_id, {"a": 10}).status)

    threads = [threading.Thread(target=push, args=(mission_id,)) for mission_id in missions]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(statuses) == [200] * 3 + [507] * 3
    assert api.get(f"/projects/{project['id']}").ok()["used_files"] == 3


def test_moving_into_a_project_counts_toward_its_quota(api: Api, sample: Sample) -> None:
    source = api.project()
    mission = api.mission(source["id"])
    files = [sample.file(mission["id"], name, size_bytes=60) for name in ("a", "b")]
    target, there = _bounded(api, quota_bytes=100)
    moved = api.patch(f"/missions/{mission['id']}", {"project_id": target["id"]}).refused(507, "quota_exceeded")
    assert (moved["requested"], moved["used"]) == (120, 0)
    api.patch(f"/files/{files[0]}", {"mission_id": there["id"]}).ok()
    api.patch(f"/files/{files[1]}", {"mission_id": there["id"]}).refused(507, "quota_exceeded")
    second = api.mission(target["id"])
    api.patch(f"/files/{files[0]}", {"mission_id": second["id"]}).ok()


def test_restoring_counts_toward_the_quota_again(api: Api, sample: Sample) -> None:
    project, mission = _bounded(api, quota_bytes=100)
    file_id = sample.file(mission["id"], "a", size_bytes=60)
    api.delete(f"/files/{file_id}").ok()
    other = api.mission(project["id"])
    second = sample.file(other["id"], "b", size_bytes=60)
    api.post(f"/trash/file/{file_id}/restore").refused(507, "quota_exceeded")
    api.delete(f"/missions/{other['id']}").ok()
    api.post(f"/trash/file/{file_id}/restore").ok(204)
    api.post(f"/trash/mission/{other['id']}/restore").refused(507, "quota_exceeded")
    api.patch(f"/projects/{project['id']}", {"quota_bytes": None}).ok()
    api.post(f"/trash/mission/{other['id']}/restore").ok(204)
    assert api.get(f"/files/{second}").ok()["path"] == "b"


def test_a_missing_file_can_be_uploaded_again_into_a_full_project(api: Api) -> None:
    _, mission = _bounded(api, quota_files=1)
    body = b"needed again"
    there = upload(api, mission["id"], "a", body)
    api.sql("UPDATE blob SET state = 'lost' FROM file WHERE blob.id = file.blob_id AND file.id = %s", there["id"])
    (decision,) = begin(api, mission["id"], {"a": body})
    assert decision["decision"] == "upload"


def test_only_admins_set_quotas(api: Api) -> None:
    ada = people.person(api)
    project = api.project()
    people.grant(api, ada, Right.delete, project_id=project["id"])
    api.as_(ada.token).patch(f"/projects/{project['id']}", {"quota_bytes": 5}).refused(403, "forbidden")
    weak = people.token(api, people.person(api, admin=True), [Scope.write])
    api.as_(weak.secret).patch(f"/projects/{project['id']}", {"quota_bytes": 5}).refused(404, "not_found")
    api.patch(f"/projects/{project['id']}", {"quota_bytes": -1}).refused(422, "invalid_request")
    api.patch(f"/projects/{project['id']}", {"quota_bytes": 5, "description": "x"}).ok()
    api.patch(f"/projects/{project['id']}", {"quota_bytes": 5}).ok()
    quota, update = api.events(project["id"])[:2]
    assert {quota["operation"], update["operation"]} == {"project.set_quota", "project.update"}
    (message,) = [event for event in (quota, update) if event["operation"] == "project.set_quota"]
    assert (message["before"], message["after"]) == ({"quota_bytes": None}, {"quota_bytes": 5})


@pytest.mark.parametrize("who", ["robot", "partner"])
def test_quota_errors_show_no_numbers_of_a_hidden_project(api: Api, who: str) -> None:
    project, mission = _bounded(api, quota_bytes=100)
    upload(api, mission["id"], "a", b"x" * 60)
    if who == "robot":
        secret = api.post("/tokens", {"name": "r", "kind": "robot", "project_ids": [project["id"]]}).ok(201)["secret"]
    else:
        ada = people.person(api)
        people.grant(api, ada, Right.create, mission_id=mission["id"])
        secret = ada.token
    refused = _begin(api.as_(secret), mission["id"], {"b": 41}).refused(507, "quota_exceeded")
    assert refused["requested"] == 41
    assert not {"used", "quota"} & refused.keys()
    assert "are used" not in refused["detail"]
