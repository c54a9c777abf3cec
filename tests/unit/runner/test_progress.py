"""How far a run says it is, from a file that a stranger writes."""

from __future__ import annotations

from pathlib import Path

from kleinkram.contract.reports import EVENTS_FILE
from kleinkram.runner.results import ProgressReader


def say(out: Path, text: str) -> None:
    (out / EVENTS_FILE).parent.mkdir(exist_ok=True)
    with (out / EVENTS_FILE).open("a") as stream:
        stream.write(text)


def test_the_last_progress_counts(tmp_path: Path) -> None:
    reader = ProgressReader(tmp_path)
    reader.read()
    assert reader.progress is None
    say(tmp_path, '{"progress": {"fraction": 0.1}}\n{"progress": {"fraction": 0.2}}\n{"metric": {"name": "a", "value"')
    reader.read()
    assert reader.progress is not None
    assert reader.progress.fraction == 0.2
    say(tmp_path, ': 1}}\nnonsense with "progress"\n' + "x" * 3_000_000 + '\n{"progress": {"fraction": 0.5}}\n')
    reader.read()
    assert reader.progress.fraction == 0.5


def test_links_are_not_followed(tmp_path: Path) -> None:
    other = tmp_path / "other"
    other.mkdir()
    say(other, '{"progress": {"fraction": 0.9}}\n')
    out = tmp_path / "out"
    out.mkdir()
    (out / ".kleinkram").symlink_to(other / ".kleinkram")
    reader = ProgressReader(out)
    reader.read()
    assert reader.progress is None
