"""A runner on a login node of Slurm: from the claim to the end, with kills of everything in between."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

import kleinkram
from kleinkram.client.errors import InvalidInput
from kleinkram.contract.isolation import Isolation
from kleinkram.contract.runners import LOG_PATH
from kleinkram.contract.runs import EndReason, RunState
from kleinkram.runner.executors.slurm.commands import SlurmCommands
from kleinkram.runner.executors.slurm.options import SlurmOptions
from kleinkram.runner.executors.slurm.probe import find_site
from kleinkram.runner.state_directory import LEASE_MARGIN_S
from tests.integration.runner_loop.conftest import Runners, ended, wait_until
from tests.integration.runner_loop.fake_runs import FakeRun
from tests.integration.runner_loop.fake_server import FakeServer
from tests.integration.runner_loop.test_faults import LASTING, SHORT, heartbeat_of, is_alive, until_running
from tests.requirements import missing
from tests.slurm_cluster import SlurmCluster

pytestmark = pytest.mark.slow
# Those that wait for time limits of Slurm or of leases.
long = pytest.mark.soak

# Leaves one file for each start that was not cleaned up.
RESTARTED = (
    "import time, uuid\nfrom kleinkram.action import out\n"
    "(out / uuid.uuid4().hex).write_text('x')\nprint('began', flush=True)\ntime.sleep(2)\n"
)


@pytest.fixture(scope="module")
def site(slurm: SlurmCluster, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a runner stored about the cluster when it started there first."""
    folder = tmp_path_factory.mktemp("site")
    find_site(SlurmCommands(slurm.environment), SlurmOptions(1), folder, runner="tests")
    return folder / "slurm-site.json"


@pytest.fixture(autouse=True)
def whole(slurm: SlurmCluster, site: Path, runners: Runners) -> Iterator[None]:
    """Have runners know the cluster, and leave it as it was."""
    runners.folder.mkdir()
    shutil.copy(site, runners.folder)
    yield
    slurm.repair()


def until_shown(run: FakeRun, words: str) -> None:
    wait_until(lambda: any(words in progress.message for progress in run.progress))


def job_of(slurm: SlurmCluster, run: FakeRun) -> str:
    """Return the id of the job of a run in Slurm, of which there is exactly one."""
    lines = slurm.command("squeue", "--noheader", "--states=all", "--format=%A|%j").stdout.splitlines()
    (job_id,) = [line.partition("|")[0] for line in lines if str(run.claim.run_id) in line]
    return job_id


def test_a_run_reads_inputs_and_leaves_artifacts(server: FakeServer, runners: Runners, slurm: SlurmCluster) -> None:
    runners.spawn(slurm=slurm)
    run = server.launch(
        "import os\nfrom kleinkram.action import inputs, out\n"
        "(out / 'copy').write_bytes((out.parent / 'in' / 'a' / 'drive.bag').read_bytes())\n"
        "print(os.environ['CUDA_VISIBLE_DEVICES'])\n",
        {"a/drive.bag": b"bytes of a drive"},
        resources={"gpus": 1},
    )
    finish = ended(run).finishes[0]
    assert (finish.reason, finish.exit_code, finish.problems) == (EndReason.done, 0, [])
    assert run.artifacts == {"copy": b"bytes of a drive", LOG_PATH: b"0\n"}
    placement = finish.placement
    assert placement is not None
    assert (placement.job_id, placement.node, placement.gpus) == (job_of(slurm, run), "node1", ["0"])
    assert placement.queued_s is not None
    assert finish.usage is not None
    assert server.registrations[0].capacity.cores == 8
    assert server.registrations[0].lease_s == 900


# The packages that a runner imports.
_IMPORTED = """
import pathlib, sys
import kleinkram.action, kleinkram.runner.__main__
for module in [*sys.modules.values()]:
    folder, found, name = (getattr(module, "__file__", None) or "").rpartition("site-packages/")
    if found and not name.startswith(("kleinkram/", "_")):
        print(pathlib.Path(folder + found, name.split("/")[0]))
"""


