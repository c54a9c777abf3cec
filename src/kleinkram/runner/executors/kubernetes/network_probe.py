"""Finds out which networks a cluster really gives to pods, by pods that try to connect.

A NetworkPolicy without a network plugin that enforces it changes nothing, and nobody can be asked: so one pod per
network tries to reach the server of Kleinkram, the API server of Kubernetes, which no run needs, and the metadata
service of clouds, by which who reaches it gets the credentials of the node.
"""

import json
import logging
import threading
import time
import uuid
from collections.abc import Mapping, Sequence
from typing import NamedTuple
from urllib.parse import urlsplit

from kleinkram.contract.actions import Network
from kleinkram.runner.executors.kubernetes import endings
from kleinkram.runner.executors.kubernetes.api_objects import Pod
from kleinkram.runner.executors.kubernetes.cluster import Cluster, ClusterError, ClusterUnavailable
from kleinkram.runner.executors.kubernetes.manifests import NETWORK_LABEL, TRANSFER, Manifests, Names

_log = logging.getLogger("kleinkram.runner")
_TIMEOUT_S = 180.0
_CHECK_S = 0.5
_DEFAULT_PORTS = {"http": 80, "https": 443}
# Its name in every cluster, from every namespace.
_API_SERVER = ("kubernetes.default.svc", 443)
# Of AWS, Azure, Google and others.
METADATA_SERVICE = ("169.254.169.254", 80)
_NETWORKS = (*(network.value for network in Network), TRANSFER)


class Reached(NamedTuple):
    """What a pod reached: the server of Kleinkram, an address that only an open network reaches, and metadata."""

    server: bool
    other: bool
    metadata: bool = False


class FoundNetworks(NamedTuple):
    """The networks that pods were seen to have. `are_all_known`: all pods ran, so that another try finds the same."""

    networks: frozenset[Network]
    are_all_known: bool


def find_networks(
    cluster: Cluster, manifests: Manifests, url: str, *, allows_metadata: bool, is_closed: threading.Event
) -> FoundNetworks:
    """Return the networks that pods were seen to have, and say what is missing for the others.

    Ends soon once `is_closed`.
    """
    parts = urlsplit(url)
    server = (parts.hostname or "", parts.port or _DEFAULT_PORTS[parts.scheme])
    try:
        reached = _probe(cluster, manifests, [server, _API_SERVER, METADATA_SERVICE], is_closed)
    except ClusterError as error:
        _log.warning("the networks of pods are not known yet, so that none is offered: %s", error)
        return FoundNetworks(frozenset(), are_all_known=False)
    if is_closed.is_set():
        return FoundNetworks(frozenset(), are_all_known=False)
    if not reached.get(TRANSFER, Reached(server=False, other=False)).server:
        _log.error("no pod that fetches inputs and stores results reaches the server at %s: no run will succeed", url)
    networks = judge(reached, allows_metadata=allows_metadata)
    return FoundNetworks(networks, are_all_known=reached.keys() >= {*_NETWORKS})


def judge(reached: Mapping[str, Reached], *, allows_metadata: bool = False) -> frozenset[Network]:
    """Return the networks that are shown to be as they should."""
    of_open = reached.get(Network.open.value)
    if of_open is None:
        _log.warning("the pod with an open network did not run, so that no network is offered yet")
        return frozenset()
    networks: set[Network] = set()
    if not of_open.metadata or allows_metadata:
        networks.add(Network.open)
    if of_open.metadata:
        _log.log(
            logging.WARNING if allows_metadata else logging.ERROR,
            "a pod with an open network reaches %s:%d, the metadata service of the cloud: runs would get the "
            "credentials of their nodes. %s",
            *METADATA_SERVICE,
            "The option --allow-metadata-access allows it."
            if allows_metadata
            else "So the network 'open' is not offered. Have a network plugin enforce the NetworkPolicies, or block "
            "the address on the nodes; or else allow it by --allow-metadata-access (docs/runs-on-kubernetes.md)",
        )
    if not of_open.other:
        _log.warning(
            "no pod with an open network was seen to reach %s:%d, so that nothing shows whether NetworkPolicies are "
            "enforced: the networks 'none' and 'api' are not offered",
            *_API_SERVER,
        )
        return frozenset(networks)
    if reached.get(Network.none.value) == Reached(server=False, other=False):
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
    names = ("the server", "other addresses", "the metadata service of the cloud")
    places = [name for name, is_reached in zip(names, reached, strict=True) if is_reached]
    return f"reached {' and '.join(places) or 'nothing'}"


def _probe(
    cluster: Cluster, manifests: Manifests, targets: Sequence[tuple[str, int]], is_closed: threading.Event
) -> dict[str, Reached]:
    """Run a pod for each network; those that do not end in time are left out."""
    mark = uuid.uuid4().hex[:8]
    keys = {network: f"probe-{mark}-{network}" for network in _NETWORKS}
    jobs = {network: Names.of(key).action for network, key in keys.items()}
    deadline_s = time.monotonic() + _TIMEOUT_S
    try:
        pending = [*keys.items()]
        while pending and not is_closed.is_set():
            network, key = pending[0]
            try:
                cluster.create("jobs", manifests.probe(key, network, targets))
            except ClusterUnavailable:
                if time.monotonic() > deadline_s:
                    raise
                is_closed.wait(_CHECK_S)
                continue
            except ClusterError as error:
                # The answer to an earlier try was lost.
                if not error.is_existing:
                    raise
            pending.pop(0)
        return _results(cluster, manifests, jobs, deadline_s, is_closed)
    finally:
        for name in jobs.values():
            try:
                cluster.delete("jobs", name)
            except ClusterError as error:  # noqa: PERF203  each round is a request
                _log.warning("the Job %s was not removed: %s", name, error)


def _results(
    cluster: Cluster, manifests: Manifests, jobs: Mapping[str, str], deadline_s: float, is_closed: threading.Event
) -> dict[str, Reached]:
    pods: dict[str | None, Pod] = {}
    while True:
        is_late = is_closed.is_set() or time.monotonic() > deadline_s
        try:
            pods = {pod.metadata.labels.get("job-name"): pod for pod in cluster.list_pods(manifests.selector)[0]}
        except ClusterUnavailable:
            if is_late:
                raise
        ended = {network: pods[name] for network, name in jobs.items() if name in pods and pods[name].has_ended}
        if len(ended) == len(jobs) or is_late:
            for network in jobs.keys() - ended.keys():
                pod = pods.get(jobs[network])
                _log.warning("the pod that tries %r did not run: %s", network, _reason(pod))
            return {network: reached for network, pod in ended.items() if (reached := _read(pod)) is not None}
        is_closed.wait(_CHECK_S)


def _reason(pod: Pod | None) -> str:
    return endings.NO_POD if pod is None else endings.reason_waiting(pod) or "it runs"


def _read(pod: Pod) -> Reached | None:
    terminated = pod.container.terminated
    try:
        server, other, metadata = json.loads(terminated.message if terminated else "")
    except ValueError:
        return None
    return Reached(server=bool(server), other=bool(other), metadata=bool(metadata))
