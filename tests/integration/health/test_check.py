"""`python -m kleinkram.server check` names each fault with its remedy."""

import asyncio
import datetime
import json
import os
import ssl
import threading
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import urllib3

from kleinkram.diagnostics import Diagnostic
from kleinkram.recordings import isolation
from kleinkram.server.health import checks, public_address
from kleinkram.server.http.headers import CHECK_HEADER, RequestOrigin, operator_code
from kleinkram.server.settings import Settings, _networks
from tests.certificate import make_certificate
from tests.http_server import QuietHandler, Server
from tests.integration.api_server import Api
from tests.integration.conftest import StartApi
from tests.integration.fault_proxy import ProxiedRequest, Reply, standing_before
from tests.klein import run_server
from tests.otlp_collector import collecting
from tests.ports import choose_port
from tests.scripted_server import scripted
from tests.services import RunningPostgres, RunningStore


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
    ran = run_server(["check", "--json"], {**os.environ, **environment})
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


def test_a_reader_that_cannot_start_is_named(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(isolation, "CHILD_COMMAND", ("/nowhere/python",))
    actual = checks._reader(api.app.state.settings)
    assert (actual.severity.value, "No such file" in actual.message) == ("problem", True)


_ORIGIN = {"peer": "10.0.0.3", "forwarded_for": ("203.0.113.7",), "address": "203.0.113.7", "scheme": "https"}


@pytest.mark.parametrize(
    ("origin", "forged", "trusted", "severity", "words"),
    [
        ({}, {}, "10.0.0.3", "ok", "as 203.0.113.7"),
        (
            {"address": "10.0.0.3"},
            {},
            "10.0.0.9",
            "problem",
            "Add 10.0.0.3, or the proxy's network, to KLEINKRAM_TRUSTED",
        ),
        (
            {"forwarded_for": ("203.0.113.7", "10.0.0.4"), "address": "10.0.0.4"},
            {},
            "10.0.0.3",
            "problem",
            "Add 10.0.0.4, or the proxy's network, to KLEINKRAM_TRUSTED_PROXIES",
        ),
        ({"forwarded_for": (), "address": "10.0.0.3"}, {}, "10.0.0.3", "problem", "does not send X-Forwarded-For"),
        ({"forwarded_for": (), "peer": "127.0.0.1"}, {}, "10.0.0.3", "problem", "does not send X-Forwarded-For"),
        ({}, {"forwarded_for": ("192.0.2.77",)}, "10.0.0.3", "problem", "clients, who can claim any address"),
        ({"scheme": "http"}, {}, "10.0.0.3", "problem", "takes https for http. Let the proxy set X-Forwarded-Proto"),
        (
            {},
            {"scheme": "http"},
            "10.0.0.3",
            "problem",
            "for http, if a client says so. Let the proxy set X-Forwarded-Pr",
        ),
        ({}, {}, "0.0.0.0/0", "problem", "has all addresses: every client can claim"),
        ({}, {}, "10.0.0.3, 203.0.113.0/24", "warning", "203.0.113.7, where this command runs"),
    ],
)
def test_wrong_headers_of_a_proxy_are_named(
    api: Api, origin: dict[str, Any], forged: dict[str, Any], trusted: str, severity: str, words: str
) -> None:
    update = {"public_url": "https://lab.example", "trusted_proxies": _networks(trusted)}
    settings = api.app.state.settings.model_copy(update=update)
    honest, claiming = ({**_ORIGIN, **origin, **changes} for changes in ({}, forged))
    result = public_address._proxy(
        settings, RequestOrigin.model_validate(honest), RequestOrigin.model_validate(claiming)
    )
    assert (result.severity.value, words in f"{result.message} {result.remedy}") == (severity, True), result


def test_only_operators_see_how_a_request_arrived(api: Api) -> None:
    url = f"{api.url}/health/live"
    assert urllib3.request("GET", url, headers={CHECK_HEADER: "guess"}).data == b"live\n"
    message = urllib3.request("GET", url, headers={CHECK_HEADER: operator_code(api.app.state.settings)}).json()
    assert (message["peer"], message["forwarded_for"]) == ("127.0.0.1", [])


def test_missing_and_excessive_rights_of_the_serving_role_are_named(start_api: StartApi) -> None:
    api = start_api()
    role = api.app.state.settings.serving_role
    for change, undo, words in (
        (f"REVOKE INSERT ON mission FROM {role}", f"GRANT INSERT ON mission TO {role}", "may not read and write"),
        (f"REVOKE INSERT ON audit_event FROM {role}", f"GRANT INSERT ON audit_event TO {role}", "may not add to the"),
        (f"GRANT UPDATE ON audit_event TO {role}", f"REVOKE UPDATE ON audit_event FROM {role}", "may alter the audit"),
    ):
        api.sql(change)
        _assert_problem(_diagnose(checks._database, api.app.state.settings), "rights of the serving role", words)
        api.sql(undo)


def test_a_retention_that_was_not_stored_and_an_unusable_archive_are_named(api: Api, tmp_path: Path) -> None:
    environment = {**_environment(api), "KLEINKRAM_AUDIT_DAYS": "90", "KLEINKRAM_AUDIT_ARCHIVE": str(tmp_path / "no")}
    code, actual = _check(environment)
    assert (code, actual["audit archive"]["severity"]) == (1, "problem")
    assert (actual["audit log"]["severity"], "migrate" in actual["audit log"]["remedy"]) == ("warning", True)
    run_server(["migrate"], {**os.environ, **environment}).check_returncode()
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


def _diagnose(check: Callable[[Settings], AsyncIterator[Diagnostic]], settings: Settings) -> dict[str, Diagnostic]:
    async def collect() -> dict[str, Diagnostic]:
        return {result.check: result async for result in check(settings)}

    return asyncio.run(collect())


def _changed(api: Api, **values: Any) -> Settings:
    settings: Settings = api.app.state.settings
    return Settings.model_validate({**settings.model_dump(), **values})


def _assert_problem(results: dict[str, Diagnostic], check: str, words: str) -> None:
    assert results[check].severity.value == "problem", results
    assert words in f"{results[check].message} {results[check].remedy}", results[check]
    assert "hunter22" not in str(results)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"s3_bucket": "nowhere"}, "there is no bucket 'nowhere': create it, or correct KLEINKRAM_S3_BUCKET"),
        ({"s3_access_key": "stranger"}, "it does not know the access key: correct KLEINKRAM_S3_ACCESS_KEY"),
        ({"s3_secret_key": "hunter22"}, "does not fit the access key: correct KLEINKRAM_S3_SECRET_KEY"),
        ({"s3_internal_url": "http://127.0.0.1:9"}, "onnect call failed"),
        ({"s3_internal_url": "http://store.invalid"}, "it does not answer: "),
    ],
)
def test_a_wrong_bucket_key_or_address_of_the_store_is_named(api: Api, values: dict[str, str], words: str) -> None:
    _assert_problem(_diagnose(checks._store, _changed(api, **values)), "store", words)


