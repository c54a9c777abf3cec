"""The sandbox of a job: namespaces with a root that has only the system's programs, Python, and the job's directories.

As root, the job gets its own uid; as another user, it is in a user namespace. Either way it sees no home directory, no
data of Kleinkram, no other process, and no network unless it has one. Imports only the standard library, since every
job waits for it.
"""

import os
import resource
import signal
import socket
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from kleinkram.runner.executors import linux_syscalls, nvidia, port_forward

_INSIDE_UID = 1000
_SYSTEM = ("/usr", "/bin", "/sbin", "/lib", "/lib32", "/lib64", "/etc", "/opt")
_DEVICES = ("null", "zero", "full", "random", "urandom")
# Of a sandbox; what an image has there is not shown.
OWN_ENTRIES = frozenset({"in", "out", "tmp", "env", "dev", "proc", "sys"})
# Where a job sees the packages of its script.
PACKAGES = "/env"
SHARED_MEMORY = Path("dev/shm")
SHARED_MEMORY_BYTES = 64 * 2**20
_PROCESSES = 1024
# A single file may exceed the disk limit by this much, so that the reason is recognised.
_FILE_MARGIN_BYTES = 64 * 2**20


class ImageRoot(NamedTuple):
    """The files of an image, in the folder `root`: what a command sees in place of the system's.

    `volumes` are further directories that it writes to, without symlinks; `directory` is where commands start.
    """

    root: str
    volumes: Sequence[str]
    directory: str


@dataclass(frozen=True)
class Sandbox:
    """Where and as whom a command runs. `uid` is None where this process cannot change its uid.

    The listening sockets of its port forwards are sent to `listeners`. `packages` is a folder to show as `PACKAGES`,
    `devices` are further files below `/dev` to show. `has_gpus`: the driver of GPUs is shown, too.
    """

    directory: Path
    has_network: bool
    disk_bytes: int
    uid: int | None
    forwards: Sequence[port_forward.PortForward]
    listeners: socket.socket
    packages: Path | None = None
    image: ImageRoot | None = None
    devices: Sequence[Path] = ()
    has_gpus: bool = False


def make_volumes(directory: Path, count: int, uid: int | None) -> None:
    """Create the directories of the volumes of an image, for a job that runs as `uid`."""
    for number in range(count):
        volume = volume_directory(directory, number)
        volume.mkdir(exist_ok=True)
        if uid is not None:
            os.chown(volume, uid, uid)


def is_available() -> bool:
    """Whether the kernel allows this process to create a sandbox, which is tried."""
    pid = os.fork()
    if pid == 0:
        try:
            _leave_namespaces(has_network=False)
            # Only the first process of a new process namespace can mount its file systems.
            inner = os.fork()
            if inner == 0:
                linux_syscalls.mount("none", Path("/"), None, linux_syscalls.MS_REC | linux_syscalls.MS_PRIVATE)
                linux_syscalls.mount("tmpfs", Path("/tmp"), "tmpfs", 0)  # noqa: S108  in a namespace that ends with this line
                linux_syscalls.make_read_only(Path("/tmp"))  # noqa: S108
                linux_syscalls.give_up_privileges()
                linux_syscalls.deny_uncounted_memory()
                os._exit(0)
            os._exit(os.waitstatus_to_exitcode(os.waitpid(inner, 0)[1]) & 0xFF)
        except BaseException:
            os._exit(1)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 0


def run_in_sandbox(sandbox: Sandbox, command: Sequence[str], environment: Mapping[str, str], errors: int) -> int:
    """Run a command in a new sandbox and return its exit code, 128 + n if a signal ended it.

    Call it in a process that does nothing else. Why the command cannot start is written to the descriptor `errors`,
    which the command does not inherit.
    """
    linux_syscalls.die_with_parent(signal.SIGKILL)
    _leave_namespaces(has_network=sandbox.has_network)
    first = os.fork()
    if first == 0:
        try:
            _be_first(sandbox, command, environment, errors)
        except BaseException as error:
            os.write(errors, f"{type(error).__name__}: {error}".encode())
            os._exit(126)
    os.close(errors)
    return _code_of(first)


