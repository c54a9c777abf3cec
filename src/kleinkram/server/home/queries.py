"""What home asks of the database: few selects, each of a bounded answer. Functions touch no connection."""

from typing import Any

from sqlalchemy import Select, func, select, text, union

from kleinkram.contract.files import BlobState
from kleinkram.contract.runs import RunState
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import visible_files, visible_missions, visible_projects
from kleinkram.server.missions.amounts import file_amounts
from kleinkram.server.runners.scheduling import Needs
from kleinkram.server.runs.queries import visible_runs
from kleinkram.server.tables import action_version, blob, file, mission, project, run, scrub, upload
from kleinkram.server.tables.upload import UNDER_WAY
from kleinkram.server.uploads.queries import own_uploads

# As the index of what ails says it.
_AILS = text("(blob.state IN ('corrupt', 'lost') OR blob.content IN ('broken', 'recovered', 'error'))")
# Among the files that came last, where something arrived; and the missions that were made last.
_LAST_FILES = 2000
_VERIFICATION_DUE_AFTER = text("interval '2 days'")
_SAY_HOW_IT_IS = (RunState.done.value, RunState.failed.value)
_FAILED_LATELY = text("interval '7 days'")


def recent_missions(actor: Actor, *, limit: int) -> Select[Any]:
    """Return the missions in which something arrived last, with when, and what is in them.

    Of those in which one of the last `_LAST_FILES` files arrived, and the last `limit` that were made.
    """
    files = visible_files(actor).with_only_columns(file.c.mission_id, maintain_column_froms=True)
    last = files.order_by(file.c.created_at.desc(), file.c.id.desc()).limit(_LAST_FILES).subquery()
    made = visible_missions(actor).with_only_columns(mission.c.id.label("id"), maintain_column_froms=True)
    newest = made.order_by(mission.c.created_at.desc(), mission.c.id.desc()).limit(limit).subquery()
    chosen = union(select(last.c.mission_id.label("id")), select(newest.c.id)).subquery()
    # Which came last is asked of many missions, what is in them of those few.
    live = file.c.deleted_at.is_(None)
    # A maximum with a filter is looked for in the mission; one without, from the newest file of all on.
    arrived_at = func.max(file.c.created_at).filter(live).label("at")
    arrival = select(arrived_at).where(file.c.mission_id == mission.c.id).lateral()
    active_at = func.greatest(mission.c.created_at, arrival.c.at).label("active_at")
    first = select(mission.c.id, mission.c.name, mission.c.project_id, active_at)
    first = first.join_from(chosen, mission, mission.c.id == chosen.c.id).join(arrival, text("true"))
    active = first.order_by(active_at.desc(), mission.c.id).limit(limit).cte("active").prefix_with("MATERIALIZED")
    counted = (func.count(file.c.id).label("files"), func.coalesce(func.sum(blob.c.size_bytes), 0).label("size_bytes"))
    named = (active.c.id, active.c.name, active.c.project_id, project.c.name.label("project_name"))
    return (
        select(*named, active.c.active_at, *counted)
        .join_from(active, project, project.c.id == active.c.project_id)
        .outerjoin(file, (file.c.mission_id == active.c.id) & live)
        .outerjoin(blob, blob.c.id == file.c.blob_id)
        .group_by(*named, active.c.active_at)
        .order_by(active.c.active_at.desc(), active.c.id)
    )


def unfinished_uploads(actor: Actor, *, limit: int) -> Select[Any]:
    """Return one's own uploads that are under way, the latest first."""
    named = (mission.c.name.label("mission_name"), mission.c.project_id, project.c.name.label("project_name"))
    return (
        own_uploads(actor)
        .add_columns(*named)
        .join(mission, mission.c.id == upload.c.mission_id)
        .join(project, project.c.id == mission.c.project_id)
        .where(upload.c.state.in_(UNDER_WAY), upload.c.expires_at > func.now())
        .order_by(upload.c.created_at.desc(), upload.c.id)
        .limit(limit)
    )


def ailing_files(actor: Actor, *, limit: int) -> Select[Any]:
    """Return how many files of each mission are in each state that is not well, most first."""
    named = (mission.c.id, mission.c.name, mission.c.project_id, project.c.name.label("project_name"))
    said = (blob.c.state, blob.c.content)
    stmt = visible_files(actor).with_only_columns(
        *named, *said, func.count().label("number"), maintain_column_froms=True
    )
    stmt = stmt.where(_AILS).group_by(mission.c.id, project.c.id, *said)
    return stmt.order_by(func.count().desc(), mission.c.id).limit(limit)


