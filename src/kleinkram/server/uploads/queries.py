"""Database queries of the upload protocol."""

import datetime
import uuid
from collections.abc import Collection, Sequence
from typing import Any, NamedTuple

from sqlalchemy import ColumnElement, Select, false, func, select

from kleinkram.contract.access import Right, Scope
from kleinkram.contract.errors import FileExists
from kleinkram.contract.files import BlobState
from kleinkram.contract.uploads import UploadState
from kleinkram.server.access.actor import Actor, ActorKind
from kleinkram.server.access.visible import visible_files, visible_missions
from kleinkram.server.db import Connection, among
from kleinkram.server.tables import blob, file, mission, run, upload
from kleinkram.server.tables.blobs import UNDER_WAY
from kleinkram.server.tables.runs import ASSIGNED


class FileContent(NamedTuple):
    """Properties that make two files equal."""

    size_bytes: int
    sha256: bytes


class UploadRow(NamedTuple):
    """One row of the table `upload`. `has_lease` and `is_expired` are judged by the database's clock."""

    id: uuid.UUID
    mission_id: uuid.UUID
    person_id: uuid.UUID
    run_id: uuid.UUID | None
    path: str
    path_key: str
    size_bytes: int
    part_size_bytes: int
    checksum: str
    store_id: str
    key: str
    multipart_id: str | None
    signed_checksum: str | None
    state: str
    sha256: bytes  # this and the next: null until the client sent the hashes
    crc64nvme: bytes
    file_id: uuid.UUID | None
    failure: str | None
    renewed_at: datetime.datetime
    lease_ends_at: datetime.datetime
    expires_at: datetime.datetime
    now: datetime.datetime

    @property
    def content(self) -> FileContent:
        """The content that the client announced with its hashes."""
        return FileContent(self.size_bytes, self.sha256)

    @property
    def has_lease(self) -> bool:
        """Whether the name is still reserved."""
        return self.lease_ends_at > self.now

    @property
    def is_expired(self) -> bool:
        """Whether it was abandoned for so long that it cannot be resumed."""
        return self.expires_at <= self.now

    @property
    def is_multipart(self) -> bool:
        """Whether the file goes up in several parts; otherwise it is one plain PUT."""
        return self.size_bytes > self.part_size_bytes

    @property
    def part_count(self) -> int:
        """Number of parts; an empty file has one empty part."""
        return max(1, -(-self.size_bytes // self.part_size_bytes))

    def part_bytes(self, number: int) -> int:
        """Return the size of a part, counted from 1: all but the last are equal."""
        return min(self.part_size_bytes, self.size_bytes - (number - 1) * self.part_size_bytes)


class ExistingFile(NamedTuple):
    """A file of a mission, outside the trash, with what is known of its bytes."""

    id: uuid.UUID
    path: str
    path_key: str
    size_bytes: int
    sha256: bytes
    state: str

    @property
    def content(self) -> FileContent:
        """Content of the file."""
        return FileContent(self.size_bytes, self.sha256)

    @property
    def is_damaged(self) -> bool:
        """Whether the store lost its bytes or changed them."""
        return self.state in DAMAGED_STATES

    def exists_error(self, path: str, sent: FileContent, *, may_read: bool) -> FileExists:
        """Return the error for other bytes under its name; without `may_read`, it says nothing else about the file."""
        return FileExists(
            path=path,
            existing_sha256=self.sha256.hex() if may_read else None,
            sent_sha256=sent.sha256.hex(),
            existing_file_id=str(self.id) if may_read else None,
        )


DAMAGED_STATES = {BlobState.lost.value, BlobState.corrupt.value}
UNFINISHED_STATES = (UploadState.completing.value, UploadState.open.value)
_COLUMNS = [*(upload.c[name] for name in UploadRow._fields[:-1]), func.now().label("now")]


def select_uploads() -> Select[Any]:
    """Return the statement whose rows `read_rows` understands."""
    return select(*_COLUMNS)


def to_upload(row: Sequence[object]) -> UploadRow:
    """Return a row of a statement that began with `select_uploads`; columns that were added are left out."""
    return UploadRow._make(row[: len(UploadRow._fields)])


async def read_rows(db: Connection, statement: Select[Any]) -> list[UploadRow]:
    """Run a statement that began with `select_uploads`."""
    return [to_upload(row) for row in await db.execute(statement)]


def own_uploads(actor: Actor) -> Select[Any]:
    """Select the actor's uploads into missions that they may still fill; a runner's: those of its active runs."""
    if actor.kind is ActorKind.runner:
        active_runs = select(run.c.id).where(run.c.runner_id == actor.runner_id, run.c.state.in_(ASSIGNED))
        return select_uploads().where(upload.c.run_id.in_(active_runs))
    missions = visible_missions(actor, Right.create).with_only_columns(mission.c.id)
    own = (upload.c.person_id == actor.person_id) & upload.c.run_id.is_(None)
    return select_uploads().where(own, upload.c.mission_id.in_(missions))


async def lock_own_uploads(
    db: Connection, actor: Actor, upload_ids: Collection[uuid.UUID]
) -> dict[uuid.UUID, UploadRow]:
    """Lock and return the actor's uploads among the given ids, always in the same order."""
    statement = own_uploads(actor).where(among(upload.c.id, upload_ids)).order_by(upload.c.id)
    return {row.id: row for row in await read_rows(db, statement.with_for_update(of=upload))}


async def lock_uploads_at(db: Connection, mission_id: uuid.UUID, path_keys: Collection[str]) -> dict[str, UploadRow]:
    """Lock and return, by path key, the uploads that reserve these names of a mission."""
    is_reserved = upload.c.run_id.is_(None) & upload.c.state.in_(UNDER_WAY)
    statement = select_uploads().where(upload.c.mission_id == mission_id, is_reserved)
    statement = statement.where(among(upload.c.path_key, path_keys)).order_by(upload.c.id)
    return {row.path_key: row for row in await read_rows(db, statement.with_for_update())}


async def lock_unfinished(db: Connection, uploads: Collection[UploadRow]) -> list[UploadRow]:
    """Lock these uploads and return those that no other request has finished.

    Open ones count: while the store joined the parts, another request may have seen too few of them and reopened the
    upload.
    """
    ids = [row.id for row in uploads]
    statement = select(upload.c.id).where(among(upload.c.id, ids), upload.c.state.in_(UNFINISHED_STATES))
    unfinished = set((await db.execute(statement.order_by(upload.c.id).with_for_update())).scalars())
    return [row for row in uploads if row.id in unfinished]


async def used_ids(db: Connection, upload_ids: Collection[uuid.UUID]) -> frozenset[uuid.UUID]:
    """Return the ids among these that any upload has or had."""
    return frozenset((await db.execute(select(upload.c.id).where(among(upload.c.id, upload_ids)))).scalars())


async def existing_files(db: Connection, mission_id: uuid.UUID, path_keys: Collection[str]) -> dict[str, ExistingFile]:
    """Return a mission's files by path key."""
    statement = (
        select(file.c.id, file.c.path, file.c.path_key, blob.c.size_bytes, blob.c.sha256, blob.c.state)
        .join(blob, blob.c.id == file.c.blob_id)
        .where(file.c.mission_id == mission_id, among(file.c.path_key, path_keys), file.c.deleted_at.is_(None))
    )
    return {row.path_key: ExistingFile._make(row) for row in await db.execute(statement)}


async def duplicate_sizes(db: Connection, actor: Actor, sizes: Collection[int]) -> frozenset[int]:
    """Return the sizes for which the actor may read a trusted blob: such files are worth hashing first."""
    statement = select(blob.c.size_bytes).where(among(blob.c.size_bytes, sizes), _is_trusted(actor), _is_read(actor))
    return frozenset((await db.execute(statement.distinct())).scalars())


async def lock_duplicates(
    db: Connection, actor: Actor, contents: Collection[FileContent]
) -> dict[FileContent, uuid.UUID]:
    """Lock and return trusted, readable blobs of these contents; garbage collection cannot mark them."""
    if not contents:
        return {}
    statement = (
        select(blob.c.size_bytes, blob.c.sha256, blob.c.id)
        .where(
            among(blob.c.size_bytes, {content.size_bytes for content in contents}),
            among(blob.c.sha256, {content.sha256 for content in contents}),
            _is_trusted(actor),
            _is_read(actor),
        )
        .order_by(blob.c.id)
        .with_for_update(read=True, of=blob)
    )
    return {FileContent(row.size_bytes, row.sha256): row.id for row in await db.execute(statement)}


def _is_trusted(actor: Actor) -> ColumnElement[bool]:
    # A hash that another person merely claims must not give access to their bytes, nor to ours under their name.
    verified = blob.c.state == BlobState.verified.value
    own = (blob.c.state == BlobState.stored.value) & (blob.c.uploaded_by_id == actor.person_id)
    return blob.c.marked_for_deletion_at.is_(None) & (verified | own)


def _is_read(actor: Actor) -> ColumnElement[bool]:
    if Scope.read not in actor.scopes:
        return false()
    return blob.c.id.in_(visible_files(actor).with_only_columns(file.c.blob_id))
