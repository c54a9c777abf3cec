"""What people and uploaders add to the checks of a mission: acceptances, notes and reports."""

from collections.abc import Sequence
from typing import Any

import pytest

from kleinkram.client import connect
from kleinkram.contract.access import Right
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.checks.judged import (
    GOOD,
    RULES,
    SECOND_NS,
    SLOW,
    checked_project,
    derive,
    failing,
    judged_mission,
    put_file,
    set_rules,
    topic,
    verdict,
)
from tests.integration.jobs import run_jobs

_IMAGES = RULES + "    images: {/camera: {}}\n"
_BLACK = {"name": "image.black", "status": "error", "message": "All pictures are black.", "topic": "/camera"}
_LIGHT = [{**_BLACK, "name": f"image.{name}", "status": "ok"} for name in ("overexposed", "frozen")]
_RATE = {"name": "topic.rate", "status": "ok", "message": "The rate is 100 Hz.", "topic": "/imu"}


@pytest.fixture(name="bad_id")
def _bad_id(api: Api) -> str:
    """A mission of which only the rate of /imu is wrong."""
    return judged_mission(api, checked_project(api), *SLOW)


def _accept(api: Api, mission_id: str, check: str = "topic.rate", **fields: Any) -> Any:
    return api.post(f"/missions/{mission_id}/check-acceptances", {"check": check, "because": "Known.", **fields})


def _report(
    api: Api,
    mission_id: str,
    document: str,
    *checks: Any,
    depth: str = "content",
    profiles: Sequence[str] = ("all robots",),
    **files: str,
) -> Any:
    rows = api.sql(
        "SELECT path, encode(sha256, 'hex') FROM file JOIN blob ON blob.id = blob_id WHERE mission_id = %s", mission_id
    )
    body = {"checks": checks, "depth": depth, "document_sha256": document, "profiles_applied": [*profiles]}
    return api.post(f"/missions/{mission_id}/check-reports", {**body, "files": {**dict(rows), **files}})


def _rules_hash(api: Api, mission_id: str) -> str:
    project_id = api.get(f"/missions/{mission_id}").ok()["project"]["id"]
    return str(api.get(f"/projects/{project_id}/checks").ok()["sha256"])


def test_an_accepted_check_no_longer_counts_until_it_is_withdrawn(api: Api, bad_id: str) -> None:
    accepted = _accept(api, bad_id, topic="/imu").ok(201)
    assert verdict(api, bad_id) == "outdated"
    run_jobs(api)
    assert (verdict(api, bad_id), failing(api, bad_id)) == ("good", [])
    result = api.get(f"/missions/{bad_id}/checks").ok()
    assert [one["because"] for one in result["acceptances"]] == ["Known."]
    (rate,) = (one for one in result["checks"] if one["name"] == "topic.rate")
    assert (rate["status"], rate["acceptance_id"], result["counts"]["accepted"]) == ("error", accepted["id"], 1)
    api.delete(f"/missions/{bad_id}/check-acceptances/{accepted['id']}").ok()
    run_jobs(api)
    assert verdict(api, bad_id) == "bad"
    assert api.get(f"/missions/{bad_id}/checks").ok()["acceptances"] == []
    (ended,) = api.get(f"/missions/{bad_id}/checks", {"all": "true"}).ok()["acceptances"]
    assert (ended["ended"], ended["ended_by"]["name"]) == ("withdrawn", accepted["created_by"]["name"])
    operations = [one["operation"] for one in api.events(bad_id)]
    assert operations[:2] == ["mission.withdraw_acceptance", "mission.accept_check"]


def test_an_acceptance_ends_when_the_files_change_and_not_when_they_are_read_again(api: Api, bad_id: str) -> None:
    _accept(api, bad_id).ok(201)
    derive(api, bad_id)
    run_jobs(api)
    assert verdict(api, bad_id) == "good"
    put_file(api, bad_id, "more.mcap", (topic("/other"),))
    run_jobs(api)
    assert verdict(api, bad_id) == "bad"
    (ended,) = api.get(f"/missions/{bad_id}/checks", {"all": "true"}).ok()["acceptances"]
    assert (ended["ended"], ended["ended_by"]) == ("files_changed", None)


