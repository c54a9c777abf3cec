"""The objects of a run on a cluster: a volume (claim), Secrets, and a Job for each of its three steps.

`fetch` has the inputs written to the volume, `action` is the program of a stranger, `store` has its results uploaded.
Each step is a pod of its own: the action's has neither credentials nor the network of the other two, and a GPU is taken
only while it runs. Nothing here sends requests.
"""

import base64
import gzip
import json
import re
from collections.abc import Mapping, Sequence
from typing import Literal, NamedTuple

from pydantic import BaseModel, ConfigDict, Field

from kleinkram.contract.actions import Resources
from kleinkram.contract.runners import RunAssignment, RunFinish
from kleinkram.runner.executors.base import RunJob
from kleinkram.runner.executors.kubernetes.cluster import Body
from kleinkram.runner.executors.kubernetes.options import KubernetesOptions, Toleration
from kleinkram.runner.executors.supervision import GRACE_S

Step = Literal["fetch", "action", "store", "probe"]
MANAGER_LABEL, MANAGER = "app.kubernetes.io/managed-by", "kleinkram-runner"
RUNNER_LABEL, KEY_LABEL, STEP_LABEL = "kleinkram.runner", "kleinkram.job", "kleinkram.step"
# What NetworkPolicies select pods by: a `Network`, or `transfer` for the pods of Kleinkram itself.
NETWORK_LABEL, TRANSFER = "kleinkram.network", "transfer"
CONTAINER = "main"
VOLUME, ASSIGNMENT_FOLDER, ASSIGNMENT_FILE = "/volume", "/run/kleinkram", "assignment.json.gz"
AUTHORITIES_FILE = "authorities.pem"
TEMPORARY = "/tmp"  # noqa: S108  the pod's own
_ENVIRONMENT = {"HOME": TEMPORARY, "TMPDIR": TEMPORARY, "PYTHONUNBUFFERED": "1"}
# An ended Job is removed after this time, even if no runner came back for it.
_TTL_S = 7 * 86_400
# A pod may take so much longer than the limit of its program, since its node pulls the image first.
_DEADLINE_MARGIN_S = 3600
_TRANSFER_RETRIES = 4
_MAX_SECRET_BYTES = 2**20 - 2**14
_VOLUME_MARGIN_BYTES = 256 * 2**20
_TRANSFER_MEMORY = "1Gi"
_TRANSFER_CPU = "100m"
_TEMPORARY = "2Gi"
_SHARED_MEMORY = "64Mi"
_POD_MODULE = "kleinkram.runner.kubernetes_pod"
_RFC1123 = re.compile(r"[a-z0-9]([a-z0-9-]*[a-z0-9])?")
_LONGEST_KEY = 51


class AssignmentTooLarge(Exception):
    """The assignment of a run does not fit into a Secret."""


class PodAssignment(BaseModel):
    """The assignment of a run for the pods of Kleinkram, with the runner's credentials. Stored in a Secret."""

    model_config = ConfigDict(frozen=True)

    url: str
    token: str = Field(repr=False)
    assignment: RunAssignment


class Names(NamedTuple):
    """The names of the objects of a run."""

    fetch: str
    action: str
    store: str
    volume: str
    assignment: str
    environment: str

    @classmethod
    def of(cls, key: str) -> "Names":
        """Return the names for the key of a job. Raises ValueError."""
        if not _RFC1123.fullmatch(key) or len(key) > _LONGEST_KEY:
            raise ValueError(f"{key} cannot be part of a name in Kubernetes")
        base = f"klein-{key}"
        return cls(f"{base}-fetch", base, f"{base}-store", base, base, f"{base}-env")

    @property
    def jobs(self) -> tuple[str, ...]:
        """All Jobs."""
        return self.fetch, self.action, self.store


