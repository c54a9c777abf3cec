"""Missions and files by verdict, failing check, finding and metric; the matrix, the trend, facets."""

import uuid
from typing import Any

import pytest

from kleinkram.contract.access import Right
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.checks.judged import GOOD, SLOW, checked_project, judged_mission, put_file, topic
from tests.integration.jobs import run_jobs


@pytest.fixture(name="missions", scope="module")
def _missions(api: Api) -> dict[str, str]:
    """A good, a bad, and an outdated mission of one project, and an unchecked one of another."""
    project_id = checked_project(api)
    missions = {"project": project_id, "good": judged_mission(api, project_id, *GOOD)}
    missions["bad"] = judged_mission(api, project_id, *SLOW)
    missions["warnings"] = judged_mission(api, project_id, GOOD[0])
    missions["unchecked"] = judged_mission(api, str(api.project()["id"]), *SLOW)
    missions["outdated"] = judged_mission(api, project_id, *GOOD)
    put_file(api, missions["outdated"], "more.mcap", (topic("/other"),))
    return missions


def _names_matching(api: Api, missions: dict[str, str], query: str) -> set[str]:
    names = {mission_id: name for name, mission_id in missions.items()}
    within = [("sort", "name"), ("limit", "500")]
    items = api.get("/missions", [("query", query), *within]).ok()["items"]
    by_missions = {names[one["id"]] for one in items if one["id"] in names}
    files = api.get("/files", [("query", query), ("limit", "500")]).ok()["items"]
    assert {names[one["mission"]["id"]] for one in files if one["mission"]["id"] in names} == by_missions
    return by_missions


@pytest.mark.parametrize(
    ("query", "expected"),
    [
        ("verdict:bad", {"bad"}),
        ("verdict:good", {"good"}),
        ("verdict:outdated", {"outdated"}),
        ("verdict:bad verdict:warnings", {"bad", "warnings"}),
        ("verdict:BAD", {"bad"}),
        ("check:topic.rate", {"bad"}),
        ("check:topic.*", {"bad", "warnings"}),
        ("check:topic.gap", set()),
        ("verdict:bad -check:topic.rate", set()),
        ("topic:/imu verdict:bad", {"bad"}),
    ],
)
def test_missions_and_files_are_found_by_verdict_and_check(
    api: Api, missions: dict[str, str], query: str, expected: set[str]
) -> None:
    assert _names_matching(api, missions, query) == expected
    assert api.get("/search", {"query": query}).ok()["query"] == query.replace("BAD", "bad")


def test_a_link_to_a_file_lists_by_verdict_without_showing_it(api: Api, missions: dict[str, str]) -> None:
    file_id = api.all("/files", {"mission_id": missions["bad"]})[0]["id"]
    guest = api.as_(people.share(api, missions["bad"], file_ids=[file_id]).secret)
    assert [one["verdict"] for one in guest.all("/missions", {"sort": "verdict"})] == ["unchecked"]


def test_unchecked_missions_are_found_too(api: Api, missions: dict[str, str]) -> None:
    names = _names_matching(api, missions, "verdict:unchecked topic:/imu")
    assert names == {"unchecked"}


def _run(api: Api, mission_id: str, finding: str, metric: float, *, name: str = "slam") -> str:
    """Insert a run that is done, of an action of that name; returns its id."""
    definition = {"name": name, "script": "print(1)"}
    body = {"mission_ids": [mission_id], "definition": definition, "force": True}
    run_id = str(api.post("/runs", body).ok()["items"][0]["run"]["id"])
    api.sql("UPDATE run SET state = 'done', ended_at = now() WHERE id = %s", run_id)
    api.sql("INSERT INTO run_finding (run_id, severity, code, message) VALUES (%s, 'error', %s, 'x')", run_id, finding)
    api.sql("INSERT INTO run_metric (run_id, name, value) VALUES (%s, 'ate_rmse', %s)", run_id, metric)
    return run_id


def test_missions_are_found_by_the_latest_results_of_runs(api: Api, missions: dict[str, str]) -> None:
    _run(api, missions["good"], "clock.jump", 0.9)
    named = _run(api, missions["bad"], "clock.jump", 0.9)
    assert _names_matching(api, missions, "finding:clock.*") == {"good", "bad"}
    _run(api, missions["good"], "none", 0.1)
    assert _names_matching(api, missions, "finding:clock.*") == {"bad"}
    assert _names_matching(api, missions, "metric.ate_rmse>0.5") == {"bad"}
    assert _names_matching(api, missions, "metric.ate_rmse<=0.1") == {"good"}
    assert _names_matching(api, missions, "metric.ate_rmse:0.9 verdict:bad") == {"bad"}
    api.sql("UPDATE run_metric SET name = 'ate-rmse.3-d' WHERE run_id = %s", named)
    assert _names_matching(api, missions, "metric.ate-rmse.3-d>0.5") == {"bad"}
    for query in ("metric.ate_rmse>0.5", "metric.ate-rmse.3-d>-0.5", "-metric.ate-rmse<1"):
        assert api.get("/search", {"query": query}).ok()["query"] == query