def test_only_failing_checks_are_accepted_and_each_once(api: Api, bad_id: str) -> None:
    assert "fails" in _accept(api, bad_id, "topic.gap").refused(422, "invalid_request")["problems"][0]["message"]
    _accept(api, bad_id, topic="/camera").refused(422, "invalid_request")
    _accept(api, bad_id, "nonsense").refused(422, "invalid_request")
    _accept(api, bad_id, because="").refused(422, "invalid_request")
    _accept(api, bad_id).ok(201)
    assert "already" in _accept(api, bad_id).refused(422, "invalid_request")["problems"][0]["message"]


def _outcomes(api: Api, mission_id: str) -> tuple[str, list[tuple[str, str, str | None]]]:
    run_jobs(api)
    return verdict(api, mission_id), failing(api, mission_id)


def test_an_acceptance_on_all_topics_covers_those_that_failed_then(api: Api) -> None:
    rules = RULES.replace("      /imu: {rate: 100 Hz", "      '/imu*': {rate: 100 Hz")
    project_id = checked_project(api, rules)
    topics = (topic("/imu", rate_hz=50), topic("/imu2"), topic("/camera", rate_hz=10, gap_ns=SECOND_NS))
    mission_id = judged_mission(api, project_id, *topics)
    accepted = _accept(api, mission_id).ok(201)
    assert accepted["failure_count"] == 1
    assert _outcomes(api, mission_id) == ("good", [])

    # The same outcome by rules that changed elsewhere stays accepted.
    set_rules(api, project_id, rules.replace("severity: warning", "severity: warning, max_gap: 2s")).ok()
    assert _outcomes(api, mission_id) == ("good", [])
    # Another topic fails: a new failure. The acceptance stays for what it covers.
    stricter = rules.replace("/camera: {", "/camera: {rate: 20 Hz, ")
    set_rules(api, project_id, stricter).ok()
    assert _outcomes(api, mission_id) == ("warnings", [("topic.rate", "warning", "/camera")])
    # Other limits and another severity, too.
    set_rules(api, project_id, rules.replace("100 Hz", "90 Hz").replace("5%", "20%")).ok()
    assert _outcomes(api, mission_id) == ("bad", [("topic.rate", "error", "/imu")])
    set_rules(api, project_id, rules.replace("max_gap: 100ms", "severity: warning")).ok()
    assert _outcomes(api, mission_id) == ("warnings", [("topic.rate", "warning", "/imu")])

    # Accepted again, it covers what fails now, in place of the earlier one.
    set_rules(api, project_id, stricter).ok()
    run_jobs(api)
    again = _accept(api, mission_id, because="The camera, too.").ok(201)
    assert again["failure_count"] == 2
    assert _outcomes(api, mission_id) == ("good", [])
    read = api.get(f"/missions/{mission_id}/checks", {"all": "true"}).ok()
    assert [(one["id"], one["ended"]) for one in read["acceptances"]] == [
        (again["id"], None),
        (accepted["id"], "replaced"),
    ]
    assert {one["acceptance_id"] for one in read["checks"] if one["status"] in ("error", "warning")} == {again["id"]}
    assert read["acceptances"][1]["ended_by"] == read["acceptances"][0]["created_by"]


def test_a_check_by_earlier_rules_cannot_be_accepted(api: Api, bad_id: str) -> None:
    project_id = api.get(f"/missions/{bad_id}").ok()["project"]["id"]
    set_rules(api, project_id, RULES.replace("100 Hz", "400 Hz")).ok()
    assert "wait for its new checks" in str(_accept(api, bad_id).refused(422, "invalid_request"))
    run_jobs(api)
    _accept(api, bad_id).ok(201)


