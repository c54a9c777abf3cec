"""`klein project actions add|list|remove` and `client.project_actions`."""

import json
import uuid
from collections.abc import Callable
from typing import Any

import pytest
from typer.testing import CliRunner

from kleinkram.cli.main import app
from kleinkram.client import Client, connect
from kleinkram.client.errors import InvalidInput
from kleinkram.contract.access import Right
from kleinkram.contract.errors import AmbiguousName, Forbidden, InvalidRequest, NotFound
from kleinkram.contract.project_actions import DEFAULT_IDLE_S, RunTrigger
from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.jobs import run_jobs
from tests.integration.runs.conftest import FakeRunner, Place
from tests.integration.runs.test_automatic_runs import complete, publish, runs

Klein = Callable[..., Any]


@pytest.fixture(name="klein")
def _klein(lab: Api, monkeypatch: pytest.MonkeyPatch) -> Klein:
    """A terminal: runs `klein project actions …` and returns its JSON or output, or raises its error."""

    def run(*arguments: str, as_json: bool = True, api: Api = lab) -> Any:
        monkeypatch.setenv("KLEINKRAM_URL", api.url)
        monkeypatch.setenv("KLEINKRAM_TOKEN", str(api.token))
        command = ["project", "actions", *arguments]
        ran = CliRunner().invoke(app, [*command, "--json"] if as_json else command)
        if ran.exception is not None:
            raise ran.exception
        if not as_json:
            return ran.output
        shown = json.loads(ran.stdout)
        return shown["items"] if arguments[0] == "list" else shown

    return run


@pytest.fixture(name="action")
def _action(lab: Api, runner: FakeRunner, place: Place) -> Any:
    """An action of the project with parameters."""
    parameters = [
        {"name": "rate", "type": "number", "default": 10.0},
        {"name": "side", "type": "choice", "choices": ["left", "right"], "default": "left"},
    ]
    return publish(lab, runner, place.project, parameters=parameters)


def client_of(api: Api) -> Client:
    return connect(api.url, token=api.token)


def test_an_action_is_added_listed_and_removed_by_its_name(
    lab: Api, klein: Klein, action: Any, runner: FakeRunner, place: Place
) -> None:
    project, name = place.project["name"], action["name"]
    output = klein("add", name, "-p", project, "--set", "rate=20", "--set", "side=right", as_json=False)
    assert f"{name}@1 runs by itself in {project}: when a mission is marked complete." in " ".join(output.split())
    (listed,) = klein("list", "-p", project)
    assert (listed["action"]["id"], listed["on"], listed["idle_s"]) == (action["id"], "complete", None)
    assert listed["parameters"] == {"rate": 20.0, "side": "right"}
    table = klein("list", "-p", project, as_json=False)
    assert all(part in table for part in (f"{name}@1", "when a mission is marked complete", "rate=20.0, side=right"))
    run_jobs(lab)
    complete(lab, place.mission)
    run_jobs(lab)
    (made,) = runs(lab, place.mission)
    assert made["action"]["id"] == action["id"]
    assert runner.claim()["parameters"] == {"rate": 20.0, "side": "right"}
    output = klein("remove", name, "-p", project, as_json=False)
    assert f"{name} no longer runs by itself in {project}." in " ".join(output.split())
    assert klein("list", "-p", project) == []
    assert "Nothing found" in klein("list", "-p", project, as_json=False)
    assert [run["id"] for run in runs(lab, place.mission)] == [made["id"]], "its runs stay"


def test_adding_again_changes_when_an_action_runs(klein: Klein, action: Any, place: Place) -> None:
    project, name = place.project["name"], action["name"]
    klein("add", name, "-p", project, "--set", "rate=20")
    assert klein("add", name, "-p", project, "--on", "idle")["idle_s"] == DEFAULT_IDLE_S
    changed = klein("add", action["id"], "-p", place.project["id"], "--on", "idle", "--idle", "1.5h")
    assert (changed["on"], changed["idle_s"], changed["parameters"]) == ("idle", 5400, {})
    assert klein("list", "-p", project) == [changed]
    assert "have not changed for 5400 s" in klein("list", "-p", project, as_json=False)
    assert klein("remove", action["id"], "-p", project) == {"removed": name}


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (("--idle", "5m"), "--idle requires --on idle"),
        (("--on", "idle", "--idle", "soon"), "write a number with d, h, m, s"),
        (("--on", "idle", "--idle", "0s"), "at least 1 s"),
        (("--on", "idle", "--idle", "200ms"), "at least 1 s"),
        (("--on", "idle", "--idle", "31d"), "idle_s"),
        (("--set", "rate"), "write it as NAME=VALUE"),
        (("--set", "rate=fast"), "'rate' is a number, not 'fast'"),
        (("--set", "side=up"), "side"),
        (("--set", "speed=3"), "speed"),
    ],
)
def test_what_cannot_be_added_is_refused_with_the_reason(
    klein: Klein, action: Any, place: Place, arguments: tuple[str, ...], reason: str
) -> None:
    with pytest.raises(InvalidInput) as refused:
        klein("add", action["name"], "-p", place.project["name"], *arguments)
    assert reason in str(refused.value)
    assert klein("list", "-p", place.project["name"]) == []


def test_projects_and_actions_must_be_there(lab: Api, klein: Klein, action: Any, place: Place) -> None:
    name, project = action["name"], place.project["name"]
    for arguments in (("add", name), ("list",), ("remove", name)):
        with pytest.raises(InvalidInput, match="specify a project with -p"):
            klein(*arguments)
        with pytest.raises(NotFound, match="no-such-project"):
            klein(*arguments, "-p", "no-such-project")
    with pytest.raises(NotFound, match="no-such-action"):
        klein("add", "no-such-action", "-p", project)
    with pytest.raises(InvalidInput, match=f"{project} does not name it"):
        klein("remove", name, "-p", project)
    with pytest.raises(NotFound, match=name):
        klein("add", name, "-p", lab.project()["name"])


