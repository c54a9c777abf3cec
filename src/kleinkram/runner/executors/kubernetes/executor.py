"""Runs jobs as Jobs of a Kubernetes cluster: a pod fetches inputs, one runs the action, one stores the results.

All state is in the cluster and in the directory of the job, so that a later runner finds the Jobs by their names. Jobs
go on while no runner does.
"""

import contextlib
import json
import logging
import math
import os
import threading
import time
from collections.abc import Collection, Mapping
from pathlib import Path

from kleinkram.contract.actions import Network, Resources
from kleinkram.contract.errors import RunGone
from kleinkram.contract.isolation import Isolation
from kleinkram.contract.runners import Capacity, ExecutorAbilities, RunFinish
from kleinkram.contract.runs import EndReason, RunPlacement, Usage
from kleinkram.environments.cache import Environment, Show
from kleinkram.environments.uv import Wait
from kleinkram.runner.executors.base import (
    CannotStart,
    Ending,
    Executor,
    LockedScript,
    PinnedImage,
    RunJob,
    StoredResults,
)
from kleinkram.runner.executors.kubernetes import endings
from kleinkram.runner.executors.kubernetes.cluster import Body, Cluster, ClusterError, ClusterUnavailable, Kind, Pod
from kleinkram.runner.executors.kubernetes.image_registry import pin_image
from kleinkram.runner.executors.kubernetes.manifests import (
    KEY_LABEL,
    AssignmentTooLarge,
    Manifests,
    Names,
    PodOrder,
)
from kleinkram.runner.executors.kubernetes.options import KubernetesOptions
from kleinkram.runner.executors.kubernetes.pod_log import PodLog
from kleinkram.runner.executors.kubernetes.pod_watch import PodWatch
from kleinkram.runner.executors.kubernetes.transfer_output import FetchOutcome, read_finish
from kleinkram.runner.executors.local import cannot_start, limits_of
from kleinkram.runner.executors.supervision import (
    CANCELLED,
    DISK_FULL,
    LEASE,
    LOG,
    LimitMonitor,
    boot_time_s,
    write_atomically,
    write_in_place,
)
from kleinkram.runner.input_cache import InputFile, InputSource

_log = logging.getLogger("kleinkram.runner")
# Between the failure of this runner and another one's start of the run: long enough to restart the runner elsewhere.
_LEASE_S = 900
_STOP_REASON, _STARTED, _FIRST_POD = "stop-reason.json", "started", "pod"
_JOB_CHECK_S = 2.0
_CHECK_S = 0.5
# A pod of an earlier start is gone by then, unless its node does not answer.
_GONE_S = 120.0
_LOG_COMPLETE_S = 60.0
_CREATE_S = 60.0
# How often inputs are fetched where a pod was lost, or the node did not say how it ended.
_MAX_FETCHES = 3
_NO_PODS, _NO_OUTCOME = "Its pods were removed.", "Its node did not say how it ended."
_JOB_NAME_LABEL = "job-name"
_CANCELLED_RESULTS = "It was cancelled: its results were not stored."
_NO_NODE = "A pod of an earlier start is not removed by the cluster, since its node does not answer."


