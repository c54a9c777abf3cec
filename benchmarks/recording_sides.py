"""Sides that read recordings, each run as a process of its own (see `sides`): ours and the public readers'."""

import json
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from mcap_ros2_support_fast.decoder import DecoderFactory as FastDecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from small_mcap import read_message_decoded

from kleinkram.recordings.decoding import Value, decoder_for, to_arrow
from kleinkram.recordings.reading import Recording


def decode_ours(path: str) -> dict[str, float]:
    """Decode every message of a recording."""
    started = time.perf_counter()
    with Recording.open(path) as recording:
        decoded = sum(isinstance(message.value, Value) for message in recording.messages())
    return {"seconds": time.perf_counter() - started, "messages": decoded}


def decode_small_mcap(path: str) -> dict[str, float]:
    """The same with small-mcap and mcap-ros2-support-fast."""
    started = time.perf_counter()
    with Path(path).open("rb") as stream:
        found = read_message_decoded(stream, decoder_factories=[FastDecoderFactory()])
        decoded = sum(message.decoded_message is not None for message in found)
    return {"seconds": time.perf_counter() - started, "messages": decoded}


def decode_mcap(path: str) -> dict[str, float]:
    """The same with mcap and mcap-ros2-support."""
    started = time.perf_counter()
    with Path(path).open("rb") as stream:
        found = make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
        decoded = sum(message is not None for _, _, _, message in found)
    return {"seconds": time.perf_counter() - started, "messages": decoded}


def decode_rosbags(path: str) -> dict[str, float]:
    """The same with rosbags."""
    started = time.perf_counter()
    with AnyReader([Path(path)], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        found = (reader.deserialize(data, connection.msgtype) for connection, _, data in reader.messages())
        decoded = sum(message is not None for message in found)
    return {"seconds": time.perf_counter() - started, "messages": decoded}


def arrow_ours(path: str, topic: str) -> dict[str, float]:
    """One topic as an Arrow table, all fields: from the file, and once more from messages that are at hand."""
    started = time.perf_counter()
    with Recording.open(path) as recording:
        rows = recording.to_arrow(topic).num_rows
        seconds = time.perf_counter() - started
        peak_kib = resource.getrusage(
            resource.RUSAGE_SELF
        ).ru_maxrss  # before the messages are held for the second table
        schema = recording.topic(topic).schema
        messages = [(m.log_time_ns, m.publish_time_ns, bytes(m.data)) for m in recording.raw_messages([topic])]
    decoder = decoder_for("cdr", schema.name, schema.encoding, schema.data)
    started = time.perf_counter()
    table = to_arrow(decoder, messages)
    return {
        "seconds": seconds,
        "messages": rows,
        "file_peak_mb": peak_kib / 1024,
        "table_messages_per_s": table.num_rows / (time.perf_counter() - started),
    }


SIDES: dict[str, Callable[..., dict[str, float]]] = {
    side.__name__: side for side in (decode_ours, decode_small_mcap, decode_mcap, decode_rosbags, arrow_ours)
}


def main() -> None:
    """Run the side named on the command line."""
    usage = resource.getrusage(resource.RUSAGE_SELF)
    account = SIDES[sys.argv[1]](*sys.argv[2:])
    account["import_cpu_s"] = usage.ru_utime + usage.ru_stime
    sys.stdout.write(json.dumps(account))


if __name__ == "__main__":
    main()
