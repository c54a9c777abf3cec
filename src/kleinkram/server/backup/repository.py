"""A backup location: a folder, an S3 bucket or any rclone remote, with the backups in it.

    klein-backup.json            format, and whether the rest is encrypted
    lock, locks/                 who writes to the location now
    objects/KEY                  objects of the store under their own keys, shared by all backups
    snapshots/ID/database.zst    all rows
    snapshots/ID/objects.zst     the list of objects
    snapshots/ID.json            the backup itself: written last, so that it names nothing that is not there

An encrypted location has objects and snapshots in `encrypted/`, in the format of `rclone crypt`. Nothing is rewritten.
"""

import contextlib
import hashlib
import io
import json
import os
import re
import secrets
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import IO, Annotated, BinaryIO, Literal, cast

import zstandard
from pydantic import BaseModel, ConfigDict, Field, SecretStr, ValidationError
from pydantic_settings import BaseSettings, SettingsConfigDict

from kleinkram.server.backup.errors import (
    BackupConflict,
    BackupDamaged,
    BackupLocationFull,
    BackupNotFound,
    BackupRequestInvalid,
    PassphraseWrong,
)
from kleinkram.server.backup.lock import lock_folder, lock_remote
from kleinkram.server.backup.objects import ObjectEntry
from kleinkram.server.backup.rclone import Rclone, join_remote, s3_remote
from kleinkram.server.environment import SettingsInvalid, secret_from_file

_FORMAT = 2
_MARKER, _CHECK = "klein-backup.json", "passphrase-check"
_CRYPT = "kleincrypt:"
_REMOTE = re.compile(r"[\w.+@-]+:.*")
_LEFT_BY_US = re.compile(rf"lock|locks/.*|{re.escape(_MARKER)}\..*")


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class StoredFile(_Model):
    """A file of a backup, as it is stored."""

    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
    size_bytes: int


class DumpedTable(_Model):
    """One table in the database file."""

    name: str
    columns: tuple[str, ...]
    rows: int


class Snapshot(_Model):
    """One backup. `revision` is the schema's; `store_id` the name of the store in the database.

    `elsewhere`: how many blobs the database names in other stores, which are in no backup of this one.
    """

    format: Literal[2] = 2
    id: str
    created_at: datetime
    ended_at: datetime
    kleinkram: str
    postgres: str
    revision: str
    store_id: str
    elsewhere: int
    tables: tuple[DumpedTable, ...]
    sequences: dict[str, int]
    database: StoredFile
    object_list: StoredFile
    objects: int
    object_bytes: int
    lost: int
    corrupt: int

    @property
    def files(self) -> dict[str, StoredFile]:
        """The files of this backup alone, by name."""
        return {"database.zst": self.database, "objects.zst": self.object_list}

    @property
    def rows(self) -> int:
        """The rows of all tables."""
        return sum(table.rows for table in self.tables)


class _Marker(_Model):
    format: Literal[2] = 2
    salt: str | None


class _BucketSettings(BaseSettings):
    model_config = SettingsConfigDict(
        env_prefix="KLEINKRAM_BACKUP_", frozen=True, extra="ignore", hide_input_in_errors=True
    )

    s3_url: str
    s3_region: str = "us-east-1"
    s3_access_key: str
    s3_secret_key: SecretStr
    s3_ca_file: Path | None = None


