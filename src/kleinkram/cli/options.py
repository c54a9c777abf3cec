"""Options and prompts that several commands share, and completion of names."""

import json
import logging
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from kleinkram.cli.commands import Many, Text, argument, flag, option
from kleinkram.cli.errors import NotConfirmed
from kleinkram.cli.render import escape
from kleinkram.client._http import Api
from kleinkram.client._resources import pages
from kleinkram.client.config import find_endpoint, load_endpoints
from kleinkram.client.errors import InvalidInput
from kleinkram.contract.missions import MissionRead
from kleinkram.contract.projects import ProjectRead

if TYPE_CHECKING:  # few commands need them
    from kleinkram.contract.actions import ActionDefinition, ParameterValues

_COMPLETION_TIMEOUT_S = 1.0
_MAX_COMPLETIONS = 100


def complete_project(ctx: typer.Context, incomplete: str) -> list[str]:
    """Return the projects whose names begin with a text."""
    return _complete(lambda: _names("/projects", ProjectRead, [("name", f"{incomplete}*")]))


def complete_mission(ctx: typer.Context, incomplete: str) -> list[str]:
    """Return the missions whose names begin with a text, in the project of the command line."""
    project = ctx.params.get("project")
    refs = [project] if isinstance(project, str) else project or []
    query = [("name", f"{incomplete}*"), *(("projects", str(ref)) for ref in refs)]
    return _complete(lambda: dict.fromkeys(_names("/missions", MissionRead, query)))


def complete_endpoint(ctx: typer.Context, incomplete: str) -> list[str]:
    """Return the saved endpoints whose names begin with a text."""
    return _complete(lambda: (name for name in load_endpoints().endpoints if name.startswith(incomplete)))


def _names(path: str, kind: type[ProjectRead | MissionRead], query: list[tuple[str, str]]) -> Iterator[str]:
    api = Api(find_endpoint(), read_timeout_s=_COMPLETION_TIMEOUT_S, retry_timeout_s=0.0)
    yield from (row.name for row in pages(api, path, kind, query, limit=_MAX_COMPLETIONS))


def _complete(names: Callable[[], Iterable[str]]) -> list[str]:
    """Return names, or none on any failure: a shell that completes a word cannot show an error."""
    logging.disable()
    try:
        return [*names()]
    except Exception:
        return []
    finally:
        logging.disable(logging.NOTSET)


def _project(text: str) -> Any:
    return option("--project -p", "PROJECT", text, autocompletion=complete_project)


def _mission(text: str) -> Any:
    return option("--mission -m", "MISSION", text, autocompletion=complete_mission)


ProjectOption = Annotated[Text, _project("Select the project by name or id.")]
MissionOption = Annotated[Text, _mission("Select the mission by name or id.")]
ProjectsOption = Annotated[Many, _project("Select projects by name, glob or id; repeatable.")]
MissionsOption = Annotated[Many, _mission("Select missions by name, glob or id; repeatable.")]
FileArgument = Annotated[str, argument("FILE", "Path or id of the file.")]
GlobArgument = Annotated[Text, argument("GLOB", "Glob that names match.")]
ExcludeOption = Annotated[Many, option("--exclude", "GLOB", "Skip matching paths, names or folders; repeatable.")]
DryRun = Annotated[bool, flag("--dry-run", "Print what the command would do, without doing it.")]
Yes = Annotated[bool, flag("--yes -y", "Do not ask for confirmation.")]
Count = Annotated[bool, flag("--count", "Print only the number of matches.")]
Ended = Annotated[bool, flag("--ended", "Include those that were revoked or have expired.")]
Overwrite = Annotated[bool, flag("--overwrite", "Replace files that differ.")]
Limit = Annotated[int | None, option("--limit", "N", "Print at most N.", min=1)]
Until = Annotated[Text, option("--until", "DATE", "Set when it expires, in UTC; a date without a time means 00:00.")]
LimitRate = Annotated[Text, option("--limit-rate", "RATE", "Transfer at most RATE bytes a second, such as 10M.")]
Connections = Annotated[int, option("--connections", "N", "Run N transfers at the same time.", min=1, max=32)]


