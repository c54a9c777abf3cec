"""The pods of one runner as they are: one list and one watch for all its runs, in a thread."""

import logging
import threading
from collections.abc import Callable, Sequence
from http import HTTPStatus

from kleinkram.runner.executors.kubernetes.api_objects import Pod
from kleinkram.runner.executors.kubernetes.cluster import Cluster, ClusterError
from kleinkram.runner.executors.kubernetes.endings import with_history

_log = logging.getLogger("kleinkram.runner")
_RETRY_S = 1.0
_MAX_RETRY_S = 30.0


class PodWatch:
    """Knows the pods with labels. Thread-safe. `start` may be called again."""

    def __init__(self, cluster: Cluster, selector: str, job_label: str) -> None:
        self._cluster = cluster
        self._selector = selector
        self._job_label = job_label
        # Of each Job, by their uids.
        self._pods: dict[str, dict[str, Pod]] = {}
        self._changed = threading.Condition()
        self._is_current = False
        self._thread: threading.Thread | None = None
        self._is_closed = False

    def start(self) -> None:
        """Begin to watch."""
        with self._changed:
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="pods", daemon=True)
                self._thread.start()

    @property
    def is_current(self) -> bool:
        """Whether the pods are known, and changes arrive."""
        return self._is_current

    def pods_of(self, job: str) -> list[Pod]:
        """Return the pods of a Job by its name."""
        with self._changed:
            return [*self._pods.get(job, {}).values()]

    def find(self, job: str) -> Pod | None:
        """Return the last pod of a Job by its name: a failed one only if it has no other."""
        return max(self.pods_of(job), key=lambda pod: (pod.status.phase != "Failed", _created_s(pod)), default=None)

    def wait(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Wait for a change after which a condition holds."""
        with self._changed:
            return self._changed.wait_for(condition, timeout_s)

    def close(self) -> None:
        """End the thread, once its request has ended."""
        with self._changed:
            self._is_closed = True
            self._changed.notify_all()

    def _run(self) -> None:
        pause_s = _RETRY_S
        while not self._is_closed:
            try:
                pods, version = self._cluster.list_pods(self._selector)
                with self._changed:
                    self._replace(pods)
                    self._is_current = True
                    self._changed.notify_all()
                pause_s = _RETRY_S
                while not self._is_closed:
                    version = self._follow(version)
            except ClusterError as error:
                if self._is_current and error.status != HTTPStatus.GONE:
                    _log.warning("the pods of runs are not watched; trying again: %s", error)
            except Exception:
                # Without this thread, all runs would stand still.
                _log.exception("an unexpected error ended the watch of the pods of runs; trying again")
            with self._changed:
                self._is_current = False
                self._changed.wait_for(lambda: self._is_closed, pause_s)
            pause_s = min(2 * pause_s, _MAX_RETRY_S)

    def _follow(self, version: str) -> str:
        """Apply changes after a version until the watch ends, and return the last one."""
        for event in self._cluster.watch_pods(self._selector, version):
            if self._is_closed:
                break
            version, pod = event.version or version, event.pod
            if pod is None:
                continue
            with self._changed:
                pods = self._pods.setdefault(self._job_of(pod), {})
                if event.is_deleted:
                    pods.pop(pod.metadata.uid, None)
                else:
                    pods[pod.metadata.uid] = with_history(pod, pods.get(pod.metadata.uid))
                if not pods:
                    del self._pods[self._job_of(pod)]
                self._changed.notify_all()
        return version

    def _replace(self, pods: Sequence[Pod]) -> None:
        known: dict[str, dict[str, Pod]] = {}
        for pod in pods:
            name, uid = self._job_of(pod), pod.metadata.uid
            known.setdefault(name, {})[uid] = with_history(pod, self._pods.get(name, {}).get(uid))
        self._pods = known

    def _job_of(self, pod: Pod) -> str:
        return pod.metadata.labels.get(self._job_label, "")


def _created_s(pod: Pod) -> float:
    return pod.metadata.creation_timestamp.timestamp() if pod.metadata.creation_timestamp else 0.0