def python_of_everybody(folder: Path) -> str:
    """Return a Python with the packages of the tests that another user can run, or skip."""
    system = Path("/usr/bin/python3")
    version = f"python3.{sys.version_info.minor}"
    if not system.exists() or system.resolve().name != version:
        missing("no Python that every user can run has the version of that of the tests")
    subprocess.run([system, "-m", "venv", "--without-pip", folder], check=True)
    # Copied: those of the tests may be where only their user can read.
    packages = folder / "lib" / version / "site-packages"
    own = shutil.ignore_patterns("__pycache__", "built")
    shutil.copytree(Path(kleinkram.__file__).parent, packages / "kleinkram", ignore=own)
    listing = subprocess.run([sys.executable, "-c", _IMPORTED], check=True, capture_output=True, text=True).stdout
    for path in {Path(line) for line in listing.splitlines()}:
        copy = shutil.copytree if path.is_dir() else shutil.copyfile
        copy(path, packages / path.name)
    return str(folder / "bin" / "python3")


def test_an_ordinary_user_runs_isolated_jobs(server: FakeServer, runners: Runners, slurm: SlurmCluster) -> None:
    runners.user = 65534
    runners.folder = slurm.folder / "home"
    runners.folder.mkdir()
    os.chown(runners.folder, runners.user, runners.user)
    runners.python = python_of_everybody(slurm.folder / "python")
    runners.spawn(slurm=slurm)
    run = server.launch(
        "import os\nfrom kleinkram.action import out\n(out / 'x').write_text('x')\n"
        f"print(os.path.exists('{slurm.folder}/slurm.conf'))\n"
    )
    finish = ended(run).finishes[0]
    assert (finish.reason, run.artifacts) == (EndReason.done, {"x": b"x", LOG_PATH: b"False\n"})
    assert server.registrations[0].abilities.isolation is Isolation.namespaces
    users = slurm.command("squeue", "--noheader", "--states=all", "--format=%U", f"--jobs={job_of(slurm, run)}").stdout
    assert users.split() == ["65534"]


def test_a_runner_killed_while_its_job_waits_finds_it_again(
    server: FakeServer, runners: Runners, slurm: SlurmCluster
) -> None:
    first = runners.spawn(slurm=slurm)
    wait_until(lambda: server.registrations)
    slurm.command("scontrol", "update", "PartitionName=main", "State=DOWN")
    run = server.launch(SHORT)
    until_shown(run, "waits in Slurm: its partition is down (PartitionDown)")
    runners.kill(first)
    runners.spawn(slurm=slurm)
    wait_until(lambda: len(server.registrations) == 2)
    slurm.command("scontrol", "update", "PartitionName=main", "State=UP")
    assert [finish.reason for finish in ended(run).finishes] == [EndReason.done]
    assert (run.attempt, run.artifacts) == (1, {"x": b"x", LOG_PATH: b"began\n"})
    assert job_of(slurm, run)


def test_a_runner_killed_while_its_job_runs_finds_it_again(
    server: FakeServer, runners: Runners, slurm: SlurmCluster
) -> None:
    first = runners.spawn(slurm=slurm)
    run = server.launch(SHORT)
    wait_until(lambda: RunState.running in run.states)
    runners.kill(first)
    runners.spawn(slurm=slurm)
    assert [finish.reason for finish in ended(run).finishes] == [EndReason.done]
    assert (run.attempt, run.artifacts) == (1, {"x": b"x", LOG_PATH: b"began\n"})


@long
def test_a_runner_that_continues_on_another_login_node_waits_for_a_silent_server(
    server: FakeServer, runners: Runners, slurm: SlurmCluster
) -> None:
    """Whose clock, besides, is a day fast. The nodes end jobs whose leases expire."""
    first = runners.spawn(slurm=slurm)
    run = server.launch(LASTING)
    heartbeat = until_running(runners, run)
    wait_until((runners.folder / "last-heartbeat").exists)
    runners.kill(first)
    server.is_silent.set()
    (runners.folder / "last-heartbeat").write_text(f"another-boot 5.0 {time.time() - 86_400}")
    runners.spawn(slurm=slurm)
    began_s = time.monotonic()
    wait_until(lambda: time.monotonic() - began_s > 15)
    assert is_alive(heartbeat)
    server.is_silent.clear()
    run.is_cancelled = True
    assert [finish.reason for finish in ended(run).finishes] == [EndReason.cancelled]
    assert run.attempt == 1


