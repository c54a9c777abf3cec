"""Recordings from a damaged disk: readable data is found, and the damage is reported."""

import shutil
from pathlib import Path

import pytest

from kleinkram.recordings.sample import generate_mcap
from tests.acceptance.conftest import Terminal


def _day(folder: Path) -> Path:
    """Create an intact recording, a truncated one, one with only its first bytes, and a text file."""
    folder.mkdir()
    generate_mcap(folder / "whole.mcap", duration_s=2)
    shutil.copy(folder / "whole.mcap", folder / "cut.mcap")
    with (folder / "cut.mcap").open("r+b") as file:
        file.truncate((folder / "whole.mcap").stat().st_size * 2 // 3)
    (folder / "empty.mcap").write_bytes((folder / "whole.mcap").read_bytes()[:60])
    (folder / "note.txt").write_text("the disk was full")
    return folder


@pytest.mark.slow
def test_intact_truncated_and_broken_recordings_differ(terminal: Terminal, project: str, tmp_path: Path) -> None:
    place = ["-p", project, "-m", "Day 1"]
    terminal.run("upload", *place, "--create", "--wait", f"{_day(tmp_path / 'day')}/")
    states = {"indexed": ["whole.mcap"], "recovered": ["cut.mcap"], "broken": ["empty.mcap"], "opaque": ["note.txt"]}
    for state, paths in states.items():
        for command in (("file", "list"), ("search",)):
            files = terminal.run(*command, "-p", project, "--content", state, "--json").json()
            assert [item["path"] for item in files["items"]] == paths, (command, state)
            shown = terminal.run(*command, "-p", project, "--content", state).out
            assert paths[0] in shown
            assert state in shown

    mission = terminal.run("mission", "info", *place, "--json").json()
    recordings = {recording["name"]: recording for recording in mission["recordings"]}
    assert {name: recording["content"] for name, recording in recordings.items()} == {
        path: state for state, paths in states.items() for path in paths if state != "opaque"
    }
    whole, cut = recordings["whole.mcap"], recordings["cut.mcap"]
    assert 0 < cut["message_count"] < whole["message_count"]
    assert cut["content_reason"]
    shown = terminal.run("mission", "info", *place).out
    for name in ("cut.mcap", "empty.mcap"):
        assert recordings[name]["content_reason"].split()[0] in shown
    assert terminal.run("search", "-p", project, "--content", "no-such", "--json", code=None).code == 2
