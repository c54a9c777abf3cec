"""Connections and transactions, and the SQL expressions that features share: SQLAlchemy Core over psycopg 3, no ORM.

A request has one transaction by default: committed when the route returns, rolled back when it raises. Code that calls
the object store opens several with `Database.begin`; reads can do without a transaction (`Database.autocommit`).
"""

import hashlib
import select
from collections.abc import AsyncIterator, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, asynccontextmanager, contextmanager
from typing import Any, overload

import psycopg
from psycopg.types.array import ListBinaryDumper
from pydantic_core import from_json, to_json
from sqlalchemy import (
    ARRAY,
    ColumnClause,
    ColumnElement,
    Insert,
    Row,
    Select,
    Table,
    TableValuedAlias,
    any_,
    bindparam,
    column,
    event,
    false,
    func,
    insert,
    literal,
    make_url,
    or_,
)
from sqlalchemy import select as sql_select
from sqlalchemy.dialects import postgresql
from sqlalchemy.exc import DBAPIError, DisconnectionError
from sqlalchemy.exc import TimeoutError as PoolTimeoutError
from sqlalchemy.ext.asyncio import AsyncConnection, AsyncEngine, create_async_engine
from sqlalchemy.types import UserDefinedType

from kleinkram.contract.errors import DatabaseUnavailable
from kleinkram.contract.names import name_key
from kleinkram.server import metrics
from kleinkram.server.settings import Settings, async_dsn

# Longer than any statement of the API on a large database; workers may need longer.
STATEMENT_TIMEOUT_S = 30
_POOL_TIMEOUT_S = 20
_DISK_FULL = "its disk is full: free space on the server"
# A row of an index holds 2704 bytes: a topic's name and type together stay well below.
_MAX_TEXT_BYTES = 1000
# The first parameter of services: an open transaction that they must not end.
Connection = AsyncConnection


class Database:
    """The pool of one process."""

    def __init__(self, engine: AsyncEngine) -> None:
        self.engine = engine
        self._transactions = engine.execution_options(isolation_level="READ COMMITTED")

    @asynccontextmanager
    async def begin(self) -> AsyncIterator[Connection]:
        """Run a transaction: commit at the end, roll back on any error. Raises DatabaseUnavailable."""
        with _translate_errors():
            async with _connect(self._transactions) as connection, connection.begin():
                yield connection

    @asynccontextmanager
    async def autocommit(self) -> AsyncIterator[Connection]:
        """Run statements without a transaction, for reads: under READ COMMITTED they see the same.

        Raises DatabaseUnavailable.
        """
        with _translate_errors():
            async with _connect(self.engine) as connection:
                yield connection

    async def close(self) -> None:
        """Close every connection."""
        await self.engine.dispose()


@asynccontextmanager
async def _connect(engine: AsyncEngine) -> AsyncIterator[Connection]:
    """Take a connection from the pool, and measure how long that takes."""
    with ExitStack() as wait:
        wait.enter_context(metrics.DATABASE_CONNECTIONS_WAITING.track_inprogress())
        wait.enter_context(metrics.DATABASE_CONNECTION_WAIT_SECONDS.time())
        async with engine.connect() as connection:
            wait.close()
            yield connection


@contextmanager
def _translate_errors() -> Iterator[None]:
    try:
        yield
    except PoolTimeoutError as error:
        raise DatabaseUnavailable from error
    except DBAPIError as error:
        if isinstance(error.orig, psycopg.errors.DiskFull):
            raise DatabaseUnavailable(reason=_DISK_FULL) from error
        if error.connection_invalidated or isinstance(error.orig, psycopg.OperationalError):
            raise DatabaseUnavailable from error
        raise


def open_database(settings: Settings, *, statement_timeout_s: float | None = STATEMENT_TIMEOUT_S) -> Database:
    """Return a pool that connects when first used, and replaces connections that a restart of PostgreSQL broke.

    The database cancels statements after `statement_timeout_s`; None leaves that to its settings.
    """
    url = make_url(async_dsn(settings.database_url))
    arguments: dict[str, object] = {"connect_timeout": 5, "application_name": "kleinkram"}
    # Plan for the values of each request: the best plan for most words, labels and people may be the worst for others.
    options = [*url.normalized_query.get("options", ()), "-c plan_cache_mode=force_custom_plan"]
    if statement_timeout_s is not None:
        options.append(f"-c statement_timeout={round(statement_timeout_s * 1000)}")
    arguments["options"] = " ".join(options)
    engine = create_async_engine(
        url,
        pool_size=settings.database_connections,
        max_overflow=0,
        pool_timeout=_POOL_TIMEOUT_S,
        connect_args=arguments,
        # Saves round trips of requests that only read, which are most.
        isolation_level="AUTOCOMMIT",
        skip_autocommit_rollback=True,
        hide_parameters=True,  # in the text of errors, which is logged
        # Five times as fast as Python's own: a page of missions has hundreds, the checks of a mission many thousands.
        json_deserializer=from_json,
        json_serializer=_to_json,
    )
    event.listen(engine.sync_engine, "connect", _send_binary_arrays)
    event.listen(engine.sync_engine, "checkout", _check_connection)
    return Database(engine)


