"""`klein audit`"""

from typing import Annotated

import typer

from kleinkram import connect
from kleinkram.cli.options import AsJson, Limit, ProjectOption
from kleinkram.cli.render import show_json_list, table


def audit(
    project: ProjectOption = None,
    noun: Annotated[str | None, typer.Option("--noun", help="Only of these: project, mission, file, …")] = None,
    limit: Limit = 100,
    as_json: AsJson = False,
) -> None:
    """List who did what to what, latest first."""
    with connect() as client:
        project_id = None if project is None else client.projects.get(project).id
        rows = [*client.audit.list(noun=noun, project_id=project_id, limit=limit)]
    if as_json:
        show_json_list(rows)
        return
    table(
        ["at", "who", "did", "to", "name", "request"],
        [
            (row.at, row.actor.name if row.actor else None, row.operation, row.noun, row.noun_name, row.request_id)
            for row in rows
        ],
    )
