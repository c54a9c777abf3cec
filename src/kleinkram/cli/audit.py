"""`klein audit`"""

import json
from collections.abc import Iterable
from typing import Annotated

import typer

from kleinkram import connect
from kleinkram.cli.filters import ids_of
from kleinkram.cli.options import AsJson, Limit, MissionsOption, ProjectsOption
from kleinkram.cli.render import line, plain, show_json_list, table
from kleinkram.cli.units import parse_time
from kleinkram.client._nouns import checked
from kleinkram.client.errors import InvalidInput
from kleinkram.contract.audit import AuditFilter, AuditRead
from kleinkram.contract.names import is_id

_SHOWN = 100


def audit(
    person: Annotated[str | None, typer.Option("--person", metavar="PERSON", help="Done by them: name or id.")] = None,
    token: Annotated[str | None, typer.Option("--token", metavar="TOKEN", help="With a token: name or id.")] = None,
    project: ProjectsOption = None,
    mission: MissionsOption = None,
    noun: Annotated[str | None, typer.Option("--noun", help="Only of these: project, mission, file, …")] = None,
    noun_id: Annotated[str | None, typer.Option("--id", metavar="ID", help="Only of the thing with this id.")] = None,
    operation: Annotated[str | None, typer.Option("--operation", metavar="GLOB", help="Such as 'file.*'.")] = None,
    since: Annotated[str | None, typer.Option("--since", metavar="TIME", help="At this time or later.")] = None,
    until: Annotated[str | None, typer.Option("--until", metavar="TIME", help="Before this time.")] = None,
    as_admin: Annotated[bool, typer.Option("--as-admin", help="Only what took the power of an admin.")] = False,
    limit: Limit = None,
    jsonl: Annotated[
        bool, typer.Option("--export", "--jsonl", help="All that match as JSON lines on stdout, oldest first.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """List who did what to what, latest first: of all that you own; for admins, of everything."""
    if jsonl and (as_json or limit is not None):
        raise InvalidInput(what="The command", reason="--export gives everything as JSON lines: no --json, no --limit")
    given: dict[str, object] = {
        _id_or_name("person", person): person,
        _id_or_name("token", token): token,
        "noun": noun,
        "noun_id": noun_id,
        "operation": operation,
        "since": parse_time(since),
        "until": parse_time(until),
        "as_admin": as_admin or None,
    }
    with connect() as client:
        given |= ids_of(client, project, mission)
        matching = checked(AuditFilter, "The filter", **{key: value for key, value in given.items() if value})
        if jsonl:
            for event in client.audit.export(matching):
                line(json.dumps(plain(event)))
            return
        rows = [*client.audit.list(matching, limit=limit or _SHOWN)]
    if as_json:
        show_json_list(rows)
    else:
        _show(rows)


def _id_or_name(noun: str, given: str | None) -> str:
    return f"{noun}_id" if given is not None and is_id(given) else noun


def _show(rows: Iterable[AuditRead]) -> None:
    table(
        ["at", "who", "with", "from", "did", "to", "name", "request"],
        [
            (row.at, _who(row), _with(row), row.address, row.operation, row.noun, row.noun_name, row.request_id)
            for row in rows
        ],
    )


def _who(row: AuditRead) -> str | None:
    name = row.actor.name if row.actor else None
    return f"{name} (as admin)" if row.as_admin else name


def _with(row: AuditRead) -> str | None:
    if row.token is not None:
        return f"token {row.token.name}"
    if row.share is not None:
        return f"link {row.share.name}"
    return "browser" if row.session_id is not None else None
