"""Containers of jobs: their descriptions, the start barrier, resource usage, and errors of their init processes."""

import contextlib
import os
import re
import resource
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from kleinkram.contract.actions import Network
from kleinkram.runner.executors.base import RunJob
from kleinkram.runner.executors.docker.client import ImageInfo
from kleinkram.runner.executors.port_forward import host_entries

JOB_LABEL = "kleinkram.run"
RUNNER_LABEL = "kleinkram.runner"
# The size of the log of the job when the container was created: what earlier starts of the job wrote.
LOG_LABEL = "kleinkram.log-offset"
_PROCESSES = 1024
# The limit of its user, who is the runner itself where that is not root; `_PROCESSES` limits the job.
_PROCESSES_OF_USER = 2**15
# Old programs loop over all possible descriptors when they start another program: a million make them slow.
_OPEN_FILES = 2**16
# Podman runs a timer even for a disabled check.
_HEALTH_EVERY_NS = 24 * 3600 * 10**9
_SHARED_MEMORY_BYTES = 64 * 2**20
# A single file may exceed the disk limit by this much, so that the reason is recognised.
_FILE_MARGIN_BYTES = 64 * 2**20
_OWN_DIRECTORIES = ("/in", "/out", "/tmp")  # noqa: S108  the job's own

# The start barrier: port forwards are made in the network namespace of the container, which the engine creates together
# with the command. So a shell of the image starts first, waits for a line in a pipe and then becomes the command.
BARRIER = "start-barrier"
BARRIER_INSIDE = "/kleinkram-start-barrier"
SHELL = "/bin/sh"
_SHELL_NAME = "kleinkram"
_WAIT = (SHELL, "-c", f'read -r _ <{BARRIER_INSIDE}; exec "$@"', _SHELL_NAME)

# Exit codes where a command cannot be executed: 126 and 127 of tini and shells, 1 of catatonit.
NOT_EXECUTED_CODES = (1, 126, 127)
_SHELL_CODES = (126, 127)
_TINI = re.compile(r"\[FATAL tini[^\]]*\] exec (.+) failed: (.+)")
_CATATONIT = re.compile(r"ERROR \(catatonit:\d+\): failed to exec \S+: (.+)")
# Of dash, bash and busybox.
_SHELL_ERROR = re.compile(rf"^{_SHELL_NAME}: (?:exec: )?(?:line )?\d+: (?:exec: )?(.+): ([^:\n]+)$", re.MULTILINE)
_CGROUPS = Path("/sys/fs/cgroup")


def container_name(job: RunJob) -> str:
    """Return the name of the container of a job."""
    return f"kleinkram-{job.key}"


def describe(
    job: RunJob, *, user: str, volumes: Sequence[str], labels: Mapping[str, str], is_podman: bool = False
) -> dict[str, Any]:
    """Return the description of the container of a job. `volumes`: further directories that its image writes to."""
    environment = {"HOME": "/tmp", "TMPDIR": "/tmp", "PYTHONUNBUFFERED": "1", **job.environment}  # noqa: S108
    return {
        "Image": job.image,
        "Cmd": list(job.command) or None,
        "Env": [f"{name}={value}" for name, value in environment.items()],
        "User": user,
        "Labels": dict(labels),
        "Healthcheck": {"Test": ["NONE"], "Interval": _HEALTH_EVERY_NS},
        "HostConfig": {
            **_limits(job),
            **_isolation(job),
            "Mounts": _mounts(job, volumes),
            # More than is kept of a log. Docker's `local` stores the exact bytes; Podman has its own format.
            "LogConfig": {
                "Type": "json-file" if is_podman else "local",
                "Config": {"max-size": "128m", "max-file": "2"},
            },
        },
    }


def with_barrier(description: Mapping[str, Any], job: RunJob, image: ImageInfo) -> dict[str, Any]:
    """Return a description whose command waits for `open_barrier`; unchanged where there is no command at all."""
    command = [*image.entrypoint, *(job.command or image.command)]
    if not command:
        return dict(description)
    pipe = job.directory / BARRIER
    with contextlib.suppress(FileExistsError):
        os.mkfifo(pipe)
    pipe.chmod(0o400)
    os.chown(pipe, int(description["User"].partition(":")[0]), -1)
    mounts = [*description["HostConfig"]["Mounts"], _bind(pipe, BARRIER_INSIDE, read_only=True)]
    host = {**description["HostConfig"], "Mounts": mounts}
    return {**description, "Entrypoint": list(_WAIT), "Cmd": command, "HostConfig": host}


