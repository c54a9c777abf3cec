"""The command line against a real server: several projects and missions, merged metadata, failures as JSON."""

import json
import os
import subprocess
import uuid
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.integration.api_server import Api
from tests.integration.jobs import run_jobs
from tests.klein import KLEIN, run_klein

Klein = Callable[..., "subprocess.CompletedProcess[str]"]


@pytest.fixture(scope="module")
def klein(api: Api, tmp_path_factory: pytest.TempPathFactory) -> Klein:
    """Run a command, and check its exit code."""
    return klein_at(api, tmp_path_factory.mktemp("home"))


def klein_at(api: Api, home: Path) -> Klein:
    """Return a function that runs a command on a server with this home, and checks its exit code."""
    inherited = {key: value for key, value in os.environ.items() if not key.startswith(("KLEINKRAM_", "COLUMNS"))}
    ours = {name: str(home / name) for name in ("XDG_CONFIG_HOME", "XDG_STATE_HOME", "XDG_DATA_HOME")}
    known = {"KLEINKRAM_URL": api.url, "KLEINKRAM_TOKEN": str(api.token)}

    def run(*arguments: object, code: int = 0, **environment: str) -> "subprocess.CompletedProcess[str]":
        done = run_klein([*map(str, arguments)], {**inherited, **ours, **known, **environment})
        assert done.returncode == code, f"{done}"
        return done

    return run


def _items(done: "subprocess.CompletedProcess[str]") -> list[Any]:
    items: list[Any] = json.loads(done.stdout)["items"]
    return items


@pytest.fixture(scope="module")
def projects(api: Api, klein: Klein, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str]:
    """Two projects: `north` with the missions day and night, `south` with day; a recording in each."""
    north, south = (f"{name}-{uuid.uuid4().hex[:8]}" for name in ("north", "south"))
    folder = tmp_path_factory.mktemp("field")
    for project, missions in ((north, ("day", "night")), (south, ("day",))):
        klein("project", "create", project)
        for mission in missions:
            klein("sample", folder / project / mission, "--size", "1MB", "--format", "mcap")
            (folder / project / mission / "core.tmp").write_text("left out")
        klein("upload", "-p", project, "--mission-per-folder", "--create", "--exclude", "*.tmp", folder / project)
    run_jobs(api)
    return north, south


def test_several_projects_and_missions_are_selected_everywhere(klein: Klein, projects: tuple[str, str]) -> None:
    north, south = projects
    both = ("-p", north, "-p", south)
    assert len(_items(klein("mission", "list", *both, "--json"))) == 3
    assert len(_items(klein("file", "list", *both, "--json"))) == 3
    assert len(_items(klein("search", *both, "-m", "day", "--json"))) == 2
    assert len(_items(klein("file", "list", "-p", north, "-m", "day", "-m", "night", "--json"))) == 2
    assert len(_items(klein("mission", "list", "-m", f"{north}/day", "-m", f"{south}/day", "--json"))) == 2
    assert _items(klein("run", "list", *both, "-m", "day", "--json")) == [], "a name stands for one mission in each"
    assert json.loads(klein("stats", *both, "--json").stdout)["total"]["files"] == 3
    dry = klein("download", "-p", north, "-m", "day", "-m", "night", "--nested", "--dry-run", "--json")
    assert len(_items(dry)) == 2
    for command in (("run", "list"), ("run", "findings"), ("run", "metrics"), ("audit",), ("action", "list")):
        klein(*command, *both, "--json")
    klein("run", "list", "-p", north, "-m", "day", "-m", "night")
    assert {row["project_id"] for row in _items(klein("audit", *both, "--operation", "mission.create", "--json"))}
    for command in (("mission", "info"), ("upload", "x"), ("share", "create"), ("access", "list")):
        refused = klein(*command, "-p", north, "-p", south, "-m", "day", code=2)
        assert "--project was given 2 times; this command takes one" in refused.stderr
    assert "this command takes one" in klein("verify", "-p", north, "-m", "day", "-m", "night", KLEIN, code=2).stderr


def test_metadata_is_merged_and_the_changes_are_printed(
    klein: Klein, projects: tuple[str, str], tmp_path: Path
) -> None:
    where = ("-p", projects[1], "-m", "day")
    update = tmp_path / "update.yaml"
    for text, more, shown in (
        ("robot: anymal\nwind: 3\n", (), ["robot: (none) -> anymal", "wind: (none) -> 3"]),
        ("wind: 5\n", (), ["wind: 3 -> 5"]),
        ("wind: null\n", (), ["wind: 5 -> (none)"]),
        ("operator: Ada\n", ("--replace",), ["operator: (none) -> Ada", "robot: anymal -> (none)"]),
    ):
        update.write_text(text)
        lines = klein("mission", "update", *where, "--metadata", update, *more).stdout.splitlines()
        assert [line.strip() for line in lines[1:]] == shown
    mission = json.loads(klein("mission", "info", *where, "--json").stdout)["mission"]
    assert (mission["metadata"], mission["metadata_yaml"]) == ({"operator": "Ada"}, "operator: Ada\n")
    assert "is unchanged" in klein("mission", "update", *where, "--metadata", update).stderr


