"""What a cluster offers: its largest node, whether it has accounting, and what a job sees on a node, which is tried.

It is stored in the folder of the runner: one that starts again must not wait behind a full queue, or for a controller
that is down, since its runs wait for it.
"""

import contextlib
import json
import logging
import shlex
import shutil
import sys
import time
import uuid
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from pydantic import TypeAdapter

from kleinkram.client.errors import InvalidInput
from kleinkram.contract.runners import Capacity
from kleinkram.runner.executors.slurm import node_job
from kleinkram.runner.executors.slurm.commands import (
    ClusterNode,
    ClusterSettings,
    QueueEntry,
    SlurmCommands,
    SlurmRefused,
    SlurmUnavailable,
)
from kleinkram.runner.executors.slurm.options import SUPERVISOR_BYTES, SlurmOptions, minimal_options, reserved_names
from kleinkram.runner.executors.slurm.shared_files import refresh
from kleinkram.runner.executors.slurm.states import Phase, never_starts, phase_of, waiting_sentence
from kleinkram.runner.executors.supervision import write_atomically

_log = logging.getLogger("kleinkram.runner")
_STORED = "slurm-site.json"
_EVERY_S = 0.2
_ASK_EVERY_S = 2.0
# How late files of a node may be seen.
_LATE_S = 30.0
_MAX_ERROR_CHARACTERS = 500


@dataclass(frozen=True)
class NodeOffer:
    """What a node offers to jobs: sandboxes, and programs that run images."""

    is_isolated: bool
    programs: tuple[str, ...] = ()


@dataclass(frozen=True)
class SlurmSite:
    """A cluster as a runner uses it."""

    commands: SlurmCommands
    options: SlurmOptions
    capacity: Capacity
    node: NodeOffer
    settings: ClusterSettings = field(default_factory=ClusterSettings)


def find_site(commands: SlurmCommands, options: SlurmOptions, directory: Path, *, runner: str) -> SlurmSite:
    """Return what a cluster offers. The first time, it runs a short job, which waits in the queue as others do.

    Raises:
        InvalidInput: Slurm does not answer, the partition does not exist, or the nodes cannot run jobs of this folder.
    """
    if reserved := reserved_names([*options.extra, *options.allowed]):
        raise InvalidInput(what=f"The option --{reserved[0]} of sbatch", reason="Kleinkram sets it itself")
    stored = _read_stored(directory)
    key = repr((options.partition, options.constraint, options.python or sys.executable))
    try:
        capacity = largest_node(commands.nodes(), options.partition)
        settings = commands.settings()
    except (SlurmUnavailable, SlurmRefused) as error:
        if stored is None:
            raise InvalidInput(what="Slurm", reason=str(error)) from error
        _log.warning("Slurm does not answer; the runner knows the cluster from before: %s", error)
        capacity, settings = stored.capacity, stored.settings
    has_runs = any((directory / "runs").glob("*"))
    if stored is not None and (stored.key == key or has_runs):
        return SlurmSite(commands, options, capacity, stored.node, settings)
    try:
        node = _Probe(commands, options, directory, runner).run()
    except SlurmUnavailable as error:
        raise InvalidInput(what="Slurm", reason=str(error)) from error
    text = TypeAdapter(_StoredSite).dump_json(_StoredSite(key, capacity, node, settings)).decode()
    write_atomically(directory / _STORED, text)
    return SlurmSite(commands, options, capacity, node, settings)


def _read_stored(directory: Path) -> "_StoredSite | None":
    try:
        return TypeAdapter(_StoredSite).validate_json((directory / _STORED).read_bytes())
    except (OSError, ValueError):
        return None


def largest_node(nodes: Sequence[ClusterNode], partition: str | None) -> Capacity:
    """Return the most of each resource that a node of a partition has; without one, of the default partition.

    Slurm refuses a job that needs what no single node has together.

    Raises:
        InvalidInput: there is no such partition, or it has no nodes.
    """
    usable = [node for node in nodes if (node.partition == partition if partition else node.is_default)]
    if not usable:
        names = ", ".join(sorted({node.partition for node in nodes})) or "none"
        what = f"The partition {partition}" if partition else "The default partition of Slurm"
        raise InvalidInput(what=what, reason=f"it does not exist, or has no nodes; there are: {names}")
    memory_bytes = max(node.memory_bytes for node in usable)
    return Capacity(
        cores=max(node.cores for node in usable),
        memory_bytes=max(0, memory_bytes - SUPERVISOR_BYTES),
        disk_bytes=0,
        gpus=max(node.gpus for node in usable),
    )


