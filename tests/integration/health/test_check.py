"""`python -m kleinkram.server check` names each fault with its remedy."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import urllib3

from kleinkram.recordings import isolation
from kleinkram.server.health import checks
from kleinkram.server.http.headers import CHECK_HEADER, RequestOrigin, operator_code
from tests.integration.api_server import Api
from tests.integration.conftest import StartApi
from tests.otlp_collector import collecting
from tests.ports import choose_port
from tests.services import RunningPostgres


def _environment(api: Api) -> dict[str, str]:
    settings = api.app.state.settings
    parts = api.database.info
    return {
        "KLEINKRAM_DATABASE_URL": str(settings.database_url),
        "KLEINKRAM_MIGRATION_DATABASE_URL": (
            f"postgresql://{parts.user}:{parts.password}@{parts.host}:{parts.port}/{parts.dbname}"
        ),
        "KLEINKRAM_S3_INTERNAL_URL": settings.s3_internal_url,
        "KLEINKRAM_S3_BUCKET": settings.s3_bucket,
        "KLEINKRAM_S3_ACCESS_KEY": settings.s3_access_key,
        "KLEINKRAM_S3_SECRET_KEY": settings.s3_secret_key.get_secret_value(),
        "KLEINKRAM_PUBLIC_URL": api.url,
    }


def _check(environment: dict[str, str]) -> tuple[int, dict[str, Any]]:
    ran = subprocess.run(
        [sys.executable, "-m", "kleinkram.server", "check", "--json"],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
    )
    assert "hunter22" not in ran.stdout + ran.stderr
    return ran.returncode, {item["check"]: item for item in json.loads(ran.stdout)["checks"]}


@pytest.fixture(name="api", scope="module")
def _api(start_api: StartApi) -> Api:
    return start_api()


def test_a_healthy_server_has_no_problems(api: Api) -> None:
    code, actual = _check(_environment(api))
    assert {name: item for name, item in actual.items() if item["severity"] == "problem"} == {}
    assert code == 0
    assert actual["checksums of the store"]["message"] == "It verifies crc64nvme."
    assert actual["reader"]["severity"] == actual["proxy headers"]["severity"] == actual["schema"]["severity"] == "ok"
    assert actual["workers"]["severity"] == "warning", "none runs"


def test_a_wrong_bucket_and_a_misspelt_setting_are_named(api: Api) -> None:
    environment = _environment(api)
    code, actual = _check({**environment, "KLEINKRAM_S3_BUCKET": "nowhere"})
    assert code == 1
    assert "there is no bucket 'nowhere'" in actual["store"]["message"]
    code, actual = _check({**environment, "KLEINKRAM_TRUSTED_PROXY": "127.0.0.1"})
    assert (code, "did you mean KLEINKRAM_TRUSTED_PROXIES" in actual["settings"]["message"]) == (1, True)


def test_a_single_role_and_an_unreachable_database_are_named(api: Api, postgres: RunningPostgres) -> None:
    environment = _environment(api)
    owner = environment["KLEINKRAM_MIGRATION_DATABASE_URL"]
    code, actual = _check(
        {**environment, "KLEINKRAM_DATABASE_URL": owner, "KLEINKRAM_SERVING_ROLE": "kleinkram_migrate"}
    )
    assert (code, actual["serving role"]["severity"]) == (1, "problem")
    assert "audit log" in actual["serving role"]["message"]
    nowhere = f"postgresql://me:hunter22@127.0.0.1:{choose_port()}/kleinkram"
    code, actual = _check({**environment, "KLEINKRAM_DATABASE_URL": nowhere})
    assert (code, actual["database"]["severity"]) == (1, "problem")


def test_a_reader_that_cannot_start_is_named(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(isolation, "CHILD_COMMAND", ("/nowhere/python",))
    actual = checks._reader(api.app.state.settings)
    assert (actual.severity.value, "No such file" in actual.message) == ("problem", True)


@pytest.mark.parametrize(
    ("text", "severity", "words"),
    [
        ({}, "ok", "as 203.0.113.7"),
        ({"is_trusted": False}, "problem", "KLEINKRAM_TRUSTED_PROXIES=10.0.0.3"),
        ({"forwarded": False, "peer": "127.0.0.1"}, "problem", "does not send X-Forwarded-For"),
        ({"scheme": "http"}, "problem", "X-Forwarded-Proto"),
    ],
)
def test_headers_missing_from_a_proxy_are_named(api: Api, text: dict[str, Any], severity: str, words: str) -> None:
    origin = {"peer": "10.0.0.3", "is_trusted": True, "forwarded": True, "address": "203.0.113.7", "scheme": "https"}
    settings = api.app.state.settings.model_copy(update={"public_url": "https://lab.example"})
    actual = checks._proxy(settings, RequestOrigin.model_validate({**origin, **text}))
    assert (actual.severity.value, words in actual.message + actual.remedy) == (severity, True)


def test_only_operators_see_how_a_request_arrived(api: Api) -> None:
    url = f"{api.url}/health/live"
    assert urllib3.request("GET", url, headers={CHECK_HEADER: "guess"}).data == b"live\n"
    message = urllib3.request("GET", url, headers={CHECK_HEADER: operator_code(api.app.state.settings)}).json()
    assert (message["peer"], message["forwarded"]) == ("127.0.0.1", False)


def test_missing_and_excessive_rights_of_the_serving_role_are_named(start_api: StartApi) -> None:
    api = start_api()
    environment, role = _environment(api), api.app.state.settings.serving_role
    for change, undo, words in (
        (f"REVOKE INSERT ON mission FROM {role}", f"GRANT INSERT ON mission TO {role}", "may not read and write"),
        (f"REVOKE INSERT ON audit_event FROM {role}", f"GRANT INSERT ON audit_event TO {role}", "may not add to the"),
        (f"GRANT UPDATE ON audit_event TO {role}", f"REVOKE UPDATE ON audit_event FROM {role}", "may alter the audit"),
    ):
        api.sql(change)
        code, actual = _check(environment)
        assert (code, actual["rights of the serving role"]["severity"]) == (1, "problem"), change
        assert words in actual["rights of the serving role"]["message"]
        api.sql(undo)


def test_a_retention_that_was_not_stored_and_an_unusable_archive_are_named(api: Api, tmp_path: Path) -> None:
    environment = {**_environment(api), "KLEINKRAM_AUDIT_DAYS": "90", "KLEINKRAM_AUDIT_ARCHIVE": str(tmp_path / "no")}
    code, actual = _check(environment)
    assert (code, actual["audit archive"]["severity"]) == (1, "problem")
    assert (actual["audit log"]["severity"], "migrate" in actual["audit log"]["remedy"]) == ("warning", True)
    command = [sys.executable, "-m", "kleinkram.server", "migrate"]
    subprocess.run(command, env={**os.environ, **environment}, check=True)
    code, actual = _check({**environment, "KLEINKRAM_AUDIT_ARCHIVE": str(tmp_path)})
    assert (code, actual["audit log"]["severity"], actual["audit archive"]["severity"]) == (0, "ok", "ok")
    assert actual["audit log"]["message"] == "Events are kept for 90 days."
    api.sql("DELETE FROM audit_retention")
    _, actual = _check({**environment, "KLEINKRAM_AUDIT_DAYS": "29"})
    assert "at least 30" in actual["settings"]["message"]


@pytest.mark.parametrize(
    ("variables", "words"),
    [
        ({"OTEL_EXPORTER_OTLP_ENDPOINT": "collector:4318"}, "does not begin with http://"),
        ({"OTEL_EXPORTER_OTLP_ENDPOINT": "http://127.0.0.1:1"}, "cannot be reached"),
        ({"OTEL_EXPORTER_OTLP_ENDPOINT": "http://127.0.0.1:1", "OTEL_EXPORTER_OTLP_PROTOCOL": "grpc"}, "http/protobuf"),
    ],
)
def test_a_wrong_collector_of_traces_is_named(api: Api, variables: dict[str, str], words: str) -> None:
    code, results = _check({**_environment(api), **variables})
    assert (code, results["traces"]["severity"]) == (0, "warning")
    assert words in results["traces"]["message"]


def test_a_collector_of_traces_is_tried(api: Api) -> None:
    with collecting() as collector:
        _, results = _check({**_environment(api), "OTEL_EXPORTER_OTLP_ENDPOINT": collector.url})
        _, wrong = _check({**_environment(api), "OTEL_EXPORTER_OTLP_TRACES_ENDPOINT": f"{api.url}/v1/traces"})
    assert (results["traces"]["severity"], wrong["traces"]["severity"]) == ("ok", "warning")
    assert "traces" not in _check(_environment(api))[1]
