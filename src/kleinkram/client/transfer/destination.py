"""Where downloaded files go: always inside the destination, whatever the server says their names are."""

import os
import stat
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

from kleinkram.client.errors import DestinationRefused, PathsCollide
from kleinkram.client.transfer.plan import distinct_text
from kleinkram.contract.files import FileRead
from kleinkram.contract.names import MAX_PATH_PART_BYTES, check_file_path
from kleinkram.contract.runs import ArtifactRead

PART_SUFFIX = ".klein-part"
JOURNAL_SUFFIX = ".klein-journal"


def check_relative(path: str) -> str:
    """Return a path from the server, if it stays inside what it is put under.

    Raises:
        DestinationRefused: it does not, or cannot be a file's name here.
    """
    try:
        return check_file_path(path)
    except ValueError as error:
        raise DestinationRefused(path=path, reason=f"the server's name for it {error}") from None


def make_folders(dest: Path, relative: str) -> Path:
    """Make the folders that a file needs below `dest`, and return where the file goes.

    A link that is there already may be followed as long as it stays inside `dest`.

    Raises:
        DestinationRefused: a link leads outside, or a file is where a folder is needed.
    """
    target = dest / relative
    root = Path(os.path.realpath(dest))
    for folder in [*reversed(target.relative_to(dest).parents)][1:]:
        here = dest / folder
        try:
            here.mkdir()
        except FileExistsError:
            _check_folder(here, root, relative)
        except OSError as error:
            raise DestinationRefused(path=str(target), reason=error.strerror or str(error)) from None
    return target


def _check_folder(folder: Path, root: Path, relative: str) -> None:
    real = Path(os.path.realpath(folder))
    if root != real and root not in real.parents:
        raise DestinationRefused(path=relative, reason=f"{str(folder)!r} is a link that leads out of the destination")
    if not folder.is_dir():
        raise DestinationRefused(path=relative, reason=f"{str(folder)!r} is a file, and a folder is needed there")


def partial_path(target: Path, suffix: str) -> Path:
    """Return the name beside a target under which it is kept until it is whole."""
    name = target.name
    while len((name + suffix).encode()) > MAX_PATH_PART_BYTES:
        name = name[:-1]
    return target.with_name(name + suffix)


def regular_size(target: Path) -> int | None:
    """Return the size of what is at a place: None for nothing, -1 for something that is not a plain file."""
    try:
        status = target.lstat()
    except FileNotFoundError:
        return None
    return status.st_size if stat.S_ISREG(status.st_mode) else -1


@dataclass(frozen=True)
class DownloadTarget:
    """A file of a mission, or an artifact of a run, and where it goes: `relative` below `dest`."""

    file: FileRead | ArtifactRead
    dest: Path
    relative: str

    @property
    def local(self) -> Path:
        """The place on this machine."""
        return self.dest / self.relative


@dataclass(frozen=True)
class DownloadPlan:
    """What would be downloaded, and which files have a name that cannot be written here."""

    targets: list[DownloadTarget] = field(default_factory=list)
    left_out: list[DestinationRefused] = field(default_factory=list)

    @property
    def size_bytes(self) -> int:
        """The bytes of all files planned."""
        return sum(target.file.size_bytes for target in self.targets)


def plan_download(files: Iterable[FileRead], dest: Path, *, nested: bool = False) -> DownloadPlan:
    """Return where these files go below `dest`: by their path in the mission, below project and mission if `nested`.

    Raises:
        PathsCollide: two files would have the same place, or one would be a folder of the other; names both.
    """
    plan = DownloadPlan()
    places: dict[str, tuple[FileRead, DownloadTarget]] = {}
    for file in files:
        above = f"{file.mission.project.name}/{file.mission.name}/" if nested else ""
        try:
            target = DownloadTarget(file, dest, check_relative(above + file.path))
        except DestinationRefused as error:
            plan.left_out.append(error)
            continue
        other, first = places.setdefault(target.relative, (file, target))
        if first is not target:
            raise _collision(target, file, other, nested=nested)
        plan.targets.append(target)
    for file, target in [*places.values()]:
        for folder in PurePosixPath(target.relative).parents:
            if str(folder) in places:
                raise _collision(target, file, places[str(folder)][0], nested=nested)
    return plan


def plan_artifacts(artifacts: Iterable[ArtifactRead], dest: Path) -> DownloadPlan:
    """Return where these artifacts of one run go below `dest`: by their paths under its `/out`."""
    plan = DownloadPlan()
    for artifact in artifacts:
        try:
            target = DownloadTarget(artifact, dest, check_relative(artifact.path))
        except DestinationRefused as error:
            plan.left_out.append(error)
            continue
        plan.targets.append(target)
    return plan


def _collision(target: DownloadTarget, file: FileRead, other: FileRead, *, nested: bool) -> PathsCollide:
    collision = PathsCollide(
        path=distinct_text(str(target.local)), first=distinct_text(_place(other)), second=distinct_text(_place(file))
    )
    if not nested and file.mission.id != other.mission.id:
        collision.remedy = "keep the missions apart with --nested (in the SDK nested=True), or download one at a time"
    return collision


def _place(file: FileRead) -> str:
    return f"{file.mission.project.name}/{file.mission.name}/{file.path}"
