"""The supervisor of one job of processes: starts it in its sandbox, enforces its limits and writes how it ended.

`python -m kleinkram.runner.executors.process_supervisor DIRECTORY LOCK`: `DIRECTORY/job.json` describes the job; the
descriptor LOCK is locked until this process ends. SIGTERM cancels the job. If this process is killed, so is the job.
Imports only the standard library, since jobs wait for it.
"""

import contextlib
import json
import os
import select
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from kleinkram.runner.executors import linux_syscalls, nvidia, port_forward
from kleinkram.runner.executors.process_sandbox import (
    SHARED_MEMORY,
    SHARED_MEMORY_BYTES,
    ImageRoot,
    Sandbox,
    apply_limits,
    limit_resources,
    run_in_sandbox,
)
from kleinkram.runner.executors.supervision import (
    CANCELLED,
    DISK_FULL,
    LOG,
    LOG_IS_FULL,
    USAGE,
    JobLimits,
    LimitMonitor,
    command_not_found,
    ending_file,
    reason_of_exit_code,
    write_all,
    write_atomically,
)

JOB, LOCK = "job.json", "supervisor"
_CHECK_EVERY_S = 0.1
_WRITE_USAGE_EVERY_S = 1.0
_TICKS_PER_S = os.sysconf("SC_CLK_TCK")
_NOT_FOUND = "not found: "
_USAGE_FIELDS = ("cpu_s", "memory_bytes", "peak_memory_bytes", "read_bytes", "written_bytes")


def write_pid(lock: int, pid: int) -> None:
    """Write the pid of a supervisor to its lock file."""
    os.pwrite(lock, str(pid).ljust(16).encode(), 0)


class _ProcessUsage(NamedTuple):
    cpu_s: float = 0.0
    memory_bytes: int = 0
    shared_bytes: int = 0
    read_bytes: int = 0
    written_bytes: int = 0


