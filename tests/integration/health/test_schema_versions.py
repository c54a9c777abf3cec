"""Programs of one version on the schema of another: a rolling upgrade needs no downtime."""

import os
import subprocess

import pytest
import urllib3

from kleinkram.server.health import routes
from kleinkram.server.migrations import HEAD
from tests.integration.api_server import Api
from tests.integration.conftest import StartApi
from tests.integration.upload_client import wait_until
from tests.klein import run_server

_LATER = f"{int(HEAD) + 1:04}"


@pytest.fixture(name="api")
def _api(start_api: StartApi, monkeypatch: pytest.MonkeyPatch) -> Api:
    monkeypatch.setattr(routes, "_HOLDS_S", 0)
    return start_api()


def _ready(api: Api) -> tuple[int, str]:
    answer = urllib3.request("GET", f"{api.url}/health/ready")
    return answer.status, answer.data.decode()


def _migrate_to(api: Api, revision: str, compatible_from: str | None) -> None:
    api.sql("UPDATE alembic_version SET version_num = %s, compatible_from = %s", revision, compatible_from)


def _migrate(api: Api) -> "subprocess.CompletedProcess[str]":
    settings = api.app.state.settings
    parts = api.database.info
    environment = {
        "KLEINKRAM_DATABASE_URL": str(settings.database_url),
        "KLEINKRAM_MIGRATION_DATABASE_URL": (
            f"postgresql://{parts.user}:{parts.password}@{parts.host}:{parts.port}/{parts.dbname}"
        ),
        "KLEINKRAM_S3_INTERNAL_URL": "http://unused",
        "KLEINKRAM_S3_ACCESS_KEY": "unused",
        "KLEINKRAM_S3_SECRET_KEY": "unused",
    }
    return run_server(["migrate"], {**os.environ, **environment})


def test_an_old_api_stays_ready_while_the_schema_moves_to_a_compatible_one(api: Api) -> None:
    assert api.sql("SELECT compatible_from <= version_num FROM alembic_version") == [(True,)]
    _migrate_to(api, _LATER, HEAD)
    assert _ready(api)[0] == 200
    api.project()


def test_an_old_api_is_not_ready_on_a_schema_that_it_does_not_know(api: Api) -> None:
    for compatible_from in (_LATER, None):
        _migrate_to(api, _LATER, compatible_from)
        wait_until(lambda: f"({_LATER}) is later than this program ({HEAD})" in _ready(api)[1])
        assert _ready(api)[0] == 503
        _migrate_to(api, HEAD, HEAD)
        wait_until(lambda: _ready(api)[0] == 200)
    _migrate_to(api, "0026", HEAD)
    wait_until(lambda: "open it with commit 530100f" in _ready(api)[1])


def test_an_old_migrate_on_a_later_schema_fails_with_an_explanation(api: Api) -> None:
    _migrate_to(api, _LATER, _LATER)
    ran = _migrate(api)
    assert ran.returncode == 1
    assert f"Nothing was changed: the database schema ({_LATER}) is later" in ran.stderr
    _migrate_to(api, _LATER, HEAD)
    compatible = _migrate(api)
    assert (compatible.returncode, "nothing to do" in compatible.stderr) == (0, True)
    assert "Traceback" not in ran.stderr + compatible.stderr
