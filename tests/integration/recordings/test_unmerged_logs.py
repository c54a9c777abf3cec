"""Databases of killed recorders: messages in the SQLite log beside them are read."""

from __future__ import annotations

import shutil
import sqlite3
import struct
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import pytest

from kleinkram.recordings import Content, FileSource, Recording
from kleinkram.recordings.formats.rosbag2.database import find_unmerged_logs
from kleinkram.recordings.inspect import inspect_paths
from kleinkram.recordings.model import Depth
from kleinkram.recordings.summary import scan_with_logs
from kleinkram.recordings.temporary_files import MIN_FREE_DISK_BYTES
from tests.integration.recordings.test_db3 import scan_file
from tests.recording_files.databases import make_database, steady


@pytest.fixture
def killed(tmp_path: Path) -> Path:
    """A copy of a database and its log, taken while the recorder still writes."""
    path = make_database(tmp_path / "a.db3", messages=steady(100))
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        database.execute("PRAGMA journal_mode=WAL")
        database.execute("PRAGMA wal_autocheckpoint=0")
        database.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", steady(50))
        (tmp_path / "killed").mkdir()
        for suffix in ("", "-wal"):
            shutil.copy(f"{path}{suffix}", tmp_path / "killed" / f"a.db3{suffix}")
    return tmp_path / "killed" / "a.db3"


def test_messages_that_are_only_in_the_log_are_read_and_reported(killed: Path) -> None:
    before = {path.name: path.read_bytes() for path in killed.parent.iterdir()}
    summary = scan_file(killed)
    assert (summary.content, summary.message_count) == (Content.recovered, 150)
    assert [(p.code, p.where) for p in summary.problems] == [("wal-not-merged", "a.db3-wal")]
    assert "wal_checkpoint" in (summary.reason or "")
    with Recording.open(killed) as recording:
        assert sum(1 for _ in recording.raw_messages()) == 150
        assert [problem.code for problem in recording.problems] == ["wal-not-merged"]
    assert {path.name: path.read_bytes() for path in killed.parent.iterdir()} == before, "the recording is not touched"


def test_tables_that_are_all_in_the_log_are_found(tmp_path: Path) -> None:
    with closing(sqlite3.connect(tmp_path / "first.db3", isolation_level=None)) as database:
        database.execute("PRAGMA journal_mode=WAL")
        database.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT)")
        database.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INT, timestamp INT, data BLOB)")
        for number in (1, 2):
            database.execute(
                "INSERT INTO topics VALUES (?, ?, 'sensor_msgs/msg/Imu', 'cdr')", (number, f"/imu{number}")
            )
        database.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", steady(20))
        (tmp_path / "killed").mkdir()
        for suffix in ("", "-wal"):
            shutil.copy(tmp_path / f"first.db3{suffix}", tmp_path / "killed" / f"first.db3{suffix}")
    path = tmp_path / "killed" / "first.db3"
    for depth in Depth:
        (actual,) = inspect_paths([path.parent], depth=depth)
        assert (actual.summary.content, actual.summary.message_count) == (Content.recovered, 20)
        assert [item.code for item in actual.summary.problems] == ["wal-not-merged"]
    with Recording.open(path) as recording:
        assert sum(1 for _ in recording.raw_messages()) == 20


def test_a_journal_is_rolled_back_in_a_copy(tmp_path: Path) -> None:
    path = make_database(tmp_path / "a.db3", messages=steady(100))
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        database.execute("PRAGMA cache_size=1")  # so that pages are written before the transaction ends
        database.execute("BEGIN")
        database.executemany(
            "INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)",
            [(topic, time, bytes(3000)) for topic, time, _ in steady(500)],
        )
        (tmp_path / "killed").mkdir()
        for suffix in ("", "-journal"):
            shutil.copy(f"{path}{suffix}", tmp_path / "killed" / f"a.db3{suffix}")
        database.execute("ROLLBACK")
    summary = scan_file(tmp_path / "killed" / "a.db3")
    assert (summary.content, summary.message_count) == (Content.recovered, 100)
    assert [item.code for item in summary.problems] == ["journal-not-merged"]


