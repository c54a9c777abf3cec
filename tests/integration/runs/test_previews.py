"""Previews of missions: what the latest runs made of them, and the first pictures of lists."""

import uuid
from pathlib import Path
from typing import Any

import pytest

import kleinkram
from kleinkram.contract.access import Right
from kleinkram.contract.previews import MAX_LISTED_PICTURE_BYTES
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.runs.conftest import FakeRunner, Place, launch
from tests.integration.runs.test_automatic_runs import publish
from tests.integration.upload_client import fetch, upload

SHEET = {"path": "sheet.PNG", "title": "Contact sheet"}
TRACK = {"path": "where/track.geojson"}
TABLE = {"path": "table.csv", "title": "Topics"}


def finish(runner: FakeRunner, *previews: dict[str, str], reason: str = "done") -> str:
    """Execute the next run: it makes these previews, each with its own path as bytes; return its id."""
    claim = runner.claim()
    if previews:
        runner.upload_artifacts(claim, {preview["path"]: preview["path"].encode() for preview in previews})
    runner.finish(claim, reason, report={"previews": [*previews]}, image_digest="sha256:stock").ok()
    return str(claim["run_id"])


def listed(api: Api, place: Place) -> list[tuple[str, str]]:
    """Return actions and paths of the previews of the mission."""
    answer = api.get(f"/missions/{place.mission['id']}/previews").ok()
    return [(item["action"]["name"], item["path"]) for item in answer["items"]]


def outdated(api: Api, place: Place) -> set[bool]:
    """Return whether the previews of the mission are outdated."""
    return {item["outdated"] for item in api.get(f"/missions/{place.mission['id']}/previews").ok()["items"]}


def pictures(api: Api, *missions: Any) -> list[Any]:
    """Return the first pictures of missions."""
    return list(api.post("/missions/pictures", {"mission_ids": [one["id"] for one in missions]}).ok()["items"])


def test_previews_of_the_action_preview_come_first_then_the_latest(lab: Api, runner: FakeRunner, place: Place) -> None:
    run_ids = {}
    for name, previews in (("preview", (SHEET, TABLE)), ("slam", (TRACK,)), ("stats", (TABLE,)), ("nothing", ())):
        launch(lab, runner, place.mission, name=name)
        run_ids[name] = finish(runner, *previews)
    assert listed(lab, place) == [
        ("preview", "sheet.PNG"),
        ("preview", "table.csv"),
        ("stats", "table.csv"),
        ("slam", "where/track.geojson"),
    ]
    sheet, table, _, track = lab.get(f"/missions/{place.mission['id']}/previews").ok()["items"]
    assert (sheet["title"], sheet["kind"], sheet["size_bytes"]) == ("Contact sheet", "picture", len(SHEET["path"]))
    assert (table["kind"], track["kind"], track["title"], track["outdated"]) == ("table", "track", "", False)
    run = lab.get(f"/runs/{run_ids['preview']}").ok()
    assert (sheet["run_id"], sheet["made_at"]) == (run["id"], run["ended_at"])
    body = {"artifact_ids": [sheet["artifact_id"]], "purpose": "preview"}
    (link,) = lab.post(f"/runs/{run['id']}/artifacts/download", body).ok()["items"]
    assert fetch(link["url"])[1] == b"sheet.PNG"
    assert "run.preview" in [event["operation"] for event in lab.events(run["id"])]


def test_only_the_latest_run_of_an_action_that_is_done_and_has_previews_counts(
    lab: Api, runner: FakeRunner, place: Place
) -> None:
    launch(lab, runner, place.mission, name="look", script="print('first')\n")
    finish(runner, TABLE)
    launch(lab, runner, place.mission, name="look", script="print('second')\n")
    second = finish(runner, SHEET)
    launch(lab, runner, place.mission, name="look")
    finish(runner, TRACK, reason="exit_code")
    launch(lab, runner, place.mission, name="look")
    finish(runner)
    launch(lab, runner, place.mission, name="look")
    (item,) = lab.get(f"/missions/{place.mission['id']}/previews").ok()["items"]
    assert (item["run_id"], item["path"]) == (second, "sheet.PNG")
    runner.finish(runner.claim()).ok()


