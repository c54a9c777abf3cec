"""The token of a run: valid for its mission, while it runs, with the rights of its action and its starter."""

from typing import Any

import pytest

from kleinkram.contract.access import Right
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.runs.conftest import FakeRunner, Place, launch
from tests.integration.upload_client import upload


def _begun(lab: Api, runner: FakeRunner, place: Place, **values: Any) -> tuple[Any, Api]:
    """Start a run with access to the API; return the claim, and the API with the token of the run."""
    launch(lab, runner, place.mission, network="api", **values)
    claim = runner.claim()
    runner.heartbeat(claim)
    return claim, lab.as_(claim["token"])


def test_a_run_without_network_has_no_token(lab: Api, runner: FakeRunner, place: Place) -> None:
    launch(lab, runner, place.mission)
    assert runner.claim()["token"] is None


def test_a_run_token_sees_its_mission_only(lab: Api, runner: FakeRunner, place: Place) -> None:
    other = lab.mission(place.project["id"])
    _, run = _begun(lab, runner, place)
    assert [entry["id"] for entry in run.all("/missions")] == [place.mission["id"]]
    run.get(f"/missions/{place.mission['id']}").ok()
    run.get(f"/missions/{other['id']}").refused(404, "not_found")
    run.get(f"/projects/{place.project['id']}").refused(404, "not_found")
    assert len(run.all("/files")) == 2


def test_a_run_token_sees_its_run_only(lab: Api, runner: FakeRunner, place: Place) -> None:
    earlier = launch(lab, runner, place.mission)
    runner.finish(runner.claim()).ok()
    claim, run = _begun(lab, runner, place)
    assert [entry["id"] for entry in run.all("/runs")] == [claim["run_id"]]
    run.get(f"/runs/{earlier['id']}").refused(404, "not_found")


def test_a_run_token_has_the_permissions_of_its_action_only(lab: Api, runner: FakeRunner, place: Place) -> None:
    """The person who started it owns the server and may do everything."""
    _, reading = _begun(lab, runner, place)
    file_id = place.files["drive.bin"]["id"]
    reading.post(f"/missions/{place.mission['id']}/uploads", {"files": [{"path": "a", "size_bytes": 1}]}).refused(
        403, "scope_missing"
    )
    _, filling = _begun(lab, runner, place, right="CREATE")
    upload(filling, place.mission["id"], "made", b"made")
    filling.patch(f"/missions/{place.mission['id']}", {"notes": "x"}).refused(403, "scope_missing")
    _, writing = _begun(lab, runner, place, right="WRITE")
    writing.patch(f"/missions/{place.mission['id']}", {"notes": "x"}).ok()
    writing.delete(f"/files/{file_id}").refused(403, "forbidden")
    _, deleting = _begun(lab, runner, place, right="DELETE")
    deleting.delete(f"/files/{file_id}").ok()


def test_a_run_token_is_neither_an_admin_nor_a_person(lab: Api, runner: FakeRunner, place: Place) -> None:
    _, run = _begun(lab, runner, place, right="DELETE")
    for path in ("/admin/settings", "/runners", "/tokens", "/me/sessions"):
        assert run.get(path).status == 403
    run.post("/tokens", {"name": "more"}).refused(403, "scope_missing")
    run.post("/runs", {"mission_ids": [place.mission["id"]], "definition": {"name": "a", "script": "x"}}).refused(
        403, "scope_missing"
    )


def test_the_token_of_a_run_identifies_it(lab: Api, runner: FakeRunner, place: Place) -> None:
    _, run = _begun(lab, runner, place)
    me = run.get("/me").ok()
    assert (me["credential"]["kind"], me["credential"]["is_limited"]) == ("run", True)
    assert (me["emails"], me["groups"], me["is_admin"]) == ([], [], False)


def test_a_run_token_ends_with_the_run(lab: Api, runner: FakeRunner, place: Place) -> None:
    claim, run = _begun(lab, runner, place)
    runner.finish(claim).ok()
    run.get("/me").refused(401, "not_authenticated")


