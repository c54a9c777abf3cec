"""Which of the places where something changed somebody may know of."""

import uuid
from collections.abc import Collection
from typing import Any

from sqlalchemy import Select

from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import reached_missions, reached_projects
from kleinkram.server.db import among
from kleinkram.server.tables import mission, project


def known_missions(actor: Actor, mission_ids: Collection[uuid.UUID]) -> Select[Any]:
    """Return ids of missions that `actor` may know of, with those of their projects."""
    columns = (mission.c.id, mission.c.project_id)
    stmt = reached_missions(actor).with_only_columns(*columns, maintain_column_froms=True)
    return stmt.where(among(mission.c.id, mission_ids))


def known_projects(actor: Actor, project_ids: Collection[uuid.UUID]) -> Select[Any]:
    """Return ids of projects that `actor` may know of."""
    return reached_projects(actor).with_only_columns(project.c.id).where(among(project.c.id, project_ids))
