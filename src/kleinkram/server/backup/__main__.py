"""`python -m kleinkram.server.backup ORDER`: one command on backups, as a process of its own.

ORDER is JSON: the command and its options, without secrets, which come by the environment. Says what it did on stdout,
what went wrong on stderr, and ends with the CLI's exit codes. `klein backup` and `klein restore` become this process.
"""

import asyncio
import json
import os
import sys
from pathlib import Path
from typing import Annotated, Literal, NoReturn

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter

from kleinkram.failures import code_of, failure_line
from kleinkram.server.backup.creating import Making, create
from kleinkram.server.backup.failing import BackupError, CannotBeMeant, Damaged
from kleinkram.server.backup.forgetting import forget
from kleinkram.server.backup.locking import at_work
from kleinkram.server.backup.pace import amount
from kleinkram.server.backup.problems import MOST_KEPT, Problems
from kleinkram.server.backup.repository import open_place, open_repository
from kleinkram.server.backup.restoring import Wish, restore
from kleinkram.server.backup.verifying import Looking, verify
from kleinkram.server.environment import SettingsInvalid, load_settings
from kleinkram.server.settings import Settings

_INTERRUPTED = 130
_BYTES_DIFFER = Damaged.exit_code
_MOST_SHOWN = 20


class _Order(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    place: str
    passphrase_file: Path | None = None
    as_json: bool = False

    @property
    def passphrase(self) -> str | None:
        """The passphrase, of the file or the environment; None where none is given."""
        path = self.passphrase_file or os.environ.get("KLEINKRAM_BACKUP_PASSPHRASE_FILE")
        if path is None:
            return os.environ.get("KLEINKRAM_BACKUP_PASSPHRASE") or None
        try:
            lines = Path(path).read_text(encoding="utf-8").splitlines()
        except (OSError, UnicodeDecodeError) as error:
            raise CannotBeMeant(f"The passphrase file {path} cannot be read: {error}") from None
        if not lines or not lines[0]:
            raise CannotBeMeant(f"The passphrase file {path} is empty: its first line counts.")
        return lines[0]


class CreateOrder(_Order):
    """Make a backup."""

    command: Literal["create"]
    encrypt: bool = False
    bytes_per_s: float | None = None
    connections: int = 8


class ListOrder(_Order):
    """List the backups in a place."""

    command: Literal["list"]


class VerifyOrder(_Order):
    """Look at backups."""

    command: Literal["verify"]
    snapshot_id: str | None = None
    read_all: bool = False
    bytes_per_s: float | None = None
    connections: int = 8


class ForgetOrder(_Order):
    """Drop old backups."""

    command: Literal["forget"]
    keep: int


class RestoreOrder(_Order):
    """Fill an empty site."""

    command: Literal["restore"]
    snapshot_id: str | None = None
    bytes_per_s: float | None = None
    connections: int = 8


AnyOrder = Annotated[CreateOrder | ListOrder | VerifyOrder | ForgetOrder | RestoreOrder, Field(discriminator="command")]


def main() -> None:
    """Carry out the order."""
    order: AnyOrder = TypeAdapter(AnyOrder).validate_json(sys.argv[1])
    try:
        sys.exit(asyncio.run(_carry_out(order)))
    except BackupError as error:
        _fail(order, str(error), code_of(error), error.exit_code)
    except KeyboardInterrupt:
        _fail(order, "Stopped. Run the same command again to go on from here.", "interrupted", _INTERRUPTED)


def _fail(order: _Order, sentence: str, code: str, exit_code: int) -> NoReturn:
    told = failure_line(sentence, code=code, exit_code=exit_code, as_json=order.as_json)
    print(told, file=sys.stderr)  # noqa: T201  (the command's own voice, here and below)
    sys.exit(exit_code)


async def _carry_out(order: AnyOrder) -> int:
    if isinstance(order, CreateOrder):
        return await _create(order)
    if isinstance(order, ListOrder):
        return await _list(order)
    if isinstance(order, VerifyOrder):
        return await _verify(order)
    if isinstance(order, ForgetOrder):
        return await _forget(order)
    return await _restore(order)


async def _create(order: CreateOrder) -> int:
    making = Making(
        order.place, order.encrypt, order.passphrase, order.bytes_per_s, order.connections, quiet=order.as_json
    )
    made = await create(_settings(), making)
    snapshot, tally = made.snapshot, made.tally
    told = {
        "id": snapshot.id,
        "created_at": snapshot.created_at.isoformat(),
        "objects": tally.objects,
        "object_bytes": tally.object_bytes,
        "copied": tally.copied,
        "copied_bytes": tally.copied_bytes,
        "rows": sum(table.rows for table in snapshot.tables),
        "lost": tally.lost,
        "corrupt": tally.corrupt,
        "elsewhere": snapshot.elsewhere,
        "problems": tally.problems.first,
    }
    sentence = (
        f"Backup {snapshot.id}: {tally.objects} objects, {amount(tally.object_bytes)}, of which {tally.copied} were "
        f"new ({amount(tally.copied_bytes)}); {told['rows']} rows in {len(snapshot.tables)} tables."
    )
    if snapshot.elsewhere:
        sentence += (
            f"\n{snapshot.elsewhere} objects lie in other stores than {snapshot.store_id}: they are in no backup."
        )
    _say(order, told, sentence)
    _complain(
        f"{tally.lost} objects could not be read from the store, and {tally.corrupt} are not what was uploaded; "
        "all others are in the backup",
        tally.problems,
    )
    return _BYTES_DIFFER if tally.problems.count else 0


async def _list(order: ListOrder) -> int:
    lines: list[str] = []
    told: list[dict[str, object]] = []
    damaged = False
    async with open_place(order.place) as shelf, at_work(shelf, alone=False):
        repository = await open_repository(shelf, order.passphrase)
        for snapshot_id in await repository.snapshot_ids():
            try:
                snapshot = await repository.snapshot(snapshot_id)
            except Damaged as error:
                damaged = True
                told.append({"id": snapshot_id, "problem": str(error)})
                lines.append(f"{snapshot_id}  cannot be read: {error}")
                continue
            objects = snapshot.objects
            said = {"created_at": snapshot.created_at.isoformat(), "kleinkram": snapshot.kleinkram}
            told.append(
                {"id": snapshot_id, **said, "objects": objects.count, "object_bytes": objects.size_bytes}
                | {"lost": objects.lost, "corrupt": objects.corrupt}
            )
            bad = f", {objects.lost} lost, {objects.corrupt} corrupt" if objects.lost or objects.corrupt else ""
            lines.append(
                f"{snapshot_id}  {snapshot.created_at:%Y-%m-%d %H:%M} UTC  {objects.count} objects, "
                f"{amount(objects.size_bytes)}{bad}"
            )
    _say(order, told, "\n".join(lines) or "No whole backup yet.")
    return _BYTES_DIFFER if damaged else 0


async def _verify(order: VerifyOrder) -> int:
    looking = Looking(
        order.place,
        order.passphrase,
        order.snapshot_id,
        order.read_all,
        order.bytes_per_s,
        order.connections,
        quiet=order.as_json,
    )
    found = await verify(looking)
    depth = f"{amount(found.read_bytes)} read" if order.read_all else "by name and size; --read-all reads every byte"
    sentence = f"{found.snapshots} backups, {found.contents} contents, {amount(found.content_bytes)} ({depth})."
    if found.unused:
        sentence += f"\n{found.unused} contents ({amount(found.unused_bytes)}) are of no whole backup yet."
    if found.lost_at_source:
        sentence += f"\n{found.lost_at_source} objects were lost before they were backed up."
    sentence += "\nDamaged." if found.damage.count else "\nAll as it should be."
    told = {**vars(found), "damaged": found.damage.count, "damage": found.damage.first}
    _say(order, {**told, "ok": not found.damage.count}, sentence)
    _complain(f"{found.damage.count} things are damaged", found.damage)
    return _BYTES_DIFFER if found.damage.count else 0


async def _forget(order: ForgetOrder) -> int:
    done = await forget(order.place, order.passphrase, keep=order.keep)
    sentence = (
        f"Dropped {len(done.forgotten)} backups and {done.removed} contents ({amount(done.removed_bytes)}); "
        f"{len(done.kept)} backups stay."
    )
    _say(order, vars(done), sentence)
    return 0


async def _restore(order: RestoreOrder) -> int:
    wish = Wish(
        order.place,
        order.snapshot_id,
        order.passphrase,
        order.bytes_per_s,
        order.connections,
        quiet=order.as_json,
    )
    done = await restore(_settings(), wish)
    problems = Problems()
    for each in done.missing:
        problems.say(f"{each.key}: {each.state}: {each.reason}")
    told = {
        "id": done.snapshot.id,
        "created_at": done.snapshot.created_at.isoformat(),
        "objects": done.objects,
        "object_bytes": done.object_bytes,
        "sent": done.sent,
        "rows": sum(table.rows for table in done.snapshot.tables),
        "problems": problems.first,
    }
    sentence = (
        f"Restored {done.snapshot.id}, the site as of {done.snapshot.created_at:%Y-%m-%d %H:%M:%S} UTC: {done.objects} "
        f"objects, {amount(done.object_bytes)}; {told['rows']} rows."
    )
    _say(order, told, sentence)
    _complain(f"{problems.count} objects are lost or corrupt, and are shown so; all others are there", problems)
    return _BYTES_DIFFER if problems.count else 0


def _settings() -> Settings:
    try:
        return load_settings()
    except SettingsInvalid as error:
        raise CannotBeMeant(
            f"The site's settings are not all there: set them as for the server, or name the folder of a `klein up` by "
            f"--data-dir.\n{error}"
        ) from None


def _say(order: _Order, told: object, sentence: str) -> None:
    print(json.dumps(told, indent=2) if order.as_json else sentence)  # noqa: T201


def _complain(sentence: str, problems: Problems) -> None:
    if problems.count:
        shown = [f"  {each}" for each in problems.first[:_MOST_SHOWN]]
        more = [f"  and {problems.count - len(shown)} more (--json names up to {MOST_KEPT})"]
        more = more if problems.count > len(shown) else []
        print("\n".join([f"Error: {sentence}:", *shown, *more]), file=sys.stderr)  # noqa: T201


if __name__ == "__main__":
    main()
