"""What the state of a pod says: why it waits, and how it ended. Words of the cluster are passed on to people."""

from collections.abc import Mapping

from kleinkram.contract.actions import Resources
from kleinkram.contract.runs import EndReason
from kleinkram.runner.executors.base import Ending
from kleinkram.runner.executors.kubernetes.api_objects import ContainerState, Pod, TerminatedContainer
from kleinkram.runner.executors.supervision import (
    command_not_found,
    out_of_memory,
    over_disk_limit,
    reason_of_exit_code,
)

# A registry that does not answer, or an image that is being pushed, is waited for.
_IMAGE_PATIENCE_S = 120.0
_BACK_OFF = "ImagePullBackOff"
_PERMANENT_IMAGE_REASONS = {"InvalidImageName", "ErrImageNeverPull"}
_IMAGE_REASONS = {
    *_PERMANENT_IMAGE_REASONS,
    "ErrImagePull",
    _BACK_OFF,
    "ImageInspectError",
    "RegistryUnavailable",
}
_PERMANENT_IMAGE_WORDS = ("not found", "manifest unknown", "denied", "unauthorized", "no match for platform")
_CONFIGURATION_REASONS = {"CreateContainerConfigError", "CreateContainerError", "RunContainerError"}
_START_REASONS = {"StartError", "ContainerCannotRun"}
_NO_COMMAND_WORDS = ("no such file", "executable file not found", "permission denied", "exec format error")
_WAITING: Mapping[str, str] = {
    "ContainerCreating": "its node prepares it: the image is pulled and the volume is mounted",
    "PodInitializing": "its node prepares it",
}
_MAX_CHARACTERS = 1000
# Of the progress of a run, which people see.
_MAX_PROGRESS_CHARACTERS = 200
_LOST = "Its pod was removed from outside: its node failed or was drained, or somebody deleted it."
NO_POD = "the cluster has created no pod for it yet; the reason is in `kubectl describe job`, such as a quota"


def reason_waiting(pod: Pod) -> str | None:
    """Return why a pod has not started yet; None where it has."""
    if pod.has_ended or pod.container.running or pod.container.terminated:
        return None
    scheduled = pod.condition("PodScheduled")
    if scheduled is not None and scheduled.status != "True":
        return _cut_progress(f"no node for it: {scheduled.message or scheduled.reason}")
    waiting = pod.container.waiting
    if waiting is None or not pod.spec.node_name:
        return "it waits for the scheduler of the cluster"
    node = f"on the node {pod.spec.node_name}, "
    if waiting.reason in _WAITING:
        return _cut_progress(node + _WAITING[waiting.reason])
    return _cut_middle(f"{node}{waiting.reason}: {waiting.message}")


def with_history(pod: Pod, earlier: Pod | None) -> Pod:
    """Return a pod with what was seen of it earlier, and the cluster does not tell any more."""
    return _with_cause(_with_disruption(pod, earlier), earlier)


def _with_disruption(pod: Pod, earlier: Pod | None) -> Pod:
    """Note whether its end was requested before it ended: its program may then have ended well, and too early."""
    disruption = pod.condition("DisruptionTarget")
    is_requested = pod.metadata.deletion_timestamp is not None or (
        disruption is not None and disruption.status == "True"
    )
    if earlier is not None and (earlier.has_ended or earlier.is_disrupted):
        is_requested = earlier.is_disrupted
    return pod.model_copy(update={"is_disrupted": is_requested})


def _with_cause(pod: Pod, earlier: Pod | None) -> Pod:
    """Return a pod that waits for its next pull of the image with why the last one failed.

    Until Kubernetes 1.31, nodes tell the cause only for a moment, at each failure.
    """
    waiting = pod.container.waiting
    before = earlier.container.waiting if earlier is not None else None
    if waiting is None or waiting.reason != _BACK_OFF or before is None or before.reason not in _IMAGE_REASONS:
        return pod
    state = ContainerState(waiting=waiting.model_copy(update={"message": before.message}))
    first, *others = pod.status.container_statuses
    statuses = [first.model_copy(update={"state": state}), *others]
    return pod.model_copy(update={"status": pod.status.model_copy(update={"container_statuses": statuses})})


