"""Restore one project, mission or file out of a backup into the running instance.

Objects are copied first and compared with their SHA-256 in the store, then the rows of a mission are added in one
transaction, with an entry in the audit log for each. Nothing that exists is overwritten or removed. What is there
already is left out, so that the same command continues after an interruption. Rights come from the present project; a
project that no longer exists returns without grants, so only admins see it.
"""

import asyncio
import uuid
from collections.abc import Callable, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace

from sqlalchemy import TextClause, select, text

from kleinkram.contract.files import BlobState
from kleinkram.contract.metadata import Metadata, MetadataFields
from kleinkram.contract.names import MAX_NAME_CHARACTERS, name_key
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.backup import database as backup_database
from kleinkram.server.backup.errors import BackupConflict
from kleinkram.server.backup.operations import (
    Messages,
    ShowProgress,
    bucket_remote,
    database_errors,
)
from kleinkram.server.backup.rclone import Rclone
from kleinkram.server.backup.repository import DATABASE, Repository, Snapshot
from kleinkram.server.backup.saved_rows import RestoreSelection, SavedFile, SavedMission, SavedProject, SavedRows
from kleinkram.server.blobs.service import enqueue_reading
from kleinkram.server.db import Connection, Database, among, open_database
from kleinkram.server.files.paths import path_conflicts
from kleinkram.server.missions.service import lock_mission, revalidate_missions
from kleinkram.server.recordings.derive import derive_again
from kleinkram.server.settings import Settings, plain_dsn
from kleinkram.server.tables import blob, file, mission, person, project

_BATCH_FILES = 1000
_INTACT = (BlobState.stored.value, BlobState.verified.value)

_INSERT_PROJECT = text(
    "INSERT INTO project (id, name, name_key, description, metadata_fields, licence, citation, created_at,"
    " created_by_id) VALUES (CAST(:id AS uuid), :name, :name_key, :description, CAST(:metadata_fields AS jsonb),"
    " :licence, :citation, CAST(:created_at AS timestamptz), CAST(:created_by_id AS uuid))"
)
_INSERT_MISSION = text(
    "INSERT INTO mission (id, project_id, name, name_key, metadata, metadata_yaml, notes, completed_at, created_at,"
    " created_by_id) VALUES (CAST(:id AS uuid), :project_id, :name, :name_key, CAST(:metadata AS jsonb),"
    " :metadata_yaml, :notes, CAST(:completed_at AS timestamptz), CAST(:created_at AS timestamptz),"
    " CAST(:created_by_id AS uuid))"
)
_INSERT_BLOB = text(
    "INSERT INTO blob (id, store_id, key, size_bytes, sha256, uploaded_by_id, created_at) VALUES (CAST(:blob_id AS"
    " uuid), :store_id, :key, :size_bytes, decode(:sha256, 'hex'), CAST(:blob_uploaded_by_id AS uuid),"
    " CAST(:blob_created_at AS timestamptz))"
)
# Of a blob that was lost or corrupt: its object is there again.
_REVIVE_BLOB = text(
    "UPDATE blob SET state = 'stored', state_reason = NULL, damaged_at = NULL WHERE id = CAST(:blob_id AS uuid)"
)
_INSERT_FILE = text(
    "INSERT INTO file (id, mission_id, blob_id, path, path_key, origin, uploaded_by_id, labels, created_at) VALUES"
    " (CAST(:id AS uuid), :mission_id, CAST(:blob_id AS uuid), :path, :path_key, :origin, CAST(:uploaded_by_id AS"
    " uuid), CAST(:labels AS text[]), CAST(:created_at AS timestamptz))"
)
_REPAIR_FILE = text("UPDATE file SET blob_id = CAST(:blob_id AS uuid) WHERE id = :id")


@dataclass
class SelectiveRestore:
    """What was restored, or with `is_dry_run` would be.

    `files`: new ones; `repaired`: files whose bytes were damaged; `present`: files that need nothing. `renamed`: paths
    that other bytes occupy, with where the file of the backup is now. `unavailable`: what the backup lacks.
    """

    snapshot: Snapshot
    is_dry_run: bool
    created: list[str] = field(default_factory=list)
    files: int = 0
    file_bytes: int = 0
    copied_bytes: int = 0
    repaired: int = 0
    present: int = 0
    renamed: dict[str, str] = field(default_factory=dict)
    unavailable: Messages = field(default_factory=Messages)