def test_an_accepted_check_is_a_state_of_its_own_in_the_matrix(api: Api, bad_id: str) -> None:
    project_id = api.get(f"/missions/{bad_id}").ok()["project"]["id"]
    _accept(api, bad_id).ok(201)
    run_jobs(api)
    (row,) = api.get(f"/projects/{project_id}/checks/matrix").ok()["items"]
    assert (row["verdict"], row["cells"]["topic.rate"], row["cells"]["topic.gap"]) == ("good", "accepted", "ok")


def test_readers_see_acceptances_and_notes_and_add_none(api: Api, bad_id: str) -> None:
    reader, stranger = people.person(api), people.person(api)
    people.grant(api, reader.group_id, Right.read, mission_id=bad_id)
    note = {"check": "topic.rate", "text": "The cable."}
    _accept(api.as_(reader.token), bad_id).refused(403, "forbidden")
    api.as_(reader.token).post(f"/missions/{bad_id}/check-notes", note).refused(403, "forbidden")
    _report(api.as_(reader.token), bad_id, "0" * 64, _RATE).refused(403, "forbidden")
    _accept(api.as_(stranger.token), bad_id).refused(404, "not_found")
    api.as_(stranger.token).get(f"/missions/{bad_id}/checks").refused(404, "not_found")
    made = api.post(f"/missions/{bad_id}/check-notes", note).ok(201)
    assert api.as_(reader.token).get(f"/missions/{bad_id}/checks").ok()["notes"] == [made]
    api.as_(reader.token).delete(f"/missions/{bad_id}/check-notes/{made['id']}").refused(403, "forbidden")
    api.delete(f"/missions/{bad_id}/check-notes/{made['id']}").ok(204)
    api.delete(f"/missions/{bad_id}/check-notes/{made['id']}").refused(404, "not_found")


def test_a_link_to_one_file_shows_no_checks(api: Api, bad_id: str) -> None:
    file_id = put_file(api, bad_id, "shown.mcap", (topic("/other"),))
    run_jobs(api)
    guest = api.as_(people.share(api, bad_id, file_ids=[file_id]).secret)
    result = guest.get(f"/missions/{bad_id}/checks").ok()
    assert (result["verdict"], result["checks"], result["counts"]["error"]) == ("unchecked", [], 0)
    assert guest.get(f"/missions/{bad_id}").ok()["verdict"] == "unchecked"
    whole = api.as_(people.share(api, bad_id).secret)
    assert whole.get(f"/missions/{bad_id}/checks").ok()["verdict"] == "bad"


def test_a_report_of_an_uploader_adds_the_checks_of_content(api: Api) -> None:
    mission_id = judged_mission(api, checked_project(api, _IMAGES), *GOOD)
    assert verdict(api, mission_id) == "unchecked"
    assert api.get(f"/missions/{mission_id}").ok()["checks"]["needs_content"] > 0
    report = _report(api, mission_id, _rules_hash(api, mission_id), _BLACK, *_LIGHT, _RATE).ok(201)
    assert (report["is_current"], report["verdict"], report["check_count"]) == (True, "bad", 4)
    run_jobs(api)
    assert failing(api, mission_id) == [("image.black", "error", "/camera")]
    checks = api.get(f"/missions/{mission_id}/checks").ok()["checks"]
    assert {one["source"] for one in checks if one["name"] == "image.black"} == {"report"}
    assert {one["source"] for one in checks if one["name"] == "topic.rate"} == {"server"}
    assert not [one for one in checks if one["status"] == "needs_content"]


