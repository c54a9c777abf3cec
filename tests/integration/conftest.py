"""The API for HTTP tests: one for the whole session, or one with settings of its own."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any

import argon2
import pytest
from alembic import command

from kleinkram.recordings.sample import jpeg, scene
from kleinkram.server.auth import local_accounts
from kleinkram.server.blobs import readers
from kleinkram.server.migrations import alembic_config
from tests.integration.api_server import Api, serving
from tests.integration.corpus import Corpus, upload_corpus
from tests.integration.kubernetes.real_cluster import RealCluster, real_cluster
from tests.integration.sample import Sample
from tests.services import RunningPostgres, RunningStore

_QUICK_HASHER = argon2.PasswordHasher(time_cost=1, memory_cost=64, parallelism=1)
_THREAD_END_S = 20
StartApi = Callable[..., Api]
Starting = Callable[[], AbstractContextManager[StartApi]]
_LIMITS = [
    f"{what}_per_minute" for what in ("sign_ins", "searches", "downloads", "uploads", "verifications", "exports")
]


@pytest.fixture(scope="session")
def template_database(postgres: RunningPostgres) -> str:
    """The name of a migrated, empty database to copy."""
    name = postgres.create_database()
    url = postgres.migrate_url(name).replace("postgresql://", "postgresql+psycopg://", 1)
    command.upgrade(alembic_config(url, "kleinkram_serve"), "head")
    return name


@pytest.fixture(scope="session")
def starting(
    postgres: RunningPostgres, store: RunningStore, template_database: str, tmp_path_factory: pytest.TempPathFactory
) -> Starting:
    """A block of code that may start APIs, each with a new database and bucket; they end with the block."""

    @contextmanager
    def block() -> Iterator[StartApi]:
        with ExitStack() as stack:

            def start(**settings: Any) -> Api:
                name = postgres.create_database(template=template_database)
                stack.callback(postgres.drop_database, name)
                values = {
                    "database_url": postgres.serve_url(name),
                    "s3_internal_url": store.endpoint,
                    "s3_bucket": store.create_bucket(),
                    "s3_region": store.region,
                    "s3_access_key": store.access_key,
                    "s3_secret_key": store.secret_key,
                    # Tests ask faster than people; those of limits set them.
                    **dict.fromkeys(_LIMITS, 0),
                    # Many have blobs that no store has.
                    "scrub_hours": 0,
                    "metrics_port": 0,
                    "package_index": "off",
                    **settings,
                }
                folder: Path = tmp_path_factory.mktemp("api")
                return stack.enter_context(serving(values, admin_url=postgres.migrate_url(name), folder=folder))

            yield start

    return block


@pytest.fixture(scope="module")
def start_api(starting: Starting) -> Iterator[StartApi]:
    """A function that starts an API, given settings; it runs until the module ends."""
    with starting() as start:
        yield start


@pytest.fixture(scope="session")
def begun_apis() -> list[Api]:
    """The session's API, once a test has asked for it."""
    return []


@pytest.fixture(scope="session")
def api(starting: Starting, begun_apis: list[Api]) -> Iterator[Api]:
    """The API of the session. Tests share it, so each creates its own project."""
    with starting() as start:
        begun_apis.append(start())
        yield begun_apis[0]


@pytest.fixture(scope="module", autouse=True)
def _isolate_modules(begun_apis: list[Api]) -> Iterator[None]:
    """Remove what a module leaves in the shared API and the next would meet: waiting jobs, public projects."""
    yield
    for api in begun_apis:
        api.sql("DELETE FROM procrastinate_jobs WHERE status = 'todo'")
        api.sql("UPDATE project SET is_public = false WHERE is_public")
        # Or garbage collection would find a thousand missions without recordings.
        api.sql("UPDATE mission SET derived_revision = files_revision WHERE derived_revision <> files_revision")


@pytest.fixture(scope="module", autouse=True)
def _threads_end() -> Iterator[None]:
    """Fail a module after which a thread of the product goes on: it would disturb the tests that follow."""
    before = {*threading.enumerate()}
    yield
    left = [thread for thread in threading.enumerate() if thread not in before and _is_of_the_product(thread)]
    deadline = time.monotonic() + _THREAD_END_S
    for thread in left:
        thread.join(max(0.0, deadline - time.monotonic()))
    assert [thread.name for thread in left if thread.is_alive()] == [], "close what started these threads"


def _is_of_the_product(thread: threading.Thread) -> bool:
    """Whether it runs code of the product; the session's API runs in a thread of the web server."""
    return str(getattr(getattr(thread, "_target", None), "__module__", "")).startswith("kleinkram.")


@pytest.fixture(scope="module", autouse=True)
def _quick_hashes() -> Iterator[None]:
    """Let servers in this process hash passwords quickly; the unit tests hash as the product does."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(local_accounts, "_argon2", _QUICK_HASHER)
        local_accounts._unknown_hash.cache_clear()
        yield
    local_accounts._unknown_hash.cache_clear()


@pytest.fixture(scope="module", autouse=True)
def _reused_readers() -> Iterator[None]:
    """Let children that read recordings wait for the next test's: starting one takes 0.15 s of CPU time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(readers, "_IDLE_S", 30.0)
        yield


@pytest.fixture(scope="module")
def remembered_scenes() -> Iterator[None]:
    """Let a module make many sample missions quickly: what cameras and lidars see takes most of the time.

    It depends only on the seed and the size; defects come later.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scene.LidarView, "scan", lru_cache(maxsize=500)(scene.LidarView.scan))
        patch.setattr(scene.CameraView, "picture", lru_cache(maxsize=500)(scene.CameraView.picture))
        patch.setattr(jpeg, "mosaic_jpeg", lru_cache(maxsize=500)(jpeg.mosaic_jpeg))
        yield


@pytest.fixture
def mission_id(api: Api) -> str:
    """A new mission in a new project, of the API that the module tests."""
    return str(api.mission(api.project()["id"])["id"])


@pytest.fixture(scope="session")
def sample(api: Api) -> Sample:
    """Inserts files into missions as if they had been uploaded and summarised."""
    return Sample(api)


@pytest.fixture(scope="session")
def corpus(starting: Starting, recordings_dir: Path) -> Iterator[Corpus]:
    """The real recordings in a mission of an API of their own, summarised, verified and grouped."""
    with starting() as start:
        yield upload_corpus(start(), recordings_dir)


@pytest.fixture(scope="session")
def kubernetes() -> Iterator[RealCluster]:
    """A Kubernetes of one node, with a namespace for runs."""
    with real_cluster() as made:
        yield made
