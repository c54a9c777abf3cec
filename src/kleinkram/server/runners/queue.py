"""The order of the queue: which queued runs a runner gets next.

Higher priorities first. Within one, projects take turns: next is the one whose assigned runs have the fewest cores,
then the one whose last start is longest ago, then the one with the oldest run. Within a project, people take turns by
the same rule, and of one person the oldest run is next.

The statement visits lanes, the runs of one priority, project and person, in the index `ix_run_queue`, and of each lane
only the first runs that fit: its time depends on the number of lanes, not on that of queued runs.
"""

import datetime
import uuid
from typing import NamedTuple

from sqlalchemy import text

from kleinkram.contract.runners import Capacity
from kleinkram.server.db import Connection
from kleinkram.server.runs.eligibility import IsolationRule, KnownRunner

# A run of low priority that waited for so long counts as one of normal priority, so that it starts on a busy machine.
_LOW_COUNTS_AS_NORMAL = datetime.timedelta(hours=1)
# A run that waited for so long, and whose turn it is, keeps the resources of its runner free until it fits.
_KEEPS_ROOM = datetime.timedelta(minutes=10)
# Candidates of each lane beyond those asked for: other transactions may hold the first ones.
_SPARE_CANDIDATES = 16
# Fractions of cores are summed as floats.
_ROUNDING = 1e-6

# As text: SQLAlchemy takes longer to build it than PostgreSQL to run it. In its order:
# - lane: skips from one to the next in the index. turn: with the last starts of its project and its person.
# - able: what this runner may execute, once it has the resources. candidate: the first of each lane that fit now, and
#   the oldest of the lane if it fits the machine, but not beside what runs there now.
# - person_turn, project_turn: the cores that the person, or the project, has when it is the candidate's turn: those of
#   assigned runs, and of the candidates before it. first: so few that not all
#   queued runs are read for them.
_NEXT = text("""
WITH RECURSIVE lane AS (
  (SELECT priority, launch_project_id, started_by_id FROM run WHERE state = 'queued' ORDER BY 1, 2, 3 LIMIT 1)
  UNION ALL
  SELECT next_lane.* FROM lane CROSS JOIN LATERAL (
    SELECT priority, launch_project_id, started_by_id FROM run
    WHERE state = 'queued' AND (priority, launch_project_id, started_by_id)
      > (lane.priority, lane.launch_project_id, lane.started_by_id)
    ORDER BY 1, 2, 3 LIMIT 1
  ) next_lane
),
turn AS MATERIALIZED (
  SELECT lane.*,
    array_position(ARRAY['high', 'normal', 'low'], lane.priority) AS declared_rank,
    (SELECT max(claimed_at) FROM run WHERE launch_project_id = lane.launch_project_id) AS project_started_at,
    (SELECT max(claimed_at) FROM run WHERE started_by_id = lane.started_by_id) AS person_started_at
  FROM lane
),
able AS NOT MATERIALIZED (
  SELECT run.*,
    cores <= :free_cores AND memory_bytes <= :free_memory AND disk_bytes <= :free_disk AND gpus <= :free_gpus AS fits,
    cores <= :all_cores AND memory_bytes <= :all_memory AND disk_bytes <= :all_disk AND gpus <= :all_gpus AS fits_alone
  FROM run JOIN mission ON mission.id = run.mission_id JOIN project ON project.id = mission.project_id
  WHERE run.state = 'queued' AND mission.deleted_at IS NULL AND project.deleted_at IS NULL
    AND project.isolation = ANY (CAST(:project_isolations AS text[]))
    AND run.labels <@ CAST(:labels AS text[]) AND run.network = ANY (CAST(:networks AS text[]))
    AND CASE WHEN run.needs_images THEN :runs_images ELSE :runs_scripts END
    AND (CAST(:only_project_ids AS uuid[]) IS NULL OR mission.project_id = ANY (:only_project_ids))
    AND (CAST(:only_labels AS text[]) IS NULL OR run.labels && :only_labels)
),
candidate AS (
  SELECT turn.*, queued.*,
    CASE WHEN queued.created_at < now() - CAST(:low_counts_as_normal AS interval) THEN least(declared_rank, 2)
      ELSE declared_rank END AS rank
  FROM turn CROSS JOIN LATERAL (
    (SELECT id, created_at, cores, false AS keeps_room FROM able
     WHERE priority = turn.priority AND launch_project_id = turn.launch_project_id
       AND started_by_id = turn.started_by_id AND fits
     ORDER BY created_at, id LIMIT :candidates)
    UNION ALL
    SELECT id, created_at, cores, true FROM (
      SELECT id, created_at, cores, fits FROM able
      WHERE priority = turn.priority AND launch_project_id = turn.launch_project_id
        AND started_by_id = turn.started_by_id AND fits_alone
        AND created_at < now() - CAST(:keeps_room_after AS interval)
      ORDER BY created_at, id LIMIT 1
    ) oldest
    WHERE :may_keep_room AND NOT fits
  ) queued
),
assigned AS MATERIALIZED (
  SELECT launch_project_id, started_by_id, sum(cores) AS cores FROM run
  WHERE state IN ('preparing', 'running', 'collecting') GROUP BY 1, 2
),
person_turn AS (
  SELECT candidate.*, coalesce(assigned.cores, 0) - candidate.cores + sum(candidate.cores) OVER (
    PARTITION BY candidate.launch_project_id, candidate.started_by_id
    ORDER BY rank, declared_rank, created_at, id ROWS UNBOUNDED PRECEDING
  ) AS person_cores
  FROM candidate LEFT JOIN assigned USING (launch_project_id, started_by_id)
),
project_turn AS (
  SELECT id, created_at, keeps_room, rank, project_started_at, coalesce(of_project.cores, 0) - person_turn.cores
    + sum(person_turn.cores) OVER (
      PARTITION BY person_turn.launch_project_id
      ORDER BY rank, person_cores, person_started_at NULLS FIRST, created_at, id ROWS UNBOUNDED PRECEDING
    ) AS project_cores
  FROM person_turn LEFT JOIN (SELECT launch_project_id, sum(cores) AS cores FROM assigned GROUP BY 1) of_project
    USING (launch_project_id)
),
first AS MATERIALIZED (
  SELECT * FROM project_turn ORDER BY rank, project_cores, project_started_at NULLS FIRST, created_at, id
  LIMIT :candidates
)
SELECT run.id, keeps_room FROM first JOIN run ON run.id = first.id
WHERE run.state = 'queued'
ORDER BY rank, project_cores, project_started_at NULLS FIRST, first.created_at, run.id
LIMIT :max_runs FOR UPDATE OF run SKIP LOCKED
""")


