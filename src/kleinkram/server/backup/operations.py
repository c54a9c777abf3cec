"""Create, verify, prune and restore backups.

Create blocks deletion, dumps the database at one moment, then copies the objects it names: each still exists. The
document that makes it a backup is written last. Restore fills an empty instance: objects first, then the database in
one transaction, so that an unfinished restore shows nothing. Both continue where an interrupted one stopped.
"""

import json
import secrets
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field
from datetime import datetime, timezone
from functools import partial

import psycopg
from sqlalchemy.exc import SQLAlchemyError

import kleinkram
from kleinkram.contract.errors import DatabaseUnavailable
from kleinkram.contract.units import format_size
from kleinkram.server.backup import database
from kleinkram.server.backup.database import RestoreTarget, UnavailableObject
from kleinkram.server.backup.errors import (
    BackupConflict,
    BackupDamaged,
    BackupNotFound,
    BackupRequestInvalid,
    BackupUnreachable,
)
from kleinkram.server.backup.objects import (
    IS_NAMED,
    IS_NAMED_AND_STORED,
    IS_PENDING,
    IS_UNUSED,
    BackupObject,
    ObjectIndex,
)
from kleinkram.server.backup.rclone import Rclone, S3Access
from kleinkram.server.backup.repository import DATABASE, OBJECT_LIST, Repository, Snapshot, complete_ids, write_objects
from kleinkram.server.settings import Settings, plain_dsn

ShowProgress = Callable[[str], None]
_MAX_MESSAGES = 1000
_NOTE = ".kleinkram-restore"


@dataclass
class Messages:
    """Messages about what is wrong: all are counted, and the first 1000 kept."""

    count: int = 0
    first: list[str] = field(default_factory=list)

    def add(self, message: str) -> None:
        """Add one."""
        self.count += 1
        if len(self.first) < _MAX_MESSAGES:
            self.first.append(message)


@dataclass
class ObjectTotals:
    """Number and size of objects."""

    count: int = 0
    bytes: int = 0

    def add(self, objects: Collection[BackupObject]) -> None:
        """Add objects."""
        self.count += len(objects)
        self.bytes += sum(row.bytes for row in objects)


@dataclass(frozen=True)
class CreatedBackup:
    """A new backup, what was copied for it, and which objects the store lost or altered."""

    snapshot: Snapshot
    copied: ObjectTotals
    problems: Messages


@dataclass
class Verification:
    """Result of verifying a backup. `unused`: objects of no complete backup; `lost_at_source`: missing before it."""

    snapshots: int = 0
    objects: int = 0
    object_bytes: int = 0
    read_bytes: int = 0
    unused: int = 0
    unused_bytes: int = 0
    lost_at_source: int = 0
    damage: Messages = field(default_factory=Messages)


@dataclass(frozen=True)
class Pruned:
    """Which backups were removed, which remain, and how many objects were removed."""

    removed: tuple[str, ...]
    remaining: tuple[str, ...]
    removed_objects: int
    removed_bytes: int


@dataclass
class Restored:
    """A restored backup. `sent`: objects that were not there from an earlier try."""

    snapshot: Snapshot
    sent: int = 0
    unavailable: list[UnavailableObject] = field(default_factory=list)


# -- create -----------------------------------------------------------------------------------------------------------


