"""Statements for the requests of runners. Functions do not execute them."""

import uuid
from collections.abc import Collection, Sequence
from typing import Any

from sqlalchemy import ARRAY, ColumnElement, Row, Select, Text, Update, exists, func, literal, or_, select, update

from kleinkram.contract.projects import ProjectRef
from kleinkram.contract.runners import Capacity, ClaimRequest, ExecutorAbilities, RunnerRead, RunnerToken
from kleinkram.server.access.actor import Actor, unexpired
from kleinkram.server.db import among
from kleinkram.server.pagination import Order
from kleinkram.server.runners.eligibility import is_alive, is_single_person_only, runs_scripts, with_limits
from kleinkram.server.tables import action, action_version, mission, project, run, runner, token, token_limit
from kleinkram.server.tables.runs import ASSIGNED

RUNNER_ORDER = Order([runner.c.name, runner.c.id])
# Fractions of cores are summed as floats.
_ROUNDING = 1e-6


def runner_rows() -> Select[Any]:
    """Return all runners, as `to_runner` reads them."""
    assigned = select(func.count()).where(run.c.runner_id == runner.c.id, run.c.state.in_(ASSIGNED))
    active = assigned.correlate(runner).scalar_subquery().label("active_runs")
    stmt = with_limits(select(runner, is_alive().label("is_alive"), active))
    return stmt.add_columns(token.c.name.label("token_name"), token.c.expires_at.label("token_expires_at"))


def projects_of(token_ids: Collection[uuid.UUID]) -> Select[Any]:
    """Return the projects that tokens are limited to."""
    stmt = select(token_limit.c.token_id, project.c.id, project.c.name).join_from(token_limit, project)
    return stmt.where(among(token_limit.c.token_id, token_ids)).order_by(project.c.name)


def to_runner(row: Row[Any], projects: Sequence[Row[Any]] = ()) -> RunnerRead:
    """Convert a row of `runner_rows`; `projects` are those that tokens are limited to."""
    return RunnerRead(
        id=row.id,
        name=row.name,
        labels=row.labels,
        capacity=Capacity.model_validate(row.capacity),
        abilities=ExecutorAbilities.model_validate(row.abilities),
        default_image=row.default_image,
        version=row.version,
        last_seen_at=row.last_seen_at,
        is_alive=row.is_alive,
        active_runs=row.active_runs,
        token=None if row.token_name is None else _to_token(row, projects),
    )


def _to_token(row: Row[Any], projects: Sequence[Row[Any]]) -> RunnerToken:
    named = [ProjectRef(id=entry.id, name=entry.name) for entry in projects if entry.token_id == row.token_id]
    return RunnerToken(
        id=row.token_id,
        name=row.token_name,
        expires_at=row.token_expires_at,
        projects=None if row.only_project_ids is None else named,
        labels=row.only_labels,
    )


def _with_definition() -> Select[Any]:
    columns = (
        action_version.c.definition,
        action_version.c.image_digest.label("pinned_digest"),
        action_version.c.number,
        action.c.id.label("action_id"),
        mission.c.project_id,
    )
    return (
        select(run, *columns)
        .join_from(run, mission, mission.c.id == run.c.mission_id)
        .join(project, project.c.id == mission.c.project_id)
        .join(action_version, action_version.c.id == run.c.version_id)
        .outerjoin(action, action.c.id == action_version.c.action_id)
    )


def unanswered_claim(runner_id: uuid.UUID, assigned: Collection[uuid.UUID]) -> Select[Any]:
    """Return a run that is assigned to a runner without its knowledge: the answer to the claim was lost."""
    unanswered = (run.c.runner_id == runner_id) & run.c.state.in_(ASSIGNED) & run.c.id.not_in(assigned)
    return _with_definition().where(unanswered).limit(1).with_for_update(of=run)


def next_run(row: Row[Any], requested: ClaimRequest, *, single_person: bool) -> Select[Any] | None:
    """Return the oldest queued run that fits the free resources of a runner, locked; None where it may execute none."""
    abilities = ExecutorAbilities.model_validate(row.abilities)
    if is_single_person_only(abilities) and not single_person:
        return None
    free = requested.free
    fits = (
        (run.c.cores <= free.cores + _ROUNDING)
        & (run.c.memory_bytes <= free.memory_bytes)
        & (run.c.disk_bytes <= free.disk_bytes)
        & (run.c.gpus <= (free.gpus if abilities.gpus else 0))
        & run.c.labels.op("<@", is_comparison=True)(literal(row.labels, ARRAY(Text)))
        & run.c.network.in_([network.value for network in abilities.networks])
        & or_(~run.c.needs_images, literal(abilities.images))
        & or_(run.c.needs_images, literal(runs_scripts(row, abilities)))
    )
    if row.only_project_ids is not None:
        fits &= mission.c.project_id.in_(row.only_project_ids)
    if row.only_labels is not None:
        fits &= run.c.labels.op("&&", is_comparison=True)(literal(row.only_labels, ARRAY(Text)))
    live = mission.c.deleted_at.is_(None) & project.c.deleted_at.is_(None)
    queued = _with_definition().where(run.c.state == "queued", live, fits)
    return queued.order_by(run.c.created_at, run.c.id).limit(1).with_for_update(of=run, skip_locked=True)


def assigned_run(actor: Actor, run_id: uuid.UUID, attempt: int) -> Select[Any]:
    """Return a run whose current attempt belongs to the runner of this token, locked."""
    current = (run.c.attempt == attempt) & run.c.state.in_(ASSIGNED) & _is_of(actor)
    return _with_definition().where(run.c.id == run_id, current).with_for_update(of=run, key_share=True)


def pin_image(version_id: uuid.UUID, digest: str) -> Update:
    """Pin the image of a version of an action, unless it is pinned: the first resolution of its name is permanent."""
    unpinned = (action_version.c.id == version_id) & action_version.c.image_digest.is_(None)
    return update(action_version).where(unpinned).values(image_digest=digest)


def ended_run(actor: Actor, run_id: uuid.UUID, attempt: int) -> Select[Any]:
    """Return the state of an ended run whose last attempt belongs to the runner of this token."""
    current = (run.c.attempt == attempt) & run.c.ended_at.is_not(None) & _is_of(actor)
    return select(run.c.state).where(run.c.id == run_id, current)


def _is_of(actor: Actor) -> ColumnElement[bool]:
    if actor.runner_id is not None:
        return run.c.runner_id == actor.runner_id
    # A runner from before tokens were bound to runners, until its next heartbeat or claim.
    good = token.c.revoked_at.is_(None) & unexpired(token.c.expires_at)
    has_token = exists().where(token.c.runner_id == runner.c.id, good)
    return run.c.runner_id.in_(select(runner.c.id).where(runner.c.person_id == actor.person_id, ~has_token))
