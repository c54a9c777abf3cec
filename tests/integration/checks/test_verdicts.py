"""Verdicts of missions, from the index of their files and the `checks.yaml` of their project."""

import uuid
from typing import Any

import pytest

from kleinkram.client import connect
from kleinkram.contract.checks import Verdict
from kleinkram.server.checks.judge import judge_missions
from kleinkram.server.context import AppContext
from tests.integration.api_server import Api
from tests.integration.checks.judged import (
    GOOD,
    RULES,
    SECOND_NS,
    SLOW,
    START_NS,
    checked_project,
    derive,
    failing,
    judged_mission,
    judging_jobs,
    put_file,
    set_rules,
    topic,
    verdict,
)
from tests.integration.jobs import on_site, run_jobs


@pytest.fixture(name="project_id")
def _project_id(api: Api) -> str:
    return checked_project(api)


def test_a_good_mission_is_good_and_lists_what_was_checked(api: Api, project_id: str) -> None:
    mission_id = judged_mission(api, project_id, *GOOD)
    assert verdict(api, mission_id) == "good"
    result = api.get(f"/missions/{mission_id}/checks").ok()
    assert {one["status"] for one in result["checks"]} == {"ok"}
    assert {one["name"] for one in result["checks"]} >= {"topic.missing", "topic.rate", "topic.gap"}
    assert (result["is_current"], result["checks_number"], result["profiles_applied"]) == (True, 1, ["all robots"])
    assert result["counts"]["ok"] == len(result["checks"]) == api.get(f"/missions/{mission_id}").ok()["checks"]["ok"]


def test_a_wrong_rate_makes_a_mission_bad_with_value_and_limit(api: Api, project_id: str) -> None:
    mission_id = judged_mission(api, project_id, *SLOW)
    assert verdict(api, mission_id) == "bad"
    assert failing(api, mission_id) == [("topic.rate", "error", "/imu")]
    (rate,) = (one for one in api.get(f"/missions/{mission_id}/checks").ok()["checks"] if one["status"] == "error")
    assert (rate["value"], rate["unit"], rate["source"]) == (50, "Hz", "server")


def test_the_checks_of_a_mission_come_in_pages_and_by_name_and_status(api: Api) -> None:
    project_id = checked_project(api, RULES.replace("/imu:", '"/*":'))
    mission_id = judged_mission(api, project_id, *SLOW, topic("/lidar"))
    path = f"/missions/{mission_id}/checks"
    api.post(f"/missions/{mission_id}/check-notes", {"check": "topic.rate", "text": "Known."}).ok(201)
    whole = api.get(path).ok()
    assert (len(whole["checks"]), whole["next"]) == (8, None)
    pages: list[dict[str, Any]] = []
    cursor: dict[str, str] = {}
    while not pages or pages[-1]["next"] is not None:
        pages.append(api.get(path, {"limit": "3", **cursor}).ok())
        cursor = {"cursor": pages[-1]["next"]}
    assert [len(page["checks"]) for page in pages] == [3, 3, 2]
    assert [check for page in pages for check in page["checks"]] == whole["checks"]
    assert {(page["verdict"], page["evaluated_at"], page["counts"]["ok"]) for page in pages} == {
        ("bad", whole["evaluated_at"], 6)
    }
    assert [len(page["notes"]) for page in pages] == [1, 0, 0]

    def matching(**query: str) -> list[tuple[str, str]]:
        result = api.get(path, query).ok()
        assert result["counts"] == whole["counts"], "of all checks"
        return [(one["name"], one["topic"]) for one in result["checks"]]

    assert matching(status="error") == [("topic.rate", "/camera"), ("topic.rate", "/imu")]
    assert matching(name="topic.rate", status="ok") == [("topic.rate", "/lidar")]
    assert [name for name, _ in matching(name="topic.g*")] == ["topic.gap"] * 3
    assert matching(name="image.*") == []
    api.get(path, {"cursor": "other"}).refused(422, "invalid_cursor")
    api.get(path, {"status": "fine"}).refused(422, "invalid_request")
    api.get(path, {"limit": "501"}).refused(422, "invalid_request")


def test_a_rule_that_only_warns_makes_warnings(api: Api, project_id: str) -> None:
    mission_id = judged_mission(api, project_id, GOOD[0])
    assert (verdict(api, mission_id), failing(api, mission_id)) == (
        "warnings",
        [("topic.missing", "warning", "/camera")],
    )


def test_missions_of_a_project_without_rules_are_unchecked_and_cost_no_job(api: Api) -> None:
    mission_id = str(api.mission(api.project()["id"])["id"])
    put_file(api, mission_id, "run.mcap", SLOW)
    assert "judge_mission" not in run_jobs(api)
    assert verdict(api, mission_id) == "unchecked"


