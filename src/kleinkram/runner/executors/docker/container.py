"""Containers of jobs: descriptions, the start barrier, logs, resource usage, and errors of their init processes."""

import contextlib
import json
import os
import re
import resource
import threading
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

from kleinkram.action.run_files import PACKAGES_VARIABLE
from kleinkram.contract.actions import Network
from kleinkram.contract.runs import LOG_BYTES
from kleinkram.runner.executors.base import RunJob
from kleinkram.runner.executors.docker.client import (
    ContainerInfo,
    DockerClient,
    EngineError,
    EngineUnavailable,
    ImageInfo,
    OutputPiece,
)
from kleinkram.runner.executors.port_forward import host_entries
from kleinkram.runner.executors.supervision import LOG, LOG_IS_FULL, write_all

# Where a job sees the packages of its script.
PACKAGES = "/env"
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
_TOOL_MEMORY_BYTES = 2**30
# What separates every container from its machine.
_SEPARATION: Mapping[str, Any] = {
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

LOG_CURSOR = "log.cursor"
_GAP = b"\n[kleinkram] lines may be missing here: the engine did not keep all of the output\n"
_FIRST_OUTPUT_BYTES = 2**12
_LONGEST_LINE_BYTES = 2**16
_RETRY_EVERY_S = 0.2


def container_name(job: RunJob) -> str:
    """Return the name of the container of a job."""
    return f"kleinkram-{job.key}"


def describe(
    job: RunJob,
    *,
    user: str,
    volumes: Sequence[str],
    labels: Mapping[str, str],
    is_podman: bool = False,
    python_path: str = "",
) -> dict[str, Any]:
    """Return the description of the container of a job.

    `volumes` are further directories that its image writes to, `python_path` is the variable PYTHONPATH of the image.
    """
    environment = {"HOME": "/tmp", "TMPDIR": "/tmp", "PYTHONUNBUFFERED": "1"}  # noqa: S108  the job's own
    if job.packages is not None:
        environment |= {PACKAGES_VARIABLE: PACKAGES, "PYTHONPATH": ":".join(filter(None, (PACKAGES, python_path)))}
    environment |= job.environment
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
            "LogConfig": _log_config("128m", is_podman=is_podman),
        },
    }


def _log_config(max_size: str, *, is_podman: bool) -> dict[str, Any]:
    kind = "json-file" if is_podman else "local"
    return {"Type": kind, "Config": {"max-size": max_size, "max-file": "2"}}


