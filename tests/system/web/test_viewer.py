"""Recordings in a real browser: previews show recorded images and plots; selections are the bytes of `klein cut`."""

import base64
import csv
import hashlib
import io
import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kleinkram.recordings import Recording
from kleinkram.recordings.decoding import image
from kleinkram.recordings.sample import FileTruth, generate_bag, generate_db3, generate_mcap
from tests.acceptance.conftest import wait_until
from tests.system.cluster import Cluster
from tests.system.web.conftest import RunBrowser

_DATABASE = "drive_rosbag2/drive_rosbag2_0.db3"
_NAMES = ("drive.mcap", "drive.bag", "cut.mcap", _DATABASE)
_MCAP_BYTES, _BAG_BYTES = 60_000_000, 10_000_000
# JPEG decoders may round differently.
_ROUNDING = 2
_MAX_SHARE = 0.05
# By the name of the file and of the selection; `from` and `to` in seconds after the start.
_SELECTIONS: dict[str, dict[str, Any]] = {
    "drive.mcap imu": {"topics": ["/imu/data"], "from": 1, "to": 2},
    "drive.mcap later": {"topics": None, "from": 1.5, "to": None},
    "drive.bag imu": {"topics": ["/imu/data"], "from": 1, "to": 2},
}


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_previews_show_the_recorded_images_and_plots(
    shared_cluster: Cluster, run_browser: RunBrowser, tmp_path: Path
) -> None:
    day = tmp_path / "day"
    day.mkdir()
    mcap = generate_mcap(day / "drive.mcap", size_bytes=_MCAP_BYTES)
    bag = generate_bag(day / "drive.bag", size_bytes=_BAG_BYTES)
    database = generate_db3(day / "drive_rosbag2", size_bytes=_BAG_BYTES)
    with (day / "drive.mcap").open("rb") as whole:
        (day / "cut.mcap").write_bytes(whole.read(_BAG_BYTES))
    terminal = shared_cluster.terminal
    terminal.run("project", "create", "Alps")
    terminal.run("upload", "-p", "Alps", "-m", "day", "--create", "--wait", f"{day}/")

    def files() -> dict[str, dict[str, Any]]:
        return {file["path"]: file for file in terminal.run("file", "list", "-p", "Alps", "--json").json()["items"]}

    wait_until(lambda: all(file["content"] != "pending" for file in files().values()), "the files to be read")
    known = files()
    assert [known[name]["content"] for name in _NAMES] == ["indexed", "indexed", "recovered", "indexed"]
    results = run_browser("look.mjs", shared_cluster, *(known[name]["id"] for name in _NAMES))

    assert results["consoleErrors"] == []
    pictures = _pictures(mcap.path)
    _assert_same(results["mcap"], pictures[0])
    _assert_same(results["next"], pictures[1])
    later = next(
        picture for picture in pictures if picture[0] >= pictures[1][0] // 1_000_000 * 1_000_000 + 1_000_000_000
    )
    _assert_same(results["second"], later)
    assert "t=1." in results["address"]
    _assert_same(results["bag"], _pictures(bag.path)[0])
    assert results["mcap"]["bytesRead"] < _MAX_SHARE * _MCAP_BYTES
    _assert_plot(results["imu"]["csv"], mcap, "/imu/data", "linear_acceleration", "xyz")
    _assert_plot(results["odom"]["csv"], bag, "/odom", "pose.pose.position", "xy")
    assert "Read all 60." in results["imu"]["partialNotice"], "the plot reads part of many messages until asked for all"
    assert results["odom"]["partialNotice"] is None
    assert results["imu"]["label"].startswith("Plot of /imu/data over time: linear_acceleration.x from -0.")
    _assert_same(results["cut"], pictures[0])
    assert "not closed" in results["cut"]["notice"]
    in_database = _pictures(database.path)
    _assert_same(results["db3"], in_database[0])
    _assert_same(results["db3Next"], in_database[1])
    _assert_plot(results["db3Odom"]["csv"], database, "/odom", "pose.pose.position", "xy")
    assert not results["db3CanBeSliced"]


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_download_selection_gives_the_bytes_of_klein_cut(
    shared_cluster: Cluster, run_browser: RunBrowser, tmp_path: Path
) -> None:
    day = tmp_path / "day"
    day.mkdir()
    generate_mcap(day / "drive.mcap", size_bytes=10_000_000)
    generate_bag(day / "drive.bag", size_bytes=5_000_000)
    terminal = shared_cluster.terminal
    terminal.run("project", "create", "Jura")
    terminal.run("upload", "-p", "Jura", "-m", "day", "--create", "--wait", f"{day}/")

    def files() -> dict[str, dict[str, Any]]:
        return {file["path"]: file for file in terminal.run("file", "list", "-p", "Jura", "--json").json()["items"]}

    wait_until(lambda: all(file["content"] == "indexed" for file in files().values()), "the files to be read")
    known = files()
    selections = [
        {"name": name, "file": known[name.split()[0]]["id"], **selected} for name, selected in _SELECTIONS.items()
    ]
    results = run_browser("slices.mjs", shared_cluster, json.dumps(selections))

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
        terminal.run("cut", name, "-p", "Jura", "-m", "day", *options, "-o", target)
        assert hashlib.sha256(target.read_bytes()).hexdigest() == results["files"][selection["name"]], selection
    assert results["commands"]["drive.mcap imu"].startswith("klein cut drive.mcap -p Jura -m day --topics /imu/data")


def _pictures(path: Path) -> list[tuple[int, Any]]:
    with Recording.open(path) as recording:
        messages = recording.messages("/camera/image/compressed")
        return [(message.log_time_ns, image(message.value)[:, :, 0]) for message in itertools.islice(messages, 20)]


def _assert_same(results: dict[str, Any], truth: tuple[int, Any]) -> None:
    log_time_ns, pixels = truth
    assert int(results["logTime"]) == log_time_ns
    grey = np.frombuffer(base64.b64decode(results["grey"]), np.uint8).reshape(results["height"], results["width"])
    assert grey.shape == pixels.shape
    assert int(np.abs(grey.astype(int) - pixels.astype(int)).max()) <= _ROUNDING
    assert int(grey.max()) - int(grey.min()) > 100, "the picture has one colour"


def _assert_plot(text: str, truth: FileTruth, topic: str, field: str, axes: str) -> None:
    head, *rows = csv.reader(io.StringIO(text))
    assert head == [f"seconds since {truth.start_ns} ns", *(f"{field}.{axis}" for axis in axes)]
    assert len(rows) == next(summary.count for summary in truth.topics if summary.name == topic)
    with Recording.open(truth.path) as recording:
        messages = list(recording.messages(topic))
    for row, message in zip(rows, messages, strict=True):
        value = message.value
        for name in field.split("."):
            value = getattr(value, name)
        assert float(row[0]) == pytest.approx((message.log_time_ns - truth.start_ns) / 1e9, abs=1e-9)
        assert [float(cell) for cell in row[1:]] == [getattr(value, axis) for axis in axes]
