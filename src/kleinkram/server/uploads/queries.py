"""What the upload protocol asks of the database."""

import uuid
from collections.abc import Collection
from pathlib import PurePosixPath
from typing import Any

from sqlalchemy import ColumnElement, Row, Select, Text, func, select, true, tuple_
from sqlalchemy.dialects.postgresql import array

from kleinkram.contract.files import BlobState
from kleinkram.contract.names import name_key
from kleinkram.contract.uploads import UploadState
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import visible_files, visible_missions
from kleinkram.server.db import Connection
from kleinkram.server.tables import blob, file, mission, upload

# What makes two files the same: size in bytes and SHA-256.
Content = tuple[int, bytes]
ACTIVE = (UploadState.open.value, UploadState.completing.value)


def own_uploads(actor: Actor) -> Select[Any]:
    """Return the uploads that `actor` began, in missions they may still see."""
    missions = visible_missions(actor).with_only_columns(mission.c.id)
    return select(upload).where(upload.c.person_id == actor.person_id, upload.c.mission_id.in_(missions))


async def live_files(db: Connection, mission_id: uuid.UUID, path_keys: Collection[str]) -> dict[str, Row[Any]]:
    """Return a mission's files under the given keys, with what is known of their bytes."""
    statement = (
        select(file.c.id, file.c.path, file.c.path_key, blob.c.size_bytes, blob.c.sha256, blob.c.state)
        .join(blob, blob.c.id == file.c.blob_id)
        .where(file.c.mission_id == mission_id, file.c.path_key.in_(path_keys), file.c.deleted_at.is_(None))
    )
    return {row.path_key: row for row in await db.execute(statement)}


async def active_uploads(db: Connection, mission_id: uuid.UUID, path_keys: Collection[str]) -> dict[str, Row[Any]]:
    """Return the uploads that hold the given keys of a mission, locked."""
    statement = (
        select(upload, (upload.c.lease_ends_at > func.now()).label("leased"))
        .where(upload.c.mission_id == mission_id, upload.c.path_key.in_(path_keys), upload.c.state.in_(ACTIVE))
        .order_by(upload.c.id)
        .with_for_update()
    )
    return {row.path_key: row for row in await db.execute(statement)}


async def twin_sizes(db: Connection, actor: Actor, sizes: Collection[int]) -> set[int]:
    """Return those of `sizes` of which `actor` may read a trusted blob: files of them are worth hashing first."""
    statement = select(blob.c.size_bytes).where(blob.c.size_bytes.in_(sizes), _trusted_by(actor), _read_by(actor))
    return set((await db.execute(statement.distinct())).scalars())


async def twins(db: Connection, actor: Actor, hashes: Collection[Content]) -> dict[Content, uuid.UUID]:
    """Return trusted, readable blobs of the given contents, locked so that no sweep can doom them meanwhile."""
    statement = (
        select(blob.c.id, blob.c.size_bytes, blob.c.sha256)
        .where(tuple_(blob.c.size_bytes, blob.c.sha256).in_(hashes), _trusted_by(actor), _read_by(actor))
        .order_by(blob.c.id)
        .with_for_update(read=True, of=blob)
    )
    return {(row.size_bytes, row.sha256): row.id for row in await db.execute(statement)}


def _trusted_by(actor: Actor) -> ColumnElement[bool]:
    # A hash that somebody else only claims must not hand out their bytes, nor lend ours to their name.
    proven = blob.c.state == BlobState.proven.value
    own = (blob.c.state == BlobState.stored.value) & (blob.c.uploaded_by_id == actor.person_id)
    return blob.c.doomed_at.is_(None) & (proven | own)


def _read_by(actor: Actor) -> ColumnElement[bool]:
    return blob.c.id.in_(visible_files(actor).with_only_columns(file.c.blob_id))


async def locked_uploads(db: Connection, actor: Actor, upload_ids: Collection[uuid.UUID]) -> dict[uuid.UUID, Row[Any]]:
    """Return the uploads of `actor` among the given ids, locked, in one order everywhere."""
    statement = (
        own_uploads(actor)
        .add_columns((upload.c.expires_at <= func.now()).label("is_expired"))
        .where(upload.c.id.in_(upload_ids))
        .order_by(upload.c.id)
        .with_for_update(of=upload)
    )
    return {row.id: row for row in await db.execute(statement)}


async def path_conflicts(db: Connection, mission_id: uuid.UUID, paths: Collection[str]) -> dict[str, str]:
    """Return, of `paths`, those that need a folder where the mission has a file or the reverse, with what they meet."""
    found: dict[str, str] = {}
    folders = {path: [name_key(str(parent)) for parent in PurePosixPath(path).parents if parent.name] for path in paths}
    wanted = {key for keys in folders.values() for key in keys}
    statement = select(file.c.path_key, file.c.path).where(
        file.c.mission_id == mission_id, file.c.deleted_at.is_(None), file.c.path_key.in_(wanted)
    )
    blocking = {row.path_key: row.path for row in await db.execute(statement)} if wanted else {}
    for path, keys in folders.items():
        if met := next((blocking[key] for key in keys if key in blocking), None):
            found[path] = met
    return found | await _files_below(db, mission_id, paths)


async def _files_below(db: Connection, mission_id: uuid.UUID, paths: Collection[str]) -> dict[str, str]:
    by_key = {name_key(path): path for path in paths}
    key = func.unnest(array(list(by_key), type_=Text)).column_valued("key")
    below = (
        select(file.c.path)
        .where(
            file.c.mission_id == mission_id,
            file.c.deleted_at.is_(None),
            # '0' is the character after '/': a range that the index on path_key serves.
            file.c.path_key > key + "/",
            file.c.path_key < key + "0",
        )
        .limit(1)
        .lateral("below")
    )
    rows = await db.execute(select(key, below.c.path).join(below, true()))
    return {by_key[row[0]]: row.path for row in rows}


async def lock_mission(db: Connection, actor: Actor, mission_id: uuid.UUID) -> bool:
    """Lock a mission against deleting, moving and other completions, and say whether `actor` may see it."""
    statement = (
        visible_missions(actor)
        .with_only_columns(mission.c.id)
        .where(mission.c.id == mission_id)
        .with_for_update(of=mission, key_share=True)
    )
    return (await db.execute(statement)).first() is not None