class KubernetesExecutor(Executor):
    """Runs jobs on a cluster. `runner` separates its Jobs from those of other runners.

    `url` and `token` are the runner's, for the pods that fetch and store. `networks` are those that the cluster was
    seen to separate.
    """

    def __init__(
        self,
        cluster: Cluster,
        options: KubernetesOptions,
        *,
        runner: str,
        url: str,
        token: str,
        networks: Collection[Network] = (Network.open,),
    ) -> None:
        self._cluster = cluster
        self._options = options
        self._url = url
        self._token = token
        self._networks = frozenset(networks)
        self._manifests = Manifests(options, runner)
        self._watch = PodWatch(cluster, self._manifests.selector, _JOB_NAME_LABEL)
        self._monitors: dict[str, _JobMonitor] = {}
        self._left_keys: set[str] = set()
        self._lock = threading.Lock()
        authorities = os.environ.get("SSL_CERT_FILE")
        self._authorities = Path(authorities).read_text() if authorities else None

    @property
    def abilities(self) -> ExecutorAbilities:
        """Supported features. Whether the size of a volume bounds what is written to it depends on the cluster."""
        return ExecutorAbilities(
            executor="kubernetes",
            isolation=Isolation.container,
            images=True,
            networks=self._networks,
            gpus=self._options.gpus > 0,
            bounds_memory=True,
            bounds_disk=False,
            environments=False,
        )

    @property
    def capacity(self) -> Capacity:
        """The most that one run may have. The cluster queues what does not fit at the moment."""
        options = self._options
        return Capacity(
            cores=options.cores, memory_bytes=options.memory_bytes, disk_bytes=options.disk_bytes, gpus=options.gpus
        )

    @property
    def lease_s(self) -> int:
        """Jobs go on while this process is started again, maybe on another node."""
        return _LEASE_S

    def free(self, reserved: Capacity, job_count: int) -> Capacity | None:
        """Return the most that one run may have, unless there are `max_jobs` already."""
        return self.capacity if job_count < self._options.max_jobs else None

    def prepare_image(self, image: str) -> PinnedImage:
        """Return the digest of an image; nodes pull it when a job starts there."""
        return pin_image(image)

    def place_inputs(self, directory: Path, files: Mapping[str, InputFile], source: InputSource) -> None:
        """Have a pod write the inputs, and what else is in `/in`, to a new volume of the job."""
        for left_key in [*self._left_keys]:
            self._try_to_delete(left_key)
        key = directory.parent.name
        assignment = source.assignment
        size_bytes = sum(file.size_bytes for file in files.values()) + assignment.resources.disk_bytes
        try:
            order = self._manifests.order(
                key, PodOrder(url=self._url, token=self._token, assignment=assignment), self._authorities
            )
        except AssignmentTooLarge:
            message = f"It has {len(files)} inputs: more than can be described to a pod of a cluster."
            raise cannot_start(message) from None
        self._watch.start()
        fetch = self._manifests.fetch(key, assignment, has_authorities=self._authorities is not None)
        volume = self._manifests.claim(key, size_bytes)
        objects: dict[Kind, Body] = {"persistentvolumeclaims": volume, "secrets": order, "jobs": fetch}
        outcome = self._fetch(key, objects, assignment.resources, source)
        if outcome.is_gone:
            raise RunGone(run_id=str(assignment.run_id))
        if outcome.ending is not None:
            raise CannotStart(outcome.ending)

    def _fetch(self, key: str, objects: Mapping[Kind, Body], resources: Resources, source: InputSource) -> FetchOutcome:
        """Create the objects of a pod that fetches inputs, and return what it says; again, where it was lost."""
        for number in range(1, _MAX_FETCHES + 1):
            self._await_removal(key, source.wait)
            self._left_keys.discard(key)
            for kind, body in objects.items():
                self._create(kind, body, source.wait)
            pod = self._await_end(_names(key).fetch, source.wait, source.show)
            outcome = FetchOutcome.parse(pod.container.terminated.message if pod and pod.container.terminated else "")
            if outcome is not None:
                return outcome
            ending = endings.ending_of(pod, resources) if pod else Ending(EndReason.lost, _NO_PODS)
            if ending.reason not in {EndReason.done, EndReason.lost}:
                break
            _log.warning("fetch %d of the inputs of the run %s: %s", number, key, ending.message or _NO_OUTCOME)
            self._try_to_delete(key)
        message = f"The pod that fetches its inputs failed: {ending.message or _NO_OUTCOME}"
        raise CannotStart(Ending(EndReason.inputs_unavailable, message))

    def place_environment(self, script: LockedScript, *, wait: Wait, show: Show) -> Environment:
        """Refuse: packages are not installed for jobs on a cluster."""
        raise cannot_start("A runner on Kubernetes installs no packages: use an image that has them.")

    def find_environment(self, packages: Path) -> Environment | None:
        """Return None: there are none."""
        return None

    def submit(self, job: RunJob) -> None:
        """Create the Job of an action, whose inputs are placed."""
        if job.image is None:
            raise cannot_start("A pod needs an image, and the action names none.")
        if job.network not in self._networks:
            raise cannot_start(f"This cluster does not give a run the network {job.network.value!r}.")
        self._watch.start()
        _names(job.key)
        if job.environment:
            self._create("secrets", self._manifests.environment(job), time.sleep)
        self._create("jobs", self._manifests.action(job), time.sleep)
        self._forget(job)
        self._monitor(job)

    def poll(self, job: RunJob) -> Ending | None:
        """Look at the pod of a job, and enforce its limits."""
        return self._monitor(job).poll()

    def reason_waiting(self, job: RunJob) -> str | None:
        """Return why the pod of a job does not run yet, in the words of the cluster."""
        return self._monitor(job).reason_waiting()

    def placement(self, job: RunJob) -> RunPlacement | None:
        """Return the pod and node of a job. Which GPUs it has, the cluster does not say."""
        return self._monitor(job).placement

    def set_lease(self, job: RunJob, until_s: float, *, create: bool = False) -> None:
        """Write the lease beside the job; it is enforced while a runner has the job."""
        write_in_place(job.directory / LEASE, str(until_s), create=create)

    def read_log(self, job: RunJob, offset: int, size_bytes: int) -> bytes:
        """Read the copy of the output."""
        try:
            with (job.directory / LOG).open("rb") as stream:
                stream.seek(offset)
                return stream.read(size_bytes)
        except FileNotFoundError:
            return b""

    def cancel(self, job: RunJob) -> None:
        """Delete the Job: its pod gets SIGTERM, and SIGKILL later."""
        self._monitor(job).stop(CANCELLED)

    def usage(self, job: RunJob) -> Usage | None:
        """Return None: that would take rights on the metrics of the cluster."""
        return None

    def collect(self, job: RunJob) -> Path:
        """Return a directory that does not exist: results stay on the volume until `upload_results`."""
        return job.directory / "out"

    def upload_results(self, job: RunJob, plain: RunFinish, wait: Wait) -> StoredResults:
        """Have a pod upload the results from the volume, and return its report."""
        self._watch.start()
        has_results = (job.directory / _STARTED).exists() and self._has_volume(job, wait)
        if not has_results or plain.reason is EndReason.lost:
            return StoredResults(plain, has_log=False)
        if plain.reason is EndReason.cancelled:
            # Nobody waits for a node on which a pod could read the report.
            return StoredResults(plain.model_copy(update={"problems": [_CANCELLED_RESULTS]}), has_log=False)
        body = self._manifests.store(job, plain, has_authorities=self._authorities is not None)
        try:
            self._create("jobs", body, wait, timeout_s=math.inf, may_exist=True)
        except CannotStart as error:
            return StoredResults(_without_results(plain, error.ending.message), has_log=False)
        pod = self._await_end(_names(job.key).store, wait, None)
        if pod is not None and pod.status.phase == "Succeeded":
            problem = "What it reported is not in its output any more."
            if (finish := self._read_report(pod, wait)) is not None:
                return StoredResults(finish, has_log=False)
        else:
            problem = endings.ending_of(pod, job.resources).message if pod else "Its pods were removed."
        return StoredResults(_without_results(plain, problem), has_log=False)

    def _has_volume(self, job: RunJob, wait: Wait) -> bool:
        while True:
            try:
                return self._cluster.has_claim(_names(job.key).claim)
            except ClusterError as error:  # noqa: PERF203  each round takes seconds
                _log.warning("the results of the run %s wait: %s", job.key, error)
                wait(_JOB_CHECK_S)

    def _read_report(self, pod: Pod, wait: Wait) -> RunFinish | None:
        while True:
            try:
                return read_finish(self._cluster.read_output(pod.metadata.name))
            except ValueError as error:  # noqa: PERF203  each round takes seconds
                _log.warning("the report of %s is damaged: %s", pod.metadata.name, error)
                return None
            except ClusterError as error:
                if error.is_missing:
                    return None
                wait(_JOB_CHECK_S)

    def remove(self, job: RunJob) -> None:
        """Delete everything of a job; what the cluster does not delete now is tried again later."""
        self._forget(job)
        for name in (_STOP_REASON, _FIRST_POD):
            (job.directory / name).unlink(missing_ok=True)
        self._try_to_delete(job.key)

    def close(self) -> None:
        """End the watch and the copies of logs."""
        self._watch.close()
        with self._lock:
            monitors = [*self._monitors.values()]
        for monitor in monitors:
            monitor.close()

    def remove_others(self, known_keys: Collection[str]) -> None:
        """Delete the Jobs, volumes and Secrets of this runner with other keys."""
        kinds: tuple[Kind, ...] = ("jobs", "persistentvolumeclaims")
        try:
            entries = [entry for kind in kinds for entry in self._cluster.list_names(kind, self._manifests.selector)]
            for key in {entry.labels.get(KEY_LABEL, "") for entry in entries} - {*known_keys, ""}:
                self._delete(key)
        except (ClusterError, CannotStart) as error:
            _log.warning("objects of earlier runs were not removed: %s", error)

    def _try_to_delete(self, key: str) -> None:
        """Delete everything of a job; what is left is tried again with the next run."""
        try:
            self._delete(key)
            self._left_keys.discard(key)
        except ClusterError as error:
            self._left_keys.add(key)
            _log.warning("objects of the run %s are not removed yet: %s", key, error)

    def _delete(self, key: str) -> None:
        names = _names(key)
        for name in names.jobs:
            self._cluster.delete("jobs", name)
        for name in (names.order, names.environment):
            self._cluster.delete("secrets", name)
        # Last, as `remove_others` finds by it what else there is.
        self._cluster.delete("persistentvolumeclaims", names.claim)

    def _create(
        self, kind: Kind, body: Body, wait: Wait, *, timeout_s: float = _CREATE_S, may_exist: bool = False
    ) -> None:
        """Create an object, though the API server may be away for a while. Raises CannotStart."""
        deadline_s = time.monotonic() + timeout_s
        while True:
            try:
                self._cluster.create(kind, body)
                return
            except ClusterUnavailable as error:  # noqa: PERF203  each round is a request
                if time.monotonic() > deadline_s:
                    raise cannot_start(f"The API server of the cluster is not available: {error}.") from error
                # It may have been created, and the answer was lost.
                may_exist = True
                wait(_CHECK_S)
            except ClusterError as error:
                if not (may_exist and error.is_conflict):
                    raise cannot_start(f"The cluster refuses it: {error}.") from error
                return

    def _await_removal(self, key: str, wait: Wait) -> None:
        """Wait until an earlier start has left nothing. Raises CannotStart."""
        names = _names(key)
        deadline_s = time.monotonic() + _GONE_S
        while True:
            with contextlib.suppress(ClusterError):
                has_pod = not self._watch.is_current or self._watch.find_any(KEY_LABEL, key) is not None
                if not has_pod and not self._cluster.has_claim(names.claim):
                    return
            if time.monotonic() > deadline_s:
                raise CannotStart(Ending(EndReason.lost, _NO_NODE))
            wait(_CHECK_S)

    def _await_end(self, name: str, wait: Wait, show: Show | None) -> Pod | None:
        """Wait for the end of a Job that may start several pods, and return the last; None where there is none."""
        checked_s = 0.0
        began_s = seen_s = time.monotonic()
        while True:
            pod = self._watch.find(name) if self._watch.is_current else None
            if pod is not None and pod.status.phase == "Succeeded":
                return pod
            if pod is None or not pod.spec.node_name:
                seen_s = time.monotonic()
            elif (failure := endings.failed_start(pod, time.monotonic() - seen_s)) is not None:
                raise CannotStart(failure)
            if show is not None and (reason := self._reason_waiting(pod, began_s)) is not None:
                show(reason, 0.0)
            if time.monotonic() > checked_s + _JOB_CHECK_S:
                checked_s = time.monotonic()
                with contextlib.suppress(ClusterError):
                    job = self._cluster.find_job(name)
                    if job is None or job.failure is not None:
                        return pod
            wait(0)
            self._watch.wait(lambda seen=pod: self._watch.find(name) is not seen, _CHECK_S)  # type: ignore[misc]

    def _reason_waiting(self, pod: Pod | None, began_s: float) -> str | None:
        if pod is not None:
            return endings.reason_waiting(pod)
        has_waited = time.monotonic() > began_s + _JOB_CHECK_S
        return endings.NO_POD if self._watch.is_current and has_waited else None

    def _monitor(self, job: RunJob) -> "_JobMonitor":
        with self._lock:
            if job.key not in self._monitors:
                self._watch.start()
                self._monitors[job.key] = _JobMonitor(self._cluster, self._watch, job)
            return self._monitors[job.key]

    def _forget(self, job: RunJob) -> None:
        with self._lock:
            monitor = self._monitors.pop(job.key, None)
        if monitor is not None:
            monitor.close()