def test_a_wrong_scheme_of_the_store_is_named(api: Api, store: RunningStore, tmp_path: Path) -> None:
    https = store.endpoint.replace("http://", "https://")
    results = _diagnose(checks._store, _changed(api, s3_internal_url=https))
    _assert_problem(results, "store", "it does not speak TLS: its address may begin with http://")
    with _speaking_tls(tmp_path, "127.0.0.1") as url:
        results = _diagnose(checks._store, _changed(api, s3_internal_url=url.replace("https://", "http://")))
    _assert_problem(results, "store", "it does not answer: Connection reset by peer. Start it, or correct the settings")
    results = _diagnose(checks._store, _changed(api, s3_internal_url=api.url))
    _assert_problem(results, "store", "correct the settings KLEINKRAM_S3_")


@pytest.mark.parametrize(
    ("reply", "words"),
    [
        (Reply(403, "AccessDenied"), "no right to list the bucket"),
        (Reply(400, "AuthorizationHeaderMalformed"), "it is in another region: correct KLEINKRAM_S3_REGION"),
        (Reply(301, "PermanentRedirect"), "it is in another region: correct KLEINKRAM_S3_REGION"),
        (Reply(403, "RequestTimeTooSkewed"), "let both set their clocks (NTP)"),
        (Reply(400), "may have to begin with https://"),
        (Reply(404), "there is no bucket"),
    ],
    ids=repr,
)
def test_what_other_stores_answer_is_explained(api: Api, store: RunningStore, reply: Reply, words: str) -> None:
    with standing_before(store.endpoint) as middleman:
        middleman.rule = lambda _request: reply
        results = _diagnose(checks._store, _changed(api, s3_internal_url=middleman.url))
    _assert_problem(results, "store", words)