@long
def test_a_controller_that_is_down_loses_and_doubles_nothing(
    server: FakeServer, runners: Runners, slurm: SlurmCluster
) -> None:
    first = runners.spawn(slurm=slurm)
    running = server.launch(SHORT)
    wait_until(lambda: RunState.running in running.states)
    slurm.kill("slurmctld")
    submitted = server.launch(SHORT)
    wait_until(lambda: submitted.states)
    # Even a runner that starts now continues.
    runners.kill(first)
    runners.spawn(slurm=slurm)
    assert ended(running).finishes[0].reason is EndReason.done
    assert submitted.finishes == []
    slurm.start_controller()

    def is_over() -> bool:
        slurm.resume_node()
        return bool(submitted.finishes)

    wait_until(is_over, timeout_s=100)
    assert [finish.reason for finish in submitted.finishes] == [EndReason.done]
    assert (running.attempt, submitted.attempt) == (1, 1)
    assert submitted.artifacts[LOG_PATH] == running.artifacts[LOG_PATH] == b"began\n"


@pytest.mark.parametrize("state", ["queued", "running"])
def test_a_run_is_cancelled_within_seconds(
    server: FakeServer, runners: Runners, slurm: SlurmCluster, state: str
) -> None:
    runners.spawn(slurm=slurm)
    wait_until(lambda: server.registrations)
    if state == "queued":
        slurm.command("scontrol", "update", "PartitionName=main", "State=DOWN")
    run = server.launch(LASTING)
    if state == "queued":
        until_shown(run, "waits in Slurm")
    else:
        until_running(runners, run)
    run.is_cancelled = True
    cancelled_s = time.monotonic()
    finish = ended(run).finishes[0]
    assert finish.reason is EndReason.cancelled
    assert time.monotonic() - cancelled_s < 15, "it takes 5 s on an idle machine"
    wait_until(lambda: not slurm.command("squeue", "--noheader").stdout)


def test_a_job_that_slurm_starts_again_has_clean_folders(
    server: FakeServer, runners: Runners, slurm: SlurmCluster
) -> None:
    runners.spawn(slurm=slurm)
    run = server.launch(RESTARTED)
    until_running_log(runners)
    slurm.command("scontrol", "requeue", job_of(slurm, run))
    (finish,) = ended(run).finishes
    assert (finish.reason, run.attempt) == (EndReason.done, 1)
    assert run.artifacts.pop(LOG_PATH) == b"began\nbegan\n"
    assert len(run.artifacts) == 1
    assert finish.placement is not None
    assert finish.placement.requeues == 1


def until_running_log(runners: Runners) -> None:
    wait_until(lambda: any(path.read_text() for path in runners.folder.glob("runs/*/log")))


@long
def test_a_job_of_a_node_that_dies_runs_again(server: FakeServer, runners: Runners, slurm: SlurmCluster) -> None:
    runners.spawn(slurm=slurm)
    run = server.launch(RESTARTED)
    until_running_log(runners)
    slurm.command("scontrol", "update", "NodeName=node1", "State=DOWN", "Reason=test")
    slurm.command("scontrol", "update", "NodeName=node1", "State=RESUME")
    (finish,) = ended(run).finishes
    assert (finish.reason, run.attempt, len(run.artifacts)) == (EndReason.done, 1, 2)


@long
def test_a_job_that_a_node_failed_to_start_is_released(
    server: FakeServer, runners: Runners, slurm: SlurmCluster
) -> None:
    runners.spawn(slurm=slurm)
    wait_until(lambda: server.registrations)
    slurm.fail_starts(fails=True)
    run = server.launch("print('began')")
    wait_until(lambda: "launch failed requeued held" in slurm.command("squeue", "--noheader", "--format=%r").stdout)
    slurm.fail_starts(fails=False)
    slurm.command("scontrol", "update", "NodeName=node1", "State=RESUME")
    assert ended(run).finishes[0].reason is EndReason.done
    assert run.artifacts == {LOG_PATH: b"began\n"}


@long
def test_a_job_that_somebody_cancels_in_slurm_says_so(
    server: FakeServer, runners: Runners, slurm: SlurmCluster
) -> None:
    runners.spawn(slurm=slurm)
    run = server.launch(LASTING)
    until_running(runners, run)
    slurm.command("scancel", job_of(slurm, run))
    finish = ended(run).finishes[0]
    assert (finish.reason, finish.message) == (
        EndReason.cancelled,
        "Somebody cancelled its job in Slurm, not in Kleinkram.",
    )


