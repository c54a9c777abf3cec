"""What the executors of one machine share: its capacity, the cache of inputs, and the directories of jobs.

The directory of a job outlives the process of the runner:

    in/ out/ tmp/   what the job sees as `/in` (read-only), `/out` and `/tmp`
    log             its output, up to `LOG_BYTES`
    lease           until when it may run
    ...             and what its executor needs
"""

import contextlib
import os
import shutil
import zlib
from abc import abstractmethod
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from kleinkram.client.errors import InvalidInput
from kleinkram.contract.isolation import Isolation
from kleinkram.contract.runners import Capacity
from kleinkram.contract.runs import LOG_BYTES, EndReason, RunPlacement
from kleinkram.environments.cache import CannotInstall, Environment, EnvironmentCache, EnvironmentRequest, Show
from kleinkram.environments.python import Python, PythonUnknown
from kleinkram.environments.uv import PackageIndex, Wait, find_uv
from kleinkram.machine import memory_bytes
from kleinkram.runner.executors.base import CannotStart, Ending, Executor, LockedScript, RunJob
from kleinkram.runner.executors.gpu_pool import GpuPool, GpusUnavailable, acquire_gpus, recorded_gpus
from kleinkram.runner.executors.gpus import OPTION, Gpu, GpuRequest
from kleinkram.runner.executors.port_forward import loopback_addresses
from kleinkram.runner.executors.supervision import JobLimits, read_log_of, write_lease
from kleinkram.runner.input_cache import InputCache, InputFile, InputSource, place_inputs

_MEMORY_SHARE = 0.8
# Shares of the free disk; the rest is for others.
_DISK_SHARE = 0.5
_CACHE_SHARE = 0.3
_ENVIRONMENTS_SHARE = 0.1
_DAY_S = 86_400.0
_IMAGES_SHARE = 0.2
# Where the runner is root, each job has its own uid, from a range that no system assigns.
_FIRST_UID = 1_000_000_000
_UIDS = 1_000_000_000


@dataclass(frozen=True)
class MachineShare:
    """Resources of the machine for runs; None: the default share."""

    cores: float | None = None
    memory_bytes: int | None = None
    disk_bytes: int | None = None
    gpus: GpuRequest = field(default_factory=GpuRequest)
    cache_bytes: int | None = None
    environments_bytes: int | None = None
    cache_age_days: int | None = None
    images_bytes: int | None = None


class Machine:
    """This machine: its capacity for runs, and the caches in `directory`, which the runner already uses.

    Its GPUs stay locked until this process ends. `index` is where the packages of scripts come from; without it,
    or without `uv`, none are installed.

    Raises:
        InvalidInput: the GPUs of `share` are not available.
    """

    def __init__(self, directory: Path, share: MachineShare, index: PackageIndex | None = None) -> None:
        space = shutil.disk_usage(directory).free + _used_bytes(directory)
        self.gpus = acquire_gpus(share.gpus, directory / "runs")
        self.capacity = Capacity(
            cores=share.cores or len(os.sched_getaffinity(0)),
            memory_bytes=share.memory_bytes or int(memory_bytes() * _MEMORY_SHARE),
            disk_bytes=share.disk_bytes or int(space * _DISK_SHARE),
            gpus=len(self.gpus.gpus) if self.gpus is not None else 0,
        )
        max_age_s = share.cache_age_days * _DAY_S if share.cache_age_days else None
        self.cache = InputCache(directory / "cache", share.cache_bytes or int(space * _CACHE_SHARE), max_age_s)
        self.images_folder = directory / "images"
        self.images_bytes = share.images_bytes or int(space * _IMAGES_SHARE)
        self.environments: EnvironmentCache | None = None
        if index is not None and find_uv() is not None:
            limit_bytes = share.environments_bytes or int(space * _ENVIRONMENTS_SHARE)
            self.environments = EnvironmentCache(directory / "environments", index, limit_bytes)


def _used_bytes(directory: Path) -> int:
    total = 0
    for parent, _, names in os.walk(directory):
        for name in names:
            with contextlib.suppress(OSError):
                status = (Path(parent) / name).lstat()
                total += status.st_blocks * 512 // status.st_nlink
    return total


