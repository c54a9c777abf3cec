"""`klein person …`, `klein group …` and `klein access …`: people, their rights, and their personal data."""

import itertools
import json
import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Annotated

import typer

from kleinkram.cli import options
from kleinkram.cli.commands import Subcommands, Text, argument, flag, option
from kleinkram.cli.render import Output, as_details, as_table, details, line, moment, note, table
from kleinkram.cli.units import count, parse_time
from kleinkram.client import Client
from kleinkram.client.errors import DestinationRefused, InvalidInput
from kleinkram.client.people import AccessResource, find_grant
from kleinkram.contract.access import AccessRead, GrantRead, GroupRead, Right
from kleinkram.contract.accounts import OneTimeLink
from kleinkram.contract.errors import NotAuthenticated
from kleinkram.contract.people import Erasure, PersonalData, PersonRead

person_app = Subcommands("Manage people. You see those who share a group or a project with you; admins see all.")
# How long `erase` waits for the job that redacts the audit log.
_REDACTION_WAIT_S = 60.0
PersonArgument = Annotated[str, argument("PERSON", "Name, id, or an address that you may see.")]


@person_app.command("list")
def list_people(
    client: Client,
    text: Annotated[Text, argument("TEXT", "Text that names contain.")] = None,
    left: Annotated[bool, flag("--left", "List those who left; for admins.")] = False,
    limit: options.Limit = None,
) -> Output:
    """List people, by name."""
    return as_table(
        client.people.list(text=text, active=not left, limit=limit),
        ["name", "addresses", "admin", "id"],
        lambda row: (row.name, row.emails or None, row.is_admin, row.id),
    )


@person_app.command("info")
def show_person(client: Client, who: PersonArgument) -> Output:
    """Show one person."""
    return _person(client.people.get(who))


@person_app.command("admin")
def make_admin(
    client: Client,
    who: PersonArgument,
    end: Annotated[bool, flag("--end", "Revoke the admin role.")] = False,
    yes: options.Yes = False,
) -> Output:
    """Make a person an admin, who can see and do everything."""
    person = client.people.get(who)
    if end:
        return _person(client.people.unmake_admin(person.id))
    options.confirm(f"Let {person.name} see and do everything on this server?", yes)
    return _person(client.people.make_admin(person.id))


@person_app.command("deactivate")
def deactivate(client: Client, who: PersonArgument, yes: options.Yes = False) -> Output:
    """End the sessions, tokens and links of a person. Projects that only they owned go to the admins."""
    person = client.people.get(who)
    options.confirm(f"Deactivate {person.name} ({person.id})?", yes)
    ended = client.people.deactivate(person.id)
    text = f"{person.name} left: {ended.sessions} sessions, {ended.tokens} tokens and {ended.links} links ended."
    if ended.projects:
        text += f" The admins own now: {', '.join(ended.projects)}"
    return Output(ended, text)


@person_app.command("reactivate")
def reactivate(client: Client, who: PersonArgument) -> Output:
    """Let a person who left sign in again. Their tokens stay revoked."""
    return _person(client.people.reactivate(client.people.get(who).id))


@person_app.command("erase")
def erase(
    client: Client,
    who: PersonArgument,
    confirmation: Annotated[
        Text, option("--confirm", "NAME", "The name of the person, instead of typing it when asked.")
    ] = None,
) -> Output:
    """Erase a person irrevocably: their data is deleted, and a pseudonym replaces their name everywhere.

    What they did stays on record. Texts that mention them are listed, and stay as they are.
    """
    person = client.people.get(who)
    if person.erased_at is not None:
        return _erased(client.people.erasure(person.id, wait_s=_REDACTION_WAIT_S), [])
    if confirmation is None:
        note(f"This cannot be undone: {person.name} ({person.id}) loses all access, and their data is deleted.")
        confirmation = options.type_name(f"Type the name {person.name!r} to erase this person")
    made = client.people.erase(person.id, confirmation=confirmation)
    erasure = made.model_copy(update={"audit_events": _redacted_events(client, person)})
    ended = f"{erasure.sessions} sessions, {erasure.tokens} tokens and {erasure.links} links ended."
    notes = [f"{person.name} is erased, and appears as {erasure.person.name}: {ended}"]
    if erasure.projects:
        notes.append(f"The admins own now: {', '.join(erasure.projects)}")
    return _erased(erasure, notes)


def _redacted_events(client: Client, person: PersonRead) -> int | None:
    try:
        return client.people.erasure(person.id, wait_s=_REDACTION_WAIT_S).audit_events
    except NotAuthenticated:  # admins may erase themselves
        return None