def _to_json(value: object) -> str:
    return to_json(value).decode()


def _send_binary_arrays(connection: Any, *_: object) -> None:
    # A fifth of the time for ids and a tenth for checksums, compared with the text form.
    connection.driver_connection.adapters.register_dumper(list, ListBinaryDumper)


def _check_connection(connection: Any, *_: object) -> None:
    # If it is readable while idle, PostgreSQL closed it. Without the round trip of a ping, which would also detect a
    # lost network.
    poll = select.poll()
    poll.register(connection.driver_connection.pgconn.socket, select.POLLIN)
    if poll.poll(0):
        raise DisconnectionError


class ArrayText(UserDefinedType[str]):
    """An array in PostgreSQL's text form, passed back without parsing."""

    cache_ok = True
    render_bind_cast = True

    def __init__(self, element: str) -> None:
        self.element = element

    def get_col_spec(self, **_: Any) -> str:
        """Return the SQL type."""
        return f"{self.element}[]"


def by_name(rows: Sequence[Row[Any]]) -> list[dict[str, Any]]:
    """Return the rows of one result as dicts; faster than `row._asdict()` for each."""
    names = rows[0]._fields if rows else ()
    return [dict(zip(names, row, strict=True)) for row in rows]


def among(column: ColumnElement[Any], values: Iterable[object]) -> ColumnElement[bool]:
    """Whether a column has one of some values, sent as one array: the statement does not depend on their number."""
    return column == any_(literal([*values], ARRAY(column.type)))


def among_parameter(column: ColumnElement[Any], name: str) -> ColumnElement[bool]:
    """Like `among`, with the values of the bind parameter `name`."""
    return column == any_(bindparam(name, type_=ARRAY(column.type)))


ESCAPE = "\\"


def like_pattern(glob: str) -> str:
    """Return the LIKE pattern of a glob: `*` is any run of characters, `?` is one, all else is itself."""
    return _escaped(glob).replace("*", "%").replace("?", "_")


def containing(text: str) -> str:
    """Return the LIKE pattern of texts that contain `text`."""
    return f"%{_escaped(text)}%"


def _escaped(text: str) -> str:
    for special in (ESCAPE, "%", "_"):
        text = text.replace(special, ESCAPE + special)
    return text


def matches(column: ColumnElement[str], glob: str) -> ColumnElement[bool]:
    """Whether a column matches a glob, letter case included; without a wildcard, whether it is equal."""
    if "*" in glob or "?" in glob:
        return column.like(like_pattern(glob), escape=ESCAPE)
    return column == glob


def matches_key(column: ColumnElement[str], glob: str) -> ColumnElement[bool]:
    """Whether a column of name keys matches a glob, in any case and Unicode form."""
    return matches(column, name_key(glob))


def matches_any(column: ColumnElement[str], globs: Sequence[str]) -> ColumnElement[bool]:
    """Whether a column matches at least one glob, letter case included."""
    return or_(false(), *(matches(column, glob) for glob in globs))


def violated_constraint(error: DBAPIError) -> str | None:
    """Return the name of the constraint that a statement violated."""
    original = error.orig
    return original.diag.constraint_name if isinstance(original, psycopg.Error) else None


def unnest_rows(columns: Sequence[ColumnClause[Any]], rows: Sequence[Mapping[str, Any]]) -> TableValuedAlias:
    """Return rows, keyed by column name, as a table with these columns in order. No column may be an array."""
    arrays = [literal([row[col.name] for row in rows], ARRAY(col.type)) for col in columns]
    named = [column(col.name, col.type) for col in columns]
    return func.unnest(*arrays).table_valued(*named, name="rows").render_derived()


def insert_rows(table: Table, rows: Sequence[Mapping[str, Any]]) -> Insert:
    """Return an INSERT of rows, at least one and all with the same keys, whose columns are sent as arrays.

    Other columns take the database's default; Python-side defaults do not apply.
    """
    return insert(table).from_select([*rows[0]], _select_rows(table, rows), include_defaults=False)


def upsert_rows(table: Table, rows: Sequence[Mapping[str, Any]]) -> postgresql.Insert:
    """Like `insert_rows`, for ON CONFLICT clauses. SQLAlchemy does not cache it."""
    return postgresql.insert(table).from_select([*rows[0]], _select_rows(table, rows), include_defaults=False)


def _select_rows(table: Table, rows: Sequence[Mapping[str, Any]]) -> Select[Any]:
    return sql_select(unnest_rows([table.c[key] for key in rows[0]], rows))


@overload
def fit_text(text: str) -> str: ...
@overload
def fit_text(text: None) -> None: ...
def fit_text(text: str | None) -> str | None:
    """Return `text` without what PostgreSQL cannot store (NUL, lone surrogates), at most 1000 bytes of UTF-8.

    Longer text is cut and ends with a hash of the whole, so that different texts stay different.
    """
    if text is None:
        return None
    whole = text.encode("utf-8", "backslashreplace").replace(b"\0", b"\\0")
    if len(whole) > _MAX_TEXT_BYTES:
        whole = whole[: _MAX_TEXT_BYTES - 20] + b"..." + hashlib.sha256(whole).hexdigest()[:16].encode()
    return whole.decode("utf-8", "ignore")
