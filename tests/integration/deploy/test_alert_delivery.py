"""Alerts arrive: with the configurations of `deploy/observability`, a receiver is notified of a dead worker."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from kleinkram.server.settings import Settings, plain_dsn
from tests.integration.conftest import StartApi
from tests.integration.deploy import monitors
from tests.integration.upload_client import wait_until
from tests.ports import choose_port

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]
_LIMIT_S = 90  # a worker counts as dead after 30 s


@contextmanager
def _worker(settings: Settings, folder: Path, metrics_port: int) -> Iterator["subprocess.Popen[bytes]"]:
    environment = {
        **{name: value for name, value in os.environ.items() if not name.startswith("KLEINKRAM_")},
        "KLEINKRAM_DATABASE_URL": plain_dsn(settings.database_url),
        "KLEINKRAM_S3_INTERNAL_URL": settings.s3_internal_url,
        "KLEINKRAM_S3_ACCESS_KEY": settings.s3_access_key,
        "KLEINKRAM_S3_SECRET_KEY": settings.s3_secret_key.get_secret_value(),
        "KLEINKRAM_S3_BUCKET": settings.s3_bucket,
        "KLEINKRAM_SCRUB_HOURS": "0",
    }
    command = [sys.executable, "-m", "kleinkram.server", "worker", "--metrics-port", str(metrics_port)]
    with (folder / "worker.log").open("ab") as log:
        process = subprocess.Popen(command, env=environment, stderr=log)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def test_a_dead_worker_is_reported_and_its_successor_resolves_the_alert(start_api: StartApi, tmp_path: Path) -> None:
    api, port = start_api(), choose_port()
    settings: Settings = api.app.state.settings
    targets = {"api": [api.app.state.metrics_port], "worker": [port]}
    with (
        monitors.receiving() as receiver,
        monitors.alertmanager(tmp_path, receiver) as address,
        monitors.prometheus(tmp_path, targets, alertmanager=address) as prometheus,
    ):
        with _worker(settings, tmp_path, port) as worker:
            wait_until(lambda: _value(prometheus, "max(kleinkram_workers)") == 1, limit_s=_LIMIT_S)
            receiver.alerts.clear()  # until then, there was none
            worker.kill()
            alert = receiver.wait_for("KleinkramNoWorker", "firing", limit_s=_LIMIT_S)
            assert alert["labels"]["severity"] == "critical"
            assert alert["annotations"]["runbook"] == "docs/alerts.md#kleinkramnoworker"
            down = receiver.wait_for("KleinkramProcessDown", "firing", limit_s=_LIMIT_S)
            assert down["labels"]["instance"] == f"127.0.0.1:{port}"
        before = [*receiver.alerts]
        receiver.alerts.clear()  # the alert from before the first worker may have been resolved late
        with _worker(settings, tmp_path, port):
            receiver.wait_for("KleinkramNoWorker", "resolved", limit_s=_LIMIT_S)
        alerts = [*before, *receiver.alerts]
        firing = {alert["labels"]["alertname"] for alert in alerts if alert["status"] == "firing"}
        assert not firing & {"KleinkramApiDown", "KleinkramDatabaseUnavailable"}


def _value(prometheus: monitors.Prometheus, expression: str) -> float | None:
    series = prometheus.query(expression)
    return float(series[0]["value"][1]) if series else None
