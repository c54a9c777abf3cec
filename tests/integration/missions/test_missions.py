"""Missions through HTTP."""

import uuid
from concurrent.futures import ThreadPoolExecutor

import pytest

from tests.integration.api_server import Api
from tests.integration.sample import Sample


def test_makes_a_mission_and_reads_it_back(api: Api) -> None:
    project = api.project()
    text = "# the robot\nrobot: anymal  # it limped\n"
    made = api.post(
        f"/projects/{project['id']}/missions",
        {"name": "Run 1 🤖", "metadata_yaml": text, "notes": "it rained\n"},
    ).ok(201)
    assert made["project"] == {"id": project["id"], "name": project["name"]}
    assert (made["metadata"], made["metadata_yaml"], made["notes"]) == ({"robot": "anymal"}, text, "it rained\n")
    assert (made["completed_at"], made["start_ns"], made["metadata_problems"]) == (None, None, [])
    amounts = ("file_count", "size_bytes", "message_count", "pending_file_count")
    assert [made[amount] for amount in amounts] == [0, 0, 0, 0]
    assert api.get(f"/missions/{made['id']}").ok() == made


def test_creating_a_mission_takes_a_bounded_number_of_queries_and_one_audit_row(api: Api) -> None:
    project = api.project()
    with api.statements() as statements:
        made = api.mission(project["id"], metadata_yaml="robot: spot\n")
    assert len(statements) == 7  # who, fields, right, insert, read, record, tell
    (event,) = api.events(made["id"])
    assert (event["operation"], event["resource_name"]) == ("mission.create", made["name"])
    assert (event["before"], event["after"]) == ({}, {"name": made["name"], "metadata": {"robot": "spot"}})
    assert event["project_id"] == project["id"]


def test_names_are_unique_within_a_project_whatever_their_case_or_unicode_form(api: Api) -> None:
    project, other = api.project(), api.project()
    api.mission(project["id"], name="Caf\u00e9")
    path = f"/projects/{project['id']}/missions"
    api.post(path, {"name": "CAFE\u0301"}).refused(409, "name_taken")
    api.mission(other["id"], name="Café")
    assert len(api.all("/missions", {"project_id": project["id"]})) == 1


@pytest.mark.parametrize("name", ["a\nb", "a\x00b", "x" * 300, "..", "a/b", "", "\u2028"])
def test_refuses_a_hostile_name_and_says_which_field(api: Api, name: str) -> None:
    problem = api.post(f"/projects/{api.project()['id']}/missions", {"name": name}).refused(422, "invalid_request")
    assert [one["field"] for one in problem["problems"]] == ["body.name"]


def test_a_mission_needs_a_project_that_is_there(api: Api) -> None:
    project = api.project()
    api.delete(f"/projects/{project['id']}").ok()
    api.post(f"/projects/{project['id']}/missions", {"name": "late"}).refused(404, "not_found")


def test_unknown_ids_are_not_found(api: Api) -> None:
    unknown = f"/missions/{uuid.uuid4()}"
    for answer in (api.get(unknown), api.patch(unknown, {"notes": "x"}), api.delete(unknown)):
        answer.refused(404, "not_found")
    api.get(f"{unknown}/recordings").refused(404, "not_found")


def test_audit_events_contain_the_changed_fields(api: Api) -> None:
    made = api.mission(api.project()["id"], metadata_yaml="a: 1\n", notes="old")
    path = f"/missions/{made['id']}"
    changed = api.patch(path, {"name": "renamed", "metadata_yaml": "a: 2\n", "notes": "new"}).ok()
    assert (changed["name"], changed["metadata"], changed["notes"]) == ("renamed", {"a": 2}, "new")
    api.patch(path, {"name": "renamed", "metadata_yaml": "a: 2\n", "notes": "new"}).ok()
    event, _ = api.events(made["id"])
    assert event["before"] == {"name": made["name"], "metadata": {"a": 1}, "notes": "old"}
    assert event["after"] == {"name": "renamed", "metadata": {"a": 2}, "notes": "new"}


