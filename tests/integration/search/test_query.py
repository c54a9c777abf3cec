"""Full-text queries for missions, files and topics, and the facets of their results."""

import json
import uuid
from typing import Any

import pytest

from kleinkram.contract.access import Right
from kleinkram.server.filters.plan import MAX_WORDS
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.conftest import StartApi
from tests.integration.sample import Sample

DAY_NS = 86_400 * 10**9
MINUTE_NS = 60 * 10**9
IMU = {"message_type": "sensor_msgs/msg/Imu", "count": 200}
IMAGE = {"message_type": "sensor_msgs/msg/Image", "count": 10}
FRONT, LOG, REAR = "bags/front.mcap", "log.txt", "rear.bag"


@pytest.fixture(scope="module")
def lab(start_api: StartApi) -> Api:
    """An API with three missions of two projects; nothing else is in it."""
    api = start_api()
    sample = Sample(api)
    hills, town = (api.project(name=name)["id"] for name in ("Green hills", "Town"))
    alps = api.mission(
        hills, name="Alps", notes="It rained", metadata_yaml="robot: anymal\nspeed: 3\nsite: Zürich HB\n"
    )["id"]
    api.mission(hills, name="Alps, empty", metadata_yaml="robot: spot\n")
    lake = api.mission(town, name="Lake", metadata_yaml="robot: spot\ncode: '3'\ntags: [wet, cold]\n")["id"]
    sample.file(
        alps,
        FRONT,
        size_bytes=2_000_000_000,
        start_ns=20_000 * DAY_NS,
        end_ns=20_000 * DAY_NS + 20 * MINUTE_NS,
        labels=("night",),
        topics=[{"name": "/cam/front", **IMAGE}, {"name": "/imu", **IMU}],
    )
    sample.file(alps, LOG, size_bytes=20, format=None, content="opaque", labels=("night", "wet"))
    sample.file(
        lake,
        REAR,
        size_bytes=30_000,
        start_ns=20_040 * DAY_NS,
        end_ns=20_040 * DAY_NS + MINUTE_NS,
        format="rosbag1",
        problems=json.dumps([{"code": "long-gap", "where": "/imu", "message": "silent"}]),
        topics=[{"name": "/cam/rear", **IMAGE}, {"name": "/imu", **IMU}, {"name": "/odd", "message_type": None}],
    )
    return api


def _result(lab: Api, text: str) -> Any:
    return lab.get("/search", {"query": text}).ok()


def _names(page: Any, name: str = "name") -> list[str]:
    return sorted(item[name] for item in page["items"])


@pytest.mark.parametrize(
    ("text", "files"),
    [
        ("", [FRONT, LOG, REAR]),
        ("alps imu", [FRONT]),
        ('"green hills"', [FRONT, LOG]),
        ("sensor_msgs", [FRONT, REAR]),
        ("Msg/Image alps", [FRONT]),
        ("-Image", [LOG]),
        ('"hills green"', []),
        ("topic:/cam/*", [FRONT, REAR]),
        ("topic:/cam/* type:*/Imu", []),
        ("project:town", [REAR]),
        ('project:"Green hills" mission:alps', [FRONT, LOG]),
        ("label:wet label:dry", [LOG]),
        ("format:rosbag1", [REAR]),
        ("content:opaque", [LOG]),
        ("problem:long-gap", [REAR]),
        ("problem:*", [REAR]),
        ("problem:damaged", []),
        ("-problem:*", [FRONT, LOG]),
        ("path:*.bag", [REAR]),
        ("meta.robot:anymal", [FRONT, LOG]),
        ("meta.robot!=anymal", [REAR]),
        ("meta.speed>=3", [FRONT, LOG]),
        ("meta.code:3", [REAR]),
        ('meta.speed:"3"', []),
        ("meta.tags:cold", [REAR]),
        ('meta.site:"Zürich HB"', [FRONT, LOG]),
        ("meta.site:zür*", [FRONT, LOG]),
        ("size>1GB", [FRONT]),
        ("size<=30kB", [LOG, REAR]),
        ("size:20", [LOG]),
        ("duration>10m", [FRONT]),
        ("duration<=1m", [REAR]),
        ("month:2024-10", [FRONT]),
        ("month:2024-10 month:2024-11", [FRONT, REAR]),
        ("after:2024-10-05", [REAR]),
        ("before:2024-11", [FRONT]),
        ("-label:night", [REAR]),
        ("alps -topic:/imu", [LOG]),
        ("-alps", [REAR]),
        ("-month:2024-10", [LOG, REAR]),
        ("-duration>10m", [LOG, REAR]),
        ('-meta.site:"Zürich HB" -label:none', [REAR]),
    ],
)
def test_a_query_finds_files(lab: Api, text: str, files: list[str]) -> None:
    page = _result(lab, text)["files"]
    assert (_names(page, "path"), page["total"]) == (files, len(files))
    assert sorted(item["path"] for item in lab.all("/files", {"query": text, "limit": "1"})) == files