def test_actions_of_other_projects_and_archived_ones_are_refused(
    lab: Api, klein: Klein, action: Any, place: Place
) -> None:
    other = lab.project()
    with pytest.raises(InvalidRequest, match="an action of another project"):
        klein("add", action["id"], "-p", other["name"])
    lab.patch(f"/actions/{action['id']}", {"archived": True}).ok()
    with pytest.raises(InvalidRequest, match="is archived"):
        klein("add", action["name"], "-p", place.project["name"])


def test_an_archived_action_is_removed_by_its_name(lab: Api, klein: Klein, action: Any, place: Place) -> None:
    klein("add", action["name"], "-p", place.project["name"])
    lab.patch(f"/actions/{action['id']}", {"archived": True}).ok()
    client_of(lab).project_actions.remove(place.project["name"], action["name"])
    assert klein("list", "-p", place.project["name"]) == []


@pytest.mark.parametrize(("right", "error"), [(None, NotFound), (Right.read, Forbidden), (Right.create, Forbidden)])
def test_only_who_may_change_a_project_names_its_actions(
    lab: Api, action: Any, place: Place, right: Right | None, error: type[Exception]
) -> None:
    member = people.person(lab)
    client_of(lab).project_actions.add(place.project["id"], action["id"], on="complete")
    if right is not None:
        people.grant(lab, member, right, project_id=place.project["id"])
    client = client_of(lab.as_(member.token))
    with pytest.raises(error):
        client.project_actions.add(uuid.UUID(place.project["id"]), uuid.UUID(action["id"]), on="idle")
    with pytest.raises(error):
        client.project_actions.remove(uuid.UUID(place.project["id"]), uuid.UUID(action["id"]))
    (listed,) = client_of(lab).project_actions.list(place.project["id"])
    assert listed.on is RunTrigger.complete
    if right is None:
        with pytest.raises(NotFound):
            client.project_actions.list(uuid.UUID(place.project["id"]))
    else:
        assert client.project_actions.list(place.project["name"]) == [listed]


def test_the_client_adds_lists_and_removes(lab: Api, runner: FakeRunner, action: Any, place: Place) -> None:
    client = client_of(lab)
    member = people.person(lab)
    people.grant(lab, member, Right.write, project_id=place.project["id"])
    other = client_of(lab.as_(member.token))
    second = publish(lab, runner, place.project)
    names = [action["name"], second["name"]]
    mine = client.project_actions.add(place.project["name"], names[0], on=RunTrigger.idle, idle_s=90)
    theirs = other.project_actions.add(uuid.UUID(place.project["id"]), second["id"], on="complete")
    assert (mine.on, mine.idle_s, mine.problem, mine.problem_count) == (RunTrigger.idle, 90, None, 0)
    assert (theirs.added_by.name, theirs.action.version) == (member.name, 1)
    listed = client.project_actions.list(place.project["id"])
    assert listed == sorted([mine, theirs], key=lambda row: row.action.name)
    client.project_actions.remove(place.project["name"], names[0])
    client.project_actions.remove(place.project["name"], names[0])  # idempotent
    assert client.project_actions.list(place.project["name"]) == [theirs]


@pytest.mark.parametrize(
    "values",
    [
        {"on": "often"},
        {"on": "complete", "idle_s": 60},
        {"on": "idle", "idle_s": 0},
        {"on": "idle", "idle_s": 31 * 86_400},
        {"on": "complete", "parameters": {"rate": object()}},
    ],
)
def test_the_client_refuses_what_cannot_be_sent(lab: Api, action: Any, place: Place, values: dict[str, Any]) -> None:
    client = client_of(lab)
    with pytest.raises(InvalidInput):
        client.project_actions.add(place.project["id"], action["id"], **values)
    assert client.project_actions.list(place.project["id"]) == []


def test_wrong_parameters_are_named(lab: Api, action: Any, place: Place) -> None:
    add = client_of(lab).project_actions.add
    with pytest.raises(InvalidRequest, match=r"parameters\.side"):
        add(place.project["id"], action["id"], on="complete", parameters={"side": "up"})
    with pytest.raises(NotFound):
        add(place.project["id"], uuid.uuid4(), on="complete")


def test_a_name_of_the_project_and_of_the_lab_is_ambiguous(lab: Api, klein: Klein, action: Any, place: Place) -> None:
    of_lab = lab.post("/actions", {"definition": action["latest"]["definition"]}).ok(201)
    with pytest.raises(AmbiguousName):
        klein("add", action["name"], "-p", place.project["name"])
    klein("add", of_lab["id"], "-p", place.project["name"])
    assert klein("remove", action["name"], "-p", place.project["name"]) == {"removed": action["name"]}


def test_the_list_says_why_an_action_did_not_run(lab: Api, klein: Klein, runner: FakeRunner, place: Place) -> None:
    action = publish(lab, runner, place.project, inputs={"paths": ["*.mcap"]})
    klein("add", action["name"], "-p", place.project["name"])
    run_jobs(lab)
    complete(lab, place.mission)
    run_jobs(lab)
    assert runs(lab, place.mission) == []
    (listed,) = klein("list", "-p", place.project["name"])
    assert listed["problem_count"] == 1
    assert listed["problem"]
    assert listed["problem"] in klein("list", "-p", place.project["name"], as_json=False)
