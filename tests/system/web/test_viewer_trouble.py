"""The viewer in a real browser, where recordings are extreme, addresses expire, or a recording is deleted meanwhile."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader

from kleinkram.client import connect
from kleinkram.contract.recording_previews import RecordingPreviewState
from kleinkram.recordings import Recording
from kleinkram.recordings.sample import generate_mcap
from kleinkram.recordings.writing.mcap_writer import McapWriter
from tests.acceptance.conftest import wait_until
from tests.system.cluster import Cluster
from tests.system.web.conftest import RunBrowser

_TOPICS = 10_000
_ADDRESS_S = 5
_S = 1_000_000_000
_TEN_YEARS_NS = 3_652 * 86_400 * _S
_CAMERA, _LIDAR, _IMU = "/camera/image/compressed", "/lidar/points", "/imu/data"
_COUNTS = "/counts"
_BLOCK_BYTES, _TAIL_BYTES = 128 * 1024, 512 * 1024
# How far around the play head panels need messages: the transforms of clouds.
_AROUND_NS = 1 * _S
_LINE = {"bytesPerSecond": 1_500_000, "latencyMs": 200}
_JUMP_S = 4
_CANCELLED_MS, _JUMP_MS = 1_000, 5_000
_WASTED_BYTES = 512 * 1024


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_the_viewer_survives_extreme_recordings_expired_addresses_and_a_deletion(
    cluster: Cluster, run_browser: RunBrowser, pictures: Path, tmp_path: Path
) -> None:
    day = tmp_path / "day"
    day.mkdir()
    drive = generate_mcap(day / "drive.mcap", size_bytes=10_000_000)
    # The clock of the recorder was set after its first messages: the time of the recording is that of the others.
    early_ns = [drive.start_ns - _TEN_YEARS_NS + step * _S for step in range(3)]
    counted_ns = [drive.start_ns + step * _S for step in range(10)]
    _write_counts(day / "years.mcap", {_COUNTS: list(enumerate([*early_ns, *counted_ns], start=-len(early_ns)))})
    topics = {f"/sensor/{number:05}": [(number, drive.start_ns + number)] for number in range(_TOPICS)}
    _write_counts(day / "many.mcap", topics)
    # The browser must not know that an address expires: it would renew it before.
    cluster.settings["KLEINKRAM_DOWNLOAD_URL_S"] = str(_ADDRESS_S)
    cluster.start()
    terminal = cluster.terminal
    terminal.run("project", "create", "Trouble")
    terminal.run("upload", "-p", "Trouble", "-m", "day", "--create", "--wait", f"{day}/")

    wait_until(lambda: all(file["content"] == "indexed" for file in _files(cluster)), "the files to be read")
    known = {file["path"]: file for file in _files(cluster)}
    years_key, drive_key = (known[name]["recording_id"][:8] for name in ("years.mcap", "drive.mcap"))
    images_ns = _times(drive.path, _CAMERA)
    request = {
        "mission": known["drive.mcap"]["mission"]["id"],
        "files": {name: file["id"] for name, file in known.items()},
        "panels": {
            "yearsRaw": f"raw:{years_key}@{_COUNTS}",
            "yearsPlot": f"plot:{years_key}@{_COUNTS},value",
            "image": f"image:{drive_key}@{_CAMERA}",
        },
        "times": {
            "first": str(counted_ns[0]),
            "second": str(counted_ns[1]),
            "last": str(counted_ns[-1]),
            "image": str(images_ns[0]),
            "lastImage": str(images_ns[-1]),
        },
        "addressSeconds": _ADDRESS_S,
    }
    results = run_browser("viewer_trouble.mjs", cluster, pictures, json.dumps(request))

    assert [results[name] for name in ("consoleErrors", "axe", "overflowing", "executed")] == [[], [], [], []]
    assert 0 < results["defaultPanels"] <= 8
    assert results["listedTopics"] == 200, "the dialog does not list ten thousand topics"
    assert results["addedTopic"] == ["9998"]
    years = results["years"]
    assert (years["first"], years["second"]) == ({"value": "0"}, {"value": "1"})
    assert int(years["messages"]) == len(counted_ns)
    assert abs(int(years["home"]) - counted_ns[0]) < _S
    assert counted_ns[-1] <= int(years["end"]) < images_ns[-1] + 5 * _S
    assert results["expired"]["renewalsAtFirst"] == 1
    assert results["expired"]["renewals"] > 1, "a new address was requested"
    assert results["expired"]["failures"] == 0, "an expired address is not shown as a failure"
    assert results["deleted"]["status"] == 200
    assert "returned no download URL" in results["deleted"]["sentence"]
    assert results["deleted"]["other"] == {"value": str(len(counted_ns) - 1)}


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_over_a_slow_line_what_is_seen_first_is_requested_first(
    shared_cluster: Cluster, run_browser: RunBrowser, pictures: Path, tmp_path: Path
) -> None:
    day = tmp_path / "day"
    day.mkdir()
    drive = generate_mcap(day / "drive.mcap", size_bytes=40_000_000)
    _write_counts(day / "other.mcap", {_COUNTS: [(number, drive.start_ns + number) for number in range(1000)]})
    terminal = shared_cluster.terminal
    terminal.run("project", "create", "Slow")
    terminal.run("upload", "-p", "Slow", "-m", "day", "--create", "--wait", f"{day}/")
    wait_until(lambda: all(file["content"] == "indexed" for file in _files(shared_cluster, "Slow")), "the index")
    known = {file["path"]: file for file in _files(shared_cluster, "Slow")}
    _wait_for_preview(shared_cluster, known["drive.mcap"]["id"])
    key, other_key = (known[name]["recording_id"][:8] for name in ("drive.mcap", "other.mcap"))
    images_ns, clouds_ns = _times(drive.path, _CAMERA), _times(drive.path, _LIDAR)
    first_ns, second_ns = drive.start_ns + 6 * _S, drive.start_ns + (6 - _JUMP_S) * _S
    size_bytes = drive.path.stat().st_size
    # The index, and the transforms that are valid all the time.
    index = (size_bytes - _TAIL_BYTES - _BLOCK_BYTES, size_bytes)
    always = [(0, _bytes_of(drive.path, drive.start_ns, drive.start_ns)[1]), index]
    needed = [_bytes_of(drive.path, at_ns - _AROUND_NS, at_ns + _AROUND_NS) for at_ns in (first_ns, second_ns)]
    seen = [f"image:{key}@{_CAMERA}", f"scene:{key}@{_LIDAR}", f"plot*:{key}@{_IMU},linear_acceleration.x"]
    request = {
        "mission": known["drive.mcap"]["mission"]["id"],
        "file": known["drive.mcap"]["id"],
        "panels": [*seen, f"raw:{key}@/odom", f"raw:{key}@/gps/fix", f"raw:{other_key}@{_COUNTS}"],
        "times": {
            "first": str(first_ns),
            "firstImage": str(_valid(images_ns, first_ns)),
            "firstCloud": str(_valid(clouds_ns, first_ns)),
            "secondImage": str(_valid(images_ns, second_ns)),
            "secondCloud": str(_valid(clouds_ns, second_ns)),
            "jumpSeconds": _JUMP_S,
        },
        "needed": [*always, needed[0]],
        "line": _LINE,
    }
    results = run_browser("slow_line.mjs", shared_cluster, pictures, json.dumps(request))

    assert results["consoleErrors"] == []
    path = next(one["path"] for one in results["first"]["picture"]["ranges"] if one["path"] != results["preview"])
    _assert_first(results["first"], results["preview"], path, [*always, needed[0]])
    _assert_jump(results, path, [*always, needed[1]])
    assert results["second"]["cloud"]["ranges"][-1]["path"] == path, "nothing is read of what is out of sight"
    assert {one["path"] for one in results["scrolled"]["ranges"]} > {results["preview"], path}


def _assert_first(shown: dict[str, Any], preview: str, path: str, needed: list[tuple[int, int]]) -> None:
    """Until the picture and the cloud are there, nothing is requested but the preview and what they need."""
    requested = shown["cloud"]["ranges"]
    assert {one["path"] for one in requested} == {preview, path}
    assert preview in [one["path"] for one in requested[:3]], "the preview is requested at once"
    assert _outside(requested, path, needed) == []
    first, last = needed[-1]
    in_window = [one for one in shown["picture"]["ranges"] if one["path"] == path and first <= one["first"] <= last]
    assert sum(one["sentBytes"] for one in in_window) < (last - first) / 2, (
        "a picture does not wait for what is around it"
    )


def _assert_jump(results: dict[str, Any], path: str, needed: list[tuple[int, int]]) -> None:
    """What is out of date ends at once, and what is needed now comes before everything else."""
    before, picture = results["before"], results["second"]["picture"]
    at_jump = len(before["ranges"])
    running = [place for place, one in enumerate(before["ranges"]) if one["endedAtMs"] is None]
    assert running, "something is read at the time of the jump"
    ended = [picture["ranges"][place] for place in running]
    assert all(not one["isWhole"] and one["endedAtMs"] - before["atMs"] < _CANCELLED_MS for one in ended)
    later = picture["ranges"][at_jump:]
    wasted_bytes = sum(one["sentBytes"] for one in _outside(later, path, needed))
    assert wasted_bytes < _WASTED_BYTES, "steps between the two times leave nothing behind"
    # The chunk of the picture, one that was begun before its request came, and the pauses between the steps.
    assert picture["atMs"] - before["atMs"] < _JUMP_MS


def _outside(ranges: list[dict[str, Any]], path: str, needed: list[tuple[int, int]]) -> list[dict[str, Any]]:
    """Return the ranges of a file that are not within a part that is needed."""
    own = [one for one in ranges if one["path"] == path]
    return [one for one in own if not any(first <= one["first"] and one["last"] <= last for first, last in needed)]


def _bytes_of(path: Path, from_ns: int, to_ns: int) -> tuple[int, int]:
    """Return the first and last byte of the blocks that have the chunks with messages of a time."""
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    chunks = [
        one for one in summary.chunk_indexes if one.message_end_time >= from_ns and one.message_start_time <= to_ns
    ]
    first = min(one.chunk_start_offset for one in chunks) // _BLOCK_BYTES * _BLOCK_BYTES
    end = max(one.chunk_start_offset + one.chunk_length for one in chunks)
    return first, -(-end // _BLOCK_BYTES) * _BLOCK_BYTES - 1


def _valid(times_ns: Sequence[int], at_ns: int) -> int:
    return max(time_ns for time_ns in times_ns if time_ns <= at_ns)


def _wait_for_preview(cluster: Cluster, file_id: str) -> None:
    with connect(cluster.runtime_info()["url"], (cluster.data_dir / "owner-token").read_text().strip()) as client:
        wait_until(lambda: client.files.preview_state(file_id).state is RecordingPreviewState.ready, "the preview")


def _files(cluster: Cluster, project: str = "Trouble") -> list[dict[str, Any]]:
    items: list[dict[str, Any]] = cluster.terminal.run("file", "list", "-p", project, "--json").json()["items"]
    return items


def _times(path: Path, topic: str) -> list[int]:
    with Recording.open(path) as recording:
        return [message.log_time_ns for message in recording.messages(topic)]


def _write_counts(path: Path, messages: Mapping[str, Sequence[tuple[int, int]]]) -> None:
    """Write an MCAP file of numbers: by topic, values and log times."""
    definition = json.dumps({"type": "object", "properties": {"value": {"type": "integer"}}}).encode()
    with path.open("wb") as file:
        writer = McapWriter(file)
        schema = writer.add_schema("Count", "jsonschema", definition)
        for topic, counts in messages.items():
            channel = writer.add_channel(topic, schema, "json")
            for value, time_ns in counts:
                writer.add_message(channel, time_ns, json.dumps({"value": value}).encode())
        writer.finish()