def _leave_namespaces(*, has_network: bool) -> None:
    flags = (
        linux_syscalls.CLONE_NEWNS
        | linux_syscalls.CLONE_NEWPID
        | linux_syscalls.CLONE_NEWIPC
        | linux_syscalls.CLONE_NEWUTS
    )
    if not has_network:
        flags |= linux_syscalls.CLONE_NEWNET
    uid, gid = os.getuid(), os.getgid()
    if uid != 0:
        linux_syscalls.unshare(flags | linux_syscalls.CLONE_NEWUSER)
        linux_syscalls.map_identity(uid, gid, inside=_INSIDE_UID)
    else:
        linux_syscalls.unshare(flags)


def _be_first(sandbox: Sandbox, command: Sequence[str], environment: Mapping[str, str], errors: int) -> None:
    """As the first process of the namespace: mount the root, start the command, and wait for its end."""
    linux_syscalls.die_with_parent(signal.SIGKILL)
    _mount_root(sandbox)
    if not sandbox.has_network:
        linux_syscalls.raise_loopback()
        sockets = port_forward.listen(sandbox.forwards)
        socket.send_fds(sandbox.listeners, [b"listeners"], [listener.fileno() for listener in sockets])
        for end in (*sockets, sandbox.listeners):
            end.close()
    if sandbox.uid is not None:
        os.setgroups([])
        os.setresgid(sandbox.uid, sandbox.uid, sandbox.uid)
        os.setresuid(sandbox.uid, sandbox.uid, sandbox.uid)
        linux_syscalls.die_with_parent(signal.SIGKILL)
    apply_limits(sandbox)
    os.chdir("/tmp" if sandbox.image is None else sandbox.image.directory)  # noqa: S108  the job's own
    pid = os.fork()
    if pid == 0:
        os.setsid()
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGPIPE, signal.SIGHUP):
            signal.signal(number, signal.SIG_DFL)
        try:
            os.execvpe(command[0], list(command), dict(environment))  # noqa: S606  what jobs are for
        except OSError as error:
            os.write(errors, f"not found: {command[0]}: {error.strerror}".encode())
            os._exit(127)
    os.close(errors)
    # The kernel shields the first process from signals without a handler; it passes this one on.
    signal.signal(signal.SIGTERM, lambda *_: _terminate_all())
    os._exit(_code_of(pid))


def _terminate_all() -> None:
    try:
        os.kill(-1, signal.SIGTERM)
    except ProcessLookupError:
        return


def _code_of(pid: int) -> int:
    """Wait for a child, and reap orphans."""
    while True:
        ended, status = os.wait()
        if ended == pid:
            code = os.waitstatus_to_exitcode(status)
            return code if code >= 0 else 128 - code


def apply_limits(sandbox: Sandbox) -> None:
    """Apply the limits of the kernel to this process and its children."""
    linux_syscalls.give_up_privileges()
    linux_syscalls.deny_uncounted_memory()
    limit_resources(sandbox.disk_bytes)


