"""From paths on this machine to files of a mission, before a byte is read.

A file given goes to the top of the mission under its own name. A folder given keeps its tree, as with rsync: `day1`
puts `day1/cam.mcap`, while `day1/` (or `.`) puts its contents, `cam.mcap`. Links to files are followed; links to
folders only where they are given themselves. Everything left out is named.
"""

import os
import stat
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import NamedTuple

from kleinkram.client.errors import (
    ClientError,
    FileUnreadable,
    InvalidInput,
    NameUnusable,
    NotAFile,
    PathsCollide,
    StillRecording,
)
from kleinkram.contract.names import check_file_path, name_key
from kleinkram.contract.uploads import MAX_FILE_BYTES

ACTIVE_SUFFIX = ".active"
_RECENT_NS = 10 * 1_000_000_000
_WATCH_S = 1.0


class FileIdentity(NamedTuple):
    """What tells that a file is still the one that was planned."""

    size_bytes: int
    mtime_ns: int
    inode: int
    device: int


@dataclass(frozen=True)
class LocalFile:
    """A file on this machine and its path in the mission."""

    source: Path
    path: str
    identity: FileIdentity

    @property
    def size_bytes(self) -> int:
        """The size when it was planned."""
        return self.identity.size_bytes


@dataclass(frozen=True)
class UploadPlan:
    """What would be uploaded, by path, and what is left out and why."""

    files: list[LocalFile] = field(default_factory=list)
    left_out: list[ClientError] = field(default_factory=list)

    @property
    def size_bytes(self) -> int:
        """The bytes of all files planned."""
        return sum(file.size_bytes for file in self.files)


def plan_upload(
    paths: Iterable[str | os.PathLike[str]], *, include_active: bool = False, exclude: Sequence[str] = ()
) -> UploadPlan:
    """Return what uploading these paths means.

    Files that are still being recorded are left out unless `include_active`: those whose name ends in `.active`, and
    those that grow while they are watched for a second (only files modified in the last seconds are). Of files that
    would have the same path in the mission, none is uploaded: nobody but their owner can say which is meant.

    Those that match a glob in `exclude` are left out without a word, as if they were not there (`is_excluded`).

    Raises:
        InvalidInput: a path given does not exist.
    """
    plan = UploadPlan()
    by_key: dict[str, list[LocalFile]] = defaultdict(list)
    for source, path in _walk(paths, plan.left_out):
        if is_excluded(path, exclude):
            continue
        file = _judged(source, path, plan.left_out)
        if file is not None and all(other.source != file.source for other in by_key[name_key(file.path)]):
            by_key[name_key(file.path)].append(file)
    plan.left_out.extend(_collision(alike) for alike in by_key.values() if len(alike) > 1)
    files = sorted((alike[0] for alike in by_key.values() if len(alike) == 1), key=lambda file: file.path)
    plan.files.extend(files if include_active else _quiet(files, plan.left_out))
    return plan


def _collision(alike: list[LocalFile]) -> PathsCollide:
    """Name files that would have one path, so that they can be told apart though they look the same."""
    *others, last = [distinct_text(str(file.source)) for file in alike]
    first = ", ".join(others)
    return PathsCollide(path=distinct_text(alike[0].path), first=first, second=last, remedy="rename all but one")


def distinct_text(text: str) -> str:
    """Return a text in quotes, with the code points of what is not ASCII: texts that look the same may differ there.

    `'café.txt' (cafe\u0301.txt)`: here the accent is a character of its own.
    """
    if text.isascii():
        return repr(text)
    return f"{text!r} ({text.encode('ascii', 'backslashreplace').decode()})"


def mission_folders(paths: Iterable[str | os.PathLike[str]], exclude: Sequence[str] = ()) -> dict[str, Path]:
    """Return the subfolders of some folders by their names, which are to be names of missions; hidden ones are not.

    Raises:
        InvalidInput: a path is no folder, or has no subfolder, or holds files beside them; or two have one name.
    """
    found: dict[str, Path] = {}
    for given in map(Path, paths):
        what = f"The folder {shown(str(given))}"
        try:
            inside = sorted(each for each in given.iterdir() if not is_excluded(each.name, [*exclude, ".*"]))
        except OSError as error:
            raise InvalidInput(what=what, reason=error.strerror or str(error)) from None
        if loose := [each.name for each in inside if not each.is_dir()]:
            reason = f"{loose[0]!r} in it belongs to no mission; move it into one, or leave it out with --exclude"
            raise InvalidInput(what=what, reason=reason)
        if not inside:
            raise InvalidInput(what=what, reason="it has no subfolder that could be a mission")
        for folder in inside:
            if folder.name in found:
                raise InvalidInput(what=what, reason=f"there is a second folder named {folder.name!r}")
            found[folder.name] = folder
    return found


