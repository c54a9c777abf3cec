"""The job queue in PostgreSQL at its greatest length."""

from typing import Any

from kleinkram.server.maintenance import collect_garbage
from tests.integration.api_server import Api
from tests.integration.jobs import on_site

_WAITING = 3000
_NEXT = "SELECT id FROM procrastinate_fetch_job_v2(ARRAY['long'], NULL)"
_READ = (
    "SELECT pg_stat_force_next_flush(), pg_stat_get_tuples_returned(oid) FROM pg_class"
    " WHERE relname = 'procrastinate_jobs'"
)


def test_finding_the_next_job_does_not_scan_all_jobs(start_api: Any) -> None:
    api: Api = start_api()
    # A plan is kept after some times, and a queue is empty most of the time: also when PostgreSQL counts its rows.
    api.sql("INSERT INTO procrastinate_jobs (queue_name, task_name) VALUES ('long', 'none')")
    api.sql("DELETE FROM procrastinate_jobs")
    api.sql("VACUUM (ANALYZE) procrastinate_jobs")
    for _ in range(10):
        assert api.sql(_NEXT) == [(None,)]
    api.sql(
        "INSERT INTO procrastinate_jobs (queue_name, task_name, status, args)"
        " SELECT 'long', 'verify_blob', 'todo', jsonb_build_object('ref', n) FROM generate_series(1, %s) n",
        _WAITING,
    )
    api.sql(_READ)
    before = api.sql(_READ)[0][1]
    job_ids = [api.sql(_NEXT)[0][0] for _ in range(5)]
    assert job_ids == sorted(job_ids)
    assert None not in job_ids
    api.sql(_READ)
    assert api.sql(_READ)[0][1] - before < 5 * 3 * _WAITING, "rows of the queue read for five jobs"


def test_jobs_that_an_old_worker_did_not_know_run_again(start_api: Any) -> None:
    """The queue marks them as failed without running them; those that failed have an error."""
    api: Api = start_api()
    insert = (
        "INSERT INTO procrastinate_jobs (queue_name, task_name, status, args, queueing_lock)"
        " VALUES ('default', %s, 'failed', '{\"ref\": \"x\"}', %s) RETURNING id"
    )
    unknown, failed, later, periodic = (
        api.sql(insert, task, lock)[0][0]
        for task, lock in (
            ("verify_blob", None),
            ("verify_blob", None),
            ("of a later version", None),
            ("scrub", "a lock"),
        )
    )
    api.sql("INSERT INTO job_error VALUES (%s, 'it failed')", failed)
    for job_id in (unknown, failed, later, periodic):
        api.sql("INSERT INTO procrastinate_events (job_id, type) VALUES (%s, 'failed')", job_id)
    on_site(api, collect_garbage)
    states = dict(
        api.sql(
            "SELECT id, status::text FROM procrastinate_jobs WHERE id = ANY(%s)", [unknown, failed, later, periodic]
        )
    )
    assert states == {unknown: "todo", failed: "failed", later: "failed"}
