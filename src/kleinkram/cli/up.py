"""`klein up`, `klein down`, `klein doctor`: Kleinkram on this one machine. Parses, hands over, renders.

`standalone` is imported when a command runs, never before: `klein --help` must not pay for it.
"""

import json
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

from kleinkram.cli.errors import ExitCode, fail
from kleinkram.cli.options import AsJson
from kleinkram.failures import code_of

if TYPE_CHECKING:
    from kleinkram.standalone.doctor import DoctorFinding
    from kleinkram.standalone.errors import StandaloneError

DataDirOption = Annotated[
    Path | None,
    typer.Option(
        "--data-dir",
        metavar="D",
        help="Folder that holds the instance. Default: KLEINKRAM_DATA_DIR, else kleinkram in this user's data folder.",
        file_okay=False,
    ),
]


def up(
    data_dir: DataDirOption = None,
    listen: Annotated[
        str, typer.Option(metavar="ADDR", help="Address to listen on; 0.0.0.0 lets other machines in.")
    ] = "127.0.0.1",
    port: Annotated[
        int | None, typer.Option(metavar="P", min=1, max=65535, help="Port of the API and the web interface.")
    ] = None,
    s3_port: Annotated[
        int | None, typer.Option("--s3-port", metavar="N", min=1, max=65535, help="Port of the store.")
    ] = None,
    public_url: Annotated[
        str | None, typer.Option(metavar="U", help="Address by which other machines reach this one.")
    ] = None,
    tls_cert: Annotated[
        Path | None, typer.Option(metavar="F", help="Certificate (PEM), for the API and the store.")
    ] = None,
    tls_key: Annotated[Path | None, typer.Option(metavar="F", help="Its private key (PEM).")] = None,
    runner: Annotated[bool, typer.Option("--runner/--no-runner", help="Run actions on this machine, too.")] = True,
    as_json: Annotated[
        bool, typer.Option("--json", help="Say where it answers as one line of JSON on stdout, once it does.")
    ] = False,
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
    # The supervisor stays for long: as a process of its own kind it needs a third of this one's memory.
    command = arguments(options)
    os.chdir("/")
    os.execv(command[0], command)  # noqa: S606  (our own interpreter, no shell)


def down(data_dir: DataDirOption = None, as_json: AsJson = False) -> None:
    """End the Kleinkram that runs on this machine, in order; returns when it has ended."""
    from kleinkram.standalone.data_dir import DataDir
    from kleinkram.standalone.errors import StandaloneError
    from kleinkram.standalone.supervisor import stop_instance

    folder = resolve_data_dir(data_dir)
    try:
        ended = stop_instance(DataDir(folder))
    except StandaloneError as error:
        _fail(error)
    if as_json:
        typer.echo(json.dumps({"data_dir": str(folder), "pid": ended.pid, "services": ended.services}, indent=2))
    else:
        typer.echo(
            f"Ended Kleinkram on {folder} (pid {ended.pid}): {', '.join(ended.services) or 'it was still starting'}."
        )


def doctor(
    data_dir: DataDirOption = None,
    as_json: AsJson = False,
) -> None:
    """Say what is wrong with the Kleinkram on this machine, and how to mend it. Exit code 1 if anything is."""
    from kleinkram.standalone.doctor import examine

    findings = examine(resolve_data_dir(data_dir))
    if data_dir is None and "KLEINKRAM_DATABASE_URL" in os.environ:
        typer.echo(
            "The environment has the settings of a server of its own, which this command does not look at: "
            "run `python -m kleinkram.server check`.",
            err=True,
        )
    if as_json:
        checks = [{"check": it.check, "ok": it.ok, "message": it.message, "remedy": it.remedy} for it in findings]
        typer.echo(json.dumps({"ok": all(it.ok for it in findings), "checks": checks}, indent=2))
    else:
        for finding in findings:
            typer.echo(_line(finding))
    if not all(finding.ok for finding in findings):
        raise typer.Exit(1)


def resolve_data_dir(data_dir: Path | None) -> Path:
    """Return the folder of the instance that is meant: the one given, else the usual one."""
    from kleinkram.client.config import data_dir as default_data_dir

    return (data_dir or default_data_dir()).expanduser().resolve()


def _line(finding: "DoctorFinding") -> str:
    mark = "ok     " if finding.ok else "PROBLEM"
    return f"{mark} {finding.check}: {finding.message}" + (f" {finding.remedy}" if finding.remedy else "")


def _fail(error: "StandaloneError") -> NoReturn:
    sys.exit(fail(code_of(error), str(error), ExitCode.server_failed))
