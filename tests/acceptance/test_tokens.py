"""Terminals of an upload-only robot, a partner with one mission, a guest with a share, and an anonymous guest."""

import filecmp
import json
import os
from pathlib import Path

import pytest

from tests.acceptance.conftest import Terminal, end, wait_until


@pytest.fixture
def url(terminal: Terminal) -> str:
    """The server's address."""
    url: str = terminal.run("endpoint", "--json").json()["url"]
    return url


def _elsewhere(terminal: Terminal, tmp_path: Path, url: str, token: str | None = None) -> Terminal:
    """Return a terminal on another machine with only this configuration."""
    home = tmp_path / f"elsewhere-{len(list(tmp_path.iterdir()))}"
    home.mkdir()
    places = {name: str(home / name[4:-5].lower()) for name in ("XDG_CONFIG_HOME", "XDG_STATE_HOME", "XDG_DATA_HOME")}
    known = {"KLEINKRAM_URL": url, **({"KLEINKRAM_TOKEN": token} if token else {})}
    return Terminal(home, {**terminal.environment, **places, "KLEINKRAM_DATA_DIR": str(home / "none"), **known})


@pytest.fixture
def day(tmp_path: Path) -> Path:
    """A folder of small files and a file of several parts."""
    folder = tmp_path / "day"
    folder.mkdir()
    for number in range(3):
        (folder / f"{number}.bin").write_bytes(bytes([number]) * 1000)
    (folder / "long.bin").write_bytes(os.urandom(20_000_000))
    return folder


@pytest.mark.slow
def test_a_robot_may_only_upload_to_one_project(
    terminal: Terminal, project: str, day: Path, tmp_path: Path, url: str
) -> None:
    terminal.run("project", "create", f"{project}-other")
    secret = terminal.run("token", "create", "anymal", "--kind", "robot", "-p", project, "--days", "30").out.strip()
    assert secret.startswith("klein_robot_")
    robot = _elsewhere(terminal, tmp_path, url, secret)

    assert [row["name"] for row in robot.run("project", "list", "--json").json()["items"]] == [project]
    place = ["-p", project, "-m", "Day 1"]
    assert "no project" in robot.run("upload", "-p", f"{project}-other", "-m", "x", "--create", day, code=3).err

    cut = robot.start("upload", *place, "--create", day / "long.bin", "--limit-rate", "4M", "--json")
    wait_until(lambda: robot.parts_sent() > 0, "the store has taken a part")
    cut.kill()
    end(cut)
    resumed = robot.run("upload", *place, "--create", "--wait", f"{day}/", "--json").json()["items"]
    assert {item["outcome"] for item in resumed} <= {"uploaded", "already_present"}
    assert sum(item["moved_bytes"] for item in resumed) < 20_003_000, "uploaded parts are not sent again"
    again = robot.run("upload", *place, f"{day}/", "--json").json()["items"]
    assert [item["outcome"] for item in again] == ["already_present"] * 4

    for command in (["file", "list"], ["trash", "list"], ["token", "list"]):
        robot.run(*command, code=4)
    robot.run("download", *place, "--dest", tmp_path / "back", code=4)
    terminal.run("token", "revoke", secret)
    assert "not valid" in robot.run("upload", *place, f"{day}/", code=4).err


@pytest.mark.slow
def test_a_person_with_one_mission_may_name_it_by_its_project(
    terminal: Terminal, project: str, day: Path, tmp_path: Path, url: str
) -> None:
    terminal.run("mission", "create", "hidden", "-p", project)
    terminal.run("upload", "-p", project, "-m", "Day 1", "--create", f"{day}/")
    made = terminal.run("token", "create", "partner", "-m", f"{project}/Day 1", "--scope", "read", "--scope", "upload")
    partner = _elsewhere(terminal, tmp_path, url, made.out.strip())
    place = ["-p", project, "-m", "day 1"]
    assert partner.run("project", "list", "--json").json() == {"items": []}
    assert [row["name"] for row in partner.run("mission", "list", "-p", project, "--json").json()["items"]] == ["Day 1"]
    partner.run("mission", "info", *place)
    partner.run("mission", "info", "-p", project, "-m", "hidden", code=3)
    (day / "more.bin").write_bytes(b"more")
    outcomes = [item["outcome"] for item in partner.run("upload", *place, f"{day}/", "--json").json()["items"]]
    assert sorted(outcomes) == ["already_present"] * 4 + ["uploaded"]
    back = tmp_path / "back"
    partner.run("download", *place, "--dest", back)
    assert all(filecmp.cmp(path, back / path.name, shallow=False) for path in day.iterdir())
    assert len(partner.run("search", "-p", project, "--json").json()["items"]) == 5
    partner.run("file", "list", "-p", "nothing of the kind", code=3)


@pytest.mark.slow
def test_guests_use_a_share_link_and_public_projects(
    terminal: Terminal, project: str, day: Path, tmp_path: Path, url: str
) -> None:
    place = ["-p", project, "-m", "Day 1"]
    terminal.run("upload", *place, "--create", f"{day}/")
    link = terminal.run("share", "create", "?.bin", *place, "--name", "for Bob", "--days", "3").out.strip()
    assert link.startswith(f"{url}/s#klein_link_")
    guest = _elsewhere(terminal, tmp_path, link)
    assert "klein_link_" not in str(guest.run("endpoint"))
    assert len(guest.run("file", "list", "--json").json()["items"]) == 3
    guest.run("download", "-m", "Day 1", "--dest", tmp_path / "guest")
    assert {path.name for path in (tmp_path / "guest").rglob("*.bin")} == {"0.bin", "1.bin", "2.bin"}
    stranger = _elsewhere(terminal, tmp_path, url)
    stranger.run("download", link, "--dest", tmp_path / "by-link")
    assert len([*(tmp_path / "by-link").rglob("*.bin")]) == 3
    guest.run("upload", "-m", "Day 1", "-p", project, day / "0.bin", code=4)
    (row,) = terminal.run("share", "list", *place, "--json").json()["items"]
    assert (row["name"], row["file_count"], row["download_count"]) == ("for Bob", 3, 6)
    terminal.run("share", "revoke", link)
    guest.run("file", "list", code=4)

    listed = stranger.run("project", "list", "--json")
    assert project not in {row["name"] for row in listed.json()["items"]}
    assert "only what is public" in listed.err
    release = ["--public", "--licence", "CC-BY-4.0", "--citation", "Lovelace 2026"]
    terminal.run("project", "update", project, *release)
    assert "CC-BY-4.0" in stranger.run("project", "info", project).out
    stranger.run("download", *place, "--dest", tmp_path / "public")
    assert len([*(tmp_path / "public").rglob("*.bin")]) == 4
    stranger.run("upload", *place, day / "0.bin", code=4)
    terminal.run("project", "update", project, "--private")
    stranger.run("project", "info", project, code=3)


@pytest.mark.slow
def test_a_full_project_refuses_with_numbers(terminal: Terminal, project: str, day: Path) -> None:
    terminal.run("project", "update", project, "--quota-bytes", "10MB", "--quota-files", "100")
    refused = terminal.run("upload", "-p", project, "-m", "m", "--create", f"{day}/", "--json", code=13)
    errors = {item["path"]: item["error"] for item in json.loads(refused.out)["items"]}
    assert errors["long.bin"]["kind"] == "QuotaExceeded"
    assert all(expected in errors["long.bin"]["message"] for expected in ("10000000", project))
    terminal.run("project", "update", project, "--quota-bytes", "none")
    terminal.run("upload", "-p", project, "-m", "m", f"{day}/")
    assert "4 of 100" in terminal.run("project", "info", project).out
