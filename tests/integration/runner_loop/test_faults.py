"""Killed runners, silent servers, cancelled runs, wrong clocks."""

from __future__ import annotations

import errno
import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from kleinkram.client import _http
from kleinkram.client.transfer import store
from kleinkram.contract.errors import BodyTooLarge, FieldProblem, InvalidRequest, KleinkramError
from kleinkram.contract.runners import LOG_PATH
from kleinkram.contract.runs import EndReason, RunState
from kleinkram.runner import active_run, result_upload
from kleinkram.runner.__main__ import _run_until_signal
from kleinkram.runner.active_run import ActiveRun
from kleinkram.runner.executors.base import CannotStart, Ending, Executor, RunJob
from kleinkram.runner.executors.process import ProcessExecutor
from kleinkram.runner.executors.supervision import boot_time_s
from kleinkram.runner.loop import Runner
from kleinkram.runner.state_directory import LEASE_MARGIN_S, StateDirectory
from tests.integration.runner_loop.conftest import Runners, ended, wait_until
from tests.integration.runner_loop.fake_runs import FakeRun
from tests.integration.runner_loop.fake_server import FakeServer

# Writes a file to show that it is alive, and ends when another file appears.
LASTING = (
    "import pathlib, time\n"
    "from kleinkram.action import out\n"
    "print('began', flush=True)\n"
    "while True:\n"
    "    (out / 'beat').write_text(str(time.monotonic()))\n"
    "    time.sleep(0.02)\n"
)
SHORT = (
    "import time\nfrom kleinkram.action import out\n"
    "print('began', flush=True)\ntime.sleep(2)\n(out / 'x').write_text('x')\n"
)


def heartbeat_of(runners: Runners) -> Path | None:
    return next(iter(runners.folder.glob("runs/*/out/beat")), None)


def is_alive(heartbeat: Path) -> bool:
    """Whether a run still executes."""
    before = heartbeat.read_text()
    until = time.monotonic() + 0.5
    while time.monotonic() < until:
        if heartbeat.read_text() != before:
            return True
        time.sleep(0.02)
    return False


def until_running(runners: Runners, run: FakeRun) -> Path:
    result: list[Path] = []

    def runs() -> bool:
        result[:] = filter(None, [heartbeat_of(runners)])
        return RunState.running in run.states and bool(result)

    wait_until(runs)
    return result[0]


@pytest.mark.slow
@pytest.mark.parametrize("when", [RunState.preparing, RunState.running, RunState.collecting])
def test_a_killed_runner_reattaches_to_its_run(server: FakeServer, runners: Runners, when: RunState) -> None:
    data = bytes(range(256)) * 4000
    server.slow_bytes_per_s = 400_000
    server.holds_uploads.set()
    first = runners.spawn()
    run = server.launch(SHORT, {"drive.bag": data})
    wait_until(lambda: when in run.states and server.requests["GET store"])
    if when is RunState.collecting:
        wait_until(lambda: server.requests["/runner/runs/*/uploads"])
    runners.kill(first)
    server.slow_bytes_per_s = None
    server.holds_uploads.clear()
    runners.spawn()
    finish = ended(run).finishes
    assert [entry.reason for entry in finish] == [EndReason.done]
    assert run.attempt == 1
    assert run.artifacts == {"x": b"x", LOG_PATH: b"began\n"}
    wait_until(lambda: not [*runners.folder.glob("runs/*")])


