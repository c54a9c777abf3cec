"""All readers agree on every real recording and on every small input that once failed."""

from __future__ import annotations

import re
import sqlite3
import struct
from collections.abc import Callable
from pathlib import Path

import pytest

from kleinkram.recordings import Recording
from kleinkram.recordings.formats.mcap import records
from kleinkram.recordings.formats.mcap.records import Opcode
from tests.conftest import CASES, MakeCase
from tests.recording_files.agreement import Accounts, accounts_of, disagreements
from tests.recording_files.builders import T0, Stamped, Watched, mcap_of
from tests.recording_files.memory_source import MemorySource

CASE_NUMBERS = sorted(path.parent.name.split("-")[0] for path in CASES.glob("*/make.py"))

WITHOUT_RECORDINGS = frozenset(("11A", "17A"))
"""Cases about files rather than recordings: one that only root can read, and names that clash on a server."""

DAMAGED_INSIDE = {"derived/auv_zstd_bitflip_chunk2.mcap"}
"""Recordings whose index is whole and says more than can be read: only reading every byte shows the damage."""


@pytest.fixture(scope="module")
def real_recordings(recordings_dir: Path) -> list[Accounts]:
    return accounts_of(recordings_dir)


def test_all_readers_agree_on_every_real_recording(real_recordings: list[Accounts]) -> None:
    assert len(real_recordings) > 100
    actual = {accounts.name: named for accounts in real_recordings if (named := disagreements(accounts))}
    assert actual == {}


def test_only_the_known_recordings_are_damaged_where_no_index_shows_it(real_recordings: list[Accounts]) -> None:
    less = {
        accounts.name
        for accounts in real_recordings
        if accounts.summary.content is not accounts.scan.content or accounts.summary.count != accounts.scan.count
    }
    assert less == DAMAGED_INSIDE


@pytest.mark.parametrize("number", [number for number in CASE_NUMBERS if number not in WITHOUT_RECORDINGS])
def test_all_readers_agree_on_every_small_input_that_once_failed(number: str, make_case: MakeCase) -> None:
    actual = {accounts.name: named for accounts in accounts_of(make_case(number)) if (named := disagreements(accounts))}
    assert actual == {}


def _database_with_undefined_topic(folder: Path) -> None:
    """Write a database half of whose messages belong to a topic that it does not define."""
    with sqlite3.connect(folder / "undefined.db3") as database:
        database.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT)")
        database.execute(
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)"
        )
        database.execute("INSERT INTO topics VALUES (1, '/t', 'std_msgs/msg/String', 'cdr')")
        rows = [(1 + number % 2, T0 + number, b"x") for number in range(10)]
        database.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", rows)
    database.close()


def _write(folder: Path, name: str, chunks: list[list[Stamped]]) -> None:
    source = mcap_of(chunks)
    (folder / name).write_bytes(source.read(0, source.size_bytes))


def _split(folder: Path) -> None:
    """Write a set of two files; before the second one, the clock was set back."""
    _write(folder, "run_0.mcap", [[("/t", T0 + number * 10**9, b"") for number in range(100)]])
    _write(folder, "run_1.mcap", [[("/t", T0 + number * 10**9, b"") for number in range(100)]])


_S = 10**9
_UNUSUAL: dict[str, Callable[[Path], None]] = {
    "topic-undefined": _database_with_undefined_topic,
    "suspect-stamps": lambda folder: _write(folder, "a.mcap", [[("/t", 5, b""), ("/t", T0, b""), ("/t", T0 + 1, b"")]]),
    "extension-lies": lambda folder: _write(folder, "a.bag", [[("/t", T0, b"")]]),
    "stops-early": lambda folder: _write(
        folder,
        "a.mcap",
        [[("/t", T0 + n * _S, b"") for n in range(12)], [("/u", T0 + n * _S, b"") for n in range(100)]],
    ),
    "clock-jump": _split,
}


@pytest.mark.parametrize("code", _UNUSUAL)
def test_a_recording_names_the_problems_that_its_summary_names(code: str, tmp_path: Path) -> None:
    _UNUSUAL[code](tmp_path)
    (accounts,) = accounts_of(tmp_path)
    assert code in accounts.summary.problems
    assert disagreements(accounts) == []


def test_remote_reading_finds_messages_between_chunks(tmp_path: Path) -> None:
    """A file of chunks and single messages by turns, without an index, so that both are fetched together."""
    source = mcap_of([[("/t", T0 + 10 * number + at, bytes(100)) for at in range(5)] for number in range(4)])
    data = source.read(0, source.size_bytes)
    starts = [match.start() for match in re.finditer(rb"\x06.{8}.{24}.{4}\x04\0\0\0zstd", data, re.DOTALL)][:4]
    end = data.index(bytes([Opcode.DATA_END]) + struct.pack("<Q", 4), starts[-1])
    pieces = [data[: starts[0]]]
    for number, (start, stop) in enumerate(zip(starts, [*starts[1:], end], strict=True)):
        head = struct.pack("<HIQQ", 0, 0, T0 + 10 * number + 7, 0)
        loose = records.RECORD_HEAD.pack(Opcode.MESSAGE, len(head) + 3) + head + b"own"
        pieces += [data[start:stop], loose, loose]
    (tmp_path / "mixed.mcap").write_bytes(b"".join(pieces))
    (accounts,) = accounts_of(tmp_path)
    assert accounts.scan.count == 28
    assert disagreements(accounts) == []


def test_problems_are_read_on_access_and_available_after_closing(tmp_path: Path) -> None:
    _write(tmp_path, "a.mcap", [[("/t", 5, b""), ("/t", T0, b""), ("/t", T0 + 1, b"")]])
    with Recording.open(tmp_path / "a.mcap") as recording:
        pass
    assert [problem.code for problem in recording.problems] == ["suspect-stamps"]
    whole = (tmp_path / "a.mcap").read_bytes()
    watched = Watched(MemorySource(whole), parallel_reads=4)
    with Recording.open(watched) as recording:
        opened = len(watched.ranges)
        assert [problem.code for problem in recording.problems] == ["suspect-stamps"]
        assert len(watched.ranges) > opened
        requested = len(watched.ranges)
        assert recording.problems
    assert len(watched.ranges) == requested