@pytest.mark.parametrize(
    ("text", "missions"),
    [
        ("", ["Alps", "Alps, empty", "Lake"]),
        ("alps", ["Alps", "Alps, empty"]),
        ("imu", ["Alps", "Lake"]),
        ("rained", ["Alps"]),
        ("sensor_msgs", ["Alps", "Lake"]),
        ("meta.robot:spot", ["Alps, empty", "Lake"]),
        ("meta.robot:spot label:wet", []),
        ("label:wet", ["Alps"]),
        ("-label:wet", ["Alps", "Lake"]),
        ("-lake", ["Alps", "Alps, empty"]),
        ("project:town", ["Lake"]),
    ],
)
def test_a_query_finds_missions_by_their_metadata_and_files(lab: Api, text: str, missions: list[str]) -> None:
    page = _result(lab, text)["missions"]
    assert (_names(page), page["total"]) == (missions, len(missions))
    assert sorted(item["name"] for item in lab.all("/missions", {"query": text, "limit": "1"})) == missions


def test_a_query_finds_topics_once_each(lab: Api) -> None:
    topics = _result(lab, "")["topics"]
    assert [(entry["name"], entry["file_count"], entry["message_count"]) for entry in topics["items"]] == [
        ("/imu", 2, 400),
        ("/cam/front", 1, 10),
        ("/cam/rear", 1, 10),
        ("/odd", 1, None),
    ]
    assert topics["total"] == 4
    assert _names(_result(lab, "topic:/cam/*")["topics"]) == ["/cam/front", "/cam/rear"]
    of_type = _result(lab, "image")["topics"]["items"]
    assert [entry["name"] for entry in of_type][:2] == ["/cam/front", "/cam/rear"], "those of that type come first"
    assert _result(lab, "rear")["topics"]["items"][0]["name"] == "/cam/rear", "what holds the word comes first"
    assert _result(lab, "no such thing")["topics"] == {"items": [], "next": None, "total": 0}


def test_a_search_returns_the_normalized_query_and_its_filter(lab: Api) -> None:
    result = _result(lab, " -label:wet   label:night size>=1000MB alps ")
    assert result["query"] == "alps label:night size>=1GB -label:wet"
    assert result["filter"]["min_size_bytes"] == 10**9
    assert _result(lab, result["query"])["files"] == result["files"]


def test_a_query_and_filters_are_combined(lab: Api) -> None:
    assert [entry["path"] for entry in lab.all("/files", {"query": "label:night", "content": "opaque"})] == [LOG]
    assert lab.get("/stats", {"query": "label:night", "text": "rained"}).ok()["total"]["files"] == 2
    assert {entry["name"] for entry in lab.all("/topics", {"query": "alps", "topic": "/i*"})} == {"/imu"}
    problem = lab.get("/files", {"query": "project:Town", "project": "Alps"}).refused(422, "invalid_query")
    assert "already set at column 1" in problem["detail"]


@pytest.mark.parametrize("path", ["/search", "/search/facets", "/files", "/missions", "/topics", "/stats"])
def test_errors_of_a_query_name_the_column(lab: Api, path: str) -> None:
    problem = lab.get(path, {"query": "alps topc:/imu"}).refused(422, "invalid_query")
    assert (problem["expression"], problem["column"]) == ("topc:/imu", 6)
    assert "did you mean 'topic'?" in problem["detail"]


@pytest.mark.parametrize("path", ["/search", "/search/facets", "/files", "/missions", "/projects", "/topics", "/stats"])
def test_the_number_of_words_of_a_search_is_limited(lab: Api, path: str) -> None:
    requested = "text" if path == "/projects" else "query"
    words = [f"word{number}" for number in range(MAX_WORDS + 1)]
    lab.get(path, {requested: " ".join(words[1:])}).ok()
    problem = lab.get(path, {requested: " ".join(words)}).refused(422, "invalid_query")
    assert problem["expression"] == f"word{MAX_WORDS}"
    assert "put words that belong together in quotes" in problem["detail"]


def _facets(api: Api, text: str) -> dict[str, dict[str, int]]:
    result = api.get("/search/facets", {"query": text}).ok()
    return {
        entry["name"]: {value["value"]: value["file_count"] for value in entry["values"]} for entry in result["facets"]
    }


def test_facets_count_what_is_found(lab: Api) -> None:
    assert _facets(lab, "") == {
        "project": {"Green hills": 2, "Town": 1},
        "format": {"mcap": 1, "rosbag1": 1},
        "content": {"indexed": 2, "opaque": 1},
        "month": {"2024-11": 1, "2024-10": 1},
        "label": {"night": 2, "wet": 1},
        "topic": {"/imu": 2, "/cam/front": 1, "/cam/rear": 1, "/odd": 1},
        "type": {"sensor_msgs/msg/Image": 2, "sensor_msgs/msg/Imu": 2},
        "meta.robot": {"anymal": 2, "spot": 1},
        "meta.site": {"Zürich HB": 2},
        "meta.speed": {"3": 2},
        "meta.code": {"3": 1},
        "meta.tags": {"cold": 1, "wet": 1},
    }
    assert "label" not in _facets(lab, "town")


