"""The filters of the lists."""

import base64
import datetime
import itertools
import json
import uuid
from typing import Any

import pytest

from kleinkram.contract.access import Right
from kleinkram.server.files import service as files_service
from kleinkram.server.filters import plan as search_plan
from tests.integration import people
from tests.integration.api_server import Api, Query
from tests.integration.sample import Sample

DAY_NS = 86_400 * 10**9
IMU = {"message_type": "sensor_msgs/msg/Imu", "count": 200}
IMAGE = {"message_type": "sensor_msgs/msg/Image", "count": 10}
# Of so many visible missions, a list sorts all files.
_MAX_SORTED = files_service._MAX_SORTED_MISSIONS


@pytest.fixture(scope="module")
def project(api: Api, sample: Sample) -> Any:
    made = api.project(name=f"Filters {uuid.uuid4()}")
    alps = api.mission(made["id"], name="Alps", notes="It rained on 50% of the way", metadata_yaml="who: Ada\n")
    lake = api.mission(made["id"], name="Lake", metadata_yaml="a: {b: [Grace]}\n")
    sample.file(
        alps["id"],
        "Bags/front.mcap",
        size_bytes=10,
        start_ns=1 * DAY_NS,
        end_ns=2 * DAY_NS,
        labels=("night",),
        topics=[{"name": "/cam/front", **IMAGE}, {"name": "/imu", **IMU}],
    )
    sample.file(alps["id"], "notes_1.txt", size_bytes=20, format=None, content="opaque", labels=("night", "wet"))
    verified: dict[str, Any] = {
        "state": "verified",
        "md5": bytes(16),
        "verified_at": datetime.datetime.now(datetime.timezone.utc),
    }
    sample.file(
        lake["id"],
        "rear.bag",
        size_bytes=30,
        start_ns=4 * DAY_NS,
        end_ns=5 * DAY_NS,
        format="rosbag1",
        topics=[{"name": "/cam/rear", **IMAGE}, {"name": "/odd", "message_type": None}],
        **verified,
    )
    api.sql("UPDATE mission SET start_ns = %s, end_ns = %s WHERE id = %s", DAY_NS, 2 * DAY_NS, alps["id"])
    api.patch(f"/missions/{lake['id']}", {"completed": True}).ok()
    return made


def _files(api: Api, project: Any, query: Query) -> str:
    pairs = list(query.items()) if isinstance(query, dict) else list(query)
    items = api.get("/files", [("project_id", project["id"]), *pairs]).ok()["items"]
    return " ".join(item["path"] for item in items)


FRONT, NOTES, REAR = "Bags/front.mcap", "notes_1.txt", "rear.bag"


@pytest.mark.parametrize(
    ("query", "result"),
    [
        ({}, [FRONT, NOTES, REAR]),
        ({"mission": "alps"}, [FRONT, NOTES]),
        ({"mission": "?ake"}, [REAR]),
        ({"path": "bags/FRONT.mcap"}, [FRONT]),
        ({"path": "*.mcap"}, [FRONT]),
        ({"path": "notes?1.txt"}, [NOTES]),
        ({"path": "front.mcap"}, []),
        ([("path", "*.mcap"), ("path", "rear*")], [FRONT, REAR]),
        ({"topic": "/imu"}, [FRONT]),
        ({"topic": "/cam/*"}, [FRONT, REAR]),
        ({"topic": "/CAM/*"}, []),
        ({"message_type": "*/Image"}, [FRONT, REAR]),
        ({"topic": "/imu", "message_type": "*/Image"}, []),
        ([("topic", "/imu"), ("topic", "/cam/rear")], [FRONT, REAR]),
        ({"format": "rosbag1"}, [REAR]),
        ({"label": "night"}, [FRONT, NOTES]),
        ([("label", "wet"), ("label", "dry")], [NOTES]),
        ({"state": "verified"}, [REAR]),
        ({"content": "opaque"}, [NOTES]),
        ({"min_size_bytes": "20"}, [NOTES, REAR]),
        ({"max_size_bytes": "20", "min_size_bytes": "11"}, [NOTES]),
        ({"recorded_after": "1970-01-04"}, [REAR]),
        ({"recorded_after": "1970-01-04T00:00:00"}, [REAR]),
        ({"recorded_before": "1970-01-03T02:00:00+02:00"}, [FRONT]),
        ({"recorded_after": "1970-01-03T12:00:00Z", "recorded_before": "1970-01-04T12:00:00Z"}, []),
        ({"recorded_after": "9999-12-31T00:00:00Z"}, []),
        ({"text": "ada"}, [FRONT, NOTES]),
        ({"text": "GRACE"}, [REAR]),
        ({"text": "who"}, []),
        ({"text": "alps imu"}, [FRONT]),
        ({"text": "wet"}, [NOTES]),
        ({"text": "50%"}, [FRONT, NOTES]),
        ({"text": "5_%"}, []),
    ],
)
def test_files(api: Api, project: Any, query: Query, result: list[str]) -> None:
    assert _files(api, project, query) == " ".join(result)


