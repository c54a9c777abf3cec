"""3D panels in a real browser: the points, poses and markers of recordings, placed by their transforms."""

import json
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import pytest
from numpy.typing import NDArray

from kleinkram.client import connect
from kleinkram.contract.recording_previews import RecordingPreviewState
from kleinkram.recordings import Recording
from kleinkram.recordings.decoding import points
from kleinkram.recordings.sample import generate_mcap
from tests.acceptance.conftest import wait_until
from tests.conftest import RECORDINGS
from tests.requirements import missing
from tests.system.cluster import Cluster
from tests.system.web import scene_messages
from tests.system.web.conftest import RunBrowser

_REAL = "ros1/embag_pointcloud2_laserscan_odom_lz4.bag"
_TIME_NS = scene_messages.START_NS + 4 * scene_messages.SECOND_NS
_MAX_POINTS = 300_000
_PICTURED = ("drive", "real", "shapes", "utm", "large", "settings")
_BACKGROUND_COLOURS = 20


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_3d_panels_show_the_recorded_points_poses_and_markers(
    shared_cluster: Cluster, run_browser: RunBrowser, tmp_path: Path, pictures: Path
) -> None:
    if not (RECORDINGS / _REAL).is_file():
        missing(f"no recording {_REAL}")
    day = tmp_path / "day"
    day.mkdir()
    generate_mcap(day / "drive.mcap", size_bytes=10_000_000)
    scene_messages.write_shapes(day / "shapes.mcap")
    (day / "real.bag").write_bytes((RECORDINGS / _REAL).read_bytes())
    ids = _upload(shared_cluster, day)
    shapes = ids["shapes.mcap"]
    drive, real = (
        _first_cloud(day / "drive.mcap", "/lidar/points"),
        _first_cloud(day / "real.bag", "/luminar_pointcloud"),
    )
    utm = scene_messages.utm_points()
    views = [
        _view("drive", ids["drive.mcap"], drive[0], ["/lidar/points"], len(drive[1])),
        _view("real", ids["real.bag"], real[0], ["/luminar_pointcloud"], len(real[1])),
        _view("shapes", shapes, _TIME_NS, ["/shapes", "/path", "/grid", "/pose", "/colours"], 95, items=16),
        _view("utm", shapes, _TIME_NS, ["/utm"], 400),
        _view("large", shapes, _TIME_NS, ["/large"], _shown_points(scene_messages.LARGE_CLOUD_POINTS)),
        _view("cut", shapes, _TIME_NS, ["/cut"], 79),
        _view("missing", shapes, _TIME_NS, ["/colours", "/utm", "/looping"], 95, missing=2),
        _view("deleted", shapes, _TIME_NS + 2 * scene_messages.SECOND_NS, ["/shapes"], 0, items=11),
        _view("settings", shapes, _TIME_NS, ["/colours"], 95, has_settings=True),
    ]
    late_ns, last = _last_cloud(day / "drive.mcap", "/lidar/points")
    late = _view("late", ids["drive.mcap"], late_ns, ["/lidar/points"], len(last))
    clouds = _preview_clouds(shared_cluster, ids["drive.mcap"])
    results = run_browser("scene.mjs", shared_cluster, pictures, json.dumps(views), json.dumps(late), timeout_s=560)

    shown = results["views"]
    assert (results["consoleErrors"], results["axe"], results["overflowing"]) == ([], [], [])
    _assert_points(shown["drive"], drive[1])
    assert shown["drive"]["topics"][0]["logTime"] == str(drive[0])
    _assert_points(shown["real"], real[1])
    _assert_shapes(shown["shapes"])
    _assert_points(shown["utm"], utm, rounding_m=1e-6)
    assert "250,000 of 1,000,000 points drawn" in shown["large"]["topics"][0]["text"]
    assert "16 missing" in shown["cut"]["topics"][0]["text"]
    assert sorted(shown["missing"]["missing"]) == [
        "The transforms above the frame b form a loop.",
        "There is no transform of the frame utm near this time.",
    ]
    assert shown["deleted"]["topics"][0]["markers"] == "11", "a marker was deleted before this time"
    for name in ("rough", "refused"):
        _assert_thinned(shown[name], clouds, day / "drive.mcap", late_ns)
    assert (shown["rough"]["failures"], shown["refused"]["failures"]) == (0, 1)
    assert shown["afterRough"]["notice"] == []
    assert shown["afterRough"]["topics"][0]["logTime"] == str(late_ns)
    assert "rough" not in shown["afterRough"]["topics"][0]
    assert all(view["colours"] > _BACKGROUND_COLOURS for view in shown.values()), "something is drawn"
    stepped = results["stepped"]
    assert len(set(stepped["times"])) == 4
    assert 0 < stepped["before"] == stepped["after"], "shaders are not compiled again for each cloud"
    assert "frame=base" in unquote(results["address"])
    assert results["hasTurned"]
    assert results["time"] == str(_TIME_NS), "keys that turn the camera do not move the play head"


