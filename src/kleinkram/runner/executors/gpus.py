"""The GPUs of this machine: those that `nvidia-smi`, NVIDIA's driver and CDI specifications list.

CDI (Container Device Interface) is how vendors describe their devices to container engines, in files below `/etc/cdi`
and `/var/run/cdi`; NVIDIA's are written by `nvidia-ctk cdi generate`.
"""

import re
import shutil
import subprocess
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

from kleinkram.client.errors import InvalidInput

OPTION = "The option --gpus"
_QUERY_TIMEOUT_S = 60.0
_SPECIFICATIONS = (".json", ".yaml", ".yml")
_GPU_LINE = re.compile(r"GPU (\d+): (.*) \(UUID: (\S+)\)")
_MIG_LINE = re.compile(r"\s+MIG (\S+)\s+Device\s+(\d+): \(UUID: (\S+)\)")
_UUIDS = ("GPU-", "MIG-")
_NVIDIA = "nvidia.com/gpu"
_ALL = "all"


class GpuSources(NamedTuple):
    """Where the GPUs of a machine are listed."""

    cdi: tuple[Path, ...] = (Path("/etc/cdi"), Path("/var/run/cdi"))
    driver: Path = Path("/proc/driver/nvidia")


SYSTEM = GpuSources()


@dataclass(frozen=True)
class Gpu:
    """A GPU, or a MIG device, which is a slice of one.

    `id` is the UUID of NVIDIA's GPUs, else a name in CDI. `index` is the number in `nvidia-smi`; `0:1` is slice 1 of
    GPU 0. `nodes` are its files below `/dev`, as far as they are known.
    """

    id: str
    model: str = ""
    index: str = ""
    cdi_names: tuple[str, ...] = ()
    nodes: tuple[str, ...] = ()

    @property
    def is_nvidia(self) -> bool:
        """Whether NVIDIA's container runtime knows it by its id."""
        return self.id.startswith(_UUIDS)

    @property
    def is_slice(self) -> bool:
        """Whether it is a MIG device."""
        return self.id.startswith("MIG-")


@dataclass(frozen=True)
class GpuRequest:
    """The GPUs that a runner is to have: those of `names`, else `count` of them, None for all.

    `sharing` is the number of runs that may have the same one.
    """

    count: int | None = 0
    names: tuple[str, ...] = ()
    sharing: int = 1

    @property
    def is_empty(self) -> bool:
        """Whether it is for no GPU."""
        return self.count == 0 and not self.names


def find_gpus(sources: GpuSources | None = None) -> list[Gpu]:
    """Return the GPUs of this machine; of a GPU that is divided into MIG devices, only these.

    Raises:
        InvalidInput: `nvidia-smi` fails, or a CDI specification cannot be read.
    """
    sources = sources or SYSTEM
    devices = _read_cdi(sources.cdi)
    if shutil.which("nvidia-smi") is None:
        nvidia = _gpus_of_driver(sources.driver)
    else:
        nvidia = _with_nodes(_gpus_of_nvidia_smi(), sources.driver)
    if not nvidia:
        return _gpus_of_cdi(devices)
    return [_with_cdi(gpu, devices) for gpu in nvidia] + _gpus_of_cdi(one for one in devices if one.kind != _NVIDIA)


def select_named(gpus: Sequence[Gpu], names: Iterable[str]) -> list[Gpu]:
    """Return the GPUs with these ids, indices or names in CDI.

    Raises:
        InvalidInput: there is none of a name.
    """
    selected: dict[str, Gpu] = {}
    for name in names:
        gpu = next((one for one in gpus if name in (one.id, one.index, *one.cdi_names)), None)
        if gpu is None:
            raise InvalidInput(what="The option --gpu", reason=f"there is no GPU {name}; {list_of(gpus)}")
        selected[gpu.id] = gpu
    return [*selected.values()]


def list_of(gpus: Sequence[Gpu]) -> str:
    """Return a sentence part that lists the GPUs of this machine, or says where they were looked for."""
    if gpus:
        return "this machine has " + ", ".join(f"{gpu.id} ({gpu.index or gpu.model or 'CDI'})" for gpu in gpus)
    return (
        "this machine has none: nvidia-smi and the NVIDIA driver list none, and no CDI specification in /etc/cdi or "
        "/var/run/cdi describes one. Install the driver of the GPU; `nvidia-smi` must list it"
    )


def _gpus_of_nvidia_smi() -> list[Gpu]:
    gpus: list[Gpu] = []
    divided = _divided_gpus()
    index = ""
    for line in _nvidia_smi("-L").splitlines():
        if match := _GPU_LINE.match(line):
            index = match[1]
            if match[3] not in divided:
                gpus.append(Gpu(match[3], match[2], index))
        elif match := _MIG_LINE.match(line):
            gpus.append(Gpu(match[3], f"MIG {match[1]}", f"{index}:{match[2]}"))
    return gpus


def _divided_gpus() -> set[str]:
    """Return the UUIDs of GPUs in MIG mode, which cannot be used as a whole, even without any MIG device."""
    try:
        rows = _nvidia_smi("--query-gpu=uuid,mig.mode.current", "--format=csv,noheader").splitlines()
    except InvalidInput:
        # A driver older than MIG does not know the field; one that fails, fails again.
        return set()
    return {uuid for uuid, _, mode in (row.partition(", ") for row in rows) if mode.strip() == "Enabled"}


