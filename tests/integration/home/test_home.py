"""Home shows recent, unfinished and failed work and the storage used, of visible objects only."""

import pytest

from kleinkram.client import connect
from kleinkram.contract.access import Right
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.conftest import StartApi
from tests.integration.sample import Sample
from tests.integration.upload_client import begin, send

_PART = 8 * 1024 * 1024


@pytest.fixture(scope="module")
def lab(start_api: StartApi) -> Api:
    return start_api()


@pytest.fixture
def member(lab: Api) -> people.Person:
    return people.person(lab)


def test_recent_missions_are_those_where_something_arrived_last(lab: Api, member: people.Person) -> None:
    project, hidden = lab.project(), lab.project()
    people.grant(lab, member, Right.read, project_id=project["id"])
    older, newer, unseen = (lab.mission(item["id"]) for item in (project, project, hidden))
    sample = Sample(lab)
    for mission in (newer, older, unseen):
        sample.file(mission["id"], "a.mcap", size_bytes=7)
    home = lab.as_(member.token).get("/home").ok()
    assert [item["mission"]["id"] for item in home["missions"]] == [older["id"], newer["id"]]
    assert home["missions"][0]["mission"]["project"]["name"] == project["name"]
    assert (home["missions"][0]["file_count"], home["missions"][0]["size_bytes"]) == (1, 7)
    storage = lab.as_(member.token).get("/home/storage").ok()
    assert [(item["project"]["id"], item["size_bytes"]) for item in storage["projects"]] == [(project["id"], 14)]
    assert storage["store"] is None, "of the whole server only admins hear"


def test_unfinished_uploads_say_how_far_they_got(lab: Api, member: people.Person) -> None:
    mission = lab.mission(lab.project()["id"])
    people.grant(lab, member, Right.create, mission_id=mission["id"])
    body = bytes(_PART) + b"the rest"
    mine = begin(lab.as_(member.token), mission["id"], {"mine.bin": body}, hashed=False)[0]["upload"]
    begin(lab, mission["id"], {"theirs.bin": b"x"}, hashed=False)
    send(lab.as_(member.token), mine, body, only=[1])
    (unfinished,) = lab.as_(member.token).get("/home").ok()["uploads"]
    assert (unfinished["id"], unfinished["path"]) == (mine["id"], "mine.bin")
    assert (unfinished["sent_bytes"], unfinished["size_bytes"]) == (mine["part_size_bytes"], len(body))
    assert unfinished["mission"]["name"] == mission["name"]
    assert unfinished["expires_at"] > unfinished["created_at"]


def test_missions_that_need_attention_are_listed(lab: Api, member: people.Person) -> None:
    project = lab.project()
    mission, hidden = lab.mission(project["id"]), lab.mission(lab.project()["id"])
    people.grant(lab, member, Right.read, project_id=project["id"])
    sample = Sample(lab)
    for item in (mission, hidden):
        sample.file(item["id"], "torn.bag", content="broken")
        sample.file(item["id"], "other.bag", content="broken")
        sample.file(item["id"], "gone.bag", state="lost", content="recovered")
        sample.file(item["id"], "fine.bag")
    problems = '[{"field": "robot", "message": "missing"}]'
    lab.sql("UPDATE mission SET metadata_problems = %s::jsonb WHERE id = %s", problems, mission["id"])
    message = lab.as_(member.token).get("/home").ok()["attention"]
    assert [(item["kind"], item["count"]) for item in message] == [
        ("files_lost", 1),
        ("files_broken", 2),
        ("metadata_missing", 1),
    ]
    assert {item["mission"]["id"] for item in message} == {mission["id"]}


def test_admins_see_the_whole_server(lab: Api) -> None:
    mission = lab.mission(lab.project()["id"])
    Sample(lab).file(mission["id"], "old.bag", created_at="2020-01-01T00:00:00Z", size_bytes=11)
    failed = "INSERT INTO procrastinate_jobs (queue_name, task_name, status) VALUES ('default', 'nothing', 'failed')"
    lab.sql(failed)
    with connect(lab.url, lab.token) as client:
        home, store = client.home.get(), client.home.storage().store
    needs = {item.kind.value: item.count for item in home.attention}
    assert needs["jobs_failed"] == 1
    assert needs["verifications_overdue"] >= 1
    assert store is not None
    assert store.used_bytes >= 11
    assert store.free_bytes is None, "where the store's disk is not this machine's"


def test_the_number_of_statements_does_not_depend_on_the_amount_of_data(lab: Api) -> None:
    with lab.statements() as statements:
        lab.get("/home").ok()
    assert len([item for item in statements if item.lstrip().startswith(("SELECT", "WITH"))]) <= 12
