"""`klein token …`"""

import uuid
from typing import Annotated

import typer

from kleinkram import connect
from kleinkram.cli.commands import Noun
from kleinkram.cli.options import AsJson, Limit, Until
from kleinkram.cli.render import details, escape, line, note, show_json, show_json_list, table
from kleinkram.cli.units import ending
from kleinkram.client import Client
from kleinkram.client.tokens import Reach, RunnerLimits
from kleinkram.contract.access import Scope, TokenKind
from kleinkram.contract.names import is_id
from kleinkram.contract.tokens import TokenRead

app = Noun("Tokens: what scripts, robots and runners sign in with.")

Days = Annotated[int | None, typer.Option("--days", metavar="N", min=1, max=36_500, help="It ends in so many days.")]
Everybody = Annotated[bool, typer.Option("--everybody", help="Those of others, too; for admins.")]


@app.command("create")
def create(
    name: Annotated[str, typer.Argument(metavar="NAME", help="What it is for.", show_default=False)],
    kind: Annotated[TokenKind, typer.Option("--kind", help="Whose it is.")] = TokenKind.personal,
    scope: Annotated[
        list[Scope] | None,
        typer.Option("--scope", help="What it is for; may be repeated. Usual: write, for robots upload."),
    ] = None,
    project: Annotated[
        list[str] | None,
        typer.Option("--project", "-p", metavar="PROJECT", help="Reaches only this; may be repeated."),
    ] = None,
    mission: Annotated[
        list[str] | None,
        typer.Option("--mission", "-m", metavar="PROJECT/MISSION", help="Reaches only this; may be repeated."),
    ] = None,
    runner: Annotated[
        uuid.UUID | None,
        typer.Option("--runner", metavar="ID", help="For this runner. Default: the first one that uses it."),
    ] = None,
    label: Annotated[
        list[str] | None,
        typer.Option("--label", metavar="L", help="A runner gets only runs that ask for this; may be repeated."),
    ] = None,
    until: Until = None,
    days: Days = None,
    no_end: Annotated[bool, typer.Option("--no-end", help="It never ends, where the server allows that.")] = False,
    as_json: AsJson = False,
) -> None:
    """Make a token and print it. It is shown this once. Without an end, it gets the one that is usual on the server."""
    with connect() as client:
        expires_at = ending(until, days, client.service.now)
        limits = RunnerLimits(runner, label or []) if runner or label else None
        reach = Reach([client.projects.get(ref).id for ref in project or []], _missions(client, mission or []))
        made = client.tokens.create(
            name,
            kind=kind,
            scopes=scope or None,
            reach=reach,
            expires_at=expires_at,
            no_end=no_end,
            runner=limits,
        )
    if as_json:
        show_json(made)
        return
    line(made.secret)
    token = made.token
    note(f"Keep it now: nobody can show it again. {_summary(token)} `klein token revoke {token.prefix}` ends it.")


@app.command("list")
def list_(
    everybody: Everybody = False,
    ended: Annotated[bool, typer.Option("--ended", help="Also those that were revoked or have expired.")] = False,
    limit: Limit = None,
    as_json: AsJson = False,
) -> None:
    """List tokens, latest first."""
    with connect() as client:
        rows = [*client.tokens.list(everybody=everybody, ended=ended, limit=limit)]
    if as_json:
        show_json_list(rows)
        return
    table(
        ["name", "begins", "kind", "scopes", "reaches", "runner", "of", "last used", "until", "revoked", "id"],
        [
            (
                row.name,
                row.prefix or None,
                row.kind.value,
                _scopes(row),
                _places(row),
                _runner(row),
                row.person.name,
                row.last_used_at,
                row.expires_at,
                row.revoked_at,
                row.id,
            )
            for row in rows
        ],
    )


@app.command("revoke")
def revoke(
    ref: Annotated[
        str, typer.Argument(metavar="TOKEN", help="Its name, how it begins, or its id.", show_default=False)
    ],
    everybody: Everybody = False,
    as_json: AsJson = False,
) -> None:
    """End a token, and all that were made with it, from the next request on."""
    with connect() as client:
        token_rows = client.tokens.get(ref, everybody=everybody)
        client.tokens.revoke(token_rows.id)
    if as_json:
        show_json({"revoked": token_rows.model_dump(mode="json")})
        return
    details([("revoked", token_rows.name), ("begins", token_rows.prefix), ("id", token_rows.id)])


def _missions(client: Client, refs: list[str]) -> list[uuid.UUID]:
    """Return the missions of ids, names, and names behind their projects' (no name holds a slash)."""
    token_rows = []
    for ref in refs:
        project, _, name = ref.rpartition("/")
        token_rows.append(client.missions.get(name, project=None if is_id(ref) else project or None).id)
    return token_rows


def _summary(token: TokenRead) -> str:
    ends = f"until {token.expires_at:%Y-%m-%d %H:%M}Z" if token.expires_at else "until it is revoked"
    return f"Good for {escape(_scopes(token))} on {escape(_places(token))}, {ends}."


def _scopes(token: TokenRead) -> str:
    return ", ".join(scope.value for scope in token.scopes)


def _runner(token: TokenRead) -> str | None:
    if token.kind is not TokenKind.runner:
        return None
    labels = f", only {' or '.join(token.runner_labels)}" if token.runner_labels else ""
    bound = (token.runner.name or str(token.runner.id)) if token.runner else "the first that uses it"
    return f"{bound}{labels}"


def _places(token: TokenRead) -> str:
    if token.limits is None:
        return "all runs" if token.kind is TokenKind.runner else "all that its person reaches"
    return ", ".join(f"{place.noun} {place.name or place.id}" for place in token.limits) or "nothing any more"
