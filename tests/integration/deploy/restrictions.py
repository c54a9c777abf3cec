"""Runs a command under the restrictions that systemd would apply to a unit: `python -m … OPTIONS COMMAND…`, as root.

Restrictions without an equivalent here (PrivateDevices, PrivateUsers, ProtectHome, ProtectHostname, RestrictRealtime
and others) are not applied.
"""

import ctypes
import errno
import json
import os
import resource
import sys
from dataclasses import asdict, dataclass, field
from pathlib import Path

from kleinkram.runner.executors import linux_syscalls

_LEFT_WRITABLE = ("/dev", "/proc", "/sys")
_PR_CAPBSET_DROP, _PR_SET_MDWE = 24, 65
_MDWE_REFUSE_EXEC_GAIN = 1
# Source: seccomp.h of libseccomp.
_ALLOW, _REFUSE = 0x7FFF0000, 0x00050000
_MASKED_EQUAL, _EQUAL = 7, 4
_FAMILIES = 46
_libc = ctypes.CDLL(None, use_errno=True)


@dataclass(frozen=True)
class Restrictions:
    """What a unit restricts. `shown`: folders that stay visible below a private /tmp; `writable`: as systemd's.

    With a `uid` of its own, the command sees Python in the home of root, and nothing else there.
    """

    shown: list[str]
    writable: list[str]
    has_private_tmp: bool
    proc_options: str
    capabilities: list[int]
    system_calls: list[str]
    address_families: list[int]
    refused_namespaces: int
    denies_write_execute: bool
    uid: int = 0
    limits: dict[int, int] = field(default_factory=dict)

    def command(self, *command: str) -> list[str]:
        """Return the command line that runs a command with these restrictions."""
        return [sys.executable, "-m", "tests.integration.deploy.restrictions", json.dumps(asdict(self)), *command]


class _Comparison(ctypes.Structure):
    _fields_ = (("argument", ctypes.c_uint), ("operator", ctypes.c_int), ("a", ctypes.c_uint64), ("b", ctypes.c_uint64))


def main() -> None:
    """Apply the restrictions, then become the command."""
    values = json.loads(sys.argv[1])
    values["limits"] = {int(name): limit for name, limit in values["limits"].items()}
    restrictions = Restrictions(**values)
    _restrict_files(restrictions)
    for name, limit in restrictions.limits.items():
        hard = resource.getrlimit(name)[1]
        # This machine may not allow as much.
        allowed = limit if hard == resource.RLIM_INFINITY else min(limit, hard)
        resource.setrlimit(name, (allowed, allowed))
    for capability in range(int(Path("/proc/sys/kernel/cap_last_cap").read_text()) + 1):
        if capability not in restrictions.capabilities:
            _libc.prctl(_PR_CAPBSET_DROP, capability, 0, 0, 0)
    if restrictions.uid:
        os.setgroups([])
        os.setresgid(restrictions.uid, restrictions.uid, restrictions.uid)
        os.setresuid(restrictions.uid, restrictions.uid, restrictions.uid)
    if restrictions.proc_options:
        linux_syscalls.mount("proc", Path("/proc"), "proc", 0, restrictions.proc_options)
    linux_syscalls.give_up_privileges()
    if restrictions.denies_write_execute:  # since Linux 6.3
        _libc.prctl(_PR_SET_MDWE, _MDWE_REFUSE_EXEC_GAIN, 0, 0, 0)
    _refuse_system_calls(restrictions)
    os.execvp(sys.argv[2], sys.argv[2:])


def _restrict_files(restrictions: Restrictions) -> None:
    """Make all mounts read-only but for the writable folders, and replace /tmp and /var/tmp."""
    linux_syscalls.unshare(linux_syscalls.CLONE_NEWNS)
    linux_syscalls.mount("none", Path("/"), None, linux_syscalls.MS_REC | linux_syscalls.MS_PRIVATE)
    for folder in restrictions.writable:
        linux_syscalls.mount(folder, Path(folder), None, linux_syscalls.MS_BIND)
    left_writable = {*restrictions.writable, *_LEFT_WRITABLE}
    for line in Path("/proc/self/mountinfo").read_text().splitlines():
        target = line.split()[4]
        if target not in left_writable and not target.startswith(tuple(f"{path}/" for path in _LEFT_WRITABLE)):
            linux_syscalls.make_read_only(Path(target), with_all_below=False)
    if restrictions.uid:
        _show_only(Path("/root"), [sys.base_prefix, *restrictions.shown])
    if restrictions.has_private_tmp:
        folders = [(path, os.open(path, os.O_PATH)) for path in restrictions.shown]
        for tmp in ("/tmp", "/var/tmp"):
            linux_syscalls.mount("tmpfs", Path(tmp), "tmpfs", 0, "size=256m")
        for path, descriptor in folders:
            if path.startswith(("/tmp/", "/var/tmp/")):
                Path(path).mkdir(parents=True)
                linux_syscalls.mount(f"/proc/self/fd/{descriptor}", Path(path), None, linux_syscalls.MS_BIND)
            os.close(descriptor)


def _show_only(home: Path, folders: list[str]) -> None:
    """Replace a home that others may not read with the given folders in it, if Python is there."""
    if not Path(sys.base_prefix).is_relative_to(home):
        return
    opened = {path: os.open(path, os.O_PATH) for path in folders if Path(path).is_relative_to(home)}
    linux_syscalls.mount("tmpfs", home, "tmpfs", 0, "mode=755")
    for path, descriptor in opened.items():
        Path(path).mkdir(parents=True, exist_ok=True)
        linux_syscalls.mount(f"/proc/self/fd/{descriptor}", Path(path), None, linux_syscalls.MS_BIND)
        os.close(descriptor)


def _refuse_system_calls(restrictions: Restrictions) -> None:
    """Load the filters that systemd would load, by its own library."""
    library = ctypes.CDLL("libseccomp.so.2")
    library.seccomp_init.restype = ctypes.c_void_p
    context = ctypes.c_void_p
    only_known = context(library.seccomp_init(_REFUSE | errno.EPERM))
    for name in restrictions.system_calls:
        number = library.seccomp_syscall_resolve_name(name.encode())
        if number >= 0:
            library.seccomp_rule_add_array(only_known, _ALLOW, number, 0, None)
    features = context(library.seccomp_init(_ALLOW))

    def refuse(name: str, error: int, *comparisons: _Comparison) -> None:
        number = library.seccomp_syscall_resolve_name(name.encode())
        array = (_Comparison * len(comparisons))(*comparisons)
        library.seccomp_rule_add_array(features, _REFUSE | error, number, len(comparisons), array)

    for family in {*range(_FAMILIES)} - {*restrictions.address_families}:
        refuse("socket", errno.EAFNOSUPPORT, _Comparison(0, _EQUAL, family, 0))
    for bit in range(32):
        if flag := restrictions.refused_namespaces & 1 << bit:
            for name in ("unshare", "clone"):
                refuse(name, errno.EPERM, _Comparison(0, _MASKED_EQUAL, flag, flag))
    if restrictions.refused_namespaces:
        refuse("clone3", errno.ENOSYS)
    for filters in (features, only_known):
        if library.seccomp_load(filters) != 0:
            sys.exit("seccomp filters cannot be loaded")


if __name__ == "__main__":
    main()
