"""Slurm's commands. Their text output is read, which all versions write alike and which has only the user's own jobs.

The JSON of Slurm 22.05 contains the jobs of everybody, whatever filter is passed.
"""

import os
import subprocess
from collections.abc import Mapping, Sequence
from typing import NamedTuple

_TIMEOUT_S = 30.0
# Slurm tries again by itself, or an administrator has to: the job is not at fault.
_TRANSIENT = (
    "unable to contact",
    "socket timed out",
    "connection refused",
    "connection timed out",
    "zero bytes were transmitted",
    "temporarily unable",
    "standby mode",
    "unable to resolve",
    "protocol authentication error",
    "munge",
    "maxsubmitjob",
    "configuration source",
    "i/o error writing",
)
_JOB_FORMAT = "%i|%T|%V|%S|%N|%j|%K|%r"
_NODE_FORMAT = "%N|%c|%m|%G|%P|%l|%T"
_USAGE_FIELDS = "JobID,JobName,State,TotalCPU,MaxRSS"
_SCRIPT = "#!/bin/sh\n"


class SlurmUnavailable(Exception):
    """Slurm does not answer at the moment. Whether a submitted job exists is not known."""


class SlurmRefused(Exception):
    """Slurm refuses a request, and would refuse it again."""


class QueueEntry(NamedTuple):
    """A job in Slurm's queue. Times are in seconds by the clock of Slurm's controller; None where not known yet.

    Of a task of a job array, `job_id` is `123_4`, and `name` ends with `_4`, too.
    """

    job_id: str
    state: str
    submitted_s: float | None
    started_s: float | None
    node: str
    name: str
    reason: str


class ClusterNode(NamedTuple):
    """A node in one of its partitions. `time_s` is the partition's limit; None where it has none."""

    name: str
    cores: int
    memory_bytes: int
    gpus: int
    partition: str
    is_default: bool
    time_s: float | None


class JobAccount(NamedTuple):
    """What Slurm's accounting has about an ended job. `name` as in `QueueEntry`: Slurm may use an id twice."""

    name: str
    state: str
    cpu_s: float
    peak_memory_bytes: int


class ClusterSettings(NamedTuple):
    """How a cluster is set: whether it stores the usage of jobs, and how many tasks a job array may have."""

    has_accounting: bool = False
    max_array_size: int = 1


class SlurmCommands:
    """Runs the commands. `environment` replaces variables of this process, such as `SLURM_CONF`."""

    def __init__(self, environment: Mapping[str, str] | None = None) -> None:
        values = {**os.environ, **(environment or {})}
        # The options of a user, or of a job that the runner was started in, are not those of its jobs.
        passed_on = ("PATH", "HOME", "USER", "LOGNAME", "SLURM_CONF", "SLURM_CLUSTERS", "LD_LIBRARY_PATH")
        self._environment = {name: values[name] for name in passed_on if name in values}
        self._environment |= {"LANG": "C.UTF-8", "SLURM_TIME_FORMAT": "%s"}
        self._user = str(os.geteuid())

    def submit(self, options: Sequence[str], command: str) -> str:
        """Submit a batch job, or a job array, that executes lines of shell, and return its id.

        Raises:
            SlurmUnavailable: it may have been submitted or not.
            SlurmRefused: it was not.
        """
        answer = self._run("sbatch", "--parsable", *options, script=f"{_SCRIPT}{command}\n")
        return answer.strip().splitlines()[-1].partition(";")[0]

    def check(self, options: Sequence[str]) -> None:
        """Check that Slurm would accept a job with these options.

        Raises:
            SlurmUnavailable: it does not say.
            SlurmRefused: it would not.
        """
        self._run("sbatch", "--test-only", "--output=/dev/null", *options, script=f"{_SCRIPT}true\n")

    def own_jobs(self, prefix: str) -> list[QueueEntry]:
        """Return the jobs of this user whose names have a prefix, also those that ended in the last minutes."""
        text = self._run(
            "squeue", "--noheader", "--array", "--states=all", f"--user={self._user}", f"--format={_JOB_FORMAT}"
        )
        entries = [parse_job(line) for line in text.splitlines() if line.count("|") >= _JOB_FORMAT.count("|")]
        return [entry for entry in entries if entry.name.startswith(prefix)]

    def nodes(self) -> list[ClusterNode]:
        """Return the nodes of all partitions."""
        text = self._run("sinfo", "--noheader", "--Node", "--exact", f"--format={_NODE_FORMAT}")
        return [parse_node(line) for line in text.splitlines() if line.count("|") >= _NODE_FORMAT.count("|")]

    def settings(self) -> ClusterSettings:
        """Return how the cluster is set."""
        text = self._run("scontrol", "show", "config")
        values = {name.strip(): value.strip() for name, _, value in (line.partition("=") for line in text.splitlines())}
        storage, size = values.get("AccountingStorageType", ""), values.get("MaxArraySize", "")
        return ClusterSettings(
            has_accounting="slurmdbd" in storage or "mysql" in storage,
            max_array_size=max(1, int(size)) if size.isdigit() else 1,
        )

    def accounts(self, job_ids: Sequence[str]) -> dict[str, JobAccount]:
        """Return what the accounting has about ended jobs, by their ids."""
        text = self._run(
            "sacct", "--noheader", "--parsable2", f"--jobs={','.join(job_ids)}", f"--format={_USAGE_FIELDS}"
        )
        return parse_accounts(text)

    def cancel_waiting(self, job_ids: Sequence[str]) -> None:
        """Cancel those that have not started."""
        self._signal("--state=PENDING", *job_ids)

    def terminate(self, job_ids: Sequence[str]) -> None:
        """Send SIGTERM to the scripts of running jobs."""
        self._signal("--batch", "--signal=TERM", *job_ids)

    def kill(self, job_ids: Sequence[str]) -> None:
        """End jobs at once, whatever their states."""
        self._signal("--full", "--signal=KILL", *job_ids)
        self._signal(*job_ids)

    def release(self, job_id: str) -> None:
        """Have a held job start."""
        self._signal(job_id, program=("scontrol", "release"))

    def _signal(self, *arguments: str, program: Sequence[str] = ("scancel", "--quiet")) -> None:
        try:
            self._run(*program, *arguments)
        except SlurmRefused:
            # The job has ended by now, or is in another state: the queue tells.
            return

    def _run(self, *command: str, script: str | None = None) -> str:
        try:
            done = subprocess.run(
                command,
                input=script or "",
                env=self._environment,
                capture_output=True,
                text=True,
                errors="replace",
                timeout=_TIMEOUT_S,
                check=False,
            )
        except subprocess.TimeoutExpired:
            raise SlurmUnavailable(f"{command[0]} did not end within {_TIMEOUT_S:.0f} s") from None
        except FileNotFoundError:  # while Slurm is upgraded, too
            raise SlurmUnavailable(f"the command {command[0]} is not installed here") from None
        except OSError as error:  # as on a crowded login node
            raise SlurmUnavailable(f"{command[0]} cannot be started: {error.strerror}") from error
        if done.returncode == 0:
            return done.stdout
        reason = reason_of(done.stderr) or f"{command[0]} ended with the exit code {done.returncode}"
        if any(words in done.stderr.lower() for words in _TRANSIENT):
            raise SlurmUnavailable(reason)
        raise SlurmRefused(reason)


