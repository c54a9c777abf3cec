"""An API process behind a proxy gets SIGTERM: the proxy can leave it without losing a request."""

import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest
import urllib3

from tests.integration.deploy.units import clean_environment
from tests.integration.upload_client import wait_until
from tests.ports import choose_port
from tests.services import RunningPostgres, RunningStore

pytestmark = [pytest.mark.slow, pytest.mark.timeout(180)]
_START_S = 120
_LIVE = b"GET /health/live HTTP/1.1\r\nHost: x\r\n\r\n"
_BODY = b'{"email": "ada@lab.example", "password": "wrong"}'
_HEAD = b"POST /api/v1/auth/password HTTP/1.1\r\nHost: x\r\nContent-Type: application/json\r\nContent-Length: "


def _environment(postgres: RunningPostgres, store: RunningStore, database: str) -> dict[str, str]:
    return {
        **clean_environment(),
        "KLEINKRAM_DATABASE_URL": postgres.serve_url(database),
        "KLEINKRAM_S3_INTERNAL_URL": store.endpoint,
        "KLEINKRAM_S3_BUCKET": store.create_bucket(),
        "KLEINKRAM_S3_ACCESS_KEY": store.access_key,
        "KLEINKRAM_S3_SECRET_KEY": store.secret_key,
        "KLEINKRAM_TRUSTED_PROXIES": "127.0.0.1",
        "KLEINKRAM_DRAIN_S": "3",
    }


def _ready(port: int) -> tuple[int, str | None, str]:
    try:
        answer = urllib3.request("GET", f"http://127.0.0.1:{port}/health/ready", retries=False)
    except urllib3.exceptions.HTTPError:
        return 0, None, ""
    return answer.status, answer.headers.get("Connection"), answer.data.decode()


def _response(connection: socket.socket, end: str | None = None) -> str:
    """Return a response in lower case, up to `end` or until the server closes the connection."""
    received = ""
    while (end is None or not received.endswith(end)) and (more := connection.recv(65_536)):
        received += more.decode().lower()
    return received


def test_a_stopping_process_behind_a_proxy_answers_all_requests(
    postgres: RunningPostgres, store: RunningStore, template_database: str, tmp_path: Path
) -> None:
    database, port = postgres.create_database(template=template_database), choose_port()
    command = [sys.executable, "-m", "kleinkram.server", "api", "--port", str(port)]
    with (tmp_path / "api.log").open("wb") as log:
        process = subprocess.Popen(command, env=_environment(postgres, store, database), stdout=log, stderr=log)
    address = ("127.0.0.1", port)
    try:
        wait_until(lambda: _ready(port)[0] == 200, limit_s=_START_S)
        with socket.create_connection(address, 20) as idle, socket.create_connection(address, 20) as begun:
            idle.sendall(_LIVE)
            assert "connection: close" not in _response(idle, "live\n")
            begun.sendall(_HEAD + b"%d\r\n\r\n" % len(_BODY) + _BODY[:5])
            process.send_signal(signal.SIGTERM)
            wait_until(lambda: _ready(port)[0] == 503, limit_s=20)
            assert _ready(port) == (503, "close", "This process is stopping.\n")
            idle.sendall(_LIVE)
            assert _response(idle).startswith("http/1.1 200 ")
            # After the listening socket is closed, what was accepted is still answered.
            wait_until(lambda: _ready(port)[0] == 0, limit_s=20)
            begun.sendall(_BODY[5:])
            answer = _response(begun)
            assert answer.startswith("http/1.1 401 ")
            assert "connection: close" in answer
        assert process.wait(20) in {0, -signal.SIGTERM}
    finally:
        process.kill()
        process.wait(20)
        postgres.drop_database(database)
