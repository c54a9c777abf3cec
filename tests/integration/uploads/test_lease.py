"""A name reserved by a dead client is free when its lease ends."""

import os
import uuid
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from kleinkram.client import Client, connect
from kleinkram.client.transfer import Outcome, TransferResult, plan_upload, upload
from kleinkram.client.transfer.report import Watcher
from kleinkram.contract.errors import NameLeased
from tests.integration.api_server import Api
from tests.integration.conftest import StartApi
from tests.integration.upload_client import begin, complete, parts_of, send, sign, wait_until

_PART = 5 * 1024 * 1024
_LEASE_S = 8.0


class _Listening(Watcher):
    """Records the messages for the user."""

    def __init__(self) -> None:
        self.received: list[str] = []

    def notify(self, text: str) -> None:
        """Keep it."""
        self.received.append(text)


@pytest.fixture(name="api", scope="module")
def _api(start_api: StartApi) -> Api:
    return start_api(upload_lease_s=_LEASE_S)


@pytest.fixture(name="client")
def _client(api: Api, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Client]:
    """A client without a journal of the uploads under way."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    with connect(api.url, api.token) as client:
        yield client


@pytest.fixture(name="file")
def _file(tmp_path: Path) -> Path:
    file = tmp_path / "run.bin"
    file.write_bytes(os.urandom(_PART + 1000))
    os.utime(file, (1_700_000_000, 1_700_000_000))
    return file


def _send(client: Client, mission_id: str, file: Path, watcher: _Listening) -> TransferResult:
    return upload(client, uuid.UUID(mission_id), plan_upload([file]), watcher=watcher).results[0]


def test_the_second_client_continues_when_the_lease_ends(api: Api, client: Client, mission_id: str, file: Path) -> None:
    body = file.read_bytes()
    dead = begin(api, mission_id, {"run.bin": body}, hashed=False)[0]["upload"]
    send(api, dead, body, only=[1])
    watcher = _Listening()
    result = _send(client, mission_id, file, watcher)
    assert (result.outcome, result.error) == (Outcome.uploaded, None)
    assert watcher.received == ["waiting for run.bin: held by an upload that may have died"]
    assert result.moved_bytes == len(body), "without a journal nothing of the dead client's is taken on trust"
    lease_ended = api.sql("SELECT lease_ends_at FROM upload WHERE id = %s", dead["id"])[0][0]
    taken_over = api.sql("SELECT created_at FROM upload WHERE mission_id = %s AND id <> %s", mission_id, dead["id"])
    assert [created > lease_ended for (created,) in taken_over] == [True]
    sign(api, dead, parts_of(dead, body)[1:]).refused(410, "upload_gone")
    assert complete(api, dead, body)["problem"]["code"] == "upload_gone"


def test_a_live_client_keeps_its_reserved_name(api: Api, client: Client, mission_id: str, file: Path) -> None:
    theirs = os.urandom(_PART + 2000)
    alive = begin(api, mission_id, {"run.bin": theirs}, hashed=False)[0]["upload"]
    watcher = _Listening()
    with ThreadPoolExecutor(1) as pool:
        sending = pool.submit(_send, client, mission_id, file, watcher)
        wait_until(lambda: bool(watcher.received))
        # Leases are reported in whole seconds: a renewal in the same second would not be visible.
        late = "SELECT lease_ends_at - now() < interval '6.5 s' FROM upload WHERE id = %s"
        wait_until(lambda: api.sql(late, alive["id"]) == [(True,)])
        send(api, alive, theirs)  # asking where to send renews the lease
        result = sending.result(30)
    assert (result.outcome, type(result.error)) == (Outcome.refused, NameLeased)
    assert complete(api, alive, theirs)["outcome"] == "completed"
