"""The GPUs of a runner, and which of its jobs have them.

A runner holds the lock of each of its GPUs (`machine_locks`), so that no other has the same. Which job has which is
written in the directory of the job, before it starts: the next process of the runner reads it there. The lock's file
names the directory of jobs that have the GPU, so that it stays theirs while no process of their runner runs.
"""

import contextlib
import json
import threading
from collections import Counter
from collections.abc import Collection, Sequence
from pathlib import Path

from kleinkram.client.errors import InvalidInput
from kleinkram.runner.executors.base import RunJob
from kleinkram.runner.executors.gpus import OPTION, Gpu, GpuRequest, find_gpus, list_of, select_named
from kleinkram.runner.executors.machine_locks import MachineLock
from kleinkram.runner.executors.supervision import write_atomically

_RECORD = "gpus.json"


class GpusUnavailable(Exception):
    """Fewer GPUs than a job needs are free."""


class GpuPool:
    """The GPUs of a runner. `jobs` is the directory of the directories of its jobs. Thread-safe."""

    def __init__(self, locks: Sequence[tuple[Gpu, MachineLock]], jobs: Path, sharing: int) -> None:
        self.gpus = tuple(gpu for gpu, _ in locks)
        self._locks = {gpu.id: lock for gpu, lock in locks}
        self._jobs = jobs
        self._sharing = sharing
        self._lock = threading.Lock()
        for gpu in self.gpus:
            self._write_holder(gpu.id, is_used=gpu.id in self._loads())

    def free_count(self, reserved: int) -> int:
        """Return how many the next job may have, where jobs that may not have theirs yet reserved so many."""
        loads = self._loads()
        with_room = sum(loads[gpu.id] < self._sharing for gpu in self.gpus)
        waiting = max(0, reserved - sum(loads[gpu.id] for gpu in self.gpus))
        return max(0, with_room - waiting)

    def assign(self, job: RunJob, in_use: Collection[str] = ()) -> tuple[Gpu, ...]:
        """Give a job its GPUs, the least used ones, and record that. `in_use` are ids not to be given.

        Raises:
            GpusUnavailable: fewer are free.
            OSError: it cannot be recorded.
        """
        count = job.resources.gpus
        with self._lock:
            loads = self._loads(without=job.directory)
            free = [gpu for gpu in self.gpus if loads[gpu.id] < self._sharing and gpu.id not in in_use]
            if len(free) < count:
                raise GpusUnavailable(
                    f"It needs {count} GPUs, and {len(free)} of its runner's {len(self.gpus)} are free."
                )
            chosen = tuple(sorted(free, key=lambda gpu: loads[gpu.id])[:count])
            for gpu in chosen:
                self._write_holder(gpu.id, is_used=True)
            write_atomically(job.directory / _RECORD, json.dumps([gpu.id for gpu in chosen]))
            return chosen

    def release(self, job: RunJob) -> None:
        """Take the GPUs of a job that has ended."""
        with self._lock:
            ids = recorded_gpus(job.directory)
            (job.directory / _RECORD).unlink(missing_ok=True)
            loads = self._loads()
            for gpu_id in ids:
                if not loads[gpu_id] and gpu_id in self._locks:
                    self._write_holder(gpu_id, is_used=False)

    def has_record(self, key: str) -> bool:
        """Whether the job of this key is one that it gave GPUs to."""
        return (self._jobs / key / _RECORD).exists()

    def close(self) -> None:
        """Release the locks."""
        for lock in self._locks.values():
            lock.close()

    def _loads(self, *, without: Path | None = None) -> Counter[str]:
        """Return by how many jobs each GPU is used."""
        return Counter(
            gpu_id
            for directory in _directories_in(self._jobs)
            if directory != without
            for gpu_id in recorded_gpus(directory)
        )

    def _write_holder(self, gpu_id: str, *, is_used: bool) -> None:
        # Nothing of this runner depends on it, should the disk be full.
        with contextlib.suppress(OSError):
            self._locks[gpu_id].write({"jobs": str(self._jobs)} if is_used else {})


def recorded_gpus(directory: Path) -> list[str]:
    """Return the ids of the GPUs of the job of a directory."""
    try:
        return [str(one) for one in json.loads((directory / _RECORD).read_text())]
    except (OSError, ValueError):
        return []


def acquire_gpus(request: GpuRequest, jobs: Path) -> GpuPool | None:
    """Lock GPUs of this machine for a runner with its jobs in a directory; None where the request is empty.

    GPUs that its jobs have come first.

    Raises:
        InvalidInput: there are not so many, not these, or others have them.
    """
    if request.is_empty:
        return None
    gpus = find_gpus()
    candidates = select_named(gpus, request.names) if request.names else gpus
    count = len(candidates) if request.names or request.count is None else request.count
    if not candidates or count > len(candidates):
        number = "all" if request.count is None else count
        raise InvalidInput(what=OPTION, reason=f"{number} are requested, and {list_of(gpus)}")
    mine = {gpu_id for directory in _directories_in(jobs) for gpu_id in recorded_gpus(directory)}
    locks: list[tuple[Gpu, MachineLock]] = []
    taken: list[str] = []
    for gpu in sorted(candidates, key=lambda gpu: gpu.id not in mine):
        if len(locks) == count:
            break
        lock = MachineLock(f"gpu-{gpu.id}")
        if reason := _reason_taken(lock, gpu, jobs):
            taken.append(f"{gpu.id} {reason}")
        else:
            locks.append((gpu, lock))
    is_short = len(locks) < count if request.count is not None or request.names else not locks
    if is_short:
        for _, lock in locks:
            lock.close()
        free = f"{count} GPUs are requested, and {len(locks)} are free"
        raise InvalidInput(what=OPTION, reason=f"{free}: {'; '.join(taken)}")
    locks.sort(key=lambda one: candidates.index(one[0]))
    return GpuPool(locks, jobs, request.sharing)


def _reason_taken(lock: MachineLock, gpu: Gpu, jobs: Path) -> str | None:
    """Take the lock of a GPU, or return who has it."""
    try:
        if not lock.try_acquire():
            return "belongs to another runner of this machine"
    except OSError as error:
        return f"cannot be locked: {lock.path}: {error.strerror}"
    others = lock.read().get("jobs")
    if others is None or others == str(jobs) or not _is_used_in(Path(str(others)), gpu.id):
        return None
    lock.close()
    return f"is used by a run of another runner, in {others}; if that runner is no more, remove {lock.path}"


def _is_used_in(jobs: Path, gpu_id: str) -> bool:
    try:
        directories = [*jobs.iterdir()]
    except (FileNotFoundError, NotADirectoryError):
        return False
    except OSError:
        # Those of another user.
        return True
    return any(gpu_id in recorded_gpus(directory) for directory in directories)


def _directories_in(jobs: Path) -> list[Path]:
    try:
        return [*jobs.iterdir()]
    except OSError:
        return []
