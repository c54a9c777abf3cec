"""`klein doctor`, and data directories that must not be changed."""

import os
import signal
from pathlib import Path

import pytest

from kleinkram import diagnostics
from kleinkram.diagnostics import find_problems
from kleinkram.standalone import doctor
from kleinkram.standalone.data_dir import DataDir
from kleinkram.standalone.supervisor import stop_instance
from tests.integration.standalone.conftest import Instance, wait_until


def _problems(instance: Instance) -> dict[str, str]:
    return {it.check: f"{it.message} {it.remedy}" for it in find_problems(doctor.examine(instance.data_dir))}


def test_a_running_instance_has_no_problems(shared_instance: Instance) -> None:
    shared_instance.up()
    assert _problems(shared_instance) == {}
    stop_instance(DataDir(shared_instance.data_dir))


def test_a_stopped_instance_is_reported(shared_instance: Instance) -> None:
    assert "klein up" in _problems(shared_instance)["running"]


def test_a_dead_api_and_an_unreachable_store_are_reported(shared_instance: Instance) -> None:
    process = shared_instance.up()
    services = shared_instance.runtime_info["services"]
    process.send_signal(signal.SIGSTOP)  # so that nothing starts them again
    for service in ("api", "store"):
        os.kill(services[service], signal.SIGKILL)
    wait_until(lambda: {"api", "store reachable"} <= _problems(shared_instance).keys())
    assert "nobody can upload or download" in _problems(shared_instance)["store reachable"]
    process.send_signal(signal.SIGCONT)
    wait_until(lambda: _problems(shared_instance) == {})
    stop_instance(DataDir(shared_instance.data_dir))


def test_files_readable_by_others_are_reported(shared_instance: Instance) -> None:
    token = shared_instance.data_dir / "owner-token"
    token.chmod(0o644)
    shared_instance.data_dir.chmod(0o755)
    problems = _problems(shared_instance)
    token.chmod(0o600)
    shared_instance.data_dir.chmod(0o700)
    assert f"chmod 600 {token}" in problems["owner token"]
    assert f"chmod 700 {shared_instance.data_dir}" in problems["data directory"]


def test_clock_skew_and_low_disk_space_are_reported(shared_instance: Instance, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(diagnostics, "LOW_DISK_BYTES", 10**18)
    monkeypatch.setattr(diagnostics, "MAX_SKEW_S", -1.0)
    shared_instance.up()
    problems = _problems(shared_instance)
    stop_instance(DataDir(shared_instance.data_dir))
    assert "GB free" in problems["disk"]
    assert "NTP" in problems["clock against the API"]
    assert "NTP" in problems["clock against the store"]


def test_a_folder_of_a_newer_kleinkram_is_refused(shared_instance: Instance) -> None:
    version = shared_instance.data_dir / "VERSION"
    before = version.read_text()
    version.write_text("1 99.0.0\n")
    stderr, problems = shared_instance.refused(), _problems(shared_instance)
    version.write_text(before)
    assert "was last used by Kleinkram 99.0.0" in stderr
    assert "install 99.0.0 or later" in problems["version"]


def test_a_database_of_another_postgres_is_refused(shared_instance: Instance) -> None:
    version = shared_instance.data_dir / "postgres" / "PG_VERSION"
    before = version.read_text()
    version.write_text("14\n")
    stderr, problems = shared_instance.refused(), _problems(shared_instance)
    version.write_text(before)
    assert "was made by PostgreSQL 14" in stderr
    assert "KLEINKRAM_POSTGRES_BIN" in stderr
    assert f"`klein backup create BACKUPS --data-dir {shared_instance.data_dir}`" in stderr
    assert "`klein restore BACKUPS --data-dir NEW`" in stderr
    assert "PostgreSQL 14" in problems["database version"]
    assert "klein restore" in problems["database version"]
    assert shared_instance.processes == []


def test_a_folder_with_other_files_is_refused(instance: Instance) -> None:
    instance.data_dir.mkdir()
    (instance.data_dir / "thesis.tex").write_text("important")
    assert "is not empty and no data directory" in instance.refused()
    assert [path.name for path in instance.data_dir.iterdir()] == ["thesis.tex"]


def test_a_missing_folder_is_created_by_up(tmp_path: Path) -> None:
    problems = {it.check: it for it in find_problems(doctor.examine(tmp_path / "none"))}
    assert "klein up" in problems["data directory"].remedy


def test_a_folder_without_postgres_is_refused(instance: Instance, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("KLEINKRAM_POSTGRES_BIN", "/nowhere")
    assert "KLEINKRAM_POSTGRES_BIN=/nowhere holds no PostgreSQL" in instance.refused()
