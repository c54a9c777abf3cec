"""Writers that compress in threads: the same bytes, bounded memory, and nothing left behind after an error."""

from __future__ import annotations

import random
import threading
import zlib
from collections.abc import Callable
from io import BytesIO

import pytest

from kleinkram.recordings import CannotWrite
from kleinkram.recordings.writing.bag_writer import BagWriter
from kleinkram.recordings.writing.mcap_writer import McapWriter


def writer_threads() -> int:
    return sum(thread.name.startswith(("compress", "write")) for thread in threading.enumerate())


def mcap(workers: int, compress: Callable[[bytes], bytes]) -> bytes:
    out = BytesIO()
    writer = McapWriter(out, compression="zlib", compress=compress, chunk_bytes=5000, workers=workers)
    channels = [writer.add_channel(f"/{name}", 0, "json") for name in "ab"]
    chance = random.Random(1)
    for number in range(500):
        writer.add_message(channels[number % 2], number, chance.randbytes(chance.randrange(2000)))
        if number % 200 == 150:
            writer.add_metadata("note", [("number", str(number))])
    writer.finish()
    writer.close()
    return out.getvalue()


def bag(workers: int, compress: Callable[[bytes], bytes]) -> bytes:
    out = BytesIO()
    writer = BagWriter(out, compression="bz2", compress=compress, chunk_bytes=5000, workers=workers)
    number = writer.add_connection("/t", "std_msgs/String", md5sum="0" * 32, definition="string data\n")
    chance = random.Random(1)
    for at in range(500):
        writer.add_message(number, at, chance.randbytes(chance.randrange(2000)))
    writer.finish()
    writer.close()
    return out.getvalue()


@pytest.mark.parametrize("write", [mcap, bag])
def test_threads_make_the_same_bytes(write: Callable[[int, Callable[[bytes], bytes]], bytes]) -> None:
    """Also where later chunks are compressed before earlier ones."""
    chance = random.Random(2)
    never = threading.Event()

    def uneven(raw: bytes) -> bytes:
        never.wait(chance.choice((0, 0, 0.002)))
        return zlib.compress(raw, 1)

    alone = write(0, lambda raw: zlib.compress(raw, 1))
    assert write(1, uneven) == write(2, uneven) == write(4, uneven) == alone
    assert writer_threads() == 0


def test_the_number_of_waiting_chunks_is_bounded() -> None:
    """However slowly they are compressed, the writer waits rather than collect them."""
    most, waiting, lock = 0, 0, threading.Lock()
    release = threading.Event()

    def slow(raw: bytes) -> bytes:
        nonlocal most, waiting
        with lock:
            waiting += 1
            most = max(most, waiting)
        release.wait(0.001)
        with lock:
            waiting -= 1
        return raw

    out = BytesIO()
    writer = McapWriter(out, compression="", compress=slow, chunk_bytes=100, workers=2)
    channel = writer.add_channel("/a", 0, "json")
    for number in range(200):
        writer.add_message(channel, number, bytes(100))
        assert len(writer._waiting) <= 4  # what bounds the memory
    writer.finish()
    writer.close()
    assert most == 2


def test_an_error_in_a_thread_ends_the_writer() -> None:
    def fail(raw: bytes) -> bytes:
        raise MemoryError(len(raw))

    writer = McapWriter(BytesIO(), compress=fail, chunk_bytes=100, workers=2)
    channel = writer.add_channel("/a", 0, "json")

    def write_all() -> None:
        for number in range(100):
            writer.add_message(channel, number, bytes(100))
        writer.finish()

    with pytest.raises(MemoryError):
        write_all()
    writer.close()
    assert writer_threads() == 0


def test_more_schemas_than_an_mcap_can_have_are_refused() -> None:
    writer = McapWriter(BytesIO())
    for number in range(2**16 - 1):
        writer.add_schema(str(number), "", b"")
    assert writer.add_schema("7", "", b"") == 8
    with pytest.raises(CannotWrite, match="at most 65535 schemas"):
        writer.add_schema("one more", "", b"")