@pytest.mark.parametrize(("refusals", "reason"), [(2, EndReason.done), (1000, EndReason.results_not_stored)])
def test_rejected_reports_are_sent_again(
    server: FakeServer, runners: Runners, monkeypatch: pytest.MonkeyPatch, refusals: int, reason: EndReason
) -> None:
    """The folder of a run is removed at its end, so failed uploads are repeated."""
    monkeypatch.setattr(result_upload, "_RETRY_EVERY_S", 0.1)
    server.uploads.refuses = refusals
    runners.start()
    run = server.launch("from kleinkram.action import out\nfor n in 'ab': (out / n).write_text(n)\nprint('began')\n")
    finish = ended(run).finishes[0]
    assert finish.reason is reason
    stored = {"a": b"a", "b": b"b"} if reason is EndReason.done else {}
    assert run.artifacts == {**stored, LOG_PATH: b"began\n"}
    assert len(finish.problems) == 2 - len(stored)


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make a runner give up soon and retry immediately."""
    monkeypatch.setattr(result_upload, "_RETRY_EVERY_S", 0.01)
    monkeypatch.setattr(store, "TRANSFER_RETRY_S", 0.1)
    monkeypatch.setattr(_http, "LONGEST_WAIT_S", 0.05)


@pytest.mark.usefixtures("impatient")
def test_results_are_uploaded_once_the_store_is_available(server: FakeServer, runners: Runners) -> None:
    """The number of rounds is not limited as it is for rejected files."""
    server.has_no_store.set()
    runners.start()
    run = server.launch("from kleinkram.action import out\n(out / 'x').write_text('x')\nprint('began')\n")
    wait_until(lambda: server.requests["/uploads/complete"] > 2 * result_upload._ROUNDS)
    assert run.finishes == []
    server.has_no_store.clear()
    assert ended(run).finishes[0].reason is EndReason.done
    assert run.artifacts == {"x": b"x", LOG_PATH: b"began\n"}


@pytest.mark.usefixtures("impatient")
@pytest.mark.parametrize(
    ("store_says", "waits_for"),
    [
        (b"", "is unreachable or full (the store answered 503)"),  # as a proxy does in its place
        (b"<Error><Code>InternalError</Code></Error>", "for several minutes, the store answered 503 InternalError"),
    ],
)
def test_results_stay_on_the_runner_while_the_store_fails(
    server: FakeServer, runners: Runners, store_says: bytes, waits_for: str
) -> None:
    """These files are not rejected, and the progress of the run names the reason."""
    server.store_says = store_says
    server.store_refuses.set()
    runners.start()
    run = server.launch("from kleinkram.action import out\n(out / 'x').write_text('x')\nprint('began')\n")
    wait_until(lambda: server.requests["/runner/runs/*/uploads"] > 2 * result_upload._ROUNDS)
    wait_until(lambda: run.progress and waits_for in run.progress[-1].message)
    assert run.finishes == []
    server.store_refuses.clear()
    assert ended(run).finishes[0].reason is EndReason.done
    assert run.artifacts == {"x": b"x", LOG_PATH: b"began\n"}


@pytest.mark.slow
def test_sigterm_leaves_jobs_and_sigint_ends_them(server: FakeServer, runners: Runners) -> None:
    first = runners.spawn()
    run = server.launch(LASTING)
    heartbeat = until_running(runners, run)
    runners.kill(first, signal.SIGTERM)
    wait_until(lambda: is_alive(heartbeat))
    second = runners.spawn()
    wait_until(lambda: len(server.registrations) == 2)
    wait_until(lambda: is_alive(heartbeat))
    runners.kill(second, signal.SIGINT)
    assert not is_alive(heartbeat)
    assert run.finishes == []
    assert run.attempt == 1


@pytest.mark.slow
@pytest.mark.parametrize("noticed_by", ["the runner", "the supervisor of the job"])
def test_a_run_whose_lease_cannot_be_renewed_is_ended(
    server: FakeServer, runners: Runners, monkeypatch: pytest.MonkeyPatch, noticed_by: str
) -> None:
    if noticed_by != "the runner":
        monkeypatch.setattr(ActiveRun, "enforce", lambda _: None)
    # The machine's clock counts for nothing.
    monkeypatch.setattr(time, "time", lambda: time.time_ns() / 1e9 + 3600)
    server.lease_s = LEASE_MARGIN_S + 8
    runners.start()
    run = server.launch(LASTING, lease_s=LEASE_MARGIN_S + 8)
    heartbeat = until_running(runners, run)
    wait_until(lambda: is_alive(heartbeat))
    server.is_silent.set()
    wait_until(lambda: not heartbeat.exists())
    assert run.finishes == []
    server.is_silent.clear()


@pytest.mark.slow
def test_a_run_of_a_lost_runner_ends_before_its_lease_does(server: FakeServer, runners: Runners) -> None:
    server.lease_s = LEASE_MARGIN_S + 8
    first = runners.spawn()
    run = server.launch(LASTING, lease_s=LEASE_MARGIN_S + 8)
    heartbeat = until_running(runners, run)
    runners.kill(first)
    killed_at = time.monotonic()
    wait_until(lambda: not is_alive(heartbeat), timeout_s=LEASE_MARGIN_S + 8)
    assert time.monotonic() - killed_at < LEASE_MARGIN_S + 8


@pytest.mark.slow
def test_a_run_of_another_runner_is_killed(server: FakeServer, runners: Runners) -> None:
    runners.start()
    run = server.launch(LASTING)
    heartbeat = until_running(runners, run)
    run.attempt, run.runner_id = 2, None
    wait_until(lambda: not heartbeat.exists())
    assert run.finishes == []


@pytest.mark.slow
def test_a_run_is_cancelled_while_it_runs(server: FakeServer, runners: Runners) -> None:
    runners.start()
    run = server.launch(LASTING)
    until_running(runners, run)
    run.is_cancelled = True
    finish = ended(run).finishes[0]
    assert finish.reason is EndReason.cancelled
    assert run.artifacts == {LOG_PATH: b"began\n"}


def test_a_run_is_cancelled_during_its_downloads(server: FakeServer, runners: Runners) -> None:
    server.slow_bytes_per_s = 1000
    runners.start()
    run = server.launch("print('never')", {"drive.bag": bytes(10**6)})
    wait_until(lambda: server.requests["GET store"])
    run.is_cancelled = True
    # All of it would take a quarter of an hour. How soon it is on a machine of its own is for the measures to say.
    assert ended(run).finishes[0].reason is EndReason.cancelled
    assert run.artifacts == {}


@pytest.mark.slow
def test_a_run_is_cancelled_during_its_uploads(server: FakeServer, runners: Runners) -> None:
    server.store_refuses.set()
    runners.start()
    run = server.launch("from kleinkram.action import out\n(out / 'x').write_text('x')")
    wait_until(lambda: server.requests["/uploads/parts"])
    run.is_cancelled = True
    finish = ended(run).finishes[0]
    assert finish.reason is EndReason.cancelled
    assert "none were stored" in finish.problems[0]
    assert run.artifacts == {}


def test_a_claim_whose_response_was_lost_is_repeated(server: FakeServer, runners: Runners) -> None:
    run = server.launch("print('done')")
    runner = runners.start()
    # As if it had been given to this runner before, and the answer never came.
    run.state, run.runner_id = RunState.preparing, runner._state.runner_id
    server.wake()
    assert ended(run).finishes[0].reason is EndReason.done


def test_all_runs_that_a_claim_assigns_are_executed(
    server: FakeServer, runners: Runners, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also those whose assignment was lost with an earlier response."""
    monkeypatch.setattr(Executor, "max_claimed", lambda *_: 3)
    runs = [server.launch("print('done')", resources={"cores": 0.5}) for _ in range(3)]
    runner = runners.start()
    assert [ended(run).finishes[0].reason for run in runs] == [EndReason.done] * 3
    lost = [server.launch("print('done')", resources={"cores": 0.5}) for _ in range(2)]
    for run in lost:
        run.state, run.runner_id = RunState.preparing, runner._state.runner_id
    server.wake()
    assert [ended(run).finishes[0].reason for run in lost] == [EndReason.done] * 2
    assert {request.max_runs for request in server.requested} == {3}


