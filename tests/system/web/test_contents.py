"""Files that are not recordings in a real browser: they are shown as their bytes say, and nothing is executed."""

import csv
import io
import json
from pathlib import Path
from shutil import copyfile
from typing import Any

import pytest

from kleinkram.recordings import Recording
from kleinkram.recordings.trajectories.files import read_file
from tests.acceptance.conftest import wait_until
from tests.system.cluster import Cluster
from tests.system.web import contents_world as world
from tests.system.web.conftest import RunBrowser

_TRAJECTORY = "trajectories/euroc_MH_04_vislam_ba0.tum"
_FLIGHT_LOG = "other/px4_sample.ulg"
_STEP_BYTES = 256 * 1024
_MAX_SHOWN_BYTES = 2**20
# Lossy formats round, and GIF has a palette.
_ROUNDING = 16
_MAX_TASK_MS = 1500


@pytest.fixture(scope="module")
def shown(
    shared_cluster: Cluster, recordings_dir: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, dict[str, str]]:
    """Upload all files; return their folder, and their ids by name."""
    folder = tmp_path_factory.mktemp("files")
    world.make_files(folder)
    copyfile(recordings_dir / _TRAJECTORY, folder / "real.tum")
    copyfile(recordings_dir / _FLIGHT_LOG, folder / "real.ulg")
    terminal = shared_cluster.terminal
    terminal.run("project", "create", "Alps")
    terminal.run("upload", "-p", "Alps", "-m", "files", "--create", "--wait", f"{folder}/")

    def files() -> list[dict[str, Any]]:
        items: list[dict[str, Any]] = terminal.run("file", "list", "-p", "Alps", "--json").json()["items"]
        return items

    wait_until(lambda: all(file["content"] != "pending" for file in files()), "the files to be read")
    return folder, {file["path"]: file["id"] for file in files()}


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_files_are_shown_as_what_they_are(
    shared_cluster: Cluster, shown: tuple[Path, dict[str, str]], run_browser: RunBrowser, pictures: Path
) -> None:
    folder, ids = shown
    results = run_browser("contents.mjs", shared_cluster, pictures, json.dumps(ids), timeout_s=540)

    assert results["executed"] == [], "content of a file was executed"
    assert results["cspViolations"] == []
    assert results["axe"] == []
    assert results["overflowing"] == []
    assert results["downloads"] == ["real.ulg"], "only the values were downloaded"
    assert [error for error in results["consoleErrors"] if not error.startswith("cut.mp4")] == []
    _assert_long_text(results["long"], (folder / "long.log").read_text())
    _assert_json(results["json"], (folder / "state.json").read_text())
    _assert_table(results["table"], (folder / "table.csv").read_text())
    _assert_trajectory(results["trajectory"], folder / "real.tum")
    _assert_flight_log(results["flightLog"], folder / "real.ulg")
    _assert_media(results)
    _assert_hostile(results, folder)


def _assert_long_text(results: dict[str, Any], text: str) -> None:
    assert results["viewer"] == "text"
    assert results["bytesRead"] <= _STEP_BYTES
    assert results["first"] == text[:_STEP_BYTES]
    assert results["more"] == text[: 2 * _STEP_BYTES]
    assert (results["mark"], results["isMarkVisible"]) == ("pose 12.25", True)
    assert results["matches"] == "2 of 1,000 or more"
    assert results["end"] == text[-_STEP_BYTES:]
    assert results["endBytesRead"] < 4 * _STEP_BYTES < len(text) / 4, "the middle of the file was read"
    assert results["window"] == _MAX_SHOWN_BYTES
    assert results["longestTask"] < _MAX_TASK_MS


def _assert_json(results: dict[str, Any], text: str) -> None:
    assert results["original"] == text
    assert results["formatted"] == results["copied"] == json.dumps(world.STATE, indent=2)


def _assert_table(results: dict[str, Any], text: str) -> None:
    head, *rows = csv.reader(io.StringIO(text))
    assert results["viewer"] == "table"
    assert results["rowCount"] == len(rows) == world.TABLE_ROWS
    assert [cells[1:] for cells in results["cells"]] == rows[:200]
    sines = [float(row[head.index("sine")]) for row in rows]
    assert (
        results["curves"]
        == results["curvesAgain"]
        == (f"Curves of table.csv: sine from {min(sines):.6g} to {max(sines):.6g}")
    )
    assert "show=curves" in results["address"]
    assert results["asText"] == text[:100]


