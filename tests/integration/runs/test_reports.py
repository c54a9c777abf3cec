"""What runs report: checks, verdicts, findings and metrics, and which of them lists return."""

from typing import Any

import pytest

from kleinkram.contract.reports import MAX_REPORT_BODY_BYTES
from tests.integration.api_server import Api
from tests.integration.runs.conftest import FakeRunner, Place, definition, launch

CHECK = {
    "name": "imu.gravity",
    "status": "error",
    "message": "9.1 instead of 9.81 m/s²",
    "value": 9.1,
    "limit": 9.81,
    "unit": "m/s²",
    "topic": "/imu/data",
    "file": "drive.bin",
    "time_ns": 1_700_000_000_000_000_000,
}
FINDING = {"severity": "info", "code": "a", "message": "m"}


def run_with(api: Api, runner: FakeRunner, mission: Any, report: dict[str, Any], **values: Any) -> Any:
    """Return a run that has ended with a report."""
    made = launch(api, runner, mission, **values)
    runner.finish(runner.claim(), report=report, image_digest="sha256:stock").ok()
    return api.get(f"/runs/{made['id']}").ok()


def test_checks_are_stored_and_listed_and_decide_the_verdict(lab: Api, runner: FakeRunner, place: Place) -> None:
    passed = {"name": "imu.constant", "status": "ok", "message": "it changes"}
    ended = run_with(lab, runner, place.mission, {"checks": [CHECK, passed], "verdict": "good"})
    assert (ended["state"], ended["verdict"], ended["check_counts"]) == ("done", "bad", {"ok": 1, "error": 1})
    rows = lab.all("/run-checks", {"run_id": ended["id"]})
    assert [row["check"]["name"] for row in rows] == ["imu.gravity", "imu.constant"]
    assert rows[0]["check"] == CHECK
    assert rows[0]["run_id"] == ended["id"]
    mission = {"mission_id": place.mission["id"]}
    for query in ({"status": "error"}, {"name": "*.gravity"}, {"topic": "/imu/*"}):
        assert [row["check"]["name"] for row in lab.all("/run-checks", mission | query)] == ["imu.gravity"]
    assert [run["id"] for run in lab.all("/runs", mission | {"verdict": "bad"})] == [ended["id"]]
    assert lab.all("/runs", mission | {"verdict": "good"}) == []
    (event,) = [event for event in lab.events(ended["id"]) if event["operation"] == "run.end"]
    assert event["after"]["verdict"] == "bad"


@pytest.mark.parametrize(
    ("report", "verdict"),
    [
        ({}, None),
        ({"findings": [FINDING]}, None),
        ({"verdict": "good", "findings": [FINDING]}, "good"),
        ({"checks": [{"name": "a.b", "status": "needs_content", "message": "m"}]}, None),
        ({"checks": [{"name": "a.b", "status": "ok", "message": "m"}]}, "good"),
        ({"checks": [{"name": "a.b", "status": "not_made", "message": "m"}]}, "warnings"),
        ({"findings": [FINDING | {"severity": "warning"}], "verdict": "good"}, "warnings"),
        ({"findings": [FINDING | {"severity": "error"}]}, "bad"),
        ({"verdict": "bad"}, "bad"),
    ],
)
def test_the_verdict_of_a_run_is_the_worst_that_it_reports(
    lab: Api, runner: FakeRunner, place: Place, report: dict[str, Any], verdict: str | None
) -> None:
    assert run_with(lab, runner, place.mission, report)["verdict"] == verdict


def test_a_run_that_failed_has_no_verdict(lab: Api, runner: FakeRunner, place: Place) -> None:
    made = launch(lab, runner, place.mission)
    runner.finish(runner.claim(), "exit_code", exit_code=1, report={"checks": [CHECK]}).ok()
    ended = lab.get(f"/runs/{made['id']}").ok()
    assert (ended["state"], ended["verdict"], ended["check_counts"]) == ("failed", None, {"error": 1})


def test_ten_thousand_findings_are_stored_with_their_verdict(lab: Api, runner: FakeRunner, place: Place) -> None:
    error = {"severity": "error", "code": "b", "message": "m"}
    ended = run_with(lab, runner, place.mission, {"findings": [FINDING] * 9_999 + [error]})
    assert (ended["verdict"], ended["finding_counts"]) == ("bad", {"info": 9_999, "error": 1})
    counted = lab.get("/findings", {"run_id": ended["id"], "severity": "error", "count": "true"}).ok()
    assert (counted["total"], len(counted["items"])) == (1, 1)


def test_a_report_above_the_limit_of_other_requests_is_stored_whole(lab: Api, runner: FakeRunner, place: Place) -> None:
    report = {"findings": [FINDING | {"severity": "error", "message": "m" * 1900}] * 10_000}
    ended = run_with(lab, runner, place.mission, report)
    assert (ended["state"], ended["verdict"], ended["finding_counts"]) == ("done", "bad", {"error": 10_000})


def test_a_report_above_its_own_limit_is_refused_and_the_run_goes_on(
    lab: Api, runner: FakeRunner, place: Place
) -> None:
    made = launch(lab, runner, place.mission)
    claim = runner.claim()
    problem = runner.finish(claim, problems=["p" * 2**20] * 33).refused(413, "body_too_large")
    assert problem["limit_bytes"] == MAX_REPORT_BODY_BYTES
    assert lab.get(f"/runs/{made['id']}").ok()["state"] not in {"done", "failed"}
    runner.finish(claim).ok()


