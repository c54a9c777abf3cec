"""`python -m kleinkram.server check`: looks at all that a server needs, and says what is wrong and how to mend it.

Deletes the objects that it writes into the bucket. Writes the bucket's CORS rules, as the API does when it starts,
unless KLEINKRAM_S3_CORS says otherwise. Never prints a secret.
"""

import asyncio
import datetime
import enum
import json
import resource
import shutil
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
from pydantic import PostgresDsn, ValidationError
from typing_extensions import LiteralString

from kleinkram.contract.errors import StoreUnavailable
from kleinkram.recordings import SummaryFailed
from kleinkram.recordings.isolation import FileRequest, summarise_isolated
from kleinkram.server.db import Database, open_database
from kleinkram.server.environment import SettingsInvalid, load_settings
from kleinkram.server.health.readiness import find_workers
from kleinkram.server.http.headers import CHECK_HEADER, Seen, proof
from kleinkram.server.logs import quiet_libraries
from kleinkram.server.migrations import schema_problem
from kleinkram.server.s3.capabilities import configure_cors, probe
from kleinkram.server.s3.storage import Storage, StoreRefused, open_storage
from kleinkram.server.settings import Settings, plain_dsn

T = TypeVar("T")
_OLDEST_POSTGRES = 150_000
_WORST_SKEW_S = 60.0
_LOW_BYTES = 2 * 1024**3
_MIN_OPEN_FILES = 4096
_TIMEOUT = aiohttp.ClientTimeout(total=15)
# Three poses of a trajectory: what a child process needs to do to read it is what it needs for any recording.
_SAMPLE = "".join(f"{second}.0 0 0 0 0 0 0 1\n" for second in range(3))


class Level(str, enum.Enum):
    """Severity of a check result: the server runs with warnings."""

    ok = "ok"
    warning = "warning"
    problem = "problem"


@dataclass(frozen=True)
class CheckResult:
    """Result of one check. `remedy`: how to correct a fault."""

    check: str
    level: Level
    message: str
    remedy: str = ""


def main(*, as_json: bool) -> int:
    """Run all checks and print what they found; returns 1 where there is a problem, else 0."""
    quiet_libraries()
    results = asyncio.run(_collect())
    is_ok = all(result.level is not Level.problem for result in results)
    if as_json:
        checks = [{**vars(result), "level": result.level.value} for result in results]
        sys.stdout.write(json.dumps({"ok": is_ok, "checks": checks}, indent=2) + "\n")
    else:
        sys.stdout.writelines(_line(result) + "\n" for result in results)
    return 0 if is_ok else 1


def _line(result: CheckResult) -> str:
    mark = {"ok": "ok     ", "warning": "WARNING", "problem": "PROBLEM"}[result.level.value]
    return f"{mark} {result.check}: {result.message} {result.remedy}".rstrip()


async def _collect() -> list[CheckResult]:
    try:
        settings = load_settings()
    except SettingsInvalid as error:
        lines = str(error).splitlines()
        return [*(_problem("settings", result, "") for result in lines), *_machine(None)]
    results = [_ok("settings", "All are known and valid."), *_optional(settings)]
    for check in (_database, _migrating_role, _store, _public_url):
        results += [result async for result in check(settings)]
    results += await asyncio.to_thread(lambda: [*_reader(settings), *_machine(settings)])
    return results


def _optional(settings: Settings) -> Iterator[CheckResult]:
    if settings.metrics_port is None:
        yield _warning("metrics", "They are not served.", "Set KLEINKRAM_METRICS_PORT, another one for result process.")
    host = urlsplit(settings.public_url).hostname
    if not _is_here(host) and not settings.public_url.startswith("https://"):
        yield _warning("public address", f"{settings.public_url} is not encrypted.", "Serve it by https.")


