"""systemd units: valid, hardened, and their processes work under the restrictions and report to systemd."""

import os
import re
import secrets
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path

import pytest
import urllib3

from kleinkram.standalone.address import is_free
from tests.integration.deploy.units import (
    FOLDER,
    NAMES,
    ROOT,
    Service,
    Unit,
    clean_environment,
    example_settings,
    load_unit,
    running,
)
from tests.integration.runner_loop.conftest import ended
from tests.integration.runner_loop.fake_http import RUNNER_TOKEN
from tests.integration.runner_loop.fake_server import FakeServer
from tests.integration.upload_client import wait_until
from tests.ports import choose_port
from tests.requirements import missing, need
from tests.services import RunningPostgres, RunningStore, fast_folder

pytestmark = pytest.mark.slow
# The exposure that `systemd-analyze security` may report. A runner is root: its unit says why.
_EXPOSURE = {"kleinkram-runner.service": 5.2}
_MAX_EXPOSURE = 3.0
_WATCHDOG_S = 0.4
_NOBODY = 65534
# Tries what units of a server must not do, and prints the errors.
_FORBIDDEN = """
import ctypes, errno, os, socket
libc = ctypes.CDLL(None, use_errno=True)
def unshare():
    if libc.unshare(0x10000000) != 0:
        raise OSError(ctypes.get_errno(), "unshare")
for attempt in (
    lambda: open("/var/lib/klein-elsewhere", "w"),
    lambda: socket.socket(socket.AF_PACKET),
    lambda: os.chroot("/"),
    lambda: os.setgroups([]),
    unshare,
):
    try:
        attempt()
        print("allowed")
    except OSError as error:
        print(errno.errorcode[error.errno])
"""


@dataclass(frozen=True)
class Host:
    """A machine with the settings of a server, in a folder that units may not write to."""

    folder: Path
    settings: dict[str, str]

    @property
    def credentials(self) -> Path:
        """The folder of secrets."""
        return self.folder / "credentials"

    def environment(self, unit: Unit, **more: str) -> dict[str, str]:
        """Return the environment of the unit's process: its own, then of the environment files."""
        return {**clean_environment(), **unit.environment(self.credentials), **self.settings, **more}

    def restrict(self, unit: Unit, command: list[str], *writable: Path, uid: int = 0) -> list[str]:
        """Return the command with the unit's restrictions."""
        return unit.restrictions(shown=[self.folder, ROOT], writable=[*writable], uid=uid).command(*command)

    def run(self, name: str, *writable: Path, **more: str) -> str:
        """Run a oneshot unit; return what it logs."""
        unit = load_unit(name)
        environment, log = self.environment(unit, **more), ""
        for command in unit.commands(environment):
            words = self.restrict(unit, command, *writable)
            done = subprocess.run(words, env=environment, cwd=ROOT, check=False, capture_output=True, text=True)
            log += done.stdout + done.stderr
            assert done.returncode == 0, log
        return log


@pytest.fixture(scope="module")
def host(postgres: RunningPostgres, store: RunningStore) -> Iterator[Host]:
    if os.geteuid() != 0:
        missing("only root can apply the restrictions of a unit")
    need("systemd-analyze")
    database = postgres.create_database()
    with tempfile.TemporaryDirectory(prefix="klein-units-", dir=fast_folder()) as name:
        host = Host(Path(name), example_settings("kleinkram"))
        host.credentials.mkdir()
        urls = {"": postgres.serve_url(database), "MIGRATION_": postgres.migrate_url(database)}
        for prefix, url in urls.items():
            user, password, rest = re.fullmatch(r"(postgresql://\w+):(\w+)(@.*)", url).groups()  # type: ignore[union-attr]  # it matches
            host.settings[f"KLEINKRAM_{prefix}DATABASE_URL"] = user + rest
            (host.credentials / f"{prefix.lower().replace('_', '-')}database-password").write_text(f"{password}\n")
        (host.credentials / "s3-secret-key").write_text(f"{store.secret_key}\n")
        (host.credentials / "runner-token").write_text(RUNNER_TOKEN)
        (host.credentials / "runner-token").chmod(0o400)
        host.settings.update(
            KLEINKRAM_PUBLIC_URL="http://kleinkram.lab.example",  # as the store, which has no certificate here
            KLEINKRAM_S3_INTERNAL_URL=store.endpoint,
            KLEINKRAM_S3_PUBLIC_URL=store.endpoint,
            KLEINKRAM_S3_ACCESS_KEY=store.access_key,
            KLEINKRAM_S3_BUCKET=store.create_bucket(),
            KLEINKRAM_STORE_FOLDER=name,
        )
        yield host
    postgres.drop_database(database)


