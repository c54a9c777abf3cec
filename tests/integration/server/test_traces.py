"""Traces, as a collector gets them: one upload and one run are one trace each, and no span holds a secret."""

from __future__ import annotations

import subprocess
import sys
import threading
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

import kleinkram
from kleinkram import traces
from kleinkram.client import Client
from kleinkram.contract.access import Scope, TokenKind
from kleinkram.contract.actions import ActionDefinition
from kleinkram.contract.runs import RunCreated, RunState
from kleinkram.environments.uv import parse_index
from kleinkram.recordings.sample import Faults, SampleFormat, generate_mission
from kleinkram.runner.executors.local import Machine, MachineShare
from kleinkram.runner.executors.process import ProcessExecutor
from kleinkram.runner.loop import Runner, RunnerOptions
from kleinkram.runner.state_directory import StateDirectory
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.conftest import StartApi
from tests.integration.jobs import run_jobs
from tests.integration.runner_loop.conftest import wait_until
from tests.integration.test_cli import klein_at
from tests.otlp_collector import OtlpCollector, collecting

_LARGE_BYTES = 12_000_000
_SECRETS = (b"X-Amz-", b"Signature", b"Bearer", b"klein_pat_", b"klein_run_", b"klein_runner_")


@pytest.fixture
def collector(monkeypatch: pytest.MonkeyPatch) -> Iterator[OtlpCollector]:
    """A collector to which this process exports its spans: the API, the worker, and a runner."""
    with collecting() as made:
        monkeypatch.setenv("OTEL_EXPORTER_OTLP_ENDPOINT", made.url)
        traces.start("kleinkram-test")
        assert traces.is_on()
        yield made
        traces.stop()


@pytest.fixture
def traced_api(collector: OtlpCollector, start_api: StartApi) -> Api:
    """An API that exports traces, and serves without them once the test has ended."""
    return start_api()


def _recordings(folder: Path) -> Path:
    """Make a recording of several parts, and a small file."""
    formats = [SampleFormat.mcap]
    generate_mission(folder, size_bytes=_LARGE_BYTES, seed=3, formats=formats, faults=Faults())
    (folder / "notes.txt").write_text("nothing")
    return folder


def _assert_no_secrets(collector: OtlpCollector, api: Api) -> None:
    exported = b"".join(collector.bodies)
    assert [secret for secret in (*_SECRETS, str(api.token).encode()) if secret in exported] == []


def test_an_upload_is_one_trace_from_the_command_to_the_verification(
    collector: OtlpCollector, traced_api: Api, tmp_path: Path
) -> None:
    api = traced_api
    mission = api.mission(api.project()["id"])
    klein = klein_at(api, tmp_path)
    klein("upload", "-m", mission["id"], _recordings(tmp_path / "drive"))
    run_jobs(api)
    traces.stop()
    (root,) = collector.named("klein upload")
    uploaded = [span for span in collector.spans if span.trace_id == root.trace_id]
    assert {span.service for span in uploaded} == {"klein", "kleinkram-test"}
    begin, complete = "POST /api/v1/missions/{mission_id}/uploads", "POST /api/v1/uploads/complete"
    assert collector.edges() >= {
        ("", "klein upload"),
        ("klein upload", "upload"),
        ("upload", "POST"),
        ("upload", "PUT"),
        ("POST", begin),
        (begin, "S3/CreateMultipartUpload"),
        ("POST", "POST /api/v1/uploads/parts"),
        ("POST", complete),
        (complete, "S3/CompleteMultipartUpload"),
        (complete, "process summarise_blob"),
        (complete, "process verify_blob"),
        ("process verify_blob", "S3/GetObject"),
        (complete, "process examine_blob"),
        (complete, "process group_recordings"),
    }
    # No span of these is in a trace of its own.
    names = {"POST", "PUT", begin, complete, "process verify_blob", "S3/GetObject", "S3/CompleteMultipartUpload"}
    assert {span.trace_id for span in collector.spans if span.name in names} == {root.trace_id}
    assert not any(span.is_error for span in uploaded)
    (verified,) = collector.named("process verify_blob")
    (completed,) = (span for span in collector.spans if span.span_id == verified.parent_id)
    assert completed.attributes["http.response.status_code"] == 200
    assert completed.attributes["http.route"] == "/api/v1/uploads/complete"
    (person,) = api.sql("SELECT person_id FROM token WHERE id = %s", completed.attributes["kleinkram.token_id"])
    assert completed.attributes["kleinkram.person_id"] == str(person[0])
    assert verified.attributes["kleinkram.request_id"] == completed.attributes["kleinkram.request_id"]
    _assert_no_secrets(collector, api)


