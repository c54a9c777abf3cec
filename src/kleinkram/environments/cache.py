"""The cache of environments: one folder for each lock, Python and image, used by runs, and read-only.

    <key>/packages/         the packages, which runs see as `/env`
    <key>/complete.json     the number and size of its files, written last; its time is that of the last use
    <key>.lock              held (flock) exclusively while the environment is built or removed, shared while it is used
    <key>.new-<random>/     an environment being built, renamed to <key> once it is complete

The locks hold between threads and between processes. A killed process leaves a folder `.new-...` that nothing uses, and
that the next build removes; `uv` inherits the lock, so that this is not done while it still writes there.
"""

import contextlib
import errno
import fcntl
import hashlib
import json
import os
import shutil
import stat
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

from packaging.specifiers import SpecifierSet

from kleinkram.contract.locks import parse_lock
from kleinkram.environments.python import Python
from kleinkram.environments.uv import PackageIndex, UvFailed, Wait, run_uv

_PACKAGES, _COMPLETE, _LOCK, _NEW = "packages", "complete.json", ".lock", ".new-"
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


class EnvironmentCache:
    """Environments in one folder, of at most `limit_bytes` beside those in use. For all threads and processes."""

    def __init__(self, folder: Path, index: PackageIndex, limit_bytes: int) -> None:
        self._folder = folder
        self._index = index
        self._limit_bytes = limit_bytes
        folder.mkdir(mode=0o711, parents=True, exist_ok=True)
        for abandoned in {path.name.partition(_NEW)[0] for path in folder.glob(f"*{_NEW}*")}:
            self._remove(abandoned, if_complete=False)

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
            with self._try_lock(request.key) as lock:
                if lock is None:  # another caller builds it, or uses it already
                    wait(_RETRY_S)
                elif not self._is_complete(request.key):
                    message = f"Installing {needed} package{'s' * (needed != 1)}"
                    self._build(request, lock, Preparation(wait, partial(show, message), compile_in))
        return environment

    def find(self, key: str) -> Environment | None:
        """Return an environment that is complete, in use from now on; None without it."""
        lock = self._open_lock(key)
        try:
            # Does not wait: whoever has the lock builds the environment, or removes it.
            fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
            if self._is_current(key, lock) and self._is_complete(key):
                with contextlib.suppress(OSError):
                    os.utime(self._folder / key / _COMPLETE)
                used, lock = lock, -1
                return Environment(key, self._folder / key / _PACKAGES, used)
        except BlockingIOError:
            return None
        finally:
            if lock >= 0:
                os.close(lock)
        return None

    def _build(self, request: EnvironmentRequest, lock: int, preparation: Preparation) -> None:
        wait, show, compile_in = preparation
        show(0.0)
        self._remove_folders(request.key)
        new = Path(tempfile.mkdtemp(prefix=f"{request.key}{_NEW}", dir=self._folder))
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
            (new / _COMPLETE).write_text(json.dumps(_inventory(target)))
            new.chmod(0o711)
            self._make_space(_inventory(target)["size_bytes"])
            # Otherwise, files could be empty after a power failure.
            os.sync()
            new.rename(self._folder / request.key)
        except UvFailed as error:
            raise CannotInstall(str(error)) from None
        except OSError as error:
            if error.errno != errno.ENOSPC:
                raise
            raise CannotInstall("The disk is full.") from None
        finally:
            if new.exists():
                remove_read_only(new)

    def _make_space(self, needed_bytes: int) -> None:
        """Remove the environments that were used longest ago, and by nobody now, until there is space.

        Raises:
            CannotInstall: there is not enough for this one alone.
        """
        complete: list[tuple[float, int, str]] = []
        for path in self._folder.glob(f"*/{_COMPLETE}"):
            with contextlib.suppress(OSError, ValueError, KeyError):
                if _NEW not in path.parent.name:
                    complete.append(
                        (path.stat().st_mtime, json.loads(path.read_text())["size_bytes"], path.parent.name)
                    )
        if needed_bytes > self._limit_bytes:
            raise _too_large(needed_bytes, self._limit_bytes)
        excess_bytes = sum(size_bytes for _, size_bytes, _ in complete) + needed_bytes - self._limit_bytes
        for _, size_bytes, key in sorted(complete):
            if excess_bytes <= 0:
                return
            if self._remove(key):
                excess_bytes -= size_bytes

    def _remove(self, key: str, *, if_complete: bool = True) -> bool:
        """Remove an environment, or what a killed build left, unless it is in use; return whether it was removed."""
        with self._try_lock(key) as lock:
            if lock is None or (not if_complete and self._is_complete(key)):
                return False
            self._remove_folders(key)
            (self._folder / f"{key}{_LOCK}").unlink(missing_ok=True)
        return True

    def _remove_folders(self, key: str) -> None:
        # No longer complete, if this process is killed now.
        (self._folder / key / _COMPLETE).unlink(missing_ok=True)
        remove_read_only(self._folder / key)
        for abandoned in self._folder.glob(f"{key}{_NEW}*"):
            # What compiled it may still write there; it is never used, and removed the next time.
            with contextlib.suppress(OSError):
                remove_read_only(abandoned)

    @contextlib.contextmanager
    def _try_lock(self, key: str) -> Iterator[int | None]:
        """Yield a lock on an environment that nobody else builds or uses; None where somebody does."""
        lock = self._open_lock(key)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            is_locked = self._is_current(key, lock)
        except BlockingIOError:
            is_locked = False
        try:
            yield lock if is_locked else None
        finally:
            os.close(lock)

    def _open_lock(self, key: str) -> int:
        return os.open(self._folder / f"{key}{_LOCK}", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)

    def _is_current(self, key: str, lock: int) -> bool:
        """Whether a lock file is still the one that others open: it is removed together with its environment."""
        try:
            return os.fstat(lock).st_ino == (self._folder / f"{key}{_LOCK}").stat().st_ino
        except FileNotFoundError:
            return False

    def _is_complete(self, key: str) -> bool:
        """Whether an environment has all of its files; after a power failure, some may be missing."""
        try:
            expected = json.loads((self._folder / key / _COMPLETE).read_text())
        except (FileNotFoundError, ValueError):
            return False
        return bool(_inventory(self._folder / key / _PACKAGES) == expected)


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


def remove_read_only(path: Path) -> None:
    """Remove a file or a folder, whatever its permissions; nothing where it does not exist."""
    if not path.is_dir() or path.is_symlink():
        path.unlink(missing_ok=True)
        return
    for parent, names, _ in os.walk(path):
        Path(parent).chmod(0o700)
        for name in names:
            if not (Path(parent) / name).is_symlink():
                (Path(parent) / name).chmod(0o700)
    shutil.rmtree(path)