@dataclass(frozen=True)
class _Placement:
    """Where a file of the backup goes. `file_id`: an existing file that gets intact bytes; else a new one at `path`."""

    saved: SavedFile
    blob_id: str
    path: str
    file_id: uuid.UUID | None = None


@dataclass
class _MissionPlan:
    """What a mission needs: files to add or repair, blobs to insert or revive, and how many files need nothing.

    `blocked`: files whose blob is marked for deletion, so that its object may vanish at any moment.
    """

    placements: list[_Placement] = field(default_factory=list)
    new_blobs: dict[str, SavedFile] = field(default_factory=dict)
    revived_blobs: dict[str, SavedFile] = field(default_factory=dict)
    blocked: list[SavedFile] = field(default_factory=list)
    present: int = 0

    def objects(self) -> dict[str, SavedFile]:
        """Return the objects that the store needs, by key."""
        return {saved.key: saved for saved in (*self.new_blobs.values(), *self.revived_blobs.values())}


def restore_selection(
    settings: Settings,
    repository: Repository,
    snapshot_id: str | None,
    selection: RestoreSelection,
    show: ShowProgress,
    *,
    is_dry_run: bool,
) -> SelectiveRestore:
    """Restore what is selected, from the latest backup if no id is given.

    Raises:
        BackupError: it is not in the backup, or cannot be added. Missions that were complete stay.
    """
    snapshot = repository.snapshot(snapshot_id)
    backup_database.refuse_unknown_schema(snapshot)
    result = SelectiveRestore(snapshot, is_dry_run)
    dsn = plain_dsn(settings.database_url)
    with (
        database_errors("The database failed ({}): run the same command again. What was restored stays."),
        closing(SavedRows()) as saved,
        # So that no object is deleted that this command compared.
        backup_database.deletion_lock(dsn) as confirm_lock,
    ):
        with repository.read_file(snapshot, DATABASE) as rows:
            saved.load(rows)
        chosen = saved.project(selection.project)
        missions = saved.missions(chosen, selection.mission)
        work = _Restoration(settings, repository, result, show, confirm_lock)
        asyncio.run(work.run(chosen, missions, {one.id: saved.files(one, selection.file) for one in missions}))
    return result