@pytest.mark.slow
def test_runs_never_exceed_the_capacity(server: FakeServer, runners: Runners) -> None:
    script = (
        "import time\nfrom kleinkram.action import out\n"
        "(out / 'from').write_text(repr(time.monotonic()))\ntime.sleep(0.3)\n"
        "(out / 'to').write_text(repr(time.monotonic()))\n"
    )
    runs = [server.launch(script, resources={"cores": cores}) for cores in (1, 2, 0.5, 1, 1.5, 0.5)]
    runners.start()
    for run in runs:
        ended(run)
    spans = [(float(run.artifacts["from"]), float(run.artifacts["to"]), run.claim.resources.cores) for run in runs]
    for moment, _, _ in spans:
        assert sum(cores for begin, end, cores in spans if begin <= moment < end) <= 2
    assert [len(run.finishes) for run in runs] == [1] * 6


def test_a_run_that_exceeds_the_disk_reports_it(server: FakeServer, runners: Runners) -> None:
    runners.start()
    run = server.launch("", image="debian:12", script=None)
    finish = ended(run).finishes[0]
    assert finish.reason is EndReason.not_possible
    assert "runs no images" in finish.message


def test_requests_are_repeated_while_the_server_fails(server: FakeServer, runners: Runners) -> None:
    server.fails = {"/runner/runs/*/context": 2, "/runner/runs/*/finish": 2, "/runner/runs/*/uploads": 1}
    runners.start()
    run = server.launch("from kleinkram.action import out\n(out / 'x').write_text('x')\nprint('done')")
    assert [entry.reason for entry in ended(run).finishes] == [EndReason.done]
    assert run.artifacts == {"x": b"x", LOG_PATH: b"done\n"}
    assert set(server.fails.values()) == {0}


