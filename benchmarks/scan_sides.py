"""Sides that scan recordings, each run as a process of its own (see `side`): ours and the public readers'."""

import time
from collections import Counter
from pathlib import Path

from benchmarks.side import Facts, main
from kleinkram.recordings import summarise
from kleinkram.recordings.sources import CountingSource, FileSource, SourceReader
from kleinkram.recordings.summary import scan

_CHUNK_BYTES = 4 * 2**20


def scan_ours(path: str) -> Facts:
    """Read everything, check everything."""
    started = time.perf_counter()
    with FileSource(path) as source:
        summary = scan(SourceReader(source))
    return {"seconds": time.perf_counter() - started, "messages": summary.message_count or 0}


def scan_mcap(path: str) -> Facts:
    """Read everything with `mcap`, checksums on, and count messages by channel."""
    from mcap.records import Message
    from mcap.stream_reader import StreamReader

    started = time.perf_counter()
    counts: Counter[int] = Counter()
    with Path(path).open("rb") as stream:
        for record in StreamReader(stream, validate_crcs=True).records:
            if isinstance(record, Message):
                counts[record.channel_id] += 1
    return {"seconds": time.perf_counter() - started, "messages": counts.total()}


def scan_small_mcap(path: str) -> Facts:
    """Read everything with `small-mcap`, checksums on, and count messages by channel."""
    import small_mcap

    started = time.perf_counter()
    counts: Counter[int] = Counter()
    with Path(path).open("rb") as stream:
        for record in small_mcap.stream_reader(stream, validate_crc=True):
            if isinstance(record, small_mcap.Message):
                counts[record.channel_id] += 1
    return {"seconds": time.perf_counter() - started, "messages": counts.total()}


def scan_rosbags(path: str) -> Facts:
    """Read every message of a bag with `rosbags`, and count them by topic."""
    from rosbags.rosbag1 import Reader

    started = time.perf_counter()
    counts: Counter[str] = Counter()
    with Reader(path) as reader:
        for connection, _stamp, _payload in reader.messages():
            counts[connection.topic] += 1
    return {"seconds": time.perf_counter() - started, "messages": counts.total()}


def summary_synthetic(size_bytes: str) -> Facts:
    """Summarise a recording of that size, which is generated while it is read."""
    from tests.recording_files.synthetic import SyntheticMcap

    source = SyntheticMcap(int(size_bytes), chunk_bytes=_CHUNK_BYTES)
    counting = CountingSource(source)
    started = time.perf_counter()
    summary = summarise(counting)
    seconds = time.perf_counter() - started
    return {
        "seconds": seconds,
        "messages": summary.message_count or 0,
        "bytes_read": counting.bytes_read,
        "index_bytes": source.index_bytes,
    }


if __name__ == "__main__":
    main((scan_ours, scan_mcap, scan_small_mcap, scan_rosbags, summary_synthetic))
