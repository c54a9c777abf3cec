"""`klein runner …`. The package `runner` is imported only when a command runs."""

import os
import platform
from enum import Enum
from pathlib import Path
from typing import Annotated, Any, Literal

import platformdirs

from kleinkram.cli.commands import Many, Subcommands, Text, flag, option
from kleinkram.cli.render import Output, as_table, moment
from kleinkram.cli.units import parse_size, size
from kleinkram.client import Client
from kleinkram.client._resources import checked
from kleinkram.client.errors import InvalidInput
from kleinkram.contract.runners import RunnerRead

app = Subcommands("Run and list runners: machines that run actions.")
_FOLDER = "kleinkram-runner"


class ExecutorOption(str, Enum):
    """How a runner runs actions."""

    auto = "auto"
    docker = "docker"
    process = "process"


class TransfersOption(str, Enum):
    """Which machine downloads inputs and uploads results."""

    login = "login"
    node = "node"


_Transfers = Annotated[
    TransfersOption,
    option("--transfers", None, "Let the compute nodes move inputs and results, or this machine. Nodes need HTTPS."),
]


class ImagesOption(str, Enum):
    """How processes run images."""

    off = "off"
    auto = "auto"
    namespaces = "namespaces"
    apptainer = "apptainer"


_TokenFile = Annotated[
    Path | None,
    option("--token-file", "F", "Read its token from a file with mode 0600. Default: KLEINKRAM_RUNNER_TOKEN."),
]
_PackageIndex = Annotated[
    Text,
    option(
        "--package-index",
        "URL",
        "Install packages of scripts from this index or folder of wheels; off: none. "
        "Default: KLEINKRAM_PACKAGE_INDEX, else PyPI.",
    ),
]
_Executor = Annotated[
    ExecutorOption, option("--executor", None, "Choose how to run actions; auto: in containers if possible.")
]
_Images = Annotated[
    ImagesOption,
    option("--images", None, "Choose how to run images without a container engine; off: only scripts."),
]
_DefaultImage = Annotated[
    Text, option("--default-image", "IMAGE", "Set the image of scripts. Default: kleinkram/action-python.")
]
_Registries = Annotated[
    Many, option("--registry", "R", "Allow images only from this registry; repeatable. Default: from anywhere.")
]
_Gpu = Annotated[
    Many, option("--gpu", "GPU", "Use this GPU for runs: its UUID, number in nvidia-smi, or name in CDI; repeatable.")
]

_MetricsPort = Annotated[
    int | None,
    option("--metrics-port", "PORT", "Serve Prometheus metrics on this port. Default: none.", min=1, max=65535),
]
_MetricsAddress = Annotated[
    str, option("--metrics-address", "ADDRESS", "Serve metrics on this address. They have no access control.")
]


def _limit(name: str, what: str, default: str) -> Any:  # Any: what `option` returns
    return option(name, "SIZE", f"Limit {what}. Default: {default}.")


def _limit_of_run(name: str, what: str) -> Any:  # Any: what `option` returns
    return option(name, "SIZE", f"Limit {what} of each run.")


_Name = Annotated[Text, option("--name", "NAME", "Name the runner. Default: the name of this machine.")]
_Url = Annotated[Text, option("--url", "U", "Set the server. Default: the one in use.")]
_Labels = Annotated[Many, option("--label", "L", "Add a label that actions can require; repeatable.")]
_Disk = Annotated[Text, _limit("--disk", "the disk for runs", "half of the free space")]
_Cache = Annotated[Text, _limit("--cache", "the cache of inputs", "30 % of the free space")]
_CacheAge = Annotated[
    int | None,
    option("--cache-age", "DAYS", "Remove cached inputs that no run used for so long. Default: never.", min=1),
]
_ImageCache = Annotated[Text, _limit("--image-cache", "these images", "20 % of the free space")]
_Environments = Annotated[Text, _limit("--environments", "the packages of scripts", "10 % of the free space")]
_DataDir = Annotated[Path | None, option("--data-dir", "D", "Set the folder of its runs and inputs.")]
_Once = Annotated[bool, flag("--once", "End after one run.")]
_Json = Annotated[bool, flag("--json", "Write its log as lines of JSON.")]


