"""The files of `deploy/observability` belong together: addresses, ids, labels, runbooks."""

import json
import logging
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from kleinkram.json_logs import JsonLines
from kleinkram.metric_definitions import DEFINITIONS
from tests.integration.deploy.monitors import FOLDER, RULES, alert_rules, load_yaml

_ROOT = Path(__file__).parents[3]
_DASHBOARDS = sorted((FOLDER / "grafana" / "dashboards").glob("*.json"))
_ALLOY = (FOLDER / "config.alloy").read_text()
_SELECTOR = re.compile(r"\b(?P<name>kleinkram_\w+)(?:\{(?P<labels>[^{}]*)\})?")
_TRACE_ID, _REQUEST_ID = "4bf92f3577b34da6a3ce929d0e0e4736", "0f4c-12"


def _datasources() -> dict[str, dict[str, Any]]:
    document = load_yaml(FOLDER / "grafana" / "provisioning" / "datasources" / "kleinkram.yaml")
    return {source["uid"]: source for source in document["datasources"]}


def _panels(page: Path) -> Iterator[dict[str, Any]]:
    yield from (panel for panel in json.loads(page.read_text())["panels"] if panel["type"] != "row")


def test_each_alert_has_a_severity_a_sentence_and_a_runbook() -> None:
    page = (_ROOT / "docs" / "alerts.md").read_text()
    sections = re.findall(r"^### (\w+)\n\n\*(.+?)\*", page, re.MULTILINE)
    severities: dict[str, set[str]] = {}
    for rule in alert_rules():
        severities.setdefault(rule["alert"], set()).add(rule["labels"]["severity"])
        assert set(rule["annotations"]) == {"summary", "runbook"}, rule["alert"]
        assert rule["annotations"]["runbook"] == f"docs/alerts.md#{rule['alert'].lower()}"
        assert rule["annotations"]["summary"].endswith("."), rule["alert"]
    assert [name for name, _ in sections] == [*severities]
    for name, severity in sections:
        assert severity.rstrip(".") in severities[name] <= {"critical", "warning"}, name


def test_alerts_that_are_named_elsewhere_exist() -> None:
    names = {rule["alert"] for rule in alert_rules()}
    texts = (FOLDER / "alertmanager.yml").read_text(), (_ROOT / "docs" / "observability.md").read_text()
    assert not {name for text in texts for name in re.findall(r"\bKleinkram[A-Z]\w+", text)} - names


@pytest.mark.parametrize("page", _DASHBOARDS, ids=lambda page: page.stem)
def test_each_panel_says_what_it_shows(page: Path) -> None:
    document = json.loads(page.read_text())
    assert document["uid"] == f"kleinkram-{page.stem}"
    kinds = {variable["name"] for variable in document["templating"]["list"]}
    for panel in _panels(page):
        assert panel["title"], panel["id"]
        assert panel["description"].endswith("."), panel["title"]
        assert panel["datasource"]["uid"] == f"${{{panel['datasource']['type']}}}"
        assert panel["datasource"]["type"] in kinds
        assert all(target.get("expr") or target.get("query") for target in panel["targets"]), panel["title"]


def test_all_dashboards_are_there() -> None:
    assert {page.stem for page in _DASHBOARDS} == {"overview", "storage", "ingest", "runs", "api", "database"}


def test_links_between_data_sources_lead_to_data_sources() -> None:
    sources = _datasources()
    uids = re.findall(r"datasourceUid: (\S+)", _text("grafana", "provisioning", "datasources", "kleinkram.yaml"))
    assert {*uids} == {*sources}
    assert {source["type"] for source in sources.values()} == {"prometheus", "loki", "tempo"}


def test_a_log_line_leads_to_its_trace_and_to_its_request() -> None:
    record = logging.LogRecord("kleinkram.request", logging.INFO, "", 0, "GET /", None, None)
    record.fields = {"request_id": _REQUEST_ID, "trace_id": _TRACE_ID}
    line = JsonLines("api").format(record)
    ids = {}
    for field in _datasources()["kleinkram-loki"]["jsonData"]["derivedFields"]:
        match = re.search(field["matcherRegex"], line)
        assert match is not None, field["name"]
        ids[field["name"]] = match[1]
    assert ids == {"trace": _TRACE_ID, "request": _REQUEST_ID}


