"""The options of `klein runner start`, `slurm` and `kubernetes`, in groups of which each command has some.

A group returns the fields of the arguments of a runner that its options set. The package `runner` is imported only when
a command runs.
"""

import platform
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Annotated, Any, Literal, Protocol

import platformdirs

from kleinkram.cli.commands import Many, Text, flag, option
from kleinkram.cli.units import parse_size
from kleinkram.client._resources import checked
from kleinkram.client.errors import InvalidInput

_FOLDER = "kleinkram-runner"
Fields = dict[str, object]


class ExecutorOption(str, Enum):
    """How a runner runs actions."""

    auto = "auto"
    docker = "docker"
    process = "process"


class TransfersOption(str, Enum):
    """Which machine downloads inputs and uploads results."""

    login = "login"
    node = "node"


class ImagesOption(str, Enum):
    """How processes run images."""

    off = "off"
    auto = "auto"
    namespaces = "namespaces"
    apptainer = "apptainer"


class OptionGroup(Protocol):
    """A group of options."""

    def fields(self) -> Fields:
        """Return fields of `Arguments`."""


def _limit(name: str, what: str, default: str) -> Any:  # Any: what `option` returns
    return option(name, "SIZE", f"Limit {what}. Default: {default}.")


def _limit_of_run(name: str, what: str) -> Any:  # Any: what `option` returns
    return option(name, "SIZE", f"Limit {what} of each run.")


@dataclass(frozen=True)
class CommonOptions:
    """What every runner has."""

    name: Annotated[Text, option("--name", "NAME", "Name the runner. Default: the name of this machine.")] = None
    url: Annotated[Text, option("--url", "U", "Set the server. Default: the one in use.")] = None
    token_file: Annotated[
        Path | None,
        option("--token-file", "F", "Read its token from a file with mode 0600. Default: KLEINKRAM_RUNNER_TOKEN."),
    ] = None
    label: Annotated[Many, option("--label", "L", "Add a label that actions can require; repeatable.")] = None
    default_image: Annotated[
        Text, option("--default-image", "IMAGE", "Set the image of scripts. Default: kleinkram/action-python.")
    ] = None
    data_dir: Annotated[Path | None, option("--data-dir", "D", "Set the folder of its runs and inputs.")] = None
    once: Annotated[bool, flag("--once", "End after one run.")] = False
    metrics_port: Annotated[
        int | None,
        option("--metrics-port", "PORT", "Serve Prometheus metrics on this port. Default: none.", min=1, max=65535),
    ] = None
    metrics_address: Annotated[
        str, option("--metrics-address", "ADDRESS", "Serve metrics on this address. They have no access control.")
    ] = "127.0.0.1"
    as_json: Annotated[bool, flag("--json", "Write its log as lines of JSON.")] = False

    def fields(self) -> Fields:
        """Return fields of `Arguments`."""
        from kleinkram.client.config import find_endpoint

        return {
            "url": self.url or find_endpoint().url,
            "name": self.name or platform.node() or "runner",
            "token_file": self.token_file.resolve() if self.token_file else None,
            "labels": self.label or [],
            **({"default_image": self.default_image} if self.default_image else {}),
            "once": self.once,
            "metrics_port": self.metrics_port,
            "metrics_address": self.metrics_address,
            "log_format": "json" if self.as_json else "text",
        }


@dataclass(frozen=True)
class StorageOptions:
    """The folder of a runner whose machine, or cluster, has the files of its runs."""

    disk: Annotated[Text, _limit("--disk", "the disk for runs", "half of the free space")] = None
    cache: Annotated[Text, _limit("--cache", "the cache of inputs", "30 % of the free space")] = None
    cache_age: Annotated[
        int | None,
        option("--cache-age", "DAYS", "Remove cached inputs that no run used for so long. Default: never.", min=1),
    ] = None
    environments: Annotated[Text, _limit("--environments", "the packages of scripts", "10 % of the free space")] = None
    package_index: Annotated[
        Text,
        option(
            "--package-index",
            "URL",
            "Install packages of scripts from this index or folder of wheels; off: none. "
            "Default: KLEINKRAM_PACKAGE_INDEX, else PyPI.",
        ),
    ] = None
    images: Annotated[
        ImagesOption,
        option("--images", None, "Choose how to run images without a container engine; off: only scripts."),
    ] = ImagesOption.off
    image_cache: Annotated[Text, _limit("--image-cache", "these images", "20 % of the free space")] = None
    registry: Annotated[
        Many, option("--registry", "R", "Allow images only from this registry; repeatable. Default: from anywhere.")
    ] = None

    def fields(self) -> Fields:
        """Return fields of `Arguments`."""
        return {
            "disk_bytes": _size_of(self.disk),
            "cache_bytes": _size_of(self.cache),
            "cache_age_days": self.cache_age,
            "environments_bytes": _size_of(self.environments),
            "package_index": self.package_index,
            "images": self.images.value,
            "images_bytes": _size_of(self.image_cache),
            "registries": self.registry or None,
        }


