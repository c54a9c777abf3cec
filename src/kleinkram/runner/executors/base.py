"""The interface of executors, which run jobs: by a container engine, as processes, or on a cluster.

An executor owns capacity, images, the placement of inputs, limits and isolation. A job outlives the process that
submitted it: the executor of a later runner process finds it by its key.
"""

import time
from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from pydantic import ValidationError

from kleinkram.contract.actions import ClusterRequest, Network, Resources
from kleinkram.contract.runners import LEASE_S, Capacity, ExecutorAbilities, RunFinish
from kleinkram.contract.runs import EndReason, RunPlacement, Usage
from kleinkram.environments.cache import Environment, Show
from kleinkram.environments.uv import Wait
from kleinkram.runner.executors.port_forward import PortForward
from kleinkram.runner.executors.transfer_steps import finish_file
from kleinkram.runner.input_cache import InputCache, InputFile, InputSource

UPLOADING = "the results are uploaded where the job ran"
_POLL_EVERY_S = 0.25
_MIN_CORES = 0.01
_MIN_BYTES = 2**20


@dataclass(frozen=True)
class PinnedImage:
    """An available image. `reference` is for `RunJob.image`; `digest` (`sha256:…`) holds everywhere."""

    reference: str
    digest: str


@dataclass(frozen=True)
class RunJob:
    """One attempt at a run. `key` is unique among all attempts and consists of letters, digits and `-`.

    `directory` belongs to the job and has the inputs in `in/`. `command` empty: the command of the image.
    `packages`: the folder of the packages of its script, which it sees read-only.
    """

    key: str
    directory: Path
    command: Sequence[str]
    image: str | None
    resources: Resources
    network: Network
    environment: Mapping[str, str] = field(default_factory=dict)
    packages: Path | None = None
    port_forwards: tuple[PortForward, ...] = ()
    cluster: ClusterRequest = field(default_factory=ClusterRequest)


@dataclass(frozen=True)
class LockedScript:
    """A script whose dependencies are locked, and the image that it runs in, which is available."""

    lock: str
    requires_python: str | None
    image: str | None


@dataclass(frozen=True)
class Ending:
    """End of a job: the reason, a sentence for people, and the exit code if the command returned one."""

    reason: EndReason
    message: str
    exit_code: int | None = None

    @classmethod
    def of(cls, reason: tuple[str, str], exit_code: int | None = None) -> "Ending":
        """Return an ending by its reason and sentence."""
        return cls(EndReason(reason[0]), reason[1], exit_code)


class StoredResults(NamedTuple):
    """Results that were uploaded where a job ran, as they are to be reported. `has_log`: the log was uploaded, too."""

    finish: RunFinish
    has_log: bool


class CannotStart(Exception):
    """A job cannot be started, for a reason that would apply to another attempt here, too."""

    def __init__(self, ending: Ending) -> None:
        super().__init__(ending.message)
        self.ending = ending


