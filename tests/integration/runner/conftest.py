"""Runs on this machine with each executor."""

from __future__ import annotations

import dataclasses
import os
import sys
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import pytest

from kleinkram.contract.actions import Network, Resources
from kleinkram.runner.executors.base import Ending, Executor, RunJob, wait_for_end
from kleinkram.runner.executors.docker.executor import DockerExecutor
from kleinkram.runner.executors.kubernetes.cluster import connect
from kleinkram.runner.executors.kubernetes.executor import KubernetesExecutor
from kleinkram.runner.executors.kubernetes.options import KubernetesOptions
from kleinkram.runner.executors.port_forward import PortForward
from kleinkram.runner.executors.process import ProcessExecutor
from kleinkram.runner.executors.slurm.commands import SlurmCommands
from kleinkram.runner.executors.slurm.executor import SlurmExecutor
from kleinkram.runner.executors.slurm.options import SlurmOptions
from kleinkram.runner.executors.slurm.probe import SlurmSite, find_site
from kleinkram.runner.images.store import FolderBuilder, ImageStore
from tests.integration.kubernetes.fake_cluster import NAMESPACE, FakeCluster
from tests.integration.kubernetes.real_cluster import NAMESPACE as NAMESPACE_OF_RUNS
from tests.integration.kubernetes.real_cluster import RealCluster
from tests.integration.runner import engines, podman_engines
from tests.integration.runner.engines import Dockerd
from tests.integration.runner.podman_engines import Podman
from tests.integration.runner.registry_images import RegistryImages, gzipped
from tests.ports import choose_port
from tests.requirements import missing, need
from tests.slurm_cluster import SlurmCluster

AnEngine = TypeVar("AnEngine", bound=Dockerd)


@dataclass
class Bench:
    """Runs Python text as jobs, each in its own folder, and removes them afterwards.

    `machine` is where a run with an open network finds the machine of its runner.
    """

    executor: Executor
    folder: Path
    next_executor: Callable[[], Executor]
    image: str | None = None
    python: str = sys.executable
    machine: str = "127.0.0.1"
    engine: Dockerd | None = None
    made: list[RunJob] = field(default_factory=list)
    later: list[Executor] = field(default_factory=list)

    def again(self) -> Executor:
        """Return the executor of the next runner on the same jobs."""
        self.later.append(self.next_executor())
        return self.later[-1]

    def job(
        self,
        text: str | Sequence[str],
        *,
        network: Network | None = None,
        port_forwards: Sequence[PortForward] = (),
        **resources: int,
    ) -> RunJob:
        """Return a run that is not started yet; without network, where the executor can keep it from one."""
        usual = Network.none if Network.none in self.executor.abilities.networks else Network.open
        folder = self.folder / f"run-{len(self.made)}"
        (folder / "in").mkdir(parents=True)
        job = RunJob(
            key=f"{folder.name}-{uuid.uuid4().hex}",
            directory=folder,
            command=[self.python, "-c", text] if isinstance(text, str) else list(text),
            image=self.image,
            resources=Resources.model_validate({"memory_bytes": 500_000_000, "time_s": 30, **resources}),
            network=network or usual,
            port_forwards=tuple(port_forwards),
        )
        self.made.append(job)
        return job

    def run(self, text: str | Sequence[str], **resources: int) -> tuple[RunJob, Ending]:
        """Start a run and wait for its end."""
        job = self.job(text, network=None, port_forwards=(), **resources)
        self.executor.submit(job)
        return job, self.end_of(job)

    def end_of(self, job: RunJob) -> Ending:
        """Wait for the end of a run."""
        ending = wait_for_end(self.executor, job, timeout_s=40)
        assert ending is not None, "it goes on"
        return ending

    def with_image(self, image: str) -> Bench:
        """Return the same with another image, forgetting together."""
        return dataclasses.replace(self, image=image)


def log_of(job: RunJob) -> str:
    """Return what a run wrote."""
    path = job.directory / "log"
    return path.read_text() if path.exists() else ""


@pytest.fixture(scope="session")
def docker() -> Iterator[Dockerd]:
    """A Docker daemon for tests, with an image of this Python."""
    yield from _loaded("a Docker", engines.PROGRAMS, engines.dockerd)


@pytest.fixture(scope="session")
def podman() -> Iterator[Podman]:
    """A Podman service for tests, with an image of this Python."""
    yield from _loaded("a Podman", podman_engines.PROGRAMS, podman_engines.podman)


