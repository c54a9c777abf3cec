"""Runs on a real cluster: its API server, controllers, scheduler, kubelet and containerd, each started and killed."""

from __future__ import annotations

import random
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from kleinkram.contract.actions import Network
from kleinkram.contract.runners import LOG_PATH, RunFinish
from kleinkram.contract.runs import EndReason
from kleinkram.runner.executors.kubernetes import endings
from kleinkram.runner.executors.kubernetes.options import KubernetesOptions
from tests.integration.kubernetes.action_scripts import COPY, LASTING
from tests.integration.kubernetes.conftest import RunnerSite
from tests.integration.kubernetes.real_cluster import NAMESPACE, RealCluster
from tests.integration.runner_loop.conftest import ended, wait_until
from tests.integration.runner_loop.fake_http import RUN_TOKEN
from tests.integration.runner_loop.fake_runs import FakeRun
from tests.integration.runner_loop.fake_server import FakeServer
from tests.kubernetes_access import Body
from tests.kubernetes_cluster import NODE

pytestmark = [pytest.mark.slow, pytest.mark.soak]
_TIMEOUT_S = 300.0


class RealSite(RunnerSite):
    """A fake server, and the runners of one test on the real cluster."""

    real: RealCluster

    def launch(self, code: str, inputs: dict[str, bytes] | None = None, **changes: object) -> FakeRun:
        """Queue a run with an open network, the only one of this cluster."""
        resources = {"cores": 0.1, "memory_bytes": 300_000_000, "time_s": 240}
        own_resources = changes.pop("resources", {})
        assert isinstance(own_resources, dict)
        return self.server.launch(
            code, inputs, network=Network.open, resources={**resources, **own_resources}, **changes
        )

    def pods(self, step: str = "") -> list[Body]:
        """Return the pods of the namespace, or of a step of runs."""
        pods = self.real.cluster.api.items(f"/api/v1/namespaces/{NAMESPACE}/pods")
        return [pod for pod in pods if not step or pod["metadata"]["labels"].get("kleinkram.step") == step]

    def is_clean(self) -> bool:
        """Whether nothing is left of a run."""
        kinds = ("/api/v1/{}/pods", "/apis/batch/v1/{}/jobs", "/api/v1/{}/persistentvolumeclaims")
        api, place = self.real.cluster.api, f"namespaces/{NAMESPACE}"
        secrets = [it["metadata"]["name"] for it in api.items(f"/api/v1/{place}/secrets")]
        left = [it for kind in kinds for it in api.items(kind.format(place))]
        return not left and not [name for name in secrets if name.startswith("klein-")]

    def let_end(self) -> None:
        """Have an action of `LASTING` end."""
        (volume,) = [
            it
            for it in self.real.cluster.api.items("/api/v1/persistentvolumes")
            if it["spec"]["claimRef"]["namespace"] == NAMESPACE and it["status"]["phase"] == "Bound"
        ]
        Path(volume["spec"]["local"]["path"], "out", "end").touch()

    def finish_of(self, run: FakeRun) -> RunFinish:
        """Wait for the only end of a run."""
        (finish,) = ended(run, timeout_s=_TIMEOUT_S).finishes
        return finish

    def wait_until_clean(self) -> None:
        """Wait until nothing is left of any run."""
        wait_until(self.is_clean, timeout_s=120)


@pytest.fixture
def site(kubernetes: RealCluster, tmp_path: Path) -> Iterator[RealSite]:
    """A server without runs that pods reach."""
    server = FakeServer(kubernetes.cluster.address)
    kubernetes.volumes.folder_of = lambda claim: None
    options = KubernetesOptions(
        namespace=NAMESPACE, kubeconfig=kubernetes.kubeconfig, pod_image=kubernetes.pod_image, memory_bytes=10**12
    )
    made = RealSite(
        server=server,
        folder=tmp_path / "runner",
        options=options,
        default_image=kubernetes.script_image,
        networks=frozenset({Network.open}),
    )
    made.real = kubernetes
    yield made
    made.close()
    server.close()
    kubernetes.cluster.kubectl(
        "delete", "jobs,pvc,secrets", "--selector", "app.kubernetes.io/managed-by=kleinkram-runner", namespace=NAMESPACE
    )
    made.wait_until_clean()


@pytest.mark.parametrize(
    ("words", "is_allowed"),
    [
        ("create jobs.batch", True),
        ("watch pods", True),
        ("get pods/log", True),
        ("delete persistentvolumeclaims", True),
        ("create secrets", True),
        ("get secrets", False),
        ("list secrets", False),
        ("create pods", False),
        ("create pods/exec", False),
        ("patch jobs.batch", False),
        ("list nodes", False),
        ("create rolebindings.rbac.authorization.k8s.io", False),
    ],
)
def test_the_service_account_has_the_rights_of_its_role_alone(
    kubernetes: RealCluster, words: str, is_allowed: bool
) -> None:
    assert is_allowed_to(kubernetes, words, NAMESPACE) is is_allowed
    assert not is_allowed_to(kubernetes, words, "default")