def test_addresses_agree() -> None:
    sources, loki, tempo = _datasources(), load_yaml(FOLDER / "loki.yaml"), load_yaml(FOLDER / "tempo.yaml")
    loki_url = f"http://127.0.0.1:{loki['server']['http_listen_port']}"
    assert sources["kleinkram-loki"]["url"] == loki_url
    assert f'"{loki_url}"' in _ALLOY
    assert sources["kleinkram-tempo"]["url"] == f"http://127.0.0.1:{tempo['server']['http_listen_port']}"
    assert f'"{tempo["distributor"]["receivers"]["otlp"]["protocols"]["grpc"]["endpoint"]}"' in _ALLOY
    prometheus = _text("prometheus", "prometheus.yml")
    assert f"--web.listen-address={sources['kleinkram-prometheus']['url'].removeprefix('http://')}" in prometheus
    listeners = [loki["server"]["grpc_listen_port"], tempo["server"]["grpc_listen_port"], 4318, 14317, 3100, 3200]
    assert len(listeners) == len(set(listeners))


def test_each_process_of_the_units_is_scraped() -> None:
    config = load_yaml(FOLDER / "prometheus" / "prometheus.yml")
    files = {pattern for job in config["scrape_configs"] for it in job["file_sd_configs"] for pattern in it["files"]}
    for path in (FOLDER / "prometheus" / "targets").iterdir():
        assert any(path.match(pattern) for pattern in files), path
        assert isinstance(load_yaml(path), list)
    units = _ROOT / "deploy" / "systemd"
    assert "--metrics-port 1%i" in (units / "kleinkram-api@.service").read_text()
    assert load_yaml(FOLDER / "prometheus" / "targets" / "api.yml")[0]["targets"][0] == "127.0.0.1:18000"


def _expressions() -> Iterator[str]:
    for rule in (rule for group in load_yaml(RULES)["groups"] for rule in group["rules"]):
        yield rule["expr"]
    for query in _datasources()["kleinkram-tempo"]["jsonData"]["tracesToMetrics"]["queries"]:
        yield query["query"]
    for page in _DASHBOARDS:
        for panel in _panels(page):
            yield from (it["expr"] for it in panel["targets"] if panel["datasource"]["type"] == "prometheus")


def test_queries_name_metrics_labels_and_values_that_exist() -> None:
    definitions = {definition.name: definition for definition in DEFINITIONS}
    named = [match for text in _expressions() for match in _SELECTOR.finditer(text)]
    assert len(named) > 100
    for match in named:
        histogram = re.sub("_(bucket|sum|count)$", "", match["name"])
        definition = definitions.get(match["name"]) or definitions[histogram]
        for label, value in re.findall(r'(\w+)[=!~]+"([^"]*)"', match["labels"] or ""):
            assert label in {*definition.labels, "job"}, match[0]
            if definition.values and label == definition.labels[-1]:
                assert {*value.split("|")} <= {*definition.values}, match[0]


def test_recorded_series_that_are_queried_exist() -> None:
    recorded = {rule["record"] for group in load_yaml(RULES)["groups"] for rule in group["rules"] if "record" in rule}
    assert {name for text in _expressions() for name in re.findall(r"kleinkram:[\w:]+", text)} <= recorded


def test_components_of_alloy_that_are_named_exist() -> None:
    assert _ALLOY.count("{") == _ALLOY.count("}")
    declared = {f"{kind}.{label}" for kind, label in re.findall(r'^([a-z_.]+) "(\w+)" \{', _ALLOY, re.MULTILINE)}
    named = re.findall(r"\b((?:loki|otelcol)(?:\.\w+)+)\.(?:receiver|rules|input)\b", _ALLOY)
    assert named
    assert {*named} <= declared
    # The stages that use a value, and the stage that reads it from the line.
    expressions = re.search(r"expressions = \{(.*?)\}", _ALLOY, re.DOTALL)
    assert expressions is not None
    read = set(re.findall(r'(\w+) += "', expressions[1]))
    used = {name for values in re.findall(r"values = \{(.*?)\}", _ALLOY) for name in re.findall(r"(\w+) =", values)}
    assert used | {"at"} == read


def _text(*path: str) -> str:
    return FOLDER.joinpath(*path).read_text()
