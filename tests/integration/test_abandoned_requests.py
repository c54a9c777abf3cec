"""Requests of clients that disconnect or are slow, and requests during which the database goes away."""

import json
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from urllib.parse import urlsplit

import psycopg
import pytest

from tests.integration.api_server import Api
from tests.integration.conftest import StartApi
from tests.integration.races import racing
from tests.integration.upload_client import wait_until
from tests.services import RunningPostgres

pytestmark = pytest.mark.slow
_CONNECTIONS = 3


@dataclass(frozen=True)
class Watched:
    """An API with few database connections, and the state of its sessions in PostgreSQL."""

    api: Api
    monitor: psycopg.Connection[tuple[int]]

    def count(self, condition: str) -> int:
        """Return how many of the API's sessions meet a condition."""
        return self._of_sessions("count(*)", condition)

    def waiting(self, count: int) -> bool:
        """Whether this many of its queries wait for a lock."""
        return self.count("wait_event_type = 'Lock'") == count

    def is_idle(self) -> bool:
        """Whether no session runs a query or is in a transaction."""
        return self.count("state <> 'idle'") == 0

    def cut(self) -> None:
        """End the sessions whose queries wait for a lock."""
        gone = "count(*) FILTER (WHERE pg_terminate_backend(pid, 20000))"
        assert self._of_sessions(gone, "wait_event_type = 'Lock'") > 0

    def _of_sessions(self, what: str, condition: str) -> int:
        name = self.api.database.info.dbname
        statement = f"SELECT {what} FROM pg_stat_activity WHERE datname = %s AND application_name = 'kleinkram'"
        row = self.monitor.execute(f"{statement} AND {condition}", [name]).fetchone()
        assert row is not None
        return row[0]


@pytest.fixture(scope="module")
def small(start_api: StartApi, postgres: RunningPostgres) -> Iterator[Watched]:
    """An API with few connections to its database."""
    with psycopg.connect(postgres.admin_url, autocommit=True) as monitor:
        yield Watched(start_api(database_connections=_CONNECTIONS), monitor)


@contextmanager
def _open_request(
    api: Api, method: str, path: str, body: bytes = b"", *, length: int | None = None
) -> Iterator[socket.socket]:
    """Send a request over a raw socket, and disconnect at the end."""
    where = urlsplit(api.url)
    head = f"{method} /api/v1{path} HTTP/1.1\r\nHost: {where.netloc}\r\nAuthorization: Bearer {api.token}\r\n"
    if method != "GET":
        head += f"Content-Type: application/json\r\nContent-Length: {len(body) if length is None else length}\r\n"
    with socket.create_connection((where.hostname or "", where.port or 0), timeout=20) as connection:
        connection.sendall(head.encode() + b"\r\n" + body)
        yield connection


def test_the_query_of_a_disconnected_client_is_cancelled(small: Watched) -> None:
    api = small.api
    project = api.project()["id"]
    with racing(api, "LOCK TABLE mission IN ACCESS EXCLUSIVE MODE"):
        for _ in range(_CONNECTIONS + 1):  # more than there are connections: each is released
            with _open_request(api, "GET", f"/missions?project_id={project}"):
                wait_until(lambda: small.waiting(1))
            wait_until(small.is_idle)
        assert api.get("/me").status == 200
    assert api.get(f"/missions?project_id={project}").ok()["items"] == []
    assert 'route="/api/v1/missions",status="499"' in api.metrics()


def test_a_change_is_completed_although_its_client_disconnected(small: Watched) -> None:
    api = small.api
    project = api.project()["id"]
    with racing(api, "SELECT 1 FROM project WHERE id = %s FOR UPDATE", project):
        body = json.dumps({"description": "changed"}).encode()
        with _open_request(api, "PATCH", f"/projects/{project}", body):
            wait_until(lambda: small.waiting(1))
        assert small.waiting(1)
    wait_until(lambda: api.get(f"/projects/{project}").ok()["description"] == "changed")


def test_slow_clients_occupy_no_database_connection(small: Watched) -> None:
    api = small.api
    project = api.project(description="d" * 9000)["id"]
    for number in range(40):
        api.project(name=f"p{number}", description="d" * 9000)
    with ExitStack() as stack:
        for _ in range(2 * _CONNECTIONS):
            stack.enter_context(_open_request(api, "PATCH", f"/projects/{project}", b'{"desc', length=50))
            connection = stack.enter_context(_open_request(api, "GET", "/projects?limit=100"))
            assert connection.recv(1) == b"H", "the response has begun"
        wait_until(small.is_idle)
        started = time.monotonic()
        assert api.get(f"/projects/{project}").status == 200
        assert time.monotonic() - started < 8, "other requests do not wait for them"


def test_requests_whose_connection_is_cut_are_answered_with_retry_after(small: Watched) -> None:
    api = small.api
    project = api.project()["id"]
    missions_path = f"/missions?project_id={project}"
    with racing(api, "LOCK TABLE mission IN ACCESS EXCLUSIVE MODE") as send:
        requests = [
            send(api.post, f"/projects/{project}/missions", {"name": "m"}),
            send(api.get, missions_path),
        ]
        small.cut()
        for request in requests:
            response = request.result()
            response.refused(503, "database_unavailable")
            assert response.headers["retry-after"]
    assert api.get(missions_path).ok()["items"] == []
