"""CORS requests of our page, of a viewer and of a stranger to the store."""

from collections.abc import Mapping
from typing import Any

import pytest
import urllib3

from tests.integration.api_server import Api
from tests.integration.conftest import StartApi
from tests.integration.fault_proxy import ProxiedRequest, Reply, standing_before
from tests.integration.upload_client import begin, complete, parts_of, sign, upload
from tests.services import RunningStore

_BODY = b"what a robot saw"
_PAGE = "https://kleinkram.lab.example"
_VIEWER = "https://viewer.lab.example"
_ELSEWHERE = "https://elsewhere.example"
_PUBLIC = {
    "public_url": "https://Kleinkram.lab.example:443",
    "viewers": [{"name": "Viewer", "url": f"{_VIEWER}/?ds=remote-file&ds.url={{url}}"}],
}


@pytest.fixture(scope="module")
def lab(start_api: StartApi) -> Api:
    """A server that has another address than the store, and a viewer at a third."""
    return start_api(**_PUBLIC)


def _preflight(url: str, origin: str, method: str, headers: str = "") -> Mapping[str, str] | None:
    """Send a preflight request as a browser does; return the lower-case headers, or None if it is refused."""
    requested = {"Origin": origin, "Access-Control-Request-Method": method}
    requested |= {"Access-Control-Request-Headers": headers} if headers else {}
    answer = urllib3.request("OPTIONS", url, headers=requested, retries=False)
    reply = {name.lower(): value.lower() for name, value in answer.headers.items()}
    names = {name.strip() for name in reply.get("access-control-allow-headers", "").split(",")}
    allowed = reply.get("access-control-allow-origin") == origin and method.lower() in {
        name.strip() for name in reply.get("access-control-allow-methods", "").split(",")
    }
    return reply if answer.status < 300 and allowed and names >= set(filter(None, headers.split(","))) else None


def _shown(answer: "urllib3.BaseHTTPResponse") -> set[str]:
    """Return the headers that a page may read."""
    return {name.strip().lower() for name in answer.headers["Access-Control-Expose-Headers"].split(",")}


def _part_to_send(api: Api, body: bytes) -> tuple[Any, Any]:
    mission = api.mission(api.project()["id"])
    upload = begin(api, mission["id"], {"seen.mcap": body})[0]["upload"]
    return upload, sign(api, upload, parts_of(upload, body)).ok()["items"][0]


def test_the_web_interface_may_upload_a_part(lab: Api) -> None:
    upload, part = _part_to_send(lab, _BODY)
    # A browser says a body's length by itself, and asks about every other header.
    own = {name.lower(): value for name, value in part["headers"].items() if name != "Content-Length"}
    assert _preflight(part["url"], _PAGE, "PUT", ",".join(sorted(own))) is not None
    sent = urllib3.request("PUT", part["url"], body=_BODY, headers={**own, "Origin": _PAGE}, retries=False)
    assert (sent.status, sent.headers["Access-Control-Allow-Origin"]) == (200, _PAGE)
    assert "etag" in _shown(sent)
    assert complete(lab, upload, _BODY)["outcome"] == "completed"


def test_the_web_interface_and_viewers_may_read_ranges(lab: Api) -> None:
    mission = lab.mission(lab.project()["id"])
    file = upload(lab, mission["id"], "Seen again.MCAP", _BODY)
    url = lab.post("/files/download", {"file_ids": [file["id"]]}).ok()["items"][0]["url"]
    assert url.partition("?")[0].endswith(".mcap"), "viewers go by what an address ends with"
    for origin in (_PAGE, _VIEWER):
        assert _preflight(url, origin, "GET", "range") is not None
        answer = urllib3.request("GET", url, headers={"Origin": origin, "Range": "bytes=5-9"}, retries=False)
        assert (answer.status, answer.data) == (206, _BODY[5:10])
        assert answer.headers["Access-Control-Allow-Origin"] == origin
        assert answer.headers["Content-Range"] == f"bytes 5-9/{len(_BODY)}"
        assert _shown(answer) >= {"content-range", "content-length", "accept-ranges", "etag"}


def test_other_origins_may_not_read_and_viewers_may_not_write(lab: Api) -> None:
    _, part = _part_to_send(lab, b"never sent")
    assert _preflight(part["url"], _VIEWER, "PUT") is None
    for method in ("GET", "PUT", "DELETE"):
        assert _preflight(part["url"], _ELSEWHERE, method) is None
    assert _preflight(part["url"], _PAGE, "DELETE") is None


def test_cors_rules_of_others_stay(start_api: StartApi, store: RunningStore) -> None:
    settings = start_api(**_PUBLIC).app.state.settings
    later = start_api(s3_bucket=settings.s3_bucket, s3_cors="leave", public_url=_ELSEWHERE)
    url = f"{store.endpoint}/{settings.s3_bucket}/any"
    assert _preflight(url, _PAGE, "PUT") is not None
    assert _preflight(url, _ELSEWHERE, "PUT") is None
    assert later.app.state.pages_may_send is False


def test_a_store_without_cors_rules_is_used(
    start_api: StartApi, store: RunningStore, caplog: pytest.LogCaptureFixture
) -> None:
    def rule(requested: ProxiedRequest) -> Reply | None:
        return Reply(501, "NotImplemented") if "cors" in requested.query else None

    with standing_before(store.endpoint) as middleman:
        middleman.rule = rule
        api = start_api(s3_internal_url=middleman.url)
    assert api.get("/service").ok()["store_url"]
    (warning,) = [record for record in caplog.records if record.name == "kleinkram.store"]
    assert "uploads by browser will fail" in warning.getMessage()
    assert "NotImplemented" in warning.__dict__["fields"]["reason"]


def test_pages_receive_the_url_of_the_store(lab: Api, store: RunningStore) -> None:
    shown = lab.as_(None).get("/service").ok()
    assert shown["store_origin"] == store.endpoint
    assert shown["name"] == "Kleinkram"
    assert shown["has_local_accounts"] is True
    assert shown["viewers"] == [{"name": "Viewer", "url": f"{_VIEWER}/?ds=remote-file&ds.url={{url}}"}]
    assert shown["person"] is None
    assert lab.get("/service").ok()["person"]["name"] == "owner"
