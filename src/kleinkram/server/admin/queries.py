"""What admins ask of the database. Of the queue by its own tables, which have no nouns here."""

from typing import Any

from sqlalchemy import Select, exists, func, select, text

from kleinkram.contract.runs import RunState
from kleinkram.server.runners.scheduling import Needs
from kleinkram.server.tables import blob, file, mission, project, run, upload
from kleinkram.server.tables.upload import UNDER_WAY

_SUM = func.coalesce(func.sum(blob.c.size_bytes), 0).label("size_bytes")
QUEUE = text(
    "SELECT j.task_name AS kind, j.status::text AS state, count(*) AS number,"
    " min(e.at) FILTER (WHERE j.status = 'todo') AS oldest_at FROM procrastinate_jobs j"
    " LEFT JOIN procrastinate_events e ON e.job_id = j.id AND e.type = 'deferred'"
    " WHERE j.status IN ('todo', 'doing', 'failed') GROUP BY 1, 2 ORDER BY 1, 2"
)
FAILED = text(
    "SELECT j.id, j.task_name AS kind, j.args ->> 'ref' AS ref, j.attempts, why.sentence AS error,"
    " (SELECT max(e.at) FROM procrastinate_events e WHERE e.job_id = j.id AND e.type = 'failed') AS failed_at"
    " FROM procrastinate_jobs j LEFT JOIN job_error why ON why.job_id = j.id"
    " WHERE j.status = 'failed' ORDER BY j.id DESC LIMIT 100"
)
RETRYING = text(
    "SELECT j.id, j.task_name AS kind, j.args ->> 'ref' AS ref, j.attempts, why.sentence AS error,"
    " j.scheduled_at AS next_attempt_at FROM procrastinate_jobs j LEFT JOIN job_error why ON why.job_id = j.id"
    " WHERE j.status = 'todo' AND j.attempts > 0 ORDER BY j.id LIMIT 100"
)
RETRY = text(
    "UPDATE procrastinate_jobs SET status = 'todo', attempts = 0, scheduled_at = NULL, worker_id = NULL"
    " WHERE id = :id AND status = 'failed' RETURNING task_name"
)
RETRY_ALL = text(
    "WITH retried AS (UPDATE procrastinate_jobs SET status = 'todo', attempts = 0, scheduled_at = NULL,"
    " worker_id = NULL WHERE status = 'failed' RETURNING 1) SELECT count(*) FROM retried"
)
SERVER = text(
    "SELECT clock_timestamp() AS now, current_setting('server_version') AS version,"
    " pg_database_size(current_database()) AS size_bytes"
)


def queued_runs() -> Select[Any]:
    """Return what queued runs need of a runner, under the names of `Needs`, and how many need the same."""
    needs = [mission.c.project_id, *(run.c[name] for name in Needs._fields if name != "project_id")]
    live = (mission.c.deleted_at.is_(None), project.c.deleted_at.is_(None), run.c.state == RunState.queued.value)
    joined = select(*needs, func.count().label("number")).join_from(run, mission).join(project)
    return joined.where(*live).group_by(*needs).order_by(func.count().desc()).limit(200)


def blobs_by_state() -> Select[Any]:
    """Return number and bytes of blobs by state."""
    stmt = select(blob.c.state, func.count().label("number"), _SUM).where(blob.c.doomed_at.is_(None))
    return stmt.group_by(blob.c.state).order_by(blob.c.state)


def doomed_blobs() -> Select[Any]:
    """Return number and bytes of blobs that nothing refers to: they go with the next sweeps."""
    return select(func.count().label("number"), _SUM).where(blob.c.doomed_at.is_not(None))


def trashed_blobs() -> Select[Any]:
    """Return number and bytes of blobs that only files in the trash are made of."""
    of_blob = exists().where(file.c.blob_id == blob.c.id)
    live = of_blob.where(
        file.c.deleted_at.is_(None),
        mission.c.id == file.c.mission_id,
        mission.c.deleted_at.is_(None),
        project.c.id == mission.c.project_id,
        project.c.deleted_at.is_(None),
    )
    stmt = select(func.count().label("number"), _SUM).where(blob.c.doomed_at.is_(None))
    return stmt.where(of_blob, ~live)


def open_uploads() -> Select[Any]:
    """Return number and bytes of the uploads under way."""
    size_bytes = func.coalesce(func.sum(upload.c.size_bytes), 0).label("size_bytes")
    return select(func.count().label("number"), size_bytes).where(upload.c.state.in_(UNDER_WAY))
