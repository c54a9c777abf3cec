"""`klein checks mission|matrix|trend`, `klein mission accept|note`, verdicts in lists, and `client.checks`."""

import json
from collections.abc import Callable
from typing import Any

import pytest
from typer.testing import CliRunner

from kleinkram.cli.main import app
from kleinkram.client import Client, connect
from kleinkram.client.errors import InvalidInput
from kleinkram.contract.errors import EditConflict, InvalidRequest, NotFound, YamlInvalid
from tests.integration.api_server import Api
from tests.integration.checks.judged import RULES, SLOW, checked_project, judged_mission
from tests.integration.jobs import run_jobs

Klein = Callable[..., Any]


@pytest.fixture(name="klein")
def _klein(api: Api, monkeypatch: pytest.MonkeyPatch) -> Klein:
    """A terminal: runs a command and returns its JSON or output, or raises its error."""

    def run(*arguments: str, as_json: bool = True) -> Any:
        monkeypatch.setenv("KLEINKRAM_URL", api.url)
        monkeypatch.setenv("KLEINKRAM_TOKEN", str(api.token))
        ran = CliRunner().invoke(app, [*arguments, "--json"] if as_json else [*arguments])
        if ran.exception is not None:
            raise ran.exception
        return json.loads(ran.stdout) if as_json else ran.output

    return run


@pytest.fixture(name="client")
def _client(api: Api) -> Client:
    return connect(api.url, token=api.token)


@pytest.fixture(name="bad_id")
def _bad_id(api: Api) -> str:
    return judged_mission(api, checked_project(api), *SLOW)


def test_a_bad_mission_shows_its_verdict_wherever_it_is_listed(api: Api, klein: Klein, bad_id: str) -> None:
    mission = api.get(f"/missions/{bad_id}").ok()
    assert "bad (1 error)" in klein("mission", "info", bad_id, as_json=False)
    assert "bad" in klein("mission", "list", "-p", mission["project"]["id"], as_json=False)
    shown = klein("checks", "mission", bad_id, as_json=False)
    assert "topic.rate" in shown
    assert "/imu" in shown
    assert "topic.gap" not in shown
    assert "topic.gap" in klein("checks", "mission", bad_id, "--all", as_json=False)
    passed = klein("checks", "mission", bad_id, "--check", "topic.g*", "--status", "ok", as_json=False)
    assert "topic.gap" in passed
    assert "topic.rate" not in passed
    assert klein("checks", "mission", bad_id, "--check", "image.*")["checks"] == []
    matrix = klein("checks", "matrix", mission["project"]["id"], as_json=False)
    assert mission["name"] in matrix
    assert "error" in matrix
    assert "2023-11-14" in klein("checks", "trend", mission["project"]["id"], "--by", "day", as_json=False)


def test_a_check_is_accepted_withdrawn_and_noted(api: Api, klein: Klein, bad_id: str) -> None:
    of_imu = ("--check", "topic.rate", "--topic", "/imu")
    printed = klein("mission", "accept", bad_id, *of_imu, "--because", "The driver was old.", as_json=False)
    assert "1 failure of topic.rate on /imu in" in printed
    klein("mission", "note", bad_id, "--check", "topic.rate", "--text", "See the log.")
    run_jobs(api)
    shown = klein("checks", "mission", bad_id, as_json=False)
    for words in ("good (1 accepted)", "The driver was old.", "See the log.", "error (accepted)"):
        assert words in shown
    project_id = api.get(f"/missions/{bad_id}").ok()["project"]["id"]
    assert "accepted" in klein("checks", "matrix", project_id, as_json=False)
    judged_mission(api, project_id, *SLOW, name="still bad")
    worst_first = klein("mission", "list", "-p", project_id, "--sort", "verdict")["items"]
    assert [one["verdict"] for one in worst_first] == ["bad", "good"]
    with pytest.raises(NotFound):
        klein("mission", "accept", bad_id, "--check", "topic.rate", "--withdraw")
    klein("mission", "accept", bad_id, *of_imu, "--withdraw")
    run_jobs(api)
    assert klein("checks", "mission", bad_id)["verdict"] == "bad"
    with pytest.raises(InvalidRequest):
        klein("mission", "accept", bad_id, "--check", "topic.gap", "--because", "It does not fail.")
    for wrong in (("--because", "x"), ("--check", "a.b"), ("--check", "a.b", "--because", "x", "--withdraw")):
        with pytest.raises(InvalidInput):
            klein("mission", "accept", bad_id, *wrong)


def test_a_mission_without_checks_says_how_to_get_some(api: Api, klein: Klein) -> None:
    mission_id = str(api.mission(api.project()["id"])["id"])
    assert "klein checks set" in klein("checks", "mission", mission_id, as_json=False)


def test_the_sdk_sets_lists_and_compares_rules(api: Api, client: Client) -> None:
    project_id = str(api.project()["id"])
    made = client.checks.set(project_id, RULES)
    assert (client.checks.get(project_id), made.number) == (made, 1)
    other = RULES.replace("100 Hz", "50 Hz")
    assert "+      /imu: {rate: 50 Hz" in client.checks.diff(project_id, other)
    assert client.checks.diff(project_id, RULES) == ""
    client.checks.set(project_id, other, if_match=made.etag)
    assert "-      /imu: {rate: 50 Hz" not in client.checks.diff(project_id, other, number=1)
    with pytest.raises(EditConflict):
        client.checks.set(project_id, "", if_match=made.etag)
    with pytest.raises(YamlInvalid) as refused:
        client.checks.set(project_id, "version: 1\nprofiles: 5\n")
    assert (refused.value.line, refused.value.column) == (2, 1)
    assert [one.number for one in client.checks.history(project_id)] == [2, 1]
    assert client.checks.version(project_id, 1).text == RULES


def test_the_sdk_finds_missions_by_verdict(client: Client, bad_id: str) -> None:
    (mission,) = client.missions.list(verdict="bad", check="topic.rate", project=client.missions.get(bad_id).project)
    assert str(mission.id) == bad_id
    assert [one.name for one in client.checks.mission(bad_id, status=["error"]).checks] == ["topic.rate"]
    matrix = client.checks.matrix(mission.project.id, limit=1)
    assert matrix.items[0].cells["topic.rate"].value == "error"
