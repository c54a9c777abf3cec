"""3D panels in a real browser: the points, poses and markers of recordings, placed by their transforms."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from kleinkram.recordings import Recording
from kleinkram.recordings.decoding import points
from kleinkram.recordings.sample import generate_mcap
from tests.acceptance.conftest import wait_until
from tests.conftest import RECORDINGS
from tests.requirements import missing
from tests.system.cluster import Cluster
from tests.system.web import scene_recording
from tests.system.web.conftest import RunBrowser

_REAL = "ros1/embag_pointcloud2_laserscan_odom_lz4.bag"
_TIME_NS = scene_recording.START_NS + 4 * scene_recording.SECOND_NS
_MAX_POINTS = 300_000


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_3d_panels_show_the_recorded_points_poses_and_markers(
    shared_cluster: Cluster, run_browser: RunBrowser, tmp_path: Path, pictures: Path
) -> None:
    if not (RECORDINGS / _REAL).is_file():
        missing(f"no recording {_REAL}")
    day = tmp_path / "day"
    day.mkdir()
    generate_mcap(day / "drive.mcap", size_bytes=10_000_000)
    scene_recording.write_shapes(day / "shapes.mcap")
    (day / "real.bag").write_bytes((RECORDINGS / _REAL).read_bytes())
    ids = _upload(shared_cluster, day)
    drive, real = _first_cloud(day / "drive.mcap", "/lidar/points"), _first_cloud(day / "real.bag", "/luminar_pointcloud")
    colours, utm = scene_recording.coloured_points(), scene_recording.utm_points()
    shapes = ["/shapes", "/path", "/grid", "/pose", "/colours"]
    views: list[dict[str, Any]] = [
        {"name": "drive", "file": ids["drive.mcap"], "series": ["/lidar/points"], "time": drive[0], "points": len(drive[1]), "isPictured": True, "follow": False},
        {"name": "real", "file": ids["real.bag"], "series": ["/luminar_pointcloud"], "time": real[0], "points": len(real[1]), "isPictured": True},
        {"name": "shapes", "file": ids["shapes.mcap"], "series": shapes, "time": _TIME_NS, "points": 95, "items": 16, "isPictured": True},
        {"name": "utm", "file": ids["shapes.mcap"], "series": ["/utm"], "time": _TIME_NS, "points": 400, "isPictured": True},
        {"name": "large", "file": ids["shapes.mcap"], "series": ["/large"], "time": _TIME_NS, "points": 250_000, "isPictured": True},
        {"name": "cut", "file": ids["shapes.mcap"], "series": ["/cut"], "time": _TIME_NS, "points": 79},
        {"name": "missing", "file": ids["shapes.mcap"], "series": ["/colours", "/utm", "/looping"], "time": _TIME_NS, "points": 95, "missing": True},
        {"name": "deleted", "file": ids["shapes.mcap"], "series": ["/shapes"], "time": _TIME_NS + 2 * scene_recording.SECOND_NS, "points": 0, "items": 11},
        {"name": "settings", "file": ids["shapes.mcap"], "series": ["/colours"], "time": _TIME_NS, "points": 95, "isPictured": True, "follow": True},
    ]  # fmt: skip
    for view in views:
        view["time"] = str(view["time"])
    results = run_browser("scene.mjs", shared_cluster, pictures, json.dumps(views), timeout_s=280)

    shown = results["views"]
    assert (results["consoleErrors"], results["axe"], results["overflowing"]) == ([], [], [])
    _assert_points(shown["drive"], drive[1])
    _assert_points(shown["real"], real[1])
    assert shown["drive"]["topics"][0]["logTime"] == str(drive[0])
    assert shown["shapes"]["fixedFrame"] == "map"
    assert shown["shapes"]["items"] == 12 + 4, "the markers, a path, a grid, a pose and a cloud"
    assert shown["shapes"]["topics"][0]["markers"] == "12"
    assert "1 mesh shown as boxes" in shown["shapes"]["topics"][0]["text"]
    assert "120 poses" in shown["shapes"]["topics"][1]["text"]
    assert "2,400 cells" in shown["shapes"]["topics"][2]["text"].replace(" ", ",")  # noqa: RUF001
    assert shown["shapes"]["label"].endswith("95 points, 15 objects")
    assert "1 without a finite position" in shown["shapes"]["topics"][4]["text"]
    _assert_points(shown["shapes"], colours, topic=4)
    _assert_points(shown["utm"], utm, rounding_m=1e-6)
    assert shown["large"]["topics"][0]["points"] == str(_shown_points(scene_recording.LARGE_CLOUD_POINTS))
    assert "16 missing" in shown["cut"]["topics"][0]["text"]
    assert sorted(shown["missing"]["missing"]) == [
        "No transforms connect the frame b with map." if "loop" not in " ".join(shown["missing"]["missing"]) else "The transforms above the frame b form a loop.",
        "There is no transform of the frame utm near this time.",
    ]
    assert shown["deleted"]["items"] == 11
    assert all(view["colours"] > 3 for view in shown.values() if view["items"]), "something is drawn"
    assert "frame%3Dbase" in results["address"] or "frame=base" in results["address"]


def _upload(cluster: Cluster, day: Path) -> dict[str, str]:
    terminal = cluster.terminal
    terminal.run("project", "create", "Dolomites")
    terminal.run("upload", "-p", "Dolomites", "-m", "day", "--create", "--wait", f"{day}/")

    def files() -> list[dict[str, Any]]:
        items: list[dict[str, Any]] = terminal.run("file", "list", "-p", "Dolomites", "--json").json()["items"]
        return items

    wait_until(lambda: all(file["content"] == "indexed" for file in files()), "the files to be read")
    return {file["path"]: file["id"] for file in files()}


def _first_cloud(path: Path, topic: str) -> tuple[int, NDArray[Any]]:
    with Recording.open(path) as recording:
        first = next(iter(recording.messages(topic)))
        return first.log_time_ns, points(first.value)


def _shown_points(total: int) -> int:
    stride = -(-total // _MAX_POINTS)
    return -(-total // stride)


def _assert_points(view: dict[str, Any], cloud: NDArray[Any], *, topic: int = 0, rounding_m: float = 0) -> None:
    """Compare a panel with a cloud as the SDK reads it: the number of points, their bounds, and the first three."""
    row = view["topics"][topic]
    xyz = np.stack([cloud[axis].astype(np.float64) for axis in "xyz"], axis=-1).reshape(-1, 3)
    finite = xyz[np.isfinite(xyz).all(axis=1)]
    assert int(row["points"]) == len(finite)
    np.testing.assert_allclose(json.loads(row["bounds"]), [finite.min(axis=0), finite.max(axis=0)], rtol=0, atol=rounding_m)
    shown = np.array(json.loads(row["first"])).reshape(-1, 3)
    offset = finite[0] if np.abs(finite[0]).max() > 8192 else 0
    np.testing.assert_allclose(shown, finite[:3] - offset, rtol=0, atol=max(rounding_m, 1e-6))
