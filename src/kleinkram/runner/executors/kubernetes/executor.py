"""Runs jobs as Jobs of a Kubernetes cluster: a pod fetches inputs, one runs the action, one stores the results.

All state is in the cluster and in the directory of the job, so that a later runner finds the Jobs by their names. Jobs
go on while no runner does.
"""

import logging
import os
import threading
from collections.abc import Collection, Mapping
from pathlib import Path

from kleinkram.contract.actions import Network
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
from kleinkram.runner.executors.kubernetes.cluster import Body, Cluster, ClusterError, Kind
from kleinkram.runner.executors.kubernetes.image_registry import pin_image
from kleinkram.runner.executors.kubernetes.job_monitor import FIRST_POD, STARTED, STOP_REASON, JobMonitor
from kleinkram.runner.executors.kubernetes.manifests import AssignmentTooLarge, Manifests, PodAssignment
from kleinkram.runner.executors.kubernetes.network_probe import find_networks
from kleinkram.runner.executors.kubernetes.options import KubernetesOptions
from kleinkram.runner.executors.kubernetes.pod_watch import PodWatch
from kleinkram.runner.executors.kubernetes.run_objects import RunObjects, names_of
from kleinkram.runner.executors.kubernetes.transfers import Transfers
from kleinkram.runner.executors.local import cannot_start
from kleinkram.runner.executors.supervision import CANCELLED, read_log_of, write_lease
from kleinkram.runner.input_cache import InputFile, InputSource

_log = logging.getLogger("kleinkram.runner")
# Between the failure of this runner and another one's start of the run: long enough to restart the runner elsewhere.
_LEASE_S = 900
_CHECK_S = 2.0
_JOB_NAME_LABEL = "job-name"
_CANCELLED_RESULTS = "It was cancelled: its results were not stored."


