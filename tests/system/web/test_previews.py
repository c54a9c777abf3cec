"""Previews of missions in a real browser: the gallery of a mission, its large view, and pictures in lists."""

import shutil
from pathlib import Path
from typing import Any

import pytest

from kleinkram.client import Client, connect
from kleinkram.contract.recording_previews import RecordingPreviewState
from tests.acceptance.conftest import Terminal, wait_until
from tests.system.cluster import Cluster
from tests.system.web.conftest import RunBrowser

_RECORDED = "Picture of a camera"
_MARKUP = "Sheet <img src=x onerror=alert(1)>"
_SCRIPT = f"""\
# /// script
# [tool.kleinkram]
# name = "preview"
# description = "Pictures of a mission."
# inputs = {{paths = ["*.mcap"]}}
# ///
import json
import struct
import zlib

from kleinkram.action import out, report


def write_png(path, width, height, red):
    rows = b"".join(
        b"\\0" + b"".join(bytes((red, 255 * x // width, 255 * y // height)) for x in range(width))
        for y in range(height)
    )
    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    chunks = (b"IHDR" + head, b"IDAT" + zlib.compress(rows), b"IEND")
    framed = (struct.pack(">I", len(chunk) - 4) + chunk + struct.pack(">I", zlib.crc32(chunk)) for chunk in chunks)
    path.write_bytes(b"\\x89PNG\\r\\n\\x1a\\n" + b"".join(framed))


write_png(out / "sheet.png", 800, 600, 40)
report.preview("sheet.png", title={_MARKUP!r})
head = '<svg xmlns="http://www.w3.org/2000/svg" width="400" height="120" onload="alert(3)"><script>alert(4)</script>'
curve = '<path d="M0 60 L100 20 L200 90 L300 30 L400 60" stroke="black" fill="none"/>'
(out / "plot.svg").write_text(head + curve + "</svg>")
report.preview("plot.svg", title="Speed over time")
line = [[8.5, 47.3], [8.501, 47.3], [8.501, 47.301]]
(out / "track.geojson").write_text(json.dumps({{"type": "LineString", "coordinates": line}}))
report.preview("track.geojson", title="Track")
(out / "topics.csv").write_text("topic,count\\n/imu/data,200\\n")
report.preview("topics.csv", title="Topics")
for number in range(5):
    write_png(out / f"frame-{{number}}.png", 160, 90, 50 * number)
    report.preview(f"frame-{{number}}.png", title=f"Frame {{number}}")
"""


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_previews_are_shown_at_the_mission_and_in_lists(
    cluster: Cluster, run_browser: RunBrowser, pictures: Path, tmp_path: Path
) -> None:
    cluster.start()
    terminal = cluster.terminal
    _create_objects(cluster, terminal, tmp_path)

    results = run_browser("previews.mjs", cluster, pictures)

    assert results["consoleErrors"] == []
    assert results["axe"] == []
    assert results["overflowing"] == []
    assert results["executed"] == [], "markup was run"
    assert "kleinkram/preview" in results["none"]
    assert results["before"] == {"home": [_RECORDED], "project": [_RECORDED]}
    gallery = results["gallery"]
    assert gallery["first"] == [_MARKUP, "Speed over time", "Frame 0", "Frame 1"]
    assert gallery["others"] == ["Track", "Topics"]
    assert len(gallery["all"]) == 7
    assert gallery["outdated"] == 0
    assert results["large"] == {
        "titles": [_MARKUP, "Speed over time", "Frame 0", "Speed over time", "Frame 4"],
        "place": "7 of 7",
        "isLastDisabled": True,
        "focusedAfter": "Frame 3",
    }
    assert results["outdated"] == ["Outdated"]
    _check_lists(results["lists"])
    assert results["renewed"] == {"requests": 2, "pictures": 1}, "the expired URL was renewed"
    listed = terminal.run("mission", "previews", "day", "-p", "Alps", "--json").json()
    assert [row["path"] for row in listed["items"]][:2] == ["sheet.png", "plot.svg"]
    terminal.run("mission", "previews", "day", "-p", "Alps", "--dest", tmp_path / "back")
    assert (tmp_path / "back" / "preview" / "sheet.png").read_bytes().startswith(b"\x89PNG")
    assert "9 (`klein mission previews`)" in terminal.run("mission", "info", "day", "-p", "Alps").out


def _check_lists(lists: dict[str, Any]) -> None:
    for name, height in (("project", 40), ("search", 52), ("home", 52)):
        assert lists[name]["alts"] == [_MARKUP, _MARKUP], name
        assert set(lists[name]["heights"]) == {height}, "a picture does not change the height of its row"
        assert lists[name]["boxes"] == [[48, 32], [48, 32]], name
        assert lists[name]["moved"] == [], "names stay where they are when pictures come"
    assert lists["far"]["rows"] < 60, "only visible rows are rendered"
    assert lists["far"]["alts"] == [_MARKUP, _MARKUP], "pictures are shown again after scrolling"


def _create_objects(cluster: Cluster, terminal: Terminal, tmp_path: Path) -> None:
    script = tmp_path / "preview.py"
    script.write_text(_SCRIPT)
    terminal.run("project", "create", "Alps")
    terminal.run("action", "create", script, "-p", "Alps")
    with _connected(cluster) as client:
        alps = client.projects.get("Alps")
        for number in range(70):
            client.missions.create(f"planned {number:02}", project=alps)
    terminal.run("sample", tmp_path / "day", "--size", "1MB", "--format", "mcap")
    shutil.copytree(tmp_path / "day", tmp_path / "night")
    for name in ("day", "night"):
        terminal.run("upload", "-p", "Alps", "-m", name, "--create", "--wait", tmp_path / name)
    terminal.run("action", "run", "preview", "-p", "Alps", "-m", "night", "--follow", "--yes")
    (recording,) = (tmp_path / "day").rglob("*.mcap")
    later = shutil.copy(recording, tmp_path / "later.mcap")
    terminal.run("upload", "-p", "Alps", "-m", "night", "--wait", later)
    with _connected(cluster) as client:
        (day,) = [file for file in client.files.list(project="Alps", mission="day") if file.path.endswith(".mcap")]
        wait_until(
            lambda: client.files.preview_state(day.id).state is RecordingPreviewState.ready,
            "the preview of the recording",
        )


def _connected(cluster: Cluster) -> Client:
    return connect(cluster.runtime_info()["url"], (cluster.data_dir / "owner-token").read_text().strip())
