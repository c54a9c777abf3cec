"""Unpacks the layers of an image below a folder. Layers come from strangers: nothing is written elsewhere.

`python -m kleinkram.runner.images.unpack FOLDER` reads an `UnpackRequest` as JSON from stdin, and writes an
`UnpackResult`. The process makes FOLDER its root before it reads a layer, so that no name, link or mistake leads out of
it. What a run needs no longer has: owners, set-user-ID bits, capabilities and devices. Memory is bounded.

Source: github.com/opencontainers/image-spec, layer.md.
"""

import contextlib
import gzip
import json
import os
import resource
import shutil
import stat
import sys
import tarfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO, NamedTuple

import zstandard

from kleinkram.runner.executors import linux_syscalls

_WHITEOUT = ".wh."
_OPAQUE = ".wh..wh..opq"
_GZIP, _ZSTD = b"\x1f\x8b", b"\x28\xb5\x2f\xfd"
_ENTRY_BYTES = 1024
_COPY_BYTES = 2**18
_MEMORY_BYTES = 2**31
# Windows of more are refused, as `zstd` does by default.
_ZSTD_WINDOW_BYTES = 2**27
# Files that a sandbox replaces by its own.
_REPLACED_FILES = ("etc/hosts", "etc/resolv.conf")


class UnpackRequest(NamedTuple):
    """Layers, the lowest first; directories that must exist; the space that all files may take."""

    layers: Sequence[str]
    directories: Sequence[str]
    limit_bytes: int


class UnpackResult(NamedTuple):
    """`error`: why it was not possible, a sentence, or empty. `directories`: those requested, without symlinks."""

    error: str
    size_bytes: int
    directories: Sequence[str]


class _LayerRefused(Exception):
    """A layer is not acceptable. The text is a sentence."""


def main() -> None:
    """Unpack what stdin requests."""
    request = UnpackRequest(*json.load(sys.stdin))
    with contextlib.ExitStack() as stack:
        layers = [stack.enter_context(Path(path).open("rb")) for path in request.layers]
        resource.setrlimit(resource.RLIMIT_AS, (_MEMORY_BYTES, _MEMORY_BYTES))
        size_bytes, directories, error = 0, [], ""
        try:
            _enter(Path(sys.argv[1]))
            unpacked = _Root(request.limit_bytes)
            for layer in layers:
                unpacked.add(layer)
            size_bytes = unpacked.size_bytes
            directories = _prepare(request.directories)
        except _LayerRefused as refusal:
            error = str(refusal)
        except MemoryError:
            error = "One of its layers has headers that are too large."
        except (tarfile.TarError, EOFError, gzip.BadGzipFile, zstandard.ZstdError, ValueError) as failure:
            error = f"One of its layers is damaged: {failure}."
        except OSError as failure:
            error = f"It cannot be unpacked: {failure.strerror or failure}."
    json.dump(UnpackResult(error, size_bytes, directories), sys.stdout)


def _enter(folder: Path) -> None:
    """Make a folder the root of this process."""
    # Loaded before: afterwards, this Python is out of reach.
    tarfile.open(mode="w", fileobj=open(os.devnull, "wb"), format=tarfile.PAX_FORMAT).close()  # noqa: SIM115
    if os.getuid() != 0:
        uid, gid = os.getuid(), os.getgid()
        linux_syscalls.unshare(linux_syscalls.CLONE_NEWUSER)
        linux_syscalls.map_identity(uid, gid, inside=0)
    os.chroot(folder)
    os.chdir("/")
    os.umask(0)


