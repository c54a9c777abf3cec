"""Compute nodes download inputs and upload results; the runner does what they leave."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from kleinkram.client.errors import InvalidInput
from kleinkram.contract.runs import EndReason, RunState
from kleinkram.runner.executors.process_supervisor import LOCK
from kleinkram.runner.executors.transfer_steps import FINISH, STATUS
from tests.integration.runner_loop.conftest import Runners, ended, wait_until
from tests.integration.runner_loop.fake_http import RUNNER_TOKEN
from tests.integration.runner_loop.fake_runs import FakeRun
from tests.integration.runner_loop.fake_server import FakeServer
from tests.integration.runner_loop.node_program import NodeExecutor

WORK = """
import pathlib
from kleinkram.action import run_files
data = run_files.in_dir.joinpath("drive.bag").read_text()
print(data)
run_files.out.joinpath("result.txt").write_text(data.upper())
"""
INPUTS = {"drive.bag": b"bytes of a drive"}


@pytest.fixture
def token_file(tmp_path: Path) -> Path:
    path = tmp_path / "token"
    path.write_text(RUNNER_TOKEN)
    path.chmod(0o600)
    return path


def directory_of(runners: Runners, run: FakeRun) -> Path:
    return runners.folder / "runs" / f"{run.claim.run_id}-{run.attempt}"


def test_a_node_downloads_inputs_and_uploads_results(server: FakeServer, runners: Runners, token_file: Path) -> None:
    runners.start(NodeExecutor(), token_file=token_file)
    first, second = (ended(server.launch(WORK, INPUTS)) for _ in range(2))
    for run in (first, second):
        assert run.finishes[0].reason is EndReason.done
        assert run.artifacts == {".kleinkram/log": b"bytes of a drive\n", "result.txt": b"BYTES OF A DRIVE"}
        assert run.shown_log == b"bytes of a drive\n"
    assert server.requests["GET store"] == 1
    wait_until(lambda: not any((runners.folder / "runs").iterdir()))


@pytest.mark.slow
def test_a_job_sees_neither_the_token_nor_the_files_of_its_transfers(
    server: FakeServer, runners: Runners, token_file: Path
) -> None:
    code = "import os, pathlib\nprint(sorted(os.listdir('/in')), pathlib.Path(os.environ['TOKEN']).exists())"
    code = code.replace("os.environ['TOKEN']", repr(str(token_file)))
    runners.start(NodeExecutor(), token_file=token_file)
    run = ended(server.launch(code, INPUTS))
    assert run.artifacts[".kleinkram/log"] == b"['.kleinkram', 'drive.bag', 'mission.json'] False\n"


@pytest.mark.slow
def test_runs_show_what_their_node_waits_for(server: FakeServer, runners: Runners, token_file: Path) -> None:
    server.slow_bytes_per_s = 8
    runners.start(NodeExecutor(), token_file=token_file)
    runs = [server.launch(WORK, INPUTS) for _ in range(2)]
    for run in runs:
        assert ended(run).finishes[0].reason is EndReason.done
    shown = {progress.message for run in runs for progress in run.progress}
    assert "waits for the download of another job: drive.bag" in shown
    assert server.requests["GET store"] == 1


def test_an_input_that_a_node_cannot_get_ends_the_run(server: FakeServer, runners: Runners, token_file: Path) -> None:
    server.spoilt["drive.bag"] = b"Bytes of a drive"
    runners.start(NodeExecutor(), token_file=token_file)
    finish = ended(server.launch(WORK, INPUTS)).finishes[0]
    assert finish.reason is EndReason.inputs_unavailable
    assert "drive.bag is damaged" in finish.message


def test_a_node_whose_token_has_ended_says_so(server: FakeServer, runners: Runners, token_file: Path) -> None:
    runners.start(NodeExecutor(), token_file=token_file)
    token_file.write_text("klein_runner_revoked")
    finish = ended(server.launch(WORK, INPUTS)).finishes[0]
    assert finish.reason is EndReason.inputs_unavailable
    assert f"does not accept the token of its runner any more. Replace it in {token_file}." in finish.message


def test_a_node_that_cannot_read_the_token_says_so(server: FakeServer, runners: Runners, token_file: Path) -> None:
    runners.start(NodeExecutor(), token_file=token_file)
    token_file.unlink()
    finish = ended(server.launch(WORK, INPUTS)).finishes[0]
    assert finish.reason is EndReason.inputs_unavailable
    assert str(token_file) in finish.message


def test_without_a_token_file_the_runner_does_not_start(runners: Runners) -> None:
    with pytest.raises(InvalidInput, match="--token-file"):
        runners.start(NodeExecutor())


@pytest.mark.slow
def test_what_a_killed_node_did_not_upload_the_runner_uploads(
    server: FakeServer, runners: Runners, token_file: Path
) -> None:
    server.holds_uploads.set()
    runners.start(NodeExecutor(), token_file=token_file)
    run = server.launch(WORK, INPUTS)
    wait_until(lambda: server.requests["/runner/runs/*/uploads"])
    os.kill(int((directory_of(runners, run) / LOCK).read_text()), signal.SIGKILL)
    server.holds_uploads.clear()
    assert ended(run).finishes[0].reason is EndReason.done
    assert run.artifacts == {".kleinkram/log": b"bytes of a drive\n", "result.txt": b"BYTES OF A DRIVE"}


@pytest.mark.slow
def test_a_run_that_is_cancelled_while_its_node_uploads_ends(
    server: FakeServer, runners: Runners, token_file: Path
) -> None:
    server.holds_uploads.set()
    runners.start(NodeExecutor(), token_file=token_file)
    run = server.launch(WORK, INPUTS)
    wait_until(lambda: server.requests["/runner/runs/*/uploads"] and run.states[-1] is RunState.collecting)
    run.is_cancelled = True
    assert ended(run).finishes[0].reason is EndReason.cancelled
    server.holds_uploads.clear()
    assert not run.artifacts


@pytest.mark.slow
def test_the_next_runner_waits_for_the_upload_of_the_node(
    server: FakeServer, runners: Runners, token_file: Path
) -> None:
    server.holds_uploads.set()
    runner = runners.start(NodeExecutor(), token_file=token_file)
    run = server.launch(WORK, INPUTS)
    wait_until(lambda: server.requests["/runner/runs/*/uploads"] and run.states[-1] is RunState.collecting)
    runner.stop()
    server.wake()
    runner.close(kill=False)
    runners.start(NodeExecutor(), token_file=token_file)
    server.holds_uploads.clear()
    assert ended(run).finishes[0].reason is EndReason.done
    assert server.requests["/runner/runs/*/uploads"] == 1
    assert set(run.artifacts) == {".kleinkram/log", "result.txt"}


@pytest.mark.slow
def test_the_node_of_an_outdated_attempt_uploads_nothing(
    server: FakeServer, runners: Runners, token_file: Path
) -> None:
    server.holds_uploads.set()
    runners.start(NodeExecutor(), token_file=token_file)
    run = server.launch(WORK, INPUTS)
    wait_until(lambda: server.requests["/runner/runs/*/uploads"])
    directory = directory_of(runners, run)
    assert (directory / STATUS).exists()
    with server._changed:
        run.attempt += 1
    server.holds_uploads.clear()
    wait_until(lambda: not directory.exists())
    assert not run.finishes
    assert not run.artifacts
    assert not (directory / FINISH).exists()
