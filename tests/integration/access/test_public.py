"""Public projects: everyone may read them, changes require an account, and downloads are recorded."""

from typing import Any

import pytest

from kleinkram import connect
from kleinkram.contract.access import Right, Scope
from kleinkram.contract.errors import NotAuthenticated
from kleinkram.contract.files import FileFilter
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.sample import Sample


@pytest.fixture
def public(api: Api) -> Any:
    """A public project."""
    project = api.project(description="for everybody")
    release = {"is_public": True, "licence": "CC-BY-4.0", "citation": "Lovelace, A.: Alps. 2026."}
    return api.patch(f"/projects/{project['id']}", release).ok()


@pytest.fixture
def stranger(api: Api) -> Api:
    """The API without a credential."""
    return api.as_(None)


def test_guests_can_list_search_read_and_download_public_data(
    api: Api, sample: Sample, stranger: Api, public: Any
) -> None:
    hidden = api.mission(api.project()["id"])
    sample.file(hidden["id"], "hidden.mcap")
    mission = api.mission(public["id"], metadata_yaml="robot: anymal\n")
    file_id = sample.file(mission["id"], "a.mcap", topics=[{"name": "/imu", "message_type": "Imu"}])
    recording = sample.recording(mission["id"], "a", [file_id])

    (seen,) = [item for item in stranger.all("/projects") if item["id"] == public["id"]]
    assert (seen["licence"], seen["citation"], seen["is_public"]) == ("CC-BY-4.0", "Lovelace, A.: Alps. 2026.", True)
    assert (seen["right"], seen["file_count"]) == ("READ", 1)
    assert hidden["id"] not in {item["id"] for item in stranger.all("/missions")}
    assert [item["id"] for item in stranger.all("/missions", {"where": "robot=anymal", "project_id": public["id"]})]
    assert {item["mission"]["project"]["id"] for item in stranger.all("/files", {"project_id": public["id"]})} == {
        public["id"]
    }
    stranger.get(f"/missions/{hidden['id']}").refused(404, "not_found")
    for path in (f"/missions/{mission['id']}", f"/files/{file_id}", f"/recordings/{recording}"):
        stranger.get(path).ok()
    assert [item["name"] for item in stranger.all(f"/files/{file_id}/topics")] == ["/imu"]
    links = stranger.post("/files/download", {"file_ids": [file_id]}).ok()["items"]
    assert links[0]["url"].startswith("http")
    (fetched,) = [event for event in api.events(file_id) if event["operation"] == "file.download"]
    assert fetched["actor"] is None
    assert api.sql("SELECT address FROM audit_event WHERE id = %s", fetched["id"]) == [("127.0.0.1",)]


def test_the_sdk_reads_public_data_without_a_token(api: Api, sample: Sample, public: Any) -> None:
    file_id = sample.file(api.mission(public["id"])["id"], "a.mcap")
    with connect(api.url) as client:
        assert client.projects.get(public["name"]).licence == "CC-BY-4.0"
        (file,) = client.files.list(FileFilter(project=public["name"]))
        (link,) = client.files.links([file.id]).items
        assert (str(file.id), link.path) == (file_id, "a.mcap")
        with pytest.raises(NotAuthenticated):
            client.projects.create("x")


def test_guests_can_do_nothing_else(api: Api, sample: Sample, stranger: Api, public: Any) -> None:
    mission = api.mission(public["id"])
    file_id = sample.file(mission["id"], "a.mcap")
    refused = [
        stranger.post(f"/projects/{public['id']}/missions", {"name": "x"}),
        stranger.patch(f"/projects/{public['id']}", {"description": "x"}),
        stranger.post(f"/missions/{mission['id']}/uploads", {"files": [{"path": "a", "size_bytes": 1}]}),
        stranger.delete(f"/files/{file_id}"),
        stranger.post(f"/files/{file_id}/verify"),
        stranger.get("/audit"),
        stranger.get("/trash"),
        stranger.get("/tokens"),
        stranger.get("/shares"),
    ]
    for answer in refused:
        answer.refused(401, "not_authenticated")


def test_private_again_or_deleted_projects_are_hidden_from_strangers(api: Api, stranger: Api, public: Any) -> None:
    mission = api.mission(public["id"])
    stranger.get(f"/missions/{mission['id']}").ok()
    api.patch(f"/projects/{public['id']}", {"is_public": False}).ok()
    stranger.get(f"/missions/{mission['id']}").refused(404, "not_found")
    api.patch(f"/projects/{public['id']}", {"is_public": True}).ok()
    stranger.get(f"/projects/{public['id']}").ok()
    api.delete(f"/projects/{public['id']}").ok()
    stranger.get(f"/projects/{public['id']}").refused(404, "not_found")
    operations = [event["operation"] for event in api.events(public["id"])]
    assert operations[:4] == ["project.delete", "project.publish", "project.unpublish", "project.publish"]


def test_everybody_with_an_account_can_only_read_public_data(api: Api, public: Any) -> None:
    ada = people.person(api)
    hers = api.as_(ada.token)
    assert hers.get(f"/projects/{public['id']}").ok()["right"] == "READ"
    hers.post(f"/projects/{public['id']}/missions", {"name": "x"}).refused(403, "forbidden")


def test_a_limited_token_does_not_reach_public_projects_outside_its_limits(api: Api, public: Any) -> None:
    ada = people.person(api)
    project = api.project()
    people.grant(api, ada, Right.create, project_id=project["id"])
    robot = api.as_(people.token(api, ada, [Scope.upload], limits=[project["id"]]).secret)
    robot.get(f"/projects/{public['id']}").refused(404, "not_found")
    assert [item["id"] for item in robot.all("/projects")] == [project["id"]]


@pytest.mark.parametrize("change", [{"is_public": True}, {"licence": "MIT"}, {"citation": "me"}])
def test_publishing_requires_ownership_and_the_scope_admin(api: Api, change: dict[str, object]) -> None:
    ada = people.person(api)
    project = api.project()
    path = f"/projects/{project['id']}"
    people.grant(api, ada, Right.write, project_id=project["id"])
    api.as_(ada.token).patch(path, change).refused(403, "forbidden")
    people.grant(api, ada, Right.delete, project_id=project["id"])
    api.as_(people.token(api, ada, [Scope.write]).secret).patch(path, change).refused(403, "scope_missing")
    api.as_(ada.token).patch(path, change).ok()
