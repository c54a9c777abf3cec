"""Where missions were recorded: positions of previews and metadata, of what the actor may see."""

import itertools
import re
import uuid
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import psycopg
import pytest

import kleinkram
from kleinkram.contract.access import Right, Scope
from kleinkram.server.missions import positions
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.sample import Sample
from tests.integration.upload_client import wait_until

_WAITING = "SELECT count(*) FROM pg_locks WHERE NOT granted"

_FIELDS = """
fields:
  - {name: robot, type: string}
  - {name: depot, type: location}
  - {name: site, type: location}
"""


def _place(api: Api, file_id: str, latitude: float | None, longitude: float | None) -> None:
    """Put the row of a preview with a position, as the worker writes it."""
    api.sql(
        "INSERT INTO recording_preview (blob_id, key, state, version, size_bytes, latitude, longitude)"
        " SELECT blob_id, %s, 'ready', 1, 1, %s, %s FROM file WHERE id = %s",
        *(f"previews/{uuid.uuid4()}", latitude, longitude, file_id),
    )


def _positions(api: Api, **query: str) -> Any:
    return api.get("/mission-positions", query).ok()


def _places(answer: Any) -> dict[str, tuple[float, float, str]]:
    return {it["mission"]["id"]: (it["latitude"], it["longitude"], it["source"]) for it in answer["items"]}


def test_the_position_is_that_of_the_earliest_recording_that_has_one(api: Api, sample: Sample) -> None:
    project = api.project()
    mission = api.mission(project["id"])
    for number, place in enumerate([None, (47.1, 8.1), (47.2, 8.2)]):
        file_id = sample.file(mission["id"], f"{number}.mcap", start_ns=number * 10, end_ns=number * 10 + 5)
        if place is not None:
            _place(api, file_id, *place)
    other = sample.file(mission["id"], "no time.mcap")
    _place(api, other, 1.0, 2.0)
    answer = _positions(api, project_id=project["id"])
    assert _places(answer) == {mission["id"]: (47.1, 8.1, "recording")}
    assert answer["items"][0]["mission"]["name"] == mission["name"]
    assert answer["items"][0]["mission"]["project"] == {"id": project["id"], "name": project["name"]}
    assert (answer["unplaced_count"], answer["left_out_count"]) == (0, 0)


def test_files_have_the_position_of_the_preview_of_their_bytes(api: Api, sample: Sample) -> None:
    mission_id = api.mission(api.project()["id"])["id"]
    first = sample.file(mission_id, "first.mcap")
    _place(api, first, 47.1, 8.1)
    (blob_id,) = api.sql("SELECT blob_id FROM file WHERE id = %s", first)[0]
    sample.link(mission_id, "linked.mcap", str(blob_id))
    assert _positions_of_files(api, mission_id) == [(47.1, 8.1)] * 2
    api.sql("UPDATE recording_preview SET latitude = 47.2, longitude = 8.2 WHERE blob_id = %s", blob_id)
    assert _positions_of_files(api, mission_id) == [(47.2, 8.2)] * 2
    api.sql("DELETE FROM recording_preview WHERE blob_id = %s", blob_id)
    assert _positions_of_files(api, mission_id) == [(None, None)] * 2
    _place(api, first, None, None)
    assert _positions_of_files(api, mission_id) == [(None, None)] * 2


def test_a_file_that_is_added_while_its_position_is_stored_has_it(api: Api, sample: Sample) -> None:
    mission_id = api.mission(api.project()["id"])["id"]
    first = sample.file(mission_id, "first.mcap")
    _place(api, first, None, None)
    link = (
        "INSERT INTO file (id, mission_id, blob_id, path, path_key, origin, uploaded_by_id)"
        " SELECT gen_random_uuid(), mission_id, blob_id, 'b.mcap', 'b.mcap', origin, uploaded_by_id FROM file"
        " WHERE id = %s"
    )
    store = (
        "UPDATE recording_preview SET latitude = 47, longitude = 8"
        " WHERE blob_id = (SELECT blob_id FROM file WHERE id = %s)"
    )
    info = api.database.info
    with ThreadPoolExecutor(1) as pool, psycopg.connect(info.dsn, password=info.password) as adding:
        adding.execute(link, [first])
        storing = pool.submit(api.sql, store, first)
        wait_until(lambda: storing.done() or adding.execute(_WAITING).fetchone() != (0,))
        adding.commit()
        storing.result(30)
    assert _positions_of_files(api, mission_id) == [(47.0, 8.0)] * 2


def _positions_of_files(api: Api, mission_id: str) -> list[tuple[float | None, float | None]]:
    return api.sql("SELECT latitude, longitude FROM file WHERE mission_id = %s", mission_id)