def _view(
    name: str, file_id: str, time_ns: int, series: list[str], points: int, *, items: int = 1, missing: int = 0,
    has_settings: bool = False,
) -> dict[str, Any]:  # fmt: skip
    view = {"name": name, "file": file_id, "time": str(time_ns), "series": series, "points": points, "items": items}
    return {**view, "missing": missing, "hasSettings": has_settings, "isPictured": name in _PICTURED}


def _assert_shapes(view: dict[str, Any]) -> None:
    markers, path, grid, _pose, colours = view["topics"]
    assert (view["fixedFrame"], view["items"]) == ("map", 12 + 4), "the markers, a path, a grid, a pose and a cloud"
    assert view["label"].endswith("95 points, 15 objects")
    assert markers["markers"] == "12"
    assert "1 mesh shown as a box" in markers["text"]
    assert "120 poses" in path["text"]
    assert "2,400 cells" in grid["text"]
    assert "1 without a finite position" in colours["text"]
    _assert_points(view, scene_messages.coloured_points(), topic=4)


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


def _last_cloud(path: Path, topic: str) -> tuple[int, NDArray[Any]]:
    with Recording.open(path) as recording:
        *_, last = recording.messages(topic)
        return last.log_time_ns, points(last.value)


def _preview_clouds(cluster: Cluster, file_id: str) -> list[int]:
    """Return the times of the clouds in the preview of a file."""
    client = connect(cluster.runtime_info()["url"], (cluster.data_dir / "owner-token").read_text().strip())
    with client:
        wait_until(
            lambda: client.files.preview_state(file_id).state is RecordingPreviewState.ready, "the preview of the drive"
        )
        return [cloud.time_ns for cloud in client.files.preview(file_id).clouds]


def _assert_thinned(view: dict[str, Any], clouds: list[int], path: Path, at_ns: int) -> None:
    """A panel shows some points of the recorded cloud at the time of the preview's last one until now."""
    row = view["topics"][0]
    time_ns = int(row["rough"])
    assert time_ns == max(time for time in clouds if time <= at_ns)
    with Recording.open(path) as recording:
        (cloud,) = [points(one.value) for one in recording.messages("/lidar/points") if one.log_time_ns == time_ns]
    xyz = np.stack([cloud[axis] for axis in "xyz"], axis=-1).reshape(-1, 3)
    recorded = {tuple(point) for point in xyz.tolist()}
    first = np.array(json.loads(row["first"]), np.float32).reshape(-1, 3)
    assert {tuple(point) for point in first.tolist()} <= recorded
    assert 100 < int(row["points"]) < len(xyz)
    assert f"{int(row['points']):,} of {len(xyz):,} points drawn" in row["text"]
    least, greatest = np.array(json.loads(row["bounds"]))
    assert (least >= xyz.min(axis=0)).all()
    assert (greatest <= xyz.max(axis=0)).all()
    assert (greatest - least > 0.5 * np.ptp(xyz, axis=0)).all(), "the points are spread over the cloud"
    assert len(view["notice"]) == 1
    assert view["notice"][0].startswith("Thinned cloud of the preview, at ")


def _shown_points(total: int) -> int:
    stride = -(-total // _MAX_POINTS)
    return -(-total // stride)


def _assert_points(view: dict[str, Any], cloud: NDArray[Any], *, topic: int = 0, rounding_m: float = 0) -> None:
    """Compare a panel with a cloud as the SDK reads it: the number of points, their bounds, and the first three."""
    row = view["topics"][topic]
    xyz = np.stack([cloud[axis].astype(np.float64) for axis in "xyz"], axis=-1).reshape(-1, 3)
    finite = xyz[np.isfinite(xyz).all(axis=1)]
    assert int(row["points"]) == len(finite)
    np.testing.assert_allclose(
        json.loads(row["bounds"]), [finite.min(axis=0), finite.max(axis=0)], rtol=0, atol=rounding_m
    )
    shown = np.array(json.loads(row["first"])).reshape(-1, 3)
    offset = finite[0] if np.abs(finite[0]).max() > 8192 else 0
    np.testing.assert_allclose(shown, finite[:3] - offset, rtol=0, atol=max(rounding_m, 1e-6))