def _is_write(request: ProxiedRequest) -> bool:
    return request.method == "PUT" and not request.query.keys() & {"uploadId", "cors"}


@pytest.mark.parametrize(
    ("right", "needs"),
    [
        ("s3:PutObject", _is_write),
        (
            "s3:GetObject",
            lambda request: request.method == "GET" and "/" in request.key and "uploadId" not in request.query,
        ),
        ("s3:DeleteObject", lambda request: request.method == "DELETE" and "uploadId" not in request.query),
        ("s3:AbortMultipartUpload", lambda request: request.method == "DELETE" and "uploadId" in request.query),
        ("s3:ListBucketMultipartUploads", lambda request: request.method == "GET" and "uploads" in request.query),
    ],
)
def test_a_missing_right_of_the_access_key_is_named(
    api: Api, store: RunningStore, right: str, needs: Callable[[ProxiedRequest], bool]
) -> None:
    with standing_before(store.endpoint) as middleman:
        middleman.rule = lambda request: Reply(403, "AccessDenied") if needs(request) else None
        results = _diagnose(checks._store, _changed(api, s3_internal_url=middleman.url))
    _assert_problem(results, f"right {right}", "AccessDenied. Grant it to the access key on this bucket.")


@contextmanager
def _speaking_tls(folder: Path, address: str, *, hours: int = 1) -> Iterator[str]:
    """Run a server that shakes hands with a certificate for an address, at 127.0.0.1."""

    certificate, key = make_certificate(folder, address, hours=hours)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate, key)
    with Server(("127.0.0.1", 0), QuietHandler) as server:
        server.socket = context.wrap_socket(server.socket, server_side=True)
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        try:
            yield f"https://127.0.0.1:{server.server_port}"
        finally:
            server.shutdown()
            thread.join()


@pytest.mark.parametrize(
    ("address", "hours", "is_known", "words"),
    [
        ("127.0.0.1", 1, False, "certificate is refused: self-signed certificate"),
        ("127.0.0.1", -1, True, "certificate is refused: certificate has expired"),
        ("127.0.0.5", 1, True, "certificate is refused: IP address mismatch"),
    ],
    ids=["unknown authority", "expired", "another name"],
)
def test_a_wrong_certificate_of_store_or_api_is_named(
    api: Api, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, address: str, hours: int, is_known: bool, words: str
) -> None:
    with _speaking_tls(tmp_path, address, hours=hours) as url:
        authority = tmp_path / "cert.pem" if is_known else None
        if authority is not None:
            monkeypatch.setenv("SSL_CERT_FILE", str(authority))
        of_store = _diagnose(checks._store, _changed(api, s3_internal_url=url, s3_ca_file=authority))
        at_public_store = _diagnose(checks._store, _changed(api, s3_public_url=url))
        of_api = _diagnose(public_address.check_public_address, _changed(api, public_url=url))
    _assert_problem(of_store, "store", words)
    assert "KLEINKRAM_S3_CA_FILE" in of_store["store"].message
    for results, check in ((of_api, "public address"), (at_public_store, "public address of the store")):
        _assert_problem(results, check, words)
        assert "SSL_CERT_FILE" in results[check].remedy


def test_another_time_of_store_or_database_is_named(api: Api, postgres: RunningPostgres, store: RunningStore) -> None:
    with standing_before(store.endpoint) as middleman:
        middleman.ahead = datetime.timedelta(minutes=3)
        results = _diagnose(checks._store, _changed(api, s3_internal_url=middleman.url))
    _assert_problem(results, "clock of the store", "s. Signatures contain the time")
    api.sql("CREATE SCHEMA wrong")
    api.sql(
        "CREATE FUNCTION wrong.clock_timestamp() RETURNS timestamptz LANGUAGE sql "
        "RETURN pg_catalog.clock_timestamp() + interval '2 hours'"
    )
    api.sql(f"GRANT USAGE ON SCHEMA wrong TO {api.app.state.settings.serving_role}")
    url = f"{api.app.state.settings.database_url}?options=-csearch_path%3Dwrong,pg_catalog,public"
    results = _diagnose(checks._database, _changed(api, database_url=url))
    _assert_problem(results, "clock of the database", "The clocks differ by 7200 s")


