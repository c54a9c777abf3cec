"""Previews in a real browser show the recorded images and plots."""

import base64
import csv
import io
import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kleinkram.recordings import Recording
from kleinkram.recordings.decoding import image
from kleinkram.recordings.sample import FileTruth, generate_bag, generate_mcap
from tests.acceptance.conftest import wait_until
from tests.system.cluster import Cluster
from tests.system.web.conftest import RunBrowser

_NAMES = ("drive.mcap", "drive.bag", "cut.mcap")
_MCAP_BYTES, _BAG_BYTES = 60_000_000, 10_000_000
# JPEG decoders may round differently.
_ROUNDING = 2
_MAX_SHARE = 0.05


@pytest.mark.slow
@pytest.mark.timeout(240)
def test_previews_show_the_recorded_images_and_plots(cluster: Cluster, run_browser: RunBrowser, tmp_path: Path) -> None:
    cluster.start()
    day = tmp_path / "day"
    day.mkdir()
    mcap = generate_mcap(day / "drive.mcap", size_bytes=_MCAP_BYTES)
    bag = generate_bag(day / "drive.bag", size_bytes=_BAG_BYTES)
    with (day / "drive.mcap").open("rb") as whole:
        (day / "cut.mcap").write_bytes(whole.read(_BAG_BYTES))
    terminal = cluster.terminal
    terminal.run("project", "create", "Alps")
    terminal.run("upload", "-p", "Alps", "-m", "day", "--create", "--wait", f"{day}/")

    def files() -> dict[str, dict[str, Any]]:
        return {file["path"]: file for file in terminal.run("file", "list", "-p", "Alps", "--json").json()["items"]}

    wait_until(lambda: all(file["content"] != "pending" for file in files().values()), "the files to be read")
    known = files()
    assert [known[name]["content"] for name in _NAMES] == ["indexed", "indexed", "recovered"]
    results = run_browser("look.mjs", cluster, *(known[name]["id"] for name in _NAMES))

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