def _nvidia_smi(*words: str) -> str:
    try:
        done = subprocess.run(
            ["nvidia-smi", *words], capture_output=True, text=True, check=False, timeout=_QUERY_TIMEOUT_S
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise InvalidInput(what=OPTION, reason=f"nvidia-smi failed: {error}") from error
    if done.returncode != 0:
        output = " ".join((done.stdout + done.stderr).split())
        raise InvalidInput(what=OPTION, reason=f"nvidia-smi failed: {output}")
    return done.stdout


def _gpus_of_driver(driver: Path) -> list[Gpu]:
    """Return the GPUs that the driver lists, where `nvidia-smi` is missing, as in a container.

    Raises:
        InvalidInput: one has MIG devices, whose UUIDs only `nvidia-smi` tells.
    """
    if any(driver.glob("capabilities/gpu*/mig/gi*")):
        raise InvalidInput(what=OPTION, reason="this machine has MIG devices: install nvidia-smi, which lists them")
    return [
        Gpu(fact["GPU UUID"], fact.get("Model", ""), str(index), nodes=(f"/dev/nvidia{fact['Device Minor']}",))
        for index, fact in enumerate(_facts_of_driver(driver))
    ]


def _with_nodes(gpus: Sequence[Gpu], driver: Path) -> list[Gpu]:
    minors = {fact["GPU UUID"]: fact["Device Minor"] for fact in _facts_of_driver(driver)}
    return [replace(gpu, nodes=(f"/dev/nvidia{minors[gpu.id]}",)) if gpu.id in minors else gpu for gpu in gpus]


def _facts_of_driver(driver: Path) -> list[dict[str, str]]:
    """Return what the driver says of each GPU, in the order of the bus, which is that of `nvidia-smi`."""
    facts = []
    for path in sorted(driver.glob("gpus/*/information")):
        pairs = (line.partition(":")[::2] for line in path.read_text().splitlines())
        fact = {name.strip(): value.strip() for name, value in pairs}
        if "GPU UUID" in fact and "Device Minor" in fact:
            facts.append(fact)
    return facts


class CdiDevice(NamedTuple):
    """A device of a CDI specification."""

    kind: str
    name: str
    nodes: tuple[str, ...]

    @property
    def full_name(self) -> str:
        """Its name for engines, such as `nvidia.com/gpu=0`."""
        return f"{self.kind}={self.name}"


def _read_cdi(directories: Iterable[Path]) -> list[CdiDevice]:
    devices: dict[str, CdiDevice] = {}
    for directory in directories:
        for path in sorted(directory.glob("*")):
            if path.suffix in _SPECIFICATIONS:
                # A later folder replaces devices of an earlier one.
                devices |= {device.full_name: device for device in _devices_of(path)}
    return [*devices.values()]


def _devices_of(path: Path) -> list[CdiDevice]:
    """Return the GPUs of a specification. Source: CDI specification, 0.3 to 1.0."""
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    try:
        document: Any = YAML(typ="safe", pure=True).load(path.read_text())
        if not str(document["kind"]).endswith("/gpu"):
            return []
        return [
            CdiDevice(document["kind"], str(device["name"]), _nodes_of(device)) for device in document["devices"] or ()
        ]
    except (OSError, ValueError, YAMLError, LookupError, TypeError) as error:
        reason = " ".join(str(error).split())
        raise InvalidInput(what=f"The CDI specification {path}", reason=reason) from error


def _nodes_of(device: Any) -> tuple[str, ...]:  # Any: a part of a YAML document
    nodes = (device.get("containerEdits") or {}).get("deviceNodes") or ()
    return tuple(str(node.get("hostPath") or node["path"]) for node in nodes)


def _with_cdi(gpu: Gpu, devices: Iterable[CdiDevice]) -> Gpu:
    """Return a GPU of NVIDIA with its names in CDI: its UUID before its number, which may change."""
    own = [one for one in devices if one.kind == _NVIDIA and one.name in (gpu.id, gpu.index)]
    own.sort(key=lambda one: one.name != gpu.id)
    nodes = own[0].nodes if own else gpu.nodes
    return replace(gpu, cdi_names=tuple(one.full_name for one in own), nodes=nodes)


def _gpus_of_cdi(devices: Iterable[CdiDevice]) -> list[Gpu]:
    """Return each GPU of CDI once: specifications give one several names, and one name to all of them."""
    groups: dict[tuple[str, object], list[CdiDevice]] = {}
    for device in devices:
        if device.name != _ALL:
            groups.setdefault((device.kind, frozenset(device.nodes) or device.name), []).append(device)
    gpus = []
    for group in groups.values():
        uuids = [one.name for one in group if one.name.startswith(_UUIDS)]
        index = next((one.name for one in group if one.name not in uuids), "")
        names = tuple(one.full_name for one in sorted(group, key=lambda one: one.name not in uuids))
        gpus.append(Gpu(uuids[0] if uuids else names[0], group[0].kind, index, names, group[0].nodes))
    return gpus