def create(settings: Settings, repository: Repository, show: ShowProgress) -> CreatedBackup:
    """Make a backup of the instance that the settings name.

    Raises:
        BackupError: it could not be made; what was copied stays for the next one.
    """
    dsn, store_id = plain_dsn(settings.migration_database_url or settings.database_url), settings.store_id
    with (
        database_errors("The database failed ({}): run the same command again. What was copied stays."),
        repository.locked() as confirm_lock,
        database.deletion_lock(dsn) as confirm_deletion_lock,
        closing(ObjectIndex()) as index,
    ):
        repository.confirm_marker()
        repository.remove_unfinished()
        created_at = datetime.now(timezone.utc)
        # Ids sort by time, also those of one second.
        snapshot_id = f"{created_at:%Y%m%dT%H%M%S%fZ}-{secrets.token_hex(3)}"
        with database.read_snapshot(dsn) as connection:
            facts = database.database_facts(connection, store_id)
            index.put("key, size_bytes, expected", database.named_objects(connection, store_id))
            dump = partial(database.dump_tables, connection, facts.tables)
            dumped, rows = repository.add_file(snapshot_id, DATABASE, dump)
            sequences = database.dump_sequences(connection)
        copied = _copy_objects(settings, repository, index, confirm_deletion_lock, show)
        problems = _find_problems(index, dsn)
        object_list, _ = repository.add_file(snapshot_id, OBJECT_LIST, partial(write_objects, index.select(IS_NAMED)))
        objects, object_bytes = index.totals("size_bytes")
        corrupt, _ = index.totals("CASE WHEN problem = 'corrupt' THEN size_bytes END")
        confirm_deletion_lock()
        confirm_lock()
        snapshot = Snapshot(
            id=snapshot_id,
            created_at=created_at,
            kleinkram=kleinkram.__version__,
            revision=facts.revision,
            store_id=store_id,
            elsewhere=facts.elsewhere,
            rows=rows,
            sequences=sequences,
            files={DATABASE: dumped, OBJECT_LIST: object_list},
            objects=objects,
            object_bytes=object_bytes,
            lost=problems.count - corrupt,
            corrupt=corrupt,
        )
        repository.add_snapshot(snapshot)
    return CreatedBackup(snapshot, copied, problems)


def record_attempt(settings: Settings, started_at: datetime, snapshot: Snapshot | None) -> None:
    """Record a backup, or with None an attempt that failed, for the metrics and the health of the instance.

    Raises:
        BackupUnreachable: the database is away, its schema is older, or the role may only read.
    """
    dsn = plain_dsn(settings.migration_database_url or settings.database_url)
    snapshot_id, damaged = (None, 0) if snapshot is None else (snapshot.id, snapshot.lost + snapshot.corrupt)
    with database_errors("{}"):
        database.record_attempt(dsn, started_at, snapshot_id, damaged)


def _copy_objects(
    settings: Settings,
    repository: Repository,
    index: ObjectIndex,
    confirm_deletion_lock: Callable[[], None],
    show: ShowProgress,
) -> ObjectTotals:
    """Copy what the location lacks, and read what no earlier backup verified."""
    rclone, bucket = bucket_remote(repository.rclone, settings)
    _index_stored(index, rclone, repository.objects)
    for snapshot_id in reversed(repository.snapshot_ids()):  # the latest that can be read
        with suppress(BackupDamaged, BackupNotFound):
            verified = repository.objects_of(repository.snapshot(snapshot_id))
            index.put("key, sha256, problem", ((row.key, row.sha256, row.problem) for row in verified))
            break
    copied, done, total = ObjectTotals(), ObjectTotals(), ObjectTotals(*index.totals("size_bytes"))
    for batch in index.batches(IS_PENDING):
        confirm_deletion_lock()
        hashes, failures = _copy_batch(rclone, bucket, repository, batch)
        for row in batch:
            sha256, problem = hashes.get(row.key), None
            if sha256 is None:
                problem = "unreadable" if row.key in failures else "lost"
            elif not row.matches(sha256):
                problem = "corrupt"
            index.put("key, sha256, problem", [(row.key, sha256, problem)])
        copied.add([row for row in batch if row.key in hashes and not row.is_complete])
        _show_progress(show, done, batch, total)
    return copied


