"""Metrics: those of each process, and those of the whole server once."""

import urllib3

from tests.integration.api_server import Api, serving
from tests.integration.conftest import StartApi
from tests.integration.sample import Sample
from tests.services import RunningPostgres


def _values(text: str, name: str) -> dict[str, float]:
    lines = [line for line in text.splitlines() if line.startswith(name) and line[len(name)] in " {"]
    return {line.rsplit(" ", 1)[0]: float(line.rsplit(" ", 1)[1]) for line in lines}


def test_one_of_several_processes_reports_the_gauges_of_the_server(
    start_api: StartApi, postgres: RunningPostgres
) -> None:
    first = start_api()
    folder = first.app.state.settings.owner_token_file.parent
    settings = first.app.state.settings.model_dump(exclude_unset=True, exclude={"owner_token_file"})
    admin_url = first.database.info.dsn + f" password={first.database.info.password}"
    with serving(settings, admin_url=admin_url, folder=folder) as second:
        texts = [first.metrics(), second.metrics(), first.metrics(), second.metrics()]
        assert [bool(_values(text, "kleinkram_workers")) for text in texts] == [True, False, True, False]
        assert all(_values(text, "kleinkram_build_info") for text in texts)
        assert all(_values(text, "process_resident_memory_bytes") for text in texts)
        # Whoever reports may go: its connection is cut, and the next one that is scraped takes over.
        ended = "SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE application_name = 'kleinkram metrics'"
        assert postgres.sql(f"{ended} AND datname = '{first.database.info.dbname}'") == "t"
        assert _values(second.metrics(), "kleinkram_workers")
        assert not _values(first.metrics(), "kleinkram_workers")


def test_no_created_series_are_exported(api: Api) -> None:
    api.get("/projects").ok()
    assert _values(api.metrics(), "kleinkram_requests_total")
    assert "_created" not in api.metrics()


def test_a_metrics_port_serves_metrics_and_liveness_alone(api: Api) -> None:
    url = f"http://127.0.0.1:{api.app.state.metrics_port}"
    assert urllib3.request("GET", f"{url}/health/live").data == b"live\n"
    assert urllib3.request("GET", f"{url}/api/v1/projects").status == 404


def test_the_space_of_a_store_on_another_machine_is_what_is_left_of_its_capacity(start_api: StartApi) -> None:
    api = start_api(store_folder=None, store_capacity_bytes=1000)
    Sample(api).blob(size_bytes=300)
    text = api.metrics()
    assert _values(text, "kleinkram_store_free_bytes") == {"kleinkram_store_free_bytes": 700}
    assert _values(text, "kleinkram_store_size_bytes") == {"kleinkram_store_size_bytes": 1000}


def test_a_job_that_waits_for_another_attempt_counts_as_old(start_api: StartApi) -> None:
    api = start_api()
    job = "INSERT INTO procrastinate_jobs (queue_name, task_name, attempts, scheduled_at, args) VALUES"
    put_off = f"{job} ('default', 'maintain_runs', 0, now() + interval '1 h', '{{}}') RETURNING id"
    retrying = f"{job} ('default', 'collect_garbage', 2, now() + interval '1 h', '{{}}') RETURNING id"
    for statement in (put_off, retrying):
        api.sql(
            "UPDATE procrastinate_events SET at = now() - interval '100 s' WHERE type = 'deferred' AND job_id = %s",
            api.sql(statement)[0][0],
        )
    text = api.metrics()
    ages = _values(text, "kleinkram_queue_oldest_seconds")
    assert 100 <= ages.pop('kleinkram_queue_oldest_seconds{queue="default"}') < 1000
    assert {*ages.values()} == {0}
    assert _values(text, "kleinkram_jobs_retrying") == {'kleinkram_jobs_retrying{task="collect_garbage"}': 1}


def test_only_living_workers_are_counted(start_api: StartApi) -> None:
    api = start_api()
    api.sql("INSERT INTO procrastinate_workers DEFAULT VALUES")
    insert = "INSERT INTO worker_process (id, host, pid, version, seen_at, ended_at) VALUES"
    for seen_at, ended_at in [("now()", "NULL"), ("now() - interval '7 min'", "NULL"), ("now()", "now()")]:
        api.sql(f"{insert} (gen_random_uuid(), 'h', 1, '1', {seen_at}, {ended_at})")
    assert _values(api.metrics(), "kleinkram_workers") == {"kleinkram_workers": 1}
    assert len(api.get("/admin/health").ok()["workers_at"]) == 1
    api.sql("DELETE FROM worker_process WHERE seen_at > now() - interval '1 min'")
    message = api.get("/admin/health").ok()
    assert message["workers_at"] == []
    assert "No worker process has run for 7 min" in message["warnings"][0]


def test_metrics_of_the_process_are_served_without_the_database(start_api: StartApi) -> None:
    api = start_api()
    api.sql("ALTER TABLE worker_process RENAME TO worker_process_of_another_schema")
    text = api.metrics()
    assert _values(text, "kleinkram_build_info")
    assert not _values(text, "kleinkram_blobs")
    api.sql("ALTER TABLE worker_process_of_another_schema RENAME TO worker_process")
    assert _values(api.metrics(), "kleinkram_workers")
