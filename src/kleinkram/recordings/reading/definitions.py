"""Schemas and channels of an MCAP with their definitions, for decoding; bounded, whatever the file defines."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field

from kleinkram.recordings.errors import Malformed
from kleinkram.recordings.limits import MAX_TOPICS
from kleinkram.recordings.mcap.records import BodyReader
from kleinkram.recordings.reading.model import Channel, Schema

MAX_DEFINITIONS = 32 * 2**20
"""Bytes of all definitions of one file together."""

NO_SCHEMA = Schema("", "", b"")
_ID = struct.Struct("<H")
_IDS = struct.Struct("<HH")


@dataclass
class Definitions:
    """What a file defines; the first of an id counts."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, tuple[int, str, str]] = field(default_factory=dict)
    _bytes: int = 0

    def read_schema(self, body: bytes, where: str) -> None:
        """Note a schema record."""
        reader = BodyReader(body, where)
        (schema_id,) = reader.fields(_ID)
        if schema_id not in self.schemas:
            self._count(len(body), where)
            self.schemas[schema_id] = Schema(reader.text(), reader.text(), reader.counted())

    def read_channel(self, body: bytes, where: str) -> None:
        """Note a channel record."""
        reader = BodyReader(body, where)
        channel_id, schema_id = reader.fields(_IDS)
        if channel_id not in self.channels:
            if len(self.channels) >= MAX_TOPICS:
                raise Malformed(where, f"more than {MAX_TOPICS} channels", certain=False)
            self._count(len(body), where)
            self.channels[channel_id] = (schema_id, reader.text(), reader.text())

    def resolve(self, message_compression: str) -> dict[int, Channel]:
        """Return the channels with their schemas; one whose schema the file lacks has an empty one."""
        return {
            channel_id: Channel(topic, encoding, self.schemas.get(schema_id, NO_SCHEMA), message_compression)
            for channel_id, (schema_id, topic, encoding) in self.channels.items()
        }

    def _count(self, size: int, where: str) -> None:
        self._bytes += size
        if self._bytes > MAX_DEFINITIONS:
            raise Malformed(where, f"more than {MAX_DEFINITIONS} bytes of definitions", certain=False)