@pytest.mark.parametrize(
    "refusal",
    [
        InvalidRequest(problems=[FieldProblem(field="report", message="is refused")]),
        BodyTooLarge(size_bytes=2**26, limit_bytes=2**25),
    ],
)
@pytest.mark.parametrize(
    ("end", "reason"), [("", EndReason.broken_report), ("raise SystemExit(3)", EndReason.exit_code)]
)
def test_a_run_whose_report_is_refused_fails(
    server: FakeServer, runners: Runners, refusal: KleinkramError, end: str, reason: EndReason
) -> None:
    server.report_refusal = refusal
    runners.start()
    run = server.launch(f"from kleinkram.action import report\nreport.metric('n', 1)\n{end}")
    (finish,) = ended(run).finishes
    assert finish.reason is reason
    assert finish.problems == [f"The server did not accept its report: {refusal}"]
    assert finish.message == finish.problems[0] or reason is EndReason.exit_code


class FailingOnce:
    """A method of an executor that fails at its first call after some."""

    def __init__(self, method: Callable[..., object], error: Exception, after: int) -> None:
        self._method = method
        self._error = error
        self.left = after

    def __call__(self, *arguments: object, **options: object) -> object:
        self.left -= 1
        if self.left == -1:
            raise self._error
        return self._method(*arguments, **options)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "error", "after"),
    [
        ("place_inputs", RuntimeError("unexpected"), 0),
        ("submit", ValueError("unexpected"), 0),
        ("submit", BlockingIOError(errno.EAGAIN, "Resource temporarily unavailable"), 0),
        ("poll", RuntimeError("unexpected"), 5),
        ("placement", OSError(errno.ESTALE, "Stale file handle"), 0),
        ("collect", PermissionError(13, "Permission denied"), 0),
        ("upload_results", CannotStart(Ending(EndReason.image_unavailable, "unexpected")), 0),
        ("upload_results", KeyError("unexpected"), 0),
    ],
)
def test_an_unexpected_error_of_the_runner_costs_no_results(
    server: FakeServer, runners: Runners, method: str, error: Exception, after: int
) -> None:
    executor = ProcessExecutor()
    failing = FailingOnce(getattr(executor, method), error, after)
    setattr(executor, method, failing)
    runners.start(executor)
    run = server.launch(SHORT)
    (finish,) = ended(run).finishes
    assert (finish.reason, run.attempt, run.artifacts) == (EndReason.done, 1, {"x": b"x", LOG_PATH: b"began\n"})
    assert failing.left <= -1
    wait_until(lambda: not [*runners.folder.glob("runs/*")])


@pytest.mark.slow
def test_a_run_whose_results_cannot_be_read_is_shown_and_cancelled(
    server: FakeServer, runners: Runners, monkeypatch: pytest.MonkeyPatch
) -> None:
    def collect(_executor: object, _job: object) -> Path:
        raise RuntimeError("unexpected")

    monkeypatch.setattr(ProcessExecutor, "collect", collect)
    runners.start()
    run = server.launch("print('x')")
    wait_until(lambda: any("an error of its runner" in (it.message or "") for it in run.progress))
    assert [*runners.folder.glob("runs/*/state.json")]
    run.is_cancelled = True
    assert ended(run).finishes[0].reason is EndReason.cancelled
    wait_until(lambda: not [*runners.folder.glob("runs/*")])


