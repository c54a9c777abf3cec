"""From files of missions to places on this machine, before a byte is fetched."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

from kleinkram.client.errors import DestinationRefused, PathsCollide
from kleinkram.client.transfer._place import check_relative
from kleinkram.contract.files import FileRead


@dataclass(frozen=True)
class Target:
    """A file and where it goes: `relative` below `dest`."""

    file: FileRead
    dest: Path
    relative: str

    @property
    def local(self) -> Path:
        """The place on this machine."""
        return self.dest / self.relative


@dataclass(frozen=True)
class DownloadPlan:
    """What would be downloaded, and which files have a name that cannot be written here."""

    targets: list[Target] = field(default_factory=list)
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
    places: dict[str, Target] = {}
    for file in files:
        above = f"{file.mission.project.name}/{file.mission.name}/" if nested else ""
        try:
            target = Target(file, dest, check_relative(above + file.path))
        except DestinationRefused as error:
            plan.left_out.append(error)
            continue
        if (other := places.setdefault(target.relative, target)) is not target:
            raise _collision(target, other, nested=nested)
        plan.targets.append(target)
    for target in plan.targets:
        for folder in PurePosixPath(target.relative).parents:
            if str(folder) in places:
                raise _collision(target, places[str(folder)], nested=nested)
    return plan


def _collision(one: Target, other: Target, *, nested: bool) -> PathsCollide:
    collision = PathsCollide(path=str(one.local), first=_place(other.file), second=_place(one.file))
    if not nested and one.file.mission.id != other.file.mission.id:
        collision.remedy = "keep the missions apart with --nested (in the SDK nested=True), or download one at a time"
    return collision


def _place(file: FileRead) -> str:
    return f"{file.mission.project.name}/{file.mission.name}/{file.path}"