class KubernetesExecutor(Executor):
    """Runs jobs on a cluster. `runner` separates its Jobs from those of other runners.

    `url` and `token` are the runner's, for the pods that fetch and store. `networks` are those that the cluster was
    seen to separate; None: `find_abilities` finds out.
    """

    def __init__(
        self,
        cluster: Cluster,
        options: KubernetesOptions,
        *,
        runner: str,
        url: str,
        token: str,
        networks: Collection[Network] | None = None,
    ) -> None:
        self._cluster = cluster
        self._options = options
        self._url = url
        self._token = token
        self._are_networks_known = networks is not None
        self._networks = frozenset(networks or ())
        self._manifests = Manifests(options, runner)
        self._watch = PodWatch(cluster, self._manifests.selector, _JOB_NAME_LABEL)
        self._objects = RunObjects(cluster, self._watch, self._manifests.selector)
        self._transfers = Transfers(cluster, self._watch, self._objects)
        self._monitors: dict[str, JobMonitor] = {}
        self._lock = threading.Lock()
        self._is_closed = threading.Event()
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
    def are_abilities_known(self) -> bool:
        """Whether the networks of this cluster are known."""
        return self._are_networks_known

    def find_abilities(self) -> None:
        """Have pods try which networks they have."""
        offered = find_networks(
            self._cluster,
            self._manifests,
            self._url,
            allows_metadata=self._options.allow_metadata_access,
            is_closed=self._is_closed,
        )
        self._networks = offered.networks
        self._are_networks_known = offered.are_all_known

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
        key = directory.parent.name
        self._objects.delete_left()
        assigned = PodAssignment(url=self._url, token=self._token, assignment=source.assignment)
        resources = source.assignment.resources
        size_bytes = sum(file.size_bytes for file in files.values()) + resources.disk_bytes
        try:
            secret = self._manifests.assignment(key, assigned, self._authorities)
        except AssignmentTooLarge:
            message = f"It has {len(files)} inputs: more than can be described to a pod of a cluster."
            raise cannot_start(message) from None
        self._watch.start()
        fetch = self._manifests.fetch(key, source.assignment, has_authorities=self._authorities is not None)
        volume = self._manifests.volume(key, size_bytes)
        bodies: dict[Kind, Body] = {"persistentvolumeclaims": volume, "secrets": secret, "jobs": fetch}
        outcome = self._transfers.fetch(key, bodies, resources, source)
        if outcome.is_gone:
            raise RunGone(run_id=str(source.assignment.run_id))
        if outcome.ending is not None:
            raise CannotStart(outcome.ending)

    def evict_unused(self) -> None:
        """Delete what the cluster did not delete so far: volumes, and Secrets with credentials."""
        self._objects.delete_left()

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
        bodies: list[tuple[Kind, Body]] = [("jobs", self._manifests.action(job))]
        if job.environment:
            bodies.insert(0, ("secrets", self._manifests.environment(job)))
        self._forget(job)
        self._monitor(job).create(bodies)

    def was_submitted(self, job: RunJob, wait: Wait) -> bool:
        """Ask for the Job, until the API server answers; one whose pod was seen may be removed by now."""
        while not (job.directory / FIRST_POD).exists():
            try:
                return self._cluster.find_job(names_of(job.key).action) is not None
            except ClusterError as error:  # noqa: PERF203  each round takes seconds
                _log.warning("whether the run %s was submitted is not known yet: %s", job.key, error)
                wait(_CHECK_S)
        return True

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
        write_lease(job.directory, until_s, create=create)

    def read_log(self, job: RunJob, offset: int, size_bytes: int) -> bytes:
        """Read the copy of the output."""
        return read_log_of(job.directory, offset, size_bytes)

    def cancel(self, job: RunJob) -> None:
        """Delete the Job: its pod gets SIGTERM, and SIGKILL later."""
        self._monitor(job).stop(CANCELLED)

    def usage(self, job: RunJob) -> Usage | None:
        """Return None: that would take rights on the metrics of the cluster."""
        return None

    def collect(self, job: RunJob) -> Path:
        """Return a directory that does not exist: results stay on the volume until `upload_results`."""
        return job.directory / "out"

    def upload_results(self, job: RunJob, plain: RunFinish, wait: Wait, show: Show) -> StoredResults:
        """Have a pod upload the results from the volume, and return its report."""
        self._watch.start()
        if plain.reason is EndReason.lost or not (job.directory / STARTED).exists():
            return StoredResults(plain, has_log=False)
        if plain.reason is EndReason.cancelled:
            # Nobody waits for a node on which a pod could read the report.
            return StoredResults(plain.model_copy(update={"problems": [_CANCELLED_RESULTS]}), has_log=False)
        if not self._transfers.has_volume(job.key, wait):
            return StoredResults(_without_results(plain, "Its volume was removed."), has_log=False)
        body = self._manifests.store(job, plain, has_authorities=self._authorities is not None)
        try:
            finish = self._transfers.store(job.key, body, job.resources, wait, show)
        except CannotStart as error:
            finish = _without_results(plain, error.ending.message)
        return StoredResults(finish, has_log=False)

    def remove(self, job: RunJob) -> None:
        """Delete everything of a job; what the cluster does not delete now is tried again later."""
        self._forget(job)
        for name in (STOP_REASON, FIRST_POD):
            (job.directory / name).unlink(missing_ok=True)
        self._objects.delete(job.key)

    def close(self) -> None:
        """End the watch and the copies of logs."""
        self._is_closed.set()
        self._watch.close()
        with self._lock:
            monitors = [*self._monitors.values()]
        for monitor in monitors:
            monitor.close()

    def remove_others(self, known_keys: Collection[str]) -> None:
        """Delete the Jobs, volumes and Secrets of this runner with other keys."""
        self._objects.delete_others(known_keys)

    def _monitor(self, job: RunJob) -> JobMonitor:
        with self._lock:
            if job.key not in self._monitors:
                self._watch.start()
                self._monitors[job.key] = JobMonitor(self._cluster, self._watch, self._objects, job)
            return self._monitors[job.key]

    def _forget(self, job: RunJob) -> None:
        with self._lock:
            monitor = self._monitors.pop(job.key, None)
        if monitor is not None:
            monitor.close()


def _without_results(plain: RunFinish, problem: str) -> RunFinish:
    message = f"Its results could not be stored: {problem}"
    changes: dict[str, object] = {"problems": [message]}
    if plain.reason is EndReason.done:
        changes |= {"reason": EndReason.results_not_stored, "message": message}
    return plain.model_copy(update=changes)