def test_a_run_is_one_trace_from_its_launch_to_the_verification_of_its_artifacts(
    collector: OtlpCollector, traced_api: Api, tmp_path: Path
) -> None:
    api = traced_api
    # Of the only person: the runner's processes may not be isolated enough for several.
    runner_token = people.token(api, api.get("/me").ok()["person"]["id"], [Scope.run], kind=TokenKind.runner).secret
    with kleinkram.connect(api.url, api.token) as client, _runner(api, runner_token, tmp_path / "runner"):
        wait_until(lambda: api.sql("SELECT 1 FROM runner"))
        mission = api.mission(api.project()["id"])
        (tmp_path / "notes.txt").write_text("nothing")
        client.upload(tmp_path / "notes.txt", mission["id"])
        with traces.span("launching"):
            run_id = _launch(client, mission["id"])
        wait_until(lambda: client.runs.get(run_id).state is RunState.done)
    run_jobs(api)
    traces.stop()
    launch, finish = "POST /api/v1/runs", "POST /api/v1/runner/runs/{run_id}/finish"
    complete = "POST /api/v1/uploads/complete"
    assert collector.edges() >= {
        ("launching", "POST"),
        ("POST", launch),
        (launch, "run"),
        ("run", "prepare"),
        ("run", "execute"),
        ("run", "upload results"),
        ("prepare", "POST"),
        ("POST", "POST /api/v1/runner/runs/{run_id}/inputs"),
        ("upload results", "POST"),
        ("POST", finish),
        (complete, "process verify_blob"),
    }
    (root,) = collector.named("launching")
    (run,) = collector.named("run")
    assert run.trace_id == root.trace_id
    assert (run.attributes["kleinkram.run_id"], run.attributes["kleinkram.reason"]) == (str(run_id), "done")
    names = {launch, finish, "run", "prepare", "execute", "upload results"}
    assert {span.trace_id for span in collector.spans if span.name in names} == {root.trace_id}
    assert any(span.trace_id == root.trace_id for span in collector.named("process verify_blob"))
    assert collector.named("POST /api/v1/runners/{runner_id}/claims") == []
    _assert_no_secrets(collector, api)
    assert runner_token.encode() not in b"".join(collector.bodies)


def _launch(client: Client, mission_id: str) -> uuid.UUID:
    script = "from kleinkram.action import out\n(out / 'copy.txt').write_text('an artifact')\n"
    (launched,) = client.runs.launch(ActionDefinition(name="copy", script=script), [mission_id])
    assert isinstance(launched, RunCreated), launched
    return launched.run.id


@contextmanager
def _runner(api: Api, token: str, folder: Path) -> Iterator[None]:
    """Run a runner in this process."""
    folder.mkdir()
    share = MachineShare(cores=2, memory_bytes=8 * 10**9, disk_bytes=50 * 10**9, cache_bytes=10**9)
    executor = ProcessExecutor(Machine(folder, share, parse_index("off")))
    runner = Runner(RunnerOptions(api.url, token, "a-runner"), StateDirectory(folder), executor)
    thread = threading.Thread(target=runner.run)
    thread.start()
    try:
        yield
    finally:
        runner.stop()
        thread.join(40)
        runner.close(kill=True)


def test_a_request_continues_the_trace_of_a_proxy_and_names_its_own(collector: OtlpCollector, traced_api: Api) -> None:
    api, trace_id = traced_api, uuid.uuid4().hex
    answer = api.call("GET", "/projects", headers={"traceparent": f"00-{trace_id}-00f067aa0ba902b7-01"})
    for invalid in ("", "00-xyz", f"00-{'0' * 32}-00f067aa0ba902b7-01", "00-" + "f" * 5000):
        other = api.call("GET", "/projects", headers={"traceparent": invalid})
        assert other.headers["traceresponse"].split("-")[1] != trace_id
    unsampled = uuid.uuid4().hex
    api.call("GET", "/projects", headers={"traceparent": f"00-{unsampled}-00f067aa0ba902b7-00"})
    traces.stop()
    spans = collector.named("GET /api/v1/projects")
    assert len(spans) == 5
    assert (spans[0].trace_id, spans[0].parent_id) == (trace_id, "00f067aa0ba902b7")
    assert answer.headers["traceresponse"] == f"00-{trace_id}-{spans[0].span_id}-01"
    assert len({span.trace_id for span in spans}) == 5


