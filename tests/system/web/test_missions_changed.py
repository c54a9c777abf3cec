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
from tests.system.web.conftest import RunBrowser

_LARGE_BYTES = 20_000_000


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_missions_are_resumed_renamed_shared_moved_deleted_and_restored(
    cluster: Cluster, run_browser: RunBrowser, pictures: Path, tmp_path: Path
) -> None:
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
    wait_until(lambda: terminal.parts_sent() >= 1, "the first part of the upload")
    begun.send_signal(signal.SIGINT)
    begun.communicate(timeout=60)
    # As a minute later, when the lease of the name has expired.
    assert len(sql(cluster, "UPDATE upload SET lease_ends_at = now() WHERE state = 'open' RETURNING id")) == 1
    missions = {row["name"]: row["id"] for row in terminal.run("mission", "list", "--json").json()["items"]}
    files = {row["path"]: row["id"] for row in terminal.run("file", "list", "--json").json()["items"]}
    invited = terminal.run("person", "invite", "grace@example.org", "--name", "Grace", "--json").json()

    ids = json.dumps({**missions, "drive": files["drive.mcap"]})
    results = run_browser("missions_changed.mjs", cluster, invited["url"], half, ids, pictures)

    assert results["consoleErrors"] == []
    assert results["executed"] == [], "markup was run"
    assert results["axe"] == []
    assert results["overflowing"] == []
    assert "Alps / night\nResume\ncamera.raw" in results["unfinished"]
    assert "of 20.0 MB" in results["unfinished"], "the uploaded bytes are shown"
    assert results["destination"] == ["Alps", "night"], "the URL selects the destination"
    assert "File uploaded." in results["finished"]
    terminal.run("verify", "-p", "Alps", "-m", "night", f"{half}/")
    assert "night" in results["nameConflict"]
    assert results["notesElements"] == 0
    assert [row.split()[0] for row in results["shared"]] == ["drive.mcap"]
    assert "1 file · until" in results["link"]
    assert results["revoked"] == "This link has ended, or the URL is incomplete."
    assert results["verified"]["after"] > results["verified"]["before"]
    assert "second line" in results["restoredNotes"]
    assert "2 missions" in results["deletionWarning"], "the dialog names what is deleted with the project"
    assert "You have no access yet" in results["homeWithoutAccess"]
    # A chosen folder is usually uploaded with its name; a resumed upload keeps the path of the first machine.
    now = {row["path"]: row["mission"]["name"] for row in terminal.run("file", "list", "--json").json()["items"]}
    assert now == {"drive.mcap": "night", "camera.raw": "night", "notes.txt": "north ridge"}
    changed = terminal.run("mission", "info", missions["ridge"], "--json").json()["mission"]
    assert changed["notes"] == "<img src=x onerror=alert(1)> **kept**\nsecond line"
    assert changed["completed_at"] is not None
