"""Conflicts of paths in a mission: no path twice, and no file where another path needs a folder."""

import uuid
from collections.abc import Collection, Sequence

from kleinkram.contract.errors import NameTaken, PathConflict
from kleinkram.contract.names import name_key
from kleinkram.server.db import Connection
from kleinkram.server.files import queries

HIDDEN_FILE = "a file that you may not see"
"""The text of a conflict for an actor who may not read the mission."""


async def path_conflicts(
    db: Connection, mission_id: uuid.UUID, paths: Collection[str], *, except_id: uuid.UUID | None = None
) -> dict[str, str]:
    """Return those of `paths` that conflict with a mission's files, each with the path of that file.

    Such a path needs a folder where there is a file, or is a folder itself. A file of the same path is no conflict, and
    `paths` do not conflict with each other. Two queries for any number of paths; the caller has locked the mission.
    """
    above = {path: folder_keys(path) for path in paths}
    blocking = await db.execute(
        queries.files_at(mission_id, {key for keys in above.values() for key in keys}, except_id=except_id)
    )
    files = {row.path_key: row.path for row in blocking}
    blocked = {path: files[key] for path, keys in above.items() for key in keys if key in files}
    keys = sorted({name_key(path) for path in paths})
    below = {row.key: row.path for row in await db.execute(queries.files_below(mission_id, keys, except_id=except_id))}
    return blocked | {path: below[name_key(path)] for path in paths if name_key(path) in below}


def visible_conflicts(conflicts: dict[str, str], *, may_read: bool) -> dict[str, str]:
    """Return conflicts with existing files as the actor may see them."""
    return conflicts if may_read else dict.fromkeys(conflicts, HIDDEN_FILE)


def conflicts_among(paths: Sequence[str]) -> dict[int, str]:
    """Return the positions of paths that conflict with an earlier path of the list, with that path.

    Two paths conflict if they are the same name (in any case or Unicode form), or one is a folder of the other.
    """
    files: dict[str, str] = {}
    folders: dict[str, str] = {}
    conflicts: dict[int, str] = {}
    for position, path in enumerate(paths):
        key, parents = name_key(path), folder_keys(path)
        parent_file = next((files[parent] for parent in parents if parent in files), None)
        other = files.get(key) or folders.get(key) or parent_file
        if other is not None:
            conflicts[position] = other
            continue
        files[key] = path
        folders |= dict.fromkeys(parents, path)
    return conflicts


def folder_keys(path: str) -> list[str]:
    """Return the keys of the folders that a path is in, the outermost first."""
    parts = name_key(path).split("/")
    return ["/".join(parts[:count]) for count in range(1, len(parts))]


async def check_path_free(
    db: Connection, mission_id: uuid.UUID, path: str, *, except_id: uuid.UUID | None = None
) -> None:
    """Check that a file can have a path; the caller has locked the mission.

    Raises:
        NameTaken: there is a file of that path, in any letter case and Unicode form.
        PathConflict: the path is a folder there, or needs a folder where a file is.
    """
    if (await db.execute(queries.files_at(mission_id, [name_key(path)], except_id=except_id))).first() is not None:
        raise NameTaken(resource_type="file", name=path)
    if other := (await path_conflicts(db, mission_id, [path], except_id=except_id)).get(path):
        raise PathConflict(path=path, other=other)
