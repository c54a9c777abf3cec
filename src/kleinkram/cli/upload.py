"""`klein upload`"""

import time
import uuid
from pathlib import Path
from typing import Annotated

import typer

from kleinkram import connect
from kleinkram.cli.errors import Interrupted, exit_code_of
from kleinkram.cli.options import (
    AsJson,
    Connections,
    DryRun,
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
from kleinkram.client.errors import NothingToDo, TimedOut
from kleinkram.client.transfer import UploadPlan, plan_upload
from kleinkram.client.transfer.upload import CONNECTIONS
from kleinkram.client.transfer.upload import upload as upload_files
from kleinkram.contract.errors import NotFound
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
    limit_rate: LimitRate = None,
    connections: Connections = CONNECTIONS,
    dry_run: DryRun = False,
    as_json: AsJson = False,
) -> None:
    """Upload files and folders into a mission. The same command again resumes, and sends only what is missing.

    A folder keeps its tree: `day1` puts day1/cam.mcap, while `day1/` (or `.`) puts its contents, cam.mcap.
    """
    bytes_per_s = parse_rate(limit_rate)
    text = read_text(metadata)
    with connect() as client:
        plan = plan_upload(paths, include_active=include_active)
        say_left_out(plan.left_out)
        if not plan.files and not plan.left_out:
            raise NothingToDo(reason="There is no file in these paths")
        found = _find(client, project, the_ref("mission", None, mission), create)
        if dry_run:
            _show_plan(plan, as_json)
            return
        target = found or _make(client, project, mission or "", text)
        if found is not None and text is not None:
            note("The mission exists; --metadata was left aside (`klein mission update` changes it).")
        _transfer(client, target, plan, connections, bytes_per_s, wait_limit if wait else None, as_json)


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


def _show_plan(plan: UploadPlan, as_json: bool) -> None:
    if as_json:
        files = [{"path": file.path, "local": str(file.source), "size_bytes": file.size_bytes} for file in plan.files]
        show_json({"dry_run": True, "items": files, "left_out": [str(error) for error in plan.left_out]})
        return
    table(["path", "size", "from"], [(file.path, size(file.size_bytes), str(file.source)) for file in plan.files])
    note(f"Would upload {count(len(plan.files), 'file')}, {size(plan.size_bytes)}.")


def _transfer(
    client: Client,
    mission: MissionRead,
    plan: UploadPlan,
    connections: int,
    bytes_per_s: float | None,
    wait: float | None,
    as_json: bool,
) -> None:
    from kleinkram.cli.progress import watching

    began_at = time.monotonic()
    try:
        with watching() as watcher:
            report = upload_files(
                client, mission.id, plan, connections=connections, bytes_per_s=bytes_per_s, watcher=watcher
            )
    except KeyboardInterrupt:
        raise Interrupted from None
    elapsed_s = time.monotonic() - began_at
    if as_json:
        show_json({"mission_id": str(mission.id), "elapsed_s": elapsed_s, **plain_report(report)})
    say_summary(report, elapsed_s)
    code = exit_code_of([*report.failures, *report.left_out])
    if code == 0 and wait is not None:
        _wait_for_summaries(client, mission.id, wait)
    if code != 0:
        raise typer.Exit(code)


def _wait_for_summaries(client: Client, mission_id: uuid.UUID, seconds: float) -> None:
    deadline = time.monotonic() + seconds
    while True:
        mission = client.missions.get(mission_id)
        if mission.pending_file_count == 0 and mission.recordings_current:
            return
        if time.monotonic() > deadline:
            raise TimedOut(what=f"Reading {count(mission.pending_file_count, 'file')}", seconds=seconds)
        time.sleep(_POLL_S)