def is_excluded(path: str, globs: Iterable[str]) -> bool:
    """Say whether a glob matches a file's path in the mission, its name, or a folder that it is in."""
    parts = path.split("/")
    names = {*parts, *("/".join(parts[: end + 1]) for end in range(len(parts)))}
    return any(fnmatchcase(name, glob.rstrip("/")) for glob in globs for name in names)


def identity_of(status: os.stat_result) -> FileIdentity:
    """Return a file's identity from its status."""
    return FileIdentity(status.st_size, status.st_mtime_ns, status.st_ino, status.st_dev)


def _walk(paths: Iterable[str | os.PathLike[str]], left_out: list[ClientError]) -> Iterator[tuple[Path, str]]:
    for given in paths:
        text = os.fspath(given)
        root = Path(text)
        try:
            is_folder = stat.S_ISDIR(root.stat().st_mode)
        except OSError as error:
            raise InvalidInput(what=f"The path {shown(text)}", reason=error.strerror or str(error)) from None
        if is_folder:
            contents = text.endswith(("/", "/.", "..")) or text == "."
            yield from _walk_folder(root, "" if contents else f"{root.name}/", left_out)
        else:
            yield root, root.name


def _walk_folder(root: Path, prefix: str, left_out: list[ClientError]) -> Iterator[tuple[Path, str]]:
    def unreadable(error: OSError) -> None:
        left_out.append(FileUnreadable(path=shown(str(error.filename)), reason=error.strerror or str(error)))

    for folder, folders, names in os.walk(root, onerror=unreadable):
        here = Path(folder)
        links = [here / name for name in folders if (here / name).is_symlink()]
        left_out.extend(NotAFile(path=shown(str(link)), kind="a link to a folder") for link in links)
        inside = here.relative_to(root).as_posix()
        for name in names:
            yield here / name, prefix + (name if inside == "." else f"{inside}/{name}")


def _judged(source: Path, path: str, left_out: list[ClientError]) -> LocalFile | None:
    try:
        path.encode()
        path = check_file_path(path)
    except UnicodeEncodeError:
        left_out.append(NameUnusable(path=shown(str(source)), reason="is not UTF-8"))
        return None
    except ValueError as error:
        left_out.append(NameUnusable(path=path, reason=str(error)))
        return None
    try:
        status = source.stat()
    except OSError as error:
        left_out.append(FileUnreadable(path=str(source), reason=error.strerror or str(error)))
        return None
    if not stat.S_ISREG(status.st_mode):
        left_out.append(NotAFile(path=str(source), kind=_kind(status.st_mode)))
        return None
    if status.st_size > MAX_FILE_BYTES:
        left_out.append(NameUnusable(path=str(source), reason="is larger than the 5 TiB that a store takes"))
        return None
    return LocalFile(source, path, identity_of(status))


def _quiet(files: list[LocalFile], left_out: list[ClientError]) -> list[LocalFile]:
    recent = [file for file in files if time.time_ns() - file.identity.mtime_ns < _RECENT_NS]
    if any(not file.path.endswith(ACTIVE_SUFFIX) for file in recent):
        time.sleep(_WATCH_S)
    growing = {file.path for file in recent if _has_changed(file)}
    for file in files:
        if file.path.endswith(ACTIVE_SUFFIX):
            left_out.append(StillRecording(path=str(file.source), reason="its name ends in .active"))
        elif file.path in growing:
            left_out.append(StillRecording(path=str(file.source), reason="something is writing to it"))
    return [file for file in files if not file.path.endswith(ACTIVE_SUFFIX) and file.path not in growing]


def _has_changed(file: LocalFile) -> bool:
    try:
        return identity_of(file.source.stat()) != file.identity
    except FileNotFoundError:
        return True


def _kind(mode: int) -> str:
    kinds = {stat.S_IFIFO: "a named pipe", stat.S_IFSOCK: "a socket", stat.S_IFDIR: "a folder"}
    return kinds.get(stat.S_IFMT(mode), "a device")


def shown(path: str) -> str:
    """Return a path from the file system as text that can be printed, bytes that are not UTF-8 escaped."""
    return os.fsencode(path).decode("utf-8", "backslashreplace")