async def _database(settings: Settings) -> AsyncIterator[CheckResult]:
    """Look at the database as the role that serves."""
    try:
        row = await _ask(_Server, settings.database_url, _ABOUT_SERVER)
    except psycopg.Error as error:
        yield _problem(
            "database", f"It cannot be used: {_first_line(error)}.", "Correct KLEINKRAM_DATABASE_URL, or start it."
        )
        return
    new_enough = row.version_number >= _OLDEST_POSTGRES
    yield _judged("database", new_enough, f"PostgreSQL {row.version}.", "Version 15 or later is needed.")
    yield _judged(
        "encoding", row.encoding == "UTF8", f"{row.encoding}.", "Create the database anew with ENCODING 'UTF8'."
    )
    yield _judged(
        "extension pg_trgm",
        row.has_trgm,
        "Available." if row.has_trgm else "Not there.",
        "Install PostgreSQL's contrib package.",
    )
    yield _clock("clock of the database", (row.now - datetime.datetime.now(datetime.timezone.utc)).total_seconds())
    yield _serving_role(settings, row)
    database = open_database(settings)
    try:
        async for result in _schema(settings, database):
            yield result
    finally:
        await database.close()


def _serving_role(settings: Settings, row: "_Server") -> CheckResult:
    check = "serving role"
    if row.role != settings.serving_role:
        return _problem(
            check,
            f"It is {row.role}, but migrations grant rights to {settings.serving_role}.",
            "Set KLEINKRAM_SERVING_ROLE to the user in KLEINKRAM_DATABASE_URL, then migrate.",
        )
    if row.is_superuser or row.can_create:
        return _problem(
            check,
            f"{row.role} may change the schema, and so the audit record.",
            "Serve with a role that owns nothing: see docs/running.md.",
        )
    return _ok(check, f"{row.role} cannot change the schema.")


async def _schema(settings: Settings, database: Database) -> AsyncIterator[CheckResult]:
    async with database.begin() as db:
        problem = await schema_problem(db)
        workers = None if problem else await find_workers(db)
    if problem is not None or workers is None:
        yield _problem("schema", f"{problem}.", "Run `python -m kleinkram.server migrate` of this version.")
        return
    yield _ok("schema", "This program works on it.")
    rights = await _ask(_Rights, settings.database_url, _ABOUT_RIGHTS)
    yield _rights_of_role(rights)
    if workers.warning:
        yield _warning("workers", f"{workers.warning}.", "")
    else:
        yield _ok("workers", f"{len(workers.seen_at)} alive.")


def _rights_of_role(rights: "_Rights") -> CheckResult:
    check = "rights of the serving role"
    if rights.alters:
        return _problem(check, "It may alter the audit record.", "REVOKE UPDATE and DELETE on audit_event from it.")
    if not (rights.writes and rights.records):
        missing = "add to the audit record" if rights.writes else "read and write all tables"
        return _problem(
            check,
            f"It may not {missing}.",
            "Migrations grant that: GRANT again what was revoked by hand (see docs/running.md).",
        )
    return _ok(check, "It reads and writes, and adds to the audit record.")


async def _migrating_role(settings: Settings) -> AsyncIterator[CheckResult]:
    check = "migrating role"
    if settings.migration_database_url is None:
        yield _warning(check, "Not checked.", "`migrate` needs KLEINKRAM_MIGRATION_DATABASE_URL; nothing else does.")
        return
    try:
        row = await _ask(_Server, settings.migration_database_url, _ABOUT_SERVER)
        here = await _ask(_Server, settings.database_url, _ABOUT_SERVER)
    except psycopg.Error as error:
        yield _problem(check, f"It cannot be used: {_first_line(error)}.", "Correct KLEINKRAM_MIGRATION_DATABASE_URL.")
        return
    if row.database != here.database:
        yield _problem(
            check,
            f"It migrates {row.database}, but {here.database} is served.",
            "Let both addresses name one database.",
        )
    else:
        yield _judged(check, row.can_create, f"{row.role}.", f"Let {row.role} own the database.")


async def _store(settings: Settings) -> AsyncIterator[CheckResult]:
    """Look at the bucket by doing what uploads, downloads and scrubs do, with small objects."""
    async with open_storage(settings) as storage:
        try:
            await storage.check()
        except StoreUnavailable as error:
            yield _problem("store", f"{error.reason}.", "See docs/running.md, what it needs.")
            return
        yield _ok("store", f"The bucket {settings.s3_bucket} is there.")
        yield _clock("clock of the store", storage.clock_offset_s)
        for right, attempt in _rights(storage):
            yield await _tried(right, attempt)
        try:
            abilities = await probe(storage)
        except (StoreUnavailable, StoreRefused) as error:
            yield _problem("proof by the store", f"{error}", "")
        else:
            yield _ok("proof by the store", f"It verifies {abilities.checksum.value}.")
        may_send = await configure_cors(storage, settings)
        message = "Pages of this server may send to the store." if may_send else "Browsers cannot upload or preview."
        remedy = "See docs/running.md, browsers." if not may_send else ""
        yield CheckResult("CORS rules", Level.ok if may_send else Level.warning, message, remedy)


