"""The room of a run: its own root with nothing in it but the system's programs, Python, and the run's folders.

Made of namespaces. As root, the run becomes a uid of its own; as anybody else, it is in a user namespace. Either way it
sees no home, no data of Kleinkram, no other process, and no network unless it has one. Imports nothing but Python's own
library, since every run waits for it.
"""

import os
import resource
import signal
import socket
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from kleinkram.runner import doors
from kleinkram.runner.process import kernel

_INSIDE_UID = 1000
_SYSTEM = ("/usr", "/bin", "/sbin", "/lib", "/lib32", "/lib64", "/etc", "/opt")
_DEVICES = ("null", "zero", "full", "random", "urandom")
SHARED_MEMORY = Path("dev/shm")
SHARED_MEMORY_BYTES = 64 * 2**20
_PROCESSES = 1024
# A file may be so much larger than what all may be: else nobody could tell that it was the disk.
_FILE_BEYOND_DISK_BYTES = 64 * 2**20


@dataclass(frozen=True)
class Room:
    """Where and as whom a command runs. `uid` is None where this process cannot be anybody else.

    The listening sockets of its doors are sent to `doorkeeper`.
    """

    folder: Path
    has_network: bool
    disk_bytes: int
    uid: int | None
    ways: Sequence[doors.Way]
    doorkeeper: socket.socket


def can_be_made() -> bool:
    """Whether the kernel gives this process a room: it is tried."""
    pid = os.fork()
    if pid == 0:
        try:
            _leave_namespaces(has_network=False)
            # The first process of a new process namespace: only it can mount what belongs there.
            inner = os.fork()
            if inner == 0:
                kernel.mount("none", Path("/"), None, kernel.MS_REC | kernel.MS_PRIVATE)
                kernel.mount("tmpfs", Path("/tmp"), "tmpfs", 0)  # noqa: S108  in a namespace that ends with this line
                kernel.make_read_only(Path("/tmp"))  # noqa: S108
                kernel.give_up_privileges()
                kernel.deny_uncounted_memory()
                os._exit(0)
            os._exit(os.waitstatus_to_exitcode(os.waitpid(inner, 0)[1]) & 0xFF)
        except BaseException:
            os._exit(1)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 0


def run_in(room: Room, command: Sequence[str], environment: Mapping[str, str], failed: int) -> int:
    """Run a command in a new room and return its exit code, 128 + n if a signal ended it. For a process of its own.

    What keeps it from starting is written to the descriptor `failed`, which the command does not inherit.
    """
    kernel.die_with_parent(signal.SIGKILL)
    _leave_namespaces(has_network=room.has_network)
    first = os.fork()
    if first == 0:
        try:
            _be_first(room, command, environment, failed)
        except BaseException as error:
            os.write(failed, f"{type(error).__name__}: {error}".encode())
            os._exit(126)
    os.close(failed)
    return _code_of(first)


def _leave_namespaces(*, has_network: bool) -> None:
    flags = kernel.CLONE_NEWNS | kernel.CLONE_NEWPID | kernel.CLONE_NEWIPC | kernel.CLONE_NEWUTS
    if not has_network:
        flags |= kernel.CLONE_NEWNET
    uid, gid = os.getuid(), os.getgid()
    if uid != 0:
        kernel.unshare(flags | kernel.CLONE_NEWUSER)
        kernel.map_identity(uid, gid, inside=_INSIDE_UID)
    else:
        kernel.unshare(flags)


def _be_first(room: Room, command: Sequence[str], environment: Mapping[str, str], failed: int) -> None:
    """Be the first process of the namespace: furnish the room, start the command, and outlive what it leaves."""
    kernel.die_with_parent(signal.SIGKILL)
    _furnish(room)
    if not room.has_network:
        kernel.raise_loopback()
        _make_doors(room)
    if room.uid is not None:
        os.setgroups([])
        os.setresgid(room.uid, room.uid, room.uid)
        os.setresuid(room.uid, room.uid, room.uid)
        kernel.die_with_parent(signal.SIGKILL)
    bound(room)
    os.chdir("/tmp")  # noqa: S108  the run's own
    pid = os.fork()
    if pid == 0:
        os.setsid()
        for sign in (signal.SIGTERM, signal.SIGINT, signal.SIGPIPE, signal.SIGHUP):
            signal.signal(sign, signal.SIG_DFL)
        try:
            os.execvpe(command[0], list(command), dict(environment))  # noqa: S606  what runs are for
        except OSError as error:
            os.write(failed, f"not found: {command[0]}: {error.strerror}".encode())
            os._exit(127)
    os.close(failed)
    # Being asked to end, it passes that on: the kernel shields the first process from signals it has no handler for.
    signal.signal(signal.SIGTERM, lambda *_: _tell_all())
    os._exit(_code_of(pid))


