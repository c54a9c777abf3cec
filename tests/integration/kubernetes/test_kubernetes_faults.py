"""Faults of a cluster: requests that fail or are answered late, quotas, images and reports that are lost, new nodes."""

from __future__ import annotations

import json
import signal
import threading
from collections.abc import Iterator
from typing import Any

import pytest
from kubernetes.config import ConfigException

from kleinkram.client.errors import ServerUnreachable
from kleinkram.client.server import Service
from kleinkram.contract.actions import Network
from kleinkram.contract.people import ServiceRead
from kleinkram.contract.runs import EndReason, RunState
from kleinkram.runner.executors.base import CannotStart
from kleinkram.runner.executors.kubernetes import run_objects, transfers
from kleinkram.runner.executors.kubernetes.api_objects import Pod, PodEvent
from kleinkram.runner.executors.kubernetes.cluster import Cluster, connect
from kleinkram.runner.executors.kubernetes.pod_watch import PodWatch
from kleinkram.runner.executors.kubernetes.run_objects import RunObjects
from tests.integration.kubernetes.action_scripts import LASTING, OBEDIENT
from tests.integration.kubernetes.conftest import Site
from tests.integration.kubernetes.fake_cluster import LATE, NAMESPACE, FakeCluster, Refused
from tests.integration.runner_loop.conftest import ended, wait_until
from tests.integration.runner_loop.fake_http import RUN_TOKEN
from tests.integration.runner_loop.fake_runs import FakeRun

pytestmark = pytest.mark.slow
_OTHER_BOOT = "00000000-0000-0000-0000-000000000000"


def created(site: Site, ending: str) -> int:
    """Return how many Jobs whose names end so were created."""
    return sum(it["kind"] == "Job" and it["metadata"]["name"].endswith(ending) for it in site.cluster.created)


def is_shown(run: FakeRun, words: str) -> bool:
    """Whether some progress of a run had these words."""
    return any(words in (progress.message or "") for progress in run.progress)


# -- requests --------------------------------------------------------------------------------------------------------


def test_requests_that_fail_or_are_answered_late_cost_nothing(site: Site) -> None:
    conflict = Refused(409, "Operation cannot be fulfilled on resourcequotas: please try again", "Conflict")
    for verb, resource in (
        ("create", "persistentvolumeclaims"),
        ("create", "secrets"),
        ("create", "jobs"),
        ("get", "jobs"),
        ("get", "persistentvolumeclaims"),
        ("list", "pods"),
        ("watch", "pods"),
        ("get", "pods/log"),
    ):
        site.cluster.fails[verb, resource] = [429, conflict, LATE] if verb == "create" else [429, LATE]
    site.start()
    run = site.server.launch("print('x')")
    finish = ended(run).finishes[0]
    assert (finish.reason, finish.message, run.attempt) == (EndReason.done, "", 1)
    assert [created(site, ending) for ending in ("-fetch", "-1", "-store")] == [1, 1, 1]
    # Jobs are asked for only every two seconds.
    assert not [key for key, failures in site.cluster.fails.items() if failures and key != ("get", "jobs")]
    assert len(site.cluster.fails["get", "jobs"]) < 2
    site.wait_until_clean()


def test_a_refused_object_ends_the_run(site: Site) -> None:
    site.cluster.fails["create", "jobs", "-1"] = [403]
    site.start()
    finish = ended(site.server.launch("print('x')")).finishes[0]
    assert (finish.reason, "The cluster refuses it" in finish.message) == (EndReason.not_possible, True)


def test_objects_that_were_not_deleted_are_deleted_before_inputs_are_fetched_again(site: Site) -> None:
    site.cluster.node.silent_ends = 1
    site.server.slow_bytes_per_s = 100_000
    site.start()
    run = site.server.launch("", {"drive.bag": bytes(300_000)})
    site.running_pod("fetch")
    site.cluster.fails["delete", "jobs"] = [500]
    site.server.slow_bytes_per_s = None
    assert ended(run).finishes[0].reason is EndReason.done
    assert (created(site, "-fetch"), site.cluster.fails["delete", "jobs"]) == (2, [])


def test_credentials_that_were_not_deleted_are_deleted_without_another_run(site: Site) -> None:
    site.start()
    run = site.server.launch(LASTING)
    wait_until(site.has_begun)
    site.cluster.fails["delete", "secrets"] = [500]
    site.let_end()
    ended(run)
    wait_until(lambda: not site.cluster.fails["delete", "secrets"])
    site.server.wake()
    site.wait_until_clean()


