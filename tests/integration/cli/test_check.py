"""`klein check` and `klein checks init|schema`: what people see, JSON for scripts, and the exit codes."""

import json
import os
import sys
from pathlib import Path
from typing import Any

import pytest

from kleinkram.checks.document import json_schema, read_checks
from kleinkram.cli import main as entry
from kleinkram.recordings.sample import Faults, SampleFormat, generate_mission

pytestmark = pytest.mark.usefixtures("remembered_scenes")

Captured = pytest.CaptureFixture[str]
RULES = """
version: 1
profiles:
- name: vehicle
  topics:
    /imu/data: {rate: 200, max_gap: 50ms}
    /gps/fix: {rate: 5, severity: warning}
"""


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    """A good mission of one recording, with its rules beside it."""
    return _mission(tmp_path)


def _mission(folder: Path, **faults: Any) -> Path:
    generate_mission(
        folder / "run", duration_s=3, size_bytes=1_000_000, formats=[SampleFormat.mcap], faults=Faults(**faults)
    )
    (folder / "checks.yaml").write_text(RULES)
    return folder / "run"


def klein(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    """Run a command as a terminal would; returns the exit code."""
    monkeypatch.setattr("sys.argv", ["klein", *map(str, arguments)])
    with pytest.raises(SystemExit) as ended:
        entry.main()
    return int(ended.value.code or 0)


def test_a_good_mission(drive: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured) -> None:
    assert klein(monkeypatch, "check", drive) == 0
    printed = capsys.readouterr()
    rules = drive.parent / "checks.yaml"
    assert printed.out == f"Verdict: good (5 passed)\nRules:   {rules} (profile: vehicle)\n"
    assert printed.err == "--all lists the checks that passed.\n"
    assert klein(monkeypatch, "check", drive, "--all", "--strict") == 0
    assert "ok      topic.rate     /imu/data" in capsys.readouterr().out


def test_the_reference_of_a_mission_is_shown(drive: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured) -> None:
    rules = drive.parent / "checks.yaml"
    rules.write_text(RULES + "  reference: ground_truth.tum\n")
    for more, reference in (([], "ground_truth.tum"), (["-w", "reference=/gps/odom"], "/gps/odom")):
        assert klein(monkeypatch, "check", drive, *more) == 0
        assert capsys.readouterr().out.endswith(f"{rules} (profile: vehicle)\nReference: {reference}\n")
        klein(monkeypatch, "check", drive, *more, "--json")
        assert json.loads(capsys.readouterr().out)["reference"] == reference


def test_an_error_is_listed_and_ends_with_2(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured) -> None:
    folder = _mission(tmp_path, dropped_topic="/imu/data")
    assert klein(monkeypatch, "check", folder) == 2
    printed = capsys.readouterr().out.splitlines()
    assert printed[0] == "RESULT  CHECK          WHERE"
    assert printed[1] == "error   topic.missing  /imu/data  it is not recorded"
    assert printed[3] == "Verdict: bad (1 error, 2 passed)"


def test_warnings_end_with_1_only_if_strict(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured) -> None:
    folder = _mission(tmp_path, dropped_topic="/gps/fix")
    assert klein(monkeypatch, "check", folder) == 0
    assert "Verdict: warnings (1 warning, 3 passed)" in capsys.readouterr().out
    assert klein(monkeypatch, "check", folder, "--strict") == 1


def test_a_check_that_could_not_be_made_is_a_warning(
    drive: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured
) -> None:
    (drive.parent / "checks.yaml").write_text("version: 1\nprofiles:\n- images: {/thermal/*: {}}\n")
    assert klein(monkeypatch, "check", drive, "--strict") == 1
    assert "not made  image.black        /thermal/*  no topic matches /thermal/*" in capsys.readouterr().out


def test_json_has_the_verdict_and_every_check(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured
) -> None:
    folder = _mission(tmp_path, dropped_topic="/imu/data")
    assert klein(monkeypatch, "check", folder, "--json") == 2
    document = json.loads(capsys.readouterr().out)
    assert (document["verdict"], document["depth"]) == ("bad", "content")
    assert document["counts"] == {"error": 1, "warning": 0, "not_made": 0, "ok": 2, "needs_content": 0}
    assert document["profiles_applied"] == ["vehicle"]
    assert [check["name"] for check in document["checks"]] == ["topic.missing", "topic.missing", "topic.rate"]
    assert document["checks_file"] == str(tmp_path / "checks.yaml")


def test_the_index_alone_says_which_checks_it_cannot_make(
    drive: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured
) -> None:
    (drive.parent / "checks.yaml").write_text(RULES + "  imu: {/imu/data: {}}\n")
    assert klein(monkeypatch, "check", drive, "--index-only") == 0
    printed = capsys.readouterr()
    assert "Verdict: unchecked (5 passed, 2 need the messages)" in printed.out
    assert "All checks from the index passed; those of the messages were not made." in printed.err
    assert klein(monkeypatch, "check", drive) == 0
    assert "Verdict: good (7 passed)" in capsys.readouterr().out


def test_the_base_install_checks_the_index_and_says_what_content_needs(
    drive: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured
) -> None:
    (drive.parent / "checks.yaml").write_text(RULES + "  imu: {/imu/data: {}}\n")
    for library in ("numpy", "PIL", "pandas", "pyarrow"):
        monkeypatch.setitem(sys.modules, library, None)
    assert klein(monkeypatch, "check", drive, "--strict") == 1
    printed = capsys.readouterr().out
    assert "Verdict: warnings (2 could not be made, 5 passed)" in printed
    assert "pip install 'open-kleinkram[reading]'" in printed


def test_a_file_of_rules_is_found_in_the_folder_beside_it_or_by_name(
    drive: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured
) -> None:
    inside = drive / "checks.yaml"
    inside.write_text(RULES.replace("vehicle", "inside"))
    assert klein(monkeypatch, "check", drive) == 0
    assert f"Rules:   {inside} (profile: inside)" in capsys.readouterr().out
    inside.unlink()
    assert klein(monkeypatch, "check", drive / "drive.mcap") == 3
    monkeypatch.chdir(drive.parent)
    assert klein(monkeypatch, "check", "run/drive.mcap") == 0
    other = drive.parent / "other.yaml"
    other.write_text(RULES.replace("vehicle", "other"))
    assert klein(monkeypatch, "check", drive, "--checks", other) == 0
    assert "(profile: other)" in capsys.readouterr().out


def test_without_rules_the_error_says_how_to_make_them(
    drive: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured, tmp_path_factory: pytest.TempPathFactory
) -> None:
    (drive.parent / "checks.yaml").unlink()
    monkeypatch.chdir(tmp_path_factory.mktemp("elsewhere"))
    assert klein(monkeypatch, "check", drive) == 3
    assert "`klein checks init GOOD_MISSION -o checks.yaml` makes one" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("content", "code", "message"),
    [
        (b"version: 1\nprofiles:\n- topics: {/a: {rte: 1}}\n", 6, "line 3, column 17: profiles.0.topics./a.rte: "),
        (b"version: 1\nprofiles: \xff\xfe\n", 2, "it is not UTF-8 text"),
        (b"", 6, "line 1, column 1: it is empty"),
        (b"#" * 200_001, 6, "it has more than 200,000 characters"),
        (b"\x00\x01\x02", 6, "line 1, column 1: the character U+0000 cannot be kept"),
    ],
)
def test_a_wrong_file_of_rules_has_its_position(
    drive: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured, content: bytes, code: int, message: str
) -> None:
    rules = drive.parent / "wrong.yaml"
    rules.write_bytes(content)
    assert klein(monkeypatch, "check", drive, "--checks", rules) == code
    error = capsys.readouterr().err
    assert str(rules) in error
    assert message in error


