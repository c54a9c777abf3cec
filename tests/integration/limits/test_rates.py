"""Rate limits per credential and per address, with Retry-After."""

import datetime
import uuid
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest

from kleinkram.client import _http
from kleinkram.client._http import Api as ClientApi
from kleinkram.client.config import Endpoint, EndpointSource
from kleinkram.contract.errors import NotFound, RateLimited
from kleinkram.contract.files import DownloadLinks, DownloadRequest
from kleinkram.server.context import AppContext
from kleinkram.server.http import rate_limit
from kleinkram.server.http.rate_limit import Count, delete_expired_counts, enforce_limits
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.conftest import StartApi
from tests.integration.jobs import on_site

_KINDS = ("searches", "downloads", "uploads", "verifications", "exports")


@pytest.fixture(scope="module")
def strict(start_api: StartApi) -> Iterator[Api]:
    """An API that allows three of each kind, in a window that does not end meanwhile."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(rate_limit, "_WINDOW", rate_limit._WINDOW * 60 * 24 * 365)
        yield start_api(**{f"{kind}_per_minute": 3 for kind in _KINDS})


def _fresh(api: Api) -> Api:
    return api.as_(people.person(api, admin=True).token)


@pytest.mark.parametrize(
    ("method", "path", "body", "what"),
    [
        ("GET", "/search", None, "searches"),
        ("GET", "/search/facets", None, "searches"),
        ("GET", "/files?text=x", None, "searches"),
        ("GET", "/missions?query=x", None, "searches"),
        ("GET", "/projects?text=x", None, "searches"),
        ("POST", "/files/download", {"file_ids": ["00000000-0000-4000-8000-000000000000"]}, "downloads"),
        ("POST", "/files/00000000-0000-4000-8000-000000000000/verify", None, "verifications"),
        ("GET", "/audit/export?until=2000-01-01", None, "exports"),
    ],
)
def test_expensive_requests_are_limited(strict: Api, method: str, path: str, body: object, what: str) -> None:
    api = _fresh(strict)
    for _ in range(3):
        assert api.call(method, path, body).status in {200, 404}
    answer = api.call(method, path, body)
    problem = answer.refused(429, "rate_limited")
    assert (problem["what"], problem["limit"], problem["window_s"]) == (what, 3, 60)
    assert int(answer.headers["retry-after"]) == problem["retry_after_s"] > 0
    assert f"at most 3 {what} in 60 s" in problem["detail"]


def test_cheap_requests_and_other_clients_are_not_limited(strict: Api) -> None:
    api = _fresh(strict)
    for _ in range(3):
        api.get("/stats").ok()
    api.get("/topics").refused(429, "rate_limited")
    for _ in range(5):
        api.get("/files").ok()
    _fresh(strict).get("/stats").ok()


def test_begin_uploads_is_limited_before_names_are_reserved(strict: Api) -> None:
    mission = strict.mission(strict.project()["id"])["id"]
    api = _fresh(strict)
    for name in ("a.bin", "a.bin", "a.bin"):
        api.post(f"/missions/{mission}/uploads", {"files": [{"path": name, "size_bytes": 1}]}).ok()
    late = {"files": [{"path": "b.bin", "size_bytes": 1}]}
    api.post(f"/missions/{mission}/uploads", late).refused(429, "rate_limited")
    assert strict.sql("SELECT count(*) FROM upload WHERE mission_id = %s AND path = 'b.bin'", mission) == [(0,)]


def test_requests_without_credential_are_counted_by_address(strict: Api) -> None:
    mission = strict.mission(strict.project()["id"])["id"]
    link = strict.as_(people.share(strict, mission).secret)
    strict.sql("DELETE FROM rate_count")
    stranger = strict.as_(None)
    for _ in range(3):
        stranger.get("/stats").ok()
    stranger.get("/stats").refused(429, "rate_limited")
    # A credential has a higher limit at the same address, and its own count.
    strict.sql("DELETE FROM rate_count")
    for _ in range(3):
        link.get("/stats").ok()
    link.get("/stats").refused(429, "rate_limited")


def test_many_credentials_of_one_address_share_its_limit(strict: Api) -> None:
    strict.sql("DELETE FROM rate_count")
    carriers = [_fresh(strict) for _ in range(11)]
    statuses = [api.get("/stats").status for api in carriers for _ in range(3)]
    assert statuses == [200] * 30 + [429] * 3
    strict.sql("DELETE FROM rate_count")


def test_concurrent_requests_are_all_counted(strict: Api) -> None:
    api = _fresh(strict)
    with ThreadPoolExecutor(8) as pool:
        statuses = [answer.status for answer in pool.map(lambda _: api.get("/stats"), range(16))]
    assert sorted(statuses) == [200] * 3 + [429] * 13


def test_stored_rate_counts_do_not_identify_the_client(strict: Api) -> None:
    async def count(context: AppContext) -> None:
        await enforce_limits(
            context.database, Count("sign-ins", "anna@lab.example", 5), Count("sign-ins", "10.0.0.1", 5)
        )

    on_site(strict, count)
    keys = [key for (key,) in strict.sql("SELECT key FROM rate_count WHERE key LIKE %s", "sign-ins:%")]
    assert len(keys) == 2
    assert not any("anna" in key or "10.0.0.1" in key for key in keys)


def test_without_a_limit_nothing_is_counted(strict: Api) -> None:
    async def count(context: AppContext) -> None:
        for _ in range(100):
            await enforce_limits(context.database, Count("x", "y", 0))

    on_site(strict, count)
    assert strict.sql("SELECT count(*) FROM rate_count WHERE key LIKE %s", "x:%") == [(0,)]


def test_counts_of_past_windows_are_deleted(start_api: StartApi, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rate_limit, "_WINDOW", datetime.timedelta(seconds=60))
    api = start_api(searches_per_minute=1)
    api.sql(
        "INSERT INTO rate_count (key, window_start, count)"
        " SELECT 'searches:x', date_bin('1 minute', now(), 'epoch') - make_interval(mins => m), 99"
        " FROM generate_series(1, 5) AS m"
    )

    async def forget(context: AppContext) -> None:
        async with context.database.begin() as db:
            await delete_expired_counts(db)

    api.get("/stats").ok()
    on_site(api, forget)
    counts = api.sql("SELECT count(*) FROM rate_count WHERE key = 'searches:x'")
    assert counts in ([(1,)], [(2,)])  # one more where a minute began meanwhile


def _limited(strict: Api) -> tuple[ClientApi, DownloadRequest]:
    """Return a client that has asked as often as it may, and what it asks."""
    api = _fresh(strict)
    nothing = DownloadRequest(file_ids=[uuid.uuid4()])
    for _ in range(3):
        api.post("/files/download", nothing.model_dump(mode="json")).refused(404, "not_found")
    return ClientApi(Endpoint("test", strict.url, api.token, EndpointSource.argument)), nothing


def test_the_client_follows_retry_after(strict: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_http, "LONGEST_RETRY_AFTER_S", float("inf"))
    client, nothing = _limited(strict)
    waited: list[float] = []

    def wait(wait_s: float) -> None:
        waited.append(wait_s)
        strict.sql("DELETE FROM rate_count")

    with pytest.raises(NotFound):
        client.with_retry(_http.RETRY_TIMEOUT_S, wait).repeat("/files/download", DownloadLinks, nothing)
    assert len(waited) == 1
    assert waited[0] >= 1
    client.close()


def test_the_client_gives_up_after_a_while(strict: Api) -> None:
    client, nothing = _limited(strict)
    with pytest.raises(RateLimited, match="Try again in"):
        client.send("POST", "/files/download", DownloadLinks, nothing)
    client.close()