def _copy_batch(
    rclone: Rclone, bucket: str, repository: Repository, batch: list[BackupObject]
) -> tuple[dict[str, str], dict[str, str]]:
    """Copy and read objects, again where they differ; return SHA-256 by key, and why copying failed, by key.

    In a folder, what was written is read; for a remote location, what the store sends.
    """
    source = bucket if repository.folder is None else repository.objects
    to_copy, to_read = [row.key for row in batch if not row.is_complete], [row.key for row in batch]
    failures = rclone.copy(bucket, repository.objects, to_copy)
    hashes = rclone.sha256(source, [key for key in to_read if key not in failures])
    again = [row.key for row in batch if not row.matches(hashes.get(row.key))]
    if again:
        failures = rclone.copy(bucket, repository.objects, again)
        for key in again:
            hashes.pop(key, None)
        hashes |= rclone.sha256(source, [key for key in again if key not in failures])
    return hashes, failures


def _find_problems(index: ObjectIndex, dsn: str) -> Messages:
    """Return what the store lost or altered; remove log chunks that were deleted since the moment of the backup."""
    lost_chunks = [row.key for row in index.select(f"{IS_NAMED} AND expected IS NULL AND sha256 IS NULL")]
    if lost_chunks:
        index.remove(database.missing_log_chunks(dsn, lost_chunks))
    problems = Messages()
    for row in index.select(f"{IS_NAMED} AND problem IS NOT NULL"):
        problems.add(f"{row.key}: {row.problem}")
    return problems


# -- verify and prune -------------------------------------------------------------------------------------------------


def verify(repository: Repository, snapshot_id: str | None, show: ShowProgress, *, read_all: bool) -> Verification:
    """Check backups, all if no id is given: names and sizes, or with `read_all` every byte.

    Raises:
        BackupError: there are none, or they cannot be opened. Damage is returned, not raised.
    """
    result = Verification()
    rclone = repository.rclone
    with closing(ObjectIndex()) as index:
        sizes = repository.file_sizes()
        ids = [snapshot_id] if snapshot_id else complete_ids(sizes)
        _index_stored(index, rclone, repository.objects)
        result.objects, result.object_bytes = index.totals("stored_bytes")
        for checked_id in ids:
            result.snapshots += 1
            damage = _check_snapshot(repository, checked_id, sizes, index, result, read_all=read_all)
            if damage and (snapshot_id or checked_id in repository.snapshot_ids()):  # else it was pruned since
                for message in damage:
                    result.damage.add(f"In the backup {checked_id}, {message}.")
        done, total = ObjectTotals(), ObjectTotals(*index.totals("size_bytes"))
        for batch in index.batches(IS_NAMED_AND_STORED) if read_all else ():
            hashes = rclone.sha256(repository.objects, [row.key for row in batch])
            for row in batch:
                if hashes.get(row.key) != row.sha256:
                    result.damage.add(f"objects/{row.key} was changed or cut off.")
            _show_progress(show, done, batch, total)
        result.read_bytes = done.bytes
        if snapshot_id is None:
            unused = [row.bytes for row in index.select(IS_UNUSED)]
            result.unused, result.unused_bytes = len(unused), sum(unused)
    return result


def _check_snapshot(
    repository: Repository,
    snapshot_id: str,
    sizes: Mapping[str, int],
    index: ObjectIndex,
    result: Verification,
    *,
    read_all: bool,
) -> list[str]:
    """Return what one backup lacks, and add the objects it names to the index."""
    damage: list[str] = []

    def check(rows: Iterable[BackupObject]) -> Iterator[tuple[object, ...]]:
        for row in rows:
            if row.sha256 is None:
                result.lost_at_source += 1
                continue
            stored_bytes = index.stored_size(row.key)
            if stored_bytes is None:
                damage.append(f"objects/{row.key} is missing")
            elif stored_bytes != row.size_bytes and row.problem is None:
                damage.append(f"objects/{row.key} has {stored_bytes} bytes instead of {row.size_bytes}")
            yield row.key, row.size_bytes, row.sha256

    try:
        snapshot = repository.snapshot(snapshot_id)
        for name, stored in snapshot.files.items():
            path = f"{snapshot_id}/{name}"
            if sizes.get(path) != stored.size_bytes:
                raise BackupDamaged(f"snapshots/{path} has {sizes.get(path, 0)} bytes instead of {stored.size_bytes}.")
        if read_all:
            with repository.read_file(snapshot, DATABASE):
                pass
        index.put("key, size_bytes, sha256", check(repository.objects_of(snapshot)))
    except BackupDamaged as error:
        damage.append(f"which cannot be restored: {str(error).rstrip('.')}")
    return damage