@app.command("start")
def start(
    name: _Name = None,
    url: _Url = None,
    token_file: _TokenFile = None,
    label: _Labels = None,
    cores: Annotated[float | None, option("--cores", "N", "Limit the cores for runs. Default: all.", min=0.1)] = None,
    memory: Annotated[Text, _limit("--memory", "the memory for runs", "80 %")] = None,
    disk: _Disk = None,
    cache: _Cache = None,
    cache_age: _CacheAge = None,
    environments: _Environments = None,
    package_index: _PackageIndex = None,
    gpus: Annotated[Text, option("--gpus", "N", "Set the number of GPUs for runs, or `all`. Default: none.")] = None,
    gpu: _Gpu = None,
    gpu_sharing: Annotated[int, option("--gpu-sharing", "N", "Set how many runs may have the same GPU.", min=1)] = 1,
    executor: _Executor = ExecutorOption.auto,
    images: _Images = ImagesOption.off,
    image_cache: _ImageCache = None,
    default_image: _DefaultImage = None,
    registry: _Registries = None,
    data_dir: _DataDir = None,
    once: _Once = False,
    metrics_port: _MetricsPort = None,
    metrics_address: _MetricsAddress = "127.0.0.1",
    as_json: _Json = False,
) -> None:
    """Run actions on this machine. Ctrl-C ends the runner and its runs; SIGTERM leaves its runs to the next one."""
    from kleinkram.client.config import find_endpoint
    from kleinkram.runner.arguments import DEFAULT_IMAGE, Arguments, ExecutorChoice, ImageChoice

    arguments = Arguments(
        url=url or find_endpoint().url,
        data_dir=_folder_of(data_dir, _FOLDER),
        name=name or platform.node() or "runner",
        token_file=token_file.resolve() if token_file else None,
        labels=label or [],
        cores=cores,
        memory_bytes=_size_of(memory),
        disk_bytes=_size_of(disk),
        cache_bytes=_size_of(cache),
        cache_age_days=cache_age,
        environments_bytes=_size_of(environments),
        package_index=package_index,
        gpus=_gpu_count(gpus, gpu or []),
        gpu_names=gpu or [],
        gpu_sharing=gpu_sharing,
        executor=ExecutorChoice(executor.value),
        images=ImageChoice(images.value),
        images_bytes=parse_size(image_cache) if image_cache else None,
        default_image=default_image or DEFAULT_IMAGE,
        registries=registry or None,
        once=once,
        metrics_port=metrics_port,
        metrics_address=metrics_address,
        log_format="json" if as_json else "text",
    )
    _become(arguments.command())


@app.command("slurm")
def slurm(
    partition: Annotated[Text, option("--partition", "P", "Submit to this partition. Default: Slurm's.")] = None,
    account: Annotated[Text, option("--account", "A", "Charge this account. Default: the user's.")] = None,
    qos: Annotated[Text, option("--qos", "Q", "Request this quality of service. Default: the account's.")] = None,
    constraint: Annotated[Text, option("--constraint", "C", "Use only nodes with these features.")] = None,
    max_jobs: Annotated[int, option("--max-jobs", "N", "Limit the jobs in the queue.", min=1, max=1000)] = 20,
    max_tasks: Annotated[
        int | None, option("--max-tasks", "N", "Limit the tasks of a job array that run at a time.", min=1)
    ] = None,
    sbatch_option: Annotated[
        Many, option("--option", "NAME=VALUE", "Pass a further option to sbatch for all jobs; repeatable.")
    ] = None,
    allow_option: Annotated[
        Many, option("--allow-option", "NAME", "Allow actions to set this option of sbatch; repeatable.")
    ] = None,
    python: Annotated[Text, option("--python", "PATH", "Run this Python on the nodes. Default: this one.")] = None,
    transfers: _Transfers = TransfersOption.login,
    images: _Images = ImagesOption.off,
    image_cache: _ImageCache = None,
    default_image: _DefaultImage = None,
    registry: _Registries = None,
    name: _Name = None,
    url: _Url = None,
    token_file: _TokenFile = None,
    label: _Labels = None,
    disk: _Disk = None,
    cache: _Cache = None,
    cache_age: _CacheAge = None,
    environments: _Environments = None,
    package_index: _PackageIndex = None,
    data_dir: _DataDir = None,
    once: _Once = False,
    metrics_port: _MetricsPort = None,
    metrics_address: _MetricsAddress = "127.0.0.1",
    as_json: _Json = False,
) -> None:
    """Run actions as jobs of Slurm, from a login node. Its folder must be on a file system that all nodes see."""
    from kleinkram.client.config import find_endpoint
    from kleinkram.runner.arguments import DEFAULT_IMAGE, Arguments, ImageChoice
    from kleinkram.runner.executors.slurm.options import SlurmOptions

    arguments = Arguments(
        url=url or find_endpoint().url,
        data_dir=_folder_of(data_dir, f"{_FOLDER}-slurm"),
        name=name or platform.node() or "runner",
        token_file=token_file.resolve() if token_file else None,
        labels=label or [],
        disk_bytes=_size_of(disk),
        cache_bytes=_size_of(cache),
        cache_age_days=cache_age,
        environments_bytes=_size_of(environments),
        package_index=package_index,
        images=ImageChoice(images.value),
        images_bytes=_size_of(image_cache),
        default_image=default_image or DEFAULT_IMAGE,
        registries=registry or None,
        slurm=SlurmOptions(
            max_jobs=max_jobs,
            partition=partition,
            account=account,
            qos=qos,
            constraint=constraint,
            extra=_sbatch_options(sbatch_option or []),
            allowed=frozenset(entry.lstrip("-") for entry in allow_option or []),
            python=python,
            max_tasks=max_tasks,
            transfers_on_nodes=transfers is TransfersOption.node,
        ),
        once=once,
        metrics_port=metrics_port,
        metrics_address=metrics_address,
        log_format="json" if as_json else "text",
    )
    _become(arguments.command())


