"""The progress of a run, read from a file that its container writes."""

from __future__ import annotations

from pathlib import Path

import pytest

from kleinkram.contract.reports import EVENTS_FILE
from kleinkram.runner import results
from kleinkram.runner.results import ProgressReader


def append(out: Path, text: str) -> None:
    (out / EVENTS_FILE).parent.mkdir(exist_ok=True)
    with (out / EVENTS_FILE).open("a") as stream:
        stream.write(text)


def test_the_last_progress_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(results, "_PROGRESS_BYTES", 10_000)
    reader = ProgressReader(tmp_path)
    reader.read()
    assert reader.progress is None
    append(
        tmp_path, '{"progress": {"fraction": 0.1}}\n{"progress": {"fraction": 0.2}}\n{"metric": {"name": "a", "value"'
    )
    reader.read()
    assert reader.progress is not None
    assert reader.progress.fraction == 0.2
    append(tmp_path, ': 1}}\nnonsense with "progress"\n' + "x" * 30_000 + '\n{"progress": {"fraction": 0.5}}\n')
    reader.read()
    assert reader.progress.fraction == 0.5


def test_symbolic_links_are_not_followed(tmp_path: Path) -> None:
    other = tmp_path / "other"
    other.mkdir()
    append(other, '{"progress": {"fraction": 0.9}}\n')
    out = tmp_path / "out"
    out.mkdir()
    (out / ".kleinkram").symlink_to(other / ".kleinkram")
    reader = ProgressReader(out)
    reader.read()
    assert reader.progress is None
