"""Create, verify, prune and restore backups.

Create blocks deletion, dumps the database at one moment, then copies the objects it names: each is still there. The
document that makes it a backup is written last. Restore fills an empty instance: objects first, then the database in
one transaction, so that an unfinished restore shows nothing. Both continue where an interrupted one stopped.
"""

import json
import secrets
import sys
import time
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import closing, suppress
from dataclasses import dataclass, field
from datetime import datetime, timezone

import psycopg
from sqlalchemy.exc import SQLAlchemyError

import kleinkram
from kleinkram.server.backup import database
from kleinkram.server.backup.database import DeletionLock, RestoreTarget, UnavailableObject
from kleinkram.server.backup.errors import (
    BackupConflict,
    BackupDamaged,
    BackupNotFound,
    BackupRequestInvalid,
    BackupUnreachable,
    first_line,
)
from kleinkram.server.backup.objects import NamedObject, ObjectEntry, ObjectIndex, in_batches
from kleinkram.server.backup.rclone import Rclone, s3_remote
from kleinkram.server.backup.repository import (
    Repository,
    Snapshot,
    make_repository,
    open_repository,
)
from kleinkram.server.settings import Settings, plain_dsn

_MOST_MESSAGES = 1000
_NOTE = ".kleinkram-restore"
_TERMINAL_EVERY_S, _ELSEWHERE_EVERY_S = 0.5, 30.0


@dataclass(frozen=True)
class BackupOptions:
    """Options of all backup commands. `quiet`: no progress on stderr."""

    place: str
    passphrase: str | None = None
    rclone: Rclone = field(default_factory=Rclone)
    quiet: bool = False


@dataclass
class Messages:
    """Messages about what is wrong: all are counted, and some are kept."""

    count: int = 0
    first: list[str] = field(default_factory=list)

    def add(self, message: str) -> None:
        """Add one."""
        self.count += 1
        if len(self.first) < _MOST_MESSAGES:
            self.first.append(message)


@dataclass(frozen=True)
class CreatedBackup:
    """A new backup, and what was copied for it."""

    snapshot: Snapshot
    copied: int
    copied_bytes: int
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
    objects: int = 0
    object_bytes: int = 0
    sent: int = 0
    unavailable: list[UnavailableObject] = field(default_factory=list)


class ProgressLine:
    """One line about progress on stderr, written over on a terminal."""

    def __init__(self, what: str, *, quiet: bool) -> None:
        self._what, self._quiet = what, quiet
        self._is_terminal = sys.stderr.isatty()
        self._next = 0.0
        self.total = (0, 0)
        self._done = self._done_bytes = 0

    def add(self, batch: Collection[NamedObject]) -> None:
        """Count a finished batch, and show the sum unless that was a moment ago."""
        self._done += len(batch)
        self._done_bytes += sum(named.size_bytes for named in batch)
        now = time.monotonic()
        if self._quiet or now < self._next:
            return
        self._next = now + (_TERMINAL_EVERY_S if self._is_terminal else _ELSEWHERE_EVERY_S)
        count, size_bytes = self.total
        line = f"{self._what}: {self._done} of {count} objects, {amount(self._done_bytes)} of {amount(size_bytes)}"
        sys.stderr.write(f"\r\033[K{line}" if self._is_terminal else f"{line}\n")
        sys.stderr.flush()

    def close(self) -> None:
        """Clear the line."""
        if self._is_terminal and not self._quiet:
            sys.stderr.write("\r\033[K")


def create(settings: Settings, options: BackupOptions, *, encrypt: bool = False) -> CreatedBackup:
    """Make a backup of the instance that the settings name.

    Raises:
        BackupError: it could not be made; what was copied stays for the next one.
    """
    with closing(ProgressLine("backup", quiet=options.quiet)) as progress, closing(ObjectIndex()) as index:
        repository = make_repository(options.place, options.passphrase, options.rclone, encrypt=encrypt)
        dsn = plain_dsn(settings.migration_database_url or settings.database_url)
        try:
            with repository.locked() as confirm_lock, database.deletion_lock(dsn) as deletion:
                repository.confirm_marker()
                repository.remove_unfinished()
                return _Creation(settings, repository, index, progress, dsn).run(confirm_lock, deletion)
        except psycopg.Error as error:
            raise BackupUnreachable(
                f"The database failed ({first_line(error)}): run the same command again. What was copied stays."
            ) from error


