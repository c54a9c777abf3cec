"""The images of a runner without a container engine: fetched by digest, unpacked once, shared, and evicted by use.

    <digest>/               an image (`folder_cache.py`): `root/`, its files, or `image.sif` of Apptainer
    <digest>/complete.json  its size, and how it is run
    names/<hash>.json       the digests that a name stood for when it was last resolved
    scratch/                directories of short jobs of the runner's own

An image is in use while a job runs it, and for a while after it was prepared.
"""

import errno
import hashlib
import json
import os
import platform
import shutil
import subprocess
import sys
import threading
import time
import uuid
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from pydantic import BaseModel, ValidationError

from kleinkram.environments.folder_cache import EntryTooLarge, FolderCache, remove_read_only
from kleinkram.runner.images import unpack
from kleinkram.runner.images.names import ImageName, ImageNotAllowed, Pull, check_allowed
from kleinkram.runner.images.registry import (
    ImageConfig,
    OtherArchitecture,
    RegistryClient,
    RegistryFailure,
    RegistryImage,
)

# Names of architectures in images.
_ARCHITECTURES = {"x86_64": "amd64", "aarch64": "arm64"}
# Left free on the disk for others.
_SPARE_BYTES = 256 * 2**20
_RETRY_S = 0.1
_BUILD_TIMEOUT_S = 3600.0
# How long a prepared image is kept for the job that it was prepared for.
_PREPARED_S = 3600.0


class ImageFailure(Exception):
    """An image cannot be had. The text is a sentence; `is_possible`: another time, or elsewhere."""

    def __init__(self, message: str, *, is_possible: bool = True) -> None:
        super().__init__(message)
        self.is_possible = is_possible


class ImageRun(BaseModel):
    """How an image is run: what it says of itself; `volumes` are without symlinks."""

    size_bytes: int
    environment: list[str] = []
    entrypoint: list[str] = []
    command: list[str] = []
    directory: str = "/"
    volumes: list[str] = []


class Resolved(BaseModel):
    """What a name stands for: `digest` in its registry, and `reference`, the digest for this architecture."""

    digest: str
    reference: str


@dataclass
class StoredImage:
    """An image in use, which is not removed before `close`, or the end of this process. `path`: its folder or file."""

    path: Path
    run: ImageRun
    _lock: int = field(repr=False)

    def close(self) -> None:
        """End the use. May be repeated."""
        if self._lock >= 0:
            os.close(self._lock)
        self._lock = -1


class BuildSpace(NamedTuple):
    """Where an image is built, the lock that programs inherit, and the space that it may take."""

    folder: Path
    lock: int
    limit_bytes: int


class ImageBuilder(ABC):
    """Makes an image of a registry usable on this machine."""

    # The name of what it makes, in the folder of an image.
    content: str

    @abstractmethod
    def build(self, name: ImageName, image: RegistryImage, space: BuildSpace, client: RegistryClient) -> ImageRun:
        """Build `content` in a folder.

        Raises:
            ImageFailure, RegistryFailure: it is not possible.
            OSError: the disk is full or broken.
        """


class FolderBuilder(ImageBuilder):
    """Makes a folder with the files of an image, for sandboxes of namespaces."""

    content = "root"

    def build(self, name: ImageName, image: RegistryImage, space: BuildSpace, client: RegistryClient) -> ImageRun:
        """Fetch the layers, and unpack them in a process that sees nothing but the folder."""
        packed_bytes = sum(layer.size_bytes for layer in image.layers)
        if packed_bytes > space.limit_bytes:
            raise too_large(packed_bytes, space.limit_bytes)
        paths: list[Path] = []
        for number, layer in enumerate(image.layers):
            paths.append(space.folder / f"layer-{number}")
            client.fetch_layer(layer, paths[-1], lambda _: check_space(space.folder))
        config = image.config
        directories = [config.directory or "/", *(config.volumes or ())]
        request = unpack.UnpackRequest([str(path) for path in paths], directories, space.limit_bytes)
        result = _unpack(request, space)
        for path in paths:
            path.unlink()
        return run_of(config, result.size_bytes, result.directories)


def run_of(config: ImageConfig, size_bytes: int, directories: Sequence[str]) -> ImageRun:
    """Return how an image is run. `directories`: its working directory and volumes."""
    return ImageRun(
        size_bytes=size_bytes,
        environment=config.environment or [],
        entrypoint=config.entrypoint or [],
        command=config.command or [],
        directory=directories[0],
        volumes=list(dict.fromkeys(directories[1:])),
    )