@pytest.fixture(scope="session")
def slurm_site(slurm: SlurmCluster, tmp_path_factory: pytest.TempPathFactory) -> SlurmSite:
    """What the cluster offers."""
    folder = tmp_path_factory.mktemp("slurm-site")
    return find_site(SlurmCommands(slurm.environment), SlurmOptions(max_jobs=8), folder, runner="tests")


def _loaded(
    what: str, programs: Sequence[str], begin: Callable[[str, str], AbstractContextManager[AnEngine]]
) -> Iterator[AnEngine]:
    if os.geteuid() != 0:
        missing(f"{what} of the tests' own needs root")
    need(*programs)
    with engines.bridge() as (name, gateway), begin(name, gateway) as made:
        made.load(engines.IMAGE, root=engines.python_root())
        yield made


@dataclass
class ImageFolder:
    """A registry for tests, with an image of this Python, and a store that has it."""

    registry: RegistryImages
    folder: Path
    image: str

    def store(self) -> ImageStore:
        return ImageStore(self.folder / "images", 10**10, FolderBuilder())


@pytest.fixture(scope="session")
def registry_images(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RegistryImages]:
    """A registry for tests, without a container engine."""
    need("docker-registry")
    registry = engines.Registry(tmp_path_factory.mktemp("registry"), choose_port())
    registry.start()
    yield RegistryImages(registry)
    registry.end()


@pytest.fixture(scope="session")
def image_folder(registry_images: RegistryImages, tmp_path_factory: pytest.TempPathFactory) -> ImageFolder:
    """A store of images without a container engine."""
    image = registry_images.push("kleinkram.test/python", [gzipped(engines.python_root())])
    return ImageFolder(registry_images, tmp_path_factory.mktemp("images"), image)


@pytest.fixture(params=["docker", pytest.param("podman", marks=pytest.mark.soak)])
def engine(request: pytest.FixtureRequest) -> Dockerd:
    """Each container engine."""
    made: Dockerd = request.getfixturevalue(request.param)
    return made


def bench_of(executor: str, request: pytest.FixtureRequest, folder: Path) -> Bench:
    """Return a bench for an executor."""
    if executor == "process":
        return Bench(ProcessExecutor(), folder, ProcessExecutor)
    if executor == "slurm":
        site: SlurmSite = request.getfixturevalue("slurm_site")
        return Bench(SlurmExecutor(site), folder, lambda: SlurmExecutor(site))
    if executor == "fake_kubernetes":
        return fake_kubernetes_bench(request, folder)
    if executor == "slurm_images":
        slurm: SlurmSite = request.getfixturevalue("slurm_site")
        stored: ImageFolder = request.getfixturevalue("image_folder")
        in_images = SlurmExecutor(slurm, images=stored.store())
        image = in_images.prepare_image(stored.image).reference
        return Bench(in_images, folder, lambda: SlurmExecutor(slurm, images=stored.store()), image, "python3")
    if executor == "kubernetes":
        return kubernetes_bench(request, folder)
    if executor == "images":
        images: ImageFolder = request.getfixturevalue("image_folder")
        process = ProcessExecutor(images=images.store())
        reference = process.prepare_image(images.image).reference
        return Bench(process, folder, lambda: ProcessExecutor(images=images.store()), reference, "python3")
    engine: Dockerd = request.getfixturevalue(executor)
    made = DockerExecutor(engine.engine)
    image = made.prepare_image(engines.IMAGE).reference
    return Bench(made, folder, lambda: DockerExecutor(engine.engine), image, "python3", engine.gateway, engine)


def fake_kubernetes_bench(request: pytest.FixtureRequest, folder: Path) -> Bench:
    """Return a bench for a fake cluster whose volumes are the folders of the jobs."""

    made: list[RunJob] = []

    def folder_of(claim: str) -> Path:
        return next(job.directory for job in made if claim == f"klein-{job.key}")

    home = folder / "cluster"
    home.mkdir()
    cluster = FakeCluster(home, folder_of=folder_of)
    request.addfinalizer(cluster.close)
    options = KubernetesOptions(namespace=NAMESPACE, kubeconfig=cluster.kubeconfig())

    def again() -> KubernetesExecutor:
        executor = KubernetesExecutor(
            connect(NAMESPACE, options.kubeconfig),
            options,
            runner="a-runner",
            url="http://127.0.0.1:9",
            token="a-token",
            networks={Network.none, Network.open},
        )
        request.addfinalizer(executor.close)
        return executor

    return Bench(again(), folder, again, f"lab/python@sha256:{'0' * 64}", made=made)


