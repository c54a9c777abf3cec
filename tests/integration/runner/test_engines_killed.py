"""Engines are killed while containers run: Docker with its daemon, and Podman without one."""

from __future__ import annotations

from pathlib import Path

import pytest

from kleinkram.contract.runs import EndReason
from kleinkram.runner.executors.base import wait_for_end
from kleinkram.runner.executors.docker.executor import DockerExecutor
from tests.integration.runner import engines, podman_engines
from tests.integration.runner.conftest import Bench, log_of
from tests.integration.runner.engines import Dockerd
from tests.integration.runner.test_docker import COUNTS, another_runner, is_numbered, until_logged
from tests.integration.runner.test_executors import until_logged_by
from tests.requirements import need


def bench_on(engine: Dockerd, folder: Path) -> Bench:
    image = engine.load(engines.IMAGE, root=engines.python_root())
    return Bench(DockerExecutor(engine.engine), folder, lambda: DockerExecutor(engine.engine), image, "python3")


@pytest.mark.slow
def test_dockerd_is_killed(tmp_path: Path) -> None:
    need(*engines.PROGRAMS)
    with engines.dockerd("none", "127.0.0.1", "--live-restore") as docker:
        mortal = bench_on(docker, tmp_path)
        executor = mortal.executor

        lasting = mortal.job(COUNTS)
        executor.submit(lasting)
        until_logged_by(mortal, COUNTS, "line 20\n")
        docker.kill()
        assert wait_for_end(executor, lasting, timeout_s=0.5) is None
        docker.start()
        until_logged_by(mortal, COUNTS, "line 200\n")
        executor.cancel(lasting)
        assert mortal.end_of(lasting).reason is EndReason.cancelled
        lines = log_of(lasting).splitlines()
        assert len(set(lines)) == len(lines)

        cut = mortal.job(COUNTS)
        executor.submit(cut)
        until_logged_by(mortal, COUNTS, "line 20\n")
        docker.kill()
        executor.cancel(cut)
        docker.options = ()
        docker.start()
        assert mortal.end_of(cut).reason is EndReason.cancelled

        lost = mortal.job(COUNTS)
        executor.submit(lost)
        until_logged_by(mortal, COUNTS, "line 20\n")
        docker.kill()
        docker.start()
        assert mortal.end_of(lost).reason is EndReason.lost
        for job in mortal.made:
            executor.remove(job)
        assert mortal.image is not None
        assert executor.prepare_image(mortal.image).reference == mortal.image


@pytest.mark.soak
def test_runs_continue_when_the_podman_service_is_killed(tmp_path: Path) -> None:
    need(*podman_engines.PROGRAMS)
    with podman_engines.podman("none", "127.0.0.1") as podman:
        bench = bench_on(podman, tmp_path)
        text = COUNTS.replace("10_000", "300")

        over, cut = bench.job(text), bench.job(COUNTS)
        for job in (cut, over):
            bench.executor.submit(job)
        until_logged_by(bench, text, "line 20\n")
        podman.kill()
        assert wait_for_end(bench.executor, over, timeout_s=0.5) is None
        bench.executor.cancel(cut)
        podman.start()
        assert bench.end_of(over).reason is EndReason.done
        assert log_of(over).splitlines() == [f"line {n}" for n in range(300)]
        assert bench.end_of(cut).reason is EndReason.cancelled
        assert is_numbered(log_of(cut))
        for job in bench.made:
            bench.executor.remove(job)


@pytest.mark.soak
def test_runs_of_podman_are_lost_with_the_machine(tmp_path: Path) -> None:
    need(*podman_engines.PROGRAMS)
    with podman_engines.podman("none", "127.0.0.1") as podman:
        bench = bench_on(podman, tmp_path)
        job = bench.job(COUNTS)
        with another_runner(bench, podman, job, COUNTS):
            until_logged(job, "line 20\n")
        podman.go_down()
        podman.start()
        assert bench.end_of(job).reason is EndReason.lost
        assert is_numbered(log_of(job))
        bench.executor.remove(job)
