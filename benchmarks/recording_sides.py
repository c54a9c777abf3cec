"""Sides that read recordings, each run as a process of its own (see `side`): ours and the public readers'."""

import time
from pathlib import Path

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from mcap_ros2_support_fast.decoder import DecoderFactory as FastDecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from small_mcap import read_message_decoded

from benchmarks.side import Facts, main
from kleinkram.recordings import Recording
from kleinkram.recordings.decoding import Value


def decode_ours(path: str) -> Facts:
    """Decode every message of a recording."""
    started = time.perf_counter()
    with Recording.open(path) as recording:
        decoded = sum(isinstance(message.value, Value) for message in recording.messages())
    return {"seconds": time.perf_counter() - started, "messages": decoded}


def decode_small_mcap(path: str) -> Facts:
    """The same with small-mcap and mcap-ros2-support-fast."""
    started = time.perf_counter()
    with Path(path).open("rb") as stream:
        messages = read_message_decoded(stream, decoder_factories=[FastDecoderFactory()])
        decoded = sum(message.decoded_message is not None for message in messages)
    return {"seconds": time.perf_counter() - started, "messages": decoded}


def decode_mcap(path: str) -> Facts:
    """The same with mcap and mcap-ros2-support."""
    started = time.perf_counter()
    with Path(path).open("rb") as stream:
        messages = make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
        decoded = sum(message is not None for _, _, _, message in messages)
    return {"seconds": time.perf_counter() - started, "messages": decoded}


def decode_rosbags(path: str) -> Facts:
    """The same with rosbags."""
    started = time.perf_counter()
    with AnyReader([Path(path)], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        messages = (reader.deserialize(data, connection.msgtype) for connection, _, data in reader.messages())
        decoded = sum(message is not None for message in messages)
    return {"seconds": time.perf_counter() - started, "messages": decoded}


if __name__ == "__main__":
    main((decode_ours, decode_small_mcap, decode_mcap, decode_rosbags))