@pytest.fixture(scope="module")
def migrated(host: Host) -> Host:
    host.run("kleinkram-migrate.service")
    return host


def test_systemd_understands_every_unit(tmp_path: Path) -> None:
    need("systemd-analyze")
    for path in FOLDER.iterdir():
        if path.suffix in {".service", ".timer", ".target"}:
            text = re.sub(r"/opt/kleinkram/bin/\w+", "/bin/true", path.read_text())
            (tmp_path / path.name.replace("@", "@1000")).write_text(text)
    units = [str(path) for path in tmp_path.iterdir()]
    done = subprocess.run(["systemd-analyze", "verify", *units], check=False, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


def test_units_are_hardened() -> None:
    need("systemd-analyze")
    for name in NAMES:
        command = ["systemd-analyze", "security", "--offline=true", str(FOLDER / name)]
        done = subprocess.run(command, check=False, capture_output=True, text=True)
        exposure = float(re.findall(r"Overall exposure level for .*: (\d+\.\d)", done.stdout)[0])
        assert exposure <= _EXPOSURE.get(name, _MAX_EXPOSURE), f"{name}\n{done.stdout}"


def test_accounts_and_folders_are_described() -> None:
    need("systemd-sysusers", "systemd-tmpfiles")
    done = subprocess.run(
        ["systemd-sysusers", "--dry-run", str(FOLDER / "kleinkram.sysusers")],
        check=True,
        capture_output=True,
        text=True,
    )
    assert "kleinkram" in done.stdout + done.stderr
    with tempfile.TemporaryDirectory() as root:
        command = ["systemd-tmpfiles", f"--root={root}", "--create", str(FOLDER / "kleinkram.tmpfiles")]
        (Path(root) / "etc").mkdir()
        shutil.copy("/etc/passwd", Path(root) / "etc")
        shutil.copy("/etc/group", Path(root) / "etc")
        subprocess.run(command, check=True)
        assert (Path(root) / "etc/kleinkram/credentials").stat().st_mode & 0o777 == 0o700


def test_the_check_finds_no_problem_and_reads_a_recording_in_a_child(migrated: Host) -> None:
    assert "It reads a recording within its limits." in migrated.run("kleinkram-check.service")


def test_the_api_reports_to_systemd_and_stops_on_request(migrated: Host) -> None:
    # The unit's metrics port is 10,000 higher: one of those that only this worker chooses.
    port = next(port for number in iter(choose_port, None) if (port := number - 10_000) >= 1024 and is_free(port))
    unit = load_unit(f"kleinkram-api@{port}.service")
    with _running(migrated, unit) as service:
        service.wait_for("READY=1")
        _is_alive_until_stopped(service)
        assert urllib3.request("GET", f"http://127.0.0.1:{port}/health/ready").status == 200
        metrics = urllib3.request("GET", f"http://127.0.0.1:1{port}/metrics").data
        assert b"kleinkram_blobs" in metrics
        assert service.stop() in {0, -signal.SIGTERM}  # both mean success to systemd
        assert "STOPPING=1" in service.messages + _remaining(service)


def test_a_worker_reports_to_systemd_and_stops_on_request(migrated: Host) -> None:
    number = next(number for number in range(1, 10) if is_free(19_000 + number))  # of its metrics port
    with _running(migrated, load_unit(f"kleinkram-worker@{number}.service")) as service:
        service.wait_for("READY=1")
        _is_alive_until_stopped(service)
        assert service.stop() == 0
        assert "STOPPING=1" in service.messages + _remaining(service)


def test_a_backup_is_made_verified_and_pruned(migrated: Host) -> None:
    location = migrated.folder / "backups"
    location.mkdir()
    variables = {**example_settings("backup"), "BACKUP_LOCATION": str(location), "BACKUP_KEEP": "1"}
    migrated.run("kleinkram-backup.service", location, **variables)
    assert [*location.iterdir()]


def test_the_restrictions_of_these_tests_are_in_force(host: Host) -> None:
    unit = load_unit("kleinkram-worker@1.service")
    command = host.restrict(unit, [sys.executable, "-c", _FORBIDDEN])
    done = subprocess.run(command, cwd=ROOT, env=clean_environment(), check=True, capture_output=True, text=True)
    assert done.stdout.split() == ["EROFS", "EAFNOSUPPORT", "EPERM", "EPERM", "EPERM"]


def test_a_runner_executes_a_run_and_reports_to_systemd(host: Host, server: FakeServer) -> None:
    unit = load_unit("kleinkram-runner.service")
    state = host.folder / "runner"
    state.mkdir()
    options = {"STATE_DIRECTORY": str(state), "RUNNER_SERVER": server.url}
    options |= {"RUNNER_OPTIONS": "--executor process --cores 2 --memory 1GB --disk 1GB"}
    with _running(host, unit, state, **options) as service:
        service.wait_for("READY=1")
        _is_alive_until_stopped(service)
        run = server.launch("import os; print(os.getuid())")
        assert ended(run).finishes[0].exit_code == 0, service.log.read_text()
        assert service.stop() == 0
        assert "STOPPING=1" in service.messages + _remaining(service)


def test_klein_up_runs_as_an_account_of_its_own_with_sandboxes_for_scripts(host: Host) -> None:
    unit = load_unit("kleinkram-up.service")
    state = host.folder / "up"
    state.mkdir()
    os.chown(state, _NOBODY, _NOBODY)
    host.folder.chmod(0o755)
    ports = f"--port {choose_port()} --s3-port {choose_port()}"
    environment = {**clean_environment(), **unit.environment(host.credentials), "HOME": str(state)}
    environment |= {"STATE_DIRECTORY": str(state), "UP_OPTIONS": ports}
    folder = host.folder / "notify"
    folder.mkdir()
    folder.chmod(0o755)
    with running(
        unit, folder, environment, watchdog_s=4, restrict=lambda words: host.restrict(unit, words, state, uid=_NOBODY)
    ) as service:
        (folder / "notify").chmod(0o666)
        service.wait_for("READY=1")
        _is_alive_until_stopped(service)
        log = state / "logs" / "runner.log"
        wait_until(lambda: log.exists() and "ready" in log.read_text(), limit_s=60)
        assert "allows this user no namespaces" not in log.read_text()
        assert service.stop() == 0
        assert "STOPPING=1" in service.messages + _remaining(service)


def _running(host: Host, unit: Unit, *writable: Path, **more: str) -> AbstractContextManager[Service]:
    environment = host.environment(unit, **more)
    folder = host.folder / secrets.token_hex(4)
    folder.mkdir()
    return running(
        unit, folder, environment, watchdog_s=_WATCHDOG_S, restrict=lambda words: host.restrict(unit, words, *writable)
    )


def _is_alive_until_stopped(service: Service) -> None:
    """Check that it pings again and again. When, depends on the load of this machine."""
    service.wait_for("WATCHDOG=1", times=3)


def _remaining(service: Service) -> list[str]:
    """Return what else it has sent, without pings."""
    lines: list[str] = []
    while received := service.receive(timeout_s=0.1):
        lines += [line for line in received if line != "WATCHDOG=1"]
    return lines
