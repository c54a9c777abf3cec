"""`klein share …`"""

from typing import Annotated

import typer

from kleinkram import connect
from kleinkram.cli.commands import Noun
from kleinkram.cli.options import AsJson, Limit, MissionOption, ProjectOption, Until, the_ref
from kleinkram.cli.render import details, escape, line, note, show_json, show_json_list, table
from kleinkram.cli.units import count, ending, in_days, size
from kleinkram.contract.files import FileFilter
from kleinkram.contract.names import is_id

app = Noun("Links to a mission, or to some of its files, for people without an account.")

_USUAL_DAYS = 14


@app.command("create")
def create(
    files: Annotated[
        list[str] | None,
        typer.Argument(metavar="FILES", help="Paths, globs or ids; without, all of the mission.", show_default=False),
    ] = None,
    project: ProjectOption = None,
    mission: MissionOption = None,
    name: Annotated[str | None, typer.Option("--name", help="What it is for, or for whom.")] = None,
    until: Until = None,
    days: Annotated[
        int | None,
        typer.Option("--days", metavar="N", min=1, max=3650, help=f"It ends in so many days; usual: {_USUAL_DAYS}."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Make a link and print its address. Whoever has it may read what it shows; it is shown this once."""
    with connect() as client:
        now = client.service.now
        expires_at = ending(until, days, now) or in_days(_USUAL_DAYS, now)
        place = client.missions.get(the_ref("mission", None, mission), project=project)
        file_ids = None
        if files:
            chosen = [client.files.get(ref).id for ref in files if is_id(ref)]
            for path in (ref for ref in files if not is_id(ref)):
                share_read = [file.id for file in client.files.list(FileFilter(mission_id=place.id, path=[path]))]
                chosen += share_read or [client.files.get(path, mission=place.id).id]
            file_ids = [*dict.fromkeys(chosen)]
        made = client.shares.create(place.id, name or place.name, expires_at=expires_at, file_ids=file_ids)
    if as_json:
        show_json(made)
        return
    line(made.url)
    what = "all of" if file_ids is None else f"{count(len(file_ids), 'file')} of"
    note(
        f"Keep it now: nobody can show it again. It shows {what} {escape(place.name)} until "
        f"{made.share.expires_at:%Y-%m-%d %H:%M}Z; `klein share revoke {made.share.prefix}` ends it."
    )


@app.command("list")
def list_(
    project: ProjectOption = None,
    mission: MissionOption = None,
    ended: Annotated[bool, typer.Option("--ended", help="Also those that were revoked or have expired.")] = False,
    limit: Limit = None,
    as_json: AsJson = False,
) -> None:
    """List the links that you may end, latest first, with what was fetched by each."""
    with connect() as client:
        mission_id = None if mission is None else client.missions.get(mission, project=project).id
        rows = [*client.shares.list(mission_id=mission_id, ended=ended, limit=limit)]
    if as_json:
        show_json_list(rows)
        return
    table(
        ["name", "begins", "mission", "files", "by", "until", "revoked", "last used", "fetched", "bytes", "id"],
        [
            (
                row.name,
                row.prefix,
                f"{row.mission.project.name}/{row.mission.name}",
                "all" if row.file_count is None else row.file_count,
                row.created_by.name,
                row.expires_at,
                row.revoked_at,
                row.last_used_at,
                row.download_count,
                size(row.download_bytes),
                row.id,
            )
            for row in rows
        ],
    )


@app.command("revoke")
def revoke(
    ref: Annotated[
        str,
        typer.Argument(metavar="LINK", help="Its name, how it begins, its address or its id.", show_default=False),
    ],
    as_json: AsJson = False,
) -> None:
    """End a link, from the next request on."""
    with connect() as client:
        share_read = client.shares.get(ref)
        client.shares.revoke(share_read.id)
    if as_json:
        show_json({"revoked": share_read.model_dump(mode="json")})
        return
    details([("revoked", share_read.name), ("begins", share_read.prefix), ("id", share_read.id)])
