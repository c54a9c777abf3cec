"""`klein action run` against a scripted server: what is launched, on what, and how the result is reported."""

import json
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel
from typer.testing import CliRunner, Result

import kleinkram
from kleinkram.cli.errors import ExitCode, NotConfirmed
from kleinkram.cli.main import app
from kleinkram.cli.options import parameter_values
from kleinkram.cli.run_reports import split_version
from kleinkram.client.errors import InvalidInput
from kleinkram.contract.actions import ActionDefinition, Parameter, ParameterType
from kleinkram.contract.base import Page
from kleinkram.contract.checks import Verdict
from kleinkram.contract.errors import NotFound
from kleinkram.contract.problems import to_problem
from kleinkram.contract.reports import Metric
from kleinkram.contract.runs import LogChunkRead, MetricRead, RunCreated, RunRead, RunRefused, RunsCreated, RunState
from kleinkram.library import shipped_actions
from tests.api_objects import action_read, mission_read, run_detail
from tests.scripted_server import Scripted, scripted

MISSION = mission_read("day")


@pytest.fixture(autouse=True)
def _known(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("KLEINKRAM_TOKEN", "t")


def klein(script: Scripted, *arguments: object) -> Result:
    return CliRunner(env={"KLEINKRAM_URL": script.url}).invoke(app, [*map(str, arguments)])


def page(*rows: BaseModel) -> Page[Any]:
    return Page(items=[*rows], next=None)


def made(run: RunRead) -> RunsCreated:
    return RunsCreated(items=[RunCreated(run=RunRead.model_validate(run.model_dump()))])


def test_an_unpublished_action_is_run_and_followed(tmp_path: Path) -> None:
    (tmp_path / "look.py").write_text("print('hello')")
    run = run_detail(RunState.queued)
    done = run.model_copy(update={"state": RunState.failed, "message": "It ended with the exit code 3."})
    log = LogChunkRead(attempt=1, offset=0, next_offset=6, text="hello\n", is_over=True)
    # The log is asked for beside the run, so the order of these two is not known: both are found by their kind.
    with scripted(page(MISSION), made(run), by_path={"/log": log, f"/runs/{run.id}": done}) as script:
        ran = klein(script, "action", "run", tmp_path / "look.py", "-m", "day", "--follow", "--json")
    assert ran.exit_code == ExitCode.run_failed
    assert json.loads(ran.stdout)["items"][0]["run"]["state"] == "failed"
    assert "hello" in ran.stderr
    assert "exit code 3" in ran.stderr
    assert script.requests[1].body["definition"]["script"] == "print('hello')"


def test_a_shipped_action_is_run_unpublished() -> None:
    shipped = shipped_actions()["slam-evaluate"]
    with scripted(page(MISSION), made(run_detail(RunState.queued))) as script:
        ran = klein(script, "action", "run", "kleinkram/slam-evaluate", "-m", "day", "--set", "alignment=yaw")
    assert ran.exit_code == 0, ran.output
    assert (
        f"kleinkram/slam-evaluate is that of kleinkram {kleinkram.__version__}, which is installed here." in ran.stderr
    )
    body = script.requests[1].body
    assert (body["definition"]["script"], body["parameters"]["alignment"]) == (shipped.script, "yaw")


@pytest.mark.parametrize(("arguments", "exit_code"), [([], ExitCode.verdict_bad), (["--ignore-verdict"], 0)])
def test_a_run_that_is_done_and_bad_has_an_exit_code_of_its_own(
    tmp_path: Path, arguments: list[str], exit_code: int
) -> None:
    (tmp_path / "look.py").write_text("print('hello')")
    run = run_detail(RunState.queued)
    done = run.model_copy(update={"state": RunState.done, "verdict": Verdict.bad})
    log = LogChunkRead(attempt=1, offset=0, next_offset=6, text="hello\n", is_over=True)
    with scripted(page(MISSION), made(run), by_path={"/log": log, f"/runs/{run.id}": done}) as script:
        ran = klein(script, "action", "run", tmp_path / "look.py", "-m", "day", "--follow", "--json", *arguments)
    assert ran.exit_code == exit_code
    assert "The run is done. It says that the mission alps/day is bad." in ran.stderr


def test_metrics_as_csv_have_columns_of_parameters_and_labels() -> None:
    run = run_detail(RunState.done)
    where = {"run_id": run.id, "mission": run.mission, "action": run.action, "ended_at": run.created_at}
    rows = [
        MetricRead(id=1, parameters={"rate": 10}, metric=Metric(name="ate", value=0.1 + 0.2, unit="m"), **where),
        MetricRead(
            id=2, parameters={}, metric=Metric(name="ate", value=7, topic="/a", labels={"kind": "x, y"}), **where
        ),
    ]
    with scripted(page(*rows)) as script:
        ran = klein(script, "run", "metrics", "--action", "look@1", "--latest", "--csv")
    assert ran.exit_code == 0, ran
    assert "action=look&version=1&latest=true" in script.requests[0].path
    lines = ran.stdout.splitlines()
    assert lines[0] == (
        "project,mission,action,version,name,value,unit,file,topic,run,ended_at,label.kind,parameter.rate"
    )
    assert lines[1].startswith("alps,day,look,1,ate,0.30000000000000004,m,,,")
    assert lines[1].endswith("Z,,10")
    assert lines[2].endswith('Z,"x, y",')


def test_a_version_of_an_action_can_be_run() -> None:
    action, older = action_read("look", number=4), action_read("look", number=3).latest
    refusal = RunRefused(mission_id=MISSION.id, problem=to_problem(NotFound(resource_type="mission", ref="day"), "r"))
    with scripted(page(MISSION), page(action), older, RunsCreated(items=[refusal])) as script:
        ran = klein(script, "action", "run", "look@3", "-m", "day")
    assert ran.exit_code == ExitCode.not_found
    assert "alps/day: There is no mission 'day'" in ran.stderr
    assert f"project_id={MISSION.project.id}" in script.requests[1].path
    assert script.requests[3].body["action_id"] == str(action.id)
    assert script.requests[3].body["version"] == 3


def test_launching_on_many_missions_needs_confirmation() -> None:
    several = [MISSION, mission_read("dusk")]
    with scripted(page(*several), page(action_read("look"))) as script:
        ran = klein(script, "action", "run", "look", "--query", "alps")
    assert isinstance(ran.exception, NotConfirmed)
    assert len(script.requests) == 2
    assert "Run look on 2 missions: alps/day, alps/dusk?" in ran.stderr
    with scripted(page(*several), page(action_read("look")), RunsCreated(items=[])) as script:
        klein(script, "action", "run", "look", "--query", "alps", "--yes", "--force")
    assert script.requests[2].body["mission_ids"] == [str(mission.id) for mission in several]
    assert script.requests[2].body["force"] is True


def test_invalid_arguments_are_reported_before_any_launch(tmp_path: Path) -> None:
    for arguments, why in (
        (["look"], "specify missions"),
        (["look", "-m", "day", "--query", "alps"], "specify missions"),
        ([tmp_path / "none.py", "-m", "day"], "no such file"),
        (["look", "-m", "day", "--set", "x=1"], "no parameter 'x'"),
    ):
        with scripted(page(MISSION), page(action_read("look"))) as script:
            ran = klein(script, "action", "run", *arguments)
        assert isinstance(ran.exception, InvalidInput)
        assert why in str(ran.exception)


def test_parameters_are_read_as_their_types() -> None:
    rate = Parameter(name="rate", type=ParameterType.number, default=1.0, minimum=0)
    deep = Parameter(name="deep", type=ParameterType.boolean, default=False)
    definition = ActionDefinition(name="look", script="", parameters=[rate, deep])
    assert parameter_values(definition, ["rate=2.5", "deep=true"]) == {"rate": 2.5, "deep": True}
    for assignments, why in (("rate=-1", "at least 0"), ("rate", "NAME=VALUE"), ("deep=maybe", "true or false")):
        with pytest.raises(InvalidInput, match=why):
            parameter_values(definition, [assignments])


def test_a_version_follows_the_last_at_sign() -> None:
    assert split_version("look@3") == ("look", 3)
    assert split_version("a@b") == ("a@b", None)
    assert split_version("@3") == ("@3", None)


def test_an_unchanged_action_is_not_published_again(tmp_path: Path) -> None:
    (tmp_path / "look.py").write_text("print(1)")
    action = action_read("look")
    create = ("action", "create", tmp_path / "look.py", "--new-version")
    with scripted(page(action), action) as script:
        # The server compares them, since only it knows the lock.
        assert "nothing was published" in klein(script, *create).stderr
    (tmp_path / "look.py").write_text("print(2)")
    latest = action.latest.model_copy(update={"number": 2})
    with scripted(page(action), action.model_copy(update={"latest": latest})) as script:
        assert "nothing was published" not in klein(script, *create).stderr
    assert script.requests[1].path.endswith(f"/actions/{action.id}/versions")
    assert script.requests[1].body["definition"]["script"] == "print(2)"