class _Creation:
    """One backup that is being made."""

    def __init__(
        self, settings: Settings, repository: Repository, index: ObjectIndex, progress: ProgressLine, dsn: str
    ) -> None:
        self._settings = settings
        self._repository = repository
        self._rclone, self._site = _with_site(repository.rclone, settings)
        self._index = index
        self._progress = progress
        self._dsn = dsn
        self._copied = self._copied_bytes = 0

    def run(self, confirm_lock: Callable[[], None], deletion: DeletionLock) -> CreatedBackup:
        """Make it."""
        created_at = datetime.now(timezone.utc)
        # Ids sort by time, also those of one second.
        snapshot_id = f"{created_at:%Y%m%dT%H%M%S%fZ}-{secrets.token_hex(3)}"
        repository, index = self._repository, self._index
        with database.read_snapshot(self._dsn) as connection:
            facts = database.database_facts(connection, self._settings.store_id)
            index.add_named(database.named_objects(connection, self._settings.store_id))
            with repository.write_packed(snapshot_id, "database.zst") as file:
                tables = [
                    database.dump_table(connection, name, columns, file) for name, columns in facts.tables.items()
                ]
                dumped = file.end()
            sequences = database.dump_sequences(connection)
        index.add_stored(repository.rclone.files(repository.objects))
        self._add_verified()
        self._progress.total = index.totals()
        for batch in index.pending_batches():
            deletion.confirm()
            self._copy(batch)
        lost, corrupt, problems = self._problems()
        with repository.write_packed(snapshot_id, "objects.zst") as file:
            for entry in index.entries():
                file.write(json.dumps(entry).encode() + b"\n")
            object_list = file.end()
        objects, object_bytes = index.totals()
        deletion.confirm()
        confirm_lock()
        snapshot = Snapshot(
            id=snapshot_id,
            created_at=created_at,
            ended_at=datetime.now(timezone.utc),
            kleinkram=kleinkram.__version__,
            postgres=facts.postgres,
            revision=facts.revision,
            store_id=self._settings.store_id,
            elsewhere=facts.elsewhere,
            tables=tuple(tables),
            sequences=sequences,
            database=dumped,
            object_list=object_list,
            objects=objects,
            object_bytes=object_bytes,
            lost=lost,
            corrupt=corrupt,
        )
        repository.add_snapshot(snapshot)
        return CreatedBackup(snapshot, self._copied, self._copied_bytes, problems)

    def _add_verified(self) -> None:
        """Add the objects that the latest readable backup verified."""
        for snapshot_id in reversed(self._repository.snapshot_ids()):
            with suppress(BackupDamaged, BackupNotFound):
                self._index.add_verified(self._repository.entries(self._repository.snapshot(snapshot_id)))
                return

    def _copy(self, batch: list[NamedObject]) -> None:
        """Copy what the location lacks, and compare all with their SHA-256; once more where they differ."""
        hashes, failures = self._copy_and_read(batch, [named.key for named in batch if not named.is_stored])
        again = [named for named in batch if not _is_right(named, hashes.get(named.key))]
        if again:
            new_hashes, failures = self._copy_and_read(again, [named.key for named in again])
            hashes = {key: sha256 for key, sha256 in hashes.items() if key not in {named.key for named in again}}
            hashes |= new_hashes
        entries = []
        for named in batch:
            sha256, problem = hashes.get(named.key), None
            if sha256 is None:
                problem = "unreadable" if named.key in failures else "lost"
            elif not _is_right(named, sha256):
                problem = "corrupt"
            entries.append(ObjectEntry(named.key, named.size_bytes, sha256, named.sha256, problem))
        self._index.add_verified(entries)
        copied = [named for named in batch if not named.is_stored and named.key in hashes]
        self._copied += len(copied)
        self._copied_bytes += sum(named.size_bytes for named in copied)
        self._progress.add(batch)

    def _copy_and_read(self, objects: list[NamedObject], to_copy: list[str]) -> tuple[dict[str, str], dict[str, str]]:
        """Return the SHA-256 of objects by key, and why copying some failed.

        In a folder, what was written is read; for a remote location, what the store sends.
        """
        failures = self._rclone.copy(self._site, self._repository.objects, to_copy)
        source = self._repository.objects if self._repository.folder is not None else self._site
        return self._rclone.sha256(source, [named.key for named in objects if named.key not in failures]), failures

    def _problems(self) -> tuple[int, int, Messages]:
        """Count what the store lost or altered; forget chunks of logs that were deleted since the moment."""
        lost_chunks = [entry.key for entry in self._index.entries() if entry.expected is None and entry.sha256 is None]
        if lost_chunks:
            self._index.remove_named(database.missing_log_chunks(self._dsn, lost_chunks))
        lost = corrupt = 0
        problems = Messages()
        for entry in self._index.entries():
            if entry.problem is not None:
                lost += entry.problem != "corrupt"
                corrupt += entry.problem == "corrupt"
                problems.add(f"{entry.key}: {entry.problem}")
        return lost, corrupt, problems


