"""The pods of Kleinkram for one run: one fetches its inputs to a volume, and one stores its results from there.

Inputs are fetched again where that helps. Results are on the volume alone, which is kept while they may be stored.
"""

import contextlib
import logging
import math
import time
from collections.abc import Mapping

from kleinkram.contract.actions import Resources
from kleinkram.contract.runners import RunFinish
from kleinkram.contract.runs import EndReason
from kleinkram.environments.cache import Show
from kleinkram.environments.uv import Wait
from kleinkram.runner.executors.base import UPLOADING, CannotStart, Ending
from kleinkram.runner.executors.kubernetes import endings
from kleinkram.runner.executors.kubernetes.api_objects import Pod
from kleinkram.runner.executors.kubernetes.cluster import Body, Cluster, ClusterError, ClusterUnavailable, Kind
from kleinkram.runner.executors.kubernetes.pod_watch import PodWatch
from kleinkram.runner.executors.kubernetes.run_objects import RunObjects, names_of
from kleinkram.runner.executors.kubernetes.transfer_output import FetchOutcome, read_finish
from kleinkram.runner.input_cache import InputSource

_log = logging.getLogger("kleinkram.runner")
_JOB_CHECK_S = 2.0
_CHECK_S = 0.5
# How often inputs are fetched where a pod was lost, or the node did not say how it ended.
_MAX_FETCHES = 3
# How often results are stored where the report is lost: stored files are not sent again.
_MAX_STORES = 2
_READ_REPORT_S = 60.0
# Only a pod that starts saves the results: an administrator has a day to mend what it waits for.
_STORE_STARTS_WITHIN_S = 86_400.0
_NO_PODS, _NO_OUTCOME = "Its pods were removed.", "Its node did not say how it ended."
_NO_REPORT = "What it reported is not in its output any more."


