"""Runs, actions and lineage on a terminal."""

import uuid

import pytest
from typer.testing import CliRunner

from kleinkram.cli.main import app
from kleinkram.cli.run_view import status_text
from kleinkram.contract.actions import Inputs
from kleinkram.contract.base import Page
from kleinkram.contract.checks import CheckStatus, Verdict
from kleinkram.contract.reports import Progress, Severity
from kleinkram.contract.runs import EndReason, LineageFile, LineageRead, LineageRun, RunRead, RunState
from tests.api_objects import action_read, file_read, run_detail
from tests.scripted_server import Scripted, scripted


def shown(script: Scripted, *arguments: object) -> str:
    ran = CliRunner(env={"KLEINKRAM_URL": script.url, "KLEINKRAM_TOKEN": "t"}).invoke(app, [*map(str, arguments)])
    assert ran.exit_code == 0, ran
    return ran.output


@pytest.mark.parametrize(
    ("state", "more", "text"),
    [
        (RunState.queued, {"waits_for": "No runner is registered."}, "queued: No runner is registered."),
        (RunState.running, {"progress": Progress(fraction=0.5, message="half")}, "running 50% half"),
        (RunState.running, {}, "running"),
        (
            RunState.preparing,
            {"progress": Progress(fraction=0, message="Installing 2 packages")},
            "preparing: Installing 2 packages",
        ),
        (RunState.collecting, {"progress": Progress(fraction=1, message="it waits")}, "collecting: it waits"),
        (RunState.collecting, {"progress": Progress(fraction=1)}, "collecting"),
        (RunState.failed, {"reason": EndReason.exit_code, "exit_code": 3}, "failed: exit_code 3"),
        (RunState.failed, {"reason": EndReason.memory}, "failed: memory"),
        (RunState.done, {}, "done"),
        (RunState.done, {"verdict": Verdict.good}, "done"),
        (RunState.done, {"verdict": Verdict.bad}, "done: bad"),
        (RunState.done, {"reuses_id": uuid.uuid4()}, "done (reused)"),
        (RunState.done, {"reuses_id": uuid.uuid4(), "verdict": Verdict.warnings}, "done: warnings (reused)"),
    ],
)
def test_the_state_of_a_run_is_described_briefly(state: RunState, more: dict[str, object], text: str) -> None:
    assert status_text(run_detail(state, **more)) == text


def test_all_fields_of_a_run_are_shown_and_names_are_escaped() -> None:
    run = run_detail(
        RunState.failed,
        reason=EndReason.time,
        message="It took longer than 60 s.",
        problems=["\x1b[2J is a link: left out."],
        metadata={"sensors": ["imu"]},
        finding_counts={Severity.warning: 2, Severity.error: 1},
        check_counts={CheckStatus.not_made: 1},
        verdict=Verdict.bad,
    )
    with scripted(run) as script:
        text = shown(script, "run", "info", run.id)
    for part in (
        "failed: time",
        "It took longer than 60 s.",
        "\\x1b[2J is a link",
        "proposed sensors: imu",
        "alps/day",
        "verdict:          bad",
        "findings:         1 error, 2 warning",
        "checks:           1 not made",
    ):
        assert part in text
    assert "\x1b" not in text


def test_lineage_shows_creator_and_readers() -> None:
    file = file_read("derived/slam.bag", content=b"x")
    maker, reader = (RunRead.model_validate(run_detail(RunState.done).model_dump()) for _ in range(2))
    sha256 = file.sha256 or ""
    made_by = LineageRun(
        run=maker, inputs=[LineageFile(id=None, path="drive.bag", sha256=sha256)], files=[], artifact_count=1
    )
    made = [LineageFile(id=uuid.uuid4(), path="plot.svg", sha256=sha256)]
    read_by = LineageRun(run=reader, inputs=[], files=made, artifact_count=3)
    own = LineageFile(id=file.id, path=file.path, sha256=sha256)
    whole = LineageRead(file=own, made_by=made_by, read_by=[read_by], truncated=True)
    with scripted(Page(items=[file], next=None), whole) as script:
        text = shown(script, "lineage", "derived/slam.bag")
    assert str(maker.id) in text
    assert "drive.bag (deleted, or not visible to you)" in text
    assert "plot.svg" in text
    assert "More runs read it" in text

    uploaded = LineageRead(file=own, made_by=None, read_by=[], truncated=False)
    with scripted(Page(items=[file], next=None), uploaded) as script:
        assert "Uploaded, not created by a run." in shown(script, "lineage", "derived/slam.bag")


def test_an_action_shows_its_parameters() -> None:
    action = action_read("look", project="alps")
    with scripted(Page(items=[action], next=None), action.latest) as script:
        text = shown(script, "action", "info", "look")
    assert "look@1" in text
    assert "a script" in text
    assert "all files" in text


def test_an_action_shows_the_inputs_that_it_declares_beside_files() -> None:
    action = action_read("verify")
    inputs = Inputs(paths=["*.mcap"], metadata=["place", "robot"], checks=True, reference=True)
    definition = action.latest.definition.model_copy(update={"inputs": inputs})
    declaring = action.model_copy(update={"latest": action.latest.model_copy(update={"definition": definition})})
    with scripted(Page(items=[declaring], next=None), declaring.latest) as script:
        text = shown(script, "action", "info", "verify")
    assert "files *.mcap; metadata place, robot; checks.yaml of the project, with all metadata; the reference" in text