def test_each_topic_is_listed_once(klein: Klein, projects: tuple[str, str]) -> None:
    items = _items(klein("search", "-p", projects[0], "--show", "topics", "--json"))
    names = [(row["name"], row["message_type"]) for row in items]
    assert len(names) == len({*names}) > 3
    assert {row["file_count"] for row in items} == {2}
    shown = klein("mission", "info", "-p", projects[0], "day").stdout
    assert shown.count("/imu/data ") == 1


def test_statistics_by_an_unknown_field_are_refused(klein: Klein, projects: tuple[str, str]) -> None:
    refused = klein("stats", "-p", projects[0], "--by", "weahter", code=2)
    assert "no mission has such a field" in refused.stderr
    assert "month" in refused.stderr


def test_json_output_reports_errors_as_json(klein: Klein, projects: tuple[str, str]) -> None:
    for arguments, code, word in (
        (("mission", "info", "nope", "-p", projects[0]), 3, "not_found"),
        (("mission", "list", "--nope"), 2, "usage"),
        (("projct", "list"), 2, "usage"),
        (("upload", "/no/such/path", "-p", projects[0], "-m", "day"), 2, "invalid_input"),
        (("stats", "--by", "weahter"), 2, "invalid_query"),
        (("mission", "list", "--limit", "0"), 2, "usage"),
        (("mission", "list", "--sort", "nope"), 2, "usage"),
    ):
        done = klein(*arguments, "--json", code=code)
        error = json.loads(done.stderr)["error"]
        assert (done.stdout, error["code"], error["exit_code"]) == ("", word, code)
        assert error["message"]
        assert "Input should be" not in error["message"]
        assert "Value error" not in error["message"]
    away = klein("project", "list", "--json", code=7, KLEINKRAM_URL="http://127.0.0.1:9")
    assert json.loads(away.stderr)["error"]["code"] == "server_unreachable"


def test_failures_of_commands_without_a_server_are_json_too(klein: Klein, tmp_path: Path) -> None:
    nowhere = ("--data-dir", tmp_path / "none", "--json")
    commands = {
        ("down", *nowhere): ("not_running", 1),
        ("backup", "create", tmp_path / "backups", *nowhere): ("not_running", 1),
        ("backup", "verify", tmp_path / "backups", "--json"): ("backup_not_found", 3),
    }
    for words, (code, exit_code) in commands.items():
        error = json.loads(klein(*words, code=exit_code).stderr)["error"]
        assert (error["code"], error["exit_code"]) == (code, exit_code)
        assert error["message"]


def test_tables_fit_the_terminal_and_the_ids_option_adds_ids(klein: Klein, projects: tuple[str, str]) -> None:
    for command in (("project", "list"), ("mission", "list"), ("file", "list"), ("search",), ("audit",), ("stats",)):
        shown = klein(*command, COLUMNS="80").stdout
        assert max(map(len, shown.splitlines())) <= 80, command
    ids = {row["id"] for row in _items(klein("file", "list", "-p", projects[0], "--json"))}
    assert not any(one in klein("file", "list", "-p", projects[0]).stdout for one in ids)
    assert all(one in klein("file", "list", "-p", projects[0], "--wide", COLUMNS="80").stdout for one in ids)


def test_debug_shows_requests_without_secrets(api: Api, klein: Klein, projects: tuple[str, str]) -> None:
    stderr = klein("mission", "info", "nope", "-p", projects[0], "--debug", code=3).stderr
    assert "GET /api/v1/missions: 200 in " in stderr
    assert "(request " in stderr
    assert "Traceback" in stderr
    assert str(api.token) not in stderr


def test_names_are_completed_and_an_absent_server_is_silent(klein: Klein, projects: tuple[str, str]) -> None:
    north = projects[0]
    shell = {"_KLEIN_COMPLETE": "complete_bash", "COMP_CWORD": "4"}
    typed = {**shell, "COMP_WORDS": f"klein mission list -p {north[:9]}"}
    assert klein(**typed).stdout.split() == [north]
    missions = {**shell, "COMP_CWORD": "6", "COMP_WORDS": f"klein mission info -p {north} -m ni"}
    assert klein(**missions).stdout.split() == ["night"]
    done = klein(**typed, KLEINKRAM_URL="http://127.0.0.1:9")
    assert (done.stdout.strip(), done.stderr) == ("", "")
