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
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import IO, BinaryIO, Literal, TypeVar, cast

import zstandard
from pydantic import BaseModel, ConfigDict, SecretStr, ValidationError
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
from kleinkram.server.backup.objects import BackupObject
from kleinkram.server.backup.rclone import Rclone, S3Access, join_remote
from kleinkram.server.environment import SettingsInvalid, secret_from_file

T = TypeVar("T")
_FORMAT = 3
DATABASE, OBJECT_LIST = "database.zst", "objects.zst"
_MARKER, _CHECK = "klein-backup.json", "passphrase-check"
_CRYPT = "kleincrypt:"
_REMOTE = re.compile(r"[\w.+@-]+:.*")
_LEFT_BY_US = re.compile(rf"lock|locks/.*|{re.escape(_MARKER)}\..*")
_READ_BYTES = 1024 * 1024


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class StoredFile(_Model):
    """A file of a backup, as it is stored."""

    sha256: str
    size_bytes: int


class Snapshot(_Model):
    """One backup. `revision` is the schema's; `store_id` the name of the store in the database.

    `elsewhere`: how many blobs the database names in other stores, which are in no backup of this one.
    """

    format: Literal[3] = 3
    id: str
    created_at: datetime
    kleinkram: str
    revision: str
    store_id: str
    elsewhere: int
    rows: int
    sequences: dict[str, int]
    files: dict[str, StoredFile]
    objects: int
    object_bytes: int
    lost: int
    corrupt: int


class _Marker(_Model):
    format: Literal[3] = 3
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

    def file_sizes(self) -> dict[str, int]:
        """Return the size of each file of all backups, by path: `ID.json`, `ID/NAME`."""
        return {file.path: file.size_bytes for file in self.rclone.files(self.snapshots)}

    def snapshot_ids(self) -> list[str]:
        """Return the ids of all complete backups, oldest first."""
        return complete_ids(self.file_sizes())

    def snapshot(self, snapshot_id: str | None) -> Snapshot:
        """Return a backup, the latest if no id is given.

        Raises:
            BackupNotFound: there is none.
            BackupDamaged: its document was changed or cut off.
        """
        ids = [snapshot_id] if snapshot_id else self.snapshot_ids()
        if not ids:
            raise BackupNotFound(f"{self.name} contains no complete backup yet.")
        chosen = ids[-1]
        try:
            sha256, _, body = self.rclone.read(f"{self.snapshots}/{chosen}.json").partition(b"\n")
        except FileNotFoundError:
            raise BackupNotFound(f"{self.name} contains no backup {chosen}: `klein backup list` shows all.") from None
        try:
            if hashlib.sha256(body).hexdigest().encode() == sha256:
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
        sizes = self.file_sizes()
        ids = complete_ids(sizes)
        self.rclone.delete(
            self.snapshots, [path for path in sizes if "/" in path and path.partition("/")[0] not in ids]
        )

    def add_file(self, snapshot_id: str, name: str, write: Callable[[IO[bytes]], T]) -> tuple[StoredFile, T]:
        """Write a file of a backup, compressed; return what was stored, and what `write` returned."""
        try:
            with tempfile.TemporaryFile() as packed:
                with zstandard.open(packed, "wb", closefd=False) as file:
                    result = write(cast("IO[bytes]", file))
                stored = _hash(packed)
                self.rclone.write(f"{self.snapshots}/{snapshot_id}/{name}", packed)
        except OSError as error:
            raise BackupLocationFull(
                f"The temporary folder {tempfile.gettempdir()} cannot be written ({error.strerror or error}): make "
                "room, or name another one in TMPDIR."
            ) from error
        return stored, result

    @contextlib.contextmanager
    def read_file(self, snapshot: Snapshot, name: str) -> Iterator[IO[bytes]]:
        """Open a file of a backup, decompressed, once all of it was compared with its SHA-256.

        Raises:
            BackupDamaged: it is missing or was changed.
        """
        path = f"snapshots/{snapshot.id}/{name}"
        try:
            with self.rclone.reader(f"{self.snapshots}/{snapshot.id}/{name}") as packed:
                if _hash(packed) != snapshot.files[name]:
                    raise BackupDamaged(f"{path} was changed or cut off.")
                file = zstandard.open(cast("BinaryIO", packed), "rb")
                yield io.BufferedReader(cast("io.RawIOBase", file), _READ_BYTES)
        except FileNotFoundError:
            raise BackupDamaged(f"{path} is missing.") from None

    def objects_of(self, snapshot: Snapshot) -> Iterator[BackupObject]:
        """Yield the objects of a backup.

        Raises:
            BackupDamaged: the list is missing or was changed.
        """
        with self.read_file(snapshot, OBJECT_LIST) as file:
            for line in file:
                yield BackupObject(*json.loads(line))

    def _sync(self) -> None:
        if self.folder is not None:
            os.sync()


def open_repository(location: str, passphrase: str | None, rclone: Rclone) -> Repository:
    """Open the backups in a location.

    Raises:
        BackupNotFound: there are none.
        PassphraseWrong: they are encrypted, and this is not their passphrase.
    """
    root, rclone = _resolve(location, rclone)
    marker = _read_marker(location, root, rclone)
    if marker is None:
        raise BackupNotFound(f"There are no backups in {location}.")
    return _open(location, root, marker, passphrase, rclone)