class JobSupervisor:
    """Runs one job to its end."""

    def __init__(self, directory: Path, lock: int, job: dict[str, Any]) -> None:
        self._directory = directory
        self._lock = lock
        self._job = job
        self._limits_of_job = JobLimits(*job["limits"])
        self._limits = LimitMonitor(directory, self._limits_of_job)
        self._forwards = [port_forward.PortForward(*values) for values in job["port_forwards"]]
        self._started_s = time.monotonic()
        self._earlier_cpu_s = _cpu_of_children_s()
        self._usage: dict[str, float] = dict.fromkeys(_USAGE_FIELDS, 0)
        self._usage_written_s = 0.0
        self._start_error = bytearray()
        self._ending = ending_file(directory)
        self._log_remaining_bytes = self._limits_of_job.log_bytes

    def run(self) -> None:
        """Run the job, and write its ending."""
        linux_syscalls.adopt_orphans()
        signal.signal(signal.SIGTERM, lambda *_: self._limits.stop(CANCELLED))
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGTERM})
        listeners, listeners_inside = socket.socketpair()
        output, output_inside = os.pipe()
        error, error_inside = os.pipe()
        pid = os.fork()
        if pid == 0:
            os.close(self._lock)
            os._exit(self._start(output_inside, error_inside, listeners_inside))
        os.close(output_inside)
        os.close(error_inside)
        listeners_inside.close()
        threading.Thread(target=self._serve_port_forwards, args=(listeners,), daemon=True).start()
        self._write_ending(self._watch(pid, output, error))

    def _start(self, output: int, error: int, listeners: socket.socket) -> int:
        """In the child: become the command, and return its exit code."""
        try:
            os.setsid()
            os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
            os.dup2(output, 1)
            os.dup2(output, 2)
            Path("/proc/self/oom_score_adj").write_text("1000")
            job = self._job
            disk_bytes = self._limits_of_job.disk_bytes
            packages = Path(job["packages"]) if job["packages"] else None
            image = ImageRoot(*job["image"]) if job["image"] else None
            has_network, uid = job["has_network"], job["uid"]
            devices = self._devices()
            if job["has_own_isolation"]:
                limit_resources(disk_bytes)
                return run_beside(job["command"], job["environment"])
            sandbox = Sandbox(
                *(self._directory, has_network, disk_bytes, uid, self._forwards, listeners, packages, image),
                devices=devices,
                has_gpus=bool(job["gpus"]),
            )
            if job["is_isolated"]:
                return run_in_sandbox(sandbox, job["command"], job["environment"], error)
            linux_syscalls.die_with_parent(signal.SIGKILL)
            apply_limits(sandbox)
            os.chdir(self._directory / "tmp")
            os.execvpe(job["command"][0], job["command"], job["environment"])  # noqa: S606
        except OSError as failure:
            kind = _NOT_FOUND if isinstance(failure, FileNotFoundError) else ""
            os.write(error, f"{kind}{failure}".encode())
        return 127

    def _devices(self) -> list[Path]:
        """Return the devices of the GPUs of the job: the runner's choice, or that of a cluster, which is made here."""
        job = self._job
        gpus = nvidia.assigned_by_slurm(os.environ) if job["gpus"] and not job["devices"] else ""
        if not gpus:
            return [Path(node) for node in job["devices"]]
        nodes = nvidia.devices(gpus)
        is_limited_to_them = job["is_isolated"] and not job["has_own_isolation"]
        visible = nvidia.visible_among(gpus, nodes) if is_limited_to_them else None
        job["environment"][f"{job['variable_prefix']}{nvidia.VISIBLE}"] = visible or os.environ[nvidia.VISIBLE]
        return nodes

    def _serve_port_forwards(self, listeners: socket.socket) -> None:
        with listeners:
            _, descriptors, _, _ = socket.recv_fds(listeners, 16, len(self._forwards))
        if descriptors:
            port_forward.serve([socket.socket(fileno=descriptor) for descriptor in descriptors], self._forwards)

    def _watch(self, pid: int, output: int, error: int) -> int:
        log = os.open(self._directory / LOG, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
        readers: dict[int, Callable[[bytes], object]] = {
            output: lambda data: self._append_to_log(data, log),
            error: self._start_error.extend,
        }
        code: int | None = None
        while code is None:
            for descriptor in select.select([*readers], [], [], _CHECK_EVERY_S)[0]:
                _read_available(descriptor, readers)
            if not readers:
                time.sleep(_CHECK_EVERY_S)
            self._check_limits()
            ended, status = os.waitpid(pid, os.WNOHANG)
            code = os.waitstatus_to_exitcode(status) if ended else None
        while remaining := _descendants(os.getpid()):
            for remaining_pid in remaining:
                _kill(remaining_pid, signal.SIGKILL)
            with contextlib.suppress(ChildProcessError):
                os.waitpid(-1, 0)
        # What was written before the end.
        while ready := select.select([*readers], [], [], 0)[0]:
            for descriptor in ready:
                _read_available(descriptor, readers)
        os.close(log)
        return code if code >= 0 else 128 - code

    def _append_to_log(self, data: bytes, log: int) -> None:
        if self._log_remaining_bytes > 0:
            try:
                write_all(log, data[: self._log_remaining_bytes])
                self._log_remaining_bytes -= len(data)
                if self._log_remaining_bytes <= 0:
                    write_all(log, LOG_IS_FULL)
            except OSError:
                self._log_remaining_bytes = 0
                self._limits.stop(DISK_FULL, grace_s=0)

    def _check_limits(self) -> None:
        self._measure()
        self._limits.check_memory(int(self._usage["memory_bytes"]))
        self._limits.check(time.monotonic() - self._started_s)
        if (due := self._limits.next_signal()) is not None:
            for pid in _descendants(os.getpid()):
                _kill(pid, due)

    def _measure(self) -> None:
        running = _descendants(os.getpid())
        usages = [_usage_of(pid) for pid in running]
        used = _ProcessUsage(*(sum(values) for values in zip(*usages, strict=True)))
        # Files in shared memory count whether mapped or not; mapped ones count once.
        memory_bytes = used.memory_bytes + max(used.shared_bytes, self._shared_memory(running))
        self._usage["memory_bytes"] = memory_bytes
        # The usage of a process becomes its parent's a moment after its end: totals never decrease.
        totals = {"cpu_s": used.cpu_s, "read_bytes": used.read_bytes, "written_bytes": used.written_bytes}
        for name, value in (totals | {"peak_memory_bytes": memory_bytes}).items():
            self._usage[name] = max(self._usage[name], value)
        if time.monotonic() >= self._usage_written_s + _WRITE_USAGE_EVERY_S:
            self._usage_written_s = time.monotonic()
            self._write_usage()

    def _write_usage(self) -> None:
        # Nothing depends on it, should the disk be full.
        with contextlib.suppress(OSError):
            write_atomically(self._directory / USAGE, json.dumps(self._usage))

    def _shared_memory(self, running: list[int]) -> int:
        """Return the bytes in the job's own /dev/shm; 0 where it has none, or no process to look through."""
        if not self._job["is_isolated"]:
            return 0
        for pid in running:
            with contextlib.suppress(OSError):
                status = os.statvfs(Path(f"/proc/{pid}/root") / SHARED_MEMORY)
                if status.f_blocks * status.f_frsize == SHARED_MEMORY_BYTES:
                    return (status.f_blocks - status.f_bfree) * status.f_frsize
        return 0

    def _write_ending(self, code: int) -> None:
        error = self._start_error.decode(errors="replace")
        self._limits.check_disk()
        self._usage["cpu_s"] = max(self._usage["cpu_s"], _cpu_of_children_s() - self._earlier_cpu_s)
        self._write_usage()
        exit_code = None
        if self._limits.reason is not None:
            reason, message = self._limits.reason
        elif error.startswith(_NOT_FOUND):
            reason, message = command_not_found(error.removeprefix(_NOT_FOUND))
        elif error:
            reason, message = "not_possible", f"It could not be started here: {error}."
        else:
            reason, message = reason_of_exit_code(code)
            exit_code = code
        ending = {"reason": reason, "message": message, "exit_code": exit_code}
        write_atomically(self._ending, json.dumps(ending))


def _cpu_of_children_s() -> float:
    times = os.times()
    return times.children_user + times.children_system


def _read_available(descriptor: int, readers: dict[int, Callable[[bytes], object]]) -> None:
    data = os.read(descriptor, 65536)
    readers[descriptor](data)
    if not data:
        os.close(descriptor)
        del readers[descriptor]


def _kill(pid: int, number: signal.Signals) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, number)


