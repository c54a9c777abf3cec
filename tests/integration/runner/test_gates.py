"""Commands of containers do not begin before their doors are there."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from kleinkram.contract.actions import Network
from kleinkram.contract.runs import EndReason
from kleinkram.runner.docker import container, gate
from kleinkram.runner.docker.engine import Engine
from kleinkram.runner.work import CannotStart, Door, Work
from tests.integration.runner import engines
from tests.integration.runner.conftest import Bench, lent, log_of

pytestmark = pytest.mark.slow
DOORS = [Door("kleinkram.lab.example", 443, "127.0.0.1", 1)]


@pytest.fixture(params=["docker", "podman"])
def bench(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Bench]:
    """Somewhere to run things, by each engine."""
    yield from lent(request.param, request, tmp_path)


@contextmanager
def behind_gate(bench: Bench, work: Work) -> Iterator[tuple[Engine, str]]:
    """Start a run's container without a warden, and yield its engine and its name."""
    assert bench.engine is not None
    assert work.image is not None
    engine, name = bench.engine.engine, container.name_of(work)
    image = engine.find_image(work.image)
    assert image is not None
    for each in ("out", "tmp"):
        (work.folder / each).mkdir()
    engine.create(name, container.gated(container.describe(work, "1000:1000", [], "desk"), work, image))
    try:
        engine.start(name)
        yield engine, name
    finally:
        engine.remove(name)


def written_by(engine: Engine, name: str) -> bytes:
    return b"".join(piece.data for pieces in engine.log(name, follow=False) for piece in pieces)


def test_it_waits_for_the_word_and_is_itself_then(bench: Bench) -> None:
    work = bench.work("import sys; print(sys.argv, sys.stdin.read())", network=Network.api, doors=DOORS)
    with behind_gate(bench, work) as (engine, name):
        time.sleep(1)
        assert written_by(engine, name) == b""
        found = engine.find(name)
        assert found is not None
        children = Path(f"/proc/{found.pid}/task/{found.pid}/children").read_text().split()
        assert [gate.is_waiting(Path(f"/proc/{each}/cmdline").read_bytes()) for each in children] == [True]
        gate.open_for(work.folder)
        engine.wait(name)
        assert written_by(engine, name) == b"['-c'] \n"


def test_while_it_waits_it_can_be_ended(bench: Bench) -> None:
    work = bench.work("print('begun')", network=Network.api, doors=DOORS)
    with behind_gate(bench, work) as (engine, name):
        time.sleep(0.5)
        engine.kill(name, "SIGTERM")
        engine.wait(name)
        assert written_by(engine, name) == b""


@pytest.mark.parametrize("command", ["/usr/bin/nonsense", "nonsense", "/etc/hosts"])
def test_a_command_that_is_not_there(bench: Bench, command: str) -> None:
    with pytest.raises(CannotStart, match=command) as caught:
        bench.executor.start(bench.work([command], network=Network.api, doors=DOORS))
    assert caught.value.ending.reason is EndReason.command_not_found


def test_what_looks_as_if_it_waited_is_held_to_its_bounds(bench: Bench) -> None:
    work = bench.work(list(gate.WAITING), network=Network.api, doors=DOORS, time_s=3)
    bench.executor.start(work)
    assert bench.end_of(work).reason is EndReason.time


def test_without_a_shell_it_does_not_wait(bench: Bench) -> None:
    assert bench.engine is not None
    image = bench.engine.load("lab/bare:1", root=engines.python_root(with_shell=False))
    work = bench.with_image(image).work(["python3", "-c", "print('begun')"], network=Network.api, doors=DOORS)
    bench.executor.start(work)
    assert bench.end_of(work).reason is EndReason.done
    assert log_of(work) == "begun\n"