def make_repository(location: str, passphrase: str | None, rclone: Rclone, *, encrypt: bool) -> Repository:
    """Open the backups in a location, or begin them there.

    Raises:
        BackupRequestInvalid: they are to be encrypted, and there is no passphrase, or they are not encrypted.
        BackupConflict: the location contains something else.
    """
    root, rclone = _resolve(location, rclone)
    marker = _read_marker(location, root, rclone)
    if marker is None:
        marker = _begin(location, root, passphrase, rclone, encrypt=encrypt)
    elif encrypt and marker.salt is None:
        raise BackupRequestInvalid(f"The backups in {location} were begun without --encrypt: name another location.")
    return _open(location, root, marker, passphrase, rclone, may_begin=True)


def _begin(location: str, root: str, passphrase: str | None, rclone: Rclone, *, encrypt: bool) -> _Marker:
    for file in rclone.files(root):
        if not _LEFT_BY_US.fullmatch(file.path):
            raise BackupConflict(
                f"{location} is not empty and contains no backups ({file.path} is there): name another."
            )
    if encrypt and not passphrase:
        raise BackupRequestInvalid(
            "--encrypt needs a passphrase: give --passphrase-file, or KLEINKRAM_BACKUP_PASSPHRASE."
        )
    marker = _Marker(salt=secrets.token_hex(16) if encrypt else None)
    if root.startswith("/"):
        try:
            Path(root).mkdir(mode=0o700, parents=True, exist_ok=True)
        except OSError as error:
            raise BackupLocationFull(f"{location} cannot be made: {error.strerror or error}.") from error
    rclone.write(join_remote(root, _MARKER), marker.model_dump_json().encode())
    return marker


def _open(
    location: str, root: str, marker: _Marker, passphrase: str | None, rclone: Rclone, *, may_begin: bool = False
) -> Repository:
    if marker.salt is None:
        return Repository(location, root, root, rclone, None)
    if passphrase is None:
        raise PassphraseWrong(
            f"The backups in {location} are encrypted: give --passphrase-file, or set KLEINKRAM_BACKUP_PASSPHRASE."
        )
    folder = join_remote(root, "encrypted")
    encrypted = rclone.with_remotes(
        {
            "RCLONE_CONFIG_KLEINCRYPT_TYPE": "crypt",
            "RCLONE_CONFIG_KLEINCRYPT_REMOTE": folder,
            "RCLONE_CONFIG_KLEINCRYPT_PASSWORD": rclone.obscure(passphrase),
            "RCLONE_CONFIG_KLEINCRYPT_PASSWORD2": rclone.obscure(marker.salt),
        }
    )
    if may_begin and not any(True for _ in rclone.files(folder)):
        encrypted.write(_CRYPT + _CHECK, b"This passphrase is the right one.\n")
    try:
        encrypted.read(_CRYPT + _CHECK)
    except FileNotFoundError:
        raise PassphraseWrong(f"The passphrase is not the one of the backups in {location}.") from None
    return Repository(location, root, _CRYPT, encrypted, marker.salt)


def _resolve(location: str, rclone: Rclone) -> tuple[str, Rclone]:
    """Return a location as a folder or a path of rclone, and rclone with its remote."""
    if not location.startswith("s3://"):
        return location if _REMOTE.fullmatch(location) else str(Path(location).absolute()), rclone
    names = ("s3_access_key", "s3_secret_key")
    try:
        secrets_in_files = {name: secret_from_file(f"KLEINKRAM_BACKUP_{name.upper()}") for name in names}
        credentials = {name: value for name, value in secrets_in_files.items() if value is not None}
        settings = _BucketSettings(**credentials)  # type: ignore[arg-type]  # validated
    except ValidationError as error:
        missing = ", ".join(f"KLEINKRAM_BACKUP_{str(detail['loc'][0]).upper()}" for detail in error.errors())
        raise BackupRequestInvalid(f"{location} needs these settings: {missing}.") from None
    except SettingsInvalid as error:
        raise BackupRequestInvalid(str(error)) from None
    secret = settings.s3_secret_key.get_secret_value()
    access = S3Access(settings.s3_url, settings.s3_region, settings.s3_access_key, secret, settings.s3_ca_file)
    return f"kleinbackup:{location.removeprefix('s3://').strip('/')}", rclone.with_s3("kleinbackup", access)


def complete_ids(paths: Iterable[str]) -> list[str]:
    """Return the ids of the complete backups among files of backups, oldest first."""
    return sorted(path.removesuffix(".json") for path in paths if "/" not in path)


def write_objects(objects: Iterable[BackupObject], file: IO[bytes]) -> None:
    """Write the list of objects of a backup."""
    for row in objects:
        file.write(json.dumps(row._replace(stored_bytes=None)).encode() + b"\n")


def _hash(file: IO[bytes]) -> StoredFile:
    """Return the size and SHA-256 of a file; it is then at its start again."""
    digest = hashlib.sha256()
    file.seek(0)
    while piece := file.read(_READ_BYTES):
        digest.update(piece)
    size_bytes = file.tell()
    file.seek(0)
    return StoredFile(sha256=digest.hexdigest(), size_bytes=size_bytes)


def _read_marker(location: str, root: str, rclone: Rclone) -> _Marker | None:
    try:
        values = json.loads(rclone.read(join_remote(root, _MARKER)))
        if values["format"] == _FORMAT:
            return _Marker.model_validate(values)
    except FileNotFoundError:
        return None
    except (ValueError, KeyError, TypeError):
        raise BackupDamaged(f"{_MARKER} in {location} cannot be read: restore it from a copy.") from None
    raise BackupRequestInvalid(f"The backups in {location} have another format: use a later version of Kleinkram.")
