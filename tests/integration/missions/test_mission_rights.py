"""Rights on a single mission: what they allow, and what they show of the project."""

from kleinkram.contract.access import Right
from tests.integration import people
from tests.integration.api_server import Api

_FIELDS = "fields:\n- {name: robot, type: string, required: true}\n- {name: budget, type: number}\n"


def test_writers_of_a_mission_edit_its_metadata_and_see_what_is_missing(api: Api) -> None:
    project, partner = api.project(fields_yaml=_FIELDS), people.person(api)
    mission_id = api.mission(project["id"], metadata_yaml="robot: anymal\n")["id"]
    people.grant(api, partner, Right.write, mission_id=mission_id)
    theirs = api.as_(partner.token)
    path = f"/missions/{mission_id}"
    assert theirs.patch(path, {"metadata_yaml": "robot: spot\n"}).ok()["metadata"] == {"robot": "spot"}
    problem = theirs.patch(path, {"metadata_yaml": "site: zurich\n"}).refused(422, "metadata_invalid")
    assert "robot" in str(problem["problems"])
    assert "budget" not in str(problem)
    theirs.get(f"/projects/{project['id']}").refused(404, "not_found")
    theirs.get(f"/projects/{project['id']}/template").refused(404, "not_found")


def test_readers_of_a_mission_see_no_missing_metadata(api: Api) -> None:
    project, partner = api.project(fields_yaml=_FIELDS), people.person(api)
    mission_id = api.mission(project["id"], metadata_yaml="robot: anymal\n")["id"]
    people.grant(api, partner, Right.create, mission_id=mission_id)
    problem = api.as_(partner.token).patch(f"/missions/{mission_id}", {"metadata_yaml": "x: 1\n"})
    problem.refused(403, "forbidden")
