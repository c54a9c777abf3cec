"""What the upload protocol asks of the database."""

import uuid
from collections.abc import Collection
from typing import Any

from sqlalchemy import ColumnElement, Row, Select, false, func, select

from kleinkram.contract.files import BlobState
from kleinkram.contract.rights import Right, Scope
from kleinkram.server.access.actor import Actor, ActorKind
from kleinkram.server.access.visible import visible_files, visible_missions
from kleinkram.server.db import Connection, among
from kleinkram.server.tables import blob, file, mission, run, upload
from kleinkram.server.tables.run import HELD
from kleinkram.server.tables.upload import UNDER_WAY

# What makes two files the same: size in bytes and SHA-256.
Content = tuple[int, bytes]


def own_uploads(actor: Actor) -> Select[Any]:
    """Return the uploads that `actor` began, in missions that they may still fill; a runner: of runs that it holds."""
    if actor.kind is ActorKind.runner:
        held = select(run.c.id).where(run.c.runner_id == actor.runner_id, run.c.state.in_(HELD))
        return select(upload).where(upload.c.run_id.in_(held))
    missions = visible_missions(actor, Right.create).with_only_columns(mission.c.id)
    own = (upload.c.person_id == actor.person_id) & upload.c.run_id.is_(None)
    return select(upload).where(own, upload.c.mission_id.in_(missions))


async def live_files(db: Connection, mission_id: uuid.UUID, path_keys: Collection[str]) -> dict[str, Row[Any]]:
    """Return a mission's files under the given keys, with what is known of their bytes."""
    statement = (
        select(file.c.id, file.c.path, file.c.path_key, blob.c.size_bytes, blob.c.sha256, blob.c.state)
        .join(blob, blob.c.id == file.c.blob_id)
        .where(file.c.mission_id == mission_id, among(file.c.path_key, path_keys), file.c.deleted_at.is_(None))
    )
    return {row.path_key: row for row in await db.execute(statement)}


async def active_uploads(db: Connection, mission_id: uuid.UUID, path_keys: Collection[str]) -> dict[str, Row[Any]]:
    """Return the uploads that hold the given keys of a mission, locked."""
    holding = (upload.c.mission_id == mission_id) & upload.c.run_id.is_(None)
    statement = (
        select(upload, (upload.c.lease_ends_at > func.now()).label("leased"))
        .where(holding, among(upload.c.path_key, path_keys), upload.c.state.in_(UNDER_WAY))
        .order_by(upload.c.id)
        .with_for_update()
    )
    return {row.path_key: row for row in await db.execute(statement)}


async def used_ids(db: Connection, upload_ids: Collection[uuid.UUID]) -> frozenset[uuid.UUID]:
    """Return those of some ids that an upload of anybody's has or had."""
    return frozenset((await db.execute(select(upload.c.id).where(among(upload.c.id, upload_ids)))).scalars())


async def twin_sizes(db: Connection, actor: Actor, sizes: Collection[int]) -> set[int]:
    """Return those of `sizes` of which `actor` may read a trusted blob: files of them are worth hashing first."""
    statement = select(blob.c.size_bytes).where(among(blob.c.size_bytes, sizes), _trusted_by(actor), _read_by(actor))
    return set((await db.execute(statement.distinct())).scalars())


async def twins(db: Connection, actor: Actor, hashes: Collection[Content]) -> dict[Content, uuid.UUID]:
    """Return trusted, readable blobs of the given contents, locked so that no sweep can doom them meanwhile."""
    statement = (
        select(blob.c.id, blob.c.size_bytes, blob.c.sha256)
        .where(
            among(blob.c.size_bytes, {size_bytes for size_bytes, _ in hashes}),
            among(blob.c.sha256, {sha256 for _, sha256 in hashes}),
            _trusted_by(actor),
            _read_by(actor),
        )
        .order_by(blob.c.id)
        .with_for_update(read=True, of=blob)
    )
    return {(row.size_bytes, row.sha256): row.id for row in await db.execute(statement)}


def _trusted_by(actor: Actor) -> ColumnElement[bool]:
    # A hash that somebody else only claims must not hand out their bytes, nor lend ours to their name.
    verified = blob.c.state == BlobState.verified.value
    own = (blob.c.state == BlobState.stored.value) & (blob.c.uploaded_by_id == actor.person_id)
    return blob.c.doomed_at.is_(None) & (verified | own)


def _read_by(actor: Actor) -> ColumnElement[bool]:
    if Scope.read not in actor.scopes:
        return false()
    return blob.c.id.in_(visible_files(actor).with_only_columns(file.c.blob_id))


async def locked_uploads(db: Connection, actor: Actor, upload_ids: Collection[uuid.UUID]) -> dict[uuid.UUID, Row[Any]]:
    """Return the uploads of `actor` among the given ids, locked, in one order everywhere."""
    statement = (
        own_uploads(actor)
        .add_columns((upload.c.expires_at <= func.now()).label("is_expired"), func.now().label("now"))
        .where(among(upload.c.id, upload_ids))
        .order_by(upload.c.id)
        .with_for_update(of=upload)
    )
    return {row.id: row for row in await db.execute(statement)}
