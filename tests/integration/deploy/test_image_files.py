"""Dockerfiles and the Compose project: valid, and consistent with the server, `klein up` and each other."""

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from kleinkram.server.environment import known_variables
from kleinkram.standalone import object_store
from kleinkram.standalone.object_store import PORT_NAMES, StoreFolder
from kleinkram.standalone.processes import ChildCommand
from tests.integration.deploy.compose import initialise, prepare
from tests.integration.deploy.images import MONITORS, ROOT
from tests.integration.deploy.monitors import FOLDER, load_yaml
from tests.requirements import missing, need_compose

_DEPLOY = ROOT / "deploy"
_COMPOSE = _DEPLOY / "compose"
_DOCKERFILES = sorted((_DEPLOY / "images").glob("*/Dockerfile"))
_PROGRAMS = Path(sys.executable).parent
# Flags that name folders, ports and sockets, or that differ because the store is reached from other containers.
_OWN_FLAGS = re.compile(r"-(dir|ip\.bind|.+\.port(\.grpc)?|s3\.config|.+\.localSocket|filer\.filerGroup)=")


@pytest.fixture(scope="module")
def compose() -> Any:
    return YAML(typ="safe").load(_COMPOSE / "compose.yaml")


@pytest.mark.parametrize("path", _DOCKERFILES, ids=lambda path: path.parent.name)
def test_hadolint_finds_nothing(path: Path) -> None:
    done = subprocess.run([str(_PROGRAMS / "hadolint"), str(path)], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "")