class _JobMonitor:
    """Watches the pod of one action: its log, limits and end."""

    def __init__(self, cluster: Cluster, watch: PodWatch, job: RunJob) -> None:
        self._cluster = cluster
        self._watch = watch
        self._job = job
        self._name = _names(job.key).action
        self._limits = LimitMonitor(job.directory, limits_of(job))
        with contextlib.suppress(FileNotFoundError, ValueError):
            reason, message = json.loads((job.directory / _STOP_REASON).read_text())
            self._limits.reason = reason, message
        self._waits_since_s = time.monotonic()
        self._pod: Pod | None = None
        self._log: PodLog | None = None
        self._is_deleted = False
        self._started_s: float | None = None
        self._ended_s: float | None = None
        self._job_checked_s = 0.0
        self._ending: Ending | None = None
        self._lock = threading.Lock()
        self.placement: RunPlacement | None = None

    def poll(self) -> Ending | None:
        """Return how the job ended, or None while it runs or its log is incomplete."""
        with self._lock:
            if self._ending is None:
                self._ending = self._poll()
            return self._ending

    def reason_waiting(self) -> str | None:
        """Return why its pod does not run yet."""
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
            lost = endings.vanished(None)
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
        return self._poll_ended(endings.vanished(job.failure if job else None))

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
        path = self._job.directory / _FIRST_POD
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
        path = self._job.directory / _STARTED
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
        write_atomically(self._job.directory / _STOP_REASON, json.dumps(self._limits.reason))
        try:
            self._cluster.delete("jobs", self._name)
        except ClusterError as error:
            raise OSError(str(error)) from error
        self._is_deleted = True


def _without_results(plain: RunFinish, problem: str) -> RunFinish:
    message = f"The pod that stores its results failed: {problem}"
    changes: dict[str, object] = {"problems": [message]}
    if plain.reason is EndReason.done:
        changes |= {"reason": EndReason.results_not_stored, "message": message}
    return plain.model_copy(update=changes)


def _names(key: str) -> Names:
    try:
        return Names.of(key)
    except ValueError as error:
        raise cannot_start(f"{error}.") from error
