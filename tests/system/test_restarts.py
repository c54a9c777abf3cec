"""The API and the database restart under twenty clients: each client succeeds, and nothing is duplicated."""

import contextlib
import json
import os
import signal
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TypeVar

import pytest
import urllib3

from kleinkram.client import Client, connect
from kleinkram.client.errors import ServerUnreachable
from kleinkram.client.transfer import plan_upload, upload
from kleinkram.contract.errors import DatabaseUnavailable
from kleinkram.contract.files import FileFilter
from tests.acceptance.conftest import wait_until
from tests.system import backend
from tests.system.cluster import Cluster

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

T = TypeVar("T")
_CLIENTS, _FILES = 20, 6
_TIMEOUT_S = 60.0
_FILES_OF_ALL = """
    SELECT mission.name, file.path FROM file JOIN mission ON mission.id = mission_id WHERE mission.name LIKE 'client %%'
"""


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    """A Kleinkram for this module."""
    cluster = Cluster(tmp_path_factory.mktemp("house"))
    # Whose announcement was lost waits for the lease that it got; a minute of that shows no more than seconds.
    cluster.settings["KLEINKRAM_UPLOAD_LEASE_S"] = "5"
    cluster.start()
    cluster.terminal.run("project", "create", "p")
    yield cluster
    cluster.end()


def _connected(cluster: Cluster) -> Client:
    return connect(cluster.runtime_info()["url"], (cluster.data_dir / "owner-token").read_text().strip())


def test_twenty_clients_read_and_upload_while_the_api_and_the_database_restart(
    cluster: Cluster, tmp_path: Path
) -> None:
    files = [_write(tmp_path / f"{number}.bin") for number in range(_FILES)]
    with _connected(cluster) as owner:
        project_id = owner.projects.get("p").id
        missions = [owner.missions.create(f"client {number}", project=project_id) for number in range(_CLIENTS)]
    begun = threading.Event()

    def work(number: int) -> None:
        mission_id = missions[number].id
        with _connected(cluster) as client:
            for count, file in enumerate(files, start=1):
                (sent,) = upload(client, mission_id, plan_upload([file])).results
                assert sent.error is None, sent
                begun.set()
                there = _read(lambda: [*client.files.list(FileFilter(mission_id=mission_id))])
                assert len(there) == count, "an uploaded file is listed at once, and once"

    with ThreadPoolExecutor(max_workers=_CLIENTS) as pool:
        working = [pool.submit(work, number) for number in range(_CLIENTS)]
        begun.wait(60)
        for part, sign in (("api", signal.SIGKILL), ("api", signal.SIGTERM), ("postgres", signal.SIGKILL)):
            _end_and_wait(cluster, part, sign)
        for future in working:
            future.result()
    counted = Counter(backend.sql(cluster, _FILES_OF_ALL))
    assert counted == Counter((f"client {number}", file.name) for number in range(_CLIENTS) for file in files)
    backend.tidy(cluster)
    assert backend.objects(cluster) == dict(backend.sql(cluster, "SELECT key, size_bytes FROM blob"))


def _write(path: Path) -> Path:
    path.write_bytes(os.urandom(20_000))
    os.utime(path, (1_700_000_000, 1_700_000_000))
    return path


def _read(ask: Callable[[], T]) -> T:
    """Send a request and retry while the server is unavailable, as a script does."""
    gives_up_at = time.monotonic() + _TIMEOUT_S
    while time.monotonic() < gives_up_at:
        with contextlib.suppress(ServerUnreachable, DatabaseUnavailable):
            return ask()
    return ask()


def _end_and_wait(cluster: Cluster, part: str, sign: signal.Signals) -> None:
    pid = cluster.runtime_info()["services"][part]
    os.kill(pid, sign)
    wait_until(lambda: cluster.runtime_info()["services"][part] not in {None, pid}, f"{part} to be started again")
    wait_until(lambda: _status(cluster, "GET", "/health/ready", "")[0] == 200, "the API to be ready")


def test_requests_without_a_database_get_503_with_retry_after(cluster: Cluster) -> None:
    token = (cluster.data_dir / "owner-token").read_text().strip()
    change = ("POST", "/api/v1/projects", token, {"name": "made while it was away"})
    reading = ("GET", "/api/v1/projects", token)
    assert cluster.process is not None
    cluster.process.send_signal(signal.SIGSTOP)  # the supervisor would restart it
    try:
        cluster.kill("postgres")
        for request in (change, reading):
            status, retry_after, error = _status(cluster, *request)
            assert (status, error["code"]) == (503, "database_unavailable")
            assert int(retry_after) > 0
        refused = cluster.terminal.run("project", "list", code=7).err
        assert "The database is not available (it does not answer). Nothing was lost; try again in a moment." in refused
    finally:
        cluster.process.send_signal(signal.SIGCONT)
    wait_until(lambda: _status(cluster, "GET", "/health/ready", "")[0] == 200, "the database to be back")
    assert _status(cluster, *change)[0] == 201, "it had not been made"


def _status(
    cluster: Cluster, method: str, path: str, token: str, body: object = None
) -> tuple[int, str, dict[str, str]]:
    headers = {"Authorization": f"Bearer {token}"} if token else {}
    try:
        answer = urllib3.request(
            method, cluster.runtime_info()["url"] + path, json=body, headers=headers, timeout=30, retries=False
        )
    except urllib3.exceptions.HTTPError:
        return 0, "", {}
    is_json = "json" in answer.headers.get("Content-Type", "")
    return answer.status, answer.headers.get("Retry-After", ""), json.loads(answer.data) if is_json else {}