def _erased(erasure: Erasure, notes: list[str]) -> Output:
    if erasure.audit_events is None:
        notes.append("A worker will redact the audit log; run the command again to see whether it is done.")
    else:
        notes.append(f"Redacted {count(erasure.audit_events, 'event')} of the audit log.")
    if not erasure.mentions:
        return Output(erasure, notes)
    mentions = erasure.mentions

    def show() -> None:
        for text in notes:
            note(text)
        note("These texts still mention the person; change them where that is necessary:")
        table(
            ["what", "name", "where", "id"],
            [(row.resource_type.value, row.name, ", ".join(row.fields), row.id) for row in mentions],
        )

    return Output(erasure, show)


@person_app.command("export")
def export(
    client: Client,
    who: Annotated[Text, argument("PERSON", "Name, id or address; yourself by default.")] = None,
    output: Annotated[
        Path | None, option("--output -o", "FILE", "Write to this new file, which only you can read.")
    ] = None,
) -> Output:
    """Write all that the server keeps of a person to a JSON file: yours, or as an admin, anybody's. No secrets."""
    if output is None:
        raise InvalidInput(what="The command", reason="specify the file to write: -o FILE")
    person_id = client.me.get().person.id if who is None else client.people.get(who).id
    try:
        written = _write_sections(output, client.people.export(person_id))
    except FileExistsError:
        raise DestinationRefused(path=str(output), reason="it exists; remove it, or choose another name") from None
    except OSError as error:
        raise DestinationRefused(path=str(output), reason=error.strerror or str(error)) from None
    return Output({"path": str(output), "records": written}, f"Wrote {count(written, 'record')} to {output}.")


def _write_sections(path: Path, records: Iterable[PersonalData]) -> int:
    """Write an object with a list for each section, record by record; an incomplete file is removed."""
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    written = 0
    try:
        with os.fdopen(descriptor, "w", encoding="utf-8") as file:
            for piece, is_record in _json_pieces(records):
                file.write(piece)
                written += is_record
    except BaseException:
        path.unlink(missing_ok=True)
        raise
    return written


def _json_pieces(records: Iterable[PersonalData]) -> Iterator[tuple[str, bool]]:
    """Yield a JSON document piece by piece, and whether a piece is a record."""
    separator = "{"
    for section, rows in itertools.groupby(records, key=lambda row: row.section):
        yield f'{separator}\n"{section.value}": [', False
        for number, row in enumerate(rows):
            yield f"{',' if number else ''}\n {json.dumps(row.record, ensure_ascii=False)}", True
        yield "\n]", False
        separator = ","
    yield "\n}\n", False


@person_app.command("invite")
def invite(
    client: Client,
    email: Annotated[str, argument("EMAIL")],
    name: Annotated[Text, option("--name", "NAME", "Set the name of the account.")] = None,
) -> Output:
    """Print a link that creates a local account with this address. No e-mail is sent: give them the link."""
    return _link(client.people.invite(email, name=name))


@person_app.command("reset")
def reset(client: Client, who: PersonArgument) -> Output:
    """Print a link that sets a new password. No e-mail is sent: give them the link."""
    return _link(client.people.reset_password(client.people.get(who).id))


@person_app.command("reset-totp")
def reset_totp(client: Client, who: PersonArgument) -> Output:
    """Remove the second factor of a person who lost their device. They sign in with their password alone."""
    person = client.people.get(who)
    client.people.reset_totp(person.id)
    text = f"{person.name} signs in with the password alone until they add a second factor again."
    return Output({"reset": str(person.id)}, text)


def _link(made: OneTimeLink) -> Output:
    def show() -> None:
        line(made.url)
        note(f"Valid once, until {moment(made.expires_at)}. Everybody who has it can use it.")
        if made.warning:
            note(f"Warning: {made.warning}")

    return Output(made, show)


def _person(person: PersonRead) -> Output:
    return as_details(
        person,
        [
            ("person", person.name),
            ("id", person.id),
            ("addresses", person.emails),
            ("admin", person.is_admin),
            ("since", person.created_at),
            ("left", person.deactivated_at),
            ("erased", person.erased_at),
        ],
    )


group_app = Subcommands("Manage groups of people. Each member has the rights that were granted to the group.")
GroupArgument = Annotated[str, argument("GROUP", "Name or id of the group.")]
MembersArgument = Annotated[list[str], argument("PERSON", "Names, ids, or addresses that you may see.")]


@group_app.command("create")
def create_group(client: Client, name: Annotated[str, argument("NAME")]) -> Output:
    """Create a group, with you as its first member and editor."""
    return _group(client.groups.create(name))


@group_app.command("list")
def list_groups(client: Client, name: options.GlobArgument = None, limit: options.Limit = None) -> Output:
    """List the groups that you are in; admins see all."""
    return as_table(
        client.groups.list(name=name, limit=limit),
        ["name", "kind", "members", "editor", "until", "id"],
        lambda row: (row.name, row.kind.value, row.member_count, row.is_editor, row.expires_at, row.id),
    )