def describe_tool(
    image: str,
    command: Sequence[str],
    *,
    user: str,
    labels: Mapping[str, str],
    folder: Path | None,
    is_podman: bool = False,
) -> dict[str, Any]:
    """Return the description of a container without network for a command of the runner's own.

    `folder` is the only one of this machine that it sees, and that it may write to, under `PACKAGES`.
    """
    return {
        "Image": image,
        "Cmd": list(command),
        "Env": ["HOME=/tmp"],
        "User": user,
        "Labels": dict(labels),
        "Healthcheck": {"Test": ["NONE"], "Interval": _HEALTH_EVERY_NS},
        "HostConfig": {
            **_SEPARATION,
            "NetworkMode": "none",
            "Tmpfs": {"/tmp": "size=64m"},  # noqa: S108  the container's own
            "Memory": _TOOL_MEMORY_BYTES,
            "PidsLimit": _PROCESSES,
            "Mounts": [_bind(folder, PACKAGES)] if folder is not None else [],
            "LogConfig": _log_config("1m", is_podman=is_podman),
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
    """Let the command of a job start, and return a descriptor to keep open, or the pipe loses unread data."""
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
        **_SEPARATION,
    }


def _mounts(job: RunJob, volumes: Sequence[str]) -> list[dict[str, Any]]:
    own = [_bind(job.directory / path[1:], path, read_only=path == "/in") for path in _OWN_DIRECTORIES]
    if job.packages is not None:
        own.append(_bind(job.packages, PACKAGES, read_only=True))
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


class ContainerLog:
    """Copies the output of a container in a thread.

    The engine stores the output as well. An interrupted copy continues after as many bytes of each stream as it has
    (the order of the two streams may change between reads): nothing is missing or duplicated. These numbers are written
    before each append, so that a partial append counts, too. Without `can_follow` (Podman) the stored output is read
    repeatedly.
    """

    def __init__(self, client: DockerClient, job: RunJob, *, can_follow: bool = True) -> None:
        self._client = client
        self._can_follow = can_follow
        self._name = container_name(job)
        self._path = job.directory / LOG
        self._cursor_path = job.directory / LOG_CURSOR
        self._thread: threading.Thread | None = None
        self._is_closed = threading.Event()
        self._has_exited = threading.Event()
        self._append_lock = threading.Lock()
        self._offset = 0
        self._cursor = -1
        self._copied = {1: 0, 2: 0}
        self.is_complete = False
        self.has_space = True

    def follow(self, container: ContainerInfo) -> None:
        """Start copying, if that has not started."""
        if self._thread is None:
            self._offset = int(container.labels.get(LOG_LABEL, 0))
            self._thread = threading.Thread(target=self._copy, name="container log", daemon=True)
            self._thread.start()

    def finish(self) -> None:
        """Note that the container has exited: nothing follows the stored output."""
        self._has_exited.set()

    def close(self) -> None:
        """Stop copying; nothing is appended from now on."""
        with self._append_lock:
            self._is_closed.set()
        self._has_exited.set()

    def first_output(self) -> bytes:
        """Return the beginning of what this container wrote."""
        with contextlib.suppress(FileNotFoundError), self._path.open("rb") as stream:
            stream.seek(self._offset)
            return stream.read(_FIRST_OUTPUT_BYTES)
        return b""

    def _copy(self) -> None:
        log = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o600)
        self._cursor = os.open(self._cursor_path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        if text := os.pread(self._cursor, 4096, 0):
            cursor = json.loads(text)
            self._copied = {1: cursor["copied"][0], 2: cursor["copied"][1]}
            self._copied[cursor["next"]] += os.fstat(log).st_size - cursor["size"]
        try:
            while not self._is_closed.is_set():
                had_exited = self._has_exited.is_set()
                # The stream of a follower may end before the last output: the stored output is read once more.
                is_whole = False
                started_s = time.monotonic()
                with contextlib.suppress(EngineUnavailable, EngineError):
                    is_whole = self._copy_missing(log, is_final=had_exited)
                if os.fstat(log).st_size >= LOG_BYTES or (had_exited and is_whole):
                    break
                # Reading all of it takes at most a tenth of the time.
                read_s = 0.0 if self._can_follow else time.monotonic() - started_s
                self._has_exited.wait(max(_RETRY_EVERY_S, 10 * read_s))
                if had_exited:
                    self._is_closed.wait(_RETRY_EVERY_S)
        except OSError:
            self.has_space = False
        finally:
            os.close(log)
            os.close(self._cursor)
            self.is_complete = True

    def _copy_missing(self, log: int, *, is_final: bool) -> bool:
        """Append what is missing of the stored output; return whether that came to its end."""
        skip = dict(self._copied)
        since_ns = 0
        if any(skip.values()) and not self._begins_alike(log):
            since_ns, skip = os.fstat(log).st_mtime_ns, {1: 0, 2: 0}
            write_all(log, _GAP)
        stored = self._client.log(self._name, follow=self._can_follow and not is_final, since_ns=since_ns)
        for stream, data in _complete_lines(stored, is_final=is_final):
            known = min(skip[stream], len(data))
            skip[stream] -= known
            if known < len(data):
                with self._append_lock:
                    if self._is_closed.is_set() or not self._append(log, stream, data[known:]):
                        return True
        return True

    def _begins_alike(self, log: int) -> bool:
        """Whether the engine still stores the beginning of the output, which it drops of a very long one."""
        pieces = next(iter(self._client.log(self._name, follow=False)), [])
        if not pieces:
            return True
        first = pieces[0].data[: self._copied[pieces[0].stream]]
        return first in os.pread(log, _FIRST_OUTPUT_BYTES + len(first), self._offset)

    def _append(self, log: int, stream: int, data: bytes) -> bool:
        """Append data up to the limit; return whether more is wanted."""
        size = os.fstat(log).st_size
        data = data[: LOG_BYTES - size]
        cursor = {"size": size, "copied": [self._copied[1], self._copied[2]], "next": stream}
        # A single write of constant length is atomic.
        os.pwrite(self._cursor, json.dumps(cursor).ljust(120).encode(), 0)
        write_all(log, data)
        self._copied[stream] += len(data)
        if size + len(data) < LOG_BYTES:
            return True
        write_all(log, LOG_IS_FULL)
        return False


def _complete_lines(batches: Iterable[list[OutputPiece]], *, is_final: bool) -> Iterator[OutputPiece]:
    """Yield output so that lines of one stream do not cut those of the other: Podman stores parts of lines."""
    pending = {1: b"", 2: b""}
    for pieces in batches:
        for stream, same in groupby(pieces, key=lambda piece: piece.stream):
            data = pending[stream] + b"".join(piece.data for piece in same)
            end = data.rfind(b"\n") + 1 if len(data) < _LONGEST_LINE_BYTES else len(data)
            pending[stream] = data[end:]
            if end:
                yield OutputPiece(stream, data[:end])
    if is_final:
        yield from (OutputPiece(stream, data) for stream, data in pending.items() if data)
