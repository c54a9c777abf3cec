"""What a container uses, by the kernel's own accounts: cheaper and fresher than to ask the engine.

Both versions of control groups are read. Imports nothing but Python's own library, since wardens wait for it.
"""

from pathlib import Path
from typing import NamedTuple

_ROOT = Path("/sys/fs/cgroup")


class Used(NamedTuple):
    """What a container uses. `memory_bytes` is without files that are only cached."""

    cpu_s: float
    memory_bytes: int
    read_bytes: int
    written_bytes: int


def groups_of(pid: int) -> dict[str, str]:
    """Return the control groups of a process by their controllers; version 2 is the controller with no name.

    Raises:
        OSError: it is over, or not a process of this machine.
    """
    lines = Path(f"/proc/{pid}/cgroup").read_text().splitlines()
    parts = [line.split(":", 2) for line in lines]
    return {name: path for _, names, path in parts for name in names.split(",")}


def usage_of(groups: dict[str, str], root: Path = _ROOT) -> Used | None:
    """Return what the processes of control groups use together, or None where they are gone or not seen here."""
    try:
        return _usage_1(groups, root) if "memory" in groups else _usage_2(root / groups[""].lstrip("/"))
    except (OSError, KeyError):
        return None


def ended_for_memory(groups: dict[str, str], root: Path = _ROOT) -> bool:
    """Whether the kernel has ended a process of control groups for its memory; False where they are gone."""
    try:
        if "memory" in groups:
            told = root / "memory" / groups["memory"].lstrip("/") / "memory.oom_control"
        else:
            told = root / groups[""].lstrip("/") / "memory.events"
        return _table(told.read_text())["oom_kill"] > 0
    except (OSError, KeyError):
        return False


def _usage_1(groups: dict[str, str], root: Path) -> Used:
    memory, cpu, disk = (root / name / groups[name].lstrip("/") for name in ("memory", "cpuacct", "blkio"))
    cached = _table((memory / "memory.stat").read_text())["total_inactive_file"]
    used = int((memory / "memory.usage_in_bytes").read_text()) - cached
    moved = [line.split() for line in (disk / "blkio.throttle.io_service_bytes_recursive").read_text().splitlines()]
    read, written = (sum(int(each[2]) for each in moved if each[1:2] == [word]) for word in ("Read", "Write"))
    return Used(int((cpu / "cpuacct.usage").read_text()) / 1e9, max(used, 0), read, written)


def _usage_2(group: Path) -> Used:
    cached = _table((group / "memory.stat").read_text())["inactive_file"]
    used = int((group / "memory.current").read_text()) - cached
    words = (group / "io.stat").read_text().split()
    moved = [word.split("=") for word in words if "=" in word]
    read, written = (sum(int(value) for name, value in moved if name == word) for word in ("rbytes", "wbytes"))
    return Used(_table((group / "cpu.stat").read_text())["usage_usec"] / 1e6, max(used, 0), read, written)


def _table(text: str) -> dict[str, int]:
    return {name: int(value) for name, value in (line.split() for line in text.splitlines())}
