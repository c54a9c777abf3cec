"""`python -m kleinkram.server check`: checks everything that a server needs, and reports problems with remedies.

Deletes the objects that it writes into the bucket. Writes the bucket's CORS rules, as the API does when it starts,
unless KLEINKRAM_S3_CORS says otherwise. Never prints a secret.
"""

import asyncio
import datetime
import os
import resource
import socket
import sys
import tempfile
import uuid
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar
from urllib.parse import urlsplit

import aiohttp
import psycopg
from psycopg.rows import class_row
from pydantic import PostgresDsn
from typing_extensions import LiteralString

from kleinkram import traces
from kleinkram.contract.errors import StoreUnavailable
from kleinkram.diagnostics import (
    Diagnostic,
    DiagnosticSeverity,
    check_clock,
    check_disk,
    find_problems,
    judge,
    ok,
    problem,
    report,
    warning,
)
from kleinkram.recordings import SummaryFailed
from kleinkram.recordings.isolation import FileRequest, summarise_isolated
from kleinkram.server.db import open_database
from kleinkram.server.environment import SettingsInvalid, load_settings
from kleinkram.server.health.public_address import check_public_address, check_public_store, is_local
from kleinkram.server.health.readiness import check_schema
from kleinkram.server.logs import quiet_libraries
from kleinkram.server.mail import MailNotSent, open_mail_server
from kleinkram.server.s3.capabilities import configure_cors, probe
from kleinkram.server.s3.storage import Storage, StoreRefused, open_storage
from kleinkram.server.settings import Settings, plain_dsn

T = TypeVar("T")
_CORRECT_MIGRATION = "Correct KLEINKRAM_MIGRATION_DATABASE_URL or KLEINKRAM_MIGRATION_DATABASE_PASSWORD."
_GRANT_AGAIN = "Migrations grant that: GRANT again what was revoked by hand (see docs/running.md)."
_OLDEST_POSTGRES = 150_000
# Beside their pools: 2 of an API process and 13 of a worker.
_OTHER_CONNECTIONS = 15
_MIN_OPEN_FILES = 4096
_READER_TIMEOUT_S = 60
_TIMEOUT = aiohttp.ClientTimeout(total=15)
# Three poses of a trajectory: what a child process needs to do to read it is what it needs for any recording.
_SAMPLE = "".join(f"{second}.0 0 0 0 0 0 0 1\n" for second in range(3))
_ABOUT_SERVER = """
SELECT current_setting('server_version') AS version, current_setting('server_version_num')::int AS version_number,
  current_setting('server_encoding') AS encoding, clock_timestamp() AS now, current_user::text AS role,
  current_database()::text AS database,
  EXISTS (SELECT 1 FROM pg_available_extensions WHERE name = 'pg_trgm') AS has_trgm,
  (SELECT rolsuper FROM pg_roles WHERE rolname = current_user) AS is_superuser,
  has_schema_privilege('public', 'CREATE') AS can_create,
  current_setting('max_connections')::int AS max_connections,
  (SELECT coalesce(string_agg(relname, ', ' ORDER BY relname), '') FROM pg_class
    WHERE relnamespace = 'public'::regnamespace AND relkind = 'r' AND NOT has_table_privilege(oid, 'SELECT')
  ) AS unreadable_tables,
  (SELECT coalesce(min(pg_get_userbyid(relowner)), '') FROM pg_class
    WHERE relnamespace = 'public'::regnamespace AND relkind = 'r' AND NOT pg_has_role(relowner, 'USAGE')
  ) AS other_owner
"""
_ABOUT_RIGHTS = """
SELECT has_table_privilege('mission', 'SELECT') AND has_table_privilege('mission', 'INSERT')
    AND has_table_privilege('mission', 'UPDATE') AS writes,
  has_table_privilege('audit_event', 'INSERT') AS appends,
  has_table_privilege('audit_event', 'UPDATE') OR has_table_privilege('audit_event', 'DELETE') AS alters,
  (SELECT coalesce(max(days), 0) FROM audit_retention) AS audit_days
"""


@dataclass(frozen=True)
class _Server:
    """Row of `_ABOUT_SERVER`: facts about the server and the current role; `other_owner` has tables that it has not."""

    version: str
    version_number: int
    encoding: str
    has_trgm: bool
    now: datetime.datetime
    role: str
    database: str
    is_superuser: bool
    can_create: bool
    max_connections: int
    unreadable_tables: str
    other_owner: str


@dataclass(frozen=True)
class _Rights:
    """Row of `_ABOUT_RIGHTS`: whether a role can change missions, and append to and change the audit log.

    `audit_days`: for how many days the database keeps the audit log; 0 for ever.
    """

    writes: bool
    appends: bool
    alters: bool
    audit_days: int