def test_a_run_whose_results_stay_unreadable_is_reported_once(
    server: FakeServer, runners: Runners, monkeypatch: pytest.MonkeyPatch
) -> None:
    def collect(_executor: object, _job: object) -> Path:
        raise OSError(errno.ESTALE, "Stale file handle")

    monkeypatch.setattr(active_run, "_KEEP_RESULTS_S", 1.0)
    monkeypatch.setattr(ProcessExecutor, "collect", collect)
    runners.start()
    run = server.launch("print('x')")
    (finish,) = ended(run).finishes
    assert (finish.reason, run.attempt) == (EndReason.lost, 1)
    assert finish.message == "Its runner could not complete it, and tried for long: Stale file handle."
    assert "an error of its runner, which tries again: Stale file handle" in {entry.message for entry in run.progress}
    wait_until(lambda: not [*runners.folder.glob("runs/*")])


class OnNodes(ProcessExecutor):
    """Runs jobs on other machines, which end them in time by themselves."""

    nodes_enforce_leases = True
    lease_s = 900


@pytest.mark.parametrize(("executor", "least_s"), [(ProcessExecutor(), 0), (OnNodes(), 800)])
def test_jobs_of_other_machines_outlive_a_move_of_their_runner(
    server: FakeServer, runners: Runners, executor: ProcessExecutor, least_s: float
) -> None:
    """On another login node, the time of the last heartbeat is unknown, and the server may not answer yet."""
    server.is_silent.set()
    runners.folder.mkdir()
    StateDirectory(runners.folder).create_attempt(server.launch("print('x')").claim)
    (runners.folder / "last-heartbeat").write_text(f"another-boot 5.0 {time.time() - 86_400}")
    runner = runners.start(executor)
    wait_until(lambda: runner._active_runs())
    (run,) = runner._active_runs()
    assert least_s < run.lease.until_s - boot_time_s() < least_s + 100


class StartedAgain(ProcessExecutor):
    """Runs jobs like a cluster that starts one again: it waits once more after it has run."""

    calls = 0

    def reason_waiting(self, job: RunJob) -> str | None:
        """Return why it waits, some moments after its start."""
        self.calls += 1
        return "waits in the queue of Slurm: Priority" if 2 < self.calls < 6 else None


@pytest.mark.slow
def test_a_run_whose_job_waits_again_says_why(server: FakeServer, runners: Runners) -> None:
    runners.start(StartedAgain())
    run = server.launch(LASTING)
    wait_until(lambda: "waits in the queue of Slurm: Priority" in {entry.message for entry in run.progress})
    assert RunState.running in run.states
    run.is_cancelled = True
    ended(run)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["on_reply", "enforce", "heartbeat"])
def test_an_unexpected_error_ends_no_thread_of_the_runner(
    server: FakeServer, runners: Runners, monkeypatch: pytest.MonkeyPatch, method: str
) -> None:
    original = getattr(ActiveRun, method)
    failures: list[str] = []

    def fails_once(*arguments: object, **options: object) -> object:
        if not failures:
            failures.append(method)
            raise RuntimeError("unexpected")
        return original(*arguments, **options)

    monkeypatch.setattr(ActiveRun, method, fails_once)
    runners.start()
    run = server.launch(LASTING)
    until_running(runners, run)
    assert failures
    run.is_cancelled = True
    assert ended(run).finishes[0].reason is EndReason.cancelled


def test_a_runner_that_ends_by_an_unexpected_error_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    class Broken(Runner):
        def __init__(self) -> None:
            self.has_killed: bool | None = None

        def run(self, *, once: bool = False) -> None:
            raise RuntimeError("unexpected")

        def close(self, *, kill: bool) -> None:
            self.has_killed = kill

    monkeypatch.setattr(signal, "signal", lambda *_: None)
    runner = Broken()
    assert _run_until_signal(runner, once=False) == 1
    assert runner.has_killed is False
