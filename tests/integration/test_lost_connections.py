"""Transfers and streams continue behind a proxy that ends every connection, and over a slow line.

The proxy's minute is a second and a half here, and the line as much faster: of four parts that share it none gets
through before the cut, of parts that are sent alone each does.
"""

import os
import threading
import uuid
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import pytest

from kleinkram.client import Client, connect
from kleinkram.client.errors import ServerUnreachable
from kleinkram.client.transfer import download, plan_download, plan_upload, upload
from kleinkram.client.transfer.download import fetch
from kleinkram.client.transfer.report import Watcher
from kleinkram.contract.access import Scope, TokenKind
from kleinkram.contract.audit import Change
from kleinkram.contract.files import DownloadLink, FileFilter
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.conftest import StartApi
from tests.integration.runs.conftest import FakeRunner, launch
from tests.integration.upload_client import upload as upload_one
from tests.integration.upload_client import wait_until
from tests.services import RunningStore
from tests.system.chaos.cutting_proxy import Cutter, cutting

pytestmark = pytest.mark.slow
_AFTER_S = 1.5
_MIB = 1024 * 1024


@dataclass(frozen=True)
class Behind:
    """A server and a store behind such proxies, and a program that reaches them through these."""

    api: Api
    client: Client
    to_api: Cutter
    to_store: Cutter


class Shown(Watcher):
    """Records the steps of a progress bar."""

    def __init__(self) -> None:
        self.steps: list[int] = []

    def moved(self, path: str, size_bytes: int, total_bytes: int) -> None:
        """Note a step of the bar."""
        self.steps.append(size_bytes)


@pytest.fixture(scope="module")
def behind(start_api: StartApi, store: RunningStore) -> Iterator[Behind]:
    """A program behind such proxies."""
    with cutting(store.endpoint, after_s=_AFTER_S, bytes_per_s=12 * _MIB) as to_store:
        api = start_api(s3_public_url=to_store.url)
        with cutting(api.url, after_s=_AFTER_S) as to_api, closing(connect(to_api.url, api.token)) as client:
            yield Behind(api, client, to_api, to_store)


def test_uploads_and_downloads_arrive(behind: Behind, tmp_path: Path) -> None:
    file = tmp_path / "large.bin"
    file.write_bytes(os.urandom(32 * _MIB + 5))
    os.utime(file, (1_700_000_000, 1_700_000_000))
    mission_id = uuid.UUID(behind.api.mission(behind.api.project()["id"])["id"])
    shown = Shown()
    (sent,) = upload(behind.client, mission_id, plan_upload([file]), watcher=shown).results
    assert min(shown.steps) > 0, "the bar never goes back, though parts were sent again"
    assert sum(shown.steps) == file.stat().st_size
    assert sent.outcome.value == "uploaded"
    assert behind.to_store.cuts > 0, "the cut fell into the upload"
    before = behind.to_store.cuts
    plan = plan_download(behind.client.files.list(FileFilter(mission_id=mission_id)), tmp_path / "back")
    (came,) = download(behind.client, plan).results
    assert (came.outcome.value, came.local.read_bytes()) == ("downloaded", file.read_bytes())
    assert behind.to_store.cuts > before, "and into the download"


def test_a_download_waits_while_the_server_does_not_answer(behind: Behind, tmp_path: Path) -> None:
    mission_id = uuid.UUID(behind.api.mission(behind.api.project()["id"])["id"])
    upload_one(behind.api, str(mission_id), "notes.txt", b"notes")
    plan = plan_download(behind.client.files.list(FileFilter(mission_id=mission_id)), tmp_path)
    failures = iter([ServerUnreachable(url=behind.to_api.url, reason="no route to host")] * 2)

    def links(file_ids: Sequence[uuid.UUID]) -> Sequence[DownloadLink]:
        for failure in failures:
            raise failure
        return behind.client.files.links(file_ids).items

    (came,) = fetch(links, behind.to_api.url, plan).results
    assert (came.outcome.value, came.local.read_bytes()) == ("downloaded", b"notes")


def test_a_followed_event_stream_is_complete(behind: Behind) -> None:
    received: list[str] = []
    made: list[str] = []

    def follow() -> None:
        for event in behind.client.events.follow(for_s=60):
            received.extend([str(event.id)] if isinstance(event, Change) else [])
            if len(made) == 3 and received[-1:] == made[2:]:
                return

    def is_received() -> bool:
        """The stream does not announce its start, so create projects until an event arrives."""
        behind.api.project()
        return bool(received)

    follower = threading.Thread(target=follow, name="follower")
    follower.start()
    wait_until(is_received)
    for _ in range(3):
        cuts = behind.to_api.cuts
        made.append(behind.api.project()["id"])
        wait_until(lambda cuts=cuts: len(made) == 3 or behind.to_api.cuts > cuts)  # type: ignore[misc]  # as it is now
    follower.join(60)
    assert not follower.is_alive()
    assert set(received) >= set(made)


def test_a_followed_log_is_complete(behind: Behind) -> None:
    api = behind.api
    admin = people.person(api, admin=True)
    runner = FakeRunner(api.as_(people.token(api, admin, [Scope.run], kind=TokenKind.runner).secret))
    runner.register()
    mission = api.mission(api.project()["id"])
    upload_one(api, mission["id"], "notes.txt", b"notes")
    run = launch(api, runner, mission)
    claim = runner.claim()
    runner.heartbeat(claim)
    read: list[str] = []

    def follow() -> None:
        read.extend(piece.text for piece in behind.client.runs.log(run["id"], follow=True))

    follower = threading.Thread(target=follow, name="follower")
    follower.start()
    offset = 0
    for number in range(3):
        cuts = behind.to_api.cuts
        line = f"line {number}\n".encode()
        runner.write(claim, offset, line)
        offset += len(line)
        wait_until(lambda cuts=cuts: behind.to_api.cuts > cuts)  # type: ignore[misc]  # bound as it is now
    runner.finish(claim).ok()
    follower.join(30)
    assert "".join(read) == "line 0\nline 1\nline 2\n"