def main(*, as_json: bool) -> int:
    """Run all checks and print what they found; returns 1 where there is a problem, else 0."""
    quiet_libraries()
    results = asyncio.run(_collect())
    sys.stdout.write(report(results, as_json=as_json) + "\n")
    return 1 if find_problems(results) else 0


async def _collect() -> list[Diagnostic]:
    try:
        settings = load_settings()
    except SettingsInvalid as error:
        return [*(problem("settings", line) for line in str(error).splitlines()), *_machine(None)]
    results = [ok("settings", "All are known and valid."), *_optional(settings)]
    for check in (_database, _migrating_role, _store, check_public_address, _traces):
        results += [result async for result in check(settings)]
    results += await asyncio.to_thread(lambda: [*_mail(settings), _reader(settings), *_machine(settings)])
    return results


def _optional(settings: Settings) -> Iterator[Diagnostic]:
    if settings.audit_archive is not None:
        folder = settings.audit_archive
        is_writable = folder.is_dir() and os.access(folder, os.W_OK | os.X_OK)
        remedy = "KLEINKRAM_AUDIT_ARCHIVE needs a folder to which the worker may write."
        yield judge("audit archive", is_writable, f"{folder}.", remedy)
    host = urlsplit(settings.public_url).hostname
    if not is_local(host) and not settings.public_url.startswith("https://"):
        yield warning("public address", f"{settings.public_url} is not encrypted.", "Serve it by https.")


async def _database(settings: Settings) -> AsyncIterator[Diagnostic]:
    """Check the database as the role that serves."""
    try:
        row = await _query(_Server, settings.database_url, _ABOUT_SERVER)
    except psycopg.Error as error:
        remedy = "Correct KLEINKRAM_DATABASE_URL or KLEINKRAM_DATABASE_PASSWORD, or start it."
        yield problem("database", f"It cannot be used: {_first_line(error)}.", remedy)
        return
    is_new_enough = row.version_number >= _OLDEST_POSTGRES
    yield judge("database", is_new_enough, f"PostgreSQL {row.version}.", "Version 15 or later is needed.")
    remedy = "Create a new database with ENCODING 'UTF8'."
    yield judge("encoding", row.encoding == "UTF8", f"{row.encoding}.", remedy)
    availability = "Available." if row.has_trgm else "Not there."
    yield judge("extension pg_trgm", row.has_trgm, availability, "Install PostgreSQL's contrib package.")
    ahead = row.now - datetime.datetime.now(datetime.timezone.utc)
    yield check_clock("clock of the database", ahead.total_seconds())
    yield _connections(settings, row.max_connections)
    yield _serving_role(settings, row)
    if row.unreadable_tables:
        message = f"It may not read these tables: {row.unreadable_tables}."
        yield problem("rights of the serving role", message, _GRANT_AGAIN)
        return
    database = open_database(settings)
    try:
        async with database.begin() as db:
            results = await check_schema(db)
    finally:
        await database.close()
    for result in results:
        yield result
    if not find_problems(results):
        rights = await _query(_Rights, settings.database_url, _ABOUT_RIGHTS)
        yield _rights_of_role(rights)
        yield _retention(settings, rights.audit_days)


def _connections(settings: Settings, allowed: int) -> Diagnostic:
    needed = 2 * settings.database_connections + _OTHER_CONNECTIONS
    message = f"PostgreSQL allows {allowed}; an API process and a worker use up to {needed}."
    remedy = "Raise max_connections, or lower KLEINKRAM_DATABASE_CONNECTIONS."
    return judge("connections", allowed > needed, message, remedy, otherwise=DiagnosticSeverity.warning)


def _serving_role(settings: Settings, row: _Server) -> Diagnostic:
    check = "serving role"
    if row.role != settings.serving_role:
        return problem(
            check,
            f"It is {row.role}, but migrations grant rights to {settings.serving_role}.",
            "Set KLEINKRAM_SERVING_ROLE to the user in KLEINKRAM_DATABASE_URL, then migrate.",
        )
    if row.is_superuser or row.can_create:
        message = f"{row.role} may change the schema, and so the audit log."
        return problem(check, message, "Serve with a role that owns nothing: see docs/running.md.")
    return ok(check, f"{row.role} cannot change the schema.")


