"""Recordings of local files and folders, by name."""

from __future__ import annotations

from pathlib import Path

import pytest

from kleinkram.recordings.open_paths import find_recordings
from tests.recording_files.builders import T0, mcap_of


def make(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    source = mcap_of([[("/a", T0, b"")]])
    path.write_bytes(source.read(0, source.size_bytes))
    return path


def names(*paths: Path | str) -> list[str]:
    return [item.name for item in find_recordings(paths)]


def test_names_are_those_of_files_or_whole_paths(tmp_path: Path) -> None:
    nuc, jetson = make(tmp_path / "nuc" / "a.mcap"), make(tmp_path / "jetson" / "a.mcap")
    assert names(nuc) == ["a.mcap"]
    assert names(nuc, jetson) == [str(nuc), str(jetson)]
    assert sorted(names(tmp_path)) == ["jetson/a.mcap", "nuc/a.mcap"]
    with pytest.raises(FileNotFoundError, match="there is no such file or folder"):
        names(tmp_path / "none")


def test_a_recording_that_is_named_twice_is_read_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Otherwise its messages would be there twice."""
    file = make(tmp_path / "drive" / "a.mcap")
    make(tmp_path / "drive" / "b.mcap")
    (tmp_path / "link.mcap").symlink_to(file)
    monkeypatch.chdir(tmp_path)
    assert names(file, "drive/a.mcap", "drive/../drive/a.mcap", "link.mcap") == ["a.mcap"]
    assert names("drive", file) == ["a.mcap", "b.mcap"]
    assert names(file, "drive") == ["a.mcap", "b.mcap"]
