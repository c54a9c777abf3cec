"""The viewer in a real browser, where recordings are extreme, addresses expire, or a recording is deleted meanwhile."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

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
_CAMERA = "/camera/image/compressed"
_COUNTS = "/counts"


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


def _files(cluster: Cluster) -> list[dict[str, Any]]:
    items: list[dict[str, Any]] = cluster.terminal.run("file", "list", "-p", "Trouble", "--json").json()["items"]
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
