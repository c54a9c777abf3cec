"""Finds out which networks a cluster really gives to pods, by pods that try to connect.

A NetworkPolicy without a network plugin that enforces it changes nothing, and nobody can be asked: so one pod per
network tries to reach the server of Kleinkram, and the API server of Kubernetes, which no run needs.
"""

import json
import logging
import time
import uuid
from collections.abc import Mapping, Sequence
from typing import NamedTuple
from urllib.parse import urlsplit

from kleinkram.contract.actions import Network
from kleinkram.runner.executors.kubernetes import endings
from kleinkram.runner.executors.kubernetes.cluster import Cluster, ClusterError, Pod
from kleinkram.runner.executors.kubernetes.manifests import NETWORK_LABEL, TRANSFER, Manifests, Names

_log = logging.getLogger("kleinkram.runner")
_TIMEOUT_S = 180.0
_CHECK_S = 0.5
_DEFAULT_PORTS = {"http": 80, "https": 443}
# Its name in every cluster, from every namespace.
_API_SERVER = ("kubernetes.default.svc", 443)
_NETWORKS = (*(network.value for network in Network), TRANSFER)


class Reached(NamedTuple):
    """What a pod reached: the server of Kleinkram, and an address that only an open network reaches."""

    server: bool
    other: bool


def find_networks(cluster: Cluster, manifests: Manifests, url: str) -> frozenset[Network]:
    """Return the networks that pods were seen to have, and say what is missing for the others."""
    parts = urlsplit(url)
    server = (parts.hostname or "", parts.port or _DEFAULT_PORTS[parts.scheme])
    try:
        reached = _probe(cluster, manifests, [server, _API_SERVER])
    except ClusterError as error:
        _log.warning("the networks of pods are not known, so that only open ones are offered: %s", error)
        return frozenset({Network.open})
    if not reached.get(TRANSFER, Reached(server=False, other=False)).server:
        _log.error("no pod that fetches inputs and stores results reaches the server at %s: no run will succeed", url)
    return judge(reached)


def judge(reached: Mapping[str, Reached]) -> frozenset[Network]:
    """Return the networks that are shown to be as they should."""
    nothing = Reached(server=False, other=False)
    of_open = reached.get(Network.open.value, nothing)
    networks = {Network.open}
    if not of_open.other:
        _log.warning(
            "no pod with an open network was seen to reach %s:%d, so that nothing shows whether NetworkPolicies are "
            "enforced: only the network 'open' is offered",
            *_API_SERVER,
        )
        return frozenset(networks)
    if reached.get(Network.none.value) == nothing:
        networks.add(Network.none)
    if reached.get(Network.api.value) == Reached(server=True, other=False):
        networks.add(Network.api)
    for network in sorted({Network.none, Network.api} - networks):
        _log.warning(
            "the network %r is not offered: a pod with the label %s=%s %s. Its NetworkPolicy is missing or wrong, or "
            "the network plugin of this cluster does not enforce NetworkPolicies (docs/runs-on-kubernetes.md)",
            network.value,
            NETWORK_LABEL,
            network.value,
            _words(reached.get(network.value)),
        )
    return frozenset(networks)


def _words(reached: Reached | None) -> str:
    if reached is None:
        return "did not run"
    places = [
        name for name, is_reached in (("the server", reached.server), ("other addresses", reached.other)) if is_reached
    ]
    return f"reached {' and '.join(places) or 'nothing'}"


def _probe(cluster: Cluster, manifests: Manifests, targets: Sequence[tuple[str, int]]) -> dict[str, Reached]:
    """Run a pod for each network; those that do not end in time are left out."""
    mark = uuid.uuid4().hex[:8]
    keys = {network: f"probe-{mark}-{network}" for network in _NETWORKS}
    jobs = {network: Names.of(key).action for network, key in keys.items()}
    try:
        for network, key in keys.items():
            cluster.create("jobs", manifests.probe(key, network, targets))
        return _results(cluster, manifests, jobs)
    finally:
        for name in jobs.values():
            try:
                cluster.delete("jobs", name)
            except ClusterError as error:  # noqa: PERF203  each round is a request
                _log.warning("the Job %s was not removed: %s", name, error)


def _results(cluster: Cluster, manifests: Manifests, jobs: Mapping[str, str]) -> dict[str, Reached]:
    deadline_s = time.monotonic() + _TIMEOUT_S
    while True:
        pods = {pod.metadata.labels.get("job-name"): pod for pod in cluster.list_pods(manifests.selector)[0]}
        ended = {network: pods[name] for network, name in jobs.items() if name in pods and pods[name].has_ended}
        if len(ended) == len(jobs) or time.monotonic() > deadline_s:
            for network in jobs.keys() - ended.keys():
                pod = pods.get(jobs[network])
                _log.warning("the pod that tries %r did not run: %s", network, _reason(pod))
            return {network: reached for network, pod in ended.items() if (reached := _read(pod)) is not None}
        time.sleep(_CHECK_S)


def _reason(pod: Pod | None) -> str:
    return endings.NO_POD if pod is None else endings.reason_waiting(pod) or "it runs"


def _read(pod: Pod) -> Reached | None:
    terminated = pod.container.terminated
    try:
        server, other = json.loads(terminated.message if terminated else "")
    except ValueError:
        return None
    return Reached(server=bool(server), other=bool(other))