@group_app.command("info")
def show_group(client: Client, group: GroupArgument) -> Output:
    """Show a group and its members."""
    target = client.groups.get(group)
    members = [*client.groups.members(target.id)]

    def show() -> None:
        details(_group_details(target))
        line("")
        table(
            ["member", "addresses", "editor", "until", "active", "id"],
            [
                (row.person.name, row.emails or None, row.is_editor, row.expires_at, row.is_active, row.person.id)
                for row in members
            ],
        )

    return Output({"group": target, "members": members}, show)


@group_app.command("rename")
def rename_group(
    client: Client, group: GroupArgument, name: Annotated[str, argument("NAME")], etag: options.IfMatch = None
) -> Output:
    """Rename a group."""
    target = client.groups.get(group)
    return _group(client.groups.rename(target.id, name, if_match=etag or target.etag))


@group_app.command("delete")
def delete_group(client: Client, group: GroupArgument, yes: options.Yes = False) -> Output:
    """Delete a group, and every right that was granted to it."""
    target = client.groups.get(group)
    options.confirm(f"Delete the group {target.name} ({count(target.member_count, 'member')}) and its rights?", yes)
    client.groups.delete(target.id)
    return Output(target, f"Deleted the group {target.name}.")


@group_app.command("add")
def add_members(
    client: Client,
    group: GroupArgument,
    people: MembersArgument,
    editor: Annotated[bool, flag("--editor", "Let them add and remove members.")] = False,
    until: options.Until = None,
) -> Output:
    """Add people to a group, or change their role and the end of their membership."""
    expires_at = parse_time(until)
    target = client.groups.get(group)
    chosen = [client.people.get(who) for who in people]
    rows = [client.groups.set_member(target.id, who.id, is_editor=editor, expires_at=expires_at) for who in chosen]
    ends = [f" until {moment(row.expires_at)}" if row.expires_at else "" for row in rows]
    notes = [f"{row.person.name} is in {target.name}{end}." for row, end in zip(rows, ends, strict=True)]
    return Output({"items": rows}, notes)


@group_app.command("remove")
def remove_members(client: Client, group: GroupArgument, people: MembersArgument) -> Output:
    """Remove people from a group, or leave it."""
    target = client.groups.get(group)
    chosen = [client.people.get(who) for who in people]
    for who in chosen:
        client.groups.remove_member(target.id, who.id)
    return Output({"items": chosen}, [f"{who.name} is no longer in {target.name}." for who in chosen])


def _group(group: GroupRead) -> Output:
    return as_details(group, _group_details(group))


def _group_details(group: GroupRead) -> list[tuple[str, object]]:
    return [
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


access_app = Subcommands("Manage the rights on a project or a mission.")
GranteeOption = Annotated[
    str, option("--to", "WHO", "The e-mail address, or the name or id of the person or group.", show_default=False)
]


@access_app.command("list")
def list_access(
    client: Client,
    project: options.ProjectOption = None,
    mission: options.MissionOption = None,
    grants: Annotated[bool, flag("--grants", "List what was granted here, including what has expired.")] = False,
) -> Output:
    """List who has which right on a project or mission now, and its source. Without WRITE, you see only your own."""
    resource = _resource(client, project, mission)
    if grants:
        return as_table(client.access.grants(resource), ["right", "to", "by", "until"], _grant_cells)
    return as_table(client.access.ways(resource), ["who", "right", "through", "until"], _access_cells)


@access_app.command("grant")
def grant(
    client: Client,
    right: Annotated[
        Right, typer.Argument(metavar="RIGHT", help="READ, CREATE, WRITE or DELETE.", case_sensitive=False)
    ],
    to: GranteeOption,
    project: options.ProjectOption = None,
    mission: options.MissionOption = None,
    until: options.Until = None,
) -> Output:
    """Grant a right. It replaces the right that they were granted here before."""
    resource = _resource(client, project, mission)
    made = client.access.grant(resource, client.access.grantee(to), right, expires_at=parse_time(until))
    end = f" until {moment(made.expires_at)}" if made.expires_at else ""
    return Output(made, f"{made.to.name} has {made.right.value} on the {made.on.value} {resource.name}{end}.")


@access_app.command("revoke")
def revoke(
    client: Client,
    to: GranteeOption,
    project: options.ProjectOption = None,
    mission: options.MissionOption = None,
) -> Output:
    """Revoke a right that was granted here. Rights from elsewhere stay: see `klein access list`."""
    resource = _resource(client, project, mission)
    target = find_grant(client.access.grants(resource), to)
    client.access.revoke(resource, target.id)
    return Output(target, f"Took {target.right.value} on the {target.on.value} {resource.name} from {target.to.name}.")


def _resource(client: Client, project: Text, mission: Text) -> AccessResource:
    if mission is not None:
        return client.missions.get(mission, project=project)
    if project is None:
        raise InvalidInput(what="The command", reason="specify a project (-p), or a mission of it (-m)")
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
