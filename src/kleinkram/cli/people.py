"""`klein person …`, `klein group …` and `klein access …`"""

from typing import Annotated

import typer

from kleinkram import connect
from kleinkram.cli.commands import Noun
from kleinkram.cli.options import (
    AsJson,
    GlobArgument,
    IfMatch,
    Limit,
    MissionOption,
    ProjectOption,
    Text,
    Until,
    Yes,
    argument,
    confirm,
    flag,
    option,
)
from kleinkram.cli.render import details, line, moment, note, show_json, show_json_list, show_rows, table
from kleinkram.cli.units import parse_time
from kleinkram.client import Client
from kleinkram.client.errors import InvalidInput
from kleinkram.client.people import Place, find_grant
from kleinkram.contract.access import AccessRead, GrantRead, GroupRead, Right
from kleinkram.contract.accounts import OneTimeLink
from kleinkram.contract.people import PersonRead

person_app = Noun("Manage people. You see those who share a group or a project with you; admins see all.")
PersonArgument = Annotated[str, argument("PERSON", "Name, id, or an address that you may see.")]


@person_app.command("list")
def list_people(
    text: Annotated[Text, argument("TEXT", "Text that names contain.")] = None,
    left: Annotated[bool, flag("--left", "List those who left; for admins.")] = False,
    limit: Limit = None,
    as_json: AsJson = False,
) -> None:
    """List people, by name."""
    with connect() as client:
        show_rows(
            client.people.list(text=text, active=not left, limit=limit),
            as_json,
            ["name", "addresses", "admin", "id"],
            lambda row: (row.name, row.emails or None, row.is_admin, row.id),
        )


@person_app.command("info")
def show_person(who: PersonArgument, as_json: AsJson = False) -> None:
    """Show one person."""
    with connect() as client:
        _show_person(client.people.get(who), as_json)


@person_app.command("admin")
def make_admin(
    who: PersonArgument,
    end: Annotated[bool, flag("--end", "Take the admin role away.")] = False,
    yes: Yes = False,
    as_json: AsJson = False,
) -> None:
    """Make a person an admin, who can see and do everything."""
    with connect() as client:
        person = client.people.get(who)
        if end:
            changed = client.people.unmake_admin(person.id)
        else:
            confirm(f"Let {person.name} see and do everything on this server?", yes)
            changed = client.people.make_admin(person.id)
    _show_person(changed, as_json)


@person_app.command("deactivate")
def deactivate(who: PersonArgument, yes: Yes = False, as_json: AsJson = False) -> None:
    """End the sessions, tokens and links of a person. Projects that only they owned go to the admins."""
    with connect() as client:
        person = client.people.get(who)
        confirm(f"Deactivate {person.name} ({person.id})?", yes)
        ended = client.people.deactivate(person.id)
    if as_json:
        show_json(ended)
        return
    note(f"{person.name} left: {ended.sessions} sessions, {ended.tokens} tokens and {ended.links} links ended.")
    if ended.projects:
        note(f"The admins own now: {', '.join(ended.projects)}")


@person_app.command("reactivate")
def reactivate(who: PersonArgument, as_json: AsJson = False) -> None:
    """Let a person who left sign in again. Their tokens stay revoked."""
    with connect() as client:
        _show_person(client.people.reactivate(client.people.get(who).id), as_json)


@person_app.command("invite")
def invite(
    email: Annotated[str, argument("EMAIL")],
    name: Annotated[Text, option("--name", "NAME", "Set the name of the account.")] = None,
    as_json: AsJson = False,
) -> None:
    """Print a link that creates a local account with this address. No e-mail is sent: give them the link."""
    with connect() as client:
        _show_link(client.people.invite(email, name=name), as_json)


@person_app.command("reset")
def reset(who: PersonArgument, as_json: AsJson = False) -> None:
    """Print a link that sets a new password. No e-mail is sent: give them the link."""
    with connect() as client:
        _show_link(client.people.reset_password(client.people.get(who).id), as_json)


