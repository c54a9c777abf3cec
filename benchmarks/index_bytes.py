"""How many bytes of a recording are its index: the minimum that a summary reads. Determined with other readers."""

import struct
from pathlib import Path

from mcap.reader import SeekingReader


def index_bytes(path: Path) -> int:
    """Return the bytes of a whole recording that are neither chunks nor messages."""
    return _mcap(path) if path.suffix == ".mcap" else _bag(path)


def _mcap(path: Path) -> int:
    with path.open("rb") as stream:
        summary = SeekingReader(stream).get_summary()
        if summary is None:
            raise ValueError(f"{path} has no summary")
        chunks = sum(chunk.chunk_length for chunk in summary.chunk_indexes)
    return path.stat().st_size - chunks


def _bag(path: Path) -> int:
    """Add up all records of a ROS 1 bag but the chunks. Source: rosbag format 2.0, op 0x05 is a chunk."""
    total, chunk = path.stat().st_size, 0
    with path.open("rb") as stream:
        stream.seek(13)
        while head := stream.read(4):
            header = stream.read(struct.unpack("<I", head)[0])
            (length,) = struct.unpack("<I", stream.read(4))
            chunk += length if b"op=\x05" in header else 0
            stream.seek(length, 1)
    return total - chunk


def needed_bytes(path: Path, topic: str, start_ns: int, end_ns: int) -> int:
    """Return the bytes of an MCAP's chunks that hold messages of a topic in [start, end), and of its summary."""
    with path.open("rb") as stream:
        summary = SeekingReader(stream).get_summary()
        if summary is None:
            raise ValueError(f"{path} has no summary")
        channels = {number for number, channel in summary.channels.items() if channel.topic == topic}
        index_bytes = sum(
            chunk.chunk_length
            for chunk in summary.chunk_indexes
            if chunk.message_start_time < end_ns
            and chunk.message_end_time >= start_ns
            and channels & chunk.message_index_offsets.keys()
        )
        last = max(chunk.chunk_start_offset + chunk.chunk_length for chunk in summary.chunk_indexes)
    return index_bytes + path.stat().st_size - last