def test_a_report_of_other_files_does_not_count(api: Api) -> None:
    mission_id = judged_mission(api, checked_project(api, _IMAGES), *GOOD)
    sha256 = _rules_hash(api, mission_id)
    assert _report(api, mission_id, sha256, _BLACK, **{"run.mcap": "0" * 64}).ok(201)["is_current"] is False
    assert _report(api, mission_id, sha256, _BLACK, **{"gone.mcap": "0" * 64}).ok(201)["is_current"] is False
    run_jobs(api)
    assert verdict(api, mission_id) == "unchecked"
    result = api.get(f"/missions/{mission_id}/checks").ok()
    assert result["reports"] == []
    assert len(api.get(f"/missions/{mission_id}/checks", {"all": "true"}).ok()["reports"]) == 2


def test_a_report_before_the_upload_counts_once_its_files_are_there(api: Api) -> None:
    project_id = checked_project(api, _IMAGES)
    mission_id = str(api.mission(project_id)["id"])
    first = put_file(api, mission_id, "run.mcap", GOOD)
    ((sha256,),) = api.sql(
        "SELECT encode(sha256, 'hex') FROM blob JOIN file ON blob_id = blob.id AND file.id = %s", first
    )
    api.sql("UPDATE file SET deleted_at = now(), deleted_by_id = uploaded_by_id WHERE id = %s", first)
    body = {"checks": [_BLACK], "depth": "content", "document_sha256": _rules_hash(api, mission_id)}
    body["profiles_applied"] = ["all robots"]
    api.post(f"/missions/{mission_id}/check-reports", {**body, "files": {"run.mcap": sha256}}).ok(201)
    run_jobs(api)
    assert verdict(api, mission_id) == "unchecked"
    api.sql("UPDATE file SET deleted_at = NULL, deleted_by_id = NULL WHERE id = %s", first)
    derive(api, mission_id)
    run_jobs(api)
    assert failing(api, mission_id) == [("image.black", "error", "/camera")]


def test_content_that_was_checked_by_earlier_rules_only_is_outdated(api: Api) -> None:
    project_id = checked_project(api, _IMAGES)
    mission_id = judged_mission(api, project_id, *GOOD)
    _report(api, mission_id, _rules_hash(api, mission_id), _BLACK).ok(201)
    run_jobs(api)
    assert verdict(api, mission_id) == "bad"
    set_rules(api, project_id, _IMAGES.replace("100ms", "200ms")).ok()
    run_jobs(api)
    assert verdict(api, mission_id) == "outdated"
    passed = {**_BLACK, "status": "ok"}
    _report(api, mission_id, _rules_hash(api, mission_id), passed, *_LIGHT).ok(201)
    run_jobs(api)
    assert verdict(api, mission_id) == "good"


def test_content_that_was_checked_by_other_profiles_is_outdated(api: Api) -> None:
    project_id = checked_project(api, RULES + "  - name: night\n    when: {night: true}\n    images: {/camera: {}}\n")
    mission_id = judged_mission(api, project_id, *GOOD)
    _report(api, mission_id, _rules_hash(api, mission_id), _RATE).ok(201)
    run_jobs(api)
    assert verdict(api, mission_id) == "good"
    api.patch(f"/missions/{mission_id}", {"metadata": {"night": True}}).ok()
    run_jobs(api)
    assert verdict(api, mission_id) == "outdated"
    assert api.get(f"/missions/{mission_id}").ok()["checks"]["needs_content"] == 3


def test_content_of_the_same_checks_by_other_profiles_is_outdated(api: Api) -> None:
    stricter = "  - name: night\n    when: {night: true}\n    images: {/camera: {min_brightness: 40}}\n"
    mission_id = judged_mission(api, checked_project(api, _IMAGES + stricter), *GOOD)
    passed, sha256 = {**_BLACK, "status": "ok"}, _rules_hash(api, mission_id)
    _report(api, mission_id, sha256, passed, *_LIGHT).ok(201)
    run_jobs(api)
    assert verdict(api, mission_id) == "good"
    api.patch(f"/missions/{mission_id}", {"metadata": {"night": True}}).ok()
    run_jobs(api)
    assert verdict(api, mission_id) == "outdated", "the stricter bound was not checked"
    report = _report(api, mission_id, sha256, passed, *_LIGHT, profiles=["night", "all robots"]).ok(201)
    assert report["is_current"] is True
    run_jobs(api)
    assert verdict(api, mission_id) == "good"


