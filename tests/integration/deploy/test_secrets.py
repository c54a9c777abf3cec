"""The password of the serving role is rotated as `docs/operating.md` says, with real processes."""

import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import urllib3

from kleinkram.standalone import postgres as pg
from tests.integration.deploy.units import clean_environment
from tests.integration.upload_client import wait_until
from tests.ports import choose_port
from tests.services import RunningPostgres, RunningStore

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]
_ROLE = "kleinkram_rotated"
_OLD, _NEW = "old-password-hunter22", "new-password-hunter22"


@contextmanager
def _process(environment: dict[str, str], folder: Path, port: int) -> Iterator["subprocess.Popen[bytes]"]:
    command = [sys.executable, "-m", "kleinkram.server", "api", "--host", "127.0.0.1", "--port", str(port)]
    with (folder / "api.log").open("ab") as log:
        process = subprocess.Popen(command, env=environment, cwd=folder, stdout=log, stderr=log)
    try:
        yield process
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait(60)


def _status(port: int) -> int:
    try:
        return urllib3.request("GET", f"http://127.0.0.1:{port}/health/ready", retries=False).status
    except urllib3.exceptions.HTTPError:
        return 0


def test_the_password_of_the_serving_role_is_rotated(
    postgres: RunningPostgres, store: RunningStore, template_database: str, tmp_path: Path
) -> None:
    database = postgres.create_database(template=template_database)
    # A role with the rights of the serving one, which other tests use meanwhile.
    postgres.sql(f"CREATE ROLE {_ROLE} LOGIN PASSWORD '{_OLD}' IN ROLE {pg.SERVE}")
    _, host, name = re.fullmatch(r"postgresql://(.*)@(.*)/(.*)", postgres.serve_url(database)).groups()  # type: ignore[union-attr]  # it matches
    secret, port = tmp_path / "database-password", choose_port()
    environment = {
        **clean_environment(),
        "KLEINKRAM_DATABASE_URL": f"postgresql://{_ROLE}@{host}/{name}",
        "KLEINKRAM_DATABASE_PASSWORD_FILE": str(secret),
        "KLEINKRAM_S3_INTERNAL_URL": store.endpoint,
        "KLEINKRAM_S3_BUCKET": store.create_bucket(),
        "KLEINKRAM_S3_ACCESS_KEY": store.access_key,
        "KLEINKRAM_S3_SECRET_KEY": store.secret_key,
    }
    try:
        secret.write_text(f"{_OLD}\n")
        with _process(environment, tmp_path, port):
            wait_until(lambda: _status(port) == 200, limit_s=120)
            secret.write_text(f"{_NEW}\n")
            postgres.sql(f"ALTER ROLE {_ROLE} PASSWORD '{_NEW}'")
            assert _status(port) == 200, "connections stay"
        with _process(environment, tmp_path, port):
            wait_until(lambda: _status(port) == 200, limit_s=120)
        assert "hunter22" not in (tmp_path / "api.log").read_text()
    finally:
        postgres.drop_database(database)
        postgres.sql(f"DROP ROLE {_ROLE}")
