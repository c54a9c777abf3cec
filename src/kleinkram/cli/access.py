"""`klein access …`"""

from typing import Annotated

import typer

from kleinkram import connect
from kleinkram.cli.commands import Noun
from kleinkram.cli.options import AsJson, MissionOption, ProjectOption, Until
from kleinkram.cli.render import escape, moment, note, show_json, show_json_list, table
from kleinkram.cli.units import parse_time
from kleinkram.client import Client
from kleinkram.client.errors import InvalidInput
from kleinkram.client.people import Place, find_grant
from kleinkram.contract.access import AccessRead, GrantRead, Right

app = Noun("Who may do what with a project or a mission.")

Whom = Annotated[
    str, typer.Option("--to", metavar="WHO", help="An address, or a person or group by name or id.", show_default=False)
]


@app.command("list")
def list_(
    project: ProjectOption = None,
    mission: MissionOption = None,
    grants: Annotated[bool, typer.Option("--grants", help="What was granted here; what has expired, too.")] = False,
    as_json: AsJson = False,
) -> None:
    """List who has a right here now, and by what. Who may not change it sees their own part."""
    with connect() as client:
        place = _place(client, project, mission)
        rows: list[GrantRead] | list[AccessRead]
        rows = [*client.access.grants(place)] if grants else [*client.access.ways(place)]
    if as_json:
        show_json_list(rows)
        return
    cells = [_granted(row) if isinstance(row, GrantRead) else _way(row) for row in rows]
    table(["right", "to", "by", "until"] if grants else ["who", "right", "through", "until"], cells)


@app.command("grant")
def grant(
    right: Annotated[
        Right, typer.Argument(metavar="RIGHT", help="READ, CREATE, WRITE or DELETE.", case_sensitive=False)
    ],
    to: Whom,
    project: ProjectOption = None,
    mission: MissionOption = None,
    until: Until = None,
    as_json: AsJson = False,
) -> None:
    """Give a right, in place of the one that they were given here before."""
    expires_at = parse_time(until)
    with connect() as client:
        place = _place(client, project, mission)
        made = client.access.grant(place, client.access.grantee(to), right, expires_at=expires_at)
    if as_json:
        show_json(made)
        return
    ending = f" until {moment(made.expires_at)}" if made.expires_at else ""
    note(f"{escape(made.to.name)} has {made.right.value} on the {made.on.value} {escape(place.name)}{ending}.")


@app.command("revoke")
def revoke(
    to: Whom,
    project: ProjectOption = None,
    mission: MissionOption = None,
    as_json: AsJson = False,
) -> None:
    """Take away what somebody was granted here. What they have from elsewhere stays: `klein access list`."""
    with connect() as client:
        place = _place(client, project, mission)
        target = find_grant(client.access.grants(place), to)
        client.access.revoke(place, target.id)
    if as_json:
        show_json(target)
        return
    note(f"Took {target.right.value} on the {target.on.value} {escape(place.name)} from {escape(target.to.name)}.")


def _place(client: Client, project: str | None, mission: str | None) -> Place:
    if mission is not None:
        return client.missions.get(mission, project=project)
    if project is None:
        raise InvalidInput(what="The command", reason="say which project (-p), or which mission of it (-m)")
    return client.projects.get(project)


def _granted(row: GrantRead) -> tuple[object, ...]:
    until = f"{moment(row.expires_at)} (over)" if row.has_expired and row.expires_at else row.expires_at
    return row.right.value, f"{row.to.kind.value} {row.to.name}", row.granted_by and row.granted_by.name, until


def _way(row: AccessRead) -> tuple[object, ...]:
    place = row.through.value
    if row.to is None:
        return ("admins" if row.through.value == "admin" else "everybody"), row.right.value, place, row.expires_at
    named = f"{row.to.kind.value} {row.to.name}"
    if row.person is None:
        return named, row.right.value, place, row.expires_at
    by_group = "" if row.to.id == row.person.id else f", {named}"
    return row.person.name, row.right.value, f"{place}{by_group}", row.expires_at