def test_selecting_a_facet_value_finds_its_number_of_files(lab: Api) -> None:
    for text in ("", "alps", "label:night", "meta.robot:spot", "project:Town", "topic:/imu month:2024-10"):
        answer = lab.get("/search/facets", {"query": text}).ok()
        for facet in answer["facets"]:
            chosen = [value for value in facet["values"] if value["is_selected"]]
            for value in facet["values"]:
                total = _result(lab, value["query"])["files"]["total"]
                if not chosen:
                    assert total == value["file_count"], (text, facet["name"], value)
                if value["is_selected"]:
                    assert total >= value["file_count"], (text, facet["name"], value)


def test_a_facet_of_which_something_is_chosen_still_shows_the_others(lab: Api) -> None:
    result = lab.get("/search/facets", {"query": "meta.robot:spot label:night"}).ok()
    facets = {entry["name"]: entry["values"] for entry in result["facets"]}
    robots = [
        (entry["value"], entry["file_count"], entry["is_selected"], entry["query"]) for entry in facets["meta.robot"]
    ]
    assert robots == [
        ("anymal", 2, False, "meta.robot:anymal label:night"),
        ("spot", 0, True, "label:night"),
    ]
    assert (result["file_count"], result["is_exact"]) == (0, True)


def test_hidden_files_are_in_no_count(lab: Api) -> None:
    member = people.person(lab)
    theirs = lab.as_(member.token)
    assert _facets(theirs, "") == {}
    assert _result(theirs, "imu")["files"]["total"] == 0
    town = lab.get("/projects", {"name": "Town"}).ok()["items"][0]["id"]
    people.grant(lab, member, Right.read, project_id=town)
    result = _result(theirs, "")
    assert [result[entry]["total"] for entry in ("missions", "files", "topics")] == [1, 1, 3]
    facets = _facets(theirs, "")
    assert (facets["project"], facets["topic"]["/imu"]) == ({"Town": 1}, 1)
    assert "meta.site" not in facets
    lake = lab.get("/missions", {"name": "Lake"}).ok()["items"][0]["id"]
    (file_id,) = (entry["id"] for entry in lab.all("/files", {"query": "lake"}))
    guest = lab.as_(people.share(lab, lake, file_ids=[file_id]).secret)
    assert not any(name.startswith("meta.") for name in _facets(guest, "")), "a link to files shows no metadata"
    guest.get("/search/facets", {"query": "meta.robot:spot"}).refused(422, "invalid_query")
    guest.get("/search", {"query": "-meta.robot:spot"}).refused(422, "invalid_query")


def test_labels_are_put_on_many_files_each_by_its_own_right(lab: Api) -> None:
    project = lab.project(name=f"Labels {uuid.uuid4()}")["id"]
    mine, other, hidden = (lab.mission(project, name=name)["id"] for name in ("mine", "other", "hidden"))
    sample = Sample(lab)
    files = [sample.file(mine, f"{number}.mcap", labels=("old", "kept")) for number in range(3)]
    seen, unseen, nobodys = sample.file(other, "o.mcap"), sample.file(hidden, "h.mcap"), str(uuid.uuid4())
    member = people.person(lab)
    people.grant(lab, member, Right.write, mission_id=mine)
    people.grant(lab, member, Right.read, mission_id=other)
    theirs = lab.as_(member.token)
    requested = [*files, seen, unseen, nobodys]
    answer = theirs.post("/files/labels", {"file_ids": requested, "add": ["new", "new"], "remove": ["old", "new"]}).ok()
    reply = [(entry["file_id"], entry["labels"], (entry["problem"] or {}).get("code")) for entry in answer["items"]]
    assert reply == [
        *((file_id, ["kept", "new"], None) for file_id in files),
        (seen, None, "forbidden"),
        (unseen, None, "not_found"),
        (nobodys, None, "not_found"),
    ]
    assert [lab.get(f"/files/{entry}").ok()["labels"] for entry in files] == [["kept", "new"]] * 3
    rows = lab.sql(
        "SELECT resource_id::text, before, after FROM audit_event WHERE actor_id = %s AND operation = 'file.update'",
        member.id,
    )
    change = ({"labels": ["old", "kept"]}, {"labels": ["kept", "new"]})
    assert sorted(rows) == sorted((file_id, *change) for file_id in files)
    theirs.post("/files/labels", {"file_ids": files, "add": ["new"]}).ok()
    (count,) = lab.sql("SELECT count(*) FROM audit_event WHERE actor_id = %s", member.id)
    assert count == (3,), "what changes nothing is not recorded"


def test_more_labels_than_a_file_may_carry_are_refused_for_that_file(lab: Api) -> None:
    mission = lab.mission(lab.project(name=f"Many {uuid.uuid4()}")["id"])["id"]
    full = Sample(lab).file(mission, "full.mcap", labels=tuple(f"label {number}" for number in range(50)))
    (item,) = lab.post("/files/labels", {"file_ids": [full], "add": ["one more"]}).ok()["items"]
    assert "full.mcap would have 51 labels; 50 are allowed" in item["problem"]["detail"]