def prune(repository: Repository, *, keep: int) -> Pruned:
    """Keep the latest backups and remove the others, then all objects that no backup names.

    Raises:
        BackupRequestInvalid: none is to be kept.
        BackupConflict: another process writes there.
        BackupDamaged: a backup that is kept cannot be read, so that its objects are unknown; nothing was removed.
    """
    if keep < 1:
        raise BackupRequestInvalid("--keep must be at least 1: remove the folder itself if you want no backup.")
    rclone = repository.rclone
    with repository.locked() as confirm_lock, closing(ObjectIndex()) as index:
        ids = repository.snapshot_ids()
        old, remaining = ids[:-keep], ids[-keep:]
        _index_stored(index, rclone, repository.objects)
        for snapshot_id in remaining:
            try:
                rows = repository.objects_of(repository.snapshot(snapshot_id))
                index.put("key, size_bytes", ((row.key, row.size_bytes) for row in rows))
            except BackupDamaged as error:  # noqa: PERF203  (there are few)
                raise BackupDamaged(f"Nothing was removed: the backup {snapshot_id} cannot be read ({error})") from None
        # Documents first: where this ends in between, no document names an object that is gone.
        confirm_lock()
        rclone.delete(repository.snapshots, [f"{snapshot_id}.json" for snapshot_id in old])
        repository.remove_unfinished()
        removed = ObjectTotals()
        for batch in index.batches(IS_UNUSED):
            confirm_lock()
            rclone.delete(repository.objects, [row.key for row in batch])
            removed.add(batch)
    return Pruned(tuple(old), tuple(remaining), removed.count, removed.bytes)


# -- restore ----------------------------------------------------------------------------------------------------------


def restore(settings: Settings, repository: Repository, snapshot_id: str | None, show: ShowProgress) -> Restored:
    """Fill the empty instance that the settings name, from the latest backup if no id is given.

    Raises:
        BackupError: it failed; the instance is still empty, and the same command continues.
    """
    if settings.migration_database_url is None:
        raise BackupRequestInvalid(
            "Restoring makes the schema: set KLEINKRAM_MIGRATION_DATABASE_URL, as for `migrate`."
        )
    target = RestoreTarget(plain_dsn(settings.migration_database_url), settings.serving_role, settings.store_id)
    snapshot = repository.snapshot(snapshot_id)
    database.refuse_unknown_schema(snapshot)
    rclone, bucket = bucket_remote(repository.rclone, settings)
    with database_errors("The database refused the backup ({}): the instance is still empty."):
        is_continued = _mark_target(rclone, bucket, settings.s3_bucket, snapshot)
        earlier = database.restored_from(target)
        if earlier is not None and (earlier != snapshot.id or not is_continued):
            raise BackupConflict(
                f"The database was restored from the backup {earlier} before: restore into an empty one."
            )
        restored = _restore_objects(rclone, bucket, repository, snapshot, show)
        if snapshot.id not in repository.snapshot_ids():
            raise BackupNotFound(
                f"The backup {snapshot.id} was removed during the restore: restore another one into an empty bucket."
            )
        if earlier is None:
            with repository.read_file(snapshot, DATABASE) as file:
                database.load_database(target, snapshot, file, restored.unavailable)
    rclone.delete(bucket, [_NOTE])
    return restored