@dataclass(frozen=True)
class _StoredSite:
    """What is known of a cluster from an earlier start. `key`: what the probe depended on."""

    key: str
    capacity: Capacity
    node: NodeOffer
    settings: ClusterSettings = field(default_factory=ClusterSettings)


class _Probe:
    """A job that writes what its node offers."""

    def __init__(self, commands: SlurmCommands, options: SlurmOptions, directory: Path, runner: str) -> None:
        self._commands = commands
        self._options = options
        self._python = options.python or sys.executable
        self._directory = directory / "probe"
        self._name = f"klein-{runner.replace('-', '')[:12]}-probe-{uuid.uuid4().hex[:8]}"
        self._shown = ""
        self._ended_s: float | None = None

    def run(self) -> NodeOffer:
        shutil.rmtree(self._directory, ignore_errors=True)
        self._directory.mkdir(parents=True)
        folder = str(self._directory)
        started = shlex.quote(f"{folder}/{node_job.PROBE_STARTED}")
        command = shlex.join([self._python, "-I", "-m", node_job.__name__, "--probe", folder])
        log = shlex.quote(f"{folder}/probe.log")
        options = ["--output=/dev/null", "--chdir=/", f"--job-name={self._name}", *minimal_options(self._options)]
        try:
            job_id = self._commands.submit(options, f": > {started} && exec {command} > {log} 2>&1")
        except SlurmRefused as error:
            raise InvalidInput(what="A job for Slurm", reason=f"Slurm refused it: {error}") from error
        try:
            return self._wait(job_id)
        except SlurmRefused as error:
            raise InvalidInput(what="Slurm", reason=f"it does not say how a job goes: {error}") from error
        finally:
            with contextlib.suppress(SlurmUnavailable):  # what went wrong before counts
                self._commands.kill([job_id])
            shutil.rmtree(self._directory, ignore_errors=True)

    def _wait(self, job_id: str) -> NodeOffer:
        ask_at_s = 0.0
        while True:
            refresh(self._directory)
            if (result := self._directory / node_job.PROBE).exists():
                values = json.loads(result.read_text())
                return NodeOffer(values["is_isolated"], tuple(values["programs"]))
            if time.monotonic() >= ask_at_s:
                ask_at_s = time.monotonic() + _ASK_EVERY_S
                jobs = {entry.name: entry for entry in self._commands.own_jobs(self._name)}
                self._check(jobs.get(self._name), job_id)
            time.sleep(_EVERY_S)

    def _check(self, entry: QueueEntry | None, job_id: str) -> None:
        phase = Phase.ended if entry is None else phase_of(entry.state)
        if entry is not None and phase is Phase.waiting:
            if (impossible := never_starts(entry.reason)) is not None:
                raise InvalidInput(what="A job for Slurm", reason=impossible.message)
            if self._shown != entry.reason and entry.reason != "None":
                _log.info("a job that tries the nodes %s", waiting_sentence(entry.reason))
            self._shown = entry.reason
        if phase is not Phase.ended:
            self._ended_s = None
            return
        self._ended_s = self._ended_s or time.monotonic()
        has_started = (self._directory / node_job.PROBE_STARTED).exists()
        late_s = 2.0 if has_started else _LATE_S
        if time.monotonic() - self._ended_s > late_s:
            self._fail(has_started=has_started, node=entry.node if entry else "", job_id=job_id)

    def _fail(self, *, has_started: bool, node: str, job_id: str) -> None:
        where = f"the node {node}" if node else "the nodes"
        if not has_started:
            reason = f"{where} cannot write to it (job {job_id}); choose one on a shared file system with --data-dir"
            raise InvalidInput(what=f"The folder {self._directory.parent}", reason=reason)
        log = self._directory / "probe.log"
        output = log.read_text(errors="replace").strip() if log.exists() else ""
        reason = f"it does not run on {where}: {output[-_MAX_ERROR_CHARACTERS:] or 'it wrote no error'}"
        raise InvalidInput(what=f"The Python {self._python}", reason=f"{reason}; choose one with --python")
