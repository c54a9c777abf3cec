"""Bytes of messages -> values, channel by channel."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from kleinkram.recordings.decoding import DecodeError, Decoder, decoder_for
from kleinkram.recordings.reading.merging import Block
from kleinkram.recordings.reading.model import Channel, Message
from kleinkram.recordings.reading.noticing import Noticed


def decode_blocks(blocks: Iterable[Block], noticed: Noticed) -> Iterator[Message]:
    """Yield the messages of blocks with their values; what cannot be decoded keeps its bytes."""
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
                    noticed.add("message-undecodable", topic, f"a message stays bytes: {error}")
            yield new(Message, (topic, log_ns, publish_ns, sequence, value, channel))


def find_decoder(channel: Channel) -> Decoder | None:
    """Return what decodes a channel's messages; None where nothing does."""
    schema = channel.schema
    found = decoder_for(channel.message_encoding, schema.name, schema.encoding, schema.data)
    return found if isinstance(found, Decoder) else None
