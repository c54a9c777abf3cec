"""The web's "Download selection" in a real browser gives the bytes that `klein cut` writes."""

import hashlib
import json
from pathlib import Path
from typing import Any

import pytest

from kleinkram.recordings.sample import generate_bag, generate_mcap
from tests.acceptance.conftest import wait_until
from tests.system.cluster import Cluster
from tests.system.web.conftest import RunBrowser

# By the name of the file and of the selection; `from` and `to` in seconds after the start.
_SELECTIONS: dict[str, dict[str, Any]] = {
    "drive.mcap imu": {"topics": ["/imu/data"], "from": 1, "to": 2},
    "drive.mcap later": {"topics": None, "from": 1.5, "to": None},
    "drive.bag imu": {"topics": ["/imu/data"], "from": 1, "to": 2},
}


@pytest.mark.slow
@pytest.mark.timeout(240)
def test_download_selection_gives_the_bytes_of_klein_cut(
    cluster: Cluster, run_browser: RunBrowser, tmp_path: Path
) -> None:
    cluster.start()
    day = tmp_path / "day"
    day.mkdir()
    generate_mcap(day / "drive.mcap", size_bytes=10_000_000)
    generate_bag(day / "drive.bag", size_bytes=5_000_000)
    terminal = cluster.terminal
    terminal.run("project", "create", "Alps")
    terminal.run("upload", "-p", "Alps", "-m", "day", "--create", "--wait", f"{day}/")

    def files() -> dict[str, dict[str, Any]]:
        return {file["path"]: file for file in terminal.run("file", "list", "-p", "Alps", "--json").json()["items"]}

    wait_until(lambda: all(file["content"] == "indexed" for file in files().values()), "the files to be read")
    known = files()
    selections = [
        {"name": name, "file": known[name.split()[0]]["id"], **selected} for name, selected in _SELECTIONS.items()
    ]
    results = run_browser("slices.mjs", cluster, json.dumps(selections))

    assert results["consoleErrors"] == []
    assert results["downloads"] == {name: results["files"][name] for name in results["downloads"]} != {}
    for selection in selections:
        name = selection["name"].split()[0]
        start_ns = known[name]["start_ns"]
        target = tmp_path / f"{selection['name'].replace(' ', '-')}.mcap"
        options: list[str] = [argument for topic in selection["topics"] or [] for argument in ("--topics", topic)]
        if selection["from"] is not None:
            options += ["--start", str(start_ns + int(selection["from"] * 10**9))]
        if selection["to"] is not None:
            options += ["--end", str(start_ns + int(selection["to"] * 10**9))]
        terminal.run("cut", name, "-p", "Alps", "-m", "day", *options, "-o", target)
        assert hashlib.sha256(target.read_bytes()).hexdigest() == results["files"][selection["name"]], selection
    assert results["commands"]["drive.mcap imu"].startswith("klein cut drive.mcap -p Alps -m day --topics /imu/data")
