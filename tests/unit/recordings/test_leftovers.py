"""A database whose recorder was killed: the log beside it holds messages that it does not."""

from __future__ import annotations

import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from kleinkram.recordings import Content
from kleinkram.recordings.rosbag2.leftovers import find_leftovers

from .databases import make_database, steady
from .test_db3 import scan_file


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


def test_messages_that_are_only_in_the_log_are_told(killed: Path) -> None:
    before = {path.name: path.read_bytes() for path in killed.parent.iterdir()}
    summary = scan_file(killed)
    assert (summary.content, summary.message_count) == (Content.recovered, 100)
    assert [(p.code, p.where) for p in summary.problems] == [("wal-not-merged", "a.db3-wal")]
    assert "wal_checkpoint" in (summary.reason or "")
    assert {path.name: path.read_bytes() for path in killed.parent.iterdir()} == before, "looked at, not touched"


def test_a_log_that_was_merged_is_not_told(killed: Path) -> None:
    log = killed.with_name("a.db3-wal")
    kept = log.read_bytes()
    with closing(sqlite3.connect(killed)) as database:
        database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    log.write_bytes(kept)
    assert find_leftovers(killed) == []
    assert scan_file(killed).content is Content.indexed


@pytest.mark.parametrize("log", [b"", b"short", b"\x37\x7f\x06\x82" + bytes(500), b"x" * 5000])
def test_a_log_that_is_none(log: bytes, tmp_path: Path) -> None:
    path = make_database(tmp_path / "a.db3", messages=steady(5))
    path.with_name("a.db3-wal").write_bytes(log)
    assert find_leftovers(path) == []


def test_a_journal_that_was_not_rolled_back_is_told(tmp_path: Path) -> None:
    path = make_database(tmp_path / "a.db3", messages=steady(5))
    journal = path.with_name("a.db3-journal")
    journal.write_bytes(bytes(512))
    assert find_leftovers(path) == []
    journal.write_bytes(b"\xd9\xd5\x05\xf9\x20\xa1\x63\xd7" + bytes(504))
    assert [(p.code, p.where) for p in find_leftovers(path)] == [("journal-not-merged", "a.db3-journal")]
    assert scan_file(path).content is Content.recovered