class LocalExecutor(Executor):
    """Runs jobs on this machine. `machine` is only needed for capacity and inputs.

    `environments` are those of scripts; by default the machine's.
    """

    def __init__(self, machine: Machine | None = None, environments: EnvironmentCache | None = None) -> None:
        self._machine = machine
        self._own_environments = environments
        self._own_gpus: GpuPool | None = None

    @property
    def capacity(self) -> Capacity:
        """The resources of this machine for runs."""
        return self._required_machine().capacity

    def free(self, reserved: Capacity, job_count: int) -> Capacity | None:
        """Return what is free; of GPUs that runs may share, as many as a single run can have."""
        free = super().free(reserved, job_count)
        if free is None or self._gpus is None:
            return free
        return free.model_copy(update={"gpus": self._gpus.free_count(reserved.gpus)})

    def placement(self, job: RunJob) -> RunPlacement | None:
        """Return which GPUs a job has; None where it has none."""
        gpus = recorded_gpus(job.directory)
        return RunPlacement(gpus=gpus) if gpus else None

    @abstractmethod
    def gpu_obstacle(self, gpu: Gpu) -> str | None:
        """Return why this executor cannot give a GPU to jobs, and what to do about that; None where it can."""

    def check_gpus(self) -> None:
        """Check that jobs can have the GPUs of the machine.

        Raises:
            InvalidInput: they cannot.
        """
        for gpu in self._gpus.gpus if self._gpus is not None else ():
            if (obstacle := self.gpu_obstacle(gpu)) is not None:
                raise InvalidInput(what=OPTION, reason=obstacle)

    def _assign_gpus(self, job: RunJob, in_use: Collection[str] = ()) -> tuple[Gpu, ...]:
        """Give a job the GPUs that it needs. `in_use`: ids of GPUs not to be given."""
        if not job.resources.gpus:
            return ()
        try:
            if self._machine is None and self._own_gpus is None:
                # A local run takes what it needs. It has no other jobs, nor a next process.
                self._own_gpus = acquire_gpus(GpuRequest(job.resources.gpus), job.directory)
                self.check_gpus()
            if self._gpus is None:
                raise GpusUnavailable("Its runner has no GPU for runs.")
            return self._gpus.assign(job, in_use)
        except (GpusUnavailable, InvalidInput) as error:
            raise cannot_start(str(error)) from error
        except OSError as error:
            raise cannot_start(f"Its GPUs cannot be recorded: {error.strerror}.") from error

    @property
    def _gpus(self) -> GpuPool | None:
        return self._machine.gpus if self._machine is not None else self._own_gpus

    def _release_gpus(self, job: RunJob) -> None:
        if self._gpus is not None:
            self._gpus.release(job)

    def place_inputs(self, directory: Path, files: Mapping[str, InputFile], source: InputSource) -> None:
        """Link inputs from the cache, or copy them where the job could change them."""
        copy = self.abilities.isolation is Isolation.none
        place_inputs(self._required_machine().cache, directory, files, source, copy=copy)

    def evict_unused(self) -> None:
        """Evict inputs that no run has used for long."""
        if self._machine is not None:
            self._machine.cache.evict_old()

    def place_environment(self, script: LockedScript, *, wait: Wait, show: Show) -> Environment:
        """Return an environment of the cache, for the Python of the image or of this process."""
        cache = self._environments
        if cache is None:
            raise cannot_start("Its runner installs no packages: it has no package index, or no uv.")
        image = script.image
        try:
            request = EnvironmentRequest(script.lock, self._find_python(image), script.requires_python, image)
            return cache.get(
                request,
                wait=wait,
                show=show,
                compile_in=lambda folder, wait: self._compile_packages(image, folder, wait),
            )
        except (CannotInstall, PythonUnknown) as error:
            raise cannot_start(f"Its packages cannot be installed. {error}") from error
        except OSError as error:
            raise cannot_start(f"Its packages cannot be installed: {error.strerror or error}.") from error

    def find_environment(self, packages: Path) -> Environment | None:
        """Return an environment of the cache."""
        return self._environments.find(packages.parent.name) if self._environments is not None else None

    @property
    def _environments(self) -> EnvironmentCache | None:
        if self._own_environments is None and self._machine is not None:
            return self._machine.environments
        return self._own_environments

    @abstractmethod
    def _find_python(self, image: str | None) -> Python:
        """Return the Python that scripts run with in an image. Raises PythonUnknown."""

    @abstractmethod
    def _compile_packages(self, image: str | None, folder: Path, wait: Wait) -> None:
        """Write the bytecode of a folder of packages, for the Python of an image."""

    def set_lease(self, job: RunJob, until_s: float, *, create: bool = False) -> None:
        """Write the lease beside the job. A directory that is being removed does not get it back."""
        write_lease(job.directory, until_s, create=create)

    def read_log(self, job: RunJob, offset: int, size_bytes: int) -> bytes:
        """Read the log file of the job."""
        return read_log_of(job.directory, offset, size_bytes)

    def collect(self, job: RunJob) -> Path:
        """Return the directory that the job saw as `/out`."""
        return job.directory / "out"

    def _check_network(self, job: RunJob, refusal: str) -> None:
        if job.network not in self.abilities.networks:
            raise cannot_start(refusal)
        try:
            loopback_addresses([forward.host for forward in job.port_forwards])
        except ValueError as error:
            raise cannot_start(f"Its network is not possible here: {error}.") from error

    def _required_machine(self) -> Machine:
        if self._machine is None:
            raise RuntimeError("this executor was created without a machine")
        return self._machine


def cannot_start(message: str, reason: EndReason = EndReason.not_possible) -> CannotStart:
    """Return the error of a job that cannot be started."""
    return CannotStart(Ending(reason, message))


def limits_of(job: RunJob) -> JobLimits:
    """Return the limits of a job."""
    return JobLimits(job.resources.memory_bytes, job.resources.disk_bytes, job.resources.time_s, LOG_BYTES)


def make_directories(job: RunJob, *, own_uid: bool) -> int | None:
    """Create the directories of a job and return its uid; None where it runs as the user of the runner."""
    uid = _FIRST_UID + zlib.crc32(job.key.encode()) % _UIDS if own_uid else None
    for name in ("in", "out", "tmp"):
        (job.directory / name).mkdir(exist_ok=True)
        if uid is not None and name != "in":
            os.chown(job.directory / name, uid, uid)
    return uid
