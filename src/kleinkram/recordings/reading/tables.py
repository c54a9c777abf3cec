"""The messages of one topic as tables: what `decoding` needs of them, out of blocks."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from kleinkram.recordings.decoding import DecodeError
from kleinkram.recordings.reading.merging import Block
from kleinkram.recordings.reading.model import Schema
from kleinkram.recordings.reading.noticing import Noticed


def timed(blocks: Iterable[Block], schema: Schema, noticed: Noticed) -> Iterator[tuple[int, int, bytes]]:
    """Yield log time, publish time and bytes of the messages that have this schema; others are left out, and named."""
    for block in blocks:
        for topic, log_ns, publish_ns, _sequence, data, channel in block:
            if channel.schema is schema or channel.schema == schema:
                yield log_ns, publish_ns, data
            else:
                message = f"messages of type {channel.schema.name} are left out of the table of {schema.name}"
                noticed.add("topic-types-differ", topic, message)


class Notice:
    """Names in the problems what a table could not decode."""

    def __init__(self, topic: str, noticed: Noticed) -> None:
        self._topic = topic
        self._noticed = noticed

    def __call__(self, log_time_ns: int, error: DecodeError) -> None:
        """Note a message whose row has no fields."""
        self._noticed.add("message-undecodable", self._topic, f"at {log_time_ns} ns: {error}; its fields are null")
