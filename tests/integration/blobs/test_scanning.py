"""Verification scans a recording while it reads every byte, with the same result as on a robot."""

import sqlite3
import sys
import time
from pathlib import Path
from typing import Any

import pytest
import zstandard

from kleinkram.recordings import FileSource
from kleinkram.recordings.formats.mcap.format import read_index
from kleinkram.recordings.sample import generate_mcap
from kleinkram.recordings.sources import CountingSource
from kleinkram.server.blobs import readers as readers_module
from kleinkram.server.settings import Settings
from tests.integration.api_server import Api
from tests.integration.fault_proxy import Cut, ProxiedRequest, standing_before
from tests.integration.jobs import on_site, run_jobs
from tests.integration.upload_client import upload

_MOST_AT_ONCE = 64 * 1024 * 1024


@pytest.fixture(name="api", scope="module")
def _api(start_api: Any) -> Api:
    api: Api = start_api()
    return api


def _key(api: Api, file_id: str) -> str:
    return str(api.sql("SELECT b.key FROM blob b JOIN file f ON f.blob_id = b.id WHERE f.id = %s", file_id)[0][0])


def test_verification_finds_a_flipped_byte(api: Api, mission_id: str, tmp_path: Path) -> None:
    """The file's own index is whole, so that only reading everything sees it."""
    truth = generate_mcap(tmp_path / "run.mcap", size_bytes=3_000_000, seed=11)
    body = bytearray(truth.path.read_bytes())
    body[len(body) // 2] ^= 0xFF
    truth.path.write_bytes(body)
    with FileSource(truth.path) as source:
        assert read_index(CountingSource(source)).statistics
    file = upload(api, mission_id, "run.mcap", bytes(body))
    run_jobs(api)
    read = api.get(f"/files/{file['id']}").ok()
    assert (read["state"], read["content"], read["depth"]) == ("verified", "recovered", "scan")
    assert "chunk" in read["content_reason"]
    assert read["lost"]["messages"] == truth.message_count - read["message_count"] > 0
    assert read["lost"]["chunks"] == 1
    topics = api.all(f"/files/{file['id']}/topics")
    assert sum(topic["count"] for topic in topics) == read["message_count"]


def test_a_recording_without_index_that_is_too_large_to_be_read_at_once(
    api: Api, mission_id: str, tmp_path: Path
) -> None:
    database = tmp_path / "run_0.db3"
    with sqlite3.connect(database) as db:
        db.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT)")
        db.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)")
        db.execute("INSERT INTO topics VALUES (1, '/big', 'std_msgs/msg/String', 'cdr')")
        rows = ((1, 1_700_000_000_000_000_000 + number, bytes(2**20)) for number in range(65))
        db.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", rows)
    db.close()
    assert database.stat().st_size > _MOST_AT_ONCE
    file = upload(api, mission_id, "run_0.db3", database.read_bytes())
    api.sql("UPDATE procrastinate_jobs SET scheduled_at = now() + interval '1 h' WHERE task_name = 'verify_blob'")
    run_jobs(api)
    read = api.get(f"/files/{file['id']}").ok()
    assert (read["state"], read["content"], read["depth"]) == ("stored", "pending", "summary")
    assert api.get(f"/missions/{mission_id}").ok()["pending_file_count"] == 1, "whoever waits, waits for the scan"
    waiting = "SELECT priority FROM procrastinate_jobs WHERE task_name = 'verify_blob' AND status = 'todo'"
    assert api.sql(waiting) == [(10,)], "before those that nobody waits for"
    api.sql("UPDATE procrastinate_jobs SET scheduled_at = NULL WHERE task_name = 'verify_blob'")
    run_jobs(api)
    assert api.get(f"/missions/{mission_id}").ok()["pending_file_count"] == 0
    read = api.get(f"/files/{file['id']}").ok()
    assert (read["content"], read["depth"], read["format"]) == ("indexed", "scan", "db3")
    assert read["message_count"] == 65


def test_a_file_that_is_no_recording_is_verified(api: Api, mission_id: str) -> None:
    file = upload(api, mission_id, "notes.bin", b"\x01\x02 nothing that we know " * 50_000)
    run_jobs(api)
    read = api.get(f"/files/{file['id']}").ok()
    assert (read["state"], read["content"]) == ("verified", "opaque")


