"""Creates and deletes the objects of runs, though the API server may be away for a while, or a quota has no room."""

import logging
import threading
import time
from collections.abc import Collection

from kleinkram.contract.runs import EndReason
from kleinkram.environments.cache import Show
from kleinkram.environments.uv import Wait
from kleinkram.runner.executors.base import CannotStart, Ending
from kleinkram.runner.executors.kubernetes import endings
from kleinkram.runner.executors.kubernetes.cluster import Body, Cluster, ClusterError, ClusterUnavailable, Kind
from kleinkram.runner.executors.kubernetes.manifests import KEY_LABEL, Names
from kleinkram.runner.executors.kubernetes.pod_watch import PodWatch
from kleinkram.runner.executors.local import cannot_start

_log = logging.getLogger("kleinkram.runner")
_CHECK_S = 0.5
_DELETE_AGAIN_S = 2.0
_CREATE_S = 60.0
# A pod of an earlier start is gone by then, unless its node does not answer.
_GONE_S = 120.0
_NO_NODE = "A pod of an earlier start is not removed by the cluster, since its node does not answer."


class OverQuota(Exception):
    """A quota of the namespace has no room for an object at the moment. The text is the reason, for people."""


class RunObjects:
    """The objects of all runs of one runner. Thread-safe."""

    def __init__(self, cluster: Cluster, watch: PodWatch, selector: str) -> None:
        self._cluster = cluster
        self._watch = watch
        self._selector = selector
        self._left_keys: set[str] = set()
        # Held while left objects are deleted, so that those of a later start of the same run are not.
        self._left_lock = threading.Lock()

    def create(
        self,
        kind: Kind,
        body: Body,
        wait: Wait,
        show: Show | None,
        *,
        timeout_s: float = _CREATE_S,
        may_exist: bool = False,
        refused_s: float = 0.0,
    ) -> None:
        """Create an object, though the API server may be away for `timeout_s`, and a quota may have no room for long.

        Raises:
            CannotStart: the cluster refuses it, for `refused_s`.
            OverQuota: `show` is None, and a quota has no room.
        """
        began_s = time.monotonic()
        deadline_s = began_s + timeout_s
        while True:
            try:
                self._cluster.create(kind, body)
                return
            except ClusterUnavailable as error:
                if time.monotonic() > deadline_s:
                    raise cannot_start(f"The API server of the cluster is not available: {error}.") from error
                # It may have been created, and the answer was lost.
                may_exist = True
            except ClusterError as error:
                if may_exist and error.is_existing:
                    return
                if not error.is_over_quota and time.monotonic() >= began_s + refused_s:
                    raise cannot_start(f"The cluster refuses it: {error}.") from error
                if show is None:
                    raise OverQuota(endings.reason_refused(str(error))) from error
                show(endings.reason_refused(str(error)), 0.0)
                deadline_s = time.monotonic() + timeout_s
            wait(_CHECK_S)

    def delete(self, key: str) -> bool:
        """Delete everything of a run; return whether all was. What is left is tried again later."""
        try:
            self._delete(key)
        except ClusterError as error:
            self._left_keys.add(key)
            _log.warning("objects of the run %s are not removed yet: %s", key, error)
            return False
        self._left_keys.discard(key)
        return True

    def delete_left(self) -> None:
        """Delete what could not be deleted, until that fails again."""
        with self._left_lock:
            all(self.delete(key) for key in [*self._left_keys])

    def delete_others(self, known_keys: Collection[str]) -> None:
        """Delete the Jobs, volumes and Secrets with other keys."""
        kinds: tuple[Kind, ...] = ("jobs", "persistentvolumeclaims")
        try:
            entries = [entry for kind in kinds for entry in self._cluster.list_names(kind, self._selector)]
            for key in {entry.labels.get(KEY_LABEL, "") for entry in entries} - {*known_keys, ""}:
                self._delete(key)
        except (ClusterError, CannotStart) as error:
            _log.warning("objects of earlier runs were not removed: %s", error)

    def await_removal(self, key: str, wait: Wait) -> None:
        """Wait until an earlier start of a run has left nothing.

        Raises:
            CannotStart: a pod is still there after minutes in which the API server answered.
        """
        with self._left_lock:
            self._left_keys.discard(key)
        now_s = time.monotonic()
        deadline_s, delete_at_s = now_s + _GONE_S, now_s + _DELETE_AGAIN_S
        while True:
            try:
                if self._watch.is_current and not self._is_there(key):
                    return
                if time.monotonic() > delete_at_s:
                    # An earlier request may have failed.
                    delete_at_s = time.monotonic() + _DELETE_AGAIN_S
                    self._delete(key)
                is_answered = self._watch.is_current
            except ClusterError:
                is_answered = False
            if not is_answered:
                deadline_s = time.monotonic() + _GONE_S
            if time.monotonic() > deadline_s:
                raise CannotStart(Ending(EndReason.lost, _NO_NODE))
            wait(_CHECK_S)

    def await_end_of_pods(self, job: str, wait: Wait) -> None:
        """Wait until no pod of a Job runs any more, such as one that was replaced while its node did not answer.

        Raises:
            CannotStart: one is still there after minutes.
        """
        deadline_s = time.monotonic() + _GONE_S
        while not self._watch.is_current or not all(pod.has_ended for pod in self._watch.pods_of(job)):
            if not self._watch.is_current:
                deadline_s = time.monotonic() + _GONE_S
            if time.monotonic() > deadline_s:
                raise CannotStart(Ending(EndReason.lost, _NO_NODE))
            wait(_CHECK_S)

    def remove_job(self, name: str, wait: Wait) -> None:
        """Delete a Job, and wait until none of its pods is there. Raises CannotStart as `await_removal`."""
        deadline_s = time.monotonic() + _GONE_S
        while True:
            try:
                self._cluster.delete("jobs", name)
                if self._watch.is_current and not self._watch.pods_of(name):
                    return
            except ClusterError:
                deadline_s = time.monotonic() + _GONE_S
            if time.monotonic() > deadline_s:
                raise CannotStart(Ending(EndReason.lost, _NO_NODE))
            wait(_CHECK_S)

    def _is_there(self, key: str) -> bool:
        names = names_of(key)
        return any(self._watch.pods_of(name) for name in names.jobs) or self._cluster.has_volume(names.volume)

    def _delete(self, key: str) -> None:
        names = names_of(key)
        for name in names.jobs:
            self._cluster.delete("jobs", name)
        for name in (names.assignment, names.environment):
            self._cluster.delete("secrets", name)
        # Last, as `delete_others` finds by it what else there is.
        self._cluster.delete("persistentvolumeclaims", names.volume)


def names_of(key: str) -> Names:
    """Return the names of the objects of a run. Raises CannotStart."""
    try:
        return Names.of(key)
    except ValueError as error:
        raise cannot_start(f"{error}.") from error
