"""Small files sent but not completed are not sent again after a kill."""

import os
import uuid
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from kleinkram.client import connect
from kleinkram.client.files import Uploads
from kleinkram.client.transfer import Outcome, plan_upload, upload
from kleinkram.client.transfer.journal import journals_dir
from kleinkram.contract.uploads import UploadFinish
from tests.integration.api_server import Api
from tests.integration.upload_client import begin, complete, send, wait_until


@pytest.mark.parametrize("count", [1, 9])
def test_resuming_lists_small_files_already_uploaded(api: Api, mission_id: str, count: int) -> None:
    bodies = {f"{number}.txt": os.urandom(10 + number) for number in range(count)}
    first = {item["upload"]["path"]: item["upload"] for item in begin(api, mission_id, bodies)}
    sent = [path for number, path in enumerate(bodies) if number % 3 == 0]
    for path in sent:
        send(api, first[path], bodies[path])
    again = [{"path": path, "size_bytes": len(body), "upload_id": first[path]["id"]} for path, body in bodies.items()]
    for decision in api.post(f"/missions/{mission_id}/uploads", {"files": again}).ok()["items"]:
        answer = decision["upload"]
        assert decision["decision"] == "upload"
        assert answer["id"] == first[answer["path"]]["id"]
        size_bytes = len(bodies[answer["path"]])
        locked = [(part["number"], part["size_bytes"]) for part in answer["parts"]]
        assert locked == ([(1, size_bytes)] if answer["path"] in sent else [])
        assert api.get(f"/uploads/{answer['id']}").ok()["parts"] == answer["parts"]
    for path in sent:
        assert complete(api, first[path], bodies[path])["outcome"] == "completed"


class _Killed(BaseException):
    """As by kill -9: nothing is tidied up on the way."""


@pytest.mark.parametrize("count", [1, 30])
def test_a_client_killed_before_completion_sends_nothing_again(
    api: Api, mission_id: str, count: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    folder = tmp_path / "drive"
    folder.mkdir()
    for number in range(count):
        (folder / f"{number}.bin").write_bytes(os.urandom(1000 + number))
        os.utime(folder / f"{number}.bin", (1_700_000_000, 1_700_000_000))
    planned = plan_upload([folder])

    def all_are_sent() -> bool:
        return [len(path.read_text().splitlines()) for path in journals_dir().glob("*.jsonl")] == [2] * count

    def killed(_self: Uploads, _finishes: Sequence[UploadFinish]) -> Any:
        wait_until(all_are_sent)
        raise _Killed

    with connect(api.url, api.token) as client:
        with monkeypatch.context() as patched:
            patched.setattr(Uploads, "complete", killed)
            with pytest.raises(_Killed):
                upload(client, uuid.UUID(mission_id), planned)
        results = upload(client, uuid.UUID(mission_id), planned).results
    assert [(result.outcome, result.moved_bytes) for result in results] == [(Outcome.uploaded, 0)] * count
    assert len(api.all("/files", {"mission_id": mission_id})) == count
