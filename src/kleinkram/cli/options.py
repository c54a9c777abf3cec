"""Options that are shared by commands, and shell completion of names."""

import logging
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Annotated

import typer

from kleinkram.cli.errors import Refused
from kleinkram.cli.render import escape
from kleinkram.client.errors import InvalidInput

_WAIT_S = 1.0
_MOST = 100


def complete_project(ctx: typer.Context, incomplete: str) -> list[str]:
    """Return the projects whose names begin so."""
    return _quietly(lambda: _names("/projects", incomplete, None))


def complete_mission(ctx: typer.Context, incomplete: str) -> list[str]:
    """Return the missions whose names begin so, in the project that was named."""
    project = ctx.params.get("project")
    return _quietly(lambda: _names("/missions", incomplete, project))


def complete_endpoint(ctx: typer.Context, incomplete: str) -> list[str]:
    """Return the saved endpoints whose names begin so."""

    def saved() -> Iterator[str]:
        from kleinkram.client.config import load_endpoints

        yield from (name for name in load_endpoints().endpoints if name.startswith(incomplete))

    return _quietly(saved)


def _names(path: str, incomplete: str, project: object) -> Iterator[str]:
    from kleinkram.client._http import Api
    from kleinkram.client._nouns import pages
    from kleinkram.client.config import find_endpoint
    from kleinkram.contract.missions import MissionRead
    from kleinkram.contract.projects import ProjectRead

    api = Api(find_endpoint(), read_timeout_s=_WAIT_S, is_patient=False)
    begins = [("name", f"{incomplete}*")]
    if path == "/projects":
        yield from (row.name for row in pages(api, path, ProjectRead, begins, limit=_MOST))
        return
    within = [project] if isinstance(project, str) else [*project] if isinstance(project, list | tuple) else []
    begins += [("projects", str(ref)) for ref in within]
    yield from dict.fromkeys(row.name for row in pages(api, path, MissionRead, begins, limit=_MOST))


def _quietly(names: Callable[[], Iterator[str]]) -> list[str]:
    """Return names; none where anything is wrong: the shell is no place to say so."""
    logging.disable()
    try:
        return [*names()]
    except Exception:
        return []
    finally:
        logging.disable(logging.NOTSET)


ProjectOption = Annotated[
    str | None,
    typer.Option(
        "--project", "-p", metavar="PROJECT", help="Name or id of the project.", autocompletion=complete_project
    ),
]
MissionOption = Annotated[
    str | None,
    typer.Option(
        "--mission", "-m", metavar="MISSION", help="Name or id of the mission.", autocompletion=complete_mission
    ),
]
ProjectsOption = Annotated[
    list[str] | None,
    typer.Option(
        "--project",
        "-p",
        metavar="PROJECT",
        help="Name, glob or id; may be given several times.",
        autocompletion=complete_project,
    ),
]
MissionsOption = Annotated[
    list[str] | None,
    typer.Option(
        "--mission",
        "-m",
        metavar="MISSION",
        help="Name, glob or id; may be given several times.",
        autocompletion=complete_mission,
    ),
]
ExcludeOption = Annotated[
    list[str] | None,
    typer.Option("--exclude", metavar="GLOB", help="Leave out such paths, names or folders; repeatable."),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON on stdout.")]
DryRun = Annotated[bool, typer.Option("--dry-run", help="Only say what would be done.")]
Yes = Annotated[bool, typer.Option("--yes", "-y", help="Do not ask.")]
Limit = Annotated[int | None, typer.Option("--limit", metavar="N", min=1, help="At most so many.")]
Until = Annotated[
    str | None, typer.Option("--until", metavar="DATE", help="When it ends, UTC; a date means its beginning.")
]
LimitRate = Annotated[
    str | None, typer.Option("--limit-rate", metavar="RATE", help="At most so many bytes a second, such as 10M.")
]
Connections = Annotated[
    int, typer.Option("--connections", metavar="N", min=1, max=32, help="Transfers at the same time.")
]


def _etag(text: str | None) -> str | None:
    if text is not None and not re.fullmatch("[0-9a-f]{16}", text):
        raise InvalidInput(what="--if-match", reason="it is the 16 characters that --json and `info` show as ETag")
    return text


IfMatch = Annotated[
    str | None,
    typer.Option(
        "--if-match", metavar="EDITION", callback=_etag, help="Only where it is still as it was when you looked."
    ),
]


def the_ref(what: str, positional: str | None, option: str | None) -> str:
    """Return the name or id that was given, as an argument or as an option.

    Raises:
        InvalidInput: neither or both were given.
    """
    if (positional is None) == (option is None):
        raise InvalidInput(what="The command", reason=f"say which {what}, once")
    return positional if positional is not None else option or ""


def the_only(what: str, refs: Sequence[str] | None) -> str | None:
    """Return the one name or id that an option was given; None where it was not given.

    Raises:
        InvalidInput: it was given several times, but the command acts on one.
    """
    if refs is not None and len(refs) > 1:
        raise InvalidInput(what=f"--{what}", reason=f"it was given {len(refs)} times, and this takes one")
    return refs[0] if refs else None


def read_text(path: Path | None) -> str | None:
    """Return what a file given on the command line says, to the letter (line ends and byte order mark); None for none.

    Raises:
        InvalidInput: it cannot be read, or is not text.
    """
    if path is None:
        return None
    try:
        return path.read_bytes().decode("utf-8")
    except OSError as error:
        raise InvalidInput(what=f"The file {str(path)!r}", reason=error.strerror or str(error)) from None
    except UnicodeDecodeError:
        raise InvalidInput(what=f"The file {str(path)!r}", reason="it is not UTF-8 text") from None


def read_token() -> str:
    """Return a token from the terminal, where it is not echoed, or the first line of stdin; empty where none came."""
    if sys.stdin.isatty():
        return str(typer.prompt("Token", hide_input=True, err=True)).strip()
    return sys.stdin.readline().strip()


def confirm(question: str, yes: bool) -> None:
    """Ask on the terminal unless `yes`.

    Raises:
        Refused: the answer was no, or there is nobody to ask.
    """
    if yes:
        return
    try:
        agreed = typer.confirm(escape(question), err=True)
    except typer.Abort:
        raise Refused from None
    if not agreed:
        raise Refused
