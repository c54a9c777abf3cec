"""Sides that cut slices, each run as a process of its own (see `side`): ours, public pairs, and the store alone."""

import json
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from http.client import HTTPConnection
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from mcap.reader import make_reader
from mcap.writer import Writer
from small_mcap import McapWriter, include_topics, read_message

from benchmarks.side import Facts, main
from benchmarks.synthetic_drive import SyntheticDrive
from kleinkram.recordings import Recording, merge_to_mcap
from kleinkram.recordings.http_source import HttpSource
from kleinkram.recordings.limits import PARALLEL_READS

_SECOND_NS = 10**9
_T0 = 1_700_000_000 * _SECOND_NS
_COMPUTERS, _RUNS = 4, 5


def cut_ours(source: str, target: str, start_ns: str, end_ns: str, topics: str) -> Facts:
    """Cut topics of a range out of a local file."""
    started = time.perf_counter()
    with Recording.open(source) as recording:
        result = recording.to_mcap(target, _topics(topics), start=int(start_ns), end=int(end_ns))
    return {"seconds": time.perf_counter() - started, "messages": result.message_count - result.latched_count}


def cut_mcap(source: str, target: str, start_ns: str, end_ns: str, topics: str) -> Facts:
    """The same, read and written with mcap."""
    started = time.perf_counter()
    count = 0
    with Path(source).open("rb") as file, Path(target).open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        channels: dict[int, int] = {}
        messages = make_reader(file).iter_messages(
            _topics(topics), starting_at=int(start_ns), ending_before=int(end_ns)
        )
        for schema, channel, message in messages:
            if channel.id not in channels and schema is not None:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, number)
            writer.add_message(channels[channel.id], message.log_time, message.data, message.publish_time)
            count += 1
        writer.finish()  # type: ignore[no-untyped-call]
    return {"seconds": time.perf_counter() - started, "messages": count}


def cut_small_mcap(source: str, target: str, start_ns: str, end_ns: str, topics: str) -> Facts:
    """The same, read and written with small-mcap."""
    started = time.perf_counter()
    count, names = 0, _topics(topics)
    options: dict[str, Any] = {} if names is None else {"should_include": include_topics(names)}
    with Path(source).open("rb") as file, Path(target).open("wb") as stream:
        writer = McapWriter(stream)
        writer.start("ros2")
        channels: set[int] = set()
        messages = read_message(
            file, start_time_ns=int(start_ns), end_time_ns=int(end_ns), validate_crc=True, **options
        )
        for schema, channel, message in messages:
            if channel.id not in channels and schema is not None:
                channels.add(channel.id)
                writer.add_schema(schema.id, schema.name, schema.encoding, schema.data)
                writer.add_channel(channel.id, channel.topic, channel.message_encoding, schema.id)
            writer.add_message(channel.id, message.log_time, message.data, message.publish_time)
            count += 1
        writer.finish()
    return {"seconds": time.perf_counter() - started, "messages": count}


def _topics(text: str) -> list[str] | None:
    return None if text == "*" else text.split(",")


def cut_remote(url: str, size_bytes: str, target: str, topic: str, start_ns: str, end_ns: str) -> Facts:
    """Cut one topic of a range over HTTP, opening included."""
    started = time.perf_counter()
    source = HttpSource(url, size_bytes=int(size_bytes), name="large.mcap")
    with Recording.open(source) as recording:
        result = recording.to_mcap(target, topic, start=int(start_ns), end=int(end_ns))
    return {
        "seconds": time.perf_counter() - started,
        "messages": result.message_count,
        "bytes": source.bytes_read,
    }


def fetch_alone(url: str, ranges: str) -> Facts:
    """Fetch ranges over HTTP, as many at a time as we do, and throw them away: the time that the store takes."""
    spans: list[tuple[int, int]] = json.loads(ranges)
    parts = urlsplit(url)
    target = f"{parts.path}?{parts.query}"

    def fetch(part: list[tuple[int, int]]) -> int:
        connection, size = HTTPConnection(parts.netloc), 0
        for start, length in part:
            connection.request("GET", target, headers={"Range": f"bytes={start}-{start + length - 1}"})
            size += len(connection.getresponse().read())
        connection.close()
        return size

    started = time.perf_counter()
    with ThreadPoolExecutor(PARALLEL_READS) as pool:
        size = sum(pool.map(fetch, [spans[number::PARALLEL_READS] for number in range(PARALLEL_READS)]))
    return {"seconds": time.perf_counter() - started, "bytes": size}


def cut_mission(target: str, recording_bytes: str) -> Facts:
    """Cut 20 s of the IMU out of 20 synthetic recordings: five runs in a row of four computers each."""
    drives: list[SyntheticDrive] = []
    start_ns = _T0
    for run in range(_RUNS):
        for computer in range(_COMPUTERS):
            name = f"computer{computer}_{run}.mcap"
            drives.append(SyntheticDrive(name, start_ns=start_ns, size_bytes=int(recording_bytes)))
        start_ns = drives[-1].end_ns
    middle = (_T0 + start_ns) // 2
    slice_ns = middle, middle + 20 * _SECOND_NS
    started = time.perf_counter()
    with ExitStack() as stack:
        recordings = [stack.enter_context(Recording.open(drive)) for drive in drives]
        result = merge_to_mcap(recordings, target, "/imu", start=slice_ns[0], end=slice_ns[1])
    return {
        "seconds": time.perf_counter() - started,
        "messages": result.message_count,
        "bytes": sum(drive.bytes_read for drive in drives),
        "total_bytes": sum(drive.size_bytes for drive in drives),
        "needed_bytes": sum(drive.chunks_between(*slice_ns) * drive.chunk_bytes for drive in drives),
        "index_bytes": sum(drive.index_bytes for drive in drives),
    }


if __name__ == "__main__":
    main((cut_ours, cut_mcap, cut_small_mcap, cut_remote, fetch_alone, cut_mission))
