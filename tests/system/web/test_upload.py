"""Uploads from a real browser are complete, whatever happens during the transfer."""

import hashlib
import random
import re
from pathlib import Path

import pytest

from kleinkram.recordings.sample import generate_mcap
from tests.system.cluster import Cluster

from .conftest import RunBrowser

_FIELDS = """
undeclared: refuse
fields:
  - {name: robot, type: choice, choices: [anymal, spot], required: true, description: Which one drove.}
  # A syntax that browsers do not support: only the server validates it.
  - {name: operator, type: string, pattern: '(?x) [a-z]+', required: true, description: In small letters.}
  - {name: temperature, type: number, unit: degC}
"""
_LARGE_BYTES = 80_000_000
_PARTS = -(-_LARGE_BYTES // (5 << 20))
_MEDIUM_BYTES = 40_000_000  # more parts than connections
_SMALL_FILES, _SMALL_BYTES = 100, 250_000


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_an_interrupted_upload_is_completed_without_sending_parts_again(
    cluster: Cluster, run_browser: RunBrowser, pictures: Path, tmp_path: Path
) -> None:
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

    results = run_browser("upload.mjs", cluster, day, other, pictures)

    assert results["consoleErrors"] == []
    assert results["axe"] == []
    assert "2 files" in results["plan"]
    assert "growing.bag another program is writing to the file" in results["plan"].replace("\n", " ")
    assert "now.bag.active the file is still being recorded" in results["plan"].replace("\n", " ")
    assert results["missingMetadata"].count("Required.") == 2
    assert "'ada.lovelace', which does not match" in results["refused"]
    assert "continues automatically" in results["offline"]
    assert results["dialogs"] == ["beforeunload"], "the browser warns before it closes the page during an upload"
    assert "already in the store" in results["unfinished"]
    assert re.search(r"[12] files? unchanged", results["matchingFiles"]), results["matchingFiles"]
    # The two small files have one part each. The page may not have received the responses of four parts in progress.
    assert results["putsBefore"] >= 6
    assert results["putsAfter"] <= _PARTS + 2 - results["putsBefore"] + 4, "uploaded parts are not sent again"
    assert "All 3 files uploaded." in results["finished"]
    assert "3 already there" in results["secondUpload"]
    assert results["putsOfSecondUpload"] == 0
    for content in (day / "drive.mcap", other / "drive.mcap"):
        assert hashlib.sha256(content.read_bytes()).hexdigest() in results["conflict"]
    overflows = [results[f"{name}Overflow"] for name in ("dark", "phone", "phone-dark")]
    assert max(overflows) <= 0, "a page is wider than its viewport"
    (day / "now.bag.active").unlink()
    terminal.run("verify", "-p", "Alps", "-m", "ascent", day)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_an_upload_survives_a_killed_api_an_expired_session_and_a_second_tab(
    cluster: Cluster, run_browser: RunBrowser, pictures: Path, tmp_path: Path
) -> None:
    """The API is killed, the session ends, two tabs upload into one mission, and a file changes during its upload."""
    cluster.start()
    day = tmp_path / "day"
    day.mkdir()
    contents = random.Random(6)
    for number in range(_SMALL_FILES):
        (day / f"a{number:03}.raw").write_bytes(contents.randbytes(_SMALL_BYTES))
    (day / "camera.raw").write_bytes(contents.randbytes(_MEDIUM_BYTES))
    changing = tmp_path / "changing.raw"
    changing.write_bytes(random.Random(7).randbytes(_MEDIUM_BYTES))
    terminal = cluster.terminal
    terminal.run("project", "create", "Alps")

    results = run_browser(
        "upload_trouble.mjs", cluster, day, changing, pictures, cluster.runtime_info()["services"]["api"]
    )

    assert "The server does not respond" in results["unreachable"]
    assert results["reachable"] == "running"
    assert "signed out" in results["signedOut"]
    assert f"All {_SMALL_FILES + 1} files uploaded." in results["finished"]
    terminal.run("verify", "-p", "Alps", "-m", "descent", day)
    assert "The file was changed, moved, or deleted after you selected it." in results["changed"]
    assert "changing.raw" not in terminal.run("file", "list", "-p", "Alps").out
    assert "Another tab is uploading it." in results["unfinishedInOtherTab"]
    assert results["refusedInOtherTab"].count("Another tab is uploading to this mission") == 1
    assert results["cancelled"].startswith("Cancelled")
    assert results["unfinishedAfterCancel"] == 0, "a cancelled upload is not listed as unfinished"
    assert results["errors"] == []
