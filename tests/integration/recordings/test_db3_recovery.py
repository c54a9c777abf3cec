"""Damaged rosbag2 databases: all messages outside the damage are found."""

from __future__ import annotations

import os
import random
import re
from pathlib import Path

import pytest

from kleinkram.recordings import Content, RecordingSummary
from kleinkram.recordings.formats.rosbag2.database import open_database
from kleinkram.recordings.formats.rosbag2.pages import LEAF_TABLE, PageFile, local_bytes, read_varint
from tests.integration.recordings.test_db3 import scan_file
from tests.recording_files.databases import SCHEMAS, make_database, steady

PAGE = 1024
SIZES = (40, 3000, 200)  # of messages: some go on in other pages
COUNT = 600
# A record of four columns: no id, two whole numbers, data.
_INTEGER = rb"[\x01-\x06\x08\x09]"
_MESSAGE = re.compile(
    rb"(\x05\x00" + 2 * _INTEGER + rb"[\x0c-\x7f]|\x06\x00" + 2 * _INTEGER + rb"[\x80-\xff].)", re.DOTALL
)


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A database whose messages say by their row in which pages they are."""
    messages = [(n % 2 + 1, n + 1, bytes([n % 251]) * SIZES[n % 3]) for n in range(COUNT)]
    path = make_database(tmp_path_factory.mktemp("db") / "a.db3", messages=messages, page_bytes=PAGE)
    return path.read_bytes()


def scan_bytes(data: bytes, folder: Path) -> RecordingSummary:
    path = folder / "damaged.db3"
    path.write_bytes(data)
    return scan_file(path)


def whole_messages(data: bytes) -> int:
    """Count, by a rule of its own, the messages that stand wholly in the pages that are there."""
    actual = 0
    pages = len(data) // PAGE
    for number in range(pages):
        page = data[number * PAGE : (number + 1) * PAGE]
        if page[0] != LEAF_TABLE or number == 0:
            continue
        for cell in range(int.from_bytes(page[3:5], "big")):
            at = int.from_bytes(page[8 + 2 * cell : 10 + 2 * cell], "big")
            payload, at = read_varint(page, at)
            _, at = read_varint(page, at)
            if not _MESSAGE.match(page, at):
                continue
            local = local_bytes(payload, PAGE)
            following = int.from_bytes(page[at + local : at + local + 4], "big") if local < payload else 0
            while following and following <= pages:
                following = int.from_bytes(data[(following - 1) * PAGE :][:4], "big")
            actual += following == 0
    return actual


def test_the_message_count_of_the_test_is_correct(sound: bytes, tmp_path: Path) -> None:
    assert whole_messages(sound) == COUNT == scan_bytes(sound, tmp_path).message_count


@pytest.mark.parametrize("tenths", range(1, 100, 7))
def test_cut_anywhere(tenths: int, sound: bytes, tmp_path: Path) -> None:
    data = sound[: len(sound) * tenths // 100]
    summary = scan_bytes(data, tmp_path)
    expected = whole_messages(data)
    assert summary.message_count == expected
    assert summary.content is Content.recovered
    assert f"{len(data)} of {len(sound)} bytes" in (summary.reason or "")
    assert summary.lost is not None
    assert summary.lost.messages is None
    assert summary.lost.bytes < len(data)
    minimum = re.search(r"at least (\d+) are lost", summary.reason or "")
    assert minimum is None or int(minimum[1]) <= COUNT - expected


@pytest.mark.parametrize("seed", range(12))
def test_pages_of_rubbish(seed: int, sound: bytes, tmp_path: Path) -> None:
    """Rubbish over leaf pages of messages: their rows are lost, all others are found, and the loss is exact."""
    chosen = random.Random(seed)
    leaves = [n for n in range(10, len(sound) // PAGE - 30) if sound[n * PAGE] == LEAF_TABLE]
    data = bytearray(sound)
    for number in chosen.sample(leaves, 3):
        data[number * PAGE : (number + 1) * PAGE] = chosen.choice([bytes(PAGE), chosen.randbytes(PAGE), b"\xff" * PAGE])
    summary = scan_bytes(bytes(data), tmp_path)
    expected = whole_messages(bytes(data))
    assert summary.content is Content.recovered
    assert summary.message_count == expected < COUNT
    assert summary.lost is not None
    assert summary.lost.messages == COUNT - expected
    assert "page" in (summary.reason or "")


@pytest.mark.parametrize("seed", range(30))
def test_flipped_bytes_never_raise(seed: int, sound: bytes, tmp_path: Path) -> None:
    chosen = random.Random(seed)
    data = bytearray(sound)
    for _ in range(40):
        data[chosen.randrange(100, len(data))] = chosen.randrange(256)
    summary = scan_bytes(bytes(data), tmp_path)
    assert summary.content in (Content.indexed, Content.recovered, Content.broken)
    assert (summary.reason is None) == (summary.content is Content.indexed)
    assert summary.message_count is None or summary.message_count <= COUNT


@pytest.mark.parametrize("schema", SCHEMAS)
def test_topics_are_found_in_what_is_left(schema: str, tmp_path: Path) -> None:
    path = make_database(tmp_path / "a.db3", schema=schema, messages=steady(2000))
    summary = scan_bytes(path.read_bytes()[:-6000], tmp_path)
    assert summary.content is Content.recovered
    assert [(t.name, t.message_type, t.message_encoding) for t in summary.topics] == [
        ("/fix", "sensor_msgs/msg/NavSatFix", "" if schema == "crystal" else "cdr"),
        ("/imu", "sensor_msgs/msg/Imu", "" if schema == "crystal" else "cdr"),
    ]


def test_messages_whose_topics_are_lost_stay_in_separate_topics(sound: bytes, tmp_path: Path) -> None:
    with open_database(_write(tmp_path / "sound.db3", sound)) as database:
        (root,) = database.execute("SELECT rootpage FROM sqlite_master WHERE name = 'topics'").fetchone()
    data = bytearray(sound)
    data[(root - 1) * PAGE : root * PAGE] = b"\xee" * PAGE
    summary = scan_bytes(bytes(data), tmp_path)
    assert {topic.name: topic.count for topic in summary.topics} == {"(topic id 1)": 300, "(topic id 2)": 300}
    assert summary.content is Content.recovered


def test_a_schema_that_sqlite_calls_too_much_memory(tmp_path: Path) -> None:
    """Found by mutations: a row of the schema that claims 2^64 - 1 bytes, for which SQLite raises MemoryError."""
    data = bytearray(make_database(tmp_path / "a.db3", messages=steady(100)).read_bytes())
    at = int.from_bytes(data[108:110], "big")
    data[at : at + 16] = b"\xff" * 16
    summary = scan_bytes(bytes(data), tmp_path)
    assert (summary.content, summary.message_count) == (Content.recovered, 100)


def test_a_schema_whose_names_are_no_text(tmp_path: Path) -> None:
    """Found by mutations: SQLite quotes the name in an error that Python cannot decode."""
    data = make_database(tmp_path / "a.db3", messages=steady(100)).read_bytes()
    summary = scan_bytes(data.replace(b"timestamp_idx", b"timesta\x80p_idx", 1), tmp_path)
    assert (summary.content, summary.message_count) == (Content.recovered, 100)


def test_a_deleted_row_is_not_brought_back(tmp_path: Path) -> None:
    """Pages of the freelist still hold the rows that were deleted."""
    import sqlite3
    from contextlib import closing

    path = make_database(tmp_path / "a.db3", messages=steady(3000))
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        database.execute("DELETE FROM messages WHERE id > 1000")
    summary = scan_bytes(path.read_bytes()[:-100], tmp_path)
    assert summary.message_count is not None
    assert summary.message_count <= 1000


def _write(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


def test_pages_in_no_order_cost_their_own_bytes(sound: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A chain of pages that jumps through the file is followed page by page; in order, many are read at once."""
    path = tmp_path / "a.db3"
    path.write_bytes(sound + bytes(4 * 2**20))
    read: list[int] = []
    pread = os.pread

    def counted(descriptor: int, length: int, offset: int) -> bytes:
        read.append(length)
        return pread(descriptor, length, offset)

    monkeypatch.setattr("kleinkram.recordings.formats.rosbag2.pages.os.pread", counted)
    with PageFile(path, "a.db3") as file:
        size, count = file.header.page_bytes, file.whole_pages
        in_order = [file.page(number) for number in range(1, count + 1)]
        assert len(read) < 10
        read.clear()
        jumping = [
            number for pair in zip(range(1, count // 2), range(count, count // 2, -1), strict=False) for number in pair
        ]
        assert [file.page(number) for number in jumping] == [in_order[number - 1] for number in jumping]
    assert sum(read) <= size * len(jumping) + 2**21
