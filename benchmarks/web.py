"""The rows about the web interface: Chromium in front of a filled instance, driven by `web.mjs`."""

import json
import os
import shutil
import statistics
import subprocess
import uuid
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks import web_places
from benchmarks.scale.requests import percentile
from kleinkram.client import Client, connect
from kleinkram.recordings.sample import generate_bag, generate_db3, generate_mcap
from kleinkram.server.http.web_app import BUILT

_WEB = Path(__file__).parent.parent / "web"
_BROWSERS = ("chromium", "chromium-browser", "google-chrome")
_BROWSER_S = 2400
_ALL = ("load", "changes", "mission", "picture", "viewer", "playing", "scroll")
_TIMES = 5
_TURNS = 120
_GB = 1_000_000_000
_LARGE = "large recordings"
_MOST_BYTES, _MOST_INTERACTIVE_MS = 350_000, 1_500
_MOST_CHANGE_MS, _MOST_MISSION_MS, _MOST_TASK_MS = 200, 500, 50
_MOST_PICTURE_MS, _MOST_PICTURE_SHARE = 1_500, 0.05
_VIEWED, _MOST_JUMP_MS = "viewed recordings", 300
# Pictures and scans of 65 s in so many bytes are larger than those of the sample: 100,000 points at 10 Hz.
_PLAYED, _PLAYED_BYTES, _PLAYED_S = "played recording", 1_220_000_000, 65.0
_MEMORY_MINUTES, _MOST_TAB_MB, _MOST_GROWTH = 10, 600, 1.1
_CAMERA, _LIDAR, _IMU, _ODOM = "/camera/image/compressed", "/lidar/points", "/imu/data", "/odom"

Row = dict[str, object]
# Runs a `klein` command, and returns what it prints.
Klein = Callable[..., str]


def web_rows(klein: Klein, url: str, token: str, database_url: str, folder: Path) -> list[Row]:
    """Fill the instance, and measure the times that users wait; prints a note if the browser is missing.

    `KLEINKRAM_BENCH_WEB=load,scroll` measures some of it.
    """
    browser = next((path for name in _BROWSERS if (path := shutil.which(name))), None)
    if lacking := _lacking(browser):
        return [{"what": "the web interface", "measured": f"not measured: {lacking}", "bar": "", "met": False}]
    selected = os.environ.get("KLEINKRAM_BENCH_WEB", ",".join(_ALL)).split(",")
    with connect(url, token=token) as client:
        places, derived_s = _filled(client, klein, database_url, folder)
    request = json.dumps(
        {**places, "asked": selected, "times": _TIMES, "turns": _TURNS, "memoryMs": _MEMORY_MINUTES * 60_000}
    )
    link = klein("session", "link").strip()
    command = ["node", str(Path(__file__).with_name("web.mjs")), str(_WEB), str(browser), link, url, request]
    try:
        done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=_BROWSER_S)
    except subprocess.TimeoutExpired as error:
        raise SystemExit(f"the browser's side was not done after {_BROWSER_S} s: {error.stderr!r}") from error
    if done.returncode != 0:
        raise SystemExit(f"the browser's side failed: {done.stderr}")
    seen = json.loads(done.stdout)
    rows: list[Row] = []
    for name, rows_of in _ROWS.items():
        if name in selected:
            rows += rows_of(seen)
    if "mission" in selected:
        rows.append(_derived_row(derived_s))
    return rows


def _lacking(browser: str | None) -> str | None:
    if browser is None:
        return "there is no Chromium"
    if shutil.which("node") is None:
        return "there is no Node"
    if not (_WEB / "node_modules" / "playwright-core").is_dir() or not (BUILT / "index.html").is_file():
        return "the web interface is not built (`make setup`)"
    return None


def _filled(client: Client, klein: Klein, database_url: str, folder: Path) -> tuple[dict[str, object], float]:
    project, many, files = web_places.fill(client, database_url)
    large = folder / "large"
    large.mkdir(parents=True)
    generate_mcap(large / "large.mcap", size_bytes=_GB, seed=1)
    generate_bag(large / "large.bag", size_bytes=_GB, seed=2)
    (folder / "notes.txt").write_text("an upload that makes the service derive the mission")
    into = ("upload", "-p", web_places.PROJECT, "-m")
    klein(*into, web_places.MANY_TOPICS, str(folder / "notes.txt"))
    derived_s = web_places.seconds_to_derive(client, many)
    klein(*into, web_places.MANY_FILES, str(folder / "notes.txt"))
    web_places.seconds_to_derive(client, files)
    klein(*into, _LARGE, "--create", f"{large}/", "--wait")
    mission_id = client.missions.get(_LARGE, project=project).id
    pictures = {samples.path: f"/files/{samples.id}" for samples in client.missions.timeline(mission_id)}
    viewer_path, layout = _viewed(client, klein, folder / "viewed", project)
    played_path, played_layout = _played(client, klein, folder / "played", project)
    places: dict[str, object] = {
        "viewerPath": viewer_path,
        "layout": layout,
        "playedPath": played_path,
        "playedLayout": played_layout,
        "project": web_places.PROJECT,
        "projectPath": f"/projects/{project}",
        "many": web_places.MANY_TOPICS,
        "manyPath": f"/missions/{many}",
        "filesPath": f"/missions/{files}",
        "large": _LARGE,
        "file": "large.mcap",
        "pictures": pictures,
        "topics": web_places.TOPICS,
        "files": web_places.FILES,
        "found": web_places.FOUND,
    }
    return places, derived_s