class Executor(ABC):
    """Runs jobs. All methods may be called from any thread."""

    @property
    @abstractmethod
    def abilities(self) -> ExecutorAbilities:
        """Supported features."""

    @property
    def are_abilities_known(self) -> bool:
        """Whether all of them could be found out; if not, `find_abilities` tries again."""
        return True

    def find_abilities(self) -> None:  # noqa: B027  most know them
        """Find out abilities that are not known yet. May take minutes."""

    @property
    @abstractmethod
    def capacity(self) -> Capacity:
        """The resources of all jobs that may run at the same time; of a cluster, the largest that one job may have."""

    @property
    def node_cache(self) -> InputCache | None:
        """The cache that compute nodes download inputs to, if they move the files of their jobs; else the runner does.

        The program of a node then makes the steps of `transfer_steps.py` before and after the job.
        """
        return None

    @property
    def lease_s(self) -> int:
        """How long its jobs may go on without news from the runner."""
        return LEASE_S

    @property
    def nodes_enforce_leases(self) -> bool:
        """Whether jobs end with their leases by themselves, wherever the next process of the runner is started."""
        return False

    def free(self, reserved: Capacity, job_count: int) -> Capacity | None:
        """Return what the next job may have beside `job_count` jobs that reserved so much; None: no room for any."""
        capacity = self.capacity
        free = Capacity(
            cores=max(0.0, round(capacity.cores - reserved.cores, 6)),
            memory_bytes=max(0, capacity.memory_bytes - reserved.memory_bytes),
            disk_bytes=max(0, capacity.disk_bytes - reserved.disk_bytes),
            gpus=max(0, capacity.gpus - reserved.gpus),
        )
        has_room = free.cores >= _MIN_CORES and min(free.memory_bytes, free.disk_bytes) >= _MIN_BYTES
        return free if has_room else None

    def max_claimed(self, job_count: int) -> int:
        """Return how many jobs may be claimed at once beside `job_count`, each with all that `free` returns.

        One on a machine; on a cluster, which queues jobs, as many as may be submitted.
        """
        return 1

    @abstractmethod
    def prepare_image(self, image: str) -> PinnedImage:
        """Make an image available, which may take minutes.

        Raises:
            CannotStart: it is not available.
        """

    @abstractmethod
    def place_inputs(self, directory: Path, files: Mapping[str, InputFile], source: InputSource) -> None:
        """Provide files, by their relative paths, as the read-only inputs of a job whose `in/` is `directory`.

        Raises:
            NoSpace: the disk has no space for them.
            OSError: they cannot be placed.
        """

    def evict_unused(self) -> None:  # noqa: B027  most have nothing to remove
        """Remove cached inputs that no job has used for too long; called every few minutes.

        Raises:
            OSError: this is not possible at the moment.
        """

    @abstractmethod
    def place_environment(self, script: LockedScript, *, wait: Wait, show: Show) -> Environment:
        """Return the environment of a script, installed if it is not yet: that takes up to minutes.

        Raises:
            CannotStart: it cannot be installed here.
        """

    @abstractmethod
    def find_environment(self, packages: Path) -> Environment | None:
        """Return the environment with these packages, which a job of an earlier runner process uses."""

    @abstractmethod
    def submit(self, job: RunJob) -> None:
        """Start a job and return.

        Raises:
            CannotStart: it cannot be started.
        """

    def was_submitted(self, job: RunJob, wait: Wait) -> bool:
        """Whether an earlier runner process submitted a job, which it was about to; True where `poll` tells.

        Raises:
            Exception: `wait` raised it.
        """
        return True

    @abstractmethod
    def poll(self, job: RunJob) -> Ending | None:
        """Return how a job ended, or None while it runs; enforce its limits. To be called at least every second."""

    def reason_waiting(self, job: RunJob) -> str | None:
        """Return why a submitted job has not started yet, such as the reason of a cluster's queue; None once it has."""
        return None

    def placement(self, job: RunJob) -> RunPlacement | None:
        """Return where a job is, and what its cluster measured."""
        return None

    @abstractmethod
    def set_lease(self, job: RunJob, until_s: float, *, create: bool = False) -> None:
        """Have a job ended at `until_s` (of `boot_time_s`) unless that is extended. `create`: it has no lease yet.

        Raises:
            OSError: it has no lease, or that cannot be written.
        """

    @abstractmethod
    def read_log(self, job: RunJob, offset: int, size_bytes: int) -> bytes:
        """Return bytes of the output of a job, which are final once they are there; empty where there are none yet."""

    @abstractmethod
    def cancel(self, job: RunJob) -> None:
        """Ask a job to end, and kill it `GRACE_S` later; return at once. No effect on one that has ended.

        Raises:
            OSError: this is not possible at the moment.
        """

    @abstractmethod
    def usage(self, job: RunJob) -> Usage | None:
        """Return the last known usage of a job; None where nothing is known, or nothing new."""

    @abstractmethod
    def collect(self, job: RunJob) -> Path:
        """Return the directory on this machine with the files that an ended job left in `/out`."""

    def upload_results(self, job: RunJob, plain: RunFinish, wait: Wait, show: Show) -> StoredResults | None:
        """Have the results of an ended job uploaded from where it ran, and return what was stored. Repeatable.

        None: `collect` has them, and the runner uploads them. `plain` is what to report without results. `show` gets
        `UPLOADING`, and what that waits for.

        Raises:
            Exception: `wait` raised it.
        """
        return None

    @abstractmethod
    def remove(self, job: RunJob) -> None:
        """Kill a job if it runs, and release its resources; its directory stays."""

    @abstractmethod
    def remove_others(self, known_keys: Collection[str]) -> None:
        """Remove the jobs of this runner whose keys are not known."""

    def close(self) -> None:  # noqa: B027  most have no threads
        """End its threads; jobs go on."""


def read_finish(directory: Path, attempt: int, start: str = "") -> RunFinish | None:
    """Return what the node of an attempt leaves to report; None where it has not uploaded all results."""
    try:
        finish = RunFinish.model_validate_json(finish_file(directory, start).read_bytes())
    except (FileNotFoundError, ValidationError):
        return None
    return finish if finish.attempt == attempt else None


def wait_for_end(executor: Executor, job: RunJob, timeout_s: float) -> Ending | None:
    """Poll a job until it has ended, and return how; None after the timeout."""
    deadline = time.monotonic() + timeout_s
    pause_s = 0.02
    while (ending := executor.poll(job)) is None:
        remaining_s = deadline - time.monotonic()
        if remaining_s <= 0:
            return None
        time.sleep(min(pause_s, remaining_s))
        pause_s = min(2 * pause_s, _POLL_EVERY_S)
    return ending
