"""`python -m kleinkram.server.backup REQUEST`: one command on backups.

REQUEST is JSON without secrets, which come by the environment. Writes the result to stdout, failures to stderr, and
ends with the CLI's exit codes. `klein backup` and `klein restore` become this process.
"""

import json
import os
import sys
from datetime import datetime, timezone
from pathlib import Path
from typing import Literal, NoReturn

from pydantic import BaseModel, ConfigDict

from kleinkram.contract.units import format_size
from kleinkram.failures import code_of, failure_line
from kleinkram.server.backup import operations
from kleinkram.server.backup.errors import BackupDamaged, BackupError, BackupRequestInvalid
from kleinkram.server.backup.operations import Messages
from kleinkram.server.backup.rclone import Rclone
from kleinkram.server.backup.repository import Repository, Snapshot, make_repository, open_repository
from kleinkram.server.backup.saved_rows import RestoreSelection
from kleinkram.server.backup.selective import restore_selection
from kleinkram.server.environment import SettingsInvalid, load_settings
from kleinkram.server.settings import Settings

_INTERRUPTED = 130
_DAMAGED = BackupDamaged.exit_code
_MAX_SHOWN = 20


class BackupRequest(BaseModel):
    """A command and its options."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    command: Literal["create", "list", "verify", "prune", "restore"]
    location: str
    passphrase_file: Path | None = None
    as_json: bool = False
    encrypt: bool = False
    snapshot_id: str | None = None
    read_all: bool = False
    keep: int = 0
    bytes_per_s: float | None = None
    connections: int = 8
    project: str | None = None
    mission: str | None = None
    file: str | None = None
    dry_run: bool = False

    def selection(self) -> RestoreSelection | None:
        """Return what to restore into the running instance; None for everything, into an empty one."""
        if self.project is not None:
            return RestoreSelection(self.project, self.mission, self.file)
        if self.mission is not None or self.file is not None or self.dry_run:
            raise BackupRequestInvalid("Name the project, too: a restore without one is of the whole instance.")
        return None

    def repository(self) -> Repository:
        """Open the backups in the location; `create` begins them there."""
        rclone = Rclone({}, self.connections, self.bytes_per_s)
        if self.command == "create":
            return make_repository(self.location, self._passphrase(), rclone, encrypt=self.encrypt)
        return open_repository(self.location, self._passphrase(), rclone)

    def show_progress(self, line: str) -> None:
        """Show progress on stderr, in one line on a terminal."""
        if not self.as_json:
            sys.stderr.write(f"\r\033[K{self.command}: {line}" if sys.stderr.isatty() else f"{self.command}: {line}\n")
            sys.stderr.flush()

    def _passphrase(self) -> str | None:
        path = self.passphrase_file or os.environ.get("KLEINKRAM_BACKUP_PASSPHRASE_FILE")
        if path is None:
            return os.environ.get("KLEINKRAM_BACKUP_PASSPHRASE") or None
        try:
            lines = Path(path).read_text(encoding="utf-8").splitlines()
        except (OSError, UnicodeDecodeError) as error:
            raise BackupRequestInvalid(f"The passphrase file {path} cannot be read: {error}") from None
        if not lines or not lines[0]:
            raise BackupRequestInvalid(f"The passphrase file {path} is empty: its first line is the passphrase.")
        return lines[0]


def main() -> None:
    """Carry out the request."""
    request = BackupRequest.model_validate_json(sys.argv[1])
    commands = {"create": _create, "list": _list, "verify": _verify, "prune": _prune, "restore": _restore}
    try:
        sys.exit(commands[request.command](request))
    except BackupError as error:
        _fail(request, str(error), code_of(error), error.exit_code)
    except KeyboardInterrupt:
        _fail(request, "Stopped. Run the same command again to continue.", "interrupted", _INTERRUPTED)


def _create(request: BackupRequest) -> int:
    settings, started_at = _settings(), datetime.now(timezone.utc)
    try:
        created = operations.create(settings, request.repository(), request.show_progress)
    except BackupError:
        _record_attempt(settings, started_at, None)
        raise
    snapshot, copied = created.snapshot, created.copied
    _record_attempt(settings, snapshot.created_at, snapshot)
    text = (
        f"Backup {snapshot.id}: {snapshot.objects} objects ({format_size(snapshot.object_bytes)}), of which "
        f"{copied.count} ({format_size(copied.bytes)}) were copied; {snapshot.rows} rows."
    )
    if snapshot.elsewhere:
        text += f"\n{snapshot.elsewhere} objects are in other stores than {snapshot.store_id}, and in no backup."
    result = {**_facts(snapshot), "elsewhere": snapshot.elsewhere, "copied": copied.count, "copied_bytes": copied.bytes}
    _print(request, {**result, "problems": created.problems.first}, text)
    return _print_problems(
        f"{snapshot.lost} objects could not be read from the store, and {snapshot.corrupt} differ from what was "
        "uploaded; all others are in the backup",
        created.problems,
    )


def _record_attempt(settings: Settings, started_at: datetime, snapshot: Snapshot | None) -> None:
    try:
        operations.record_attempt(settings, started_at, snapshot)
    except BackupError as error:
        _clear_progress()
        text = f"Warning: the metrics do not know of this attempt, because it could not be recorded: {error}"
        print(text, file=sys.stderr)  # noqa: T201  (this program's output)


def _list(request: BackupRequest) -> int:
    repository = request.repository()
    lines: list[str] = []
    results: list[dict[str, object]] = []
    is_damaged = False
    for snapshot_id in repository.snapshot_ids():
        try:
            snapshot = repository.snapshot(snapshot_id)
        except BackupDamaged as error:
            is_damaged = True
            results.append({"id": snapshot_id, "problem": str(error)})
            lines.append(f"{snapshot_id}  cannot be read: {error}")
            continue
        results.append(_facts(snapshot))
        bad = f", {snapshot.lost} lost, {snapshot.corrupt} corrupt" if snapshot.lost or snapshot.corrupt else ""
        lines.append(
            f"{snapshot_id}  {snapshot.created_at:%Y-%m-%d %H:%M} UTC  {snapshot.objects} objects, "
            f"{format_size(snapshot.object_bytes)}{bad}"
        )
    _print(request, results, "\n".join(lines) or "No complete backup yet.")
    return _DAMAGED if is_damaged else 0


def _verify(request: BackupRequest) -> int:
    result = operations.verify(
        request.repository(), request.snapshot_id, request.show_progress, read_all=request.read_all
    )
    depth = (
        f"{format_size(result.read_bytes)} read"
        if request.read_all
        else "by name and size; --read-all reads every byte"
    )
    text = f"{result.snapshots} backups, {result.objects} objects, {format_size(result.object_bytes)} ({depth})."
    if result.unused:
        text += f"\n{result.unused} objects ({format_size(result.unused_bytes)}) are in no complete backup."
    if result.lost_at_source:
        text += f"\n{result.lost_at_source} objects were lost before they were backed up."
    damage = result.damage
    text += "\nDamaged." if damage.count else "\nNo damage found."
    values = {**vars(result), "ok": not damage.count, "damaged": damage.count, "damage": damage.first}
    _print(request, values, text)
    return _print_problems(f"{damage.count} items are damaged", damage)


def _prune(request: BackupRequest) -> int:
    pruned = operations.prune(request.repository(), keep=request.keep)
    text = (
        f"Removed {len(pruned.removed)} backups and {pruned.removed_objects} objects "
        f"({format_size(pruned.removed_bytes)}); {len(pruned.remaining)} backups are kept."
    )
    _print(request, vars(pruned), text)
    return 0


def _restore(request: BackupRequest) -> int:
    if (selection := request.selection()) is not None:
        return _restore_selection(request, selection)
    restored = operations.restore(_settings(), request.repository(), request.snapshot_id, request.show_progress)
    snapshot, problems = restored.snapshot, Messages()
    for lost in restored.unavailable:
        problems.add(f"{lost.key}: {lost.state}: {lost.reason}")
    text = (
        f"Restored {snapshot.id}, the instance at {snapshot.created_at:%Y-%m-%d %H:%M:%S} UTC: {snapshot.objects} "
        f"objects, {format_size(snapshot.object_bytes)}; {snapshot.rows} rows."
    )
    _print(request, {**_facts(snapshot), "sent": restored.sent, "problems": problems.first}, text)
    return _print_problems(
        f"{problems.count} objects are lost or corrupt, and shown so; all others are there", problems
    )


def _restore_selection(request: BackupRequest, selection: RestoreSelection) -> int:
    restored = restore_selection(
        _settings(),
        request.repository(),
        request.snapshot_id,
        selection,
        request.show_progress,
        is_dry_run=request.dry_run,
    )
    snapshot = restored.snapshot
    verb = "Would restore" if request.dry_run else "Restored"
    lines = [
        f"{verb} from {snapshot.id}, the instance at {snapshot.created_at:%Y-%m-%d %H:%M:%S} UTC: files: "
        f"{restored.files} ({format_size(restored.file_bytes)}, of which {format_size(restored.copied_bytes)} copied); "
        f"repaired: {restored.repaired}; there already: {restored.present}.",
        *(f"Created: {name}" for name in restored.created),
        *(f"Other bytes are at {path}: restored as {new}" for path, new in [*restored.renamed.items()][:_MAX_SHOWN]),
    ]
    values = {name: value for name, value in vars(restored).items() if name not in {"snapshot", "unavailable"}}
    problems = restored.unavailable
    _print(request, {**_facts(snapshot), **values, "problems": problems.first}, "\n".join(lines))
    return _print_problems(f"{problems.count} files could not be restored", problems)


def _facts(snapshot: Snapshot) -> dict[str, object]:
    fields = {"id", "created_at", "kleinkram", "objects", "object_bytes", "rows", "lost", "corrupt"}
    return snapshot.model_dump(mode="json", include=fields)


def _settings() -> Settings:
    try:
        return load_settings()
    except SettingsInvalid as error:
        raise BackupRequestInvalid(
            f"Settings are missing: set them as for the server, or name the data directory of `klein up` with "
            f"--data-dir.\n{error}"
        ) from None


def _print(request: BackupRequest, result: object, text: str) -> None:
    _clear_progress()
    print(json.dumps(result, indent=2) if request.as_json else text)  # noqa: T201  (this program's output)


def _print_problems(text: str, problems: Messages) -> int:
    """Print problems, if there are any; return the exit code."""
    if not problems.count:
        return 0
    lines = [f"  {message}" for message in problems.first[:_MAX_SHOWN]]
    if problems.count > len(lines):
        lines.append(f"  and {problems.count - len(lines)} more (--json names up to {len(problems.first)})")
    print("\n".join([f"Error: {text}:", *lines]), file=sys.stderr)  # noqa: T201  (this program's output)
    return _DAMAGED


def _clear_progress() -> None:
    if sys.stderr.isatty():
        sys.stderr.write("\r\033[K")


def _fail(request: BackupRequest, text: str, code: str, exit_code: int) -> NoReturn:
    _clear_progress()
    print(failure_line(text, code=code, exit_code=exit_code, as_json=request.as_json), file=sys.stderr)  # noqa: T201
    sys.exit(exit_code)


if __name__ == "__main__":
    main()