def is_allowed_to(real: RealCluster, words: str, namespace: str) -> bool:
    """Ask the API server, as an administrator, what the service account may do."""
    verb, resource = words.split()
    resource, _, subresource = resource.partition("/")
    resource, _, group = resource.partition(".")
    attributes = {
        "namespace": namespace,
        "verb": verb,
        "group": group,
        "resource": resource,
        "subresource": subresource,
    }
    body: Body = {
        "apiVersion": "authorization.k8s.io/v1",
        "kind": "SubjectAccessReview",
        "spec": {
            "user": f"system:serviceaccount:{NAMESPACE}:kleinkram-runner",
            "groups": ["system:serviceaccounts", f"system:serviceaccounts:{NAMESPACE}", "system:authenticated"],
            "resourceAttributes": attributes,
        },
    }
    answer = real.cluster.api.send("POST", "/apis/authorization.k8s.io/v1/subjectaccessreviews", body)
    return bool(answer["status"]["allowed"])


def test_a_run_reads_its_inputs_and_its_results_are_stored(site: RealSite, capfd: pytest.CaptureFixture[str]) -> None:
    site.spawn()
    run = site.launch(COPY, {"a/drive.bag": b"bytes of a drive"}, token=RUN_TOKEN)
    finish = site.finish_of(run)
    assert (finish.reason, finish.message, finish.problems) == (EndReason.done, "", [])
    assert run.artifacts == {"deep/copy": b"bytes of a drive", LOG_PATH: b"a-mission\n"}
    assert [metric.name for metric in finish.report.metrics] == ["size"]
    assert finish.placement is not None
    assert finish.placement.node == NODE
    site.wait_until_clean()
    # Its network plugin enforces no policies, which was noticed.
    assert site.server.registrations[0].abilities.networks == {Network.open}
    assert "does not enforce NetworkPolicies" in capfd.readouterr().err


def test_a_cancelled_run_ends_soon_and_leaves_nothing(site: RealSite) -> None:
    site.start()
    run = site.launch(LASTING)
    wait_until(site.has_begun, timeout_s=_TIMEOUT_S)
    run.is_cancelled = True
    assert site.finish_of(run).reason is EndReason.cancelled
    site.wait_until_clean()


def test_too_much_memory(site: RealSite) -> None:
    site.start()
    run = site.launch("held = bytearray(b'x' * 800_000_000)")
    finish = site.finish_of(run)
    assert (finish.reason, "300 MB" in finish.message) == (EndReason.memory, True)


def test_a_time_limit(site: RealSite) -> None:
    site.start()
    run = site.launch(LASTING, resources={"time_s": 3})
    assert site.finish_of(run).reason is EndReason.time


def test_too_much_in_the_temporary_folder_is_evicted(site: RealSite) -> None:
    site.start()
    text = "import time\nwith open('/tmp/large', 'wb') as file: file.write(bytes(90_000_000))\ntime.sleep(200)"
    finish = site.finish_of(site.launch(text))
    assert (finish.reason, "EmptyDir" in finish.message) == (EndReason.disk, True)


def test_an_image_that_is_not_in_its_registry(site: RealSite) -> None:
    site.start()
    image = f"{site.real.registry.registry.place}/kleinkram.test/scripts@sha256:{'b' * 64}"
    finish = site.finish_of(site.launch("", script=None, image=image, command=["x"]))
    assert finish.reason is EndReason.image_unavailable
    assert "not found" in finish.message


def test_a_command_that_is_not_in_its_image(site: RealSite) -> None:
    site.start()
    run = site.launch("", script=None, image=site.real.script_image, command=["/usr/bin/nonsense"])
    finish = site.finish_of(run)
    assert (finish.reason, "/usr/bin/nonsense" in finish.message) == (EndReason.command_not_found, True)


def test_the_words_of_the_scheduler_are_shown_while_a_run_waits(site: RealSite) -> None:
    site.start()
    run = site.launch(LASTING, resources={"memory_bytes": 500 * 10**9})
    words = "0/1 nodes are available: 1 Insufficient memory."
    wait_until(lambda: any(words in (it.message or "") for it in run.progress), timeout_s=_TIMEOUT_S)
    run.is_cancelled = True
    assert site.finish_of(run).reason is EndReason.cancelled
    site.wait_until_clean()


def test_a_quota_that_allows_no_pod_is_shown(site: RealSite) -> None:
    place = f"/api/v1/namespaces/{NAMESPACE}/resourcequotas"
    body: Body = {
        "apiVersion": "v1",
        "kind": "ResourceQuota",
        "metadata": {"name": "none"},
        "spec": {"hard": {"pods": "0"}},
    }
    site.real.cluster.api.send("POST", place, body)
    try:
        site.start()
        run = site.launch("print('x')")
        wait_until(lambda: any(endings.NO_POD[:40] in (it.message or "") for it in run.progress), timeout_s=_TIMEOUT_S)
    finally:
        site.real.cluster.api.send("DELETE", f"{place}/none")
    assert site.finish_of(run).reason is EndReason.done


