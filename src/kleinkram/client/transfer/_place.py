"""Where a downloaded file may be written: inside the destination, whatever the server says its name is."""

import os
import stat
from pathlib import Path

from kleinkram.client.errors import DestinationRefused
from kleinkram.contract.names import MAX_PATH_PART_BYTES, check_file_path

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


def part_file(target: Path, suffix: str) -> Path:
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