def _assert_trajectory(results: dict[str, Any], path: Path) -> None:
    positions = read_file(path).positions
    assert results["points"] == len(positions)
    assert results["label"] == f"A path of {len(positions)} points: tx to the right, ty up"
    extent = results["extent"].split("\n")[-1].split("end")[-1].replace(" m", "").split("×")
    truth = positions.max(axis=0) - positions.min(axis=0)
    assert [float(number) for number in extent] == pytest.approx(truth[:2].tolist(), rel=1e-5)
    for axis, name in enumerate(("tx", "ty", "tz")):
        least, greatest = results["curves"].split(f"{name} from ")[1].split(",")[0].split(" to ")
        assert float(least) == pytest.approx(positions[:, axis].min(), rel=1e-5)
        assert float(greatest) == pytest.approx(positions[:, axis].max(), rel=1e-5)


def _assert_flight_log(results: dict[str, Any], path: Path) -> None:
    head, *rows = csv.reader(io.StringIO(results["csv"]))
    with Recording.open(path) as recording:
        assert sorted(results["topics"]) == sorted(topic.name for topic in recording.topics)
        messages = list(recording.messages("vehicle_attitude"))
        start_ns = min(message.log_time_ns for message in recording.messages())
    assert head == [f"seconds since {start_ns} ns", "quat_reset_counter"] or head[1].startswith(("q[", "quat"))
    assert len(rows) == len(messages)
    for row, message in zip(rows, messages, strict=True):
        assert float(row[0]) == pytest.approx((message.log_time_ns - start_ns) / 1e9, abs=1e-9)
        for name, cell in zip(head[1:], row[1:], strict=True):
            field, _, index = name.partition("[")
            value = getattr(message.value, field)
            assert float(cell) == float(value[int(index[:-1])] if index else value)


def _assert_media(results: dict[str, Any]) -> None:
    video = results["video"]
    assert (video["viewer"], video["width"], video["height"]) == ("video", *world.VIDEO_SIZE)
    assert video["duration"] == pytest.approx(world.VIDEO_FRAMES / world.FRAMES_PER_S, abs=0.2)
    assert video["pixels"][0] == pytest.approx(world.frame_colour(world.FRAMES_PER_S), abs=_ROUNDING)
    assert results["sound"]["viewer"] == "audio"
    assert results["sound"]["duration"] == pytest.approx(world.SOUND_S, abs=0.1)
    truth = world.picture()
    for ending, shown_picture in results["pictures"].items():
        assert (shown_picture["width"], shown_picture["height"]) == world.PICTURE_SIZE, ending
        for place, pixel in zip([(10, 70), (110, 10), (60, 40)], shown_picture["pixels"], strict=True):
            assert pixel == pytest.approx(truth.getpixel(place), abs=_ROUNDING), ending


def _assert_hostile(results: dict[str, Any], folder: Path) -> None:
    texts = results["texts"]
    for name in ("notes.md", "config.yaml", "drawing.svg", "page.html", "page.png"):
        assert texts[name]["text"] == (folder / name).read_text(), name
        assert (texts[name]["viewer"], texts[name]["elements"]) == ("text", 0), "markup was rendered"
    assert texts["one-line.txt"]["text"] == "x" * _STEP_BYTES
    assert texts["one-line.txt"]["longestTask"] < _MAX_TASK_MS
    assert texts["latin.log"]["text"] == "Fahrt nach Z\ufffdrich, Stra\ufffde gesperrt\nbell \u2407 ⟨U+202E⟩evil\n"
    assert "2 sequences of bytes that are not UTF-8" in texts["latin.log"]["status"]
    wide = results["wide"]
    assert (wide["heads"], wide["fields"]) == (51, 200)
    assert "50 of 10,000 columns shown" in wide["text"]
    assert results["formula"]["cell"] == world.SCRIPT
    sentences = {name: item["text"] for name, item in results["sentences"].items()}
    assert "This file is not text" in sentences["noise.txt"]
    first = (folder / "noise.txt").read_bytes()[:16]
    assert f"00000000  {first.hex(' ')}" in sentences["noise.txt"]
    assert "Browsers do not show TIFF files" in sentences["photo.tiff"]
    assert "This image is too large to display (60000 × 60000)" in sentences["bomb.png"]
    assert results["sentences"]["bomb.png"]["bytesRead"] <= (folder / "bomb.png").stat().st_size
    assert "cannot show this image" in sentences["broken.png"]
    assert "cannot play this file" in sentences["cut.mp4"]
    assert "Download it to open it with a PDF reader" in sentences["paper.pdf"]
