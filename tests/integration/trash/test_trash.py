"""The trash through HTTP: its list, and restoring."""

import datetime
import uuid
from typing import Any

import pytest

from tests.integration.api_server import Api
from tests.integration.conftest import StartApi
from tests.integration.sample import Sample


def _lying(api: Api, resource_id: str) -> Any:
    actual = [row for row in api.all("/trash", {"limit": "500"}) if row["id"] == resource_id]
    return actual[0] if actual else None


def _restore(api: Api, resource_type: str, resource_id: str) -> Any:
    return api.post(f"/trash/{resource_type}/{resource_id}/restore")


@pytest.fixture(name="tree")
def _tree(api: Api, sample: Sample) -> dict[str, Any]:
    project = api.project()
    mission = api.mission(project["id"])
    remaining = sample.file(mission["id"], "kept.mcap", size_bytes=1)
    return {
        "project": project,
        "mission": mission,
        "file": sample.file(mission["id"], "a.mcap", size_bytes=5),
        "kept": remaining,
    }


def test_deleted_objects_are_in_the_trash_with_place_size_and_expiry(api: Api, tree: dict[str, Any]) -> None:
    project, mission = tree["project"], tree["mission"]
    place = f"{project['name']}/{mission['name']}"
    api.delete(f"/files/{tree['file']}").ok()
    row = _lying(api, tree["file"])
    assert (row["resource_type"], row["name"], row["location"]) == ("file", "a.mcap", place)
    assert (row["size_bytes"], row["file_count"], row["deleted_by"]["name"]) == (5, 1, "owner")
    deleted_at, purged_after = (datetime.datetime.fromisoformat(row[name]) for name in ("deleted_at", "purged_after"))
    assert purged_after - deleted_at == datetime.timedelta(days=30)
    api.delete(f"/missions/{mission['id']}").ok()
    row = _lying(api, mission["id"])
    assert (row["resource_type"], row["name"], row["location"]) == ("mission", mission["name"], project["name"])
    assert (row["size_bytes"], row["file_count"]) == (1, 1)
    api.delete(f"/projects/{project['id']}").ok()
    row = _lying(api, project["id"])
    assert (row["resource_type"], row["name"], row["location"]) == ("project", project["name"], "")
    assert (row["size_bytes"], row["file_count"]) == (0, 0)


def test_objects_deleted_with_their_parent_are_not_listed_and_restored_with_it(api: Api, tree: dict[str, Any]) -> None:
    project, mission = tree["project"], tree["mission"]
    before = api.get(f"/projects/{project['id']}").ok()
    api.delete(f"/projects/{project['id']}").ok()
    assert (_lying(api, mission["id"]), _lying(api, tree["file"])) == (None, None)
    assert _lying(api, project["id"])["file_count"] == 2
    _restore(api, "project", project["id"]).ok(204)
    assert api.get(f"/projects/{project['id']}").ok() == before
    assert api.get(f"/files/{tree['file']}").ok()["path"] == "a.mcap"


@pytest.mark.parametrize("resource_type", ["project", "mission", "file"])
def test_a_restore_is_complete_and_recorded_once(api: Api, tree: dict[str, Any], resource_type: str) -> None:
    resource_id = tree[resource_type] if resource_type == "file" else tree[resource_type]["id"]
    api.delete(f"/{resource_type}s/{resource_id}").ok()
    _restore(api, resource_type, resource_id).ok(204)
    assert api.get(f"/{resource_type}s/{resource_id}").ok()["id"] == resource_id
    assert _lying(api, resource_id) is None
    operations = [event["operation"] for event in api.events(resource_id)]
    assert operations[:2] == [f"{resource_type}.restore", f"{resource_type}.delete"]
    _restore(api, resource_type, resource_id).refused(404, "not_found")
    assert len(api.events(resource_id)) == len(operations)


def test_restoring_under_a_taken_name_is_refused(api: Api, sample: Sample, tree: dict[str, Any]) -> None:
    project, mission = tree["project"], tree["mission"]
    api.delete(f"/files/{tree['file']}").ok()
    sample.file(mission["id"], "A.mcap")
    assert _restore(api, "file", tree["file"]).refused(409, "name_taken")["name"] == "a.mcap"
    api.delete(f"/missions/{mission['id']}").ok()
    api.mission(project["id"], name=mission["name"].upper())
    _restore(api, "mission", mission["id"]).refused(409, "name_taken")
    api.delete(f"/projects/{project['id']}").ok()
    api.project(name=project["name"].upper())
    _restore(api, "project", project["id"]).refused(409, "name_taken")
    assert _lying(api, project["id"]) is not None


def test_a_file_does_not_come_back_where_a_folder_is_now(api: Api, sample: Sample, tree: dict[str, Any]) -> None:
    api.delete(f"/files/{tree['file']}").ok()
    sample.file(tree["mission"]["id"], "a.mcap/inside")
    assert _restore(api, "file", tree["file"]).refused(409, "path_conflict")["other"] == "a.mcap/inside"


def test_restoring_into_a_deleted_parent_is_refused(api: Api, tree: dict[str, Any]) -> None:
    project, mission = tree["project"], tree["mission"]
    api.delete(f"/files/{tree['file']}").ok()
    api.delete(f"/missions/{mission['id']}").ok()
    refused = _restore(api, "file", tree["file"]).refused(404, "not_found")
    assert (refused["resource_type"], "restore it first" in refused["detail"]) == ("mission", True)
    api.delete(f"/projects/{project['id']}").ok()
    for resource_type, resource_id in (("mission", mission["id"]), ("file", tree["file"])):
        assert _restore(api, resource_type, resource_id).refused(404, "not_found")["resource_type"] == "project"
    for resource_type, resource_id in (("project", project["id"]), ("mission", mission["id"]), ("file", tree["file"])):
        _restore(api, resource_type, resource_id).ok(204)
    assert api.get(f"/missions/{mission['id']}").ok()["file_count"] == 2


def test_existing_and_unknown_objects_are_not_in_the_trash(api: Api, tree: dict[str, Any]) -> None:
    _restore(api, "mission", tree["mission"]["id"]).refused(404, "not_found")
    _restore(api, "file", str(uuid.uuid4())).refused(404, "not_found")
    _restore(api, "topic", str(uuid.uuid4())).refused(422, "invalid_request")


def test_the_trash_is_listed_latest_first_by_resource_type_and_in_pages(start_api: StartApi) -> None:
    api = start_api(trash_days=3)
    sample = Sample(api)
    project = api.project()["id"]
    missions = [api.mission(project)["id"] for _ in range(3)]
    file_id = sample.file(missions[2], "a.mcap")
    for path in (f"/missions/{missions[0]}", f"/files/{file_id}", f"/missions/{missions[1]}"):
        api.delete(path).ok()
    rows = api.all("/trash", {"limit": "1"})
    assert [row["id"] for row in rows] == [missions[1], file_id, missions[0]]
    assert [row["id"] for row in api.all("/trash", {"resource_type": "mission"})] == [missions[1], missions[0]]
    first = rows[0]
    remaining = datetime.datetime.fromisoformat(first["purged_after"]) - datetime.datetime.fromisoformat(
        first["deleted_at"]
    )
    assert remaining.days == 3
    api.get("/trash", {"resource_type": "topic"}).refused(422, "invalid_request")
    with api.statements() as statements:
        api.get("/trash").ok()
    assert len(statements) == 2  # who, what
