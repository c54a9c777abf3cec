"""Server, runner or engine are killed during a run: the run ends once, with its complete log and all artifacts."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.acceptance.conftest import Instance, Terminal, running_instance, wait_until

pytestmark = pytest.mark.slow

_STEPS = 40
LASTING = f"""
import time
from kleinkram.action import out, progress, report
for step in range({_STEPS}):
    print("step", step, flush=True)
    progress(step / {_STEPS})
    time.sleep(0.1)
report.metric("steps", {_STEPS})
(out / "steps").write_text("{_STEPS}")
"""


@pytest.fixture(scope="module")
def instance(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Instance]:
    """An instance without an engine and with one account, because runs as processes require a single account."""
    home = tmp_path_factory.mktemp("up")
    with running_instance(home, DOCKER_HOST=f"unix://{home}/nothing") as running:
        yield running


@pytest.mark.parametrize(
    "parts",
    [["api"], ["postgres"], ["runner", "api"], pytest.param(["store"], marks=pytest.mark.soak)],
    ids="+".join,
)
def test_a_run_survives_killed_processes(
    instance: Instance, terminal: Terminal, project: str, tmp_path: Path, parts: list[str]
) -> None:
    script = tmp_path / "lasting.py"
    script.write_text(LASTING)
    (tmp_path / "notes.txt").write_text(f"notes of a drive of {project}")
    terminal.run("upload", "-p", project, "-m", "drive", "--create", tmp_path / "notes.txt")
    launched = terminal.run("action", "run", script, "-p", project, "-m", "drive", "--json").json()
    run_id = launched["items"][0]["run"]["id"]
    wait_until(lambda: "step 3" in terminal.run("run", "logs", run_id).out, "the run to begin")
    assert (instance.data_dir / "runner-token").stat().st_mode & 0o777 == 0o600
    killed = {part: instance.kill_process(part) for part in parts}

    def is_over() -> bool:
        values = terminal.run("run", "info", run_id, "--json", code=None)
        return values.code == 0 and json.loads(values.out)["ended_at"] is not None

    wait_until(is_over, "the end of the run")
    values = terminal.run("run", "info", run_id, "--json").json()
    assert (values["state"], values["attempt"], values["artifact_count"], values["metric_count"]) == ("done", 1, 1, 1)
    assert all(instance.runtime_info()["services"][part] not in {None, pid} for part, pid in killed.items())
    (runner,) = terminal.run("runner", "list", "--json").json()["items"]
    assert (runner["name"], runner["is_alive"]) == ("klein-up", True)
    lines = terminal.run("run", "logs", run_id).out.splitlines()
    assert lines == [f"step {step}" for step in range(_STEPS)]
