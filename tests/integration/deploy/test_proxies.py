"""The proxies of `deploy/`: two API processes and the store behind one address with TLS."""

import asyncio
import json
import os
import socket
import ssl
import subprocess
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest
import urllib3

from kleinkram.diagnostics import Diagnostic
from kleinkram.server.health.public_address import check_public_address, check_public_store
from kleinkram.server.s3.storage import open_storage
from kleinkram.server.settings import Settings
from tests.certificate import make_certificate
from tests.integration.api_server import Api, serving
from tests.integration.deploy.proxies import caddy_command, nginx_command, run
from tests.integration.upload_client import begin, complete, parts_of, sign, wait_until
from tests.log_lines import logged_lines
from tests.ports import choose_port
from tests.services import RunningPostgres, RunningStore

_MIB = 2**20
# nginx is a package of the system, which only slow tests install.
_PROXIES = [pytest.param("nginx", marks=pytest.mark.slow), "caddy"]
_FORGED, _CLIENT = "203.0.113.7", "127.0.0.9"
# To `check` an address of another machine: there, requests must pass a proxy.
_NOT_LOOPBACK = "127.0.0.5"


@dataclass(frozen=True)
class Backend:
    """Two API processes on one database, and the bucket. `port` is the proxy's."""

    apis: list[Api]
    store: str
    bucket: str
    ports: dict[str, int]
    certificate: Path
    key: Path


@dataclass(frozen=True)
class Site:
    """A proxy in front of the backend."""

    api: Api
    pool: urllib3.PoolManager
    backend: Backend
    folder: Path
    process: "subprocess.Popen[bytes]"

    def get(self, path: str, **headers: str) -> urllib3.BaseHTTPResponse:
        """Request a page by HTTPS."""
        return self.pool.request("GET", self.api.url + path, headers=headers)

    def log(self) -> str:
        """Return what the proxy has logged."""
        return "".join(path.read_text() for path in self.folder.iterdir() if path.suffix == ".log")


@pytest.fixture(scope="module")
def backend(
    postgres: RunningPostgres, store: RunningStore, template_database: str, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Backend]:
    folder = tmp_path_factory.mktemp("backend")
    certificate, key = make_certificate(folder, "127.0.0.1", _NOT_LOOPBACK)
    database, bucket = postgres.create_database(template=template_database), store.create_bucket()
    ports = {name: choose_port() for name in ("http", "https")}
    settings: dict[str, Any] = {
        "database_url": postgres.serve_url(database),
        "s3_internal_url": store.endpoint,
        "s3_public_url": f"https://127.0.0.1:{ports['https']}",
        "s3_bucket": bucket,
        "s3_region": store.region,
        "s3_access_key": store.access_key,
        "s3_secret_key": store.secret_key,
        "public_url": f"https://127.0.0.1:{ports['https']}",
        "trusted_proxies": "127.0.0.1",
        "scrub_hours": 0,
        "package_index": "off",
    }
    with ExitStack() as stack:
        stack.callback(postgres.drop_database, database)
        apis = [
            stack.enter_context(serving(settings, admin_url=postgres.migrate_url(database), folder=folder))
            for _ in range(2)
        ]
        # The second API replaced the owner's token.
        apis = [replace(api, token=apis[1].token) for api in apis]
        yield Backend(apis, store.endpoint.removeprefix("http://"), bucket, ports, certificate, key)


