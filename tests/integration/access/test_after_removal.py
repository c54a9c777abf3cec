"""Credentials and numbers that remain after rights were lost give no access."""

import datetime
from concurrent.futures import ThreadPoolExecutor

from kleinkram.contract.access import Right
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.upload_client import begin, upload, wait_until


def _soon() -> str:
    return (datetime.datetime.now(datetime.timezone.utc) + datetime.timedelta(days=1)).isoformat()


def test_a_share_is_suspended_while_its_creator_lacks_the_right_to_share(api: Api) -> None:
    ada, project = people.person(api), api.project()
    mission_id = api.mission(project["id"])["id"]
    upload(api, mission_id, "a.bag", b"bytes")
    grant_id = people.grant(api, ada, Right.write, project_id=project["id"])
    expected = {"name": "for a reviewer", "expires_at": _soon()}
    guest = api.as_(api.as_(ada.token).post(f"/missions/{mission_id}/shares", expected).ok(201)["secret"])
    assert [item["path"] for item in guest.all("/files")] == ["a.bag"]
    lower = {"right": Right.read.value}
    api.patch(f"/projects/{project['id']}/grants/{grant_id}", lower).ok()
    guest.get("/files").refused(401, "not_authenticated")
    people.grant(api, ada, Right.write, mission_id=mission_id)
    assert guest.get(f"/missions/{mission_id}").status == 200
    api.sql("DELETE FROM access_grant WHERE mission_id = %s", mission_id)
    api.delete(f"/projects/{project['id']}/grants/{grant_id}").ok(204)
    guest.get(f"/missions/{mission_id}").refused(401, "not_authenticated")


def test_no_credential_is_created_for_a_person_who_is_being_removed(api: Api) -> None:
    ada, project = people.person(api), api.project()
    mission_id = api.mission(project["id"])["id"]
    people.grant(api, ada, Right.write, project_id=project["id"])
    hers, shared = api.as_(ada.token), {"name": "kept", "expires_at": _soon()}
    requested = [("/tokens", {"name": "kept"}), (f"/missions/{mission_id}/shares", shared)]
    with ThreadPoolExecutor() as at_once, api.database.transaction():
        # As during a deactivation: her row is locked, and the concurrent request has authenticated before.
        api.sql("SELECT 1 FROM person WHERE id = %s FOR UPDATE", ada.id)
        answers = [at_once.submit(hers.post, path, body) for path, body in requested]
        wait_until(lambda: _waiting(api) == len(requested))
        api.sql("UPDATE person SET deactivated_at = now() WHERE id = %s", ada.id)
    for answer in answers:
        answer.result().refused(401, "not_authenticated")


def _waiting(api: Api) -> int:
    """Return how many connections wait for a lock."""
    # PostgreSQL shows a transaction the same list of connections again: without new ones, unless it is cleared.
    api.sql("SELECT pg_stat_clear_snapshot()")
    ((count,),) = api.sql(
        "SELECT count(*) FROM pg_locks WHERE NOT granted AND pid IN"
        " (SELECT pid FROM pg_stat_activity WHERE datname = current_database())"
    )
    return int(count)


def test_guests_see_neither_quota_nor_uploads_of_a_public_project(api: Api) -> None:
    project = api.project()
    mission_id = api.mission(project["id"])["id"]
    upload(api, mission_id, "there.bag", b"there")
    begin(api, mission_id, {"coming.bag": b"on its way"})
    api.patch(f"/projects/{project['id']}", {"is_public": True, "quota_bytes": 1000}).ok()
    message = api.as_(None).get(f"/projects/{project['id']}").ok()
    assert (message["quota_bytes"], message["used_bytes"], message["used_files"]) == (None, 5, 1)
    known = api.get(f"/projects/{project['id']}").ok()
    assert (known["quota_bytes"], known["used_bytes"], known["used_files"]) == (1000, 15, 2)