def run_beside(command: list[str], environment: dict[str, str]) -> int:
    """Run a program that changes its privileges, and return its exit code; end it if this process's parent ends.

    The kernel cannot do that: it forgets the signal of `die_with_parent` for such a program.
    """
    linux_syscalls.adopt_orphans()
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    parent = os.getppid()
    pid = os.fork()
    if pid == 0:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        os.execvpe(command[0], command, environment)  # noqa: S606  what jobs are for
    while True:
        ended, status = os.waitpid(-1, os.WNOHANG)
        if ended == pid:
            code = os.waitstatus_to_exitcode(status)
            return code if code >= 0 else 128 - code
        if os.getppid() != parent:
            for remaining in _descendants(os.getpid()):
                _kill(remaining, signal.SIGKILL)
        if not ended:
            time.sleep(_CHECK_EVERY_S)


def _descendants(pid: int) -> list[int]:
    descendants: list[int] = []
    pending = [pid]
    while pending:
        parent = pending.pop()
        try:
            tasks = list(Path(f"/proc/{parent}/task").iterdir())
            children = [int(child) for task in tasks for child in (task / "children").read_text().split()]
        except OSError:
            continue
        descendants += children
        pending += children
    return descendants


def _usage_of(pid: int) -> _ProcessUsage:
    """Return the usage of a process and its ended children; nothing where it has ended itself."""
    try:
        # The name, which stands in parentheses, may contain anything.
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        status = Path(f"/proc/{pid}/status").read_text()
        traffic = Path(f"/proc/{pid}/io").read_text()
    except OSError:
        return _ProcessUsage()
    values = dict(line.split(":", 1) for line in (status + traffic).splitlines() if ":" in line)
    own, shared = (int(values.get(name, "0 kB").split()[0]) * 1024 for name in ("RssAnon", "RssShmem"))
    cpu_s = sum(map(int, fields[11:15])) / _TICKS_PER_S
    return _ProcessUsage(cpu_s, own, shared, int(values["read_bytes"]), int(values["write_bytes"]))


def main() -> None:
    """Run the job; do nothing where a runner has already removed it."""
    directory, lock = Path(sys.argv[1]), int(sys.argv[2])
    os.set_inheritable(lock, False)
    write_pid(lock, os.getpid())
    with contextlib.suppress(FileNotFoundError):
        JobSupervisor(directory, lock, json.loads((directory / JOB).read_text())).run()


if __name__ == "__main__":
    main()
