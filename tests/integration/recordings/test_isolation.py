"""The reader process returns the same summary, is stopped at its limits, and its end is classified."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import zstandard

from kleinkram.recordings import Content, Depth, FailureKind, FileSource, SummaryFailed, isolation, summarise
from kleinkram.recordings.formats.rosbag2.metadata import parse_rosbag2_metadata
from kleinkram.recordings.isolation import (
    CHILD_COMMAND,
    CHILD_ENVIRONMENT,
    FileRequest,
    MetadataRequest,
    StreamRequest,
    read_answer,
    read_metadata_answer,
    request_bytes,
    summarise_isolated,
    timed_out,
)
from kleinkram.recordings.sample import generate_mcap
from kleinkram.recordings.sources import SourceReader
from kleinkram.recordings.summary import scan
from tests.unit.recordings.test_hostile import chunk, mcap_of

RECORD = b"\x80" + bytes(8)


def test_same_summary_as_in_this_process(tmp_path: Path) -> None:
    truth = generate_mcap(tmp_path / "drive.mcap", duration_s=1)
    with FileSource(truth.path) as source:
        assert summarise_isolated(FileRequest(str(truth.path))) == summarise(source)


def test_same_scan_as_in_this_process(tmp_path: Path) -> None:
    truth = generate_mcap(tmp_path / "drive.mcap", duration_s=1)
    with FileSource(truth.path) as source:
        assert summarise_isolated(FileRequest(str(truth.path)), depth=Depth.scan) == scan(SourceReader(source))


def test_a_child_reads_files_from_its_standard_input(tmp_path: Path) -> None:
    """Two files through one child; of the one that is no recording, only the head is looked at, and all is taken."""
    truth = generate_mcap(tmp_path / "drive.mcap", duration_s=1)
    data = truth.path.read_bytes()
    lines = b"".join(
        request_bytes(StreamRequest(len(body), name)) + b"\n" + body
        for name, body in (("notes.bin", b"\x01" * 3_000_000), ("drive.mcap", data))
    )
    done = subprocess.run(CHILD_COMMAND, input=lines, env=CHILD_ENVIRONMENT, capture_output=True, check=True)
    first, second = (read_answer(line, b"", 0) for line in done.stdout.splitlines())
    assert first.content is Content.opaque
    with FileSource(truth.path) as source:
        assert second == scan(SourceReader(source))


def test_metadata_of_a_folder() -> None:
    """Good ones, something else, and no YAML at all."""
    texts = (
        "rosbag2_bagfile_information:\n  version: 5\n  files: [{path: a.db3, message_count: 2}]\n"
        "  topics_with_message_count: [{message_count: 2, topic_metadata: {name: /a, type: T}}]\n",
        "other: 1",
        "{",
    )
    lines = b"".join(request_bytes(MetadataRequest(text)) + b"\n" for text in texts)
    done = subprocess.run(CHILD_COMMAND, input=lines, env=CHILD_ENVIRONMENT, capture_output=True, check=True)
    answers = [read_metadata_answer(line, b"", 0) for line in done.stdout.splitlines()]
    assert answers == [parse_rosbag2_metadata(text) for text in texts]
    assert answers[2] is None
    with pytest.raises(SummaryFailed, match="cannot be understood"):
        read_metadata_answer(b'{"metadata": {"files": []}}', b"", 0)


def test_bytes_that_break_off(tmp_path: Path) -> None:
    line = request_bytes(StreamRequest(1_000, "drive.mcap")) + b"\n" + bytes(10)
    done = subprocess.run(CHILD_COMMAND, input=line, env=CHILD_ENVIRONMENT, capture_output=True, check=True)
    with pytest.raises(SummaryFailed, match="before the 1000 announced"):
        read_answer(done.stdout, done.stderr, 0)


def test_a_pending_summary_states_the_cost_of_a_scan(tmp_path: Path) -> None:
    truth = generate_mcap(tmp_path / "drive.mcap", duration_s=1)
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(truth.path.read_bytes()[:-100])
    with FileSource(cut) as source:
        summary = summarise(source, max_bytes=1000)
    assert summary.content is Content.pending
    assert summary.reason is not None
    assert str(cut.stat().st_size) in summary.reason
    assert summary.bytes_read < 100_000


def test_a_file_that_is_not_there() -> None:
    with pytest.raises(SummaryFailed) as caught:
        summarise_isolated(FileRequest("/nowhere/drive.mcap"))
    assert caught.value.kind is FailureKind.source
    assert "/nowhere/drive.mcap" in str(caught.value)


def test_a_pipe_is_refused_rather_than_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.mcap")
    with pytest.raises(SummaryFailed, match="not a regular file"):
        summarise_isolated(FileRequest(str(tmp_path / "pipe.mcap")))


def test_a_file_that_needs_too_much_memory(tmp_path: Path) -> None:
    """A zstd frame with a window of 64 MB, in a process that may have 64 MB in all."""
    parameters = zstandard.ZstdCompressionParameters(window_log=26)
    compressor = zstandard.ZstdCompressor(compression_params=parameters).compressobj()
    stored = compressor.compress(RECORD * 10) + compressor.flush()
    path = tmp_path / "hungry.mcap"
    path.write_bytes(mcap_of(chunk(b"zstd", stored, 90)))
    assert summarise_isolated(FileRequest(str(path))).content is Content.indexed
    with pytest.raises(SummaryFailed) as caught:
        summarise_isolated(FileRequest(str(path)), memory_bytes=64 * 2**20)
    assert caught.value.kind is FailureKind.memory


def test_a_file_that_takes_too_long(tmp_path: Path) -> None:
    """A few kilobytes that hold a hundred million empty records."""
    size = len(RECORD) * 10_000_000
    compressor = zstandard.ZstdCompressor().compressobj()
    stored = b"".join(compressor.compress(RECORD * 100_000) for _ in range(100)) + compressor.flush()
    path = tmp_path / "endless.mcap"
    path.write_bytes(mcap_of(chunk(b"zstd", stored, size) * 10))
    with pytest.raises(SummaryFailed) as caught:
        summarise_isolated(FileRequest(str(path)), timeout_s=1)
    assert caught.value.kind is FailureKind.time


def test_a_crash_is_reported_with_its_signal() -> None:
    with pytest.raises(SummaryFailed) as caught:
        read_answer(b"", b"", -signal.SIGSEGV)
    assert (caught.value.kind, caught.value.signal) == (FailureKind.crash, signal.SIGSEGV)


def test_exceeding_the_processor_time_is_a_timeout() -> None:
    with pytest.raises(SummaryFailed) as caught:
        read_answer(b"", b"", -signal.SIGXCPU)
    assert caught.value.kind is FailureKind.time
    assert timed_out().kind is FailureKind.time


def test_an_answer_that_cannot_be_understood() -> None:
    with pytest.raises(SummaryFailed) as caught:
        read_answer(b"[1, 2]\n", b"", 0)
    assert caught.value.kind is FailureKind.crash


def test_a_request_that_cannot_be_understood_ends_the_child() -> None:
    done = subprocess.run(CHILD_COMMAND, input=b"{}", capture_output=True, env=CHILD_ENVIRONMENT, check=False)
    with pytest.raises(SummaryFailed) as caught:
        read_answer(done.stdout, done.stderr, done.returncode)
    assert caught.value.kind is FailureKind.crash


def test_the_child_gets_no_secret(monkeypatch: pytest.MonkeyPatch) -> None:
    """The environment of the parent, with its credentials, does not reach the child."""
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "hunter2")
    program = "import json, os; print(json.dumps({'failed': 'source', 'message': str(dict(os.environ))}))"
    monkeypatch.setattr(isolation, "CHILD_COMMAND", (sys.executable, "-I", "-c", program))
    with pytest.raises(SummaryFailed, match="MALLOC_ARENA_MAX") as caught:
        summarise_isolated(FileRequest("/nowhere"))
    assert "hunter2" not in str(caught.value)
