"""Decodes raw messages, channel by channel."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from kleinkram.recordings.damage_report import ProblemLog
from kleinkram.recordings.decoding import DecodeError, Decoder, Undecodable, decoder_for
from kleinkram.recordings.formats.base import MemberContents
from kleinkram.recordings.formats.ulog import as_ros1_definition
from kleinkram.recordings.messages import Block, Channel, Message, Schema, Topic


def decode_blocks(blocks: Iterable[Block], problem_log: ProblemLog) -> Iterator[Message]:
    """Yield decoded messages; one that cannot be decoded has its bytes as value."""
    decoders: dict[int, tuple[Channel, Decoder | None]] = {}
    new = tuple.__new__
    for block in blocks:
        for topic, log_ns, publish_ns, sequence, data, channel in block:
            known = decoders.get(id(channel))
            if known is None:
                known = decoders[id(channel)] = (channel, find_decoder(channel))
            value: object = data
            decoder = known[1]
            if decoder is not None:
                try:
                    value = decoder.decode(data)
                except DecodeError as error:
                    problem_log.add("message-undecodable", topic, f"a message stays bytes: {error}")
            yield new(Message, (topic, log_ns, publish_ns, sequence, value, channel))


def decoder_of(message_encoding: str, schema: Schema) -> Decoder | Undecodable:
    """Return the decoder of a message encoding and schema, or why there is none."""
    if (message_encoding, schema.encoding) == ("ulog", "ulog"):
        return decoder_for("ros1", schema.name, "ros1msg", as_ros1_definition(schema.name, schema.data))
    return decoder_for(message_encoding, schema.name, schema.encoding, schema.data)


def find_decoder(channel: Channel) -> Decoder | None:
    """Return the decoder of a channel; None if there is none."""
    decoder = decoder_of(channel.message_encoding, channel.schema)
    return decoder if isinstance(decoder, Decoder) else None


def timed(
    blocks: Iterable[Block], schema: Schema, encoding: str, problem_log: ProblemLog
) -> Iterator[tuple[int, int, bytes]]:
    """Yield log time, publish time and bytes of the messages of one layout; others are left out and reported.

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
                problem_log.add("topic-types-differ", topic, message)


def _have_one_layout(one: Schema, other: Schema, one_encoding: str, other_encoding: str) -> bool:
    if one_encoding != other_encoding or one.name != other.name:
        return False
    if one == other:
        return True
    decoders = [decoder_of(one_encoding, schema) for schema in (one, other)]
    layouts = [decoder.layout for decoder in decoders if isinstance(decoder, Decoder)]
    return len(layouts) == 2 and layouts[0] == layouts[1]


class DecodeProblemLogger:
    """Reports messages that a table could not decode."""

    def __init__(self, topic: str, problem_log: ProblemLog) -> None:
        self._topic = topic
        self._problem_log = problem_log

    def __call__(self, log_time_ns: int, error: DecodeError) -> None:
        """Note a message whose row has no fields."""
        self._problem_log.add(
            "message-undecodable", self._topic, f"at {log_time_ns} ns: {error}; what could not be decoded is null"
        )


def list_topics(contents: Iterable[MemberContents]) -> tuple[Topic, ...]:
    """Return the topics by name, with the counts over all files; None if one file does not know its count."""
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
    """Return why messages of a channel stay bytes; None if they can be decoded."""
    decoder = decoder_of(channel.message_encoding, channel.schema)
    return decoder.reason if isinstance(decoder, Undecodable) else None