@pytest.mark.parametrize(
    ("query", "result"),
    [
        ({}, "Alps Lake"),
        ({"name": "ALPS"}, "Alps"),
        ({"name": "*"}, "Alps Lake"),
        ({"topic": "/imu"}, "Alps"),
        ({"topic": "/odd"}, "Lake"),
        ({"message_type": "sensor_msgs/msg/*"}, "Alps Lake"),
        ({"recorded_before": "1970-01-10"}, "Alps"),
        ({"completed": "true"}, "Lake"),
        ({"completed": "false"}, "Alps"),
        ({"satisfied": "true"}, "Alps Lake"),
        ({"text": "rained ada"}, "Alps"),
        ({"text": "filters lake"}, "Lake"),
        ({"text": "imu"}, ""),
    ],
)
def test_missions(api: Api, project: Any, query: dict[str, str], result: str) -> None:
    items = api.all("/missions", {"project_id": project["id"], **query})
    assert " ".join(item["name"] for item in items) == result


@pytest.mark.parametrize("by", ["project_id", "project"])
def test_missions_are_counted_within_their_project(api: Api, by: str) -> None:
    some, many = api.project(), api.project()
    for project in (some, many, many, many):
        api.mission(project["id"])
    reader = people.person(api)
    for project in (some, many):
        people.grant(api, reader, Right.read, project_id=project["id"])
    for who in (api, api.as_(reader.token)):
        for project, count in ((some, 1), (many, 3)):
            expected = {by: project["id"] if by == "project_id" else project["name"], "count": "true", "limit": "1"}
            assert who.get("/missions", expected).ok()["total"] == count


def test_a_project_is_selected_by_name_or_pattern(api: Api, project: Any) -> None:
    assert len(api.all("/files", {"project": project["name"].upper()})) == 3
    assert len(api.all("/files", {"project": project["name"][:20] + "*"})) == 3
    assert api.all("/missions", {"project": project["name"] + "x"}) == []


@pytest.mark.parametrize(
    ("sort", "result"),
    [
        ("path", [FRONT, NOTES, REAR]),
        ("-path", [REAR, NOTES, FRONT]),
        ("created", [FRONT, NOTES, REAR]),
        ("-created", [REAR, NOTES, FRONT]),
        ("size", [FRONT, NOTES, REAR]),
        ("-size", [REAR, NOTES, FRONT]),
        ("start", [FRONT, REAR, NOTES]),
        ("-start", [REAR, FRONT, NOTES]),
    ],
)
def test_files_sort_page_by_page(api: Api, project: Any, sort: str, result: list[str]) -> None:
    listed = api.all("/files", {"project_id": project["id"], "sort": sort, "limit": "1"})
    assert [item["path"] for item in listed] == result


def test_files_are_counted_on_request(api: Api, project: Any) -> None:
    query = {"project_id": project["id"], "count": "true", "limit": "2", "label": "night"}
    assert api.get("/files", query).ok()["total"] == 2


@pytest.mark.parametrize(
    "query",
    [
        {"limit": "0"},
        {"limit": "501"},
        {"sort": "colour"},
        {"min_size_bytes": "-1"},
        {"max_size_bytes": str(2**63)},
        {"recorded_after": "yesterday"},
        {"state": "fine"},
        {"colour": "red"},
        {"mission_id": "x"},
    ],
)
def test_a_wrong_filter_is_named(api: Api, query: dict[str, str]) -> None:
    problem = api.get("/files", query).refused(422, "invalid_request")
    assert [one["field"].split(".")[:2] for one in problem["problems"]] == [["query", next(iter(query))]]


def test_pages_are_stable_while_files_come_and_go(api: Api, sample: Sample) -> None:
    mission = api.mission(api.project()["id"])["id"]
    ids = {name: sample.file(mission, name) for name in "bdfh"}
    query = {"mission_id": mission, "limit": "2"}
    first = api.get("/files", query).ok()
    for name in "ag":
        sample.file(mission, name)
    api.patch(f"/files/{ids['d']}", {"path": "z"}).ok()
    second = api.get("/files", {**query, "cursor": first["next"]}).ok()
    assert [item["path"] for item in first["items"] + second["items"]] == ["b", "d", "f", "g"]