def unsatisfied_missions(actor: Actor, *, limit: int) -> Select[Any]:
    """Return missions that lack what their project asks for, with the number of problems of each."""
    number = func.jsonb_array_length(mission.c.metadata_problems)
    named = (mission.c.id, mission.c.name, mission.c.project_id, project.c.name.label("project_name"))
    stmt = visible_missions(actor).with_only_columns(*named, number.label("number"), maintain_column_froms=True)
    return stmt.where(number > 0).order_by(mission.c.created_at.desc(), mission.c.id).limit(limit)


def failed_runs(actor: Actor, *, limit: int) -> Select[Any]:
    """Return how many actions failed on each mission in the last days, where that was the last they said, most first.

    An action is the same by its name, so that a script that was mended and run again from its folder counts as well.
    """
    later, its_version = run.alias("later"), action_version.alias("its_version")
    name, later_name = action_version.c.definition["name"], its_version.c.definition["name"]
    said_since = (
        select(later.c.id)
        .join(its_version, its_version.c.id == later.c.version_id)
        .where(later.c.mission_id == run.c.mission_id, later_name == name)
        .where((later.c.created_at > run.c.created_at) & later.c.state.in_(_SAY_HOW_IT_IS))
    )
    named = (mission.c.id, mission.c.name, mission.c.project_id, project.c.name.label("project_name"))
    stmt = visible_runs(actor).with_only_columns(*named, func.count().label("number"), maintain_column_froms=True)
    lately = run.c.ended_at > func.now() - _FAILED_LATELY
    stmt = stmt.where(run.c.state == RunState.failed.value, lately, ~said_since.exists())
    return (
        stmt.group_by(mission.c.id, project.c.id).order_by(func.max(run.c.ended_at).desc(), mission.c.id).limit(limit)
    )


def queued_runs(actor: Actor, *, limit: int) -> Select[Any]:
    """Return what queued runs need of a runner, under the names of `Needs`, and how many do so on each mission."""
    needs = [run.c[name] for name in Needs._fields if name != "project_id"]
    named = (mission.c.id, mission.c.name, mission.c.project_id, project.c.name.label("project_name"))
    number = func.count().label("number")
    stmt = visible_runs(actor).with_only_columns(*named, *needs, number, maintain_column_froms=True)
    stmt = stmt.where(run.c.state == RunState.queued.value).group_by(mission.c.id, project.c.id, *needs)
    return stmt.order_by(number.desc(), mission.c.id).limit(limit)


def storage_by_project(actor: Actor, *, limit: int) -> Select[Any]:
    """Return what is kept in each project that somebody sees, the largest first."""
    files, in_bytes = file_amounts(actor)
    inside = visible_missions(actor).with_only_columns(
        mission.c.project_id,
        func.sum(files).label("files"),
        func.sum(in_bytes).label("size_bytes"),
        maintain_column_froms=True,
    )
    sums = inside.group_by(mission.c.project_id).subquery()
    size_bytes = func.coalesce(sums.c.size_bytes, 0)
    stmt = visible_projects(actor).with_only_columns(
        project.c.id,
        project.c.name,
        project.c.quota_bytes,
        func.coalesce(sums.c.files, 0).label("files"),
        size_bytes.label("size_bytes"),
        maintain_column_froms=True,
    )
    stmt = stmt.outerjoin(sums, sums.c.project_id == project.c.id)
    return stmt.order_by(size_bytes.desc(), project.c.name, project.c.id).limit(limit)


def used_bytes() -> Select[Any]:
    """Return how many bytes the store keeps, each once."""
    return select(func.coalesce(func.sum(blob.c.size_bytes), 0)).where(blob.c.doomed_at.is_(None))


def overdue_verifications() -> Select[Any]:
    """Return how many files' bytes should have been verified by now."""
    late = (blob.c.state == BlobState.stored.value, blob.c.doomed_at.is_(None))
    return select(func.count()).select_from(blob).where(*late, blob.c.created_at < func.now() - _VERIFICATION_DUE_AFTER)


def stopped_scrubs(store_id: str) -> Select[Any]:
    """Return whether the last comparison of the store with the database that ended did not go through: 1, or 0."""
    ended = select(scrub.c.stopped).where(scrub.c.store_id == store_id, scrub.c.ended_at.is_not(None))
    last = ended.order_by(scrub.c.created_at.desc()).limit(1).subquery()
    return select(func.count(last.c.stopped))


def failed_jobs() -> Select[Any]:
    """Return how many jobs were given up."""
    return select(func.count()).select_from(text("procrastinate_jobs")).where(text("status = 'failed'"))