def test_completing_notes_the_time_once_and_can_be_undone(api: Api) -> None:
    path = f"/missions/{api.mission(api.project()['id'])['id']}"
    first = api.patch(path, {"completed": True}).ok()["completed_at"]
    assert first is not None
    assert api.patch(path, {"completed": True}).ok()["completed_at"] == first
    assert api.patch(path, {"completed": False}).ok()["completed_at"] is None


def test_a_moved_mission_is_validated_by_the_fields_of_its_new_project(api: Api, sample: Sample) -> None:
    fields = "fields:\n  - {name: robot, type: string, required: true}\n"
    source, target = api.project(), api.project(fields_yaml=fields)
    made = api.mission(source["id"], metadata_yaml="operator: ada\n")
    file_id = sample.file(made["id"], "a.mcap")
    moved = api.patch(f"/missions/{made['id']}", {"project_id": target["id"]}).ok()
    assert moved["project"]["id"] == target["id"]
    assert [one["field"] for one in moved["metadata_problems"]] == ["robot"]
    assert api.get(f"/files/{file_id}").ok()["mission"]["project"]["id"] == target["id"]
    arrived, left, _ = api.events(made["id"])
    # Neither project's owners need know the other.
    assert (left["operation"], left["project_id"], left["after"]) == ("mission.move_out", source["id"], {})
    assert (arrived["project_id"], arrived["before"], arrived["after"]) == (
        target["id"],
        {},
        {"project": target["name"]},
    )
    repaired = api.patch(f"/missions/{made['id']}", {"metadata_yaml": "robot: spot\n"}).ok()
    assert (repaired["metadata"], repaired["metadata_problems"]) == ({"robot": "spot"}, [])


def test_moving_to_a_taken_name_or_a_missing_project_is_refused(api: Api) -> None:
    source, target = api.project(), api.project()
    made = api.mission(source["id"], name="Run")
    api.mission(target["id"], name="RUN")
    path = f"/missions/{made['id']}"
    api.patch(path, {"project_id": target["id"]}).refused(409, "name_taken")
    api.patch(path, {"project_id": str(uuid.uuid4())}).refused(404, "not_found")
    assert api.get(path).ok() == made
    assert len(api.events(made["id"])) == 1


def test_stored_totals_are_valid_until_files_change(api: Api) -> None:
    mission = api.mission(api.project()["id"])
    seen = []
    for change in ("file_count = 9", "notes = 'rain'", "files_revision = files_revision + 1"):
        api.sql(f"UPDATE mission SET {change} WHERE id = %s", mission["id"])
        place = f"/missions/{mission['id']}", f"/projects/{mission['project']['id']}"
        seen.append({api.get(item).ok()["file_count"] for item in place})
    assert seen == [{9}, {9}, {0}]


def test_counts_files_bytes_and_messages(api: Api, sample: Sample) -> None:
    made = api.mission(api.project()["id"])
    sample.file(made["id"], "a.mcap", size_bytes=10, message_count=5)
    sample.file(made["id"], "b.mcap", size_bytes=20, content="pending", summarised_at=None)
    # Too large to be summarised: the verification will read it, unless the bytes turn out to be damaged.
    sample.file(made["id"], "d.db3", size_bytes=1, content="pending")
    sample.file(made["id"], "e.db3", size_bytes=1, content="pending", state="lost")
    gone = sample.file(made["id"], "c.mcap", size_bytes=40, message_count=9)
    api.delete(f"/files/{gone}").ok()
    seen = api.get(f"/missions/{made['id']}").ok()
    amounts = ("file_count", "size_bytes", "message_count", "pending_file_count")
    assert [seen[amount] for amount in amounts] == [4, 32, 5, 2]