def _is_right(named: NamedObject, sha256: str | None) -> bool:
    return sha256 is not None and named.sha256 in (None, sha256)


def verify(options: BackupOptions, snapshot_id: str | None, *, read_all: bool) -> Verification:
    """Check backups, all if no id is given: names and sizes, or with `read_all` every byte.

    Raises:
        BackupError: there are none, or they cannot be opened. Damage is returned, not raised.
    """
    result = Verification()
    with closing(ProgressLine("verify", quiet=options.quiet)) as progress, closing(ObjectIndex()) as index:
        repository = open_repository(options.place, options.passphrase, options.rclone)
        ids = [snapshot_id] if snapshot_id else repository.snapshot_ids()
        index.add_stored(repository.rclone.files(repository.objects))
        result.objects, result.object_bytes = index.stored_totals()
        for each_id in ids:
            result.snapshots += 1
            damage = _damage_of(repository, each_id, index, result, read_all=read_all)
            if damage and (snapshot_id or each_id in repository.snapshot_ids()):  # else it was pruned meanwhile
                for message in damage:
                    result.damage.add(f"In the backup {each_id}, {message}.")
        if read_all:
            progress.total = index.totals()
            for batch in index.stored_batches():
                hashes = repository.rclone.sha256(repository.objects, [named.key for named in batch])
                for named in batch:
                    if hashes.get(named.key) != named.sha256:
                        result.damage.add(f"objects/{named.key} was changed or cut off.")
                result.read_bytes += sum(named.size_bytes for named in batch)
                progress.add(batch)
        if snapshot_id is None:
            unused = [stored.size_bytes for stored in index.unnamed_stored()]
            result.unused, result.unused_bytes = len(unused), sum(unused)
    return result


def _damage_of(
    repository: Repository, snapshot_id: str, index: ObjectIndex, result: Verification, *, read_all: bool
) -> list[str]:
    """Return what one backup lacks, and add the objects it names to the index."""
    damage: list[str] = []
    try:
        snapshot = repository.snapshot(snapshot_id)
        repository.check_sizes(snapshot)
        if read_all:
            repository.check_files(snapshot)
        index.add_named(_check_entries(repository.entries(snapshot), index, result, damage))
    except BackupDamaged as error:
        damage.append(f"which cannot be restored: {str(error).rstrip('.')}")
    return damage


