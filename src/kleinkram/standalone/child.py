"""Starting and ending child processes so that none outlives its parent.

Every child asks the kernel to be signalled when the *thread* that started it ends (PR_SET_PDEATHSIG), so children must
be started from a thread that lives as long as they may: the main thread. Never signals a process it did not start.
"""

import contextlib
import ctypes
import os
import signal
import subprocess
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

MARKER = "KLEINKRAM_INSTANCE"
"""Environment variable that every child carries: the data directory it belongs to."""

_PR_SET_PDEATHSIG = 1
_CLONE_NEWUSER = 0x10000000
_libc = ctypes.CDLL(None, use_errno=True)


@dataclass(frozen=True)
class Identity:
    """Who a child runs as: the caller (default), another uid, or the caller by another number in a user namespace."""

    uid: int | None = None
    gid: int | None = None
    in_namespace: bool = False


CALLER = Identity()


@dataclass(frozen=True)
class Command:
    """A program to start.

    `death_signal` is what it gets when its parent thread dies. `log` receives stdout and stderr, appended.
    `waits`: it reads a line from stdin before it begins, which `tell` writes.
    """

    arguments: Sequence[str]
    data_dir: Path
    log: Path
    environment: Mapping[str, str] = field(default_factory=dict)
    directory: Path = Path("/")
    death_signal: signal.Signals = signal.SIGKILL
    identity: Identity = CALLER
    waits: bool = False


def spawn(command: Command) -> "subprocess.Popen[bytes]":
    """Start the program in its own session, bound to the life of the calling thread.

    Raises:
        OSError: the program or its working directory cannot be used.
    """
    environment = {**_inherited_environment(), **command.environment, MARKER: str(command.data_dir)}
    descriptor = os.open(command.log, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o600)
    try:
        return subprocess.Popen(
            list(command.arguments),
            stdin=subprocess.PIPE if command.waits else subprocess.DEVNULL,
            stdout=descriptor,
            stderr=descriptor,
            env=environment,
            cwd=command.directory,
            start_new_session=True,
            preexec_fn=_before_exec(command, parent=os.getpid()),
        )
    finally:
        os.close(descriptor)


def speak_for_us(arguments: Sequence[str], environment: Mapping[str, str]) -> "subprocess.Popen[bytes]":
    """Start a program that has our own terminal, and dies with the calling thread."""
    command = Command(arguments=arguments, data_dir=Path("/"), log=Path("/dev/null"))
    return subprocess.Popen(
        list(arguments), env=dict(environment), preexec_fn=_before_exec(command, parent=os.getpid())
    )


def tell(child: "subprocess.Popen[bytes]") -> None:
    """Let a child begin that waits; nothing happens where it does not, or has begun or ended."""
    if child.stdin is not None and not child.stdin.closed:
        with contextlib.suppress(BrokenPipeError):
            child.stdin.write(b"begin\n")
            child.stdin.flush()
        with contextlib.suppress(BrokenPipeError):
            child.stdin.close()


def stop(child: "subprocess.Popen[bytes]", *, sign: signal.Signals, timeout_s: float) -> None:
    """End the child with `sign`, after `timeout_s` with SIGKILL, and with it whatever is left of its process group."""
    if child.poll() is None:
        child.send_signal(sign)
        try:
            child.wait(timeout_s)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()
    end_group(child)


def end_group(child: "subprocess.Popen[bytes]") -> None:
    """Kill what a dead child left in its session's process group."""
    try:
        os.killpg(child.pid, signal.SIGKILL)
    except (ProcessLookupError, PermissionError):
        return


def namespace_allowed() -> bool:
    """Whether this process may start children in a user namespace of their own (containers often forbid it)."""
    pid = os.fork()
    if pid == 0:
        try:
            _enter_namespace()
        except OSError:
            os._exit(1)
        os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 0


def _inherited_environment() -> dict[str, str]:
    """What children need of the caller's environment: never its locale, nor credentials such as AWS_*."""
    wanted = {"PATH", "HOME", "TMPDIR", "TZ", "VIRTUAL_ENV", "PYTHONPATH"}
    return {name: value for name, value in os.environ.items() if name in wanted or name.startswith("KLEINKRAM_")}


def _before_exec(command: Command, *, parent: int) -> Callable[[], None]:
    """What runs between fork and exec. Safe because the starting process has one thread that starts children."""

    def run() -> None:
        signal.pthread_sigmask(signal.SIG_SETMASK, [])
        _assume(command.identity)
        # After the change of identity, which would clear it.
        if _libc.prctl(_PR_SET_PDEATHSIG, int(command.death_signal), 0, 0, 0) != 0:
            raise OSError(ctypes.get_errno(), "prctl(PR_SET_PDEATHSIG)")
        if os.getppid() != parent:  # the parent died before the line above
            os._exit(1)

    return run


def _assume(identity: Identity) -> None:
    if identity.in_namespace:
        _enter_namespace()
    elif identity.uid is not None and identity.gid is not None:
        os.setgroups([])
        os.setresgid(identity.gid, identity.gid, identity.gid)
        os.setresuid(identity.uid, identity.uid, identity.uid)


def _enter_namespace() -> None:
    """Become uid and gid 65534 in a new user namespace, while files still see the caller."""
    uid, gid = os.getuid(), os.getgid()
    if _libc.unshare(_CLONE_NEWUSER) != 0:
        raise OSError(ctypes.get_errno(), "unshare(CLONE_NEWUSER)")
    Path("/proc/self/setgroups").write_text("deny")
    Path("/proc/self/uid_map").write_text(f"65534 {uid} 1")
    Path("/proc/self/gid_map").write_text(f"65534 {gid} 1")
