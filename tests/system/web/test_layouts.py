"""Layouts of the viewer in real browsers: saved in one mission, shown in another, shared with a second person."""

import json
from pathlib import Path
from typing import Any

import pytest

from kleinkram.recordings.sample import generate_mcap
from kleinkram.recordings.writing.mcap_writer import McapWriter
from tests.acceptance.conftest import wait_until
from tests.system.cluster import Cluster
from tests.system.web.conftest import RunBrowser

_SIZE_BYTES = 2_000_000


def _write_text(path: Path, topic: str, start_ns: int) -> None:
    """Write a recording with one topic of JSON messages."""
    with path.open("wb") as file:
        writer = McapWriter(file)
        channel = writer.add_channel(topic, writer.add_schema("example.Text", "jsonschema", b"{}"), "json")
        for second in range(5):
            writer.add_message(channel, start_ns + second * 1_000_000_000, b'{"data": "x"}')
        writer.finish()


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_layouts_are_saved_in_one_mission_and_shown_in_another(
    shared_cluster: Cluster, run_browser: RunBrowser, pictures: Path, tmp_path: Path
) -> None:
    terminal = shared_cluster.terminal
    terminal.run("project", "create", "Ticino")
    for mission in ("first", "second"):
        (tmp_path / mission).mkdir()
        drive = generate_mcap(tmp_path / mission / "drive.mcap", size_bytes=_SIZE_BYTES)
    _write_text(tmp_path / "first" / "text.mcap", "/text", drive.start_ns)
    for mission in ("first", "second"):
        terminal.run("upload", "-p", "Ticino", "-m", mission, "--create", "--wait", f"{tmp_path / mission}/")

    def files() -> list[dict[str, Any]]:
        items: list[dict[str, Any]] = terminal.run("file", "list", "-p", "Ticino", "--json").json()["items"]
        return items

    wait_until(lambda: all(file["content"] == "indexed" for file in files()), "the files to be read")
    keys = {(file["mission"]["name"], file["path"]): file["recording_id"][:8] for file in files()}
    missions = {file["mission"]["name"]: file["mission"]["id"] for file in files()}
    invited = terminal.run("person", "invite", "ada@lab.example", "--name", "Ada", "--json").json()
    terminal.run("access", "grant", "READ", "-p", "Ticino", "--to", "ada@lab.example")
    here, text = keys["first", "drive.mcap"], keys["first", "text.mcap"]
    panels = [f"plot*:{here}@/imu/data,linear_acceleration.x", f"raw:{text}@/text", f"raw:{here}@/odom"]

    results = run_browser(
        *("layouts.mjs", shared_cluster, pictures, invited["url"]),
        json.dumps({**missions, "panels": panels}),
    )

    assert [results[name] for name in ("consoleErrors", "axe", "overflowing", "executed")] == [[], [], [], []]
    assert len(results["saved"]) == 3
    elsewhere = keys["second", "drive.mcap"]
    assert results["appliedAddress"] == [
        f"plot*:{elsewhere}@/imu/data,linear_acceleration.x",
        f"raw:{elsewhere}@/odom",
    ]
    fitting = [results["saved"][0], results["saved"][2]]
    assert results["applied"] == results["byDefault"] == results["readerDefault"] == fitting
    assert results["automatic"] != fitting
    assert results["readerLayouts"] == ["Arms"], "the second person does not see personal layouts of others"
    assert results["readerButtons"] == ["Show Arms"], "reading does not allow changes"
    assert results["readerShares"] == 0
    assert results["ownerLayouts"] == ["Mine"]
