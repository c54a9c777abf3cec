"""A real server, a real Slurm, and a runner between them, each of which may be killed."""

from __future__ import annotations

import signal
import subprocess
import threading
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from socketserver import StreamRequestHandler, ThreadingTCPServer
from typing import Any, NamedTuple

from kleinkram import connect
from kleinkram.contract.actions import ActionDefinition
from kleinkram.contract.errors import KleinkramError
from kleinkram.contract.runs import RunDetail
from kleinkram.runner.arguments import Arguments, ExecutorChoice
from kleinkram.runner.executors.slurm.options import SlurmOptions
from tests import slurm_cluster
from tests.requirements import need
from tests.slurm_cluster import SlurmCluster
from tests.system.cluster import Cluster, environment

MISSIONS = 10


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
    """A server with some missions and without a runner of its own, a Slurm, and a runner with these options of it."""

    def __init__(
        self, home: Path, slurm: SlurmCluster, server: Cluster, witness: Witness, options: Mapping[str, Any]
    ) -> None:
        self.slurm, self.server, self.witness = slurm, server, witness
        self._home, self._options = home, options
        token = server.terminal.run("token", "create", "slurm", "--kind", "runner").out.strip()
        self._token_file = home / "runner-token"
        self._token_file.touch(0o600)
        self._token_file.write_text(token)
        owner = (server.data_dir / "owner-token").read_text().strip()
        self.client = connect(self._url, token=owner)
        self.client.projects.create("p")
        (home / "notes.txt").write_text("notes of a drive")
        self._missions = [self.client.missions.create(f"drive-{number}", project="p") for number in range(MISSIONS)]
        for mission in self._missions:
            self.client.upload(home / "notes.txt", mission)
        self._runner = self._start_runner()

    @property
    def _url(self) -> str:
        return f"http://127.0.0.1:{self.server.port}"

    def launch(self, definition: ActionDefinition, missions: int = MISSIONS) -> list[str]:
        """Launch runs on all missions, or the first ones, at once; return their ids."""
        outcomes = self.client.runs.launch(definition, self._missions[:missions], force=True)
        assert all(outcome.outcome == "created" for outcome in outcomes), outcomes
        return [str(outcome.run.id) for outcome in outcomes if outcome.outcome == "created"]

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
            slurm=SlurmOptions(max_jobs=20, **self._options),
        )
        variables = environment(self._home, **self.slurm.environment)
        with (self._home / "runner.log").open("ab") as log:
            return subprocess.Popen(arguments.command(), env=variables, stderr=log)


@contextmanager
def lab(home: Path, node_variables: Mapping[str, str] | None = None, **options: Any) -> Iterator[Lab]:
    """Run everything, in folders of its own. `node_variables` are those of the node, `options` those of the runner."""
    need(*slurm_cluster.PROGRAMS)
    with ExitStack() as stack:
        slurm = stack.enter_context(slurm_cluster.slurm_cluster(node_variables=node_variables))
        server = Cluster(home, options=["--no-runner"])
        stack.callback(server.end)
        server.start()
        witness = Witness()
        stack.callback(witness.close)
        made = Lab(home, slurm, server, witness, options)
        stack.callback(made.close)
        yield made
