"""Invariants of every file, whatever its bytes: it has a summary, a scan, and as many messages as can be read."""

from __future__ import annotations

import json
from contextlib import suppress
from itertools import islice
from pathlib import Path

from kleinkram.recordings import (
    Content,
    FileSource,
    NotARecording,
    Recording,
    RecordingSummary,
    TooDisordered,
    summarise,
)
from kleinkram.recordings.decoding import image, points
from kleinkram.recordings.decoding.types import DecodeError
from kleinkram.recordings.isolation import from_dict, to_dict
from kleinkram.recordings.sources import SourceReader
from kleinkram.recordings.summary import scan
from tests.fuzz.seeds import Seed

_FILE_ZSTD = "file-zstd"
_LEAST_MESSAGE_BYTES = 8
_MOST_EXPANSION = 2_000
_MESSAGES_READ = 200
_TABLES = 3


def check(file: Seed, folder: Path) -> None:
    """Look at a file in every way.

    Raises:
        AssertionError: a promise is broken. Any other exception is one too.
    """
    path = folder / file.name
    path.write_bytes(file.data)
    try:
        with FileSource(path) as source:
            _check_summary(summarise(source), len(file.data))
        with FileSource(path) as source:
            _check_summary(scan(SourceReader(source)), len(file.data))
        _check_messages(path)
    finally:
        path.unlink()  # a metadata.yaml would find the files of other cases beside itself


def _check_summary(summary: RecordingSummary, size_bytes: int) -> None:
    assert summary.content is not Content.error
    assert (summary.content is Content.indexed) == (summary.reason is None)
    assert from_dict(json.loads(json.dumps(to_dict(summary)))) == summary
    counted = sum(topic.count or 0 for topic in summary.topics)
    assert counted * _LEAST_MESSAGE_BYTES <= size_bytes * _MOST_EXPANSION
    if summary.start_ns is not None and summary.end_ns is not None:
        assert summary.start_ns <= summary.end_ns
    if summary.lost is not None:
        assert 0 <= summary.lost.bytes <= size_bytes * (_MOST_EXPANSION if _FILE_ZSTD in summary.compression else 1)
        assert summary.lost.chunks >= 0
        assert (summary.lost.messages or 0) >= 0


def _check_messages(path: Path) -> None:
    try:
        with Recording.open(path) as recording:
            _read(recording)
    except (NotARecording, TooDisordered):
        return


def _read(recording: Recording) -> None:
    before = -1
    for raw in islice(recording.raw_messages(), _MESSAGES_READ):
        assert raw.log_time_ns >= before
        before = raw.log_time_ns
    for message in islice(recording.messages(), _MESSAGES_READ):
        with suppress(DecodeError):
            image(message.value)
        with suppress(DecodeError):
            points(message.value)
    for topic in recording.topics[:_TABLES]:
        for batch in islice(recording.batches(topic.name), 2):
            batch.validate(full=True)