@pytest.mark.parametrize("value", ["sa\x00b", "s\ud800", "i5", f"u{uuid.UUID(int=5)}", "d2024-01-01"])
@pytest.mark.parametrize("place", [1, 2, 3, 4])
@pytest.mark.parametrize("sort", ["path", "-path"])
def test_a_forged_cursor_of_files_by_path_is_refused_or_leads_nowhere_else(
    api: Api, project: Any, sort: str, place: int, value: str
) -> None:
    query = {"project_id": project["id"], "sort": sort, "limit": "1"}
    result = {one["id"] for one in api.all("/files", query)}
    real = api.get("/files", query).ok()["next"]
    shown = json.loads(base64.urlsafe_b64decode(real + "=" * (-len(real) % 4)))
    shown[place] = value
    answer = api.get("/files", {**query, "cursor": base64.urlsafe_b64encode(json.dumps(shown).encode()).decode()})
    if answer.status != 200:
        answer.refused(422, "invalid_cursor")
    else:
        assert {one["id"] for one in answer.ok()["items"]} <= result


def test_a_list_of_files_takes_the_same_number_of_queries_however_long(api: Api, sample: Sample) -> None:
    mission = api.mission(api.project()["id"])["id"]
    api.get(f"/missions/{mission}").ok()  # so that an admin's look is noted already
    counts = []
    for number in range(3):
        sample.file(mission, f"{number}.mcap", topics=[{"name": "/a"}])
        with api.statements() as statements:
            assert len(api.get("/files", {"mission_id": mission}).ok()["items"]) == number + 1
        counts.append(len(statements))
    assert counts == [2, 2, 2]


