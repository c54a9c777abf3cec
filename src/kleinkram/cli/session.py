"""`klein session …`"""

import uuid
from typing import Annotated

import typer

from kleinkram import connect
from kleinkram.cli.commands import Noun
from kleinkram.cli.options import AsJson, Yes, confirm
from kleinkram.cli.render import line, moment, note, show_json, show_json_list, table
from kleinkram.client.errors import InvalidInput

app = Noun("Browsers that you are signed in with.", no_args_is_help=False)


@app.command("list")
def list_(as_json: AsJson = False) -> None:
    """List the browsers that you are signed in with, latest use first."""
    with connect() as client:
        rows = [*client.me.sessions()]
    if as_json:
        show_json_list(rows)
        return
    table(
        ["session", "signed in", "last used", "until", "from", "browser"],
        [(row.id, row.created_at, row.last_used_at, row.expires_at, row.address, row.user_agent) for row in rows],
    )


@app.command("link")
def link(as_json: AsJson = False) -> None:
    """Print a link that signs a browser in as the owner of `klein up`. It is good once, and for some minutes."""
    with connect() as client:
        made = client.me.owner_link()
    if as_json:
        show_json(made)
        return
    line(made.url)
    note(f"Good once, until {moment(made.expires_at)}.")


@app.command("revoke")
def revoke(
    session: Annotated[
        str | None, typer.Argument(metavar="ID", show_default=False, help="As `klein session list` shows it.")
    ] = None,
    everywhere: Annotated[bool, typer.Option("--all", help="Sign every browser out.")] = False,
    yes: Yes = False,
    as_json: AsJson = False,
) -> None:
    """Sign a browser out, or all of them. Tokens stay (`klein token revoke`)."""
    if (session is None) != everywhere:
        raise InvalidInput(what="The command", reason="say which session, or --all")
    with connect() as client:
        if session is None:
            confirm("Sign every browser out?", yes)
            client.me.end_sessions()
        else:
            client.me.end_session(_id(session))
    if as_json:
        show_json({"revoked": session or "all"})
    note("Every browser is signed out." if session is None else "That browser is signed out.")


def _id(text: str) -> uuid.UUID:
    try:
        return uuid.UUID(text)
    except ValueError:
        raise InvalidInput(what=f"The session {text!r}", reason="give an id that `klein session list` shows") from None
