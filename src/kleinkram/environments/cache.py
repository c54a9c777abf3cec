"""The cache of environments: one folder for each lock, Python and image, used by runs, and read-only.

    <key>/packages/         the packages, which runs see as `/env`
    <key>/complete.json     the number and size of its files

`uv` inherits the lock of what it builds (`folder_cache.py`), which nobody removes while it still writes there.
"""

import contextlib
import errno
import hashlib
import os
import shutil
import stat
import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

from packaging.specifiers import SpecifierSet

from kleinkram.contract.locks import parse_lock
from kleinkram.environments.folder_cache import EntryTooLarge, FolderCache, remove_read_only
from kleinkram.environments.python import Python
from kleinkram.environments.uv import PackageIndex, UvFailed, Wait, run_uv

_PACKAGES = "packages"
_BUILD_TIMEOUT_S = 1800.0
_RETRY_S = 0.1
_MEASURE_EVERY_S = 2.0
# Left free on the disk for others.
_SPARE_BYTES = 256 * 2**20
# What `uv` keeps for itself in a target folder.
_OF_UV = ".lock"

Show = Callable[[str, float], None]
Compile = Callable[[Path, Wait], None]


class CannotInstall(Exception):
    """An environment cannot be built. The text is a sentence."""


@dataclass(frozen=True)
class EnvironmentRequest:
    """An environment: the lock of a script, the Python that it accepts, and the Python that it runs with.

    `image`: the id of the image whose Python that is. An image writes to the environment while it compiles it, so that
    environments are not shared between images.
    """

    lock: str
    python: Python
    requires_python: str | None = None
    image: str | None = None

    @property
    def key(self) -> str:
        """The name of its folder in a cache."""
        parts = [self.lock, self.python.short_version, self.python.platform, *([self.image] if self.image else [])]
        return hashlib.sha256("\n".join(parts).encode()).hexdigest()


class Preparation(NamedTuple):
    """What a build calls: to wait, to show its progress, and to write bytecode."""

    wait: Wait
    show: Callable[[float], None]
    compile_in: Compile


class Environment:
    """An environment in use, which is not removed before `close`, or the end of this process."""

    def __init__(self, key: str, packages: Path, lock: int) -> None:
        self.key = key
        self.packages = packages
        self._lock = lock

    def close(self) -> None:
        """End the use. May be repeated."""
        if self._lock >= 0:
            os.close(self._lock)
        self._lock = -1


class EnvironmentCache(FolderCache):
    """Environments in one folder, of at most `limit_bytes` beside those in use. For all threads and processes."""

    def __init__(self, folder: Path, index: PackageIndex, limit_bytes: int) -> None:
        super().__init__(folder, limit_bytes)
        self._index = index

    def get(self, request: EnvironmentRequest, *, wait: Wait, show: Show, compile_in: Compile) -> Environment:
        """Return an environment, which is built if there is none: by one caller, while others `wait` (seconds).

        `show` gets what is done and its progress (0 to 1); `compile_in` writes the bytecode of a folder.

        Raises:
            CannotInstall: it cannot be built here.
            OSError: the disk is full or broken.
        """
        packages = parse_lock(request.lock)
        _check_python(request)
        needed = sum(package.is_needed(request.python.markers()) for package in packages)
        while (environment := self.find(request.key)) is None:
            with self.try_lock(request.key) as lock:
                if lock is None:  # another caller builds it, or uses it already
                    wait(_RETRY_S)
                elif not self._is_complete(request.key):
                    message = f"Installing {needed} package{'s' * (needed != 1)}"
                    self._build(request, lock, Preparation(wait, partial(show, message), compile_in))
        return environment

    def find(self, key: str) -> Environment | None:
        """Return an environment that is complete, in use from now on; None without it."""
        lock = self.use(key)
        return None if lock is None else Environment(key, self._folder / key / _PACKAGES, lock)

    def _build(self, request: EnvironmentRequest, lock: int, preparation: Preparation) -> None:
        wait, show, compile_in = preparation
        show(0.0)
        self.remove_folders(request.key)
        new = self.make_folder(request.key)
        try:
            target = new / _PACKAGES
            (new / "lock.txt").write_text(request.lock)
            arguments = [
                *("pip", "install", "--target", str(target), "--require-hashes", "--only-binary", ":all:"),
                *("--no-deps", "--python-version", request.python.short_version),
                *("--python-platform", request.python.platform),
                *("--requirements", str(new / "lock.txt")),
            ]

            guard = _SizeGuard(new, self._limit_bytes, wait)

            def wait_and_show(seconds: float) -> None:
                guard.wait(seconds)
                show(_fraction(new / "uv.log"))

            run_uv(arguments, self._index, folder=new, timeout_s=_BUILD_TIMEOUT_S, wait=wait_and_show, pass_fds=[lock])
            (target / _OF_UV).unlink(missing_ok=True)
            for name in ("scratch", "uv.log"):
                remove_read_only(new / name)
            guard.wait(0)
            compile_in(target, guard.wait)
            _make_read_only(target)
            self.publish(new, request.key, _inventory(target))
        except UvFailed as error:
            raise CannotInstall(str(error)) from None
        except EntryTooLarge:
            raise _too_large(_inventory(target)["size_bytes"], self._limit_bytes) from None
        except OSError as error:
            if error.errno != errno.ENOSPC:
                raise
            raise CannotInstall("The disk is full.") from None
        finally:
            if new.exists():
                remove_read_only(new)

    def _is_complete(self, key: str) -> bool:
        """Whether an environment has all of its files; after a power failure, some may be missing."""
        expected = self._read_complete(key)
        return expected is not None and _inventory(self._folder / key / _PACKAGES) == expected


