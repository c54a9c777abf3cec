"""Child processes that end with their parent, and information from /proc about processes of this machine.

Each child is signalled by the kernel when the *thread* that started it ends (PR_SET_PDEATHSIG), so start children from
the main thread. Processes of an earlier supervisor are signalled through a pidfd that was opened before their identity
was checked: never a recycled pid.
"""

import contextlib
import ctypes
import os
import select
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from kleinkram.standalone.errors import ServiceFailed

_MARKER = "KLEINKRAM_INSTANCE"  # environment variable of every child: the data directory it belongs to
_INHERITED = {"PATH", "HOME", "TMPDIR", "TZ", "VIRTUAL_ENV", "PYTHONPATH"}  # no locale, and no AWS_* credentials
_STOP_TIMEOUT_S = 5.0
_PR_SET_PDEATHSIG = 1
_CLONE_NEWUSER = 0x10000000
_PROC = Path("/proc")
_libc = ctypes.CDLL(None, use_errno=True)


@dataclass(frozen=True)
class ProcessUser:
    """Who a child runs as: the caller (default), another uid, or the caller by another uid in a user namespace."""

    uid: int | None = None
    gid: int | None = None
    in_namespace: bool = False


CALLER = ProcessUser()


@dataclass(frozen=True)
class ChildCommand:
    """A program to start.

    `death_signal` is sent when its parent thread ends. `log` receives stdout and stderr, appended.
    `waits`: it reads a line from stdin before it begins; see `release`.
    """

    arguments: Sequence[str]
    data_dir: Path
    log: Path
    environment: Mapping[str, str] = field(default_factory=dict)
    directory: Path = Path("/")
    death_signal: signal.Signals = signal.SIGKILL
    user: ProcessUser = CALLER
    waits: bool = False


def spawn(command: ChildCommand) -> "subprocess.Popen[bytes]":
    """Start the program in its own session, bound to the life of the calling thread.

    Raises:
        OSError: the program or its working directory cannot be used.
    """
    inherited = {
        name: value for name, value in os.environ.items() if name in _INHERITED or name.startswith("KLEINKRAM_")
    }
    descriptor = os.open(command.log, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o600)
    try:
        return subprocess.Popen(
            list(command.arguments),
            stdin=subprocess.PIPE if command.waits else subprocess.DEVNULL,
            stdout=descriptor,
            stderr=descriptor,
            env={**inherited, **command.environment, _MARKER: str(command.data_dir)},
            cwd=command.directory,
            start_new_session=True,
            preexec_fn=_before_exec(command.user, command.death_signal),
        )
    finally:
        os.close(descriptor)


def spawn_in_terminal(arguments: Sequence[str], environment: Mapping[str, str]) -> "subprocess.Popen[bytes]":
    """Start a program that uses this process's terminal, and is killed when the calling thread ends."""
    return subprocess.Popen(list(arguments), env=dict(environment), preexec_fn=_before_exec(CALLER, signal.SIGKILL))


def release(child: "subprocess.Popen[bytes]") -> None:
    """Let a waiting child begin; does nothing if the child does not wait, or has ended."""
    if child.stdin is not None and not child.stdin.closed:
        with contextlib.suppress(BrokenPipeError):
            child.stdin.write(b"begin\n")
            child.stdin.flush()
        with contextlib.suppress(BrokenPipeError):
            child.stdin.close()


def stop(child: "subprocess.Popen[bytes]", *, sign: signal.Signals, timeout_s: float) -> None:
    """End the child with `sign`, after `timeout_s` with SIGKILL, then kill the rest of its process group."""
    if child.poll() is None:
        child.send_signal(sign)
        try:
            child.wait(timeout_s)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()
    kill_group(child)


