"""The topics of a recording out of the channels of its files."""

from __future__ import annotations

from collections.abc import Iterable

from kleinkram.recordings.decoding import Undecodable, decoder_for
from kleinkram.recordings.reading.member import Contents
from kleinkram.recordings.reading.model import Channel, Topic


def list_topics(contents: Iterable[Contents]) -> tuple[Topic, ...]:
    """Return the topics by name, with the counts of all files; a count that one file does not know is not known."""
    first: dict[str, Channel] = {}
    counts: dict[str, int | None] = {}
    for content in contents:
        for number, channel in content.channels.items():
            topic = channel.topic
            first.setdefault(topic, channel)
            so_far = counts.setdefault(topic, 0)
            here = None if content.counts is None else content.counts.get(number, 0)
            counts[topic] = None if so_far is None or here is None else so_far + here
    return tuple(_topic(first[name], counts[name]) for name in sorted(first))


def _topic(channel: Channel, count: int | None) -> Topic:
    schema = channel.schema
    return Topic(channel.topic, schema.name, schema, channel.message_encoding, count, undecodable(channel))


def undecodable(channel: Channel) -> str | None:
    """Return why messages of a channel stay bytes; None where they can be decoded."""
    schema = channel.schema
    decoder = decoder_for(channel.message_encoding, schema.name, schema.encoding, schema.data)
    return decoder.reason if isinstance(decoder, Undecodable) else None
