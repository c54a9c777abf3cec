"""Runs of a real server on a real Slurm while server, runner, slurmctld and slurmd are killed at random.

Each start of a script says to a process outside of all of them when it begins, goes on and ends: none may be lost,
doubled or stuck.
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from socketserver import StreamRequestHandler, ThreadingTCPServer
from typing import NamedTuple

import pytest

from kleinkram import connect
from kleinkram.contract.actions import ActionDefinition, Network, Resources
from kleinkram.contract.errors import KleinkramError
from kleinkram.contract.runs import RunDetail
from kleinkram.runner.arguments import Arguments, ExecutorChoice
from kleinkram.runner.executors.slurm.options import SlurmOptions
from tests import slurm_cluster
from tests.requirements import need
from tests.slurm_cluster import SlurmCluster
from tests.system.cluster import Cluster, environment

_PARTS = ("api", "runner", "slurmctld", "slurmd")
_STUCK_S = 300.0
_MISSIONS = 10
_SCRIPT = """
import socket, time, uuid
from kleinkram.action import context, out
name, run = uuid.uuid4().hex, context().run_id
with socket.create_connection(("127.0.0.1", {port})) as outside:
    def say(event):
        outside.sendall(f"{{run}} {{name}} {{event}}\\n".encode())
        outside.recv(1)
    say("begin")
    for _ in range({beats}):
        print(name, flush=True)
        time.sleep(0.1)
        say("beat")
    (out / "name").write_text(name)
    say("end")
