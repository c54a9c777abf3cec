"""The script of a job on its node: `python -m kleinkram.runner.executors.slurm.node_job DIRECTORY`.

Supervises the job as on a single machine. Slurm may start it again, and a job that was given up may start late: each
start checks that the directory is still its own. If Slurm interrupts it, it writes no ending: the state in Slurm says
why. Imports only the standard library, since jobs wait for it.
"""

import contextlib
import json
import os
import shutil
import signal
import socket
import sys
import threading
import time
import uuid
from pathlib import Path
from typing import Any

from kleinkram.runner.executors import nvidia, process_sandbox, transfer_steps
from kleinkram.runner.executors.process_supervisor import JOB, JobSupervisor
from kleinkram.runner.executors.slurm.shared_files import (
    NodeStart,
    is_cancel_requested,
    read_lease,
    read_start,
    read_submission,
    write_start,
)
from kleinkram.runner.executors.supervision import (
    CANCELLED,
    GRACE_S,
    LEASE_EXPIRED,
    JobLimits,
    LimitMonitor,
    boot_time_s,
    ending_file,
    move_reserved,
    write_atomically,
)

PROBE, PROBE_STARTED = "probe.json", "probe.started"
PROGRAMS = ("apptainer", "singularity", "ch-run")
INTERRUPTED = ("interrupted", "Slurm ended it.")
# Preemption is common where it is used; a job that crashes each node must not go through all of them for ever.
_MAX_RESTARTS = 100
TOO_MANY_STARTS = ("lost", f"Slurm started its job {_MAX_RESTARTS} times, and it was interrupted each time.")
SUPERSEDED = ("superseded", "The directory belongs to a later start.")
_READ_EVERY_S = 1.0
_WAIT_EVERY_S = 0.1
_GPU_VARIABLES = ("CUDA_VISIBLE_DEVICES", "ROCR_VISIBLE_DEVICES", "ZE_AFFINITY_MASK")


class SharedLease:
    """The lease of a job, by the clock of this node. A lease counts only once it has changed here."""

    def __init__(self, directory: Path) -> None:
        self._directory = directory
        lease = read_lease(directory)
        self.exists = lease is not None
        self._text, remaining_s = lease or ("", 0.0)
        self.until_s = boot_time_s() + remaining_s
        self.is_renewed = False

    def read(self) -> None:
        """Read the lease again."""
        with contextlib.suppress(OSError):
            lease = read_lease(self._directory)
            if lease is not None and lease[0] != self._text:
                self._text = lease[0]
                self.until_s = boot_time_s() + lease[1]
                self.is_renewed = True

    def is_over(self) -> bool:
        """Whether another runner may soon have the run."""
        return self.exists and boot_time_s() >= self.until_s


class NodeLimits(LimitMonitor):
    """The limits of a job on a node, its lease, and what the login node asks for."""

    def __init__(self, directory: Path, limits: JobLimits, token: str, lease: SharedLease) -> None:
        super().__init__(directory, limits)
        self._token = token
        self._lease = lease
        self._read_at_s = 0.0

    def stop(self, reason: tuple[str, str], *, grace_s: float = GRACE_S) -> None:
        """Have the job ended. SIGTERM is from Slurm, unless the login node asked for it."""
        if reason == CANCELLED and not is_cancel_requested(self._directory):
            reason = INTERRUPTED
        super().stop(reason, grace_s=grace_s)

    def is_lease_expired(self) -> bool:
        """Whether the lease has expired; also reads what the login node wrote."""
        if boot_time_s() >= self._read_at_s:
            self._read_at_s = boot_time_s() + _READ_EVERY_S
            self._lease.read()
            if not _is_current(self._directory, self._token):
                super().stop(SUPERSEDED, grace_s=0)
            elif is_cancel_requested(self._directory):
                super().stop(CANCELLED)
        return self._lease.is_over()


class NodeJobSupervisor(JobSupervisor):
    """Runs a job on a node."""

    def __init__(self, directory: Path, job: dict[str, Any], token: str, lease: SharedLease) -> None:
        # No process on the node has to find this one.
        super().__init__(directory, os.open(os.devnull, os.O_RDONLY), job)
        self._limits = NodeLimits(directory, self._limits_of_job, token, lease)
        self._token = token
        self._ending = ending_file(directory, token)

    def _write_ending(self, code: int) -> None:
        if self._limits.reason in (INTERRUPTED, SUPERSEDED) or not _is_current(self._directory, self._token):
            sys.exit(1)
        super()._write_ending(code)


def _own_name() -> str | None:
    """Return the name of this job as its submission has it; None outside of Slurm."""
    name, task = os.environ.get("SLURM_JOB_NAME"), os.environ.get("SLURM_ARRAY_TASK_ID")
    return f"{name}_{task}" if name and task else name


def _is_current(directory: Path, token: str) -> bool:
    """Whether a start still has the directory of its job; what cannot be read at the moment is not changed."""
    try:
        submission, start = read_submission(directory), read_start(directory)
    except OSError:
        return True
    is_named = submission is not None and submission.name == (_own_name() or submission.name)
    return is_named and start is not None and start.token == token


