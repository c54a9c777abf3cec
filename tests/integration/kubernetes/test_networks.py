"""Which networks a runner offers: those that pods of the cluster were seen to have."""

from __future__ import annotations

import json
import threading

import pytest

from kleinkram.contract.actions import Network
from kleinkram.runner import loop
from kleinkram.runner.executors.kubernetes.cluster import connect
from kleinkram.runner.executors.kubernetes.manifests import Manifests
from kleinkram.runner.executors.kubernetes.network_probe import FoundNetworks, find_networks
from kleinkram.runner.executors.kubernetes.options import KubernetesOptions
from kleinkram.runner.state_directory import StateDirectory
from tests.integration.kubernetes.conftest import Site
from tests.integration.kubernetes.fake_cluster import LATE, NAMESPACE, FakeCluster
from tests.integration.kubernetes.manifests import rules
from tests.integration.runner_loop.conftest import wait_until

URL = "https://192.0.2.10"


def offered_in(cluster: FakeCluster, *, allows_metadata: bool = False) -> FoundNetworks:
    options = KubernetesOptions(namespace=NAMESPACE, kubeconfig=cluster.kubeconfig())
    return find_networks(
        connect(NAMESPACE, options.kubeconfig),
        Manifests(options, "a-runner"),
        URL,
        allows_metadata=allows_metadata,
        is_closed=threading.Event(),
    )


def networks_of(cluster: FakeCluster, *, allows_metadata: bool = False) -> frozenset[Network]:
    return offered_in(cluster, allows_metadata=allows_metadata).networks


def test_networks_that_policies_separate_are_offered(cluster: FakeCluster) -> None:
    cluster.rules = rules()
    assert networks_of(cluster) == set(Network)
    assert not cluster.named("jobs")


@pytest.mark.slow
def test_pods_of_a_check_that_was_killed_are_removed_by_the_next_runner(site: Site) -> None:
    site.folder.mkdir()
    manifests = Manifests(site.options, str(StateDirectory(site.folder).runner_id))
    key = "probe-0123abcd-none"
    connect(NAMESPACE, site.options.kubeconfig).create("jobs", manifests.probe(key, "none", [("192.0.2.10", 443)]))
    assert site.cluster.named("jobs")
    site.start()
    wait_until(lambda: not site.cluster.named("jobs"))


def test_policies_that_nothing_enforces_are_noticed(cluster: FakeCluster, caplog: pytest.LogCaptureFixture) -> None:
    cluster.ignores_policies = True
    assert networks_of(cluster) == {Network.open}
    assert "does not enforce NetworkPolicies" in caplog.text


def test_a_policy_with_the_address_of_another_server_is_noticed(
    cluster: FakeCluster, caplog: pytest.LogCaptureFixture
) -> None:
    cluster.network_policies = json.loads(json.dumps(cluster.network_policies).replace("192.0.2.10", "192.0.2.99"))
    assert networks_of(cluster) == {Network.open, Network.none}
    assert "'api' is not offered: a pod with the label kleinkram.network=api reached nothing" in caplog.text


def test_a_namespace_that_refuses_jobs_is_noticed(cluster: FakeCluster, caplog: pytest.LogCaptureFixture) -> None:
    cluster.rules = [rule for rule in rules() if "jobs" not in rule["resources"]]
    offered = offered_in(cluster)
    assert offered == FoundNetworks(frozenset(), are_all_known=False)
    assert "cannot create resource" in caplog.text


def test_requests_to_an_overloaded_api_server_are_repeated(cluster: FakeCluster) -> None:
    cluster.fails = {("create", "jobs"): [429, LATE], ("list", "pods"): [500, 429, 503]}
    offered = offered_in(cluster)
    assert offered == FoundNetworks(frozenset(Network), are_all_known=True)
    assert not any(cluster.fails.values())
    assert not cluster.named("jobs")


def test_an_open_network_that_reaches_a_metadata_service_is_not_offered(
    cluster: FakeCluster, caplog: pytest.LogCaptureFixture
) -> None:
    cluster.has_metadata = True
    assert networks_of(cluster) == set(Network)
    assert "metadata" not in caplog.text
    cluster.ignores_policies = True
    assert networks_of(cluster) == set()
    (error,) = [it for it in caplog.records if it.levelname == "ERROR"]
    assert "the credentials of their nodes" in error.getMessage()
    assert networks_of(cluster, allows_metadata=True) == {Network.open}


@pytest.mark.slow
def test_networks_that_were_not_known_are_reported_later(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(loop, "_ABILITIES_RETRY_S", 0.2)
    site.networks = None
    site.cluster.fails = {("create", "jobs"): [403, 403]}
    site.start()
    wait_until(
        lambda: (
            site.server.registrations
            and site.server.registrations[-1].abilities.networks == {Network.none, Network.open}
        )
    )
    assert site.server.registrations[0].abilities.networks == set()
