"""`klein group …`"""

from typing import Annotated

import typer

from kleinkram import connect
from kleinkram.cli.commands import Noun
from kleinkram.cli.options import AsJson, IfMatch, Limit, Until, Yes, confirm
from kleinkram.cli.render import details, escape, line, moment, note, show_json, show_json_list, table
from kleinkram.cli.units import parse_time
from kleinkram.contract.access import GroupRead

app = Noun("Groups of people: what is granted to one, all of it have.")

Group = Annotated[str, typer.Argument(metavar="GROUP", help="Name or id.", show_default=False)]
People = Annotated[
    list[str],
    typer.Argument(metavar="PERSON", help="Names, ids, or addresses you may know.", show_default=False),
]


@app.command("create")
def create(name: Annotated[str, typer.Argument(metavar="NAME", show_default=False)], as_json: AsJson = False) -> None:
    """Make a group; you are its first member and editor."""
    with connect() as client:
        made = client.groups.create(name)
    _show(made, as_json)


@app.command("list")
def list_(
    name: Annotated[str | None, typer.Argument(metavar="GLOB", show_default=False)] = None,
    limit: Limit = None,
    as_json: AsJson = False,
) -> None:
    """List the groups that you are in; admins see all."""
    with connect() as client:
        rows = [*client.groups.list(name=name, limit=limit)]
    if as_json:
        show_json_list(rows)
        return
    table(
        ["name", "kind", "members", "editor", "until", "id"],
        [(row.name, row.kind.value, row.member_count, row.is_editor, row.expires_at, row.id) for row in rows],
    )


@app.command("info")
def info(group: Group, as_json: AsJson = False) -> None:
    """Show a group and who is in it."""
    with connect() as client:
        target = client.groups.get(group)
        members = [*client.groups.members(target.id)]
    if as_json:
        show_json({"group": target, "members": members})
        return
    _show(target, as_json=False)
    line("")
    table(
        ["member", "addresses", "editor", "until", "active", "id"],
        [
            (row.person.name, row.emails or None, row.is_editor, row.expires_at, row.is_active, row.person.id)
            for row in members
        ],
    )


@app.command("rename")
def rename(
    group: Group,
    name: Annotated[str, typer.Argument(metavar="NAME", show_default=False)],
    etag: IfMatch = None,
    as_json: AsJson = False,
) -> None:
    """Rename a group."""
    with connect() as client:
        target = client.groups.get(group)
        changed = client.groups.rename(target.id, name, if_match=etag or target.etag)
    _show(changed, as_json)


@app.command("delete")
def delete(group: Group, yes: Yes = False, as_json: AsJson = False) -> None:
    """Delete a group, and with it every right that was granted to it."""
    with connect() as client:
        target = client.groups.get(group)
        confirm(f"Delete the group {escape(target.name)} of {target.member_count}, and its rights?", yes)
        client.groups.delete(target.id)
    show_json(target) if as_json else note(f"Deleted the group {escape(target.name)}.")


@app.command("add")
def add(
    group: Group,
    people: People,
    editor: Annotated[bool, typer.Option("--editor", help="Who says who else is in it.")] = False,
    until: Until = None,
    as_json: AsJson = False,
) -> None:
    """Put people into a group, or change how and until when they are in it."""
    expires_at = parse_time(until)
    with connect() as client:
        target = client.groups.get(group)
        chosen = [client.people.get(who) for who in people]
        rows = [client.groups.set_member(target.id, who.id, is_editor=editor, expires_at=expires_at) for who in chosen]
    if as_json:
        show_json_list(rows)
        return
    for row in rows:
        ending = f" until {moment(row.expires_at)}" if row.expires_at else ""
        note(f"{escape(row.person.name)} is in {escape(target.name)}{ending}.")


@app.command("remove")
def remove(group: Group, people: People, as_json: AsJson = False) -> None:
    """Take people out of a group, or leave it."""
    with connect() as client:
        target = client.groups.get(group)
        chosen = [client.people.get(who) for who in people]
        for who in chosen:
            client.groups.remove_member(target.id, who.id)
    if as_json:
        show_json({"items": chosen})
        return
    for who in chosen:
        note(f"{escape(who.name)} is in {escape(target.name)} no longer.")


def _show(group: GroupRead, as_json: bool) -> None:
    if as_json:
        show_json(group)
        return
    details(
        [
            ("group", group.name),
            ("id", group.id),
            ("kind", group.kind.value),
            ("members", group.member_count),
            ("domains", group.domains),
            ("on new projects", group.default_right.value if group.default_right else None),
            ("you", "editor" if group.is_editor else "member" if group.is_member else "not in it"),
            ("until", group.expires_at),
            ("made", group.created_at),
            ("by", group.created_by.name if group.created_by else None),
            ("etag", group.etag),
        ]
    )