def test_the_project_follows_the_compose_specification() -> None:
    schema = "vendor.compose-spec"
    command = [str(_PROGRAMS / "check-jsonschema"), "--builtin-schema", schema, str(_COMPOSE / "compose.yaml")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


def test_variables_are_those_of_the_example() -> None:
    used = set(re.findall(r"\$\{([A-Z_]+)", (_COMPOSE / "compose.yaml").read_text()))
    described = set(re.findall(r"^([A-Z_]+)=", (_COMPOSE / ".env.example").read_text(), re.MULTILINE))
    assert used - {"BACKUP_LOCATION"} == described - {"COMPOSE_PROFILES"}


def test_files_that_are_mounted_exist(compose: Any) -> None:
    text = (_COMPOSE / "compose.yaml").read_text()
    sources = re.findall(r"- (\.\.?/[^:\s]+):", text)
    assert len(sources) > 5
    written_by_init = {"./alertmanager.yml", "./tls", "./backups"}
    assert not [source for source in sources if source not in written_by_init and not (_COMPOSE / source).exists()]


@pytest.mark.slow  # make test installs no programs
def test_docker_compose_renders_the_project_with_its_profile(tmp_path: Path) -> None:
    folder = prepare(tmp_path)
    (folder / ".env").write_text((folder / ".env.example").read_text())
    (folder / "settings.env").touch()
    command = [need_compose(), "--profile", "observability", "config", "--services"]
    environment = {"PATH": os.environ["PATH"], "HOME": str(tmp_path)}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.stderr == ""
    assert {*MONITORS} < {*done.stdout.split()}


def test_addresses_of_the_profile_agree(compose: Any) -> None:
    services = compose["services"]
    flags = {name: " ".join(service.get("command", [])) for name, service in services.items()}
    config = load_yaml(FOLDER / "prometheus" / "prometheus.yml")
    (manager,) = config["alerting"]["alertmanagers"][0]["static_configs"][0]["targets"]
    assert f"--web.listen-address={manager}" in flags["alertmanager"]
    probes = next(job for job in config["scrape_configs"] if job["job_name"] == "kleinkram-public")
    assert f"--web.listen-address={probes['relabel_configs'][-1]['replacement']}" in flags["blackbox"]
    (node,) = load_yaml(_COMPOSE / "targets" / "node.yml")[0]["targets"]
    assert f"--web.listen-address={node}" in flags["node"]
    patterns = [pattern for job in config["scrape_configs"] for it in job["file_sd_configs"] for pattern in it["files"]]
    for path in (_COMPOSE / "targets").glob("*.yml"):
        assert any(path.match(pattern) for pattern in patterns), path
    for kind in ("api", "worker"):
        hosts = {target.split(":")[0] for target in load_yaml(_COMPOSE / "targets" / f"{kind}.yml")[0]["targets"]}
        assert hosts == {name for name in services if name.startswith(kind)}
    dashboards = load_yaml(FOLDER / "grafana" / "provisioning" / "dashboards" / "kleinkram.yaml")
    path = dashboards["providers"][0]["options"]["path"]
    assert f"../observability/grafana/dashboards:{path}:ro" in services["grafana"]["volumes"]
    for monitor in MONITORS:
        assert services[monitor]["network_mode"] == "service:watch"


def test_alloy_sends_what_it_sends_without_containers() -> None:
    """Logs and traces have the same labels, fields and addresses; only their sources differ."""
    ours, theirs = ((folder / "config.alloy").read_text() for folder in (_COMPOSE, FOLDER))
    shared = 'loki.process "kleinkram" {', 'otelcol.processor.batch "traces" {'
    for head in shared:
        assert ours[ours.index(head) :].split("\n}\n")[0] == theirs[theirs.index(head) :].split("\n}\n")[0]
    assert {*re.findall(r"127\.0\.0\.1:\d+", ours)} == {*re.findall(r"127\.0\.0\.1:\d+", theirs)} - {"127.0.0.1:4318"}


def test_settings_are_known_and_secrets_are_files(compose: Any) -> None:
    for name in ("bucket", "migrate", "api-1", "api-2", "worker", "backup"):
        service = compose["services"][name]
        variables = {key for key in service["environment"] if key.startswith("KLEINKRAM_")}
        assert variables <= {*known_variables()}
        files = {value.removeprefix("/run/secrets/") for key, value in service["environment"].items() if "_FILE" in key}
        assert files == set(service["secrets"])


def test_services_are_hardened(compose: Any) -> None:
    for service in compose["services"].values():
        assert (service["read_only"], service["cap_drop"]) == (True, ["ALL"])
        assert service["security_opt"] == ["no-new-privileges:true"]


def test_the_store_has_the_flags_of_klein_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    commands: list[ChildCommand] = []
    monkeypatch.setattr(object_store, "spawn", commands.append)
    ports = {name: number for number, name in enumerate(PORT_NAMES, 10_000)} | {"s3": 8333}
    object_store.start(StoreFolder(Path("weed"), tmp_path, tmp_path, tmp_path / "log", ports, "key", "secret"))
    text = (_COMPOSE / "start-store").read_text().replace("\\\n", " ")
    words = re.search(r"exec (weed .*)", text)
    assert words is not None
    flags = {word for word in words[1].replace('"', "").split() if not _OWN_FLAGS.match(word)}
    expected = {word for word in commands[0].arguments if not _OWN_FLAGS.match(word)}
    assert flags - {"cat", "filer-group)"} == expected


def test_init_writes_what_is_missing_and_keeps_the_rest(tmp_path: Path) -> None:
    if os.geteuid() != 0:
        missing("only root can make the folder of backups for another user")
    folder = prepare(tmp_path)
    initialise(folder, "data.robots.example")
    assert "SITE=data.robots.example\nPUBLIC_URL=https://data.robots.example\n" in (folder / ".env").read_text()
    assert "https://data.robots.example/health/ready" in (folder / "targets" / "public.yml").read_text()
    secrets = {path.name: path.read_text() for path in (folder / "secrets").iterdir()}
    assert len({*secrets.values()}) == 7
    assert secrets["s3-secret-key"] in secrets["store-identities.json"]
    assert oct((folder / "secrets").stat().st_mode & 0o777) == "0o700", "only root reads the files in it"
    assert oct((folder / "settings.env").stat().st_mode & 0o777) == "0o600", "it may have secrets"
    (folder / "secrets" / "postgres-password").write_text("mine")
    initialise(folder, "other.example")
    assert (folder / "secrets" / "postgres-password").read_text() == "mine"
    assert "SITE=data.robots.example" in (folder / ".env").read_text()


@pytest.mark.parametrize("name", ["", "a b", "x/y", "a&b"])
def test_init_refuses_what_is_no_name(tmp_path: Path, name: str) -> None:
    folder = prepare(tmp_path)
    done = subprocess.run([folder / "init", name], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr.startswith("usage: ./init NAME")) == (2, True)
    assert not (folder / ".env").exists()