def test_a_run_that_reuses_results_shows_those_of_the_earlier_one(lab: Api, runner: FakeRunner, place: Place) -> None:
    launch(lab, runner, place.mission, name="look", script="print(1)\n")
    made = finish(runner, SHEET)
    launch(lab, runner, place.mission, name="look", script="print(2)\n")
    finish(runner, TABLE)
    reusing = launch(lab, runner, place.mission, name="look", script="print(1)\n", force=False)
    assert reusing["reuses_id"] == made
    (item,) = lab.get(f"/missions/{place.mission['id']}/previews").ok()["items"]
    assert (item["run_id"], item["path"], item["outdated"]) == (made, "sheet.PNG", False)
    (picture,) = pictures(lab, place.mission)
    assert (picture["run_id"], fetch(picture["url"])[1]) == (made, b"sheet.PNG")


def test_previews_are_outdated_once_the_files_that_the_action_reads_have_changed(
    lab: Api, runner: FakeRunner, place: Place
) -> None:
    parameters = [{"name": "scale", "type": "number"}]
    launch(lab, runner, place.mission, inputs={"paths": ["*.bin"]}, parameters=parameters, given={"scale": 1e20})
    finish(runner, SHEET)
    assert outdated(lab, place) == {False}
    upload(lab, place.mission["id"], "notes/evening.txt", b"not an input")
    assert outdated(lab, place) == {False}
    extra = upload(lab, place.mission["id"], "more.bin", b"an input")
    assert outdated(lab, place) == {True}
    lab.delete(f"/files/{extra['id']}").ok()
    assert outdated(lab, place) == {False}
    lab.delete(f"/files/{place.files['drive.bin']['id']}").ok()
    assert outdated(lab, place) == {True}
    (item,) = pictures(lab, place.mission)
    assert item["path"] == "sheet.PNG", "an outdated picture is better than none"


def test_previews_are_outdated_once_metadata_that_the_action_declares_has_changed(
    lab: Api, runner: FakeRunner, place: Place
) -> None:
    launch(lab, runner, place.mission, inputs={"metadata": ["robot"]})
    finish(runner, SHEET)
    lab.patch(f"/missions/{place.mission['id']}", {"metadata": {"weather": "rain"}}).ok()
    assert outdated(lab, place) == {False}
    lab.patch(f"/missions/{place.mission['id']}", {"metadata": {"robot": "spot"}}).ok()
    assert outdated(lab, place) == {True}


def test_previews_of_an_archived_action_stay_until_one_of_its_name_has_some(
    lab: Api, runner: FakeRunner, place: Place
) -> None:
    action = publish(lab, runner, place.project)
    lab.post("/runs", {"mission_ids": [place.mission["id"]], "action_id": action["id"]}).ok()
    finish(runner, SHEET)
    lab.patch(f"/actions/{action['id']}", {"archived": True}).ok()
    assert listed(lab, place) == [(action["name"], "sheet.PNG")]
    launch(lab, runner, place.mission, name=action["name"])
    finish(runner, TABLE)
    assert listed(lab, place) == [(action["name"], "table.csv")]


def test_previews_are_shown_to_readers_only(lab: Api, runner: FakeRunner, place: Place) -> None:
    launch(lab, runner, place.mission)
    finish(runner, SHEET)
    path = f"/missions/{place.mission['id']}/previews"
    reader, stranger = people.person(lab), people.person(lab)
    people.grant(lab, reader, Right.read, mission_id=place.mission["id"])
    by_reader, by_stranger = lab.as_(reader.token), lab.as_(stranger.token)
    assert len(by_reader.get(path).ok()["items"]) == 1
    assert len(pictures(by_reader, place.mission)) == 1
    by_stranger.get(path).refused(404, "not_found")
    assert pictures(by_stranger, place.mission) == []
    body = {"mission_ids": [place.mission["id"]]}
    lab.patch(f"/projects/{place.project['id']}", {"is_public": True}).ok()
    link = lab.as_(people.share(lab, place.mission["id"]).secret)
    for guest, status, code in ((link, 403, "scope_missing"), (lab.as_(None), 401, "not_authenticated")):
        guest.get(path).refused(status, code)
        guest.post("/missions/pictures", body).refused(status, code)


def test_a_mission_in_the_trash_has_no_previews(lab: Api, runner: FakeRunner, place: Place) -> None:
    launch(lab, runner, place.mission)
    finish(runner, SHEET)
    lab.delete(f"/missions/{place.mission['id']}").ok()
    lab.get(f"/missions/{place.mission['id']}/previews").refused(404, "not_found")
    assert pictures(lab, place.mission) == []


