"""Which collector the environment names, what is wrong with it, and spans of a process without traces."""

import pytest

from kleinkram import traces


@pytest.fixture(autouse=True)
def _no_variables(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in (
        *("OTEL_EXPORTER_OTLP_ENDPOINT", "OTEL_EXPORTER_OTLP_TRACES_ENDPOINT", "OTEL_SDK_DISABLED"),
        *("OTEL_TRACES_EXPORTER", "OTEL_EXPORTER_OTLP_PROTOCOL", "OTEL_EXPORTER_OTLP_TRACES_PROTOCOL"),
    ):
        monkeypatch.delenv(name, raising=False)


@pytest.mark.parametrize(
    ("variables", "endpoint"),
    [
        ({}, None),
        ({"OTEL_EXPORTER_OTLP_ENDPOINT": " "}, None),
        ({"OTEL_EXPORTER_OTLP_ENDPOINT": "http://a:4318"}, "http://a:4318/v1/traces"),
        ({"OTEL_EXPORTER_OTLP_ENDPOINT": "http://a:4318/"}, "http://a:4318/v1/traces"),
        (
            {"OTEL_EXPORTER_OTLP_ENDPOINT": "http://a", "OTEL_EXPORTER_OTLP_TRACES_ENDPOINT": "http://b/in"},
            "http://b/in",
        ),
        ({"OTEL_EXPORTER_OTLP_ENDPOINT": "http://a", "OTEL_SDK_DISABLED": "True"}, None),
        ({"OTEL_EXPORTER_OTLP_ENDPOINT": "http://a", "OTEL_TRACES_EXPORTER": "none"}, None),
    ],
)
def test_the_endpoint_is_what_the_variables_of_opentelemetry_say(
    variables: dict[str, str], endpoint: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    assert traces.endpoint() == endpoint


@pytest.mark.parametrize(
    ("variables", "words"),
    [
        ({"OTEL_EXPORTER_OTLP_ENDPOINT": "collector:4318"}, "begin with http://"),
        ({"OTEL_EXPORTER_OTLP_ENDPOINT": "http://a", "OTEL_EXPORTER_OTLP_PROTOCOL": "grpc"}, "'grpc'"),
    ],
)
def test_a_process_with_wrong_variables_says_so_and_has_no_traces(
    variables: dict[str, str], words: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    traces.start("test")
    assert not traces.is_on()
    assert words in caplog.messages[0]


def test_a_process_without_the_packages_says_how_to_install_them(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("OTEL_EXPORTER_OTLP_ENDPOINT", "http://a")
    monkeypatch.setattr(traces, "_PACKAGES", ("no_such_package.inner",))
    traces.start("test")
    assert not traces.is_on()
    assert "pip install 'open-kleinkram[otel]'" in caplog.messages[0]


def test_without_traces_spans_have_no_effect() -> None:
    with traces.span("one", {"a": 1}) as outer, traces.leaf_span("two") as inner:
        outer.set({"b": 2})
        outer.rename("three")
        inner.fail("Error")
        assert (outer.traceparent, inner.traceparent, traces.traceparent(), traces.trace_id()) == (None,) * 4
        assert not traces.is_active()
    traces.stop()


def test_an_error_passes_through_a_span() -> None:
    with pytest.raises(ZeroDivisionError), traces.span("one"):
        raise ZeroDivisionError
