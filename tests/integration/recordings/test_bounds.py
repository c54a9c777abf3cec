"""Bytes read and memory used for a summary of large files with many chunks."""

from __future__ import annotations

from io import BytesIO

import pytest

from kleinkram.recordings import Content, RecordingSummary, summarise
from kleinkram.recordings.sources import CountingSource
from tests.memory import call_within
from tests.recording_files.memory_source import MemorySource, SparseFile
from tests.recording_files.synthetic import MESSAGES_PER_CHUNK, SyntheticMcap
from tests.recording_files.writers import BagCompression, BagWriter, Compression, McapWriter

MESSAGES = 400
PAYLOAD = bytes(1_000_000)
SPARE = 1_000_000
T0 = 1_700_000_000_000_000_000


def sparse_mcap() -> tuple[SparseFile, int]:
    """Return 400 MB of MCAP in 400 chunks with 40 small messages each, and the size of its index."""
    file = SparseFile("large.mcap")
    writer = McapWriter(file, compression=Compression.none)  # type: ignore[arg-type]  # it only writes
    image, small = (writer.add_channel(topic, 0, "cdr") for topic in ("/image", "/small"))
    for number in range(MESSAGES):
        for tick in range(40):
            stamp = T0 + number * 40_000 + tick * 1_000
            writer.add_message(small, stamp, b"x" * 20, publish_time_ns=stamp)
        writer.add_message(image, T0 + number * 40_000, PAYLOAD, publish_time_ns=0)
    writer.finish()
    return file, MESSAGES * (41 * 16 + 2 * 15 + 150)


def sparse_bag() -> tuple[SparseFile, int]:
    """Return 400 MB of bag in 400 chunks with 40 small messages each, and the size of its index."""
    file = SparseFile("large.bag")
    writer = BagWriter(file, compression=BagCompression.none)  # type: ignore[arg-type]  # it only writes
    image, small = (writer.add_connection(t, "a/B", md5sum="*", definition="") for t in ("/image", "/small"))
    for number in range(MESSAGES):
        for tick in range(40):
            writer.add_message(small, T0 + number * 40_000 + tick * 1_000, b"x" * 20)
        writer.add_message(image, T0 + number * 40_000, PAYLOAD)
    writer.finish()
    return file, MESSAGES * (41 * 12 + 2 * 55 + 150)


@pytest.fixture(scope="module", params=["mcap", "bag"])
def large(request: pytest.FixtureRequest) -> tuple[SparseFile, int]:
    return sparse_mcap() if request.param == "mcap" else sparse_bag()


def test_a_summary_reads_the_index_and_little_more(large: tuple[SparseFile, int]) -> None:
    file, index_bytes = large
    counting = CountingSource(file)
    summary = summarise(counting)
    assert summary.content is Content.indexed
    assert summary.message_count == MESSAGES * 41
    assert file.size_bytes > 400_000_000
    assert counting.bytes_read <= index_bytes + SPARE
    assert counting.reads <= MESSAGES + 10


@pytest.mark.parametrize(("size_bytes", "chunk_bytes"), [(10**10, 4 * 2**20), (10**12, 128 * 2**20)])
def test_a_summary_of_any_size_costs_its_index(size_bytes: int, chunk_bytes: int) -> None:
    """10 GB and 1 TB: bytes and memory follow the index alone."""
    source = SyntheticMcap(size_bytes, chunk_bytes=chunk_bytes)

    def summarised() -> tuple[RecordingSummary, CountingSource]:
        counting = CountingSource(source)
        return summarise(counting), counting

    summary, counting = call_within(16_000_000, summarised)
    assert summary.content is Content.indexed
    assert counting.size_bytes > 0.99 * size_bytes
    assert summary.message_count == source.chunks * MESSAGES_PER_CHUNK
    assert counting.bytes_read <= source.index_bytes + SPARE


def test_a_scan_needs_memory_for_one_chunk() -> None:
    """Of a chunk of 64 MB without any index, only the stored bytes and the content are held."""
    out = BytesIO()
    writer = McapWriter(out, compression=Compression.zstd, chunk_bytes=2**40)
    channel = writer.add_channel("/image", 0, "cdr")
    for number in range(64):
        writer.add_message(channel, T0 + number, PAYLOAD, publish_time_ns=0)
    writer._flush()
    source = MemorySource(out.getvalue())
    del out, writer
    summary = call_within(80_000_000, lambda: summarise(source))
    assert summary.content is Content.recovered
    assert summary.message_count == 64
