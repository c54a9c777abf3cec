"""People, groups, tokens, the trash and the record in real browsers, two at once."""

from pathlib import Path

import pytest

from tests.system.house import House
from tests.system.web.conftest import Act


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_somebody_comes_is_let_in_and_leaves(house: House, act: Act, pictures: Path, tmp_path: Path) -> None:
    house.start()
    terminal = house.terminal
    terminal.run("project", "create", "Alps")
    (tmp_path / "ridge.txt").write_text("above the snow line")
    terminal.run("upload", "-p", "Alps", "-m", "ridge", "--create", tmp_path / "ridge.txt")
    terminal.run("mission", "delete", "ridge", "-p", "Alps", "--yes")
    project = terminal.run("project", "list", "--json").json()["items"][0]["id"]
    seen = act("people.mjs", house, project, pictures, timeout_s=280)

    assert seen["ran"] == [], "names full of markup do nothing"
    assert seen["complaints"] == []
    assert seen["axe"] == []
    assert seen["wide"] == []
    assert (seen["refused"], seen["adminLinks"]) == ("This page is for admins", 0)
    assert seen["given"] == 201
    assert (seen["before"], seen["during"], seen["after"]) == (404, 200, 404)
    assert "Read" in seen["access"]
    assert "as a member of <img" in seen["access"]
    assert "Read" in seen["reach"]
    assert seen["limited"], "a robot's token without limits is not sent at all"
    assert f"klein login http://127.0.0.1:{house.port} --token" in seen["loginLine"]
    assert (seen["robot"], seen["revoked"]) == (200, 401)
    assert "1 file" in seen["trashed"]
    assert terminal.run("mission", "list", "-p", "Alps", "--json").json()["items"][0]["name"] == "ridge"
    assert "revoked the token" in seen["recorded"]
    assert set(seen["lines"]) == {"token.create", "token.revoke"}
    assert "robot" in seen["changes"]
    assert "1 session" in seen["left"]
    assert seen["gone"] == 401