def test_a_wrong_role_password_or_database_is_named(api: Api, postgres: RunningPostgres) -> None:
    role, name = api.app.state.settings.serving_role, api.database.info.dbname
    url = postgres.serve_url(name)
    password = url.partition("@")[0].rpartition(":")[2]
    for wrong, words in (
        (url.replace(password, "hunter22"), "password authentication failed for user"),
        (url.replace(f"/{name}", "/nowhere"), 'database "nowhere" does not exist'),
        (f"postgresql://me:hunter22@127.0.0.1:{choose_port()}/{name}", "Correct KLEINKRAM_DATABASE_URL"),
    ):
        _assert_problem(_diagnose(checks._database, _changed(api, database_url=wrong)), "database", words)
    superuser = postgres.admin_url.replace("/postgres", f"/{name}")
    admin = superuser.partition("://")[2].partition(":")[0]
    results = _diagnose(checks._database, _changed(api, database_url=superuser, serving_role=admin))
    _assert_problem(results, "serving role", "Serve with a role that owns nothing")
    owner = _changed(api, database_url=postgres.migrate_url(name), serving_role="kleinkram_migrate")
    _assert_problem(_diagnose(checks._database, owner), "serving role", "may change the schema, and so the audit log")
    results = _diagnose(checks._database, _changed(api, serving_role="other"))
    _assert_problem(results, "serving role", f"It is {role}, but migrations grant rights to other")
    results = _diagnose(checks._database, _changed(api, database_connections=200))
    assert "lower KLEINKRAM_DATABASE_CONNECTIONS" in results["connections"].remedy


def test_a_role_that_may_not_read_or_does_not_own_the_tables_is_named(start_api: StartApi) -> None:
    api = start_api()
    role = api.app.state.settings.serving_role
    api.sql(f"REVOKE SELECT ON worker_process, alembic_version FROM {role}")
    results = _diagnose(checks._database, api.app.state.settings)
    _assert_problem(results, "rights of the serving role", "these tables: alembic_version, worker_process. Migrations")
    settings = _changed(api, migration_database_url=str(api.app.state.settings.database_url))
    results = _diagnose(checks._migrating_role, settings)
    _assert_problem(results, "migrating role", f"Migrate as kleinkram_migrate, or REASSIGN OWNED BY it TO {role}")


def test_a_schema_that_is_missing_behind_or_ahead_is_named(start_api: StartApi, postgres: RunningPostgres) -> None:
    api = start_api()
    for revision, compatible_from, words in (
        ("0100", None, "older than this program: run `python -m kleinkram.server migrate`"),
        ("9999", "9999", "start the version that migrated it, or restore a backup"),
        ("9999", None, "start the version that migrated it, or restore a backup"),
    ):
        api.sql("UPDATE alembic_version SET version_num = %s, compatible_from = %s", revision, compatible_from)
        _assert_problem(_diagnose(checks._database, api.app.state.settings), "schema", words)
    empty = postgres.create_database()
    results = _diagnose(checks._database, _changed(api, database_url=postgres.serve_url(empty)))
    _assert_problem(results, "schema", "The database has no schema: run `python -m kleinkram.server migrate`")
    postgres.drop_database(empty)


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        ((502, b""), "it does not reach the API. Start the API"),
        ((301, b""), "Set KLEINKRAM_PUBLIC_URL to the address that clients use"),
        ((404, b""), "answers 404. Let the proxy pass it on to the API"),
        ((200, b"<html>It works!</html>"), "Another server than the API answers"),
    ],
)
def test_a_public_address_that_does_not_lead_to_the_api_is_named(
    api: Api, answer: tuple[int, bytes], words: str
) -> None:
    with scripted(answer) as server:
        results = _diagnose(public_address.check_public_address, _changed(api, public_url=server.url))
    _assert_problem(results, "public address", words)


def test_a_public_address_of_the_store_that_does_not_lead_to_it_is_named(api: Api) -> None:
    results = _diagnose(checks._store, _changed(api, s3_public_url=api.url))
    _assert_problem(results, "public address of the store", "does not lead to the bucket: a signed URL answers 404")
    results = _diagnose(checks._store, _changed(api, public_url="https://lab.example"))
    assert "public address of the store" in results