def _viewed(client: Client, klein: Klein, folder: Path, project: uuid.UUID) -> tuple[str, list[str]]:
    """Upload a mission of 1 GB in three recordings; return the address of its viewer, and panels of all three."""
    folder.mkdir()
    size_bytes = _GB // 3
    generate_mcap(folder / "drive.mcap", size_bytes=size_bytes, seed=3)
    generate_bag(folder / "drive.bag", size_bytes=size_bytes, seed=4)
    generate_db3(folder / "drive_rosbag2", size_bytes=size_bytes, seed=5)
    klein("upload", "-p", web_places.PROJECT, "-m", _VIEWED, "--create", f"{folder}/", "--wait")
    mission_id = client.missions.get(_VIEWED, project=project).id
    keys = {
        Path(file.path).suffix: str(file.recording_id)[:8]
        for file in client.files.list(mission=mission_id)
        if file.recording_id is not None
    }
    mcap, bag, db3 = keys[".mcap"], keys[".bag"], keys[".db3"]
    acceleration, position = "linear_acceleration.x", "pose.pose.position.x"
    plots = [
        f"plot:{mcap}@{_IMU},{acceleration}",
        f"plot:{bag}@{_ODOM},{position}",
        f"plot:{db3}@{_IMU},{acceleration}",
    ]
    layout = [f"image:{mcap}@{_CAMERA}", f"image:{db3}@{_CAMERA}", f"scene:{mcap}@{_LIDAR}", *plots]
    return f"/missions/{mission_id}/view", layout


def _played(client: Client, klein: Klein, folder: Path, project: uuid.UUID) -> tuple[str, list[str]]:
    """Upload a recording with large clouds; return the address of its viewer, and panels of what is played."""
    folder.mkdir()
    generate_mcap(folder / "drive.mcap", size_bytes=_PLAYED_BYTES, duration_s=_PLAYED_S, seed=6)
    klein("upload", "-p", web_places.PROJECT, "-m", _PLAYED, "--create", f"{folder}/", "--wait")
    mission_id = client.missions.get(_PLAYED, project=project).id
    (file,) = client.files.list(mission=mission_id)
    key = str(file.recording_id)[:8]
    plots = [f"plot:{key}@{_IMU},linear_acceleration.{axis}" for axis in "xy"]
    layout = [f"image:{key}@{_CAMERA}", f"scene:{key}@{_LIDAR}", *plots, f"plot:{key}@{_ODOM},pose.pose.position.x"]
    return f"/missions/{mission_id}/view", layout


def _load_rows(seen: Mapping[str, Any]) -> list[Row]:
    loads = seen["load"]
    size = statistics.median(samples["bytes"] for samples in loads)
    bytes_row = {
        "what": "first load of the home page, gzipped",
        "measured": f"{size / 1000:.0f} kB",
        "bar": f"<= {_MOST_BYTES / 1000:.0f} kB",
        "met": size <= _MOST_BYTES,
        "bytes": [samples["bytes"] for samples in loads],
    }
    times = [samples["milliseconds"] for samples in loads]
    return [bytes_row, _time_row("the home page is interactive", times, _MOST_INTERACTIVE_MS)]


def _change_rows(seen: Mapping[str, Any]) -> list[Row]:
    medians = {name: statistics.median(times) for name, times in seen["changes"].items()}
    slowest = max(medians, key=lambda name: medians[name])
    row = _time_row(f"from page to page with warm data, slowest: {slowest}", seen["changes"][slowest], _MOST_CHANGE_MS)
    in_order = sorted(medians.items(), key=lambda item: -item[1])
    return [row | {"also": ", ".join(f"{name} {time:.0f} ms" for name, time in in_order), "medians_ms": medians}]


def _mission_rows(seen: Mapping[str, Any]) -> list[Row]:
    cold = {
        name: statistics.median(samples["milliseconds"] for samples in seen[name])
        for name in ("missionCold", "topicsCold")
    }
    topics = statistics.median(samples["topics"] for samples in seen["mission"])
    what = f"the page of a mission of {web_places.RECORDINGS} files and {web_places.TOPICS} topics, from the click"
    row = _time_row(what, [samples["files"] for samples in seen["mission"]], _MOST_MISSION_MS)
    also = (
        f"then its topics {topics:.0f} ms; in a browser that knows nothing, the app included: "
        f"files {cold['missionCold']:.0f} ms, topics {cold['topicsCold']:.0f} ms"
    )
    return [row | {"also": also, "raw": {name: seen[name] for name in ("mission", "missionCold", "topicsCold")}}]


