"""Linux system calls that Python does not wrap, for sandboxes. Each raises OSError with the name of the call."""

import ctypes
import errno
import fcntl
import os
import platform
import socket
import struct
from dataclasses import dataclass
from pathlib import Path

CLONE_NEWNS = 0x00020000
CLONE_NEWUTS = 0x04000000
CLONE_NEWIPC = 0x08000000
CLONE_NEWUSER = 0x10000000
CLONE_NEWPID = 0x20000000
CLONE_NEWNET = 0x40000000

MS_NOSUID = 0x2
MS_NODEV = 0x4
MS_BIND = 0x1000
MS_REC = 0x4000
MS_PRIVATE = 0x40000
_MNT_DETACH = 0x2

_PR_SET_PDEATHSIG = 1
_PR_SET_CHILD_SUBREAPER = 36
_PR_SET_NO_NEW_PRIVS = 38
_MOUNT_SETATTR = 442  # the same number on all architectures; Linux 5.12
_AT_RECURSIVE = 0x8000
_AT_FDCWD = -100
_MOUNT_ATTR_RDONLY = 0x1
_MOUNT_ATTR_NOSUID = 0x2
_MOUNT_ATTR_NODEV = 0x4
_PR_SET_SECCOMP = 22
_SECCOMP_MODE_FILTER = 2
# A classic BPF program over `struct seccomp_data`: offsets of its fields, and operations.
# Source: linux/seccomp.h, linux/filter.h, linux/bpf_common.h.
_NUMBER_AT, _ARCHITECTURE_AT, _FIRST_ARGUMENT_AT = 0, 4, 16
_LOAD_WORD, _JUMP_IF_EQUAL, _JUMP_IF_AT_LEAST, _JUMP_IF_BITS, _RETURN = 0x20, 0x15, 0x35, 0x45, 0x06
_ALLOW, _FAIL_WITH = 0x7FFF0000, 0x00050000
_X32_CALLS = 0x40000000

_SIOCGIFFLAGS = 0x8913
_SIOCSIFFLAGS = 0x8914
_IFF_UP = 0x1

_libc = ctypes.CDLL(None, use_errno=True)


@dataclass(frozen=True)
class _SystemCalls:
    """The identifier of an architecture in filters, and the numbers of its system calls.

    Source: linux/audit.h; arch/x86/entry/syscalls/syscall_64.tbl; include/uapi/asm-generic/unistd.h.
    """

    architecture: int
    memory_files: tuple[int, ...]  # memfd_create, memfd_secret
    system_v: tuple[int, ...]  # shmget, msgget
    clone3: int
    with_flags: tuple[int, ...]  # unshare, clone


_CALLS = {
    "x86_64": _SystemCalls(0xC000003E, (319, 447), (29, 68), 435, (272, 56)),
    "aarch64": _SystemCalls(0xC00000B7, (279, 447), (194, 186), 435, (97, 220)),
}


class _FilterProgram(ctypes.Structure):
    _fields_ = (("length", ctypes.c_ushort), ("instructions", ctypes.c_char_p))


def unshare(flags: int) -> None:
    """Move this process to new namespaces."""
    _check(_libc.unshare(flags), "unshare")


def map_identity(uid: int, gid: int, *, inside: int) -> None:
    """Map `uid` and `gid` to `inside` in the new user namespace."""
    Path("/proc/self/setgroups").write_text("deny")
    Path("/proc/self/uid_map").write_text(f"{inside} {uid} 1")
    Path("/proc/self/gid_map").write_text(f"{inside} {gid} 1")


def mount(source: str, target: Path, kind: str | None, flags: int, options: str = "") -> None:
    """Mount a file system, or bind-mount a directory."""
    arguments = [source.encode(), os.fsencode(target), kind.encode() if kind else None]
    _check(_libc.mount(*arguments, ctypes.c_ulong(flags), options.encode() or None), f"mount {target}")


