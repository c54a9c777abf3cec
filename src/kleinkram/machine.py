"""This machine. Imports nothing of ours: the supervisor of `klein up` needs it, and should start quickly."""

import contextlib
import os
from pathlib import Path

_CGROUP_MEMORY = Path("/sys/fs/cgroup/memory.max")


def memory_bytes() -> int:
    """Return the memory of this machine, or of the container that this process is in."""
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    with contextlib.suppress(OSError, ValueError):
        return min(total, int(_CGROUP_MEMORY.read_text()))
    return total
