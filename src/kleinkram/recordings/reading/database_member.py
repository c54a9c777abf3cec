"""One rosbag2 database (db3) of a recording: messages by SQLite, in the order of their timestamps.

SQLite reads any page at any time, so the file must be local. Each pass over the messages has a connection of its own,
which takes a few MB. Where the database has no index of timestamps, SQLite sorts numbers, in a temporary file if they
are many, and the messages are fetched one by one.
"""

from __future__ import annotations

import sqlite3
import sys
from collections.abc import Callable, Iterator
from operator import le
from pathlib import Path

from kleinkram.recordings.errors import Malformed
from kleinkram.recordings.reading.chunked import MAX_MESSAGE
from kleinkram.recordings.reading.definitions import MAX_DEFINITIONS
from kleinkram.recordings.reading.member import Contents, Member
from kleinkram.recordings.reading.merging import Block, Piece, Run, merge
from kleinkram.recordings.reading.model import Channel, RawMessage, Schema, Selection
from kleinkram.recordings.reading.noticing import Noticed
from kleinkram.recordings.rosbag2.database import check_tables, columns, open_database, read_origin, read_topics

_LATEST_NS = 2**63 - 1
_BLOCK_BYTES = 4 * 2**20
_BLOCK_ROWS = 2000
_DATA = f"CASE WHEN length(data) <= {MAX_MESSAGE} THEN data END"
_WHERE = "FROM messages WHERE timestamp >= ? AND timestamp < ?"
_BY_INDEX = f"SELECT topic_id, timestamp, {_DATA} {_WHERE} ORDER BY timestamp, rowid"  # our words
_BY_NUMBERS = f"SELECT rowid {_WHERE} ORDER BY timestamp, rowid"
_ONE = f"SELECT topic_id, timestamp, {_DATA} FROM messages WHERE rowid = ?"  # noqa: S608  # our words
_TEXT = f"substr(encoded_message_definition, 1, {MAX_DEFINITIONS})"
_DEFINITIONS = f"SELECT topic_type, encoding, {_TEXT} FROM message_definitions"  # noqa: S608  # our words
_Row = tuple[object, object, object]


