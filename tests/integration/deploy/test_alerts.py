"""Alerts: Prometheus understands the rules, each alert fires when it should, and arrives at a receiver."""

import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from tests.integration.deploy.alert_cases import CASES, AlertCase
from tests.integration.deploy.monitors import FOLDER, RULES, alert_rules, save_yaml
from tests.requirements import need, path_of

pytestmark = pytest.mark.slow

# Prometheus evaluates all rules at each step. Those that judge days are not evaluated each minute of them.
_LONG_MINUTES, _LONG_STEP = 200, "10m"


def _check(*command: object) -> None:
    words = [str(path_of(str(command[0]))), *map(str, command[1:])]
    done = subprocess.run(words, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


def test_prometheus_and_alertmanager_understand_their_configurations() -> None:
    need("promtool", "amtool")
    _check("promtool", "check", "config", FOLDER / "prometheus" / "prometheus.yml")
    _check("amtool", "check-config", FOLDER / "alertmanager.yml")


def test_each_alert_fires_when_it_should_and_only_then(tmp_path: Path) -> None:
    need("promtool")
    assert {case.alert for case in CASES} == {rule["alert"] for rule in alert_rules()}
    for step, is_long in (("1m", False), (_LONG_STEP, True)):
        tests = [test for case in CASES if (case.minutes > _LONG_MINUTES) is is_long for test in _tests_of(case)]
        path = tmp_path / f"tests-{step}.yml"
        save_yaml(path, {"rule_files": [str(RULES)], "evaluation_interval": step, "tests": tests})
        _check("promtool", "test", "rules", path)


def _tests_of(case: AlertCase) -> list[dict[str, Any]]:
    annotations = {"summary": case.summary, "runbook": f"docs/alerts.md#{case.alert.lower()}"}
    expected = [{"exp_labels": dict(labels), "exp_annotations": annotations} for labels in case.labels]
    return [_test(case, case.firing, expected), _test(case, case.quiet, [])]


def _test(case: AlertCase, series: Mapping[str, str], expected: list[dict[str, Any]]) -> dict[str, Any]:
    values = [{"series": name, "values": f"{value}x{case.minutes}"} for name, value in series.items()]
    evaluation = {"eval_time": f"{case.minutes}m", "alertname": case.alert, "exp_alerts": expected}
    return {"interval": "1m", "input_series": values, "alert_rule_test": [evaluation]}
