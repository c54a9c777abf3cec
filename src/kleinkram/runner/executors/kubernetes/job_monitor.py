"""Watches the pod of one action: what it waits for, its log, its limits and its end."""

import contextlib
import json
import threading
import time
from collections.abc import Sequence

from kleinkram.contract.runs import EndReason, RunPlacement
from kleinkram.runner.executors.base import Ending, RunJob
from kleinkram.runner.executors.kubernetes import endings
from kleinkram.runner.executors.kubernetes.api_objects import Pod
from kleinkram.runner.executors.kubernetes.cluster import Body, Cluster, ClusterError, ClusterUnavailable, Kind
from kleinkram.runner.executors.kubernetes.pod_log import PodLog
from kleinkram.runner.executors.kubernetes.pod_watch import PodWatch
from kleinkram.runner.executors.kubernetes.run_objects import OverQuota, RunObjects, names_of
from kleinkram.runner.executors.local import limits_of
from kleinkram.runner.executors.supervision import DISK_FULL, LimitMonitor, boot_time_s, write_atomically

STOP_REASON, STARTED, FIRST_POD = "stop-reason.json", "started", "pod"
_JOB_CHECK_S = 2.0
_LOG_COMPLETE_S = 60.0


class JobMonitor:
    """The monitor of one job. `poll` is called by one thread, the other methods by any."""

    def __init__(self, cluster: Cluster, watch: PodWatch, objects: RunObjects, job: RunJob) -> None:
        self._cluster = cluster
        self._watch = watch
        self._objects = objects
        self._job = job
        self._name = names_of(job.key).action
        self._limits = LimitMonitor(job.directory, limits_of(job))
        with contextlib.suppress(FileNotFoundError, ValueError):
            reason, message = json.loads((job.directory / STOP_REASON).read_text())
            self._limits.reason = reason, message
        self._waits_since_s = time.monotonic()
        self._pod: Pod | None = None
        self._log: PodLog | None = None
        self._is_deleted = False
        self._started_s: float | None = None
        self._ended_s: float | None = None
        self._job_checked_s = 0.0
        self._ending: Ending | None = None
        # What a quota had no room for, and what it said.
        self._uncreated: list[tuple[Kind, Body]] = []
        self._refusal = ""
        self._lock = threading.Lock()
        self.placement: RunPlacement | None = None

    def create(self, bodies: Sequence[tuple[Kind, Body]]) -> None:
        """Create the objects of the job; `poll` creates those for which a quota has no room at the moment.

        Raises:
            CannotStart: the cluster refuses them.
        """
        self._uncreated = [*bodies]
        try:
            while self._uncreated:
                self._objects.create(*self._uncreated[0], time.sleep, None)
                self._uncreated.pop(0)
        except OverQuota as error:
            self._refusal = str(error)

    def poll(self) -> Ending | None:
        """Return how the job ended, or None while it runs or its log is incomplete."""
        with self._lock:
            if self._ending is None:
                self._ending = self._poll()
            return self._ending

    def reason_waiting(self) -> str | None:
        """Return why its pod does not run yet."""
        if self._uncreated:
            return self._refusal
        if not self._watch.is_current:
            return None if self._pod is not None else "its pod is not known yet"
        pod = self._watch.find(self._name)
        if pod is not None:
            self._place(pod)
            return endings.reason_waiting(pod)
        return None if self._pod is not None or self._ending is not None else endings.NO_POD

    def stop(self, reason: tuple[str, str]) -> None:
        """Have the job stopped. Raises OSError."""
        self._limits.stop(reason)
        self._delete()

    def close(self) -> None:
        """End the threads."""
        if self._log is not None:
            self._log.close()

    def _poll(self) -> Ending | None:
        if self._uncreated:
            return self._poll_uncreated()
        if not self._watch.is_current:
            self._enforce()
            return None
        pod = self._watch.find(self._name)
        if pod is None:
            return self._poll_without_pod()
        self._pod = pod
        self._place(pod)
        if not self._is_first(pod):
            # Old clusters, such as 1.20, replace a pod that somebody deleted, whatever it has done by then.
            lost = endings.ending_without_pod(None)
            self._limits.stop((lost.reason.value, lost.message), grace_s=0)
        elif pod.container.running or pod.container.terminated:
            self._follow(pod)
        if pod.has_ended:
            return self._poll_ended(endings.ending_of(pod, self._job.resources))
        if not pod.spec.node_name:
            self._waits_since_s = time.monotonic()
        failure = endings.failed_start(pod, time.monotonic() - self._waits_since_s)
        if failure is not None:
            self._limits.stop((failure.reason.value, failure.message), grace_s=0)
        self._enforce()
        return None

    def _poll_uncreated(self) -> Ending | None:
        """Try again to create what a quota had no room for."""
        self._enforce()
        if self._limits.reason is not None:
            return Ending.of(self._limits.reason)
        if time.monotonic() < self._job_checked_s + _JOB_CHECK_S:
            return None
        self._job_checked_s = time.monotonic()
        try:
            self._cluster.create(*self._uncreated[0])
        except ClusterUnavailable:
            return None
        except ClusterError as error:
            if error.is_over_quota:
                self._refusal = endings.reason_refused(str(error))
                return None
            # It exists where the answer to an earlier try was lost.
            if not error.is_existing:
                return Ending(EndReason.not_possible, f"The cluster refuses it: {error}.")
        self._uncreated.pop(0)
        return None

    def _poll_without_pod(self) -> Ending | None:
        """Ask for the Job: its pod is not there yet, or not any more."""
        if time.monotonic() < self._job_checked_s + _JOB_CHECK_S and self._pod is None:
            return None
        self._job_checked_s = time.monotonic()
        try:
            job = self._cluster.find_job(self._name)
        except ClusterError:
            return None
        if job is not None and job.failure is None and self._pod is None:
            self._enforce()
            return None
        return self._poll_ended(endings.ending_without_pod(job.failure if job else None))

    def _poll_ended(self, ending: Ending) -> Ending | None:
        self._ended_s = self._ended_s or time.monotonic()
        if self._log is not None and not self._log.is_complete:
            self._log.finish()
            if self._log.has_space and not self._log.is_gone and time.monotonic() < self._ended_s + _LOG_COMPLETE_S:
                return None
            if self._log.has_space:
                self._log.give_up()
        if self._log is not None and not self._log.has_space:
            return Ending.of(DISK_FULL)
        return Ending.of(self._limits.reason) if self._limits.reason is not None else ending

    def _place(self, pod: Pod) -> None:
        waited_s = endings.queued_s(pod)
        name = f"{self._cluster.namespace}/{pod.metadata.name}"
        self.placement = RunPlacement(job_id=name[:200], node=pod.spec.node_name, queued_s=waited_s)

    def _is_first(self, pod: Pod) -> bool:
        """Whether a pod is the first that any runner saw of this job."""
        path = self._job.directory / FIRST_POD
        with contextlib.suppress(FileNotFoundError):
            return path.read_text() == pod.metadata.uid
        write_atomically(path, pod.metadata.uid)
        return True

    def _follow(self, pod: Pod) -> None:
        if self._log is None:
            self._log = PodLog(self._cluster, pod.metadata.name, self._job.directory)
            self._log.follow()
        if self._started_s is None:
            self._started_s = boot_time_s() - self._running_s()

    def _running_s(self) -> float:
        """Return for how long a runner has seen it run, by the clock of this machine: those of nodes may be wrong."""
        path = self._job.directory / STARTED
        with contextlib.suppress(FileNotFoundError, ValueError):
            return max(0.0, time.time() - float(path.read_text()))
        write_atomically(path, str(time.time()))
        return 0.0

    def _enforce(self) -> None:
        if self._log is not None and not self._log.has_space:
            self._limits.stop(DISK_FULL, grace_s=0)
        self._limits.check(boot_time_s() - self._started_s if self._started_s is not None else 0.0)
        if self._limits.reason is not None:
            with contextlib.suppress(OSError):
                self._delete()

    def _delete(self) -> None:
        """Delete the Job once. Raises OSError."""
        if self._is_deleted or self._limits.reason is None or self._ending is not None:
            return
        write_atomically(self._job.directory / STOP_REASON, json.dumps(self._limits.reason))
        try:
            self._cluster.delete("jobs", self._name)
        except ClusterError as error:
            raise OSError(str(error)) from error
        self._is_deleted = True