def _rights_of_role(rights: _Rights) -> Diagnostic:
    check = "rights of the serving role"
    if rights.alters:
        return problem(check, "It may alter the audit log.", "REVOKE UPDATE and DELETE on audit_event from it.")
    if not (rights.writes and rights.appends):
        missing = "add to the audit log" if rights.writes else "read and write all tables"
        return problem(check, f"It may not {missing}.", _GRANT_AGAIN)
    return ok(check, "It reads and writes, and adds to the audit log.")


def _retention(settings: Settings, stored_days: int) -> Diagnostic:
    message = f"Events are kept for {stored_days} days." if stored_days else "Events are kept forever."
    remedy = "Run `migrate`: it stores KLEINKRAM_AUDIT_DAYS, which differs."
    return judge("audit log", stored_days == settings.audit_days, message, remedy, otherwise=DiagnosticSeverity.warning)


async def _migrating_role(settings: Settings) -> AsyncIterator[Diagnostic]:
    check = "migrating role"
    if settings.migration_database_url is None:
        yield warning(check, "Not checked.", "`migrate` needs KLEINKRAM_MIGRATION_DATABASE_URL; nothing else does.")
        return
    try:
        row = await _query(_Server, settings.migration_database_url, _ABOUT_SERVER)
        served = await _query(_Server, settings.database_url, _ABOUT_SERVER)
    except psycopg.Error as error:
        yield problem(check, f"It cannot be used: {_first_line(error)}.", _CORRECT_MIGRATION)
        return
    if row.database != served.database:
        message = f"It migrates {row.database}, but {served.database} is served."
        yield problem(check, message, "Let both addresses name one database.")
    elif row.other_owner:
        message = f"{row.role} cannot change the tables, which {row.other_owner} owns."
        yield problem(check, message, f"Migrate as {row.other_owner}, or REASSIGN OWNED BY it TO {row.role}.")
    else:
        message = f"{row.role} may {'' if row.can_create else 'not '}create tables."
        yield judge(check, row.can_create, message, f"Let {row.role} own the database.")


async def _store(settings: Settings) -> AsyncIterator[Diagnostic]:
    """Check the bucket by doing what uploads, downloads and scrubs do, with small objects."""
    async with open_storage(settings) as storage:
        try:
            await storage.check()
        except StoreUnavailable as error:
            remedy = "Start it, or correct the settings KLEINKRAM_S3_…: see docs/running.md, what it needs."
            yield problem("store", f"{settings.s3_internal_url}: {error.reason}.", remedy)
            return
        yield ok("store", f"The bucket {settings.s3_bucket} is there.")
        yield check_clock("clock of the store", storage.clock_offset_s)
        for right, attempt in _store_rights(storage):
            yield await _try_right(right, attempt)
        try:
            abilities = await probe(storage)
        except (StoreUnavailable, StoreRefused) as error:
            yield problem("checksums of the store", f"{error}")
        else:
            yield ok("checksums of the store", f"It verifies {abilities.checksum.value}.")
        async for result in check_public_store(settings, storage):
            yield result
        if await configure_cors(storage, settings):
            yield ok("CORS rules", "Pages of this server may send to the store.")
        else:
            yield warning("CORS rules", "Browsers cannot upload or preview.", "See docs/running.md, browsers.")


def _store_rights(storage: Storage) -> Iterator[tuple[str, Callable[[], Awaitable[object]]]]:
    key = f"probe/{uuid.uuid4()}"

    async def read() -> None:
        async for _ in storage.read(key):
            pass

    async def multipart() -> None:
        await storage.abort_multipart(key, await storage.create_multipart(key))

    yield "s3:PutObject", lambda: storage.put_object(key, b"check")
    yield "s3:GetObject", read
    yield "s3:ListBucket", lambda: storage.sizes(key)
    yield "s3:AbortMultipartUpload", multipart
    yield "s3:ListBucketMultipartUploads", lambda: storage.list_multiparts(key)
    yield "s3:DeleteObject", lambda: storage.delete(key)


async def _try_right(right: str, attempt: Callable[[], Awaitable[object]]) -> Diagnostic:
    try:
        await attempt()
    except (StoreUnavailable, StoreRefused, FileNotFoundError) as error:
        reason = error.reason if isinstance(error, StoreUnavailable) else str(error)
        return problem(f"right {right}", f"Refused: {reason}.", "Grant it to the access key on this bucket.")
    return ok(f"right {right}", "Granted.")


