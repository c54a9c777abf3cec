"""What is asked of grants. Functions return selects; they touch no connection."""

import datetime
import uuid
from dataclasses import dataclass
from typing import Any

from sqlalchemy import ColumnElement, Row, Select, collate, func, select

from kleinkram.contract.grants import Grantee, GranteeKind, GrantOn, GrantRead
from kleinkram.contract.people import PersonRef
from kleinkram.contract.rights import GroupKind, Right
from kleinkram.server.access.actor import Actor, unexpired
from kleinkram.server.access.visible import (
    lasting_level_on_mission,
    lasting_level_on_project,
    level_on_mission,
    level_on_project,
    visible_missions,
    visible_projects,
)
from kleinkram.server.paging import Order
from kleinkram.server.tables import access_grant, access_group, mission, person, project

# People whose own group a grantee's is, and whoever gave a grant.
grantee, giver = person.alias("grantee"), person.alias("giver")
_KINDS = {GroupKind.person.value: GranteeKind.person, GroupKind.email.value: GranteeKind.email}


@dataclass(frozen=True)
class Place:
    """What a grant is on: one project or one mission."""

    on: GrantOn
    id: uuid.UUID

    @property
    def key(self) -> str:
        """The name of the column of a grant that says so."""
        return f"{self.on.value}_id"


def place_seen(actor: Actor, place: Place) -> Select[Any]:
    """Return a visible place: `project_id`, and the `level` that `actor` holds there now."""
    project_id = project.c.id.label("project_id")
    if place.on is GrantOn.project:
        level = level_on_project(actor).label("level")
        return visible_projects(actor).with_only_columns(project_id, level).where(project.c.id == place.id)
    seen = visible_missions(actor).where(mission.c.id == place.id)
    return seen.with_only_columns(project_id, level_on_mission(actor).label("level"), maintain_column_froms=True)


def level_until(actor: Actor, place: Place, until: datetime.datetime | None) -> Select[Any]:
    """Return the level that `actor` will still hold on a visible place then, or for good."""
    if place.on is GrantOn.project:
        lasting = lasting_level_on_project(actor, until)
        return visible_projects(actor).with_only_columns(lasting).where(project.c.id == place.id)
    seen = visible_missions(actor).where(mission.c.id == place.id)
    return seen.with_only_columns(lasting_level_on_mission(actor, until), maintain_column_froms=True)


def grantee_name() -> ColumnElement[str]:
    """Return the name of whom a grant is to, of a select that joins `grantee`."""
    return collate(func.coalesce(grantee.c.name, access_group.c.name), "C")


def grants_on(place: Place) -> Select[Any]:
    """Return the grants on a place, as `to_grant` reads them; those that have expired too."""
    return (
        select(
            access_grant,
            access_group.c.kind,
            access_group.c.person_id,
            grantee_name().label("grantee_name"),
            giver.c.name.label("giver_name"),
            (~unexpired(access_grant.c.expires_at)).label("has_expired"),
        )
        .join_from(access_grant, access_group, access_group.c.id == access_grant.c.group_id)
        .outerjoin(grantee, grantee.c.id == access_group.c.person_id)
        .outerjoin(giver, giver.c.id == access_grant.c.granted_by_id)
        .where(access_grant.c[place.key] == place.id)
    )


def grant_order() -> Order:
    """Return a list's order: by the name of whom a right was given to."""
    return Order([grantee_name(), access_grant.c.id])


def to_grant(row: Row[Any]) -> GrantRead:
    """Return the grant that a row stands for."""
    return GrantRead(
        id=row.id,
        on=GrantOn.project if row.project_id else GrantOn.mission,
        to=to_grantee(row.kind, row.person_id or row.group_id, row.grantee_name),
        right=Right.of_level(row.level),
        expires_at=row.expires_at,
        has_expired=bool(row.has_expired),
        granted_at=row.created_at,
        granted_by=PersonRef(id=row.granted_by_id, name=row.giver_name) if row.granted_by_id else None,
    )


def to_grantee(kind: str, ref: uuid.UUID, name: str) -> Grantee:
    """Return whom a right is given to, from their group's kind."""
    told = _KINDS.get(kind, GranteeKind.group)
    return Grantee(kind=told, id=None if told is GranteeKind.email else ref, name=name)