def _sbatch_options(texts: list[str]) -> dict[str, str]:
    pairs = (text.lstrip("-").partition("=") for text in texts)
    return {name: value for name, _, value in pairs}


def _folder_of(data_dir: Path | None, default: str) -> Path:
    return (data_dir or Path(platformdirs.user_data_dir(default))).expanduser().resolve()


def _size_of(text: str | None) -> int | None:
    return parse_size(text) if text else None


def _become(command: list[str]) -> None:
    # A runner runs for a long time; its own process needs less memory than this one.
    os.execv(command[0], command)  # noqa: S606  (our own interpreter, no shell)


def _gpu_count(text: str | None, names: list[str]) -> int | Literal["all"]:
    if text is not None and names:
        raise InvalidInput(what="The option --gpus", reason="--gpu chooses the GPUs already")
    if text == "all":
        return "all"
    if text is not None and not text.isdecimal():
        raise InvalidInput(what="The option --gpus", reason=f"{text!r} is neither a number nor `all`")
    return int(text or 0)


@app.command("kubernetes")
def kubernetes(
    namespace: Annotated[str, option("--namespace", "N", "Create Jobs in this namespace.")] = "kleinkram-runs",
    kubeconfig: Annotated[
        Path | None, option("--kubeconfig", "F", "Read this file. Default: the pod's service account, or KUBECONFIG.")
    ] = None,
    context: Annotated[
        Text, option("--context", "C", "Use this context of the file. Default: its current one.")
    ] = None,
    pod_image: Annotated[
        Text, option("--pod-image", "IMAGE", "Fetch and store by this image. Default: kleinkram/runner.")
    ] = None,
    default_image: _DefaultImage = None,
    pull_secret: Annotated[
        Many, option("--pull-secret", "NAME", "Pull images with this Secret of the namespace; repeatable.")
    ] = None,
    storage_class: Annotated[
        Text, option("--storage-class", "S", "Create volumes of this class. Default: the cluster's.")
    ] = None,
    max_jobs: Annotated[int, option("--max-jobs", "N", "Limit the runs at a time.", min=1, max=1000)] = 10,
    cores: Annotated[float, option("--cores", "N", "Limit the cores of each run.", min=0.1)] = 4,
    memory: Annotated[str, _limit_of_run("--memory", "the memory")] = "16GB",
    disk: Annotated[str, _limit_of_run("--disk", "the disk")] = "100GB",
    gpus: Annotated[int, option("--gpus", "N", "Limit the GPUs of each run.", min=0)] = 0,
    gpu_resource: Annotated[str, option("--gpu-resource", "R", "Request GPUs by this name.")] = "nvidia.com/gpu",
    node_selector: Annotated[
        Many, option("--node-selector", "KEY=VALUE", "Use only nodes with this label; repeatable.")
    ] = None,
    gpu_node_selector: Annotated[
        Many, option("--gpu-node-selector", "KEY=VALUE", "For runs with GPUs, only nodes with this one; repeatable.")
    ] = None,
    toleration: Annotated[
        Many, option("--toleration", "KEY[=VALUE][:EFFECT]", "Tolerate this taint of nodes; repeatable.")
    ] = None,
    gpu_toleration: Annotated[
        Many, option("--gpu-toleration", "KEY[=VALUE][:EFFECT]", "For runs with GPUs, tolerate this one; repeatable.")
    ] = None,
    priority_class: Annotated[Text, option("--priority-class", "P", "Give pods this priority class.")] = None,
    user: Annotated[
        int, option("--user", "UID", "Run pods as this user; 0: as the one that the cluster chooses.", min=0)
    ] = 10_001,
    name: _Name = None,
    url: _Url = None,
    token_file: _TokenFile = None,
    label: _Labels = None,
    data_dir: _DataDir = None,
    once: _Once = False,
    metrics_port: _MetricsPort = None,
    metrics_address: _MetricsAddress = "127.0.0.1",
    as_json: _Json = False,
) -> None:
    """Run actions as Jobs of a Kubernetes cluster, from inside or outside of it. SIGTERM leaves runs to the next."""
    from kleinkram.client.config import find_endpoint
    from kleinkram.runner.arguments import DEFAULT_IMAGE, Arguments
    from kleinkram.runner.executors.kubernetes.options import KubernetesOptions, Toleration

    options: dict[str, object] = {
        "namespace": namespace,
        "kubeconfig": kubeconfig.expanduser().resolve() if kubeconfig else None,
        "context": context,
        "pull_secrets": pull_secret or [],
        "storage_class": storage_class,
        "max_jobs": max_jobs,
        "cores": cores,
        "memory_bytes": parse_size(memory),
        "disk_bytes": parse_size(disk),
        "gpus": gpus,
        "gpu_resource": gpu_resource,
        "node_selector": _selector(node_selector, "--node-selector"),
        "gpu_node_selector": _selector(gpu_node_selector, "--gpu-node-selector"),
        "tolerations": [checked(Toleration, "--toleration", **Toleration.split(text)) for text in toleration or []],
        "gpu_tolerations": [
            checked(Toleration, "--gpu-toleration", **Toleration.split(text)) for text in gpu_toleration or []
        ],
        "priority_class": priority_class,
        "run_as_user": user or None,
        **({"pod_image": pod_image} if pod_image else {}),
    }
    arguments = Arguments(
        url=url or find_endpoint().url,
        data_dir=_folder_of(data_dir, f"{_FOLDER}-kubernetes"),
        name=name or platform.node() or "runner",
        token_file=token_file.resolve() if token_file else None,
        labels=label or [],
        kubernetes=checked(KubernetesOptions, "The runner", **options),
        default_image=default_image or DEFAULT_IMAGE,
        once=once,
        metrics_port=metrics_port,
        metrics_address=metrics_address,
        log_format="json" if as_json else "text",
    )
    _become(arguments.command())


