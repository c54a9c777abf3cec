"""`klein up`, `klein down`, `klein doctor`, `klein backup …` and `klein restore`: Kleinkram on this machine.

`standalone` is imported only when a command runs. Backup and restore use the instance of `klein up`, unless the
environment contains the settings of a server.
"""

import json
import os
import re
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

from kleinkram.cli.commands import AsJson, Subcommands, Text, argument, flag, option
from kleinkram.cli.errors import ExitCode, fail
from kleinkram.cli.options import Connections, LimitRate
from kleinkram.cli.units import parse_rate
from kleinkram.client.errors import InvalidInput
from kleinkram.failures import code_of

DataDirOption = Annotated[
    Path | None,
    option(
        "--data-dir",
        "D",
        "Set the folder of the instance. Default: KLEINKRAM_DATA_DIR, else kleinkram in this user's data folder.",
        file_okay=False,
    ),
]
Port = int | None


def up(
    data_dir: DataDirOption = None,
    listen: Annotated[str, option("--listen", "ADDR", "Listen on ADDR; 0.0.0.0 serves other machines.")] = "127.0.0.1",
    port: Annotated[Port, option("--port", "P", "Set the port of API and web interface.", min=1, max=65535)] = None,
    s3_port: Annotated[Port, option("--s3-port", "N", "Set the port of the store.", min=1, max=65535)] = None,
    public_url: Annotated[
        Text, option("--public-url", "U", "Set the URL by which other machines reach this one.")
    ] = None,
    tls_cert: Annotated[
        Path | None, option("--tls-cert", "F", "Use this certificate (PEM) for the API and the store.")
    ] = None,
    tls_key: Annotated[Path | None, option("--tls-key", "F", "Use this private key (PEM).")] = None,
    runner: Annotated[bool, flag("--runner/--no-runner", "Run actions on this machine, too.")] = True,
    as_json: Annotated[bool, flag("--json", "Print its addresses as one line of JSON when it is ready.")] = False,
) -> None:
    """Run Kleinkram on this machine: PostgreSQL, S3, API, worker and runner. Ctrl-C or `klein down` ends it."""
    from kleinkram.standalone.__main__ import arguments
    from kleinkram.standalone.address import Listening
    from kleinkram.standalone.services import UpOptions

    options = UpOptions(
        data_dir=resolve_data_dir(data_dir),
        listening=Listening(
            address=listen,
            port=port,
            s3_port=s3_port,
            public_url=public_url,
            tls_cert=tls_cert.resolve() if tls_cert else None,
            tls_key=tls_key.resolve() if tls_key else None,
        ),
        is_default_data_dir=resolve_data_dir(data_dir) == resolve_data_dir(None),
        with_runner=runner,
        as_json=as_json,
    )
    # The supervisor runs for a long time; its own process needs a third of the memory of this one.
    command = arguments(options)
    os.chdir("/")
    os.execv(command[0], command)  # noqa: S606  (our own interpreter, no shell)


def down(data_dir: DataDirOption = None, as_json: AsJson = False) -> None:
    """Stop the Kleinkram that runs on this machine, and wait until it has ended."""
    from kleinkram.standalone.data_dir import DataDir
    from kleinkram.standalone.errors import StandaloneError
    from kleinkram.standalone.supervisor import stop_instance

    folder = resolve_data_dir(data_dir)
    try:
        ended = stop_instance(DataDir(folder))
    except StandaloneError as error:
        sys.exit(fail(code_of(error), str(error), ExitCode.server_failed))
    if as_json:
        typer.echo(json.dumps({"data_dir": str(folder), "pid": ended.pid, "services": ended.services}, indent=2))
    else:
        services = ", ".join(ended.services) or "it was still starting"
        typer.echo(f"Ended Kleinkram on {folder} (pid {ended.pid}): {services}.")


def doctor(data_dir: DataDirOption = None, as_json: AsJson = False) -> None:
    """Check the Kleinkram on this machine, and show how to fix problems. The exit code is 1 if there are any."""
    from kleinkram import diagnostics
    from kleinkram.standalone.doctor import examine

    results = examine(resolve_data_dir(data_dir))
    if data_dir is None and "KLEINKRAM_DATABASE_URL" in os.environ:
        typer.echo(
            "The environment contains the settings of another server, which this command does not check: "
            "run `python -m kleinkram.server check`.",
            err=True,
        )
    typer.echo(diagnostics.report(results, as_json=as_json))
    if diagnostics.find_problems(results):
        raise typer.Exit(1)


def resolve_data_dir(data_dir: Path | None) -> Path:
    """Return the folder of the instance: the one given, else the default."""
    from kleinkram.client.config import data_dir as default_data_dir

    return (data_dir or default_data_dir()).expanduser().resolve()


app = Subcommands("Create, list, verify and prune backups of a whole instance.")
_REMOTE = re.compile(r"s3://|[\w.+@-]+:")  # of rclone's configuration; a folder is made absolute
_CONNECTIONS = 8
Location = Annotated[
    str,
    argument(
        "LOCATION",
        "A folder, s3://bucket/folder (KLEINKRAM_BACKUP_S3_URL, _S3_ACCESS_KEY, _S3_SECRET_KEY), or REMOTE:PATH "
        "of rclone.",
    ),
]
PassphraseFile = Annotated[
    Path | None,
    option(
        "--passphrase-file",
        "FILE",
        "Read the passphrase from the first line of FILE. Default: KLEINKRAM_BACKUP_PASSPHRASE.",
        dir_okay=False,
    ),
]
SnapshotOption = Annotated[Text, option("--snapshot", "ID", "Choose the backup, as in `klein backup list`.")]