class _SizeGuard:
    """Ends a build that fills the disk, or becomes larger than the cache: wheels are archives, and grow by any factor.

    Downloaded wheels are beside the unpacked ones for a while, so that it allows twice the limit.
    """

    def __init__(self, folder: Path, limit_bytes: int, wait: Wait) -> None:
        self._folder, self._limit_bytes, self._wait = folder, limit_bytes, wait
        self._measured_s = time.monotonic()

    def wait(self, seconds: float) -> None:
        """Wait (seconds). Raises CannotInstall."""
        self._wait(seconds)
        if shutil.disk_usage(self._folder).free < _SPARE_BYTES:
            raise CannotInstall("The disk is full.")
        if time.monotonic() < self._measured_s + _MEASURE_EVERY_S:
            return
        size_bytes = 0
        for parent, _, names in os.walk(self._folder):
            for name in names:
                with contextlib.suppress(OSError):  # removed meanwhile
                    size_bytes += (Path(parent) / name).lstat().st_size
        self._measured_s = time.monotonic()
        if size_bytes > 2 * self._limit_bytes:
            raise _too_large(size_bytes, self._limit_bytes)


def _too_large(size_bytes: int, limit_bytes: int) -> CannotInstall:
    return CannotInstall(f"They need {size_bytes / 1e9:.1f} GB; {limit_bytes / 1e9:.1f} GB are allowed.")


def _check_python(request: EnvironmentRequest) -> None:
    version = request.python.version
    if request.requires_python and not SpecifierSet(request.requires_python).contains(version, prereleases=True):
        raise CannotInstall(f"The script requires Python {request.requires_python}; it would run with {version}.")


def _fraction(log: Path) -> float:
    """Return how much of the large downloads `uv` has done, from its output."""
    lines = log.read_text(errors="replace").splitlines()
    announced = sum(line.startswith("Downloading ") for line in lines)
    return 0.9 * sum(line.startswith(" Downloaded ") for line in lines) / announced if announced else 0.0


def compile_packages(python: str, folder: Path, wait: Wait) -> None:
    """Write the bytecode of a folder, for a Python of this machine: runs cannot, and would compile all they import."""
    command = [python, "-I", "-m", "compileall", "-q", "-q", "-j", "0", str(folder)]
    # Packages contain files that do not compile, such as templates: its exit code says nothing.
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            while process.poll() is None:
                wait(_RETRY_S)
        finally:
            process.kill()


def _make_read_only(folder: Path) -> None:
    """Make a folder with its content read-only, for everybody."""
    for parent, _, names in os.walk(folder):
        for name in names:
            path = Path(parent) / name
            mode = path.lstat().st_mode
            if stat.S_ISREG(mode):
                path.chmod(0o555 if mode & 0o100 else 0o444)
        Path(parent).chmod(0o555)


def _inventory(folder: Path) -> dict[str, int]:
    """Return the number and size of the files in a folder, but for bytecode, which a run without a sandbox may add."""
    count, size_bytes, pending = 0, 0, [str(folder)]
    while pending:
        with os.scandir(pending.pop()) as entries:
            for entry in entries:
                if entry.is_dir(follow_symlinks=False):
                    if entry.name != "__pycache__":
                        pending.append(entry.path)
                else:
                    count += 1
                    size_bytes += entry.stat(follow_symlinks=False).st_size
    return {"files": count, "size_bytes": size_bytes}
