"""`klein up --listen 0.0.0.0`: another machine uploads, downloads and verifies, and reaches nothing else."""

import filecmp
import json
import os
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from kleinkram.standalone.processes import marked_processes
from tests.acceptance.conftest import Terminal
from tests.certificate import make_certificate
from tests.system.cluster import Cluster
from tests.system.conftest import OtherMachine

pytestmark = pytest.mark.slow

_ASKING = """\
# /// script
# dependencies = ["open-kleinkram"]
#
# [tool.kleinkram]
# network = "api"
# ///
import os

import kleinkram

with kleinkram.connect() as client:
    print(client.missions.get(os.environ["KLEINKRAM_MISSION_ID"]).name, "it is")
"""
_MIB = 1024 * 1024
# Tries to connect to these ports, and prints the open ones.
_CONNECT = """
import json, socket, sys
def opens(port):
    try:
        socket.create_connection((sys.argv[1], port), timeout=5).close()
    except OSError:
        return False
    return True
print(json.dumps([port for port in map(int, sys.argv[2:]) if opens(port)]))
"""


@pytest.mark.soak
def test_another_machine_uploads_downloads_and_verifies_over_http(
    cluster: Cluster, other_machine: OtherMachine, tmp_path: Path
) -> None:
    _listen(cluster, other_machine, "http")
    cluster.start()
    _upload_download_verify(cluster, other_machine.terminal(_folder(tmp_path / "robot")))
    assert _ports_that_open(cluster, other_machine) == {cluster.port, cluster.s3_port}


def test_another_machine_uploads_downloads_and_verifies_over_tls(
    cluster: Cluster, other_machine: OtherMachine, tmp_path: Path
) -> None:
    certificate, key = make_certificate(tmp_path, other_machine.our_address)
    _listen(cluster, other_machine, "https")
    cluster.options += ["--tls-cert", str(certificate), "--tls-key", str(key)]
    cluster.start()
    url = cluster.runtime_info()["url"]
    stranger = other_machine.terminal(_folder(tmp_path / "stranger"), KLEINKRAM_URL=url, KLEINKRAM_TOKEN="klein_x")
    assert "certificate" in stranger.run("project", "list", code=None).err.lower()
    # The variable of OpenSSL; the client has no setting for certificates.
    robot = other_machine.terminal(_folder(tmp_path / "robot"), SSL_CERT_FILE=str(certificate))
    _upload_download_verify(cluster, robot)
    assert _ports_that_open(cluster, other_machine) == {cluster.port, cluster.s3_port}
    (tmp_path / "asking.py").write_text(_ASKING)
    place = ("-p", "alpine", "-m", "day")
    runtime_info = robot.run("action", "run", tmp_path / "asking.py", *place, "--follow")
    assert "day it is" in runtime_info.out + runtime_info.err, "a run believes whom its runner believes"


def _listen(cluster: Cluster, machine: OtherMachine, scheme: str) -> None:
    cluster.options += ["--listen", "0.0.0.0", "--public-url", f"{scheme}://{machine.our_address}:{cluster.port}"]


def _upload_download_verify(cluster: Cluster, robot: Terminal) -> None:
    source, back = _folder(robot.home / "day"), robot.home / "back"
    sizes = {"large.bin": 20 * _MIB + 7, "small.bin": 1000, "empty.bin": 0}
    for name, size in sizes.items():
        (source / name).write_bytes(os.urandom(size))
        os.utime(source / name, (1_700_000_000, 1_700_000_000))
    robot.run(
        "endpoint", "add", "lab", cluster.runtime_info()["url"], stdin=(cluster.data_dir / "owner-token").read_text()
    )
    robot.run("project", "create", "alpine")
    mission = ["-p", "alpine", "-m", "day"]
    robot.run("upload", *mission, "--create", source)
    robot.run("verify", *mission, source)
    robot.run("verify", *mission, "--remote")
    robot.run("download", *mission, "--dest", back)
    for name in sizes:
        (copy,) = back.rglob(name)
        assert filecmp.cmp(source / name, copy, shallow=False)


def _ports_that_open(cluster: Cluster, machine: OtherMachine) -> set[int]:
    """Return the ports of all parts that the other machine can reach."""
    connections = [
        it for pid in marked_processes(cluster.data_dir) for it in psutil.Process(pid).net_connections("tcp")
    ]
    ports = {it.laddr.port for it in connections if it.status == psutil.CONN_LISTEN}
    assert {*cluster.runtime_info()["ports"].values()} - ports <= {
        cluster.runtime_info()["ports"]["s3_tls"],
        cluster.runtime_info()["ports"]["s3"],
    }
    probe = [sys.executable, "-c", _CONNECT, machine.our_address, *map(str, sorted(ports))]
    done = subprocess.run(machine.command(*probe), check=True, capture_output=True, text=True)
    return set(json.loads(done.stdout))


def _folder(path: Path) -> Path:
    path.mkdir()
    return path