def _derived_row(derived_s: float) -> Row:
    return {
        "what": f"topics of {web_places.RECORDINGS} files with {web_places.TOPICS} topics each, added up by a worker",
        "measured": f"{derived_s:.1f} s",
        "bar": "none",
        "met": True,
        "seconds": derived_s,
    }


def _picture_rows(seen: Mapping[str, Any]) -> list[Row]:
    rows = []
    for name, pictures in seen["pictures"].items():
        share = max(samples["bytes"] for samples in pictures) / _GB
        row = _time_row(f"first picture of a 1 GB {Path(name).suffix[1:]}", _all_ms(pictures), _MOST_PICTURE_MS)
        row["measured"] = f"{row['measured']}, {share:.1%} of it read"
        row["bar"] = f"{row['bar']}, <= {_MOST_PICTURE_SHARE:.0%} of it"
        row["met"] = bool(row["met"]) and share <= _MOST_PICTURE_SHARE
        rows.append(row | {"share": share})
    return rows


def _viewer_rows(seen: Mapping[str, Any]) -> list[Row]:
    opened, jumps = seen["viewer"]["opened"], seen["viewer"]["jumps"]
    share = max(samples["bytes"] for samples in opened) / _GB
    opening = _time_row("the viewer of a mission of 1 GB: first picture and curve", _all_ms(opened), _MOST_PICTURE_MS)
    opening["measured"] = f"{opening['measured']}, {share:.1%} of it read"
    opening["bar"] = f"{opening['bar']}, <= {_MOST_PICTURE_SHARE:.0%} of it"
    opening["met"] = bool(opening["met"]) and share <= _MOST_PICTURE_SHARE
    slowest = percentile(jumps["read"], 95)
    jump = {
        "what": "a jump of the viewer to what it has read: 2 cameras and a cloud are right",
        "measured": f"median {statistics.median(jumps['read']):.0f} ms, p95 {slowest:.0f} ms",
        "bar": f"p95 <= {_MOST_JUMP_MS} ms",
        "met": slowest <= _MOST_JUMP_MS,
        "also": f"with reading: median {statistics.median(jumps['unread']):.0f} ms, "
        f"p95 {percentile(jumps['unread'], 95):.0f} ms",
        "milliseconds": jumps,
    }
    return [opening | {"share": share}, jump]


def _playing_rows(seen: Mapping[str, Any]) -> list[Row]:
    played, tab_mb = seen["playing"], [size / 1e6 for size in seen["playing"]["tabBytes"]]
    half = len(tab_mb) // 2
    growth = statistics.median(tab_mb[half:]) / statistics.median(tab_mb[:half])
    playing = {
        "what": f"the viewer plays {played['seconds']:.0f} s: a camera and a cloud of {played['points']:,} points at "
        "10 Hz, 3 plots",
        "measured": f"{played['played']:.1f} s shown, longest task of the main thread {played['longest']:.0f} ms",
        "bar": f"no second less, <= {_MOST_TASK_MS} ms",
        "met": played["seconds"] - played["played"] < 1 and played["longest"] <= _MOST_TASK_MS,
        "also": f"{played['long']} tasks over 50 ms",
        "raw": played,
    }
    memory = {
        "what": f"memory of the tab while it plays for {played['minutes']:.0f} minutes",
        "measured": f"at most {max(tab_mb):.0f} MB; the second half {growth:.2f}x the first",
        "bar": f"<= {_MOST_TAB_MB} MB, <= {_MOST_GROWTH}x",
        "met": max(tab_mb) <= _MOST_TAB_MB and growth <= _MOST_GROWTH,
        "megabytes": tab_mb,
    }
    return [playing, memory]


def _scroll_rows(seen: Mapping[str, Any]) -> list[Row]:
    return [
        _time_row(f"longest task of the main thread while scrolling {name}", _all_ms(scrolls), _MOST_TASK_MS)
        | {
            "also": f"{sum(samples['long'] for samples in scrolls)} tasks over 50 ms in {len(scrolls)} rounds",
            "raw": scrolls,
        }
        for name, scrolls in seen["scrolls"].items()
    ]


def _all_ms(samples: Sequence[Mapping[str, float]]) -> list[float]:
    return [one["milliseconds"] for one in samples]


def _time_row(what: str, times_ms: Sequence[float], most_ms: float) -> Row:
    median = statistics.median(times_ms)
    return {
        "what": what,
        "measured": f"median {median:.0f} ms, slowest {max(times_ms):.0f} ms",
        "bar": f"<= {most_ms} ms",
        "met": median <= most_ms,
        "milliseconds": list(times_ms),
    }


_ROWS = {
    "load": _load_rows,
    "changes": _change_rows,
    "mission": _mission_rows,
    "picture": _picture_rows,
    "viewer": _viewer_rows,
    "playing": _playing_rows,
    "scroll": _scroll_rows,
}