class _Restoration:
    """One command: the instance, the backup, and what was done so far."""

    def __init__(
        self,
        settings: Settings,
        repository: Repository,
        result: SelectiveRestore,
        show: ShowProgress,
        confirm_lock: Callable[[], None],
    ) -> None:
        self._settings = settings
        self._objects = repository.objects
        self._rclone, self._bucket = bucket_remote(repository.rclone, settings)
        self._result, self._show, self._confirm_lock = result, show, confirm_lock

    async def run(
        self, chosen: SavedProject, missions: Sequence[SavedMission], files: dict[str, list[SavedFile]]
    ) -> None:
        """Restore missions one after another."""
        connections = open_database(self._settings, statement_timeout_s=None)
        try:
            async with connections.begin() as db:
                await _require_people(db, chosen, missions, files)
                if not missions:
                    await self._place_project(db, chosen)
            for number, one in enumerate(missions, start=1):
                await self._restore_mission(connections, chosen, one, files[one.id])
                self._show(f"{number} of {len(missions)} missions, {self._result.files} files restored")
        finally:
            await connections.close()

    async def _restore_mission(
        self, connections: Database, chosen: SavedProject, saved: SavedMission, files: list[SavedFile]
    ) -> None:
        available = [one for one in files if self._is_available(one)]
        async with connections.begin() as db:
            mission_id = await self._find_mission(db, saved)
            plan = await self._plan(db, mission_id, available)
        if self._result.is_dry_run:
            self._count(plan, plan.objects().values())
            if mission_id is None:
                await self._name_new(connections, chosen, saved)
            return
        copied, missing = plan.objects().keys(), self._copy_objects(plan)
        async with connections.begin() as db:
            mission_id = await self._place_mission(db, chosen, saved)
            await lock_mission(db, mission_id)
            # Again under the lock: people work meanwhile.
            await self._find_mission(db, saved)
            plan = await self._plan(db, mission_id, [one for one in available if one.key not in missing])
            if plan.objects().keys() - copied:
                raise BackupConflict("Files were deleted or damaged meanwhile: run the same command again.")
            await self._write(db, mission_id, plan)
        self._count(plan, ())

    def _is_available(self, saved: SavedFile) -> bool:
        is_available = saved.store_id == self._result.snapshot.store_id
        if not is_available:
            self._result.unavailable.add(f"{saved.path}: it is in the store {saved.store_id}, which is in no backup")
        return is_available

    # -- planning -----------------------------------------------------------------------------------------------------

    async def _plan(self, db: Connection, mission_id: uuid.UUID | None, files: Sequence[SavedFile]) -> _MissionPlan:
        plan = _MissionPlan()
        for start in range(0, len(files), _BATCH_FILES):
            await self._plan_batch(db, mission_id, files[start : start + _BATCH_FILES], plan)
        return plan

    async def _plan_batch(
        self, db: Connection, mission_id: uuid.UUID | None, files: Sequence[SavedFile], plan: _MissionPlan
    ) -> None:
        blob_ids = await self._choose_blobs(db, files, plan)
        names = {one.path: f"restored {self._result.snapshot.created_at:%Y-%m-%dT%H%M%S}/{one.path}" for one in files}
        existing = await _existing_files(db, mission_id, [*names, *names.values()])
        conflicts = {} if mission_id is None else await path_conflicts(db, mission_id, [*names])
        taken = set((await db.execute(select(file.c.id).where(among(file.c.id, _uuids(files))))).scalars())
        for saved in files:
            saved = saved if uuid.UUID(saved.id) not in taken else saved._replace(id=str(uuid.uuid4()))
            content, path = (saved.size_bytes, saved.sha256), saved.path
            occupant = existing.get(name_key(path))
            if (occupant is not None and occupant.content != content) or path in conflicts:
                path = names[path]
                self._result.renamed[saved.path] = path
                occupant = existing.get(name_key(path))
            if occupant is not None and occupant.content != content:
                raise BackupConflict(f"{saved.path} and {path} exist, with other bytes: rename one of them.")
            if occupant is not None and occupant.is_intact:
                plan.present += 1
            elif (blob_id := blob_ids.get(saved.blob_id)) is None:
                plan.blocked.append(saved)
            else:
                plan.placements.append(_Placement(saved, blob_id, path, occupant.id if occupant else None))

    async def _choose_blobs(self, db: Connection, files: Sequence[SavedFile], plan: _MissionPlan) -> dict[str, str]:
        """Return the blob for each blob of the backup: an intact one with the same bytes, else its own, restored."""
        columns = (blob.c.id, blob.c.size_bytes, blob.c.sha256)
        is_same = among(blob.c.sha256, {bytes.fromhex(one.sha256) for one in files})
        sizes = among(blob.c.size_bytes, {one.size_bytes for one in files})
        is_usable = blob.c.marked_for_deletion_at.is_(None) & (blob.c.store_id == self._settings.store_id)
        stmt = select(*columns).where(is_same, sizes, is_usable, blob.c.state.in_(_INTACT))
        # The lock keeps garbage collection from marking them before the files are there.
        rows = await db.execute(stmt.order_by(blob.c.id).with_for_update(read=True, key_share=True))
        intact = {(row.size_bytes, row.sha256.hex()): str(row.id) for row in rows}
        own = select(blob.c.id, blob.c.marked_for_deletion_at)
        own = own.where(among(blob.c.id, {uuid.UUID(one.blob_id) for one in files}))
        is_marked = {str(row.id): row.marked_for_deletion_at is not None for row in await db.execute(own)}
        chosen: dict[str, str] = {}
        for one in files:
            if intact_id := intact.get((one.size_bytes, one.sha256)):
                chosen[one.blob_id] = intact_id
            elif not is_marked.get(one.blob_id):
                (plan.revived_blobs if one.blob_id in is_marked else plan.new_blobs)[one.blob_id] = one
                chosen[one.blob_id] = one.blob_id
        return chosen

    def _count(self, plan: _MissionPlan, objects: Iterable[SavedFile]) -> None:
        added = [one for one in plan.placements if one.file_id is None]
        self._result.files += len(added)
        self._result.file_bytes += sum(one.saved.size_bytes for one in added)
        self._result.repaired += len(plan.placements) - len(added)
        self._result.present += plan.present
        self._result.copied_bytes += sum(one.size_bytes for one in objects)
        for one in plan.blocked:
            self._result.unavailable.add(f"{one.path}: its bytes are being deleted: run the same command in an hour")

    # -- copying ------------------------------------------------------------------------------------------------------

    def _copy_objects(self, plan: _MissionPlan) -> set[str]:
        """Copy what the store lacks and compare it there; return the keys of objects that could not be restored."""
        failed: set[str] = set()
        objects = [*plan.objects().values()]
        for start in range(0, len(objects), _BATCH_FILES):
            self._confirm_lock()
            batch = {one.key: one for one in objects[start : start + _BATCH_FILES]}
            failed |= _copy_batch(self._rclone, self._objects, self._bucket, batch, self._result)
        return failed

    # -- writing ------------------------------------------------------------------------------------------------------

    async def _find_mission(self, db: Connection, saved: SavedMission) -> uuid.UUID | None:
        """Return the mission if it still exists, wherever it was moved. Raises BackupConflict: it is in the trash."""
        stmt = select(mission.c.id, mission.c.deleted_at, project.c.deleted_at.label("project_deleted_at"))
        row = (await db.execute(stmt.join_from(mission, project).where(mission.c.id == uuid.UUID(saved.id)))).first()
        if row is None:
            return None
        if row.deleted_at is not None or row.project_deleted_at is not None:
            raise _in_trash("mission", saved.name)
        return uuid.UUID(saved.id)

    async def _place_mission(self, db: Connection, chosen: SavedProject, saved: SavedMission) -> uuid.UUID:
        mission_id = await self._find_mission(db, saved)
        if mission_id is not None:
            return mission_id
        project_id = await self._place_project(db, chosen)
        stmt = select(mission.c.id).where(mission.c.project_id == project_id, mission.c.deleted_at.is_(None))
        name = saved.name
        if (await db.execute(stmt.where(mission.c.name_key == name_key(name)))).first() is not None:
            name = self._other_name(name)
        values = {**saved._asdict(), "project_id": project_id, "name": name, "name_key": name_key(name)}
        await db.execute(_INSERT_MISSION, values)
        fields = (await db.execute(select(project.c.metadata_fields).where(project.c.id == project_id))).scalar_one()
        await revalidate_missions(db, project_id, MetadataFields.model_validate(fields))
        mission_id = uuid.UUID(saved.id)
        event = Event("mission.restore", "mission", mission_id, name, project_id, mission_id=mission_id)
        await audit(db, None, _from_backup(event, self._result.snapshot))
        self._result.created.append(f"mission {name}")
        return mission_id

    async def _place_project(self, db: Connection, saved: SavedProject) -> uuid.UUID:
        project_id = uuid.UUID(saved.id)
        row = (await db.execute(select(project.c.deleted_at).where(project.c.id == project_id))).first()
        if row is not None:
            if row.deleted_at is not None:
                raise _in_trash("project", saved.name)
            return project_id
        is_taken = (project.c.name_key == name_key(saved.name)) & project.c.deleted_at.is_(None)
        name = saved.name
        if (await db.execute(select(project.c.id).where(is_taken))).first() is not None:
            name = self._other_name(name)
        self._result.created.append(f"project {name}")
        if not self._result.is_dry_run:
            await db.execute(_INSERT_PROJECT, {**saved._asdict(), "name": name, "name_key": name_key(name)})
            event = Event("project.restore", "project", project_id, name, project_id)
            await audit(db, None, _from_backup(event, self._result.snapshot))
        return project_id

    async def _name_new(self, connections: Database, chosen: SavedProject, saved: SavedMission) -> None:
        """Note for a dry run what would be created."""
        names = self._result.created
        async with connections.begin() as db:
            if not any(name.startswith("project ") for name in names):
                await self._place_project(db, chosen)
        names.append(f"mission {saved.name}")

    def _other_name(self, name: str) -> str:
        suffix = f" (restored {self._result.snapshot.created_at:%Y-%m-%d})"
        return name[: MAX_NAME_CHARACTERS - len(suffix)] + suffix

    async def _write(self, db: Connection, mission_id: uuid.UUID, plan: _MissionPlan) -> None:
        if not plan.placements:
            return
        store = {"store_id": self._settings.store_id}
        await _execute(db, _INSERT_BLOB, [{**one._asdict(), **store} for one in plan.new_blobs.values()])
        await _execute(db, _REVIVE_BLOB, [{"blob_id": one.blob_id} for one in plan.revived_blobs.values()])
        added = [one for one in plan.placements if one.file_id is None]
        rows = [
            {
                **one.saved._asdict(),
                "mission_id": mission_id,
                "blob_id": one.blob_id,
                "path": one.path,
                "path_key": name_key(one.path),
            }
            for one in added
        ]
        await _execute(db, _INSERT_FILE, rows)
        repaired = [{"blob_id": one.blob_id, "id": one.file_id} for one in plan.placements if one.file_id is not None]
        await _execute(db, _REPAIR_FILE, repaired)
        project_id = (await db.execute(select(mission.c.project_id).where(mission.c.id == mission_id))).scalar_one()
        events = [
            _from_backup(_file_event(one, project_id, mission_id), self._result.snapshot) for one in plan.placements
        ]
        await audit(db, None, *events)
        await enqueue_reading(db, [uuid.UUID(one) for one in (*plan.new_blobs, *plan.revived_blobs)])
        await derive_again(db, mission_id)


