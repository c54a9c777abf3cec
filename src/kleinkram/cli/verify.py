"""`klein verify`"""

from collections.abc import Sequence
from typing import Annotated

import typer

from kleinkram import connect
from kleinkram.cli.errors import ExitCode, exit_code_of
from kleinkram.cli.filters import Choice, Many, select_files
from kleinkram.cli.options import AsJson, MissionsOption, ProjectsOption, the_only, the_ref
from kleinkram.cli.render import moment, note, show_json, table
from kleinkram.cli.transfer_view import plain_error, say_left_out
from kleinkram.cli.units import count, size
from kleinkram.client import Client
from kleinkram.client.errors import ClientError, InvalidInput, NothingToDo
from kleinkram.client.transfer import FileVerdict, UploadPlan, Verdict, plan_upload, verify_local, verify_remote


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
    """Compare local files with a mission's by SHA-256; with --remote, have the server verify its stored bytes again."""
    left_out: Sequence[ClientError] = ()
    with connect() as client:
        if remote:
            found = _remote(client, project, mission, paths or [], timeout)
        else:
            plan = _plan(paths or [])
            one_mission = the_ref("mission", None, the_only("mission", mission))
            mission_id = client.missions.get(one_mission, project=the_only("project", project)).id
            found, left_out = verify_local(client.files, mission_id, plan), plan.left_out
    if as_json:
        show_json({"items": [_plain(one) for one in found], "left_out": [plain_error(each) for each in left_out]})
    else:
        table(
            ["verdict", "path", "size"],
            [(one.verdict.value, path, size(one.size_bytes)) for one, path in _named(found)],
        )
        _say_damage(found)
    unread = [one.error for one in found if one.error is not None]
    say_left_out(unread)
    odd = [one for one in found if one.verdict is not Verdict.same]
    note(f"{len(found) - len(odd)} of {count(len(found) + len(left_out), 'file')} are the same.")
    if len(odd) > len(unread):
        raise typer.Exit(ExitCode.bytes_differ)
    if code := exit_code_of([*unread, *left_out]):
        raise typer.Exit(code)


def _plan(paths: list[str]) -> UploadPlan:
    if not paths:
        raise InvalidInput(what="The command", reason="say which local files to compare, or --remote")
    plan = plan_upload(paths, include_active=True)
    say_left_out(plan.left_out)
    if not plan.files and not plan.left_out:
        raise NothingToDo(reason="There is no file in these paths")
    return plan


def _remote(client: Client, project: Many, mission: Many, paths: list[str], timeout_s: float) -> list[FileVerdict]:
    choice = Choice(project=project, mission=mission)
    if choice.is_empty() and not paths:
        raise InvalidInput(what="The command", reason="say which files: -p, -m, a path, a glob or an id")
    files = select_files(client, choice, paths)
    if not files:
        raise NothingToDo(reason="No file matches")
    return verify_remote(client.files, files, timeout_s=timeout_s)


def _named(found: list[FileVerdict]) -> list[tuple[FileVerdict, str]]:
    """Return each with its path, and with project and mission before it where these are several."""
    places = [(one.file.mission.project.name, one.file.mission.name) if one.file else () for one in found]
    if len({place for place in places if place}) < 2:
        return [(one, one.path) for one in found]
    return [(one, "/".join([*place, one.path])) for one, place in zip(found, places, strict=True)]


def _say_damage(found: list[FileVerdict]) -> None:
    for one, path in _named(found):
        if one.file is not None and one.file.damaged_at is not None:
            reason, since = one.file.state_reason, moment(one.file.damaged_at)
            note(f"{path} is {one.file.state.value} since {since}: {reason}. Upload it again to mend it.")


def _plain(one: FileVerdict) -> dict[str, object]:
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
