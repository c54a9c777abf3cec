"""One site with all kinds of things in it, backed up by all tests here, and changed by none."""

from collections.abc import Iterator

import pytest

from kleinkram.contract.rights import Scope, TokenKind
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.backup.sites import Sites
from tests.integration.conftest import Starting
from tests.integration.jobs import run_jobs
from tests.integration.runs.conftest import Played, launch
from tests.integration.upload_client import begin, send, upload
from tests.services import RunningPostgres, RunningStore

LARGE = bytes(range(256)) * 40_000  # more than one part, and than one frame of a sealed file


@pytest.fixture(scope="package")
def lived_in(starting: Starting) -> Iterator[Api]:
    """A site with files, twins, trash, runs, an upload under way, a token and a group."""
    with starting() as start:
        api = start(reverify_days=0)
        project = api.project()
        mission = api.mission(project["id"])["id"]
        upload(api, mission, "large.bin", LARGE)
        upload(api, mission, "small.bin", b"small")
        upload(api, mission, "twin.bin", b"small")
        gone = upload(api, mission, "gone.bin", b"in the trash")
        run_jobs(api)
        api.delete(f"/files/{gone['id']}").ok()
        half = LARGE[::-1]
        [under_way] = begin(api, mission, {"half.bin": half})
        send(api, under_way["upload"], half, only=[1])
        _let_runs_run(api)
        api.post("/tokens", {"name": "robot"}).ok(201)
        api.post("/groups", {"name": "lab"}).ok(201)
        yield api


def _let_runs_run(api: Api) -> None:
    """One run that is over and left something, and one that is held and has said something."""
    mission = api.mission(api.project()["id"])
    upload(api, mission["id"], "input", b"input")
    admin = people.person(api, admin=True)
    runner = Played(api.as_(people.token(api, admin, [Scope.run], kind=TokenKind.runner).secret))
    runner.hello()
    launch(api, runner, mission)
    done = runner.claim()
    runner.leave(done, "made", b"made")
    runner.leave(done, ".kleinkram/log", b"it said\n")
    runner.finish(done).ok()
    launch(api, runner, mission)
    held = runner.claim()
    runner.beat(held)
    runner.write(held, 0, b"it says\n")


@pytest.fixture(scope="package")
def sites(postgres: RunningPostgres, store: RunningStore) -> Sites:
    """Empty sites."""
    return Sites(postgres, store)
