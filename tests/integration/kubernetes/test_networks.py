"""Which networks a runner offers: those that pods of the cluster were seen to have."""

from __future__ import annotations

import json

import pytest

from kleinkram.contract.actions import Network
from kleinkram.runner.executors.kubernetes.cluster import connect
from kleinkram.runner.executors.kubernetes.manifests import Manifests
from kleinkram.runner.executors.kubernetes.network_probe import find_networks
from kleinkram.runner.executors.kubernetes.options import KubernetesOptions
from kleinkram.runner.state_directory import StateDirectory
from tests.integration.kubernetes.conftest import Site
from tests.integration.kubernetes.fake_cluster import NAMESPACE, FakeCluster
from tests.integration.kubernetes.manifests import rules
from tests.integration.runner_loop.conftest import wait_until

URL = "https://192.0.2.10"


def networks_of(cluster: FakeCluster) -> frozenset[Network]:
    options = KubernetesOptions(namespace=NAMESPACE, kubeconfig=cluster.kubeconfig())
    return find_networks(connect(NAMESPACE, options.kubeconfig), Manifests(options, "a-runner"), URL)


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
    assert networks_of(cluster) == {Network.open}
    assert "cannot create resource" in caplog.text
