"""The API for HTTP tests: one for the whole session, or one with settings of its own."""

import os
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
from alembic import command

from kleinkram.server.migrations import alembic_config
from tests import slurm_cluster
from tests.integration.api_server import Api, serving
from tests.integration.corpus import Corpus, upload_corpus
from tests.integration.kubernetes.real_cluster import RealCluster, real_cluster
from tests.integration.sample import Sample
from tests.requirements import missing, need
from tests.services import RunningPostgres, RunningStore
from tests.slurm_cluster import SlurmCluster

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
def slurm() -> Iterator[SlurmCluster]:
    """A Slurm cluster of one node."""
    if os.geteuid() != 0:
        missing("a Slurm of the tests' own needs root")
    need(*slurm_cluster.PROGRAMS)
    with slurm_cluster.slurm_cluster() as made:
        yield made


@pytest.fixture(scope="session")
def kubernetes() -> Iterator[RealCluster]:
    """A Kubernetes of one node, with a namespace for runs."""
    with real_cluster() as made:
        yield made
