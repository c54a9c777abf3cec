"""Failed sign-ins and denials are recorded, in bounded number."""

import uuid
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from kleinkram.contract.access import Right
from kleinkram.contract.errors import Forbidden
from kleinkram.server.audit import requests
from kleinkram.server.audit.requests import Refusals
from kleinkram.server.auth.bootstrap import ensure_owner
from kleinkram.server.context import AppContext
from kleinkram.server.http.dependencies import CurrentActor, Transaction
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.conftest import StartApi
from tests.integration.jobs import on_site
from tests.integration.upload_client import wait_until


def _noted(api: Api, operation: str) -> list[Any]:
    return [event for event in api.all("/audit", {"limit": "500"}) if event["operation"] == operation]


@pytest.mark.parametrize(
    ("sent", "reason"),
    [("Bearer wrong-secret", "the token is not valid here"), ("Basic eDp5", "the request has no bearer token")],
)
def test_a_failed_sign_in_is_audited_without_its_token(start_api: StartApi, sent: str, reason: str) -> None:
    api = start_api()
    headers = {"Authorization": sent, "X-Request-Id": "mine"}
    api.call("GET", f"/projects/{uuid.uuid4()}", headers=headers).refused(401, "not_authenticated")
    (event,) = _noted(api, "auth.refused")
    assert (event["actor"], event["resource_type"], event["resource_name"]) == (
        None,
        "request",
        "GET /api/v1/projects/{project_id}",
    )
    assert (event["after"]["reason"], event["address"], event["request_id"]) == (reason, "127.0.0.1", "mine")
    assert sent.split()[1] not in str(event)


def test_a_denial_is_recorded_although_the_transaction_is_rolled_back(start_api: StartApi) -> None:
    api = start_api()

    async def forbidden(db: Transaction, actor: CurrentActor) -> None:
        raise Forbidden(resource_type="project", operation="delete", needs="DELETE")

    api.app.add_api_route("/api/v1/forbidden", forbidden, operation_id="get_service")
    api.get("/forbidden").refused(403, "forbidden")
    (event,) = _noted(api, "access.denied")
    assert (event["actor"]["name"], event["resource_name"]) == ("owner", "GET /api/v1/forbidden")
    assert event["after"] == {"resource_type": "project", "operation": "delete", "needs": "DELETE"}
    assert event["address"] == "127.0.0.1"


def test_many_refusals_are_audited_in_part_without_further_statements(
    start_api: StartApi, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(requests, "PER_MINUTE", 5)
    api = start_api()
    with api.statements() as statements, ThreadPoolExecutor(4) as pool:
        calls = [pool.submit(api.call, "GET", "/projects", headers={"Authorization": "x"}) for _ in range(30)]
    assert {call.result().status for call in calls} == {401}
    assert len(_noted(api, "auth.refused")) == len(statements) == 5


def test_refusals_of_guests_hide_no_denials_and_are_summed_up(
    start_api: StartApi, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(requests, "PER_MINUTE", 3)
    monkeypatch.setattr(requests, "MINUTE_S", 2.0)
    api = start_api()
    ada, project = people.person(api), api.project()["id"]
    people.grant(api, ada, Right.read, project_id=project)
    for _ in range(8):
        api.as_(None).get("/me").refused(401, "not_authenticated")
    api.as_(ada.token).delete(f"/projects/{project}").refused(403, "forbidden")
    assert [event["actor"]["id"] for event in _noted(api, "access.denied")] == [ada.id]

    def summed() -> list[Any]:
        return [event["after"]["left_out"] for event in _noted(api, "auth.refused") if "left_out" in event["after"]]

    def ones() -> int:
        return sum("left_out" not in event["after"] for event in _noted(api, "auth.refused"))

    wait_until(lambda: bool(summed()) and sum(summed()) + ones() >= 8)
    assert sum(summed()) + ones() == 8
    assert len(summed()) <= 2


def test_each_known_actor_has_a_limit_of_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(requests, "PER_MINUTE", 2)
    noted, ada = Refusals(), uuid.uuid4()
    requested = [
        (None, 1000),
        (None, 1001),
        (None, 1030),
        (ada, 1031),
        (ada, 1032),
        (ada, 1059),
        (None, 1060),
        (ada, 1061),
    ]
    assert [noted.admits(whose, now) for whose, now in requested] == [True, True, False, True, True, False, True, True]


def test_creation_and_revocation_of_owner_tokens_are_audited(start_api: StartApi) -> None:
    api = start_api()

    async def replace(context: AppContext) -> None:
        for _ in range(2):
            async with context.database.begin() as db:
                await ensure_owner(db, "another secret")

    on_site(api, replace)
    operations = api.sql("SELECT operation, resource_id FROM audit_event WHERE resource_type = 'token' ORDER BY id")
    tokens = [row[0] for row in api.sql("SELECT id FROM token ORDER BY created_at")]
    assert operations == [("token.create", tokens[0]), ("token.revoke", tokens[0]), ("token.create", tokens[1])]


def test_owners_see_denials_in_their_projects(start_api: StartApi) -> None:
    api = start_api()  # of its own: a process notes only so many refusals a minute
    project = api.project()["id"]
    mission = api.mission(project)["id"]
    owner, reader = people.person(api), people.person(api)
    people.grant(api, owner, Right.delete, project_id=project)
    people.grant(api, reader, Right.read, mission_id=mission)
    api.as_(reader.token).delete(f"/missions/{mission}").refused(403, "forbidden")
    (event,) = api.as_(owner.token).get("/audit", {"operation": "access.denied"}).ok()["items"]
    assert (event["actor"]["id"], event["mission_id"], event["project_id"]) == (reader.id, mission, project)