def test_a_journal_that_names_another_file_deletes_nothing(tmp_path: Path) -> None:
    """SQLite removes the file that a journal names at its end, once no journal names that."""
    victim = tmp_path / "thesis.txt"
    victim.write_text("precious")
    path = make_database(tmp_path / "a.db3", messages=steady(5))
    name = str(victim).encode()
    magic = b"\xd9\xd5\x05\xf9\x20\xa1\x63\xd7"
    trailer = struct.pack(">I", 0x40000000 // 4096 + 1) + name + struct.pack(">II", len(name), sum(name)) + magic
    path.with_name("a.db3-journal").write_bytes(magic + bytes(504) + trailer)
    summary = scan_file(path)
    assert [item.code for item in summary.problems] == ["journal-not-merged", "log-not-read"]
    with Recording.open(path) as recording:
        assert sum(1 for _ in recording.raw_messages()) == 5
    assert victim.read_text() == "precious"


def test_a_journal_that_corrupts_the_copy_loses_no_messages(tmp_path: Path) -> None:
    """It cuts the database down to its first page, in which SQLite then finds no more than that it is malformed."""
    path = make_database(tmp_path / "a.db3", messages=steady(100))
    page_bytes = int.from_bytes(path.read_bytes()[16:18], "big")
    head = b"\xd9\xd5\x05\xf9\x20\xa1\x63\xd7" + struct.pack(">5I", 0, 0, 1, 512, page_bytes)
    journal = path.with_name("a.db3-journal")
    journal.write_bytes(head.ljust(512, b"\0"))
    with FileSource(path) as source, FileSource(journal) as log:
        summaries = [scan_file(path), scan_with_logs(source, {"-journal": log})]
        recordings = [Recording.open(path), Recording.open([source, log])]
        for recording in recordings:
            with recording:
                assert sum(1 for _ in recording.raw_messages()) == 100
                assert {item.code for item in recording.problems} == {"journal-not-merged", "log-not-read"}
    for summary in summaries:
        assert (summary.content, summary.message_count) == (Content.recovered, 100)
        assert [item.code for item in summary.problems] == ["journal-not-merged", "log-not-read"]


def test_recovering_a_database_leaves_no_temporary_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "tmp").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "tmp"))
    path = make_database(tmp_path / "a.db3", messages=[(1, time, bytes(3000)) for _, time, _ in steady(100)])
    data = bytearray(path.read_bytes())
    data[-20 * 4096 : -19 * 4096] = bytes(4096)
    path.write_bytes(data)
    with Recording.open(path) as recording:
        assert list((tmp_path / "tmp").iterdir()) == []
        assert 0 < sum(1 for _ in recording.raw_messages()) < 100
        assert "damaged" in {item.code for item in recording.problems}
    assert list((tmp_path / "tmp").iterdir()) == []


def test_a_log_is_not_applied_if_the_disk_is_too_full_for_sqlite(killed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log_bytes = killed.with_name("a.db3-wal").stat().st_size
    free = MIN_FREE_DISK_BYTES + max(killed.stat().st_size, log_bytes) + log_bytes // 2
    monkeypatch.setattr("shutil.disk_usage", lambda _: SimpleNamespace(free=free))
    summary = scan_file(killed)
    assert (summary.content, summary.message_count) == (Content.recovered, 100)
    assert [item.code for item in summary.problems] == ["wal-not-merged", "log-not-read"]


def test_a_merged_log_causes_no_problem(killed: Path) -> None:
    log = killed.with_name("a.db3-wal")
    remaining = log.read_bytes()
    with closing(sqlite3.connect(killed)) as database:
        database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    log.write_bytes(remaining)
    assert find_unmerged_logs(killed) == []
    assert scan_file(killed).content is Content.indexed


@pytest.mark.parametrize("log", [b"", b"short", b"\x37\x7f\x06\x82" + bytes(500), b"x" * 5000])
def test_an_invalid_log(log: bytes, tmp_path: Path) -> None:
    path = make_database(tmp_path / "a.db3", messages=steady(5))
    path.with_name("a.db3-wal").write_bytes(log)
    assert find_unmerged_logs(path) == []


def test_a_journal_that_was_not_rolled_back_is_reported(tmp_path: Path) -> None:
    path = make_database(tmp_path / "a.db3", messages=steady(5))
    journal = path.with_name("a.db3-journal")
    journal.write_bytes(bytes(512))
    assert find_unmerged_logs(path) == []
    journal.write_bytes(b"\xd9\xd5\x05\xf9\x20\xa1\x63\xd7" + bytes(504))
    assert [(p.code, p.where) for p in find_unmerged_logs(path)] == [("journal-not-merged", "a.db3-journal")]
    assert scan_file(path).content is Content.recovered
