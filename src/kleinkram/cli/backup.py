"""`klein backup`, `klein restore`: for whoever runs the server, on its machine. Parses, and becomes who does it.

Where no settings of a server are in the environment, and no folder is named, the instance of `klein up` is meant.
"""

import json
import os
import re
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

from kleinkram.cli.commands import Noun
from kleinkram.cli.options import AsJson, Connections, LimitRate
from kleinkram.cli.units import parse_rate
from kleinkram.cli.up import DataDirOption, resolve_data_dir
from kleinkram.client.errors import InvalidInput

app = Noun("Backups of a whole instance: create, list, verify, prune.")

_AT_ONCE = 8
_REMOTE = re.compile(r"s3://|[\w.+@-]+:")  # of rclone's configuration; a folder is made absolute

Place = Annotated[
    str,
    typer.Argument(
        metavar="PLACE",
        help="A folder, s3://bucket/folder (KLEINKRAM_BACKUP_S3_URL, _S3_ACCESS_KEY, _S3_SECRET_KEY), or REMOTE:PATH "
        "of rclone.",
        show_default=False,
    ),
]
PassphraseFile = Annotated[
    Path | None,
    typer.Option(
        "--passphrase-file",
        metavar="FILE",
        help="Its first line is the passphrase. Or KLEINKRAM_BACKUP_PASSPHRASE.",
        dir_okay=False,
    ),
]
SnapshotOption = Annotated[
    str | None, typer.Option("--snapshot", metavar="ID", help="Which backup, as `klein backup list` names it.")
]


@app.command()
def create(
    place: Place,
    data_dir: DataDirOption = None,
    encrypt: Annotated[
        bool, typer.Option("--encrypt", help="Encrypt with a passphrase. Decided at the first backup.")
    ] = False,
    passphrase_file: PassphraseFile = None,
    limit_rate: LimitRate = None,
    connections: Connections = _AT_ONCE,
    as_json: AsJson = False,
) -> None:
    """Back up database and files while the server runs. Only files that are new there are copied; resumes.

    Exit code 9: it was made, but some files were lost or corrupt in the store already; it says which.
    """
    pace = _pace(limit_rate, connections)
    _become(_request("create", place, passphrase_file, as_json, encrypt=encrypt, **pace), data_dir)


@app.command("list")
def list_(place: Place, passphrase_file: PassphraseFile = None, as_json: AsJson = False) -> None:
    """List the backups in a place, the oldest first."""
    _become_server(_request("list", place, passphrase_file, as_json))


@app.command()
def verify(
    place: Place,
    snapshot: SnapshotOption = None,
    read_all: Annotated[
        bool, typer.Option("--read-all", help="Read every byte and compare it with its SHA-256.")
    ] = False,
    passphrase_file: PassphraseFile = None,
    limit_rate: LimitRate = None,
    connections: Connections = _AT_ONCE,
    as_json: AsJson = False,
) -> None:
    """Say whether the backups are whole: by names and sizes, or with --read-all by every byte. Exit code 9 if not."""
    which = {"snapshot_id": snapshot, "read_all": read_all}
    _become_server(_request("verify", place, passphrase_file, as_json, **which, **_pace(limit_rate, connections)))


@app.command()
def prune(
    place: Place,
    keep: Annotated[int, typer.Option("--keep", metavar="N", min=1, help="How many backups, the latest, to keep.")],
    passphrase_file: PassphraseFile = None,
    as_json: AsJson = False,
) -> None:
    """Remove all backups but the latest, and the objects that only they name."""
    _become_server(_request("prune", place, passphrase_file, as_json, keep=keep))


def restore(
    place: Place,
    data_dir: DataDirOption = None,
    snapshot: SnapshotOption = None,
    passphrase_file: PassphraseFile = None,
    limit_rate: LimitRate = None,
    connections: Connections = _AT_ONCE,
    as_json: AsJson = False,
) -> None:
    """Restore a backup (the latest) into an empty site: a new folder, or an empty database and bucket. Resumes.

    Exit code 9: it was restored, but some files are lost or corrupt, and shown so; it says which.
    """
    pace = _pace(limit_rate, connections)
    _become(_request("restore", place, passphrase_file, as_json, snapshot_id=snapshot, **pace), data_dir)


def _pace(limit_rate: str | None, connections: int) -> dict[str, object]:
    return {"bytes_per_s": parse_rate(limit_rate), "connections": connections}


def _request(
    command: str, place: str, passphrase_file: Path | None, as_json: bool, **more: object
) -> dict[str, object]:
    # The process that does it has another working directory.
    where = place if _REMOTE.match(place) else str(Path(place).expanduser().resolve())
    file = str(passphrase_file.expanduser().resolve()) if passphrase_file else None
    return {"command": command, "place": where, "passphrase_file": file, "as_json": as_json, **more}


def _become(request: dict[str, object], data_dir: Path | None) -> None:
    if data_dir is None and "KLEINKRAM_DATABASE_URL" in os.environ:
        _become_server(request)
    _require_server()
    from kleinkram.standalone.backup import BackupTask

    _exec(BackupTask(str(resolve_data_dir(data_dir)), request, restores=request["command"] == "restore").command())


def _become_server(request: dict[str, object]) -> None:
    _require_server()
    _exec([sys.executable, "-m", "kleinkram.server.backup", json.dumps(request)])


def _require_server() -> None:
    if find_spec("psycopg") is None:
        raise InvalidInput(
            what="This installation", reason="it lacks the server's part: `pip install 'open-kleinkram[server]'`"
        )


def _exec(command: list[str]) -> None:
    sys.stdout.flush()
    os.execv(command[0], command)  # noqa: S606  (our own interpreter, no shell)
