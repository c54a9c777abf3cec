"""Runs on this machine, by every executor that it has."""

from __future__ import annotations

import sys
import uuid
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from kleinkram.contract.actions import Network, Resources
from kleinkram.runner.process.executor import ProcessExecutor
from kleinkram.runner.work import Ending, Executor, Work


@dataclass
class Bench:
    """Makes runs of Python text, each in a folder of its own, and forgets them afterwards."""

    executor: Executor
    folder: Path
    again: Callable[[], Executor]
    made: list[Work] = field(default_factory=list)

    def work(self, text: str | Sequence[str], *, network: Network | None = None, **resources: int) -> Work:
        """Return a run that is not started yet; without network, where the executor can keep it from one."""
        usual = Network.none if Network.none in self.executor.abilities.networks else Network.open
        folder = self.folder / f"run-{len(self.made)}"
        (folder / "in").mkdir(parents=True)
        command = [sys.executable, "-c", text] if isinstance(text, str) else list(text)
        work = Work(
            key=f"{folder.name}-{uuid.uuid4().hex}",
            folder=folder,
            command=command,
            image=None,
            resources=Resources.model_validate({"memory_bytes": 500_000_000, "time_s": 30, **resources}),
            network=network or usual,
        )
        self.made.append(work)
        return work

    def run(self, text: str | Sequence[str], **resources: int) -> tuple[Work, Ending]:
        """Start a run and wait for its end."""
        work = self.work(text, network=None, **resources)
        self.executor.start(work)
        return work, self.end_of(work)

    def end_of(self, work: Work) -> Ending:
        """Wait for the end of a run."""
        ending = self.executor.wait(work, timeout_s=40)
        assert ending is not None, "it goes on"
        return ending


def log_of(work: Work) -> str:
    """Return what a run wrote."""
    return (work.folder / "log").read_text()


@pytest.fixture(params=[ProcessExecutor])
def bench(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Bench]:
    """Somewhere to run things, by each executor."""
    made = Bench(request.param(), tmp_path, request.param)
    yield made
    for work in made.made:
        made.executor.remove(work)
