"""The log of a container on a disk without room: what is written is passed over, and the warden is told."""

from __future__ import annotations

from pathlib import Path

from kleinkram.runner.docker.log import Log, Piece


def test_a_log_without_room_takes_no_more_and_says_so(tmp_path: Path) -> None:
    (tmp_path / "log").symlink_to("/dev/full")
    with Log(tmp_path, 1000) as log:
        assert log.has_room
        log.add([Piece(1, b"a word\n")])
        assert (log.has_room, log.is_full) == (False, True)
        log.note_gap()
        log.add([Piece(2, b"another\n")])


def test_a_log_is_kept_up_to_its_limit(tmp_path: Path) -> None:
    with Log(tmp_path, 10) as log:
        log.add([Piece(1, b"a word and more\n")])
        assert (log.has_room, log.is_full) == (True, True)
    assert (tmp_path / "log").read_bytes().startswith(b"a word and\n[kleinkram] the log is full")