class _Root:
    """The files of the layers so far, in the root of this process."""

    def __init__(self, limit_bytes: int) -> None:
        self._limit_bytes = limit_bytes
        self.size_bytes = 0

    def add(self, layer: IO[bytes]) -> None:
        """Apply a layer."""
        own: set[str] = set()
        with _decompressed(layer) as stream, tarfile.open(fileobj=stream, mode="r|") as tar:
            for member in tar:
                # All members would be kept otherwise.
                tar.members = []  # type: ignore[attr-defined]
                path = _path_of(member.name)
                self._count(_ENTRY_BYTES)
                folder, name = os.path.split(path)
                if name == _OPAQUE:
                    _clear(folder or ".", own)
                elif name.startswith(_WHITEOUT):
                    _remove(os.path.join(folder, name.removeprefix(_WHITEOUT)))
                elif path:
                    _add_with_parents(path, own)
                    self._extract(tar, member, path)

    def _extract(self, tar: tarfile.TarFile, member: tarfile.TarInfo, path: str) -> None:
        _make_parents(path)
        mode = member.mode & 0o777
        if member.isdir():
            if not _is_directory(path):
                _remove(path)
                os.mkdir(path)
            os.chmod(path, mode | 0o700)
            return
        if not (member.isreg() or member.issym() or member.islnk()):
            # Devices and pipes.
            return
        _remove(path)
        if member.issym():
            os.symlink(member.linkname, path)
        elif member.islnk():
            os.link(_path_of(member.linkname), path, follow_symlinks=False)
        else:
            self._write(tar, member, path, mode)

    def _write(self, tar: tarfile.TarFile, member: tarfile.TarInfo, path: str, mode: int) -> None:
        data = tar.extractfile(member)
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, mode | 0o400)
        with os.fdopen(descriptor, "wb") as stream:
            while data is not None and (piece := data.read(_COPY_BYTES)):
                self._count(len(piece))
                stream.write(piece)
        # Python compares the times of its files with those in its bytecode.
        with contextlib.suppress(OSError, OverflowError, ValueError):
            os.utime(path, (member.mtime, member.mtime))

    def _count(self, size_bytes: int) -> None:
        self.size_bytes += size_bytes
        if self.size_bytes > self._limit_bytes:
            raise _LayerRefused(f"It takes more than the {self._limit_bytes / 1e9:.1f} GB that images may take here.")


@contextlib.contextmanager
def _decompressed(layer: IO[bytes]) -> Iterator[IO[bytes]]:
    first = layer.read(4)
    layer.seek(0)
    if first.startswith(_GZIP):
        with gzip.open(layer, "rb") as stream:
            yield stream  # type: ignore[misc]
    elif first == _ZSTD:
        decompressor = zstandard.ZstdDecompressor(max_window_size=_ZSTD_WINDOW_BYTES)
        with decompressor.stream_reader(layer, read_across_frames=True) as stream:
            yield stream
    else:
        yield layer


def _path_of(name: str) -> str:
    """Return the path of an entry, relative to the root, which is empty."""
    parts = [part for part in name.split("/") if part not in ("", ".")]
    if ".." in parts:
        raise _LayerRefused(f"One of its layers has a path that leads out of the image: {name[:200]!r}.")
    return "/".join(parts)


def _add_with_parents(path: str, paths: set[str]) -> None:
    while path and path not in paths:
        paths.add(path)
        path = os.path.dirname(path)


def _make_parents(path: str) -> None:
    parent = os.path.dirname(path)
    if parent and not os.path.isdir(parent):
        _make_parents(parent)
        if os.path.lexists(parent):
            _remove(parent)
        os.mkdir(parent, 0o755)


def _is_directory(path: str) -> bool:
    try:
        return stat.S_ISDIR(os.lstat(path).st_mode)
    except FileNotFoundError:
        return False


def _remove(path: str) -> None:
    if _is_directory(path):
        shutil.rmtree(path)
    else:
        with contextlib.suppress(FileNotFoundError):
            os.unlink(path)


def _clear(folder: str, own: set[str]) -> None:
    """Remove what lower layers have in a folder."""
    if not _is_directory(folder):
        return
    for entry in os.listdir(folder):
        path = entry if folder == "." else f"{folder}/{entry}"
        if path not in own:
            _remove(path)
        elif _is_directory(path):
            _clear(path, own)


def _prepare(directories: Sequence[str]) -> list[str]:
    """Create what a sandbox mounts over, and return the directories without symlinks."""
    for path in _REPLACED_FILES:
        _make_parents(path)
        if os.path.islink(path) or not os.path.isfile(path):
            _remove(path)
            Path(path).touch()
    resolved = []
    for directory in directories:
        # A dangling link stays one; it may only lead to somewhere in the image.
        real = os.path.realpath("/" + _path_of(directory))
        os.makedirs(real, 0o755, exist_ok=True)
        resolved.append(real)
    return resolved


if __name__ == "__main__":
    main()