TopicsOption = Annotated[
    Many, option("--topics", "TOPICS", "Take only these topics, by name or glob; repeatable, or separated by commas.")
]
_START = "Begin at this log time, inclusive: 2026-05-01T10:00:00Z, 10:00 (UTC), or +20s after the start."
_END = "End before this log time, written like the start."
StartOption = Annotated[Text, option("--start --start-time", "TIME", _START)]
EndOption = Annotated[Text, option("--end --end-time", "TIME", _END)]
SetOption = Annotated[Many, option("--set", "NAME=VALUE", "Set a parameter; repeatable.")]


def _check_etag(text: str | None) -> str | None:
    if text is not None and not re.fullmatch("[0-9a-f]{16}", text):
        raise InvalidInput(what="--if-match", reason="an ETag has 16 characters; --json and `info` show it")
    return text


IfMatch = Annotated[
    Text, option("--if-match", "ETAG", "Change it only if it still has this ETag.", callback=_check_etag)
]


def parameter_values(definition: "ActionDefinition", assignments: Iterable[str]) -> "ParameterValues":
    """Return the checked values that `NAME=VALUE` assignments set for the parameters of an action."""
    known = {parameter.name: parameter for parameter in definition.parameters}
    values: ParameterValues = {}
    try:
        for assignment in assignments:
            name, equals, text = assignment.partition("=")
            if not equals:
                raise InvalidInput(what=f"The parameter {assignment!r}", reason="write it as NAME=VALUE")
            values[name] = known[name].read(text) if name in known else text
        definition.fill_in(values)
    except ValueError as error:
        raise InvalidInput(what="The parameters", reason=str(error)) from None
    return values


def untyped_values(assignments: Iterable[str]) -> "ParameterValues":
    """Return the values of `NAME=VALUE` assignments: numbers, `true` and `false`, and texts."""
    values: ParameterValues = {}
    for assignment in assignments:
        name, equals, text = assignment.partition("=")
        if not equals:
            raise InvalidInput(what=f"The parameter {assignment!r}", reason="write it as NAME=VALUE")
        try:
            value = json.loads(text)
        except ValueError:
            value = text
        values[name] = value if isinstance(value, bool | int | float) else text
    return values


def topic_names(topics: Sequence[str] | None) -> list[str] | None:
    """Return the names and globs of `--topics`; None for all."""
    return None if not topics else [name for text in topics for name in text.replace(",", " ").split()]


def the_ref(what: str, positional: str | None, option: str | None) -> str:
    """Return the name or id given as an argument or as an option; raise InvalidInput for neither or both."""
    if (positional is None) == (option is None):
        raise InvalidInput(what="The command", reason=f"specify one {what}")
    return positional if positional is not None else option or ""


def the_only(what: str, refs: Sequence[str] | None) -> str | None:
    """Return the one value of a repeatable option, or None; raise InvalidInput for several."""
    if refs is not None and len(refs) > 1:
        raise InvalidInput(what=f"--{what}", reason=f"it was given {len(refs)} times; this command takes one")
    return refs[0] if refs else None


def read_text(path: Path | None) -> str | None:
    """Return the exact text of a file given on the command line; None for none."""
    if path is None:
        return None
    try:
        return path.read_bytes().decode("utf-8")
    except OSError as error:
        raise InvalidInput(what=f"The file {str(path)!r}", reason=error.strerror or str(error)) from None
    except UnicodeDecodeError:
        raise InvalidInput(what=f"The file {str(path)!r}", reason="it is not UTF-8 text") from None


def read_token() -> str:
    """Return a token from a prompt without echo, or the first line of stdin; empty where none came."""
    if sys.stdin.isatty():
        return str(typer.prompt("Token", hide_input=True, err=True)).strip()
    return sys.stdin.readline().strip()


def type_name(question: str) -> str:
    """Ask for a name on the terminal, which confirms what cannot be undone; raise InvalidInput without an answer."""
    try:
        return str(typer.prompt(escape(question), err=True)).strip()
    except typer.Abort:
        raise InvalidInput(what="The confirmation", reason="no name was typed; scripts use --confirm NAME") from None


def confirm(question: str, yes: bool) -> None:
    """Ask on the terminal unless `yes`; raise NotConfirmed unless the answer is yes."""
    if yes:
        return
    try:
        agreed = typer.confirm(escape(question), err=True)
    except typer.Abort:
        raise NotConfirmed from None
    if not agreed:
        raise NotConfirmed