class ImageStore(FolderCache):
    """Images of at most `limit_bytes` beside those in use. `allowed`: registries or namespaces; None for all."""

    def __init__(
        self,
        folder: Path,
        limit_bytes: int,
        builder: ImageBuilder,
        *,
        pull: Pull = Pull.missing,
        allowed: Sequence[str] | None = None,
    ) -> None:
        super().__init__(folder, limit_bytes)
        self.builder = builder
        self._pull = pull
        self._allowed = allowed
        self._names = folder / "names"
        self._names.mkdir(exist_ok=True)
        self.scratch = folder / "scratch"
        self.scratch.mkdir(mode=0o711, exist_ok=True)
        self._prepared: dict[str, tuple[int, float]] = {}
        self._lock = threading.Lock()
        self._architecture = _ARCHITECTURES.get(platform.machine(), platform.machine())

    def prepare(self, text: str) -> Resolved:
        """Make an image available, which may take minutes, and keep it for a while.

        Raises:
            ImageFailure: it is not allowed, not available, or for another architecture.
        """
        try:
            name = check_allowed(text, self._allowed)
            known = self._read_name(name)
            is_fixed = name.digest or self._pull is not Pull.always
            if known is not None and is_fixed and self._keep(known.reference):
                return known
            if self._pull is Pull.never:
                raise ImageFailure(f"The image {text} is not on this runner, which does not pull images.")
            return self._fetch(name)
        except OtherArchitecture as error:
            raise ImageFailure(str(error), is_possible=False) from error
        except (ImageNotAllowed, RegistryFailure) as error:
            raise ImageFailure(str(error)) from error
        except EntryTooLarge:
            raise ImageFailure(f"The image {text} takes more than all images may take here.") from None
        except OSError as error:
            reason = "The disk is full" if error.errno == errno.ENOSPC else str(error.strerror or error)
            raise ImageFailure(f"The image {text} cannot be stored: {reason}.") from error

    def find(self, reference: str) -> StoredImage | None:
        """Return an image that was prepared, in use from now on; None without it."""
        key = self._key(reference)
        lock = self.use(key)
        if lock is None:
            return None
        try:
            run = ImageRun.model_validate(self._read_complete(key))
        except ValidationError:
            os.close(lock)
            return None
        return StoredImage(self._folder / key / self.builder.content, run, lock)

    def close(self) -> None:
        """End the use of the images that were prepared last."""
        with self._lock:
            for lock, _ in self._prepared.values():
                os.close(lock)
            self._prepared.clear()

    def _fetch(self, name: ImageName) -> Resolved:
        client = RegistryClient(name, self._architecture)
        image = client.resolve()
        resolved = Resolved(digest=image.digest, reference=image.manifest_digest)
        key = self._key(resolved.reference)
        while not self._keep(resolved.reference):
            with self.try_lock(key) as lock:
                if lock is None:  # another runner builds it
                    time.sleep(_RETRY_S)
                elif not self._is_complete(key):
                    self._build(name, image, client, lock)
        path = self._name_path(name)
        # Runners may resolve the same name at the same time.
        temporary = path.with_name(f"{path.name}.{uuid.uuid4().hex}.new")
        temporary.write_text(resolved.model_dump_json())
        temporary.replace(path)
        return resolved

    def _build(self, name: ImageName, image: RegistryImage, client: RegistryClient, lock: int) -> None:
        key = self._key(image.manifest_digest)
        self.remove_folders(key)
        new = self.make_folder(key)
        try:
            limit_bytes = min(self._limit_bytes, max(0, shutil.disk_usage(new).free - _SPARE_BYTES))
            run = self.builder.build(name, image, BuildSpace(new, lock, limit_bytes), client)
            self.publish(new, key, run.model_dump())
        finally:
            if new.exists():
                remove_read_only(new)

    def _keep(self, reference: str) -> bool:
        """Keep an image for a while; whether it is there."""
        key, now = self._key(reference), time.monotonic()
        with self._lock:
            for expired in [key for key, (_, until) in self._prepared.items() if until < now]:
                os.close(self._prepared.pop(expired)[0])
            lock = self._prepared[key][0] if key in self._prepared else self.use(key)
            if lock is None:
                return False
            self._prepared[key] = (lock, now + _PREPARED_S)
        return True

    def _key(self, reference: str) -> str:
        return f"{reference.removeprefix('sha256:')}-{self.builder.content.rpartition('.')[2]}"

    def _name_path(self, name: ImageName) -> Path:
        full = name.digest or f"{name.repository}:{name.tag}"
        return self._names / f"{hashlib.sha256(full.encode()).hexdigest()}.json"

    def _read_name(self, name: ImageName) -> Resolved | None:
        try:
            return Resolved.model_validate_json(self._name_path(name).read_text())
        except (FileNotFoundError, ValidationError):
            return None


def _unpack(request: unpack.UnpackRequest, space: BuildSpace) -> unpack.UnpackResult:
    root = space.folder / FolderBuilder.content
    root.mkdir(mode=0o755)
    command = [sys.executable, "-I", "-m", unpack.__name__, str(root)]
    try:
        done = subprocess.run(
            command,
            input=json.dumps(request),
            capture_output=True,
            text=True,
            check=False,
            timeout=_BUILD_TIMEOUT_S,
            pass_fds=[space.lock],
        )
        result = unpack.UnpackResult(*json.loads(done.stdout))
    except subprocess.TimeoutExpired:
        raise ImageFailure(f"The image cannot be unpacked within {_BUILD_TIMEOUT_S:.0f} s.") from None
    except ValueError:
        last = done.stderr.strip().rpartition("\n")[2]
        raise ImageFailure(f"The image cannot be unpacked: {last or f'exit code {done.returncode}'}.") from None
    if result.error:
        raise ImageFailure(f"The image cannot be unpacked. {result.error}")
    return result


def check_space(folder: Path) -> None:
    """Raise OSError where the disk is full, but for what is left to others."""
    if shutil.disk_usage(folder).free < _SPARE_BYTES:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def too_large(size_bytes: int, limit_bytes: int) -> ImageFailure:
    """Return the failure of an image that is too large."""
    return ImageFailure(f"The image takes {size_bytes / 1e9:.1f} GB; {limit_bytes / 1e9:.1f} GB are allowed.")