def test_a_run_that_reuses_another_has_its_results(api: Api, missions: dict[str, str]) -> None:
    reused_id = _run(api, missions["good"], "reused.code", 0.3)
    run_id = _run(api, missions["warnings"], "none", 0.3)
    api.sql("DELETE FROM run_finding WHERE run_id = %s", run_id)
    api.sql("UPDATE run SET reuses_id = %s WHERE id = %s", reused_id, run_id)
    assert _names_matching(api, missions, "finding:reused.*") == {"good", "warnings"}
    _run(api, missions["good"], "none", 0.3)
    assert _names_matching(api, missions, "finding:reused.code") == {"warnings"}
    assert _names_matching(api, missions, "-finding:reused.code verdict:warnings") == set()
    _run(api, missions["warnings"], "reused.code", 0.3, name="another action")
    _run(api, missions["warnings"], "none", 0.3)
    assert _names_matching(api, missions, "finding:reused.code") == {"warnings"}, "of another action"


@pytest.mark.parametrize("query", ["verdict:terrible", "metric.ate_rmse>much", "metric.ate_rmse", "verdict>bad"])
def test_a_faulty_search_says_what_is_wrong(api: Api, query: str) -> None:
    if query == "metric.ate_rmse":  # a plain word
        api.get("/missions", {"query": query}).ok()
    else:
        assert api.get("/missions", {"query": query}).refused(422, "invalid_query")["column"] == 1


def test_a_faulty_metric_of_a_filter_is_refused(api: Api) -> None:
    api.get("/missions", {"metric": "ate_rmse"}).refused(422, "invalid_query")


def test_facets_count_the_files_by_verdict_and_failing_check(api: Api, missions: dict[str, str]) -> None:
    facets = api.get("/search/facets", {"query": f"project:{missions['project']}"}).ok()["facets"]
    by_name = {one["name"]: {value["value"]: value["file_count"] for value in one["values"]} for one in facets}
    assert by_name["verdict"] == {"outdated": 2, "good": 1, "bad": 1, "warnings": 1}
    assert by_name["check"] == {"topic.missing": 1, "topic.rate": 1}
    selected = api.get("/search/facets", {"query": f"project:{missions['project']} verdict:bad"}).ok()
    (facet,) = (one for one in selected["facets"] if one["name"] == "verdict")
    assert {one["value"] for one in facet["values"] if one["is_selected"]} == {"bad"}
    assert len(facet["values"]) == 4


def test_the_matrix_has_the_worst_status_of_each_check(api: Api, missions: dict[str, str]) -> None:
    path = f"/projects/{missions['project']}/checks/matrix"
    matrix = api.get(path, {"count": "true"}).ok()
    rows = {one["mission"]["id"]: one for one in matrix["items"]}
    assert matrix["total"] == 4
    assert set(matrix["checks"][:2]) == {"topic.rate", "topic.missing"}
    assert rows[missions["bad"]]["cells"]["topic.rate"] == "error"
    assert rows[missions["good"]]["cells"]["topic.rate"] == "ok"
    assert rows[missions["warnings"]]["cells"]["topic.missing"] == "warning"
    assert {one["verdict"] for one in matrix["items"]} == {"good", "bad", "warnings", "outdated"}
    pages: list[Any] = []
    cursor: dict[str, str] = {}
    while True:
        page = api.get(path, {"limit": "1", **cursor}).ok()
        pages += page["items"]
        if page["next"] is None:
            break
        cursor = {"cursor": page["next"]}
    assert pages == matrix["items"]


def test_the_trend_counts_missions_by_the_day_and_week_of_their_recordings(api: Api, missions: dict[str, str]) -> None:
    path = f"/projects/{missions['project']}/checks/trend"
    counts = {"good": 1, "bad": 1, "warnings": 1, "outdated": 1}
    assert api.get(path, {"by": "day"}).ok()["buckets"] == [{"start": "2023-11-14", "verdicts": counts}]
    assert api.get(path).ok()["buckets"] == [{"start": "2023-11-13", "verdicts": counts}]


def test_others_see_only_the_verdicts_of_their_missions(api: Api, missions: dict[str, str]) -> None:
    stranger = people.person(api)
    assert api.as_(stranger.token).get("/missions", {"query": "verdict:bad"}).ok()["items"] == []
    api.as_(stranger.token).get(f"/projects/{missions['project']}/checks/matrix").refused(404, "not_found")
    api.get(f"/projects/{uuid.uuid4()}/checks/trend").refused(404, "not_found")


def test_the_home_page_counts_missions_that_became_bad_this_week(api: Api) -> None:
    project_id = checked_project(api)
    person = people.person(api)
    people.grant(api, person, Right.read, project_id=project_id)
    first, old = judged_mission(api, project_id, *SLOW), judged_mission(api, project_id, *SLOW)
    judged_mission(api, project_id, *GOOD)
    api.sql("UPDATE mission_checks SET bad_since = now() - interval '8 days' WHERE mission_id = %s", old)
    run_jobs(api)
    failed = api.as_(person.token).get("/home").ok()["failed_checks"]
    assert (failed["count"], [one["id"] for one in failed["missions"]]) == (1, [first])