"""


class Event(NamedTuple):
    """What a start of a script did, in the order in which it happened."""

    run: str
    name: str
    what: str


class Witness:
    """Records what scripts do. Nothing kills it."""

    def __init__(self) -> None:
        self.events: list[Event] = []
        events = self.events

        class Listener(StreamRequestHandler):
            def handle(self) -> None:
                for line in self.rfile:
                    events.append(Event(*line.decode().split()))
                    self.wfile.write(b".")

        ThreadingTCPServer.daemon_threads = True
        self._server = ThreadingTCPServer(("127.0.0.1", 0), Listener)
        self.port: int = self._server.server_address[1]
        threading.Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.05}, daemon=True).start()

    def close(self) -> None:
        """End it."""
        self._server.shutdown()
        self._server.server_close()

    def starts(self, run: RunDetail) -> list[list[Event]]:
        """Return the events of each start of a run, in their order; fail where one went on after the next began."""
        events = [event for event in self.events if event.run == str(run.id)]
        names = [event.name for event in events]
        assert names == sorted(names, key=names.index), f"two starts of {run.id} ran at once: {events}"
        return [[event for event in events if event.name == name] for name in dict.fromkeys(names)]


class Lab:
    """A server without a runner of its own, a Slurm, and a runner between them."""

    def __init__(self, home: Path, slurm: SlurmCluster, server: Cluster, witness: Witness) -> None:
        self.slurm, self.server, self.witness = slurm, server, witness
        self._home = home
        token = server.terminal.run("token", "create", "slurm", "--kind", "runner").out.strip()
        self._token_file = home / "runner-token"
        self._token_file.touch(0o600)
        self._token_file.write_text(token)
        owner = (server.data_dir / "owner-token").read_text().strip()
        self.client = connect(self._url, token=owner)
        self.client.projects.create("p")
        (home / "notes.txt").write_text("notes of a drive")
        self._missions = [self.client.missions.create(f"drive-{number}", project="p") for number in range(_MISSIONS)]
        for mission in self._missions:
            self.client.upload(home / "notes.txt", mission)
        self._runner = self._start_runner()

    @property
    def _url(self) -> str:
        return f"http://127.0.0.1:{self.server.port}"

    def launch(self, count: int, chance: random.Random) -> list[str]:
        """Launch runs, on all missions at once; return their ids."""
        resources = Resources(cores=1, memory_bytes=200_000_000, disk_bytes=50_000_000, time_s=120)
        ids = []
        for _ in range(count // _MISSIONS):
            script = _SCRIPT.format(port=self.witness.port, beats=chance.randrange(1, 30))
            definition = ActionDefinition(name="beat", script=script, resources=resources, network=Network.open)
            for outcome in self.client.runs.launch(definition, self._missions, force=True):
                assert outcome.outcome == "created", outcome
                ids.append(str(outcome.run.id))
        return ids

    def kill(self, part: str) -> None:
        """Kill one of them with SIGKILL. `klein up` starts the API again by itself."""
        if part == "runner":
            self._runner.kill()
            self._runner.wait()
        elif part == "api":
            self.server.kill("api")
        else:
            self.slurm.kill(part)

    def start_again(self, part: str) -> None:
        """Start what was killed; do what an administrator does with a node that Slurm drained."""
        if part == "slurmctld":
            self.slurm.start_controller()
        elif part == "slurmd":
            self.slurm.start_node()
        if self._runner.poll() is not None:  # it also ends if nothing answers when it begins
            self._runner = self._start_runner()
        self.slurm.resume_node()

    def active(self) -> int | None:
        """Return how many runs have not ended; None where the server does not answer."""
        try:
            return self.client.runs.count(active=True)
        except KleinkramError:
            return None

    def close(self) -> None:
        """End the runner and its jobs."""
        self.client.close()
        if self._runner.poll() is None:
            self._runner.send_signal(signal.SIGINT)
            self._runner.wait(60)

    def _start_runner(self) -> subprocess.Popen[bytes]:
        arguments = Arguments(
            url=self._url,
            data_dir=self._home / "runner",
            name="cluster",
            token_file=self._token_file,
            disk_bytes=10**9,
            cache_bytes=10**9,
            executor=ExecutorChoice.process,
            slurm=SlurmOptions(max_jobs=20),
        )
        variables = environment(self._home, **self.slurm.environment)
        with (self._home / "runner.log").open("ab") as log:
            return subprocess.Popen(arguments.command(), env=variables, stderr=log)


@contextmanager
def lab(home: Path) -> Iterator[Lab]:
    """Run everything, in folders of its own."""
    need(*slurm_cluster.PROGRAMS)
    with ExitStack() as stack:
        slurm = stack.enter_context(slurm_cluster.slurm_cluster())
        server = Cluster(home, options=["--no-runner"])
        stack.callback(server.end)
        server.start()
        witness = Witness()
        stack.callback(witness.close)
        made = Lab(home, slurm, server, witness)
        stack.callback(made.close)
        yield made


def run_under_fire(lab: Lab, count: int, chance: random.Random, strikes: Iterator[str]) -> None:
    """Have runs done while parts are killed; check that each was done, with the results of exactly one start."""
    ids = lab.launch(count, chance)
    kills = dict.fromkeys(_PARTS, 0)
    until_s, least = time.monotonic() + _STUCK_S, count
    while (active := lab.active()) != 0:
        if active is not None and active < least:
            until_s, least = time.monotonic() + _STUCK_S, active
        assert time.monotonic() < until_s, f"{active} runs are stuck: {lab.slurm.command('squeue').stdout}"
        if (part := next(strikes, None)) is not None:
            kills[part] += 1
            lab.kill(part)
            time.sleep(chance.uniform(0, 4))
        lab.start_again(part or "")
        time.sleep(chance.uniform(1, 5) if part else 0.2)
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
        run_under_fire(made, 10, random.Random(1), iter(_PARTS))


@pytest.mark.soak
@pytest.mark.slow
def test_many_runs_survive_random_kills(tmp_path: Path) -> None:
    seed = int(os.environ.get("KLEINKRAM_KILLS_SEED", "28"))
    chance = random.Random(seed)
    with lab(tmp_path) as made:
        run_under_fire(made, 200, chance, iter(lambda: chance.choice(_PARTS), ""))
