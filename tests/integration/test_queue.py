"""The job queue in PostgreSQL at its greatest length."""

from typing import Any

from tests.integration.api_server import Api

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