def test_a_reader_that_dies_does_not_stop_the_verification(
    api: Api, mission_id: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    dying = "import sys; sys.stdin.buffer.readline(); sys.exit('no luck today')"
    monkeypatch.setattr(readers_module, "CHILD_COMMAND", (sys.executable, "-c", dying))
    generate_mcap(tmp_path / "run.mcap", size_bytes=2_000_000, seed=12)
    file = upload(api, mission_id, "run.mcap", (tmp_path / "run.mcap").read_bytes())
    run_jobs(api)
    read = api.get(f"/files/{file['id']}").ok()
    assert (read["state"], read["content"]) == ("verified", "error")
    assert "no luck today" in read["content_reason"]


_ANSWERS_EARLY = """
import json, sys
sys.stdin.buffer.readline()
sys.stdin.buffer.read(1000)
sys.stdout.write(json.dumps({"summary": {"format": "mcap", "content": "indexed", "message_count": 1}}) + "\\n")
sys.stdout.flush()
"""


def test_an_answer_of_a_reader_before_all_bytes_were_sent_is_rejected(
    api: Api, mission_id: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    generate_mcap(tmp_path / "run.mcap", size_bytes=2_000_000, seed=14)
    file = upload(api, mission_id, "run.mcap", (tmp_path / "run.mcap").read_bytes())
    api.sql("DELETE FROM procrastinate_jobs WHERE task_name = 'summarise_blob'")
    monkeypatch.setattr(readers_module, "CHILD_COMMAND", (sys.executable, "-c", _ANSWERS_EARLY))
    run_jobs(api)
    read = api.get(f"/files/{file['id']}").ok()
    assert (read["state"], read["content"], read["message_count"]) == ("verified", "error", None)


def test_a_store_that_breaks_off_gives_no_summary_of_half_a_file(api: Api, mission_id: str, tmp_path: Path) -> None:
    truth = generate_mcap(tmp_path / "run.mcap", size_bytes=6_000_000, seed=15)
    file = upload(api, mission_id, "run.mcap", truth.path.read_bytes())
    api.sql("DELETE FROM procrastinate_jobs WHERE task_name = 'summarise_blob'")
    key = _key(api, file["id"])
    settings: Settings = api.app.state.settings
    cut: list[str] = []

    def break_off(requested: ProxiedRequest) -> Cut | None:
        if requested.method != "GET" or not requested.key.endswith(key):
            return None
        cut.append(requested.key)
        return Cut()

    with standing_before(settings.s3_internal_url) as middleman:
        middleman.rule = break_off
        run_jobs(api, store=middleman.url)
    read = api.get(f"/files/{file['id']}").ok()
    assert cut
    assert (read["state"], read["content"], read["depth"], read["summarised_at"]) == ("stored", "pending", None, None)
    api.sql("UPDATE procrastinate_jobs SET scheduled_at = now()")
    run_jobs(api)
    read = api.get(f"/files/{file['id']}").ok()
    assert (read["state"], read["content"], read["depth"]) == ("verified", "indexed", "scan")
    assert read["message_count"] == truth.message_count


@pytest.mark.parametrize("altered", ["shorter", "longer"])
def test_bytes_of_another_number_are_no_recording_to_read(
    api: Api, mission_id: str, tmp_path: Path, altered: str
) -> None:
    body = generate_mcap(tmp_path / "run.mcap", size_bytes=500_000, seed=16).path.read_bytes() + altered.encode()
    file = upload(api, mission_id, "run.mcap", body)
    key = _key(api, file["id"])
    api.sql("DELETE FROM procrastinate_jobs WHERE task_name = 'summarise_blob'")
    on_site(api, lambda site: site.storage.put_object(key, body[:-9] if altered == "shorter" else body + b"more\n"))
    began_at = time.monotonic()
    run_jobs(api)
    read = api.get(f"/files/{file['id']}").ok()
    assert (read["state"], read["content"], read["depth"]) == ("corrupt", "pending", None)
    assert time.monotonic() - began_at < api.app.state.settings.summary_timeout_s, "nobody waits for what is not there"


def test_a_recording_that_is_compressed_as_a_whole(api: Api, mission_id: str, tmp_path: Path) -> None:
    truth = generate_mcap(tmp_path / "run.mcap", size_bytes=1_000_000, seed=13)
    file = upload(api, mission_id, "run.mcap.zstd", zstandard.compress(truth.path.read_bytes()))
    run_jobs(api)
    read = api.get(f"/files/{file['id']}").ok()
    assert (read["content"], read["message_count"]) == ("indexed", truth.message_count)
