"""`klein person …`"""

from typing import Annotated

import typer

from kleinkram import connect
from kleinkram.cli.commands import Noun
from kleinkram.cli.options import AsJson, Limit, Yes, confirm
from kleinkram.cli.render import details, escape, line, moment, note, show_json, show_json_list, table
from kleinkram.contract.accounts import OneTimeLink
from kleinkram.contract.people import PersonRead

app = Noun("People whom you share a group or a project with; admins see all.")

Who = Annotated[str, typer.Argument(metavar="PERSON", help="Name, id, or an address you may know.", show_default=False)]


@app.command("list")
def list_(
    text: Annotated[str | None, typer.Argument(metavar="TEXT", help="Found in names.", show_default=False)] = None,
    left: Annotated[bool, typer.Option("--left", help="Those who left, for admins.")] = False,
    limit: Limit = None,
    as_json: AsJson = False,
) -> None:
    """List people, by name."""
    with connect() as client:
        rows = [*client.people.list(text=text, active=not left, limit=limit)]
    if as_json:
        show_json_list(rows)
        return
    table(
        ["name", "addresses", "admin", "id"],
        [(row.name, row.emails or None, row.is_admin, row.id) for row in rows],
    )


@app.command("info")
def info(who: Who, as_json: AsJson = False) -> None:
    """Show one person."""
    with connect() as client:
        target = client.people.get(who)
    _show(target, as_json)


@app.command("admin")
def admin(
    who: Who,
    end: Annotated[bool, typer.Option("--end", help="Take that power away.")] = False,
    yes: Yes = False,
    as_json: AsJson = False,
) -> None:
    """Make somebody an admin, who sees and does everything."""
    with connect() as client:
        target = client.people.get(who)
        if end:
            changed = client.people.unmake_admin(target.id)
        else:
            confirm(f"Let {escape(target.name)} see and do everything on this server?", yes)
            changed = client.people.make_admin(target.id)
    _show(changed, as_json)


@app.command("deactivate")
def deactivate(who: Who, yes: Yes = False, as_json: AsJson = False) -> None:
    """End somebody's sessions, tokens and links; projects that only they owned go to the admins."""
    with connect() as client:
        target = client.people.get(who)
        confirm(f"Deactivate {escape(target.name)} ({target.id})?", yes)
        ended = client.people.deactivate(target.id)
    if as_json:
        show_json(ended)
        return
    note(f"{escape(target.name)} left: {ended.sessions} sessions, {ended.tokens} tokens and {ended.links} links ended.")
    if ended.projects:
        note(f"The admins own now: {escape(', '.join(ended.projects))}")


@app.command("reactivate")
def reactivate(who: Who, as_json: AsJson = False) -> None:
    """Let somebody who left sign in again. Their tokens stay revoked."""
    with connect() as client:
        changed = client.people.reactivate(client.people.get(who).id)
    _show(changed, as_json)


@app.command("invite")
def invite(
    email: Annotated[str, typer.Argument(metavar="EMAIL", show_default=False)],
    name: Annotated[str | None, typer.Option("--name", metavar="NAME", help="What to call them.")] = None,
    as_json: AsJson = False,
) -> None:
    """Print a link by which somebody gets a local account with this address. Nothing is mailed: give it to them."""
    with connect() as client:
        made = client.people.invite(email, name=name)
    _show_link(made, as_json)


@app.command("reset")
def reset(who: Who, as_json: AsJson = False) -> None:
    """Print a link by which somebody chooses a new password. Nothing is mailed: give it to them."""
    with connect() as client:
        made = client.people.reset_password(client.people.get(who).id)
    _show_link(made, as_json)


@app.command("reset-totp")
def reset_totp(who: Who, as_json: AsJson = False) -> None:
    """Take the second factor away from somebody who lost their device. They sign in with their password alone."""
    with connect() as client:
        person = client.people.get(who)
        client.people.reset_totp(person.id)
    if as_json:
        show_json({"reset": str(person.id)})
        return
    note(f"{escape(person.name)} signs in with the password alone until they add a second factor again.")


def _show_link(made: OneTimeLink, as_json: bool) -> None:
    if as_json:
        show_json(made)
        return
    line(made.url)
    note(f"Good once, until {moment(made.expires_at)}. Whoever has it can use it.")
    if made.warning:
        note(escape(f"Warning: {made.warning}"))


def _show(person: PersonRead, as_json: bool) -> None:
    if as_json:
        show_json(person)
        return
    details(
        [
            ("person", person.name),
            ("id", person.id),
            ("addresses", person.emails),
            ("admin", person.is_admin),
            ("since", person.created_at),
            ("left", person.deactivated_at),
        ]
    )