@app.command()
def create(
    location: Location,
    data_dir: DataDirOption = None,
    encrypt: Annotated[
        bool, flag("--encrypt", "Encrypt with a passphrase. Decided by the first backup in a location.")
    ] = False,
    passphrase_file: PassphraseFile = None,
    limit_rate: LimitRate = None,
    connections: Connections = _CONNECTIONS,
    as_json: AsJson = False,
) -> None:
    """Back up database and files while the server runs. Only new files are copied; running it again resumes.

    The exit code is 9 if the backup was made, but some files were lost or corrupt in the store already; it lists them.
    """
    pace = {"bytes_per_s": parse_rate(limit_rate), "connections": connections}
    _execute(_command("create", location, passphrase_file, as_json, encrypt=encrypt, **pace), data_dir)


@app.command("list")
def list_(location: Location, passphrase_file: PassphraseFile = None, as_json: AsJson = False) -> None:
    """List the backups in a location, the oldest first."""
    _execute_server(_command("list", location, passphrase_file, as_json))


@app.command()
def verify(
    location: Location,
    snapshot: SnapshotOption = None,
    read_all: Annotated[bool, flag("--read-all", "Read every byte and compare it with its SHA-256.")] = False,
    passphrase_file: PassphraseFile = None,
    limit_rate: LimitRate = None,
    connections: Connections = _CONNECTIONS,
    as_json: AsJson = False,
) -> None:
    """Verify backups by names and sizes, or with --read-all by every byte. The exit code is 9 if one is incomplete."""
    pace = {"bytes_per_s": parse_rate(limit_rate), "connections": connections}
    which = {"snapshot_id": snapshot, "read_all": read_all}
    _execute_server(_command("verify", location, passphrase_file, as_json, **which, **pace))


@app.command()
def prune(
    location: Location,
    keep: Annotated[int, option("--keep", "N", "Keep the latest N backups.", min=1)],
    passphrase_file: PassphraseFile = None,
    as_json: AsJson = False,
) -> None:
    """Remove all but the latest N backups, and the objects that only they contain."""
    _execute_server(_command("prune", location, passphrase_file, as_json, keep=keep))


def restore(
    location: Location,
    data_dir: DataDirOption = None,
    snapshot: SnapshotOption = None,
    project: Annotated[
        Text, option("-p --project", "PROJECT", "Restore only this project of the backup, into the existing instance.")
    ] = None,
    mission: Annotated[Text, option("-m --mission", "MISSION", "Restore only this mission of the project.")] = None,
    file: Annotated[Text, option("--file", "PATH", "Restore only this file of the mission.")] = None,
    dry_run: Annotated[
        bool, flag("--dry-run", "With --project: show what would be restored, and change nothing.")
    ] = False,
    passphrase_file: PassphraseFile = None,
    limit_rate: LimitRate = None,
    connections: Connections = _CONNECTIONS,
    as_json: AsJson = False,
) -> None:
    """Restore a backup (the latest) to a new folder, or to an empty database and bucket. Running it again resumes.

    With --project, restore that project, a mission or a file into the existing instance while people work. Nothing
    there is overwritten: where other bytes have the path of a file, it is restored in the folder "restored TIME".

    The exit code is 9 if it was restored, but some files are lost or corrupt; it lists them.
    """
    if project is None and (mission is not None or file is not None or dry_run):
        raise typer.BadParameter("specify the project, too", param_hint="--project")
    if file is not None and mission is None:
        raise typer.BadParameter("specify the mission of the file, too", param_hint="--mission")
    selected = {"project": project, "mission": mission, "file": file, "dry_run": dry_run}
    more = {"bytes_per_s": parse_rate(limit_rate), "connections": connections, **selected}
    _execute(_command("restore", location, passphrase_file, as_json, snapshot_id=snapshot, **more), data_dir)


def _command(
    command: str, location: str, passphrase_file: Path | None, as_json: bool, **more: object
) -> dict[str, object]:
    # The process that runs the command has another working directory.
    where = location if _REMOTE.match(location) else str(Path(location).expanduser().resolve())
    file = str(passphrase_file.expanduser().resolve()) if passphrase_file else None
    return {"command": command, "location": where, "passphrase_file": file, "as_json": as_json, **more}


def _execute(command: dict[str, object], data_dir: Path | None) -> None:
    if data_dir is None and "KLEINKRAM_DATABASE_URL" in os.environ:
        _execute_server(command)
    _require_server()
    from kleinkram.standalone.backup import BackupTask

    is_whole = command["command"] == "restore" and command["project"] is None
    _become(BackupTask(str(resolve_data_dir(data_dir)), command, restores=is_whole).command())


def _execute_server(command: dict[str, object]) -> None:
    _require_server()
    _become([sys.executable, "-m", "kleinkram.server.backup", json.dumps(command)])


def _require_server() -> None:
    if find_spec("psycopg") is None:
        reason = "the server is not installed: `pip install 'open-kleinkram[server]'`"
        raise InvalidInput(what="This installation", reason=reason)


def _become(command: list[str]) -> None:
    sys.stdout.flush()
    os.execv(command[0], command)  # noqa: S606  (our own interpreter, no shell)