@long
def test_a_job_whose_runner_is_gone_ends_before_its_lease_does(
    server: FakeServer, runners: Runners, slurm: SlurmCluster
) -> None:
    """The boot clock of the node is another one."""
    server.lease_s = LEASE_MARGIN_S + 6
    first = runners.spawn(slurm=slurm)
    run = server.launch(LASTING, lease_s=LEASE_MARGIN_S + 6)
    heartbeat = until_running(runners, run)
    runners.kill(first)
    killed_s = time.monotonic()
    wait_until(lambda: not is_alive(heartbeat), timeout_s=LEASE_MARGIN_S + 6)
    assert time.monotonic() - killed_s < LEASE_MARGIN_S + 6


@long
def test_a_job_that_starts_without_a_current_lease_does_nothing(
    server: FakeServer, runners: Runners, slurm: SlurmCluster
) -> None:
    """It waited while its runner was gone: another one may have the run by now."""
    first = runners.spawn(slurm=slurm)
    wait_until(lambda: server.registrations)
    server.lease_s = LEASE_MARGIN_S + 4
    slurm.command("scontrol", "update", "PartitionName=main", "State=DOWN")
    run = server.launch(LASTING, lease_s=LEASE_MARGIN_S + 4)
    until_shown(run, "waits in Slurm")
    runners.kill(first)
    slurm.command("scontrol", "update", "PartitionName=main", "State=UP")
    wait_until(lambda: not slurm.command("squeue", "--noheader").stdout)
    assert heartbeat_of(runners) is None


def test_what_no_node_can_run_is_refused(server: FakeServer, runners: Runners, slurm: SlurmCluster) -> None:
    runners.spawn(slurm=slurm, allowed=frozenset({"comment"}))
    wait_until(lambda: server.registrations)
    too_long = server.launch(LASTING, resources={"time_s": 2 * 86400})
    wrong_nodes = server.launch(LASTING, cluster={"constraint": "slow"})
    option = server.launch(LASTING, cluster={"options": {"reservation": "night"}})
    allowed = server.launch("print('began')", cluster={"constraint": "fast", "options": {"comment": "a=b"}})
    finishes = [ended(run).finishes[0] for run in (too_long, wrong_nodes, option)]
    assert {finish.reason for finish in finishes} == {EndReason.not_possible}
    assert "its time limit is longer than its partition allows" in finishes[0].message
    assert finishes[1].message == "Slurm refused its job: Invalid feature specification."
    assert "the option --reservation of sbatch, which its runner does not allow" in finishes[2].message
    assert ended(allowed).finishes[0].reason is EndReason.done


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        (SlurmOptions(1, partition="large"), "The partition large"),
        (SlurmOptions(1, constraint="slow"), "Invalid feature specification"),
        (SlurmOptions(1, python="/nonexistent/python"), "/nonexistent/python.*not found.*--python"),
        (SlurmOptions(1, extra={"output": "/etc/x"}), "the option --output|The option --output"),
    ],
)
def test_options_that_do_not_work_are_refused_at_the_start(
    slurm: SlurmCluster, tmp_path: Path, options: SlurmOptions, problem: str
) -> None:
    with pytest.raises(InvalidInput, match=problem):
        find_site(SlurmCommands(slurm.environment), options, tmp_path, runner="tests")


def test_a_folder_that_nodes_do_not_see_is_refused(slurm: SlurmCluster, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("kleinkram.runner.executors.slurm.probe._LATE_S", 1.0)
    with pytest.raises(InvalidInput, match=r"cannot write to it.*--data-dir"):
        find_site(SlurmCommands(slurm.environment), SlurmOptions(1), slurm.unshared, runner="tests")


@long
def test_the_jobs_of_an_unknown_run_are_cancelled(server: FakeServer, runners: Runners, slurm: SlurmCluster) -> None:
    first = runners.spawn(slurm=slurm)
    run = server.launch(LASTING)
    until_running(runners, run)
    runners.kill(first)
    job_id = job_of(slurm, run)
    (state,) = runners.folder.glob("runs/*/state.json")
    state.unlink()
    runners.spawn(slurm=slurm)
    wait_until(lambda: job_id not in slurm.command("squeue", "--noheader", "--format=%A").stdout.split())
