"""The projects, missions, files and blobs of a backup, read from its database file into a temporary SQLite database.

Only columns that every schema since the initial one has. Values stay in PostgreSQL's text form. Millions of files need
little memory.
"""

import json
import re
import sqlite3
from collections.abc import Iterator
from dataclasses import dataclass
from typing import IO, NamedTuple

from kleinkram.contract.names import is_id, name_key
from kleinkram.server.backup.errors import BackupDamaged, BackupNotFound, BackupRequestInvalid

_COLUMNS = {
    "project": "id name description metadata_fields licence citation created_by_id created_at deleted_at",
    "mission": "id project_id name metadata metadata_yaml notes completed_at created_by_id created_at deleted_at",
    "file": "id mission_id path origin blob_id labels uploaded_by_id created_at deleted_at",
    "blob": "id store_id key size_bytes sha256 uploaded_by_id created_at",
}
_INDEXES = "CREATE INDEX of_mission ON file (mission_id); CREATE INDEX of_project ON mission (project_id)"
# What COPY writes in place of some characters. Source: PostgreSQL manual, COPY, "Text Format".
_ESCAPED = re.compile(r"\\(.)")
_CHARACTERS = {"b": "\b", "f": "\f", "n": "\n", "r": "\r", "t": "\t", "v": "\v"}


@dataclass(frozen=True)
class RestoreSelection:
    """What to restore, by names or ids: a project, a mission of it, or a file of that."""

    project: str
    mission: str | None = None
    file: str | None = None

    def __post_init__(self) -> None:
        """Refuse a file without its mission."""
        if self.file is not None and self.mission is None:
            raise BackupRequestInvalid("To restore a file, name its mission, too.")


class SavedProject(NamedTuple):
    """A project of the backup."""

    id: str
    name: str
    description: str
    metadata_fields: str
    licence: str
    citation: str
    created_by_id: str
    created_at: str


class SavedMission(NamedTuple):
    """A mission of the backup."""

    id: str
    project_id: str
    name: str
    metadata: str
    metadata_yaml: str | None
    notes: str
    completed_at: str | None
    created_by_id: str
    created_at: str


class SavedFile(NamedTuple):
    """A file of the backup with its blob; `sha256` in hexadecimal digits."""

    id: str
    path: str
    origin: str
    labels: str
    uploaded_by_id: str
    created_at: str
    blob_id: str
    store_id: str
    key: str
    size_bytes: int
    sha256: str
    blob_uploaded_by_id: str
    blob_created_at: str


class SavedRows:
    """The rows, without those in the trash at the time of the backup."""

    def __init__(self) -> None:
        self._db = sqlite3.connect("", isolation_level=None)
        for table, columns in _COLUMNS.items():
            self._db.execute(f"CREATE TABLE {table} ({', '.join(columns.split())}, PRIMARY KEY (id)) WITHOUT ROWID")

    def close(self) -> None:
        """Delete the temporary database."""
        self._db.close()

    def load(self, file: IO[bytes]) -> None:
        """Read a database file of a backup. Raises BackupDamaged."""
        self._db.execute("BEGIN")
        while line := file.readline():
            table, columns, size_bytes = json.loads(line)
            piece = file.read(size_bytes)
            if len(piece) != size_bytes:
                raise BackupDamaged("The backup's database file was cut off.")
            if table in _COLUMNS:
                self._insert(table, columns, piece.decode())
        self._db.execute("COMMIT")
        self._db.executescript(_INDEXES)

    def _insert(self, table: str, columns: list[str], piece: str) -> None:
        saved_columns = _COLUMNS[table].split()
        positions = [columns.index(name) for name in saved_columns]
        rows = (_values(line, positions) for line in piece.split("\n") if line)
        places = ", ".join("?" * len(saved_columns))
        self._db.executemany(f"INSERT INTO {table} VALUES ({places})", rows)  # noqa: S608  (constants)

    def project(self, reference: str) -> SavedProject:
        """Return a project by name or id. Raises BackupNotFound."""
        return SavedProject(*self._one("project", SavedProject._fields, "1", (), reference))

    def missions(self, project: SavedProject, reference: str | None) -> list[SavedMission]:
        """Return a mission of a project by name or id, or all. Raises BackupNotFound."""
        condition, values = "project_id = ?", (project.id,)
        if reference is not None:
            return [SavedMission(*self._one("mission", SavedMission._fields, condition, values, reference))]
        rows = self._select("mission", SavedMission._fields, condition, values)
        return sorted((SavedMission(*row) for row in rows), key=lambda one: one.name)

    def files(self, mission: SavedMission, reference: str | None) -> list[SavedFile]:
        """Return a file of a mission by path or id, or all, ordered by path. Raises BackupNotFound."""
        file_columns = ("id", "path", "origin", "labels", "uploaded_by_id", "created_at")
        blob_columns = ("id", "store_id", "key", "CAST(blob.size_bytes AS INTEGER)", "sha256", "uploaded_by_id")
        columns = [f"file.{name}" for name in file_columns]
        columns += [name if "(" in name else f"blob.{name}" for name in (*blob_columns, "created_at")]
        query = (
            f"SELECT {', '.join(columns)} FROM file JOIN blob ON blob.id = file.blob_id"  # noqa: S608  (constants)
            " WHERE file.deleted_at IS NULL AND file.mission_id = ? ORDER BY file.path"
        )
        rows = (SavedFile(*row) for row in self._db.execute(query, (mission.id,)))
        files = [row._replace(sha256=row.sha256.removeprefix("\\x")) for row in rows]
        if reference is None:
            return files
        chosen = [row for row in files if _matches(reference, row.id, row.path)]
        if not chosen:
            raise BackupNotFound(f"The backup has no file {reference} in the mission {mission.name}.")
        return chosen

    def _one(
        self, table: str, columns: tuple[str, ...], condition: str, values: tuple[str, ...], reference: str
    ) -> tuple[str, ...]:
        name = columns.index("name")
        for row in self._select(table, columns, condition, values):
            if _matches(reference, row[0], row[name]):
                return row
        raise BackupNotFound(f"The backup has no {table} {reference}, or had it in the trash.")

    def _select(
        self, table: str, columns: tuple[str, ...], condition: str, values: tuple[str, ...]
    ) -> Iterator[tuple[str, ...]]:
        listing = ", ".join(columns)
        query = f"SELECT {listing} FROM {table} WHERE deleted_at IS NULL AND {condition}"  # noqa: S608  (constants)
        return iter(self._db.execute(query, values))


def _matches(reference: str, row_id: str, name: str) -> bool:
    return row_id == reference.lower() if is_id(reference) else name_key(name) == name_key(reference)


def _values(line: str, positions: list[int]) -> list[str | None]:
    fields = line.split("\t")
    return [None if fields[position] == "\\N" else _unescaped(fields[position]) for position in positions]


def _unescaped(text: str) -> str:
    return _ESCAPED.sub(lambda match: _CHARACTERS.get(match[1], match[1]), text) if "\\" in text else text