@dataclass(frozen=True)
class _ExistingFile:
    id: uuid.UUID
    content: tuple[int, str]
    is_intact: bool


async def _existing_files(
    db: Connection, mission_id: uuid.UUID | None, paths: Sequence[str]
) -> dict[str, _ExistingFile]:
    """Return the files of a mission at some paths, by the key of the path."""
    stmt = select(file.c.id, file.c.path_key, blob.c.size_bytes, blob.c.sha256, blob.c.state).join_from(file, blob)
    keys = among(file.c.path_key, [name_key(path) for path in paths])
    rows = await db.execute(stmt.where(file.c.mission_id == mission_id, file.c.deleted_at.is_(None), keys))
    return {
        row.path_key: _ExistingFile(row.id, (row.size_bytes, row.sha256.hex()), row.state in _INTACT) for row in rows
    }


async def _require_people(
    db: Connection, chosen: SavedProject, missions: Iterable[SavedMission], files: dict[str, list[SavedFile]]
) -> None:
    """Require that this instance knows everybody whom the rows name. Raises BackupConflict."""
    ids = {chosen.created_by_id, *(one.created_by_id for one in missions)}
    ids |= {one for rows in files.values() for row in rows for one in (row.uploaded_by_id, row.blob_uploaded_by_id)}
    known = select(person.c.id).where(among(person.c.id, {uuid.UUID(one) for one in ids}))
    if len((await db.execute(known)).all()) < len(ids):
        raise BackupConflict(
            "The backup names people whom this instance does not have, so it is of another instance: restore it whole "
            "into an empty one."
        )