@person_app.command("reset-totp")
def reset_totp(who: PersonArgument, as_json: AsJson = False) -> None:
    """Remove the second factor of a person who lost their device. They sign in with their password alone."""
    with connect() as client:
        person = client.people.get(who)
        client.people.reset_totp(person.id)
    if as_json:
        show_json({"reset": str(person.id)})
        return
    note(f"{person.name} signs in with the password alone until they add a second factor again.")


def _show_link(made: OneTimeLink, as_json: bool) -> None:
    if as_json:
        show_json(made)
        return
    line(made.url)
    note(f"Valid once, until {moment(made.expires_at)}. Everybody who has it can use it.")
    if made.warning:
        note(f"Warning: {made.warning}")


def _show_person(person: PersonRead, as_json: bool) -> None:
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


group_app = Noun("Manage groups of people. Each member has the rights that were granted to the group.")
GroupArgument = Annotated[str, argument("GROUP", "Name or id of the group.")]
MembersArgument = Annotated[list[str], argument("PERSON", "Names, ids, or addresses that you may see.")]


@group_app.command("create")
def create_group(name: Annotated[str, argument("NAME")], as_json: AsJson = False) -> None:
    """Create a group, with you as its first member and editor."""
    with connect() as client:
        _show_group(client.groups.create(name), as_json)


@group_app.command("list")
def list_groups(name: GlobArgument = None, limit: Limit = None, as_json: AsJson = False) -> None:
    """List the groups that you are in; admins see all."""
    with connect() as client:
        show_rows(
            client.groups.list(name=name, limit=limit),
            as_json,
            ["name", "kind", "members", "editor", "until", "id"],
            lambda row: (row.name, row.kind.value, row.member_count, row.is_editor, row.expires_at, row.id),
        )


@group_app.command("info")
def show_group(group: GroupArgument, as_json: AsJson = False) -> None:
    """Show a group and its members."""
    with connect() as client:
        target = client.groups.get(group)
        members = [*client.groups.members(target.id)]
    if as_json:
        show_json({"group": target, "members": members})
        return
    _show_group(target, as_json=False)
    line("")
    table(
        ["member", "addresses", "editor", "until", "active", "id"],
        [
            (row.person.name, row.emails or None, row.is_editor, row.expires_at, row.is_active, row.person.id)
            for row in members
        ],
    )


@group_app.command("rename")
def rename_group(
    group: GroupArgument, name: Annotated[str, argument("NAME")], etag: IfMatch = None, as_json: AsJson = False
) -> None:
    """Rename a group."""
    with connect() as client:
        target = client.groups.get(group)
        _show_group(client.groups.rename(target.id, name, if_match=etag or target.etag), as_json)


@group_app.command("delete")
def delete_group(group: GroupArgument, yes: Yes = False, as_json: AsJson = False) -> None:
    """Delete a group, and every right that was granted to it."""
    with connect() as client:
        target = client.groups.get(group)
        confirm(f"Delete the group {target.name} of {target.member_count}, and its rights?", yes)
        client.groups.delete(target.id)
    show_json(target) if as_json else note(f"Deleted the group {target.name}.")


@group_app.command("add")
def add_members(
    group: GroupArgument,
    people: MembersArgument,
    editor: Annotated[bool, flag("--editor", "Let them add and remove members.")] = False,
    until: Until = None,
    as_json: AsJson = False,
) -> None:
    """Add people to a group, or change their role and the end of their membership."""
    expires_at = parse_time(until)
    with connect() as client:
        target = client.groups.get(group)
        chosen = [client.people.get(who) for who in people]
        rows = [client.groups.set_member(target.id, who.id, is_editor=editor, expires_at=expires_at) for who in chosen]
    if as_json:
        show_json_list(rows)
        return
    for row in rows:
        end = f" until {moment(row.expires_at)}" if row.expires_at else ""
        note(f"{row.person.name} is in {target.name}{end}.")