class EmptyVolumeExecutor(KubernetesExecutor):
    """An executor on a real cluster whose jobs have a volume, though nothing was fetched for them."""

    def submit(self, job: RunJob) -> None:
        self._cluster.create("persistentvolumeclaims", self._manifests.volume(job.key, job.resources.disk_bytes))
        for name in ("in", "out"):
            (job.directory / name).mkdir(exist_ok=True)
        super().submit(job)


def kubernetes_bench(request: pytest.FixtureRequest, folder: Path) -> Bench:
    """Return a bench for a real cluster whose volumes are the folders of the jobs."""
    real: RealCluster = request.getfixturevalue("kubernetes")
    made: list[RunJob] = []

    def folder_of(claim: str) -> Path | None:
        return next((job.directory for job in made if claim == f"klein-{job.key}"), None)

    real.volumes.folder_of = folder_of
    options = KubernetesOptions(namespace=NAMESPACE_OF_RUNS, kubeconfig=real.kubeconfig)

    def again() -> KubernetesExecutor:
        cluster = connect(options.namespace, options.kubeconfig)
        executor = EmptyVolumeExecutor(
            cluster, options, runner="a-runner", url="http://127.0.0.1:9", token="a-token", networks={Network.open}
        )
        request.addfinalizer(executor.close)
        return executor

    executor = again()
    image = executor.prepare_image(real.python_image).reference
    return Bench(executor, folder, again, image, "python3", real.cluster.address, made=made)


def lent(executor: str, request: pytest.FixtureRequest, folder: Path) -> Iterator[Bench]:
    """Yield a bench for an executor, and remove its jobs afterwards."""
    made = bench_of(executor, request, folder)
    first = made.executor
    yield made
    for job in made.made:
        made.executor.remove(job)
    for started in (first, *made.later):
        started.close()


# Of this machine: they measure what a job uses, and give it the network `api` by port forwards.
# With `images`, processes run in images.
_LOCAL = [
    "process",
    pytest.param("images", marks=pytest.mark.slow),
    pytest.param("docker", marks=pytest.mark.slow),
]
_FAKE_CLUSTER = pytest.param("fake_kubernetes", marks=pytest.mark.slow)
_CLUSTER = pytest.param("kubernetes", marks=[pytest.mark.slow, pytest.mark.soak])
LOCALLY = pytest.mark.parametrize(
    "bench",
    [
        *_LOCAL,
        pytest.param("podman", marks=pytest.mark.soak),
        pytest.param("slurm", marks=[pytest.mark.slow, pytest.mark.soak]),
    ],
    indirect=True,
)
LOCALLY_EVERYWHERE = pytest.mark.parametrize(
    "bench",
    [*_LOCAL, pytest.param("podman", marks=pytest.mark.slow), pytest.param("slurm", marks=pytest.mark.slow)],
    indirect=True,
)
# What each executor does each time that Docker does: for the rest, the turn of the others is with the long rounds.
EVERYWHERE = pytest.mark.parametrize(
    "bench",
    [
        *_LOCAL,
        pytest.param("podman", marks=pytest.mark.slow),
        pytest.param("slurm", marks=pytest.mark.slow),
        _FAKE_CLUSTER,
        _CLUSTER,
    ],
    indirect=True,
)
# The same, and jobs of Slurm in images.
EVERYWHERE_IN_IMAGES = pytest.mark.parametrize(
    "bench",
    [*EVERYWHERE.args[1], pytest.param("slurm_images", marks=pytest.mark.slow)],
    indirect=True,
)
_EXECUTORS = [
    "process",
    pytest.param("docker", marks=pytest.mark.slow),
    *(
        pytest.param(name, marks=[pytest.mark.slow, pytest.mark.soak])
        for name in ("images", "slurm", "slurm_images", "fake_kubernetes")
    ),
    pytest.param("podman", marks=pytest.mark.soak),
]
# What the real cluster of the tests cannot do: it enforces no network policies, and its volumes have no size.
NOT_ON_THAT_CLUSTER = pytest.mark.parametrize("bench", _EXECUTORS, indirect=True)


@pytest.fixture(params=[*_EXECUTORS, _CLUSTER])
def bench(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Bench]:
    """A bench for each executor."""
    yield from lent(request.param, request, tmp_path)
