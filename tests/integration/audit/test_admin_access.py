"""Changes that needed admin rights are marked, and no others."""

from collections.abc import Callable
from typing import Any

import pytest

from kleinkram.contract.access import Right, Scope
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.conftest import StartApi
from tests.integration.people import Person
from tests.integration.sample import Sample


@pytest.fixture
def admin(api: Api) -> Person:
    """An admin without rights of their own."""
    return people.person(api, admin=True)


def _marks(api: Api, who: Person) -> list[tuple[str, bool]]:
    return [(event["operation"], event["as_admin"]) for event in reversed(api.all("/audit", {"person_id": who.id}))]


def test_access_to_own_data_is_not_recorded_as_admin_access(api: Api, admin: Person, sample: Sample) -> None:
    requested = api.as_(admin.token)
    project = requested.project()["id"]
    mission = requested.mission(project)["id"]
    file_id = sample.file(mission, "a.mcap")
    requested.post("/files/download", {"file_ids": [file_id]}).ok()
    requested.patch(f"/projects/{project}", {"description": "x"}).ok()
    requested.delete(f"/projects/{project}").ok()
    requested.post(f"/trash/project/{project}/restore").ok(204)
    marks = _marks(api, admin)
    assert len(marks) == 6
    assert not any(marked for _, marked in marks)


Act = Callable[[Api, dict[str, str]], Any]
ACTS: dict[str, tuple[Right, Act]] = {
    "file.download": (Right.read, lambda api, at: api.post("/files/download", {"file_ids": [at["file"]]}).ok()),
    "file.verify": (Right.read, lambda api, at: api.post(f"/files/{at['file']}/verify").ok(202)),
    "mission.create": (Right.create, lambda api, at: api.mission(at["project"])),
    "mission.update": (Right.write, lambda api, at: api.patch(f"/missions/{at['mission']}", {"notes": "x"}).ok()),
    "project.update": (Right.write, lambda api, at: api.patch(f"/projects/{at['project']}", {"description": "x"}).ok()),
    "file.update": (Right.write, lambda api, at: api.patch(f"/files/{at['file']}", {"path": "b.mcap"}).ok()),
    "file.delete": (Right.delete, lambda api, at: api.delete(f"/files/{at['file']}").ok()),
    "mission.delete": (Right.delete, lambda api, at: api.delete(f"/missions/{at['mission']}").ok()),
    "project.delete": (Right.delete, lambda api, at: api.delete(f"/projects/{at['project']}").ok()),
}


@pytest.mark.parametrize("operation", ACTS)
@pytest.mark.parametrize("on_mission", [False, True])
def test_access_beyond_own_rights_is_recorded_as_admin_access(
    api: Api, sample: Sample, operation: str, on_mission: bool
) -> None:
    needed, act = ACTS[operation]
    for locked in [None, *Right]:
        admin = people.person(api, admin=True)
        project = api.project()["id"]
        mission = api.mission(project)["id"]
        place = {"mission_id": mission} if on_mission else {"project_id": project}
        if locked is not None:
            people.grant(api, admin, locked, **place)
        act(api.as_(admin.token), {"project": project, "mission": mission, "file": sample.file(mission, "a.mcap")})
        helps = locked is not None and not (
            on_mission and operation in {"project.update", "project.delete", "mission.create"}
        )
        enough = helps and locked is not None and locked.level >= needed.level
        assert _marks(api, admin)[-1] == (operation, not enough), locked


def test_downloads_of_public_data_are_not_recorded_as_admin_access(api: Api, sample: Sample, admin: Person) -> None:
    project = api.project()["id"]
    file_id = sample.file(api.mission(project)["id"], "a.mcap")
    api.sql("UPDATE project SET is_public = true WHERE id = %s", project)
    api.as_(admin.token).post("/files/download", {"file_ids": [file_id]}).ok()
    assert _marks(api, admin)[-1] == ("file.download", False)


def test_a_move_requires_rights_on_both_projects(api: Api, admin: Person) -> None:
    source, target = api.project()["id"], api.project()["id"]
    mission = api.mission(source)["id"]
    people.grant(api, admin, Right.create, project_id=target)
    people.grant(api, admin, Right.write, project_id=source)
    api.as_(admin.token).patch(f"/missions/{mission}", {"project_id": target}).ok()
    assert _marks(api, admin)[-2:] == [("mission.move_out", True), ("mission.move_in", False)]


def test_a_token_without_admin_rights_is_not_marked_as_admin_access(api: Api, admin: Person, sample: Sample) -> None:
    plain = people.token(api, admin.id, [Scope.write])
    project = api.project()["id"]
    people.grant(api, admin, Right.write, project_id=project)
    api.as_(plain.secret).patch(f"/projects/{project}", {"description": "x"}).ok()
    api.as_(plain.secret).delete(f"/projects/{project}").refused(403, "forbidden")
    assert _marks(api, admin) == [("project.update", False), ("access.denied", False)]


@pytest.mark.parametrize(("creators", "needs_admin"), [("everybody", False), ("affiliated", False), ("admins", True)])
def test_creating_a_project_is_admin_access_if_the_setting_requires_admins(
    start_api: StartApi, creators: str, needs_admin: bool
) -> None:
    api = start_api(creators=creators)
    admin = people.person(api, admin=True)
    api.as_(admin.token).project()
    api.as_(admin.token).post("/groups", {"name": "field team"}).ok(201)
    assert _marks(api, admin) == [("project.create", needs_admin), ("group.create", needs_admin)]