def open_barrier(directory: Path) -> int | None:
    """Let the command of a job start, and return a descriptor to keep open: else the pipe forgets unread data."""
    try:
        # To read and write, so that this does not wait for a reader.
        descriptor = os.open(directory / BARRIER, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
    except FileNotFoundError:
        return None
    with contextlib.suppress(BlockingIOError):
        os.write(descriptor, b"\n")
    return descriptor


def _limits(job: RunJob) -> dict[str, Any]:
    resources = job.resources
    largest = resources.disk_bytes + _FILE_MARGIN_BYTES
    return {
        "NanoCpus": int(resources.cores * 1e9),
        "Memory": resources.memory_bytes,
        "MemorySwap": resources.memory_bytes,
        "PidsLimit": _PROCESSES,
        "ShmSize": _SHARED_MEMORY_BYTES,
        "Ulimits": [
            {"Name": "core", "Soft": 0, "Hard": 0},
            {"Name": "fsize", "Soft": largest, "Hard": largest},
            # Podman's own defaults are a million each, which it may not set without all of root's capabilities.
            _ulimit("nofile", resource.RLIMIT_NOFILE, _OPEN_FILES),
            _ulimit("nproc", resource.RLIMIT_NPROC, _PROCESSES_OF_USER),
        ],
        "DeviceRequests": [{"Driver": "nvidia", "Count": resources.gpus, "Capabilities": [["gpu"]]}]
        if resources.gpus
        else [],
        "OomScoreAdj": 1000,
    }


def _ulimit(name: str, kind: int, value: int) -> dict[str, Any]:
    """Return a limit of the kernel, no higher than the runner's own."""
    own = resource.getrlimit(kind)[1]
    allowed = value if own == resource.RLIM_INFINITY else min(value, own)
    return {"Name": name, "Soft": allowed, "Hard": allowed}


def _isolation(job: RunJob) -> dict[str, Any]:
    names = host_entries([forward.host for forward in job.port_forwards])
    return {
        "NetworkMode": "bridge" if job.network is Network.open else "none",
        "ExtraHosts": [f"{name}:{address}" for name, address in names.items()],
        "ReadonlyRootfs": True,
        "CapDrop": ["ALL"],
        "SecurityOpt": ["no-new-privileges"],
        "Privileged": False,
        "IpcMode": "private",
        "CgroupnsMode": "private",
        "RestartPolicy": {"Name": "no"},
        # Reaps orphans, and the command gets the default actions of signals, which a first process does not.
        "Init": True,
    }


def _mounts(job: RunJob, volumes: Sequence[str]) -> list[dict[str, Any]]:
    own = [_bind(job.directory / path[1:], path, read_only=path == "/in") for path in _OWN_DIRECTORIES]
    # Volumes that the engine would create have no limit.
    others = [path for path in volumes if path.rstrip("/") not in _OWN_DIRECTORIES]
    return own + [_bind(volume_directory(job, number), path) for number, path in enumerate(others)]


def volume_directory(job: RunJob, number: int) -> Path:
    """Return the directory of a volume of the image: its content counts as `/tmp`."""
    return job.directory / "tmp" / f".volume-{number}"


def _bind(source: Path, target: str, *, read_only: bool = False) -> dict[str, Any]:
    return {
        "Type": "bind",
        "Source": str(source.absolute()),
        "Target": target,
        "ReadOnly": read_only,
        "BindOptions": {"Propagation": "rprivate"},
    }


def execution_error(output: str, command: Sequence[str], exit_code: int) -> str | None:
    """Return why a command could not be executed, from the first output of its container; None where it was.

    `command` is the command of the container, which catatonit does not name.
    """
    if match := _TINI.search(output) or (_SHELL_ERROR.search(output) if exit_code in _SHELL_CODES else None):
        return f"{match[1]}: {match[2]}"
    if match := _CATATONIT.search(output):
        return f"{command[0]}: {match[1]}" if command else match[1]
    return None


class CgroupUsage(NamedTuple):
    """Usage of a container. `memory_bytes` does not count cached files."""

    cpu_s: float
    memory_bytes: int
    read_bytes: int
    written_bytes: int


def cgroups_of(pid: int) -> dict[str, str]:
    """Return the control groups of a process by controller; the one of version 2 has no name.

    Raises:
        OSError: it has ended, or is not a process of this machine.
    """
    lines = Path(f"/proc/{pid}/cgroup").read_text().splitlines()
    parts = [line.split(":", 2) for line in lines]
    return {name: path for _, names, path in parts for name in names.split(",")}


def cgroup_usage(groups: Mapping[str, str], root: Path = _CGROUPS) -> CgroupUsage | None:
    """Return the usage of control groups of either version, or None where they do not exist."""
    try:
        return _usage_v1(groups, root) if "memory" in groups else _usage_v2(root / groups[""].lstrip("/"))
    except (OSError, KeyError):
        return None


def was_oom_killed(groups: Mapping[str, str], root: Path = _CGROUPS) -> bool:
    """Whether the kernel killed a process of control groups for its memory; False where they do not exist."""
    try:
        if "memory" in groups:
            events = root / "memory" / groups["memory"].lstrip("/") / "memory.oom_control"
        else:
            events = root / groups[""].lstrip("/") / "memory.events"
        return _table(events.read_text())["oom_kill"] > 0
    except (OSError, KeyError):
        return False


def _usage_v1(groups: Mapping[str, str], root: Path) -> CgroupUsage:
    memory, cpu, disk = (root / name / groups[name].lstrip("/") for name in ("memory", "cpuacct", "blkio"))
    cached = _table((memory / "memory.stat").read_text())["total_inactive_file"]
    used = int((memory / "memory.usage_in_bytes").read_text()) - cached
    rows = [line.split() for line in (disk / "blkio.throttle.io_service_bytes_recursive").read_text().splitlines()]
    read, written = (sum(int(row[2]) for row in rows if row[1:2] == [word]) for word in ("Read", "Write"))
    return CgroupUsage(int((cpu / "cpuacct.usage").read_text()) / 1e9, max(used, 0), read, written)


def _usage_v2(group: Path) -> CgroupUsage:
    cached = _table((group / "memory.stat").read_text())["inactive_file"]
    used = int((group / "memory.current").read_text()) - cached
    pairs = [word.split("=") for word in (group / "io.stat").read_text().split() if "=" in word]
    read, written = (sum(int(value) for name, value in pairs if name == word) for word in ("rbytes", "wbytes"))
    cpu_s = _table((group / "cpu.stat").read_text())["usage_usec"] / 1e6
    return CgroupUsage(cpu_s, max(used, 0), read, written)


def _table(text: str) -> dict[str, int]:
    return {name: int(value) for name, value in (line.split() for line in text.splitlines())}