class PackedWriter:
    """Compresses what is written with zstd, and hashes the result."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self._compressor = zstandard.ZstdCompressor(level=3).compressobj()
        self._digest = hashlib.sha256()
        self._size_bytes = 0

    def write(self, raw: bytes) -> None:
        """Append bytes."""
        self._put(self._compressor.compress(raw))

    def end(self) -> StoredFile:
        """Write the end; return what was written."""
        self._put(self._compressor.flush())
        return StoredFile(sha256=self._digest.hexdigest(), size_bytes=self._size_bytes)

    def _put(self, packed: bytes) -> None:
        self._file.write(packed)
        self._digest.update(packed)
        self._size_bytes += len(packed)


@dataclass(frozen=True)
class Repository:
    """Backups in one location. `content`: the remote below which objects and snapshots are."""

    name: str
    root: str
    content: str
    rclone: Rclone
    salt: str | None

    @property
    def folder(self) -> Path | None:
        """The location, if it is a folder of this machine."""
        return Path(self.root) if self.root.startswith("/") else None

    @property
    def objects(self) -> str:
        """The remote folder of objects."""
        return join_remote(self.content, "objects")

    @property
    def snapshots(self) -> str:
        """The remote folder of backups."""
        return join_remote(self.content, "snapshots")

    def locked(self) -> AbstractContextManager[Callable[[], None]]:
        """Be the only process that writes to the location; yields a check that this is still so.

        Raises:
            BackupConflict: another process writes there; also by the check.
        """
        folder = self.folder
        return lock_folder(folder) if folder else lock_remote(self.rclone, join_remote(self.root, "locks"), self.name)

    def confirm_marker(self) -> None:
        """Raise BackupConflict if another process began backups here at the same time."""
        marker = _read_marker(self.name, self.root, self.rclone)
        if marker is None or marker.salt != self.salt:
            raise BackupConflict(f"Another process began the backups in {self.name}: run the command again.")

    def snapshot_ids(self) -> list[str]:
        """Return the ids of all complete backups, oldest first."""
        paths = [file.path for file in self.rclone.files(self.snapshots)]
        return sorted(path.removesuffix(".json") for path in paths if "/" not in path)

    def snapshot(self, snapshot_id: str | None) -> Snapshot:
        """Return a backup, the latest if no id is given.

        Raises:
            BackupNotFound: there is none.
            BackupDamaged: its document was changed or cut off.
        """
        ids = self.snapshot_ids()
        if snapshot_id is None and not ids:
            raise BackupNotFound(f"{self.name} contains no complete backup yet.")
        chosen = snapshot_id or ids[-1]
        if chosen not in ids:
            raise BackupNotFound(f"{self.name} contains no backup {chosen}: `klein backup list` shows all.")
        stated, _, body = self.rclone.read(f"{self.snapshots}/{chosen}.json").partition(b"\n")
        try:
            if hashlib.sha256(body).hexdigest().encode() == stated:
                return Snapshot.model_validate_json(body)
        except ValidationError as error:
            raise BackupDamaged(
                f"snapshots/{chosen}.json cannot be read, or is of a later version ({error})."
            ) from None
        raise BackupDamaged(f"snapshots/{chosen}.json was changed or cut off.")

    def add_snapshot(self, snapshot: Snapshot) -> None:
        """Write the document that makes a backup complete, after everything it names has reached the disk."""
        body = snapshot.model_dump_json().encode()
        self._sync()
        self.rclone.write(
            f"{self.snapshots}/{snapshot.id}.json", hashlib.sha256(body).hexdigest().encode() + b"\n" + body
        )
        self._sync()

    def remove_unfinished(self) -> None:
        """Delete the files of backups that have no document."""
        paths = [file.path for file in self.rclone.files(self.snapshots)]
        ids = {path.removesuffix(".json") for path in paths if "/" not in path}
        unfinished = [path for path in paths if "/" in path and path.partition("/")[0] not in ids]
        self.rclone.delete(self.snapshots, unfinished)

    @contextlib.contextmanager
    def write_packed(self, snapshot_id: str, name: str) -> Iterator[PackedWriter]:
        """Open a new file of a backup; call `end` on it within the block."""
        with self.rclone.writer(f"{self.snapshots}/{snapshot_id}/{name}") as file:
            yield PackedWriter(file)

    def check_sizes(self, snapshot: Snapshot) -> None:
        """Compare the sizes of a backup's files.

        Raises:
            BackupDamaged: one is missing or has another size.
        """
        sizes = {file.path: file.size_bytes for file in self.rclone.files(f"{self.snapshots}/{snapshot.id}")}
        for name, stored in snapshot.files.items():
            if sizes.get(name) != stored.size_bytes:
                raise BackupDamaged(
                    f"snapshots/{snapshot.id}/{name} has {sizes.get(name, 0)} bytes instead of {stored.size_bytes}."
                )

    def check_files(self, snapshot: Snapshot) -> None:
        """Read the files of a backup.

        Raises:
            BackupDamaged: one is missing or was changed.
        """
        hashes = self.rclone.sha256(f"{self.snapshots}/{snapshot.id}", [*snapshot.files])
        for name, stored in snapshot.files.items():
            if hashes.get(name) != stored.sha256:
                state = "was changed or cut off" if name in hashes else "is missing"
                raise BackupDamaged(f"snapshots/{snapshot.id}/{name} {state}.")

    @contextlib.contextmanager
    def read_packed(self, snapshot_id: str, name: str) -> Iterator[IO[bytes]]:
        """Open a file of a backup; `check_files` checks its content."""
        try:
            with self.rclone.reader(f"{self.snapshots}/{snapshot_id}/{name}") as packed:
                unpacked = zstandard.open(cast("BinaryIO", packed), "rb")
                yield io.BufferedReader(cast("io.RawIOBase", unpacked), 1024 * 1024)
        except FileNotFoundError:
            raise BackupDamaged(f"snapshots/{snapshot_id}/{name} is missing.") from None

    def entries(self, snapshot: Snapshot) -> Iterator[ObjectEntry]:
        """Yield the objects of a backup.

        Raises:
            BackupDamaged: the list is missing or was changed.
        """
        count = 0
        try:
            with self.read_packed(snapshot.id, "objects.zst") as file:
                for line in file:
                    count += 1
                    yield ObjectEntry(*json.loads(line))
        except (zstandard.ZstdError, ValueError, TypeError):
            count = -1
        if count != snapshot.objects:
            raise BackupDamaged(f"snapshots/{snapshot.id}/objects.zst was changed or cut off.")

    def _sync(self) -> None:
        if self.folder is not None:
            os.sync()


def open_repository(place: str, passphrase: str | None, rclone: Rclone) -> Repository:
    """Open the backups in a location.

    Raises:
        BackupNotFound: there are none.
        PassphraseWrong: they are encrypted, and this is not their passphrase.
    """
    root, remotes = _resolve(place)
    marker = _read_marker(place, root, rclone.with_remotes(remotes))
    if marker is None:
        raise BackupNotFound(f"There are no backups in {place}.")
    return _open(place, root, marker, passphrase, rclone.with_remotes(remotes))


def make_repository(place: str, passphrase: str | None, rclone: Rclone, *, encrypt: bool) -> Repository:
    """Open the backups in a location, or begin them there.

    Raises:
        BackupRequestInvalid: they are to be encrypted, and there is no passphrase, or they are not encrypted.
        BackupConflict: the location contains something else.
    """
    root, remotes = _resolve(place)
    plain = rclone.with_remotes(remotes)
    marker = _read_marker(place, root, plain)
    if marker is not None:
        if encrypt and marker.salt is None:
            raise BackupRequestInvalid(f"The backups in {place} were begun without --encrypt: name another location.")
        return _open(place, root, marker, passphrase, plain, may_begin=True)
    for file in plain.files(root):
        if not _LEFT_BY_US.fullmatch(file.path):
            raise BackupConflict(f"{place} is not empty and contains no backups ({file.path} is there): name another.")
    if encrypt and not passphrase:
        raise BackupRequestInvalid(
            "--encrypt needs a passphrase: give --passphrase-file, or KLEINKRAM_BACKUP_PASSPHRASE."
        )
    marker = _Marker(salt=secrets.token_hex(16) if encrypt else None)
    if root.startswith("/"):
        try:
            Path(root).mkdir(mode=0o700, parents=True, exist_ok=True)
        except OSError as error:
            raise BackupLocationFull(f"{place} cannot be made: {error.strerror or error}.") from error
    plain.write(join_remote(root, _MARKER), marker.model_dump_json().encode())
    return _open(place, root, marker, passphrase, plain, may_begin=True)


def _open(
    place: str, root: str, marker: _Marker, passphrase: str | None, rclone: Rclone, *, may_begin: bool = False
) -> Repository:
    if marker.salt is None:
        return Repository(place, root, root, rclone, None)
    if passphrase is None:
        raise PassphraseWrong(
            f"The backups in {place} are encrypted: give --passphrase-file, or set KLEINKRAM_BACKUP_PASSPHRASE."
        )
    encrypted = rclone.with_remotes(_encryption(root, marker, passphrase, rclone))
    if may_begin and not any(True for _ in rclone.files(join_remote(root, "encrypted"))):
        encrypted.write(_CRYPT + _CHECK, b"This passphrase is the right one.\n")
    try:
        encrypted.read(_CRYPT + _CHECK)
    except FileNotFoundError:
        raise PassphraseWrong(f"The passphrase is not the one of the backups in {place}.") from None
    return Repository(place, root, _CRYPT, encrypted, marker.salt)


def _encryption(root: str, marker: _Marker, passphrase: str, rclone: Rclone) -> dict[str, str]:
    return {
        "RCLONE_CONFIG_KLEINCRYPT_TYPE": "crypt",
        "RCLONE_CONFIG_KLEINCRYPT_REMOTE": join_remote(root, "encrypted"),
        "RCLONE_CONFIG_KLEINCRYPT_PASSWORD": rclone.obscure(passphrase),
        "RCLONE_CONFIG_KLEINCRYPT_PASSWORD2": rclone.obscure(marker.salt or ""),
    }


def _resolve(place: str) -> tuple[str, dict[str, str]]:
    """Return a location's rclone remote, and the variables that configure it."""
    if not place.startswith("s3://"):
        return place if _REMOTE.fullmatch(place) else str(Path(place).absolute()), {}
    names = ("s3_access_key", "s3_secret_key")
    try:
        secrets_in_files = {name: secret_from_file(f"KLEINKRAM_BACKUP_{name.upper()}") for name in names}
        credentials = {name: value for name, value in secrets_in_files.items() if value is not None}
        settings = _BucketSettings(**credentials)  # type: ignore[arg-type]  # validated
    except ValidationError as error:
        missing = ", ".join(f"KLEINKRAM_BACKUP_{str(detail['loc'][0]).upper()}" for detail in error.errors())
        raise BackupRequestInvalid(f"{place} needs these settings: {missing}.") from None
    except SettingsInvalid as error:
        raise BackupRequestInvalid(str(error)) from None
    secret = settings.s3_secret_key.get_secret_value()
    remotes = s3_remote("kleinbackup", settings.s3_url, settings.s3_region, settings.s3_access_key, secret)
    if settings.s3_ca_file is not None:
        remotes["RCLONE_CA_CERT"] = str(settings.s3_ca_file)
    return f"kleinbackup:{place.removeprefix('s3://').strip('/')}", remotes


def _read_marker(place: str, root: str, rclone: Rclone) -> _Marker | None:
    try:
        values = json.loads(rclone.read(join_remote(root, _MARKER)))
        if values["format"] == _FORMAT:
            return _Marker.model_validate(values)
    except FileNotFoundError:
        return None
    except (ValueError, KeyError, TypeError):
        raise BackupDamaged(f"{_MARKER} in {place} cannot be read: restore it from a copy.") from None
    raise BackupRequestInvalid(f"The backups in {place} have another format: use a later version of Kleinkram.")
