"""What a backup is made of: a document that names its pieces, and lists of objects, a line of JSON each."""

import datetime
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

FORMAT = 1
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


Problem = Literal["lost", "unreadable", "corrupt"]


class _Noun(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Piece(_Noun):
    """Some bytes in the repository, packed with zstd: `sha256` and `size_bytes` are of them as they are packed."""

    sha256: Sha256
    size_bytes: int


class TableCopy(_Noun):
    """One table: its columns in order, and its rows as `COPY ... TO STDOUT` writes them, piece after piece."""

    name: str
    columns: tuple[str, ...]
    rows: int
    pieces: tuple[Piece, ...]


class ObjectEntry(_Noun):
    """One object of the store: what was found under its key.

    `sha256`: of the bytes that the backup holds for it; null where it holds none.
    `problem`: of the store that was read. What was lost there may be here all the same, where another key had it.
    `expected`: where there was a problem, the SHA-256 that the database states.
    """

    key: str
    size_bytes: int
    sha256: Sha256 | None = None
    expected: Sha256 | None = None
    problem: Problem | None = None


class ObjectList(_Noun):
    """All objects that the database names, ordered by nothing, packed into pieces of some thousand lines."""

    count: int
    size_bytes: int
    lost: int
    corrupt: int
    pieces: tuple[Piece, ...]


class Snapshot(_Noun):
    """One backup. `revision` is the schema's; `store_id` the name by which the database knows the store that was read.

    `elsewhere`: how many blobs the database names in other stores, which are in no backup of this one.
    """

    format: Literal[1] = 1
    id: str
    created_at: datetime.datetime
    ended_at: datetime.datetime
    kleinkram: str
    postgres: str
    revision: str
    store_id: str
    elsewhere: int
    tables: tuple[TableCopy, ...]
    sequences: dict[str, int]
    objects: ObjectList
