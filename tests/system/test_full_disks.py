"""Full disks of the client and the database are reported with place and reason; work continues once there is space."""

import filecmp
import json
import os
import secrets
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import psycopg
import pytest

from kleinkram.client import Client, connect
from kleinkram.contract.errors import DatabaseUnavailable
from kleinkram.standalone.data_dir import DataDir, load_secrets
from kleinkram.standalone.postgres import ADMIN
from tests.acceptance.conftest import end, wait_until
from tests.system import backend
from tests.system.chaos.disks import MIB, SmallDisk, need_small_disks, small_disk
from tests.system.cluster import Cluster

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

# An empty database uses 60 MB of it, including two WAL segments.
_DATABASE_MB = 160
_EXIT_UNREACHABLE, _EXIT_DESTINATION = 7, 11


@pytest.fixture(scope="module")
def disk(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Cluster, SmallDisk]]:
    """An instance whose database is on a small disk."""
    need_small_disks()
    cluster = Cluster(tmp_path_factory.mktemp("house"))
    cluster.start()
    cluster.terminal.run("project", "create", "p")
    cluster.end()
    with small_disk(cluster.data_dir / "postgres", _DATABASE_MB * MIB) as disk:
        cluster.inside = disk.inside
        cluster.start()
        yield cluster, disk
        cluster.end()


def _file(path: Path, size_bytes: int) -> Path:
    path.write_bytes(os.urandom(size_bytes))
    os.utime(path, (1_700_000_000, 1_700_000_000))
    return path


def test_a_download_reports_a_full_disk_and_resumes_once_there_is_space(
    disk: tuple[Cluster, SmallDisk], tmp_path: Path
) -> None:
    terminal, size_bytes = disk[0].terminal, 40 * MIB
    file = _file(tmp_path / "large.bin", size_bytes)
    terminal.run("upload", "-p", "p", "-m", "there", "--create", file)
    back = tmp_path / "back"
    back.mkdir()
    download = ["download", "-p", "p", "-m", "there", "--dest", back]
    with small_disk(back, 30 * MIB) as too_small:
        refused = replace(terminal, prefix=too_small.inside).run(*download, code=_EXIT_DESTINATION).err
        assert f"{size_bytes} bytes are needed and {30 * MIB} are free" in refused
        assert not too_small.path("large.bin.klein-part").exists(), "nothing was begun"
    with small_disk(back, 60 * MIB) as filling:
        inside = replace(terminal, prefix=filling.inside)
        process = inside.start(*download, "--limit-rate", "4MiB")
        wait_until(filling.path("large.bin.klein-journal").exists, "the download to begin")
        filling.fill()
        ended = end(process)
        assert ended.code == _EXIT_DESTINATION, ended.err
        assert "There is not enough disk space for" in ended.err
        assert "run the same command again" in ended.err
        assert not filling.path("large.bin").exists(), "what is not whole has no name"
        filling.make_room()
        (came,) = inside.run(*download, "--json").json()["items"]
        assert came["outcome"] == "downloaded"
        assert filecmp.cmp(file, filling.path("large.bin"), shallow=False)


def test_a_database_with_a_full_disk_reports_it_and_recovers_once_there_is_space(
    disk: tuple[Cluster, SmallDisk], tmp_path: Path
) -> None:
    cluster, small = disk
    terminal = cluster.terminal
    stored = _file(tmp_path / "kept.bin", 9 * MIB)
    terminal.run("upload", "-p", "p", "-m", "m", "--create", stored)
    with _administrator(cluster) as administrator:
        small.fill()
        _fill_a_table(cluster)
        terminal.run("verify", "-p", "p", "-m", "m", stored)  # reading still works
        with pytest.raises(psycopg.OperationalError):
            _fill_the_log(administrator)
    wait_until(lambda: _postgres_complains(cluster), "the supervisor to say why PostgreSQL does not start")
    findings: dict[str, Any] = {}

    def is_reported() -> bool:  # not while PostgreSQL restarts
        findings.update({finding["check"]: finding for finding in _doctor(cluster, small)})
        return "No space left on device" in findings["service postgres"]["message"]

    wait_until(is_reported, "the doctor to say why PostgreSQL does not run")
    assert "without any the database stops until there is some" in findings["disk of the database"]["remedy"]
    assert findings["disk of the database"]["severity"] == "problem"
    coming = _file(tmp_path / "coming.bin", 9 * MIB)
    unanswered = terminal.run("project", "list", code=_EXIT_UNREACHABLE).err
    assert "The database is not available" in unanswered
    small.make_room()
    wait_until(lambda: terminal.run("project", "list", code=None).code == 0, "the database to be back")
    terminal.run("upload", "-p", "p", "-m", "m", coming)
    terminal.run("verify", "-p", "p", "-m", "m", stored, coming)
    backend.tidy(cluster)
    assert backend.objects(cluster) == dict(backend.sql(cluster, "SELECT key, size_bytes FROM blob"))


def _fill_a_table(cluster: Cluster) -> None:
    """Create missions until the disk is full, and check the error."""
    token = (cluster.data_dir / "owner-token").read_text().strip()
    with connect(cluster.runtime_info()["url"], token) as client, pytest.raises(DatabaseUnavailable) as refused:
        _make_missions(client)
    assert "its disk is full: free space on the server" in str(refused.value)
    assert "Nothing was lost" in str(refused.value)


def _make_missions(client: Client) -> None:
    project_id = client.projects.get("p").id
    for number in range(200):
        client.missions.create(f"m{number}", project=project_id, notes=secrets.token_hex(4000))


def _administrator(cluster: Cluster) -> "psycopg.Connection[tuple[object, ...]]":
    return psycopg.connect(
        host="127.0.0.1",
        port=cluster.runtime_info()["ports"]["postgres"],
        user=ADMIN,
        password=load_secrets(DataDir(cluster.data_dir)).postgres_admin,
        dbname="postgres",
        autocommit=True,
    )


def _fill_the_log(administrator: "psycopg.Connection[tuple[object, ...]]") -> None:
    """Make PostgreSQL create WAL segments until the disk is full."""
    for _ in range(20):
        administrator.execute("SELECT pg_logical_emit_message(false, 'w', 'x'), pg_switch_wal()")


def _postgres_complains(cluster: Cluster) -> bool:
    log = (cluster.home / "up.err").read_text()
    return "postgres has ended" in log and "No space left on device); restarting it in" in log


def _doctor(cluster: Cluster, small: SmallDisk) -> list[dict[str, str]]:
    command = [*small.inside, *cluster.terminal.command("doctor", "--data-dir", cluster.data_dir, "--json")]
    done = subprocess.run(command, check=False, capture_output=True, text=True, env=cluster.terminal.environment)
    checks: list[dict[str, str]] = json.loads(done.stdout)["checks"]
    return checks