def test_a_map_reads_one_entry_of_an_index_for_each_mission(api: Api) -> None:
    """Not their files, of which a map of 2,000 missions has a million, nor the previews of these."""
    with api.statements() as statements:
        _positions(api)
    (statement,) = [one for one in statements if "recorded.latitude" in one]
    numbers = itertools.count(1)
    statement = re.sub(r"%\(\w+\)s", lambda _: f"${next(numbers)}", statement)
    api.sql("SET enable_seqscan = off")
    plan = "\n".join(line for (line,) in api.sql(f"EXPLAIN (GENERIC_PLAN) {statement}"))
    api.sql("RESET enable_seqscan")
    assert "Index Only Scan using ix_file_position on file" in plan
    assert "recording_preview" not in plan


def test_files_in_the_trash_and_derived_files_place_nothing(api: Api, sample: Sample) -> None:
    project = api.project()
    mission = api.mission(project["id"])
    deleted, derived = (sample.file(mission["id"], name, start_ns=1, end_ns=2) for name in ("a.mcap", "b.mcap"))
    _place(api, deleted, 47.0, 8.0)
    _place(api, derived, 48.0, 9.0)
    api.sql("UPDATE file SET origin = 'run' WHERE id = %s", derived)
    assert _places(_positions(api, project_id=project["id"]))[mission["id"]][:2] == (47.0, 8.0)
    api.delete(f"/files/{deleted}").ok()
    answer = _positions(api, project_id=project["id"])
    assert (answer["items"], answer["unplaced_count"]) == ([], 1)


def test_the_metadata_places_a_mission_whose_recordings_do_not(api: Api, sample: Sample) -> None:
    project = api.project(fields_yaml=_FIELDS)
    site = "site: {latitude: 46.5, longitude: -7.25, name: Yard}"
    declared = api.mission(project["id"], metadata_yaml=f"depot: Zurich\n{site}\n")
    recorded = api.mission(project["id"], metadata_yaml=f"{site}\n")
    _place(api, sample.file(recorded["id"], "a.mcap"), 47.0, 8.0)
    api.mission(project["id"], metadata_yaml="depot: Zurich\n")
    undeclared = api.mission(project["id"], metadata_yaml="goal: {latitude: 1, longitude: 2}\n")
    answer = _positions(api, project_id=project["id"])
    assert _places(answer) == {declared["id"]: (46.5, -7.25, "metadata"), recorded["id"]: (47.0, 8.0, "recording")}
    assert undeclared["id"] not in _places(answer)
    assert answer["unplaced_count"] == 2


@pytest.mark.parametrize(
    "site",
    [
        '"Zurich"',
        "{}",
        "[47, 8]",
        '{"latitude": 91, "longitude": 8}',
        '{"latitude": 47, "longitude": -180.5}',
        '{"latitude": "47", "longitude": "8"}',
        '{"latitude": [47], "longitude": [8]}',
        '{"latitude": 47}',
        '{"latitude": 1e400, "longitude": 8}',
        '[{"latitude": 47, "longitude": 8}]',
    ],
)
def test_metadata_without_a_usable_location_places_nothing(api: Api, site: str) -> None:
    project = api.project(fields_yaml=_FIELDS)
    mission = api.mission(project["id"])
    # As where the fields of the project became stricter later.
    api.sql("UPDATE mission SET metadata = jsonb_build_object('site', %s::jsonb) WHERE id = %s", site, mission["id"])
    answer = _positions(api, project_id=project["id"])
    assert (answer["items"], answer["unplaced_count"]) == ([], 1)


def test_tiny_numbers_of_metadata_are_rounded(api: Api) -> None:
    project = api.project(fields_yaml=_FIELDS)
    mission = api.mission(project["id"])
    site = '{"latitude": 1e-400, "longitude": 8.123456789}'
    api.sql("UPDATE mission SET metadata = jsonb_build_object('site', %s::jsonb) WHERE id = %s", site, mission["id"])
    assert _places(_positions(api, project_id=project["id"])) == {mission["id"]: (0.0, 8.1234568, "metadata")}


@pytest.mark.parametrize(
    ("latitude", "longitude"),
    [(90.5, 0.0), (0.0, -181.0), (float("nan"), 8.0), (47.0, float("inf")), (47.0, None), (None, 8.0)],
)
def test_the_database_refuses_what_is_no_position(
    api: Api, sample: Sample, latitude: float | None, longitude: float | None
) -> None:
    file_id = sample.file(api.mission(api.project()["id"])["id"], "a.mcap")
    with pytest.raises(psycopg.errors.CheckViolation):
        _place(api, file_id, latitude, longitude)