@dataclass(frozen=True)
class MachineOptions:
    """What runs on this machine may have, and how they run."""

    cores: Annotated[float | None, option("--cores", "N", "Limit the cores for runs. Default: all.", min=0.1)] = None
    memory: Annotated[Text, _limit("--memory", "the memory for runs", "80 %")] = None
    gpus: Annotated[Text, option("--gpus", "N", "Set the number of GPUs for runs, or `all`. Default: none.")] = None
    gpu: Annotated[
        Many,
        option("--gpu", "GPU", "Use this GPU for runs: its UUID, number in nvidia-smi, or name in CDI; repeatable."),
    ] = None
    gpu_sharing: Annotated[int, option("--gpu-sharing", "N", "Set how many runs may have the same GPU.", min=1)] = 1
    executor: Annotated[
        ExecutorOption, option("--executor", None, "Choose how to run actions; auto: in containers if possible.")
    ] = ExecutorOption.auto

    def fields(self) -> Fields:
        """Return fields of `Arguments`."""
        return {
            "cores": self.cores,
            "memory_bytes": _size_of(self.memory),
            "gpus": _gpu_count(self.gpus, self.gpu or []),
            "gpu_names": self.gpu or [],
            "gpu_sharing": self.gpu_sharing,
            "executor": self.executor.value,
        }


@dataclass(frozen=True)
class BatchOptions:
    """How jobs of Slurm are submitted."""

    partition: Annotated[Text, option("--partition", "P", "Submit to this partition. Default: Slurm's.")] = None
    account: Annotated[Text, option("--account", "A", "Charge this account. Default: the user's.")] = None
    qos: Annotated[Text, option("--qos", "Q", "Request this quality of service. Default: the account's.")] = None
    constraint: Annotated[Text, option("--constraint", "C", "Use only nodes with these features.")] = None
    max_jobs: Annotated[int, option("--max-jobs", "N", "Limit the jobs in the queue.", min=1, max=1000)] = 20
    max_tasks: Annotated[
        int | None, option("--max-tasks", "N", "Limit the tasks of a job array that run at a time.", min=1)
    ] = None
    sbatch_option: Annotated[
        Many, option("--option", "NAME=VALUE", "Pass a further option to sbatch for all jobs; repeatable.")
    ] = None
    allow_option: Annotated[
        Many, option("--allow-option", "NAME", "Allow actions to set this option of sbatch; repeatable.")
    ] = None
    python: Annotated[Text, option("--python", "PATH", "Run this Python on the nodes. Default: this one.")] = None
    transfers: Annotated[
        TransfersOption,
        option(
            "--transfers", None, "Let the compute nodes move inputs and results, or this machine. Nodes need HTTPS."
        ),
    ] = TransfersOption.login

    def fields(self) -> Fields:
        """Return fields of `Arguments`."""
        from kleinkram.runner.executors.slurm.options import SlurmOptions

        pairs = [text.lstrip("-").partition("=") for text in self.sbatch_option or []]
        options = SlurmOptions(
            max_jobs=self.max_jobs,
            partition=self.partition,
            account=self.account,
            qos=self.qos,
            constraint=self.constraint,
            extra={name: value for name, _, value in pairs},
            allowed=frozenset(entry.lstrip("-") for entry in self.allow_option or []),
            python=self.python,
            max_tasks=self.max_tasks,
            transfers_on_nodes=self.transfers is TransfersOption.node,
        )
        return {"slurm": options}


