"""Runs of a real server on a real Slurm while server, runner, slurmctld and slurmd are killed at random.

Each start of a script says to a process outside of all of them when it begins, goes on and ends: none may be lost,
doubled or stuck.
"""

from __future__ import annotations

import os
import random
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from kleinkram.contract.actions import ActionDefinition, Network, Resources
from kleinkram.contract.runs import RunDetail
from tests.system.slurm_lab import MISSIONS, Lab, lab

_PARTS = ("api", "runner", "slurmctld", "slurmd")
_STUCK_S = 300.0
_SCRIPT = """
import socket, time, uuid
from kleinkram.action import context, out
name, run = uuid.uuid4().hex, context().run_id
with socket.create_connection(("127.0.0.1", {port})) as outside:
    def say(event):
        outside.sendall(f"{{run}} {{name}} {{event}}\\n".encode())
        outside.recv(1)
    say("begin")
    for _ in range({steps}):
        print(name, flush=True)
        time.sleep(0.1)
        say("step")
    (out / "name").write_text(name)
    say("end")
"""


def stepwise(lab: Lab, steps: int) -> ActionDefinition:
    """Return an action that lasts for so many tenths of a second."""
    resources = Resources(cores=1, memory_bytes=200_000_000, disk_bytes=50_000_000, time_s=120)
    script = _SCRIPT.format(port=lab.witness.port, steps=steps)
    return ActionDefinition(name="step", script=script, resources=resources, network=Network.open)


def run_under_fire(
    lab: Lab, count: int, chance: random.Random, strikes: Iterator[str], *, steps: Sequence[int], pause_s: float
) -> None:
    """Have runs done while parts are killed; check that each was done, with the results of exactly one start.

    The runs last for so many tenths of a second. Each part is killed at least once, and away for up to `pause_s`; all
    of them work as long at most before the next is killed.
    """
    ids = [run_id for _ in range(count // MISSIONS) for run_id in lab.launch(stepwise(lab, chance.choice(steps)))]
    kills = dict.fromkeys(_PARTS, 0)
    until_s, least = time.monotonic() + _STUCK_S, count
    while (active := lab.active()) != 0:
        if active is not None and active < least:
            until_s, least = time.monotonic() + _STUCK_S, active
        assert time.monotonic() < until_s, f"{active} runs are stuck: {lab.slurm.command('squeue').stdout}"
        if (part := next(strikes, None)) is not None:
            kills[part] += 1
            lab.kill(part)
            time.sleep(chance.uniform(0, pause_s))
        lab.start_again(part or "")
        time.sleep(chance.uniform(pause_s / 4, pause_s) if part else 0.2)
    assert min(kills.values()) > 0, f"the runs ended before each part was killed: {kills}"
    repeated = [run_id for run_id in ids if check(lab, lab.client.runs.get(run_id)) > 1]
    sys.stderr.write(f"{count} runs, {len(repeated)} of them started more than once; kills: {kills}\n")


def check(lab: Lab, run: RunDetail) -> int:
    """Check that a run was done, with the results of its last start, the only one that ended; count its starts."""
    assert (run.state.value, run.message, run.artifact_count) == ("done", "", 1), run
    starts = lab.witness.starts(run)
    assert starts, f"{run.id} was done without being started"
    complete = [start for start in starts if start[-1].what == "end"]
    assert complete, f"{run.id} did not reach its end"
    assert complete[-1] is starts[-1]
    # A start may be killed after its script and before its ending: the next one is recorded.
    requeues = run.placement.requeues if run.placement else 0
    assert len(complete) == 1 or run.attempt > 1 or requeues, f"{run.id} was done twice, and recorded once"
    lines = "".join(piece.text for piece in lab.client.runs.log(run.id)).split()
    assert lines, f"{run.id} has no log"
    assert lines[-1] == starts[-1][0].name
    return len(starts)


@pytest.mark.slow
def test_runs_survive_a_kill_of_each_part(tmp_path: Path) -> None:
    with lab(tmp_path) as made:
        run_under_fire(made, 10, random.Random(1), iter(_PARTS), steps=(60,), pause_s=1)


@pytest.mark.soak
@pytest.mark.slow
def test_many_runs_survive_random_kills(tmp_path: Path) -> None:
    seed = int(os.environ.get("KLEINKRAM_KILLS_SEED", "28"))
    chance = random.Random(seed)
    with lab(tmp_path) as made:
        run_under_fire(made, 200, chance, iter(lambda: chance.choice(_PARTS), ""), steps=range(1, 30), pause_s=4)