def _check_entries(
    entries: Iterable[ObjectEntry], index: ObjectIndex, result: Verification, damage: list[str]
) -> Iterator[NamedObject]:
    for entry in entries:
        if entry.sha256 is None:
            result.lost_at_source += 1
            continue
        size_bytes = index.stored_size(entry.key)
        if size_bytes is None:
            damage.append(f"objects/{entry.key} is missing")
        elif size_bytes != entry.size_bytes and entry.problem is None:
            damage.append(f"objects/{entry.key} has {size_bytes} bytes instead of {entry.size_bytes}")
        yield NamedObject(entry.key, entry.size_bytes, entry.sha256)


def prune(options: BackupOptions, *, keep: int) -> Pruned:
    """Keep the latest backups and remove the others, then all objects that no backup names.

    Raises:
        BackupRequestInvalid: none is to be kept.
        BackupConflict: another process writes there.
        BackupDamaged: a backup that is kept cannot be read, so that its objects are unknown; nothing was removed.
    """
    if keep < 1:
        raise BackupRequestInvalid("--keep must be at least 1: remove the folder itself if you want no backup.")
    repository = open_repository(options.place, options.passphrase, options.rclone)
    with repository.locked() as confirm_lock, closing(ObjectIndex()) as index:
        ids = repository.snapshot_ids()
        old, remaining = ids[:-keep], ids[-keep:]
        index.add_stored(repository.rclone.files(repository.objects))
        for snapshot_id in remaining:
            try:
                entries = repository.entries(repository.snapshot(snapshot_id))
                index.add_named(NamedObject(entry.key, entry.size_bytes, entry.sha256) for entry in entries)
            except BackupDamaged as error:  # noqa: PERF203  (there are few)
                raise BackupDamaged(f"Nothing was removed: the backup {snapshot_id} cannot be read ({error})") from None
        # Documents first: where this ends in between, no document names an object that is gone.
        confirm_lock()
        repository.rclone.delete(repository.snapshots, [f"{snapshot_id}.json" for snapshot_id in old])
        repository.remove_unfinished()
        removed = removed_bytes = 0
        for batch in in_batches(NamedObject(*stored, None) for stored in index.unnamed_stored()):
            confirm_lock()
            repository.rclone.delete(repository.objects, [stored.key for stored in batch])
            removed += len(batch)
            removed_bytes += sum(stored.size_bytes for stored in batch)
    return Pruned(tuple(old), tuple(remaining), removed, removed_bytes)


def restore(settings: Settings, options: BackupOptions, snapshot_id: str | None) -> Restored:
    """Fill the empty instance that the settings name, from the latest backup if no id is given.

    Raises:
        BackupError: it failed; the instance is still empty, and the same command continues.
    """
    if settings.migration_database_url is None:
        raise BackupRequestInvalid(
            "Restoring makes the schema: set KLEINKRAM_MIGRATION_DATABASE_URL, as for `migrate`."
        )
    target = RestoreTarget(plain_dsn(settings.migration_database_url), settings.serving_role, settings.store_id)
    with closing(ProgressLine("restore", quiet=options.quiet)) as progress:
        repository = open_repository(options.place, options.passphrase, options.rclone)
        snapshot = repository.snapshot(snapshot_id)
        database.refuse_unknown_schema(snapshot)
        try:
            return _restore(settings, repository, snapshot, target, progress)
        except (psycopg.Error, SQLAlchemyError) as error:
            raise BackupUnreachable(
                f"The database refused the backup ({first_line(error)}): the instance is still empty."
            ) from error