def _take_directory(directory: Path, job: dict[str, Any], previous: NodeStart | None) -> NodeStart:
    """Make this start the one that has the directory, without what the previous one left, and return it."""
    gpus = nvidia.assigned_by_slurm(os.environ)
    start = NodeStart(
        token=uuid.uuid4().hex,
        node=os.environ.get("SLURMD_NODENAME") or socket.gethostname(),
        restarts=0 if previous is None else previous.restarts + 1,
        gpus=[gpu for gpu in gpus.split(",") if gpu],
    )
    move_reserved(ending_file(directory, previous.token if previous else ""), ending_file(directory, start.token))
    write_start(directory, start)
    if previous is not None:
        for name in ("out", "tmp"):
            _replace_directory(directory / name)
        process_sandbox.make_volumes(directory, job["volumes"], job["uid"])
    return start


def _replace_directory(directory: Path) -> None:
    """Make an empty directory in place of another, which processes of a lost node may still write to."""
    status = directory.stat()
    aside = directory.with_name(f"{directory.name}-{uuid.uuid4().hex[:8]}")
    directory.rename(aside)
    directory.mkdir()
    if os.geteuid() == 0:
        os.chown(directory, status.st_uid, status.st_gid)
    shutil.rmtree(aside, ignore_errors=True)


def _wait_for_lease(directory: Path, token: str, lease: SharedLease) -> tuple[str, str] | None:
    """Wait until the login node has renewed the lease since this start; return why the job must not start, if so.

    The lease may have been written long ago, while the job waited.
    """
    while lease.exists and not lease.is_renewed:
        if not _is_current(directory, token):
            return SUPERSEDED
        if is_cancel_requested(directory):
            return CANCELLED
        if lease.is_over():
            return LEASE_EXPIRED
        time.sleep(_WAIT_EVERY_S)
        lease.read()
    return None


def _fetch_inputs(directory: Path, token: str, lease: SharedLease) -> tuple[str, str] | None:
    """Download the inputs of a job; return why it must not start, if so."""

    def stop_reason() -> tuple[str, str] | None:
        lease.read()
        if not _is_current(directory, token):
            return SUPERSEDED
        if signal.SIGTERM in signal.sigpending():
            return CANCELLED if is_cancel_requested(directory) else INTERRUPTED
        if is_cancel_requested(directory):
            return CANCELLED
        return LEASE_EXPIRED if lease.is_over() else None

    failure = transfer_steps.fetch_inputs(directory, lambda: stop_reason() is None)
    return stop_reason() or failure


def _upload_results(directory: Path, token: str) -> None:
    """Upload the results of a job. What Slurm interrupts is left to the login node."""
    is_interrupted = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: is_interrupted.set())
    transfer_steps.upload_results(
        directory,
        lambda: _is_current(directory, token) and not is_interrupted.is_set() and not is_cancel_requested(directory),
        token,
    )


def run_job(directory: Path) -> None:
    """Run a job to its end; do nothing where the directory is not this job's any more, or the job has ended."""
    submission, previous = read_submission(directory), read_start(directory)
    if submission is None or submission.name != _own_name():
        return
    if previous is not None and ending_file(directory, previous.token).exists():
        return
    job = json.loads((directory / JOB).read_text())
    start = _take_directory(directory, job, previous)
    token = start.token
    visible = {
        name: os.environ[name]
        for name in _GPU_VARIABLES
        if os.environ.get(name, nvidia.NONE_VISIBLE) != nvidia.NONE_VISIBLE
    }
    job["environment"] |= visible
    lease = SharedLease(directory)
    reason = TOO_MANY_STARTS if start.restarts >= _MAX_RESTARTS else _wait_for_lease(directory, token, lease)
    if reason is None and job["is_isolated"] and not process_sandbox.is_available():
        reason = ("not_possible", f"The node {socket.gethostname()} allows no namespaces, which isolate its runs.")
    if reason is None and transfer_steps.node_moves_files(directory):
        reason = _fetch_inputs(directory, token, lease)
    if reason is None:
        NodeJobSupervisor(directory, job, token, lease).run()
        if transfer_steps.node_moves_files(directory):
            _upload_results(directory, token)
    elif reason not in (SUPERSEDED, INTERRUPTED):
        ending = {"reason": reason[0], "message": reason[1], "exit_code": None}
        write_atomically(ending_file(directory, token), json.dumps(ending))


def probe(directory: Path) -> None:
    """Write what this node offers to jobs."""
    offer = {
        "node": socket.gethostname(),
        "is_isolated": process_sandbox.is_available(),
        "programs": [program for program in PROGRAMS if shutil.which(program)],
    }
    write_atomically(directory / PROBE, json.dumps(offer))


def main() -> None:
    """Run a job, or, with `--probe`, write what this node offers."""
    if sys.argv[1] == "--probe":
        probe(Path(sys.argv[2]))
    else:
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})
        run_job(Path(sys.argv[1]))


if __name__ == "__main__":
    main()
