"""How engines give GPUs to containers: Docker by NVIDIA's runtime or by CDI, Podman by CDI."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from kleinkram.runner.executors.docker.client import EngineInfo
from kleinkram.runner.executors.gpus import Gpu

GPUS_LABEL = "kleinkram.gpus"
# NVIDIA's runtime gives a container what this variable names, and images of CUDA set it to all GPUs.
_VISIBLE_DEVICES = "NVIDIA_VISIBLE_DEVICES"
_NO_DEVICES = "void"
_DRIVER = Path("/proc/driver/nvidia")
_CPU_PERIOD_US = 100_000
_SIZE_UNITS = {"": 1, "k": 10**3, "m": 10**6, "g": 10**9}
_GENERATE = "`nvidia-ctk cdi generate --output=/etc/cdi/nvidia.yaml` (package nvidia-container-toolkit)"
_INSTALL_RUNTIME = (
    "install nvidia-container-toolkit, run `nvidia-ctk runtime configure --runtime=docker`, and restart Docker"
)
_ENABLE_CDI = '{"features": {"cdi": true}} in /etc/docker/daemon.json (Docker 25 or later)'


def gpu_obstacle(gpu: Gpu, engine: EngineInfo) -> str | None:
    """Return why an engine cannot give a GPU to containers, and what to do about that; None where it can."""
    if gpu.is_nvidia and engine.has_nvidia:
        return None
    if engine.has_cdi:
        if gpu.cdi_names:
            return None
        made_by = _GENERATE if gpu.is_nvidia else "the vendor's toolkit"
        return f"no CDI specification in /etc/cdi or /var/run/cdi describes {gpu.id}: write one by {made_by}"
    if gpu.is_nvidia:
        return (
            f"Docker here has no NVIDIA runtime and no CDI, so it cannot give {gpu.id} to runs: {_INSTALL_RUNTIME}; "
            f"or set {_ENABLE_CDI}, and run {_GENERATE}"
        )
    return f"Docker here has no CDI, so it cannot give {gpu.id} to runs: set {_ENABLE_CDI}"


def with_gpus(description: Mapping[str, Any], gpus: Sequence[Gpu], engine: EngineInfo) -> dict[str, Any]:
    """Return the description of a container with exactly these GPUs, whatever variables its image sets."""
    by_runtime = [gpu.id for gpu in gpus if gpu.is_nvidia and engine.has_nvidia]
    by_cdi = [gpu.cdi_names[0] for gpu in gpus if gpu.id not in by_runtime]
    requests: list[dict[str, Any]] = []
    if by_runtime:
        requests.append({"Driver": "nvidia", "DeviceIDs": by_runtime, "Capabilities": [["gpu"]]})
    if by_cdi:
        requests.append({"Driver": "cdi", "DeviceIDs": by_cdi})
    variables = list(description["Env"])
    if engine.has_nvidia or _DRIVER.exists():
        variables.append(f"{_VISIBLE_DEVICES}={','.join(by_runtime) or _NO_DEVICES}")
    labels = dict(description["Labels"])
    if gpus:
        labels[GPUS_LABEL] = ",".join(gpu.id for gpu in gpus)
    host = {**description["HostConfig"], "DeviceRequests": requests}
    return {**description, "Env": variables, "Labels": labels, "HostConfig": host}


def libpod_description(name: str, description: Mapping[str, Any]) -> dict[str, Any]:
    """Return the description of a container for Podman's own API.

    By Docker's API, Podman before 5.4 ignores requests for devices. Source: SpecGenerator of Podman 4.
    """
    host = description["HostConfig"]
    devices = [device for request in host["DeviceRequests"] for device in request["DeviceIDs"]]
    log = host["LogConfig"]
    return {
        "name": name,
        "image": description["Image"],
        "entrypoint": description.get("Entrypoint"),
        "command": description["Cmd"],
        "env": dict(entry.split("=", 1) for entry in description["Env"]),
        "user": description["User"],
        "labels": description["Labels"],
        "healthconfig": description["Healthcheck"],
        "devices": [{"path": device} for device in devices],
        "read_only_filesystem": host["ReadonlyRootfs"],
        "cap_drop": host["CapDrop"],
        "no_new_privileges": "no-new-privileges" in host["SecurityOpt"],
        "privileged": host["Privileged"],
        "ipcns": {"nsmode": host["IpcMode"]},
        "cgroupns": {"nsmode": host["CgroupnsMode"]},
        "netns": {"nsmode": host["NetworkMode"]},
        "restart_policy": host["RestartPolicy"]["Name"],
        "init": host["Init"],
        "hostadd": host["ExtraHosts"],
        "shm_size": host["ShmSize"],
        "oom_score_adj": host["OomScoreAdj"],
        "resource_limits": {
            "cpu": {"quota": host["NanoCpus"] * _CPU_PERIOD_US // 10**9, "period": _CPU_PERIOD_US},
            "memory": {"limit": host["Memory"], "swap": host["MemorySwap"]},
            "pids": {"limit": host["PidsLimit"]},
        },
        "r_limits": [{"type": one["Name"], "soft": one["Soft"], "hard": one["Hard"]} for one in host["Ulimits"]],
        "mounts": [_libpod_mount(mount) for mount in host["Mounts"]],
        "log_configuration": {"driver": log["Type"], "size": _size_bytes(log["Config"]["max-size"])},
    }


def _libpod_mount(mount: Mapping[str, Any]) -> dict[str, Any]:
    options = ["bind", mount["BindOptions"]["Propagation"], "ro" if mount["ReadOnly"] else "rw"]
    return {"type": mount["Type"], "source": mount["Source"], "destination": mount["Target"], "options": options}


def _size_bytes(text: str) -> int:
    match = re.fullmatch(r"(\d+)([kmg]?)", text)
    if match is None:
        raise ValueError(f"{text!r} is not a size")
    return int(match[1]) * _SIZE_UNITS[match[2]]