def test_a_person_with_several_missions_finds_what_an_admin_finds_in_them(
    api: Api, sample: Sample, project: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The statements on files name those missions; those of someone who sees many do not."""
    monkeypatch.setattr(search_plan, "MAX_VISIBLE_MISSIONS", _MAX_SORTED)
    reader, many = people.person(api), people.person(api)
    missions = [item["id"] for item in api.all("/missions", {"project_id": project["id"]})]
    for mission_id in missions:
        people.grant(api, reader, Right.read, mission_id=mission_id)
    people.grant(api, many, Right.read, project_id=project["id"])
    crowd = api.project()["id"]
    people.grant(api, many, Right.read, project_id=crowd)
    for number in range(_MAX_SORTED):
        sample.file(api.mission(crowd)["id"], f"{number}.txt")
    for person in (reader, many):
        theirs = api.as_(person.token)
        for sort in ("start", "-start", "created", "-size", "path"):
            query = {"project_id": project["id"], "sort": sort, "limit": "2"}
            assert _ids(theirs.all("/files", query)) == _ids(api.all("/files", query))
        for path in ("/stats", "/topics"):
            query = {"project_id": project["id"], **({} if path == "/stats" else {"count": "true"})}
            assert theirs.get(path, query).ok() == api.get(path, query).ok()
        text = {"query": f'project:"{project["name"]}"'}
        # All but the first: the projects to choose from are those that one sees.
        own, all_ = (entry.get("/search/facets", text).ok()["facets"][1:] for entry in (theirs, api))
        assert own == all_
    assert set(_statements_naming_missions(api, reader.token)) == {True}, "each statement on files names the missions"
    assert set(_statements_naming_missions(api, many.token)) == {False}


def test_lists_by_label_name_the_visible_missions_up_to_the_limit_of_searches(
    api: Api, sample: Sample, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Other lists of this person are read in the order of an index, since their conditions may hold for most files."""
    reader, crowd = people.person(api), api.project()["id"]
    people.grant(api, reader, Right.read, project_id=crowd)
    ids = []
    for number in range(_MAX_SORTED + 1):
        mission = api.mission(crowd)["id"]
        ids += [sample.file(mission, f"{number}.txt", labels=("night",) if number % 2 else ())]
    theirs = api.as_(reader.token)
    for query, result, is_named in (
        ({"label": "night"}, ids[1::2], True),
        ({"label": "night", "sort": "path"}, ids[1::2], True),
        ({"label": "night", "sort": "created", "limit": "3", "count": "true"}, ids[1::2], True),
        ({"sort": "created"}, ids, False),
        ({"path": "*.txt", "sort": "created"}, ids, False),
    ):
        with api.statements() as statements:
            assert sorted(_ids(theirs.all("/files", {"project_id": crowd, **query}))) == sorted(result)
        listed = [entry for entry in statements if "JOIN mission ON" in entry and "FROM file" in entry]
        assert listed, query
        assert {"file.mission_id = ANY" in entry for entry in listed} == {is_named}, query

    monkeypatch.setattr(search_plan, "MAX_VISIBLE_MISSIONS", _MAX_SORTED)
    by_label = {"project_id": crowd, "label": "night"}
    with api.statements() as statements:
        assert sorted(_ids(theirs.all("/files", {**by_label, "sort": "created"}))) == sorted(ids[1::2])
    listed = [entry for entry in statements if "JOIN mission ON" in entry and "FROM file" in entry]
    assert {"file.mission_id = ANY" in entry for entry in listed} == {False}


@pytest.mark.parametrize("sort", ["start", "-start", "-created", "size"])
def test_a_list_continues_when_the_number_of_visible_missions_changes(
    api: Api, sample: Sample, monkeypatch: pytest.MonkeyPatch, sort: str
) -> None:
    mission = api.mission(api.project()["id"])["id"]
    ids = [sample.file(mission, f"{number}.txt", size_bytes=number) for number in range(5)]
    ids += [sample.file(mission, f"{number}.bag", start_ns=number, end_ns=number) for number in range(2)]
    reader = people.person(api)
    people.grant(api, reader, Right.read, mission_id=mission)
    theirs, result, query = api.as_(reader.token), list[str](), {"sort": sort, "limit": "1"}
    for most in itertools.cycle((_MAX_SORTED, 0)):
        monkeypatch.setattr(search_plan, "MAX_VISIBLE_MISSIONS", most)
        page = theirs.get("/files", query).ok()
        result += _ids(page["items"])
        if page["next"] is None:
            break
        query["cursor"] = page["next"]
    assert result == _ids(api.all("/files", {"sort": sort, "mission_id": mission}))
    assert sorted(result) == sorted(ids)


def test_both_execution_plans_find_the_same_files(api: Api, sample: Sample, monkeypatch: pytest.MonkeyPatch) -> None:
    missions = [api.mission(api.project()["id"])["id"] for _ in range(3)]
    ids = [sample.file(mission, "a.mcap") for mission in missions]
    reader = people.person(api)
    for mission in missions:
        people.grant(api, reader, Right.read, mission_id=mission)
    for most in (0, _MAX_SORTED):
        monkeypatch.setattr(search_plan, "MAX_VISIBLE_MISSIONS", most)
        assert sorted(_ids(api.as_(reader.token).all("/files", {"sort": "created"}))) == sorted(ids)


def test_granting_and_revoking_takes_effect_at_once_with_several_visible_missions(api: Api, sample: Sample) -> None:
    first, second = (api.mission(api.project()["id"])["id"] for _ in range(2))
    ids = [sample.file(mission, "a.mcap") for mission in (first, second)]
    reader = people.person(api)
    theirs = api.as_(reader.token)
    assert theirs.get("/files", {"count": "true"}).ok()["total"] == 0
    people.grant(api, reader, Right.read, mission_id=first)
    assert _ids(theirs.all("/files", {})) == ids[:1]
    people.grant(api, reader, Right.read, mission_id=second)
    assert sorted(_ids(theirs.all("/files", {}))) == sorted(ids)
    api.sql("DELETE FROM access_grant WHERE mission_id = %s AND group_id = %s", first, reader.group_id)
    assert _ids(theirs.all("/files", {})) == ids[1:]


def _ids(rows: list[dict[str, Any]]) -> list[str]:
    return [row["id"] for row in rows]


def _statements_naming_missions(api: Api, token: str) -> list[bool]:
    with api.statements() as statements:
        api.as_(token).get("/search", {"query": ""}).ok()
        api.as_(token).get("/search/facets", {"query": ""}).ok()
    return [
        "file.mission_id = ANY" in entry for entry in statements if "JOIN mission ON" in entry and "FROM file" in entry
    ]


def test_topics_are_found_across_files(api: Api, project: Any, sample: Sample) -> None:
    rows = api.all("/topics", {"project_id": project["id"], "limit": "2"})
    assert [row["name"] for row in rows] == ["/cam/front", "/cam/rear", "/imu", "/odd"]
    narrowed = api.get("/topics", {"project_id": project["id"], "message_type": "*Image", "count": "true"}).ok()
    assert ([row["name"] for row in narrowed["items"]], narrowed["total"]) == (["/cam/front", "/cam/rear"], 2)
    assert [row["count"] for row in api.all("/topics", {"project_id": project["id"], "topic": "/imu"})] == [200]


def test_a_blob_in_two_files_shows_its_topics_in_both(api: Api, sample: Sample) -> None:
    mission = api.mission(api.project()["id"])["id"]
    first = sample.file(mission, "a.mcap", topics=[{"name": "/a"}, {"name": "/b"}])
    ((blob_id,),) = api.sql("SELECT blob_id FROM file WHERE id = %s", first)
    second = sample.link(mission, "b.mcap", str(blob_id))
    rows = api.all("/topics", {"mission_id": mission, "limit": "1"})
    assert [row["name"] for row in rows] == ["/a", "/a", "/b", "/b"]
    assert {row["file_id"] for row in rows} == {first, second}