@group_app.command("remove")
def remove_members(group: GroupArgument, people: MembersArgument, as_json: AsJson = False) -> None:
    """Remove people from a group, or leave it."""
    with connect() as client:
        target = client.groups.get(group)
        chosen = [client.people.get(who) for who in people]
        for who in chosen:
            client.groups.remove_member(target.id, who.id)
    if as_json:
        show_json_list(chosen)
        return
    for who in chosen:
        note(f"{who.name} is in {target.name} no longer.")


def _show_group(group: GroupRead, as_json: bool) -> None:
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


access_app = Noun("Manage the rights on a project or a mission.")
GranteeOption = Annotated[
    str, option("--to", "WHO", "Name the address, or the person or group by name or id.", show_default=False)
]


@access_app.command("list")
def list_access(
    project: ProjectOption = None,
    mission: MissionOption = None,
    grants: Annotated[bool, flag("--grants", "List what was granted here, including what has expired.")] = False,
    as_json: AsJson = False,
) -> None:
    """List who has which right here now, and through what. Without WRITE here, you see only your own rights."""
    with connect() as client:
        place = _place(client, project, mission)
        if grants:
            show_rows(client.access.grants(place), as_json, ["right", "to", "by", "until"], _grant_cells)
        else:
            show_rows(client.access.ways(place), as_json, ["who", "right", "through", "until"], _access_cells)


@access_app.command("grant")
def grant(
    right: Annotated[
        Right, typer.Argument(metavar="RIGHT", help="READ, CREATE, WRITE or DELETE.", case_sensitive=False)
    ],
    to: GranteeOption,
    project: ProjectOption = None,
    mission: MissionOption = None,
    until: Until = None,
    as_json: AsJson = False,
) -> None:
    """Grant a right. It replaces the right that they were granted here before."""
    expires_at = parse_time(until)
    with connect() as client:
        place = _place(client, project, mission)
        made = client.access.grant(place, client.access.grantee(to), right, expires_at=expires_at)
    if as_json:
        show_json(made)
        return
    end = f" until {moment(made.expires_at)}" if made.expires_at else ""
    note(f"{made.to.name} has {made.right.value} on the {made.on.value} {place.name}{end}.")


@access_app.command("revoke")
def revoke(
    to: GranteeOption, project: ProjectOption = None, mission: MissionOption = None, as_json: AsJson = False
) -> None:
    """Revoke a right that was granted here. Rights from elsewhere stay: see `klein access list`."""
    with connect() as client:
        place = _place(client, project, mission)
        target = find_grant(client.access.grants(place), to)
        client.access.revoke(place, target.id)
    if as_json:
        show_json(target)
        return
    note(f"Took {target.right.value} on the {target.on.value} {place.name} from {target.to.name}.")


def _place(client: Client, project: str | None, mission: str | None) -> Place:
    if mission is not None:
        return client.missions.get(mission, project=project)
    if project is None:
        raise InvalidInput(what="The command", reason="say which project (-p), or which mission of it (-m)")
    return client.projects.get(project)


def _grant_cells(row: GrantRead) -> tuple[object, ...]:
    until = f"{moment(row.expires_at)} (over)" if row.has_expired and row.expires_at else row.expires_at
    return row.right.value, f"{row.to.kind.value} {row.to.name}", row.granted_by and row.granted_by.name, until


def _access_cells(row: AccessRead) -> tuple[object, ...]:
    through = row.through.value
    if row.to is None:
        who = "admins" if through == "admin" else "everybody"
    elif row.person is None:
        who = f"{row.to.kind.value} {row.to.name}"
    else:
        who = row.person.name
        through += "" if row.to.id == row.person.id else f", {row.to.kind.value} {row.to.name}"
    return who, row.right.value, through, row.expires_at
