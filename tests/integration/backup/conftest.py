"""One instance with content of all kinds, and a backup of it; the tests here change copies of the backup."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from kleinkram.contract.access import Scope, TokenKind
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.backup.instances import EmptyInstances, back_up, settings_of
from tests.integration.conftest import Starting
from tests.integration.jobs import run_jobs
from tests.integration.runs.conftest import FakeRunner, launch
from tests.integration.upload_client import begin, send, upload
from tests.services import RunningPostgres, RunningStore

LARGE = bytes(range(256)) * 40_000  # more than one part of an upload, and more than one block of an encrypted file


@pytest.fixture(scope="package", autouse=True)
def _no_garbage_collection() -> Iterator[None]:
    """Let rclone, which starts hundreds of times for a moment, take a quarter less CPU time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("GOGC", "off")
        yield


@pytest.fixture(scope="package")
def populated(starting: Starting) -> Iterator[Api]:
    """An instance with files, duplicates, trash, runs, an unfinished upload, a token and a group."""
    with starting() as start:
        api = start(reverify_days=0)
        project = api.project()
        mission = api.mission(project["id"])["id"]
        upload(api, mission, "large.bin", LARGE)
        upload(api, mission, "small.bin", b"small")
        upload(api, mission, "duplicate.bin", b"small")
        gone = upload(api, mission, "gone.bin", b"in the trash")
        run_jobs(api)
        api.delete(f"/files/{gone['id']}").ok()
        half = LARGE[::-1]
        [unfinished] = begin(api, mission, {"half.bin": half})
        send(api, unfinished["upload"], half, only=[1])
        _create_runs(api)
        api.post("/tokens", {"name": "robot"}).ok(201)
        api.post("/groups", {"name": "lab"}).ok(201)
        yield api


def _create_runs(api: Api) -> None:
    """Create a run that has ended with an artifact, and one that is running with a log."""
    mission = api.mission(api.project()["id"])
    upload(api, mission["id"], "input", b"input")
    admin = people.person(api, admin=True)
    runner = FakeRunner(api.as_(people.token(api, admin, [Scope.run], kind=TokenKind.runner).secret))
    runner.register()
    launch(api, runner, mission)
    done = runner.claim()
    runner.upload_artifact(done, "made", b"made")
    runner.upload_artifact(done, ".kleinkram/log", b"it said\n")
    runner.finish(done).ok()
    launch(api, runner, mission)
    running = runner.claim()
    runner.heartbeat(running)
    runner.write(running, 0, b"it says\n")


@pytest.fixture(scope="package")
def _backup(populated: Api, tmp_path_factory: pytest.TempPathFactory) -> Path:
    place: Path = tmp_path_factory.mktemp("backup") / "one"
    back_up(settings_of(populated), place)
    return place


@pytest.fixture
def backed_up(_backup: Path, tmp_path: Path) -> Path:
    """A folder with one backup of the populated instance."""
    return shutil.copytree(_backup, tmp_path / "backed up")


@pytest.fixture(scope="package")
def instances(postgres: RunningPostgres, store: RunningStore) -> EmptyInstances:
    """Empty instances."""
    return EmptyInstances(postgres, store)
