"""Deleting and moving during an upload: in either order the second sees the effect of the first."""

import os
from typing import Any

import pytest

from tests.integration.api_server import Api
from tests.integration.races import racing
from tests.integration.upload_client import begin, complete, send, sha256, upload

_BLOCK = "SELECT 1 FROM mission WHERE id = %s FOR UPDATE"


def _sent(api: Api, mission_id: str, path: str) -> tuple[Any, bytes]:
    body = os.urandom(1000)
    started = begin(api, mission_id, {path: body})[0]["upload"]
    send(api, started, body)
    return started, body


@pytest.mark.parametrize("delete_first", [True, False])
def test_a_mission_deleted_while_an_upload_is_completed(api: Api, mission_id: str, delete_first: bool) -> None:
    started, body = _sent(api, mission_id, "run.bin")
    with racing(api, _BLOCK, mission_id) as send_one:
        if delete_first:
            deleted = send_one(api.delete, f"/missions/{mission_id}")
            completed = send_one(complete, api, started, body)
        else:
            completed = send_one(complete, api, started, body)
            deleted = send_one(api.delete, f"/missions/{mission_id}")
    deleted.result(30).ok()
    outcome = completed.result(30)
    files = api.sql("SELECT path FROM file WHERE mission_id = %s", mission_id)
    if delete_first:
        assert (outcome["outcome"], outcome["problem"]["code"], files) == ("refused", "upload_gone", [])
    else:
        assert (outcome["outcome"], files) == ("completed", [("run.bin",)])
        api.post(f"/trash/mission/{mission_id}/restore").ok(204)
        assert [file["sha256"] for file in api.all("/files", {"mission_id": mission_id})] == [sha256(body)]


@pytest.mark.parametrize("move_first", [True, False])
def test_a_file_moved_to_where_an_upload_is_completed(api: Api, mission_id: str, move_first: bool) -> None:
    other = upload(api, mission_id, "other.bin", os.urandom(100))
    started, body = _sent(api, mission_id, "run.bin")
    with racing(api, _BLOCK, mission_id) as send_one:
        if move_first:
            moved = send_one(api.patch, f"/files/{other['id']}", {"path": "run.bin"})
            completed = send_one(complete, api, started, body)
        else:
            completed = send_one(complete, api, started, body)
            moved = send_one(api.patch, f"/files/{other['id']}", {"path": "run.bin"})
    outcome = completed.result(30)
    results = {file["path"]: file["sha256"] for file in api.all("/files", {"mission_id": mission_id})}
    if move_first:
        moved.result(30).ok()
        assert (outcome["outcome"], outcome["problem"]["code"]) == ("refused", "file_exists")
        assert results == {"run.bin": other["sha256"]}
    else:
        moved.result(30).refused(409, "name_taken")
        assert outcome["outcome"] == "completed"
        assert results == {"run.bin": sha256(body), "other.bin": other["sha256"]}