def reason_of(errors: str) -> str:
    """Return what a command of Slurm wrote about its failure, in one line."""
    lines = [line.strip() for line in errors.splitlines() if line.strip()]
    parts = [line.partition(": ")[2].removeprefix("error: ").removeprefix("fatal: ") for line in lines]
    parts = [part.removeprefix("Batch job submission failed: ") for part in parts if part]
    return "; ".join(dict.fromkeys(parts))[:1000]


def parse_job(line: str) -> QueueEntry:
    """Read a line of squeue."""
    job_id, state, submitted, started, node, name, task, reason = line.split("|", 7)
    name = task_name(name, task) if task.isdigit() else name
    return QueueEntry(job_id, state, _seconds(submitted), _seconds(started), node, name, reason.strip())


def task_name(name: str, task: int | str) -> str:
    """Return the name of a task of a job array."""
    return f"{name}_{task}"


def parse_node(line: str) -> ClusterNode:
    """Read a line of sinfo."""
    name, cores, memory, gres, partition, limit, _ = line.split("|", 6)
    return ClusterNode(
        name=name,
        cores=int(cores.rstrip("+")),
        memory_bytes=int(memory.rstrip("+")) * 2**20,
        gpus=count_gpus(gres),
        partition=partition.rstrip("*"),
        is_default=partition.endswith("*"),
        time_s=parse_duration(limit),
    )


def count_gpus(gres: str) -> int:
    """Return the GPUs in a list of generic resources, such as `gpu:a100:4(S:0-1),nvme:1`."""
    total = 0
    for part in gres.split(","):
        kind, _, rest = part.partition(":")
        if kind == "gpu":
            count = rest.partition("(")[0].rpartition(":")[2]
            total += int(count) if count.isdigit() else 1
    return total


def parse_duration(text: str) -> float | None:
    """Return seconds of `[days-][hours:]minutes:seconds[.fraction]`; None where it is `infinite`."""
    days, _, clock = text.strip().rpartition("-")
    parts = clock.split(":")
    try:
        values = [float(part) for part in parts]
        seconds = 86400 * int(days or 0)
    except ValueError:
        return None
    return float(seconds + sum(value * 60**power for power, value in enumerate(reversed(values))))


_UNITS = {"": 1, "K": 2**10, "M": 2**20, "G": 2**30, "T": 2**40}


def parse_accounts(text: str) -> dict[str, JobAccount]:
    """Read lines of sacct: that of a job has its state and CPU time, that of its script the memory."""
    accounts: dict[str, JobAccount] = {}
    for line in text.splitlines():
        job, name, state, cpu, memory = line.split("|")
        job_id, _, step = job.partition(".")
        known = accounts.get(job_id, JobAccount("", "", 0.0, 0))
        task = job_id.partition("_")[2]
        number, unit = memory.rstrip("KMGT"), memory[-1:] if memory[-1:] in _UNITS else ""
        peak = int(float(number or 0) * _UNITS[unit])
        accounts[job_id] = JobAccount(
            name=known.name if step else task_name(name, task) if task else name,
            state=known.state if step else state.partition(" ")[0],
            cpu_s=max(known.cpu_s, parse_duration(cpu) or 0.0),
            peak_memory_bytes=max(known.peak_memory_bytes, peak),
        )
    return accounts


def _seconds(text: str) -> float | None:
    return float(text) if text.replace(".", "", 1).isdigit() else None