class Transfers:
    """The pods that fetch and store, of all runs of one runner. Thread-safe."""

    def __init__(self, cluster: Cluster, watch: PodWatch, objects: RunObjects) -> None:
        self._cluster = cluster
        self._watch = watch
        self._objects = objects

    def fetch(self, key: str, bodies: Mapping[Kind, Body], resources: Resources, source: InputSource) -> FetchOutcome:
        """Create the objects of a pod that fetches inputs, and return what it says; again, where it was lost.

        Raises:
            CannotStart: it cannot be started, or fails.
        """
        name = names_of(key).fetch
        for number in range(1, _MAX_FETCHES + 1):
            self._objects.await_removal(key, source.wait)
            for kind, body in bodies.items():
                self._objects.create(kind, body, source.wait, source.show)
            pod = self._await_end(name, source.wait, source.show, starts_within_s=None)
            outcome = FetchOutcome.parse(pod.container.terminated.message if pod and pod.container.terminated else "")
            if outcome is not None:
                self._objects.await_end_of_pods(name, source.wait)
                return outcome
            ending = endings.ending_of(pod, resources) if pod else Ending(EndReason.lost, _NO_PODS)
            if ending.reason not in {EndReason.done, EndReason.lost}:
                break
            _log.warning("fetch %d of the inputs of the run %s: %s", number, key, ending.message or _NO_OUTCOME)
            self._objects.delete(key)
        message = f"The pod that fetches its inputs failed: {ending.message or _NO_OUTCOME} {_words(pod)}".strip()
        raise CannotStart(Ending(EndReason.inputs_unavailable, message))

    def store(self, key: str, body: Body, resources: Resources, wait: Wait, show: Show) -> RunFinish:
        """Have a pod upload the results from the volume, and return its report.

        Raises:
            CannotStart: it does not start, fails, or its report is lost; the message says why.
        """
        name = names_of(key).store
        problem = ""
        for number in range(1, _MAX_STORES + 1):
            self._objects.create(
                "jobs", body, wait, show, timeout_s=math.inf, may_exist=True, refused_s=_STORE_STARTS_WITHIN_S
            )
            pod = self._await_end(name, wait, show, starts_within_s=_STORE_STARTS_WITHIN_S)
            if pod is not None and pod.status.phase == "Succeeded":
                if (finish := self._read_report(pod, wait)) is not None:
                    return finish
                problem = _NO_REPORT
            elif pod is not None and pod.has_ended:
                problem = f"{endings.ending_of(pod, resources).message} {_words(pod)}".strip()
                break
            else:
                problem = _NO_PODS
            _log.warning("storing the results of the run %s, try %d: %s", key, number, problem)
            if number < _MAX_STORES:
                self._objects.remove_job(name, wait)
        raise CannotStart(Ending(EndReason.results_not_stored, problem))

    def has_volume(self, key: str, wait: Wait) -> bool:
        """Whether the volume of a run exists; waits until the API server says so."""
        while True:
            try:
                return self._cluster.has_volume(names_of(key).volume)
            except ClusterError as error:  # noqa: PERF203  each round takes seconds
                _log.warning("the results of the run %s wait: %s", key, error)
                wait(_JOB_CHECK_S)

    def _read_report(self, pod: Pod, wait: Wait) -> RunFinish | None:
        """Return the report of an ended pod. Nodes answer for a while with an error in place of the output."""
        deadline_s = time.monotonic() + _READ_REPORT_S
        problem: Exception
        while True:
            try:
                return read_finish(self._cluster.read_output(pod.metadata.name))
            except ClusterUnavailable as error:
                problem, deadline_s = error, time.monotonic() + _READ_REPORT_S
            except ClusterError as error:
                if error.is_missing:
                    return None
                problem = error
            except ValueError as error:
                problem = error
            if time.monotonic() > deadline_s:
                _log.warning("the report of %s cannot be read: %s", pod.metadata.name, problem)
                return None
            wait(_JOB_CHECK_S)

    def _await_end(self, name: str, wait: Wait, show: Show, *, starts_within_s: float | None) -> Pod | None:
        """Wait for the end of a Job that may start several pods, and return the last; None where there is none.

        Raises:
            CannotStart: it does not start within this time; None: as soon as the cluster names a lasting reason.
        """
        checked_s = 0.0
        began_s = seen_s = time.monotonic()
        while True:
            pod = self._watch.find(name) if self._watch.is_current else None
            if pod is not None and pod.status.phase == "Succeeded":
                return pod
            now_s = time.monotonic()
            reason = self._reason_waiting(pod, began_s)
            if pod is not None and reason is None:
                began_s = now_s
            if pod is None or not pod.spec.node_name:
                seen_s = now_s
            if starts_within_s is None:
                failure = endings.failed_start(pod, now_s - seen_s) if pod is not None else None
                if failure is not None:
                    raise CannotStart(failure)
            elif now_s - began_s > starts_within_s:
                message = f"It did not start within {starts_within_s / 3600:.0f} h: {reason or endings.NO_POD}"
                raise CannotStart(Ending(EndReason.results_not_stored, message))
            if reason is not None:
                show(reason, 0.0)
            elif starts_within_s is not None:
                show(UPLOADING, 1.0)
            if now_s > checked_s + _JOB_CHECK_S:
                checked_s = now_s
                with contextlib.suppress(ClusterError):
                    job = self._cluster.find_job(name)
                    if job is None or job.failure is not None:
                        return self._watch.find(name) or pod
            wait(0)
            self._watch.wait(lambda seen=pod: self._watch.find(name) is not seen, _CHECK_S)  # type: ignore[misc]

    def _reason_waiting(self, pod: Pod | None, began_s: float) -> str | None:
        if pod is not None:
            return endings.reason_waiting(pod)
        has_waited = time.monotonic() > began_s + _JOB_CHECK_S
        return endings.NO_POD if self._watch.is_current and has_waited else None


def _words(pod: Pod | None) -> str:
    words = endings.last_words(pod) if pod is not None else ""
    return f"It said: {words}" if words else ""