class DatabaseMember:
    """A database, its channels being the rows of `topics`."""

    summary = None
    """Opening it reads little of it."""

    def __init__(
        self, path: Path, name: str, noticed: Noticed, recover: Callable[[], Member], *, message_compression: str = ""
    ) -> None:
        """Read what the database says of itself; `recover` opens what is left of it, should it be damaged.

        Raises:
            SourceError: the file cannot be opened.
        """
        self._recover = recover
        self._recovered: Member | None = None
        self._path = path
        self._name = name
        self._noticed = noticed
        self._has_index = False
        self.contents = Contents({}, {}, 0, None, None)
        try:
            with open_database(path) as database:
                check_tables(database)
                self._has_index = _has_index(database)
                compression = message_compression or read_origin(database).message_compression
                channels = _read_channels(database, compression)
                self.contents = _contents(database, channels, has_index=self._has_index)
        except (sqlite3.Error, Malformed) as error:
            self.contents = self._rescue(error).contents

    def pieces(self, selection: Selection, order: tuple[int, ...]) -> Iterator[Piece]:
        """Yield the database as one piece that is read as it goes."""
        if self._recovered is not None:
            yield from self._recovered.pieces(selection, order)
            return
        wanted = {
            number: channel
            for number, channel in self.contents.channels.items()
            if selection.topics is None or channel.topic in selection.topics
        }
        if wanted:
            first_ns = max(selection.start_ns, self.contents.start_ns or 0)
            yield Piece(first_ns, order, lambda: Run([], 0, self._blocks(wanted, selection)))

    def close(self) -> None:
        """Do nothing: no connection outlives a pass."""

    def _blocks(self, wanted: dict[int, Channel], selection: Selection) -> Iterator[Block]:
        """Yield the messages by SQLite; should it stumble, those behind from what can be recovered."""
        latest_ns, of_latest = max(selection.start_ns, self.contents.start_ns or 0), 0
        try:
            for block in self._by_sqlite(wanted, selection):
                if block[0].log_time_ns < latest_ns or not _is_in_order(block):
                    raise sqlite3.DatabaseError("its index of times is not in their order")
                of_latest = of_latest if block[-1].log_time_ns == latest_ns else 0
                latest_ns = block[-1].log_time_ns
                of_latest += sum(message.log_time_ns == latest_ns for message in block)
                yield block
        except sqlite3.Error as error:
            rest = self._rescue(error).pieces(selection._replace(start_ns=latest_ns), ())
            for block in merge(rest):
                seen = sum(message.log_time_ns == latest_ns for message in block[:of_latest])
                of_latest -= seen
                if block[seen:]:
                    yield block[seen:]

    def _by_sqlite(self, wanted: dict[int, Channel], selection: Selection) -> Iterator[Block]:
        block: Block = []
        size = 0
        with open_database(self._path) as database:
            if sys.version_info >= (3, 11):
                database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, 2 * MAX_MESSAGE)
            for topic_id, timestamp, data in self._rows(database, wanted, selection):
                channel = wanted.get(topic_id) if isinstance(topic_id, int) else None
                if channel is None or not isinstance(timestamp, int):
                    continue
                if not isinstance(data, bytes):
                    self._noticed.add("damaged-message", channel.topic, "left out: its data are too large, or none")
                    continue
                block.append(RawMessage(channel.topic, timestamp, timestamp, 0, data, channel))
                size += len(data)
                if size > _BLOCK_BYTES or len(block) >= _BLOCK_ROWS:
                    yield block
                    block, size = [], 0
        if block:
            yield block

    def _rows(self, database: sqlite3.Connection, wanted: dict[int, Channel], selection: Selection) -> Iterator[_Row]:
        span = (max(0, selection.start_ns), min(selection.end_ns, _LATEST_NS))
        if self._has_index:
            some = len(wanted) < len(self.contents.channels)
            numbers = ", ".join(str(number) for number in wanted)
            statement = _BY_INDEX.replace("ORDER", f"AND topic_id IN ({numbers}) ORDER") if some else _BY_INDEX
            yield from database.execute(statement, span)
            return
        for (number,) in database.execute(_BY_NUMBERS, span):
            yield from database.execute(_ONE, (number,))

    def _rescue(self, error: Exception) -> Member:
        self._noticed.add("damaged", self._name, f"SQLite cannot read it ({error}); what is left of it is read")
        if self._recovered is None:
            self._recovered = self._recover()
        return self._recovered


def _is_in_order(block: Block) -> bool:
    """Say whether times never fall: a damaged index hands messages out in an order of its own."""
    stamps = [message.log_time_ns for message in block]
    return all(map(le, stamps, stamps[1:]))


def _has_index(database: sqlite3.Connection) -> bool:
    statements = database.execute("SELECT sql FROM sqlite_master WHERE type = 'index' AND tbl_name = 'messages'")
    return any(isinstance(sql, str) and "(timestamp" in sql.replace(" ", "").lower() for (sql,) in statements)


def _read_channels(database: sqlite3.Connection, message_compression: str) -> dict[int, Channel]:
    definitions: dict[str, tuple[str, bytes]] = {}
    if {"topic_type", "encoding", "encoded_message_definition"} <= columns(database, "message_definitions"):
        size = 0
        for name, encoding, text in database.execute(_DEFINITIONS):
            if isinstance(name, str) and isinstance(encoding, str) and isinstance(text, str):
                size += len(text)
                if size > MAX_DEFINITIONS:
                    break
                definitions.setdefault(name, (encoding, text.encode()))
    return {
        topic.topic_id: Channel(
            topic.name,
            topic.serialization_format or "cdr",
            Schema(topic.message_type, *definitions.get(topic.message_type, ("", b""))),
            message_compression,
        )
        for topic in read_topics(database)
    }


def _contents(database: sqlite3.Connection, channels: dict[int, Channel], *, has_index: bool) -> Contents:
    """Say what is cheap to know: with an index of timestamps, the span and how many messages there are."""
    if not has_index:
        return Contents(channels, None, None, None, None)
    (count,) = database.execute("SELECT count(*) FROM messages").fetchone()
    ends = [
        database.execute(f"SELECT timestamp FROM messages ORDER BY timestamp {way} LIMIT 1").fetchone()  # noqa: S608  # our words
        for way in ("ASC", "DESC")
    ]
    start_ns, end_ns = (end[0] if end and isinstance(end[0], int) else None for end in ends)
    return Contents(channels, None, count, start_ns, end_ns)
