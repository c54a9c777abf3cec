"""The container descriptions sent to an engine, and the images requested, without an engine."""

from __future__ import annotations

import base64
import json
import os
import resource
import stat
from pathlib import Path

import pytest

from kleinkram.contract.actions import Network, Resources
from kleinkram.runner.executors.base import RunJob
from kleinkram.runner.executors.docker import container as docker_container
from kleinkram.runner.executors.docker.client import ImageInfo
from kleinkram.runner.executors.docker.container import describe, execution_error, with_barrier
from kleinkram.runner.executors.port_forward import PortForward
from kleinkram.runner.images.names import credentials_for, is_allowed, parse_image_name


def job_of(folder: Path, network: Network = Network.none, **resources: int) -> RunJob:
    return RunJob("run-1", folder, ["ls"], "sha256:1", Resources.model_validate(resources), network, {"A": "b"})


def host_of(job: RunJob, *volumes: str) -> dict[str, object]:
    described = json.loads(json.dumps(describe(job, user="1000:1000", volumes=volumes, labels={})))
    return dict(described["HostConfig"])


@pytest.mark.parametrize("network", list(Network))
def test_a_container_gets_no_more_than_its_job_needs(tmp_path: Path, network: Network) -> None:
    host = host_of(job_of(tmp_path, network, memory_bytes=10**9))
    assert host["NetworkMode"] == ("bridge" if network is Network.open else "none")
    assert (host["ReadonlyRootfs"], host["Privileged"], host["CapDrop"]) == (True, False, ["ALL"])
    assert host["SecurityOpt"] == ["no-new-privileges"]
    assert (host["Memory"], host["MemorySwap"]) == (10**9, 10**9)
    assert not {"PidMode", "Binds", "Devices", "CapAdd", "GroupAdd", "VolumesFrom"} & set(host)
    assert "docker.sock" not in json.dumps(host)


def test_measured_usage_does_not_exceed_that_of_the_runner(tmp_path: Path) -> None:
    limits = host_of(job_of(tmp_path, disk_bytes=10**9))["Ulimits"]
    assert isinstance(limits, list)
    hard = {entry["Name"]: entry["Hard"] for entry in limits}
    assert hard["core"] == 0
    assert 10**9 < hard["fsize"] < 1.1 * 10**9
    for name, kind, most in (("nofile", resource.RLIMIT_NOFILE, 2**16), ("nproc", resource.RLIMIT_NPROC, 2**15)):
        mine = resource.getrlimit(kind)[1]
        assert hard[name] == (most if mine == resource.RLIM_INFINITY else min(mine, most))


@pytest.mark.parametrize(
    ("output", "error"),
    [
        ("[FATAL tini (7)] exec /usr/bin/odd failed: No such file or directory\n", "/usr/bin/odd: No such file"),
        ("ERROR (catatonit:2): failed to exec pid1: Permission denied\n", "/usr/bin/odd: Permission denied"),
        ("kleinkram: 1: exec: /usr/bin/odd: not found\n", "/usr/bin/odd: not found"),
        ("kleinkram: line 1: /usr/bin/odd: Is a directory\n", "/usr/bin/odd: Is a directory"),
        ("kleinkram: exec: line 0: /usr/bin/odd: Permission denied\n", "/usr/bin/odd: Permission denied"),
        ("kleinkram: 3 of 5 chunks: odd\n", None),
        ("Traceback (most recent call last):\n", None),
        ("", None),
    ],
)
def test_a_missing_command_is_reported_for_every_init_process(output: str, error: str | None) -> None:
    result = execution_error(output, ["/usr/bin/odd", "-v"], 127)
    assert result is None if error is None else str(result).startswith(error)


@pytest.mark.parametrize(
    ("image", "command", "runs"),
    [
        ([["ros"], ["slam"]], [], ["ros", "slam"]),
        ([["ros"], ["slam"]], ["ls", "/in"], ["ros", "ls", "/in"]),
        ([[], ["slam"]], [], ["slam"]),
        ([[], []], [], None),
    ],
)
def test_the_start_barrier_runs_the_same_command(
    tmp_path: Path, image: list[list[str]], command: list[str], runs: list[str] | None
) -> None:
    job = RunJob(**{**vars(job_of(tmp_path, Network.api)), "command": command})
    plain = describe(job, user=f"{os.getuid()}:{os.getgid()}", volumes=[], labels={})
    entrypoint, default_command = map(tuple, image)
    info = ImageInfo("1", (), "amd64", (), entrypoint, default_command)
    made = json.loads(json.dumps(with_barrier(plain, job, info)))
    if runs is None:
        assert made == json.loads(json.dumps(plain))
        return
    assert (made["Entrypoint"][0], made["Cmd"]) == (docker_container.SHELL, runs)
    added = made["HostConfig"].pop("Mounts")[-1]
    assert (added["Source"], added["ReadOnly"]) == (str(tmp_path / docker_container.BARRIER), True)
    assert stat.S_ISFIFO((tmp_path / docker_container.BARRIER).stat().st_mode)


def test_output_like_a_shell_error_is_ignored_with_another_exit_code() -> None:
    assert execution_error("kleinkram: 1: exec: /usr/bin/odd: not found", ["/usr/bin/odd"], 1) is None


