"""Differences between Podman and Docker, as the page on the security of runs describes them."""

from __future__ import annotations

import pytest

from kleinkram.contract.runs import EndReason
from kleinkram.runner.executors.docker.executor import DockerExecutor
from tests.integration.runner.conftest import Bench, log_of
from tests.integration.runner.test_docker import COUNTS

pytestmark = [pytest.mark.soak, pytest.mark.parametrize("bench", ["podman"], indirect=True)]


@pytest.mark.parametrize("folder", ["/run", "/var/tmp"])
def test_tmpfs_counts_towards_the_memory_of_a_run(bench: Bench, folder: str) -> None:
    text = f"open('{folder}/one', 'w').close(); print('made', flush=True)\n"
    text += f"with open('{folder}/large', 'wb') as large:\n    while True: large.write(bytes(1_000_000))"
    job, ending = bench.run(text, memory_bytes=100_000_000)
    assert (ending.reason, log_of(job)) == (EndReason.memory, "made\n")


@pytest.mark.parametrize(("words", "reason"), [(["kill"], EndReason.lost), (["stop", "-t", "3"], EndReason.signal)])
def test_the_reason_of_a_container_ended_by_hand(bench: Bench, words: list[str], reason: EndReason) -> None:
    assert bench.engine is not None
    job = bench.job(COUNTS)
    bench.executor.submit(job)
    bench.engine.docker(*words, f"kleinkram-{job.key}")
    assert bench.end_of(job).reason is reason


def test_podman_may_forget_its_containers(bench: Bench) -> None:
    """It is then unknown whether a request ended a container; its exit code is known."""
    assert bench.engine is not None
    settings = bench.engine.folder / "containers.conf"
    before = settings.read_text()
    try:
        bench.engine.kill()
        settings.write_text(before.replace('events_logger = "file"', 'events_logger = "none"'))
        bench.engine.start()
        bench.executor = DockerExecutor(bench.engine.engine)
        _, ending = bench.run("raise SystemExit(3)")
        assert (ending.reason, ending.exit_code) == (EndReason.exit_code, 3)
    finally:
        settings.write_text(before)
        bench.engine.kill()
        bench.engine.start()