WHEN = """
version: 1
profiles:
- {name: spot, when: {robot: spot}, topics: {/spot/status: {}}}
- {name: anymal, when: {robot: anymal-*, night: true}, topics: {/imu/data: {}}}
"""


def test_profiles_are_chosen_by_metadata(drive: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured) -> None:
    (drive.parent / "checks.yaml").write_text(WHEN)
    metadata = drive.parent / "mission.yaml"
    metadata.write_text("robot: anymal-d\nnight: false\n")
    assert klein(monkeypatch, "check", drive, "--metadata", metadata, "-w", "night=true") == 0
    printed = capsys.readouterr().out
    assert "(profile: anymal)" in printed
    assert "not applied: spot, because robot is anymal-d; it must be spot" in printed


def test_nothing_is_checked_without_a_profile_that_applies(
    drive: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured
) -> None:
    (drive.parent / "checks.yaml").write_text(WHEN)
    assert klein(monkeypatch, "check", drive) == 3
    printed = capsys.readouterr()
    assert printed.out.startswith("Verdict: unchecked\n")
    assert "no profile applies. Name the metadata of the mission with -w FIELD=VALUE." in printed.err
    assert klein(monkeypatch, "check", drive, "-w", "robot") == 2


def test_a_path_that_does_not_exist(drive: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured) -> None:
    assert klein(monkeypatch, "check", drive, drive / "nothing") == 8
    assert "nothing" in capsys.readouterr().err


