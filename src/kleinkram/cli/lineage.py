"""`klein lineage`"""

from typing import Annotated

import typer

from kleinkram import connect
from kleinkram.cli.options import AsJson, MissionOption, ProjectOption
from kleinkram.cli.render import details, line, note, show_json, table
from kleinkram.cli.run_view import action_name, mission_name, standing
from kleinkram.contract.runs import LineageFile, LineageRead, LineageRun


def lineage(
    file: Annotated[str, typer.Argument(metavar="FILE", help="Path or id.", show_default=False)],
    project: ProjectOption = None,
    mission: MissionOption = None,
    as_json: AsJson = False,
) -> None:
    """Show which run made a file, of what, and which runs have read it, and what they made of it."""
    with connect() as client:
        lineage_read = client.files.lineage(client.files.get(file, mission=mission, project=project).id)
    show_json(lineage_read) if as_json else _show(lineage_read)


def _show(lineage_read: LineageRead) -> None:
    line(f"{lineage_read.file.path}  sha256 {lineage_read.file.sha256}")
    line("")
    if lineage_read.made_by is None:
        line("Uploaded: no run made it.")
    else:
        line("Made by")
        _show_maker(lineage_read.made_by)
    if lineage_read.read_by:
        line("")
        line("Read by")
        table(
            ["mission", "action", "state", "ended", "files made", "artifacts", "run"],
            [
                (
                    mission_name(row.run),
                    action_name(row.run.action),
                    standing(row.run),
                    row.run.ended_at,
                    [_file(made) for made in row.files] or None,
                    row.artifact_count,
                    row.run.id,
                )
                for row in lineage_read.read_by
            ],
        )
    if lineage_read.truncated:
        note("More runs read it; `klein run list` has all.")


def _show_maker(made_by: LineageRun) -> None:
    run = made_by.run
    details(
        [
            ("run", run.id),
            ("action", action_name(run.action)),
            ("version", run.version_id),
            ("image", run.image_digest),
            ("runner", run.runner),
            ("started", run.started_at),
            ("ended", run.ended_at),
            *((f"  {name}", value) for name, value in run.parameters.items()),
        ]
    )
    line("")
    table(
        ["of the file", "sha256", "id"],
        [(_file(row), row.sha256, row.id) for row in made_by.inputs],
    )


def _file(file: LineageFile) -> str:
    return file.path if file.id is not None else f"{file.path} (not there any more, or not yours to see)"