def test_a_run_token_survives_an_abandoned_request_of_its_runner(lab: Api, runner: FakeRunner, place: Place) -> None:
    """A request whose connection broke still waits, and receives the run although the next request received it, too."""
    claim, run = _begun(lab, runner, place)
    runner.active_ids.clear()
    again = runner.claim()
    assert again["run_id"] == claim["run_id"]
    for entry in (run, lab.as_(again["token"])):
        entry.get("/me").ok()
    runner.finish(claim).ok()
    for entry in (run, lab.as_(again["token"])):
        entry.get("/me").refused(401, "not_authenticated")


def test_a_run_token_ends_when_the_run_moves_to_another_runner(lab: Api, runner: FakeRunner, place: Place) -> None:
    claim, run = _begun(lab, runner, place)
    lab.sql("UPDATE run SET lease_ends_at = now() - interval '1 s' WHERE id = %s", claim["run_id"])
    runner.claim()
    run.get("/me").refused(401, "not_authenticated")


def test_a_run_token_follows_the_current_rights_of_its_starter(lab: Api, runner: FakeRunner, place: Place) -> None:
    starter = people.person(lab)
    grant = people.grant(lab, starter, Right.write, mission_id=place.mission["id"])
    mine = lab.as_(people.token(lab, starter).secret)
    launch(mine, runner, place.mission, network="api", right="WRITE")
    run = lab.as_(runner.claim()["token"])
    run.patch(f"/missions/{place.mission['id']}", {"notes": "x"}).ok()
    lab.sql("UPDATE access_grant SET level = 1 WHERE id = %s", grant)
    run.patch(f"/missions/{place.mission['id']}", {"notes": "y"}).refused(403, "forbidden")
    lab.sql("DELETE FROM access_grant WHERE id = %s", grant)
    run.get(f"/missions/{place.mission['id']}").refused(404, "not_found")


def test_losing_the_right_cancels_queued_runs(lab: Api, runner: FakeRunner, place: Place) -> None:
    starter = people.person(lab)
    grant = people.grant(lab, starter, Right.create, mission_id=place.mission["id"])
    made = launch(lab.as_(people.token(lab, starter).secret), runner, place.mission)
    lab.sql("DELETE FROM access_grant WHERE id = %s", grant)
    assert runner.claim() is None
    seen = lab.get(f"/runs/{made['id']}").ok()
    assert (seen["state"], seen["reason"]) == ("cancelled", "cancelled")
    assert "may not run it" in seen["message"]


def test_launching_requires_the_right_of_the_action(lab: Api, runner: FakeRunner, place: Place) -> None:
    starter = people.person(lab)
    people.grant(lab, starter, Right.create, mission_id=place.mission["id"])
    mine = lab.as_(people.token(lab, starter).secret)
    launch(mine, runner, place.mission)
    expected = {"mission_ids": [place.mission["id"]], "definition": {"name": "a", "script": "x", "right": "WRITE"}}
    (refused,) = mine.post("/runs", expected).ok()["items"]
    assert (refused["outcome"], refused["problem"]["code"]) == ("refused", "forbidden")


def test_a_runners_token_claims_and_reports_and_nothing_else(lab: Api, runner: FakeRunner, place: Place) -> None:
    for path in ("/missions", "/files", "/runs", "/actions", "/runners", "/home"):
        assert runner.api.get(path).status == 403
    launch(lab, runner, place.mission)
    claim = runner.claim()
    runner.api.get(f"/runs/{claim['run_id']}").refused(403, "scope_missing")
    other = launch(lab, runner, place.mission)
    requested = {"attempt": 1, "paths": ["drive.bin"]}
    runner.api.post(f"/runner/runs/{other['id']}/inputs", requested).refused(409, "run_gone")
    assert len(runner.api.post(f"/runner/runs/{claim['run_id']}/inputs", requested).ok()["urls"]) == 1


@pytest.mark.parametrize("state", ["preparing", "running"])
def test_a_run_token_does_not_end_before_its_job(lab: Api, runner: FakeRunner, place: Place, state: str) -> None:
    """A job may wait in the queue of a cluster for days, at first or after a failure of its node."""
    launch(lab, runner, place.mission, network="api", resources={"time_s": 600})
    claim = runner.claim()
    lab.sql("UPDATE token SET expires_at = now() + interval '2 minutes' WHERE run_id = %s", claim["run_id"])
    runner.heartbeat(claim, state)
    query = "SELECT expires_at > now() + interval '1 hour' FROM token WHERE run_id = %s"
    assert lab.sql(query, claim["run_id"]) == [(True,)]