def test_a_mission_without_files_is_unchecked_also_after_its_files_are_deleted(api: Api, project_id: str) -> None:
    mission_id = str(api.mission(project_id)["id"])
    run_jobs(api)
    assert verdict(api, mission_id) == "unchecked"
    file_id = put_file(api, mission_id, "run.mcap", SLOW)
    run_jobs(api)
    assert verdict(api, mission_id) == "bad"
    api.delete(f"/files/{file_id}").ok()
    run_jobs(api)
    assert (verdict(api, mission_id), failing(api, mission_id)) == ("unchecked", [])


def test_a_mission_without_recordings_lacks_its_topics(api: Api, project_id: str) -> None:
    mission_id = str(api.mission(project_id)["id"])
    put_file(api, mission_id, "notes.txt", (), content="opaque", format="unknown", start_ns=None, end_ns=None)
    run_jobs(api)
    assert verdict(api, mission_id) == "bad"
    assert ("topic.missing", "error", "/imu") in failing(api, mission_id)


def test_a_broken_recording_makes_a_mission_bad_with_the_reason(api: Api) -> None:
    project_id = checked_project(api, 'version: 1\nprofiles:\n  - recordings: {"*": {complete: true}}\n')
    mission_id = str(api.mission(project_id)["id"])
    put_file(api, mission_id, "run.mcap", GOOD, content="broken", content_reason="cut at byte 4711")
    run_jobs(api)
    assert verdict(api, mission_id) == "bad"
    (broken,) = (one for one in api.get(f"/missions/{mission_id}/checks").ok()["checks"] if one["status"] == "error")
    assert broken["name"] == "recording.incomplete"
    assert "4711" in broken["message"]


def test_while_files_are_read_a_mission_is_running_not_bad(api: Api, project_id: str) -> None:
    mission_id = str(api.mission(project_id)["id"])
    assert verdict(api, mission_id) == "unchecked"
    put_file(api, mission_id, "run.mcap", (), content="pending", summarised_at=None)
    assert verdict(api, mission_id) == "running"
    run_jobs(api)
    assert verdict(api, mission_id) == "running"


def test_newer_files_make_a_verdict_outdated_until_it_is_judged_again(api: Api, project_id: str) -> None:
    mission_id = judged_mission(api, project_id, *GOOD)
    put_file(api, mission_id, "second.mcap", (topic("/imu", rate_hz=10),))
    assert verdict(api, mission_id) == "outdated"
    assert api.get(f"/missions/{mission_id}/checks").ok()["is_current"] is False
    run_jobs(api)
    assert verdict(api, mission_id) == "bad"


def test_new_rules_judge_every_mission_again_by_one_job(api: Api, project_id: str) -> None:
    missions = [judged_mission(api, project_id, *GOOD) for _ in range(3)]
    set_rules(api, project_id, RULES.replace("100 Hz", "400 Hz")).ok()
    assert {verdict(api, one) for one in missions} == {"outdated"}
    assert judging_jobs(api) == ["judge_project"]
    assert {verdict(api, one) for one in missions} == {"bad"}
    set_rules(api, project_id, "").ok()
    run_jobs(api)
    assert {verdict(api, one) for one in missions} == {"unchecked"}


def test_profiles_apply_by_metadata_and_again_when_these_change(api: Api) -> None:
    text = RULES.replace("    topics:", "    when: {robot: anymal}\n    topics:")
    project_id = checked_project(api, text)
    mission_id = judged_mission(api, project_id, *SLOW, metadata={"robot": "spot"})
    assert verdict(api, mission_id) == "unchecked"
    (left_out,) = api.get(f"/missions/{mission_id}/checks").ok()["profiles_left_out"]
    assert left_out["name"] == "all robots"
    assert "spot" in left_out["reason"]
    api.patch(f"/missions/{mission_id}", {"metadata": {"robot": "anymal"}}).ok()
    assert verdict(api, mission_id) == "outdated"
    run_jobs(api)
    assert verdict(api, mission_id) == "bad"


def test_a_moved_mission_is_judged_by_the_rules_of_its_new_project(api: Api, project_id: str) -> None:
    mission_id = judged_mission(api, project_id, *SLOW)
    other = checked_project(api, RULES.replace("100 Hz", "50 Hz"))
    api.patch(f"/missions/{mission_id}", {"project_id": other}).ok()
    assert verdict(api, mission_id) == "outdated"
    run_jobs(api)
    assert verdict(api, mission_id) == "good"


