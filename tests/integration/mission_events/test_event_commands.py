"""`klein event` and `klein cut --event`, and the SDK behind them, with recordings on a server."""

import csv
import json
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from kleinkram.client import Client, connect
from kleinkram.client.errors import InvalidInput, NothingToDo
from kleinkram.contract.errors import EditConflict, InvalidRequest
from kleinkram.recordings import Recording
from kleinkram.recordings.sample import generate_bag, generate_mcap
from tests.integration.api_server import Api
from tests.integration.jobs import run_jobs
from tests.integration.test_cli import Klein, klein_at
from tests.recording_files.whole_mcap import read_whole_mcap

_S = 10**9


@pytest.fixture(name="klein", scope="module")
def _klein(api: Api, tmp_path_factory: pytest.TempPathFactory) -> Klein:
    return klein_at(api, tmp_path_factory.mktemp("home"))


@pytest.fixture(name="client")
def _client(api: Api) -> Iterator[Client]:
    with connect(api.url, api.token) as client:
        yield client


@pytest.fixture(name="drives", scope="module")
def _drives(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two recordings of 10 s that overlap: an MCAP, and a bag in a folder."""
    folder: Path = tmp_path_factory.mktemp("drives")
    generate_mcap(folder / "drive.mcap", size_bytes=2_000_000, duration_s=10)
    (folder / "nuc").mkdir()
    generate_bag(folder / "nuc" / "drive2.bag", size_bytes=1_000_000, duration_s=10, seed=2)
    return folder


@pytest.fixture(name="mission", scope="module")
def _mission(api: Api, drives: Path) -> str:
    """A mission with these files, read by the server."""
    mission_id = str(api.mission(api.project()["id"])["id"])
    with connect(api.url, api.token) as client:
        client.upload(f"{drives}/", uuid.UUID(mission_id))
    run_jobs(api)
    return mission_id


@pytest.fixture(name="empty")
def _empty(api: Api) -> str:
    return str(api.mission(api.project()["id"])["id"])


def _json(klein: Klein, *arguments: object, code: int = 0) -> Any:
    return json.loads(klein(*arguments, "--json", code=code).stdout)


def _expected(path: Path, topics: tuple[str, ...], start_ns: int, end_ns: int) -> list[tuple[str, int, bytes]]:
    with Recording.open(path) as recording:
        messages = recording.raw_messages(topics, start=start_ns, end=end_ns)
        return [(message.topic, message.log_time_ns, message.data) for message in messages]


def _stamped(path: Path) -> list[tuple[str, int, bytes]]:
    return [(topic, log_ns, data) for topic, log_ns, _, _, data in read_whole_mcap(path).messages]


def test_events_are_added_changed_listed_exported_and_deleted(klein: Klein, client: Client, mission: str) -> None:
    start_ns = client.missions.get(mission).start_ns or 0
    own = ("-m", mission)
    span = ("--start", "+2s", "--end", "+3.5s", "--label", "night", "--colour", "#ff8800", "--file", "drive.mcap")
    made = _json(klein, "event", "add", "fall", *own, *span, "--note", "=1+1")
    assert (made["start_ns"], made["end_ns"]) == (start_ns + 2 * _S, start_ns + 3 * _S + _S // 2)
    assert (made["file"]["path"], made["labels"], made["colour"]) == ("drive.mcap", ["night"], "#ff8800")
    moment = _json(klein, "event", "add", "fall again", *own, "--start", "+7s")
    assert [one["name"] for one in _json(klein, "event", "list", "fall*", *own)["items"]] == ["fall", "fall again"]
    assert klein("event", "list", "FALL", *own, "--count").stdout == "1\n"
    assert "1.500 s" in klein("event", "list", "fall", *own).stdout
    rows = [*csv.DictReader(klein("event", "list", "fall*", *own, "--csv").stdout.splitlines())]
    assert [(row["name"], int(row["start_ns"]), row["end_ns"]) for row in rows] == [
        ("fall", made["start_ns"], str(made["end_ns"])),
        ("fall again", moment["start_ns"], ""),
    ]
    assert rows[0]["note"] == "'=1+1", "no spreadsheet computes it"
    changed = _json(klein, "event", "update", made["id"], "--name", "slip", "--end", "", "--colour", "")
    assert (changed["name"], changed["end_ns"], changed["colour"]) == ("slip", None, None)
    stale = klein("event", "update", made["id"], "--note", "x", "--if-match", made["etag"], code=5)
    assert "was changed by somebody else" in stale.stderr
    klein("event", "delete", made["id"], "--yes")
    klein("event", "delete", moment["id"], "--yes")
    assert _json(klein, "event", "list", "fall*", "slip", *own) == {"items": []}


def test_one_mcap_is_cut_around_each_event(
    klein: Klein, client: Client, mission: str, drives: Path, tmp_path: Path
) -> None:
    topics = ("/imu/data",)
    moment = client.mission_events.add(mission, "stumble", "+4s")
    span = client.mission_events.add(mission, "stumble left", "+5s", "+6s")
    of_file = client.mission_events.add(
        mission, "glare", "+8s", file_id=client.files.get("drive.mcap", mission=mission).id
    )
    cut = ("cut", "-m", mission, "--event", "stumble*", "--event", "glare", "--around", "500ms", "--topics", topics[0])
    planned = _json(klein, *cut, "-o", tmp_path, "--dry-run")["items"]
    assert [one["event"] for one in planned] == ["stumble", "stumble left", "glare"]
    assert [*tmp_path.iterdir()] == []
    report = _json(klein, *cut, "-o", tmp_path)
    paths = {Path(one["local"]).name.partition("-20")[0]: Path(one["local"]) for one in report["items"]}
    assert paths.keys() == {"stumble", "stumble left", "glare"}
    assert [one["local"] for one in report["items"]] == [one["local"] for one in planned]
    around, files = _S // 2, (drives / "drive.mcap", drives / "nuc" / "drive2.bag")
    for event, end_ns, sources in (
        (moment, moment.start_ns, files),
        (span, span.end_ns or 0, files),
        (of_file, of_file.start_ns, files[:1]),
    ):
        bounds = (event.start_ns - around, end_ns + around + 1)
        expected = [message for path in sources for message in _expected(path, topics, *bounds)]
        assert sorted(_stamped(paths[event.name])) == sorted(expected)
        assert len(expected) > 50
    before = {path: path.read_bytes() for path in paths.values()}
    assert "it exists, and is not replaced" in klein(*cut, "-o", tmp_path, code=11).stderr
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_nothing_is_cut_of_an_event_whose_file_is_gone(
    klein: Klein, client: Client, api: Api, mission: str, tmp_path: Path
) -> None:
    file_id = client.files.get("drive.mcap", mission=mission).id
    event = client.mission_events.add(mission, "vanished", "+4s", file_id=file_id)
    api.sql("UPDATE mission_event SET file_id = NULL WHERE id = %s", event.id)  # as when the file is purged
    refused = klein("cut", "-m", mission, "--event", "vanished", "-o", tmp_path, code=3)
    assert "the file that the event refers to is no longer in the mission" in refused.stderr
    assert [*tmp_path.iterdir()] == []
    assert "not in the mission" in klein("event", "info", event.id).stdout


def test_files_and_missions_are_selected_by_their_events(
    klein: Klein, client: Client, mission: str, tmp_path: Path
) -> None:
    client.mission_events.add(mission, "rare glare", "+2s", file_id=client.files.get("drive.mcap", mission=mission).id)
    assert [one["path"] for one in _json(klein, "file", "list", "--event", "rare*")["items"]] == ["drive.mcap"]
    assert [one["id"] for one in _json(klein, "mission", "list", "--event", "RARE GLARE")["items"]] == [mission]
    assert [one.path for one in client.files.list(event="rare glare")] == ["drive.mcap"]
    klein("download", "--event", "rare glare", "--dest", tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["drive.mcap"]


def test_slices_of_several_missions_and_of_equal_names_are_in_files_of_their_own(
    client: Client, api: Api, mission: str, drives: Path, tmp_path: Path
) -> None:
    other = api.mission(api.project()["id"])
    client.upload([drives / "drive.mcap"], uuid.UUID(other["id"]))
    run_jobs(api)
    for where in (mission, mission, other["id"]):
        client.mission_events.add(uuid.UUID(where), "twin", "+4s")
    nowhere = client.mission_events.add(uuid.UUID(mission), "twin", 5)
    report = client.cut_events(client.mission_events.list(name="twin"), tmp_path, around_s=0.1, topics="/imu/data")
    paths = [result.local.relative_to(tmp_path) for result in report.results]
    assert len({*paths}) == 3
    assert [len(path.parts) for path in paths] == [3, 3, 3]
    assert {*paths} == {path.relative_to(tmp_path) for path in tmp_path.rglob("*.mcap")}
    assert len(report.left_out) == 1
    assert "nothing was recorded then" in str(report.left_out[0])
    with pytest.raises(NothingToDo):
        client.cut_events([nowhere], tmp_path)
    with pytest.raises(NothingToDo):
        client.cut_events([], tmp_path)


def test_findings_of_a_run_become_events_once(klein: Klein, api: Api, mission: str) -> None:
    body = {"mission_ids": [mission], "definition": {"name": "gait", "script": "print(1)"}, "force": True}
    run_id = str(api.post("/runs", body).ok()["items"][0]["run"]["id"])
    for code, time_ns in (("gait.slip", 10), ("gait.fall", 20), ("gait.none", None)):
        api.sql(
            "INSERT INTO run_finding (run_id, severity, code, message, time_ns) VALUES (%s, 'error', %s, 'Why.', %s)",
            *(run_id, code, time_ns),
        )
    first = _json(klein, "event", "from-run", run_id)["items"]
    assert [(one["name"], one["start_ns"], one["note"]) for one in first] == [
        ("gait.slip", 10, "Why."),
        ("gait.fall", 20, "Why."),
    ]
    assert _json(klein, "event", "from-run", run_id, "--code", "gait.f*")["items"] == first[1:]
    assert len(_json(klein, "event", "list", "--run", run_id)["items"]) == 2
    assert "no such finding with a time" in klein("event", "from-run", run_id, "--code", "x", code=3).stderr


def test_what_is_wrong_is_named(klein: Klein, client: Client, mission: str, empty: str, tmp_path: Path) -> None:
    client.mission_events.add(empty, "alone", 5)
    for arguments, code, text in (
        (("event", "add", "x", "-m", mission), 2, "--start TIME"),
        (("event", "add", "x", "-m", mission, "--start", "noon"), 2, "'noon' is no time"),
        (("event", "add", "a/b", "-m", mission, "--start", "+1s"), 2, "paths and wildcards"),
        (("event", "add", "x", "-m", mission, "--start", "+2s", "--end", "+1s"), 2, "before the start"),
        (("event", "add", "x", "-m", empty, "--start", "+1s"), 2, "give date and time"),
        (("event", "info", "stumble"), 2, "give its id"),
        (("event", "update", str(uuid.uuid4()), "--note", "x"), 3, "no event"),
        (("cut", "--event", "x", "-o", tmp_path), 2, "of a mission, -m"),
        (("cut", "--event", "x", "-m", mission, "--around", "5", "-o", tmp_path), 2, "a number with"),
        (("cut", "--event", "none", "-m", mission, "-o", tmp_path), 3, "There is no event none"),
        (("cut", "--event", "alone", "-m", empty, "-o", tmp_path), 3, "nothing was recorded then"),
        (("cut", "--event", "x", "-m", mission, "--start", "+1s", "-o", tmp_path), 2, "the events say what is cut"),
        (("cut", "drive.mcap", "--around", "5s", "-o", tmp_path / "x"), 2, "it requires --event"),
    ):
        assert text in klein(*arguments, code=code).stderr
    assert list(tmp_path.iterdir()) == []


def test_the_sdk_names_failures(client: Client, mission: str) -> None:
    events = client.mission_events
    made = events.add(mission, "handover", "+1s", labels=["a"], topic="/imu/data")
    assert events.count(mission=mission, name="handover", label="a") == 1
    changed = events.update(made, note="Given.", if_match=made.etag)
    with pytest.raises(EditConflict):
        events.update(made, note="Taken.", if_match=made.etag)
    with pytest.raises(InvalidRequest):
        events.update(made, end_ns=1)
    with pytest.raises(InvalidInput):
        events.add(mission, "handover", "+1s", colour="red")
    with pytest.raises(InvalidInput):
        client.cut_events([changed], around_s=-1)
    events.delete(changed)
    assert events.count(mission=mission, name="handover") == 0
