"""What is asked of tokens. Functions return selects; they touch no connection."""

import uuid
from collections.abc import Collection, Sequence
from typing import Any

from sqlalchemy import Row, Select, exists, func, literal, select, union_all

from kleinkram.contract.people import PersonRef
from kleinkram.contract.rights import Scope, TokenKind
from kleinkram.contract.tokens import TokenPlace, TokenRead, TokenRunner
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import visible_missions, visible_projects
from kleinkram.server.db import among
from kleinkram.server.paging import Order
from kleinkram.server.tables import audit_event, mission, person, project, runner, token, token_limit

# Latest first.
TOKEN_ORDER = Order([token.c.created_at, token.c.id], descending=True)


def tokens_of(person_id: uuid.UUID | None) -> Select[Any]:
    """Return the tokens of one person, or with None everybody's, as `to_token` reads them; none of a run."""
    own = [column for column in token.c if column is not token.c.secret_sha256]
    names = person.c.name.label("person_name"), runner.c.name.label("runner_name")
    stmt = select(*own, *names).join_from(token, person).outerjoin(runner, runner.c.id == token.c.runner_id)
    stmt = stmt.where(token.c.kind != TokenKind.run.value)
    return stmt if person_id is None else stmt.where(token.c.person_id == person_id)


def made_from(token_id: uuid.UUID) -> Select[Any]:
    """Return the ids of a token, of those that were made with it, of those made with these, and so on."""
    line = select(token.c.id).where(token.c.id == token_id).cte("line", recursive=True)
    line = line.union(select(token.c.id).join(line, token.c.made_by_token_id == line.c.id))
    return select(line.c.id)


def carried_by(person_id: uuid.UUID | None) -> Select[Any]:
    """Return the ids of the tokens that stand for somebody as a person and that were made in their name.

    That of the owner of `klein up` is the server's: it made that by itself, as the record says, and keeps it in a file.
    """
    by_somebody = exists().where(
        audit_event.c.noun_id == token.c.id,
        audit_event.c.operation == "token.create",
        audit_event.c.actor_id.is_not(None),
    )
    mine = (token.c.person_id == person_id) & (token.c.kind == TokenKind.personal.value)
    return select(token.c.id).where(mine, by_somebody)


def still_usable(stmt: Select[Any]) -> Select[Any]:
    """Return those of a select's tokens that have neither been revoked nor expired."""
    return stmt.where(token.c.revoked_at.is_(None), func.coalesce(token.c.expires_at > func.now(), True))


def places_of(actor: Actor, token_ids: Collection[uuid.UUID]) -> Select[Any]:
    """Return what tokens are limited to, with the names that `actor` may see."""
    projects = visible_projects(actor).subquery("seen_project")
    missions = visible_missions(actor).with_only_columns(mission.c.id, mission.c.name).subquery("seen_mission")
    name = func.coalesce(projects.c.name, missions.c.name).label("name")
    stmt = select(token_limit.c.token_id, token_limit.c.project_id, token_limit.c.mission_id, name)
    joined = stmt.outerjoin(projects, projects.c.id == token_limit.c.project_id).outerjoin(
        missions, missions.c.id == token_limit.c.mission_id
    )
    return joined.where(among(token_limit.c.token_id, token_ids)).order_by(token_limit.c.token_id, token_limit.c.id)


def reachable(actor: Actor, *, project_ids: Collection[uuid.UUID], mission_ids: Collection[uuid.UUID]) -> Select[Any]:
    """Return those of some projects and missions that `actor` may see; by that also within their own limits."""
    projects = visible_projects(actor).with_only_columns(literal("project").label("noun"), project.c.id)
    missions = visible_missions(actor).with_only_columns(
        literal("mission").label("noun"), mission.c.id, maintain_column_froms=True
    )
    return union_all(projects.where(among(project.c.id, project_ids)), missions.where(among(mission.c.id, mission_ids)))  # type: ignore[return-value]  # a compound select is read like one


def to_token(row: Row[Any], places: Sequence[Row[Any]]) -> TokenRead:
    """Return the token that a row stands for."""
    return TokenRead(
        id=row.id,
        person=PersonRef(id=row.person_id, name=row.person_name),
        name=row.name,
        kind=TokenKind(row.kind),
        prefix=row.prefix,
        scopes=[Scope(scope) for scope in row.scopes],
        limits=[_place(place) for place in places] if row.is_limited else None,
        created_at=row.created_at,
        expires_at=row.expires_at,
        last_used_at=row.last_used_at,
        revoked_at=row.revoked_at,
        runner=None if row.runner_id is None else TokenRunner(id=row.runner_id, name=row.runner_name),
        runner_labels=row.runner_labels,
    )


def _place(row: Row[Any]) -> TokenPlace:
    noun = "project" if row.project_id else "mission"
    return TokenPlace(noun=noun, id=row.project_id or row.mission_id, name=row.name)
