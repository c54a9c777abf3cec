"""rosbag2 databases of every schema version."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable, Sequence
from contextlib import closing
from pathlib import Path

from kleinkram.recordings import Problem

T0 = 1_700_000_000_000_000_000
MESSAGES = (
    "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL,"
    " data BLOB NOT NULL)"
)
INDEX = "CREATE INDEX timestamp_idx ON messages (timestamp ASC)"
HUMBLE = (
    "CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL)",
    "CREATE TABLE metadata(id INTEGER PRIMARY KEY, metadata_version INTEGER NOT NULL, metadata TEXT NOT NULL)",
)
TOPICS = "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL"
SCHEMAS: dict[str, Sequence[str]] = {
    "crystal": (f"{TOPICS})", MESSAGES),
    "dashing": (f"{TOPICS}, serialization_format TEXT NOT NULL)", MESSAGES),
    "foxy": (f"{TOPICS}, serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL)", MESSAGES, INDEX),
    "humble": (
        *HUMBLE,
        f"{TOPICS}, serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL)",
        MESSAGES,
        INDEX,
    ),
    "jazzy": (
        *HUMBLE,
        f"{TOPICS}, serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL,"
        " type_description_hash TEXT NOT NULL)",
        "CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL, encoding TEXT NOT NULL,"
        " encoded_message_definition TEXT NOT NULL, type_description_hash TEXT NOT NULL)",
        MESSAGES,
        INDEX,
    ),
}


def make_database(
    path: Path,
    *,
    schema: str = "humble",
    topics: Iterable[tuple[str, str]] = (("/imu", "sensor_msgs/msg/Imu"), ("/fix", "sensor_msgs/msg/NavSatFix")),
    messages: Iterable[tuple[object, object, object]] = (),
    page_bytes: int = 4096,
) -> Path:
    """Make a database of rows (topic id from 1, timestamp, data)."""
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        database.execute(f"PRAGMA page_size={page_bytes}")
        database.execute("BEGIN")
        for statement in SCHEMAS[schema]:
            database.execute(statement)
        columns = len(database.execute("PRAGMA table_info(topics)").fetchall())
        for number, topic in enumerate(topics, 1):
            row = (number, *topic, "cdr", "- history: 3", "RIHS01_00")[:columns]
            database.execute(f"INSERT INTO topics VALUES ({', '.join('?' * columns)})", row)
        database.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", messages)
        database.execute("COMMIT")
    return path


def steady(count: int, *, size: int = 200, topics: int = 2) -> list[tuple[object, object, object]]:
    """Return messages every 10 ms, by turns on each topic."""
    return [(number % topics + 1, T0 + number * 10_000_000, bytes([number % 251]) * size) for number in range(count)]


def faults(problems: Iterable[Problem]) -> list[Problem]:
    """Return the problems of files, without the quality warnings about topics."""
    return [one for one in problems if one.code not in ("silent-topic", "starts-late", "stops-early", "long-gap")]
