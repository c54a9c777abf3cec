"""Shipped actions are listed and added: `/library`, for whom, in which version, and what is refused."""

from __future__ import annotations

from typing import Any

import kleinkram
from kleinkram.contract.access import Right, Scope
from kleinkram.contract.locks import parse_lock
from kleinkram.library import shipped_actions
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.runs.conftest import FakeRunner, Place, launch
from tests.package_index import PackageIndex

NAME = "slam-evaluate"
SHIPPED = shipped_actions()[NAME]
FROM = f"kleinkram/{NAME}@{kleinkram.__version__}"


def add(api: Api, project_id: str | None, name: str = NAME) -> Any:
    return api.post(f"/library/{name}", {"project_id": project_id}).ok(201)


def entry(api: Api, project_id: str | None = None, name: str = NAME) -> Any:
    items = api.get("/library", {} if project_id is None else {"project_id": project_id}).ok()["items"]
    return {item["name"]: item for item in items}[f"kleinkram/{name}"]


def make_older(api: Api, action: Any) -> None:
    """Make the latest version of an action what an earlier Kleinkram added."""
    api.sql(
        "UPDATE action_version SET definition = definition || %s::jsonb WHERE id = %s",
        f'{{"script": "print(1)", "library": "kleinkram/{NAME}@0.0.1"}}',
        action["latest"]["id"],
    )


def test_the_list_describes_what_is_shipped(lab: Api, project_id: str) -> None:
    items = lab.get("/library", {"project_id": project_id}).ok()["items"]
    assert [item["name"] for item in items] == [f"kleinkram/{name}" for name in shipped_actions()]
    item = entry(lab, project_id)
    assert (item["description"], item["version"]) == (SHIPPED.description, kleinkram.__version__)
    assert (item["dependencies"], item["right"]) == (SHIPPED.dependencies, "READ")
    assert [parameter["name"] for parameter in item["parameters"]] == [entry.name for entry in SHIPPED.parameters]
    assert (item["state"], item["action_id"], item["action_version"]) == ("available", None, None)
    assert not {"script", "lock"} & item.keys()


def test_an_action_is_added_to_a_project(lab: Api, project_id: str) -> None:
    made = add(lab, project_id)
    definition = made["latest"]["definition"]
    assert (made["name"], made["project"]["id"], made["latest"]["number"]) == (NAME, project_id, 1)
    assert (definition["library"], definition["script"]) == (FROM, SHIPPED.script)
    assert [(package.name, package.version) for package in parse_lock(definition["lock"])] == [("evo", "1.38.1")]
    item = entry(lab, project_id)
    assert (item["state"], item["action_id"], item["action_version"]) == ("added", made["id"], 1)
    assert entry(lab, str(lab.project()["id"]))["state"] == "available"
    assert [event["operation"] for event in lab.events(made["id"])] == ["action.create"]


def test_adding_again_changes_nothing(lab: Api, project_id: str, index: PackageIndex) -> None:
    made = add(lab, project_id)
    index.requests.clear()
    assert add(lab, project_id) == made
    assert index.requests == []
    assert [event["operation"] for event in lab.events(made["id"])] == ["action.create"]


def test_after_an_upgrade_the_next_version_is_published(lab: Api, project_id: str) -> None:
    made = add(lab, project_id)
    make_older(lab, made)
    assert entry(lab, project_id)["state"] == "outdated"
    upgraded = add(lab, project_id)
    assert (upgraded["id"], upgraded["latest"]["number"]) == (made["id"], 2)
    assert (upgraded["latest"]["definition"]["script"], upgraded["latest"]["definition"]["library"]) == (
        SHIPPED.script,
        FROM,
    )
    versions = lab.all(f"/actions/{made['id']}/versions")
    assert [version["definition"]["library"] for version in versions] == [FROM, f"kleinkram/{NAME}@0.0.1"]
    assert [event["operation"] for event in lab.events(made["id"])] == ["action.publish", "action.create"]


def test_an_upgrade_without_a_change_of_the_action_publishes_nothing(lab: Api, project_id: str) -> None:
    made = add(lab, project_id)
    lab.sql(
        "UPDATE action_version SET definition = jsonb_set(definition, '{library}', %s::jsonb) WHERE id = %s",
        f'"kleinkram/{NAME}@0.0.1"',
        made["latest"]["id"],
    )
    assert entry(lab, project_id)["state"] == "added"
    assert add(lab, project_id)["latest"]["number"] == 1


def test_what_was_added_without_an_index_is_locked_later(lab: Api, project_id: str) -> None:
    made = add(lab, project_id)
    lab.sql(
        "UPDATE action_version SET definition = jsonb_set(definition, '{lock}', 'null') WHERE id = %s",
        made["latest"]["id"],
    )
    assert entry(lab, project_id)["state"] == "outdated"
    assert add(lab, project_id)["latest"]["definition"]["lock"].startswith("evo==1.38.1")
    assert entry(lab, project_id)["state"] == "added"