def queued_s(pod: Pod) -> float | None:
    """Return how long a pod waited for a node; None while it does."""
    scheduled = pod.condition("PodScheduled")
    created_at = pod.metadata.creation_timestamp
    if scheduled is None or scheduled.status != "True" or scheduled.last_transition_time is None or created_at is None:
        return None
    return max(0.0, (scheduled.last_transition_time - created_at).total_seconds())


def failed_start(pod: Pod, waited_s: float) -> Ending | None:
    """Return why a pod will not start, which Kubernetes would try for ever; None where it may.

    `waited_s`: for how long it was seen to wait for its node.
    """
    waiting = pod.container.waiting
    if waiting is None:
        return None
    words = _cut(waiting.message or waiting.reason)
    if waiting.reason in _IMAGE_REASONS:
        is_permanent = waiting.reason in _PERMANENT_IMAGE_REASONS or any(
            text in waiting.message.lower() for text in _PERMANENT_IMAGE_WORDS
        )
        if is_permanent or waited_s > _IMAGE_PATIENCE_S:
            return Ending(EndReason.image_unavailable, f"The cluster cannot pull its image: {words}")
    elif waiting.reason in _CONFIGURATION_REASONS:
        return _failed_command(words) or Ending(EndReason.not_possible, f"The cluster cannot start it: {words}")
    return None


def _failed_command(words: str) -> Ending | None:
    if any(text in words.lower() for text in _NO_COMMAND_WORDS):
        return Ending.of(command_not_found(words))
    return None


def ending_of(pod: Pod, resources: Resources) -> Ending:
    """Return how an ended pod ended that nobody here has stopped."""
    status, terminated = pod.status, pod.container.terminated
    if status.reason == "DeadlineExceeded":
        return Ending(EndReason.time, f"It ran longer than its limit of {resources.time_s} s.")
    if status.reason == "Evicted":
        return _eviction(_cut(status.message), resources)
    if pod.is_disrupted:
        disruption = pod.condition("DisruptionTarget")
        return _lost(disruption.message or disruption.reason if disruption is not None else None)
    # The other reasons of pods are those of nodes, which end or refuse them: a shutdown, a pod of higher priority.
    if terminated is None or status.reason or (status.phase == "Failed" and terminated.exit_code == 0):
        return _lost(status.message or status.reason)
    return _termination(terminated, resources)


def _eviction(words: str, resources: Resources) -> Ending:
    if words.startswith("The node "):
        return Ending(EndReason.lost, f"Its node ran out of resources and evicted it: {words}")
    return Ending(EndReason.disk, f"{over_disk_limit(resources.disk_bytes)[1]} {words}".strip())


def _termination(terminated: TerminatedContainer, resources: Resources) -> Ending:
    if terminated.reason == "OOMKilled":
        return Ending.of(out_of_memory(resources.memory_bytes))
    if terminated.reason in _START_REASONS:
        words = _cut(terminated.message or terminated.reason)
        return _failed_command(words) or Ending(EndReason.not_possible, f"The cluster could not start it: {words}")
    if terminated.reason == "ContainerStatusUnknown":
        return _lost(None)
    return Ending.of(reason_of_exit_code(terminated.exit_code), terminated.exit_code)


def ending_without_pod(failure: str | None) -> Ending:
    """Return the ending of a job whose pod is gone; `failure` is what its Job says."""
    return _lost(failure)


def _lost(words: str | None) -> Ending:
    return Ending(EndReason.lost, _cut(f"{_LOST} {words or ''}".strip()))


def last_words(pod: Pod) -> str:
    """Return what the container of an ended pod said last, for people; empty where it said nothing."""
    terminated = pod.container.terminated
    return _cut_middle(terminated.message) if terminated is not None else ""


def reason_refused(message: str) -> str:
    """Return why the cluster creates nothing at the moment, as a progress."""
    return _cut_middle(f"the cluster refuses it at the moment: {message}")


def _cut_progress(text: str) -> str:
    return " ".join(text.replace("\0", "").split())[:_MAX_PROGRESS_CHARACTERS]


def _cut_middle(text: str) -> str:
    """Return the beginning and the end of a text: the cause is at the end."""
    words = " ".join(text.replace("\0", "").split())
    if len(words) <= _MAX_PROGRESS_CHARACTERS:
        return words
    half = _MAX_PROGRESS_CHARACTERS // 2 - 2
    return f"{words[:half]} … {words[-half:]}"


def _cut(text: str) -> str:
    return text[:_MAX_CHARACTERS]