def _mark_target(rclone: Rclone, bucket: str, bucket_name: str, snapshot: Snapshot) -> bool:
    """Note in the bucket what is being restored; return whether an earlier try noted the same.

    Raises:
        BackupConflict: the bucket contains something else.
    """
    with suppress(FileNotFoundError):
        noted = json.loads(rclone.read(f"{bucket}/{_NOTE}"))["snapshot"]
        if noted != snapshot.id:
            raise BackupConflict(
                f"A restore of the backup {noted} into {bucket_name} was not finished: continue that one (--snapshot), "
                "or name an empty instance."
            )
        return True
    for file in rclone.files(bucket):
        raise BackupConflict(
            f"{bucket_name} is not empty ({file.path} is there): a backup is restored into an empty one."
        )
    rclone.write(f"{bucket}/{_NOTE}", json.dumps({"snapshot": snapshot.id}).encode())
    return False


def _restore_objects(
    rclone: Rclone, bucket: str, repository: Repository, snapshot: Snapshot, show: ShowProgress
) -> Restored:
    """Copy objects into the bucket, and read them there; those that differ from the backup are removed."""
    restored = Restored(snapshot)
    done, total = ObjectTotals(), ObjectTotals(snapshot.objects, snapshot.object_bytes)
    with closing(ObjectIndex()) as index:
        _index_stored(index, rclone, bucket)
        # Objects that this backup lacks may be in the location from an earlier or later one.
        rows = repository.objects_of(snapshot)
        index.put(
            "key, size_bytes, expected, problem",
            ((row.key, row.size_bytes, row.sha256 or row.expected, row.problem) for row in rows),
        )
        for batch in index.batches(IS_NAMED):
            rclone.copy(repository.objects, bucket, [row.key for row in batch if not row.is_complete])
            hashes = rclone.sha256(bucket, [row.key for row in batch])
            damaged: list[str] = []
            for row in batch:
                sha256 = hashes.get(row.key)
                restored.sent += not row.is_complete and sha256 is not None
                if row.matches(sha256) and row.problem == "corrupt":
                    reason = "it was corrupt when it was backed up, and restored as it was"
                    restored.unavailable.append(UnavailableObject(row.key, "corrupt", reason))
                elif not row.matches(sha256):
                    if sha256 is not None:
                        damaged.append(row.key)
                    reason = "the backup it was restored from was damaged" if sha256 else "no backup contains its bytes"
                    restored.unavailable.append(UnavailableObject(row.key, "lost", reason))
            rclone.delete(bucket, damaged)
            _show_progress(show, done, batch, total)
    return restored


# -- shared -----------------------------------------------------------------------------------------------------------


@contextmanager
def database_errors(sentence: str) -> Iterator[None]:
    """Raise BackupUnreachable with a sentence, which has a place for the reason, when the database fails."""
    try:
        yield
    except (psycopg.Error, SQLAlchemyError, DatabaseUnavailable) as error:
        raise BackupUnreachable(sentence.format(database.first_line(error))) from error


def _index_stored(index: ObjectIndex, rclone: Rclone, remote: str) -> None:
    index.put("key, stored_bytes", ((file.path, file.size_bytes) for file in rclone.files(remote)))


def bucket_remote(rclone: Rclone, settings: Settings) -> tuple[Rclone, str]:
    """Return rclone with the instance's bucket as a remote, and that remote."""
    secret_key = settings.s3_secret_key.get_secret_value()
    access = S3Access(
        settings.s3_internal_url, settings.s3_region, settings.s3_access_key, secret_key, settings.s3_ca_file
    )
    return rclone.with_s3("kleinsite", access), f"kleinsite:{settings.s3_bucket}"


def _show_progress(show: ShowProgress, done: ObjectTotals, batch: list[BackupObject], total: ObjectTotals) -> None:
    done.add(batch)
    show(f"{done.count} of {total.count} objects, {format_size(done.bytes)} of {format_size(total.bytes)}")
