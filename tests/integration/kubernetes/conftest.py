"""A runner on a fake cluster, against a fake server."""

from __future__ import annotations

import os
import signal
import subprocess
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from kleinkram.contract.actions import Network
from kleinkram.runner.arguments import TOKEN_VARIABLE, Arguments
from kleinkram.runner.executors.kubernetes.cluster import connect
from kleinkram.runner.executors.kubernetes.executor import KubernetesExecutor
from kleinkram.runner.executors.kubernetes.options import KubernetesOptions
from kleinkram.runner.loop import Runner, RunnerOptions
from kleinkram.runner.state_directory import StateDirectory
from tests.integration.kubernetes.fake_cluster import NAMESPACE, FakeCluster
from tests.integration.kubernetes.manifests import manifests
from tests.integration.runner_loop.fake_http import RUNNER_TOKEN
from tests.integration.runner_loop.fake_server import FakeServer

IMAGE = "registry.lab.example/actions/python@sha256:" + "a" * 64


@dataclass
class RunnerSite:
    """A fake server, and the consecutive runners of one test on a cluster."""

    server: FakeServer
    folder: Path
    options: KubernetesOptions
    default_image: str = IMAGE
    networks: frozenset[Network] = frozenset(Network)
    _threads: list[tuple[Runner, threading.Thread]] = field(default_factory=list)
    _processes: list[subprocess.Popen[bytes]] = field(default_factory=list)

    def executor(self, state: StateDirectory) -> KubernetesExecutor:
        """Return the executor of a runner."""
        options = self.options
        return KubernetesExecutor(
            connect(options.namespace, options.kubeconfig),
            options,
            runner=str(state.runner_id),
            url=self.server.url,
            token=RUNNER_TOKEN,
            networks=self.networks,
        )

    def start(self) -> Runner:
        """Start a runner in this process."""
        self.folder.mkdir(exist_ok=True)
        state = StateDirectory(self.folder)
        executor = self.executor(state)
        runner = Runner(
            RunnerOptions(self.server.url, RUNNER_TOKEN, "a-runner", default_image=self.default_image), state, executor
        )
        thread = threading.Thread(target=runner.run)
        thread.start()
        self._threads.append((runner, thread))
        return runner

    def spawn(self) -> subprocess.Popen[bytes]:
        """Start a runner as a process."""
        arguments = Arguments(
            url=self.server.url,
            data_dir=self.folder,
            name="a-runner",
            kubernetes=self.options,
            default_image=self.default_image,
        )
        process = subprocess.Popen(arguments.command(), env={**os.environ, TOKEN_VARIABLE: RUNNER_TOKEN})
        self._processes.append(process)
        return process

    def kill(self, process: subprocess.Popen[bytes], number: signal.Signals) -> None:
        """End the process of a runner."""
        process.send_signal(number)
        process.wait(timeout=30)

    def close(self) -> None:
        """End what is left, runs included."""
        for runner, _ in self._threads:
            runner.stop()
        self.server.is_silent.set()
        self.server.wake()
        for runner, thread in self._threads:
            thread.join(10)
            runner.close(kill=True)
        for process in self._processes:
            if process.poll() is None:
                self.kill(process, signal.SIGINT)


@dataclass
class Site(RunnerSite):
    """The same with a fake cluster."""

    cluster: FakeCluster = field(kw_only=True)


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[FakeCluster]:
    """A cluster without pods."""
    folder = tmp_path / "cluster"
    folder.mkdir()
    made = FakeCluster(folder)
    made.network_policies = manifests("NetworkPolicy")
    yield made
    made.close()


@pytest.fixture
def site(cluster: FakeCluster, tmp_path: Path) -> Iterator[Site]:
    """A server and a cluster without runs."""
    server = FakeServer()
    options = KubernetesOptions(namespace=NAMESPACE, kubeconfig=cluster.kubeconfig())
    made = Site(server, tmp_path / "runner", options, cluster=cluster)
    yield made
    made.close()
    server.close()
