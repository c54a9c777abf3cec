"""Editing missions in a real browser: names, notes, links, moving, deleting, and the home page."""

import json
import random
import signal
from pathlib import Path

import pytest

from kleinkram.recordings.sample import generate_mcap
from tests.acceptance.conftest import wait_until
from tests.system.backend import sql
from tests.system.cluster import Cluster
from tests.system.web.conftest import Act

_LARGE_BYTES = 20_000_000


@pytest.mark.slow
@pytest.mark.timeout(280)
def test_missions_changed(cluster: Cluster, act: Act, pictures: Path, tmp_path: Path) -> None:
    cluster.start()
    terminal = cluster.terminal
    day, half = tmp_path / "day", tmp_path / "half"
    day.mkdir()
    half.mkdir()
    generate_mcap(day / "drive.mcap", size_bytes=200_000)
    (day / "notes.txt").write_text("above the snow line")
    (half / "camera.raw").write_bytes(random.Random(3).randbytes(_LARGE_BYTES))
    terminal.run("project", "create", "Alps")
    terminal.run("upload", "-p", "Alps", "-m", "ridge", "--create", f"{day}/", "--wait")
    begun = terminal.start("upload", "-p", "Alps", "-m", "night", "--create", "--limit-rate", "10M", f"{half}/")
    wait_until(lambda: terminal.parts_sent() >= 1, "a part of the upload to be there")
    begun.send_signal(signal.SIGINT)
    begun.communicate(timeout=60)
    # As after a minute, when the lease of the name has expired.
    assert len(sql(cluster, "UPDATE upload SET lease_ends_at = now() WHERE state = 'open' RETURNING id")) == 1
    missions = {row["name"]: row["id"] for row in terminal.run("mission", "list", "--json").json()["items"]}
    files = {row["path"]: row["id"] for row in terminal.run("file", "list", "--json").json()["items"]}
    invited = terminal.run("person", "invite", "grace@example.org", "--name", "Grace", "--json").json()

    runtime_info = json.dumps({**missions, "drive": files["drive.mcap"]})
    seen = act("missions_changed.mjs", cluster, invited["url"], half, runtime_info, pictures)

    assert seen["complaints"] == []
    assert seen["ran"] == [], "markup was run"
    assert seen["axe"] == []
    assert seen["wide"] == []
    assert "Alps / night\nResume\ncamera.raw" in seen["unfinished"]
    assert "of 20.0 MB" in seen["unfinished"], "what the store holds of it is told"
    assert seen["chosen"] == ["Alps", "night"], "the address chose where it goes"
    assert "File uploaded." in seen["over"]
    terminal.run("verify", "-p", "Alps", "-m", "night", f"{half}/")
    assert "night" in seen["taken"]
    assert seen["notesElements"] == 0
    assert [row.split()[0] for row in seen["shared"]] == ["drive.mcap"]
    assert "1 file · until" in seen["link"]
    assert seen["ended"] == "This link has ended, or the URL is incomplete."
    assert seen["verified"]["after"] > seen["verified"]["before"]
    assert "second line" in seen["back"]
    assert "2 missions" in seen["goesWithIt"], "it says what goes with the project"
    assert "You have no access yet" in seen["empty"]
    # Under the path that the other machine gave it, though a folder that is chosen goes up with its name.
    now = {row["path"]: row["mission"]["name"] for row in terminal.run("file", "list", "--json").json()["items"]}
    assert now == {"drive.mcap": "night", "camera.raw": "night", "notes.txt": "north ridge"}
    changed = terminal.run("mission", "info", missions["ridge"], "--json").json()["mission"]
    assert changed["notes"] == "<img src=x onerror=alert(1)> **kept**\nsecond line"
    assert changed["completed_at"] is not None
