"""Selects of actions. Functions do not execute them."""

import uuid
from typing import Any

from sqlalchemy import ColumnElement, Row, Select, false, func, literal, or_, select

from kleinkram.contract.access import Right
from kleinkram.contract.actions import ActionDefinition, ActionFilter, ActionRead, ActionVersionRead
from kleinkram.contract.people import PersonRef
from kleinkram.contract.projects import ProjectRef
from kleinkram.server.access.actor import Actor, ActorKind
from kleinkram.server.access.visible import visible_projects
from kleinkram.server.db import matches_key
from kleinkram.server.pagination import Order
from kleinkram.server.tables import action, action_version, person, project

ACTION_ORDER = Order([action.c.name, action.c.id])
# Latest first.
VERSION_ORDER = Order([action_version.c.number, action_version.c.id], descending=True)
_maker = person.alias("version_maker")


def visible_actions(actor: Actor) -> Select[Any]:
    """Return the actions visible to `actor`: of projects that they may read, and with an account, the whole lab's.

    Joined with their projects, if any.
    """
    of_lab: ColumnElement[bool] = action.c.project_id.is_(None)
    if actor.kind is not ActorKind.person or actor.limits is not None:
        of_lab = false()
    seen = visible_projects(actor).with_only_columns(project.c.id)
    joined = select(action).outerjoin(project, project.c.id == action.c.project_id)
    return joined.where(or_(of_lab, action.c.project_id.in_(seen)))


def action_rows(actor: Actor, stmt: Select[Any]) -> Select[Any]:
    """Return the rows that `to_action` reads, of a select that began with `visible_actions`."""
    writable = visible_projects(actor, Right.write).with_only_columns(project.c.id)
    of_lab = action.c.project_id.is_(None) & (literal(actor.is_admin) | (action.c.created_by_id == actor.person_id))
    newest = select(func.max(action_version.c.number)).where(action_version.c.action_id == action.c.id)
    version = version_columns()
    return (
        stmt.add_columns(
            *version,
            project.c.name.label("project_name"),
            person.c.name.label("created_by_name"),
            or_(of_lab, action.c.project_id.in_(writable)).label("may_change"),
        )
        .join(person, person.c.id == action.c.created_by_id)
        .join(action_version, action_version.c.action_id == action.c.id)
        .join(_maker, _maker.c.id == action_version.c.created_by_id)
        .where(action_version.c.number == newest.correlate(action).scalar_subquery())
    )


def version_columns() -> list[ColumnElement[Any]]:
    """Return the columns of a version that `to_version` reads."""
    return [
        action_version.c.id.label("version_id"),
        action_version.c.number,
        action_version.c.definition,
        action_version.c.image_digest,
        action_version.c.created_at.label("version_created_at"),
        action_version.c.created_by_id.label("version_created_by_id"),
        _maker.c.name.label("version_created_by_name"),
    ]


def narrow(stmt: Select[Any], matching: ActionFilter) -> Select[Any]:
    """Return the actions of a select that match."""
    if matching.name is not None:
        stmt = stmt.where(matches_key(action.c.name_key, matching.name))
    if matching.project_id is not None:
        stmt = stmt.where(or_(action.c.project_id.is_(None), action.c.project_id == matching.project_id))
    if matching.archived is not None:
        stmt = stmt.where(action.c.archived_at.is_not(None) if matching.archived else action.c.archived_at.is_(None))
    return stmt


def versions_of(action_id: uuid.UUID) -> Select[Any]:
    """Return the versions of an action, as `to_version` reads them."""
    return (
        select(*version_columns())
        .join_from(action_version, _maker, _maker.c.id == action_version.c.created_by_id)
        .where(action_version.c.action_id == action_id)
    )


def to_version(row: Row[Any]) -> ActionVersionRead:
    """Convert a row with `version_columns`."""
    return ActionVersionRead(
        id=row.version_id,
        number=row.number,
        definition=ActionDefinition.model_validate(row.definition),
        image_digest=row.image_digest,
        created_at=row.version_created_at,
        created_by=PersonRef(id=row.version_created_by_id, name=row.version_created_by_name),
    )


def to_action(row: Row[Any]) -> ActionRead:
    """Convert a row of `action_rows`."""
    latest = to_version(row)
    return ActionRead(
        id=row.id,
        name=row.name,
        description=latest.definition.description,
        project=None if row.project_id is None else ProjectRef(id=row.project_id, name=row.project_name),
        latest=latest,
        archived=row.archived_at is not None,
        created_at=row.created_at,
        created_by=PersonRef(id=row.created_by_id, name=row.created_by_name),
        may_change=row.may_change,
    )
