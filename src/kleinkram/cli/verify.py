"""`klein verify`"""

from typing import Annotated

import typer

from kleinkram import connect
from kleinkram.cli.errors import ExitCode
from kleinkram.cli.filters import Choice, Many, select_files
from kleinkram.cli.options import AsJson, MissionsOption, ProjectsOption, the_only, the_ref
from kleinkram.cli.render import moment, note, show_json, table
from kleinkram.cli.transfer_view import say_left_out
from kleinkram.cli.units import size
from kleinkram.client import Client
from kleinkram.client.errors import InvalidInput, NothingToDo
from kleinkram.client.transfer import Verdict, Verified, plan_upload, verify_local, verify_remote


def verify(
    paths: Annotated[Many, typer.Argument(metavar="PATHS", help="Local files and folders.", show_default=False)] = None,
    project: ProjectsOption = None,
    mission: MissionsOption = None,
    remote: Annotated[
        bool, typer.Option("--remote", help="Have the server read its bytes again; PATHS are then the mission's.")
    ] = False,
    timeout: Annotated[float, typer.Option("--timeout", metavar="SECONDS", help="How long to wait for it.")] = 600.0,
    as_json: AsJson = False,
) -> None:
    """Compare local files with a mission's, byte for byte (by sha256); or prove those in the store again."""
    with connect() as client:
        if remote:
            found = _remote(client, project, mission, paths or [], timeout)
        else:
            one_mission = the_ref("mission", None, the_only("mission", mission))
            found = _local(client, the_only("project", project), one_mission, paths or [])
    if as_json:
        show_json({"items": [_plain(one) for one in found]})
    else:
        table(["verdict", "path", "size"], [(one.verdict.value, one.path, size(one.size_bytes)) for one in found])
        _say_damage(found)
    odd = sum(one.verdict is not Verdict.same for one in found)
    note(f"{len(found) - odd} of {len(found)} files are the same.")
    if odd:
        raise typer.Exit(ExitCode.bytes_differ)


def _local(client: Client, project: str | None, mission: str, paths: list[str]) -> list[Verified]:
    if not paths:
        raise InvalidInput(what="The command", reason="say which local files to compare, or --remote")
    plan = plan_upload(paths, include_active=True)
    say_left_out(plan.left_out)
    if not plan.files:
        raise NothingToDo(reason="There is no file in these paths")
    return verify_local(client.files, client.missions.get(mission, project=project).id, plan)


def _remote(client: Client, project: Many, mission: Many, paths: list[str], timeout_s: float) -> list[Verified]:
    choice = Choice(project=project, mission=mission)
    if choice.is_empty() and not paths:
        raise InvalidInput(what="The command", reason="say which files: -p, -m, a path, a glob or an id")
    files = select_files(client, choice, paths)
    if not files:
        raise NothingToDo(reason="No file matches")
    return verify_remote(client.files, files, timeout_s=timeout_s)


def _say_damage(found: list[Verified]) -> None:
    for one in found:
        if one.file is not None and one.file.damaged_at is not None:
            reason, since = one.file.state_reason, moment(one.file.damaged_at)
            note(f"{one.path} is {one.file.state.value} since {since}: {reason}. Upload it again to mend it.")


def _plain(one: Verified) -> dict[str, object]:
    state = one.file.state.value if one.file else None
    reason = one.file.state_reason if one.file else None
    return {
        "path": one.path,
        "verdict": one.verdict.value,
        "size_bytes": one.size_bytes,
        "sha256": one.sha256,
        "file_id": str(one.file.id) if one.file else None,
        "state": state,
        "state_reason": reason,
        "damaged_at": one.file.damaged_at.isoformat() if one.file and one.file.damaged_at else None,
    }