def test_an_action_of_somebody_is_not_replaced(lab: Api, project_id: str) -> None:
    own = {"name": NAME.upper(), "script": "print('mine')", "library": FROM}
    made = lab.post("/actions", {"project_id": project_id, "definition": own}).ok(201)
    assert made["latest"]["definition"]["library"] is None
    assert entry(lab, project_id)["state"] == "name_taken"
    problem = lab.post(f"/library/{NAME}", {"project_id": project_id}).refused(409, "not_from_library")
    assert "Archive it to add the one from the library." in problem["detail"]
    assert lab.get(f"/actions/{made['id']}").ok() == made
    lab.patch(f"/actions/{made['id']}", {"archived": True}).ok()
    assert entry(lab, project_id)["state"] == "available"
    assert add(lab, project_id)["latest"]["number"] == 1


def test_a_changed_version_of_somebody_is_not_replaced(lab: Api, project_id: str) -> None:
    made = add(lab, project_id)
    changed = made["latest"]["definition"] | {"description": "mine"}
    second = lab.post(f"/actions/{made['id']}/versions", {"definition": changed}).ok(201)
    assert (second["latest"]["number"], second["latest"]["definition"]["library"]) == (2, None)
    lab.post(f"/library/{NAME}", {"project_id": project_id}).refused(409, "not_from_library")


def test_publishing_what_info_shows_keeps_where_it_is_from(lab: Api, project_id: str) -> None:
    made = add(lab, project_id)
    same = lab.post(f"/actions/{made['id']}/versions", {"definition": made["latest"]["definition"]}).ok(201)
    assert same == made


def test_an_unpublished_definition_is_not_from_the_library(lab: Api, runner: FakeRunner, place: Place) -> None:
    definition = {"name": "own", "script": "print(1)", "library": FROM, "resources": {"labels": runner.labels}}
    requested = {"mission_ids": [place.mission["id"]], "definition": definition}
    (item,) = lab.post("/runs", requested).ok()["items"]
    assert lab.get(f"/runs/{item['run']['id']}").ok()["definition"]["library"] is None
    definition["library"] = "somebody/else@1"
    lab.post("/runs", requested).refused(422, "invalid_request")


def test_what_cannot_be_locked_is_refused_and_not_stored(lab: Api, project_id: str) -> None:
    problem = lab.post("/library/lidar-odometry", {"project_id": project_id}).refused(422, "invalid_request")
    assert problem["problems"][0]["message"] == "There is no package kiss-icp in the package index."
    assert entry(lab, project_id, "lidar-odometry")["state"] == "available"


def test_an_unknown_name_is_not_found(lab: Api, project_id: str) -> None:
    problem = lab.post("/library/preveiw", {"project_id": project_id}).refused(404, "not_found")
    assert "kleinkram/preveiw" in problem["detail"]


def test_adding_to_a_project_requires_write(lab: Api, project_id: str, index: PackageIndex) -> None:
    person = people.person(lab)
    api = lab.as_(people.token(lab, person).secret)
    query = {"project_id": project_id}
    index.requests.clear()
    api.get("/library", query).refused(404, "not_found")
    api.post(f"/library/{NAME}", query).refused(404, "not_found")
    people.grant(lab, person, Right.read, project_id=project_id)
    assert entry(api, project_id)["state"] == "available"
    api.post(f"/library/{NAME}", query).refused(403, "forbidden")
    assert index.requests == []
    people.grant(lab, person, Right.write, project_id=project_id)
    reading = lab.as_(people.token(lab, person, [Scope.read]).secret)
    reading.post(f"/library/{NAME}", query).refused(403, "scope_missing")
    assert add(api, project_id)["created_by"]["id"] == person.id


def test_in_the_lab_only_who_added_it_and_admins_upgrade_it(lab: Api) -> None:
    ada, bob = people.person(lab), people.person(lab)
    as_ada, as_bob = (lab.as_(people.token(lab, who).secret) for who in (ada, bob))
    made = add(as_ada, None)
    assert (made["project"], entry(as_bob)["state"]) == (None, "added")
    make_older(lab, made)
    as_bob.post(f"/library/{NAME}", {}).refused(403, "forbidden")
    assert add(as_ada, None)["latest"]["number"] == 2


def test_guests_and_runs_have_no_library(lab: Api, runner: FakeRunner, place: Place) -> None:
    project = {"project_id": place.project["id"]}
    link = lab.as_(people.share(lab, place.mission["id"]).secret)
    for guest, status, code in ((lab.as_(None), 401, "not_authenticated"), (link, 403, "scope_missing")):
        guest.get("/library", project).refused(status, code)
        guest.post(f"/library/{NAME}", project).refused(status, code)
    launch(lab, runner, place.mission, network="api", right="WRITE")
    claim = runner.claim()
    runner.heartbeat(claim)
    run = lab.as_(claim["token"])
    run.post(f"/library/{NAME}", project).refused(404, "not_found")
    run.post(f"/library/{NAME}", {}).refused(403, "forbidden")
