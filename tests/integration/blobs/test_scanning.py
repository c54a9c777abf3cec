"""Proving reads every byte anyway: a recording is scanned on the way, and says the same here as on a robot."""

import sqlite3
import sys
from pathlib import Path
from typing import Any

import pytest
import zstandard

from kleinkram.recordings import CountingSource, FileSource, Lost
from kleinkram.recordings.forward import from_file
from kleinkram.recordings.mcap.index import read_footer
from kleinkram.recordings.sample import generate_mcap
from kleinkram.recordings.summary import scan
from kleinkram.server.blobs import reading
from tests.integration.jobs import run_jobs
from tests.integration.running import Api
from tests.integration.uploading import upload

_MOST_AT_ONCE = 64 * 1024 * 1024


@pytest.fixture(name="api", scope="module")
def _api(start_api: Any) -> Api:
    api: Api = start_api()
    return api


@pytest.fixture(name="mission_id")
def _mission_id(api: Api) -> str:
    return str(api.mission(api.project()["id"])["id"])


def test_a_flipped_byte_is_found_by_the_proof(api: Api, mission_id: str, tmp_path: Path) -> None:
    """The file's own index is whole, so that only reading everything sees it."""
    truth = generate_mcap(tmp_path / "run.mcap", size_bytes=3_000_000, seed=11)
    body = bytearray(truth.path.read_bytes())
    body[len(body) // 2] ^= 0xFF
    truth.path.write_bytes(body)
    with FileSource(truth.path) as source:
        assert read_footer(CountingSource(source))
    file = upload(api, mission_id, "run.mcap", bytes(body))
    run_jobs(api)
    read = api.get(f"/files/{file['id']}").ok()
    assert (read["state"], read["content"], read["depth"]) == ("proven", "recovered", "scan")
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
    run_jobs(api)
    read = api.get(f"/files/{file['id']}").ok()
    assert (read["content"], read["depth"], read["format"]) == ("indexed", "scan", "db3")
    assert read["message_count"] == 65


def test_what_is_no_recording_is_proven_all_the_same(api: Api, mission_id: str) -> None:
    file = upload(api, mission_id, "notes.bin", b"\x01\x02 nothing that we know " * 50_000)
    run_jobs(api)
    read = api.get(f"/files/{file['id']}").ok()
    assert (read["state"], read["content"]) == ("proven", "opaque")


def test_a_reader_that_dies_leaves_the_proof(
    api: Api, mission_id: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    dying = "import sys; sys.stdin.buffer.readline(); sys.exit('no luck today')"
    monkeypatch.setattr(reading, "CHILD_COMMAND", (sys.executable, "-c", dying))
    generate_mcap(tmp_path / "run.mcap", size_bytes=2_000_000, seed=12)
    file = upload(api, mission_id, "run.mcap", (tmp_path / "run.mcap").read_bytes())
    run_jobs(api)
    read = api.get(f"/files/{file['id']}").ok()
    assert (read["state"], read["content"]) == ("proven", "error")
    assert "no luck today" in read["content_reason"]


def test_every_real_recording_says_the_same_on_the_server(api: Api, mission_id: str, recordings_dir: Path) -> None:
    paths = [path for path in sorted(recordings_dir.rglob("*")) if path.is_file() and path.name != "manifest.json"]
    ids = {}
    for path in paths:
        name = path.relative_to(recordings_dir).as_posix()
        ids[name] = upload(api, mission_id, name, path.read_bytes())["id"]
    run_jobs(api)
    for path in paths:
        name = path.relative_to(recordings_dir).as_posix()
        read = api.get(f"/files/{ids[name]}").ok()
        with from_file(path) as forward:
            here = scan(forward)
        assert read["state"] == "proven", name
        assert (read["content"], read["message_count"]) == (here.content.value, here.message_count), name
        assert (read["start_ns"], read["end_ns"]) == (here.start_ns, here.end_ns), name
        assert (read["lost"] and Lost(**read["lost"])) == here.lost, name
        topics = {(t["name"], t["message_type"], t["count"]) for t in api.all(f"/files/{ids[name]}/topics")}
        assert topics == {(t.name, t.message_type, t.count) for t in here.topics}, name


def test_a_recording_that_is_compressed_as_a_whole(api: Api, mission_id: str, tmp_path: Path) -> None:
    truth = generate_mcap(tmp_path / "run.mcap", size_bytes=1_000_000, seed=13)
    file = upload(api, mission_id, "run.mcap.zstd", zstandard.compress(truth.path.read_bytes()))
    run_jobs(api)
    read = api.get(f"/files/{file['id']}").ok()
    assert (read["content"], read["message_count"]) == ("indexed", truth.message_count)
