"""Concurrent linking and completing: in either order the second sees the effect of the first."""

import os
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

import pytest

from kleinkram.server.uploads import queries
from tests.integration.api_server import Api
from tests.integration.races import racing
from tests.integration.upload_client import begin, complete, fetch, send, upload

_BLOCK = "SELECT 1 FROM mission WHERE id = %s FOR UPDATE"


@pytest.fixture(name="duplicate")
def _duplicate(api: Api) -> bytes:
    """What is in a file of another mission already, so that it is linked and not sent."""
    body = os.urandom(1000)
    upload(api, api.mission(api.project()["id"])["id"], "copy.bin", body)
    return body


def _read(api: Api, mission_id: str) -> list[tuple[str, bytes]]:
    files = api.all("/files", {"mission_id": mission_id})
    links = [api.post("/files/download", {"file_ids": [file["id"]]}).ok()["items"][0] for file in files]
    return [(file["path"], fetch(link["url"])[1]) for file, link in zip(files, links, strict=True)]


def _race(api: Api, mission_id: str, works: "list[Callable[[], Any]]") -> list[Any]:
    """Do these at once, in the order given as far as they wait for the same mission; return what they return."""
    with racing(api, _BLOCK, mission_id) as send_one:
        futures: list[Future[Any]] = [send_one(work) for work in works]
    return [future.result(30) for future in futures]


@pytest.mark.parametrize("link_first", [True, False])
def test_a_link_does_not_replace_a_completed_upload(
    api: Api, mission_id: str, duplicate: bytes, link_first: bool
) -> None:
    body = os.urandom(1000)
    started = begin(api, mission_id, {"run.bin": body})[0]["upload"]
    send(api, started, body)
    api.sql("UPDATE upload SET lease_ends_at = now() - interval '1 s' WHERE id = %s", started["id"])

    def link() -> Any:
        return begin(api, mission_id, {"run.bin": duplicate})[0]

    def finish() -> Any:
        return complete(api, started, body)

    # The mark of completing is set before the mission is waited for: from then on the name is held whatever the lease.
    works = [link, finish] if link_first else [finish, link]
    answers = dict(zip(works, _race(api, mission_id, works), strict=True))
    assert answers[finish]["outcome"] == "completed"
    assert answers[link]["decision"] == "refused"
    assert answers[link]["problem"]["code"] in {"name_leased", "file_exists"}
    assert _read(api, mission_id) == [("run.bin", body)]


def test_the_first_of_a_link_and_an_upload_gets_the_name(api: Api, mission_id: str, duplicate: bytes) -> None:
    body = os.urandom(1000)

    def link() -> Any:
        return begin(api, mission_id, {"run.bin": duplicate})[0]

    def announce() -> Any:
        return begin(api, mission_id, {"run.bin": body})[0]

    linked, announced = _race(api, mission_id, [link, announce])
    assert (linked["decision"], announced["decision"]) == ("deduplicated", "refused")
    assert announced["problem"]["code"] == "file_exists"
    assert _read(api, mission_id) == [("run.bin", duplicate)]


@pytest.mark.parametrize("link_first", [True, False])
def test_a_missing_file_is_repaired_once_by_the_first_upload(
    api: Api, mission_id: str, duplicate: bytes, link_first: bool
) -> None:
    linked = begin(api, mission_id, {"run.bin": duplicate})[0]["file"]
    api.sql("UPDATE blob SET state = 'lost' WHERE id = (SELECT blob_id FROM file WHERE id = %s)", linked["id"])
    started = begin(api, mission_id, {"run.bin": duplicate})[0]["upload"]
    send(api, started, duplicate)
    other = api.mission(api.project()["id"])["id"]
    upload(api, other, "good.bin", duplicate)

    def link() -> Any:
        return begin(api, mission_id, {"run.bin": duplicate})[0]

    def finish() -> Any:
        return complete(api, started, duplicate)

    works = [link, finish] if link_first else [finish, link]
    answers = dict(zip(works, _race(api, mission_id, works), strict=True))
    assert answers[finish]["outcome"] == "completed"
    assert answers[link]["decision"] in {"already_present", "refused"}
    assert _read(api, mission_id) == [("run.bin", duplicate)]
    assert [file["id"] for file in api.all("/files", {"mission_id": mission_id})] == [linked["id"]]


def test_a_missing_file_verified_before_it_is_linked_is_present(
    api: Api, mission_id: str, duplicate: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    mine = begin(api, mission_id, {"run.bin": duplicate})[0]["file"]["id"]
    (blob_id,) = api.sql(
        "UPDATE blob SET state = 'lost' FROM file WHERE blob_id = blob.id AND file.id = %s RETURNING blob.id", mine
    )[0]
    upload(api, api.mission(api.project()["id"])["id"], "good.bin", duplicate)
    real = queries.lock_duplicates

    async def lock_and_heal(*of: Any) -> Any:
        results = await real(*of)
        api.sql("UPDATE blob SET state = 'verified', md5 = %s, verified_at = now() WHERE id = %s", bytes(16), blob_id)
        return results

    monkeypatch.setattr(queries, "lock_duplicates", lock_and_heal)
    (decision,) = begin(api, mission_id, {"run.bin": duplicate})
    assert (decision["decision"], decision["file"]["id"]) == ("already_present", mine)