def test_a_deleted_mission_is_gone_with_its_files_and_its_name_is_free(api: Api, sample: Sample) -> None:
    project = api.project()
    made = api.mission(project["id"])
    file_id = sample.file(made["id"], "a.mcap", size_bytes=5)
    path = f"/missions/{made['id']}"
    would = api.delete(path, {"dry_run": "true"}).ok()
    assert (would["missions"], would["files"], would["size_bytes"], would["dry_run"]) == (1, 1, 5, True)
    assert api.delete(path).ok()["dry_run"] is False
    api.get(path).refused(404, "not_found")
    api.get(f"/files/{file_id}").refused(404, "not_found")
    assert api.mission(project["id"], name=made["name"])["id"] != made["id"]
    assert [event["operation"] for event in api.events(made["id"])] == ["mission.delete", "mission.create"]


def test_a_list_takes_the_same_number_of_queries_however_long(api: Api, sample: Sample) -> None:
    project = api.project()
    api.get(f"/projects/{project['id']}").ok()  # so that an admin's look is noted already
    counts = []
    for number in range(3):
        sample.file(api.mission(project["id"])["id"], f"{number}.mcap")
        with api.statements() as statements:
            assert len(api.get("/missions", {"project_id": project["id"]}).ok()["items"]) == number + 1
        counts.append(len(statements))
    assert counts == [2, 2, 2]


def test_pages_neither_repeat_nor_skip_while_missions_come_and_go(api: Api) -> None:
    project = api.project()
    made = {name: api.mission(project["id"], name=name)["id"] for name in "bdfhj"}
    query = {"project_id": project["id"], "limit": "2"}
    first = api.get("/missions", query).ok()
    api.mission(project["id"], name="a")  # before what was read
    api.mission(project["id"], name="g")  # after it
    api.delete(f"/missions/{made['d']}").ok()  # the very row the cursor stands on
    second = api.get("/missions", {**query, "cursor": first["next"]}).ok()
    third = api.get("/missions", {**query, "cursor": second["next"]}).ok()
    names = [[mission["name"] for mission in page["items"]] for page in (first, second, third)]
    assert names == [["b", "d"], ["f", "g"], ["h", "j"]]
    assert third["next"] is None


def test_sorts_and_puts_missions_without_time_last(api: Api) -> None:
    project = api.project()
    ids = {name: api.mission(project["id"], name=name)["id"] for name in ("b", "a", "c")}
    for name, start in {"b": 100, "a": 200}.items():
        api.sql("UPDATE mission SET start_ns = %s, end_ns = %s WHERE id = %s", start, start + 10, ids[name])
    expected = {"name": "abc", "-name": "cba", "created": "bac", "-created": "cab", "start": "bac", "-start": "abc"}
    for sort, names in expected.items():
        listed = api.all("/missions", {"project_id": project["id"], "sort": sort, "limit": "2"})
        assert "".join(mission["name"] for mission in listed) == names, sort


def test_two_missions_created_at_the_same_time_cannot_share_a_name(api: Api) -> None:
    project = api.project()
    path = f"/projects/{project['id']}/missions"
    with ThreadPoolExecutor(4) as pool:
        answers = list(pool.map(lambda name: api.post(path, {"name": name}), ["Run", "RUN", "run", "rUn"]))
    assert sorted(answer.status for answer in answers) == [201, 409, 409, 409]
    assert len(api.all("/missions", {"project_id": project["id"]})) == 1


def test_missions_made_while_fields_change_are_judged_by_the_old_or_the_new(api: Api) -> None:
    project = api.project()
    fields = "fields: [{name: robot, type: string, required: true}]"
    path = f"/projects/{project['id']}"
    moving = api.mission(project["id"])
    with ThreadPoolExecutor(4) as pool:
        made = [pool.submit(api.post, f"{path}/missions", {"name": f"run {number}"}) for number in range(8)]
        changed = pool.submit(api.patch, path, {"fields_yaml": fields})
        edited = pool.submit(api.patch, f"/missions/{moving['id']}", {"metadata_yaml": "robot: spot\n"})
        changed.result().ok()
        edited.result().ok()
        assert {answer.result().status for answer in made} <= {201, 422}
    for mission in api.all("/missions", {"project_id": project["id"]}):
        assert bool(mission["metadata_problems"]) == ("robot" not in mission["metadata"])