def test_a_mission_that_moves_to_a_hidden_project_takes_its_previews_along(
    lab: Api, runner: FakeRunner, place: Place
) -> None:
    launch(lab, runner, place.mission)
    finish(runner, SHEET)
    reader = people.person(lab)
    people.grant(lab, reader, Right.read, project_id=place.project["id"])
    by_reader = lab.as_(reader.token)
    assert len(pictures(by_reader, place.mission)) == 1
    lab.patch(f"/missions/{place.mission['id']}", {"project_id": lab.project()["id"]}).ok()
    by_reader.get(f"/missions/{place.mission['id']}/previews").refused(404, "not_found")
    assert pictures(by_reader, place.mission) == []
    assert listed(lab, place) == [("count", "sheet.PNG")]


def test_lists_show_the_first_picture_that_is_readable_and_not_too_large(
    lab: Api, runner: FakeRunner, place: Place
) -> None:
    launch(lab, runner, place.mission, name="preview")
    finish(runner, TABLE, {"path": "large.png"}, {"path": "lost.svg"}, {"path": "small.jpeg", "title": "Small"})
    launch(lab, runner, place.mission, name="later")
    finish(runner, {"path": "later.png"})
    change = "UPDATE blob SET {} FROM run_artifact WHERE blob_id = blob.id AND path = %s"
    lab.sql(change.format(f"size_bytes = {MAX_LISTED_PICTURE_BYTES + 1}"), "large.png")
    lab.sql(change.format("state = 'lost'"), "lost.svg")
    (picture,) = pictures(lab, place.mission)
    assert (picture["path"], picture["title"]) == ("small.jpeg", "Small")
    assert [path for _, path in listed(lab, place)] == ["table.csv", "large.png", "small.jpeg", "later.png"]


def test_pictures_of_many_missions_take_three_statements_and_are_recorded(
    lab: Api, runner: FakeRunner, place: Place
) -> None:
    missions = [place.mission, *(lab.mission(place.project["id"]) for _ in range(3))]
    for mission in missions[1:]:
        upload(lab, mission["id"], "drive.bin", uuid.uuid4().bytes)
    for mission in missions[:3]:
        for name in ("preview", "slam"):
            launch(lab, runner, mission, name=name)
            finish(runner, SHEET, TABLE)
    person = people.person(lab)
    people.grant(lab, person, Right.read, project_id=place.project["id"])
    api = lab.as_(person.token)
    with api.statements() as statements:
        listed_pictures = pictures(api, *missions)
    tables = ("run_artifact", "recording_preview", "audit_event")
    own = [statement for statement in statements if any(table in statement for table in tables)]
    assert len(own) == 3
    assert {item["mission_id"] for item in listed_pictures} == {mission["id"] for mission in missions[:3]}
    (event,) = [event for event in lab.events(place.project["id"]) if event["operation"] == "project.preview"]
    assert (event["actor"]["id"], event["after"]) == (person.id, {"missions": 3})


def test_at_most_100_previews_are_listed(lab: Api, runner: FakeRunner, place: Place) -> None:
    for name in ("one", "two"):
        launch(lab, runner, place.mission, name=name)
        finish(runner, *({"path": f"{number:03}.png"} for number in range(60)))
    answer = lab.get(f"/missions/{place.mission['id']}/previews").ok()
    assert (len(answer["items"]), answer["truncated"]) == (100, True)
    assert answer["items"][0]["path"] == "000.png"


@pytest.mark.parametrize("mission_ids", [[], [str(uuid.UUID(int=number)) for number in range(201)]])
def test_pictures_are_requested_of_1_to_200_missions(lab: Api, mission_ids: list[str]) -> None:
    lab.post("/missions/pictures", {"mission_ids": mission_ids}).refused(422, "invalid_request")


def test_the_sdk_lists_and_downloads_previews(lab: Api, runner: FakeRunner, place: Place, tmp_path: Path) -> None:
    for name, preview in (("preview", SHEET), ("slam", TRACK)):
        launch(lab, runner, place.mission, name=name)
        finish(runner, preview)
    with kleinkram.connect(lab.url, lab.token) as client:
        previews = client.missions.previews(place.mission["id"])
        assert [(preview.path, preview.kind.value) for preview in previews] == [
            ("sheet.PNG", "picture"),
            ("where/track.geojson", "track"),
        ]
        report = client.runs.download_previews(previews, tmp_path)
    assert report.left_out == []
    assert (tmp_path / "preview" / "sheet.PNG").read_bytes() == b"sheet.PNG"
    assert (tmp_path / "slam" / "where" / "track.geojson").read_bytes() == b"where/track.geojson"