def test_a_rule_that_matches_no_topic_is_not_made_or_missing(api: Api) -> None:
    rules = "version: 1\nprofiles:\n  - topics: {/nothing/*: {}}\n    images: {/camera/*: {}}\n"
    mission_id = judged_mission(api, checked_project(api, rules), *GOOD)
    assert verdict(api, mission_id) == "bad"
    statuses = {(name, status) for name, status, _ in failing(api, mission_id)}
    assert ("topic.missing", "error") in statuses
    assert ("image.black", "not_made") in statuses


def test_files_that_a_run_made_are_not_checked(api: Api) -> None:
    project_id = checked_project(api, "version: 1\nprofiles:\n  - files: {'*.bag': {required: true}}\n")
    mission_id = judged_mission(api, project_id, *GOOD)
    made = put_file(api, mission_id, "converted.bag", GOOD, format="rosbag1")
    api.sql("UPDATE file SET origin = 'run' WHERE id = %s", made)
    derive(api, mission_id)
    run_jobs(api)
    assert failing(api, mission_id) == [("file.missing", "error", None)]


def test_judging_twice_changes_nothing_and_keeps_the_time_since_a_mission_is_bad(api: Api, project_id: str) -> None:
    mission_id = judged_mission(api, project_id, *SLOW)
    before = api.get(f"/missions/{mission_id}/checks").ok()
    derive(api, mission_id)
    run_jobs(api)
    after = api.get(f"/missions/{mission_id}/checks").ok()
    assert before["bad_since"] == after["bad_since"] is not None
    assert before["checks"] == after["checks"]
    set_rules(api, project_id, RULES.replace("100 Hz", "50 Hz")).ok()
    run_jobs(api)
    assert api.get(f"/missions/{mission_id}/checks").ok()["bad_since"] is None


def test_more_checks_than_are_listed_say_how_many_are_left_out(api: Api) -> None:
    globs = "".join(f"      '/t*{number}': {{rate: 5 Hz, max_gap: 1ms, required: false}}\n" for number in range(10))
    project_id = checked_project(api, f"version: 1\nprofiles:\n  - topics:\n{globs}")
    topics = [topic(f"/t{number}", rate_hz=10) for number in range(6_000)]
    mission_id = judged_mission(api, project_id, *topics)
    result = connect(api.url, token=api.token).checks.mission(mission_id)
    assert (len(result.checks), result.next) == (10_000, None)
    assert (result.checks[-1].name, result.checks[-1].status.value) == ("checks.left_out", "not_made")
    assert result.verdict is Verdict.bad


def test_judging_ends_early_where_it_takes_long_and_continues(api: Api) -> None:
    project_id = str(api.project()["id"])
    ids = sorted(uuid.UUID(judged_mission(api, project_id, *GOOD)) for _ in range(3))
    set_rules(api, project_id, RULES).ok()
    judged = "SELECT mission_id FROM mission_checks WHERE project_id = %s ORDER BY mission_id"

    async def judge(context: AppContext) -> uuid.UUID | None:
        async with context.database.begin() as db:
            return await judge_missions(db, ids, within_s=0)

    assert on_site(api, judge) == ids[0]
    assert [row[0] for row in api.sql(judged, project_id)] == ids[:1]
    assert judging_jobs(api) == ["judge_project"]
    assert [row[0] for row in api.sql(judged, project_id)] == ids
    assert {verdict(api, str(mission_id)) for mission_id in ids} == {"good"}


@pytest.mark.parametrize("limit", [1, 2, 50])
def test_missions_are_listed_by_verdict_worst_or_best_first_the_latest_first(api: Api, limit: int) -> None:
    project_id = checked_project(api)
    early = {"start_ns": START_NS - SECOND_NS}
    missions = {"good": judged_mission(api, project_id, *GOOD), "warnings": judged_mission(api, project_id, GOOD[0])}
    missions |= {"empty": str(api.mission(project_id)["id"]), "outdated": judged_mission(api, project_id, *GOOD)}
    missions["old bad"] = str(api.mission(project_id)["id"])
    put_file(api, missions["old bad"], "run.mcap", SLOW, **early)
    missions["bad"] = judged_mission(api, project_id, *SLOW)
    put_file(api, missions["outdated"], "more.mcap", (topic("/other"),))
    names = {mission_id: name for name, mission_id in missions.items()}

    def listed(sort: str) -> list[str]:
        query = {"project_id": project_id, "sort": sort, "limit": str(limit)}
        return [names[one["id"]] for one in api.all("/missions", query)]

    assert listed("verdict") == ["bad", "old bad", "warnings", "outdated", "empty", "good"]
    assert listed("-verdict") == ["good", "empty", "outdated", "warnings", "bad", "old bad"]
    first = api.get("/missions", {"project_id": project_id, "sort": "verdict", "limit": "1"}).ok()
    query = {"project_id": project_id, "sort": "-verdict", "cursor": first["next"]}
    api.get("/missions", query).refused(422, "invalid_cursor")