def test_a_mission_without_recordings_is_bad(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured) -> None:
    (tmp_path / "checks.yaml").write_text(RULES)
    (tmp_path / "notes.txt").write_text("nothing was recorded")
    assert klein(monkeypatch, "check", tmp_path) == 2
    assert "Verdict: bad (1 error, 1 warning)" in capsys.readouterr().out


def test_a_damaged_recording_is_listed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured) -> None:
    folder = _mission(tmp_path, truncate_to=0.5)
    (tmp_path / "checks.yaml").write_text("version: 1\nprofiles:\n- recordings: {'*': {}}\n")
    assert klein(monkeypatch, "check", folder) == 2
    assert "recording.incomplete  drive.mcap" in capsys.readouterr().out


def test_a_named_pipe_among_the_files_is_not_made(
    drive: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured
) -> None:
    os.mkfifo(drive / "pipe.mcap")
    assert klein(monkeypatch, "check", drive, "--strict") == 1
    printed = capsys.readouterr().out
    assert "not made  file.incomplete" in printed
    assert "a named pipe" in printed


def test_on_a_narrow_terminal_messages_continue_below(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured
) -> None:
    folder = _mission(tmp_path)
    (tmp_path / "checks.yaml").write_text(
        "version: 1\nprofiles:\n- topics: {/imu/data: {type: geometry_msgs/PoseWithCovarianceStamped}}\n"
    )
    monkeypatch.setenv("COLUMNS", "60")
    assert klein(monkeypatch, "check", folder) == 2
    printed = capsys.readouterr().out.splitlines()
    assert printed[1] == "error   topic.type  /imu/data"
    assert printed[2].startswith("        its type is sensor_msgs/msg/Imu; expected")
    assert all(len(text) <= 60 for text in printed[:4])


# -- klein checks -----------------------------------------------------------------------------------------------------


def test_init_writes_rules_that_good_missions_pass(
    drive: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured
) -> None:
    rules = drive.parent / "new.yaml"
    assert klein(monkeypatch, "checks", "init", drive, "-o", rules) == 0
    assert f"Wrote {rules}" in capsys.readouterr().err
    assert "/imu/data" in read_checks(rules.read_text()).profiles[0].topics
    assert klein(monkeypatch, "check", drive, "--checks", rules, "--strict") == 0
    capsys.readouterr()
    assert klein(monkeypatch, "checks", "init", drive) == 0
    assert capsys.readouterr().out == rules.read_text()


def test_init_never_overwrites(drive: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured) -> None:
    rules = drive.parent / "checks.yaml"
    assert klein(monkeypatch, "checks", "init", drive, "-o", rules) == 11
    assert "it exists; remove it, or choose another name" in capsys.readouterr().err
    assert rules.read_text() == RULES


def test_init_of_a_folder_without_recordings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured) -> None:
    assert klein(monkeypatch, "checks", "init", tmp_path) == 3
    assert "There is nothing to make rules from: it has no messages." in capsys.readouterr().err


def test_the_schema_is_printed(monkeypatch: pytest.MonkeyPatch, capsys: Captured) -> None:
    assert klein(monkeypatch, "checks", "schema") == 0
    assert json.loads(capsys.readouterr().out) == json_schema()
