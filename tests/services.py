"""A private PostgreSQL and a private S3 store for a test session.

Use with `pytest_plugins = ["tests.services"]`, or `-p tests.services`. Both die with pytest, however it dies.
"""

import itertools
import os
import secrets
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest

from kleinkram.standalone import object_store, postgres, processes
from tests.ports import choose_port

_numbers = itertools.count(1)
_MEMORY = Path("/dev/shm")
_ENOUGH_BYTES = 4 * 2**30
_MEMORY_OF_STORE = {"GOMEMLIMIT": "1GiB"}


def fast_folder() -> str | None:
    """Return a file system in memory with room for all workers of a test run; None, which is the default, without one.

    There, creating a database takes 0.03 s of CPU time instead of 0.4 s. A container has 64 MB of it by default.
    """
    if _MEMORY.is_dir() and os.access(_MEMORY, os.W_OK) and shutil.disk_usage(_MEMORY).free > _ENOUGH_BYTES:
        return str(_MEMORY)
    return None


@dataclass(frozen=True)
class RunningPostgres:
    """A PostgreSQL with the two roles; every test may have databases of its own."""

    cluster: postgres.PostgresCluster

    @property
    def admin_url(self) -> str:
        """Superuser on the maintenance database."""
        return self.cluster.url(postgres.ADMIN, "postgres")

    def migrate_url(self, database: str) -> str:
        """The role that owns the schema."""
        return self.cluster.url(postgres.MIGRATE, database)

    def serve_url(self, database: str) -> str:
        """The role that the API and the worker use."""
        return self.cluster.url(postgres.SERVE, database)

    def create_database(self, *, template: str = "template0") -> str:
        """A new database, a copy of `template` (which must have no connections); about 30 ms. Returns its name."""
        name = f"test_{os.getpid()}_{next(_numbers)}"
        self.sql(f"CREATE DATABASE {name} OWNER {postgres.MIGRATE} TEMPLATE {template} STRATEGY FILE_COPY")
        if template == "template0":
            self.sql(
                f"ALTER SCHEMA public OWNER TO {postgres.MIGRATE}; GRANT USAGE ON SCHEMA public TO {postgres.SERVE}",
                database=name,
            )
        return name

    def drop_database(self, name: str) -> None:
        """Remove a database and end its connections."""
        self.sql(f"DROP DATABASE IF EXISTS {name} WITH (FORCE)")

    def sql(self, script: str, *, database: str = "postgres") -> str:
        """Run statements as superuser; returns unaligned tuples."""
        return postgres.run_sql(self.cluster, script, database=database)


@dataclass(frozen=True)
class RunningStore:
    """An S3 store with one identity that may do everything."""

    endpoint: str
    access_key: str
    secret_key: str
    region: str
    folder: Path = field(repr=False)

    @property
    def access(self) -> object_store.StoreAccess:
        """The same for `kleinkram.standalone.object_store`."""
        return object_store.StoreAccess(self.endpoint, self.access_key, self.secret_key, self.region)

    def create_bucket(self) -> str:
        """A new, empty bucket; returns its name."""
        name = f"test-{os.getpid()}-{next(_numbers)}"
        assert object_store.create_bucket(self.access, name)
        return name


@pytest.fixture(scope="session", name="postgres")
def _postgres() -> Iterator[RunningPostgres]:
    """The session's PostgreSQL."""
    with tempfile.TemporaryDirectory(prefix="klein-pg-", dir=fast_folder()) as name:
        folder = Path(name)
        cluster = postgres.PostgresCluster(
            binaries=postgres.locate_postgres(),
            data_dir=folder,
            folder=folder / "postgres",
            log=folder / "postgres.log",
            port=choose_port(),
            passwords={role: secrets.token_hex(16) for role in (postgres.ADMIN, postgres.MIGRATE, postgres.SERVE)},
        )
        postgres.initialise(cluster)
        # What is lost by a crash of the machine is only a test's; the log should not fill the memory; and each minute
        # a vacuum would start for each of a dozen databases.
        quick = {"fsync": "off", "max_connections": "400", "max_wal_size": "128MB", "autovacuum": "off"}
        process = postgres.start(cluster, extra=quick)
        try:
            _wait_until(lambda: postgres.is_ready(cluster, process), process, cluster.log)
            postgres.prepare_database(cluster)
            yield RunningPostgres(cluster)
        finally:
            processes.stop(process, sign=postgres.STOP_SIGNAL, timeout_s=10)


@pytest.fixture(scope="session", name="store")
def _store() -> Iterator[RunningStore]:
    """The session's S3 store."""
    with tempfile.TemporaryDirectory(prefix="klein-s3-", dir=fast_folder()) as name:
        folder = Path(name)
        plan = object_store.StoreFolder(
            program=object_store.locate_weed(),
            data_dir=folder,
            folder=folder,
            log=folder / "store.log",
            ports={name: choose_port() for name in object_store.PORT_NAMES},
            access_key=secrets.token_hex(10),
            secret_key=secrets.token_hex(20),
        )
        # Each bucket takes a volume at least, and weed counts as many as would fit on the disk when full.
        command = object_store.prepare(plan, extra=["-master.volumeSizeLimitMB=64"])
        # After hundreds of buckets, collecting garbage to stay below the limit of `klein up` takes a tenth of a core.
        process = processes.spawn(replace(command, environment={**command.environment, **_MEMORY_OF_STORE}))
        try:
            _wait_until(lambda: object_store.is_ready(plan.access, object_store.BUCKET), process, plan.log)
            access = plan.access
            yield RunningStore(access.endpoint, access.access_key, access.secret_key, access.region, folder)
        finally:
            # Nothing of it is needed again: no reason to wait the two seconds of its orderly end.
            processes.stop(process, sign=signal.SIGKILL, timeout_s=10)
            object_store.remove_sockets(plan)


def _wait_until(ready: Callable[[], bool], process: "subprocess.Popen[bytes]", log: Path) -> None:
    deadline = time.monotonic() + 60
    while not ready():
        if process.poll() is not None or time.monotonic() > deadline:
            pytest.fail(f"did not become ready (exit code {process.returncode}):\n{log.read_text()[-3000:]}")
        time.sleep(0.02)
