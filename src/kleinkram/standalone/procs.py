"""What /proc knows of processes: when they started, whom they belong to, which port they hold. Only reads."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from kleinkram.standalone.child import MARKER

_PROC = Path("/proc")


def start_ticks(pid: int) -> int | None:
    """When the process started, in clock ticks since boot: with the pid, the identity of a process. None: gone."""
    try:
        stat = (_PROC / str(pid) / "stat").read_bytes()
    except OSError:
        return None
    # Source: proc(5), field 22; the command in field 2 may hold spaces and brackets.
    return int(stat.rpartition(b")")[2].split()[19])


def marked_processes(data_dir: Path) -> list[int]:
    """Pids of living processes that were started for this data directory by any supervisor."""
    wanted = f"{MARKER}={data_dir}".encode()
    return [pid for pid in _pids() if wanted in _read(pid, "environ").split(b"\0") and not _is_zombie(pid)]


def users_of_folder(folder: Path, *, program: str) -> list[int]:
    """Pids of living processes of `program` whose working directory is `folder`."""
    wanted = program.encode()
    return [pid for pid in _pids() if _link(pid, "cwd") == str(folder) and _read(pid, "comm").strip() == wanted]


def listener(port: int) -> str | None:
    """Who listens on the TCP port: `name (pid N)`, or None where nobody does or it cannot be known."""
    inodes = {f"socket:[{inode}]" for inode in _listening_inodes(port)}
    for pid in _pids() if inodes else ():
        with contextlib.suppress(OSError):
            for descriptor in (_PROC / str(pid) / "fd").iterdir():
                if _link(pid, f"fd/{descriptor.name}") in inodes:
                    return f"{_read(pid, 'comm').decode(errors='replace').strip()} (pid {pid})"
    return None


def _pids() -> list[int]:
    return [int(name) for name in os.listdir(_PROC) if name.isdigit() and int(name) != os.getpid()]  # noqa: PTH208  (names suffice: a hundred Path objects per scan do not)


def _read(pid: int, name: str) -> bytes:
    try:
        return (_PROC / str(pid) / name).read_bytes()
    except OSError:
        return b""


def _link(pid: int, name: str) -> str:
    try:
        return str((_PROC / str(pid) / name).readlink())
    except OSError:
        return ""


def _is_zombie(pid: int) -> bool:
    return _read(pid, "stat").rpartition(b")")[2].split()[:1] == [b"Z"]


def _listening_inodes(port: int) -> Iterator[str]:
    for table in ("tcp", "tcp6"):
        with contextlib.suppress(OSError):
            for line in (_PROC / "net" / table).read_text().splitlines()[1:]:
                fields = line.split()
                # Source: proc(5), /proc/net/tcp: state 0A is LISTEN.
                if fields[3] == "0A" and int(fields[1].rpartition(":")[2], 16) == port:
                    yield fields[9]
