"""Inputs are downloaded once and verified; inputs in use stay in the cache."""

from __future__ import annotations

import pytest

from kleinkram.contract.runs import EndReason
from tests.integration.runner_loop.conftest import Runners, ended
from tests.integration.runner_loop.fake_server import FakeServer

READ = (
    "import pathlib\nfrom kleinkram.action import run_files\nprint(run_files.in_dir.joinpath('drive.bag').read_text())"
)


@pytest.mark.slow
def test_concurrent_runs_download_an_input_once(server: FakeServer, runners: Runners) -> None:
    server.slow_bytes_per_s = 40
    runners.start()
    runs = [server.launch(READ, {"drive.bag": b"bytes of a drive"}) for _ in range(3)]
    for run in runs:
        assert ended(run).finishes[0].reason is EndReason.done
        assert run.artifacts[".kleinkram/log"] == b"bytes of a drive\n"
    assert server.requests["GET store"] == 1


def test_a_damaged_input_is_downloaded_again_and_never_used(server: FakeServer, runners: Runners) -> None:
    server.spoilt["drive.bag"] = b"Bytes of a drive"
    runners.start()
    run = server.launch(READ, {"drive.bag": b"bytes of a drive"})
    finish = ended(run).finishes[0]
    assert finish.reason is EndReason.inputs_unavailable
    assert "drive.bag is damaged" in finish.message
    assert server.requests["GET store"] == 2


@pytest.mark.slow
def test_changed_inputs_are_downloaded_again(server: FakeServer, runners: Runners) -> None:
    runners.start()
    ended(server.launch(READ, {"drive.bag": b"bytes of a drive"}))
    (stored,) = runners.folder.glob("cache/*.file")
    stored.chmod(0o644)
    stored.write_bytes(b"other bytes")
    run = ended(server.launch(READ, {"drive.bag": b"bytes of a drive"}))
    assert run.artifacts[".kleinkram/log"] == b"bytes of a drive\n"
    assert server.requests["GET store"] == 2


def test_an_input_path_outside_the_directory_is_refused(server: FakeServer, runners: Runners) -> None:
    runners.start()
    for path in ("../../escaped", "mission.json", ".kleinkram/script.py"):
        run = ended(server.launch(READ, {path: b"x"}))
        assert run.finishes[0].reason is EndReason.inputs_unavailable