def _selector(texts: list[str] | None, name: str) -> dict[str, str]:
    pairs = [text.partition("=") for text in texts or []]
    for key, equals, _ in pairs:
        if not key or not equals:
            raise InvalidInput(what=f"The option {name}", reason="it is KEY=VALUE")
    return {key: value for key, _, value in pairs}


@app.command("list")
def list_(client: Client) -> Output:
    """List the runners; for admins."""
    headers = ["name", "seen", "runs", "executor", "isolation", "cores", "memory", "gpus", "labels", "lease", "token"]
    return as_table(client.runners.list(), [*headers, "version", "id"], _cells)


def _cells(row: RunnerRead) -> tuple[object, ...]:
    token = None
    if row.token is not None:
        limits = [f"project {project.name}" for project in row.token.projects or []]
        limits += [f"label {label}" for label in row.token.labels or []]
        token = f"{row.token.name} (only {', '.join(limits)})" if limits else row.token.name
    seen = "now" if row.is_alive else moment(row.last_seen_at)
    executor = (row.abilities.executor, row.abilities.isolation.value)
    resources = (f"{row.capacity.cores:g}", size(row.capacity.memory_bytes), row.capacity.gpus)
    more = (", ".join(row.labels) or None, f"{row.lease_s} s", token)
    return row.name, seen, row.active_runs, *executor, *resources, *more, row.version, row.id