def test_volumes_of_an_image_are_counted_with_tmp(tmp_path: Path) -> None:
    mounts = host_of(job_of(tmp_path), "/data", "/out")["Mounts"]
    assert isinstance(mounts, list)
    places = {entry["Target"]: (entry["Source"], entry["ReadOnly"]) for entry in mounts}
    assert places == {
        "/in": (str(tmp_path / "in"), True),
        "/out": (str(tmp_path / "out"), False),
        "/tmp": (str(tmp_path / "tmp"), False),
        "/data": (str(tmp_path / "tmp" / ".volume-0"), False),
    }


def test_each_forwarded_host_has_its_own_address(tmp_path: Path) -> None:
    hosts = ["api.lab.example", "store.lab.example", "localhost", "192.168.1.5", "api.lab.example"]
    job = job_of(tmp_path, Network.api)
    forwards = tuple(PortForward(host, 443, "127.0.0.1", 1) for host in hosts)
    host = host_of(RunJob(**{**vars(job), "port_forwards": forwards}))
    assert host["ExtraHosts"] == ["api.lab.example:127.1.0.1", "store.lab.example:127.1.0.2"]


@pytest.mark.parametrize(
    ("text", "place", "tag", "digest"),
    [
        ("debian", "docker.io/library/debian", "latest", ""),
        ("lab/slam:2", "docker.io/lab/slam", "2", ""),
        ("ghcr.io/lab/slam", "ghcr.io/lab/slam", "latest", ""),
        ("localhost:5000/slam:1", "localhost:5000/slam", "1", ""),
        ("lab/slam:2@sha256:ab", "docker.io/lab/slam", "2", "sha256:ab"),
    ],
)
def test_image_names_are_completed(text: str, place: str, tag: str, digest: str) -> None:
    assert parse_image_name(text) == (place, tag, digest)


def test_allowed_images_by_registry_or_namespace() -> None:
    allowed = ["ghcr.io/lab", "registry.lab.example:5000/"]
    for name in ("ghcr.io/lab/slam:1", "ghcr.io/lab", "registry.lab.example:5000/a/b"):
        assert is_allowed(parse_image_name(name), allowed), name
    for name in ("ghcr.io/labor/slam", "ghcr.io/other/lab", "lab/slam", "registry.lab.example/a", "ghcr.io.evil/lab/x"):
        assert not is_allowed(parse_image_name(name), allowed), name


def test_credentials_of_docker_login_are_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DOCKER_CONFIG", str(tmp_path))
    assert credentials_for("ghcr.io") is None
    known = {"ghcr.io": {"auth": base64.b64encode(b"ada:pass:word").decode()}, "quay.io": {"identitytoken": "t"}}
    (tmp_path / "config.json").write_text(json.dumps({"auths": known}))
    assert read_credentials("ghcr.io") == {"username": "ada", "password": "pass:word", "serveraddress": "ghcr.io"}
    assert read_credentials("quay.io") == {"identitytoken": "t", "serveraddress": "quay.io"}
    assert credentials_for("docker.io") is None


def test_credentials_may_come_from_a_helper_program(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = tmp_path / "docker-credential-safe"
    program.write_text('#!/bin/sh\nread name\necho "{\\"Username\\": \\"ada\\", \\"Secret\\": \\"for $name\\"}"\n')
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    monkeypatch.setenv("DOCKER_CONFIG", str(tmp_path))
    (tmp_path / "config.json").write_text('{"credsStore": "safe"}')
    assert read_credentials("ghcr.io")["password"] == "for ghcr.io"


def read_credentials(registry: str) -> dict[str, str]:
    values = credentials_for(registry)
    assert values is not None
    return values


def test_usage_of_both_versions_of_control_groups(tmp_path: Path) -> None:
    files = {
        "one/memory.stat": "anon 5\ninactive_file 1000\n",
        "one/memory.current": "51000\n",
        "one/io.stat": "8:0 rbytes=10 wbytes=20 rios=1 wios=1\n8:16 rbytes=1 wbytes=2\n",
        "one/cpu.stat": "usage_usec 1500000\nuser_usec 1\n",
        "memory/one/memory.stat": "total_inactive_file 1000\n",
        "memory/one/memory.usage_in_bytes": "51000\n",
        "blkio/one/blkio.throttle.io_service_bytes_recursive": "8:0 Read 11\n8:0 Write 22\n8:0 Total 33\nTotal 33\n",
        "cpuacct/one/cpuacct.usage": "1500000000\n",
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    first = {"memory": "/one", "cpuacct": "/one", "blkio": "/one", "": "/"}
    assert (
        docker_container.cgroup_usage(first, tmp_path)
        == docker_container.cgroup_usage({"": "/one"}, tmp_path)
        == (1.5, 50_000, 11, 22)
    )
    assert docker_container.cgroup_usage({"": "/gone"}, tmp_path) is None


@pytest.mark.parametrize(("ended", "is_reported"), [(0, False), (2, True)])
def test_out_of_memory_in_both_versions_of_control_groups(tmp_path: Path, ended: int, *, is_reported: bool) -> None:
    (tmp_path / "memory" / "one").mkdir(parents=True)
    (tmp_path / "memory" / "one" / "memory.oom_control").write_text(f"oom_kill_disable 0\noom_kill {ended}\n")
    (tmp_path / "two").mkdir()
    (tmp_path / "two" / "memory.events").write_text(f"max 3\noom {ended}\noom_kill {ended}\n")
    for groups in ({"memory": "/one", "": "/"}, {"": "/two"}):
        assert docker_container.was_oom_killed(groups, tmp_path) is is_reported
    assert not docker_container.was_oom_killed({"": "/gone"}, tmp_path)
