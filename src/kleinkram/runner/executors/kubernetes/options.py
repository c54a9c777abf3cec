"""The options of a runner that runs jobs on a Kubernetes cluster."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

import kleinkram

_GB = 10**9
# Pods of a run have the same user, to whom its volume belongs.
_USER = 10_001


class Toleration(BaseModel):
    """A taint of nodes that pods tolerate. `value` null: any; `effect` null: all."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    key: Annotated[str, Field(min_length=1)]
    value: str | None = None
    effect: Literal["NoSchedule", "PreferNoSchedule", "NoExecute"] | None = None

    @staticmethod
    def split(text: str) -> dict[str, str | None]:
        """Return the fields of a text such as `nvidia.com/gpu` or `team=slam:NoSchedule`."""
        words, _, effect = text.partition(":")
        key, equals, value = words.partition("=")
        return {"key": key, "value": value if equals else None, "effect": effect or None}


class KubernetesOptions(BaseModel):
    """How jobs run on a cluster.

    `kubeconfig` and `context` null: the service account of the pod that this process is in, or else the usual file.
    `pod_image` is the image with Kleinkram, which fetches inputs and stores results. `storage_class` null: the
    cluster's default. `cores`, `memory_bytes`, `disk_bytes` and `gpus` are the most that one run may have.
    `gpu_node_selector` and `gpu_tolerations` are for runs with GPUs, in addition.
    `allow_metadata_access`: runs with an open network may reach the metadata service of the cloud, by which they get
    the credentials of their node.
    `run_as_user` null: the cluster chooses, as OpenShift does.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    namespace: Annotated[str, Field(pattern=r"^[a-z0-9]([a-z0-9-]{0,61}[a-z0-9])?$")] = "kleinkram-runs"
    kubeconfig: Path | None = None
    context: str | None = None
    pod_image: str = f"kleinkram/runner:{kleinkram.__version__}"
    pull_secrets: list[str] = []
    storage_class: str | None = None
    max_jobs: Annotated[int, Field(ge=1, le=1000)] = 10
    cores: Annotated[float, Field(gt=0)] = 4
    memory_bytes: Annotated[int, Field(gt=0)] = 16 * _GB
    disk_bytes: Annotated[int, Field(gt=0)] = 100 * _GB
    gpus: Annotated[int, Field(ge=0)] = 0
    gpu_resource: str = "nvidia.com/gpu"
    node_selector: dict[str, str] = {}
    gpu_node_selector: dict[str, str] = {}
    tolerations: list[Toleration] = []
    gpu_tolerations: list[Toleration] = []
    priority_class: str | None = None
    allow_metadata_access: bool = False
    run_as_user: Annotated[int, Field(ge=1)] | None = _USER