def make_read_only(target: Path, *, with_all_below: bool = True) -> None:
    """Make a mount read-only, without devices and set-uid programs."""
    attributes = _MOUNT_ATTR_RDONLY | _MOUNT_ATTR_NOSUID | _MOUNT_ATTR_NODEV
    mount_attr = struct.pack("QQQQ", attributes, 0, 0, 0)
    flags = _AT_RECURSIVE if with_all_below else 0
    path = os.fsencode(target)
    done = _libc.syscall(_MOUNT_SETATTR, _AT_FDCWD, path, flags, mount_attr, ctypes.c_size_t(len(mount_attr)))
    _check(done, f"mount_setattr {target}")


def change_root(root: Path) -> None:
    """Make `root`, which is a mount, the root of this mount namespace, and unmount the old one."""
    os.chdir(root)
    _check(_libc.pivot_root(b".", b"."), "pivot_root")
    _check(_libc.umount2(b".", _MNT_DETACH), "umount2")
    os.chdir("/")


def adopt_orphans() -> None:
    """Become the parent of all orphaned descendants."""
    _check(_libc.prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0), "prctl")


def die_with_parent(number: int) -> None:
    """Receive a signal when the parent dies. A change of the uid clears this."""
    _check(_libc.prctl(_PR_SET_PDEATHSIG, int(number), 0, 0, 0), "prctl")


def give_up_privileges() -> None:
    """Gain no privileges by executing a program, in this process and all children."""
    _check(_libc.prctl(_PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0), "prctl")


def deny_uncounted_memory() -> None:
    """Block the system calls that allocate memory outside of processes, in this process and all children.

    Memory files and System V segments hold memory that is mapped nowhere; a new user namespace could mount a tmpfs of
    any size. Programs see the errors of an older kernel. Call `give_up_privileges` first.

    Raises:
        OSError: the kernel has no such filters, or the architecture is unknown.
    """
    calls = _CALLS.get(platform.machine())
    if calls is None:
        raise OSError(errno.ENOTSUP, f"seccomp: no filter for {platform.machine()}")
    missing = _FAIL_WITH | errno.ENOSYS
    program = [
        (_LOAD_WORD, 0, 0, _ARCHITECTURE_AT),
        (_JUMP_IF_EQUAL, 1, 0, calls.architecture),
        (_RETURN, 0, 0, missing),
        (_LOAD_WORD, 0, 0, _NUMBER_AT),
        (_JUMP_IF_AT_LEAST, 0, 1, _X32_CALLS),
        (_RETURN, 0, 0, missing),
    ]
    for number in (*calls.memory_files, *calls.system_v, calls.clone3):
        program += [(_JUMP_IF_EQUAL, 0, 1, number), (_RETURN, 0, 0, missing)]
    for number in calls.with_flags:
        program += [
            (_JUMP_IF_EQUAL, 0, 4, number),
            (_LOAD_WORD, 0, 0, _FIRST_ARGUMENT_AT),
            (_JUMP_IF_BITS, 0, 1, CLONE_NEWUSER),
            (_RETURN, 0, 0, _FAIL_WITH | errno.EPERM),
            (_RETURN, 0, 0, _ALLOW),
        ]
    program.append((_RETURN, 0, 0, _ALLOW))
    filter_program = _FilterProgram(
        len(program), b"".join(struct.pack("HBBI", *instruction) for instruction in program)
    )
    _check(_libc.prctl(_PR_SET_SECCOMP, _SECCOMP_MODE_FILTER, ctypes.byref(filter_program), 0, 0), "seccomp")


def raise_loopback() -> None:
    """Bring up the loopback interface of this network namespace."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        request = struct.pack("16sH14x", b"lo", 0)
        flags = struct.unpack("16sH14x", fcntl.ioctl(any_socket, _SIOCGIFFLAGS, request))[1]
        fcntl.ioctl(any_socket, _SIOCSIFFLAGS, struct.pack("16sH14x", b"lo", flags | _IFF_UP))


def _check(result: int, call: str) -> None:
    if result != 0:
        error = ctypes.get_errno()
        raise OSError(error, f"{call}: {os.strerror(error)}")
