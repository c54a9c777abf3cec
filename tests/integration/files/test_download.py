"""Download links: valid for reading the bytes from the store, and recorded in the audit log."""

import asyncio
import uuid

import pytest
import urllib3

from kleinkram.server.s3.storage import open_storage
from tests.integration.api_server import Api
from tests.integration.sample import Sample
from tests.integration.upload_client import begin, complete, put, sign


@pytest.fixture(name="mission")
def _mission(api: Api) -> str:
    made: str = api.mission(api.project()["id"])["id"]
    return made


def _stored(api: Api, key: str, body: bytes) -> None:
    async def put() -> None:
        async with open_storage(api.app.state.settings) as storage:
            await storage.put_object(key, body)

    asyncio.run(put())


def test_download_links_are_in_the_requested_order(api: Api, sample: Sample, mission: str) -> None:
    ids = []
    for body in (b"first", b"second"):
        key = f"blobs/{uuid.uuid4()}"
        _stored(api, key, body)
        ids.append(sample.file(mission, f'{body.decode()} "é".mcap', key=key, size_bytes=len(body)))
    links = api.post("/files/download", {"file_ids": [ids[1], ids[0], ids[1]]}).ok()["items"]
    assert [link["file_id"] for link in links] == [ids[1], ids[0], ids[1]]
    answers = [urllib3.request("GET", link["url"], timeout=30) for link in links]
    assert [answer.data for answer in answers] == [b"second", b"first", b"second"]
    part = urllib3.request("GET", links[0]["url"], headers={"Range": "bytes=1-3"}, timeout=30)
    assert (part.status, part.data) == (206, b"eco")


def test_headers_that_an_uploader_sends_do_not_come_back(api: Api, mission: str) -> None:
    # A browser unpacks what the store calls packed, and would save other bytes than those that were verified; a proxy
    # keeps what it calls public.
    body = b"these bytes are not packed at all"
    (decision,) = begin(api, mission, {"a.mcap": body})
    (signed,) = sign(api, decision["upload"], [(1, body)]).ok()["items"]
    sent = {
        "Content-Encoding": "gzip",
        "Content-Type": "text/html",
        "Content-Disposition": "inline; filename=evil.html",
        "Content-Language": "xx-evil",
        "Cache-Control": "public, max-age=31536000, immutable",
        "Expires": "Wed, 21 Oct 2099 07:28:00 GMT",
        "Link": "<https://evil.test>; rel=preload",
        "Set-Cookie": "evil=1",
        "Access-Control-Allow-Origin": "https://evil.test",
    }
    assert put(signed, body, {**signed["headers"], **sent}) == 200
    file_id = complete(api, decision["upload"], body)["file"]["id"]
    (link,) = api.post("/files/download", {"file_ids": [file_id]}).ok()["items"]
    answer = urllib3.request("GET", link["url"], timeout=30)
    assert answer.data == body
    assert not [name for name, value in sent.items() if answer.headers.get(name) == value]
    assert answer.headers["Content-Encoding"] == "identity"
    assert answer.headers["Content-Type"] == "application/octet-stream"
    assert answer.headers["Cache-Control"] == "private"
    assert answer.headers["Content-Disposition"] == 'attachment; filename="a.mcap"'


@pytest.mark.parametrize("name", ["x-amz-meta-note", "x-amz-acl", "x-amz-tagging", "x-amz-website-redirect-location"])
def test_the_store_refuses_settings_of_the_object_that_were_not_signed(api: Api, mission: str, name: str) -> None:
    body = uuid.uuid4().bytes
    (decision,) = begin(api, mission, {"a.mcap": body})
    (signed,) = sign(api, decision["upload"], [(1, body)]).ok()["items"]
    assert put(signed, body, {**signed["headers"], name: "public-read"}) == 403


def test_each_file_fetched_is_one_audit_row(api: Api, sample: Sample, mission: str) -> None:
    ids = [sample.file(mission, f"{number}.mcap") for number in range(3)]
    with api.statements() as statements:
        api.post("/files/download", {"file_ids": ids}).ok()
    assert len(statements) == 3  # who, which, record
    assert [[event["operation"] for event in api.events(item)] for item in ids] == [["file.download"]] * 3


def test_a_preview_is_recorded_as_a_preview(api: Api, sample: Sample, mission: str) -> None:
    file_id = sample.file(mission, "a.mcap")
    api.post("/files/download", {"file_ids": [file_id], "purpose": "preview"}).ok()
    api.post("/files/download", {"file_ids": [file_id], "purpose": "download"}).ok()
    assert sorted(event["operation"] for event in api.events(file_id)) == ["file.download", "file.preview"]


@pytest.mark.parametrize("state", ["lost", "corrupt"])
def test_corrupt_bytes_are_not_served(api: Api, sample: Sample, mission: str, state: str) -> None:
    good, bad = sample.file(mission, "a.mcap"), sample.file(mission, "b.mcap", state=state)
    problem = api.post("/files/download", {"file_ids": [good, bad]}).refused(409, "file_unavailable")
    assert (problem["path"], problem["state"]) == ("b.mcap", state)
    assert api.events(good) == []


def test_one_unknown_file_refuses_all(api: Api, sample: Sample, mission: str) -> None:
    known, unknown = sample.file(mission, "a.mcap"), str(uuid.uuid4())
    assert api.post("/files/download", {"file_ids": [known, unknown]}).refused(404, "not_found")["ref"] == unknown
    assert api.events(known) == []
    api.post("/files/download", {"file_ids": []}).refused(422, "invalid_request")
    api.post("/files/download", {"file_ids": [known] * 501}).refused(422, "invalid_request")