def test_a_report_with_nan_is_refused_with_a_sentence(lab: Api, runner: FakeRunner, place: Place) -> None:
    launch(lab, runner, place.mission)
    claim = runner.claim()
    for value in ("NaN", "Infinity"):
        report = {"metrics": [{"name": "ate", "value": value}]}
        problem = runner.finish(claim, report=report).refused(422, "invalid_request")
        assert problem["problems"][0]["message"] == "it must be a finite number"


def test_rows_carry_parameters_and_version_and_lists_choose_by_them(lab: Api, runner: FakeRunner, place: Place) -> None:
    parameters = [{"name": "method", "type": "string", "default": "kiss-icp"}]
    published = definition(runner, parameters=parameters)
    action = lab.post("/actions", {"project_id": place.project["id"], "definition": published}).ok(201)
    metric = {"name": "ate", "value": 1, "unit": "m", "topic": "/lidar", "labels": {"alignment": "se3"}}
    for number, method, value in ((1, "kiss-icp", 1), (1, "odometry", 2), (2, "kiss-icp", 3)):
        if number == 2:
            published |= {"description": "better"}
            lab.post(f"/actions/{action['id']}/versions", {"definition": published}).ok(201)
        body = {"mission_ids": [place.mission["id"]], "action_id": action["id"], "parameters": {"method": method}}
        (made,) = lab.post("/runs", body).ok()["items"]
        assert made["outcome"] == "created", made
        findings = [{"severity": "error", "code": "topic.gap", "message": str(value), "topic": "/lidar"}]
        runner.finish(runner.claim(), report={"metrics": [metric | {"value": value}], "findings": findings}).ok()
    mission = {"mission_id": place.mission["id"]}
    rows = lab.all("/run-metrics", mission)
    assert [(row["action"]["version"], row["parameters"], row["metric"]["value"]) for row in rows] == [
        (2, {"method": "kiss-icp"}, 3),
        (1, {"method": "odometry"}, 2),
        (1, {"method": "kiss-icp"}, 1),
    ]
    assert rows[0]["metric"] == metric | {"value": 3, "file": None}
    assert rows[0]["ended_at"] is not None
    listed = lab.all("/runs", mission)[0]
    assert listed["metrics"] == [rows[0]["metric"]]

    def values(**query: str) -> list[float]:
        return [row["metric"]["value"] for row in lab.all("/run-metrics", mission | query)]

    assert values(latest="true") == [3, 2]
    assert values(version="1") == [2, 1]
    assert values(action="cou*", version="2") == [3]
    assert values(action="other") == []
    assert values(action_id=action["id"], latest="true", name="ate") == [3, 2]
    assert values(topic="/lid*") == [3, 2, 1]
    assert values(topic="/imu") == values(name="rate") == []
    lab.get("/run-metrics", mission | {"code": "ate"}).refused(422, "invalid_request")
    messages = [row["finding"]["message"] for row in lab.all("/findings", mission | {"latest": "true"})]
    assert messages == ["3", "2"]


def test_lists_have_the_order_of_the_reports_and_the_latest_run_first(
    lab: Api, runner: FakeRunner, place: Place
) -> None:
    for prefix in ("early", "late"):
        names = [f"{prefix}.{letter}" for letter in "cab"]
        report = {
            "metrics": [{"name": name, "value": 1} for name in names],
            "findings": [FINDING | {"code": name} for name in names],
            "checks": [CHECK | {"name": name} for name in names],
        }
        ended = run_with(lab, runner, place.mission, report)
    late, early = ["late.c", "late.a", "late.b"], ["early.c", "early.a", "early.b"]
    for path, kind, name in (
        ("/run-metrics", "metric", "name"),
        ("/findings", "finding", "code"),
        ("/run-checks", "check", "name"),
    ):
        rows = lab.all(path, {"mission_id": place.mission["id"], "limit": "2"})  # three pages
        assert [row[kind][name] for row in rows] == late + early
        rows = lab.all(path, {"run_id": ended["id"], "limit": "2"})
        assert [row[kind][name] for row in rows] == late
    assert [metric["name"] for metric in ended["metrics"]] == late


def test_latest_results_are_those_that_the_latest_run_reuses(lab: Api, runner: FakeRunner, place: Place) -> None:
    first = run_with(lab, runner, place.mission, {"metrics": [{"name": "ate", "value": 1}]})
    second = run_with(lab, runner, place.mission, {"metrics": [{"name": "ate", "value": 2}]})
    reused = launch(lab, runner, place.mission, force=False)
    assert (reused["state"], reused["reuses_id"], reused["verdict"]) == ("done", second["id"], None)
    failed = launch(lab, runner, place.mission)
    runner.finish(runner.claim(), "exit_code", exit_code=1, report={"metrics": [{"name": "ate", "value": 3}]}).ok()
    rows = lab.all("/run-metrics", {"mission_id": place.mission["id"], "latest": "true"})
    assert [row["run_id"] for row in rows] == [second["id"]]
    assert {first["id"], failed["id"]}.isdisjoint({row["run_id"] for row in rows})
    assert lab.all("/run-metrics", {"run_id": reused["id"], "latest": "true"})[0]["metric"]["value"] == 2


def test_reused_results_keep_their_verdict(lab: Api, runner: FakeRunner, place: Place) -> None:
    first = run_with(lab, runner, place.mission, {"checks": [CHECK]})
    reused = launch(lab, runner, place.mission, force=False)
    assert (reused["reuses_id"], reused["verdict"], reused["check_counts"]) == (first["id"], "bad", {"error": 1})
    assert [row["run_id"] for row in lab.all("/run-checks", {"run_id": reused["id"]})] == [first["id"]]