def _rights(storage: Storage) -> "Iterator[tuple[str, Callable[[], Awaitable[object]]]]":
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


async def _tried(right: str, attempt: Callable[[], Awaitable[object]]) -> CheckResult:
    try:
        await attempt()
    except (StoreUnavailable, StoreRefused, FileNotFoundError) as error:
        reason = error.reason if isinstance(error, StoreUnavailable) else str(error)
        return _problem(f"right {right}", f"Refused: {reason}.", "Grant it to the access key on this bucket.")
    return _ok(f"right {right}", "Granted.")


async def _public_url(settings: Settings) -> AsyncIterator[CheckResult]:
    """Ask the public address as clients do, and have the API say how the request reached it."""
    check, url = "public address", settings.public_url.rstrip("/")
    try:
        async with aiohttp.ClientSession(timeout=_TIMEOUT) as session:
            live = await _get(session, f"{url}/health/live", proof(settings))
            metrics = await _get(session, f"{url}/metrics")
            store = await _get(session, settings.store_public_url)
    except (aiohttp.ClientError, asyncio.TimeoutError, OSError) as error:
        where = f"{url} or the store's address {settings.store_public_url}"
        yield _warning(
            check, f"{where} cannot be reached from here ({type(error).__name__}).", "Start the API and the proxy."
        )
        return
    if live[0] != 200:
        yield _problem(check, f"{url}/health/live answers {live[0]}.", "Let the proxy pass it on to the API.")
        return
    yield _ok(check, f"The API answers at {url}, the store at {settings.store_public_url} ({store[0]}).")
    yield _judged(
        "metrics not public",
        not (metrics[0] == 200 and "kleinkram_" in metrics[1]),
        "They are not served at the public address.",
        "They are: let the proxy answer 404 for /metrics.",
    )
    try:
        seen = Seen.model_validate_json(live[1])
    except ValidationError:
        yield _warning("proxy headers", "Not checked: the API has other settings, or is of another version.", "")
        return
    yield _proxy(settings, seen)


def _proxy(settings: Settings, seen: Seen) -> CheckResult:
    check = "proxy headers"
    is_https = settings.public_url.startswith("https://")
    if seen.forwarded and not seen.is_trusted:
        return _problem(
            check,
            f"The API does not trust the proxy at {seen.peer}: all people look like one address.",
            f"Set KLEINKRAM_TRUSTED_PROXIES={seen.peer}, or to the proxy's network.",
        )
    if not seen.forwarded and not _is_here(urlsplit(settings.public_url).hostname) and _is_here(seen.peer):
        return _problem(
            check,
            "The proxy does not send X-Forwarded-For: all people look like this machine.",
            "Let it, and set KLEINKRAM_TRUSTED_PROXIES: see docs/running.md.",
        )
    if is_https and seen.scheme != "https":
        return _problem(check, "The API takes https for http.", "Let the proxy send X-Forwarded-Proto.")
    return _ok(check, f"The API sees requests from here as {seen.address}, by {seen.scheme}.")


def _reader(settings: Settings) -> Iterator[CheckResult]:
    """Read a small recording as workers do: in a child process, within its limits."""
    check = "reader"
    with tempfile.TemporaryDirectory() as folder:
        sample = Path(folder) / "sample.tum"
        sample.write_text(_SAMPLE)
        try:
            summarise_isolated(
                FileRequest(str(sample)), memory_bytes=settings.summary_memory_bytes, timeout_s=_READER_WITHIN_S
            )
        except (SummaryFailed, OSError) as error:
            yield _problem(
                check,
                f"The process that reads recordings fails: {error}.",
                f"This user must be able to run {sys.executable}, with KLEINKRAM_SUMMARY_MEMORY_BYTES of memory.",
            )
            return
    yield _ok(check, "It reads a recording within its limits.")