class Manifests:
    """Describes the objects of the runs of one runner."""

    def __init__(self, options: KubernetesOptions, runner: str) -> None:
        self._options = options
        self._runner = runner
        self.selector = f"{MANAGER_LABEL}={MANAGER},{RUNNER_LABEL}={runner}"

    def labels(self, key: str, step: Step, network: str) -> dict[str, str]:
        """Return the labels of the Job and the pod of a step."""
        return {**self._labels(key), STEP_LABEL: step, NETWORK_LABEL: network}

    def _labels(self, key: str) -> dict[str, str]:
        return {MANAGER_LABEL: MANAGER, RUNNER_LABEL: self._runner, KEY_LABEL: key}

    def volume(self, key: str, size_bytes: int) -> Body:
        """Return a claim of a volume for the inputs and outputs of a run."""
        specification: Body = {
            "accessModes": ["ReadWriteOnce"],
            "resources": {"requests": {"storage": str(size_bytes + _VOLUME_MARGIN_BYTES)}},
        }
        if self._options.storage_class is not None:
            specification["storageClassName"] = self._options.storage_class
        return {
            "apiVersion": "v1",
            "kind": "PersistentVolumeClaim",
            "metadata": {"name": Names.of(key).volume, "labels": self._labels(key)},
            "spec": specification,
        }

    def assignment(self, key: str, assignment: PodAssignment, authorities: str | None) -> Body:
        """Return the Secret of the pods that fetch and store. Raises AssignmentTooLarge."""
        files = {ASSIGNMENT_FILE: gzip.compress(assignment.model_dump_json().encode(), mtime=0)}
        if authorities is not None:
            files[AUTHORITIES_FILE] = authorities.encode()
        if sum(map(len, files.values())) > _MAX_SECRET_BYTES:
            raise AssignmentTooLarge
        return self._secret(
            key, Names.of(key).assignment, {"data": {name: _base64(data) for name, data in files.items()}}
        )

    def environment(self, job: RunJob) -> Body:
        """Return the Secret with the environment of a job, which has the token of the run."""
        return self._secret(job.key, Names.of(job.key).environment, {"stringData": dict(job.environment)})

    def _secret(self, key: str, name: str, content: Body) -> Body:
        metadata = {"name": name, "labels": self._labels(key)}
        return {"apiVersion": "v1", "kind": "Secret", "metadata": metadata, "immutable": True, **content}

    def fetch(self, key: str, assignment: RunAssignment, *, has_authorities: bool) -> Body:
        """Return the Job that writes the inputs to the volume."""
        container = self._transfer_container(["fetch"], has_authorities=has_authorities)
        return self._transfer_job(key, Names.of(key).fetch, "fetch", container, assignment.resources)

    def store(self, job: RunJob, finish: RunFinish, *, has_authorities: bool) -> Body:
        """Return the Job that uploads the results from the volume; `finish` is what is known without them."""
        words = json.dumps([finish.reason.value, finish.message, finish.exit_code])
        container = self._transfer_container(["store", "--ending", words], has_authorities=has_authorities)
        return self._transfer_job(job.key, Names.of(job.key).store, "store", container, job.resources)

    def _transfer_container(self, arguments: Sequence[str], *, has_authorities: bool) -> Body:
        environment = {**_ENVIRONMENT}
        if has_authorities:
            environment["SSL_CERT_FILE"] = f"{ASSIGNMENT_FOLDER}/{AUTHORITIES_FILE}"
        return {
            "name": CONTAINER,
            "image": self._options.pod_image,
            "command": _literal(
                ["python3", "-m", _POD_MODULE, *arguments, "--volume", VOLUME, "--assignment", ASSIGNMENT_FOLDER]
            ),
            "env": _variables(environment),
            "resources": {
                "requests": {"cpu": _TRANSFER_CPU, "memory": "256Mi"},
                "limits": {"memory": _TRANSFER_MEMORY, "ephemeral-storage": _TEMPORARY},
            },
            # Of a pod that fails, the end of its output says why. An action's would be the words of a stranger.
            "terminationMessagePolicy": "FallbackToLogsOnError",
            "volumeMounts": [
                {"name": "run", "mountPath": VOLUME},
                {"name": "assignment", "mountPath": ASSIGNMENT_FOLDER, "readOnly": True},
                {"name": "tmp", "mountPath": TEMPORARY},
            ],
        }

    def _transfer_job(self, key: str, name: str, step: Step, container: Body, resources: Resources) -> Body:
        volumes = [
            _claimed(key),
            {"name": "assignment", "secret": {"secretName": Names.of(key).assignment, "defaultMode": 0o440}},
            {"name": "tmp", "emptyDir": {"sizeLimit": _TEMPORARY}},
        ]
        pod = {**self._pod(container, resources), "volumes": volumes}
        labels = self.labels(key, step, TRANSFER)
        return self._job(name, labels, pod, retries=_TRANSFER_RETRIES)

    def action(self, job: RunJob) -> Body:
        """Return the Job of the action."""
        resources = job.resources
        amounts = {"cpu": f"{round(resources.cores * 1000)}m", "memory": str(resources.memory_bytes)}
        amounts["ephemeral-storage"] = str(resources.disk_bytes)
        if resources.gpus:
            amounts[self._options.gpu_resource] = str(resources.gpus)
        container: Body = {
            "name": CONTAINER,
            "image": job.image,
            "env": _variables(_ENVIRONMENT),
            "resources": {"requests": amounts, "limits": amounts},
            "volumeMounts": [
                {"name": "run", "mountPath": "/in", "subPath": "in", "readOnly": True},
                {"name": "run", "mountPath": "/out", "subPath": "out"},
                {"name": "tmp", "mountPath": TEMPORARY},
                {"name": "shm", "mountPath": "/dev/shm"},  # noqa: S108  the pod's own
            ],
        }
        if job.command:
            container["args"] = _literal(job.command)
        if job.environment:
            container["envFrom"] = [{"secretRef": {"name": Names.of(job.key).environment}}]
        pod = {
            **self._pod(container, resources),
            "activeDeadlineSeconds": resources.time_s + _DEADLINE_MARGIN_S,
            "terminationGracePeriodSeconds": int(GRACE_S),
            "volumes": [
                _claimed(job.key),
                {"name": "tmp", "emptyDir": {"sizeLimit": str(resources.disk_bytes)}},
                {"name": "shm", "emptyDir": {"medium": "Memory", "sizeLimit": _SHARED_MEMORY}},
            ],
        }
        labels = self.labels(job.key, "action", job.network.value)
        return self._job(Names.of(job.key).action, labels, pod, retries=0)

    def probe(self, key: str, network: str, targets: Sequence[tuple[str, int]]) -> Body:
        """Return a Job that tells which of some addresses a pod with this network reaches."""
        words = [f"{host} {port}" for host, port in targets]
        container: Body = {
            "name": CONTAINER,
            "image": self._options.pod_image,
            "command": ["python3", "-m", _POD_MODULE, "probe", *words],
            "env": _variables(_ENVIRONMENT),
            "resources": {
                "requests": {"cpu": _TRANSFER_CPU, "memory": "64Mi"},
                "limits": {"memory": "256Mi", "ephemeral-storage": "64Mi"},
            },
            "volumeMounts": [{"name": "tmp", "mountPath": TEMPORARY}],
        }
        pod = {**self._pod(container, Resources()), "volumes": [{"name": "tmp", "emptyDir": {"sizeLimit": "64Mi"}}]}
        pod["activeDeadlineSeconds"] = _DEADLINE_MARGIN_S
        # With the key of its own name, it is found and removed by a later runner, if this one is killed.
        return self._job(Names.of(key).action, self.labels(key, "probe", network), pod, retries=0)

    def _job(self, name: str, labels: dict[str, str], pod: Body, *, retries: int) -> Body:
        return {
            "apiVersion": "batch/v1",
            "kind": "Job",
            "metadata": {"name": name, "labels": labels},
            "spec": {
                "backoffLimit": retries,
                # A pod that is being deleted may still write to the volume. Until 1.28, clusters ignore this.
                "podReplacementPolicy": "Failed",
                "ttlSecondsAfterFinished": _TTL_S,
                "template": {"metadata": {"labels": labels}, "spec": pod},
            },
        }

    def _pod(self, container: Body, resources: Resources) -> Body:
        options = self._options
        user: Body = {"runAsNonRoot": True, "seccompProfile": {"type": "RuntimeDefault"}}
        if options.run_as_user is not None:
            user |= dict.fromkeys(("runAsUser", "runAsGroup", "fsGroup"), options.run_as_user)
            user["fsGroupChangePolicy"] = "OnRootMismatch"
        security = {
            "allowPrivilegeEscalation": False,
            "readOnlyRootFilesystem": True,
            "capabilities": {"drop": ["ALL"]},
        }
        selector = {**options.node_selector, **(options.gpu_node_selector if resources.gpus else {})}
        tolerations = [*options.tolerations, *(options.gpu_tolerations if resources.gpus else [])]
        pod: Body = {
            "restartPolicy": "Never",
            "automountServiceAccountToken": False,
            "enableServiceLinks": False,
            # The program is then not the first process: signals have their usual effects, and orphans are reaped.
            "shareProcessNamespace": True,
            "securityContext": user,
            "containers": [{"terminationMessagePolicy": "File", **container, "securityContext": security}],
        }
        if selector:
            pod["nodeSelector"] = selector
        if tolerations:
            pod["tolerations"] = [*map(_toleration, tolerations)]
        if options.pull_secrets:
            pod["imagePullSecrets"] = [{"name": name} for name in options.pull_secrets]
        if options.priority_class is not None:
            pod["priorityClassName"] = options.priority_class
        return pod


def _claimed(key: str) -> Body:
    return {"name": "run", "persistentVolumeClaim": {"claimName": Names.of(key).volume}}


def _toleration(toleration: Toleration) -> Body:
    operator = "Exists" if toleration.value is None else "Equal"
    return {**toleration.model_dump(exclude_none=True), "operator": operator}


def _variables(environment: Mapping[str, str]) -> list[Body]:
    return [{"name": name, "value": value} for name, value in environment.items()]


def _literal(words: Sequence[str]) -> list[str]:
    """Return words in which Kubernetes replaces no `$(VARIABLE)`."""
    return [word.replace("$", "$$") for word in words]


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode()
