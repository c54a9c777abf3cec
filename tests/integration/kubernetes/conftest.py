"""A runner on a fake cluster, against a fake server."""

from __future__ import annotations

import signal
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from kleinkram.contract.actions import Network
from kleinkram.runner.arguments import Arguments
from kleinkram.runner.executors.kubernetes.cluster import connect
from kleinkram.runner.executors.kubernetes.executor import KubernetesExecutor
from kleinkram.runner.executors.kubernetes.options import KubernetesOptions
from kleinkram.runner.loop import Runner, RunnerOptions
from kleinkram.runner.state_directory import StateDirectory
from tests.integration.kubernetes.action_scripts import LASTING
from tests.integration.kubernetes.fake_cluster import NAMESPACE, FakeCluster
from tests.integration.kubernetes.manifests import manifests
from tests.integration.runner_loop.conftest import wait_until
from tests.integration.runner_loop.fake_http import RUNNER_TOKEN
from tests.integration.runner_loop.fake_runs import FakeRun
from tests.integration.runner_loop.fake_server import FakeServer
from tests.integration.runner_loop.started_runners import StartedRunners

IMAGE = "registry.lab.example/actions/python@sha256:" + "a" * 64


@dataclass(kw_only=True)
class RunnerSite(StartedRunners):
    """A fake server, and runners on a cluster."""

    options: KubernetesOptions
    default_image: str = IMAGE
    networks: frozenset[Network] | None = frozenset(Network)

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
        options = RunnerOptions(self.server.url, RUNNER_TOKEN, "a-runner", default_image=self.default_image)
        return self.run_in_thread(Runner(options, state, executor))

    def has_begun(self) -> bool:
        """Whether the only run has written its first line."""
        return any(b"began" in path.read_bytes() for path in self.folder.glob("runs/*/log"))

    def spawn(self) -> subprocess.Popen[bytes]:
        """Start a runner as a process."""
        arguments = Arguments(
            url=self.server.url,
            data_dir=self.folder,
            name="a-runner",
            kubernetes=self.options,
            default_image=self.default_image,
        )
        return self.run_as_process(arguments.command(), {})


@dataclass(kw_only=True)
class Site(RunnerSite):
    """The same with a fake cluster."""

    cluster: FakeCluster

    def running_pod(self, step: str) -> dict[str, Any]:
        """Return the pod of a step once it runs."""

        def running() -> list[dict[str, Any]]:
            return [
                pod
                for pod in self.cluster.named("pods")
                if pod["metadata"]["labels"]["kleinkram.step"] == step and pod["status"]["phase"] == "Running"
            ]

        wait_until(running)
        return running()[0]

    def wait_for_pod(self, step: str) -> None:
        """Wait until there is a pod of a step."""
        wait_until(lambda: any(it["metadata"]["labels"]["kleinkram.step"] == step for it in self.cluster.named("pods")))

    def kill_while_it_fetches(self) -> FakeRun:
        """Return a run whose runner was killed, and whose inputs wait for a node."""
        first = self.spawn()
        wait_until(lambda: self.server.registrations)
        self.cluster.unschedulable = "0/3 nodes are available"
        run = self.server.launch(LASTING)
        self.wait_for_pod("fetch")
        self.kill(first, signal.SIGKILL)
        return run

    def is_clean(self) -> bool:
        """Whether nothing is left of a run."""
        return not any(self.cluster.named(kind) for kind in ("jobs", "pods", "secrets", "persistentvolumeclaims"))

    def wait_until_clean(self) -> None:
        """Wait until nothing is left of any run."""
        wait_until(self.is_clean)

    def let_end(self) -> None:
        """Have an action of `LASTING` end."""
        (volume,) = self.cluster.named("persistentvolumeclaims")
        (self.cluster.folder_of(volume["metadata"]["name"]) / "out" / "end").touch()


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
    made = Site(server, tmp_path / "runner", cluster=cluster, options=options)
    yield made
    made.close()
    server.close()