class QueuedRun(NamedTuple):
    """A queued run whose turn it is. `keeps_room`: it does not fit yet, and nothing behind it should start."""

    id: uuid.UUID
    keeps_room: bool


async def lock_next_runs(
    db: Connection, claiming: KnownRunner, free: Capacity, max_runs: int, rule: IsolationRule, *, may_keep_room: bool
) -> list[QueuedRun]:
    """Return the next runs, locked, without those that others have locked.

    Each fits the free resources, or, if it `may_keep_room`, those of the runner.
    """
    abilities = claiming.abilities
    values: dict[str, object] = {
        "labels": claiming.offered_labels,
        "project_isolations": rule.projects_of(abilities.isolation),
        "networks": [network.value for network in abilities.networks],
        "runs_images": abilities.images,
        "runs_scripts": claiming.runs_scripts,
        "only_project_ids": claiming.only_project_ids,
        "only_labels": claiming.only_labels,
        "low_counts_as_normal": _LOW_COUNTS_AS_NORMAL,
        "keeps_room_after": _KEEPS_ROOM,
        "may_keep_room": may_keep_room,
        "candidates": max_runs + _SPARE_CANDIDATES,
        "max_runs": max_runs,
    }
    for name, capacity in (("free", free), ("all", claiming.capacity)):
        values |= {
            f"{name}_cores": capacity.cores + _ROUNDING,
            f"{name}_memory": capacity.memory_bytes,
            f"{name}_disk": capacity.disk_bytes,
            f"{name}_gpus": capacity.gpus if abilities.gpus else 0,
        }
    return [QueuedRun._make(row) for row in await db.execute(_NEXT, values)]
