"""Writer of rosbag2 with SQLite storage. Only samples, tests and benchmarks use it.

Source: rosbag2_storage_sqlite3, schema version 3, with metadata version 5 (ROS 2 Humble).
"""

from __future__ import annotations

import json
import sqlite3
from pathlib import Path

_ROSBAG2_SCHEMA = """
CREATE TABLE schema(schema_version INTEGER PRIMARY KEY,ros_distro TEXT NOT NULL);
CREATE TABLE metadata(id INTEGER PRIMARY KEY,metadata_version INTEGER NOT NULL,metadata TEXT NOT NULL);
CREATE TABLE topics(id INTEGER PRIMARY KEY,name TEXT NOT NULL,type TEXT NOT NULL,
    serialization_format TEXT NOT NULL,offered_qos_profiles TEXT NOT NULL);
CREATE TABLE messages(id INTEGER PRIMARY KEY,topic_id INTEGER NOT NULL,timestamp INTEGER NOT NULL, data BLOB NOT NULL);
CREATE INDEX timestamp_idx ON messages (timestamp ASC);
INSERT INTO schema(schema_version, ros_distro) VALUES (3, 'humble');
"""
_METADATA = """\
rosbag2_bagfile_information:
  version: 5
  storage_identifier: sqlite3
  duration:
    nanoseconds: {duration}
  starting_time:
    nanoseconds_since_epoch: {start}
  message_count: {count}
  topics_with_message_count:
{topics}  compression_format: ""
  compression_mode: ""
  relative_file_paths:
    - {name}
  files:
    - path: {name}
      starting_time:
        nanoseconds_since_epoch: {start}
      duration:
        nanoseconds: {duration}
      message_count: {count}
"""
_TOPIC_METADATA = """\
    - topic_metadata:
        name: {name}
        type: {message_type}
        serialization_format: cdr
        offered_qos_profiles: ""
      message_count: {count}
"""


class Db3Writer:
    """Makes a new rosbag2 folder with one database, `path`; call `finish` at the end, or there is no metadata.yaml."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True)
        self.path = folder / f"{folder.name}_0.db3"
        self.bytes_written = 0
        self._topics: list[tuple[str, str]] = []
        self._counts: list[int] = []
        self._batch: list[tuple[int, int, bytes]] = []
        self._first_ns, self._last_ns = 2**63, 0
        self._database = sqlite3.connect(self.path, isolation_level=None)
        self._database.execute("PRAGMA journal_mode=OFF")
        self._database.execute("PRAGMA synchronous=OFF")
        self._database.executescript(_ROSBAG2_SCHEMA)
        self._database.execute("BEGIN")

    def add_topic(self, name: str, message_type: str) -> int:
        """Define a topic; returns its id, to be used for messages."""
        self._topics.append((name, message_type))
        self._counts.append(0)
        topic_id = len(self._topics)
        self._database.execute("INSERT INTO topics VALUES (?, ?, ?, 'cdr', '')", (topic_id, name, message_type))
        return topic_id

    def add_message(self, topic_id: int, log_time_ns: int, payload: bytes) -> None:
        """Add a message."""
        self._counts[topic_id - 1] += 1
        self._first_ns, self._last_ns = min(self._first_ns, log_time_ns), max(self._last_ns, log_time_ns)
        self._batch.append((topic_id, log_time_ns, payload))
        self.bytes_written += len(payload)
        if len(self._batch) >= 500:
            self._flush()

    def finish(self) -> None:
        """Write what is left and metadata.yaml, and close the database."""
        self._flush()
        self._database.execute("COMMIT")
        self._database.close()
        start = self._first_ns if any(self._counts) else 0
        topics = "".join(
            _TOPIC_METADATA.format(name=json.dumps(name), message_type=message_type, count=count)
            for (name, message_type), count in zip(self._topics, self._counts, strict=True)
        )
        metadata = _METADATA.format(
            name=self.path.name, start=start, duration=self._last_ns - start, count=sum(self._counts), topics=topics
        )
        self.path.with_name("metadata.yaml").write_text(metadata, encoding="utf-8")

    def _flush(self) -> None:
        self._database.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", self._batch)
        self._batch.clear()
