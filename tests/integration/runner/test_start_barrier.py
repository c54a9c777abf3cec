"""Commands of containers do not start before their port forwards are open."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from kleinkram.contract.actions import Network
from kleinkram.contract.runs import EndReason
from kleinkram.runner.executors.base import RunJob
from kleinkram.runner.executors.docker import container as docker_container
from kleinkram.runner.executors.docker.client import DockerClient
from kleinkram.runner.executors.port_forward import PortForward
from tests.integration.runner import engines
from tests.integration.runner.conftest import Bench, lent, log_of
from tests.integration.runner.test_executors import ending_of_start

pytestmark = pytest.mark.slow
PORT_FORWARDS = [PortForward("kleinkram.lab.example", 443, "127.0.0.1", 1)]


@pytest.fixture(params=["docker", "podman"])
def bench(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Bench]:
    """A bench for each engine."""
    yield from lent(request.param, request, tmp_path)


@contextmanager
def behind_barrier(bench: Bench, job: RunJob) -> Iterator[tuple[DockerClient, str]]:
    """Start the container of a job without its executor, and yield its engine and its name."""
    assert bench.engine is not None
    assert job.image is not None
    client, name = bench.engine.engine, docker_container.container_name(job)
    image = client.find_image(job.image)
    assert image is not None
    for entry in ("out", "tmp"):
        (job.directory / entry).mkdir()
    described = docker_container.describe(
        job, user="1000:1000", volumes=[], labels={}, is_podman=client.info().is_podman
    )
    client.create(name, docker_container.with_barrier(described, job, image))
    try:
        client.start(name)
        yield client, name
    finally:
        client.remove(name)


def log_after_end(client: DockerClient, name: str) -> bytes:
    """Wait for the end of a container, and return what it wrote."""
    until = time.monotonic() + 60
    while (container := client.find_container(name)) is None or container.status != "exited":
        assert time.monotonic() < until
        time.sleep(0.05)
    return b"".join(piece.data for pieces in client.log(name, follow=False) for piece in pieces)


def test_the_command_starts_unchanged_once_the_barrier_is_open(bench: Bench) -> None:
    job = bench.job("import sys; print(sys.argv, sys.stdin.read())", network=Network.api, port_forwards=PORT_FORWARDS)
    with behind_barrier(bench, job) as (client, name):
        time.sleep(1)
        assert b"".join(piece.data for pieces in client.log(name, follow=False) for piece in pieces) == b""
        descriptor = docker_container.open_barrier(job.directory)
        assert log_after_end(client, name) == b"['-c'] \n"
        assert descriptor is not None
        os.close(descriptor)


def test_a_command_at_the_barrier_can_be_ended(bench: Bench) -> None:
    job = bench.job("print('begun')", network=Network.api, port_forwards=PORT_FORWARDS)
    with behind_barrier(bench, job) as (client, name):
        time.sleep(0.5)
        client.kill(name, "SIGTERM")
        assert log_after_end(client, name) == b""


@pytest.mark.parametrize("command", ["/usr/bin/nonsense", "nonsense", "/etc/hosts"])
def test_a_missing_command(bench: Bench, command: str) -> None:
    ending = ending_of_start(bench, bench.job([command], network=Network.api, port_forwards=PORT_FORWARDS))
    assert (ending.reason, command in ending.message) == (EndReason.command_not_found, True)


def test_a_command_in_an_image_without_a_shell_starts_without_the_barrier(bench: Bench) -> None:
    assert bench.engine is not None
    image = bench.engine.load("lab/bare:1", root=engines.python_root(with_shell=False))
    job = bench.with_image(image).job(
        ["python3", "-c", "print('begun')"], network=Network.api, port_forwards=PORT_FORWARDS
    )
    bench.executor.submit(job)
    assert bench.end_of(job).reason is EndReason.done
    assert log_of(job) == "begun\n"