def test_of_reads_that_belong_to_no_trace_one_in_ten_is_a_span(collector: OtlpCollector, traced_api: Api) -> None:
    answers = [traced_api.get("/projects") for _ in range(20)]
    traces.stop()
    assert len(collector.named("GET /api/v1/projects")) == 2
    assert sum("traceresponse" in answer.headers for answer in answers) == 2


def test_a_refused_request_is_a_span_without_its_query_and_long_parts(
    collector: OtlpCollector, traced_api: Api
) -> None:
    pasted = "klein_pat_" + "s" * 40
    traced_api.call("GET", f"/missions/{pasted}", query={"code": pasted}).refused(422, "invalid_request")
    traces.stop()
    (span,) = collector.named("GET /api/v1/missions/{mission_id}")
    assert span.attributes["url.path"] == "/api/v1/missions/klein_pa…"
    assert span.attributes["http.response.status_code"] == 422
    assert pasted.encode() not in b"".join(collector.bodies)


def test_packages_that_use_the_global_provider_export_nothing(collector: OtlpCollector, traced_api: Api) -> None:
    from opentelemetry import trace

    with trace.get_tracer("another").start_as_current_span("of another package"):
        traced_api.get("/projects", {"text": "secret words"}).ok()
    traces.stop()
    assert {span.name for span in collector.spans} == {"GET /api/v1/projects"}
    assert b"secret words" not in b"".join(collector.bodies)


_OWN_PROVIDER = """
import sys
from opentelemetry import trace
from opentelemetry.sdk.trace import TracerProvider
from opentelemetry.sdk.trace.export import SimpleSpanProcessor
from opentelemetry.sdk.trace.export.in_memory_span_exporter import InMemorySpanExporter
import kleinkram
from kleinkram import traces

kept = InMemorySpanExporter()
trace.set_tracer_provider(TracerProvider())
trace.get_tracer_provider().add_span_processor(SimpleSpanProcessor(kept))
traces.start("recorder")
with trace.get_tracer("recorder").start_as_current_span("drive"), kleinkram.connect(*sys.argv[1:3]) as client:
    client.upload(sys.argv[3], sys.argv[4])
print(*sorted({span.name for span in kept.get_finished_spans()}))
"""


def test_a_program_with_a_tracer_provider_gets_the_spans_of_the_sdk(api: Api, mission_id: str, tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("nothing")
    command = [sys.executable, "-c", _OWN_PROVIDER, api.url, str(api.token), str(tmp_path / "notes.txt"), mission_id]
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
    assert ran.stdout.split() == ["GET", "POST", "PUT", "drive", "upload"]


def test_a_command_says_nothing_of_a_collector_that_is_away(api: Api, tmp_path: Path) -> None:
    done = klein_at(api, tmp_path)("whoami", OTEL_EXPORTER_OTLP_ENDPOINT="http://127.0.0.1:9")
    assert done.stderr == ""


_IMPORTS = """
import sys
{code}
print(*sorted(name for name in sys.modules if name.startswith({prefixes})))
"""
_SERVER = "from kleinkram.server import __main__, app, worker; from kleinkram import traces; traces.start('x')"
_CLIENT = "from kleinkram.cli import main, transfer; from kleinkram import client, traces; traces.start('x')"


@pytest.mark.parametrize(
    ("code", "prefixes", "environment"),
    [
        # FastAPI itself imports the API of OpenTelemetry.
        (_SERVER, ("opentelemetry.sdk", "opentelemetry.exporter", "kleinkram.opentelemetry"), {}),
        (_CLIENT, ("opentelemetry", "kleinkram.opentelemetry"), {}),
        (_CLIENT, ("opentelemetry", "kleinkram.opentelemetry"), {"OTEL_SDK_DISABLED": "true"}),
        (_CLIENT, ("opentelemetry", "kleinkram.opentelemetry"), {"OTEL_TRACES_EXPORTER": "none"}),
    ],
)
def test_nothing_is_imported_unless_traces_are_on(
    code: str, prefixes: tuple[str, ...], environment: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    if environment:
        monkeypatch.setenv("OTEL_EXPORTER_OTLP_ENDPOINT", "http://127.0.0.1:9")
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    program = _IMPORTS.format(code=code, prefixes=prefixes)
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == ""


def test_an_api_without_traces_has_no_middleware_for_them(api: Api) -> None:
    assert [getattr(item.cls, "__name__", "") for item in api.app.user_middleware] == ["RequestMiddleware"]
    assert "traceresponse" not in api.get("/projects").headers
