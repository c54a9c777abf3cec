"""Runs on a fake cluster, from their claim to their end."""

from __future__ import annotations

import json
import signal
import threading
from collections.abc import Callable

import pytest

from kleinkram.contract.actions import Network
from kleinkram.contract.runners import LOG_PATH
from kleinkram.contract.runs import EndReason, RunState
from kleinkram.runner.executors.base import CannotStart, Ending
from kleinkram.runner.executors.kubernetes import endings, executor, run_objects
from tests.integration.kubernetes.action_scripts import COPY, LASTING
from tests.integration.kubernetes.conftest import IMAGE, Site
from tests.integration.kubernetes.manifests import rules
from tests.integration.runner_loop.conftest import ended, wait_until
from tests.integration.runner_loop.fake_http import RUN_TOKEN, RUNNER_TOKEN
from tests.integration.runner_loop.fake_runs import FakeRun


def test_a_run_reads_its_inputs_and_its_results_are_stored(site: Site) -> None:
    site.cluster.rules = rules()
    site.start()
    run = site.server.launch(COPY, {"a/drive.bag": b"bytes of a drive"})
    finish = ended(run).finishes[0]
    assert (finish.reason, finish.exit_code, finish.problems) == (EndReason.done, 0, [])
    assert run.artifacts == {"deep/copy": b"bytes of a drive", LOG_PATH: b"a-mission\n"}
    assert [metric.name for metric in finish.report.metrics] == ["size"]
    assert finish.placement is not None
    assert finish.placement.node == "node-1"
    assert (finish.placement.job_id or "").startswith(f"runs/klein-{run.claim.run_id}-1-")
    assert run.digest == IMAGE.partition("@")[2]
    assert RunState.running in run.states
    site.wait_until_clean()


def test_the_role_allows_what_the_runner_does_and_no_more(site: Site) -> None:
    allowed = {(verb, resource) for rule in rules() for resource in rule["resources"] for verb in rule["verbs"]}
    site.cluster.rules = rules()
    runner = site.start()
    run = site.server.launch("print('x')", token=RUN_TOKEN, network=Network.api)
    assert ended(run).finishes[0].reason is EndReason.done
    site.wait_until_clean()
    wait_until(lambda: runner.active_count == 0)
    assert set(site.cluster.requests) == allowed


