"""The progress of a run, read from a file that its container writes."""

from __future__ import annotations

import errno
import io
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


def test_a_job_that_starts_again_does_not_show_its_earlier_progress(tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    append(out, '{"progress": {"fraction": 0.8, "message": "nearly there"}}\n')
    reader = ProgressReader(out)
    reader.read()
    out.rename(tmp_path / "earlier")
    out.mkdir()
    append(out, '{"progress": {"fraction": 0.1}}\n')
    reader.read()
    assert reader.progress is not None
    assert reader.progress.fraction == 0.1


def test_progress_stays_while_its_file_cannot_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    append(tmp_path, '{"progress": {"fraction": 0.3}}\n')
    reader = ProgressReader(tmp_path)
    reader.read()
    monkeypatch.setattr(results, "_open_beneath", lambda *_: UnreadableFile(tmp_path / EVENTS_FILE))
    reader.read()
    assert reader.progress is not None
    assert reader.progress.fraction == 0.3


class UnreadableFile(io.FileIO):
    """A file of a network file system that was replaced."""

    def read(self, _: int | None = -1, /) -> bytes:
        """Fail."""
        raise OSError(errno.ESTALE, "Stale file handle")