@pytest.fixture(scope="module", params=_PROXIES)
def site(request: pytest.FixtureRequest, backend: Backend, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    with _serving(request.param, backend, tmp_path_factory.mktemp(request.param)) as site:
        yield site


@contextmanager
def _serving(proxy: str, backend: Backend, folder: Path, mistakes: Mapping[str, str] | None = None) -> Iterator[Site]:
    """Run a proxy with the configuration of `deploy/`, changed to the addresses of the backend, and with mistakes."""
    first, second = (api.url.removeprefix("http://") for api in backend.apis)
    changes = {
        **(mistakes or {}),
        "127.0.0.1:8000": first,
        "127.0.0.1:8001": second,
        "127.0.0.1:9000": backend.store,
        "/kleinkram/": f"/{backend.bucket}/",
        "/etc/ssl/kleinkram.pem": str(backend.certificate),
        "/etc/ssl/kleinkram.key": str(backend.key),
    }
    command = (nginx_command if proxy == "nginx" else caddy_command)(folder, changes, backend.ports)
    process = run(command, folder)
    try:
        pool = urllib3.PoolManager(ca_certs=str(backend.certificate), retries=False, timeout=30)
        url = f"https://127.0.0.1:{backend.ports['https']}"
        site = Site(replace(backend.apis[1], url=url, _pool=pool), pool, backend, folder, process)
        wait_until(lambda: _answers(site), limit_s=30)
        yield site
    finally:
        process.terminate()
        process.wait(30)


def _answers(site: Site) -> bool:
    assert site.process.poll() is None, site.log()
    try:
        return site.get("/health/live").status == 200
    except urllib3.exceptions.HTTPError:
        return False


def test_a_file_goes_up_in_parts_and_ranges_come_back(site: Site) -> None:
    body = os.urandom(6 * _MIB)
    mission = site.api.mission(site.api.project()["id"])
    upload = begin(site.api, mission["id"], {"drive.bin": body})[0]["upload"]
    _send(site, upload, parts_of(upload, body))
    outcome = complete(site.api, upload, body)
    assert outcome["outcome"] == "completed"
    link = site.api.post("/files/download", {"file_ids": [outcome["file"]["id"]]}).ok()["items"][0]["url"]
    start = upload["part_size_bytes"] - 5
    answer = site.pool.request("GET", link, headers={"Range": f"bytes={start}-{start + 9}"})
    assert (answer.status, answer.data) == (206, body[start : start + 10])
    assert site.pool.request("GET", link).data == body
    assert "X-Amz-Signature" not in site.log(), "whoever reads the log could read the file"


def test_a_part_of_64_mib_passes_without_a_copy_on_the_disk(site: Site) -> None:
    mission = site.api.mission(site.api.project()["id"])
    # The parts of a file grow with the file.
    announced = {"files": [{"path": "year.bin", "size_bytes": 500 * 2**30}]}
    upload = site.api.post(f"/missions/{mission['id']}/uploads", announced).ok()["items"][0]["upload"]
    assert upload["part_size_bytes"] >= 64 * _MIB
    _send(site, upload, [(1, os.urandom(_MIB) * (upload["part_size_bytes"] // _MIB))])
    assert not [path for path in site.folder.glob("body/**/*") if path.is_file()]


def _send(site: Site, upload: Mapping[str, Any], parts: Sequence[tuple[int, bytes]]) -> None:
    """Send parts to the store through the proxy."""
    for (_, piece), signed in zip(parts, sign(site.api, upload, parts).ok()["items"], strict=True):
        assert signed["url"].startswith(site.api.url)
        assert site.pool.request("PUT", signed["url"], body=piece, headers=signed["headers"]).status == 200


def test_events_arrive_at_once(site: Site) -> None:
    project = site.api.project()
    headers = {"Authorization": f"Bearer {site.api.token}"}
    stream = site.pool.request("GET", f"{site.api.url}/api/v1/events", headers=headers, preload_content=False)
    with closing(stream):
        # The beginning, then the change. A proxy that collects pieces keeps both, and reading ends after 30 s.
        _read_until(stream, "id:")
        site.api.mission(project["id"])
        _read_until(stream, project["id"])


def _read_until(stream: urllib3.BaseHTTPResponse, text: str) -> None:
    received = ""
    while text not in received:
        piece = stream.read1(4096)
        assert piece, f"the stream ended: {received}"
        received += piece.decode()


def test_the_api_sees_the_address_of_the_client_and_not_a_forged_one(site: Site) -> None:
    pool = urllib3.PoolManager(
        ca_certs=str(site.backend.certificate), retries=False, timeout=30, source_address=(_CLIENT, 0)
    )
    headers = {"X-Forwarded-For": f"{_FORGED}, 127.0.0.1", "X-Forwarded-Proto": "http", "Forwarded": f"for={_FORGED}"}
    client = replace(site.api, _pool=pool)
    project = client.call("POST", "/projects", {"name": f"from {os.urandom(4).hex()}"}, headers=headers).ok(201)
    addresses = site.api.sql("SELECT address FROM audit_event WHERE resource_id = %s", project["id"])
    assert addresses == [(_CLIENT,)]


def test_metrics_are_not_published(site: Site) -> None:
    assert site.get("/metrics").status == 404


def test_a_request_id_is_in_the_response_and_in_both_logs(site: Site) -> None:
    own_id = f"robot-{os.urandom(4).hex()}"
    with logged_lines() as lines:
        assert site.get("/api/v1/service", **{"X-Request-Id": own_id}).headers["x-request-id"] == own_id
        new_id = site.get("/api/v1/service").headers["x-request-id"]
        bad = site.get("/api/v1/service", **{"X-Request-Id": "a b"}).headers["x-request-id"]
    wait_until(lambda: all(value in site.log() for value in (own_id, new_id, bad)))
    assert {own_id, new_id} <= {line.get("request_id") for line in lines}
    assert bad != "a b"


def test_http_is_redirected_to_https(site: Site) -> None:
    plain = f"http://127.0.0.1:{site.backend.ports['http']}/projects?q=1"
    answer = urllib3.request("GET", plain, redirect=False)
    assert answer.status == 308
    assert answer.headers["location"] == "https://127.0.0.1/projects?q=1", "the default port"


def test_the_api_refuses_a_large_body_in_its_own_words(site: Site) -> None:
    answer = site.api.call("POST", "/projects", b'{"name": "' + b"x" * (5 * _MIB) + b'"}')
    answer.refused(413, "body_too_large")


def test_a_report_of_a_run_may_be_large(site: Site) -> None:
    path = f"{site.api.url}/api/v1/runner/runs/00000000-0000-4000-8000-000000000000/finish"
    headers = {"Authorization": f"Bearer {site.api.token}", "Content-Type": "application/json"}
    answer = site.pool.request("POST", path, body=b" " * (32 * _MIB), headers=headers)
    assert answer.headers["content-type"] == "application/problem+json", answer.data
    assert answer.status != 413


def test_a_slow_client_is_served_beside_others(site: Site) -> None:
    """It sends its request in pieces, while another one is answered."""
    body = json.dumps({"name": f"slow {os.urandom(4).hex()}"}).encode()
    headers = {"Authorization": f"Bearer {site.api.token}", "Content-Type": "application/json"}
    assert _send_slowly(site, "POST", "/api/v1/projects", headers, body, pieces=8).startswith(b"HTTP/1.1 201")


def test_a_part_on_a_slow_line_is_stored_beside_other_requests(site: Site) -> None:
    body = os.urandom(_MIB)
    mission = site.api.mission(site.api.project()["id"])
    upload = begin(site.api, mission["id"], {"slow.bin": body})[0]["upload"]
    (signed,) = sign(site.api, upload, parts_of(upload, body)).ok()["items"]
    path = signed["url"].removeprefix(site.api.url)
    assert _send_slowly(site, "PUT", path, signed["headers"], body, pieces=20).startswith(b"HTTP/1.1 200")
    assert complete(site.api, upload, body)["outcome"] == "completed"


def _send_slowly(site: Site, method: str, path: str, headers: Mapping[str, str], body: bytes, *, pieces: int) -> bytes:
    """Send a request in pieces, and another one after each; return the beginning of the response."""
    context = ssl.create_default_context(cafile=str(site.backend.certificate))
    address = f"127.0.0.1:{site.backend.ports['https']}"
    own = {"Host": address, "Content-Length": str(len(body)), "Connection": "close"}
    lines = [f"{method} {path} HTTP/1.1", *(f"{name}: {value}" for name, value in {**own, **headers}.items())]
    head, size, pause = ("\r\n".join(lines) + "\r\n\r\n").encode(), -(-len(body) // pieces), threading.Event()
    raw = socket.create_connection(("127.0.0.1", site.backend.ports["https"]), timeout=30)
    with context.wrap_socket(raw, server_hostname="127.0.0.1") as line:
        for piece in (head[:40], head[40:], *(body[at : at + size] for at in range(0, len(body), size))):
            line.sendall(piece)
            assert site.get("/health/live").status == 200
            pause.wait(0.05)
        return line.recv(4096)


@pytest.mark.parametrize("proxy", _PROXIES)
def test_requests_go_to_the_other_api_process_if_one_does_not_run(proxy: str, backend: Backend, tmp_path: Path) -> None:
    ports = {name: choose_port() for name in backend.ports}
    stopped = replace(backend.apis[0], url=f"http://127.0.0.1:{choose_port()}")
    with _serving(proxy, replace(backend, apis=[stopped, backend.apis[1]], ports=ports), tmp_path) as site:
        assert {site.get("/health/live").status for _ in range(8)} == {200}


@pytest.mark.parametrize("proxy", _PROXIES)
def test_no_signature_is_logged_if_the_store_does_not_run(proxy: str, backend: Backend, tmp_path: Path) -> None:
    ports = {name: choose_port() for name in backend.ports}
    with _serving(proxy, replace(backend, store=f"127.0.0.1:{choose_port()}", ports=ports), tmp_path) as site:
        answer = site.get(f"/{backend.bucket}/key?X-Amz-Signature=secret")
        assert answer.status == 502
        wait_until(lambda: f"/{backend.bucket}/key" in site.log())
        assert "secret" not in site.log()


def _diagnose(backend: Backend, monkeypatch: pytest.MonkeyPatch) -> dict[str, Diagnostic]:
    """Run `check` of both public addresses, as from another machine."""
    monkeypatch.setenv("SSL_CERT_FILE", str(backend.certificate))
    url = f"https://{_NOT_LOOPBACK}:{backend.ports['https']}"
    settings: Settings = backend.apis[0].app.state.settings
    settings = settings.model_copy(update={"public_url": url, "s3_public_url": url})

    async def collect() -> list[Diagnostic]:
        results = [result async for result in check_public_address(settings)]
        async with open_storage(settings) as storage:
            return [*results, *[result async for result in check_public_store(settings, storage)]]

    return {result.check: result for result in asyncio.run(collect())}


def test_check_finds_nothing_wrong_with_the_proxies_of_deploy(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    results = _diagnose(site.backend, monkeypatch)
    assert results.pop("certificate").severity.value == "warning", "it is valid for an hour"
    assert {result.severity.value for result in results.values()} == {"ok"}, results
    assert {"proxy headers", "size of requests", "event streams", "public address of the store"} <= results.keys()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mistakes", "named"),
    [
        (
            {
                "proxy_set_header Host $http_host;": "proxy_set_header Host $proxy_host;",
                "client_max_body_size 33m;": "client_max_body_size 1m; proxy_ignore_headers X-Accel-Buffering;",
                "client_max_body_size 5g;": "client_max_body_size 1m;",
                "proxy_set_header X-Forwarded-For $remote_addr;": "",
            },
            {
                "public address of the store": "proxy_set_header Host $http_host",
                "size of requests": "client_max_body_size 33m",
                "size of parts": "client_max_body_size 0",
                "event streams": "proxy_buffering off",
                "proxy headers": "does not send X-Forwarded-For",
            },
        ),
        (
            {"X-Forwarded-For $remote_addr;": "X-Forwarded-For $http_x_forwarded_for;"},
            {"proxy headers": "does not send X-Forwarded-For"},
        ),
        (
            {"proxy_set_header X-Forwarded-Proto $scheme;": ""},
            {"proxy headers": "The API takes https for http. Let the proxy set X-Forwarded-Proto"},
        ),
        (
            {
                "location = /metrics { return 404; }": "location = /metrics { return 200 'kleinkram_workers 1'; }",
                "proxy_pass http://kleinkram_store;": "proxy_pass http://127.0.0.1:9;",
            },
            {
                "metrics not public": "Let the proxy answer 404 for /metrics",
                "public address of the store": "answers 502",
            },
        ),
    ],
    ids=["limits and headers", "forwarded for", "forwarded proto", "metrics and store"],
)
def test_check_names_the_mistakes_of_a_proxy(
    backend: Backend, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mistakes: dict[str, str], named: dict[str, str]
) -> None:
    backend = replace(backend, ports={name: choose_port() for name in backend.ports})
    with _serving("nginx", backend, tmp_path, mistakes):
        results = _diagnose(backend, monkeypatch)
    for check, words in named.items():
        assert results[check].severity.value == "problem", results[check]
        assert words in f"{results[check].message} {results[check].remedy}"
    assert {check for check, result in results.items() if result.severity.value == "problem"} == named.keys()
