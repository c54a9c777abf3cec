"""A worker dies during a job: the job is completed, and periodic jobs continue."""

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil
import pytest

from kleinkram.recordings.sample import generate_mcap
from kleinkram.server.settings import Settings
from tests.integration.api_server import Api
from tests.integration.fault_proxy import ProxiedRequest, standing_before
from tests.integration.upload_client import upload, wait_until


@pytest.fixture(name="api", scope="module")
def _api(start_api: Any) -> Api:
    # Slow: long enough to die in the middle of verifying.
    api: Api = start_api(verify_bytes_per_s=1_048_576)
    return api


@contextmanager
def _worker(settings: Settings, **changes: str) -> Iterator["subprocess.Popen[bytes]"]:
    environment = {
        "PATH": os.environ["PATH"],
        "KLEINKRAM_DATABASE_URL": str(settings.database_url),
        "KLEINKRAM_S3_INTERNAL_URL": settings.s3_internal_url,
        "KLEINKRAM_S3_BUCKET": settings.s3_bucket,
        "KLEINKRAM_S3_ACCESS_KEY": settings.s3_access_key,
        "KLEINKRAM_S3_SECRET_KEY": settings.s3_secret_key.get_secret_value(),
        **changes,
    }
    process = subprocess.Popen(
        [sys.executable, "-m", "kleinkram.server", "worker"], env=environment, stderr=subprocess.DEVNULL
    )
    try:
        yield process
    finally:
        process.terminate()
        assert process.wait(30) in {0, -signal.SIGKILL, -signal.SIGTERM}


def test_a_job_whose_worker_died_is_done_by_the_next(api: Api, tmp_path: Path) -> None:
    """In the middle of verifying a recording, while a child scans along."""
    truth = generate_mcap(tmp_path / "run.mcap", size_bytes=16 << 20, seed=21)
    mission_id = api.mission(api.project()["id"])["id"]
    file = upload(api, mission_id, "run.mcap", truth.path.read_bytes())
    settings: Settings = api.app.state.settings
    doing = "SELECT count(*) FROM procrastinate_jobs WHERE task_name = 'verify_blob' AND status = 'doing'"
    with _worker(settings, KLEINKRAM_VERIFY_BYTES_PER_S="1048576") as worker:
        begun = lambda: api.sql(doing) == [(1,)] and api.get(f"/files/{file['id']}").ok()["depth"] == "summary"  # noqa: E731
        wait_until(begun, limit_s=60)
        readers = psutil.Process(worker.pid).children()
        worker.kill()
        worker.wait(10)
    assert psutil.wait_procs(readers, timeout=10)[1] == [], "a reader outlived its worker"
    read = api.get(f"/files/{file['id']}").ok()
    assert (read["state"], read["depth"]) == ("stored", "summary")
    # As if a periodic job had died too, with its next round queued already: that one must not stop the rescue.
    api.sql(
        "INSERT INTO procrastinate_jobs (queue_name, task_name, lock, queueing_lock, args, status)"
        " VALUES ('default', 'collect_garbage', 'collect_garbage', 'collect_garbage', '{\"timestamp\": 0}', 'doing')"
        " ON CONFLICT DO NOTHING"
    )
    api.sql("UPDATE procrastinate_workers SET last_heartbeat = now() - interval '1 hour'")
    with _worker(settings, KLEINKRAM_VERIFY_BYTES_PER_S="1000000000"):
        wait_until(lambda: api.get(f"/files/{file['id']}").ok()["state"] == "verified", limit_s=60)
        read = api.get(f"/files/{file['id']}").ok()
        assert (read["content"], read["depth"], read["message_count"]) == ("indexed", "scan", truth.message_count)
        stuck = "SELECT count(*) FROM procrastinate_jobs WHERE task_name = 'collect_garbage' AND status = 'doing'"
        wait_until(lambda: api.sql(stuck) == [(0,)])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ros1/turtlesim_lz4.bag", "mcap/kleinkram_imu_ros1profile_zstd.mcap"])
def test_a_recording_whose_reader_died_half_way_is_read_by_the_next(api: Api, recordings_dir: Path, name: str) -> None:
    mission_id = api.mission(api.project()["id"])["id"]
    file = upload(api, mission_id, Path(name).name, (recordings_dir / name).read_bytes())
    settings: Settings = api.app.state.settings
    reading, may_go_on = threading.Event(), threading.Event()

    def block(requested: ProxiedRequest) -> None:
        if requested.method != "GET":
            return
        if "range" not in requested.headers:  # verifying reads the content too: it does not come to that
            may_go_on.wait(60)
        elif not requested.headers["range"].startswith("bytes=0-"):
            reading.set()
            may_go_on.wait(60)

    with standing_before(settings.s3_internal_url) as middleman:
        middleman.rule = block
        with _worker(settings, KLEINKRAM_S3_INTERNAL_URL=middleman.url) as worker:
            assert reading.wait(30), "nobody began to read"
            readers = psutil.Process(worker.pid).children()
            assert readers, "recordings are read in a child"
            worker.kill()
            worker.wait(10)
            may_go_on.set()
        assert psutil.wait_procs(readers, timeout=10)[1] == [], "a reader outlived its worker"
    assert api.get(f"/files/{file['id']}").ok()["content"] == "pending"
    api.sql("UPDATE procrastinate_workers SET last_heartbeat = now() - interval '1 hour'")
    with _worker(settings):
        wait_until(lambda: api.get(f"/files/{file['id']}").ok()["content"] == "indexed", limit_s=60)
    assert api.get(f"/files/{file['id']}").ok()["message_count"] > 0
