"""What this machine has for runs, where nobody says how much of it they may use."""

import contextlib
import os
import shutil
from dataclasses import dataclass
from pathlib import Path

from kleinkram.contract.actions import Resources
from kleinkram.contract.runners import Capacity

_MEMORY_SHARE = 0.8
# Of what is free: the rest is for the cache of inputs, and for whatever else the disk is for.
_DISK_SHARE = 0.5
_CACHE_SHARE = 0.3
_CGROUP = Path("/sys/fs/cgroup/memory.max")


@dataclass(frozen=True)
class Share:
    """What runs may use of a machine; None: what it has."""

    cores: float | None = None
    memory_bytes: int | None = None
    disk_bytes: int | None = None
    gpus: int = 0
    cache_bytes: int | None = None


def capacity_of(share: Share, folder: Path, *, used_bytes: int) -> Capacity:
    """Return what runs may use at the same time; `used_bytes` of the disk are the runner's already."""
    room = shutil.disk_usage(folder).free + used_bytes
    return Capacity(
        cores=share.cores or len(os.sched_getaffinity(0)),
        memory_bytes=share.memory_bytes or int(memory_bytes() * _MEMORY_SHARE),
        disk_bytes=share.disk_bytes or int(room * _DISK_SHARE),
        gpus=share.gpus,
    )


def cache_bytes_of(share: Share, folder: Path, *, used_bytes: int) -> int:
    """Return how much of the disk the cache of inputs may take."""
    return share.cache_bytes or int((shutil.disk_usage(folder).free + used_bytes) * _CACHE_SHARE)


def what_is_left(capacity: Capacity, held: list[Resources]) -> Capacity:
    """Return what of a machine no run has been promised."""
    return Capacity(
        cores=max(0.0, round(capacity.cores - sum(each.cores for each in held), 6)),
        memory_bytes=max(0, capacity.memory_bytes - sum(each.memory_bytes for each in held)),
        disk_bytes=max(0, capacity.disk_bytes - sum(each.disk_bytes for each in held)),
        gpus=max(0, capacity.gpus - sum(each.gpus for each in held)),
    )


def memory_bytes() -> int:
    """Return the memory of this machine, or of the container this is in."""
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    with contextlib.suppress(OSError, ValueError):
        return min(total, int(_CGROUP.read_text()))
    return total
