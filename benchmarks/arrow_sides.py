"""Sides that make an Arrow table of an IMU topic, all fields, each run as a process of its own (see `side`).

Each imports only its own reader, which keeps their memory apart.
"""

import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pyarrow as pa

from benchmarks.side import Facts, main

_VECTORS = {"orientation": "xyzw", "angular_velocity": "xyz", "linear_acceleration": "xyz"}


def arrow_ours(path: str, topic: str) -> Facts:
    """From the file, every checksum checked."""
    from kleinkram.recordings import Recording

    started = time.perf_counter()
    with Recording.open(path) as recording:
        table = recording.to_arrow(topic)
    return {"seconds": time.perf_counter() - started, "messages": table.num_rows, "columns": table.num_columns}


def arrow_at_hand(path: str, topic: str) -> Facts:
    """From messages in memory."""
    from kleinkram.recordings import Recording
    from kleinkram.recordings.decoding import decoder_for, to_arrow

    with Recording.open(path) as recording:
        schema = recording.topic(topic).schema
        messages = [(m.log_time_ns, m.publish_time_ns, bytes(m.data)) for m in recording.raw_messages([topic])]
    decoder = decoder_for("cdr", schema.name, schema.encoding, schema.data)
    started = time.perf_counter()
    table = to_arrow(decoder, messages)
    return {"seconds": time.perf_counter() - started, "messages": table.num_rows, "columns": table.num_columns}


def arrow_small_mcap(path: str, topic: str) -> Facts:
    """From the file with small-mcap and mcap-ros2-support-fast, no checksum checked."""
    from mcap_ros2_support_fast.decoder import DecoderFactory
    from small_mcap import read_message_decoded

    started = time.perf_counter()
    with Path(path).open("rb") as stream:
        messages = read_message_decoded(
            stream,
            should_include=lambda channel, _schema: channel.topic == topic,
            decoder_factories=[DecoderFactory()],
        )
        table = _table((m.message.log_time, m.message.publish_time, m.decoded_message) for m in messages)
    return {"seconds": time.perf_counter() - started, "messages": table.num_rows, "columns": table.num_columns}


def arrow_mcap(path: str, topic: str) -> Facts:
    """From the file with mcap and mcap-ros2-support, no checksum checked."""
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    started = time.perf_counter()
    with Path(path).open("rb") as stream:
        messages = make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages(topics=[topic])
        table = _table((message.log_time, message.publish_time, value) for _, _, message, value in messages)
    return {"seconds": time.perf_counter() - started, "messages": table.num_rows, "columns": table.num_columns}


def _table(messages: Iterable[tuple[int, int, Any]]) -> Any:
    """Build the same table as Kleinkram: a column per number, one per covariance."""
    rows = list(messages)
    columns: dict[str, Any] = {
        "log_time_ns": [log for log, _, _ in rows],
        "publish_time_ns": [publish for _, publish, _ in rows],
        "header.stamp_ns": [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for _, _, m in rows],
        "header.frame_id": [m.header.frame_id for _, _, m in rows],
    }
    for name, axes in _VECTORS.items():
        vectors = [getattr(message, name) for _, _, message in rows]
        columns |= {f"{name}.{axis}": [getattr(vector, axis) for vector in vectors] for axis in axes}
        covariances = [list(getattr(message, f"{name}_covariance")) for _, _, message in rows]
        columns[f"{name}_covariance"] = pa.array(covariances, pa.list_(pa.float64(), 9))
    return pa.table(columns)


if __name__ == "__main__":
    main((arrow_ours, arrow_at_hand, arrow_small_mcap, arrow_mcap))