@dataclass(frozen=True)
class ClusterOptions:
    """How Jobs of Kubernetes are created, and what each may have."""

    namespace: Annotated[str, option("--namespace", "N", "Create Jobs in this namespace.")] = "kleinkram-runs"
    kubeconfig: Annotated[
        Path | None, option("--kubeconfig", "F", "Read this file. Default: the pod's service account, or KUBECONFIG.")
    ] = None
    context: Annotated[Text, option("--context", "C", "Use this context of the file. Default: its current one.")] = None
    pod_image: Annotated[
        Text, option("--pod-image", "IMAGE", "Fetch and store by this image. Default: kleinkram/runner.")
    ] = None
    pull_secret: Annotated[
        Many, option("--pull-secret", "NAME", "Pull images with this Secret of the namespace; repeatable.")
    ] = None
    storage_class: Annotated[
        Text, option("--storage-class", "S", "Create volumes of this class. Default: the cluster's.")
    ] = None
    max_jobs: Annotated[int, option("--max-jobs", "N", "Limit the runs at a time.", min=1, max=1000)] = 10
    cores: Annotated[float, option("--cores", "N", "Limit the cores of each run.", min=0.1)] = 4
    memory: Annotated[str, _limit_of_run("--memory", "the memory")] = "16GB"
    disk: Annotated[str, _limit_of_run("--disk", "the disk")] = "100GB"
    gpus: Annotated[int, option("--gpus", "N", "Limit the GPUs of each run.", min=0)] = 0
    gpu_resource: Annotated[str, option("--gpu-resource", "R", "Request GPUs by this name.")] = "nvidia.com/gpu"
    node_selector: Annotated[
        Many, option("--node-selector", "KEY=VALUE", "Use only nodes with this label; repeatable.")
    ] = None
    gpu_node_selector: Annotated[
        Many, option("--gpu-node-selector", "KEY=VALUE", "For runs with GPUs, only nodes with this one; repeatable.")
    ] = None
    toleration: Annotated[
        Many, option("--toleration", "KEY[=VALUE][:EFFECT]", "Tolerate this taint of nodes; repeatable.")
    ] = None
    gpu_toleration: Annotated[
        Many, option("--gpu-toleration", "KEY[=VALUE][:EFFECT]", "For runs with GPUs, tolerate this one; repeatable.")
    ] = None
    priority_class: Annotated[Text, option("--priority-class", "P", "Give pods this priority class.")] = None
    allow_metadata_access: Annotated[
        bool,
        option(
            "--allow-metadata-access",
            None,
            "Offer open networks though they reach the cloud's metadata service, and so credentials of nodes.",
        ),
    ] = False
    user: Annotated[
        int, option("--user", "UID", "Run pods as this user; 0: as the one that the cluster chooses.", min=0)
    ] = 10_001

    def fields(self) -> Fields:
        """Return fields of `Arguments`."""
        from kleinkram.runner.executors.kubernetes.options import KubernetesOptions, Toleration

        def tolerations(name: str, texts: list[str] | None) -> list[Toleration]:
            return [checked(Toleration, name, **Toleration.split(text)) for text in texts or []]

        options: Fields = {
            "namespace": self.namespace,
            "kubeconfig": self.kubeconfig.expanduser().resolve() if self.kubeconfig else None,
            "context": self.context,
            "pull_secrets": self.pull_secret or [],
            "storage_class": self.storage_class,
            "max_jobs": self.max_jobs,
            "cores": self.cores,
            "memory_bytes": parse_size(self.memory),
            "disk_bytes": parse_size(self.disk),
            "gpus": self.gpus,
            "gpu_resource": self.gpu_resource,
            "node_selector": _selector("--node-selector", self.node_selector),
            "gpu_node_selector": _selector("--gpu-node-selector", self.gpu_node_selector),
            "tolerations": tolerations("--toleration", self.toleration),
            "gpu_tolerations": tolerations("--gpu-toleration", self.gpu_toleration),
            "priority_class": self.priority_class,
            "allow_metadata_access": self.allow_metadata_access,
            "run_as_user": self.user or None,
            **({"pod_image": self.pod_image} if self.pod_image else {}),
        }
        return {"kubernetes": checked(KubernetesOptions, "The runner", **options)}


def runner_command(common: CommonOptions, *groups: OptionGroup, suffix: str = "") -> list[str]:
    """Return the command line of a runner with these options; its default folder ends with `suffix`.

    Raises:
        InvalidInput: a value is not possible.
    """
    from kleinkram.runner.arguments import Arguments

    folder = common.data_dir or Path(platformdirs.user_data_dir(f"{_FOLDER}{suffix}"))
    fields: Fields = {"data_dir": folder.expanduser().resolve()}
    for group in (common, *groups):
        fields |= group.fields()
    return checked(Arguments, "The runner", **fields).command()


def _size_of(text: str | None) -> int | None:
    return parse_size(text) if text else None


def _gpu_count(text: str | None, names: list[str]) -> int | Literal["all"]:
    if text is not None and names:
        raise InvalidInput(what="The option --gpus", reason="--gpu chooses the GPUs already")
    if text == "all":
        return "all"
    if text is not None and not text.isdecimal():
        raise InvalidInput(what="The option --gpus", reason=f"{text!r} is neither a number nor `all`")
    return int(text or 0)


def _selector(name: str, texts: list[str] | None) -> dict[str, str]:
    pairs = [text.partition("=") for text in texts or []]
    for key, equals, _ in pairs:
        if not key or not equals:
            raise InvalidInput(what=f"The option {name}", reason="it is KEY=VALUE")
    return {key: value for key, _, value in pairs}
