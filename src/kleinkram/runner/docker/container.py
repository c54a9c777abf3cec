"""The container of a run, as engines are told to make it: what a run may have, and nothing else."""

import resource
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from kleinkram.contract.actions import Network
from kleinkram.runner import doors
from kleinkram.runner.docker import gate
from kleinkram.runner.docker.engine import Image
from kleinkram.runner.work import Work

RUN_LABEL = "kleinkram.run"
RUNNER_LABEL = "kleinkram.runner"
_PROCESSES = 1024
# Of its user, who is the runner itself where that is not root: `_PROCESSES` is what bounds a run.
_PROCESSES_OF_USER = 2**15
# Old programs go through all that they may have open whenever they start another one: a million make them slow.
_OPEN_FILES = 2**16
# Podman has a timer look even for a check that is switched off.
_HEALTH_EVERY_NS = 24 * 3600 * 10**9
_SHARED_MEMORY_BYTES = 64 * 2**20
# A file may be so much larger than what all may be: else nobody could tell that it was the disk.
_FILE_BEYOND_DISK_BYTES = 64 * 2**20
# What an engine keeps of an output until it is read: more than a log may be.
_LOG = {"Type": "json-file", "Config": {"max-size": "128m", "max-file": "2"}}
_OWN_FOLDERS = ("/in", "/out", "/tmp")  # noqa: S108  the run's own


def name_of(work: Work) -> str:
    """Return what a run's container is called."""
    return f"kleinkram-{work.key}"


def describe(work: Work, user: str, volumes: Sequence[str], runner: str) -> dict[str, object]:
    """Return the description of a run's container. `volumes`: where its image wants to write besides."""
    environment = {"HOME": "/tmp", "TMPDIR": "/tmp", "PYTHONUNBUFFERED": "1", **work.environment}  # noqa: S108
    return {
        "Image": work.image,
        "Cmd": list(work.command) or None,
        "Env": [f"{name}={value}" for name, value in environment.items()],
        "User": user,
        "Labels": {RUN_LABEL: work.key, RUNNER_LABEL: runner},
        "Healthcheck": {"Test": ["NONE"], "Interval": _HEALTH_EVERY_NS},
        "HostConfig": {**_bounds(work), **_walls(work), "Mounts": _mounts(work, volumes)},
    }


def gated(described: Mapping[str, Any], work: Work, image: Image) -> dict[str, object]:
    """Return a container's description with its command behind a gate; without a command, the engine is to say so."""
    command = [*image.entry, *(work.command or image.command)]
    if not command:
        return dict(described)
    pipe = gate.make(work.folder, int(described["User"].partition(":")[0]))
    mounts = [*described["HostConfig"]["Mounts"], _bind(pipe, gate.INSIDE, read_only=True)]
    host = {**described["HostConfig"], "Mounts": mounts}
    return {**described, "Entrypoint": list(gate.WAITING), "Cmd": command, "HostConfig": host}


def _bounds(work: Work) -> dict[str, object]:
    wanted = work.resources
    largest = wanted.disk_bytes + _FILE_BEYOND_DISK_BYTES
    gpus = [{"Driver": "nvidia", "Count": wanted.gpus, "Capabilities": [["gpu"]]}] if wanted.gpus else []
    return {
        "NanoCpus": int(wanted.cores * 1e9),
        "Memory": wanted.memory_bytes,
        "MemorySwap": wanted.memory_bytes,
        "PidsLimit": _PROCESSES,
        "ShmSize": _SHARED_MEMORY_BYTES,
        "Ulimits": [
            {"Name": "core", "Soft": 0, "Hard": 0},
            {"Name": "fsize", "Soft": largest, "Hard": largest},
            # Left to Podman these would be a million each, which it may not give where it lacks some of root's rights.
            _limit("nofile", resource.RLIMIT_NOFILE, _OPEN_FILES),
            _limit("nproc", resource.RLIMIT_NPROC, _PROCESSES_OF_USER),
        ],
        "DeviceRequests": gpus,
        "OomScoreAdj": 1000,
        "LogConfig": _LOG,
    }


def _limit(name: str, kind: int, wanted: int) -> dict[str, object]:
    """Return a bound of the kernel, no higher than this runner's own."""
    mine = resource.getrlimit(kind)[1]
    given = wanted if mine == resource.RLIM_INFINITY else min(wanted, mine)
    return {"Name": name, "Soft": given, "Hard": given}


def _walls(work: Work) -> dict[str, object]:
    names = doors.names_of([door.host for door in work.doors])
    return {
        "NetworkMode": "bridge" if work.network is Network.open else "none",
        "ExtraHosts": [f"{name}:{address}" for name, address in names.items()],
        "ReadonlyRootfs": True,
        "CapDrop": ["ALL"],
        "SecurityOpt": ["no-new-privileges"],
        "Privileged": False,
        "IpcMode": "private",
        "CgroupnsMode": "private",
        "RestartPolicy": {"Name": "no"},
        # Reaps what is left behind, and is not shielded from signals as a first process is.
        "Init": True,
    }


def _mounts(work: Work, volumes: Sequence[str]) -> list[dict[str, object]]:
    made = [_bind(work.folder / each[1:], each, read_only=each == "/in") for each in _OWN_FOLDERS]
    # Left to the engine, they would be folders of its own without any bound.
    others = [each for each in volumes if each.rstrip("/") not in _OWN_FOLDERS]
    return made + [_bind(volume_folder(work, number), each) for number, each in enumerate(others)]


def volume_folder(work: Work, number: int) -> Path:
    """Return where a volume that the image wants is: it is counted with `/tmp`."""
    return work.folder / "tmp" / f".volume-{number}"


def _bind(source: Path, target: str, *, read_only: bool = False) -> dict[str, object]:
    return {
        "Type": "bind",
        "Source": str(source.absolute()),
        "Target": target,
        "ReadOnly": read_only,
        "BindOptions": {"Propagation": "rprivate"},
    }
