"""Readiness and metrics are correct and cheap, however often they are requested."""

import asyncio
from concurrent.futures import ThreadPoolExecutor

import pytest
import urllib3

from kleinkram.contract.errors import StoreUnavailable
from kleinkram.server.access.operations import OPEN_PAGES
from kleinkram.server.health import metrics_server, readiness, routes
from tests.integration.api_server import Api
from tests.integration.conftest import StartApi
from tests.integration.sample import Sample
from tests.integration.upload_client import wait_until

_POOL = urllib3.PoolManager(retries=False, timeout=20, maxsize=20)

_POOL = urllib3.PoolManager(retries=False, timeout=20)
# As if the proxy on this machine said where somebody comes from.
_FROM_AFAR = {"X-Forwarded-For": "203.0.113.7"}


def _ready(api: Api) -> tuple[int, str]:
    answer = _POOL.request("GET", f"{api.url}/health/ready")
    return answer.status, answer.data.decode()


class _Silent:
    """A store that takes the question and does not answer until it is told to; it counts the questions."""

    def __init__(self) -> None:
        self.requests = 0
        self._is_awake = asyncio.Event()

    async def check(self) -> None:
        self._loop = asyncio.get_running_loop()
        self.requests += 1
        await self._is_awake.wait()
        raise StoreUnavailable(reason="it woke up")

    def answer(self) -> None:
        self._loop.call_soon_threadsafe(self._is_awake.set)


def test_readiness_names_unavailable_services(start_api: StartApi) -> None:
    api = start_api()
    status, text = _ready(api)
    assert (status, text.splitlines()[0]) == (200, "ready")
    assert "No worker process has ever run" in text, "nobody should find out from files that stay unread"
    other = start_api()
    other.sql("UPDATE alembic_version SET version_num = 'other'")
    status, text = _ready(other)
    assert (status, "kleinkram.server migrate" in text) == (503, True)


def test_readiness_does_not_wait_for_a_silent_store(start_api: StartApi, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(readiness, "_STORE_TIMEOUT_S", 0.1)
    api = start_api()
    api.app.state.storage = _Silent()
    assert _ready(api) == (503, "The object store did not answer within 0.1 seconds.\n")


def test_a_silent_store_blocks_no_other_requests(start_api: StartApi, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(readiness, "_STORE_TIMEOUT_S", 60)
    monkeypatch.setattr(routes, "_HOLDS_S", 3600)
    api = start_api(database_connections=2)
    store = _Silent()
    api.app.state.storage = store
    with ThreadPoolExecutor(10) as pool:
        probes = [pool.submit(_ready, api) for _ in range(10)]
        wait_until(lambda: store.requests > 0)
        for _ in range(5):
            api.get("/projects").ok()
        assert not any(probe.done() for probe in probes)
        store.answer()
        assert len({probe.result() for probe in probes}) == 1
        assert "it woke up" in probes[0].result()[1]
    assert store.requests == 1


def test_metrics_are_complete_with_concurrent_readers(start_api: StartApi, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(metrics_server, "_HOLDS_S", 3600)
    api = start_api()
    with api.statements() as statements, ThreadPoolExecutor(8) as pool:
        texts = list(pool.map(lambda _: api.metrics(), range(24)))
    for text in texts:
        assert text.count("# TYPE kleinkram_queue_oldest_seconds gauge") == 1
        assert text.count("# TYPE kleinkram_jobs gauge") == 1
        assert text.count("# TYPE kleinkram_requests_total counter") == 1
    assert len(statements) == 17, "11 for each scrape, if it is a second later, and 6 for the slow gauges"


def test_more_requests_than_connections_wait_for_each_other(start_api: StartApi) -> None:
    api = start_api(database_connections=2)
    paths = ["/projects", "/files", "/missions", "/trash", "/audit", "/stats", "/topics"]
    with ThreadPoolExecutor(12) as pool:
        assert {answer.status for answer in pool.map(api.get, 4 * paths)} == {200}


@pytest.fixture(name="far", scope="module")
def _far(start_api: StartApi) -> Api:
    """An API behind a proxy that it knows, on this machine."""
    return start_api(trusted_proxies="127.0.0.1")


def _get(api: Api, path: str, headers: dict[str, str] | None = None) -> tuple[int, str]:
    answer = _POOL.request("GET", api.url + path, headers=headers or {})
    return answer.status, answer.data.decode()


def test_metrics_are_not_on_the_port_that_a_proxy_publishes(api: Api, far: Api) -> None:
    for requested in (api, far):
        for headers in ({}, _FROM_AFAR):
            status, text = _get(requested, "/metrics", headers)
            assert (status, "kleinkram_" in text) == (404, False)
    assert "kleinkram_build_info" in api.metrics()


def test_monitoring_networks_are_a_setting(start_api: StartApi) -> None:
    api = start_api(trusted_proxies="127.0.0.1", monitoring_networks="203.0.113.0/24")
    api.sql("UPDATE alembic_version SET version_num = 'other'")
    assert "migrate" in _get(api, "/health/ready", _FROM_AFAR)[1]
    for headers in ({"X-Forwarded-For": "203.0.114.1"}, {}):
        assert _get(api, "/health/ready", headers) == (503, "not ready\n")


def test_only_monitoring_networks_see_why_it_is_not_ready(start_api: StartApi) -> None:
    api = start_api()
    api.sql("UPDATE alembic_version SET version_num = 'other'")
    assert _get(api, "/health/ready", _FROM_AFAR) == (503, "not ready\n")
    assert "migrate" in _get(api, "/health/ready")[1]


def test_public_pages_reveal_no_names(api: Api, sample: Sample) -> None:
    project = api.project(name="a secret of ours")
    mission = api.mission(project["id"], name="outing to Zanskar")
    file = sample.file(mission["id"], "unheard-of.mcap")
    for path in (f"/projects/{project['id']}", f"/missions/{mission['id']}", f"/files/{file}"):
        api.get(path).ok()
    pages = [path for path in OPEN_PAGES if "{" not in path] + [
        "/sign-in/link",
        "/openapi.json",
        "/api/v1/auth/methods",
    ]
    for path in pages:
        status, text = _get(api, path)
        assert status == 200, path
        for secret in ("secret of ours", "Zanskar", "unheard-of", project["id"], mission["id"], file):
            assert secret not in text, path
