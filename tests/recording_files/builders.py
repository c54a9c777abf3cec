"""Small recordings in memory."""

from __future__ import annotations

from collections.abc import Iterable
from io import BytesIO

from tests.recording_files.memory_source import MemorySource
from tests.recording_files.writers import BagCompression, BagWriter, Compression, McapWriter

T0 = 1_700_000_000_000_000_000

Stamped = tuple[str, int, bytes]


def mcap_of(
    chunks: Iterable[Iterable[Stamped]],
    *,
    compression: Compression = Compression.zstd,
    name: str = "test.mcap",
) -> MemorySource:
    """Return an MCAP with these messages (topic, log time, data), chunk by chunk."""
    out = BytesIO()
    writer = McapWriter(out, compression=compression, chunk_bytes=2**40)
    channels: dict[str, int] = {}
    for chunk in chunks:
        for topic, log_ns, data in chunk:
            if topic not in channels:
                channels[topic] = writer.add_channel(topic, 0, "cdr")
            writer.add_message(channels[topic], log_ns, data, publish_time_ns=log_ns - 1)
        writer._flush()
    writer.finish()
    return MemorySource(out.getvalue(), name)


def bag_of(
    chunks: Iterable[Iterable[Stamped]], *, compression: BagCompression = BagCompression.lz4, name: str = "test.bag"
) -> MemorySource:
    """Return a bag with these messages (topic, log time, data), chunk by chunk."""
    out = BytesIO()
    writer = BagWriter(out, compression=compression, chunk_bytes=2**40)
    connections: dict[str, int] = {}
    for chunk in chunks:
        for topic, log_ns, data in chunk:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, "a/B", md5sum="*", definition="uint8 x")
            writer.add_message(connections[topic], log_ns, data)
        writer._flush()
    writer.finish()
    return MemorySource(out.getvalue(), name)


class Watched(MemorySource):
    """A source that remembers which ranges were read."""

    def __init__(self, source: MemorySource, *, parallel_reads: int = 1) -> None:
        super().__init__(source.read(0, source.size_bytes), source.name)
        self.parallel_reads = parallel_reads
        self.ranges: list[tuple[int, int]] = []

    def read(self, offset: int, length: int) -> bytes:
        self.ranges.append((offset, offset + length))
        return super().read(offset, length)

    def touched(self, start: int, end: int) -> bool:
        return any(first < end and start < last for first, last in self.ranges)

    @property
    def bytes_read(self) -> int:
        return sum(last - first for first, last in self.ranges)