def test_filters_and_queries_select_missions_as_in_lists(api: Api, sample: Sample) -> None:
    project = api.project()
    missions = {name: api.mission(project["id"], name=f"{name} {uuid.uuid4()}") for name in ("walk", "drive")}
    word = uuid.uuid4().hex
    for name, mission in missions.items():
        _place(api, sample.file(mission["id"], f"{word} {name}.mcap"), 47.0, 8.0)
    walk, drive = missions["walk"]["id"], missions["drive"]["id"]
    assert set(_places(_positions(api, project_id=project["id"], name="walk*"))) == {walk}
    assert set(_places(_positions(api, query=word))) == {walk, drive}
    assert set(_places(_positions(api, query=f"{word} path:*drive.mcap"))) == {drive}
    assert _positions(api, query=f"{word}-nowhere") == {"items": [], "unplaced_count": 0, "left_out_count": 0}
    api.get("/mission-positions", {"query": "size>much"}).refused(422, "invalid_query")
    api.get("/mission-positions", {"where": "=="}).refused(422, "invalid_query")


def test_only_visible_missions_and_shown_files_have_positions(api: Api, sample: Sample) -> None:
    project = api.project(fields_yaml=_FIELDS)
    site = "site: {latitude: 46.5, longitude: 7.5}\n"
    seen, hidden = (api.mission(project["id"], metadata_yaml=site) for _ in range(2))
    first, second = (sample.file(seen["id"], f"{number}.mcap", start_ns=number, end_ns=9) for number in (1, 2))
    _place(api, first, 47.1, 8.1)
    _place(api, second, 47.2, 8.2)
    _place(api, sample.file(hidden["id"], "a.mcap"), 1.0, 2.0)

    stranger = people.person(api)
    assert _positions(api.as_(stranger.token), project_id=project["id"])["items"] == []
    assert _positions(api.as_(None), project_id=project["id"])["items"] == []

    reader = people.person(api)
    people.grant(api, reader.group_id, Right.read, mission_id=seen["id"])
    answer = _positions(api.as_(reader.token), project_id=project["id"])
    assert _places(answer) == {seen["id"]: (47.1, 8.1, "recording")}
    assert (answer["unplaced_count"], answer["left_out_count"]) == (0, 0)

    whole = api.as_(people.share(api, seen["id"]).secret)
    assert _places(_positions(whole)) == {seen["id"]: (47.1, 8.1, "recording")}
    one_file = api.as_(people.share(api, seen["id"], file_ids=[second]).secret)
    assert _places(_positions(one_file)) == {seen["id"]: (47.2, 8.2, "recording")}
    api.sql(
        "DELETE FROM recording_preview WHERE blob_id IN (SELECT blob_id FROM file WHERE mission_id = %s)", seen["id"]
    )
    assert _places(_positions(whole)) == {seen["id"]: (46.5, 7.5, "metadata")}
    assert _positions(one_file)["items"] == [], "a link to some files shows no metadata"

    uploader = people.token(api, reader.id, scopes=[Scope.upload])
    api.as_(uploader.secret).get("/mission-positions").refused(403, "scope_missing")


def test_a_map_has_the_latest_missions_and_says_how_many_are_left_out(
    api: Api, sample: Sample, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(positions, "MAX_PLACED_MISSIONS", 3)
    monkeypatch.setattr("kleinkram.server.filters.plan._built", {})
    project = api.project()
    missions = [api.mission(project["id"]) for _ in range(5)]
    for number, mission in enumerate(missions):
        api.sql("UPDATE mission SET start_ns = %s, end_ns = %s WHERE id = %s", number + 1, number + 2, mission["id"])
    for mission in missions[:4]:
        _place(api, sample.file(mission["id"], "a.mcap"), 47.0, 8.0)
    answer = _positions(api, project_id=project["id"])
    assert [it["mission"]["id"] for it in answer["items"]] == [missions[3]["id"], missions[2]["id"]]
    assert (answer["unplaced_count"], answer["left_out_count"]) == (1, 2)


def test_the_sdk_returns_positions(api: Api, sample: Sample) -> None:
    project = api.project()
    mission = api.mission(project["id"])
    _place(api, sample.file(mission["id"], "a.mcap"), -33.5, 151.25)
    api.mission(project["id"])
    with kleinkram.connect(api.url, api.token) as client:
        answer = client.missions.positions(project=project["name"])
        (only,) = answer.items
        assert (str(only.mission.id), only.latitude, only.longitude) == (mission["id"], -33.5, 151.25)
        assert (only.source.value, answer.unplaced_count) == ("recording", 1)
        assert client.missions.positions(query=f'project:"{project["name"]}"').items == [only]
