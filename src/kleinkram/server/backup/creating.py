"""Making a backup: hold back the sweep, copy the database as of one moment, then the objects it names that are new.

In this order a named object is always there to be copied. The document that makes it a backup is written last; whatever
ended before, the next run copies only what is missing.
"""

import contextlib
import datetime
import secrets
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass

import psycopg

import kleinkram
from kleinkram.server.backup.copying import Copier, CopyCounts, Lister, side_by_side
from kleinkram.server.backup.dumping import WantedList, copy_table, facts, one_moment, sequences
from kleinkram.server.backup.failing import CannotWrite, InTheWay, Unreachable
from kleinkram.server.backup.hold import holding_back
from kleinkram.server.backup.locking import Presence, at_work
from kleinkram.server.backup.pace import Pace, amount, telling
from kleinkram.server.backup.repository import Repository, make_repository, open_place
from kleinkram.server.backup.shelf import Shelf
from kleinkram.server.backup.snapshot import Snapshot
from kleinkram.server.s3.storage import open_storage
from kleinkram.server.settings import Settings, plain_dsn


@dataclass(frozen=True)
class Making:
    """How a backup is to be made. `sealed`: with the passphrase, where there are none yet."""

    place: str
    sealed: bool
    passphrase: str | None
    bytes_per_s: float | None
    at_once: int
    quiet: bool


@dataclass(frozen=True)
class Made:
    """A backup that was made, and what it took."""

    snapshot: Snapshot
    tally: CopyCounts


async def create(settings: Settings, making: Making) -> Made:
    """Make a backup of the site that the settings name.

    Raises:
        BackupError: it could not be made; what was copied stays for the next one.
    """
    async with open_place(making.place) as shelf:
        await _begin(shelf, making)
        async with at_work(shelf, alone=False) as presence:
            repository = await make_repository(shelf, making.passphrase, sealed=making.sealed)
            try:
                with _room_for_list():
                    listed = WantedList()
                with contextlib.closing(listed) as wanted:
                    return await _create(settings, making, repository, wanted, presence)
            except psycopg.Error as error:
                reason = str(error).strip().partition("\n")[0]
                raise Unreachable(
                    f"The database would not go on ({reason}): run it again, what was copied stays."
                ) from error


async def _begin(shelf: Shelf, making: Making) -> None:
    """See that backups can be kept there, and that nothing is left of earlier runs; not while others are at work."""
    with contextlib.suppress(InTheWay):
        async with at_work(shelf, alone=True, begins=True):
            await make_repository(shelf, making.passphrase, sealed=making.sealed)
            await shelf.tidy()


async def _create(
    settings: Settings, making: Making, repository: Repository, wanted: WantedList, presence: Presence
) -> Made:
    dsn = plain_dsn(settings.migration_database_url or settings.database_url)
    tally = CopyCounts()

    def so_far() -> str:
        done = f"{tally.objects} of {wanted.count} objects, {amount(tally.object_bytes)} of {amount(wanted.size_bytes)}"
        return f"backup: {done}; copied {amount(tally.copied_bytes)}"

    async with holding_back(dsn) as hold, telling(so_far, quiet=making.quiet):
        async with one_moment(dsn) as connection:
            found = await facts(connection, settings.store_id)
            created_at = datetime.datetime.now(datetime.timezone.utc)
            with _room_for_list():
                await wanted.fill(connection, settings.store_id, with_logs="log_chunk" in found.tables)
            tables = [await copy_table(connection, repository, name, columns) for name, columns in found.tables.items()]
            counted = await sequences(connection)
        lister = Lister(repository, tally)
        async with open_storage(settings) as storage:
            copier = Copier(
                storage=storage,
                repository=repository,
                held=await repository.held(),
                pace=Pace(making.bytes_per_s),
                tally=tally,
                lister=lister,
                is_still_named=lambda key: _is_still_named(dsn, key),
                check=hold.check,
            )
            await side_by_side(wanted.groups(), copier.copy, making.at_once)
        await hold.confirm()
        await presence.confirm()
        snapshot = Snapshot(
            # In the order of their names backups are the oldest first, those of one second too.
            id=f"{created_at:%Y%m%dT%H%M%S%fZ}-{secrets.token_hex(3)}",
            created_at=created_at,
            ended_at=datetime.datetime.now(datetime.timezone.utc),
            kleinkram=kleinkram.__version__,
            postgres=found.postgres,
            revision=found.revision,
            store_id=settings.store_id,
            elsewhere=found.elsewhere,
            tables=tuple(tables),
            sequences=counted,
            objects=await lister.end(),
        )
        await repository.put_snapshot(snapshot)
    return Made(snapshot, tally)


@contextlib.contextmanager
def _room_for_list() -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise CannotWrite(
            f"{tempfile.gettempdir()} takes no temporary file ({error.strerror}): make room, or set TMPDIR."
        ) from error


async def _is_still_named(dsn: str, key: str) -> bool:
    async with await psycopg.AsyncConnection.connect(dsn, application_name="kleinkram backup") as connection:
        row = await (await connection.execute("SELECT FROM log_chunk WHERE key = %s", (key,))).fetchone()
    return row is not None