def limit_resources(disk_bytes: int) -> None:
    """Apply the limits of the kernel that leave this process its privileges."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    largest = disk_bytes + _FILE_MARGIN_BYTES
    resource.setrlimit(resource.RLIMIT_FSIZE, (largest, largest))
    resource.setrlimit(resource.RLIMIT_NPROC, (_PROCESSES, _PROCESSES))


def _mount_root(sandbox: Sandbox) -> None:
    linux_syscalls.mount("none", Path("/"), None, linux_syscalls.MS_REC | linux_syscalls.MS_PRIVATE)
    root = sandbox.directory / "root"
    root.mkdir(exist_ok=True)
    linux_syscalls.mount("tmpfs", root, "tmpfs", linux_syscalls.MS_NOSUID | linux_syscalls.MS_NODEV, "size=1m,mode=755")
    for name in ("out", "tmp"):
        _bind(sandbox.directory / name, root / name)
    if sandbox.image is not None:
        _mount_image(sandbox.directory, sandbox.image, root)
    else:
        # After those: Python itself may stand below /tmp.
        for path in _system_paths():
            _bind_read_only(path, root / str(path)[1:])
    _bind_read_only(sandbox.directory / "in", root / "in")
    if sandbox.packages is not None:
        _bind_read_only(sandbox.packages, root / PACKAGES[1:])
    _mount_network_files(sandbox, root / "etc")
    devices = root / "dev"
    (devices / "shm").mkdir(parents=True)
    for node in (*(Path("/dev", name) for name in _DEVICES), *sandbox.devices):
        target = root / str(node)[1:]
        target.parent.mkdir(parents=True, exist_ok=True)
        target.touch()
        linux_syscalls.mount(str(node), target, None, linux_syscalls.MS_BIND)
    for name, number in (("fd", ""), ("stdin", "/0"), ("stdout", "/1"), ("stderr", "/2")):
        (devices / name).symlink_to(f"/proc/self/fd{number}")
    if sandbox.has_gpus:
        _mount_driver(root)
    flags = linux_syscalls.MS_NOSUID | linux_syscalls.MS_NODEV
    linux_syscalls.mount("tmpfs", devices / "shm", "tmpfs", flags, f"size={SHARED_MEMORY_BYTES},mode=1777")
    (root / "proc").mkdir()
    linux_syscalls.mount("proc", root / "proc", "proc", linux_syscalls.MS_NOSUID | linux_syscalls.MS_NODEV)
    linux_syscalls.change_root(root)
    linux_syscalls.make_read_only(Path("/"), with_all_below=False)


def _mount_image(directory: Path, image: ImageRoot, root: Path) -> None:
    for entry in Path(image.root).iterdir():
        if entry.name not in OWN_ENTRIES:
            _bind_read_only(entry, root / entry.name)
    for number, path in enumerate(image.volumes):
        _bind(volume_directory(directory, number), root / path[1:])


def _mount_driver(root: Path) -> None:
    """Mount the libraries and programs of the driver of GPUs."""
    for folder, files in ((nvidia.LIBRARIES, nvidia.libraries()), (nvidia.PROGRAMS, nvidia.programs())):
        (root / folder[1:]).mkdir(parents=True)
        for file in files:
            target = root / folder[1:] / file.name
            target.touch()
            linux_syscalls.mount(str(file.resolve()), target, None, linux_syscalls.MS_BIND)
            linux_syscalls.make_read_only(target)


def volume_directory(directory: Path, number: int) -> Path:
    """Return the directory of a volume of an image: its content counts as `/tmp`."""
    return directory / "tmp" / f".volume-{number}"


def _mount_network_files(sandbox: Sandbox, etc: Path) -> None:
    """Mount the names of the port forwards; over the files of an image, those of this machine if it has its network."""
    names = port_forward.host_entries([forward.host for forward in sandbox.forwards])
    if sandbox.image is not None and sandbox.has_network:
        for name in ("hosts", "resolv.conf"):
            _mount_file(Path("/etc", name), etc / name)
    elif names or sandbox.image is not None:
        hosts = sandbox.directory / "hosts"
        hosts.write_text("127.0.0.1 localhost\n" + "".join(f"{address} {name}\n" for name, address in names.items()))
        hosts.chmod(0o644)
        _mount_file(hosts, etc / "hosts")


def _mount_file(source: Path, target: Path) -> None:
    if source.exists():
        linux_syscalls.mount(str(source), target, None, linux_syscalls.MS_BIND)
        linux_syscalls.make_read_only(target)


def _system_paths() -> list[Path]:
    """Return what a script needs of this machine: the system's programs, this Python, and its imports."""
    here = Path(__file__).resolve().parents[4]
    candidates = [Path(path) for path in (*_SYSTEM, sys.prefix, sys.base_prefix, here)]
    existing = [path for path in dict.fromkeys(candidates) if path.exists()]
    # One inside of another is included already.
    return [path for path in existing if not any(other in path.parents for other in existing)]


def _bind_read_only(source: Path, target: Path) -> None:
    """Bind-mount a file or directory of this machine; a symlink stays one."""
    if source.is_symlink():
        target.parent.mkdir(parents=True, exist_ok=True)
        target.symlink_to(source.readlink())
        return
    _bind(source, target)
    linux_syscalls.make_read_only(target)


def _bind(source: Path, target: Path) -> None:
    if source.is_file():
        target.touch()
    else:
        target.mkdir(parents=True, exist_ok=True)
    linux_syscalls.mount(str(source), target, None, linux_syscalls.MS_BIND | linux_syscalls.MS_REC)