def test_a_closed_runner_looks_for_its_image_no_longer(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    searches: list[threading.Thread] = []

    def find_none(_executor: object, _image: str) -> None:
        searches.append(threading.current_thread())
        raise CannotStart(Ending(EndReason.image_unavailable, "The image is not there."))

    monkeypatch.setattr(executor.KubernetesExecutor, "prepare_image", find_none)
    site.start()
    wait_until(lambda: searches)
    site.close()
    searches[0].join(20)
    assert not searches[0].is_alive()


@pytest.mark.slow
def test_the_pod_of_an_action_has_no_credentials_and_no_privileges(site: Site) -> None:
    site.start()
    run = site.server.launch("print('x')", token=RUN_TOKEN, network=Network.api, resources={"cores": 0.5})
    assert ended(run).finishes[0].reason is EndReason.done
    (job,) = [it for it in site.cluster.created if it["metadata"]["labels"].get("kleinkram.step") == "action"]
    pod = job["spec"]["template"]["spec"]
    (container,) = pod["containers"]
    assert job["spec"]["backoffLimit"] == 0
    assert pod["automountServiceAccountToken"] is False
    assert not {"hostNetwork", "hostPID", "hostIPC", "serviceAccountName"} & pod.keys()
    assert pod["securityContext"]["runAsNonRoot"] is True
    assert pod["securityContext"]["seccompProfile"] == {"type": "RuntimeDefault"}
    assert container["securityContext"] == {
        "allowPrivilegeEscalation": False,
        "readOnlyRootFilesystem": True,
        "capabilities": {"drop": ["ALL"]},
    }
    assert [volume for volume in pod["volumes"] if "secret" in volume] == []
    assert all("sizeLimit" in volume["emptyDir"] for volume in pod["volumes"] if "emptyDir" in volume)
    assert container["resources"]["limits"] == container["resources"]["requests"]
    assert container["resources"]["limits"]["cpu"] == "500m"
    described = json.dumps([it for it in site.cluster.created if it["kind"] == "Job"])
    assert RUNNER_TOKEN not in described
    assert RUN_TOKEN not in described


@pytest.mark.slow
def test_a_report_of_many_megabytes_arrives_whole(site: Site) -> None:
    site.start()
    run = site.server.launch(
        "from kleinkram.action import report\n"
        "for number in range(9_999):\n"
        "    report.finding('warning', 'imu.gap', f'{number * 7919}'.ljust(600, '.'))\n"
    )
    (finish,) = ended(run).finishes
    assert (finish.reason, finish.problems, len(finish.report.findings)) == (EndReason.done, [], 9_999)


@pytest.mark.slow
def test_words_of_a_command_are_not_expanded(site: Site) -> None:
    site.start()
    run = site.server.launch("", script=None, image=IMAGE, command=["python3", "-c", "print('$(HOME) $$')"])
    assert ended(run).finishes[0].reason is EndReason.done
    assert run.artifacts[LOG_PATH] == b"$(HOME) $$\n"
    (job,) = [it for it in site.cluster.created if it["metadata"]["labels"].get("kleinkram.step") == "action"]
    assert job["spec"]["template"]["spec"]["containers"][0]["args"][-1] == "print('$$(HOME) $$$$')"


@pytest.mark.slow
def test_no_action_starts_with_a_damaged_input(site: Site) -> None:
    site.server.spoilt["drive.bag"] = b"BYTES of a drive"
    site.start()
    run = site.server.launch("print('x')", {"drive.bag": b"bytes of a drive"})
    finish = ended(run).finishes[0]
    assert finish.reason is EndReason.inputs_unavailable
    assert "drive.bag is damaged" in finish.message
    assert not [it for it in site.cluster.created if it["metadata"]["labels"].get("kleinkram.step") == "action"]
    site.wait_until_clean()


@pytest.mark.slow
def test_the_words_of_the_scheduler_are_shown_while_a_run_waits(site: Site) -> None:
    words = "0/3 nodes are available: 3 Insufficient nvidia.com/gpu."
    site.cluster.unschedulable = words
    site.start()
    run = site.server.launch("print('x')")
    wait_until(lambda: any(words in (progress.message or "") for progress in run.progress))
    site.cluster.unschedulable = None
    assert ended(run).finishes[0].reason is EndReason.done


@pytest.mark.slow
def test_a_cluster_that_creates_no_pod_is_named_while_a_run_waits(site: Site) -> None:
    site.cluster.creates_pods = False
    site.start()
    run = site.server.launch("print('x')")
    wait_until(lambda: any("created no pod" in (progress.message or "") for progress in run.progress))
    site.cluster.creates_pods = True
    site.cluster.start_pod(site.cluster.named("jobs", "-fetch")[0])
    assert ended(run).finishes[0].reason is EndReason.done


@pytest.mark.slow
def test_an_image_that_cannot_be_pulled(site: Site) -> None:
    words = "failed to resolve reference: lab/slam:1: not found"
    image = "lab/slam@sha256:" + "b" * 64
    site.cluster.image_errors[f"docker.io/{image}"] = "ErrImagePull", words
    site.start()
    finish = ended(site.server.launch("", script=None, image=image, command=["x"])).finishes[0]
    assert finish.reason is EndReason.image_unavailable
    assert words in finish.message
    site.wait_until_clean()


@pytest.mark.slow
def test_a_registry_that_is_away_is_waited_for(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    image = "docker.io/lab/slam@sha256:" + "b" * 64
    site.cluster.image_errors[image] = "ErrImagePull", "dial tcp: i/o timeout"
    site.start()
    run = site.server.launch("", script=None, image=image, command=["python3", "-c", "print(1)"])
    wait_until(lambda: any("i/o timeout" in (progress.message or "") for progress in run.progress))
    del site.cluster.image_errors[image]
    assert ended(run).finishes[0].reason is EndReason.done
    site.cluster.image_errors[image] = "ErrImagePull", "dial tcp: i/o timeout"
    monkeypatch.setattr(endings, "_IMAGE_PATIENCE_S", 0.5)
    run = site.server.launch("", script=None, image=image, command=["python3", "-c", "print(1)"])
    assert ended(run).finishes[0].reason is EndReason.image_unavailable


def _evicted(words: str) -> Callable[[Site, str], None]:
    def evict(site: Site, pod: str) -> None:
        site.cluster.node.end(pod, {"phase": "Failed", "reason": "Evicted", "message": words})

    return evict


def _removed(site: Site, pod: str) -> None:
    site.cluster.delete_pod(pod)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("happens", "reason", "words"),
    [
        (_evicted('Usage of EmptyDir volume "tmp" exceeds the limit "50M".'), EndReason.disk, "EmptyDir"),
        (_removed, EndReason.lost, "drained"),
    ],
    ids=["disk", "removed"],
)
def test_what_ends_a_pod_from_outside(
    site: Site, happens: Callable[[Site, str], None], reason: EndReason, words: str
) -> None:
    site.start()
    run = site.server.launch(LASTING)
    pod = site.running_pod("action")
    wait_until(site.has_begun)
    happens(site, pod["metadata"]["name"])
    finish = ended(run).finishes[0]
    assert finish.reason is reason
    assert words in finish.message
    site.cluster.delete_pod(pod["metadata"]["name"])
    site.wait_until_clean()


@pytest.mark.slow
def test_a_pod_that_replaces_a_deleted_one_does_not_count(site: Site) -> None:
    site.cluster.replaces_deleted_pods = True
    site.start()
    run = site.server.launch(LASTING)
    wait_until(site.has_begun)
    site.cluster.delete_pod(site.running_pod("action")["metadata"]["name"])
    (finish,) = ended(run).finishes
    assert (finish.reason, "deleted it" in finish.message) == (EndReason.lost, True)
    assert run.artifacts.keys() <= {LOG_PATH}
    site.wait_until_clean()


@pytest.mark.slow
def test_a_cancelled_run_ends_and_leaves_nothing(site: Site) -> None:
    site.start()
    run = site.server.launch(LASTING)
    wait_until(site.has_begun)
    run.is_cancelled = True
    assert ended(run).finishes[0].reason is EndReason.cancelled
    site.wait_until_clean()


@pytest.mark.slow
def test_a_run_is_cancelled_while_it_waits_for_a_node(site: Site) -> None:
    site.cluster.unschedulable = "0/3 nodes are available"
    site.start()
    run = site.server.launch(LASTING)
    site.wait_for_pod("fetch")
    run.is_cancelled = True
    assert ended(run).finishes[0].reason is EndReason.cancelled
    site.wait_until_clean()


@pytest.mark.slow
def test_an_api_server_that_is_away_costs_nothing(site: Site) -> None:
    site.start()
    run = site.server.launch(LASTING)
    wait_until(site.has_begun)
    site.cluster.is_away.set()
    site.let_end()
    wait_until(lambda: pod_status(site) == "Succeeded")
    site.cluster.is_away.clear()
    finish = ended(run).finishes[0]
    assert finish.reason is EndReason.done
    assert run.artifacts == {"x": b"x", LOG_PATH: b"began\n"}


def pod_status(site: Site) -> str:
    (pod,) = [pod for pod in site.cluster.named("pods") if pod["metadata"]["labels"]["kleinkram.step"] == "action"]
    return str(pod["status"]["phase"])


@pytest.mark.slow
def test_a_history_that_was_compacted_is_listed_again(site: Site) -> None:
    site.start()
    run = site.server.launch(LASTING)
    wait_until(site.has_begun)
    site.cluster.forget_versions()
    site.let_end()
    assert ended(run).finishes[0].reason is EndReason.done


@pytest.mark.slow
def test_a_failing_pod_of_kleinkram_is_started_again(site: Site) -> None:
    site.start()
    site.server.holds_uploads.set()
    run = site.server.launch("from kleinkram.action import out\n(out / 'x').write_text('x')")
    pod = site.running_pod("store")
    site.cluster.node.kill(pod["metadata"]["name"])
    site.server.holds_uploads.clear()
    assert ended(run).finishes[0].reason is EndReason.done
    assert run.artifacts == {"x": b"x"}


@pytest.mark.slow
@pytest.mark.parametrize("when", ["fetch", "action", "store"])
def test_a_killed_runner_finds_its_jobs_again(site: Site, when: str) -> None:
    site.server.slow_bytes_per_s = 100_000 if when == "fetch" else None
    if when == "store":
        site.server.holds_uploads.set()
    first = site.spawn()
    run = site.server.launch(LASTING, {"drive.bag": bytes(300_000)})
    if when != "fetch":
        site.running_pod("action")
        wait_until(site.has_begun)
    if when == "store":
        site.let_end()
    site.running_pod(when)
    site.kill(first, signal.SIGKILL)
    site.server.slow_bytes_per_s = None
    site.server.holds_uploads.clear()
    site.spawn()
    if when != "store":
        wait_until(site.has_begun)
        site.let_end()
    (finish,) = ended(run).finishes
    assert (finish.reason, run.attempt) == (EndReason.done, 1)
    assert run.artifacts == {"x": b"x", LOG_PATH: b"began\n"}
    assert run.shown_log in {b"", b"began\n"}
    actions = [it for it in site.cluster.created if it["metadata"]["labels"].get("kleinkram.step") == "action"]
    assert len(actions) == 1
    site.wait_until_clean()


@pytest.mark.slow
@pytest.mark.parametrize(("silent", "reason"), [(2, EndReason.done), (3, EndReason.inputs_unavailable)])
def test_inputs_are_fetched_again_where_a_node_does_not_say_how_it_went(
    site: Site, silent: int, reason: EndReason
) -> None:
    site.cluster.node.silent_ends = silent
    site.start()
    (finish,) = ended(site.server.launch("", {"drive.bag": b"bytes"})).finishes
    assert finish.reason is reason
    assert ("did not say" in finish.message) == (reason is EndReason.inputs_unavailable)
    assert len([it for it in site.cluster.created if it["metadata"]["name"].endswith("-fetch")]) == 3
    site.wait_until_clean()


@pytest.mark.slow
def test_objects_of_unknown_runs_are_removed(site: Site) -> None:
    first = site.spawn()
    run = site.server.launch(LASTING)
    wait_until(site.has_begun)
    site.kill(first, signal.SIGKILL)
    for state in site.folder.glob("runs/*/state.json"):
        state.unlink()
    run.is_cancelled = True
    site.start()
    site.wait_until_clean()


@pytest.mark.slow
def test_volumes_are_as_large_as_inputs_and_results(site: Site) -> None:
    site.start()
    run: FakeRun = site.server.launch("", {"drive.bag": bytes(1000)}, resources={"disk_bytes": 60_000_000})
    ended(run)
    (claim,) = [it for it in site.cluster.created if it["kind"] == "PersistentVolumeClaim"]
    assert int(claim["spec"]["resources"]["requests"]["storage"]) > 60_001_000


@pytest.mark.slow
def test_a_run_is_not_started_again_while_its_pod_may_run(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_objects, "_GONE_S", 1.0)
    run = site.kill_while_it_fetches()
    # The runner deletes the Job, but the node of its pod does not confirm the end.
    site.cluster.node.ignores_deletions = True
    site.start()
    finish = ended(run).finishes[0]
    assert (finish.reason, "does not answer" in finish.message) == (EndReason.lost, True)
    assert len([it for it in site.cluster.created if it["metadata"]["name"].endswith("-fetch")]) == 1
    site.cluster.node.ignores_deletions = False
