"""Uploads from a real browser are complete, whatever happens during the transfer."""

import hashlib
import random
import re
from pathlib import Path

import pytest

from kleinkram.recordings.sample import generate_mcap
from tests.system.cluster import Cluster

from .conftest import Act

_FIELDS = """
undeclared: refuse
fields:
  - {name: robot, type: choice, choices: [anymal, spot], required: true, description: Which one drove.}
  # In words that a browser does not understand: the server judges.
  - {name: operator, type: string, pattern: '(?x) [a-z]+', required: true, description: In small letters.}
  - {name: temperature, type: number, unit: degC}
"""
_LARGE_BYTES = 120_000_000
_PARTS = -(-_LARGE_BYTES // (5 << 20))


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_an_upload_with_all_that_comes_between(cluster: Cluster, act: Act, pictures: Path, tmp_path: Path) -> None:
    cluster.start()
    day, other = tmp_path / "day", tmp_path / "other" / "day"
    (day / "nothing").mkdir(parents=True)
    other.mkdir(parents=True)
    generate_mcap(day / "drive.mcap", size_bytes=5_000_000)
    (day / "camera.raw").write_bytes(random.Random(5).randbytes(_LARGE_BYTES))
    (day / "growing.bag").write_bytes(b"begun")
    (day / "now.bag.active").write_bytes(b"begun")
    (other / "drive.mcap").write_bytes(b"something else")
    fields = tmp_path / "fields.yaml"
    fields.write_text(_FIELDS)
    terminal = cluster.terminal
    terminal.run("project", "create", "Alps", "--fields", fields)

    seen = act("upload.mjs", cluster, day, other, pictures)

    assert seen["complaints"] == []
    assert seen["axe"] == []
    assert "2 files" in seen["plan"]
    assert "growing.bag another program is writing to the file" in seen["plan"].replace("\n", " ")
    assert "now.bag.active the file is still being recorded" in seen["plan"].replace("\n", " ")
    assert seen["asked"].count("Required.") == 2
    assert "'ada.lovelace', which does not match" in seen["refused"]
    assert "continues automatically" in seen["offline"]
    assert seen["dialogs"] == ["beforeunload"], "closing the page is warned about while something is under way"
    assert "already in the store" in seen["unfinished"]
    assert re.search(r"[12] files? unchanged", seen["fit"]), seen["fit"]
    # The two small files go in one part each; of four parts on their way the page may not have heard the answer.
    assert seen["putsBefore"] >= 6
    assert seen["putsAfter"] <= _PARTS + 2 - seen["putsBefore"] + 4, "what the store holds is not sent again"
    assert "All 3 files uploaded." in seen["over"]
    assert "3 already there" in seen["again"]
    assert seen["putsAgain"] == 0
    for content in (day / "drive.mcap", other / "drive.mcap"):
        assert hashlib.sha256(content.read_bytes()).hexdigest() in seen["conflict"]
    widths = [seen[f"{name}Wide"] for name in ("dark", "phone", "phone-dark")]
    assert max(widths) <= 0, "nothing is wider than the page"
    (day / "now.bag.active").unlink()
    terminal.run("verify", "-p", "Alps", "-m", "ascent", day)


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_trouble_on_the_way(cluster: Cluster, act: Act, pictures: Path, tmp_path: Path) -> None:
    """The API dies and comes back, the session ends and somebody signs in again, a file is written to."""
    cluster.start()
    day = tmp_path / "day"
    day.mkdir()
    (day / "camera.raw").write_bytes(random.Random(6).randbytes(_LARGE_BYTES))
    changing = tmp_path / "changing.raw"
    changing.write_bytes(random.Random(7).randbytes(_LARGE_BYTES))
    terminal = cluster.terminal
    terminal.run("project", "create", "Alps")

    seen = act("upload_trouble.mjs", cluster, day, changing, pictures, cluster.runtime_info()["services"]["api"])

    assert "The server does not respond" in seen["away"]
    assert "signed out" in seen["signedOut"]
    assert "File uploaded." in seen["over"]
    terminal.run("verify", "-p", "Alps", "-m", "descent", day)
    assert "The file was changed, moved, or deleted after you selected it." in seen["changed"]
    assert "changing.raw" not in terminal.run("file", "list", "-p", "Alps").out
    assert "Another tab is uploading it." in seen["other"]
    assert seen["elsewhere"].count("Another tab is uploading to this mission") == 1
    assert seen["cancelled"].startswith("Cancelled")
    assert seen["left"] == 0, "nothing is unfinished once it was cancelled"
    assert seen["errors"] == []
