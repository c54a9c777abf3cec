"""`klein upload`"""

import time
import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from kleinkram import connect
from kleinkram.cli.commands import wants_json
from kleinkram.cli.errors import ExitCode, Interrupted, exit_code_of
from kleinkram.cli.options import (
    AsJson,
    Connections,
    DryRun,
    ExcludeOption,
    LimitRate,
    MissionOption,
    ProjectOption,
    read_text,
    the_ref,
)
from kleinkram.cli.render import note, show_json, table
from kleinkram.cli.transfer_view import plain_report, say_left_out, say_summary
from kleinkram.cli.units import count, parse_rate, size
from kleinkram.client import Client
from kleinkram.client.errors import InvalidInput, NothingToDo, ServerUnreachable, TimedOut
from kleinkram.client.transfer import UploadPlan, plan_upload
from kleinkram.client.transfer.plan import mission_folders
from kleinkram.client.transfer.upload import CONNECTIONS
from kleinkram.client.transfer.upload import upload as upload_files
from kleinkram.contract.errors import KleinkramError, NotFound
from kleinkram.contract.missions import MissionRead
from kleinkram.contract.names import is_id

_POLL_S = 0.3


def upload(
    paths: Annotated[list[str], typer.Argument(metavar="PATHS", help="Files and folders.", show_default=False)],
    project: ProjectOption = None,
    mission: MissionOption = None,
    create: Annotated[bool, typer.Option("--create", help="Make the mission if there is none.")] = False,
    metadata: Annotated[
        Path | None, typer.Option("--metadata", metavar="mission.yaml", help="The new mission's metadata.")
    ] = None,
    include_active: Annotated[
        bool, typer.Option("--include-active", help="Also files that are still being recorded.")
    ] = False,
    wait: Annotated[
        bool, typer.Option("--wait", help="Then wait until the server knows what is in the files.")
    ] = False,
    wait_limit: Annotated[
        float, typer.Option("--wait-limit", metavar="SECONDS", min=0, help="Wait at most so long.")
    ] = 600,
    exclude: ExcludeOption = None,
    mission_per_folder: Annotated[
        bool, typer.Option("--mission-per-folder", help="Each subfolder of PATHS is a mission of its name.")
    ] = False,
    limit_rate: LimitRate = None,
    connections: Connections = CONNECTIONS,
    dry_run: DryRun = False,
    as_json: AsJson = False,
) -> None:
    """Upload files and folders into a mission. The same command again resumes, and sends only what is missing.

    A folder keeps its tree: `day1` puts day1/cam.mcap, while `day1/` (or `.`) puts its contents, cam.mcap.
    """
    how = _How(
        create=create,
        metadata_yaml=read_text(metadata),
        include_active=include_active,
        exclude=exclude or [],
        bytes_per_s=parse_rate(limit_rate),
        connections=connections,
        wait_s=wait_limit if wait else None,
        dry_run=dry_run,
    )
    with connect() as client:
        if not mission_per_folder:
            told, code = _upload(client, project, the_ref("mission", None, mission), paths, how)
        elif mission is not None:
            raise InvalidInput(what="--mission-per-folder", reason="each folder names its mission: leave out --mission")
        else:
            told, code = _upload_folders(client, the_ref("project", None, project), paths, how)
    if as_json:
        show_json(told)
    if code:
        raise typer.Exit(code)


@dataclass(frozen=True)
class _How:
    """How to upload: what the options said."""

    create: bool
    metadata_yaml: str | None
    include_active: bool
    exclude: Sequence[str]
    bytes_per_s: float | None
    connections: int
    wait_s: float | None
    dry_run: bool


def _upload(
    client: Client, project: str | None, mission: str, paths: Sequence[str], how: _How
) -> tuple[dict[str, object], int]:
    """Upload into one mission; return what JSON says of it, and the exit code."""
    plan = plan_upload(paths, include_active=how.include_active, exclude=how.exclude)
    say_left_out(plan.left_out)
    if not plan.files and not plan.left_out:
        raise NothingToDo(reason="There is no file in these paths")
    found = _find(client, project, mission, how.create)
    if how.dry_run:
        return _show_plan(plan), 0
    target = found or _make(client, project, mission, how.metadata_yaml)
    if found is not None and how.metadata_yaml is not None:
        note("The mission exists; --metadata was left aside (`klein mission update` changes it).")
    return _transfer(client, target, plan, how)


def _upload_folders(client: Client, project: str, paths: Sequence[str], how: _How) -> tuple[dict[str, object], int]:
    """Upload each subfolder of some folders into a mission of its name; one that fails does not stop the others."""
    missions = mission_folders(paths, how.exclude)
    items: list[dict[str, object]] = []
    codes: set[int] = set()
    for name, folder in missions.items():
        note(f"{name}:")
        try:
            told, code = _upload(client, project, name, [f"{folder}/"], how)
        except (Interrupted, ServerUnreachable):
            raise  # so would the others
        except KleinkramError as error:
            told, code = {"error": str(error)}, exit_code_of([error])
            note(f"Error: {error}")
        items.append({"mission": name, **told})
        codes |= {code} if code else set()
    return {"items": items}, 0 if not codes else codes.pop() if len(codes) == 1 else ExitCode.several


def _find(client: Client, project: str | None, mission: str, create: bool) -> MissionRead | None:
    if not is_id(mission):
        project = the_ref("project", None, project)
    try:
        return client.missions.get(mission, project=project)
    except NotFound as error:
        if not create or is_id(mission) or error.noun != "mission":
            raise
    return None


def _make(client: Client, project: str | None, mission: str, metadata_yaml: str | None) -> MissionRead:
    project_id = client.projects.get(project or "").id
    made = client.missions.create(mission, project_id=project_id, metadata_yaml=metadata_yaml)
    note(f"Made the mission {made.project.name}/{made.name}.")
    return made


def _show_plan(plan: UploadPlan) -> dict[str, object]:
    if not wants_json():
        table(["path", "size", "from"], [(file.path, size(file.size_bytes), str(file.source)) for file in plan.files])
    files = [{"path": file.path, "local": str(file.source), "size_bytes": file.size_bytes} for file in plan.files]
    note(f"Would upload {count(len(plan.files), 'file')}, {size(plan.size_bytes)}.")
    return {"dry_run": True, "items": files, "left_out": [str(error) for error in plan.left_out]}


def _transfer(client: Client, mission: MissionRead, plan: UploadPlan, how: _How) -> tuple[dict[str, object], int]:
    from kleinkram.cli.transfer_view import watching

    began_at = time.monotonic()
    try:
        with watching() as watcher:
            report = upload_files(
                client, mission.id, plan, connections=how.connections, bytes_per_s=how.bytes_per_s, watcher=watcher
            )
    except KeyboardInterrupt:
        raise Interrupted from None
    elapsed_s = time.monotonic() - began_at
    say_summary(report, elapsed_s)
    code = exit_code_of([*report.failures, *report.left_out])
    if code == 0 and how.wait_s is not None:
        _wait_for_summaries(client, mission.id, how.wait_s)
    return {"mission_id": str(mission.id), "elapsed_s": elapsed_s, **plain_report(report)}, code


def _wait_for_summaries(client: Client, mission_id: uuid.UUID, seconds: float) -> None:
    deadline = time.monotonic() + seconds
    while True:
        mission = client.missions.get(mission_id)
        if mission.pending_file_count == 0 and mission.recordings_current:
            return
        if time.monotonic() > deadline:
            raise TimedOut(what=f"Reading {count(mission.pending_file_count, 'file')}", seconds=seconds)
        time.sleep(_POLL_S)