def _restore(
    settings: Settings, repository: Repository, snapshot: Snapshot, target: RestoreTarget, progress: ProgressLine
) -> Restored:
    rclone, site = _with_site(repository.rclone, settings)
    is_continued = _mark_target(rclone, site, settings.s3_bucket, snapshot)
    earlier = database.restored_from(target)
    if earlier is not None and (earlier != snapshot.id or not is_continued):
        raise BackupConflict(f"The database was restored from the backup {earlier} before: restore into an empty one.")
    restored = Restored(snapshot, objects=snapshot.objects, object_bytes=snapshot.object_bytes)
    progress.total = (snapshot.objects, snapshot.object_bytes)
    with closing(ObjectIndex()) as index:
        index.add_stored(rclone.files(site) if is_continued else [])
        problems: dict[str, ObjectEntry] = {}

        def named() -> Iterator[NamedObject]:
            for entry in repository.entries(snapshot):
                if entry.problem is not None:
                    problems[entry.key] = entry
                # What this backup lacks, an earlier or a later one may have copied.
                yield NamedObject(entry.key, entry.size_bytes, entry.sha256 or entry.expected)

        index.add_named(named())
        for batch in index.pending_batches():
            _restore_batch(batch, rclone, repository.objects, site, restored, problems)
            progress.add(batch)
    if snapshot.id not in repository.snapshot_ids():
        raise BackupNotFound(
            f"The backup {snapshot.id} was removed meanwhile: restore another one into an empty bucket."
        )
    if earlier is None:
        database.load_database(
            target,
            snapshot,
            lambda: repository.read_packed(snapshot.id, "database.zst"),
            restored.unavailable,
        )
    rclone.delete(site, [_NOTE])
    return restored


def _restore_batch(
    batch: list[NamedObject],
    rclone: Rclone,
    source: str,
    site: str,
    restored: Restored,
    problems: dict[str, ObjectEntry],
) -> None:
    """Put objects into the bucket, and read them there."""
    rclone.copy(source, site, [named.key for named in batch if not named.is_stored])
    hashes = rclone.sha256(site, [named.key for named in batch])
    damaged: list[str] = []
    for named in batch:
        sha256, entry = hashes.get(named.key), problems.get(named.key)
        restored.sent += not named.is_stored and sha256 is not None
        if _is_right(named, sha256):
            if entry is not None and entry.problem == "corrupt":
                reason = "it was corrupt when it was backed up, and restored as it was"
                restored.unavailable.append(UnavailableObject(named.key, "corrupt", reason))
            continue
        if sha256 is not None:
            damaged.append(named.key)
        reason = "the backup it was restored from was damaged" if sha256 else "no backup contains its bytes"
        restored.unavailable.append(UnavailableObject(named.key, "lost", reason))
    rclone.delete(site, damaged)


def _mark_target(rclone: Rclone, site: str, bucket: str, snapshot: Snapshot) -> bool:
    """Note in the bucket what is being restored; return whether an earlier try noted the same.

    Raises:
        BackupConflict: the bucket contains something else.
    """
    with suppress(FileNotFoundError):
        noted = json.loads(rclone.read(f"{site}/{_NOTE}"))["snapshot"]
        if noted != snapshot.id:
            raise BackupConflict(
                f"A restore of the backup {noted} into {bucket} was not finished: continue that one (--snapshot), or "
                "name an empty instance."
            )
        return True
    for file in rclone.files(site):
        raise BackupConflict(f"{bucket} is not empty ({file.path} is there): a backup is restored into an empty one.")
    rclone.write(f"{site}/{_NOTE}", json.dumps({"snapshot": snapshot.id}).encode())
    return False


def _with_site(rclone: Rclone, settings: Settings) -> tuple[Rclone, str]:
    """Return rclone with the instance's bucket as a remote, and that remote."""
    secret_key = settings.s3_secret_key.get_secret_value()
    remotes = s3_remote("kleinsite", settings.s3_internal_url, settings.s3_region, settings.s3_access_key, secret_key)
    if settings.s3_ca_file is not None:
        others = rclone.remotes.get("RCLONE_CA_CERT")
        remotes["RCLONE_CA_CERT"] = ",".join(filter(None, [others, str(settings.s3_ca_file)]))
    return rclone.with_remotes(remotes), f"kleinsite:{settings.s3_bucket}"


def amount(size_bytes: float) -> str:
    """Return bytes as a person reads them."""
    for unit in ("B", "kB", "MB", "GB"):
        if size_bytes < 1000:
            return f"{size_bytes:.0f} {unit}" if unit == "B" else f"{size_bytes:.1f} {unit}"
        size_bytes /= 1000
    return f"{size_bytes:.1f} TB"
