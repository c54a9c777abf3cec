"""Many runs on Slurm while everything is killed at random: none is lost, doubled or stuck."""

from __future__ import annotations

import random
import subprocess
import time

import pytest

from kleinkram.contract.runners import LOG_PATH
from kleinkram.contract.runs import EndReason
from tests.integration.runner_loop.conftest import Runners, wait_until
from tests.integration.runner_loop.fake_runs import FakeRun
from tests.integration.runner_loop.fake_server import FakeServer
from tests.slurm_cluster import SlurmCluster

_RUNS = 200
_TIMEOUT_S = 3000.0
# Each start has a name of its own, in every line of the log and in its only file.
_SCRIPT = (
    "import time, uuid\nfrom kleinkram.action import out\nname = uuid.uuid4().hex\n"
    "for _ in range({beats}):\n    print(name, flush=True)\n    time.sleep(0.1)\n"
    "(out / 'name').write_text(name)\n"
)


class Killer:
    """Kills services and the runner, and starts them again."""

    def __init__(self, server: FakeServer, runners: Runners, slurm: SlurmCluster, seed: int) -> None:
        self._server = server
        self._runners = runners
        self._slurm = slurm
        self._random = random.Random(seed)
        self._runner = runners.spawn(slurm=slurm)
        self.counts = dict.fromkeys(("slurmctld", "slurmd", "runner", "api"), 0)

    def strike(self) -> None:
        """Kill one of them; it comes back after up to four seconds."""
        victim = self._random.choice([*self.counts])
        self.counts[victim] += 1
        if victim == "runner":
            self._runners.kill(self._runner)
        elif victim == "api":
            self._server.is_silent.set()
        else:
            self._slurm.kill(victim)
        time.sleep(self._random.uniform(0, 4))
        if victim == "runner":
            self._runner = self._runners.spawn(slurm=self._slurm)
        elif victim == "api":
            self._server.is_silent.clear()
        elif victim == "slurmctld":
            self._slurm.start_controller()
        else:
            self._slurm.start_node()
        self.revive()

    def revive(self) -> None:
        """Start a runner that ended by itself: it found nothing that answers when it began."""
        if self._runner.poll() is not None:
            self._runner = self._runners.spawn(slurm=self._slurm)
        self._slurm.resume_node()

    def pause(self) -> None:
        """Let them work for some seconds."""
        time.sleep(self._random.uniform(2, 8))


@pytest.mark.soak
@pytest.mark.slow
def test_no_run_is_lost_doubled_or_stuck(server: FakeServer, runners: Runners, slurm: SlurmCluster) -> None:
    # The slowest machine has time for all of them.
    chance = random.Random(28)
    runs = [server.launch(_SCRIPT.format(beats=chance.randrange(1, 30))) for _ in range(_RUNS)]
    runners.folder.mkdir()
    killer = Killer(server, runners, slurm, seed=28)
    wait_until(lambda: server.hellos)
    until_s = time.monotonic() + _TIMEOUT_S
    try:
        while not all(run.finishes for run in runs):
            stuck = [str(run.claim.run_id) for run in runs if not run.finishes]
            assert time.monotonic() < until_s, f"stuck: {stuck}"
            killer.strike()
            killer.pause()
    except subprocess.TimeoutExpired:
        slurm.repair()
        raise
    for run in runs:
        check(run)
    assert min(killer.counts.values()) > 0, killer.counts


def check(run: FakeRun) -> None:
    """Check that a run ended once, with the results of one start, which was the last."""
    assert [(finish.reason, finish.message) for finish in run.finishes] == [(EndReason.done, "")]
    names = run.artifacts[LOG_PATH].decode().split()
    assert run.artifacts["name"].decode() == names[-1]
    # No start went on after the next one began.
    assert names == sorted(names, key=names.index)
