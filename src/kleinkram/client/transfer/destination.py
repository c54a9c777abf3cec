"""From files of missions to places on this machine, before a byte is fetched."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

from kleinkram.client.errors import DestinationRefused, PathsCollide
from kleinkram.client.transfer._place import check_relative
from kleinkram.client.transfer.plan import distinct_text
from kleinkram.contract.files import FileRead
from kleinkram.contract.runs import ArtifactRead


@dataclass(frozen=True)
class Target:
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
    places: dict[str, tuple[FileRead, Target]] = {}
    for file in files:
        above = f"{file.mission.project.name}/{file.mission.name}/" if nested else ""
        try:
            target = Target(file, dest, check_relative(above + file.path))
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
            target = Target(artifact, dest, check_relative(artifact.path))
        except DestinationRefused as error:
            plan.left_out.append(error)
            continue
        plan.targets.append(target)
    return plan


def _collision(target: Target, file: FileRead, other: FileRead, *, nested: bool) -> PathsCollide:
    collision = PathsCollide(
        path=distinct_text(str(target.local)), first=distinct_text(_place(other)), second=distinct_text(_place(file))
    )
    if not nested and file.mission.id != other.mission.id:
        collision.remedy = "keep the missions apart with --nested (in the SDK nested=True), or download one at a time"
    return collision


def _place(file: FileRead) -> str:
    return f"{file.mission.project.name}/{file.mission.name}/{file.path}"