def kill_group(child: "subprocess.Popen[bytes]") -> None:
    """Kill what remains of a dead child's process group."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(child.pid, signal.SIGKILL)


def can_enter_namespace() -> bool:
    """Whether this process may start children in a user namespace of their own; containers often forbid it."""
    pid = os.fork()
    if pid == 0:
        try:
            _enter_namespace()
        except OSError:
            os._exit(1)
        os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 0


def start_ticks(pid: int) -> int | None:
    """Return when the process started, in clock ticks since boot: with the pid, its identity. None if it has ended."""
    # Source: proc(5), field 22; the command in field 2 may contain spaces and brackets.
    fields = _read(pid, "stat").rpartition(b")")[2].split()
    return int(fields[19]) if fields else None


def marked_processes(data_dir: Path) -> list[int]:
    """Return the pids of running processes that a supervisor started for this data directory."""
    marker = f"{_MARKER}={data_dir}".encode()
    return [pid for pid in _pids() if marker in _read(pid, "environ").split(b"\0") and not _is_zombie(pid)]


def end_marked_processes(data_dir: Path) -> None:
    """End every process of an earlier supervisor of this data directory. The caller holds its lock.

    Raises:
        ServiceFailed: one of them does not end.
    """
    # SIGINT lets PostgreSQL close its files; after a kill it recovers.
    for sign in (signal.SIGINT, signal.SIGKILL):
        for pid in marked_processes(data_dir):
            with open_pidfd(pid) as descriptor:
                if descriptor is not None and pid in marked_processes(data_dir):
                    with contextlib.suppress(ProcessLookupError):
                        signal.pidfd_send_signal(descriptor, sign)
        deadline = time.monotonic() + _STOP_TIMEOUT_S
        while marked_processes(data_dir) and time.monotonic() < deadline:
            time.sleep(0.02)
    if remaining := marked_processes(data_dir):
        raise ServiceFailed(
            f"Processes {', '.join(map(str, remaining))} of an earlier start on {data_dir} do not end: "
            "restart the machine, or name another --data-dir."
        )


@contextlib.contextmanager
def open_pidfd(pid: int) -> Iterator[int | None]:
    """Open a descriptor of a process, which no later process with its pid shares; None if it has ended."""
    try:
        descriptor = os.pidfd_open(pid)
    except ProcessLookupError:
        yield None
        return
    try:
        yield descriptor
    finally:
        os.close(descriptor)


def wait_for_end(pidfd: int, timeout_s: float) -> bool:
    """Wait until a process has ended; returns whether it has."""
    poll = select.poll()
    poll.register(pidfd, select.POLLIN)
    return bool(poll.poll(timeout_s * 1000))


def users_of_folder(folder: Path, *, program: str) -> list[int]:
    """Return the pids of running processes of `program` whose working directory is `folder`."""
    name = program.encode()
    return [pid for pid in _pids() if _link(pid, "cwd") == str(folder) and _read(pid, "comm").strip() == name]


def port_listener(port: int) -> str | None:
    """Return who listens on the TCP port, `name (pid N)`; None where nobody does or it cannot be known."""
    inodes = {f"socket:[{inode}]" for inode in _listening_inodes(port)}
    for pid in _pids() if inodes else ():
        with contextlib.suppress(OSError):
            for descriptor in (_PROC / str(pid) / "fd").iterdir():
                if _link(pid, f"fd/{descriptor.name}") in inodes:
                    return f"{_read(pid, 'comm').decode(errors='replace').strip()} (pid {pid})"
    return None


def _before_exec(user: ProcessUser, death_signal: signal.Signals) -> Callable[[], None]:
    """Return what runs between fork and exec. Safe because only one thread starts children."""
    parent = os.getpid()

    def run() -> None:
        signal.pthread_sigmask(signal.SIG_SETMASK, [])
        if user.in_namespace:
            _enter_namespace()
        elif user.uid is not None and user.gid is not None:
            os.setgroups([])
            os.setresgid(user.gid, user.gid, user.gid)
            os.setresuid(user.uid, user.uid, user.uid)
        # After the change of user, which would clear it.
        if _libc.prctl(_PR_SET_PDEATHSIG, int(death_signal), 0, 0, 0) != 0:
            raise OSError(ctypes.get_errno(), "prctl(PR_SET_PDEATHSIG)")
        if os.getppid() != parent:  # the parent ended before the line above
            os._exit(1)

    return run


def _enter_namespace() -> None:
    """Become uid and gid 65534 in a new user namespace; file permissions stay those of the caller."""
    uid, gid = os.getuid(), os.getgid()
    if _libc.unshare(_CLONE_NEWUSER) != 0:
        raise OSError(ctypes.get_errno(), "unshare(CLONE_NEWUSER)")
    Path("/proc/self/setgroups").write_text("deny")
    Path("/proc/self/uid_map").write_text(f"65534 {uid} 1")
    Path("/proc/self/gid_map").write_text(f"65534 {gid} 1")


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
