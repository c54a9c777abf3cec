"""The messages of one topic as tables: what `decoding` needs of them, out of blocks."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from kleinkram.recordings.decoding import DecodeError, Decoder, decoder_for
from kleinkram.recordings.reading.merging import Block
from kleinkram.recordings.reading.model import Schema
from kleinkram.recordings.reading.noticing import Noticed


def timed(blocks: Iterable[Block], schema: Schema, encoding: str, noticed: Noticed) -> Iterator[tuple[int, int, bytes]]:
    """Yield log time, publish time and bytes of the messages of one layout; others are left out, and named.

    Schemas of one layout may differ in comments, white space and the order of their definitions.
    """
    fitting: dict[int, bool] = {}
    for block in blocks:
        for topic, log_ns, publish_ns, _sequence, data, channel in block:
            fits = fitting.get(id(channel))
            if fits is None:
                fits = fitting[id(channel)] = _have_one_layout(
                    channel.schema, schema, channel.message_encoding, encoding
                )
            if fits:
                yield log_ns, publish_ns, data
            else:
                message = f"messages of type {channel.schema.name} are left out of the table of {schema.name}"
                noticed.add("topic-types-differ", topic, message)


def _have_one_layout(one: Schema, other: Schema, one_encoding: str, other_encoding: str) -> bool:
    if one_encoding != other_encoding or one.name != other.name:
        return False
    if one == other:
        return True
    decoders = [decoder_for(one_encoding, schema.name, schema.encoding, schema.data) for schema in (one, other)]
    layouts = [decoder.layout for decoder in decoders if isinstance(decoder, Decoder)]
    return len(layouts) == 2 and layouts[0] == layouts[1]


class Notice:
    """Names in the problems what a table could not decode."""

    def __init__(self, topic: str, noticed: Noticed) -> None:
        self._topic = topic
        self._noticed = noticed

    def __call__(self, log_time_ns: int, error: DecodeError) -> None:
        """Note a message whose row has no fields."""
        self._noticed.add(
            "message-undecodable", self._topic, f"at {log_time_ns} ns: {error}; what could not be decoded is null"
        )
