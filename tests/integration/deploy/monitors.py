"""Prometheus and Alertmanager with the configurations of `deploy/observability`, and a receiver of notifications."""

import json
import subprocess
import urllib.parse
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import urllib3
from ruamel.yaml import YAML

from tests.http_server import QuietHandler, serving
from tests.integration.upload_client import wait_until
from tests.ports import choose_port
from tests.requirements import need, path_of

FOLDER = Path(__file__).parents[3] / "deploy" / "observability"
RULES = FOLDER / "prometheus" / "rules.yml"
_TIMEOUT_S = 60


def load_yaml(path: Path) -> Any:
    """Return the document of a YAML file."""
    return YAML(typ="safe").load(path)


def save_yaml(path: Path, document: object) -> None:
    """Write a document as YAML."""
    writer = YAML(typ="safe")
    writer.default_flow_style = False
    writer.dump(document, path)


def alert_rules() -> list[dict[str, Any]]:
    """Return the alerts of the rules file."""
    return [rule for group in load_yaml(RULES)["groups"] for rule in group["rules"] if "alert" in rule]


@dataclass(frozen=True)
class Prometheus:
    """A running Prometheus."""

    url: str

    def query(self, expression: str) -> list[dict[str, Any]]:
        """Return the series of an instant query."""
        return self._get("query", query=expression)

    def query_range(self, expression: str, *, start: float, end: float, step_s: float) -> list[dict[str, Any]]:
        """Return the series of a range query, as a panel asks for them."""
        return self._get("query_range", query=expression, start=str(start), end=str(end), step=str(step_s))

    def _get(self, page: str, **parameters: str) -> list[dict[str, Any]]:
        url = f"{self.url}/api/v1/{page}?{urllib.parse.urlencode(parameters)}"
        answer = json.loads(urllib3.request("GET", url, timeout=_TIMEOUT_S).data)
        assert answer["status"] == "success", f"{parameters['query']}: {answer.get('error')}"
        series: list[dict[str, Any]] = answer["data"]["result"]
        return series


@dataclass
class Receiver:
    """The alerts of all notifications that have arrived, in order."""

    url: str = ""
    alerts: list[dict[str, Any]] = field(default_factory=list)

    def wait_for(self, name: str, status: str, *, limit_s: float) -> dict[str, Any]:
        """Wait for a notification of an alert; return the alert."""
        wait_until(lambda: self._find(name, status) is not None, limit_s=limit_s)
        alert = self._find(name, status)
        assert alert is not None
        return alert

    def _find(self, name: str, status: str) -> dict[str, Any] | None:
        matching = (a for a in self.alerts if (a["labels"]["alertname"], a["status"]) == (name, status))
        return next(matching, None)


@contextmanager
def receiving(address: str = "127.0.0.1") -> Iterator[Receiver]:
    """Receive the webhooks of an Alertmanager at an address of this machine."""
    receiver = Receiver()

    class Handler(QuietHandler):
        def do_POST(self) -> None:
            receiver.alerts += json.loads(self.body())["alerts"]
            self.send(200)

    with serving(Handler, address) as port:
        receiver.url = f"http://{address}:{port}/"
        yield receiver


@contextmanager
def prometheus(
    folder: Path, targets: Mapping[str, Sequence[int]], *, alertmanager: str | None = None
) -> Iterator[Prometheus]:
    """Run Prometheus with the shipped configuration, at one scrape per second.

    Args:
        folder: an empty folder.
        targets: the ports to scrape, for each job `kleinkram-...` by the rest of its name.
        alertmanager: its address. With one, alerts fire after 5 s instead of minutes.
    """
    need("prometheus")
    config = load_yaml(FOLDER / "prometheus" / "prometheus.yml")
    config["global"] = {"scrape_interval": "1s", "evaluation_interval": "1s"}
    config["scrape_configs"] = [job for job in config["scrape_configs"] if job["job_name"].startswith("kleinkram-")]
    managers = [] if alertmanager is None else [{"static_configs": [{"targets": [alertmanager]}]}]
    config["alerting"]["alertmanagers"] = managers
    rules = load_yaml(RULES)
    if alertmanager is not None:
        for rule in (rule for group in rules["groups"] for rule in group["rules"] if "for" in rule):
            rule["for"] = "5s"
    save_yaml(folder / "prometheus.yml", config)
    save_yaml(folder / "rules.yml", rules)
    (folder / "targets").mkdir()
    for name, ports in targets.items():
        addresses = [f"127.0.0.1:{port}" for port in ports]
        save_yaml(folder / "targets" / f"{name}.yml", [{"targets": addresses}])
    port = choose_port()
    options = {
        "config.file": folder / "prometheus.yml",
        "storage.tsdb.path": folder / "data",
        "web.listen-address": f"127.0.0.1:{port}",
    }
    with _running("prometheus", options, folder, f"http://127.0.0.1:{port}") as url:
        yield Prometheus(url)


def alertmanager_config(receiver: Receiver) -> dict[str, Any]:
    """Return the shipped configuration with this receiver, and without pauses."""
    config: dict[str, Any] = load_yaml(FOLDER / "alertmanager.yml")
    del config["global"]
    for route in (config["route"], *config["route"]["routes"]):
        route["group_wait"] = "0s"
    config["route"]["group_interval"] = "1s"
    webhook = {"url": receiver.url, "send_resolved": True}
    config["receivers"] = [{"name": it["name"], "webhook_configs": [webhook]} for it in config["receivers"]]
    return config


@contextmanager
def alertmanager(folder: Path, receiver: Receiver) -> Iterator[str]:
    """Run Alertmanager with the shipped routes, without their pauses; yields its address."""
    need("prometheus-alertmanager")
    save_yaml(folder / "alertmanager.yml", alertmanager_config(receiver))
    address = f"127.0.0.1:{choose_port()}"
    options = {
        "config.file": folder / "alertmanager.yml",
        "storage.path": folder / "alerts",
        "web.listen-address": address,
        "cluster.listen-address": "",
    }
    with _running("prometheus-alertmanager", options, folder, f"http://{address}"):
        yield address


@contextmanager
def _running(program: str, options: Mapping[str, object], folder: Path, url: str) -> Iterator[str]:
    log = folder / f"{program}.log"
    command = [str(path_of(program)), *(f"--{name}={value}" for name, value in options.items())]
    with log.open("wb") as output:
        process = subprocess.Popen(command, stdout=output, stderr=output, cwd=folder)
    try:
        wait_until(lambda: _is_ready(url, process, log), limit_s=_TIMEOUT_S)
        yield url
    finally:
        process.terminate()
        process.wait(_TIMEOUT_S)


def _is_ready(url: str, process: "subprocess.Popen[bytes]", log: Path) -> bool:
    assert process.poll() is None, log.read_text()
    try:
        return urllib3.request("GET", f"{url}/-/ready", retries=False, timeout=5).status == 200
    except urllib3.exceptions.HTTPError:
        return False
