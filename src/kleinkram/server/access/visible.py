"""What somebody may see: the selects that every other select narrows.

Today there is one owner, who sees all that is not in the trash; rights are added here and nowhere else.
"""

from typing import Any

from sqlalchemy import Select, select

from kleinkram.server.access.actor import Actor
from kleinkram.server.tables import blob, file, mission, project


def visible_projects(actor: Actor) -> Select[Any]:
    """Return the projects that `actor` may see."""
    return select(project).where(project.c.deleted_at.is_(None))


def visible_missions(actor: Actor) -> Select[Any]:
    """Return the missions that `actor` may see, joined with their projects."""
    return (
        select(mission)
        .join(project, project.c.id == mission.c.project_id)
        .where(mission.c.deleted_at.is_(None), project.c.deleted_at.is_(None))
    )


def visible_files(actor: Actor) -> Select[Any]:
    """Return the files that `actor` may see, joined with their missions, projects and blobs."""
    return (
        select(file)
        .join(mission, mission.c.id == file.c.mission_id)
        .join(project, project.c.id == mission.c.project_id)
        .join(blob, blob.c.id == file.c.blob_id)
        .where(file.c.deleted_at.is_(None), mission.c.deleted_at.is_(None), project.c.deleted_at.is_(None))
    )


def trashed_projects(actor: Actor) -> Select[Any]:
    """Return the projects in the trash that `actor` may see there."""
    return select(project).where(project.c.deleted_at.is_not(None))


def trashed_missions(actor: Actor) -> Select[Any]:
    """Return the missions in the trash by themselves that `actor` may see there, joined with their projects."""
    return select(mission).join(project, project.c.id == mission.c.project_id).where(mission.c.deleted_at.is_not(None))


def trashed_files(actor: Actor) -> Select[Any]:
    """Return the files in the trash by themselves that `actor` may see there, joined as in `visible_files`."""
    return (
        select(file)
        .join(mission, mission.c.id == file.c.mission_id)
        .join(project, project.c.id == mission.c.project_id)
        .join(blob, blob.c.id == file.c.blob_id)
        .where(file.c.deleted_at.is_not(None))
    )
