"""Public health pages show liveness and readiness only; counts and reasons need authorization."""

import pytest
import urllib3

from kleinkram.server.access.operations import OPEN_PAGES
from tests.integration.api_server import Api
from tests.integration.conftest import StartApi
from tests.integration.sample import Sample

_POOL = urllib3.PoolManager(retries=False, timeout=20)
# As if the proxy on this machine said where somebody comes from.
_FROM_AFAR = {"X-Forwarded-For": "203.0.113.7"}


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
    assert "migrations" in _get(api, "/health/ready", _FROM_AFAR)[1]
    for headers in ({"X-Forwarded-For": "203.0.114.1"}, {}):
        assert _get(api, "/health/ready", headers) == (503, "not ready\n")


def test_only_monitoring_networks_see_why_it_is_not_ready(start_api: StartApi) -> None:
    api = start_api()
    api.sql("UPDATE alembic_version SET version_num = 'other'")
    assert _get(api, "/health/ready", _FROM_AFAR) == (503, "not ready\n")
    assert "migrations" in _get(api, "/health/ready")[1]


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