async def _traces(_settings: Settings) -> AsyncIterator[Diagnostic]:
    """Send a collector no spans, if the environment names one."""
    check, url = "traces", traces.endpoint()
    if url is None:
        return
    if (reason := traces.misconfiguration()) is not None:
        yield warning(check, f"None are exported: {reason}.", "Correct the variables of OpenTelemetry, or unset them.")
        return
    host = urlsplit(url).hostname  # the address may hold a password
    try:
        async with (
            aiohttp.ClientSession(timeout=_TIMEOUT) as session,
            session.post(url, headers={"Content-Type": "application/x-protobuf"}, allow_redirects=False) as response,
        ):
            status = response.status
    except (aiohttp.ClientError, asyncio.TimeoutError, OSError, ValueError) as error:
        message = f"The collector at {host} cannot be reached ({type(error).__name__})."
        yield warning(check, message, "Start it, or correct OTEL_EXPORTER_OTLP_ENDPOINT.")
        return
    # It may want the headers of `OTEL_EXPORTER_OTLP_HEADERS`, which are the exporter's.
    is_there = status < 300 or status in {401, 403}
    message, remedy = (
        f"The collector at {host} answers {status}.",
        "Set OTEL_EXPORTER_OTLP_ENDPOINT to its address for OTLP over HTTP.",
    )
    yield judge(check, is_there, message, remedy, otherwise=DiagnosticSeverity.warning)


def _mail(settings: Settings) -> Iterator[Diagnostic]:
    """Sign in to the mail server, without sending anything."""
    if settings.smtp_host is None:
        return
    try:
        with open_mail_server(settings):
            yield ok("mail server", f"{settings.smtp_host} accepts mail from this server.")
    except MailNotSent as error:
        yield problem("mail server", str(error), "Correct the settings KLEINKRAM_SMTP_….")


def _reader(settings: Settings) -> Diagnostic:
    """Read a small recording as workers do: in a child process, within its limits."""
    memory_bytes = settings.summary_memory_bytes
    with tempfile.TemporaryDirectory() as folder:
        sample = Path(folder) / "sample.tum"
        sample.write_text(_SAMPLE)
        try:
            summarise_isolated(FileRequest(str(sample)), memory_bytes=memory_bytes, timeout_s=_READER_TIMEOUT_S)
        except (SummaryFailed, OSError) as error:
            remedy = f"This user must be able to run {sys.executable}, with KLEINKRAM_SUMMARY_MEMORY_BYTES of memory."
            return problem("reader", f"The process that reads recordings fails: {error}.", remedy)
    return ok("reader", "It reads a recording within its limits.")


def _machine(settings: Settings | None) -> Iterator[Diagnostic]:
    folder = Path(tempfile.gettempdir())
    yield check_disk("temporary files", folder, "Free some.", otherwise=DiagnosticSeverity.warning)
    if settings is not None:
        yield from _disk_of_store(settings.store_folder)
        yield _metrics(settings)
    _, files = resource.getrlimit(resource.RLIMIT_NOFILE)  # the API raises the soft limit to the hard one
    is_unlimited = files == resource.RLIM_INFINITY
    remedy = f"Raise the hard limit to {_MIN_OPEN_FILES} (`ulimit -Hn`, or LimitNOFILE= of a unit)."
    message = f"The API may have {'any number' if is_unlimited else files} at a time."
    is_enough = is_unlimited or files >= _MIN_OPEN_FILES
    yield judge("open files", is_enough, message, remedy, otherwise=DiagnosticSeverity.warning)


def _disk_of_store(folder: Path | None) -> Iterator[Diagnostic]:
    check = "disk of the store"
    if folder is not None and not folder.is_dir():
        yield problem(check, f"{folder} is no folder.", "Mount it, or correct KLEINKRAM_STORE_FOLDER.")
    elif folder is not None:
        yield check_disk(check, folder, "Free some.", otherwise=DiagnosticSeverity.warning)


def _metrics(settings: Settings) -> Diagnostic:
    check, address = "metrics", settings.metrics_address
    if settings.metrics_port is None:
        remedy = "Set KLEINKRAM_METRICS_PORT, a different one for each process."
        return warning(check, "They are not served.", remedy)
    try:
        family, *_, place = socket.getaddrinfo(address, 0, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, socket.SOCK_STREAM) as listener:
            listener.bind(place)
    except OSError as error:
        message = f"This machine has no address {address} ({error.strerror})."
        return problem(check, message, "Correct KLEINKRAM_METRICS_ADDRESS.")
    return ok(check, f"Each process can serve them at {address}.")


async def _query(kind: type[T], url: PostgresDsn, statement: LiteralString) -> T:
    async with await psycopg.AsyncConnection.connect(plain_dsn(url), connect_timeout=5, autocommit=True) as connection:
        cursor = connection.cursor(row_factory=class_row(kind))
        await cursor.execute(statement)
        return await anext(aiter(cursor))


def _first_line(error: BaseException) -> str:
    return str(error).strip().partition("\n")[0]
