"""Writing a rosbag2 folder with SQLite storage: one database and its metadata.yaml. SQLite bounds the memory.

Source: rosbag2_storage_sqlite3, schema version 3; metadata version 5 (ROS 2 Humble).
"""

from __future__ import annotations

import json
import sqlite3
from dataclasses import dataclass
from pathlib import Path

_BATCH = 500
_SCHEMA = """
CREATE TABLE schema(schema_version INTEGER PRIMARY KEY,ros_distro TEXT NOT NULL);
CREATE TABLE metadata(id INTEGER PRIMARY KEY,metadata_version INTEGER NOT NULL,metadata TEXT NOT NULL);
CREATE TABLE topics(id INTEGER PRIMARY KEY,name TEXT NOT NULL,type TEXT NOT NULL,
    serialization_format TEXT NOT NULL,offered_qos_profiles TEXT NOT NULL);
CREATE TABLE messages(id INTEGER PRIMARY KEY,topic_id INTEGER NOT NULL,timestamp INTEGER NOT NULL, data BLOB NOT NULL);
CREATE INDEX timestamp_idx ON messages (timestamp ASC);
INSERT INTO schema(schema_version, ros_distro) VALUES (3, 'humble');
"""


@dataclass
class _Topic:
    name: str
    message_type: str
    count: int = 0


class Db3Writer:
    """Makes the folder, which must not exist yet; call `finish` at the end, or there is no metadata.yaml.

    Attributes:
        bytes_written: bytes of all messages so far, which is a little less than the size of the database.
        path: the database.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True)
        self.path = folder / f"{folder.name}_0.db3"
        self.bytes_written = 0
        self._topics: list[_Topic] = []
        self._batch: list[tuple[int, int, bytes]] = []
        self._first_ns: int | None = None
        self._last_ns = 0
        self._database = sqlite3.connect(self.path, isolation_level=None)
        self._database.execute("PRAGMA journal_mode=OFF")
        self._database.execute("PRAGMA synchronous=OFF")
        self._database.executescript(_SCHEMA)
        self._database.execute("BEGIN")

    def add_topic(self, name: str, message_type: str) -> int:
        """Define a topic; returns its id, to be used for messages."""
        self._topics.append(_Topic(name, message_type))
        topic_id = len(self._topics)
        self._database.execute("INSERT INTO topics VALUES (?, ?, ?, 'cdr', '')", (topic_id, name, message_type))
        return topic_id

    def add_message(self, topic_id: int, log_time_ns: int, payload: bytes) -> None:
        """Add a message."""
        self._topics[topic_id - 1].count += 1
        self._first_ns = log_time_ns if self._first_ns is None else min(self._first_ns, log_time_ns)
        self._last_ns = max(self._last_ns, log_time_ns)
        self._batch.append((topic_id, log_time_ns, payload))
        self.bytes_written += len(payload)
        if len(self._batch) >= _BATCH:
            self._flush()

    def finish(self) -> None:
        """Write what is left and metadata.yaml, and close the database."""
        self._flush()
        self._database.execute("COMMIT")
        self._database.close()
        self.path.with_name("metadata.yaml").write_text(self._metadata(), encoding="utf-8")

    def _flush(self) -> None:
        self._database.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", self._batch)
        self._batch.clear()

    def _metadata(self) -> str:
        start = self._first_ns or 0
        duration = self._last_ns - start
        count = sum(topic.count for topic in self._topics)
        topics = "".join(
            "    - topic_metadata:\n"
            f"        name: {json.dumps(topic.name)}\n"
            f"        type: {topic.message_type}\n"
            "        serialization_format: cdr\n"
            '        offered_qos_profiles: ""\n'
            f"      message_count: {topic.count}\n"
            for topic in self._topics
        )
        return (
            "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: sqlite3\n"
            f"  duration:\n    nanoseconds: {duration}\n"
            f"  starting_time:\n    nanoseconds_since_epoch: {start}\n"
            f"  message_count: {count}\n  topics_with_message_count:\n{topics}"
            '  compression_format: ""\n  compression_mode: ""\n'
            f"  relative_file_paths:\n    - {self.path.name}\n"
            f"  files:\n    - path: {self.path.name}\n"
            f"      starting_time:\n        nanoseconds_since_epoch: {start}\n"
            f"      duration:\n        nanoseconds: {duration}\n"
            f"      message_count: {count}\n"
        )