@pytest.mark.parametrize(("kind", "ending"), [("persistentvolumeclaims", ""), ("secrets", "-env"), ("jobs", "-store")])
def test_a_run_waits_for_a_quota_and_shows_its_words(site: Site, kind: str, ending: str) -> None:
    words = "objects, requested: count=1, used: count=9, limited: count=9"
    site.cluster.quotas[kind, ending] = words
    site.start()
    run = site.server.launch("print('x')", token=RUN_TOKEN, network=Network.api)
    wait_until(lambda: is_shown(run, "limited: count=9"))
    assert not run.finishes
    site.cluster.quotas.clear()
    finish = ended(run).finishes[0]
    assert (finish.reason, run.attempt) == (EndReason.done, 1)
    site.wait_until_clean()


def test_a_run_that_waits_for_a_quota_is_cancelled(site: Site) -> None:
    site.cluster.quotas["jobs", "-1"] = "no room"
    site.start()
    run = site.server.launch("print('x')")
    wait_until(lambda: is_shown(run, "no room"))
    run.is_cancelled = True
    assert ended(run).finishes[0].reason is EndReason.cancelled
    site.wait_until_clean()


def test_inputs_stay_where_the_server_fails_after_they_were_placed(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    answers = Service.get
    failures: list[int] = [1, 2]

    def get(service: Service) -> ServiceRead:
        if failures:
            failures.pop()
            raise ServerUnreachable(url=site.server.url, reason="the test has it fail")
        return answers(service)

    monkeypatch.setattr(Service, "get", get)
    site.start()
    run = site.server.launch("print('x')", {"drive.bag": b"bytes"}, token=RUN_TOKEN, network=Network.api)
    assert ended(run).finishes[0].reason is EndReason.done
    assert (failures, created(site, "-fetch")) == ([], 1)


# -- results ---------------------------------------------------------------------------------------------------------


def _cannot_pull(site: Site, words: str) -> FakeRun:
    """Return a run whose action has ended, and whose results no pod can store yet."""
    site.start()
    run = site.server.launch(LASTING)
    wait_until(site.has_begun)
    site.cluster.image_errors[site.options.pod_image] = "ErrImagePull", words
    site.let_end()
    return run


@pytest.mark.parametrize("words", ["pull access denied", "dial tcp: i/o timeout"])
def test_results_wait_for_the_image_that_stores_them(site: Site, words: str) -> None:
    run = _cannot_pull(site, words)
    wait_until(lambda: is_shown(run, words))
    assert not run.finishes
    site.cluster.image_errors.clear()
    finish = ended(run).finishes[0]
    assert (finish.reason, run.artifacts["x"], run.attempt) == (EndReason.done, b"x", 1)


def test_results_that_no_pod_stores_are_reported_so(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(transfers, "_STORE_STARTS_WITHIN_S", 1.0)
    run = _cannot_pull(site, "pull access denied")
    finish = ended(run).finishes[0]
    assert (finish.reason, run.attempt) == (EndReason.results_not_stored, 1)
    assert "pull access denied" in finish.message


def test_results_wait_where_the_cluster_refuses_the_pod_that_stores_them(site: Site) -> None:
    site.cluster.fails["create", "jobs", "-store"] = [403, 401]
    site.start()
    run = site.server.launch("from kleinkram.action import out\n(out / 'x').write_text('x')")
    assert ended(run).finishes[0].reason is EndReason.done
    assert run.artifacts == {"x": b"x"}


def test_a_volume_that_somebody_deletes_has_no_results(site: Site) -> None:
    site.start()
    run = site.server.launch(LASTING)
    wait_until(site.has_begun)
    (volume,) = site.cluster.named("persistentvolumeclaims")
    connect(NAMESPACE, site.options.kubeconfig).delete("persistentvolumeclaims", volume["metadata"]["name"])
    site.let_end()
    finish = ended(run).finishes[0]
    assert (finish.reason, "volume was removed" in finish.message) == (EndReason.results_not_stored, True)


def test_results_wait_for_a_node_and_show_why(site: Site) -> None:
    site.start()
    run = site.server.launch(LASTING)
    wait_until(site.has_begun)
    site.cluster.unschedulable = "0/3 nodes are available: 1 node had volume node affinity conflict"
    site.let_end()
    wait_until(lambda: is_shown(run, "volume node affinity conflict"))
    site.cluster.unschedulable = None
    assert ended(run).finishes[0].reason is EndReason.done


@pytest.mark.parametrize(("patience_s", "stores"), [(60.0, 1), (0.0, 2)])
def test_a_report_that_its_node_cannot_read_is_read_and_then_written_again(
    site: Site, monkeypatch: pytest.MonkeyPatch, patience_s: float, stores: int
) -> None:
    monkeypatch.setattr(transfers, "_READ_REPORT_S", patience_s)
    site.cluster.node.unreadable_outputs = 1
    site.start()
    run = site.server.launch("from kleinkram.action import out\n(out / 'x').write_text('x')")
    finish = ended(run).finishes[0]
    assert (finish.reason, finish.problems, run.artifacts) == (EndReason.done, [], {"x": b"x"})
    assert created(site, "-store") == stores
    site.wait_until_clean()


def test_a_report_that_stays_unreadable_ends_the_run(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(transfers, "_READ_REPORT_S", 0.0)
    site.cluster.node.unreadable_outputs = 2
    site.start()
    finish = ended(site.server.launch("print('x')")).finishes[0]
    assert finish.reason is EndReason.results_not_stored
    assert "not in its output any more" in finish.message


def test_a_store_job_that_somebody_deletes_is_created_again(site: Site) -> None:
    site.start()
    site.server.holds_uploads.set()
    run = site.server.launch("from kleinkram.action import out\n(out / 'x').write_text('x')")
    site.running_pod("store")
    (job,) = site.cluster.named("jobs", "-store")
    connect(NAMESPACE, site.options.kubeconfig).delete("jobs", job["metadata"]["name"])
    site.server.holds_uploads.clear()
    assert ended(run).finishes[0].reason is EndReason.done
    assert run.artifacts == {"x": b"x"}


def test_a_fetch_that_crashes_says_why(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    site.cluster.node.crashes = 5
    site.start()
    finish = ended(site.server.launch("print('x')")).finishes[0]
    assert finish.reason is EndReason.inputs_unavailable
    assert "No space left on device" in finish.message
    assert "exit code 1" in finish.message


@pytest.mark.parametrize("way", ["delete", "disrupt"])
def test_a_program_that_ends_well_because_its_pod_is_removed_has_not_ended_well(site: Site, way: str) -> None:
    site.start()
    run = site.server.launch(OBEDIENT)
    wait_until(site.has_begun)
    name = site.running_pod("action")["metadata"]["name"]
    if way == "disrupt":
        condition = {"type": "DisruptionTarget", "status": "True", "reason": "PreemptionByScheduler"}
        site.cluster.change_pod(name, {"conditions": [condition]})
    site.cluster.delete_pod(name)
    finish = ended(run).finishes[0]
    assert (finish.reason, "half" in run.artifacts) == (EndReason.lost, False)


# -- runners that are started again ----------------------------------------------------------------------------------


@pytest.mark.parametrize("fails", [[], [429, 503]])
def test_a_runner_killed_before_it_created_the_job_of_an_action_starts_it(site: Site, fails: list[int]) -> None:
    run = site.kill_while_it_fetches()
    site.cluster.unschedulable = None
    (path,) = site.folder.glob("runs/*/state.json")
    state: dict[str, Any] = json.loads(path.read_text())
    path.write_text(json.dumps({**state, "stage": RunState.running.value, "starts": 3, "image": site.default_image}))
    site.cluster.fails["get", "jobs"] = [*fails]
    site.start()
    wait_until(site.has_begun)
    site.let_end()
    finish = ended(run).finishes[0]
    assert (finish.reason, run.attempt, run.artifacts["x"]) == (EndReason.done, 1, b"x")


@pytest.mark.parametrize("is_silent", [False, True])
def test_a_runner_that_starts_on_another_node_continues_its_runs(site: Site, is_silent: bool) -> None:
    """The clocks of leases count from the start of each machine; its server may be away for longer than seconds."""
    first = site.spawn()
    run = site.server.launch(LASTING)
    wait_until(site.has_begun)
    site.kill(first, signal.SIGKILL)
    (lease,) = site.folder.glob("runs/*/lease")
    lease.write_text(f"0.0 {_OTHER_BOOT}")
    heartbeat = site.folder / "last-heartbeat"
    heartbeat.write_text(" ".join([_OTHER_BOOT, "12.5", heartbeat.read_text().split()[2]]))
    if is_silent:
        site.server.is_silent.set()
        # Longer than the server is waited for where it is not known when it answered last.
        threading.Timer(7, site.server.is_silent.clear).start()
    site.start()
    if is_silent:
        wait_until(lambda: not site.server.is_silent.is_set())
    site.let_end()
    finish = ended(run).finishes[0]
    assert (finish.reason, run.attempt) == (EndReason.done, 1)


# -- parts -----------------------------------------------------------------------------------------------------------


def test_the_credentials_of_a_runner_may_be_unreadable_for_a_moment(
    cluster: FakeCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    client = connect(NAMESPACE, cluster.kubeconfig())
    calls: list[int] = []
    call_api = client._library.call_api

    def fails_once(*arguments: Any, **options: Any) -> Any:
        calls.append(1)
        if len(calls) == 1:
            raise ConfigException("Token file exists but empty")
        return call_api(*arguments, **options)

    monkeypatch.setattr(client._library, "call_api", fails_once)
    watch = PodWatch(client, "app=x", "job-name")
    monkeypatch.setattr("kleinkram.runner.executors.kubernetes.pod_watch._RETRY_S", 0.05)
    watch.start()
    wait_until(lambda: watch.is_current)
    watch.close()


class BrokenOnce(Cluster):
    """A cluster whose watch ends with an unexpected error once, while a pod appears."""

    def __init__(self) -> None:
        self.lists = 0

    def list_pods(self, selector: str) -> tuple[list[Pod], str]:
        """Return a pod, from the second time on."""
        self.lists += 1
        pod = Pod.model_validate({"metadata": {"name": "a", "uid": "u", "labels": {"job-name": "a-job"}}})
        return [pod] if self.lists > 1 else [], "1"

    def watch_pods(self, selector: str, version: str) -> Iterator[PodEvent]:
        """Fail."""
        if self.lists == 1:
            raise RuntimeError("the test has it fail")
        yield PodEvent(version="2")


def test_an_unexpected_error_does_not_end_the_watch(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("kleinkram.runner.executors.kubernetes.pod_watch._RETRY_S", 0.05)
    watch = PodWatch(BrokenOnce(), "app=x", "job-name")
    watch.start()
    wait_until(lambda: watch.is_current and watch.find("a-job") is not None)
    watch.close()


class KnownPods(PodWatch):
    """Pods of a Job, of which one still runs."""

    def __init__(self) -> None:
        self.phases = ["Succeeded", "Running"]

    @property
    def is_current(self) -> bool:
        return True

    def pods_of(self, job: str) -> list[Pod]:
        """Return them."""
        return [Pod.model_validate({"metadata": {"name": it}, "status": {"phase": it}}) for it in self.phases]


def test_an_action_does_not_start_while_a_pod_that_fetched_its_inputs_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    pods = KnownPods()
    objects = RunObjects(BrokenOnce(), pods, "app=x")
    monkeypatch.setattr(run_objects, "_GONE_S", 0.0)
    with pytest.raises(CannotStart, match="does not answer"):
        objects.await_end_of_pods("a-job", lambda seconds: None)
    monkeypatch.setattr(run_objects, "_GONE_S", 60.0)
    objects.await_end_of_pods("a-job", lambda seconds: setattr(pods, "phases", ["Succeeded", "Failed"]))


def test_the_jobs_of_a_run_replace_only_ended_pods_and_report_why_they_failed(site: Site) -> None:
    site.start()
    ended(site.server.launch("print('x')"))
    jobs = [it for it in site.cluster.created if it["kind"] == "Job"]
    assert {it["spec"]["podReplacementPolicy"] for it in jobs} == {"Failed"}
    policies = {
        it["metadata"]["labels"]["kleinkram.step"]: it["spec"]["template"]["spec"]["containers"][0][
            "terminationMessagePolicy"
        ]
        for it in jobs
    }
    # An action's would be the words of a stranger.
    assert policies == {"fetch": "FallbackToLogsOnError", "action": "File", "store": "FallbackToLogsOnError"}