def _copy_batch(
    rclone: Rclone, source: str, bucket: str, batch: dict[str, SavedFile], result: SelectiveRestore
) -> set[str]:
    """Copy objects that the bucket does not have, and remove new copies that differ from what was uploaded."""
    before = rclone.sha256(bucket, [*batch])
    wrong = [key for key, saved in batch.items() if before.get(key) != saved.sha256]
    rclone.copy(source, bucket, wrong)
    hashes = rclone.sha256(bucket, wrong)
    failed = {key for key in wrong if hashes.get(key) != batch[key].sha256}
    rclone.delete(bucket, [*failed - before.keys()])  # damaged bytes of a file of the instance are better than none
    for key in failed:
        result.unavailable.add(f"{batch[key].path}: the backup does not have its bytes, or they were damaged there")
    result.copied_bytes += sum(batch[key].size_bytes for key in wrong if key not in failed)
    return failed


async def _execute(db: Connection, statement: TextClause, rows: Sequence[dict[str, object]]) -> None:
    if rows:
        await db.execute(statement, rows)


def _file_event(placement: _Placement, project_id: uuid.UUID, mission_id: uuid.UUID) -> Event:
    saved = placement.saved
    operation = "file.restore" if placement.file_id is None else "file.repair"
    file_id = placement.file_id or uuid.UUID(saved.id)
    after: Metadata = {"size_bytes": saved.size_bytes, "sha256": saved.sha256}
    return Event(operation, "file", file_id, placement.path, project_id, after=after, mission_id=mission_id)


def _from_backup(event: Event, snapshot: Snapshot) -> Event:
    return replace(event, after={**event.after, "backup": snapshot.id})


def _in_trash(resource_type: str, name: str) -> BackupConflict:
    return BackupConflict(
        f"The {resource_type} {name}, or its project, is in the trash: restore it from there (`klein trash restore`), "
        "then run the same command again for what it lacks."
    )


def _uuids(files: Iterable[SavedFile]) -> set[uuid.UUID]:
    return {uuid.UUID(one.id) for one in files}
