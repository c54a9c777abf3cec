"""What holds for every file, whatever its bytes."""

from __future__ import annotations

import json
from pathlib import Path

from kleinkram.recordings import Content, FileSource, RecordingSummary, from_dict, summarise, to_dict
from tests.fuzz.seeds import Seed

_LEAST_MESSAGE_BYTES = 8
_MOST_EXPANSION = 2_000


def check(file: Seed, folder: Path) -> None:
    """Summarise a file.

    Raises:
        AssertionError: a promise is broken.
    """
    path = folder / file.name
    path.write_bytes(file.data)
    with FileSource(path) as source:
        _check_summary(summarise(source), len(file.data))


def _check_summary(summary: RecordingSummary, size_bytes: int) -> None:
    assert summary.content is not Content.error
    assert (summary.content is Content.indexed) == (summary.reason is None)
    assert from_dict(json.loads(json.dumps(to_dict(summary)))) == summary
    counted = sum(topic.count or 0 for topic in summary.topics)
    assert counted * _LEAST_MESSAGE_BYTES <= size_bytes * _MOST_EXPANSION
    if summary.start_ns is not None and summary.end_ns is not None:
        assert summary.start_ns <= summary.end_ns
    if summary.lost is not None:
        assert 0 <= summary.lost.bytes <= size_bytes
        assert summary.lost.chunks >= 0
        assert (summary.lost.messages or 0) >= 0