def _make_doors(room: Room) -> None:
    listeners = doors.listen(room.ways)
    socket.send_fds(room.doorkeeper, [b"doors"], [each.fileno() for each in listeners])
    for each in (*listeners, room.doorkeeper):
        each.close()


def _tell_all() -> None:
    try:
        os.kill(-1, signal.SIGTERM)
    except ProcessLookupError:
        return


def _code_of(pid: int) -> int:
    """Wait for a child and reap all others that come by."""
    while True:
        ended, status = os.wait()
        if ended == pid:
            code = os.waitstatus_to_exitcode(status)
            return code if code >= 0 else 128 - code


def bound(room: Room) -> None:
    """Hold this process, and all it starts, to what one process may have."""
    kernel.give_up_privileges()
    kernel.deny_uncounted_memory()
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    largest = room.disk_bytes + _FILE_BEYOND_DISK_BYTES
    resource.setrlimit(resource.RLIMIT_FSIZE, (largest, largest))
    resource.setrlimit(resource.RLIMIT_NPROC, (_PROCESSES, _PROCESSES))


def _furnish(room: Room) -> None:
    kernel.mount("none", Path("/"), None, kernel.MS_REC | kernel.MS_PRIVATE)
    root = room.folder / "root"
    root.mkdir(exist_ok=True)
    kernel.mount("tmpfs", root, "tmpfs", kernel.MS_NOSUID | kernel.MS_NODEV, "size=1m,mode=755")
    for name in ("out", "tmp"):
        _bind(room.folder / name, root / name)
    # After those: Python itself may stand below /tmp.
    for place in _places():
        _show(place, root / str(place)[1:])
    _show(room.folder / "in", root / "in")
    _name_doors(room, root)
    _make_devices(root)
    (root / "proc").mkdir()
    kernel.mount("proc", root / "proc", "proc", kernel.MS_NOSUID | kernel.MS_NODEV)
    kernel.change_root(root)
    kernel.make_read_only(Path("/"), with_all_below=False)


def _name_doors(room: Room, root: Path) -> None:
    names = doors.names_of([way.host for way in room.ways])
    if names:
        hosts = room.folder / "hosts"
        hosts.write_text("127.0.0.1 localhost\n" + "".join(f"{address} {name}\n" for name, address in names.items()))
        hosts.chmod(0o644)
        target = root / "etc" / "hosts"
        kernel.mount(str(hosts), target, None, kernel.MS_BIND)
        kernel.make_read_only(target)


def _places() -> list[Path]:
    """What of this machine a script needs: the system's programs, this Python, and what it imports."""
    here = Path(__file__).resolve().parents[3]
    wanted = [Path(place) for place in (*_SYSTEM, sys.prefix, sys.base_prefix, here)]
    found = [place for place in dict.fromkeys(wanted) if place.exists()]
    # One inside of another is there already.
    return [place for place in found if not any(other in place.parents for other in found)]


def _show(source: Path, target: Path) -> None:
    """Let a file or folder of this machine be read there; a symlink stays one."""
    if source.is_symlink():
        target.parent.mkdir(parents=True, exist_ok=True)
        target.symlink_to(source.readlink())
        return
    _bind(source, target)
    kernel.make_read_only(target)


def _bind(source: Path, target: Path) -> None:
    target.mkdir(parents=True, exist_ok=True)
    kernel.mount(str(source), target, None, kernel.MS_BIND | kernel.MS_REC)


def _make_devices(root: Path) -> None:
    devices = root / "dev"
    (devices / "shm").mkdir(parents=True)
    for name in _DEVICES:
        (devices / name).touch()
        kernel.mount(f"/dev/{name}", devices / name, None, kernel.MS_BIND)
    for name, number in (("fd", ""), ("stdin", "/0"), ("stdout", "/1"), ("stderr", "/2")):
        (devices / name).symlink_to(f"/proc/self/fd{number}")
    flags = kernel.MS_NOSUID | kernel.MS_NODEV
    kernel.mount("tmpfs", devices / "shm", "tmpfs", flags, f"size={SHARED_MEMORY_BYTES},mode=1777")