def test_a_pod_that_somebody_deletes_is_lost(site: RealSite) -> None:
    site.start()
    run = site.launch(LASTING)
    wait_until(site.has_begun, timeout_s=_TIMEOUT_S)
    (pod,) = site.pods("action")
    site.real.cluster.kubectl("delete", "pod", pod["metadata"]["name"], namespace=NAMESPACE)
    finish = site.finish_of(run)
    assert (finish.reason, "removed from outside" in finish.message) == (EndReason.lost, True)


@pytest.mark.parametrize("when", ["fetch", "action", "store"])
def test_a_killed_runner_finds_its_jobs_again(site: RealSite, when: str) -> None:
    site.server.slow_bytes_per_s = 100_000 if when == "fetch" else None
    if when == "store":
        site.server.holds_uploads.set()
    first = site.spawn()
    run = site.launch(LASTING, {"drive.bag": bytes(500_000)})
    if when != "fetch":
        wait_until(site.has_begun, timeout_s=_TIMEOUT_S)
    if when == "store":
        site.let_end()
    wait_until(lambda: any(it["status"]["phase"] == "Running" for it in site.pods(when)), timeout_s=_TIMEOUT_S)
    site.kill(first, signal.SIGKILL)
    site.server.slow_bytes_per_s = None
    site.server.holds_uploads.clear()
    site.spawn()
    if when != "store":
        wait_until(site.has_begun, timeout_s=_TIMEOUT_S)
        site.let_end()
    finish = site.finish_of(run)
    assert (finish.reason, run.attempt) == (EndReason.done, 1)
    assert run.artifacts == {"x": b"x", LOG_PATH: b"began\n"}
    site.wait_until_clean()


@pytest.mark.parametrize("service", ["kube-apiserver", "etcd", "kube-controller-manager", "kubelet", "containerd"])
def test_a_service_of_the_cluster_is_killed_during_a_run(site: RealSite, service: str) -> None:
    cluster = site.real.cluster
    site.start()
    run = site.launch(LASTING)
    wait_until(site.has_begun, timeout_s=_TIMEOUT_S)
    cluster.kill(service)
    time.sleep(2)
    cluster.repair()
    site.let_end()
    finish = site.finish_of(run)
    assert (finish.reason, finish.message) == (EndReason.done, "")
    assert run.artifacts == {"x": b"x", LOG_PATH: b"began\n"}
    site.wait_until_clean()


_RUNS = 20
# Each start has a name of its own, in every line of the log and in its only file.
_NAMED = (
    "import time, uuid\nfrom kleinkram.action import out\nname = uuid.uuid4().hex\n"
    "for _ in range({beats}):\n    print(name, flush=True)\n    time.sleep(0.1)\n"
    "(out / 'name').write_text(name)\n"
)


def test_no_run_is_lost_doubled_or_stuck(site: RealSite) -> None:
    chance = random.Random(28)
    runs = [site.launch(_NAMED.format(beats=chance.randrange(1, 50)), resources={"time_s": 600}) for _ in range(_RUNS)]
    runner = site.spawn()
    wait_until(lambda: site.server.registrations, timeout_s=_TIMEOUT_S)
    until_s = time.monotonic() + 40 * _RUNS
    counts = dict.fromkeys(("runner", "kube-apiserver", "kube-controller-manager", "kubelet", "etcd"), 0)
    # Each at least once, then by chance.
    victims = chance.sample([*counts], len(counts))
    while not all(run.finishes for run in runs):
        stuck = [str(run.claim.run_id) for run in runs if not run.finishes]
        assert time.monotonic() < until_s, f"stuck: {stuck}"
        victim = victims.pop() if victims else chance.choice([*counts])
        counts[victim] += 1
        if victim == "runner":
            site.kill(runner, signal.SIGKILL)
        else:
            site.real.cluster.kill(victim)
        time.sleep(chance.uniform(0, 4))
        site.real.cluster.repair()
        if runner.poll() is not None:
            runner = site.spawn()
        time.sleep(chance.uniform(5, 20))
    for run in runs:
        assert [(finish.reason, finish.message) for finish in run.finishes] == [(EndReason.done, "")]
        # A second attempt would have a log and results of its own.
        assert run.attempt == 1
        names = run.artifacts[LOG_PATH].decode().split()
        assert set(names) == {run.artifacts["name"].decode()}
        assert len(names) == int(str(run.claim.script).partition("range(")[2].partition(")")[0])
    assert not victims, f"ended before all were killed: {counts}"
    site.wait_until_clean()