def test_a_check_of_earlier_files_cannot_be_accepted(api: Api, bad_id: str) -> None:
    put_file(api, bad_id, "more.mcap", (topic("/other"),))
    problem = _accept(api, bad_id, topic="/imu").refused(422, "invalid_request")
    assert "wait for its new checks" in str(problem)
    run_jobs(api)
    _accept(api, bad_id, topic="/imu").ok(201)


def test_the_latest_reports_of_each_person_stay(api: Api) -> None:
    mission_id = judged_mission(api, checked_project(api, _IMAGES), *GOOD)
    sha256 = _rules_hash(api, mission_id)
    first = _report(api, mission_id, sha256, _BLACK).ok(201)["id"]
    helper = people.person(api)
    people.grant(api, helper.group_id, Right.create, mission_id=mission_id)
    other = api.as_(helper.token)
    passed = {**_BLACK, "status": "ok"}
    made = [_report(other, mission_id, f"{number:064x}", _RATE).ok(201)["id"] for number in range(7)]
    made.append(_report(other, mission_id, sha256, passed, *_LIGHT).ok(201)["id"])
    listed = api.get(f"/missions/{mission_id}/checks", {"all": "true"}).ok()["reports"]
    assert [one["id"] for one in listed] == [*made[:2:-1], first]
    run_jobs(api)
    assert failing(api, mission_id) == [("image.black", "error", "/camera")], "what another person found still counts"
    _report(api, mission_id, sha256, passed, *_LIGHT).ok(201)
    run_jobs(api)
    assert (verdict(api, mission_id), failing(api, mission_id)) == ("good", [])


def test_without_rules_of_the_project_the_report_is_the_verdict(api: Api) -> None:
    mission_id = judged_mission(api, str(api.project()["id"]), *GOOD)
    _report(api, mission_id, "0" * 64, _RATE, _BLACK).ok(201)
    run_jobs(api)
    assert (verdict(api, mission_id), failing(api, mission_id)) == ("bad", [("image.black", "error", "/camera")])


def test_a_report_with_ten_thousand_checks_is_stored_and_one_more_is_refused(api: Api) -> None:
    mission_id = judged_mission(api, str(api.project()["id"]), *GOOD)
    checks = [{**_RATE, "topic": f"/t{number}"} for number in range(10_000)]
    _report(api, mission_id, "0" * 64, *checks).ok(201)
    run_jobs(api)
    assert api.get(f"/missions/{mission_id}").ok()["checks"]["ok"] == 10_000
    listed = connect(api.url, token=api.token).checks.mission(mission_id).checks
    assert [one.topic for one in listed] == [f"/t{number}" for number in range(10_000)]
    _report(api, mission_id, "0" * 64, *checks, _RATE).refused(422, "invalid_request")


@pytest.mark.parametrize(
    "fault",
    [
        {"value": float("nan")},
        {"value": float("inf")},
        {"status": "great"},
        {"message": ""},
        {"name": "no dots"},
        {"file": "../x"},
        {"topic": "a\x00b"},
    ],
)
def test_a_faulty_report_is_refused(api: Api, bad_id: str, fault: Any) -> None:
    _report(api, bad_id, "0" * 64, {**_RATE, **fault}).refused(422, "invalid_request")


def test_a_report_above_the_limit_of_other_requests_is_stored(api: Api, bad_id: str) -> None:
    checks = [{**_RATE, "topic": f"/imu/{number}", "message": "m" * 600} for number in range(9_999)]
    stored = _report(api, bad_id, _rules_hash(api, bad_id), _BLACK, *checks).ok(201)
    assert (stored["check_count"], stored["verdict"]) == (10_000, "bad")