def _machine(settings: Settings | None) -> Iterator[CheckResult]:
    folders = {"temporary files": Path(tempfile.gettempdir())}
    if settings is not None and settings.store_folder is not None:
        folders["disk of the store"] = settings.store_folder
    for check, folder in folders.items():
        try:
            free = shutil.disk_usage(folder).free
        except OSError as error:
            yield _problem(check, f"{folder} cannot be used ({error.strerror}).", "Create it, or set another one.")
            continue
        level = Level.ok if free >= _LOW_BYTES else Level.warning
        yield CheckResult(
            check, level, f"{free / 1e9:.1f} GB free in {folder}.", "" if level is Level.ok else "Free some."
        )
    _, files = resource.getrlimit(resource.RLIMIT_NOFILE)  # the API raises the soft limit to the hard one
    enough = files == resource.RLIM_INFINITY or files >= _MIN_OPEN_FILES
    level = Level.ok if enough else Level.warning
    remedy = "" if enough else f"Raise the hard limit to {_MIN_OPEN_FILES} (`ulimit -Hn`, or LimitNOFILE= of a unit)."
    yield CheckResult(
        "open files",
        level,
        f"The API may have {'any number' if files == resource.RLIM_INFINITY else files} at a time.",
        remedy,
    )


@dataclass(frozen=True)
class _Server:
    """Row of `_ABOUT_SERVER`: facts about the server and the current role."""

    version: str
    version_number: int
    encoding: str
    has_trgm: bool
    now: datetime.datetime
    role: str
    database: str
    is_superuser: bool
    can_create: bool


@dataclass(frozen=True)
class _Rights:
    """Row of `_ABOUT_RIGHTS`: whether a role can change missions, and append to and change the audit log."""

    writes: bool
    records: bool
    alters: bool


_READER_WITHIN_S = 60
_ABOUT_SERVER = """
SELECT current_setting('server_version') AS version, current_setting('server_version_num')::int AS version_number,
  current_setting('server_encoding') AS encoding, clock_timestamp() AS now, current_user::text AS role,
  current_database()::text AS database,
  EXISTS (SELECT 1 FROM pg_available_extensions WHERE name = 'pg_trgm') AS has_trgm,
  (SELECT rolsuper FROM pg_roles WHERE rolname = current_user) AS is_superuser,
  has_schema_privilege('public', 'CREATE') AS can_create
"""
_ABOUT_RIGHTS = """
SELECT has_table_privilege('mission', 'SELECT') AND has_table_privilege('mission', 'INSERT')
    AND has_table_privilege('mission', 'UPDATE') AS writes,
  has_table_privilege('audit_event', 'INSERT') AS records,
  has_table_privilege('audit_event', 'UPDATE') OR has_table_privilege('audit_event', 'DELETE') AS alters
"""


async def _ask(kind: type[T], url: PostgresDsn, statement: LiteralString) -> T:
    async with await psycopg.AsyncConnection.connect(plain_dsn(url), connect_timeout=5, autocommit=True) as connection:
        cursor = connection.cursor(row_factory=class_row(kind))
        await cursor.execute(statement)
        return await anext(aiter(cursor))


async def _get(session: aiohttp.ClientSession, url: str, proof_of_settings: str | None = None) -> tuple[int, str]:
    headers = {} if proof_of_settings is None else {CHECK_HEADER: proof_of_settings}
    async with session.get(url, headers=headers, allow_redirects=False) as response:
        return response.status, (await response.content.read(65_536)).decode(errors="replace")


def _is_here(host: str | None) -> bool:
    return host in {"localhost", "127.0.0.1", "::1"}


def _clock(check: str, ahead_s: float) -> CheckResult:
    message = f"It differs from this machine's by {abs(ahead_s):.0f} s."
    return _judged(check, abs(ahead_s) <= _WORST_SKEW_S, message, "Let both machines set their clocks (NTP).")


def _first_line(error: BaseException) -> str:
    return str(error).strip().partition("\n")[0]


def _ok(check: str, message: str) -> CheckResult:
    return CheckResult(check, Level.ok, message)


def _warning(check: str, message: str, remedy: str) -> CheckResult:
    return CheckResult(check, Level.warning, message, remedy)


def _problem(check: str, message: str, remedy: str) -> CheckResult:
    return CheckResult(check, Level.problem, message, remedy)


def _judged(check: str, is_ok: bool, message: str, remedy: str) -> CheckResult:
    return _ok(check, message) if is_ok else _problem(check, message, remedy)
