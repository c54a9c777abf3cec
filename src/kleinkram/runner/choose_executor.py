"""Chooses the executor of a runner, or of a local run."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from kleinkram.client.errors import InvalidInput
from kleinkram.contract.isolation import Isolation
from kleinkram.environments.cache import EnvironmentCache
from kleinkram.environments.local import local_index
from kleinkram.environments.uv import PackageIndex
from kleinkram.runner.arguments import ExecutorChoice, ImageChoice
from kleinkram.runner.executors import process_sandbox
from kleinkram.runner.executors.base import CannotStart, Executor
from kleinkram.runner.executors.docker.client import DockerClient, EngineError, EngineUnavailable, find_socket
from kleinkram.runner.executors.docker.executor import DockerExecutor
from kleinkram.runner.executors.kubernetes.cluster import connect
from kleinkram.runner.executors.kubernetes.executor import KubernetesExecutor
from kleinkram.runner.executors.kubernetes.options import KubernetesOptions
from kleinkram.runner.executors.local import Machine
from kleinkram.runner.executors.process import ProcessExecutor
from kleinkram.runner.executors.slurm.commands import SlurmCommands
from kleinkram.runner.executors.slurm.executor import SlurmExecutor
from kleinkram.runner.executors.slurm.options import SlurmOptions
from kleinkram.runner.executors.slurm.probe import find_site
from kleinkram.runner.images.apptainer import Apptainer, find_apptainer
from kleinkram.runner.images.names import Pull
from kleinkram.runner.images.store import FolderBuilder, ImageBuilder, ImageFailure, ImageStore

_log = logging.getLogger("kleinkram.runner")


@dataclass(frozen=True)
class ImagePolicy:
    """Which images may be pulled, and when. `allowed`: registries, or namespaces of them; None for all."""

    pull: Pull = Pull.missing
    allowed: Sequence[str] | None = None


def find_index(text: str | None) -> PackageIndex | None:
    """Return the package index of this name, else of the environment, else PyPI; None where it is `off`.

    Raises:
        InvalidInput: it is neither the URL of an index nor a folder.
    """
    try:
        return local_index(text)
    except ValueError as error:
        raise InvalidInput(what="The package index", reason=str(error)) from None


def choose_executor(
    choice: ExecutorChoice,
    policy: ImagePolicy,
    default_image: str,
    *,
    images: ImageChoice = ImageChoice.off,
    runner: str = "local",
    machine: Machine | None = None,
    environments: EnvironmentCache | None = None,
) -> Executor:
    """Return the executor of a runner. The default image may be pulled first, which may take long.

    `environments` are those of scripts; by default the machine's. `images` is how processes run images.

    Raises:
        InvalidInput: `choice` is `docker`, and no engine answers; it cannot give the GPUs of the machine to runs; or
            `images` is not possible here.
    """
    socket = None if choice is ExecutorChoice.process else find_socket()
    if choice is ExecutorChoice.docker and socket is None:
        raise InvalidInput(what="The executor docker", reason="no socket of a container engine was found")
    if socket is not None:
        try:
            client = DockerClient(socket)
            containers = DockerExecutor(
                client, machine, runner=runner, pull=policy.pull, allowed=policy.allowed, environments=environments
            )
            if choice is ExecutorChoice.auto:
                containers.prepare_image(default_image)
            containers.check_gpus()
            return containers
        except (EngineUnavailable, EngineError) as error:
            if choice is ExecutorChoice.docker:
                raise InvalidInput(what="The executor docker", reason=str(error)) from error
            _log.info("no container engine answers (%s): scripts run as processes", error)
        except CannotStart as error:
            _log.warning(
                "%s So scripts run as processes, and images do not run; to change this: --executor docker", error
            )
    elif choice is ExecutorChoice.auto:
        _log.info("no socket of a container engine was found: scripts run as processes")
    has_namespaces = process_sandbox.is_available()
    store = _image_store(images, policy, default_image, machine, has_namespaces=has_namespaces)
    executor = ProcessExecutor(machine, environments, store)
    executor.check_gpus()
    if executor.abilities.isolation is Isolation.none:
        _log.warning("this kernel allows this user no namespaces: runs can read and change whatever the runner can")
    return executor


def slurm_executor(
    options: SlurmOptions,
    directory: Path,
    policy: ImagePolicy,
    default_image: str,
    *,
    images: ImageChoice,
    runner: str,
    machine: Machine,
) -> Executor:
    """Return the executor of a runner on a login node of Slurm, whose folder all nodes see.

    Raises:
        InvalidInput: Slurm does not answer, its nodes cannot run jobs of this folder, or `images` is not possible.
    """
    site = find_site(SlurmCommands(), options, directory, runner=runner)
    if not site.node.is_isolated:
        _log.warning("the nodes allow this user no namespaces: runs can read and change whatever this user can")
    store = _image_store(images, policy, default_image, machine, has_namespaces=site.node.is_isolated)
    return SlurmExecutor(site, runner=runner, machine=machine, images=store)


def kubernetes_executor(options: KubernetesOptions, *, runner: str, url: str, token: str) -> Executor:
    """Return the executor of a runner on a cluster, once pods there have shown which networks they can have.

    Raises:
        InvalidInput: there is no configuration of a cluster.
    """
    cluster = connect(options.namespace, options.kubeconfig, options.context)
    executor = KubernetesExecutor(cluster, options, runner=runner, url=url, token=token)
    executor.find_abilities()
    return executor


def _image_store(
    choice: ImageChoice, policy: ImagePolicy, default_image: str, machine: Machine | None, *, has_namespaces: bool
) -> ImageStore | None:
    if choice is ImageChoice.off or machine is None:
        return None
    apptainer = find_apptainer()
    if choice is ImageChoice.namespaces and not has_namespaces:
        raise InvalidInput(what="--images namespaces", reason="this kernel allows this user no namespaces")
    if choice is ImageChoice.apptainer and apptainer is None:
        raise InvalidInput(what="--images apptainer", reason="there is no program apptainer in PATH")
    builder: ImageBuilder
    if has_namespaces and choice is not ImageChoice.apptainer:
        builder = FolderBuilder()
    elif apptainer is not None:
        builder = Apptainer(apptainer)
    else:
        _log.warning("images do not run: this kernel allows this user no namespaces, and Apptainer is not installed")
        return None
    store = ImageStore(machine.images_folder, machine.images_bytes, builder, pull=policy.pull, allowed=policy.allowed)
    if choice is ImageChoice.auto:
        try:
            store.prepare(default_image)
        except ImageFailure as error:
            _log.warning("%s So images do not run; to change this: --images namespaces, or --default-image", error)
            return None
    return store
